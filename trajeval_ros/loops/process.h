/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The steps of a process (error_model/process.py), and their slopes.
 */
#ifndef TRAJEVAL_ROS_PROCESS_H
#define TRAJEVAL_ROS_PROCESS_H

#include "chain.h"

#include <string.h>

/* 2h - 3 + 4a - a² with a = exp(-h); by its series where the formula loses digits. */
LOOPS_PART double integral(double h, double a)
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

LOOPS_PART Process process(int kind, const double *parameters)
{
    Process p = {kind, exp(2.0 * parameters[0]), 0.0, 0.0, 1.0};
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
LOOPS_PART void set_step(const Process *p, double interval, double factor, Filtered *at)
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

/* The slopes of a step's Q by each parameter but the jitter's, and of F's last column by the time's
 * logarithm. */
typedef struct {
    Symmetric q[PARAMETERS];
    double column[2];
} Slopes;

LOOPS_PART void set_slopes(const Process *p, double interval, double factor, const Filtered *at,
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

#endif
