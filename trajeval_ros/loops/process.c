/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The steps of both groups' processes, as band.c takes them: each entry of a group's (k, k) for all
 * steps at once.
 */
#include "process.h"

/* Entries of (2, k, k, n), of one group's step. */
LOOPS_PART void put(const Symmetric q, int64_t group, int64_t i, int64_t n, int64_t k,
                    double *into)
{
    double *const to = into + group * k * k * n + i;
    to[0] = q[0];
    if (k > 1) {
        to[n] = to[2 * n] = q[1];
        to[3 * n] = q[2];
    }
}

LOOPS_PART int steps(int kind, int64_t n, int64_t size, const double *parameters,
                     const double *intervals, const double *factors, double *moves,
                     double *noise, double *precision, double *log_det)
{
    const int64_t k = kind == VELOCITY ? 2 : 1;
    *log_det = 0.0;
    for (int64_t g = 0; g < 2; g++) {
        const Process p = process(kind, parameters + g * size);
        double product = 1.0;
        for (int64_t i = 0; i < n; i++) {
            Filtered at;
            set_step(&p, intervals[i], factors[2 * i + g], &at);
            const double det = k > 1 ? at.q[0] * at.q[2] - at.q[1] * at.q[1] : at.q[0];
            if (!(det > 0.0))
                return 1;
            const Symmetric inverse = {k > 1 ? at.q[2] / det : 1.0 / det, -at.q[1] / det,
                                       at.q[0] / det};
            put(at.q, g, i, n, k, noise);
            put(inverse, g, i, n, k, precision);
            double *const to = moves + g * k * k * n + i;
            to[0] = at.f;
            if (k > 1) {
                to[n] = at.c;
                to[2 * n] = 0.0;
                to[3 * n] = at.a;
            }
            product *= det;
            if (!(product > 1e-100 && product < 1e100)) {
                *log_det += log(product);
                product = 1.0;
            }
        }
        *log_det += log(product);
    }
    return 0;
}

/* F, Q and Q^-1 of n steps, (2, k, k, n) each, and log |.| of all Q. parameters (2, p), intervals (n,),
 * factors (n, 2). Not 0 where a Q is not positive definite. */
LOOPS_WIDE int process_steps(int64_t kind, int64_t n, int64_t size, const double *parameters,
                             const double *intervals, const double *factors, double *moves,
                             double *noise, double *precision, double *log_det)
{
    return OF_KIND(steps, kind, n, size, parameters, intervals, factors, moves, noise, precision,
                   log_det);
}

LOOPS_PART int slopes(int kind, int64_t n, int64_t size, const double *parameters,
                      const double *intervals, const double *factors, double *noise,
                      double *moves)
{
    const int64_t k = kind == VELOCITY ? 2 : 1, all = 2 * k * k * n;
    memset(noise, 0, (size_t)all * sizeof *noise); /* by the jitter */
    memset(moves, 0, (size_t)all * sizeof *moves);
    for (int64_t g = 0; g < 2; g++) {
        const Process p = process(kind, parameters + g * size);
        for (int64_t i = 0; i < n; i++) {
            Filtered at;
            Slopes found;
            set_step(&p, intervals[i], factors[2 * i + g], &at);
            set_slopes(&p, intervals[i], factors[2 * i + g], &at, &found);
            for (int64_t j = 1; j < size; j++)
                put(found.q[j], g, i, n, k, noise + j * all);
            if (kind == DRIFT)
                continue;
            double *const to = moves + g * k * k * n + i;
            to[k > 1 ? n : 0] = found.column[0];
            if (k > 1)
                to[3 * n] = found.column[1];
        }
    }
    return 0;
}

/* The slopes of Q by each parameter, (p, 2, k, k, n), and of F by the last, (2, k, k, n). */
LOOPS_WIDE int process_slopes(int64_t kind, int64_t n, int64_t size, const double *parameters,
                              const double *intervals, const double *factors, double *noise,
                              double *moves)
{
    return OF_KIND(slopes, kind, n, size, parameters, intervals, factors, noise, moves);
}
