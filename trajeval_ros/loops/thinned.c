/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Which of some samples lie far enough from the one chosen before: in time (`ground_truth/jumps.py`),
 * and along the way (`online/coverage.py`).
 */
#include "loops.h"

/* Of stamps (n,), ns, increasing, the numbers of those at or after `next`, which then is `spacing`
 * after the newest one: chosen (n,), how many (1). */
int thinned_by_time(const int64_t *stamps, int64_t n, int64_t next, int64_t spacing,
                    int64_t *chosen, int64_t *count) {
    int64_t found = 0;
    for (int64_t i = 0; i < n; i++) {
        if (stamps[i] >= next) {
            chosen[found++] = i;
            next = stamps[i] + spacing;
        }
    }
    *count = found;
    return 0;
}

/* Of positions (n, 3), m, the numbers of those further than `step` from the one before, at first from
 * anchor (3,), which moves on: chosen (n,), how far each is (n,), and how many (1). */
int thinned_by_distance(const double *positions, int64_t n, double step, double *anchor,
                        int64_t *chosen, double *away, int64_t *count) {
    int64_t found = 0;
    for (int64_t i = 0; i < n; i++) {
        const double *p = positions + 3 * i;
        const double x = p[0] - anchor[0], y = p[1] - anchor[1], z = p[2] - anchor[2];
        const double distance = sqrt(x * x + y * y + z * z);
        if (distance > step) {
            chosen[found] = i;
            away[found++] = distance;
            for (int j = 0; j < 3; j++) {
                anchor[j] = p[j];
            }
        }
    }
    *count = found;
    return 0;
}
