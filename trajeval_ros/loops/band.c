/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The regression of an estimate's error on its process (docs/error_model.md, The likelihood), with
 * m = 6 k states a pose: k components, each of translation and rotation, each on three axes.
 *
 *     z_i = s_i[:6] + K_i theta + r_i,  r_i ~ N(0, R_i);  s_(i+1) = F_i s_i + w_i,  w_i ~ N(0, Q_i)
 *
 * Kalman's filter of the columns [K | z], and the smoother of its disturbances (de Jong). With P the
 * covariance of s_i before pose i is seen, H = [1 0], S = R + H P H' = U' U and G = P H' S^-1,
 *
 *     W = U^-T ([K | z] - H x),  x <- x + G U' W,  C = (1 - G H) P,  then  x <- F x,  P <- F C F' + Q
 *
 * and back, from r = 0 and N = 0 after the last,  b = F' r,  B = F' N F,
 *
 *     u = R^-1 (residual) = U^-1 W - G' b,  r <- b + H' u,  N <- (1 - G H)' B (1 - G H) + H' S^-1 H
 *
 * where r is Q^-1 w of the step that leads to pose i, and N the variance of that score. A first
 * position that is flat is as the first pose says, S^-1 = 0. Neither Q nor what grows with it is
 * inverted, and no variance of a pose is a difference: digits stay however small R or Q is.
 *
 * Lanes are columns, as many as a multiple of LANES, zero beyond those asked for; so a sum over
 * poses or states adds lane by lane, in one order.
 */
#include <float.h>
#include <string.h>

#include "loops.h"

#define AXES 3
#define POSE 6        /* rows of an error: translation, rotation */
#define COMPONENTS 2  /* k at the most */
#define STATES (POSE * COMPONENTS)
#define LANES 4
#define MOST_LANES 32
#define PADDED 8      /* POSE, as a multiple of LANES */
#define PARAMETERS 4  /* of one group, at the most */
#define TOGETHER 10   /* poses whose products are summed at once */
#define BOTH (2 * PARAMETERS)

/* Before what is short is unrolled, it is vectorised. */
#if defined(__GNUC__) && !defined(__clang__)
#define ROLLED _Pragma("GCC unroll 1")
#else
#define ROLLED
#endif

/* One step of the process: F and Q of each group, (2, k, k), and what the position goes. */
typedef struct {
    double move[2][COMPONENTS][COMPONENTS];
    double noise[2][COMPONENTS][COMPONENTS];
    double travel[AXES];
} Step;

/* Of arrays (2, k, k, n), n steps. */
LOOPS_PART void load(const double *values, int64_t i, int64_t n, int64_t k,
                     double into[2][COMPONENTS][COMPONENTS])
{
    for (int64_t g = 0; g < 2; g++)
        for (int64_t c = 0; c < k; c++)
            for (int64_t d = 0; d < k; d++)
                into[g][c][d] = values[((g * k + c) * k + d) * n + i];
}

/* The row of a component's state of a group on an axis. */
LOOPS_PART int64_t row_of(int64_t c, int64_t g, int64_t axis)
{
    return POSE * c + AXES * g + axis;
}

LOOPS_PART void add(double *restrict row, double factor, const double *restrict other,
                    int64_t width)
{
    ROLLED
    for (int64_t l = 0; l < width; l++)
        row[l] += factor * other[l];
}

LOOPS_PART void take(double *restrict row, double factor, const double *restrict other,
                     int64_t width)
{
    ROLLED
    for (int64_t l = 0; l < width; l++)
        row[l] -= factor * other[l];
}

LOOPS_PART void times(double *row, double factor, int64_t width)
{
    ROLLED
    for (int64_t l = 0; l < width; l++)
        row[l] *= factor;
}

/* x' y of vectors as long as a multiple of LANES. */
LOOPS_PART double product(const double *x, const double *y, int64_t width)
{
    double part[LANES] = {0.0};
    for (int64_t l = 0; l < width; l += LANES)
        for (int64_t lane = 0; lane < LANES; lane++)
            part[lane] += x[l + lane] * y[l + lane];
    return (part[0] + part[1]) + (part[2] + part[3]);
}

/* x' y of any vectors. */
LOOPS_PART double dot(const double *x, const double *y, int64_t n)
{
    const int64_t whole = n - n % LANES;
    double sum = product(x, y, whole);
    for (int64_t l = whole; l < n; l++)
        sum += x[l] * y[l];
    return sum;
}

/* The logarithm of a product, of many factors at once. */
typedef struct {
    double product, sum;
} Logarithm;

LOOPS_PART void multiply(Logarithm *of, double factor)
{
    if (!(factor > 1e-200 && factor < 1e200)) {
        of->sum += log(factor);
        return;
    }
    of->product *= factor;
    if (!(of->product > 1e-100 && of->product < 1e100)) {
        of->sum += log(of->product);
        of->product = 1.0;
    }
}

static double logarithm(const Logarithm *of)
{
    return of->sum + log(of->product);
}

/* What becomes of a row: the sum of others' shares, or that more or less. */
typedef enum { SET, ADD, TAKE } How;

/* Into a row (width) goes the sum over q < n of shares[q * apart] times row q of b, whose rows are
 * ``wide`` apart; sums stay in registers. */
LOOPS_PART void combine(How how, double *row, const double *shares, int64_t apart,
                        const double *b, int64_t wide, int64_t n, int64_t width)
{
    const Lanes none = {0.0};
    int64_t l = 0;
    for (; l + 3 * LANES <= width; l += 3 * LANES) {
        Lanes *to = (Lanes *)(row + l), *to1 = (Lanes *)(row + l + LANES);
        Lanes *to2 = (Lanes *)(row + l + 2 * LANES);
        Lanes sum = how == SET ? none : *to, sum1 = how == SET ? none : *to1;
        Lanes sum2 = how == SET ? none : *to2;
        for (int64_t q = 0; q < n; q++) {
            const double share = shares[q * apart], *from = b + q * wide + l;
            const Lanes part = share * *(const Lanes *)from;
            const Lanes part1 = share * *(const Lanes *)(from + LANES);
            const Lanes part2 = share * *(const Lanes *)(from + 2 * LANES);
            sum = how == TAKE ? sum - part : sum + part;
            sum1 = how == TAKE ? sum1 - part1 : sum1 + part1;
            sum2 = how == TAKE ? sum2 - part2 : sum2 + part2;
        }
        *to = sum;
        *to1 = sum1;
        *to2 = sum2;
    }
    for (; l + LANES <= width; l += LANES) {
        Lanes *to = (Lanes *)(row + l), sum = how == SET ? none : *to;
        for (int64_t q = 0; q < n; q++) {
            const Lanes part = shares[q * apart] * *(const Lanes *)(b + q * wide + l);
            sum = how == TAKE ? sum - part : sum + part;
        }
        *to = sum;
    }
    for (l = width - width % LANES; l < width; l++) {
        double sum = how == SET ? 0.0 : row[l];
        for (int64_t q = 0; q < n; q++) {
            const double part = shares[q * apart] * b[q * wide + l];
            sum = how == TAKE ? sum - part : sum + part;
        }
        row[l] = sum;
    }
}

/* [A | B] (m, width) -> [U | U^-T B] in place, U' U = A; 1 where A is not positive definite. */
LOOPS_PART int eliminate(double *rows, int64_t m, int64_t width, Logarithm *determinant)
{
    for (int64_t j = 0; j < m; j++) {
        double *row = rows + j * width;
        const int64_t from = j - j % LANES; /* what is before is nothing in the end */
        combine(TAKE, row + from, rows + j, width, rows + from, width, j, width - from);
        double pivot = row[j];
        if (!(pivot > 0.0 && pivot <= DBL_MAX))
            return 1;
        multiply(determinant, pivot);
        double scale = 1.0 / sqrt(pivot);
        for (int64_t l = 0; l < j; l++)
            row[l] = 0.0;
        times(row, scale, width);
    }
    return 0;
}

/* U^-1 B of B (m, width) in place; U (m, m) upper, its rows ``stride`` apart. */
LOOPS_PART void substitute(const double *u, int64_t stride, double *b, int64_t m, int64_t width)
{
    for (int64_t r = m - 1; r >= 0; r--) {
        double *row = b + r * width;
        combine(TAKE, row, u + r * stride + r + 1, 1, row + width, width, m - 1 - r, width);
        times(row, 1.0 / u[r * stride + r], width);
    }
}

/* U^-T B of B (m, width) in place; U (m, m) upper, its rows ``stride`` apart. */
LOOPS_PART void substitute_forward(const double *u, int64_t stride, double *b, int64_t m,
                                   int64_t width)
{
    for (int64_t r = 0; r < m; r++) {
        combine(TAKE, b + r * width, u + r, stride, b, width, r, width);
        times(b + r * width, 1.0 / u[r * stride + r], width);
    }
}

/* A B of A (m, n), its rows ``stride`` apart, and B (n, width). */
LOOPS_PART void multiplied(const double *a, int64_t stride, const double *b, double *into,
                           int64_t m, int64_t n, int64_t width)
{
    for (int64_t r = 0; r < m; r++)
        combine(SET, into + r * width, a + r * stride, 1, b, width, n, width);
}

/* What round-off makes of a symmetric matrix (m, m) is made one again. */
LOOPS_PART void symmetrise(double *a, int64_t m)
{
    for (int64_t r = 0; r < m; r++)
        for (int64_t q = 0; q < r; q++)
            a[r * m + q] = a[q * m + r] = 0.5 * (a[r * m + q] + a[q * m + r]);
}

/* F A of A (m, width) in place, F of a group being upper triangular; headings, rows 3 to 5, turn what
 * the position goes. */
LOOPS_PART void move(const Step *step, double *a, int64_t k, int64_t width)
{
    for (int64_t r = 0; r < POSE; r++) {
        const int64_t g = r / AXES, y = (r + 1) % AXES, z = (r + 2) % AXES;
        double *const row = a + r * width;
        const double own = step->move[g][0][0], of_y = step->travel[y], of_z = step->travel[z];
        const double *const heading_y = a + (AXES + y) * width;
        const double *const heading_z = a + (AXES + z) * width;
        if (own != 1.0)
            times(row, own, width);
        if (k > 1)
            add(row, step->move[g][0][1], a + (POSE + r) * width, width);
        if (g > 0)
            continue;
        ROLLED
        for (int64_t l = 0; l < width; l++)
            row[l] += of_z * heading_y[l] - of_y * heading_z[l];
    }
    for (int64_t r = 0; r < POSE && k > 1; r++)
        times(a + (POSE + r) * width, step->move[r / AXES][1][1], width);
}

/* F' A of A (m, width) in place. */
LOOPS_PART void move_back(const Step *step, double *a, int64_t k, int64_t width)
{
    for (int64_t r = 0; r < POSE && k > 1; r++) {
        times(a + (POSE + r) * width, step->move[r / AXES][1][1], width);
        add(a + (POSE + r) * width, step->move[r / AXES][0][1], a + r * width, width);
    }
    for (int64_t x = 0; x < AXES; x++) {
        const int64_t y = (x + 1) % AXES, z = (x + 2) % AXES;
        double *const row = a + (AXES + x) * width;
        const double *const of_y = a + y * width, *const of_z = a + z * width;
        const double own = step->move[1][0][0], to_y = step->travel[y], to_z = step->travel[z];
        ROLLED
        for (int64_t l = 0; l < width; l++)
            row[l] = own * row[l] + (to_y * of_z[l] - to_z * of_y[l]);
    }
    for (int64_t x = 0; x < AXES && step->move[0][0][0] != 1.0; x++)
        times(a + x * width, step->move[0][0][0], width);
}

/* What `move` and `move_back` take of columns, of the state's own and of another: (m) each. */
LOOPS_PART void shares_of(const Step *step, double *own, double *other, int64_t k)
{
    for (int64_t r = 0; r < POSE; r++) {
        own[r] = step->move[r / AXES][0][0];
        own[POSE + r] = k > 1 ? step->move[r / AXES][1][1] : 0.0;
        other[r] = k > 1 ? step->move[r / AXES][0][1] : 0.0;
    }
}

/* A F' of A (m, m) in place. */
LOOPS_PART void move_columns(const Step *step, double *a, int64_t k)
{
    const int64_t m = POSE * k;
    const double *const t = step->travel;
    double own[2 * POSE], other[POSE];
    shares_of(step, own, other, k);
    for (int64_t r = 0; r < m; r++) {
        double *const row = a + r * m;
        const double turned[AXES] = {t[2] * row[4] - t[1] * row[5], t[0] * row[5] - t[2] * row[3],
                                     t[1] * row[3] - t[0] * row[4]};
        for (int64_t q = 0; q < POSE; q++)
            row[q] = own[q] * row[q] + (k > 1 ? other[q] * row[POSE + q] : 0.0);
        for (int64_t q = POSE; q < m; q++)
            row[q] *= own[q];
        for (int64_t x = 0; x < AXES; x++)
            row[x] += turned[x];
    }
}

/* A F of A (m, m) in place. */
LOOPS_PART void move_columns_back(const Step *step, double *a, int64_t k)
{
    const int64_t m = POSE * k;
    const double *const t = step->travel;
    double own[2 * POSE], other[POSE];
    shares_of(step, own, other, k);
    for (int64_t r = 0; r < m; r++) {
        double *const row = a + r * m;
        const double turned[AXES] = {t[1] * row[2] - t[2] * row[1], t[2] * row[0] - t[0] * row[2],
                                     t[0] * row[1] - t[1] * row[0]};
        for (int64_t q = POSE; q < m; q++)
            row[q] = own[q] * row[q] + other[q - POSE] * row[q - POSE];
        for (int64_t q = 0; q < POSE; q++)
            row[q] *= own[q];
        for (int64_t x = 0; x < AXES; x++)
            row[AXES + x] += turned[x];
    }
}

/* Add P, (2, k, k) on each axis, to rows (m, m) that are ``width`` apart. */
LOOPS_PART void add_groups(double p[2][COMPONENTS][COMPONENTS], double *rows, int64_t k,
                           int64_t width)
{
    for (int64_t c = 0; c < k; c++)
        for (int64_t d = 0; d < k; d++)
            for (int64_t g = 0; g < 2; g++)
                for (int64_t x = 0; x < AXES; x++)
                    rows[row_of(c, g, x) * width + row_of(d, g, x)] += p[g][c][d];
}

/* F a of a vector a (m), in one row. */
LOOPS_PART double moved_of(const Step *step, const double *a, int64_t d, int64_t g, int64_t x,
                           int64_t k)
{
    double sum = 0.0;
    for (int64_t e = 0; e < k; e++)
        sum += step->move[g][d][e] * a[row_of(e, g, x)];
    if (d == 0 && g == 0) {
        int64_t y = (x + 1) % AXES, z = (x + 2) % AXES;
        sum += step->travel[z] * a[AXES + y] - step->travel[y] * a[AXES + z];
    }
    return sum;
}

/* The system, of N poses (`System` in error_model/system.py). */
typedef struct {
    const double *covariance; /* V, (N, 6, 6) */
    const double *jitter;     /* variances beside it, (N, 2) */
    const double *nuisances;  /* (N, 6, c) */
    const double *gauge;      /* (N, 6, d) */
    const double *errors;     /* (N, 6) */
    const double *moves;      /* F, (2, k, k, N - 1) */
    const double *noise;      /* Q, (2, k, k, N - 1) */
    const double *prior;      /* the precision of the first states, (2, k, k) */
    const double *travel;     /* (N - 1, 3) */
    int64_t count, c, d;
} System;

LOOPS_PART Step step_of(const System *system, int64_t i, int64_t k)
{
    Step step;
    load(system->moves, i, system->count - 1, k, step.move);
    load(system->noise, i, system->count - 1, k, step.noise);
    memcpy(step.travel, system->travel + AXES * i, sizeof step.travel);
    return step;
}

/* Whether the first position is flat. */
LOOPS_PART int is_flat(const System *system)
{
    return !(system->prior[0] > 0.0);
}

/* What is regressed of a pose, [K_i | gauge_i | z_i | 0] of (6, lanes), in rows ``width`` apart. */
LOOPS_PART void columns_of(const System *system, int64_t i, double *rows, int64_t lanes,
                           int64_t width)
{
    int64_t c = system->c, d = system->d;
    for (int64_t r = 0; r < POSE; r++) {
        double *row = rows + r * width;
        memcpy(row, system->nuisances + (POSE * i + r) * c, sizeof(double) * (size_t)c);
        memcpy(row + c, system->gauge + (POSE * i + r) * d, sizeof(double) * (size_t)d);
        row[c + d] = system->errors[POSE * i + r];
        for (int64_t l = c + d + 1; l < lanes; l++)
            row[l] = 0.0;
    }
}

/* R_i = V_i + J_i in rows that are ``width`` apart. */
LOOPS_PART void noise_of(const System *system, int64_t i, double *rows, int64_t width)
{
    for (int64_t r = 0; r < POSE; r++) {
        memcpy(rows + r * width, system->covariance + (POSE * i + r) * POSE, sizeof(double) * POSE);
        rows[r * width + r] += system->jitter[2 * i + r / AXES];
    }
}

/* What is kept of a pose, as numbers from its begin. */
typedef struct {
    int64_t root;     /* U, (6, 6) */
    int64_t gain;     /* U^-T H P, (6, m) */
    int64_t white;    /* W, (6, lanes) */
    int64_t known;    /* C of the velocities, (6, 6) */
    int64_t velocity; /* x of them, (6, lanes) */
    int64_t size;
} Places;

LOOPS_PART Places places_of(int64_t k, int64_t lanes)
{
    Places at = {.gain = POSE * POSE};
    at.white = at.gain + POSE * POSE * k;
    at.known = at.white + POSE * lanes;
    at.velocity = at.known + (k > 1 ? POSE * POSE : 0);
    at.size = at.velocity + (k > 1 ? POSE * lanes : 0);
    return at;
}

/* The size of what is kept of a pose. */
int64_t band_size(int64_t k, int64_t lanes)
{
    return places_of(k, lanes).size;
}

/* P of the first states, what is flat of them left out, (m, m). */
LOOPS_PART void first_known(const System *system, double *known, int64_t k)
{
    double prior[2][COMPONENTS][COMPONENTS];
    load(system->prior, 0, 1, k, prior);
    for (int64_t g = 0; g < 2; g++)
        for (int64_t c = 0; c < k; c++)
            prior[g][c][c] = prior[g][c][c] > 0.0 ? 1.0 / prior[g][c][c] : 0.0;
    memset(known, 0, sizeof(double) * (size_t)(POSE * k * POSE * k));
    add_groups(prior, known, k, POSE * k);
}

/* What is known of the states, P -> C and x, with a pose; gain = U^-T H P. */
LOOPS_PART void update(const double *noise, const double *root, const double *gain,
                       const double *white, double *known, double *x, int64_t k, int64_t lanes)
{
    const int64_t m = POSE * k;
    double g[POSE * STATES], seen[POSE * STATES];
    for (int64_t r = 0; r < m; r++)
        combine(ADD, x + r * lanes, gain + r, m, white, lanes, POSE, lanes);
    /* H C = R G', no difference; of what the pose does not see, C = P - gain' gain. */
    memcpy(g, gain, sizeof(double) * (size_t)(POSE * m));
    substitute(root, POSE, g, POSE, m);
    multiplied(noise, POSE, g, seen, POSE, POSE, m);
    for (int64_t r = POSE; r < m; r++)
        combine(TAKE, known + r * m + POSE, gain + r, m, gain + POSE, m, POSE, m - POSE);
    for (int64_t r = 0; r < POSE; r++) {
        for (int64_t q = 0; q < POSE; q++)
            known[r * m + q] = 0.5 * (seen[r * m + q] + seen[q * m + r]);
        for (int64_t q = POSE; q < m; q++)
            known[r * m + q] = known[q * m + r] = seen[r * m + q];
    }
}

/* The states one step on: F C F' + Q and F x. */
LOOPS_PART void predict(const Step *step, double *known, double *x, int64_t k, int64_t lanes)
{
    const int64_t m = POSE * k;
    double noise[2][COMPONENTS][COMPONENTS];
    move(step, known, k, m);
    move_columns(step, known, k);
    memcpy(noise, step->noise, sizeof noise);
    add_groups(noise, known, k, m);
    symmetrise(known, m);
    move(step, x, k, lanes);
}

/* The upper triangle of normal (lanes, lanes), and what is beside its diagonal, grows by the products
 * of rows (n, lanes) with themselves; LANES of its rows at a time, whose sums stay in registers. */
LOOPS_PART void add_products(const double *rows, double *normal, int64_t n, int64_t lanes)
{
    for (int64_t first = 0; first < lanes; first += LANES) {
        const int64_t wide = (lanes - first) / LANES;
        Lanes sums[LANES][MOST_LANES / LANES];
        for (int64_t l = 0; l < LANES; l++)
            for (int64_t m = 0; m < wide; m++)
                sums[l][m] = *(Lanes *)(normal + (first + l) * lanes + first + LANES * m);
        for (int64_t i = 0; i < n; i++) {
            const double *const row = rows + i * lanes + first;
            for (int64_t l = 0; l < LANES; l++)
                for (int64_t m = 0; m < wide; m++)
                    sums[l][m] += row[l] * *(const Lanes *)(row + LANES * m);
        }
        for (int64_t l = 0; l < LANES; l++)
            for (int64_t m = 0; m < wide; m++)
                *(Lanes *)(normal + (first + l) * lanes + first + LANES * m) = sums[l][m];
    }
}

LOOPS_PART int filter(const System *system, double *kept, double *normal, double *log_det,
                      int64_t room, int64_t k, int64_t lanes)
{
    const int64_t m = POSE * k, begin = PADDED + (k > 1 ? STATES : PADDED), width = begin + lanes;
    const Places at = places_of(k, lanes);
    double known[STATES * STATES], x[STATES * MOST_LANES] = {0.0}, noise[POSE * POSE];
    double rows[POSE * (PADDED + STATES + MOST_LANES)], white_rows[TOGETHER * POSE * MOST_LANES];
    int64_t together = 0;
    Logarithm determinant = {1.0, 0.0};
    first_known(system, known, k);
    memset(normal, 0, sizeof(double) * (size_t)(lanes * lanes));
    for (int64_t i = 0; i < system->count; i++) {
        double *pose = kept + i % room * at.size, *white = pose + at.white;
        noise_of(system, i, noise, POSE);
        columns_of(system, i, rows + begin, lanes, width);
        if (i == 0 && is_flat(system)) {
            memset(pose, 0, sizeof(double) * (size_t)at.size);
            for (int64_t r = 0; r < POSE; r++) {
                memcpy(known + r * m, noise + r * POSE, sizeof noise / POSE);
                memcpy(x + r * lanes, rows + r * width + begin,
                       sizeof(double) * (size_t)lanes);
            }
        } else {
            /* [H P H' + R | H P | K - H x] -> [U | gain | W] */
            for (int64_t r = 0; r < POSE; r++) {
                double *row = rows + r * width;
                for (int64_t q = 0; q < POSE; q++)
                    row[q] = known[r * m + q] + noise[r * POSE + q];
                row[POSE] = row[POSE + 1] = 0.0;
                memcpy(row + PADDED, known + r * m, sizeof(double) * (size_t)m);
                for (int64_t q = PADDED + m; q < begin; q++)
                    row[q] = 0.0;
                take(row + begin, 1.0, x + r * lanes, lanes);
            }
            if (eliminate(rows, POSE, width, &determinant))
                return 1;
            for (int64_t r = 0; r < POSE; r++) {
                const double *row = rows + r * width;
                memcpy(pose + r * POSE, row, sizeof(double) * POSE);
                memcpy(pose + at.gain + r * m, row + PADDED, sizeof(double) * (size_t)m);
                memcpy(white + r * lanes, row + begin, sizeof(double) * (size_t)lanes);
            }
            memcpy(white_rows + together++ * POSE * lanes, white,
                   sizeof(double) * (size_t)(POSE * lanes));
            if (together == TOGETHER) {
                add_products(white_rows, normal, together * POSE, lanes);
                together = 0;
            }
            update(noise, pose, pose + at.gain, white, known, x, k, lanes);
        }
        if (k > 1)
            for (int64_t r = 0; r < POSE; r++) {
                memcpy(pose + at.known + r * POSE, known + (POSE + r) * m + POSE,
                       sizeof(double) * POSE);
                memcpy(pose + at.velocity + r * lanes, x + (POSE + r) * lanes,
                       sizeof(double) * (size_t)lanes);
            }
        if (i + 1 < system->count) {
            const Step step = step_of(system, i, k);
            predict(&step, known, x, k, lanes);
        }
    }
    add_products(white_rows, normal, together * POSE, lanes);
    for (int64_t l = 0; l < lanes; l++)
        for (int64_t q = 0; q < l; q++)
            normal[l * lanes + q] = normal[q * lanes + l];
    *log_det = logarithm(&determinant);
    return !(*log_det <= DBL_MAX && *log_det >= -DBL_MAX);
}

/* Loops of their own for the sizes that are met most. */
#define OF_SIZE(function, k, lanes, ...)                                  \
    ((k) == 1 && (lanes) == 12   ? function(__VA_ARGS__, 1, 12)           \
     : (k) == 1 && (lanes) == 16 ? function(__VA_ARGS__, 1, 16)           \
     : (k) == 2 && (lanes) == 12 ? function(__VA_ARGS__, 2, 12)           \
                                 : function(__VA_ARGS__, k, lanes))

#define SYSTEM                                                                                    \
    {covariance, jitter, nuisances, gauge, errors, moves, noise, prior, travel, count, c, d}

/* The filter.
 *
 * covariance .. d: the `System`. kept: of the last ``room`` poses, (room, `band_size`). normal: the
 * normal equations without the states, (lanes, lanes). log_det: of the covariance of the errors, of
 * which the first is left out where it is flat, (1).
 * Returns 1 where there is none.
 */
LOOPS_WIDE int band_filter(const double *covariance, const double *jitter, const double *nuisances,
                           const double *gauge, const double *errors, const double *moves,
                           const double *noise, const double *prior, const double *travel,
                           int64_t count, int64_t c, int64_t d, int64_t k, int64_t lanes,
                           int64_t room, double *kept, double *normal, double *log_det)
{
    const System system = SYSTEM;
    return OF_SIZE(filter, k, lanes, &system, kept, normal, log_det, room);
}

/* What all poses say, as `band_smooth` returns it. */
typedef struct {
    double *states, *scores, *felt, *of_poses, *of_steps, *crossed, *first;
} Told;

/* Going back: r and N of a step, and b and B of the pose that it begins at. */
typedef struct {
    double score[STATES * MOST_LANES];
    double spread[STATES * STATES];
} Later;

LOOPS_PART void pull_back(const Step *step, const Later *later, Later *back, int64_t k,
                          int64_t lanes)
{
    const int64_t m = POSE * k;
    memcpy(back->score, later->score, sizeof(double) * (size_t)(m * lanes));
    memcpy(back->spread, later->spread, sizeof(double) * (size_t)(m * m));
    move_back(step, back->score, k, lanes);
    move_back(step, back->spread, k, m);
    move_columns_back(step, back->spread, k);
    symmetrise(back->spread, m);
}

/* Rows of lanes, of which that of the errors becomes nothing. */
LOOPS_PART void without(const double *rows, double *into, int64_t count, int64_t lanes, int64_t at)
{
    memcpy(into, rows, sizeof(double) * (size_t)(count * lanes));
    for (int64_t r = 0; r < count; r++)
        into[r * lanes + at] = 0.0;
}

/* Of the scores of the step that begins at pose i. */
LOOPS_PART void tell_step(const Later *later, const Told *told, int64_t i, int64_t n, int64_t k,
                          int64_t lanes, int64_t at)
{
    const int64_t m = POSE * k, part = 2 * k * k * n;
    double columns[STATES * MOST_LANES];
    without(later->score, columns, m, lanes, at);
    for (int64_t r = 0; r < m; r++)
        told->felt[m * i + r] = later->score[r * lanes + at];
    for (int64_t g = 0; g < 2; g++)
        for (int64_t c = 0; c < k; c++)
            for (int64_t d = 0; d < k; d++) {
                double square = 0.0, spread = 0.0;
                for (int64_t x = 0; x < AXES; x++) {
                    const int64_t r = row_of(c, g, x), q = row_of(d, g, x);
                    square += later->score[r * lanes + at] * later->score[q * lanes + at];
                    spread += later->spread[r * m + q];
                    spread -= product(columns + r * lanes, columns + q * lanes, lanes);
                }
                double *into = told->of_steps + ((g * k + c) * k + d) * n + i;
                into[0] = square;
                into[part] = spread;
            }
}

/* And of these with the last component's states before, (6, lanes), whose covariance with all is
 * (6, m). */
LOOPS_PART void tell_crossed(const Step *step, const Later *later, const double *last,
                             const double *known, const Told *told, int64_t i, int64_t n,
                             int64_t k, int64_t lanes)
{
    const int64_t m = POSE * k;
    double moved[POSE * STATES];
    for (int64_t r = 0; r < POSE; r++)
        for (int64_t d = 0; d < k; d++)
            for (int64_t g = 0; g < 2; g++)
                for (int64_t x = 0; x < AXES; x++)
                    moved[r * m + row_of(d, g, x)] = moved_of(step, known + r * m, d, g, x, k);
    for (int64_t g = 0; g < 2; g++)
        for (int64_t c = 0; c < k; c++) {
            double crossed = 0.0;
            for (int64_t x = 0; x < AXES; x++) {
                const int64_t r = row_of(c, g, x), own = AXES * g + x;
                crossed += product(last + own * lanes, later->score + r * lanes, lanes);
                crossed -= dot(moved + own * m, later->spread + r * m, m);
            }
            told->crossed[(g * k + c) * n + i] = crossed;
        }
}

/* What is known of a group's last states at the first pose, over its axes. */
LOOPS_PART void tell_first(const Later *back, const double *last, const double *known,
                           const Told *told, int64_t k, int64_t lanes, int64_t at)
{
    const int64_t m = POSE * k;
    double columns[POSE * MOST_LANES], taken[POSE * STATES];
    without(last, columns, POSE, lanes, at);
    multiplied(known, m, back->spread, taken, POSE, m, m);
    for (int64_t g = 0; g < 2; g++) {
        double sum = 0.0;
        for (int64_t r = AXES * g; r < AXES * (g + 1); r++) {
            sum += known[r * m + m - POSE + r];
            sum += product(columns + r * lanes, columns + r * lanes, lanes);
            sum -= dot(taken + r * m, known + r * m, m);
        }
        told->first[g] = sum;
    }
}

/* The last component's states at pose i, (6, lanes), and their covariance with all that goes before
 * it, (6, m); of the pose itself H C = R G', and its states are what the noise leaves. */
LOOPS_PART void last_of(const System *system, const double *pose, const double *rows,
                        const double *noise, const double *residual, const double *score,
                        const Later *back, const double *ends, double *last, double *known,
                        int64_t i, int64_t k, int64_t lanes)
{
    const int64_t m = POSE * k, width = m + lanes + PADDED;
    const Places place = places_of(k, lanes);
    double seen[POSE * STATES] = {0.0};
    for (int64_t r = 0; r < POSE; r++) {
        if (i == 0 && is_flat(system)) {
            memcpy(seen + r * m, noise + r * PADDED, sizeof(double) * POSE);
            continue;
        }
        combine(SET, seen + r * m, noise + r * PADDED, 1, rows, width, POSE, m);
    }
    if (k == 1) {
        multiplied(residual, lanes, ends, last, POSE, lanes, lanes);
        for (int64_t r = 0; r < POSE; r++)
            combine(TAKE, last + r * lanes, noise + r * PADDED, 1, score, lanes, POSE, lanes);
        memcpy(known, seen, sizeof(double) * (size_t)(POSE * m));
        return;
    }
    multiplied(pose + place.velocity, lanes, ends, last, POSE, lanes, lanes);
    for (int64_t r = 0; r < POSE; r++) {
        for (int64_t q = 0; q < POSE; q++) {
            known[r * m + q] = seen[q * m + POSE + r];
            known[r * m + POSE + q] = pose[place.known + r * POSE + q];
        }
        combine(ADD, last + r * lanes, known + r * m, 1, back->score, lanes, m, lanes);
    }
}

LOOPS_PART void smooth(const System *system, const double *kept, const double *ends,
                       const Told *told, int64_t k, int64_t lanes)
{
    const int64_t m = POSE * k, width = m + lanes + PADDED, count = system->count;
    const int64_t at = system->c + system->d;
    /* Only of a process with a time F has a slope, and the first states have a prior. */
    const int timed = k > 1 || !is_flat(system);
    const Places place = places_of(k, lanes);
    double errors[MOST_LANES];
    Later both_ways[2], *later = both_ways, *back = both_ways + 1;
    memset(told->crossed, 0, sizeof(double) * (size_t)(2 * k * (count - 1)));
    memset(told->first, 0, sizeof(double) * 2);
    for (int64_t l = 0; l < lanes; l++)
        errors[l] = ends[l * lanes + at];
    for (int64_t i = count - 1; i >= 0; i--) {
        const double *pose = kept + i * place.size;
        const int flat = i == 0 && is_flat(system);
        double rows[POSE * (STATES + MOST_LANES + PADDED)], noise[POSE * PADDED] = {0.0};
        double score[POSE * MOST_LANES], columns[POSE * MOST_LANES], taken[POSE * STATES];
        double last[POSE * MOST_LANES], known[POSE * STATES], rest[POSE * STATES];
        double both[POSE * STATES], residual[POSE * MOST_LANES];
        Step step = {0};
        if (i + 1 < count) {
            step = step_of(system, i, k);
            pull_back(&step, later, back, k, lanes);
        } else {
            memset(back, 0, sizeof *back);
        }
        /* [G' | S^-1 nu | S^-1] */
        memset(rows, 0, sizeof(double) * (size_t)(POSE * width));
        for (int64_t r = 0; r < POSE; r++) {
            double *row = rows + r * width;
            if (flat) {
                row[r] = 1.0;
                continue;
            }
            memcpy(row, pose + place.gain + r * m, sizeof(double) * (size_t)m);
            combine(SET, row + m, pose + place.white + r * lanes, 1, ends, lanes, lanes, lanes);
            row[m + lanes + r] = 1.0;
            combine(TAKE, row + m + lanes, pose + r, POSE, rows + m + lanes, width, r, PADDED);
            times(row + m + lanes, 1.0 / pose[r * POSE + r], PADDED);
        }
        if (!flat)
            substitute(pose, POSE, rows, POSE, width);
        /* u, and its variance S^-1 + G' B G. */
        for (int64_t r = 0; r < POSE; r++) {
            const double *row = rows + r * width;
            memcpy(score + r * lanes, row + m, sizeof(double) * (size_t)lanes);
            combine(TAKE, score + r * lanes, row, 1, back->score, lanes, m, lanes);
        }
        multiplied(rows, width, back->spread, taken, POSE, m, m);
        without(score, columns, POSE, lanes, at);
        for (int64_t g = 0; g < 2; g++) {
            double square = 0.0, informed = 0.0;
            for (int64_t r = AXES * g; r < AXES * (g + 1); r++) {
                const double own = score[r * lanes + at];
                told->scores[POSE * i + r] = own;
                square += own * own;
                informed += rows[r * width + m + lanes + r];
                informed += dot(taken + r * m, rows + r * width, m);
                informed -= product(columns + r * lanes, columns + r * lanes, lanes);
            }
            told->of_poses[g * count + i] = square;
            told->of_poses[(2 + g) * count + i] = informed;
        }
        /* The states of the pose: what its noise leaves. */
        noise_of(system, i, noise, PADDED);
        columns_of(system, i, residual, lanes, lanes);
        for (int64_t r = 0; r < POSE; r++) {
            double state = product(residual + r * lanes, errors, lanes);
            for (int64_t q = 0; q < POSE; q++)
                state -= noise[r * PADDED + q] * score[q * lanes + at];
            told->states[m * i + r] = state;
        }
        if (timed) {
            last_of(system, pose, rows, noise, residual, score, back, ends, last, known, i, k,
                    lanes);
            if (k > 1)
                for (int64_t r = 0; r < POSE; r++)
                    told->states[m * i + POSE + r] = last[r * lanes + at];
            if (i + 1 < count)
                tell_crossed(&step, later, last, known, told, i, count - 1, k, lanes);
            if (i == 0)
                tell_first(back, last, known, told, k, lanes, at);
        }
        if (i + 1 < count)
            tell_step(later, told, i, count - 1, k, lanes, at);
        /* (1 - G H)': S^-1 R, and -G' of what is not seen. */
        for (int64_t r = 0; r < POSE; r++) {
            double row[PADDED];
            combine(SET, row, rows + r * width + m + lanes, 1, noise, PADDED, POSE, PADDED);
            memcpy(rest + r * m, row, sizeof(double) * POSE);
            for (int64_t q = POSE; q < m; q++)
                rest[r * m + q] = -rows[r * width + q];
        }
        multiplied(rest, m, back->spread, both, POSE, m, m);
        for (int64_t r = 0; r < POSE; r++) {
            add(back->score + r * lanes, 1.0, score + r * lanes, lanes);
            for (int64_t q = 0; q <= r; q++)
                back->spread[r * m + q] = back->spread[q * m + r] =
                    rows[r * width + m + lanes + q] + dot(both + r * m, rest + q * m, m);
            for (int64_t q = POSE; q < m; q++)
                back->spread[r * m + q] = back->spread[q * m + r] = both[r * m + q];
        }
        Later *const gone = later;
        later = back;
        back = gone;
    }
}

/* What the data say of the states and of the disturbances.
 *
 * kept: of all poses. ends: (lanes, lanes), a root of the covariance of theta and, in the lane of
 * the errors, (-theta, 1), beside which what is below is as of [K | z] ends.
 * states: (N, m). scores: u, (N, 6). felt: r of each step, (N - 1, m). Sums over the three axes of
 * each group: of_poses, (2, 2, N), the squares of u and the variance of u. of_steps, likewise of r:
 * (2, 2, k, k, N - 1). Of a process with a time, crossed: the products of the last component's
 * states with r, less their covariance, (2, k, N - 1); first: the variance of these states at the
 * first pose, (2); zero of another.
 */
LOOPS_WIDE int band_smooth(const double *covariance, const double *jitter, const double *nuisances,
                           const double *gauge, const double *errors, const double *moves,
                           const double *noise, const double *prior, const double *travel,
                           int64_t count, int64_t c, int64_t d, int64_t k, int64_t lanes,
                           const double *kept, const double *ends, double *states, double *scores,
                           double *felt, double *of_poses, double *of_steps, double *crossed,
                           double *first)
{
    const System system = SYSTEM;
    const Told told = {states, scores, felt, of_poses, of_steps, crossed, first};
    OF_SIZE(smooth, k, lanes, &system, kept, ends, &told);
    return 0;
}

/* Slopes by the parameters, of a group's steps. */
typedef struct {
    const double *noise;  /* (p, 2, k, k, n) */
    const double *move;   /* by the last, (2, k, k, n) */
    int64_t p, n;
} Slopes;

/* By the last parameter, how F's slope is felt at each pose and later, (N, 6). */
LOOPS_PART void adjoints(const System *system, const Slopes *slopes, const double *felt,
                         double *adjoint, int64_t k)
{
    const int64_t n = slopes->n, m = POSE * k;
    double move[2][COMPONENTS][COMPONENTS], slope[2][COMPONENTS][COMPONENTS];
    memset(adjoint + POSE * n, 0, sizeof(double) * POSE);
    for (int64_t i = n - 1; i >= 0; i--) {
        load(system->moves, i, n, k, move);
        load(slopes->move, i, n, k, slope);
        for (int64_t g = 0; g < 2; g++)
            for (int64_t x = 0; x < AXES; x++) {
                const int64_t own = AXES * g + x;
                double sum = move[g][k - 1][k - 1] * adjoint[POSE * (i + 1) + own];
                for (int64_t c = 0; c < k; c++)
                    sum += slope[g][c][k - 1] * felt[m * i + row_of(c, g, x)];
                adjoint[POSE * i + own] = sum;
            }
    }
}

/* What the states of the parameters' errors, (m, 8), become by the step that begins at pose i. */
LOOPS_PART void step_on(const Slopes *slopes, const Step *step, int64_t i, const double *states,
                        const double *felt, const double *adjoint, double *apart, int64_t k)
{
    const int64_t p = slopes->p, n = slopes->n, m = POSE * k;
    double slope[2][COMPONENTS][COMPONENTS];
    move(step, apart, k, BOTH);
    for (int64_t j = 1; j < p; j++) {
        load(slopes->noise + 2 * k * k * n * j, i, n, k, slope);
        for (int64_t g = 0; g < 2; g++)
            for (int64_t c = 0; c < k; c++)
                for (int64_t d = 0; d < k; d++)
                    for (int64_t x = 0; x < AXES; x++)
                        apart[row_of(c, g, x) * BOTH + PARAMETERS * g + j] +=
                            slope[g][c][d] * felt[m * i + row_of(d, g, x)];
    }
    load(slopes->move, i, n, k, slope);
    for (int64_t g = 0; g < 2; g++)
        for (int64_t c = 0; c < k; c++)
            for (int64_t x = 0; x < AXES; x++)
                apart[row_of(c, g, x) * BOTH + PARAMETERS * g + p - 1] +=
                    slope[g][c][k - 1] * states[m * i + row_of(k - 1, g, x)] +
                    step->noise[g][c][k - 1] * adjoint[POSE * (i + 1) + AXES * g + x];
}

LOOPS_PART void average(const System *system, const double *kept, const Slopes *slopes,
                        const double *states, const double *scores, const double *felt,
                        double *adjoint, double *found, double *ahead, int64_t k, int64_t lanes)
{
    const int64_t m = POSE * k, p = slopes->p;
    const Places place = places_of(k, lanes);
    double apart[STATES * BOTH] = {0.0}, seen[POSE * BOTH];
    double prior[2][COMPONENTS][COMPONENTS];
    adjoints(system, slopes, felt, adjoint, k);
    load(system->prior, 0, 1, k, prior);
    for (int64_t r = 0; r < POSE; r++) {
        const int64_t g = r / AXES;
        double *row = apart + (m - POSE + r) * BOTH + PARAMETERS * g;
        if (!(prior[g][k - 1][k - 1] > 0.0))
            continue;
        row[p - 2] = 2.0 * states[m - POSE + r];
        row[p - 1] = adjoint[r] / prior[g][k - 1][k - 1];
    }
    memset(found, 0, sizeof(double) * BOTH * BOTH);
    memset(ahead, 0, sizeof(double) * (size_t)(lanes * BOTH));
    for (int64_t i = 0; i < system->count; i++) {
        const double *pose = kept + i * place.size, *white = pose + place.white;
        memcpy(seen, apart, sizeof seen);
        for (int64_t r = 0; r < POSE; r++)
            seen[r * BOTH + PARAMETERS * (r / AXES)] +=
                2.0 * system->jitter[2 * i + r / AXES] * scores[POSE * i + r];
        if (i == 0 && is_flat(system)) {
            for (int64_t r = 0; r < POSE; r++)
                take(apart + r * BOTH, 1.0, seen + r * BOTH, BOTH);
        } else {
            substitute_forward(pose, POSE, seen, POSE, BOTH);
            for (int64_t j = 0; j < BOTH; j++)
                combine(ADD, found + j * BOTH, seen + j, BOTH, seen, BOTH, POSE, BOTH);
            for (int64_t l = 0; l < lanes; l++)
                combine(ADD, ahead + l * BOTH, white + l, lanes, seen, BOTH, POSE, BOTH);
            for (int64_t r = 0; r < m; r++)
                combine(TAKE, apart + r * BOTH, pose + place.gain + r, m, seen, BOTH, POSE, BOTH);
        }
        if (i + 1 < system->count) {
            const Step step = step_of(system, i, k);
            step_on(slopes, &step, i, states, felt, adjoint, apart, k);
        }
    }
}

/* Twice the average information before theta is integrated out (`Likelihood.average_information`):
 * q_j' P q_l of q_j = dV / dpsi_j P z, filtered as z is.
 *
 * kept, states, scores, felt: as above. slope_noise: of Q, (p, 2, k, k, N - 1). slope_moves: of F by
 * the last parameter, (2, k, k, N - 1). adjoint: work, (N, 6). found: (8, 8), the second group's
 * parameters from the fifth on. ahead: what it has to do with theta, (lanes, 8).
 */
LOOPS_WIDE int band_average(const double *covariance, const double *jitter, const double *nuisances,
                            const double *gauge, const double *errors, const double *moves,
                            const double *noise, const double *prior, const double *travel,
                            int64_t count, int64_t c, int64_t d, int64_t k, int64_t lanes,
                            const double *kept, const double *slope_noise,
                            const double *slope_moves, int64_t p, const double *states,
                            const double *scores, const double *felt, double *adjoint,
                            double *found, double *ahead)
{
    const System system = SYSTEM;
    const Slopes slopes = {slope_noise, slope_moves, p, count - 1};
    OF_SIZE(average, k, lanes, &system, kept, &slopes, states, scores, felt, adjoint, found, ahead);
    return 0;
}

/* Columns of positions (M, 3, c) less what those before predict, whitened: what each pose is beyond
 * a walk, or an Ornstein-Uhlenbeck process about nothing, the same along every axis.
 *
 * columns: (M, 3, width), of which the last c count. covariance: (M, 3, 3), and jitter, a variance,
 * beside it. gaps: (M - 1), s. size: the variance of a walk a second, time being 0, or of the
 * process. white: (M - 1, 3, c) of a walk, whose first position is free, and else (M, 3, c).
 * log_det: of what it is whitened by. Returns the number of the first pose, from 1 on, whose
 * covariance is not positive definite.
 */
LOOPS_WIDE int band_positions(const double *columns, const double *covariance, const double *gaps,
                              double *white, double *log_det, int64_t count, int64_t width,
                              int64_t c, double jitter, double size, double time)
{
    const int64_t begin = time > 0.0 ? 0 : 1, wide = 2 * AXES + c;
    double known[AXES * AXES] = {0.0}, states[AXES * MOST_LANES] = {0.0};
    double rows[AXES * (2 * AXES + MOST_LANES)];
    Logarithm determinant = {1.0, 0.0};
    for (int64_t i = 0; i < count; i++) {
        double keep = time > 0.0 && i > 0 ? exp(-gaps[i - 1] / time) : 1.0;
        double added = time > 0.0 ? size : 0.0;
        if (i > 0)
            added *= 1.0 - keep * keep;
        if (i > 0 && time <= 0.0)
            added = size * gaps[i - 1];
        for (int64_t r = 0; r < AXES; r++) {
            times(known + r * AXES, keep * keep, AXES);
            times(states + r * c, keep, c);
            known[r * AXES + r] += added;
        }
        for (int64_t r = 0; r < AXES; r++) {
            double *row = rows + r * wide;
            for (int64_t q = 0; q < AXES; q++) {
                row[q] = covariance[(AXES * i + r) * AXES + q] + known[r * AXES + q];
                row[AXES + q] = known[r * AXES + q];
            }
            row[r] += jitter;
            memcpy(row + 2 * AXES, columns + (AXES * i + r + 1) * width - c,
                   sizeof(double) * (size_t)c);
            take(row + 2 * AXES, 1.0, states + r * c, c);
        }
        if (i < begin) {
            for (int64_t r = 0; r < AXES; r++) {
                memcpy(known + r * AXES, rows + r * wide, sizeof(double) * AXES);
                memcpy(states + r * c, rows + r * wide + 2 * AXES, sizeof(double) * (size_t)c);
            }
            continue;
        }
        if (eliminate(rows, AXES, wide, &determinant))
            return (int)(i + 1);
        for (int64_t q = 0; q < AXES; q++) {
            const double *a = rows + q * wide + AXES, *new = a + AXES;
            memcpy(white + (AXES * (i - begin) + q) * c, new, sizeof(double) * (size_t)c);
            for (int64_t r = 0; r < AXES; r++) {
                take(known + r * AXES, a[r], a, AXES);
                add(states + r * c, a[r], new, c);
            }
        }
    }
    log_det[0] = logarithm(&determinant);
    return 0;
}
