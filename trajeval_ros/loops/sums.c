/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Sums of residuals that are affine in a few unknowns: whitened (likelihood/band.py), and put into
 * a triangle (likelihood/information.py).
 */
#include "loops.h"

#include <float.h>

enum { BLOCK = 6, SQUARE = BLOCK * BLOCK, WIDEST = 8 };

/* The lower Cholesky factor of a (6, 6), in its lower triangle; not 0 where there is none. */
LOOPS_PART int factored(const double *matrix, double *lower)
{
    for (int j = 0; j < BLOCK; j++) {
        double pivot = matrix[BLOCK * j + j];
        for (int k = 0; k < j; k++)
            pivot -= lower[BLOCK * j + k] * lower[BLOCK * j + k];
        /* Not of what is not a number or not finite either. */
        if (!(pivot > 0.0 && pivot <= DBL_MAX))
            return 1;
        const double root = sqrt(pivot);
        lower[BLOCK * j + j] = root;
        for (int i = j + 1; i < BLOCK; i++) {
            double sum = matrix[BLOCK * i + j];
            for (int k = 0; k < j; k++)
                sum -= lower[BLOCK * i + k] * lower[BLOCK * j + k];
            lower[BLOCK * i + j] = sum / root;
        }
    }
    return 0;
}

/* X becomes L^-1 X, of so many columns. */
LOOPS_PART void forward(const double *lower, int columns, double *x)
{
    for (int i = 0; i < BLOCK; i++)
        for (int c = 0; c < columns; c++) {
            double sum = x[columns * i + c];
            for (int k = 0; k < i; k++)
                sum -= lower[BLOCK * i + k] * x[columns * k + c];
            x[columns * i + c] = sum / lower[BLOCK * i + i];
        }
}

LOOPS_PART double log_determinant(const double *lower)
{
    double sum = 0.0;
    for (int i = 0; i < BLOCK; i++)
        sum += log(lower[BLOCK * i + i]);
    return 2.0 * sum;
}

/* Residuals whose covariances (count, 6, 6) are independent of each other: columns (count, 6, wide)
 * become L^-1 of themselves, log_det (count,). 1 + the number of one that is not positive definite;
 * columns are then of no use. */
int64_t sums_whitened(int64_t count, int64_t wide, const double *covariance, double *columns,
                       double *log_det)
{
    for (int64_t i = 0; i < count; i++) {
        double lower[SQUARE];
        if (factored(covariance + SQUARE * i, lower))
            return 1 + i;
        forward(lower, (int)wide, columns + BLOCK * wide * i);
        log_det[i] = log_determinant(lower);
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
