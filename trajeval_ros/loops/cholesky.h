/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Covariances V = L L' of a pose's residual, (6, 6).
 */
#ifndef TRAJEVAL_ROS_CHOLESKY_H
#define TRAJEVAL_ROS_CHOLESKY_H

#include "loops.h"

#include <float.h>

enum { D = 6 };

/* L, in the lower triangle, of V, whose lower triangle is read, and log |V|. Not 0 where V is not
 * positive definite: not of what is not a number or not finite either. */
LOOPS_PART int factor(const double *v, double lower[D][D], double *log_det)
{
    *log_det = 0.0;
    for (int j = 0; j < D; j++) {
        double pivot = v[D * j + j];
        for (int k = 0; k < j; k++)
            pivot -= lower[j][k] * lower[j][k];
        if (!(pivot > 0.0 && pivot <= DBL_MAX))
            return 1;
        lower[j][j] = sqrt(pivot);
        *log_det += 2.0 * log(lower[j][j]);
        for (int i = j + 1; i < D; i++) {
            double sum = v[D * i + j];
            for (int k = 0; k < j; k++)
                sum -= lower[i][k] * lower[j][k];
            lower[i][j] = sum / lower[j][j];
        }
    }
    return 0;
}

/* X becomes L^-1 X, of so many columns (6, columns), whose rows are ``stride`` apart. */
LOOPS_PART void forward(double lower[D][D], int64_t columns, int64_t stride, double *x)
{
    for (int i = 0; i < D; i++, x += stride) {
        for (int k = 0; k < i; k++)
            for (int64_t c = 0; c < columns; c++)
                x[c] -= lower[i][k] * x[(k - i) * stride + c];
        for (int64_t c = 0; c < columns; c++)
            x[c] /= lower[i][i];
    }
}

#endif
