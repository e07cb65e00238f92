/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The Cholesky factor K = L L' of samples under a sum of Matern kernels, sample by sample, and what
 * queries need of it; `ground_truth/recursion.py` has the formulas.
 *
 * Of r numbers in all, each kernel has some that follow each other; the transition over a time dt
 * has, of each kernel, the entries Phi_ij = q_(i-j), i >= j, of its powers q_k = a^k / k! exp(-a),
 * a = rate dt; where samples follow each other, q_0 - 1 is kept for q_0: what is close to the
 * identity is added, so that the round-off of many small steps does not add up. A state [N M] is
 * (r, lanes): 1 + c columns of N and r of M, zeros after each up to a multiple of LANES. The rows of
 * a group hold of each sample [g z], (1 + c), the pivot l, the sums up to it, (2 + c), its z' z,
 * e^2 and d of factor_add, w (r) and the powers since the sample before (r); its spans, the state
 * after every SPAN samples.
 */
#include "loops.h"

#include <stddef.h>

enum { LANES = 4, SPAN = 8 };

/* How many numbers each kernel has, (m,), and past(0), (r,); of one group, each kernel's rate, the
 * same where it is motion and 0 where it is noise, and its variance, (m,). */
typedef struct {
    const int64_t *sizes;
    const double *first_past, *rates, *slopes, *variances;
    int64_t kernels, rank, columns, begin, lanes, row; /* begin: of M in a state's row */
} Group;

/* What is in a sample's row. */
typedef struct {
    double *white, *l, *sums, *square, *news, *w, *q;
} Row;

static int64_t in_lanes(int64_t n) { return (n + LANES - 1) / LANES * LANES; }

/* Of constants (G, 3, m): rates, slopes and variances. */
static Group group_of(int64_t number, const int64_t *sizes, const double *first_past,
                      int64_t kernels, const double *constants, int64_t columns) {
    int64_t rank = 0;
    for (int64_t k = 0; k < kernels; k++) {
        rank += sizes[k];
    }
    const double *own = constants + number * 3 * kernels;
    const int64_t begin = in_lanes(columns);
    return (Group){
        .sizes = sizes,
        .first_past = first_past,
        .rates = own,
        .slopes = own + kernels,
        .variances = own + 2 * kernels,
        .kernels = kernels,
        .rank = rank,
        .columns = columns,
        .begin = begin,
        .lanes = begin + in_lanes(rank),
        .row = 2 * columns + 5 + 2 * rank,
    };
}

static Row row_of(const Group *g, double *rows, int64_t n) {
    Row row = {.white = rows + n * g->row};
    row.l = row.white + g->columns;
    row.sums = row.l + 1;
    row.square = row.sums + g->columns + 1;
    row.news = row.square + 1;
    row.w = row.news + 2;
    row.q = row.w + g->rank;
    return row;
}

static double dot(const double *a, const double *b, int64_t n) {
    double sum = 0.0;
    for (int64_t i = 0; i < n; i++) {
        sum += a[i] * b[i];
    }
    return sum;
}

static void fill(double *a, int64_t n, double value) {
    for (int64_t i = 0; i < n; i++) {
        a[i] = value;
    }
}

/* Add so many lanes of a row, times a factor, to another. */
LOOPS_PART void add_row(double *to, double factor, const double *from, int64_t lanes) {
    for (int64_t begin = 0; begin < lanes; begin += LANES) {
        for (int64_t i = begin; i < begin + LANES; i++) {
            to[i] += factor * from[i];
        }
    }
}

/* The powers (p,) of one kernel from that of order 0 on. */
static void raise(double a, int64_t size, double *q) {
    for (int64_t j = 1; j < size; j++) {
        q[j] = q[j - 1] * (a / (double)j);
    }
}

/* The powers (r,) of a time. */
static void powers(const Group *g, double time, double *q) {
    for (int64_t k = 0; k < g->kernels; q += g->sizes[k++]) {
        q[0] = exp(-g->rates[k] * time);
        raise(g->rates[k] * time, g->sizes[k], q);
    }
}

/* The same, or their derivatives. */
static void powers_or_slopes(const Group *g, double time, int slope, double *q) {
    powers(g, time, q);
    for (int64_t k = 0; slope && k < g->kernels; q += g->sizes[k++]) {
        for (int64_t j = g->sizes[k] - 1; j > 0; j--) {
            q[j] = g->slopes[k] * (q[j - 1] - q[j]);
        }
        q[0] *= -g->slopes[k];
    }
}

/* The same of a transition, less 1 where they are of order 0. */
static void transition(const Group *g, double time, double *q) {
    for (int64_t k = 0; k < g->kernels; q += g->sizes[k++]) {
        const double a = g->rates[k] * time, less = a < 0.5 ? expm1(-a) : exp(-a) - 1.0;
        q[0] = a < 0.5 ? 1.0 + less : exp(-a);
        raise(a, g->sizes[k], q);
        q[0] = less;
    }
}

/* Let x (r,) be Phi' x. */
static void onwards(const Group *g, const double *q, double *x) {
    for (int64_t k = 0; k < g->kernels; k++) {
        const int64_t size = g->sizes[k];
        for (int64_t j = 0; j < size; j++) {
            x[j] += dot(q, x + j, size - j);
        }
        q += size;
        x += size;
    }
}

/* Let x (r,) be Phi x. */
static void back(const Group *g, const double *q, double *x) {
    for (int64_t k = 0; k < g->kernels; k++) {
        const int64_t size = g->sizes[k];
        for (int64_t i = size - 1; i >= 0; i--) {
            double sum = 0.0;
            for (int64_t j = 0; j <= i; j++) {
                sum += q[i - j] * x[j];
            }
            x[i] += sum;
        }
        q += size;
        x += size;
    }
}

/* Of a row or a vector x (r,): future(0)' x. */
static double at_sample(const Group *g, const double *x) {
    double sum = 0.0;
    for (int64_t k = 0; k < g->kernels; x += g->sizes[k++]) {
        sum += g->variances[k] * *x;
    }
    return sum;
}

/* Let the r rows of so many lanes, each that far from the next, be Phi' times them; sum: (lanes,)
 * to work with. */
LOOPS_PART void rows_onwards(const Group *g, const double *q, double *rows, int64_t lanes,
                         double *sum) {
    for (int64_t k = 0; k < g->kernels; q += g->sizes[k++]) {
        for (int64_t left = g->sizes[k]; left > 0; left--, rows += g->lanes) {
            fill(sum, lanes, 0.0);
            for (int64_t i = 0; i < left; i++) {
                add_row(sum, q[i], rows + i * g->lanes, lanes);
            }
            add_row(rows, 1.0, sum, lanes);
        }
    }
}

/* Let the state [N M] be [Phi' N, Phi' M Phi], as Phi' (Phi' M)'. */
LOOPS_PART void predict(const Group *g, const double *q, double *state, double *sum) {
    double *m = state + g->begin;
    rows_onwards(g, q, state, g->lanes, sum);
    for (int64_t i = 0; i < g->rank; i++) {
        for (int64_t j = 0; j < i; j++) {
            const double kept = m[i * g->lanes + j];
            m[i * g->lanes + j] = m[j * g->lanes + i];
            m[j * g->lanes + i] = kept;
        }
    }
    rows_onwards(g, q, m, g->lanes - g->begin, sum);
    /* Symmetric to the bit: what is not would stay for good, and add up. */
    for (int64_t i = 0; i < g->rank; i++) {
        for (int64_t j = 0; j < i; j++) {
            m[j * g->lanes + i] = m[i * g->lanes + j];
        }
    }
}

/* Take a sample whose noise is given; write its l, [g z] and w; 0 if its variance is not positive.
 * seen: (lanes,) to work with. */
LOOPS_PART int take(const Group *g, double noise, const double *values, double *state, Row row,
                double *seen) {
    double variance = noise, *line = state;
    fill(seen, g->lanes, 0.0);
    for (int64_t k = 0; k < g->kernels; line += g->lanes * g->sizes[k++]) {
        variance += g->variances[k];
        add_row(seen, g->variances[k], line, g->lanes);
    }
    variance -= at_sample(g, seen + g->begin);
    if (!(variance > 0.0)) {
        return 0;
    }
    *row.l = sqrt(variance);
    for (int64_t j = 0; j < g->columns; j++) {
        seen[j] = row.white[j] = ((j ? values[j - 1] : 1.0) - seen[j]) / *row.l;
    }
    for (int64_t i = 0; i < g->rank; i++) {
        double *solved = seen + g->begin + i;
        *solved = row.w[i] = (g->first_past[i] - *solved) / *row.l;
    }
    for (int64_t i = 0; i < g->rank; i++) {
        add_row(state + i * g->lanes, row.w[i], seen, g->lanes);
    }
    return 1;
}

/* Write the sums A, g' z and q of a sample's row, z' z, e^2 and d; of those before it (before), or
 * of the first one the information that there is before all. */
static void sum_up(const Group *g, double information, const Row *before, Row row) {
    const int64_t last = g->columns;
    double square = 0.0, explained = 0.0;
    for (int64_t j = 0; j < g->columns; j++) {
        const double known = before ? before->sums[j] : j ? 0.0 : information;
        row.sums[j] = known + row.white[0] * row.white[j];
        square += j ? row.white[j] * row.white[j] : 0.0;
        explained += j ? row.sums[j] * row.sums[j] : 0.0;
    }
    *row.square = (before ? *before->square : 0.0) + square;
    row.sums[last] = *row.square - explained / row.sums[0];
    row.news[0] = row.sums[last] - (before ? before->sums[last] : 0.0);
    row.news[1] = log(*row.l * *row.l * (row.sums[0] / (before ? before->sums[0] : information)));
}

/* Take the samples from `first` on, of G groups and c coordinates; 1 if K is not positive definite.
 *
 * sizes (m,), first_past (r,) and constants (G, 3, m) as in Group; information (G,) of the mean's
 * prior; times (count,), values (count, G, c), noise (count, G); rows (G, room, row), spans (G,
 * room / SPAN, r, lanes), state (G, r, lanes) after the sample before the first one, overwritten;
 * seen (lanes,) to work with.
 *
 * The sums are A = information + g' g, g' z and q = tr z' z - |g' z|^2 / A; e^2 and d, what q and
 * log det K + log A are more than before. */
LOOPS_WIDE
int factor_add(const int64_t *sizes, const double *first_past, int64_t kernels,
               const double *constants, int64_t groups, int64_t coordinates,
               const double *information, const double *times, const double *values,
               const double *noise, int64_t first, int64_t count, int64_t room, double *rows,
               double *spans, double *state, double *seen) {
    for (int64_t number = 0; number < groups; number++) {
        const Group g =
            group_of(number, sizes, first_past, kernels, constants, 1 + coordinates);
        const int64_t size = g.rank * g.lanes;
        double *own = state + number * size, *of = rows + number * room * g.row;
        for (int64_t n = first; n < count; n++) {
            const Row row = row_of(&g, of, n), before = row_of(&g, of, n ? n - 1 : 0);
            const int64_t place = n * groups + number;
            if (n > 0) {
                transition(&g, times[n] - times[n - 1], row.q);
                predict(&g, row.q, own, seen);
            } else {
                fill(row.q, g.rank, 0.0);
            }
            if (!take(&g, noise[place], values + place * coordinates, own, row, seen)) {
                return 1;
            }
            sum_up(&g, information[number], n ? &before : NULL, row);
            if (n % SPAN == SPAN - 1) {
                double *span = spans + (number * (room / SPAN) + n / SPAN) * size;
                for (int64_t i = 0; i < size; i++) {
                    span[i] = own[i];
                }
            }
        }
    }
    return 0;
}

/* What there is of a group's samples. */
typedef struct {
    Group g;
    const double *times, *spans;
    double *rows;
} Known;

static Known known_of(int64_t number, const int64_t *sizes, const double *first_past,
                      int64_t kernels, const double *constants, int64_t coordinates,
                      const double *times, double *rows, const double *spans, int64_t room) {
    const Group g = group_of(number, sizes, first_past, kernels, constants, 1 + coordinates);
    return (Known){g, times, spans + number * (room / SPAN) * g.rank * g.lanes,
                   rows + number * room * g.row};
}

/* How many of the first `count` samples lie at a time or before it. */
static int64_t samples_until(const double *times, int64_t count, double time) {
    int64_t first = 0;
    while (first < count) {
        const int64_t middle = first + (count - first) / 2;
        if (times[middle] <= time) {
            first = middle + 1;
        } else {
            count = middle;
        }
    }
    return first;
}

/* Let f (r,) be the future that has these powers. */
static void future(const Group *g, const double *q, double *f) {
    for (int64_t k = 0, i = 0; k < g->kernels; k++) {
        for (const int64_t end = i + g->sizes[k]; i < end; i++) {
            f[i] = g->variances[k] * q[i];
        }
    }
}

/* Take the past that has these powers, times a factor, from s (r,). */
static void take_past(const Group *g, double factor, const double *q, double *s) {
    for (int64_t k = 0, begin = 0; k < g->kernels; begin += g->sizes[k++]) {
        for (int64_t i = begin, end = begin + g->sizes[k]; i < end; i++) {
            s[i] -= factor * dot(q + begin, g->first_past + i, end - i);
        }
    }
}

/* Write v of a query at a time, given the first `count` samples, from a row on, which is returned:
 * the begin of a span. Of the rows before it, f (r,) is the future of the query, or of its slope,
 * after the last, and seen (lanes,) f' [N M]. s and q (r,) to work with. */
static int64_t whiten(const Known *known, double time, int64_t count, int slope, double *v,
                      double *f, double *s, double *q, double *seen) {
    const Group *g = &known->g;
    const int64_t next = samples_until(known->times, count, time), begin = next / SPAN * SPAN;
    fill(seen, g->lanes, 0.0);
    if (next > 0) {
        powers_or_slopes(g, time - known->times[next - 1], slope, q);
        future(g, q, f);
    }
    for (int64_t n = next - 1; n >= begin; n--) {
        const Row row = row_of(g, known->rows, n);
        v[n] = dot(row.w, f, g->rank);
        back(g, row.q, f);
    }
    for (int64_t i = 0; begin > 0 && i < g->rank; i++) {
        const double *state = known->spans + (begin / SPAN - 1) * g->rank * g->lanes;
        add_row(seen, f[i], state + i * g->lanes, g->lanes);
    }
    for (int64_t i = 0; i < g->rank; i++) {
        s[i] = seen[g->begin + i];
    }
    for (int64_t n = begin; n < count; n++) {
        const Row row = row_of(g, known->rows, n);
        onwards(g, row.q, s);
        if (n == next) {
            powers_or_slopes(g, known->times[n] - time, slope, q);
            take_past(g, slope ? -1.0 : 1.0, q, s);
        }
        if (n >= next) {
            v[n] = -at_sample(g, s) / *row.l;
        }
        for (int64_t i = 0; i < g->rank; i++) {
            s[i] += v[n] * row.w[i];
        }
    }
    return begin;
}

/* v' [g z] and v' v of queries, of the process and, of two kinds, of its motion's derivative.
 *
 * As in factor_add; of queries at asked (a,), given the first counts (a,) >= 1 samples, found
 * (kinds, G, a, 1 + c) and explained (kinds, G, a). v (the largest count,) and work (3 r + lanes,)
 * to work with. */
int factor_products(const int64_t *sizes, const double *first_past, int64_t kernels,
                    const double *constants, int64_t groups, int64_t coordinates,
                    const double *times, double *rows, const double *spans, int64_t room,
                    const double *asked, const int64_t *counts, int64_t queries, int64_t kinds,
                    double *found, double *explained, double *v, double *work) {
    for (int64_t i = 0; i < kinds * groups * queries; i++) {
        const int64_t query = i % queries, number = i / queries % groups;
        const int slope = i / queries / groups > 0;
        const Known known = known_of(number, sizes, first_past, kernels, constants, coordinates,
                                     times, rows, spans, room);
        const Group *g = &known.g;
        double *f = work, *s = f + g->rank, *q = s + g->rank, *seen = q + g->rank;
        double *sums = found + i * g->columns;
        const int64_t begin =
            whiten(&known, asked[query], counts[query], slope, v, f, s, q, seen);
        for (int64_t j = 0; j < g->columns; j++) {
            sums[j] = seen[j];
        }
        explained[i] = begin > 0 ? dot(seen + g->begin, f, g->rank) : 0.0;
        for (int64_t n = begin; n < counts[query]; n++) {
            const Row row = row_of(g, known.rows, n);
            for (int64_t j = 0; j < g->columns; j++) {
                sums[j] += v[n] * row.white[j];
            }
            explained[i] += v[n] * v[n];
        }
    }
    return 0;
}

/* All of v of queries, white (G, a, size), zeros from row counts (a,) on; as factor_products. */
int factor_whitened(const int64_t *sizes, const double *first_past, int64_t kernels,
                    const double *constants, int64_t groups, int64_t coordinates,
                    const double *times, double *rows, const double *spans, int64_t room,
                    const double *asked, const int64_t *counts, int64_t queries, double *white,
                    int64_t size, double *work) {
    for (int64_t i = 0; i < groups * queries; i++) {
        const int64_t query = i % queries;
        const Known known = known_of(i / queries, sizes, first_past, kernels, constants,
                                     coordinates, times, rows, spans, room);
        const Group *g = &known.g;
        double *f = work, *s = f + g->rank, *q = s + g->rank, *seen = q + g->rank;
        double *v = white + i * size;
        int64_t n = whiten(&known, asked[query], counts[query], 0, v, f, s, q, seen);
        while (n-- > 0) {
            const Row row = row_of(g, known.rows, n);
            v[n] = dot(row.w, f, g->rank);
            back(g, row.q, f);
        }
        fill(v + counts[query], size - counts[query], 0.0);
    }
    return 0;
}

/* Let each right side (G, a, size), zero from row counts (a,) on, be L^-T times it.
 *
 * s (r,) to work with. */
int factor_weights(const int64_t *sizes, const double *first_past, int64_t kernels,
                   const double *constants, int64_t groups, int64_t coordinates,
                   double *rows, int64_t room, const int64_t *counts, int64_t queries,
                   double *right, int64_t size, double *s) {
    for (int64_t i = 0; i < groups * queries; i++) {
        const Group g =
            group_of(i / queries, sizes, first_past, kernels, constants, 1 + coordinates);
        double *x = right + i * size;
        fill(s, g.rank, 0.0);
        for (int64_t n = counts[i % queries] - 1; n >= 0; n--) {
            const Row row = row_of(&g, rows + i / queries * room * g.row, n);
            x[n] = (x[n] - dot(row.w, s, g.rank)) / *row.l;
            for (int64_t k = 0, j = 0; k < g.kernels; j += g.sizes[k++]) {
                s[j] += g.variances[k] * x[n];
            }
            back(&g, row.q, s);
        }
    }
    return 0;
}
