/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Few symmetric equations.
 */
#ifndef TRAJEVAL_ROS_EIGEN_H
#define TRAJEVAL_ROS_EIGEN_H

#include "loops.h"

enum { ORDER = 16 }; /* of a matrix, at the most */

/* Eigenvalues, on the diagonal of a (n, n), and eigenvectors in the columns of v, by Jacobi's
 * rotations. */
static inline void diagonalise(int n, double a[ORDER][ORDER], double v[ORDER][ORDER])
{
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++)
            v[i][j] = i == j;
    for (int sweep = 0, turned = 1; turned && sweep < 40; sweep++) {
        turned = 0;
        for (int p = 0; p < n; p++)
            for (int q = p + 1; q < n; q++) {
                const double beside = a[p][q];
                if (!(fabs(beside) > 1e-17 * sqrt(fabs(a[p][p] * a[q][q])) &&
                      fabs(beside) > 1e-300))
                    continue;
                turned = 1;
                const double ratio = 0.5 * (a[q][q] - a[p][p]) / beside;
                const double t = copysign(1.0, ratio) / (fabs(ratio) + sqrt(1.0 + ratio * ratio));
                const double c = 1.0 / sqrt(1.0 + t * t), s = t * c;
                a[p][p] -= t * beside;
                a[q][q] += t * beside;
                a[p][q] = a[q][p] = 0.0;
                for (int k = 0; k < n; k++) {
                    const double w = v[k][p], z = v[k][q];
                    v[k][p] = c * w - s * z;
                    v[k][q] = s * w + c * z;
                    if (k == p || k == q)
                        continue;
                    const double x = a[k][p], y = a[k][q];
                    a[k][p] = a[p][k] = c * x - s * y;
                    a[k][q] = a[q][k] = s * x + c * y;
                }
            }
    }
}

#endif
