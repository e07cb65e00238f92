/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Page's test for a change of a variance by each of some ratios r, of `ground_truth/adaptation.py`:
 * S_k = max(0, S_(k-1) + (e_k^2 (1 - 1/r) - offset) / 2).
 */
#include "loops.h"

/* Look at the squares e^2 (n,) of the rows from `looked` on; those that are not `telling` (n,)
 * leave the sum of the `cautious` test as it is.
 *
 * Of each test its steepness 1 - 1/r, offset and limit (t,); its sum, and the row since which that
 * is not zero, (t,): what these are after the rows is written to new_sums and new_since. If a sum
 * exceeds its limit, 1 is returned, and raised (2,) is the first row at which one does, and since
 * which it is not zero. */
int page_look(const double *squares, const uint8_t *telling, int64_t n, int64_t looked,
              const double *steepness, const double *offsets, const double *limits, int64_t tests,
              int64_t cautious, const double *sums, const int64_t *since, double *new_sums,
              int64_t *new_since, int64_t *raised) {
    int64_t first = n;
    for (int64_t t = 0; t < tests; t++) {
        double sum = sums[t];
        int64_t begin = since[t];
        for (int64_t k = 0; k < first; k++) {
            if (t != cautious || telling[k]) {
                sum += 0.5 * (squares[k] * steepness[t] - offsets[t]);
            }
            if (sum <= 0.0) {
                sum = 0.0;
                begin = looked + k + 1;
            } else if (sum > limits[t]) {
                raised[0] = looked + k;
                raised[1] = begin;
                first = k;
            }
        }
        new_sums[t] = sum;
        new_since[t] = begin;
    }
    return first < n;
}
