/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Sums of residuals that are affine in a few unknowns: whitened (likelihood/band.py), and put into
 * a triangle (likelihood/information.py).
 */
#include "cholesky.h"

enum { WIDEST = 8 };

/* Residuals whose covariances (count, 6, 6) are independent of each other: columns (count, 6, wide)
 * become L^-1 of themselves, log_det (count,). 1 + the number of one that is not positive definite;
 * columns are then of no use. */
int64_t sums_whitened(int64_t count, int64_t wide, const double *covariance, double *columns,
                       double *log_det)
{
    for (int64_t i = 0; i < count; i++) {
        double lower[D][D];
        if (factor(covariance + D * D * i, lower, log_det + i))
            return 1 + i;
        forward(lower, wide, wide, columns + D * wide * i);
    }
    return 0;
}

/* The larger one, NaN where either is. */
static inline double larger(double a, double b) { return b > a || isnan(b) ? b : a; }

/* The triangle R with R'R = A'A, by Householder's reflections, as the first rows of A (rows, wide),
 * wide <= rows, wide <= 8. */
int sums_triangle(int64_t rows, int64_t wide, double *matrix)
{
    if (wide > WIDEST || wide > rows)
        return 1;
    for (int64_t j = 0; j < wide; j++) {
        double largest = 0.0, square = 0.0, product[WIDEST] = {0.0};
        for (int64_t i = j + 1; i < rows; i++)
            largest = larger(largest, fabs(matrix[wide * i + j]));
        if (largest == 0.0)
            continue;
        const double head = matrix[wide * j + j];
        largest = larger(largest, fabs(head));
        for (int64_t i = j; i < rows; i++) {
            const double scaled = matrix[wide * i + j] / largest;
            square += scaled * scaled;
        }
        /* H = I - v v' / (v_0 diagonal) up to sign, with v = column - diagonal e_0. */
        const double diagonal = -copysign(largest * sqrt(square), head);
        const double first = head - diagonal;
        matrix[wide * j + j] = first;
        for (int64_t i = j; i < rows; i++) {
            const double v = matrix[wide * i + j] / first;
            for (int64_t c = j + 1; c < wide; c++)
                product[c] += v * matrix[wide * i + c];
        }
        for (int64_t c = j + 1; c < wide; c++)
            product[c] /= diagonal;
        for (int64_t i = j; i < rows; i++) {
            const double v = matrix[wide * i + j];
            for (int64_t c = j + 1; c < wide; c++)
                matrix[wide * i + c] += v * product[c];
        }
        matrix[wide * j + j] = diagonal;
    }
    for (int64_t i = 1; i < wide; i++)
        for (int64_t c = 0; c < i; c++)
            matrix[wide * i + c] = 0.0;
    return 0;
}
