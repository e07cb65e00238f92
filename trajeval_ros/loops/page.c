/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Page's test for a change of a variance by each of some ratios r, of `ground_truth/adaptation.py`:
 * S_k = max(0, S_(k-1) + (e_k^2 (1 - 1/r) - offset) / 2).
 */
#include "loops.h"

/* Look at the squares e^2 (G, n) of the rows before `end`, of each group at those from its row
 * looked (G,) on; those that are not `telling` (G, n) leave the sum of the `cautious` test as it is.
 *
 * Of each test its steepness 1 - 1/r and offset, (t,), its limit, its sum, and the row since which
 * that is not zero, (G, t): what these two are after the rows is written to new_sums and new_since.
 * Where a group's sum exceeds its limit, raised (G, 2) is the first row at which one does, and
 * since which it is not zero. */
int page_look(const double *squares, const uint8_t *telling, int64_t end, int64_t n,
              const int64_t *looked, int64_t groups, const double *steepness,
              const double *offsets, const double *limits, int64_t tests, int64_t cautious,
              const double *sums, const int64_t *since, double *new_sums, int64_t *new_since,
              int64_t *raised) {
    for (int64_t g = 0; g < groups; g++, squares += n, telling += n, raised += 2) {
        int64_t last = n;
        for (int64_t t = 0; t < tests; t++, sums++, since++, limits++) {
            double sum = *sums;
            int64_t begin = *since;
            for (int64_t k = n - (end - looked[g]); k < last; k++) {
                if (t != cautious || telling[k]) {
                    sum += 0.5 * (squares[k] * steepness[t] - offsets[t]);
                }
                if (sum <= 0.0) {
                    sum = 0.0;
                    begin = end - n + k + 1;
                } else if (sum > *limits) {
                    raised[0] = end - n + k;
                    raised[1] = begin;
                    last = k;
                }
            }
            *new_sums++ = sum;
            *new_since++ = begin;
        }
    }
    return 0;
}
