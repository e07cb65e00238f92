/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The chain of one axis (chain.c), for its climb (climb.c).
 */
#ifndef TRAJEVAL_ROS_CHAIN_H
#define TRAJEVAL_ROS_CHAIN_H

#include "loops.h"

enum { AXES = 3, LANES = 4, MEAN = 3 };
enum { DRIFT, VELOCITY, WANDER };
enum { PARAMETERS = 4 };
/* Of a structure function, at the most, and times that are tried. */
enum { LAGS = 64, TIMES = 12 };

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

/* A function of each process by itself: much of it is nothing for some. */
#define OF_KIND(function, kind, ...)                                  \
    ((kind) == DRIFT      ? function(DRIFT, __VA_ARGS__)              \
     : (kind) == VELOCITY ? function(VELOCITY, __VA_ARGS__)           \
                          : function(WANDER, __VA_ARGS__))

int chain_filter(int64_t kind, int64_t count, const double *parameters, const double *intervals,
                 const double *errors, const double *variance, const double *measured,
                 const double *moved, Filtered *filtered, double *found);

int chain_smooth(int64_t kind, int64_t count, const double *parameters, const double *intervals,
                 const double *errors, const double *moved, const Filtered *filtered,
                 const double *found, Smoothed *smoothed, double *poses, double *steps,
                 double *gradient);

int chain_information(int64_t kind, int64_t count, const double *parameters,
                      const double *intervals, const double *moved, const Filtered *filtered,
                      const double *found, const Smoothed *smoothed, double *told);

/* What a climb keeps to (maximum.py has each as a constant). */
typedef struct {
    double kappa, rare, little_change; /* of the factors */
    double neighbours, farther;        /* among which one changes, and after a step in vain */
    double much, alone;                /* nats for which the factors move first, so often */
    double settled, far, sure;         /* of nats, of logarithms, of nats */
    double trusted, telling;           /* of a curvature */
    double little, longest;            /* of a Newton step */
} Rules;

/* κ Σ log λ of factors (n,), most of which are 1. */
double climb_penalty(int64_t n, const double *factors, double kappa);

int chain_climb(int64_t kind, int64_t count, int64_t size, const double *intervals,
                const double *errors, const double *variance, const double *low,
                const double *high, const Rules *rules, double gain, int64_t steps, int64_t near,
                int64_t weighted, double *parameters, double *factors, Filtered *filtered,
                double *found, Smoothed *smoothed, double *poses, double *moves,
                double *gradient, double *work);

int chain_whiten(int64_t count, int64_t lanes, const Filtered *filtered, const double *values,
                 double *whitened, double *work);
int chain_smooth_others(int64_t count, int64_t lanes, const Filtered *filtered,
                        const double *values, double *whitened, double *work);
int chain_turn(int64_t count, int64_t columns, const double *travel, const double *positions,
               double *rotations, double *work);

/* What a search begins with (structure.py has each as a constant). */
typedef struct {
    double of_median, rare, clipped; /* of a structure function, and to how many lags */
    double growth, longest, gap;
    double least, starts; /* of a start, and how many */
} Beginning;

int structure_starts(int64_t kind, int64_t count, const double *errors, const double *intervals,
                     const double *variance, const Beginning *rules, double *starts, double *work);

#endif
