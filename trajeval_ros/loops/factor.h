/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * A Cholesky factor K = L L' of samples as `factor.c` leaves it, and what queries need of it.
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
#ifndef TRAJEVAL_ROS_FACTOR_H
#define TRAJEVAL_ROS_FACTOR_H

#include "loops.h"

enum { LANES = 4, SPAN = 8 };
typedef double Lanes __attribute__((vector_size(8 * LANES), aligned(8), may_alias));

/* How many numbers each kernel has, (m,), and past(0), (r,); of one group, each kernel's rate, the
 * same where it is motion and 0 where it is noise, and its variance, (m,). */
typedef struct {
    const int64_t *sizes;
    const double *first_past, *rates, *slopes, *variances;
    int64_t kernels, rank, columns, begin, lanes; /* begin: of M in a state's row */
    int64_t l, sums, square, news, w, q, row;     /* where what is in a row; how long that is */
} Group;

int factor_add(const int64_t *sizes, const double *first_past, int64_t kernels,
               const double *constants, int64_t groups, int64_t coordinates,
               const double *information, const double *times, int64_t first, int64_t count,
               int64_t room, double *rows, double *spans, double *state, double *seen,
               const double *values, const double *noise);

/* The samples, taken, of G groups and c coordinates: sizes (m,), first_past (r,) and constants (G,
 * 3, m) as in Group; times (room,), rows (G, room, row), spans (G, room / SPAN, r, lanes). */
typedef struct {
    const int64_t *sizes;
    const double *first_past, *constants;
    int64_t kernels, groups, coordinates, room;
    const double *times, *rows, *spans;
} Factor;

static inline int64_t in_lanes(int64_t n) { return (n + LANES - 1) / LANES * LANES; }

static inline Group group_of(const Factor *of, int64_t number) {
    int64_t rank = 0;
    for (int64_t k = 0; k < of->kernels; k++) {
        rank += of->sizes[k];
    }
    const double *own = of->constants + number * 3 * of->kernels;
    const int64_t columns = 1 + of->coordinates, begin = in_lanes(columns);
    return (Group){
        .sizes = of->sizes,
        .first_past = of->first_past,
        .rates = own,
        .slopes = own + of->kernels,
        .variances = own + 2 * of->kernels,
        .kernels = of->kernels,
        .rank = rank,
        .columns = columns,
        .begin = begin,
        .lanes = begin + in_lanes(rank),
        .l = columns,
        .sums = columns + 1,
        .square = 2 * columns + 2,
        .news = 2 * columns + 3,
        .w = 2 * columns + 5,
        .q = 2 * columns + 5 + rank,
        .row = 2 * columns + 5 + 2 * rank,
    };
}

LOOPS_PART void fill(double *a, int64_t n, double value) {
    for (int64_t i = 0; i < n; i++) {
        a[i] = value;
    }
}

/* The powers (p,) of one kernel from that of order 0 on. */
LOOPS_PART void raise(double a, int64_t size, double *q) {
    for (int64_t j = 1; j < size; j++) {
        q[j] = q[j - 1] * (a / (double)j);
    }
}

/* Of a factor LANES pairs of a group and of what is asked of it, its value or its slope. */
typedef struct {
    Group groups[LANES]; /* what is no pointer is the same of all */
    const double *times, *rows[LANES], *spans[LANES], *variances[LANES];
    int64_t numbers[LANES];
    int slopes[LANES];
} Pairs;

/* To work with: v (most,), as many as there are samples, f, s and q (r,), found (1 + c,),
 * explained, seen (LANES, lanes) and own (r,); LANES (most + 4 r + 2 + c + lanes) numbers do. */
typedef struct {
    Lanes *v, *f, *s, *q, *found, *explained;
    double *seen, *own;
} Room;

static inline Room room_in(double *work, int64_t most, const Group *g) {
    Lanes *v = (Lanes *)work, *f = v + most, *s = f + g->rank, *q = s + g->rank;
    Lanes *found = q + g->rank, *explained = found + g->columns;
    double *seen = (double *)(explained + 1);
    return (Room){v, f, s, q, found, explained, seen, seen + LANES * g->lanes};
}

/* The pairs of k that are asked for and G groups, group after group, from the first on; the last
 * one again where there are no more. */
static inline Pairs pairs_of(const Factor *of, int64_t first, int64_t kinds) {
    Pairs found = {.times = of->times};
    for (int64_t l = 0; l < LANES; l++) {
        const int64_t last = kinds * of->groups - 1, i = first + l < last ? first + l : last;
        const int64_t number = i % of->groups;
        Group *g = found.groups + l;
        *g = group_of(of, number);
        found.numbers[l] = number;
        found.slopes[l] = i >= of->groups;
        found.variances[l] = g->variances;
        found.rows[l] = of->rows + number * of->room * g->row;
        found.spans[l] = of->spans + number * (of->room / SPAN) * g->rank * g->lanes;
    }
    return found;
}

/* Number i of each. */
LOOPS_PART void gather(const double *const from[LANES], int64_t i, Lanes *to) {
    *to = (Lanes){from[0][i], from[1][i], from[2][i], from[3][i]};
}

LOOPS_PART void gather_all(const double *const from[LANES], int64_t begin, int64_t n, Lanes *to) {
    for (int64_t i = 0; i < n; i++) {
        gather(from, begin + i, to + i);
    }
}

/* Of a sample. */
LOOPS_PART void rows_at(const Pairs *of, int64_t n, const double *at[LANES]) {
    for (int64_t l = 0; l < LANES; l++) {
        at[l] = of->rows[l] + n * of->groups[l].row;
    }
}

/* The powers (r,) of a time, or their derivatives; own (r,) to work with. */
LOOPS_PART void powers(const Pairs *of, double time, Lanes *to, double *own) {
    for (int64_t l = 0; l < LANES; l++) {
        const Group *g = of->groups + l;
        int64_t known = 0; /* the pair of the same group's value, whose powers these are, too */
        while (known < l && (of->numbers[known] != of->numbers[l] || of->slopes[known])) {
            known++;
        }
        double *q = own;
        for (int64_t k = 0, begin = 0; k < g->kernels; q += g->sizes[k], begin += g->sizes[k++]) {
            const int64_t size = g->sizes[k];
            q[0] = known < l ? to[begin][known] : exp(-g->rates[k] * time);
            raise(g->rates[k] * time, size, q);
            for (int64_t j = size - 1; of->slopes[l] && j > 0; j--) {
                q[j] = g->slopes[k] * (q[j - 1] - q[j]);
            }
            q[0] *= of->slopes[l] ? -g->slopes[k] : 1.0;
        }
        for (int64_t i = 0; i < g->rank; i++) {
            to[i][l] = own[i];
        }
    }
}

/* Let the numbers of one kernel be Phi' times them, of the powers q, or Phi times them. */
LOOPS_PART void kernel_moved(int64_t size, int back, const Lanes *q, Lanes *x) {
    for (int64_t n = 0; n < size; n++) {
        const int64_t j = back ? size - 1 - n : n;
        Lanes sum = {0.0};
        for (int64_t i = 0; i < (back ? j + 1 : size - j); i++) {
            sum += back ? q[j - i] * x[i] : q[i] * x[i + j];
        }
        x[j] += sum;
    }
}

/* The same of all x (r,); with the usual sizes as constants, so that what is in it is unrolled. */
LOOPS_PART void moved(const Group *g, int back, const Lanes *q, Lanes *x) {
    for (int64_t k = 0; k < g->kernels; q += g->sizes[k], x += g->sizes[k++]) {
        switch (g->sizes[k]) {
        case 1: kernel_moved(1, back, q, x); break;
        case 2: kernel_moved(2, back, q, x); break;
        case 3: kernel_moved(3, back, q, x); break;
        case 4: kernel_moved(4, back, q, x); break;
        default: kernel_moved(g->sizes[k], back, q, x);
        }
    }
}

/* Let v be w' f of a sample, of which f (r,) is the future after it, and f that before it; q (r,) to
 * work with. */
LOOPS_PART void step_back(const Pairs *of, int64_t n, Lanes *v, Lanes *f, Lanes *q) {
    const Group *g = of->groups;
    const double *at[LANES];
    Lanes sum = {0.0};
    rows_at(of, n, at);
    gather_all(at, g->w, g->rank, q);
    for (int64_t i = 0; i < g->rank; i++) {
        sum += q[i] * f[i];
    }
    *v = sum;
    gather_all(at, g->q, g->rank, q);
    moved(g, 1, q, f);
}

/* Let f (r,) be the future that has these powers. */
LOOPS_PART void future(const Pairs *of, const Lanes *q, Lanes *f) {
    const Group *g = of->groups;
    for (int64_t k = 0, i = 0; k < g->kernels; k++) {
        Lanes variance;
        gather(of->variances, k, &variance);
        for (const int64_t end = i + g->sizes[k]; i < end; i++) {
            f[i] = variance * q[i];
        }
    }
}

/* Take the past that has these powers from s (r,); as the time moves on, its slope is less. */
LOOPS_PART void take_past(const Pairs *of, const Lanes *q, Lanes *s) {
    const Group *g = of->groups;
    Lanes sign;
    for (int64_t l = 0; l < LANES; l++) {
        sign[l] = of->slopes[l] ? -1.0 : 1.0;
    }
    for (int64_t k = 0, begin = 0; k < g->kernels; begin += g->sizes[k++]) {
        for (int64_t i = begin, end = begin + g->sizes[k]; i < end; i++) {
            Lanes sum = {0.0};
            for (int64_t j = 0; j < end - i; j++) {
                sum += q[begin + j] * g->first_past[i + j];
            }
            s[i] -= sign * sum;
        }
    }
}

/* How many of the first `count` lie at a time or before it. */
LOOPS_PART int64_t samples_until(const double *times, int64_t count, double time) {
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

/* Write v of a query at a time, given the first `count` samples, from a row on, which is returned:
 * the begin of a span. Of the rows before it, f (r,) is the future of the query, or of its slope,
 * after the last, and seen f' [N M]. */
LOOPS_PART int64_t whiten(const Pairs *of, double time, int64_t count, const Room *room) {
    const Group *g = of->groups;
    Lanes *v = room->v, *f = room->f, *s = room->s, *q = room->q;
    const int64_t next = samples_until(of->times, count, time), begin = next / SPAN * SPAN;
    const double *at[LANES];
    if (next > 0) {
        powers(of, time - of->times[next - 1], q, room->own);
        future(of, q, f);
    }
    for (int64_t n = next - 1; n >= begin; n--) {
        step_back(of, n, v + n, f, q);
    }
    for (int64_t l = 0; l < LANES; l++) {
        double *seen = room->seen + l * g->lanes;
        const double *state = of->spans[l] + (begin / SPAN - 1) * g->rank * g->lanes;
        for (int64_t j = 0; j < g->lanes; j += LANES) {
            Lanes sum = {0.0};
            for (int64_t i = 0; begin > 0 && i < g->rank; i++) {
                sum += f[i][l] * *(const Lanes *)(state + i * g->lanes + j);
            }
            *(Lanes *)(seen + j) = sum;
        }
        at[l] = seen;
    }
    gather_all(at, g->begin, g->rank, s);
    for (int64_t n = begin; n < count; n++) {
        rows_at(of, n, at);
        gather_all(at, g->q, g->rank, q);
        moved(g, 0, q, s);
        if (n == next) {
            powers(of, of->times[n] - time, q, room->own);
            take_past(of, q, s);
        }
        if (n >= next) {
            Lanes sum = {0.0}, pivot;
            for (int64_t k = 0, i = 0; k < g->kernels; i += g->sizes[k++]) {
                Lanes variance;
                gather(of->variances, k, &variance);
                sum += variance * s[i];
            }
            gather(at, g->l, &pivot);
            v[n] = -sum / pivot;
        }
        gather_all(at, g->w, g->rank, q);
        for (int64_t i = 0; i < g->rank; i++) {
            s[i] += v[n] * q[i];
        }
    }
    return begin;
}

/* Let found (1 + c,) be v' [g z] of a query, and explained v' v; as whiten. */
LOOPS_PART void products(const Pairs *of, double time, int64_t count, const Room *room) {
    const Group *g = of->groups;
    const int64_t begin = whiten(of, time, count, room);
    const double *at[LANES];
    Lanes sum = {0.0}, one;
    for (int64_t l = 0; l < LANES; l++) {
        at[l] = room->seen + l * g->lanes;
    }
    gather_all(at, 0, g->columns, room->found);
    for (int64_t i = 0; begin > 0 && i < g->rank; i++) {
        gather(at, g->begin + i, &one);
        sum += one * room->f[i];
    }
    for (int64_t n = begin; n < count; n++) {
        rows_at(of, n, at);
        for (int64_t j = 0; j < g->columns; j++) {
            gather(at, j, &one);
            room->found[j] += room->v[n] * one;
        }
        sum += room->v[n] * room->v[n];
    }
    *room->explained = sum;
}

#endif
