/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * What poses that are independent of each other say of an alignment g (`likelihood/search.py`).
 * The residual of a pose is eps = Log(T_gt^-1 g T_est) ~ N(0, V), and to first order
 *
 *     eps(h(delta) g) = eps + J delta,    J = J_r(eps)^-1 [Ad(B) | -b],    B = (g T_est)^-1
 *
 * with b the translation of B, whose world has its origin at the centre c (`alignment/gauge.py`).
 * With V = L L^T, the rows L^-1 [J eps] are taken into a triangle by Householder's reflections.
 */
#include <string.h>

#include "cholesky.h"
#include "se3.h"

enum { MOST = 8 }; /* freedoms of a similarity, and the residual */

/* T_gt and T_est are asked of g: its pose (4, 4) and scale, perturbed about a centre (3) in some
 * freedoms (dimension) of (rho, phi, lambda). series (terms, 2): as `se3_log`. */
typedef struct {
    const double *pose, *centre, *series;
    double scale;
    const int64_t *freedoms;
    int64_t dimension, terms;
} Alignment;

/* The residual (6) of a pose, and where it lies aligned (4, 4). */
static void residual(const Alignment *g, const double *truth, const double *estimate, double *eps,
                     double *aligned)
{
    double scaled[16], back[16], apart[16];
    memcpy(scaled, estimate, sizeof scaled);
    for (int i = 0; i < 3; i++) scaled[4 * i + 3] *= g->scale;
    se3_compose(g->pose, scaled, aligned);
    se3_inverse(truth, back, 1);
    se3_compose(back, aligned, apart);
    se3_log(apart, eps, 1, g->series, g->terms);
}

/* J (6, dimension) of a residual, in the first columns of `rows`. */
static void jacobian(const Alignment *g, const double *eps, const double *aligned,
                     double rows[D][MOST])
{
    double about[16], to_body[16], adjoint[D][D], lever[D] = {0.0}, back[D], inverse[D][D];
    memcpy(about, aligned, sizeof about);
    for (int i = 0; i < 3; i++) about[4 * i + 3] -= g->centre[i];
    for (int i = 0; i < D; i++) back[i] = -eps[i];
    se3_inverse(about, to_body, 1);
    se3_adjoint(to_body, *adjoint, 1);
    se3_left_jacobian_inverse(back, *inverse, 1, g->series, g->terms);
    for (int i = 0; i < 3; i++) lever[i] = -to_body[4 * i + 3];
    for (int64_t c = 0; c < g->dimension; c++) {
        const int64_t from = g->freedoms[c];
        for (int i = 0; i < D; i++) {
            rows[i][c] = 0.0;
            for (int k = 0; k < D; k++)
                rows[i][c] += inverse[i][k] * (from < D ? adjoint[k][from] : lever[k]);
        }
    }
}

/* triangle (size, size), upper, takes rows (6, size) in: R^T R grows by rows^T rows. */
static void absorb(int64_t size, double *triangle, double rows[D][MOST])
{
    for (int64_t j = 0; j < size; j++) {
        double *const r = triangle + size * j, below = 0.0;
        for (int i = 0; i < D; i++) below += rows[i][j] * rows[i][j];
        if (below == 0.0) continue;
        /* The reflection that takes (r_j, rows_j) to (-+ norm, 0). */
        const double norm = copysign(sqrt(r[j] * r[j] + below), r[j]), head = r[j] + norm;
        const double scale = 1.0 / (norm * head);
        for (int64_t c = j + 1; c < size; c++) {
            double along = head * r[c];
            for (int i = 0; i < D; i++) along += rows[i][j] * rows[i][c];
            along *= scale;
            r[c] -= head * along;
            for (int i = 0; i < D; i++) rows[i][c] -= rows[i][j] * along;
        }
        r[j] = -norm;
    }
}

/* Takes poses in: ground_truth and estimate (count, 4, 4), covariance (count, 6, 6), under an
 * alignment of pose (4, 4) and scale, perturbed about a centre (3) in so many freedoms (dimension)
 * of (rho, phi, lambda). series (terms, 2): the logarithm's, as `se3.py` has it.
 *
 * triangle (dimension + 1, dimension + 1), of which nothing is asked for a dimension of -1; sums (2):
 * the residuals' chi2 and log |V|. All of these grow.
 *
 * Returns 0, or the number, from 1, of the pose whose covariance has no factor, or minus that of
 * the pose that is not finite. */
int64_t absolute(int64_t count, const double *ground_truth, const double *estimate,
                 const double *covariance, const double *pose, double scale, const double *centre,
                 const int64_t *freedoms, int64_t dimension, const double *series, int64_t terms,
                 double *triangle, double *sums)
{
    const Alignment g = {pose, centre, series, scale, freedoms, dimension, terms};
    const int64_t last = dimension < 0 ? 0 : dimension;
    for (int64_t n = 0; n < count; n++) {
        double eps[D], aligned[16], rows[D][MOST], lower[D][D], log_det;
        residual(&g, ground_truth + 16 * n, estimate + 16 * n, eps, aligned);
        for (int i = 0; i < D; i++)
            if (!isfinite(eps[i])) return -(n + 1);
        if (dimension > 0) jacobian(&g, eps, aligned, rows);
        for (int i = 0; i < D; i++) rows[i][last] = eps[i];
        if (factor(covariance + D * D * n, lower, &log_det)) return n + 1;
        forward(lower, last + 1, MOST, *rows);
        for (int i = 0; i < D; i++) sums[0] += rows[i][last] * rows[i][last];
        sums[1] += log_det;
        if (dimension >= 0) absorb(last + 1, triangle, rows);
    }
    return 0;
}

/* Takes rows in, L^-1 columns with V = L L^T: covariance (count, 6, 6), columns (count, 6, size),
 * size <= 8, triangle (size, size); log_det (1), which grows.
 *
 * Returns 0, or the number, from 1, of the covariance that has no factor. */
int64_t absorb_whitened(int64_t count, int64_t size, const double *covariance,
                        const double *columns, double *triangle, double *log_det)
{
    for (int64_t n = 0; n < count; n++) {
        double rows[D][MOST], lower[D][D], own;
        for (int i = 0; i < D; i++)
            memcpy(rows[i], columns + size * (D * n + i), (size_t)size * sizeof(double));
        if (factor(covariance + D * D * n, lower, &own)) return n + 1;
        forward(lower, size, MOST, *rows);
        absorb(size, triangle, rows);
        *log_det += own;
    }
    return 0;
}
