/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The likelihood of records of n samples under a sum of Matern kernels and white noise, its slope
 * and its average information, in time that grows as n (`ground_truth/likelihood.py` has them).
 *
 * With the time counted in a = rate dt, a kernel of b coefficients is the covariance of x_0 in
 *
 *     dx_i/da = -x_i + x_(i+1),  i < b - 1,    dx_(b-1)/da = -x_(b-1) + white noise of intensity q
 *
 * so that, all entries positive and none of them a difference,
 *
 *     Phi(a)_(i,i+m) = phi_m = exp(-a) a^m / m!,
 *     Q(a)_(ij) = q int_0^a phi_(b-1-i)(s) phi_(b-1-j)(s) ds.
 *
 * Kalman's filter goes through a record with P the covariance of the kernels' states before a
 * sample, H their x_0's sum, R the noise:
 *
 *     S = H P H' + R,   K = P H' / S,   P+ = P - K S K',   P <- Phi P+ Phi' + Q,
 *     v = y - H m,      m+ = m + K v,   m <- Phi m+
 *
 * for the columns y, which are 1 and x: log|K| = sum log S and y' K^-1 z = sum v_y v_z / S. Its
 * transpose, from the end, gives the columns of K^-1, and Lambda the slope of log|K| in P:
 *
 *     alpha = v / S + K' l+,           l = l+ - H' alpha,                    l+ <- Phi' l
 *     delta = 1 / S + K' Lambda+ K,    Lambda = (I - K H)' Lambda+ (I - K H) + H' H / S,
 *     Lambda+ <- Phi' Lambda Phi
 *
 * (the smoother after Bryson and Frazier). With A the matrix of the equation above, dP/da =
 * A P + P A' + q e e', and P depends on sigma^2 through Q and on l through a = rate dt / l alone:
 *
 *     tr(K^-1 dK/dlog sigma) = 2 sum tr(Lambda Q),   tr(K^-1 dK/dlog n) = 2 n^2 sum delta,
 *     tr(K^-1 dK/dlog l) = -sum a (2 tr(A P Lambda) + q e' Lambda e).
 *
 * Products u with dK/dtheta are sums over the samples before and those after, whose powers
 * t_m = sum phi_m(a) alpha go on as Phi' does; and u' K^-1 u of two is had from their v.
 */
#include "loops.h"

#include <string.h>

/* From 2 a = x on Q(a) is Q at infinity, and from a on Phi(a) is zero. */
#define FAR_NOISE 100.0
#define FAR 700.0

/* The kernels: b of each, rate / l, sigma^2; and what follows from these. Of b numbers a kernel
 * has there are rank, of b + 1 powers, of 2 b - 1 moments, of b^2 squares. */
typedef struct {
    int64_t kernels, rank, wide, powers, moments, squares;
    const int64_t *orders;
    const double *rates, *variances;
    double *intensity; /* (squares): Q_ij per moment m = 2 b - 2 - i - j */
    double *value;     /* (powers): of k in t_m */
    double *slope;     /* (powers): of dk/dlog l in t_m */
} Sum;

/* The samples of a record. */
typedef struct {
    int64_t count, coordinates;
    const double *times, *values, *variances; /* (n), (n, c), (n) */
    double noise;                             /* n^2 */
} Samples;

/* What the filter leaves, a row a sample. */
typedef struct {
    double *phi;         /* (n, powers): from the sample before */
    double *moments;     /* (n, moments): int s^m exp(-2 s) ds / m! over that step */
    double *predicted;   /* (n, rank, wide): P */
    double *gains;       /* (n, wide): K */
    double *spreads;     /* (n): S */
    double *innovations; /* (n, 1 + c): v */
    double *updated;     /* (rank, wide): P+ */
    double *means;       /* (rank, columns): m */
    int kept;            /* or one row for all, but of S and v */
} Filter;

/* Allot so many of the doubles at *work. */
LOOPS_PART double *allotted(double **work, int64_t count)
{
    double *here = *work;
    *work += count;
    return here;
}

LOOPS_PART void add(double *restrict to, const double *restrict from, double factor, int64_t count)
{
    for (int64_t j = 0; j < count; ++j) to[j] += factor * from[j];
}

LOOPS_PART void scale(double *restrict to, double factor, int64_t count)
{
    for (int64_t j = 0; j < count; ++j) to[j] *= factor;
}

/* rows (b, columns) <- Phi rows, of one kernel. */
LOOPS_PART void forward(int64_t order, const double *phi, double *rows, int64_t columns, int64_t stride)
{
    for (int64_t i = 0; i < order; ++i) {
        scale(rows + i * stride, phi[0], columns);
        for (int64_t m = 1; i + m < order; ++m)
            add(rows + i * stride, rows + (i + m) * stride, phi[m], columns);
    }
}

/* rows (b, columns) <- Phi' rows, of one kernel. */
LOOPS_PART void backward(int64_t order, const double *phi, double *rows, int64_t columns,
                     int64_t stride)
{
    for (int64_t i = order - 1; i >= 0; --i) {
        scale(rows + i * stride, phi[0], columns);
        for (int64_t m = 1; m <= i; ++m)
            add(rows + i * stride, rows + (i - m) * stride, phi[m], columns);
    }
}

typedef void Turn(int64_t, const double *, double *, int64_t, int64_t);

/* The same of all kernels: rows (rank, columns). */
LOOPS_PART void turned(const Sum *sum, Turn *turn, const double *phi, double *rows,
                          int64_t columns, int64_t stride)
{
    for (int64_t k = 0; k < sum->kernels; ++k) {
        turn(sum->orders[k], phi, rows, columns, stride);
        phi += sum->orders[k] + 1;
        rows += sum->orders[k] * stride;
    }
}

/* to <- Phi from Phi', or Phi' from Phi, of a symmetric (rank, wide); from is lost. */
LOOPS_PART void turned_twice(const Sum *sum, Turn *turn, const double *phi, double *from,
                                double *to)
{
    const int64_t rank = sum->rank, wide = sum->wide;
    turned(sum, turn, phi, from, rank, wide);
    for (int64_t i = 0; i < rank; ++i)
        for (int64_t j = 0; j < rank; ++j) to[i * wide + j] = from[j * wide + i];
    turned(sum, turn, phi, to, rank, wide);
}

/* rows at the kernels' first states, summed; (columns). */
LOOPS_PART void observed(const Sum *sum, const double *rows, int64_t columns, int64_t stride,
                     double *found)
{
    memset(found, 0, (size_t)columns * sizeof *found);
    for (int64_t k = 0; k < sum->kernels; ++k) {
        add(found, rows, 1.0, columns);
        rows += sum->orders[k] * stride;
    }
}

/* What the kernels are, at *work. */
LOOPS_PART Sum prepared(const int64_t *orders, const double *rates, const double *variances,
                    int64_t kernels, double **work)
{
    Sum sum = {.kernels = kernels, .orders = orders, .rates = rates, .variances = variances};
    for (int64_t k = 0; k < kernels; ++k) {
        sum.rank += orders[k];
        sum.squares += orders[k] * orders[k];
    }
    sum.wide = (sum.rank + 3) / 4 * 4;
    sum.powers = sum.rank + kernels;
    sum.moments = 2 * sum.rank - kernels;
    if (!work) return sum;
    sum.intensity = allotted(work, sum.squares);
    sum.value = allotted(work, sum.powers);
    sum.slope = allotted(work, sum.powers);
    double *intensity = sum.intensity, *value = sum.value, *slope = sum.slope;
    for (int64_t k = 0; k < kernels; ++k) {
        const int64_t last = orders[k] - 1;
        /* (i + j)! / (i! j!), by Pascal's rule. */
        for (int64_t i = last; i >= 0; --i)
            for (int64_t j = last; j >= 0; --j)
                intensity[i * orders[k] + j] =
                    i == last || j == last
                        ? 1.0
                        : intensity[(i + 1) * orders[k] + j] + intensity[i * orders[k] + j + 1];
        /* Q_00 at infinity is sigma^2. */
        const double q = variances[k] * ldexp(1.0, (int)(2 * last + 1)) / intensity[0];
        scale(intensity, q, orders[k] * orders[k]);
        value[0] = variances[k];
        slope[0] = 0.0;
        for (int64_t m = 1; m <= orders[k]; ++m) {
            value[m] = m > last ? 0.0
                                : value[m - 1] * (double)(2 * (last - m + 1)) /
                                      (double)(2 * last - m + 1);
            slope[m] = (double)m * (value[m - 1] - value[m]);
        }
        intensity += orders[k] * orders[k];
        value += orders[k] + 1;
        slope += orders[k] + 1;
    }
    return sum;
}

/* phi (b + 1) and the moments (2 b - 1) of one kernel's step. */
LOOPS_PART void stepped(int64_t order, double a, double *phi, double *moments)
{
    const int64_t last = 2 * order - 2;
    const double decay = a < FAR ? exp(-a) : 0.0;
    double power = decay;
    for (int64_t m = 0; m <= order; ++m) {
        phi[m] = power;
        power = decay > 0.0 ? power * a / (double)(m + 1) : 0.0;
    }
    if (!(2.0 * a < FAR_NOISE)) {
        for (int64_t m = 0; m <= last; ++m) moments[m] = ldexp(0.5, (int)-m);
        return;
    }
    /* The last by its series, of positive terms, and each by the one after it. */
    double term = 1.0, series = 1.0;
    for (int64_t k = 1; term > 1e-17 * series; ++k) {
        term *= 2.0 * a / (double)(last + 1 + k);
        series += term;
    }
    power = decay * decay;
    for (int64_t m = 0; m <= last; ++m) {
        moments[m] = power; /* a^m exp(-2 a) / m! */
        power *= a / (double)(m + 1);
    }
    double later = power * series;
    for (int64_t m = last; m >= 0; --m) {
        const double here = moments[m];
        moments[m] = later;
        later = 2.0 * later + here;
    }
}

/* P (rank, wide) += Q. */
LOOPS_PART void disturbed(const Sum *sum, const double *moments, double *predicted)
{
    const double *intensity = sum->intensity;
    for (int64_t k = 0; k < sum->kernels; ++k) {
        const int64_t order = sum->orders[k], last = 2 * order - 2;
        for (int64_t i = 0; i < order; ++i)
            for (int64_t j = 0; j < order; ++j)
                predicted[i * sum->wide + j] += intensity[i * order + j] * moments[last - i - j];
        predicted += order * sum->wide + order;
        intensity += order * order;
        moments += 2 * order - 1;
    }
}

/* tr(Lambda Q) of each kernel, added to found (kernels). */
LOOPS_PART void traced(const Sum *sum, const double *moments, const double *lambda, double *found)
{
    const double *intensity = sum->intensity;
    for (int64_t k = 0; k < sum->kernels; ++k) {
        const int64_t order = sum->orders[k], last = 2 * order - 2;
        for (int64_t i = 0; i < order; ++i)
            for (int64_t j = 0; j < order; ++j)
                found[k] += lambda[i * sum->wide + j] * intensity[i * order + j] *
                            moments[last - i - j];
        lambda += order * sum->wide + order;
        intensity += order * order;
        moments += 2 * order - 1;
    }
}

/* v = y - H m and then m+ of what is in m (rank, columns); y is overwritten. */
LOOPS_PART void innovated(const Sum *sum, const double *gain, double *means, int64_t columns,
                      double *y, double *seen)
{
    observed(sum, means, columns, columns, seen);
    add(y, seen, -1.0, columns);
    for (int64_t i = 0; i < sum->rank; ++i) add(means + i * columns, y, gain[i], columns);
}

/* Where the filter's rows are, of n samples, at *work. */
LOOPS_PART Filter placed(const Sum *sum, int64_t count, int64_t coordinates, int kept, double **work)
{
    const int64_t rows = kept ? count : 1;
    Filter f = {.kept = kept};
    f.phi = allotted(work, rows * sum->powers);
    f.moments = allotted(work, rows * sum->moments);
    f.predicted = allotted(work, rows * sum->rank * sum->wide);
    f.gains = allotted(work, rows * sum->wide);
    f.spreads = allotted(work, count);
    f.innovations = allotted(work, count * (1 + coordinates));
    f.updated = allotted(work, sum->rank * sum->wide);
    f.means = allotted(work, (sum->rank + 1) * (1 + coordinates));
    return f;
}

/* Go through a record; return zero, or one where K is not positive definite. */
LOOPS_PART int filtered(const Sum *sum, const Samples *samples, Filter *f)
{
    const int64_t rank = sum->rank, wide = sum->wide, columns = 1 + samples->coordinates;
    const int64_t block = rank * wide;
    memset(f->updated, 0, (size_t)block * sizeof(double));
    memset(f->means, 0, (size_t)(rank * columns) * sizeof(double));
    for (int64_t i = 0; i < samples->count; ++i) {
        const int64_t row = f->kept ? i : 0;
        double *phi = f->phi + row * sum->powers, *moments = f->moments + row * sum->moments;
        double *predicted = f->predicted + row * block, *gain = f->gains + row * wide;
        const double apart = i ? samples->times[i] - samples->times[i - 1] : INFINITY;
        double *power = phi, *moment = moments;
        for (int64_t k = 0; k < sum->kernels; ++k) {
            stepped(sum->orders[k], apart * sum->rates[k], power, moment);
            power += sum->orders[k] + 1;
            moment += 2 * sum->orders[k] - 1;
        }
        turned_twice(sum, forward, phi, f->updated, predicted);
        disturbed(sum, moments, predicted);
        observed(sum, predicted, rank, wide, gain);
        double spread = samples->noise + samples->variances[i];
        for (int64_t k = 0, at = 0; k < sum->kernels; at += sum->orders[k++]) spread += gain[at];
        if (!(spread > 0.0 && spread < INFINITY)) return 1;
        f->spreads[i] = spread;
        memcpy(f->updated, predicted, (size_t)block * sizeof(double));
        for (int64_t j = 0; j < rank; ++j)
            add(f->updated + j * wide, gain, -gain[j] / spread, rank);
        scale(gain, 1.0 / spread, rank);
        double *v = f->innovations + i * columns;
        v[0] = 1.0;
        memcpy(v + 1, samples->values + i * (columns - 1),
               (size_t)(columns - 1) * sizeof(double));
        turned(sum, forward, phi, f->means, columns, columns);
        innovated(sum, gain, f->means, columns, v, f->means + rank * columns);
    }
    return 0;
}

/* Take the mean from the innovations; return 1' K^-1 1, and x' Pi x in *squares. */
LOOPS_PART double centred(const Samples *samples, Filter *f, double *squares)
{
    const int64_t columns = 1 + samples->coordinates;
    double information = 0.0;
    for (int64_t i = 0; i < samples->count; ++i) {
        const double one = f->innovations[i * columns];
        information += one * one / f->spreads[i];
    }
    *squares = 0.0;
    for (int64_t j = 1; j < columns; ++j) {
        double mean = 0.0;
        for (int64_t i = 0; i < samples->count; ++i) {
            const double *v = f->innovations + i * columns;
            mean += v[0] * v[j] / f->spreads[i];
        }
        mean /= information;
        for (int64_t i = 0; i < samples->count; ++i) {
            double *v = f->innovations + i * columns;
            v[j] -= mean * v[0];
            *squares += v[j] * v[j] / f->spreads[i];
        }
    }
    return information;
}

/* Go back: alpha (n, 1 + c), which is K^-1 1 and Pi x, and tr(K^-1 dK/dtheta) (2 k + 1). */
LOOPS_PART void smoothed(const Sum *sum, const Samples *samples, const Filter *f, double *alpha,
                     double *traces, double *work)
{
    const int64_t rank = sum->rank, wide = sum->wide, columns = 1 + samples->coordinates;
    const int64_t block = rank * wide, kernels = sum->kernels;
    double *l = allotted(&work, rank * columns);
    double *lambda = allotted(&work, block), *other = allotted(&work, block);
    double *turn = allotted(&work, wide), *lengths = allotted(&work, kernels * wide);
    double *signals = allotted(&work, kernels), *ends = allotted(&work, kernels);
    memset(l, 0, (size_t)(rank * columns) * sizeof(double));
    memset(lambda, 0, (size_t)block * sizeof(double));
    memset(lengths, 0, (size_t)(kernels * wide) * sizeof(double));
    memset(signals, 0, (size_t)kernels * sizeof(double));
    memset(ends, 0, (size_t)kernels * sizeof(double));
    double noise = 0.0;
    for (int64_t i = samples->count - 1; i >= 0; --i) {
        const double *gain = f->gains + i * wide, *v = f->innovations + i * columns;
        const double precision = 1.0 / f->spreads[i];
        double *here = alpha + i * columns;
        for (int64_t j = 0; j < columns; ++j) here[j] = v[j] * precision;
        for (int64_t j = 0; j < rank; ++j) add(here, l + j * columns, gain[j], columns);
        /* turn: Lambda+ K */
        memset(turn, 0, (size_t)wide * sizeof(double));
        for (int64_t j = 0; j < rank; ++j) add(turn, lambda + j * wide, gain[j], rank);
        double delta = precision;
        for (int64_t j = 0; j < rank; ++j) delta += gain[j] * turn[j];
        noise += delta;
        for (int64_t k = 0, at = 0; k < kernels; at += sum->orders[k++]) {
            add(l + at * columns, here, -1.0, columns);
            add(lambda + at * wide, turn, -1.0, rank);
        }
        for (int64_t k = 0, at = 0; k < kernels; at += sum->orders[k++]) {
            for (int64_t j = 0; j < rank; ++j) lambda[j * wide + at] -= turn[j];
            for (int64_t m = 0, to = 0; m < kernels; to += sum->orders[m++])
                lambda[to * wide + at] += delta;
        }
        const double *moments = f->moments + i * sum->moments;
        traced(sum, moments, lambda, signals);
        if (!i) break;
        const double apart = samples->times[i] - samples->times[i - 1];
        const double *predicted = f->predicted + i * block;
        for (int64_t k = 0, at = 0; k < kernels; at += sum->orders[k++]) {
            const double a = apart * sum->rates[k];
            double *length = lengths + k * wide;
            for (int64_t s = at; s < at + sum->orders[k]; ++s) {
                const double *p = predicted + s * wide, *to = lambda + s * wide;
                for (int64_t j = 0; j < rank; ++j) length[j] += 2.0 * a * p[j] * to[j];
                if (s + 1 == at + sum->orders[k]) {
                    ends[k] -= a * to[s];
                    continue;
                }
                for (int64_t j = 0; j < rank; ++j) length[j] -= 2.0 * a * p[wide + j] * to[j];
            }
        }
        const double *phi = f->phi + i * sum->powers;
        turned(sum, backward, phi, l, columns, columns);
        turned_twice(sum, backward, phi, lambda, other);
        double *swapped = lambda;
        lambda = other;
        other = swapped;
    }
    const double *intensity = sum->intensity;
    for (int64_t k = 0; k < kernels; ++k) {
        const int64_t order = sum->orders[k];
        traces[2 * k] = 2.0 * signals[k];
        traces[2 * k + 1] = ends[k] * intensity[order * order - 1];
        for (int64_t j = 0; j < rank; ++j) traces[2 * k + 1] += lengths[k * wide + j];
        intensity += order * order;
    }
    traces[2 * kernels] = 2.0 * samples->noise * noise;
}

/* The products u (n, c, p) of dK/dtheta with Pi x, of p parameters, and 1' K^-1 dK/dtheta K^-1 1
 * (p); of kernel k. */
LOOPS_PART void multiplied(const Sum *sum, const Samples *samples, const double *phi, int64_t k,
                       const double *alpha, double *u, double *means, double *t)
{
    const int64_t columns = 1 + samples->coordinates, size = 2 * sum->kernels + 1;
    int64_t at = 0;
    for (int64_t i = 0; i < k; ++i) at += sum->orders[i] + 1;
    const int64_t order = sum->orders[k];
    const double *value = sum->value + at, *slope = sum->slope + at;
    for (int64_t i = 0; i < samples->count; ++i) {
        const double *here = alpha + i * columns;
        means[2 * k] += 2.0 * value[0] * here[0] * here[0];
        for (int64_t j = 1; j < columns; ++j) {
            double *to = u + (i * (columns - 1) + j - 1) * size + 2 * k;
            to[0] = 2.0 * value[0] * here[j];
            to[1] = 0.0;
        }
    }
    for (int64_t way = 0; way < 2; ++way) { /* those before, those after */
        memset(t, 0, (size_t)((order + 1) * columns) * sizeof(double));
        for (int64_t step = 1; step < samples->count; ++step) {
            const int64_t i = way ? samples->count - 1 - step : step;
            const double *here = alpha + i * columns;
            add(t, way ? here + columns : here - columns, 1.0, columns);
            backward(order + 1, phi + (way ? i + 1 : i) * sum->powers + at, t, columns, columns);
            for (int64_t j = 0; j < columns; ++j) {
                double signal = 0.0, length = 0.0;
                for (int64_t m = 0; m <= order; ++m) {
                    signal += value[m] * t[m * columns + j];
                    length += slope[m] * t[m * columns + j];
                }
                if (j) {
                    double *to = u + (i * (columns - 1) + j - 1) * size + 2 * k;
                    to[0] += 2.0 * signal;
                    to[1] += length;
                } else {
                    means[2 * k] += 2.0 * signal * here[0];
                    means[2 * k + 1] += length * here[0];
                }
            }
        }
    }
}

/* How many doubles of work the longest record needs, of count samples. */
int64_t record_room(const int64_t *orders, int64_t kernels, int64_t coordinates, int64_t count,
                    int64_t slopes)
{
    const Sum sum = prepared(orders, 0, 0, kernels, 0);
    const int64_t columns = 1 + coordinates, size = 2 * kernels + 1, wide = sum.wide;
    const int64_t rows = slopes ? count : 1, block = sum.rank * wide;
    int64_t room = sum.squares + 2 * sum.powers;
    room += rows * (sum.powers + sum.moments + block + wide) + count * (1 + columns);
    room += block + (sum.rank + 1) * columns;
    if (!slopes) return room;
    room += count * columns + 2 * size + count * coordinates * size;
    const int64_t back = sum.rank * columns + 2 * block + wide + kernels * (wide + 2);
    const int64_t products = sum.powers * columns;
    const int64_t forth = (sum.rank + 2) * coordinates * size + size * (size + 1);
    return room + (back > products + forth ? back : products + forth);
}

/* Each record's log|K| + log 1' K^-1 1 and x' Pi x, found (records, 2); return one where a K is
 * not positive definite. The samples of record r are those from begins[r] on, begins (records + 1);
 * times (n), values (n, c), variances (n), orders, rates, kernel_variances (kernels). */
LOOPS_WIDE
int record_values(const int64_t *begins, int64_t records, const double *times,
                  const double *values, const double *variances, int64_t coordinates,
                  const int64_t *orders, const double *rates, const double *kernel_variances,
                  int64_t kernels, double noise, double *work, double *found)
{
    const Sum sum = prepared(orders, rates, kernel_variances, kernels, &work);
    for (int64_t r = 0; r < records; ++r) {
        const int64_t at = begins[r];
        const Samples samples = {begins[r + 1] - at, coordinates,    times + at,
                                 values + at * coordinates, variances + at, noise};
        double *rest = work;
        Filter f = placed(&sum, samples.count, coordinates, 0, &rest);
        if (filtered(&sum, &samples, &f)) return 1;
        double log_det = log(centred(&samples, &f, found + 2 * r + 1));
        for (int64_t i = 0; i < samples.count; ++i) log_det += log(f.spreads[i]);
        found[2 * r] = log_det;
    }
    return 0;
}

/* The sums over the records of the slope of log p, gradient (p), and of its average information
 * (p, p), with `freedom` degrees; K is positive definite, and the rest as of record_values. */
LOOPS_WIDE
int record_slopes(const int64_t *begins, int64_t records, const double *times,
                  const double *values, const double *variances, int64_t coordinates,
                  const int64_t *orders, const double *rates, const double *kernel_variances,
                  int64_t kernels, double noise, double freedom, double *work, double *gradient,
                  double *information)
{
    const Sum sum = prepared(orders, rates, kernel_variances, kernels, &work);
    const int64_t size = 2 * kernels + 1, columns = coordinates * size;
    memset(gradient, 0, (size_t)size * sizeof(double));
    memset(information, 0, (size_t)(size * size) * sizeof(double));
    for (int64_t r = 0; r < records; ++r) {
        const int64_t at = begins[r], count = begins[r + 1] - at;
        const Samples samples = {count,          coordinates, times + at, values + at * coordinates,
                                 variances + at, noise};
        double *rest = work, squares;
        Filter f = placed(&sum, count, coordinates, 1, &rest);
        if (filtered(&sum, &samples, &f)) return 1;
        const double ones = centred(&samples, &f, &squares);
        double *alpha = allotted(&rest, count * (1 + coordinates));
        double *traces = allotted(&rest, size), *means = allotted(&rest, size);
        double *u = allotted(&rest, count * columns);
        smoothed(&sum, &samples, &f, alpha, traces, rest);

        memset(means, 0, (size_t)size * sizeof(double));
        for (int64_t k = 0; k < kernels; ++k)
            multiplied(&sum, &samples, f.phi, k, alpha, u, means, rest);
        for (int64_t i = 0; i < count; ++i) {
            const double *here = alpha + i * (1 + coordinates);
            means[size - 1] += 2.0 * noise * here[0] * here[0];
            for (int64_t j = 0; j < coordinates; ++j)
                u[i * columns + (j + 1) * size - 1] = 2.0 * noise * here[1 + j];
        }

        /* x' Pi dK/dtheta Pi x; then the u go through the filter as x did. */
        double *explained = allotted(&rest, size), *products = allotted(&rest, size * size);
        double *projected = allotted(&rest, columns);
        double *states = allotted(&rest, (sum.rank + 1) * columns);
        memset(explained, 0, (size_t)size * sizeof(double));
        memset(products, 0, (size_t)(size * size) * sizeof(double));
        memset(projected, 0, (size_t)columns * sizeof(double));
        memset(states, 0, (size_t)(sum.rank * columns) * sizeof(double));
        for (int64_t i = 0; i < count; ++i) {
            double *v = u + i * columns;
            for (int64_t j = 0; j < coordinates; ++j)
                add(explained, v + j * size, alpha[i * (1 + coordinates) + 1 + j], size);
            turned(&sum, forward, f.phi + i * sum.powers, states, columns, columns);
            innovated(&sum, f.gains + i * sum.wide, states, columns, v,
                      states + sum.rank * columns);
            const double precision = 1.0 / f.spreads[i];
            add(projected, v, precision * f.innovations[i * (1 + coordinates)], columns);
            for (int64_t j = 0; j < coordinates; ++j)
                for (int64_t p = 0; p < size; ++p)
                    add(products + p * size, v + j * size, precision * v[j * size + p], size);
        }

        const double held = freedom + squares;
        const double weight = (freedom + (double)(coordinates * (count - 1))) / held;
        for (int64_t p = 0; p < size; ++p) {
            gradient[p] += 0.5 * (weight * explained[p] -
                                  (double)coordinates * (traces[p] - means[p] / ones));
            double *row = information + p * size;
            add(row, products + p * size, 0.5 * weight, size);
            add(row, explained, -0.5 * weight * explained[p] / held, size);
            for (int64_t j = 0; j < coordinates; ++j)
                add(row, projected + j * size, -0.5 * weight * projected[j * size + p] / ones,
                    size);
        }
    }
    return 0;
}
