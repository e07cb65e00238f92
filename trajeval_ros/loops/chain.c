/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The restricted likelihood of errors z (3 axes, N poses) whose axes are alike: Kalman's filter, and
 * the smoother of its disturbances (de Jong). On each axis
 *
 *     z_i = mean + e'x_i + n_i,  n_i ~ N(0, r_i),      x_(i+1) = F_i x_i + w_i,  w_i ~ N(0, Q_i)
 *
 * with e = (1, 0), F = [[f, c], [0, a]] and x of two components, of which the second is nothing but
 * for VELOCITY. The first position is flat of DRIFT and VELOCITY; WANDER has a flat mean instead,
 * by a fourth right-hand side beside the three axes, ones. No Q is inverted, and variances but the
 * velocity's are sums of what is not negative: digits stay however small Q or r is beside the other.
 */
#include "process.h"

#include <string.h>

int64_t chain_filtered_size(void) { return sizeof(Filtered) / sizeof(double); }
int64_t chain_smoothed_size(void) { return sizeof(Smoothed) / sizeof(double); }

/* Whether a step's Q is positive definite. */
LOOPS_PART int is_proper(int kind, const Filtered *at)
{
    const double det = kind == VELOCITY ? at->q[0] * at->q[2] - at->q[1] * at->q[1] : 1.0;
    return at->q[0] > 0.0 && det > 0.0;
}

/* A state's covariance and mean with a pose, over the step that begins there. */
LOOPS_PART void predict(int kind, const Filtered *at, double *covariance, double *position,
                        double *velocity)
{
    const double f = at->f, c = at->c, a = at->a, *from = at->covariance;
    if (kind != VELOCITY) {
        covariance[0] = f * f * from[0] + at->q[0];
        for (int x = 0; x < LANES && kind == WANDER; x++)
            position[x] *= f;
        return;
    }
    covariance[0] = from[0] + 2.0 * c * from[1] + c * c * from[2] + at->q[0];
    covariance[1] = a * (from[1] + c * from[2]) + at->q[1];
    covariance[2] = a * a * from[2] + at->q[2];
    for (int x = 0; x < LANES; x++) {
        position[x] += c * velocity[x];
        velocity[x] *= a;
    }
}

/* Σ ν² / S of errors about a mean (3,). */
LOOPS_PART double squares_about(const double *mean, int64_t count, const Filtered *filtered)
{
    double squares = 0.0;
    for (const Filtered *at = filtered; at < filtered + count; at++)
        for (int x = 0; x < AXES; x++) {
            const double innovation = at->innovation[x] - mean[x] * at->innovation[MEAN];
            squares += at->precision * innovation * innovation;
        }
    return squares;
}

LOOPS_PART int filter(int kind, int64_t count, const double *parameters, const double *intervals,
                      const double *errors, const double *variance, const double *measured,
                      const double *moved, Filtered *filtered, double *found)
{
    const Process p = process(kind, parameters);
    /* Predicted: the covariance B and the mean of x. */
    Symmetric b = {p.kind == WANDER ? p.variance : 0.0, 0.0, p.kind == VELOCITY ? p.variance : 0.0};
    double position[LANES] = {0.0}, velocity[LANES] = {0.0};
    double log_det = 0.0, product = 1.0, mean[LANES] = {0.0};
    for (int64_t i = 0; i < count; i++) {
        Filtered *at = filtered + i;
        const double z[LANES] = {errors[i], errors[count + i], errors[2 * count + i],
                                 p.kind == WANDER ? 1.0 : 0.0};
        const int flat = i == 0 && p.kind != WANDER;
        at->jitter = measured[i] * p.jitter;
        const double r = at->noise = variance[i] + at->jitter;
        if (!(r > 0.0))
            return 1;
        /* A flat first position has no innovation. */
        const double s = flat ? 1.0 : b[0] + r;
        const double precision = at->precision = flat ? 0.0 : 1.0 / s;
        const double g0 = at->gain[0] = flat ? 1.0 : b[0] * precision;
        const double g1 = at->gain[1] = b[1] * precision;
        for (int x = 0; x < LANES; x++) {
            const double innovation = z[x] - position[x];
            at->innovation[x] = innovation;
            position[x] += g0 * innovation;
            if (p.kind == VELOCITY)
                velocity[x] += g1 * innovation;
            at->velocity[x] = velocity[x];
        }
        for (int x = 0; x < LANES && p.kind == WANDER; x++)
            mean[x] += precision * at->innovation[MEAN] * at->innovation[x];
        /* The logarithm of many at once. */
        product *= s;
        if (!(product > 1e-100 && product < 1e100)) {
            log_det += log(product);
            product = 1.0;
        }
        at->covariance[0] = r * g0;
        at->covariance[1] = r * g1;
        at->covariance[2] = b[2] - g1 * b[1];
        if (i + 1 == count)
            break;
        set_step(&p, intervals[i], moved[i], at);
        if (!is_proper(p.kind, at))
            return 1;
        predict(p.kind, at, b, position, velocity);
    }
    const double information = mean[MEAN];
    if (p.kind == WANDER) {
        if (!(information > 0.0))
            return 1;
        log_det += log(information);
        for (int x = 0; x < AXES; x++)
            mean[x] /= information;
    }
    log_det += log(product);
    found[0] = -0.5 * (squares_about(mean, count, filtered) + AXES * log_det);
    found[1] = p.kind == WANDER ? information : 1.0;
    memcpy(found + 2, mean, AXES * sizeof(double));
    return !isfinite(found[0]);
}

/* The filter. parameters (p,), intervals and moved (N - 1,), errors (3, N), variance and measured
 * (N,), filtered (N,). found: log L, the mean's information, the means (3,). Not 0 where there is
 * no likelihood. */
LOOPS_WIDE int chain_filter(int64_t kind, int64_t count, const double *parameters,
                            const double *intervals, const double *errors, const double *variance,
                            const double *measured, const double *moved, Filtered *filtered,
                            double *found)
{
    return OF_KIND(filter, kind, count, parameters, intervals, errors, variance, measured, moved,
                   filtered, found);
}

LOOPS_PART double trace(const Symmetric a, const Symmetric b)
{
    return a[0] * b[0] + 2.0 * a[1] * b[1] + a[2] * b[2];
}

/* What is known of a disturbance below this share of what is known of its pose is none. */
static const double ROUND_OFF = 1e-10;

/* From the score of a disturbance on three axes and what is known of it, of most / part: the square
 * of its estimate, and the variance beside its own. */
LOOPS_PART void set_disturbance(const double *score, double known, double most, double part,
                                double own, double *square, double *rest)
{
    const double least = ROUND_OFF * most;
    const double variance = known * part > least ? 1.0 / known : part / least;
    const double size = score[0] * score[0] + score[1] * score[1] + score[2] * score[2];
    *square = size * variance * variance;
    *rest = variance > own ? variance - own : 0.0;
}

LOOPS_PART int last_of(int kind) { return kind == DRIFT ? 1 : kind == VELOCITY ? 3 : 2; }

/* What is known, from later on, of the step that begins at a pose: Q⁻¹ w and its variance, and ε. */
typedef struct {
    double felt[2][LANES];
    Symmetric known;
    double adjoint[LANES];
} Later;

/* What later poses say of a pose's state: F'felt, and its variance F'known F. */
typedef struct {
    double felt[2][LANES];
    Symmetric known;
} Back;

LOOPS_PART void pull_back(int kind, const Filtered *at, const Later *later, Back *back)
{
    const double f = at->f, c = at->c, a = at->a, *k = later->known;
    if (kind != VELOCITY) {
        for (int x = 0; x < LANES; x++)
            back->felt[0][x] = f * later->felt[0][x];
        back->known[0] = f * f * k[0];
        return;
    }
    for (int x = 0; x < LANES; x++) {
        back->felt[0][x] = f * later->felt[0][x];
        back->felt[1][x] = c * later->felt[0][x] + a * later->felt[1][x];
    }
    back->known[0] = f * f * k[0];
    back->known[1] = f * (c * k[0] + a * k[1]);
    back->known[2] = c * c * k[0] + 2.0 * c * a * k[1] + a * a * k[2];
}

/* n / r and x of a pose, with its errors (LANES,) about the mean. */
LOOPS_PART void set_pose(int kind, const Filtered *at, const double *errors, const double *mean,
                         const Back *back, Smoothed *to)
{
    const double *b0 = back->felt[0], *b1 = back->felt[1], *c = at->covariance;
    for (int x = 0; x < LANES; x++) {
        double innovation = at->innovation[x];
        if (kind == WANDER)
            innovation -= mean[x] * at->innovation[MEAN];
        to->score[x] = at->precision * innovation - at->gain[0] * b0[x];
        if (kind == VELOCITY)
            to->score[x] -= at->gain[1] * b1[x];
        to->state[0][x] = errors[x] - at->noise * to->score[x];
        to->state[1][x] = kind == VELOCITY ? at->velocity[x] + c[1] * b0[x] + c[2] * b1[x] : 0.0;
    }
}

/* The variance of a pose's score. */
LOOPS_PART double known_of_pose(int kind, const Filtered *at, const Back *back)
{
    const double g0 = at->gain[0], g1 = at->gain[1], *k = back->known;
    if (kind != VELOCITY)
        return at->precision + g0 * g0 * k[0];
    return at->precision + g0 * g0 * k[0] + 2.0 * g0 * g1 * k[1] + g1 * g1 * k[2];
}

/* Adds a step's part of the gradient: half of ∂Q by Σ felt felt' - 3 known and, of the column of ∂F,
 * Σ x felt' - 3 cov(x, felt), x the state's last component. spread: the variance of the mean. */
LOOPS_PART void add_slopes(const Process *p, const Slopes *slopes, const Filtered *at,
                           const Smoothed *to, const Later *later, double spread,
                           double *gradient)
{
    const int last = last_of(p->kind), own = p->kind == VELOCITY;
    const double *f0 = later->felt[0], *f1 = later->felt[1], *x = to->state[own];
    const double *c = at->covariance, *k = later->known;
    /* C F' of x. */
    const double row0 = own ? c[1] * at->f + c[2] * at->c : c[0] * at->f;
    const double row1 = own ? c[2] * at->a : 0.0;
    const double one = spread * f0[MEAN];
    Symmetric felt = {-AXES * (k[0] - one * f0[MEAN]), -AXES * k[1], -AXES * k[2]};
    double crossed0 = -AXES * (row0 * k[0] + row1 * k[1] - one * to->state[0][MEAN]);
    double crossed1 = -AXES * (row0 * k[1] + row1 * k[2]);
    for (int axis = 0; axis < AXES; axis++) {
        felt[0] += f0[axis] * f0[axis];
        crossed0 += x[axis] * f0[axis];
        if (own) {
            felt[1] += f0[axis] * f1[axis];
            felt[2] += f1[axis] * f1[axis];
            crossed1 += x[axis] * f1[axis];
        }
    }
    for (int j = 1; j <= last; j++)
        gradient[j] += 0.5 * (own ? trace(slopes->q[j], felt) : slopes->q[j][0] * felt[0]);
    if (p->kind != DRIFT)
        gradient[last] += slopes->column[0] * crossed0;
    if (own)
        gradient[last] += slopes->column[1] * crossed1;
}

/* That of the first state's own variance. */
LOOPS_PART void add_slope_of_first(const Process *p, const Filtered *at, const Smoothed *to,
                                   const Back *back, double spread, double *gradient)
{
    const int own = p->kind == VELOCITY;
    const double c0 = at->covariance[own], c1 = own ? at->covariance[2] : 0.0, *k = back->known;
    const double told = c0 * c0 * k[0] + 2.0 * c0 * c1 * k[1] + c1 * c1 * k[2];
    const double one = to->state[0][MEAN], *x = to->state[own];
    double first = AXES * (at->covariance[2 * own] - told + spread * one * one);
    for (int axis = 0; axis < AXES; axis++)
        first += x[axis] * x[axis];
    gradient[last_of(p->kind) - 1] += first / p->variance - AXES;
}

/* From the step that begins at a pose to the one that ends there. */
LOOPS_PART void go_back(int kind, const Filtered *at, const Smoothed *to, const Back *back,
                        Later *later)
{
    const double left = at->noise * at->precision; /* 1 - g0 */
    const double g1 = at->gain[1], *k = back->known;
    later->known[0] = at->precision + left * left * k[0];
    for (int x = 0; x < LANES; x++)
        later->felt[0][x] = to->score[x] + back->felt[0][x];
    if (kind != VELOCITY)
        return;
    later->known[0] += g1 * g1 * k[2] - 2.0 * left * g1 * k[1];
    later->known[1] = left * k[1] - g1 * k[2];
    later->known[2] = k[2];
    for (int x = 0; x < LANES; x++)
        later->felt[1][x] = back->felt[1][x];
}

LOOPS_PART int smooth(int kind, int64_t count, const double *parameters, const double *intervals,
                      const double *errors, const double *moved, const Filtered *filtered,
                      const double *found, Smoothed *smoothed, double *poses, double *steps,
                      double *gradient)
{
    const Process p = process(kind, parameters);
    const int own = p.kind == VELOCITY;
    const double spread = p.kind == WANDER ? 1.0 / found[1] : 0.0; /* the mean's variance */
    const double mean[LANES] = {found[2], found[3], found[4], 0.0};
    Later later = {{{0.0}}, {0.0}, {0.0}};
    double slope[PARAMETERS] = {0.0};
    for (int64_t i = count - 1; i >= 0; i--) {
        const Filtered *at = filtered + i;
        Smoothed *to = smoothed + i;
        const double z[LANES] = {errors[i] - mean[0], errors[count + i] - mean[1],
                                 errors[2 * count + i] - mean[2], 1.0};
        Back back = {{{0.0}}, {0.0}};
        if (i + 1 < count)
            pull_back(p.kind, at, &later, &back);
        set_pose(p.kind, at, z, mean, &back, to);
        const double *u = to->score;
        const double known = known_of_pose(p.kind, at, &back) - spread * u[MEAN] * u[MEAN];
        const double size = u[0] * u[0] + u[1] * u[1] + u[2] * u[2];
        set_disturbance(u, known, 1.0, at->noise, at->jitter, poses + i, poses + count + i);
        slope[0] += at->jitter * (size - AXES * known);
        memcpy(to->felt, later.felt, sizeof to->felt);
        if (i + 1 < count) {
            const double *f0 = later.felt[0], *f1 = later.felt[1];
            const double det = at->q[0] * at->q[2] - at->q[1] * at->q[1];
            set_disturbance(f0, later.known[0] - spread * f0[MEAN] * f0[MEAN],
                            own ? at->q[2] : 1.0, own ? det : at->q[0], at->q[0], steps + i,
                            steps + count - 1 + i);
            Slopes slopes;
            set_slopes(&p, intervals[i], moved[i], at, &slopes);
            add_slopes(&p, &slopes, at, to, &later, spread, slope);
            for (int x = 0; x < LANES && p.kind != DRIFT; x++)
                later.adjoint[x] = slopes.column[0] * f0[x] + slopes.column[1] * f1[x] +
                                   (own ? at->a : at->f) * later.adjoint[x];
        }
        memcpy(to->adjoint, later.adjoint, sizeof to->adjoint);
        if (i == 0 && p.kind != DRIFT)
            add_slope_of_first(&p, at, to, &back, spread, slope);
        go_back(p.kind, at, to, &back, &later);
    }
    memcpy(gradient, slope, (last_of(p.kind) + 1) * sizeof *gradient);
    return 0;
}

/* The smoother. found: as the filter has left it. smoothed (N,); disturbances: of poses (2, N), of
 * steps (2, N - 1), each squares and rests; gradient (p,). */
LOOPS_WIDE int chain_smooth(int64_t kind, int64_t count, const double *parameters,
                            const double *intervals, const double *errors, const double *moved,
                            const Filtered *filtered, const double *found, Smoothed *smoothed,
                            double *poses, double *steps, double *gradient)
{
    return OF_KIND(smooth, kind, count, parameters, intervals, errors, moved, filtered, found,
                   smoothed, poses, steps, gradient);
}

LOOPS_PART int information(int kind, int64_t count, const double *parameters,
                           const double *intervals, const double *moved, const Filtered *filtered,
                           const double *found, const Smoothed *smoothed, double *told)
{
    const Process p = process(kind, parameters);
    const int last = last_of(p.kind), size = last + 1, own = p.kind == VELOCITY;
    /* What q_j's states are beyond what the filter says; the lane of the ones counts nowhere. */
    double state[PARAMETERS][2][LANES] = {{{0.0}}};
    double ahead[PARAMETERS][LANES] = {{0.0}}, sums[PARAMETERS][PARAMETERS][LANES] = {{{0.0}}};
    if (p.kind != DRIFT)
        for (int x = 0; x < LANES; x++) {
            state[last - 1][own][x] = 2.0 * smoothed->state[own][x];
            state[last][own][x] = p.variance * smoothed->adjoint[x];
        }
    for (int64_t i = 0; i < count; i++) {
        const Filtered *at = filtered + i;
        const Smoothed *here = smoothed + i;
        double innovation[PARAMETERS][LANES], weighted[PARAMETERS][LANES];
        memcpy(innovation[0], state[0][0], sizeof innovation[0]);
        for (int x = 0; x < LANES; x++)
            innovation[0][x] += 2.0 * at->jitter * here->score[x];
        for (int j = 1; j < size; j++)
            memcpy(innovation[j], state[j][0], sizeof innovation[j]);
        for (int j = 0; j < size; j++)
            for (int x = 0; x < LANES; x++)
                weighted[j][x] = at->precision * innovation[j][x];
        for (int j = 0; j < size; j++)
            for (int l = 0; l <= j; l++)
                for (int x = 0; x < LANES; x++)
                    sums[j][l][x] += weighted[j][x] * innovation[l][x];
        for (int j = 0; j < size; j++)
            for (int x = 0; x < LANES; x++) {
                if (p.kind == WANDER)
                    ahead[j][x] += at->innovation[MEAN] * weighted[j][x];
                state[j][0][x] -= at->gain[0] * innovation[j][x];
                if (own)
                    state[j][1][x] -= at->gain[1] * innovation[j][x];
            }
        if (i + 1 == count)
            break;
        Slopes slopes;
        set_slopes(&p, intervals[i], moved[i], at, &slopes);
        for (int j = 0; j < size; j++)
            for (int x = 0; x < LANES; x++) {
                if (own) {
                    state[j][0][x] += at->c * state[j][1][x];
                    state[j][1][x] *= at->a;
                } else if (p.kind == WANDER) {
                    state[j][0][x] *= at->f;
                }
            }
        for (int j = 1; j < size; j++)
            for (int x = 0; x < LANES; x++) {
                const double *q = slopes.q[j];
                state[j][0][x] += q[0] * here->felt[0][x];
                if (own) {
                    state[j][0][x] += q[1] * here->felt[1][x];
                    state[j][1][x] += q[1] * here->felt[0][x] + q[2] * here->felt[1][x];
                }
            }
        for (int x = 0; x < LANES && p.kind != DRIFT; x++) {
            const double later = here[1].adjoint[x];
            state[last][0][x] += slopes.column[0] * here->state[own][x] + at->q[own] * later;
            if (own)
                state[last][1][x] += slopes.column[1] * here->state[1][x] + at->q[2] * later;
        }
    }
    for (int j = 0; j < size; j++)
        for (int l = 0; l <= j; l++) {
            double sum = 0.0;
            for (int x = 0; x < AXES; x++) {
                sum += sums[j][l][x];
                if (p.kind == WANDER)
                    sum -= ahead[j][x] * ahead[l][x] / found[1];
            }
            told[j * size + l] = told[l * size + j] = 0.5 * sum;
        }
    return 0;
}

/* The average information (p, p): ½ q_j P q_l with q_j = ∂V/∂ψ_j P z, filtered as z is. */
LOOPS_WIDE int chain_information(int64_t kind, int64_t count, const double *parameters,
                                 const double *intervals, const double *moved,
                                 const Filtered *filtered, const double *found,
                                 const Smoothed *smoothed, double *told)
{
    return OF_KIND(information, kind, count, parameters, intervals, moved, filtered, found,
                   smoothed, told);
}

/* Other errors, values (N, lanes): their innovations by their standard deviations, whitened (N,
 * lanes). work: (2, lanes). */
LOOPS_WIDE
int chain_whiten(int64_t count, int64_t lanes, const Filtered *filtered,
                 const double *restrict values, double *restrict whitened, double *restrict work)
{
    double *restrict const position = work, *restrict const velocity = work + lanes;
    memset(work, 0, 2 * lanes * sizeof *work);
    for (int64_t i = 0; i < count; i++) {
        const Filtered *at = filtered + i;
        const int step = i + 1 < count;
        const double g0 = at->gain[0], g1 = at->gain[1], root = sqrt(at->precision);
        const double f = step ? at->f : 0.0, c = step ? at->c : 0.0, a = step ? at->a : 0.0;
        const double *restrict z = values + i * lanes;
        double *restrict to = whitened + i * lanes;
        for (int64_t x = 0; x < lanes; x++) {
            const double innovation = z[x] - position[x];
            const double v = velocity[x] + g1 * innovation;
            to[x] = root * innovation;
            position[x] = f * (position[x] + g0 * innovation) + c * v;
            velocity[x] = a * v;
        }
    }
    return 0;
}

/* What the process of values (N, lanes) is, as each pose's neighbours tell it: values less their share
 * of the noise. whitened (N, lanes): by `chain_whiten`, in whose place it is written. work: (2,
 * lanes). */
LOOPS_WIDE
int chain_smooth_others(int64_t count, int64_t lanes, const Filtered *filtered,
                        const double *restrict values, double *restrict whitened,
                        double *restrict work)
{
    double *restrict const felt = work, *restrict const later = work + lanes;
    memset(work, 0, 2 * lanes * sizeof *work);
    for (int64_t i = count - 1; i >= 0; i--) {
        const Filtered *at = filtered + i;
        const int step = i + 1 < count;
        const double g0 = at->gain[0], g1 = at->gain[1], root = sqrt(at->precision);
        const double f = step ? at->f : 0.0, c = step ? at->c : 0.0, a = step ? at->a : 0.0;
        const double r = at->noise;
        const double *restrict z = values + i * lanes;
        double *restrict to = whitened + i * lanes;
        for (int64_t x = 0; x < lanes; x++) {
            const double back0 = f * felt[x], back1 = c * felt[x] + a * later[x];
            const double score = root * to[x] - g0 * back0 - g1 * back1;
            to[x] = z[x] - r * score;
            felt[x] = score + back0;
            later[x] = back1;
        }
    }
    return 0;
}

/* Positions (N, 3, columns) and, beside them, what rotations (N, 3, columns) have moved them by until
 * each pose, on the way: travel (N - 1, 3). Written in place of the rotations. work: (3, columns). */
LOOPS_WIDE
int chain_turn(int64_t count, int64_t columns, const double *restrict travel,
               const double *restrict positions, double *restrict rotations,
               double *restrict work)
{
    double *restrict const sum0 = work, *restrict const sum1 = work + columns;
    double *restrict const sum2 = work + 2 * columns;
    memset(work, 0, 3 * columns * sizeof *work);
    for (int64_t i = 0; i < count; i++) {
        const int step = i + 1 < count;
        const double t0 = step ? travel[3 * i] : 0.0, t1 = step ? travel[3 * i + 1] : 0.0;
        const double t2 = step ? travel[3 * i + 2] : 0.0;
        const double *restrict p = positions + 3 * i * columns;
        double *restrict r0 = rotations + 3 * i * columns, *restrict r1 = r0 + columns;
        double *restrict r2 = r1 + columns;
        for (int64_t x = 0; x < columns; x++) {
            const double a = r0[x], b = r1[x], c = r2[x];
            r0[x] = p[x] + sum0[x];
            r1[x] = p[columns + x] + sum1[x];
            r2[x] = p[2 * columns + x] + sum2[x];
            sum0[x] += t1 * c - t2 * b;
            sum1[x] += t2 * a - t0 * c;
            sum2[x] += t0 * b - t1 * a;
        }
    }
    return 0;
}
