/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * A segment's process is held to its samples (`ground_truth/adaptation.py`): the regime that predicts
 * samples best, of those that can be reached from another one; Page's test for a change of a variance
 * by each of some ratios r, S_k = max(0, S_(k-1) + (e_k^2 (1 - 1/r) - offset) / 2); and both together.
 */
#include "factor.h"
#include "record.h"

#include <string.h>

/* Of all regimes that are looked at, of those together, of groups and of kernels: the most. */
enum { TRIED = 64, TOGETHER = 8, PARALLEL = 3, KERNELS = 8 };
/* Of what Page's test looks at, and of its ratios. */
enum { GROUPS = 2, MOST_TESTS = 8, TESTS = 2 };
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

static Regime shifted(Regime regime, int64_t motion, int64_t noise, int64_t most)
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
    near[n++] = shifted(from, leap, 0, most);
    near[n++] = shifted(from, 0, leap, most);
    for (int64_t way = leap > 0 ? -1 : 1, i = 1; i <= (leap > 0 ? 2 : 1); i++) {
        near[n++] = shifted(from, leap + i * way, 0, most);
        if (i == 1)
            near[n++] = shifted(from, 0, leap + way, most);
    }
    look_at(&q, near, n, noisiest, stds, &known);
    if (leap > 0 && from.noise >= NOISY) {
        /* Motion far below the noise shows only once it is many times as lively. */
        const Regime quiet = {from.motion, 0};
        for (int64_t i = 0; i < FAR; i++)
            near[i] = shifted(quiet, leap + 2 * (i + 1), 0, most);
        look_at(&q, near, FAR, noisiest, stds, &known);
    }
    int64_t best = best_of(&known);
    for (int64_t round = 0, looked_at = 0; round < rounds && known.count > looked_at; round++) {
        const Regime here = known.regimes[best];
        const Regime around[] = {shifted(here, 1, 0, most),  shifted(here, -1, 0, most),
                                 shifted(here, 0, 1, most),  shifted(here, 0, -1, most),
                                 shifted(here, 1, -1, most), shifted(here, -1, 1, most)};
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

/* What a segment is held to (adaptation.py has each as a constant, but for what was learned): of each
 * test steepness and offset; of each group the least log d^2 that tells and the instrument's variance;
 * and of regime_best. */
typedef struct {
    double steepness[TESTS], offsets[TESTS], telling[GROUPS], instrument[GROUPS];
    double least, flat, stds[2], least_gain;
} Rules;

/* Likewise: the test that is cautious; how many samples are predicted at most, from how many before
 * them, and of how few no regime is taken that is far noisier; and of regime_best. */
typedef struct {
    int64_t cautious, most_samples, context, few, most, rounds;
} Sizes;

/* The first row that refutes, the one since which, and the group; row -1 where there is none. */
typedef struct {
    int64_t row, since, group;
} Raised;

static Raised first_of(const int64_t *raised)
{
    Raised first = {-1, -1, -1};
    for (int64_t g = 0; g < GROUPS; g++) {
        const Raised own = {raised[2 * g], raised[2 * g + 1], g};
        if (own.row >= 0 && (first.row < 0 || own.row < first.row ||
                             (own.row == first.row && own.since < first.since)))
            first = own;
    }
    return first;
}

/* Take samples as factor_add does, and hold the newest epoch to all of them.
 *
 * Up to `seen` as of factor_add, with the variances (count, G) beside the noise (G,) of the epoch. rules
 * and sizes as in Rules and Sizes; of the kernels how many coefficients each has, orders (m,), and what
 * was learned of both groups, as regime_best has it: rates (2, m), parts (2, m + 1, 2). Of the epoch its
 * regimes (2, 2), the rows (2,) since which these are, and the sums of squares before (G,), which are
 * written where no sample was known. limits, sums and since (2, 2) and looked (2,) as of page_look.
 *
 * Return 1 if K is not positive definite; 2 where the samples refute the epoch, found (5): the row that
 * does, that since which it does, the group and its regime; else 0. work: of regime_best for a record
 * of most_samples + context, 9 numbers more for each of these, and G for each sample. */
int segment_hold(const int64_t *sizes, const double *first_past, int64_t kernels,
                 const double *constants, int64_t groups, int64_t coordinates,
                 const double *information, const double *times, int64_t known, int64_t count,
                 int64_t room, double *rows, double *spans, double *state, double *seen,
                 const double *values, const double *variances, const double *noise,
                 const double *rules, const int64_t *numbers, const int64_t *orders,
                 const double *rates, const double *parts, const int64_t *regimes,
                 const int64_t *begun, double *before, double *limits, double *sums,
                 int64_t *since, int64_t *looked, double *work, int64_t *found)
{
    const Factor all = {sizes, first_past, constants, kernels, groups, coordinates, room,
                        times, rows,       spans};
    const Group g = group_of(&all, 0);
    const Rules *rule = (const Rules *)rules;
    const Sizes *size = (const Sizes *)numbers;
    const int64_t parallel = groups / GROUPS, apart = room * g.row;
    for (int64_t i = known * groups; i < count * groups; i++)
        work[i] = variances[i] + noise[i % groups];
    if (factor_add(sizes, first_past, kernels, constants, groups, coordinates, information, times,
                   known, count, room, rows, spans, state, seen, values, work))
        return 1;
    for (int64_t p = 0; known == 0 && p < groups; p++)
        before[p] = rows[p * apart + (begun[p / parallel] - 1) * g.row + g.sums + g.columns];
    for (;;) {
        const int64_t first = looked[0] < looked[1] ? looked[0] : looked[1];
        int64_t raised[2 * GROUPS], best[2];
        double score;
        if (first >= count)
            return 0;
        page_look((int64_t)(intptr_t)(rows + first * g.row + g.news), apart, g.row, parallel, first,
                  count - first, rule->telling, rule->steepness, rule->offsets, TESTS,
                  size->cautious, limits, sums, since, looked, raised);
        const Raised it = first_of(raised);
        if (it.row < 0)
            return 0;
        const int64_t own = it.group * parallel, end = it.row + 1;
        double square = 0.0;
        for (int64_t p = own; p < own + parallel; p++)
            for (int64_t n = it.since; n < end; n++)
                square += rows[p * apart + n * g.row + g.news];
        const double ratio = square / (double)((end - it.since) * parallel * coordinates);

        /* The group's samples that are to be predicted, and some before them, lane after lane. */
        const int64_t told = it.since > end - size->most_samples ? it.since : end - size->most_samples;
        const int64_t begin = told > size->context ? told - size->context : 0, n = end - begin;
        double *t = work, *x = t + parallel * n, *v = x + parallel * n * coordinates;
        for (int64_t p = 0; p < parallel; p++) {
            memcpy(t + p * n, times + begin, (size_t)n * sizeof *t);
            for (int64_t i = 0; i < n; i++) {
                const int64_t place = (begin + i) * groups + own + p;
                v[p * n + i] = variances[place];
                memcpy(x + (p * n + i) * coordinates, values + place * coordinates,
                       (size_t)coordinates * sizeof *x);
            }
        }
        const int64_t *from = regimes + 2 * it.group;
        const int64_t much = end - told < size->few ? 1 : size->most_samples;
        regime_best(t, x, v, parallel, n, coordinates, orders, kernels, rates + it.group * kernels,
                    parts + it.group * 2 * (kernels + 1), rule->instrument[it.group], rule->least,
                    rule->flat, told - begin, from, ratio, (from[1] > 0 ? from[1] : 0) + much,
                    size->most, rule->stds, size->rounds, rule->least_gain,
                    v + parallel * n, best, &score);
        for (int64_t i = TESTS * it.group; i < TESTS * (it.group + 1); i++) {
            limits[i] *= 2.0;
            sums[i] = 0.0;
            since[i] = end;
        }
        looked[it.group] = end;
        if (best[0] != from[0] || best[1] != from[1]) {
            const int64_t said[] = {it.row, it.since, it.group, best[0], best[1]};
            memcpy(found, said, sizeof said);
            return 2;
        }
    }
}
