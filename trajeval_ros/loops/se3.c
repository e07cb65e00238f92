/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The maps of SE(3) over n poses, one after the other; conventions, coefficients and how they keep
 * their digits are those of `se3.py`. A sum of products starts from zero and leaves no zero out, so
 * that what is not finite spreads as it does there. `table` holds a Taylor series a column.
 */
#include "loops.h"
#include "se3.h"

#include <float.h>

/* Below this |phi|^2 the series serve. */
#define SERIES_BELOW 4.0

enum { A, B, C, DB, DC, EXPONENTIALS };
enum { D, DD, LOGARITHMS };

/* The sums of the series at x. */
static void taylor(double x, const double *table, int64_t terms, int columns, double *found)
{
    for (int c = 0; c < columns; ++c) found[c] = 0.0;
    for (int64_t k = terms - 1; k >= 0; --k)
        for (int c = 0; c < columns; ++c) found[c] = found[c] * x + table[k * columns + c];
}

/* A, B, C, B', C' at x = |phi|^2. */
static void exponential_coefficients(double x, const double *table, int64_t terms, double *found)
{
    if (x < SERIES_BELOW) {
        taylor(x, table, terms, EXPONENTIALS, found);
        return;
    }
    const double theta = sqrt(x), half = 0.5 * theta, ratio = sin(half) / half;
    found[A] = sin(theta) / theta;
    found[B] = 0.5 * (ratio * ratio);
    found[C] = (1.0 - found[A]) / x;
    found[DB] = (found[A] - 2.0 * found[B]) / x;
    found[DC] = (found[B] - 3.0 * found[C]) / x;
}

/* D, D' at x = |phi|^2. */
static void logarithm_coefficients(double x, const double *table, int64_t terms, double *found)
{
    if (x < SERIES_BELOW) {
        taylor(x, table, terms, LOGARITHMS, found);
        return;
    }
    const double half = 0.5 * sqrt(x), ratio = half / sin(half);
    found[D] = (1.0 - ratio * cos(half)) / x;
    found[DD] = ((ratio * ratio - 1.0) / x - found[D]) / x;
}

static double dot(const double *u, const double *v)
{
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
}

/* w (3, 3): hat(v). */
static void hat(const double *v, double *w)
{
    const double none = 0.0 * v[0] + 0.0 * v[1] + 0.0 * v[2]; /* or NaN */
    const double rows[9] = {0.0, -v[2], v[1], v[2], 0.0, -v[0], -v[1], v[0], 0.0};
    for (int i = 0; i < 9; ++i) w[i] = rows[i] + none;
}

/* c = a b, (3, 3) each. */
static void product(const double *a, const double *b, double *c)
{
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            c[3 * i + j] =
                a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
}

/* f = I + p w + q w2, (3, 3) each. */
static void quadratic(double p, const double *w, double q, const double *w2, double *f)
{
    for (int i = 0; i < 9; ++i) f[i] = (i % 4 ? 0.0 : 1.0) + p * w[i] + q * w2[i];
}

/* The rotation (3, 3) of a pose. */
static void rotation_of(const double *pose, double *rotation)
{
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) rotation[3 * i + j] = pose[4 * i + j];
}

static void position_of(const double *pose, double *position)
{
    for (int i = 0; i < 3; ++i) position[i] = pose[4 * i + 3];
}

static void to_pose(const double *rotation, const double *position, double *pose)
{
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) pose[4 * i + j] = rotation[3 * i + j];
        pose[4 * i + 3] = position[i];
        pose[12 + i] = 0.0;
    }
    pose[15] = 1.0;
}

/* [[diagonal, upper], [0, diagonal]], (6, 6). */
static void to_block_triangle(const double *diagonal, const double *upper, double *found)
{
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            found[6 * i + j] = found[6 * (i + 3) + j + 3] = diagonal[3 * i + j];
            found[6 * i + j + 3] = upper[3 * i + j];
            found[6 * (i + 3) + j] = 0.0;
        }
}

/* q (4): that of the nearest rotation, w >= 0. */
static void to_quaternion(const double *r, double *q)
{
    /* K = 4 q q'. */
    double k[4][4];
    k[0][0] = r[0] - r[4] - r[8] + 1.0;
    k[1][1] = -r[0] + r[4] - r[8] + 1.0;
    k[2][2] = -r[0] - r[4] + r[8] + 1.0;
    k[3][3] = r[0] + r[4] + r[8] + 1.0;
    for (int i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, l = (i + 2) % 3;
        k[j][l] = k[l][j] = r[3 * l + j] + r[3 * j + l];
        k[i][3] = k[3][i] = r[3 * l + j] - r[3 * j + l];
    }
    int largest = 0;
    for (int i = 1; i < 4; ++i)
        if (k[i][i] > k[largest][largest]) largest = i;
    double all = 0.0, square = 0.0;
    for (int i = 0; i < 9; ++i) all += 0.0 * r[i]; /* NaN of what is not finite */
    for (int i = 0; i < 4; ++i) {
        q[i] = all;
        for (int j = 0; j < 4; ++j) q[i] += k[i][j] * k[j][largest];
        square += q[i] * q[i];
    }
    const double length = copysign(sqrt(square), q[3]);
    for (int i = 0; i < 4; ++i) q[i] /= length;
}

static void to_rotation_vector(const double *rotation, double *phi)
{
    double q[4];
    to_quaternion(rotation, q);
    /* The least normal number is below any sine whose square is not zero. */
    const double sine = sqrt(dot(q, q)), bound = sine < DBL_MIN ? DBL_MIN : sine;
    const double factor = 2.0 * atan2(bound, q[3]) / bound;
    for (int i = 0; i < 3; ++i) phi[i] = factor * q[i];
}

/* rotations (n, 3, 3) of phi (n, 3). */
int so3_exp(const double *phi, double *rotations, int64_t count, const double *table,
            int64_t terms)
{
    for (int64_t i = 0; i < count; ++i, phi += 3, rotations += 9) {
        double f[EXPONENTIALS], w[9], w2[9];
        exponential_coefficients(dot(phi, phi), table, terms, f);
        hat(phi, w);
        product(w, w, w2);
        quadratic(f[A], w, f[B], w2, rotations);
    }
    return 0;
}

/* J_r(phi), (n, 3, 3), of phi (n, 3). */
int so3_right_jacobian(const double *phi, double *jacobians, int64_t count, const double *table,
                       int64_t terms)
{
    for (int64_t i = 0; i < count; ++i, phi += 3, jacobians += 9) {
        double f[EXPONENTIALS], w[9], w2[9];
        exponential_coefficients(dot(phi, phi), table, terms, f);
        hat(phi, w);
        product(w, w, w2);
        quadratic(-f[B], w, f[C], w2, jacobians);
    }
    return 0;
}

/* q (n, 4) of rotations (n, 3, 3). */
int so3_quaternion(const double *rotations, double *quaternions, int64_t count)
{
    for (int64_t i = 0; i < count; ++i) to_quaternion(rotations + 9 * i, quaternions + 4 * i);
    return 0;
}

/* phi (n, 3) of rotations (n, 3, 3). */
int so3_log(const double *rotations, double *phi, int64_t count)
{
    for (int64_t i = 0; i < count; ++i) to_rotation_vector(rotations + 9 * i, phi + 3 * i);
    return 0;
}

/* poses (n, 4, 4) of xi (n, 6). */
int se3_exp(const double *xi, double *poses, int64_t count, const double *table, int64_t terms)
{
    for (int64_t i = 0; i < count; ++i, xi += 6, poses += 16) {
        double f[EXPONENTIALS], w[9], w2[9], rotation[9], jacobian[9], position[3];
        exponential_coefficients(dot(xi + 3, xi + 3), table, terms, f);
        hat(xi + 3, w);
        product(w, w, w2);
        quadratic(f[A], w, f[B], w2, rotation);
        quadratic(f[B], w, f[C], w2, jacobian);
        for (int j = 0; j < 3; ++j) position[j] = dot(jacobian + 3 * j, xi);
        to_pose(rotation, position, poses);
    }
    return 0;
}

/* xi (n, 6) of poses (n, 4, 4). */
int se3_log(const double *poses, double *xi, int64_t count, const double *table, int64_t terms)
{
    for (int64_t i = 0; i < count; ++i, poses += 16, xi += 6) {
        double f[LOGARITHMS], w[9], w2[9], rotation[9], jacobian[9], position[3];
        rotation_of(poses, rotation);
        position_of(poses, position);
        to_rotation_vector(rotation, xi + 3);
        logarithm_coefficients(dot(xi + 3, xi + 3), table, terms, f);
        hat(xi + 3, w);
        product(w, w, w2);
        quadratic(-0.5, w, f[D], w2, jacobian);
        for (int j = 0; j < 3; ++j) xi[j] = dot(jacobian + 3 * j, position);
    }
    return 0;
}

/* The inverses of poses (n, 4, 4). */
int se3_inverse(const double *poses, double *inverses, int64_t count)
{
    for (int64_t i = 0; i < count; ++i, poses += 16, inverses += 16) {
        double rotation[9], transpose[9], position[3], turned[3];
        rotation_of(poses, rotation);
        position_of(poses, position);
        for (int j = 0; j < 9; ++j) transpose[j] = rotation[3 * (j % 3) + j / 3];
        for (int j = 0; j < 3; ++j) turned[j] = -dot(transpose + 3 * j, position);
        to_pose(transpose, turned, inverses);
    }
    return 0;
}

/* c = a b, of poses (4, 4). */
void se3_compose(const double *a, const double *b, double *c)
{
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++) {
            c[4 * i + j] = 0.0;
            for (int k = 0; k < 4; k++) c[4 * i + j] += a[4 * i + k] * b[4 * k + j];
        }
}

/* Ad_T, (n, 6, 6), of poses (n, 4, 4). */
int se3_adjoint(const double *poses, double *adjoints, int64_t count)
{
    for (int64_t i = 0; i < count; ++i, poses += 16, adjoints += 36) {
        double rotation[9], position[3], w[9], upper[9];
        rotation_of(poses, rotation);
        position_of(poses, position);
        hat(position, w);
        product(w, rotation, upper);
        to_block_triangle(rotation, upper, adjoints);
    }
    return 0;
}

/* I + p W + q W^2 of ad_xi with p' = dp and q' = dq, (6, 6). */
static void quadratic_in_ad(const double *xi, double p, double q, double dp, double dq,
                            double *found)
{
    double w[9], v[9], w2[9], wv[9], diagonal[9], upper[9];
    hat(xi + 3, w);
    hat(xi, v);
    product(w, w, w2);
    product(w, v, wv);
    const double both = dot(xi, xi + 3);
    for (int i = 0; i < 9; ++i) {
        const double twice = wv[i] + wv[3 * (i % 3) + i / 3];
        upper[i] = p * v[i] + q * twice + both * (dp * w[i] + dq * w2[i]);
    }
    quadratic(p, w, q, w2, diagonal);
    to_block_triangle(diagonal, upper, found);
}

/* J_l(xi), (n, 6, 6), of xi (n, 6). */
int se3_left_jacobian(const double *xi, double *jacobians, int64_t count, const double *table,
                      int64_t terms)
{
    for (int64_t i = 0; i < count; ++i, xi += 6, jacobians += 36) {
        double f[EXPONENTIALS];
        exponential_coefficients(dot(xi + 3, xi + 3), table, terms, f);
        quadratic_in_ad(xi, f[B], f[C], f[DB], f[DC], jacobians);
    }
    return 0;
}

/* J_l(xi)^-1, (n, 6, 6), of xi (n, 6). */
int se3_left_jacobian_inverse(const double *xi, double *jacobians, int64_t count,
                              const double *table, int64_t terms)
{
    for (int64_t i = 0; i < count; ++i, xi += 6, jacobians += 36) {
        double f[LOGARITHMS];
        logarithm_coefficients(dot(xi + 3, xi + 3), table, terms, f);
        quadratic_in_ad(xi, -0.5, f[D], 0.0, f[DD], jacobians);
    }
    return 0;
}

/* poses (n, 4, 4) of positions (n, 3) and quaternions (n, 4) of any length; one where there is
 * none. */
int se3_from_position_quaternion(const double *positions, const double *quaternions,
                                 double *poses, int64_t count)
{
    for (int64_t i = 0; i < count; ++i, positions += 3, quaternions += 4, poses += 16) {
        double q[4], w[9], w2[9], rotation[9], largest = 0.0, square = 0.0;
        for (int j = 0; j < 3; ++j)
            if (!isfinite(positions[j])) return 1;
        for (int j = 0; j < 4; ++j) {
            if (!isfinite(quaternions[j])) return 1;
            largest = fmax(largest, fabs(quaternions[j]));
        }
        if (!(largest > 0.0)) return 1;
        /* Twice, so that neither squaring a tiny nor a huge number takes the norm away. */
        for (int j = 0; j < 4; ++j) {
            q[j] = quaternions[j] / largest;
            square += q[j] * q[j];
        }
        for (int j = 0; j < 4; ++j) q[j] /= sqrt(square);
        hat(q, w);
        product(w, w, w2);
        quadratic(2.0 * q[3], w, 2.0, w2, rotation);
        to_pose(rotation, positions, poses);
    }
    return 0;
}
