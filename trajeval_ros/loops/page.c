/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Page's test for a change of a variance by each of some ratios r, of `ground_truth/adaptation.py`:
 * S_k = max(0, S_(k-1) + (e_k^2 (1 - 1/r) - offset) / 2).
 */
#include "loops.h"

enum { GROUPS = 2, MOST_TESTS = 8 };

/* e^2 of a row, of all lanes of a group together, and whether it tells: where log d^2 is above the
 * least of it in all. */
static double square(const double *news, int64_t parallel, int64_t apart, double least, int *telling)
{
    double sum = 0.0;
    *telling = 1;
    for (int64_t p = 0; p < parallel; p++, news += apart) {
        sum += news[0];
        *telling = *telling && news[1] > least;
    }
    return sum;
}

/* Look at the rows from `first` on, n of them, of both groups at those from its row looked (2,) on:
 * e^2 and log d^2 lie, of a lane, from `news` on, where `parallel` lanes a group are lane_apart
 * numbers apart and their rows row_apart. Those that do not tell, with least (2,), leave the sum of
 * the `cautious` test as it is.
 *
 * Of each test its steepness 1 - 1/r and offset, (t,), its limit, its sum, and the row since which
 * that is not zero, (2, t): these two go on, and with them looked, where no sum of the group exceeds
 * its limit. Where one does, raised (2, 2) is the first row at which, and since which it is not zero;
 * else -1. 1 where there are too many tests. */
int page_look(int64_t news, int64_t lane_apart, int64_t row_apart, int64_t parallel, int64_t first,
              int64_t n, const double *least, const double *steepness, const double *offsets,
              int64_t tests, int64_t cautious, const double *limits, double *sums, int64_t *since,
              int64_t *looked, int64_t *raised)
{
    if (tests > MOST_TESTS)
        return 1;
    for (int64_t g = 0; g < GROUPS; g++, limits += tests, sums += tests, since += tests) {
        const double *own = (const double *)(intptr_t)news + g * parallel * lane_apart;
        double after[MOST_TESTS];
        int64_t begins[MOST_TESTS], end = first + n;
        raised[2 * g] = raised[2 * g + 1] = -1;
        for (int64_t t = 0; t < tests; t++) {
            after[t] = sums[t];
            begins[t] = since[t];
            for (int64_t row = looked[g]; row < end; row++) {
                int telling;
                const double e2 = square(own + (row - first) * row_apart, parallel, lane_apart,
                                         least[g], &telling);
                if (t != cautious || telling)
                    after[t] += 0.5 * (e2 * steepness[t] - offsets[t]);
                if (after[t] <= 0.0) {
                    after[t] = 0.0;
                    begins[t] = row + 1;
                } else if (after[t] > limits[t]) {
                    raised[2 * g] = row;
                    raised[2 * g + 1] = begins[t];
                    end = row;
                }
            }
        }
        for (int64_t t = 0; t < tests && raised[2 * g] < 0; t++) {
            sums[t] = after[t];
            since[t] = begins[t];
        }
        if (raised[2 * g] < 0)
            looked[g] = end;
    }
    return 0;
}
