/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The local coordinates of a segment's poses, (R_ref' (p - p_ref), Log(R_ref' R)), as
 * `ground_truth/segment.py` has them.
 */
#include "loops.h"
#include "se3.h"

static const double PI = 3.14159265358979323846;

static double dot3(const double *a, const double *b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Put phi on the branch that is nearest to the one before. */
static void go_on(const double *before, double *phi) {
    const double apart[3] = {phi[0] - before[0], phi[1] - before[1], phi[2] - before[2]};
    const double angle = sqrt(dot3(phi, phi));
    if (sqrt(dot3(apart, apart)) > PI && angle > 0.0) {
        const double turns = rint((dot3(before, phi) / angle - angle) / (2.0 * PI));
        for (int64_t i = 0; i < 3; i++) {
            phi[i] *= 1.0 + 2.0 * PI * turns / angle;
        }
    }
}

/* The coordinates x (6,) of a pose (4, 4) about a reference (4, 4); those of the one before, if
 * there is, are just before them. */
static void local(const double *reference, const double *pose, int64_t is_first, double *x)
{
    double rotation[9];
    for (int64_t j = 0; j < 3; j++) {
        x[j] = 0.0;
        for (int64_t l = 0; l < 3; l++) {
            x[j] += reference[4 * l + j] * (pose[4 * l + 3] - reference[4 * l + 3]);
        }
        for (int64_t m = 0; m < 3; m++) {
            rotation[3 * j + m] = 0.0;
            for (int64_t l = 0; l < 3; l++) {
                rotation[3 * j + m] += reference[4 * l + j] * pose[4 * l + m];
            }
        }
    }
    so3_log(rotation, x + 3, 1);
    if (!is_first) {
        go_on(x - 3, x + 3);
    }
}

/* Of poses (n, 4, 4) about a reference (4, 4), coordinates (known + n, 6), of which the first, if
 * one is known, is given: those that follow it. */
int local_coordinates(const double *reference, const double *poses, int64_t n, int64_t known,
                      double *coordinates) {
    for (int64_t i = 0; i < n; i++) {
        local(reference, poses + 16 * i, known + i == 0, coordinates + 6 * (known + i));
    }
    return 0;
}

/* Feed a segment of `size` samples, the first at a stamp `start` (ns), with samples at stamps (n,)
 * and poses (n, 4, 4) up to the first one at which its hand-over begins: as in `_continue_alone` of
 * `ground_truth/segmentation.py`. It does once there are so many samples for so long (ns), or the
 * most of them, or its angle has reached `turned`. coordinates (1 + n, 6) are of the segment's last
 * sample, given, and of those taken; taken (2): how many, and whether it begins; angle (1): there. */
int segment_alone(const double *reference, const int64_t *stamps, const double *poses, int64_t n,
                  int64_t start, int64_t size, double longest, double fewest, double most,
                  double turned, double *coordinates, int64_t *taken, double *angle)
{
    taken[0] = taken[1] = 0;
    for (int64_t i = 0; i < n && !taken[1]; i++) {
        double *x = coordinates + 6 * (i + 1);
        const double count = (double)(size + i + 1);
        local(reference, poses + 16 * i, 0, x);
        *angle = sqrt(dot3(x + 3, x + 3));
        taken[0] = i + 1;
        taken[1] = ((double)(stamps[i] - start) >= longest && count >= fewest) || count >= most ||
                   *angle >= turned;
    }
    return 0;
}

/* Feed a segment that hands over with samples as above, up to the one that completes it, and find
 * the progress (n,) at each: as in `_continue_handover`. It began at a stamp `begin` (ns) and at
 * `angle`, so many samples ago; it goes on by the time, the samples and the turn that it takes, and
 * faster where `room` samples are all there is room for; last: the progress so far. */
int segment_handover(const double *reference, const int64_t *stamps, const double *poses, int64_t n,
                     int64_t begin, int64_t ago, double time, double samples, double room,
                     double angle, double turn, double last, double *coordinates,
                     double *progress, int64_t *taken)
{
    for (*taken = 0; *taken < n && last < 1.0; ++*taken) {
        const int64_t i = *taken;
        double *x = coordinates + 6 * (i + 1);
        const double count = (double)(ago + i + 1);
        local(reference, poses + 16 * i, 0, x);
        const double by_turn = (sqrt(dot3(x + 3, x + 3)) - angle) / turn;
        double here = fmin((double)(stamps[i] - begin) / time, count / samples);
        here = fmax(fmax(here, count / room), by_turn);
        last = progress[i] = fmax(last, fmin(here, 1.0));
    }
    return 0;
}
