/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Nuisances by their normal equations (error_model/likelihood.py, `Likelihood._integrate`).
 */
#include "loops.h"

enum { MOST = 16 };

/* normal (n + 1, n + 1), the errors last; precision (c,) of the first c <= n. theta (n,), its covariance
 * (n, n); found: chi2 without theta, and log |information|. Not 0 where that is not positive definite. */
int theta_integrated(int64_t size, int64_t c, const double *normal, const double *precision,
                     double *theta, double *covariance, double *found)
{
    const int n = (int)size;
    double lower[MOST][MOST], inverse[MOST][MOST] = {{0.0}}, scale[MOST];
    const double *const right = normal + n * (n + 1);
    found[0] = right[n];
    found[1] = 0.0;
    for (int i = 0; i < n; i++) {
        const double own = normal[i * (n + 1) + i] + (i < c ? precision[i] : 0.0);
        scale[i] = 1.0 / sqrt(fmax(own, 1e-300));
        for (int j = 0; j <= i; j++) {
            double sum = scale[i] * (i == j ? own : normal[i * (n + 1) + j]) * scale[j];
            for (int k = 0; k < j; k++)
                sum -= lower[i][k] * lower[j][k];
            if (i > j) {
                lower[i][j] = sum / lower[j][j];
                continue;
            }
            if (!(sum > 0.0))
                return 1;
            lower[i][i] = sqrt(sum);
            found[1] += 2.0 * log(lower[i][i] / scale[i]);
        }
    }
    for (int j = 0; j < n; j++)
        for (int i = j; i < n; i++) {
            double sum = i == j ? 1.0 : 0.0;
            for (int k = j; k < i; k++)
                sum -= lower[i][k] * inverse[k][j];
            inverse[i][j] = sum / lower[i][i];
        }
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            double sum = 0.0;
            for (int k = i; k < n; k++)
                sum += inverse[k][i] * inverse[k][j];
            covariance[i * n + j] = covariance[j * n + i] = scale[i] * sum * scale[j];
        }
    for (int i = 0; i < n; i++) {
        theta[i] = 0.0;
        for (int j = 0; j < n; j++)
            theta[i] += covariance[i * n + j] * right[j];
        found[0] -= right[i] * theta[i];
    }
    return 0;
}
