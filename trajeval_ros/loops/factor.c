/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The Cholesky factor K = L L' of samples under a sum of Matern kernels, sample by sample, and what
 * queries need of it; `ground_truth/recursion.py` has the formulas, `factor.h` says what is kept.
 */
#include "factor.h"

#include <stddef.h>

/* What is in a sample's row. */
typedef struct {
    double *white, *l, *sums, *square, *news, *w, *q;
} Row;

static Row row_of(const Group *g, double *rows, int64_t n) {
    double *row = rows + n * g->row;
    return (Row){row,           row + g->l, row + g->sums, row + g->square,
                 row + g->news, row + g->w, row + g->q};
}

/* Add so many lanes of a row, times a factor, to another. */
LOOPS_PART void add_row(double *to, double factor, const double *from, int64_t lanes) {
    for (int64_t begin = 0; begin < lanes; begin += LANES) {
        *(Lanes *)(to + begin) += factor * *(const Lanes *)(from + begin);
    }
}

/* The powers (r,) of a transition over a time, less 1 where they are of order 0. */
static void transition(const Group *g, double time, double *q) {
    for (int64_t k = 0; k < g->kernels; q += g->sizes[k++]) {
        const double a = g->rates[k] * time, less = a < 0.5 ? expm1(-a) : exp(-a) - 1.0;
        q[0] = a < 0.5 ? 1.0 + less : exp(-a);
        raise(a, g->sizes[k], q);
        q[0] = less;
    }
}

static double dot(const double *a, const double *b, int64_t n) {
    double sum = 0.0;
    for (int64_t i = 0; i < n; i++) {
        sum += a[i] * b[i];
    }
    return sum;
}

/* Let x (r,) be Phi x, of one group. */
static void back_alone(const Group *g, const double *q, double *x) {
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

/* Let the rows of one kernel, of so many lanes, each that far from the next, be Phi' times them. */
LOOPS_PART void kernel_onwards(int64_t size, const double *q, double *rows, int64_t lanes,
                               int64_t apart) {
    for (int64_t begin = 0; begin < lanes; begin += LANES) {
        for (int64_t j = 0; j < size; j++) {
            Lanes sum = {0.0};
            for (int64_t i = 0; i < size - j; i++) {
                sum += q[i] * *(const Lanes *)(rows + (i + j) * apart + begin);
            }
            *(Lanes *)(rows + j * apart + begin) += sum;
        }
    }
}

/* The same of all r rows; with the usual sizes as constants, so that what is in it is unrolled. */
LOOPS_PART void rows_onwards(const Group *g, const double *q, double *rows, int64_t lanes) {
    for (int64_t k = 0; k < g->kernels; q += g->sizes[k], rows += g->sizes[k++] * g->lanes) {
        switch (g->sizes[k]) {
        case 1: kernel_onwards(1, q, rows, lanes, g->lanes); break;
        case 2: kernel_onwards(2, q, rows, lanes, g->lanes); break;
        case 3: kernel_onwards(3, q, rows, lanes, g->lanes); break;
        case 4: kernel_onwards(4, q, rows, lanes, g->lanes); break;
        default: kernel_onwards(g->sizes[k], q, rows, lanes, g->lanes);
        }
    }
}

/* Let the state [N M] be [Phi' N, Phi' M Phi], as Phi' (Phi' M)'. */
LOOPS_PART void predict(const Group *g, const double *q, double *state) {
    double *m = state + g->begin;
    rows_onwards(g, q, state, g->lanes);
    for (int64_t i = 0; i < g->rank; i++) {
        for (int64_t j = 0; j < i; j++) {
            const double kept = m[i * g->lanes + j];
            m[i * g->lanes + j] = m[j * g->lanes + i];
            m[j * g->lanes + i] = kept;
        }
    }
    rows_onwards(g, q, m, g->lanes - g->begin);
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
 * prior; times (count,); rows (G, room, row), spans (G, room / SPAN, r, lanes), state (G, r, lanes)
 * after the sample before the first one, overwritten; seen (lanes,) to work with; values (count, G,
 * c), noise (count, G).
 *
 * The sums are A = information + g' g, g' z and q = tr z' z - |g' z|^2 / A; e^2 and d, what q and
 * log det K + log A are more than before. */
LOOPS_WIDE
int factor_add(const int64_t *sizes, const double *first_past, int64_t kernels,
               const double *constants, int64_t groups, int64_t coordinates,
               const double *information, const double *times, int64_t first, int64_t count,
               int64_t room, double *rows, double *spans, double *state, double *seen,
               const double *values, const double *noise) {
    const Factor all = {sizes, first_past, constants, kernels, groups, coordinates, room,
                        times, rows,       spans};
    for (int64_t number = 0; number < groups; number++) {
        const Group g = group_of(&all, number);
        const int64_t size = g.rank * g.lanes;
        double *own = state + number * size, *of = rows + number * room * g.row;
        for (int64_t n = first; n < count; n++) {
            const Row row = row_of(&g, of, n), before = row_of(&g, of, n ? n - 1 : 0);
            const int64_t place = n * groups + number;
            if (n > 0) {
                transition(&g, times[n] - times[n - 1], row.q);
                predict(&g, row.q, own);
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

/* v' [g z] and v' v of queries, of the process and, of two kinds, of its motion's derivative.
 *
 * As in factor_add; of queries at asked (a,), given the first counts (a,) >= 1 samples, found
 * (kinds, G, a, 1 + c) and explained (kinds, G, a). work: for a Room of `most` samples, the largest
 * count. */
LOOPS_WIDE
int factor_products(const int64_t *sizes, const double *first_past, int64_t kernels,
                    const double *constants, int64_t groups, int64_t coordinates,
                    const double *times, const double *rows, const double *spans, int64_t room,
                    const double *asked, const int64_t *counts, int64_t queries, int64_t kinds,
                    double *found, double *explained, int64_t most, double *work) {
    const Factor of = {sizes, first_past, constants, kernels, groups, coordinates, room,
                       times, rows,       spans};
    for (int64_t first = 0; first < kinds * groups; first += LANES) {
        const Pairs pairs = pairs_of(&of, first, kinds);
        const Room space = room_in(work, most, pairs.groups);
        for (int64_t i = 0; i < queries; i++) {
            products(&pairs, asked[i], counts[i], &space);
            for (int64_t l = 0; l < LANES && first + l < kinds * groups; l++) {
                const int64_t place = (first + l) * queries + i;
                explained[place] = (*space.explained)[l];
                for (int64_t j = 0; j <= coordinates; j++) {
                    found[place * (1 + coordinates) + j] = space.found[j][l];
                }
            }
        }
    }
    return 0;
}

/* All of v of queries, white (G, a, size), zeros from row counts (a,) on; as factor_products. */
LOOPS_WIDE
int factor_whitened(const int64_t *sizes, const double *first_past, int64_t kernels,
                    const double *constants, int64_t groups, int64_t coordinates,
                    const double *times, const double *rows, const double *spans, int64_t room,
                    const double *asked, const int64_t *counts, int64_t queries, double *white,
                    int64_t size, int64_t most, double *work) {
    const Factor of = {sizes, first_past, constants, kernels, groups, coordinates, room,
                       times, rows,       spans};
    for (int64_t first = 0; first < groups; first += LANES) {
        const Pairs pairs = pairs_of(&of, first, 1);
        const Room space = room_in(work, most, pairs.groups);
        for (int64_t i = 0; i < queries; i++) {
            int64_t n = whiten(&pairs, asked[i], counts[i], &space);
            while (n-- > 0) {
                step_back(&pairs, n, space.v + n, space.f, space.q);
            }
            for (int64_t l = 0; l < LANES && first + l < groups; l++) {
                double *v = white + ((first + l) * queries + i) * size;
                for (n = 0; n < size; n++) {
                    v[n] = n < counts[i] ? space.v[n][l] : 0.0;
                }
            }
        }
    }
    return 0;
}

/* Let each right side (G, a, size), zero from row counts (a,) on, be L^-T times it.
 *
 * s (r,) to work with. */
int factor_weights(const int64_t *sizes, const double *first_past, int64_t kernels,
                   const double *constants, int64_t groups, int64_t coordinates,
                   const double *rows, int64_t room, const int64_t *counts, int64_t queries,
                   double *right, int64_t size, double *s) {
    const Factor of = {sizes, first_past, constants, kernels, groups, coordinates, room,
                       NULL,  rows,       NULL};
    for (int64_t i = 0; i < groups * queries; i++) {
        const Group g = group_of(&of, i / queries);
        double *x = right + i * size;
        fill(s, g.rank, 0.0);
        for (int64_t n = counts[i % queries] - 1; n >= 0; n--) {
            const double *row = rows + (i / queries * room + n) * g.row;
            x[n] = (x[n] - dot(row + g.w, s, g.rank)) / row[g.l];
            for (int64_t k = 0, j = 0; k < g.kernels; j += g.sizes[k++]) {
                s[j] += g.variances[k] * x[n];
            }
            back_alone(&g, row + g.q, s);
        }
    }
    return 0;
}
