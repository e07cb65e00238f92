/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * What a fit of the error model takes of its poses (error_model/nuisances.py): errors in the world's
 * axes, what nuisances and an alignment do to them, and the motion that nuisances show in
 * (error_model/observed.py).
 *
 * An estimate is corrected by E^-1 of the body's frame on the right and a factor s of positions:
 * R R_E', s p + R t with t the translation of E^-1.
 */
#include "eigen.h"
#include "loops.h"
#include "se3.h"

#include <string.h>

enum { POSE = 6, NUISANCES = 9, ALL = POSE + NUISANCES };

/* a b or, of ``turned``, a b', of (3, 3) whose rows are so far apart; into (3, 3). */
LOOPS_PART void product(const double *a, int na, const double *b, int nb, int turned, double *into)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double sum = 0.0;
            for (int k = 0; k < 3; k++)
                sum += a[na * i + k] * b[turned ? nb * j + k : nb * k + j];
            into[3 * i + j] = sum;
        }
}

/* R v of a rotation whose rows are so far apart. */
LOOPS_PART void turn(const double *rotation, int apart, const double *v, double *into)
{
    for (int i = 0; i < 3; i++)
        into[i] = rotation[apart * i] * v[0] + rotation[apart * i + 1] * v[1] +
                  rotation[apart * i + 2] * v[2];
}

LOOPS_PART void cross(const double *a, const double *b, double *into)
{
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        into[i] = a[j] * b[k] - a[k] * b[j];
    }
}

/* The corrected estimate: R (3, 3) and p (3). back: E^-1, (4, 4). */
LOOPS_PART void correct(const double *estimate, const double *back, double scale, double *rotation,
                        double *position)
{
    const double lever[3] = {back[3], back[7], back[11]};
    product(estimate, 4, back, 4, 0, rotation);
    turn(estimate, 4, lever, position);
    for (int i = 0; i < 3; i++)
        position[i] += scale * estimate[4 * i + 3];
}

/* sums (12,): of R_truth R_estimate', the estimate corrected, and of the ground truth's positions.
 * truth, estimate: (n, 4, 4). back: E^-1, (4, 4). */
int errors_about(int64_t count, const double *truth, const double *estimate, const double *back,
                 double *sums)
{
    memset(sums, 0, 12 * sizeof *sums);
    for (int64_t i = 0; i < count; i++, truth += 16, estimate += 16) {
        double corrected[9], apart[9];
        product(estimate, 4, back, 4, 0, corrected);
        product(truth, 4, corrected, 3, 1, apart);
        for (int j = 0; j < 9; j++)
            sums[j] += apart[j];
        for (int j = 0; j < 3; j++)
            sums[9 + j] += truth[4 * j + 3];
    }
    return 0;
}

/* Positions' errors of small rotations: those of an alignment (3, 3), about their mean. */
static void set_offsets(int64_t count, const double *truth, const double *estimate,
                        const double *back, double scale, const double *mean, const double *align,
                        double *errors)
{
    double sum[3] = {0.0};
    for (int64_t i = 0; i < count; i++) {
        double rotation[9], position[3], *const z = errors + POSE * i;
        correct(estimate + 16 * i, back, scale, rotation, position);
        turn(align, 3, position, z);
        for (int j = 0; j < 3; j++) {
            z[j] -= truth[16 * i + 4 * j + 3] - mean[j];
            sum[j] += z[j];
        }
    }
    for (int64_t i = 0; i < count; i++)
        for (int j = 0; j < 3; j++)
            errors[POSE * i + j] -= sum[j] / (double)count;
}

/* b^-1 a of poses by rotations (3, 3) and positions. */
LOOPS_PART void between(const double *a, const double *p, const double *b, const double *q,
                        double *rotation, double *position)
{
    const double apart[3] = {p[0] - q[0], p[1] - q[1], p[2] - q[2]};
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++)
            rotation[3 * i + j] =
                b[i] * a[j] + b[3 + i] * a[3 + j] + b[6 + i] * a[6 + j];
        position[i] = b[i] * apart[0] + b[3 + i] * apart[1] + b[6 + i] * apart[2];
    }
}

/* Errors as sums of those of steps, Log(T_(i+1)^-1 T_i t_i^-1 t_(i+1)) with T the ground truth. */
static void set_sums(int64_t count, const double *truth, const double *estimate,
                     const double *back, double scale, const double *mean, const double *series,
                     int64_t terms, double *errors)
{
    double before[2][12] = {{0.0}}, total[POSE] = {0.0}; /* truth and estimate: R, p */
    for (int64_t i = 0; i < count; i++) {
        double now[2][12], *const z = errors + POSE * i, swept[3];
        for (int j = 0; j < 3; j++) {
            memcpy(now[0] + 3 * j, truth + 16 * i + 4 * j, 3 * sizeof(double));
            now[0][9 + j] = truth[16 * i + 4 * j + 3] - mean[j];
        }
        correct(estimate + 16 * i, back, scale, now[1], now[1] + 9);
        if (i > 0) {
            double ahead[12], behind[12], pose[16] = {0.0}, xi[POSE], moved[3], turned[3];
            between(before[0], before[0] + 9, now[0], now[0] + 9, behind, behind + 9);
            between(now[1], now[1] + 9, before[1], before[1] + 9, ahead, ahead + 9);
            for (int j = 0; j < 3; j++) {
                for (int k = 0; k < 3; k++)
                    pose[4 * j + k] = behind[3 * j] * ahead[k] + behind[3 * j + 1] * ahead[3 + k] +
                                      behind[3 * j + 2] * ahead[6 + k];
                pose[4 * j + 3] = behind[9 + j];
                for (int k = 0; k < 3; k++)
                    pose[4 * j + 3] += behind[3 * j + k] * ahead[9 + k];
            }
            pose[15] = 1.0;
            se3_log(pose, xi, 1, series, terms);
            turn(now[0], 3, xi, moved);
            turn(now[0], 3, xi + 3, turned);
            cross(now[0] + 9, turned, swept);
            for (int j = 0; j < 3; j++) {
                total[j] += moved[j] + swept[j];
                total[3 + j] += turned[j];
            }
        }
        memcpy(z, total, sizeof total);
        cross(now[0] + 9, total + 3, swept);
        for (int j = 0; j < 3; j++)
            z[j] -= swept[j];
        memcpy(before, now, sizeof before);
    }
}

/* Errors (n, 6), up to the alignment. mean (3): of the ground truth's positions, about which they are.
 * align (3, 3): the rotation of the estimate's world in the ground truth's. Where no angle between
 * the two exceeds ``small``, they are taken as they are, and else as sums of steps. series (terms, 2):
 * as `se3_log`. */
int errors_of(int64_t count, const double *truth, const double *estimate, const double *back,
              double scale, const double *mean, const double *align, double small,
              const double *series, int64_t terms, double *errors)
{
    int is_small = 1;
    for (int64_t i = 0; i < count; i++) {
        double corrected[9], aligned[9], apart[9], *const phi = errors + POSE * i + 3;
        product(estimate + 16 * i, 4, back, 4, 0, corrected);
        product(align, 3, corrected, 3, 0, aligned);
        product(aligned, 3, truth + 16 * i, 4, 1, apart);
        so3_log(apart, phi, 1);
        is_small &= sqrt(phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]) < small;
    }
    if (is_small)
        set_offsets(count, truth, estimate, back, scale, mean, align, errors);
    else
        set_sums(count, truth, estimate, back, scale, mean, series, terms, errors);
    return 0;
}

/* Beside the errors, in the world's axes: columns (n, 6, 9) of the nuisances, gauge (n, 6, 6) of the
 * alignment, turned (n, 6, 6), the ground truth's covariance, and travel (n - 1, 3).
 *
 * truth (n, 4, 4) with covariances (n, 6, 6) and twists (n, 6) of the body; mean (3) of its positions;
 * times (n,), s. */
int errors_columns(int64_t count, const double *truth, const double *covariances,
                   const double *twists, const double *times, const double *mean, double *columns,
                   double *gauge, double *turned, double *travel)
{
    memset(columns, 0, (size_t)(count * POSE * NUISANCES) * sizeof *columns);
    memset(gauge, 0, (size_t)(count * POSE * POSE) * sizeof *gauge);
    for (int64_t i = 0; i < count; i++) {
        const double *r = truth + 16 * i, *v = covariances + POSE * POSE * i;
        double *const k = columns + POSE * NUISANCES * i, *const g = gauge + POSE * POSE * i;
        const double p[3] = {r[3] - mean[0], r[7] - mean[1], r[11] - mean[2]};
        double moved[POSE];
        for (int half = 0; half < 2; half++)
            turn(r, 4, twists + POSE * i + 3 * half, moved + 3 * half);
        for (int row = 0; row < POSE; row++) {
            const int axis = row % 3, first = row - axis;
            double *const to = k + NUISANCES * row;
            to[0] = moved[row];
            to[1] = moved[row] * times[i];
            memcpy(to + 2 + first, r + 4 * axis, 3 * sizeof *to);
            g[POSE * row + row] = 1.0;
        }
        for (int axis = 0; axis < 3; axis++) {
            const int y = (axis + 1) % 3, z = (axis + 2) % 3;
            k[NUISANCES * axis + 8] = -p[axis];
            g[POSE * axis + 3 + y] = p[z]; /* -hat(p) */
            g[POSE * axis + 3 + z] = -p[y];
            if (i + 1 < count)
                travel[3 * i + axis] = (r[16 + 4 * axis + 3] - mean[axis]) - p[axis];
        }
        for (int half = 0; half < 4; half++) {
            const int at = POSE * 3 * (half / 2) + 3 * (half % 2);
            double once[9], twice[9];
            product(r, 4, v + at, POSE, 0, once);
            product(once, 3, r, 4, 1, twice);
            for (int row = 0; row < 3; row++)
                memcpy(turned + POSE * POSE * i + at + POSE * row, twice + 3 * row,
                       3 * sizeof(double));
        }
    }
    return 0;
}

/* How much columns of alignment and nuisances, (n, 6, 6) and (n, 6, 9), vary, weighted: squares
 * (15, 15), the sum of their products over rows of which each group's count ``1 / (noise + jitter)``:
 * noise the covariance's (n, 6, 6) on one axis, jitter (2) by factors (n, 2). errors (9): how much they
 * would, did the ground truth's errors alone tell of them. */
LOOPS_WIDE int errors_shown(int64_t count, const double *covariance, const double *factors,
                            const double *jitter, const double *gauge, const double *columns,
                            double *squares, double *errors)
{
    double sums[ALL][ALL + 1] = {{0.0}};
    memset(errors, 0, NUISANCES * sizeof *errors);
    for (int64_t i = 0; i < count; i++) {
        const double *v = covariance + POSE * POSE * i;
        double noise[2], weight[2];
        for (int g = 0; g < 2; g++) {
            const double *at = v + 21 * g; /* the first of the group's on the diagonal */
            noise[g] = (at[0] + at[7] + at[14]) / 3.0;
            weight[g] = 1.0 / (noise[g] + factors[2 * i + g] * jitter[g]);
        }
        for (int row = 0; row < POSE; row++) {
            double both[ALL + 1];
            memcpy(both, gauge + POSE * (POSE * i + row), POSE * sizeof *both);
            memcpy(both + POSE, columns + NUISANCES * (POSE * i + row), NUISANCES * sizeof *both);
            both[ALL] = 0.0;
            for (int l = 0; l < ALL; l++) {
                const double weighted = weight[row / 3] * both[l];
                if (weighted == 0.0)
                    continue;
                for (int m = 0; m < ALL + 1; m++)
                    sums[l][m] += weighted * both[m];
            }
        }
        for (int j = 0; j < 3; j++) {
            errors[2 + j] += 2.0 * noise[1] * weight[0];
            errors[5 + j] += 2.0 * noise[1] * weight[1];
        }
        errors[8] += 3.0 * noise[0] * weight[0];
    }
    for (int l = 0; l < ALL; l++)
        memcpy(squares + ALL * l, sums[l], ALL * sizeof *squares);
    return 0;
}

/* The inverse of a symmetric a (n, n), by its eigenvalues of which none is as small as round-off: not
 * below this share of the largest, or left out where it ``may_lack``. Not 0 where one is. */
static int invert(int n, double a[ORDER][ORDER], double least, int may_lack)
{
    double v[ORDER][ORDER], largest = 0.0, inverse[ORDER];
    diagonalise(n, a, v);
    for (int i = 0; i < n; i++)
        largest = fmax(largest, fabs(a[i][i]));
    for (int i = 0; i < n; i++) {
        const int is_there = fabs(a[i][i]) > least * largest;
        if (!is_there && !may_lack)
            return 1;
        inverse[i] = is_there ? 1.0 / a[i][i] : 0.0;
    }
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            double sum = 0.0;
            for (int k = 0; k < n; k++)
                sum += v[i][k] * v[j][k] * inverse[k];
            a[i][j] = a[j][i] = sum;
        }
    return 0;
}

/* vectors (NUISANCES, size) become themselves times turn (size, size). */
static void turn_vectors(int size, double vectors[ORDER][ORDER], double by[ORDER][ORDER])
{
    for (int i = 0; i < NUISANCES; i++) {
        double row[ORDER];
        for (int j = 0; j < size; j++) {
            row[j] = 0.0;
            for (int k = 0; k < size; k++)
                row[j] += vectors[i][k] * by[k][j];
        }
        memcpy(vectors[i], row, (size_t)size * sizeof *row);
    }
}

/* Nuisances as far as the motion shows them, as `shown` of error_model/observed.py. theta (c,) and
 * covariance (c, c) as found; squares (15, 15) and errors (9,) as `errors_shown` leaves them; units
 * (9,). found (9,) and known (9, 9). Not 0 where the covariance is singular. */
int errors_told(int64_t c, const double *theta, const double *covariance, const double *squares,
                const double *errors, const double *units, double beyond_errors, double unknown,
                double round_off, double *found, double *known)
{
    static const int turning[] = {2, 3, 4, 8};
    double information[ORDER][ORDER], taken[ORDER][ORDER], beyond[ORDER][ORDER];
    double vectors[ORDER][ORDER], own[ORDER][ORDER], turned[ORDER][ORDER], right[NUISANCES];
    for (int i = 0; i < NUISANCES; i++)
        for (int j = 0; j < NUISANCES; j++) {
            information[i][j] = 0.5 * (covariance[i * c + j] + covariance[j * c + i]);
            information[i][j] /= units[i] * units[j];
            if (!isfinite(information[i][j]))
                return 1;
        }
    for (int i = 0; i < POSE; i++)
        for (int j = 0; j < POSE; j++)
            taken[i][j] = squares[i * ALL + j];
    if (invert(NUISANCES, information, 0.0, 0) || invert(POSE, taken, 1e-15, 1))
        return 1;
    for (int i = 0; i < NUISANCES; i++)
        for (int j = 0; j <= i; j++) {
            double sum = squares[(POSE + i) * ALL + POSE + j];
            for (int k = 0; k < POSE; k++)
                for (int l = 0; l < POSE; l++)
                    sum -= squares[(POSE + i) * ALL + k] * taken[k][l] *
                           squares[l * ALL + POSE + j];
            if (i == j)
                sum -= beyond_errors * errors[i] +
                       round_off * squares[(POSE + i) * ALL + POSE + i];
            beyond[i][j] = beyond[j][i] = sum;
        }
    int still = 1;
    for (int i = 0; i < 4; i++)
        still = still && beyond[turning[i]][turning[i]] <= 0.0;
    for (int i = 0; i < NUISANCES; i++)
        for (int j = 0; j < NUISANCES; j++)
            beyond[i][j] *= still && (i < 2 || j < 2) ? 0.0 : units[i] * units[j];
    diagonalise(NUISANCES, beyond, vectors);
    /* Those that move first, then those that are hidden. */
    int moved = 0;
    for (int i = 0; i < NUISANCES; i++)
        if (beyond[i][i] > 0.0) {
            for (int k = 0; k < NUISANCES && moved != i; k++) {
                const double kept = vectors[k][i];
                vectors[k][i] = vectors[k][moved];
                vectors[k][moved] = kept;
            }
            beyond[i][i] = beyond[moved][moved];
            moved++;
        }
    for (int i = 0; i < moved; i++)
        for (int j = 0; j < moved; j++) {
            own[i][j] = 0.0;
            for (int k = 0; k < NUISANCES; k++)
                for (int l = 0; l < NUISANCES; l++)
                    own[i][j] += vectors[k][i] * information[k][l] * vectors[l][j];
        }
    diagonalise(moved, own, turned);
    turn_vectors(moved, vectors, turned);
    for (int k = 0; k < NUISANCES; k++) {
        right[k] = 0.0;
        for (int l = 0; l < NUISANCES; l++)
            right[k] += information[k][l] * theta[l] / units[l];
    }
    memset(found, 0, NUISANCES * sizeof *found);
    memset(known, 0, NUISANCES * NUISANCES * sizeof *known);
    for (int i = 0; i < NUISANCES; i++) {
        const int is_seen = i < moved && own[i][i] >= 1.0;
        double along = 0.0;
        for (int k = 0; k < NUISANCES; k++)
            along += vectors[k][i] * right[k];
        for (int k = 0; k < NUISANCES; k++) {
            if (is_seen)
                found[k] += vectors[k][i] * along / own[i][i] * units[k];
            for (int l = 0; l < NUISANCES; l++)
                known[k * NUISANCES + l] += vectors[k][i] * vectors[l][i] * units[k] * units[l] *
                                            (is_seen ? 1.0 / own[i][i] : unknown);
        }
    }
    return 0;
}
