/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * A climb (error_model/maximum.py): steps of the parameters by Newton's method between bounds, and
 * of the factors λ of the disturbances' variances by what each asks for. Of a chain, all of it.
 */
#include "chain.h"
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
    *gain = 0.0;
    /* The larger root is below twice its half; mostly that is below 1. */
    if (now == 1.0 && square - (3.0 + 4.0 * kappa) * rest < rare * own)
        return 1.0;
    const double scale = 1.0 / fmax(own, 1e-300);
    square *= scale;
    rest *= scale;
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

/* A chain at a place; what is filtered and smoothed is of the place that was looked at last. */
typedef struct {
    int64_t kind, count;
    int size;
    const double *intervals, *errors, *variance;
    Filtered *filtered;
    Smoothed *smoothed;
    double *found;                      /* (5,), as `chain_filter` leaves it */
    double *poses, *steps;              /* disturbances, as `chain_smooth` leaves them */
    double *own_steps, *factors, *work; /* (N,), (2 N,), (8 N,) */
} Chain;

double climb_penalty(int64_t n, const double *factors, double kappa)
{
    double sum = 0.0;
    for (int64_t i = 0; i < n; i++)
        if (factors[i] != 1.0)
            sum += log(factors[i]);
    return kappa * sum;
}

/* Φ at parameters (p,) and factors (2 N - 1,), of poses and of steps; -inf where there is none. */
static double value_at(const Chain *chain, const double *parameters, const double *factors,
                       double kappa)
{
    const int64_t n = chain->count;
    if (chain_filter(chain->kind, n, parameters, chain->intervals, chain->errors, chain->variance,
                     factors, factors + n, chain->filtered, chain->found))
        return -INFINITY;
    return chain->found[0] - climb_penalty(2 * n - 1, factors, kappa);
}

/* That a share of a step (p,) on, at `there`. */
static double value_on(const Chain *chain, const double *here, double share, const double *step,
                       const double *factors, double kappa, double *there)
{
    for (int j = 0; j < chain->size; j++)
        there[j] = here[j] + share * step[j];
    return value_at(chain, there, factors, kappa);
}

/* What the disturbances ask for, at a place that is smoothed; what it promises. */
static double reweighed(const Chain *chain, const Rules *rules, double apart,
                        const double *parameters, const double *factors)
{
    const int64_t n = chain->count, all = 2 * n - 1;
    const int64_t reach = 2.0 * apart < (double)all ? (int64_t)(2.0 * apart) : all;
    double promised;
    reweigh(n, reach, chain->poses, chain->poses + n, exp(2.0 * parameters[0]), factors,
            chain->steps, chain->steps + n - 1, chain->own_steps, factors + n, rules->kappa,
            rules->rare, rules->little_change, chain->factors, chain->work, &promised);
    return promised;
}

/* The curvature (p, p) corrected by how much a step (p,) has lowered the slope (BFGS). */
static void update_curvature(int p, const double *step, const double *fallen, const Rules *rules,
                             double *curvature)
{
    double along[PARAMETERS], seen = 0.0, told = 0.0;
    for (int j = 0; j < p; j++) {
        along[j] = 0.0;
        for (int l = 0; l < p; l++)
            along[j] += curvature[j * p + l] * step[l];
        seen += step[j] * fallen[j];
        told += step[j] * along[j];
    }
    if (!(seen > fmax(rules->trusted * told, rules->telling)))
        return;
    for (int j = 0; j < p; j++)
        for (int l = 0; l < p; l++)
            curvature[j * p + l] +=
                fallen[j] * fallen[l] / seen - along[j] * along[l] / told;
}

/* Where a climb is. */
typedef struct {
    double *parameters, *factors; /* (p,), (2 N - 1,) */
    double value;
    int is_filtered, is_smoothed, is_told; /* what is known is of here */
    double slope[PARAMETERS], information[PARAMETERS * PARAMETERS];
} Place;

static void smooth_at(const Chain *chain, Place *here)
{
    const int64_t n = chain->count;
    for (int64_t i = 0; i + 1 < n; i++)
        chain->own_steps[i] = chain->filtered[i].q[0] / here->factors[n + i];
    chain_smooth(chain->kind, n, here->parameters, chain->intervals, chain->errors,
                 here->factors + n, chain->filtered, chain->found, chain->smoothed, chain->poses,
                 chain->steps, here->slope);
    here->is_smoothed = 1;
}

static void tell_at(const Chain *chain, const Rules *rules, Place *here)
{
    if (!here->is_filtered)
        value_at(chain, here->parameters, here->factors, rules->kappa);
    here->is_filtered = here->is_told = 1;
    chain_information(chain->kind, chain->count, here->parameters, chain->intervals,
                      here->factors + chain->count, chain->filtered, chain->found,
                      chain->smoothed, here->information);
}

/* From now on here is where the filter is. */
static void go(const Chain *chain, const double *there, const double *factors, double value,
               Place *here)
{
    memcpy(here->parameters, there, chain->size * sizeof *there);
    if (factors != here->factors)
        memcpy(here->factors, factors, (2 * chain->count - 1) * sizeof *factors);
    here->value = value;
    here->is_filtered = 1;
    here->is_smoothed = here->is_told = 0;
}

/* Φ at the first point on a shrinking step that is better than here, with the factors that there
 * are; of no better one, -inf. */
static double value_along(const Chain *chain, const Rules *rules, const Place *here, int whole,
                          const double *step, double *there)
{
    static const double shares[] = {1.0, 0.5, 0.2, 0.05};
    for (int i = whole ? 0 : 1; i < 4; i++) {
        const double value = value_on(chain, here->parameters, shares[i], step, here->factors,
                                      rules->kappa, there);
        if (value > here->value)
            return value;
    }
    return -INFINITY;
}

/* The climb of a chain, as `climb` in maximum.py: of parameters (p,) between low and high, and of
 * factors (2 N - 1,), both where it begins and where it ends; filtered and found are of there, and
 * where 1 is returned, as `chain_smooth` leaves them, smoothed, poses, moves and gradient.
 * work: (11 N,). Returns -1 where there is no likelihood or no curvature. */
int chain_climb(int64_t kind, int64_t count, int64_t size, const double *intervals,
                const double *errors, const double *variance, const double *low,
                const double *high, const Rules *rules, double gain, int64_t steps, int64_t near,
                int64_t weighted, double *parameters, double *factors, Filtered *filtered,
                double *found, Smoothed *smoothed, double *poses, double *moves,
                double *gradient, double *work)
{
    const Chain chain = {kind, count, (int)size, intervals, errors, variance, filtered, smoothed,
                         found, poses, moves, work, work + count, work + 3 * count};
    const double nowhere[PARAMETERS] = {0.0};
    Place here = {.parameters = parameters, .factors = factors, .is_filtered = 1};
    double curvature[PARAMETERS * PARAMETERS], before[PARAMETERS], slope_before[PARAMETERS];
    double apart = rules->neighbours;
    int alone = 0, far = 1, has_before = 0;
    here.value = value_at(&chain, parameters, factors, rules->kappa);
    if (!(here.value > -INFINITY))
        return -1;
    for (; steps > 0; steps--) {
        double there[PARAMETERS], step[PARAMETERS], fallen[PARAMETERS], promised = 0.0, expected;
        const double *asked = factors;
        if (!here.is_smoothed)
            smooth_at(&chain, &here);
        if (weighted) {
            promised = reweighed(&chain, rules, apart, parameters, factors);
            asked = chain.factors;
        }
        if (promised > rules->much && alone < rules->alone) {
            alone++;
            const double value = value_on(&chain, parameters, 0.0, nowhere, asked, rules->kappa,
                                          there);
            if (value > here.value) {
                go(&chain, there, asked, value, &here);
                has_before = 0;
                continue;
            }
            here.is_filtered = 0;
            apart *= rules->farther;
        }
        alone = 0;
        const int fresh = far;
        if (fresh) {
            if (!here.is_told)
                tell_at(&chain, rules, &here);
            memcpy(curvature, here.information, size * size * sizeof *curvature);
        }
        if (has_before) {
            for (int j = 0; j < size; j++)
                fallen[j] = slope_before[j] - here.slope[j];
            update_curvature(chain.size, before, fallen, rules, curvature);
        }
        if (newton_step(size, parameters, here.slope, curvature, low, high, rules->little,
                        rules->longest, step, &expected))
            return -1;
        if (expected + promised < gain)
            break;
        int stuck = 0;
        double value = value_on(&chain, parameters, 1.0, step, asked, rules->kappa, there);
        here.is_filtered = 0;
        if (!(value >= here.value)) {
            apart *= rules->farther;
            value = value_along(&chain, rules, &here, weighted != 0, step, there);
            if (value > here.value) {
                asked = factors;
            } else {
                /* The curvature is that of another place, or the step can only be noise. */
                if (fresh && promised < gain)
                    break;
                stuck = 1;
                value = value_on(&chain, parameters, 0.0, step, asked, rules->kappa, there);
                if (!(value >= here.value)) {
                    if (apart > (double)count)
                        break;
                    continue;
                }
            }
        }
        const int settled = promised < fmax(fmax(gain, expected), rules->settled);
        double longest = 0.0;
        for (int j = 0; j < size; j++) {
            before[j] = there[j] - parameters[j];
            slope_before[j] = here.slope[j];
            longest = fmax(longest, fabs(before[j]));
        }
        has_before = settled;
        far = stuck || (!near && (!settled || longest > rules->far));
        go(&chain, there, asked, value, &here);
        if (near && expected < rules->sure)
            break;
    }
    if (!here.is_filtered)
        value_at(&chain, parameters, factors, rules->kappa);
    memcpy(gradient, here.slope, size * sizeof *gradient);
    return here.is_smoothed;
}
