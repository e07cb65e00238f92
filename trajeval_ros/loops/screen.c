/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The first suspicious one of some samples, as `ground_truth/screen.py` has it: one that went much
 * further from the one before it than is usual, changed its velocity as none before, left the
 * parabola through the last three, or repeats the one before.
 */
#include "loops.h"
#include "se3.h"

enum { WINDOW = 32 };

/* Samples, those `known` first: stamps (ns) and poses (, 4, 4) of either. Of the step to each from
 * the one before, its length (m) and angle (rad), and by how much it is off the one before it at
 * that one's velocity (m); as far as they have been asked for. */
typedef struct {
    int64_t known;
    const int64_t *before_stamps, *stamps;
    const double *before, *poses;
    double *lengths, *angles, *changes;
} Seen;

static int64_t stamp(const Seen *s, int64_t n) {
    return n < s->known ? s->before_stamps[n] : s->stamps[n - s->known];
}

static const double *pose(const Seen *s, int64_t n) {
    return n < s->known ? s->before + 16 * n : s->poses + 16 * (n - s->known);
}

/* So many seconds after another sample. */
static double since(const Seen *s, int64_t n, int64_t other) {
    return (double)(stamp(s, n) - stamp(s, other)) * 1e-9;
}

static double norm(const double *v) {
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

static double larger(double a, double b) { return a > b ? a : b; }

/* Measure the step to sample n >= 1; a change counts as no faster than `even` times. */
static void measure(const Seen *s, int64_t n, double even) {
    const double *a = pose(s, n - 1), *b = pose(s, n), *c = n > 1 ? pose(s, n - 2) : a;
    double moved[3], change[3], between[9], phi[3];
    const double last = n > 1 ? since(s, n - 1, n - 2) : 0.0;
    const double pace = since(s, n, n - 1) / larger(last, 1e-9);
    const double ratio = pace < even ? pace : even;
    for (int i = 0; i < 3; i++) {
        const int at = 4 * i + 3;
        moved[i] = b[at] - a[at];
        change[i] = moved[i] - ratio * (a[at] - c[at]);
        for (int j = 0; j < 3; j++) {
            between[3 * i + j] = a[i] * b[j] + a[4 + i] * b[4 + j] + a[8 + i] * b[8 + j];
        }
    }
    so3_log(between, phi, 1);
    s->lengths[n] = norm(moved);
    s->angles[n] = norm(phi);
    s->changes[n] = n > 1 ? norm(change) : 0.0;
}

/* Of values (n,), those before n from `first` on: the largest of the last three. */
static double largest(const double *values, int64_t n, int64_t first) {
    double found = 0.0;
    for (int64_t i = n > first + 3 ? n - 3 : first; i < n; i++) {
        found = larger(found, values[i]);
    }
    return found;
}

/* The same: the median of the last `window` ones, the lower one of two; zero if there is none. */
static double usual(const double *values, int64_t n, int64_t first, int64_t window) {
    double sorted[WINDOW];
    int64_t count = 0;
    for (int64_t i = n > first + window ? n - window : first; i < n; i++) {
        int64_t place = count++;
        for (; place > 0 && sorted[place - 1] > values[i]; place--) {
            sorted[place] = sorted[place - 1];
        }
        sorted[place] = values[i];
    }
    return count ? sorted[(count - 1) / 2] : 0.0;
}

/* By how much sample n >= 3 is off the parabola through the three before it, m. */
static double off_parabola(const Seen *s, int64_t n) {
    double led[3];
    for (int i = 0; i < 3; i++) {
        led[i] = pose(s, n)[4 * i + 3];
    }
    for (int64_t k = n - 3; k < n; k++) {
        double weight = 1.0;
        for (int64_t j = n - 3; j < n; j++) {
            weight *= j == k ? 1.0 : since(s, n, j) / since(s, k, j);
        }
        for (int i = 0; i < 3; i++) {
            led[i] -= weight * pose(s, k)[4 * i + 3];
        }
    }
    return norm(led);
}

/* Which of `count` samples after `known` >= 1 ones is the first suspicious one, or count, and
 * whether that one repeats: found (2).
 *
 * The numbers are those of the same names in `screen.py` and `jumps.py`: nothing is suspicious
 * before `fewest` steps; a step is beyond times_usual the usual one of `window` <= 32, times_last
 * the largest of three, and its least (2), m and rad; a change likewise; one after an interval
 * between shortest and longest (ns), and further than `jump` (m), where that is `gap` times the
 * one before or the sample is times_off any of `off` before off the parabola. With
 * `resting`, what repeats the samples before is no news. steps (3, known + count) to work with. */
int screen_first(const int64_t *before_stamps, const double *before, int64_t known,
                 const int64_t *stamps, const double *poses, int64_t count, int64_t resting,
                 int64_t fewest, int64_t window, double times_usual, double times_last,
                 const double *least, double even, int64_t shortest, int64_t longest, double jump,
                 double gap, double times_off, int64_t off, double *steps, int64_t *found) {
    const int64_t all = known + count;
    const Seen s = {
        .known = known,
        .before_stamps = before_stamps,
        .stamps = stamps,
        .before = before,
        .poses = poses,
        .lengths = steps,
        .angles = steps + all,
        .changes = steps + 2 * all,
    };
    if (window > WINDOW) {
        return 1;
    }
    for (int64_t n = 1; n < known; n++) {
        measure(&s, n, even);
    }
    for (int64_t n = known; n < all; n++) {
        measure(&s, n, even);
        const double *each[2] = {s.lengths, s.angles};
        int large = 0;
        for (int i = 0; i < 2 && n > fewest; i++) {
            large |= each[i][n] > larger(times_last * largest(each[i], n, 1), least[i]) &&
                     each[i][n] > times_usual * usual(each[i], n, 1, window);
        }
        /* Of window + 1 samples there are two changes less. */
        if (!large && n > fewest + 1) {
            const double change = s.changes[n];
            large = change > larger(times_last * largest(s.changes, n, 2), least[0]) &&
                    change > times_usual * usual(s.changes, n, 2, window - 2);
        }
        const int64_t here = stamp(&s, n) - stamp(&s, n - 1);
        if (!large && n >= off + 3 && here >= shortest && here <= longest &&
            s.lengths[n] > jump) {
            const double left = off_parabola(&s, n);
            int unlike = left > jump;
            for (int64_t i = n - off; unlike && i < n; i++) {
                unlike = left > times_off * off_parabola(&s, i);
            }
            large = unlike || (double)here > gap * (double)(stamp(&s, n - 1) - stamp(&s, n - 2));
        }
        const int repeats = n > fewest && s.lengths[n] == 0.0 && s.angles[n] == 0.0;
        resting = resting && repeats;
        if (large || (repeats && !resting)) {
            found[0] = n - known;
            found[1] = repeats;
            return 0;
        }
    }
    found[0] = count;
    found[1] = 0;
    return 0;
}
