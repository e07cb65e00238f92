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
#include "loops.h"

#include <string.h>

enum { AXES = 3, LANES = 4, MEAN = 3 };
enum { DRIFT, VELOCITY, WANDER };
enum { PARAMETERS = 4 };

/* Symmetric matrices (2, 2) are their entries 00, 01 and 11. */
typedef double Symmetric[3];

/* What the filter knows at a pose; lanes are the axes and, last, the ones. */
typedef struct {
    double f, c, a, rest; /* of the step that begins here; rest: 1 - exp(-interval / time) */
    Symmetric q;
    double drift;            /* the part of q's 00 that is the walk's */
    double noise, jitter;    /* r, and the estimate's part of it */
    double precision;        /* 1 / S of the innovation; 0 of a flat first position */
    double gain[2];          /* g */
    Symmetric covariance;    /* C, with this pose */
    double innovation[LANES];
    double velocity[LANES]; /* the mean of x's second component, with this pose */
} Filtered;

/* What all poses say of one. */
typedef struct {
    double score[LANES];    /* u = n / r */
    double state[2][LANES]; /* x */
    double felt[2][LANES];  /* Q⁻¹ w of the step that begins here */
    double adjoint[LANES];  /* ε: how F's slope by the time is felt, here and later */
} Smoothed;

int64_t chain_filtered_size(void) { return sizeof(Filtered) / sizeof(double); }
int64_t chain_smoothed_size(void) { return sizeof(Smoothed) / sizeof(double); }

/* 2h - 3 + 4a - a² with a = exp(-h); by its series where the formula loses digits. */
static double integral(double h, double a)
{
    static const double terms[] = {2.0 / 3, -1.0 / 2, 7.0 / 30, -1.0 / 12, 31.0 / 1260, -1.0 / 160,
                                   127.0 / 90720};
    if (h >= 0.05)
        return 2.0 * h - 3.0 + 4.0 * a - a * a;
    double sum = 0.0;
    for (int i = 6; i >= 0; i--)
        sum = sum * h + terms[i];
    return sum * h * h * h;
}

/* The process (error_model/process.py) at its parameters. */
typedef struct {
    int kind;
    double jitter, drift, variance, time;
} Process;

static Process process(int64_t kind, const double *parameters)
{
    Process p = {(int)kind, exp(2.0 * parameters[0]), 0.0, 0.0, 1.0};
    if (kind != WANDER)
        p.drift = exp(2.0 * parameters[1]);
    if (kind != DRIFT) {
        const double *last = parameters + (kind == VELOCITY ? 2 : 1);
        p.variance = exp(2.0 * last[0]);
        p.time = exp(last[1]);
    }
    return p;
}

/* F and Q of a step; the factor is of the variance of x's first component. */
static inline void set_step(const Process *p, double interval, double factor, Filtered *at)
{
    at->f = 1.0;
    at->c = at->a = at->rest = 0.0;
    at->q[1] = at->q[2] = 0.0;
    at->q[0] = at->drift = interval * p->drift * factor;
    if (p->kind == DRIFT)
        return;
    const double h = interval / p->time;
    const double rest = -expm1(-h), a = h < 0.5 ? 1.0 - rest : exp(-h);
    const double stationary = p->variance * rest * (1.0 + a);
    at->rest = rest;
    if (p->kind == WANDER) {
        at->f = a;
        at->q[0] = stationary * factor;
        return;
    }
    at->a = a;
    at->c = p->time * rest;
    at->q[0] += p->variance * p->time * p->time * integral(h, a) * factor;
    at->q[1] = p->variance * p->time * rest * rest;
    at->q[2] = stationary;
}

/* Whether a step's Q is positive definite. */
static inline int is_proper(int kind, const Filtered *at)
{
    const double det = kind == VELOCITY ? at->q[0] * at->q[2] - at->q[1] * at->q[1] : 1.0;
    return at->q[0] > 0.0 && det > 0.0;
}

/* A state's covariance and mean with a pose, over the step that begins there. */
static inline void predict(const Filtered *at, double *covariance, double *position,
                           double *velocity)
{
    const double f = at->f, c = at->c, a = at->a, *from = at->covariance;
    covariance[0] = f * f * from[0] + 2.0 * f * c * from[1] + c * c * from[2] + at->q[0];
    covariance[1] = a * (f * from[1] + c * from[2]) + at->q[1];
    covariance[2] = a * a * from[2] + at->q[2];
    for (int x = 0; x < LANES; x++) {
        position[x] = f * position[x] + c * velocity[x];
        velocity[x] *= a;
    }
}

/* Σ ν² / S of errors about a mean (3,). */
static double squares_about(const double *mean, int64_t count, const Filtered *filtered)
{
    double squares = 0.0;
    for (const Filtered *at = filtered; at < filtered + count; at++)
        for (int x = 0; x < AXES; x++) {
            const double innovation = at->innovation[x] - mean[x] * at->innovation[MEAN];
            squares += at->precision * innovation * innovation;
        }
    return squares;
}

/* The filter. parameters (p,), intervals and moved (N - 1,), errors (3, N), variance and measured
 * (N,), filtered (N,). found: log L, the mean's information, the means (3,). Not 0 where there is
 * no likelihood. */
int chain_filter(int64_t kind, int64_t count, const double *parameters, const double *intervals,
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
            at->velocity[x] = velocity[x] += g1 * innovation;
        }
        for (int x = 0; x < LANES; x++)
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
        predict(at, b, position, velocity);
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

/* The slopes of a step's Q by each parameter but the jitter's, and of F's last column by the time's
 * logarithm. */
typedef struct {
    Symmetric q[PARAMETERS];
    double column[2];
} Slopes;

static inline void set_slopes(const Process *p, double interval, double factor, const Filtered *at,
                              Slopes *slopes)
{
    if (p->kind == DRIFT) {
        slopes->q[1][0] = 2.0 * at->q[0];
        slopes->q[1][1] = slopes->q[1][2] = 0.0;
        return;
    }
    const double h = interval / p->time, rest = at->rest;
    if (p->kind == WANDER) {
        const double a = at->f;
        memset(slopes->q, 0, sizeof slopes->q);
        slopes->q[1][0] = 2.0 * at->q[0];
        slopes->q[2][0] = -2.0 * p->variance * a * a * h * factor;
        slopes->column[0] = a * h;
        slopes->column[1] = 0.0;
        return;
    }
    const double a = at->a, stationary = at->q[0] - at->drift;
    double *const drift = slopes->q[1], *const std = slopes->q[2], *const time = slopes->q[3];
    drift[0] = 2.0 * at->drift;
    drift[1] = drift[2] = 0.0;
    std[0] = 2.0 * stationary;
    std[1] = 2.0 * at->q[1];
    std[2] = 2.0 * at->q[2];
    time[0] = 2.0 * (stationary - p->variance * p->time * p->time * h * rest * rest * factor);
    time[1] = p->variance * p->time * rest * (rest - 2.0 * a * h);
    time[2] = -2.0 * p->variance * a * a * h;
    slopes->column[0] = p->time * (rest - a * h);
    slopes->column[1] = a * h;
}

static inline double trace(const Symmetric a, const Symmetric b)
{
    return a[0] * b[0] + 2.0 * a[1] * b[1] + a[2] * b[2];
}

/* What is known of a disturbance below this share of what is known of its pose is none. */
static const double ROUND_OFF = 1e-10;

/* From the score of a disturbance on three axes and what is known of it: the square of its estimate,
 * and the variance beside its own. */
static inline void set_disturbance(const double *score, double known, double most, double own,
                                   double *square, double *rest)
{
    const double least = fmax(known, ROUND_OFF * most);
    const double size = score[0] * score[0] + score[1] * score[1] + score[2] * score[2];
    *square = size / (least * least);
    *rest = fmax(1.0 / least - own, 0.0);
}

static inline int last_of(int kind) { return kind == DRIFT ? 1 : kind == VELOCITY ? 3 : 2; }

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

static inline void pull_back(const Filtered *at, const Later *later, Back *back)
{
    const double f = at->f, c = at->c, a = at->a, *k = later->known;
    for (int x = 0; x < LANES; x++) {
        back->felt[0][x] = f * later->felt[0][x];
        back->felt[1][x] = c * later->felt[0][x] + a * later->felt[1][x];
    }
    back->known[0] = f * f * k[0];
    back->known[1] = f * (c * k[0] + a * k[1]);
    back->known[2] = c * c * k[0] + 2.0 * c * a * k[1] + a * a * k[2];
}

/* n / r and x of a pose, with its errors (LANES,) about the mean. */
static inline void set_pose(const Filtered *at, const double *errors, const double *mean,
                            const Back *back, Smoothed *to)
{
    const double *b0 = back->felt[0], *b1 = back->felt[1], *c = at->covariance;
    for (int x = 0; x < LANES; x++) {
        const double innovation = at->innovation[x] - mean[x] * at->innovation[MEAN];
        to->score[x] = at->precision * innovation - at->gain[0] * b0[x] - at->gain[1] * b1[x];
        to->state[0][x] = errors[x] - at->noise * to->score[x];
        to->state[1][x] = at->velocity[x] + c[1] * b0[x] + c[2] * b1[x];
    }
}

/* The variance of a pose's score. */
static inline double known_of_pose(const Filtered *at, const Back *back)
{
    const double g0 = at->gain[0], g1 = at->gain[1], *k = back->known;
    return at->precision + g0 * g0 * k[0] + 2.0 * g0 * g1 * k[1] + g1 * g1 * k[2];
}

/* Adds a step's part of the gradient: half of ∂Q by Σ felt felt' - 3 known and, of the column of ∂F,
 * Σ x felt' - 3 cov(x, felt), x the state's last component. spread: the variance of the mean. */
static inline void add_slopes(const Process *p, const Slopes *slopes, const Filtered *at,
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
        felt[1] += f0[axis] * f1[axis];
        felt[2] += f1[axis] * f1[axis];
        crossed0 += x[axis] * f0[axis];
        crossed1 += x[axis] * f1[axis];
    }
    for (int j = 1; j <= last; j++)
        gradient[j] += 0.5 * trace(slopes->q[j], felt);
    if (p->kind != DRIFT)
        gradient[last] += slopes->column[0] * crossed0 + slopes->column[1] * crossed1;
}

/* That of the first state's own variance. */
static inline void add_slope_of_first(const Process *p, const Filtered *at, const Smoothed *to,
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
static inline void go_back(const Filtered *at, const Smoothed *to, const Back *back, Later *later)
{
    const double left = at->noise * at->precision; /* 1 - g0 */
    const double g1 = at->gain[1], *k = back->known;
    later->known[0] =
        at->precision + left * left * k[0] - 2.0 * left * g1 * k[1] + g1 * g1 * k[2];
    later->known[1] = left * k[1] - g1 * k[2];
    later->known[2] = k[2];
    for (int x = 0; x < LANES; x++) {
        later->felt[0][x] = to->score[x] + back->felt[0][x];
        later->felt[1][x] = back->felt[1][x];
    }
}

/* The smoother. found: as the filter has left it. smoothed (N,); disturbances: of poses (2, N), of
 * steps (2, N - 1), each squares and rests; gradient (p,). */
int chain_smooth(int64_t kind, int64_t count, const double *parameters, const double *intervals,
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
            pull_back(at, &later, &back);
        set_pose(at, z, mean, &back, to);
        const double *u = to->score;
        const double known = known_of_pose(at, &back) - spread * u[MEAN] * u[MEAN];
        const double size = u[0] * u[0] + u[1] * u[1] + u[2] * u[2];
        set_disturbance(u, known, 1.0 / at->noise, at->jitter, poses + i, poses + count + i);
        slope[0] += at->jitter * (size - AXES * known);
        memcpy(to->felt, later.felt, sizeof to->felt);
        if (i + 1 < count) {
            const double *f0 = later.felt[0], *f1 = later.felt[1];
            const double det = at->q[0] * at->q[2] - at->q[1] * at->q[1];
            set_disturbance(f0, later.known[0] - spread * f0[MEAN] * f0[MEAN],
                            own ? at->q[2] / det : 1.0 / at->q[0], at->q[0], steps + i,
                            steps + count - 1 + i);
            Slopes slopes;
            set_slopes(&p, intervals[i], moved[i], at, &slopes);
            add_slopes(&p, &slopes, at, to, &later, spread, slope);
            for (int x = 0; x < AXES && p.kind != DRIFT; x++)
                later.adjoint[x] = slopes.column[0] * f0[x] + slopes.column[1] * f1[x] +
                                   (own ? at->a : at->f) * later.adjoint[x];
        }
        memcpy(to->adjoint, later.adjoint, sizeof to->adjoint);
        if (i == 0 && p.kind != DRIFT)
            add_slope_of_first(&p, at, to, &back, spread, slope);
        go_back(at, to, &back, &later);
    }
    memcpy(gradient, slope, (last_of(p.kind) + 1) * sizeof *gradient);
    return 0;
}

/* The average information (p, p): ½ q_j P q_l with q_j = ∂V/∂ψ_j P z, filtered as z is. */
int chain_information(int64_t kind, int64_t count, const double *parameters,
                      const double *intervals, const double *moved, const Filtered *filtered,
                      const double *found, const Smoothed *smoothed, double *information)
{
    const Process p = process(kind, parameters);
    const int last = last_of(p.kind), size = last + 1, own = p.kind == VELOCITY;
    /* What q_j's states are beyond what the filter says. */
    double state[PARAMETERS][2][LANES] = {{{0.0}}};
    double ahead[PARAMETERS][LANES] = {{0.0}}, sums[PARAMETERS][PARAMETERS] = {{0.0}};
    if (p.kind != DRIFT)
        for (int x = 0; x < AXES; x++) {
            state[last - 1][own][x] = 2.0 * smoothed->state[own][x];
            state[last][own][x] = p.variance * smoothed->adjoint[x];
        }
    for (int64_t i = 0; i < count; i++) {
        const Filtered *at = filtered + i;
        const Smoothed *here = smoothed + i;
        double innovation[PARAMETERS][LANES];
        for (int j = 0; j < size; j++)
            for (int x = 0; x < LANES; x++)
                innovation[j][x] = state[j][0][x];
        for (int x = 0; x < AXES; x++)
            innovation[0][x] += 2.0 * at->jitter * here->score[x];
        for (int j = 0; j < size; j++) {
            for (int l = 0; l <= j; l++)
                for (int x = 0; x < AXES; x++)
                    sums[j][l] += at->precision * innovation[j][x] * innovation[l][x];
            const double one = at->precision * at->innovation[MEAN];
            for (int x = 0; x < LANES; x++) {
                ahead[j][x] += one * innovation[j][x];
                state[j][0][x] -= at->gain[0] * innovation[j][x];
                state[j][1][x] -= at->gain[1] * innovation[j][x];
            }
        }
        if (i + 1 == count)
            break;
        Slopes slopes;
        set_slopes(&p, intervals[i], moved[i], at, &slopes);
        for (int j = 0; j < size; j++)
            for (int x = 0; x < LANES; x++) {
                state[j][0][x] = at->f * state[j][0][x] + at->c * state[j][1][x];
                state[j][1][x] *= at->a;
            }
        for (int j = 1; j < size; j++)
            for (int x = 0; x < AXES; x++) {
                const double *q = slopes.q[j];
                state[j][0][x] += q[0] * here->felt[0][x] + q[1] * here->felt[1][x];
                state[j][1][x] += q[1] * here->felt[0][x] + q[2] * here->felt[1][x];
            }
        if (p.kind == DRIFT)
            continue;
        for (int x = 0; x < AXES; x++) {
            const double later = here[1].adjoint[x];
            state[last][0][x] += slopes.column[0] * here->state[own][x] + at->q[own] * later;
            state[last][1][x] +=
                slopes.column[1] * here->state[own][x] + at->q[2 * own] * later * own;
        }
    }
    for (int j = 0; j < size; j++)
        for (int l = 0; l <= j; l++) {
            double sum = sums[j][l];
            for (int x = 0; x < AXES && p.kind == WANDER; x++)
                sum -= ahead[j][x] * ahead[l][x] / found[1];
            information[j * size + l] = information[l * size + j] = 0.5 * sum;
        }
    return 0;
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
