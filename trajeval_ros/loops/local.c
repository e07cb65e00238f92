/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The local coordinates of a segment's poses, (R_ref' (p - p_ref), Log(R_ref' R)), as
 * `ground_truth/segment.py` has them.
 */
#include "loops.h"
#include "se3.h"

static const double PI = 3.14159265358979323846;

static double dot3(const double *a, const double *b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
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
        double *x = coordinates + 6 * (known + i), rotation[9];
        for (int64_t j = 0; j < 3; j++) {
            x[j] = 0.0;
            for (int64_t l = 0; l < 3; l++) {
                x[j] += reference[4 * l + j] * (poses[4 * l + 3] - reference[4 * l + 3]);
            }
            for (int64_t m = 0; m < 3; m++) {
                rotation[3 * j + m] = 0.0;
                for (int64_t l = 0; l < 3; l++) {
                    rotation[3 * j + m] += reference[4 * l + j] * poses[4 * l + m];
                }
            }
        }
        so3_log(rotation, x + 3, 1);
        if (known + i > 0) {
            go_on(x - 3, x + 3);
        }
    }
    return 0;
}
