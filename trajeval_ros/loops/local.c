/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The local coordinates of a segment's poses, (R_ref' (p - p_ref), Log(R_ref' R)), as
 * `ground_truth/segment.py` has them.
 */
#include "loops.h"

static const double PI = 3.14159265358979323846, TINY = 2.2250738585072014e-308;

static double dot3(const double *a, const double *b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* q (x, y, z, w), w >= 0, of the nearest rotation: K = 4 q q' is linear in it, and its largest
 * column, times K once more, along q; see `se3.py`. */
static void quaternion(double r[3][3], double *q) {
    const double k[4][4] = {
        {1.0 + r[0][0] - r[1][1] - r[2][2], r[0][1] + r[1][0], r[0][2] + r[2][0],
         r[2][1] - r[1][2]},
        {r[0][1] + r[1][0], 1.0 - r[0][0] + r[1][1] - r[2][2], r[1][2] + r[2][1],
         r[0][2] - r[2][0]},
        {r[0][2] + r[2][0], r[1][2] + r[2][1], 1.0 - r[0][0] - r[1][1] + r[2][2],
         r[1][0] - r[0][1]},
        {r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1],
         1.0 + r[0][0] + r[1][1] + r[2][2]},
    };
    int64_t largest = 0;
    for (int64_t i = 1; i < 4; i++) {
        if (k[i][i] > k[largest][largest]) {
            largest = i;
        }
    }
    double square = 0.0;
    for (int64_t i = 0; i < 4; i++) {
        q[i] = 0.0;
        for (int64_t j = 0; j < 4; j++) {
            q[i] += k[i][j] * k[j][largest];
        }
        square += q[i] * q[i];
    }
    const double norm = copysign(sqrt(square), q[3]);
    for (int64_t i = 0; i < 4; i++) {
        q[i] /= norm;
    }
}

/* The rotation vector phi (3,), of length at most pi. */
static void logarithm(double r[3][3], double *phi) {
    double q[4];
    quaternion(r, q);
    const double sine = fmax(sqrt(dot3(q, q)), TINY), factor = 2.0 * atan2(sine, q[3]) / sine;
    for (int64_t i = 0; i < 3; i++) {
        phi[i] = factor * q[i];
    }
}

/* Put phi on the branch that is nearest to the one before. */
static void go_on(const double *before, double *phi) {
    const double apart[3] = {phi[0] - before[0], phi[1] - before[1], phi[2] - before[2]};
    const double angle = sqrt(dot3(phi, phi));
    if (sqrt(dot3(apart, apart)) > PI && angle > 0.0) {
        const double turns = rint((dot3(before, phi) / angle - angle) / (2.0 * PI));
        for (int64_t i = 0; i < 3; i++) {
            phi[i] *= 1.0 + 2.0 * PI * turns / angle;
        }
    }
}

/* Of poses (n, 4, 4) about a reference (4, 4), coordinates (known + n, 6), of which the first, if
 * one is known, is given: those that follow it. */
int local_coordinates(const double *reference, const double *poses, int64_t n, int64_t known,
                      double *coordinates) {
    for (int64_t i = 0; i < n; i++, poses += 16) {
        double *x = coordinates + 6 * (known + i), rotation[3][3];
        for (int64_t j = 0; j < 3; j++) {
            x[j] = 0.0;
            for (int64_t l = 0; l < 3; l++) {
                x[j] += reference[4 * l + j] * (poses[4 * l + 3] - reference[4 * l + 3]);
            }
            for (int64_t m = 0; m < 3; m++) {
                rotation[j][m] = 0.0;
                for (int64_t l = 0; l < 3; l++) {
                    rotation[j][m] += reference[4 * l + j] * poses[4 * l + m];
                }
            }
        }
        logarithm(rotation, x + 3);
        if (known + i > 0) {
            go_on(x - 3, x + 3);
        }
    }
    return 0;
}
