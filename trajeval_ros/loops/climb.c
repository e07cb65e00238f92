/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * A step of a climb (error_model/maximum.py): of the parameters by Newton's method between bounds, of
 * the factors λ of the disturbances' variances by what each asks for.
 */
#include "loops.h"
#include "solve.h"

#include <string.h>

/* The free entries of a step (n,): curvature step = slope, where the others are as they are. */
static int set_free(int n, const double *curvature, const double *slope, const int *free,
                    double *step)
{
    double a[MOST][MOST], x[MOST];
    int rows = 0;
    for (int i = 0; i < n; i++) {
        if (!free[i])
            continue;
        x[rows] = slope[i];
        int columns = 0;
        for (int j = 0; j < n; j++) {
            if (free[j])
                a[rows][columns++] = curvature[i * n + j];
            else
                x[rows] -= curvature[i * n + j] * step[j];
        }
        rows++;
    }
    if (solve(rows, a, x))
        return 1;
    for (int i = 0, row = 0; i < n; i++)
        if (free[i])
            step[i] = x[row++];
    return 0;
}

/* A step (n,) between bounds (n,), no longer than so much in each entry, and what it promises:
 * parameters that it would take out of bounds end there, the first that is met at a time, and the
 * others step as fits that. curvature (n, n), to which little is added where the slope promises less
 * than that would. Not 0 where it is singular. */
int newton_step(int64_t count, const double *here, const double *slope, const double *curvature,
                const double *low, const double *high, double little, double longest,
                double *step, double *promised)
{
    if (count > MOST)
        return 1;
    const int n = (int)count;
    int free[MOST];
    double full[MOST * MOST], least[MOST], most[MOST];
    memcpy(full, curvature, n * n * sizeof *full);
    for (int i = 0; i < n; i++) {
        double *own = full + i * n + i;
        if (!(slope[i] * slope[i] > 2.0 * little * fmax(*own, 1e-300)))
            *own += little;
        step[i] = 0.0;
        free[i] = (here[i] > low[i] || slope[i] > 0.0) && (here[i] < high[i] || slope[i] < 0.0);
        least[i] = fmax(low[i], here[i] - longest);
        most[i] = fmin(high[i], here[i] + longest);
    }
    for (int round = 0; round < n; round++) {
        if (set_free(n, full, slope, free, step))
            return 1;
        int first = -1;
        double share = INFINITY, end = 0.0;
        for (int i = 0; i < n; i++) {
            const double there = here[i] + step[i];
            if (!free[i] || (there >= least[i] && there <= most[i]))
                continue;
            const double within = fmin(fmax(there, least[i]), most[i]) - here[i];
            if (within / step[i] < share) {
                share = within / step[i];
                first = i;
                end = within;
            }
        }
        if (first < 0)
            break;
        step[first] = end;
        free[first] = 0;
    }
    *promised = 0.0;
    for (int i = 0; i < n; i++) {
        *promised += slope[i] * step[i];
        for (int j = 0; j < n; j++)
            *promised -= 0.5 * step[i] * full[i * n + j] * step[j];
    }
    return 0;
}

/* log of a disturbance's density, λ^-κ besides, in units of its own variance. */
static inline double nats(double square, double rest, double factor, double kappa)
{
    const double variance = factor + rest;
    return -1.5 * log(variance) - 0.5 * square / variance - kappa * log(factor);
}

/* The likeliest λ ≥ 1 of a disturbance, others held, and what it gains over the one there is.
 * square, rest: of its estimate over three axes, and its variance beside its own. */
static inline double likeliest(double square, double rest, double own, double now, double kappa,
                               double rare, double *gain)
{
    const double scale = 1.0 / fmax(own, 1e-300);
    square *= scale;
    rest *= scale;
    *gain = 0.0;
    const double half = 0.5 * (square - (3.0 + 4.0 * kappa) * rest);
    const double below = half * half - 2.0 * kappa * rare * rest * rest;
    /* The larger root, if there is one beyond 1. */
    double factor = half > 0.0 && below > 0.0 ? (half + sqrt(below)) / rare : 1.0;
    if (!(factor > 1.0)) {
        factor = 1.0;
        if (now == 1.0)
            return 1.0;
    }
    const double least = nats(square, rest, 1.0, kappa), best = nats(square, rest, factor, kappa);
    if (!(best > least))
        factor = 1.0;
    *gain = fmax(fmax(best, least) - nats(square, rest, now, kappa), 0.0);
    return factor;
}

/* At each of values (n + 2 reach,) the largest of it and those that lie 2 reach beyond. */
LOOPS_PART void set_largest(int64_t n, int64_t reach, double *values)
{
    const int64_t width = 2 * reach + 1;
    int64_t length = n + 2 * reach;
    for (int64_t have = 1; have < width;) {
        const int64_t step = have < width - have ? have : width - have;
        length -= step;
        /* No fmax, of which no vector is made; gains are numbers. */
        for (int64_t i = 0; i < length; i++)
            values[i] = values[i] > values[i + step] ? values[i] : values[i + step];
        have += step;
    }
}

/* The factors that the disturbances of N poses and N - 1 steps ask for. poses: squares, with rests,
 * (N,), own variance and factors now; steps likewise, their own variances (N - 1,). Of those within
 * `reach` places in the order of time only the one that gains most changes, and those that hardly
 * change in the logarithm. new: those of poses and of steps, (2 N - 1,). work: (4 N - 2 + 2 reach,).
 * promised: what they gain. */
LOOPS_WIDE int reweigh(int64_t count, int64_t reach, const double *poses, const double *rests, double own,
                       const double *measured, const double *steps, const double *step_rests,
                       const double *own_steps, const double *moved, double kappa, double rare,
                       double little, double *new, double *work, double *promised)
{
    double *const largest = work, *const gains = work + 2 * count - 1 + 2 * reach;
    int some = 0;
    for (int64_t i = 0; i < count; i++) {
        new[i] = likeliest(poses[i], rests[i], own, measured[i], kappa, rare, gains + 2 * i);
        some |= gains[2 * i] > 0.0;
        if (i + 1 < count) {
            new[count + i] = likeliest(steps[i], step_rests[i], own_steps[i], moved[i], kappa,
                                       rare, gains + 2 * i + 1);
            some |= gains[2 * i + 1] > 0.0;
        }
    }
    *promised = 0.0;
    if (!some)
        return 0;
    memset(work, 0, (2 * count - 1 + 2 * reach) * sizeof *work);
    memcpy(largest + reach, gains, (2 * count - 1) * sizeof *gains);
    set_largest(2 * count - 1, reach, largest);
    for (int64_t i = 0; i < 2 * count - 1; i++) {
        const int64_t half = i / 2;
        double *const to = i % 2 ? new + count + half : new + half;
        const double now = i % 2 ? moved[half] : measured[half];
        if (*to == now || gains[i] >= largest[i] || fabs(log(*to / now)) < little)
            *promised += gains[i];
        else
            *to = now;
    }
    return 0;
}
