/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The search for a process's parameters and for nuisances in turn (error_model/search.py), by the
 * chains of one axis: rotations first, as what their errors do to positions is taken off those.
 */
#include "chain.h"
#include "eigen.h"

#include <string.h>

enum { COLUMNS = 16, GROUPS = 2 }; /* nuisances, those of the alignment, and the errors */
enum { PART = 64 };                /* rows that lie in the processor's cache */

/* What a search keeps to (search.py has each as a constant). */
typedef struct {
    double few, steps, turns; /* of a start, of a climb; and in turn */
    double small, large;      /* steps of nuisances, by their standard deviations */
    double round_off;
} Turns;

/* What is searched. columns: of the nuisances with, last, the errors. */
typedef struct {
    int64_t kind, count, columns;
    int size;
    const double *intervals; /* (N - 1,) */
    const double *both;      /* (2, N, 3, columns) */
    const double *variance;  /* (2, N) */
    const double *travel;    /* (N - 1, 3) */
    const double *precision; /* (columns - 1,) */
    const double *low, *high; /* (2, p) */
    const Rules *rules;
    const Beginning *beginning;
    const Turns *turns;
    double gain;
} Problem;

/* What is known to begin with: nothing where the kind is negative. */
typedef struct {
    int64_t kind, size;
    const double *parameters; /* (2, size) */
    int64_t has_factors;      /* of these poses */
    const double *factors;    /* (2, 2 N - 1) */
} Known;

/* A group's chain where it is. */
typedef struct {
    double parameters[PARAMETERS], gradient[PARAMETERS], found[5];
    double *errors, *factors, *poses, *steps; /* (3, N), (2 N - 1,), (2, N), (2, N - 1) */
    Filtered *filtered;
    Smoothed *smoothed;
    int is_smoothed;
} Place;

/* Of all: (11 N), (3 N), (2 N), and of columns (3 N, columns) twice. */
typedef struct {
    double *climb, *cleaned, *best, *columns, *positions;
} Work;

/* Numbers of `work` for a search. */
int64_t search_room(int64_t count, int64_t columns)
{
    const int64_t place = 3 + 2 + 2 + 2 + (sizeof(Filtered) + sizeof(Smoothed)) / sizeof(double);
    return count * (GROUPS * place + 11 + 3 + 2 + 2 * 3 * columns);
}

static double *room(double **next, int64_t numbers)
{
    double *const begin = *next;
    *next += numbers;
    return begin;
}

static int smooth(const Problem *at, int64_t kind, const double *parameters, const double *errors,
                  Place *here)
{
    return chain_smooth(kind, at->count, parameters, at->intervals, errors,
                        here->factors + at->count, here->filtered, here->found, here->smoothed,
                        here->poses, here->steps, here->gradient);
}

static int climb(const Problem *at, int group, double steps, Place *here, Work *work)
{
    const int64_t p = at->size, n = at->count;
    const int told =
        chain_climb(at->kind, n, p, at->intervals, here->errors, at->variance + group * n,
                    at->low + group * p, at->high + group * p, at->rules, at->gain,
                    (int64_t)steps, 0, 1, here->parameters, here->factors, here->filtered,
                    here->found, here->smoothed, here->poses, here->steps, here->gradient,
                    work->climb);
    here->is_smoothed = told > 0;
    return told < 0;
}

/* Errors without what has factors already, as the process says that is known; work->cleaned. */
static int clean(const Problem *at, const Known *known, int group, Place *here, Work *work)
{
    const int64_t n = at->count;
    const double *const parameters = known->parameters + group * known->size;
    const double *const factors = here->factors, *const moved = factors + n;
    double *const cleaned = work->cleaned, leaps[AXES] = {0.0};
    if (chain_filter(known->kind, n, parameters, at->intervals, here->errors,
                     at->variance + group * n, factors, moved, here->filtered, here->found))
        return 1;
    smooth(at, known->kind, parameters, here->errors, here);
    for (int64_t i = 0; i < n; i++) {
        const Filtered *const f = here->filtered + i;
        const Smoothed *const s = here->smoothed + i;
        const double share = 1.0 - 1.0 / factors[i];
        for (int x = 0; x < AXES; x++)
            cleaned[x * n + i] =
                here->errors[x * n + i] - f->noise * s->score[x] * share - leaps[x];
        if (i + 1 == n)
            break;
        const double leapt = 1.0 - 1.0 / moved[i];
        for (int x = 0; x < AXES; x++)
            leaps[x] += (f->q[0] * s->felt[0][x] + f->q[1] * s->felt[1][x]) * leapt;
    }
    return 0;
}

/* The likeliest end of a few steps from each start. */
static int begin_anew(const Problem *at, const Known *known, int group, Place *here, Work *work)
{
    const int64_t n = at->count, factors = 2 * n - 1;
    const double *const low = at->low + group * at->size, *const high = at->high + group * at->size;
    const double *const first = known->factors + group * factors, *errors = here->errors;
    double starts[(TIMES + 1) * PARAMETERS], best[PARAMETERS], most = -INFINITY;
    memcpy(here->factors, first, factors * sizeof *first);
    if (known->kind >= 0 && known->has_factors) {
        if (clean(at, known, group, here, work))
            return 1;
        errors = work->cleaned;
    }
    int count = structure_starts(at->kind, n, errors, at->intervals, at->variance + group * n,
                                 at->beginning, starts, work->climb);
    if (count == 0)
        return 1;
    if (at->kind == VELOCITY && known->kind >= 0) { /* beside the drift that there is, too */
        double *const more = starts + PARAMETERS * count++;
        memcpy(more, known->parameters + group * known->size, 2 * sizeof *more);
        memcpy(more + 2, starts + 2, 2 * sizeof *more);
    }
    for (int j = 0; j < count; j++) {
        for (int i = 0; i < at->size; i++)
            here->parameters[i] = fmin(fmax(starts[PARAMETERS * j + i], low[i]), high[i]);
        memcpy(here->factors, first, factors * sizeof *first);
        if (climb(at, group, at->turns->few, here, work))
            return 1;
        const double value =
            here->found[0] - climb_penalty(factors, here->factors, at->rules->kappa);
        if (value > most) {
            most = value;
            memcpy(best, here->parameters, sizeof best);
            memcpy(work->best, here->factors, factors * sizeof *first);
        }
    }
    memcpy(here->parameters, best, sizeof best);
    memcpy(here->factors, work->best, factors * sizeof *first);
    return 0;
}

/* Each group at its maximum, given the nuisances; from where it is, or from starts. */
static int climb_both(const Problem *at, const Known *known, int from_starts, const double *theta,
                      Place *places, Work *work)
{
    const int64_t n = at->count, columns = at->columns;
    for (int g = GROUPS - 1; g >= 0; g--) {
        Place *const here = places + g, *const turned = g == 0 && at->kind != WANDER ? here + 1 : 0;
        const double *row = at->both + g * n * AXES * columns;
        double moved[AXES] = {0.0};
        if (turned && !turned->is_smoothed)
            smooth(at, at->kind, turned->parameters, turned->errors, turned);
        for (int64_t i = 0; i < n; i++) {
            for (int x = 0; x < AXES; x++, row += columns) {
                double rest = row[columns - 1];
                for (int64_t c = 0; c + 1 < columns; c++)
                    rest -= row[c] * theta[c];
                here->errors[x * n + i] = rest + moved[x];
            }
            if (!turned || i + 1 == n)
                continue;
            const double *const t = at->travel + AXES * i;
            const double(*const s)[LANES] = turned->smoothed[i].state;
            moved[0] += t[1] * s[0][2] - t[2] * s[0][1];
            moved[1] += t[2] * s[0][0] - t[0] * s[0][2];
            moved[2] += t[0] * s[0][1] - t[1] * s[0][0];
        }
        if (from_starts && begin_anew(at, known, g, here, work))
            return 1;
        if (climb(at, g, at->turns->steps, here, work))
            return 1;
    }
    return 0;
}

/* Four rows of sums (COLUMNS, COLUMNS) from the first's diagonal on grow by products of each of values
 * (rows, COLUMNS) with itself; so many times LANES wide. */
LOOPS_PART void add_four(int64_t rows, double values[][COLUMNS], int first, int wide,
                         double sums[COLUMNS][COLUMNS])
{
    Lanes total[4][COLUMNS / LANES];
    for (int l = 0; l < 4; l++)
        for (int m = 0; m < wide; m++)
            total[l][m] = *(Lanes *)(sums[first + l] + first + LANES * m);
    for (int64_t i = 0; i < rows; i++) {
        const double *const row = values[i] + first;
        for (int l = 0; l < 4; l++)
            for (int m = 0; m < wide; m++)
                total[l][m] += row[l] * *(const Lanes *)(row + LANES * m);
    }
    for (int l = 0; l < 4; l++)
        for (int m = 0; m < wide; m++)
            *(Lanes *)(sums[first + l] + first + LANES * m) = total[l][m];
}

/* normal (columns, columns) grows by what rows of (rows, columns) are by themselves. */
LOOPS_WIDE void search_products(int64_t rows, int64_t columns, const double *values,
                                double *normal)
{
    double sums[COLUMNS][COLUMNS] = {{0.0}}, part[PART][COLUMNS] = {{0.0}};
    for (int64_t done = 0; done < rows; done += PART) {
        const int64_t some = rows - done < PART ? rows - done : PART;
        for (int64_t i = 0; i < some; i++)
            memcpy(part[i], values + (done + i) * columns, (size_t)columns * sizeof *values);
        if (columns > 12) {
            add_four(some, part, 0, 4, sums);
            add_four(some, part, 4, 3, sums);
            add_four(some, part, 8, 2, sums);
            add_four(some, part, 12, 1, sums);
        } else {
            add_four(some, part, 0, 3, sums);
            add_four(some, part, 4, 2, sums);
            add_four(some, part, 8, 1, sums);
        }
    }
    for (int l = 0; l < columns; l++)
        for (int m = 0; m < columns; m++)
            normal[l * columns + m] += m < l ? sums[m][l] : sums[l][m];
}

/* The normal equations of both groups (columns, columns), of errors with these filters. */
static void set_normal(const Problem *at, const Place *places, double *normal, Work *work)
{
    const int64_t n = at->count, columns = at->columns, lanes = AXES * columns;
    const double *const positions = at->both, *const rotations = at->both + n * lanes;
    double small[2 * AXES * COLUMNS];
    memset(normal, 0, columns * columns * sizeof *normal);
    chain_whiten(n, lanes, places[1].filtered, rotations, work->columns, small);
    search_products(AXES * n, columns, work->columns, normal);
    const double *seen = positions;
    if (at->kind != WANDER) {
        chain_smooth_others(n, lanes, places[1].filtered, rotations, work->columns, small);
        chain_turn(n, columns, at->travel, positions, work->columns, small);
        seen = work->columns;
    }
    chain_whiten(n, lanes, places[0].filtered, seen, work->positions, small);
    search_products(AXES * n, columns, work->positions, normal);
}

/* Nuisances (c,) and their covariance (c, c) by normal equations (c + 1, c + 1); not 0 of what is not
 * finite. */
static int solve_normal(const Problem *at, const double *normal, double *theta, double *covariance)
{
    const int columns = (int)at->columns, n = columns - 1;
    double a[ORDER][ORDER], v[ORDER][ORDER], scale[COLUMNS];
    const double round_off = at->turns->round_off;
    for (int i = 0; i < n; i++) {
        /* What the process takes all of has no information but by round-off. */
        const double own = normal[i * columns + i];
        const double least = at->precision[i] + round_off * fabs(own);
        a[i][i] = own + least;
        scale[i] = 1.0 / sqrt(fmax(a[i][i], least));
        if (!isfinite(scale[i]) || !isfinite(own))
            return 1;
    }
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            const double both = i == j ? a[i][i] : normal[i * columns + j];
            a[i][j] = a[j][i] = scale[i] * both * scale[j] + (i == j ? round_off : 0.0);
            if (!isfinite(a[i][j]))
                return 1;
        }
    diagonalise(n, a, v);
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            double sum = 0.0;
            for (int k = 0; k < n; k++)
                sum += v[i][k] * v[j][k] / fmax(a[k][k], round_off);
            covariance[i * n + j] = covariance[j * n + i] = scale[i] * sum * scale[j];
        }
    for (int i = 0; i < n; i++) {
        theta[i] = 0.0;
        for (int j = 0; j < n; j++)
            theta[i] += covariance[i * n + j] * normal[j * columns + n];
    }
    return 0;
}

/* The search, as `_Search.run` of search.py, of columns - 1 nuisances. begin_kind .. begin_factors:
 * as `Known` has them. parameters (2, p), factors (2, 2 N - 1), theta (c,), covariance (c, c): where
 * it ends; theta is given where it begins. work: as many numbers as `search_room` says. Not 0 where
 * there is no likelihood. */
int search_run(int64_t kind, int64_t count, int64_t columns, int64_t size, const double *intervals,
               const double *both, const double *variance, const double *travel,
               const double *precision, const double *low, const double *high, const Rules *rules,
               const Beginning *beginning, const Turns *turns, double gain, int64_t begin_kind,
               int64_t begin_size, const double *begin, int64_t has_factors,
               const double *begin_factors, double *parameters, double *factors, double *theta,
               double *covariance, double *work)
{
    const Problem at = {kind,      count, columns, (int)size, intervals, both,  variance, travel,
                        precision, low,   high,    rules,     beginning, turns, gain};
    const Known known = {begin_kind, begin_size, begin, has_factors, begin_factors};
    const int64_t n = columns - 1, all = 2 * count - 1;
    double *next = work, normal[COLUMNS * COLUMNS], there[COLUMNS];
    Place places[GROUPS];
    int from_starts = begin_kind != kind;
    for (int g = 0; g < GROUPS; g++) {
        Place *const here = places + g;
        here->errors = room(&next, 3 * count);
        here->factors = room(&next, 2 * count);
        here->poses = room(&next, 2 * count);
        here->steps = room(&next, 2 * count);
        here->filtered = (Filtered *)room(&next, count * (int64_t)(sizeof(Filtered) / sizeof *next));
        here->smoothed = (Smoothed *)room(&next, count * (int64_t)(sizeof(Smoothed) / sizeof *next));
        if (!from_starts) {
            memcpy(here->parameters, begin + g * begin_size, size * sizeof *begin);
            memcpy(here->factors, begin_factors + g * all, all * sizeof *begin_factors);
        }
    }
    Work rest = {.climb = room(&next, 11 * count), .cleaned = room(&next, 3 * count)};
    rest.best = room(&next, 2 * count);
    rest.columns = room(&next, 3 * count * columns);
    rest.positions = room(&next, 3 * count * columns);
    for (int turn = 0; turn < (int)turns->turns; turn++) {
        int is_small = 1, is_large = 0;
        if (climb_both(&at, &known, from_starts, theta, places, &rest))
            return 1;
        set_normal(&at, places, normal, &rest);
        if (solve_normal(&at, normal, there, covariance))
            return 1;
        for (int64_t i = 0; i < n; i++) {
            const double step = fabs(there[i] - theta[i]) / sqrt(covariance[i * n + i]);
            is_small = is_small && step < turns->small;
            is_large = is_large || step > turns->large;
            theta[i] = there[i];
        }
        from_starts = 0;
        if (is_small)
            break;
        from_starts = begin_kind < 0 && is_large;
    }
    if (from_starts && climb_both(&at, &known, 1, theta, places, &rest))
        return 1;
    for (int g = 0; g < GROUPS; g++) {
        memcpy(parameters + g * size, places[g].parameters, size * sizeof *parameters);
        memcpy(factors + g * all, places[g].factors, all * sizeof *factors);
    }
    return 0;
}
