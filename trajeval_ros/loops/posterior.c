/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * What overlapping segments of the ground truth say of queries, in the world and blended:
 * `ground_truth/segment.py`, `regression.py` and `trajectory.py` have the formulas, and do the same
 * where there is no compiler, `ground_truth/at_once.py` calls this.
 */
#include "factor.h"
#include "se3.h"

#include <stddef.h>

/* Value and slope of six groups. */
enum { MOST_PAIRS = 12 };

/* A segment, and its epochs, as rows of integers, of which some are addresses. */
typedef struct {
    int64_t samples, stamps, reference; /* how many; their stamps (n,), ns; the first pose (4, 4) */
    int64_t epochs;                     /* how many; theirs follow each other */
    int64_t incoming, incoming_stamps, incoming_progress; /* the hand-overs (n,); 0 of none */
    int64_t outgoing, outgoing_stamps, outgoing_progress;
} Segment;

/* It answers queries that know at least `first` samples; since which its groups' scales are, the
 * sums of squares before (G,), k(0) and that of the slope (2, G), and of a Factor all. */
typedef struct {
    int64_t first, since[2], before, priors;
    int64_t sizes, first_past, kernels, constants, groups, coordinates, times, rows, spans, room;
} Epoch;

/* Of an epoch: the least scales, and how uncertain the stamps are together, s. */
typedef struct {
    double least[2], shared;
} Bounds;

/* One segment's answer: the pose, the right perturbation's covariance and, where they are asked for,
 * the twist and its covariance. */
typedef struct {
    double pose[16], covariance[36], twist[6], twist_covariance[36];
} Answer;

/* Degrees of freedom that a scale is held at one by, the least variance in units of the prior, and
 * the tables of the maps of SE(3). */
typedef struct {
    double freedom, round_off;
    const double *exponential;
    int64_t exponential_terms;
    const double *logarithm;
    int64_t logarithm_terms;
} Constants;

static const double *doubles_at(int64_t address) { return (const double *)(intptr_t)address; }

static const int64_t *integers_at(int64_t address) { return (const int64_t *)(intptr_t)address; }

/* How many of n numbers that do not decrease are less than a value, or not larger. */
static int64_t count_below(const int64_t *numbers, int64_t n, int64_t value, int or_equal) {
    int64_t first = 0;
    while (first < n) {
        const int64_t middle = first + (n - first) / 2;
        if (or_equal ? numbers[middle] <= value : numbers[middle] < value) {
            first = middle + 1;
        } else {
            n = middle;
        }
    }
    return first;
}

/* The weight of the later of two segments: p^2 (3 - 2 p) of the progress, linear between samples. */
static double handed_over(int64_t n, const int64_t *stamps, const double *progress, int64_t at) {
    const int64_t after = count_below(stamps, n, at, 1);
    double p = progress[after > 0 ? after - 1 : 0];
    if (after > 0 && after < n) {
        const double begin = (double)(stamps[after - 1] - stamps[0]);
        const double slope =
            (progress[after] - p) / ((double)(stamps[after] - stamps[0]) - begin);
        p += slope * ((double)(at - stamps[0]) - begin);
    }
    return p * p * (3.0 - 2.0 * p);
}

/* Whether a stamp is before all that a segment answers. */
static int is_before(const Segment *of, int64_t at) {
    return of->incoming && at <= *integers_at(of->incoming_stamps);
}

/* Whether it is after that: where the segment has been handed over. */
static int is_after(const Segment *of, int64_t at) {
    const int64_t last = of->outgoing - 1;
    return of->outgoing && doubles_at(of->outgoing_progress)[last] >= 1.0 &&
           at >= integers_at(of->outgoing_stamps)[last];
}

/* The segment's weight at a stamp between; the weights of all segments sum to one. */
static double weight_of(const Segment *of, int64_t at) {
    double weight = 1.0;
    if (of->incoming) {
        weight *= handed_over(of->incoming, integers_at(of->incoming_stamps),
                              doubles_at(of->incoming_progress), at);
    }
    if (of->outgoing) {
        weight *= 1.0 - handed_over(of->outgoing, integers_at(of->outgoing_stamps),
                                    doubles_at(of->outgoing_progress), at);
    }
    return weight;
}

static Factor factor_of(const Epoch *e) {
    return (Factor){
        .sizes = integers_at(e->sizes),
        .first_past = doubles_at(e->first_past),
        .constants = doubles_at(e->constants),
        .kernels = e->kernels,
        .groups = e->groups,
        .coordinates = e->coordinates,
        .room = e->room,
        .times = doubles_at(e->times),
        .rows = doubles_at(e->rows),
        .spans = doubles_at(e->spans),
    };
}

/* What queries need of an epoch: all pairs of what is asked for and a group. */
typedef struct {
    const Epoch *epoch;
    const Bounds *least;
    Pairs pairs[MOST_PAIRS / LANES];
    int64_t count;
} Ready;

static Ready ready_of(const Epoch *epoch, const Bounds *least, int64_t kinds) {
    const Factor of = factor_of(epoch);
    Ready found = {.epoch = epoch, .least = least, .count = kinds * of.groups};
    for (int64_t first = 0; first < found.count; first += LANES) {
        found.pairs[first / LANES] = pairs_of(&of, first, kinds);
    }
    return found;
}

/* An epoch's answer at a time by the first `count` samples, in local coordinates: of k that are asked
 * for the means (k, 6) and variances (k, 6). */
LOOPS_PART void ask(const Ready *of, double time, int64_t count, const Constants *constants,
                    double *work, int64_t most, double *means, double *variances) {
    const int64_t groups = of->epoch->groups, c = of->epoch->coordinates;
    const double *before = doubles_at(of->epoch->before), *priors = doubles_at(of->epoch->priors);
    double squares[2] = {0.0}, scales[2];
    for (int64_t place = 0; place < of->count; place++) {
        const int64_t l = place % LANES;
        const Pairs *pairs = of->pairs + place / LANES;
        const Group *g = pairs->groups + l;
        const Room room = room_in(work, most, g);
        const double *sums = pairs->rows[l] + (count - 1) * g->row + g->sums;
        if (l == 0) {
            products(pairs, time, count, &room);
        }
        /* What a constant has of either, less what of it the samples explain. */
        const double r = (pairs->slopes[l] ? 0.0 : 1.0) - room.found[0][l];
        const double variance = priors[place] - (*room.explained)[l] + r * r / sums[0];
        const double least = constants->round_off * priors[place];
        for (int64_t j = 0; j < c; j++) {
            means[place * c + j] = room.found[1 + j][l] + r / sums[0] * sums[1 + j];
            variances[place * c + j] = variance > least ? variance : least;
        }
        if (place < groups) {
            squares[2 * place / groups] += sums[1 + c] - before[place];
        }
    }
    for (int64_t i = 0; i < 2; i++) {
        const double seen = 3.0 * (double)(count - of->epoch->since[i]);
        const double scale = (constants->freedom + squares[i]) / (constants->freedom + seen);
        scales[i] = scale > of->least->least[i] ? scale : of->least->least[i];
    }
    for (int64_t place = 0; place < of->count * c; place++) {
        variances[place] *= scales[place / 3 % 2];
    }
}

/* Put a (3, 3) times diag(d) times a' into a block of a covariance (6, 6). */
static void to_block(const double *a, const double *d, double *block) {
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            double sum = 0.0;
            for (int k = 0; k < 3; k++) {
                sum += a[3 * i + k] * d[k] * a[3 * j + k];
            }
            block[6 * i + j] = sum;
        }
    }
}

/* B diag(d) B' of B = blkdiag(Exp(phi)', J_r(phi)). */
static void to_covariance(const double *turned_back, const double *jacobian, const double *d,
                          double *covariance) {
    for (int i = 0; i < 36; i++) {
        covariance[i] = 0.0;
    }
    to_block(turned_back, d, covariance);
    to_block(jacobian, d + 3, covariance + 21);
}

static void turn(const double *matrix, const double *x, double *to) {
    for (int i = 0; i < 3; i++) {
        to[i] = matrix[3 * i] * x[0] + matrix[3 * i + 1] * x[1] + matrix[3 * i + 2] * x[2];
    }
}

/* What local coordinates about a reference (4, 4) are in the world. */
static void to_world(const double *reference, int64_t kinds, const double *means,
                     const double *variances, const Constants *constants, Answer *answer) {
    double rotation[9], back[9], jacobian[9];
    so3_exp(means + 3, rotation, 1, constants->exponential, constants->exponential_terms);
    so3_right_jacobian(means + 3, jacobian, 1, constants->exponential,
                       constants->exponential_terms);
    for (int i = 0; i < 3; i++) {
        const double *row = reference + 4 * i;
        for (int j = 0; j < 3; j++) {
            back[3 * j + i] = rotation[3 * i + j];
            answer->pose[4 * i + j] =
                row[0] * rotation[j] + row[1] * rotation[3 + j] + row[2] * rotation[6 + j];
        }
        answer->pose[4 * i + 3] =
            row[3] + (row[0] * means[0] + row[1] * means[1] + row[2] * means[2]);
        answer->pose[12 + i] = 0.0;
    }
    answer->pose[15] = 1.0;
    to_covariance(back, jacobian, variances, answer->covariance);
    if (kinds > 1) {
        turn(back, means + 6, answer->twist);
        turn(jacobian, means + 9, answer->twist + 3);
        to_covariance(back, jacobian, variances + 6, answer->twist_covariance);
    }
}

/* c = a b, poses (4, 4). */
static void pose_product(const double *a, const double *b, double *c) {
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            c[4 * i + j] = a[4 * i] * b[j] + a[4 * i + 1] * b[4 + j] + a[4 * i + 2] * b[8 + j] +
                           a[4 * i + 3] * b[12 + j];
        }
    }
}

/* T_a becomes T_a Exp(w Log(T_a^-1 T_b)). */
static void interpolate(double *a, const double *b, double w, const Constants *constants) {
    double back[16], between[16], step[6], moved[16], found[16];
    se3_inverse(a, back, 1);
    pose_product(back, b, between);
    se3_log(between, step, 1, constants->logarithm, constants->logarithm_terms);
    for (int i = 0; i < 6; i++) {
        step[i] *= w;
    }
    se3_exp(step, moved, 1, constants->exponential, constants->exponential_terms);
    pose_product(a, moved, found);
    for (int i = 0; i < 16; i++) {
        a[i] = found[i];
    }
}

/* Add n numbers times a weight to those that are there, if there are. */
static void mix(double weight, const double *from, int64_t n, int there, double *to) {
    for (int64_t i = 0; i < n; i++) {
        to[i] = (there ? to[i] : 0.0) + weight * from[i];
    }
}

/* Add what segments (n,), each later than the one before, say of queries.
 *
 * segments (n, 10), and of all of them epochs (m, 15) and bounds (m, 3): as Segment, Epoch and Bounds
 * are. Queries, the order (q,) of whose stamps is given: at stamps (q,), ns, given the samples stamped
 * up to until (q,); if `kinds` is two their twists, too. weights (q,): of the segments so far, and
 * what those said, mixed: poses (q, 4, 4), covariances (q, 6, 6), twists (q, 6), theirs (q, 6, 6), and
 * the standard deviation (q,) of stamps that are off together, s. The tables are those of the maps of
 * SE(3), the exponential's and the logarithm's. work: for a Room of `most` samples. 1 if an epoch is
 * not of six coordinates. */
LOOPS_WIDE
int posterior_add(const int64_t *segments, int64_t n, const int64_t *epochs, const double *bounds,
                  const int64_t *order, const int64_t *stamps, const int64_t *until,
                  int64_t queries, int64_t kinds, double freedom, double round_off,
                  const double *exponential, int64_t exponential_terms, const double *logarithm,
                  int64_t logarithm_terms, double *weights, double *poses, double *covariances,
                  double *twists, double *twist_covariances, double *shared, int64_t most,
                  double *work) {
    const Constants constants = {freedom, round_off, exponential, exponential_terms,
                                 logarithm, logarithm_terms};
    const Segment *segment = (const Segment *)segments;
    const Epoch *own = (const Epoch *)epochs;
    const Bounds *least = (const Bounds *)bounds;
    int64_t from = 0; /* those before it are before all segments that are left */
    for (; n > 0; own += segment->epochs, least += segment->epochs, segment++, n--) {
        const int64_t *samples = integers_at(segment->stamps);
        Ready ready = {.epoch = NULL};
        while (from < queries && is_before(segment, stamps[order[from]])) {
            from++;
        }
        for (int64_t j = from; j < queries && !is_after(segment, stamps[order[j]]); j++) {
            const int64_t i = order[j];
            const double weight = weight_of(segment, stamps[i]);
            if (!(weight > 0.0)) {
                continue;
            }
            int64_t e = segment->epochs - 1, count = segment->samples;
            count = count_below(samples, count, until[i], 1);
            count = count > 1 ? count : 1;
            while (e > 0 && own[e].first > count) {
                e--;
            }
            if (ready.epoch != own + e) {
                const int64_t groups = own[e].groups;
                if (groups * kinds > MOST_PAIRS || groups * own[e].coordinates != 6) {
                    return 1;
                }
                ready = ready_of(own + e, least + e, kinds);
            }
            double means[12], variances[12];
            ask(&ready, (double)(stamps[i] - samples[0]) * 1e-9, count, &constants, work, most,
                means, variances);
            Answer answer;
            to_world(doubles_at(segment->reference), kinds, means, variances, &constants, &answer);
            const int there = weights[i] > 0.0;
            weights[i] += weight;
            if (there) {
                interpolate(poses + 16 * i, answer.pose, weight / weights[i], &constants);
            } else {
                mix(1.0, answer.pose, 16, 0, poses + 16 * i);
            }
            mix(weight, answer.covariance, 36, there, covariances + 36 * i);
            mix(weight, &least[e].shared, 1, there, shared + i);
            if (kinds > 1) {
                mix(weight, answer.twist, 6, there, twists + 6 * i);
                mix(weight, answer.twist_covariance, 36, there, twist_covariances + 36 * i);
            }
        }
    }
    return 0;
}
