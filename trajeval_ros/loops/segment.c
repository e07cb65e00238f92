/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * What lessons look at in a segment's coordinates: whether it moves (`ground_truth/lessons.py`), and
 * what neighbouring residuals say of its stamps (`ground_truth/stamps.py`, which has the formulas).
 */
#include "loops.h"

#include <stdlib.h>

static double norm(const double *v) { return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

/* Of coordinates x (n, 6), n >= 2, the largest standard deviation of translation and rotation,
 * spread (2), and of what neighbours differ by, over sqrt(2), noise (2). */
int segment_spread(const double *x, int64_t n, double *spread, double *noise)
{
    for (int64_t g = 0; g < 2; g++)
        spread[g] = noise[g] = 0.0;
    for (int64_t j = 0; j < 6; j++) {
        double mean = 0.0, square = 0.0, difference = 0.0;
        for (int64_t i = 0; i < n; i++)
            mean += x[6 * i + j];
        mean /= (double)n;
        for (int64_t i = 0; i < n; i++) {
            const double off = x[6 * i + j] - mean;
            square += off * off;
            const double step = i ? x[6 * i + j] - x[6 * i - 6 + j] : 0.0;
            difference += step * step;
        }
        spread[j / 3] = fmax(spread[j / 3], sqrt(square / (double)n));
        noise[j / 3] = fmax(noise[j / 3], sqrt(0.5 * difference / (double)(n - 1)));
    }
    return 0;
}

static int in_order(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* The median of values (n,), which are put in order. */
static double median(double *values, int64_t n)
{
    qsort(values, (size_t)n, sizeof *values, in_order);
    return 0.5 * (values[(n - 1) / 2] + values[n / 2]);
}

/* Of times (n,) and three coordinates x (n, 3), `wide` numbers from row to row, n >= 5, `Sums`: the
 * excess along the motion, the squared speeds beside it, their number, what is across; what is due at
 * even times, the square of its scatter, by so many together, and what it would be: found (7). Single
 * residuals count as no more than sqrt(clipped) times the median of their squares; velocities are
 * those between so many samples before and after at most; where an interval is no less than `even`
 * times the usual one, nothing is due. work (14 n). */
int stamp_sums(const double *times, const double *x, int64_t wide, int64_t n, int64_t reach,
               double clipped, double usual, double even, int64_t together, double *work,
               double *found)
{
    static const int64_t near[4] = {-2, -1, 1, 2};
    const int64_t m = n - 4;
    double *shares = work, *scales = shares + 4 * m, *speeds = scales + m, *along = speeds + m;
    double *across = along + m, *residuals = across + 3 * m, *squares = residuals + 3 * m;
    for (int64_t k = 0; k < m; k++) {
        const double *here = x + (k + 2) * wide, *time = times + k + 2;
        double *share = shares + 4 * k, *r = residuals + 3 * k, size = 1.0;
        for (int64_t j = 0; j < 4; j++) {
            share[j] = 1.0;
            for (int64_t i = 0; i < 4; i++)
                if (i != j)
                    share[j] *= (time[near[i]] - time[0]) / (time[near[i]] - time[near[j]]);
            size += share[j] * share[j];
        }
        scales[k] = 1.0 / sqrt(size);
        for (int64_t c = 0; c < 3; c++) {
            double value = 0.0;
            for (int64_t j = 0; j < 4; j++)
                value += share[j] * here[near[j] * wide + c];
            r[c] = (here[c] - value) * scales[k];
        }
        squares[k] = r[0] * r[0] + r[1] * r[1] + r[2] * r[2];
    }
    const double limit = sqrt(clipped * median(squares, m));
    for (int64_t k = 0; k < m; k++) {
        const int64_t low = k + 2 > reach ? k + 2 - reach : 0;
        const int64_t high = k + 2 + reach < n ? k + 2 + reach : n - 1;
        double velocity[3], *r = residuals + 3 * k;
        for (int64_t j = 0; j < 3; j++)
            velocity[j] = (x[high * wide + j] - x[low * wide + j]) / (times[high] - times[low]);
        const double size = norm(r), factor = size > limit ? limit / size : 1.0;
        speeds[k] = norm(velocity);
        const double unit = speeds[k] > 0.0 ? speeds[k] : 1.0;
        along[k] = 0.0;
        for (int64_t j = 0; j < 3; j++) {
            r[j] *= factor;
            velocity[j] /= unit;
            along[k] += r[j] * velocity[j];
        }
        for (int64_t j = 0; j < 3; j++)
            across[3 * k + j] = r[j] - along[k] * velocity[j];
    }
    for (int64_t i = 0; i < 7; i++)
        found[i] = 0.0;
    for (int64_t begin = 0; begin < m; begin += together) {
        double sum = 0.0;
        for (int64_t k = begin; k < m && k < begin + together; k++) {
            double wanted = 0.0, longest = 0.0;
            for (int64_t j = 0; j < 4; j++) {
                wanted -= shares[4 * k + j] * (double)near[j];
                longest = fmax(longest, times[k + j + 1] - times[k + j]);
            }
            if (!(longest < even * usual))
                continue;
            wanted *= usual * speeds[k] * scales[k];
            sum += along[k] * wanted;
            found[6] += wanted * wanted;
        }
        found[4] += sum;
        found[5] += sum * sum;
    }
    for (int64_t k = 0; k + 1 < m; k++) {
        const double *a = across + 3 * k, *one = shares + 4 * k, *next = one + 4;
        const double lateral = 0.5 * (a[0] * a[3] + a[1] * a[4] + a[2] * a[5]);
        double weight = one[2] + next[1] - one[1] * next[0] - one[3] * next[2];
        weight *= scales[k] * scales[k + 1];
        if (!(speeds[k] > 0.0 && speeds[k + 1] > 0.0 && weight > 0.0))
            continue;
        found[0] -= along[k] * along[k + 1] - lateral;
        found[1] += weight * speeds[k] * speeds[k + 1];
        found[2] += 1.0;
        found[3] -= lateral;
    }
    return 0;
}
