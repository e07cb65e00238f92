/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The regression of an estimate's error on its process (docs/error_model.md, The likelihood), with
 * m = 6 k states a pose: k components, each of translation and rotation, each on three axes.
 *
 *     z_i = s_i[:6] + K_i theta + r_i,  r_i ~ N(0, R_i);  s_(i+1) = F_i s_i + w_i,  w_i ~ N(0, Q_i)
 *
 * The information of all states is block-tridiagonal, U' U with U_i on the diagonal and X_i beside
 * it. Going forwards, one elimination a pose does it all: of the rows [Lambda_i | B_i' | right],
 *
 *     [U_i | X_i | f_i] = U_i^-T [Lambda_i - X_(i-1)' X_(i-1) | B_i' | right_i - X_(i-1)' f_(i-1)].
 *
 * Lanes are columns of the right-hand side, as many as a multiple of LANES, zero beyond those asked
 * for; so a sum over poses or states adds lane by lane, in one order.
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
#define PARAMETERS 4  /* of one group, at the most */
#define BOTH (2 * PARAMETERS)

/* Before what is short is unrolled, it is vectorised. */
#if defined(__GNUC__) && !defined(__clang__)
#define ROLLED _Pragma("GCC unroll 1")
#else
#define ROLLED
#endif

/* One step of the process: F and Q^-1 of each group, (2, k, k), and what the position goes. */
typedef struct {
    double move[2][COMPONENTS][COMPONENTS];
    double precision[2][COMPONENTS][COMPONENTS];
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

LOOPS_PART Step step_of(const double *moves, const double *precision, const double *travel,
                        int64_t i, int64_t n, int64_t k)
{
    Step step;
    load(moves, i, n, k, step.move);
    load(precision, i, n, k, step.precision);
    memcpy(step.travel, travel + AXES * i, sizeof step.travel);
    return step;
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

/* The logarithm of a product, which overflows nowhere. */
typedef struct {
    double fraction;
    int64_t exponent;
} Logarithm;

LOOPS_PART void multiply(Logarithm *sum, double factor)
{
    int exponent;
    sum->fraction = frexp(sum->fraction * factor, &exponent);
    sum->exponent += exponent;
}

static double logarithm(const Logarithm *sum)
{
    return log(sum->fraction) + (double)sum->exponent * log(2.0);
}

/* [A | B] (m, width) -> [U | U^-T B] in place, U' U = A; 1 where A is not positive definite. */
LOOPS_PART int eliminate(double *rows, int64_t m, int64_t width, Logarithm *determinant)
{
    for (int64_t j = 0; j < m; j++) {
        double *row = rows + j * width;
        double pivot = row[j];
        if (!(pivot > 0.0 && pivot <= DBL_MAX))
            return 1;
        multiply(determinant, pivot);
        double scale = 1.0 / sqrt(pivot);
        for (int64_t l = 0; l < j; l++)
            row[l] = 0.0;
        times(row, scale, width);
        for (int64_t r = j + 1; r < m; r++)
            take(rows + r * width, row[r], row, width);
    }
    return 0;
}

/* U^-1 B of B (m, width) in place; U (m, m) upper, its rows ``stride`` apart. */
LOOPS_PART void substitute(const double *u, int64_t stride, double *b, int64_t m, int64_t width)
{
    for (int64_t r = m - 1; r >= 0; r--) {
        double *row = b + r * width;
        for (int64_t q = r + 1; q < m; q++)
            take(row, u[r * stride + q], b + q * width, width);
        times(row, 1.0 / u[r * stride + r], width);
    }
}

/* Add P A, or P' A, of A (m, width) to ``into``, P block-diagonal as a group's (2, k, k) on each
 * axis. */
LOOPS_PART void add_weighed(const double p[2][COMPONENTS][COMPONENTS], int transposed,
                            const double *a, double *into, int64_t k, int64_t width)
{
    for (int64_t c = 0; c < k; c++)
        for (int64_t d = 0; d < k; d++)
            for (int64_t g = 0; g < 2; g++)
                for (int64_t x = 0; x < AXES; x++) {
                    const int64_t to = transposed ? d : c, from = transposed ? c : d;
                    add(into + row_of(to, g, x) * width, p[g][c][d], a + row_of(from, g, x) * width,
                        width);
                }
}

/* F A of A (m, width); headings, rows 3 to 5, turn what the position goes. */
LOOPS_PART void move(const Step *step, const double *a, double *into, int64_t k, int64_t width)
{
    memset(into, 0, sizeof(double) * (size_t)(POSE * k * width));
    add_weighed(step->move, 0, a, into, k, width);
    for (int64_t x = 0; x < AXES; x++) {
        int64_t y = (x + 1) % AXES, z = (x + 2) % AXES;
        add(into + x * width, step->travel[z], a + (AXES + y) * width, width);
        take(into + x * width, step->travel[y], a + (AXES + z) * width, width);
    }
}

/* Add F' A to ``into``. */
LOOPS_PART void add_moved_back(const Step *step, const double *a, double *into, int64_t k,
                               int64_t width)
{
    add_weighed(step->move, 1, a, into, k, width);
    for (int64_t x = 0; x < AXES; x++) {
        int64_t y = (x + 1) % AXES, z = (x + 2) % AXES;
        add(into + (AXES + y) * width, step->travel[z], a + x * width, width);
        take(into + (AXES + z) * width, step->travel[y], a + x * width, width);
    }
}

/* P A of A (m, width), P as of add_weighed. */
LOOPS_PART void weigh(double p[2][COMPONENTS][COMPONENTS], const double *a, double *into, int64_t k,
                      int64_t width)
{
    memset(into, 0, sizeof(double) * (size_t)(POSE * k * width));
    add_weighed(p, 0, a, into, k, width);
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

/* The unit matrix (m, m) in rows that are ``width`` apart. */
LOOPS_PART void unit(double *rows, int64_t m, int64_t width)
{
    for (int64_t r = 0; r < m; r++) {
        for (int64_t c = 0; c < m; c++)
            rows[r * width + c] = 0.0;
        rows[r * width + r] = 1.0;
    }
}

/* What is regressed of a pose, [K_i | gauge_i | z_i | 0] of (6, lanes), in rows ``width`` apart. */
typedef struct {
    const double *nuisances; /* (N, 6, c) */
    const double *gauge;     /* (N, 6, d) */
    const double *errors;    /* (N, 6) */
    int64_t c, d;
} Columns;

LOOPS_PART void columns_of(const Columns *columns, int64_t i, double *rows, int64_t lanes,
                           int64_t width)
{
    int64_t c = columns->c, d = columns->d;
    for (int64_t r = 0; r < POSE; r++) {
        double *row = rows + r * width;
        memcpy(row, columns->nuisances + (POSE * i + r) * c, sizeof(double) * (size_t)c);
        memcpy(row + c, columns->gauge + (POSE * i + r) * d, sizeof(double) * (size_t)d);
        row[c + d] = columns->errors[POSE * i + r];
        for (int64_t l = c + d + 1; l < lanes; l++)
            row[l] = 0.0;
    }
}

/* R_i = V_i + J_i in rows that are ``width`` apart. */
LOOPS_PART void noise_of(const double *covariance, const double *jitter, int64_t i, double *rows,
                         int64_t width)
{
    for (int64_t r = 0; r < POSE; r++) {
        memcpy(rows + r * width, covariance + (POSE * i + r) * POSE, sizeof(double) * POSE);
        rows[r * width + r] += jitter[2 * i + r / AXES];
    }
}

LOOPS_PART int forward(const double *covariance, const double *jitter, const Columns *columns,
                       const double *moves, const double *precision, const double *prior,
                       const double *travel, double *weight, double *kept, double *normal,
                       double *log_dets, int64_t room, int64_t count, int64_t k, int64_t lanes)
{
    const int64_t m = POSE * k, width = 2 * m + lanes, wide = 2 * POSE + lanes;
    double noise[POSE * (2 * POSE + MOST_LANES)], pushed[STATES * STATES], one[STATES * STATES];
    double first[2][COMPONENTS][COMPONENTS];
    Logarithm of_noise = {1.0, 0}, of_states = {1.0, 0};
    unit(one, m, m);
    load(prior, 0, 1, k, first);
    memset(normal, 0, sizeof(double) * (size_t)(lanes * lanes));
    memset(kept, 0, sizeof(double) * (size_t)(m * width));
    add_groups(first, kept, k, width);
    for (int64_t i = 0; i < count; i++) {
        double *rows = kept + i % room * m * width, *w = weight + i % room * POSE * POSE;
        /* [R | 1 | K] -> [N | E | G]; R^-1 = E' E, R^-1 K = E' G. */
        noise_of(covariance, jitter, i, noise, wide);
        unit(noise + POSE, POSE, wide);
        columns_of(columns, i, noise + 2 * POSE, lanes, wide);
        if (eliminate(noise, POSE, wide, &of_noise))
            return 1;
        memset(w, 0, sizeof(double) * POSE * POSE);
        for (int64_t q = 0; q < POSE; q++) {
            const double *e = noise + q * wide + POSE, *g = e + POSE;
            for (int64_t r = 0; r <= q; r++) {
                add(w + r * POSE, e[r], e, POSE);
                add(rows + r * width + 2 * m, e[r], g, lanes);
            }
            for (int64_t r = 0; r < lanes; r++)
                add(normal + r * lanes, g[r], g, lanes);
        }
        for (int64_t r = 0; r < POSE; r++)
            add(rows + r * width, 1.0, w + r * POSE, POSE);
        double *next = kept + (i + 1) % room * m * width;
        Step step;
        if (i + 1 < count) {
            step = step_of(moves, precision, travel, i, count - 1, k);
            memset(next, 0, sizeof(double) * (size_t)(m * width));
            add_groups(step.precision, next, k, width);
            /* B = -Q^-1 F, and F' Q^-1 F. */
            double f[STATES * STATES];
            move(&step, one, f, k, m);
            weigh(step.precision, f, pushed, k, m);
            for (int64_t r = 0; r < m; r++)
                for (int64_t q = 0; q < m; q++)
                    rows[q * width + m + r] = -pushed[r * m + q];
            memset(f, 0, sizeof(double) * (size_t)(m * m));
            add_moved_back(&step, pushed, f, k, m);
            for (int64_t r = 0; r < m; r++)
                add(rows + r * width, 1.0, f + r * m, m);
        }
        if (eliminate(rows, m, width, &of_states))
            return 1;
        for (int64_t q = 0; q < m; q++) {
            const double *x = rows + q * width + m, *f = x + m;
            if (i + 1 < count)
                for (int64_t r = 0; r < m; r++) {
                    take(next + r * width, x[r], x, m);
                    take(next + r * width + 2 * m, x[r], f, lanes);
                }
            for (int64_t r = 0; r < lanes; r++)
                take(normal + r * lanes, f[r], f, lanes);
        }
    }
    log_dets[0] = logarithm(&of_noise);
    log_dets[1] = logarithm(&of_states);
    return 0;
}

/* The elimination of all poses.
 *
 * covariance: V (N, 6, 6). jitter: (N, 2), by group. nuisances, gauge, errors: (N, 6, c), (N, 6, d)
 * and (N, 6). moves, precision: F and Q^-1 (2, k, k, N - 1). prior: of the first states, (2, k, k).
 * travel: (N - 1, 3). weight: R^-1 (room, 6, 6), and kept: [U | X | f] (room, m, 2 m + lanes),
 * with room for all poses, or for two at the least. normal: the normal equations without the
 * states, (lanes, lanes). log_dets: of R and of Lambda, (2).
 * Returns 1 where one of them is not positive definite.
 */
LOOPS_WIDE int band_forward(const double *covariance, const double *jitter, const double *nuisances,
                            const double *gauge, const double *errors, const double *moves,
                            const double *precision, const double *prior, const double *travel,
                            double *weight, double *kept, double *normal, double *log_dets,
                            int64_t room, int64_t count, int64_t k, int64_t c, int64_t d,
                            int64_t lanes)
{
    const Columns columns = {nuisances, gauge, errors, c, d};
    if (k == 1)
        return forward(covariance, jitter, &columns, moves, precision, prior, travel, weight, kept,
                       normal, log_dets, room, count, 1, lanes);
    return forward(covariance, jitter, &columns, moves, precision, prior, travel, weight, kept,
                   normal, log_dets, room, count, 2, lanes);
}

/* U^-T B of B (m, width) in place; U (m, m) upper, its rows ``stride`` apart. */
LOOPS_PART void substitute_forward(const double *u, int64_t stride, double *b, int64_t m,
                                   int64_t width)
{
    for (int64_t r = 0; r < m; r++) {
        for (int64_t q = 0; q < r; q++)
            take(b + r * width, u[q * stride + r], b + q * width, width);
        times(b + r * width, 1.0 / u[r * stride + r], width);
    }
}

/* A B of A (m, n), its rows ``stride`` apart, and B (n, width). */
LOOPS_PART void multiplied(const double *a, int64_t stride, const double *b, double *into,
                           int64_t m, int64_t n, int64_t width)
{
    memset(into, 0, sizeof(double) * (size_t)(m * width));
    for (int64_t r = 0; r < m; r++)
        for (int64_t q = 0; q < n; q++)
            add(into + r * width, a[r * stride + q], b + q * width, width);
}

LOOPS_PART void transpose(const double *a, double *into, int64_t m)
{
    for (int64_t r = 0; r < m; r++)
        for (int64_t q = 0; q < m; q++)
            into[q * m + r] = a[r * m + q];
}

/* What is known of a pose and of that before: covariances and columns of their states. */
typedef struct {
    double own[STATES * STATES];   /* S_i */
    double after[STATES * STATES]; /* S_(i,i+1) */
    double columns[STATES * MOST_LANES];
} Known;

/* Of pose i, given that of i + 1 (nothing, for the last); [U | X | f root] are its rows. */
LOOPS_PART void go_back(const double *rows, const double *root, const Known *next, Known *here,
                        int64_t m, int64_t lanes)
{
    const int64_t width = 2 * m + lanes;
    double right[STATES * (2 * STATES + MOST_LANES)], turned[STATES * STATES];
    double y[STATES * STATES], inverse[STATES * STATES];
    /* [U^-1 | Y = U^-1 X | U^-1 f root] */
    for (int64_t r = 0; r < m; r++) {
        double *row = right + r * width;
        const double *f = rows + r * width + 2 * m;
        memset(row, 0, sizeof(double) * (size_t)width);
        row[r] = 1.0;
        memcpy(row + m, rows + r * width + m, sizeof(double) * (size_t)m);
        for (int64_t q = 0; q < lanes; q++)
            add(row + 2 * m, f[q], root + q * lanes, lanes);
    }
    substitute(rows, width, right, m, width);
    for (int64_t r = 0; r < m; r++) {
        memcpy(inverse + r * m, right + r * width, sizeof(double) * (size_t)m);
        memcpy(y + r * m, right + r * width + m, sizeof(double) * (size_t)m);
    }
    transpose(inverse, turned, m);
    multiplied(inverse, m, turned, here->own, m, m, m);
    multiplied(y, m, next->own, here->after, m, m, m);
    transpose(y, turned, m);
    for (int64_t r = 0; r < m; r++) {
        double *column = here->columns + r * lanes;
        for (int64_t q = 0; q < m; q++)
            add(here->own + r * m, here->after[r * m + q], turned + q * m, m);
        times(here->after + r * m, -1.0, m);
        memcpy(column, right + r * width + 2 * m, sizeof(double) * (size_t)lanes);
        for (int64_t q = 0; q < m; q++)
            take(column, y[r * m + q], next->columns + q * lanes, lanes);
    }
}

/* Row r of F, as those of A times it: sum of F[r, q] A[q]. */
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

LOOPS_PART void backward(const double *kept, const double *weight, const Columns *columns,
                         const double *root, const double *moves, const double *travel,
                         double *states, double *scores, double *of_poses, double *of_steps,
                         double *first, int64_t count, int64_t k, int64_t lanes)
{
    const int64_t m = POSE * k, width = 2 * m + lanes, n = count - 1, at = columns->c + columns->d;
    const int64_t part = 2 * k * k * n;
    Known both[2];
    memset(&both[count % 2], 0, sizeof both[0]);
    for (int64_t i = count - 1; i >= 0; i--) {
        Known *here = &both[i % 2], *next = &both[(i + 1) % 2];
        const double *w = weight + i * POSE * POSE;
        double seen[POSE * MOST_LANES], rest[POSE * MOST_LANES], known[POSE * POSE];
        double own[POSE * POSE];
        go_back(kept + i * m * width, root, next, here, m, lanes);
        columns_of(columns, i, seen, lanes, lanes);
        multiplied(seen, lanes, root, rest, POSE, lanes, lanes);
        for (int64_t r = 0; r < POSE; r++) {
            add(rest + r * lanes, -1.0, here->columns + r * lanes, lanes);
            memcpy(own + r * POSE, here->own + r * m, sizeof(double) * POSE);
        }
        multiplied(w, POSE, rest, seen, POSE, POSE, lanes);
        multiplied(w, POSE, own, known, POSE, POSE, POSE);
        for (int64_t g = 0; g < 2; g++) {
            double trace = 0.0, told = 0.0, square = 0.0;
            for (int64_t r = AXES * g; r < AXES * (g + 1); r++) {
                double score = seen[r * lanes + at];
                scores[POSE * i + r] = score;
                seen[r * lanes + at] = 0.0;
                trace += w[r * POSE + r];
                square += score * score;
                for (int64_t q = 0; q < POSE; q++)
                    told += known[r * POSE + q] * w[r * POSE + q];
                told += product(seen + r * lanes, seen + r * lanes, lanes);
            }
            of_poses[g * count + i] = trace;
            of_poses[(2 + g) * count + i] = told;
            of_poses[(4 + g) * count + i] = square;
        }
        for (int64_t r = 0; r < m; r++)
            states[m * i + r] = here->columns[r * lanes + at];
        if (i + 1 == count)
            continue;
        Step step = {0};
        double spread[STATES * STATES], across[STATES * STATES], ahead[STATES * MOST_LANES];
        double went[STATES], was[STATES * MOST_LANES];
        load(moves, i, n, k, step.move);
        memcpy(step.travel, travel + AXES * i, sizeof step.travel);
        move(&step, here->own, spread, k, m);
        move(&step, here->after, across, k, m);
        move(&step, here->columns, ahead, k, lanes);
        memcpy(was, here->columns, sizeof(double) * (size_t)(m * lanes));
        for (int64_t r = 0; r < m; r++) {
            double *row = ahead + r * lanes;
            for (int64_t l = 0; l < lanes; l++)
                row[l] = next->columns[r * lanes + l] - row[l];
            went[r] = row[at];
            row[at] = was[r * lanes + at] = 0.0;
        }
        for (int64_t g = 0; g < 2; g++)
            for (int64_t c = 0; c < k; c++)
                for (int64_t d = 0; d < k; d++) {
                    double moved = 0.0, earlier = 0.0, squares = 0.0, mixed = 0.0;
                    for (int64_t x = 0; x < AXES; x++) {
                        int64_t r = row_of(c, g, x), q = row_of(d, g, x);
                        moved += next->own[r * m + q] - across[r * m + q] - across[q * m + r];
                        moved += moved_of(&step, spread + r * m, d, g, x, k);
                        moved += product(ahead + r * lanes, ahead + q * lanes, lanes);
                        earlier += here->after[r * m + q] - spread[q * m + r];
                        earlier += product(was + r * lanes, ahead + q * lanes, lanes);
                        squares += went[r] * went[q];
                        mixed += states[m * i + r] * went[q];
                    }
                    double *into = of_steps + ((g * k + c) * k + d) * n + i;
                    into[0] = moved;
                    into[part] = earlier;
                    into[2 * part] = squares;
                    into[3 * part] = mixed;
                }
    }
    Known *begin = &both[0];
    for (int64_t r = 0; r < m; r++)
        begin->columns[r * lanes + at] = 0.0;
    for (int64_t g = 0; g < 2; g++)
        for (int64_t c = 0; c < k; c++)
            for (int64_t d = 0; d < k; d++) {
                double sum = 0.0;
                for (int64_t x = 0; x < AXES; x++) {
                    int64_t r = row_of(c, g, x), q = row_of(d, g, x);
                    sum += begin->own[r * m + q];
                    sum += product(begin->columns + r * lanes, begin->columns + q * lanes, lanes);
                }
                first[(g * k + c) * k + d] = sum;
            }
}

/* What the data say of the states and of the disturbances.
 *
 * root: (lanes, lanes), of the covariance of theta, and in the lane of the errors (-theta, 1). As
 * lanes of [K_i | z_i] root and of the states that go with it. states: (N, m). scores: R^-1 of the
 * residuals, (N, 6). Sums over the three axes of each group, ``known`` being the covariance of what
 * is estimated:
 * of_poses: (3, 2, N), of R^-1, of what is known of the scores, of their squares.
 * of_steps: (4, 2, k, k, N - 1), what is known of the moves w, and of the states before with them,
 * and the products of both as estimated. first: what is known of the first states, (2, k, k).
 */
LOOPS_WIDE int band_backward(const double *kept, const double *weight, const double *nuisances,
                             const double *gauge, const double *errors, const double *root,
                             const double *moves, const double *travel, double *states,
                             double *scores, double *of_poses, double *of_steps, double *first,
                             int64_t count, int64_t k, int64_t c, int64_t d, int64_t lanes)
{
    const Columns columns = {nuisances, gauge, errors, c, d};
    if (k == 1)
        backward(kept, weight, &columns, root, moves, travel, states, scores, of_poses, of_steps,
                 first, count, 1, lanes);
    else
        backward(kept, weight, &columns, root, moves, travel, states, scores, of_poses, of_steps,
                 first, count, 2, lanes);
    return 0;
}

/* Slopes by the parameters, of the steps and of the prior of the first states. */
typedef struct {
    const double *noise;  /* (p, 2, k, k, n) */
    const double *move;   /* by the last, (2, k, k, n) */
    const double *prior;  /* (p, 2, k, k) */
    int64_t p, n;
} Slopes;

/* Q^-1 of a step's move, (m), and the slope that its last states have by it. */
LOOPS_PART void felt_of(const Step *step, const double *states, double *felt, int64_t k)
{
    const int64_t m = POSE * k;
    double went[STATES];
    move(step, states, went, k, 1);
    for (int64_t r = 0; r < m; r++)
        went[r] = states[m + r] - went[r];
    double precision[2][COMPONENTS][COMPONENTS];
    memcpy(precision, step->precision, sizeof precision);
    weigh(precision, went, felt, k, 1);
}

/* t of the pose that step i leads to, (m, BOTH). */
LOOPS_PART void through_of(const Slopes *slopes, const Step *step, int64_t i, const double *states,
                           const double *felt, double *into, int64_t k)
{
    const int64_t p = slopes->p, n = slopes->n;
    double slope[2][COMPONENTS][COMPONENTS], precision[2][COMPONENTS][COMPONENTS];
    double each[STATES * BOTH] = {0.0};
    for (int64_t j = 1; j < p; j++) {
        load(slopes->noise + 2 * k * k * n * j, i, n, k, slope);
        for (int64_t g = 0; g < 2; g++)
            for (int64_t c = 0; c < k; c++)
                for (int64_t d = 0; d < k; d++)
                    for (int64_t x = 0; x < AXES; x++)
                        each[row_of(c, g, x) * BOTH + PARAMETERS * g + j] -=
                            slope[g][c][d] * felt[row_of(d, g, x)];
    }
    load(slopes->move, i, n, k, slope);
    for (int64_t g = 0; g < 2; g++)
        for (int64_t c = 0; c < k; c++)
            for (int64_t d = 0; d < k; d++)
                for (int64_t x = 0; x < AXES; x++)
                    each[row_of(c, g, x) * BOTH + PARAMETERS * g + p - 1] -=
                        slope[g][c][d] * states[row_of(d, g, x)];
    memcpy(precision, step->precision, sizeof precision);
    weigh(precision, each, into, k, BOTH);
}

/* t of the first pose. */
LOOPS_PART void through_first(const Slopes *slopes, const double *states, double *into, int64_t k)
{
    double slope[2][COMPONENTS][COMPONENTS];
    memset(into, 0, sizeof(double) * (size_t)(POSE * k * BOTH));
    for (int64_t j = 1; j < slopes->p; j++) {
        load(slopes->prior + 2 * k * k * j, 0, 1, k, slope);
        for (int64_t g = 0; g < 2; g++)
            for (int64_t c = 0; c < k; c++)
                for (int64_t d = 0; d < k; d++)
                    for (int64_t x = 0; x < AXES; x++)
                        into[row_of(c, g, x) * BOTH + PARAMETERS * g + j] +=
                            slope[g][c][d] * states[row_of(d, g, x)];
    }
}

/* By the last parameter, what the last component's states feel of the step that follows, (6). */
LOOPS_PART void feel(const Slopes *slopes, int64_t i, const double *felt, double *into, int64_t k)
{
    double slope[2][COMPONENTS][COMPONENTS];
    load(slopes->move, i, slopes->n, k, slope);
    for (int64_t g = 0; g < 2; g++)
        for (int64_t x = 0; x < AXES; x++) {
            double sum = 0.0;
            for (int64_t c = 0; c < k; c++)
                sum -= slope[g][c][k - 1] * felt[row_of(c, g, x)];
            into[AXES * g + x] = sum;
        }
}

LOOPS_PART void average(const double *kept, const double *weight, const Columns *columns,
                        const double *jitter, const double *states, const double *scores,
                        const double *moves, const double *precision, const double *noise,
                        const double *travel, const double *prior, const Slopes *slopes,
                        double *found, double *ahead, int64_t count, int64_t k, int64_t lanes)
{
    const int64_t m = POSE * k, width = 2 * m + lanes, n = count - 1, last = slopes->p - 1;
    double into[STATES * BOTH], own[STATES * BOTH], felt[STATES], here[POSE], later[POSE] = {0.0};
    double slope[2][COMPONENTS][COMPONENTS];
    Step step;
    memset(found, 0, sizeof(double) * BOTH * BOTH);
    memset(ahead, 0, sizeof(double) * (size_t)(lanes * BOTH));
    /* t' Q t, with what goes back along the last component. */
    for (int64_t i = count - 1; i >= 0; i--) {
        if (i < n) {
            step = step_of(moves, precision, travel, i, n, k);
            felt_of(&step, states + m * i, felt, k);
            feel(slopes, i, felt, here, k);
            for (int64_t r = 0; r < POSE; r++)
                later[r] = here[r] + step.move[r / AXES][k - 1][k - 1] * later[r];
        }
        if (i > 0) {
            step = step_of(moves, precision, travel, i - 1, n, k);
            felt_of(&step, states + m * (i - 1), felt, k);
            through_of(slopes, &step, i - 1, states + m * (i - 1), felt, into, k);
            load(noise, i - 1, n, k, slope);
        } else {
            through_first(slopes, states, into, k);
            load(prior, 0, 1, k, slope);
            for (int64_t g = 0; g < 2; g++)
                for (int64_t c = 0; c < k; c++)
                    slope[g][c][c] = slope[g][c][c] > 0.0 ? 1.0 / slope[g][c][c] : 0.0;
        }
        for (int64_t r = 0; r < POSE; r++)
            into[(m - POSE + r) * BOTH + PARAMETERS * (r / AXES) + last] += later[r];
        weigh(slope, into, own, k, BOTH);
        for (int64_t r = 0; r < m; r++)
            for (int64_t j = 0; j < BOTH; j++)
                add(found + j * BOTH, into[r * BOTH + j], own + r * BOTH, BOTH);
    }
    /* g' Lambda^-1 g. */
    double t[STATES * BOTH], next[STATES * BOTH], solved[STATES * BOTH], rows[POSE * MOST_LANES];
    through_first(slopes, states, t, k);
    for (int64_t i = 0; i < count; i++) {
        const double *own_rows = kept + i * m * width, *w = weight + i * POSE * POSE;
        memcpy(into, t, sizeof(double) * (size_t)(m * BOTH));
        if (i < n) {
            step = step_of(moves, precision, travel, i, n, k);
            felt_of(&step, states + m * i, felt, k);
            through_of(slopes, &step, i, states + m * i, felt, next, k);
            feel(slopes, i, felt, here, k);
            memset(own, 0, sizeof(double) * (size_t)(m * BOTH));
            add_moved_back(&step, next, own, k, BOTH);
            for (int64_t r = 0; r < m; r++)
                take(into + r * BOTH, 1.0, own + r * BOTH, BOTH);
            for (int64_t r = 0; r < POSE; r++)
                into[(m - POSE + r) * BOTH + PARAMETERS * (r / AXES) + last] += here[r];
        }
        double errors[POSE * BOTH] = {0.0}, weighted[POSE * BOTH];
        for (int64_t r = 0; r < POSE; r++)
            errors[r * BOTH + PARAMETERS * (r / AXES)] =
                2.0 * jitter[2 * i + r / AXES] * scores[POSE * i + r];
        multiplied(w, POSE, errors, weighted, POSE, POSE, BOTH);
        columns_of(columns, i, rows, lanes, lanes);
        for (int64_t r = 0; r < POSE; r++) {
            add(into + r * BOTH, 1.0, weighted + r * BOTH, BOTH);
            for (int64_t j = 0; j < BOTH; j++)
                add(found + j * BOTH, errors[r * BOTH + j], weighted + r * BOTH, BOTH);
            for (int64_t l = 0; l < lanes; l++)
                add(ahead + l * BOTH, rows[r * lanes + l], weighted + r * BOTH, BOTH);
        }
        if (i > 0)
            for (int64_t q = 0; q < m; q++) {
                const double *x = own_rows - m * width + q * width + m;
                for (int64_t r = 0; r < m; r++)
                    take(into + r * BOTH, x[r], solved + q * BOTH, BOTH);
            }
        memcpy(solved, into, sizeof(double) * (size_t)(m * BOTH));
        substitute_forward(own_rows, width, solved, m, BOTH);
        for (int64_t r = 0; r < m; r++) {
            const double *f = own_rows + r * width + 2 * m, *h = solved + r * BOTH;
            for (int64_t j = 0; j < BOTH; j++)
                take(found + j * BOTH, h[j], h, BOTH);
            for (int64_t l = 0; l < lanes; l++)
                take(ahead + l * BOTH, f[l], h, BOTH);
        }
        memcpy(t, next, sizeof(double) * (size_t)(m * BOTH));
    }
}

/* Twice the average information before theta is integrated out (`Likelihood.average_information`).
 *
 * As above; noise: Q. slope_noise: (p, 2, k, k, N - 1). slope_moves: of F by the last parameter,
 * (2, k, k, N - 1). slope_prior: (p, 2, k, k). found: (8, 8), the second group's parameters from
 * the fifth on. ahead: what it has to do with theta, (lanes, 8).
 */
LOOPS_WIDE int band_average(const double *kept, const double *weight, const double *nuisances,
                            const double *gauge, const double *errors, const double *jitter,
                            const double *states, const double *scores, const double *moves,
                            const double *precision, const double *noise, const double *travel,
                            const double *prior, const double *slope_noise,
                            const double *slope_moves, const double *slope_prior, double *found,
                            double *ahead, int64_t count, int64_t k, int64_t p, int64_t c,
                            int64_t d, int64_t lanes)
{
    const Columns columns = {nuisances, gauge, errors, c, d};
    const Slopes slopes = {slope_noise, slope_moves, slope_prior, p, count - 1};
    if (k == 1)
        average(kept, weight, &columns, jitter, states, scores, moves, precision, noise, travel,
                prior, &slopes, found, ahead, count, 1, lanes);
    else
        average(kept, weight, &columns, jitter, states, scores, moves, precision, noise, travel,
                prior, &slopes, found, ahead, count, 2, lanes);
    return 0;
}

LOOPS_PART int whiten(const double *covariance, const double *jitter, const Columns *columns,
                      const double *moves, const double *noise, const double *prior,
                      const double *travel, double *white, int64_t begin, int64_t count, int64_t k,
                      int64_t lanes)
{
    const int64_t m = POSE * k, width = POSE + m + lanes, n = count - 1;
    double known[STATES * STATES] = {0.0}, states[STATES * MOST_LANES] = {0.0};
    double rows[POSE * (POSE + STATES + MOST_LANES)], went[STATES * STATES];
    double moved[STATES * MOST_LANES], slope[2][COMPONENTS][COMPONENTS];
    Logarithm determinant = {1.0, 0};
    Step step = {0};
    /* What is not flat of the first states; what is, is as the first pose says. */
    load(prior, 0, 1, k, slope);
    for (int64_t g = 0; g < 2; g++)
        for (int64_t c = 0; c < k; c++)
            slope[g][c][c] = slope[g][c][c] > 0.0 ? 1.0 / slope[g][c][c] : 0.0;
    add_groups(slope, known, k, m);
    if (begin > 0) {
        noise_of(covariance, jitter, 0, known, m);
        columns_of(columns, 0, states, lanes, lanes);
    }
    for (int64_t i = begin; i < count; i++) {
        if (i > 0) {
            load(moves, i - 1, n, k, step.move);
            memcpy(step.travel, travel + AXES * (i - 1), sizeof step.travel);
            move(&step, known, went, k, m);
            for (int64_t r = 0; r < m; r++)
                for (int64_t d = 0; d < k; d++)
                    for (int64_t g = 0; g < 2; g++)
                        for (int64_t x = 0; x < AXES; x++)
                            known[r * m + row_of(d, g, x)] =
                                moved_of(&step, went + r * m, d, g, x, k);
            load(noise, i - 1, n, k, slope);
            add_groups(slope, known, k, m);
            move(&step, states, moved, k, lanes);
            memcpy(states, moved, sizeof(double) * (size_t)(m * lanes));
        }
        /* [R + P | P | K - x] -> [. | A | white] */
        noise_of(covariance, jitter, i, rows, width);
        columns_of(columns, i, rows + POSE + m, lanes, width);
        for (int64_t r = 0; r < POSE; r++) {
            double *row = rows + r * width;
            add(row, 1.0, known + r * m, POSE);
            memcpy(row + POSE, known + r * m, sizeof(double) * (size_t)m);
            take(row + POSE + m, 1.0, states + r * lanes, lanes);
        }
        if (eliminate(rows, POSE, width, &determinant))
            return 1;
        for (int64_t q = 0; q < POSE; q++) {
            const double *a = rows + q * width + POSE, *new = a + m;
            memcpy(white + ((i - begin) * POSE + q) * lanes, new, sizeof(double) * (size_t)lanes);
            for (int64_t r = 0; r < m; r++) {
                take(known + r * m, a[r], a, m);
                add(states + r * lanes, a[r], new, lanes);
            }
        }
    }
    return 0;
}

/* What each pose is beyond its prediction from those before, whitened (a Kalman filter).
 *
 * As above; white: (N - begin, 6, lanes) of the columns [K | z]. begin: 1 where the states of the
 * first pose are not known before, and 0. Returns 1 where a covariance is not positive definite.
 */
LOOPS_WIDE int band_whiten(const double *covariance, const double *jitter, const double *nuisances,
                           const double *gauge, const double *errors, const double *moves,
                           const double *noise, const double *prior, const double *travel,
                           double *white, int64_t begin, int64_t count, int64_t k, int64_t c,
                           int64_t d, int64_t lanes)
{
    const Columns columns = {nuisances, gauge, errors, c, d};
    if (k == 1)
        return whiten(covariance, jitter, &columns, moves, noise, prior, travel, white, begin,
                      count, 1, lanes);
    return whiten(covariance, jitter, &columns, moves, noise, prior, travel, white, begin, count, 2,
                  lanes);
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
    Logarithm determinant = {1.0, 0};
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
