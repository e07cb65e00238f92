/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Few linear equations.
 */
#ifndef TRAJEVAL_ROS_SOLVE_H
#define TRAJEVAL_ROS_SOLVE_H

#include "loops.h"

enum { MOST = 8 }; /* unknowns */

/* x of a x = b by elimination with partial pivoting, in place; a (n, n) with rows of MOST. Not 0 where
 * there is none. */
static inline int solve(int n, double a[MOST][MOST], double *x)
{
    for (int c = 0; c < n; c++) {
        int pivot = c;
        for (int r = c + 1; r < n; r++)
            if (fabs(a[r][c]) > fabs(a[pivot][c]))
                pivot = r;
        if (!(fabs(a[pivot][c]) > 0.0))
            return 1;
        for (int k = 0; k < n && pivot != c; k++) {
            const double kept = a[c][k];
            a[c][k] = a[pivot][k];
            a[pivot][k] = kept;
        }
        const double kept = x[c];
        x[c] = x[pivot];
        x[pivot] = kept;
        for (int r = c + 1; r < n; r++) {
            const double share = a[r][c] / a[c][c];
            for (int k = c; k < n; k++)
                a[r][k] -= share * a[c][k];
            x[r] -= share * x[c];
        }
    }
    for (int c = n - 1; c >= 0; c--) {
        for (int k = c + 1; k < n; k++)
            x[c] -= a[c][k] * x[k];
        x[c] /= a[c][c];
    }
    return 0;
}

#endif
