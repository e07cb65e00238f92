/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The regime that predicts samples best, of those that can be reached from another one:
 * `best_regime` of `ground_truth/adaptation.py`.
 */
#include "record.h"

/* Of all regimes that are looked at, of those together, of groups and of kernels: the most. */
enum { TRIED = 64, TOGETHER = 8, PARALLEL = 3, KERNELS = 8 };
/* Where so many times the noise, 2^NOISY, is refuted, so many motions far off are looked at. */
enum { NOISY = 2, FAR = 6 };

/* Motion 2^motion times as lively as learned, noise 2^noise times as large. */
typedef struct {
    int64_t motion, noise;
} Regime;

/* Samples to be predicted, those from `first` on, by others: each of the `parallel` groups is a
 * record. Of the kernels their rate / l and of their sigma^2 and of the noise's n^2 (kernels + 1, 2)
 * what goes with the motion's and with the noise's; beside the noise the instrument's variance, no
 * less than so much of the largest sigma^2; flat^2, of the mean's prior. */
typedef struct {
    const double *times, *values, *variances, *rates, *parts;
    const int64_t *orders;
    int64_t parallel, count, coordinates, kernels, first;
    double instrument, least, flat;
    double *work;
} Question;

/* The regimes that were looked at, and how probable they make the samples, nats. */
typedef struct {
    int64_t count;
    Regime regimes[TRIED];
    double squares[TRIED], scores[TRIED];
} Known;

static int64_t within(int64_t value, int64_t most)
{
    return value > most ? most : value < -most ? -most : value;
}

static Regime moved(Regime regime, int64_t motion, int64_t noise, int64_t most)
{
    return (Regime){within(regime.motion + motion, most), within(regime.noise + noise, most)};
}

static int64_t place_of(const Regime *regimes, int64_t count, Regime regime)
{
    int64_t place = 0;
    while (place < count && !(regimes[place].motion == regime.motion &&
                              regimes[place].noise == regime.noise))
        place++;
    return place;
}

/* How probable a regime is beside the learned one, nats; stds (2) of its two logarithms. */
static double log_prior(Regime regime, const double *stds)
{
    const double step = log(2.0);
    const double motion = step * (double)regime.motion / stds[0];
    const double noise = step * (double)regime.noise / stds[1];
    return -0.5 * (motion * motion + noise * noise);
}

/* Write sigma^2 (kernels) and n^2 of the process in a regime; the sum of the former. */
static double natural(const Question *q, Regime regime, double *sigmas, double *noise)
{
    const double motion = ldexp(1.0, (int)(2 * regime.motion));
    const double others = ldexp(1.0, (int)(2 * regime.noise));
    double sum = 0.0, largest = 0.0;
    for (int64_t k = 0; k <= q->kernels; k++) {
        const double variance = motion * q->parts[2 * k] + others * q->parts[2 * k + 1];
        if (k == q->kernels) {
            *noise = fmax(variance + q->instrument, q->least * largest);
        } else {
            sigmas[k] = variance;
            sum += variance;
            largest = fmax(largest, variance);
        }
    }
    return sum;
}

/* Look at those of n regimes, TOGETHER at most, that are new and not too noisy. */
static void look_at(const Question *q, const Regime *regimes, int64_t n, int64_t noisiest,
                    const double *stds, Known *known)
{
    double rates[TOGETHER * KERNELS], sigmas[TOGETHER * KERNELS], noises[TOGETHER];
    double information[TOGETHER], found[2 * TOGETHER * PARALLEL];
    int64_t begins[TOGETHER * PARALLEL], counts[TOGETHER * PARALLEL], sets[TOGETHER * PARALLEL];
    const int64_t before = known->count;
    int64_t records = 0;
    for (int64_t i = 0; i < n && known->count < TRIED; i++) {
        if (regimes[i].noise > noisiest ||
            place_of(known->regimes, known->count, regimes[i]) < known->count)
            continue;
        const int64_t set = known->count - before;
        known->regimes[known->count++] = regimes[i];
        const double sum =
            natural(q, regimes[i], sigmas + set * q->kernels, noises + set);
        information[set] = 1.0 / (q->flat * sum);
        for (int64_t k = 0; k < q->kernels; k++)
            rates[set * q->kernels + k] = q->rates[k];
        for (int64_t p = 0; p < q->parallel; p++, records++) {
            begins[records] = p * q->count;
            counts[records] = q->count;
            sets[records] = set;
        }
    }
    if (!records)
        return;
    record_news(begins, counts, records, q->times, q->values, q->variances, q->coordinates,
                q->orders, q->kernels, sets, rates, sigmas, noises, information, q->first, q->work,
                found);
    for (int64_t i = before, r = 0; i < known->count; i++) {
        double squares = 0.0, spreads = 0.0;
        for (int64_t p = 0; p < q->parallel; p++, r++) {
            squares += found[2 * r];
            spreads += found[2 * r + 1];
        }
        known->squares[i] = squares;
        known->scores[i] =
            -0.5 * (squares + (double)q->coordinates * spreads) + log_prior(known->regimes[i], stds);
    }
}

/* Where the best one is; of two the one with more motion, or noise. */
static int64_t best_of(const Known *known)
{
    int64_t best = 0;
    for (int64_t i = 1; i < known->count; i++) {
        const Regime a = known->regimes[i], b = known->regimes[best];
        const double more = known->scores[i] - known->scores[best];
        if (more > 0.0 || (!(more < 0.0) && (a.motion > b.motion ||
                                             (a.motion == b.motion && a.noise > b.noise))))
            best = i;
    }
    return best;
}

/* The regime found (2) from start (2), and its score (1).
 *
 * times, values and variances: (parallel, count), of c coordinates each; rates (kernels), parts and
 * the others as in Question. ratio: the standardised mean square of what is to be predicted, under
 * the start; below zero where it is not known. No regime is noisier than `noisiest`, none of either
 * exponent beyond `most`; stds (2) of the prior; so many rounds; another regime is to be better by
 * least_gain, nats. work: of record_news for a record of `count`. 1 where there are too many groups
 * or kernels. */
int regime_best(const double *times, const double *values, const double *variances,
                int64_t parallel, int64_t count, int64_t coordinates, const int64_t *orders,
                int64_t kernels, const double *rates, const double *parts, double instrument,
                double least, double flat, int64_t first, const int64_t *start, double ratio,
                int64_t noisiest, int64_t most, const double *stds, int64_t rounds,
                double least_gain, double *work, int64_t *found, double *score)
{
    const Question q = {.times = times, .values = values, .variances = variances,
                        .rates = rates, .parts = parts, .orders = orders, .parallel = parallel,
                        .count = count, .coordinates = coordinates, .kernels = kernels,
                        .first = first, .instrument = instrument, .least = least, .flat = flat,
                        .work = work};
    const Regime from = {start[0], start[1]}, usual = {0, 0};
    Known known = {.count = 0};
    if (parallel > PARALLEL || kernels > KERNELS)
        return 1;
    if (ratio < 0.0) {
        look_at(&q, &from, 1, noisiest, stds, &known);
        ratio = known.squares[0] / (double)((count - first) * parallel * coordinates);
    }
    const int64_t leap = (int64_t)nearbyint(0.5 * log2(fmax(ratio, 1e-12)));
    Regime near[TOGETHER];
    int64_t n = 0;
    near[n++] = from;
    near[n++] = (Regime){0, from.noise};
    near[n++] = usual;
    near[n++] = moved(from, leap, 0, most);
    near[n++] = moved(from, 0, leap, most);
    for (int64_t way = leap > 0 ? -1 : 1, i = 1; i <= (leap > 0 ? 2 : 1); i++) {
        near[n++] = moved(from, leap + i * way, 0, most);
        if (i == 1)
            near[n++] = moved(from, 0, leap + way, most);
    }
    look_at(&q, near, n, noisiest, stds, &known);
    if (leap > 0 && from.noise >= NOISY) {
        /* Motion far below the noise shows only once it is many times as lively. */
        const Regime quiet = {from.motion, 0};
        for (int64_t i = 0; i < FAR; i++)
            near[i] = moved(quiet, leap + 2 * (i + 1), 0, most);
        look_at(&q, near, FAR, noisiest, stds, &known);
    }
    int64_t best = best_of(&known);
    for (int64_t round = 0, looked_at = 0; round < rounds && known.count > looked_at; round++) {
        const Regime here = known.regimes[best];
        const Regime around[] = {moved(here, 1, 0, most),  moved(here, -1, 0, most),
                                 moved(here, 0, 1, most),  moved(here, 0, -1, most),
                                 moved(here, 1, -1, most), moved(here, -1, 1, most)};
        looked_at = known.count;
        look_at(&q, around, 6, noisiest, stds, &known);
        best = best_of(&known);
    }
    const int64_t own = place_of(known.regimes, known.count, from);
    if (!(known.scores[best] > known.scores[own] + least_gain))
        best = own;
    found[0] = known.regimes[best].motion;
    found[1] = known.regimes[best].noise;
    *score = known.scores[best];
    return 0;
}
