/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The relative errors given the past ones (`likelihood/innovations.py`). With the gauge's error at a
 * pose ~ N(m, P) given the errors up to there, the step from it, of error e, adjoint A and noise
 * Sigma, has the innovation e + A m ~ N(0, S), and after it m and P are
 *
 *     S = A P A^T + Sigma = L L^T,    m <- Sigma S^-1 (A m + e),    P <- (A P A^T) S^-1 Sigma.
 */
#include "cholesky.h"
#include "se3.h"

/* out = a b^T; all (D, D). */
static void times_transposed(const double a[D][D], const double b[D][D], double out[D][D]) {
    for (int i = 0; i < D; i++)
        for (int j = 0; j < D; j++) {
            double sum = 0.0;
            for (int k = 0; k < D; k++) sum += a[i][k] * b[j][k];
            out[i][j] = sum;
        }
}

/* out = a b. */
static void times(const double a[D][D], const double b[D][D], double out[D][D]) {
    for (int i = 0; i < D; i++) {
        for (int j = 0; j < D; j++) out[i][j] = 0.0;
        for (int k = 0; k < D; k++)
            for (int j = 0; j < D; j++) out[i][j] += a[i][k] * b[k][j];
    }
}

/* x <- L^-T x. */
static void backward(const double lower[D][D], double x[D][D]) {
    for (int i = D - 1; i >= 0; i--) {
        for (int k = i + 1; k < D; k++)
            for (int j = 0; j < D; j++) x[i][j] -= lower[k][i] * x[k][j];
        for (int j = 0; j < D; j++) x[i][j] /= lower[i][i];
    }
}

/* One step. error (D), adjoint (D, D) and noise (D, D), that of its end; mean (D) and spread (D, D)
 * go on. Writes chi2 and log |S|; returns 0 where S has no factor. */
static int step(const double *error, const double adjoint[D][D], const double noise[D][D],
                double *mean, double spread[D][D], double *chi2, double *log_det) {
    double half[D][D], ahead[D][D], covariance[D][D], lower[D][D], gain[D][D], moved[D], white[D];
    times(adjoint, (const double(*)[D])spread, half);
    times_transposed((const double(*)[D])half, adjoint, ahead);
    for (int i = 0; i < D; i++)
        for (int j = 0; j < D; j++)
            covariance[i][j] = ahead[i][j] + noise[i][j], gain[i][j] = noise[i][j];
    if (factor(*covariance, lower, log_det)) return 0;
    for (int i = 0; i < D; i++) {
        moved[i] = error[i];
        for (int k = 0; k < D; k++) moved[i] += adjoint[i][k] * mean[k];
        white[i] = moved[i];
    }
    forward(lower, 1, 1, white);
    *chi2 = 0.0;
    for (int i = 0; i < D; i++) *chi2 += white[i] * white[i];
    forward(lower, D, D, *gain);
    backward((const double(*)[D])lower, gain);
    times((const double(*)[D])ahead, (const double(*)[D])gain, half);
    for (int i = 0; i < D; i++) {
        mean[i] = 0.0;
        for (int k = 0; k < D; k++) mean[i] += moved[k] * gain[k][i];
        for (int j = 0; j < D; j++) spread[i][j] = 0.5 * (half[i][j] + half[j][i]);
    }
    return 1;
}

/* So many steps in turn: error (count, 6), adjoint and noise (count, 6, 6); mean (6) and spread
 * (6, 6) before the first, and then after the last. Writes chi2 and log_det (count).
 *
 * Returns 0, or the number, from 1, of the step where S has no factor. */
int64_t innovations(int64_t count, const double *error, const double *adjoint, const double *noise,
                    double *mean, double *spread, double *chi2, double *log_det) {
    for (int64_t i = 0; i < count; i++)
        if (!step(error + D * i, (const double(*)[D])(adjoint + D * D * i),
                  (const double(*)[D])(noise + D * D * i), mean, (double(*)[D])spread, chi2 + i,
                  log_det + i))
            return i + 1;
    return 0;
}

/* Of poses (count + 1, 4, 4), ground truth and estimate, the relative errors e (count, 6) of the
 * steps and their adjoints A (count, 6, 6), as `likelihood/relative.py` has them. series (terms, 2):
 * as `se3_log`. */
int relative_steps(int64_t count, const double *ground_truth, const double *estimate,
                   const double *series, int64_t terms, double *error, double *adjoint) {
    for (int64_t n = 0; n < count; n++, ground_truth += 16, estimate += 16) {
        double inverse[16], backwards[16], apart[16], product[16];
        se3_inverse(ground_truth + 16, inverse, 1);
        se3_compose(inverse, ground_truth, backwards);
        se3_inverse(estimate, inverse, 1);
        se3_compose(backwards, inverse, product);
        se3_compose(product, estimate + 16, apart);
        se3_log(apart, error + D * n, 1, series, terms);
        se3_adjoint(backwards, adjoint + D * D * n, 1);
    }
    return 0;
}

/* Whether all covariances (count, 6, 6), scaled to a unit diagonal, have a Cholesky factor less
 * ``least`` times the identity. */
int all_positive(int64_t count, const double *covariance, double least) {
    for (int64_t n = 0; n < count; n++, covariance += D * D) {
        double scale[D], scaled[D * D], lower[D][D], log_det;
        for (int i = 0; i < D; i++) {
            const double variance = covariance[D * i + i];
            if (!(variance > 0.0 && variance <= DBL_MAX)) return 0;
            scale[i] = 1.0 / sqrt(variance);
        }
        for (int i = 0; i < D; i++)
            for (int j = 0; j < D; j++) {
                const double entry = scale[i] * covariance[D * i + j] * scale[j];
                if (!isfinite(entry)) return 0;
                scaled[D * i + j] = entry - (i == j ? least : 0.0);
            }
        if (factor(scaled, lower, &log_det)) return 0;
    }
    return 1;
}
