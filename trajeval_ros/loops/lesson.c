/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * A climb to the hyperparameters that are most probable given records, each in a regime: `maximum` of
 * `ground_truth/learning.py`, of the models of `ground_truth/models.py`.
 *
 * theta (p,) is log sigma and log l of the motion's kernels and log n_0. In a regime sigma is 2^motion
 * and n_0 2^noise times as large; the noise's variance is n_0^2 + sum_k w_k sigma_k^2 l_k^-m_k. Where
 * a share of it is correlated, that is a further kernel's.
 */
#include "record.h"
#include "solve.h"

#include <string.h>

/* What the model says of its noise, `parts` kernels having one in it: order m and weight w (parts,
 * 2); the share that is correlated, and over which time, s. */
typedef struct {
    int64_t parts;
    const double *weights;
    double share, time;
} Noise;

/* The log-prior: normal in theta of one length's place (none below zero) with a centre and a standard
 * deviation; in log n_0 flat from lowest to highest, normal beside these with standard deviations
 * below and above, and from `tail` of these on a power. */
typedef struct {
    double place, centre, std, lowest, highest, below, above, tail;
} Prior;

/* The records, the regimes (many, 2) that they are in, and room for what there is of each. */
typedef struct {
    const int64_t *begins, *counts, *orders, *sets, *regimes;
    const double *times, *values, *variances, *own_rates, *constants;
    int64_t records, coordinates, kernels, many, parameters;
    double freedom;
    Noise noise;
    Prior prior;
    double *rates, *sigmas, *noises, *found, *gradients, *informations, *work;
} Lesson;

/* theta, with its log-posterior and, as soon as they are asked for, slope and curvature. */
typedef struct {
    double theta[MOST], value, gradient[MOST], curvature[MOST * MOST];
} Point;

/* The noise's variance in a regime, and what is in it of each kernel's sigma^2 and at last of n_0^2,
 * within (parts + 1). */
static double noise_variance(const Lesson *q, const double *theta, const int64_t *regime,
                             double *within)
{
    double variance = exp(2.0 * theta[q->parameters - 1]) * ldexp(1.0, (int)(2 * regime[1]));
    within[q->noise.parts] = variance;
    for (int64_t k = 0; k < q->noise.parts; k++) {
        const double *weight = q->noise.weights + 2 * k;
        within[k] = weight[1] * exp(2.0 * theta[2 * k] - weight[0] * theta[2 * k + 1]) *
                    ldexp(1.0, (int)(2 * regime[0]));
        variance += within[k];
    }
    return variance;
}

/* The log-prior, its slope and its negative second derivatives, (p,) both. */
static double prior_of(const Lesson *q, const double *theta, double *slope, double *curvature)
{
    const Prior *p = &q->prior;
    const int64_t last = q->parameters - 1;
    double value = 0.0;
    for (int64_t i = 0; i <= last; i++)
        slope[i] = curvature[i] = 0.0;
    if (p->place < 0.0)
        return value;
    const int64_t place = (int64_t)p->place;
    const double length = (theta[place] - p->centre) / p->std;
    slope[place] = -length / p->std;
    curvature[place] = 1.0 / (p->std * p->std);
    const double usual = fmin(fmax(theta[last], p->lowest), p->highest);
    const double std = theta[last] > usual ? p->above : p->below;
    const double noise = (theta[last] - usual) / std, tail = fmin(noise, p->tail);
    slope[last] = -tail / std;
    curvature[last] = tail == noise && noise != 0.0 ? 1.0 / (std * std) : 0.0;
    return value - 0.5 * length * length - (0.5 * tail * tail + tail * (noise - tail));
}

/* What a sum of kernels is in each regime, as record.c takes it. */
static void set_natural(const Lesson *q, const double *theta)
{
    const int64_t own = (q->parameters - 1) / 2;
    double within[MOST];
    for (int64_t s = 0; s < q->many; s++) {
        double *rates = q->rates + s * q->kernels, *sigmas = q->sigmas + s * q->kernels;
        const double variance = noise_variance(q, theta, q->regimes + 2 * s, within);
        const double motion = ldexp(1.0, (int)(2 * q->regimes[2 * s]));
        for (int64_t k = 0; k < own; k++) {
            rates[k] = q->own_rates[k] / exp(theta[2 * k + 1]);
            sigmas[k] = motion * exp(2.0 * theta[2 * k]);
        }
        for (int64_t k = own; k < q->kernels; k++) {
            rates[k] = q->own_rates[k] / q->noise.time;
            sigmas[k] = q->noise.share * variance;
        }
        q->noises[s] = (q->kernels > own ? 1.0 - q->noise.share : 1.0) * variance;
    }
}

/* Look at the value alone. */
static void evaluate(const Lesson *q, Point *point)
{
    double slope[MOST], curvature[MOST];
    const double nu = q->freedom;
    set_natural(q, point->theta);
    record_values(q->begins, q->counts, q->records, q->times, q->values, q->variances,
                  q->coordinates, q->orders, q->kernels, q->sets, q->rates, q->sigmas, q->noises,
                  q->work, q->found);
    point->value = prior_of(q, point->theta, slope, curvature);
    for (int64_t r = 0; r < q->records; r++) {
        const double freedom = (double)(q->coordinates * (q->counts[r] - 1));
        point->value += q->constants[r] - 0.5 * (double)q->coordinates * q->found[2 * r] -
                        0.5 * (nu + freedom) * log1p(q->found[2 * r + 1] / nu);
    }
}

/* Slope and curvature, of each regime's natural parameters turned into those of theta. */
static void differentiate(const Lesson *q, Point *point)
{
    const int64_t p = q->parameters, size = 2 * q->kernels + 1, last = p - 1;
    const int correlated = size > p;
    double prior[MOST], curvature[MOST], jacobian[MOST], within[MOST];
    set_natural(q, point->theta);
    record_slopes(q->begins, q->counts, q->records, q->times, q->values, q->variances,
                  q->coordinates, q->orders, q->kernels, q->sets, q->rates, q->sigmas, q->noises,
                  q->many, q->freedom, q->work, q->gradients, q->informations);
    prior_of(q, point->theta, prior, curvature);
    memcpy(point->gradient, prior, (size_t)p * sizeof *prior);
    memset(point->curvature, 0, sizeof point->curvature);
    for (int64_t s = 0; s < q->many; s++) {
        const double *g = q->gradients + s * size, *h = q->informations + s * size * size;
        const double variance = noise_variance(q, point->theta, q->regimes + 2 * s, within);
        /* Of the logarithm of either noise; all others are theta's own. */
        memset(jacobian, 0, sizeof jacobian);
        jacobian[last] = within[q->noise.parts] / variance;
        for (int64_t k = 0; k < q->noise.parts; k++) {
            jacobian[2 * k] = within[k] / variance;
            jacobian[2 * k + 1] = -0.5 * q->noise.weights[2 * k] * within[k] / variance;
        }
        /* The places of the noises' logarithms among the natural ones: the last, and two before. */
        const int64_t places[2] = {size - 1, size - 3};
        double noise = 0.0, noises = 0.0, crossed[MOST] = {0.0};
        for (int a = 0; a <= correlated; a++) {
            noise += g[places[a]];
            for (int b = 0; b <= correlated; b++)
                noises += h[places[a] * size + places[b]];
            for (int64_t i = 0; i < last; i++)
                crossed[i] += h[places[a] * size + i];
        }
        for (int64_t i = 0; i < p; i++) {
            point->gradient[i] += (i < last ? g[i] : 0.0) + jacobian[i] * noise;
            for (int64_t j = 0; j < p; j++)
                point->curvature[i * p + j] +=
                    (i < last && j < last ? h[i * size + j] : 0.0) + crossed[i] * jacobian[j] +
                    jacobian[i] * crossed[j] + jacobian[i] * jacobian[j] * noises;
        }
    }
    for (int64_t i = 0; i < p; i++) {
        /* In sigma and n only the squares count: a slope g is a second derivative of 2 g. */
        const double square = i % 2 ? 0.0 : fmax(2.0 * (prior[i] - point->gradient[i]), 0.0);
        point->curvature[i * p + i] += curvature[i] + square;
    }
}

/* The next theta, and what is expected of it, nats; NAN where there is none. */
static double next(const Lesson *q, const Point *point, double damping, double hold,
                   double longest, const double *bounds, double *theta)
{
    const int64_t p = q->parameters;
    double a[MOST][MOST], x[MOST], step[MOST] = {0.0}, expected = 0.0, most = longest;
    int64_t free[MOST];
    int rows = 0;
    for (int64_t i = 0; i < p; i++) {
        const double here = point->theta[i], slope = point->gradient[i];
        if (!((here <= bounds[2 * i] && slope < 0.0) || (here >= bounds[2 * i + 1] && slope > 0.0)))
            free[rows++] = i;
    }
    for (int r = 0; r < rows; r++) {
        x[r] = point->gradient[free[r]];
        for (int c = 0; c < rows; c++)
            a[r][c] = point->curvature[free[r] * p + free[c]];
        a[r][r] += damping * a[r][r] + hold;
    }
    if (solve(rows, a, x))
        return NAN;
    for (int r = 0; r < rows; r++) {
        step[free[r]] = x[r];
        most = fmax(most, fabs(x[r]));
    }
    for (int64_t i = 0; i < p; i++) {
        theta[i] = point->theta[i] + step[i] * (longest / most);
        theta[i] = fmin(fmax(theta[i], bounds[2 * i]), bounds[2 * i + 1]);
        step[i] = theta[i] - point->theta[i];
    }
    for (int64_t i = 0; i < p; i++) {
        double bent = 0.0;
        for (int64_t j = 0; j < p; j++)
            bent += point->curvature[i * p + j] * step[j];
        expected += step[i] * (point->gradient[i] - 0.5 * bent);
    }
    return expected;
}

/* Climb from theta (p,), which becomes where the climb ends, with its value (1).
 *
 * Records as in record.c; their kernels' own rates (kernels), r / l at l = 1; constants (records) that
 * their likelihoods have besides; `many` regimes (many, 2); the model's noise and prior, as in Noise
 * and Prior; bounds (p, 2). The numbers of the climb, its damping at first, at least, at most, and the
 * factor that it changes by; what a parameter is held by; its longest step; the least gain: climb (7).
 * work: of record_slopes for the longest record, and 2 records + many (size^2 + size + size) beside,
 * size = 2 kernels + 1. 1 where there are too many parameters. */
int lesson_climb(const int64_t *begins, const int64_t *counts, int64_t records,
                 const double *times, const double *values, const double *variances,
                 int64_t coordinates, const int64_t *orders, int64_t kernels, const int64_t *sets,
                 const double *own_rates, const double *constants, double freedom,
                 const int64_t *regimes, int64_t many, const double *weights, int64_t parts,
                 double share, double time, const double *prior, const double *bounds,
                 int64_t parameters, const double *climb, int64_t steps, double *theta,
                 double *value, double *work)
{
    const int64_t size = 2 * kernels + 1;
    if (parameters > MOST)
        return 1;
    Lesson q = {.begins = begins, .counts = counts, .orders = orders, .sets = sets,
                .regimes = regimes, .times = times, .values = values, .variances = variances,
                .own_rates = own_rates, .constants = constants, .records = records,
                .coordinates = coordinates, .kernels = kernels, .many = many,
                .parameters = parameters, .freedom = freedom,
                .noise = {parts, weights, share, time}};
    memcpy(&q.prior, prior, sizeof q.prior);
    q.found = work;
    q.gradients = q.found + 2 * records;
    q.informations = q.gradients + many * size;
    q.rates = q.informations + many * size * size;
    q.sigmas = q.rates + many * kernels;
    q.noises = q.sigmas + many * kernels;
    q.work = q.noises + many;
    double damping = climb[0];
    const double least = climb[1], most = climb[2], factor = climb[3];
    Point point, further;
    memcpy(point.theta, theta, (size_t)parameters * sizeof *theta);
    evaluate(&q, &point);
    for (int64_t n = 0; n < steps && isfinite(point.value); n++) {
        double gain = 0.0;
        if (damping < most)
            differentiate(&q, &point);
        while (gain <= 0.0 && damping < most) {
            const double expected =
                next(&q, &point, damping, climb[4], climb[5], bounds, further.theta);
            if (!(expected > 0.0)) {
                damping *= factor;
                continue;
            }
            evaluate(&q, &further);
            gain = further.value - point.value;
            if (gain > 0.5 * expected)
                damping = fmax(damping / factor, least);
            else if (!(gain > 0.25 * expected))
                damping *= factor;
        }
        if (gain > 0.0)
            point = further;
        if (gain * (1.0 + damping) < climb[6])
            break;
    }
    memcpy(theta, point.theta, (size_t)parameters * sizeof *theta);
    *value = point.value;
    return 0;
}
