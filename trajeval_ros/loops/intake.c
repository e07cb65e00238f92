/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Whether poses are let in as they are (`online/intake.py`), as they mostly are.
 */
#include "loops.h"

/* Of stamps (n,), ns, positions (n, 3), m, and quaternions (n, 4): whether there is nothing to say
 * of any. Each stamp is later than the one before, at first `last`, by no more than `leap`; and no
 * number is anywhere near where another rule would judge. */
int intake_plain(const int64_t *stamps, const double *positions, const double *quaternions,
                 int64_t n, int64_t last, int64_t leap, double largest, double tolerance) {
    for (int64_t i = 0; i < n; i++) {
        const double *p = positions + 3 * i, *q = quaternions + 4 * i;
        if (stamps[i] <= last || stamps[i] < 0 || stamps[i] - last > leap) {
            return 0;
        }
        last = stamps[i];
        const double norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
        /* What is not a number is not less than anything. */
        if (!(fabs(p[0]) < largest && fabs(p[1]) < largest && fabs(p[2]) < largest &&
              fabs(norm - 1.0) < tolerance)) {
            return 0;
        }
    }
    return 1;
}
