/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The ground truth between its answers (error_model/recorded.py).
 */
#include "loops.h"
#include "se3.h"

#include <string.h>

enum { POSE = 6 };

/* From p with the slope u to q with the slope v, as s goes from 0 to 1. */
static inline double cubic(double s, double p, double q, double u, double v)
{
    const double a = s * s, b = a * s;
    return p + (3.0 * a - 2.0 * b) * (q - p) + (s - 2.0 * a + b) * u + (b - a) * v;
}

/* R v of a pose (4, 4). */
static inline void turned(const double *pose, const double *v, double *into)
{
    for (int i = 0; i < 3; i++)
        into[i] = pose[4 * i] * v[0] + pose[4 * i + 1] * v[1] + pose[4 * i + 2] * v[2];
}

/* Writes R (3, 3) times the pose's rotation on its right into a pose. */
static inline void set_rotation(const double *pose, const double *right, double *into)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            into[4 * i + j] = pose[4 * i] * right[j] + pose[4 * i + 1] * right[3 + j] +
                              pose[4 * i + 2] * right[6 + j];
}

/* The pose on the cubics from one with a twist to another, ``span`` seconds later, at a share of
 * that. */
static void set_between(const double *start, const double *end, const double *first,
                        const double *second, double span, double share, const double *table,
                        int64_t terms, const double *of_log, int64_t log_terms, double *pose)
{
    double u[3], v[3], apart[9], xi[POSE] = {0.0}, turn[3], local[36], angle[3], rotation[9];
    turned(start, first, u);
    turned(end, second, v);
    for (int i = 0; i < 3; i++) {
        pose[4 * i + 3] =
            cubic(share, start[4 * i + 3], end[4 * i + 3], span * u[i], span * v[i]);
        for (int j = 0; j < 3; j++)
            apart[3 * i + j] = start[i] * end[j] + start[4 + i] * end[4 + j] +
                               start[8 + i] * end[8 + j];
    }
    so3_log(apart, turn, 1);
    for (int i = 0; i < 3; i++)
        xi[3 + i] = -turn[i];
    se3_left_jacobian_inverse(xi, local, 1, of_log, log_terms);
    for (int i = 0; i < 3; i++) {
        const double *const row = local + POSE * (3 + i) + 3;
        const double slope = row[0] * second[3] + row[1] * second[4] + row[2] * second[5];
        angle[i] = cubic(share, 0.0, turn[i], span * first[3 + i], span * slope);
    }
    so3_exp(angle, rotation, 1, table, terms);
    set_rotation(start, rotation, pose);
}

/* The nearest answer goes on for so many seconds along its twist. */
static void set_held(const double *known, const double *twist, double shift, const double *table,
                     int64_t terms, double *pose)
{
    double xi[POSE], step[16], rotation[9], moved[3];
    for (int i = 0; i < POSE; i++)
        xi[i] = twist[i] * shift;
    se3_exp(xi, step, 1, table, terms);
    const double offset[3] = {step[3], step[7], step[11]};
    for (int i = 0; i < 3; i++)
        memcpy(rotation + 3 * i, step + 4 * i, 3 * sizeof *step);
    turned(known, offset, moved);
    set_rotation(known, rotation, pose);
    for (int i = 0; i < 3; i++)
        pose[4 * i + 3] = known[4 * i + 3] + moved[i];
}

/* The last of increasing stamps (n,) that is not after one, or the first. */
static int64_t before(int64_t n, const int64_t *stamps, int64_t asked)
{
    int64_t low = 0, high = n;
    while (high - low > 1) {
        const int64_t middle = low + (high - low) / 2;
        if (stamps[middle] <= asked)
            low = middle;
        else
            high = middle;
    }
    return low;
}

/* As `Recorded.at`: answers at stamps (m,), ns, by those known at stamps (n,) that increase; poses
 * (., 4, 4), covariances (., 6, 6), twists (., 6). table, of_log: as `se3_exp` and `se3_log` have
 * them. */
int recorded_at(int64_t n, int64_t m, const int64_t *stamps, const double *poses,
                const double *covariances, const double *twists, const int64_t *asked,
                double widest, double near, const double *table, int64_t terms,
                const double *of_log, int64_t log_terms, double *found, double *spread,
                double *moving, unsigned char *valid)
{
    for (int64_t i = 0; i < m; i++, found += 16, spread += POSE * POSE, moving += POSE) {
        int64_t from = before(n, stamps, asked[i]);
        if (from + 1 == n && n > 1)
            from--;
        const int64_t to = from + 1 < n ? from + 1 : from;
        const double length = (double)(stamps[to] - stamps[from]) * 1e-9;
        const double since = (double)(asked[i] - stamps[from]) * 1e-9;
        const double share = fmin(fmax(since / (length > 0.0 ? length : 1.0), 0.0), 1.0);
        const double *const first = twists + POSE * from, *const second = twists + POSE * to;
        valid[i] = asked[i] == stamps[from] || asked[i] == stamps[to] ||
                   (since >= 0.0 && since <= length && length <= widest);
        memset(found, 0, 16 * sizeof *found);
        found[15] = 1.0;
        const int64_t nearest = fabs(since) < fabs(since - length) ? from : to;
        const double shift = (double)(asked[i] - stamps[nearest]) * 1e-9;
        if (!valid[i] && fabs(shift) < near) {
            valid[i] = 1;
            memcpy(moving, twists + POSE * nearest, POSE * sizeof *moving);
            memcpy(spread, covariances + POSE * POSE * nearest, POSE * POSE * sizeof *spread);
            set_held(poses + 16 * nearest, moving, shift, table, terms, found);
            continue;
        }
        set_between(poses + 16 * from, poses + 16 * to, first, second, length, share, table, terms,
                    of_log, log_terms, found);
        const double *const a = covariances + POSE * POSE * from, *const b = covariances + POSE * POSE * to;
        for (int j = 0; j < POSE * POSE; j++)
            spread[j] = (1.0 - share) * a[j] + share * b[j];
        for (int j = 0; j < POSE; j++)
            moving[j] = (1.0 - share) * first[j] + share * second[j];
    }
    return 0;
}
