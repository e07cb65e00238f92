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
 *
 * Four records are gone through side by side, one a lane, each with hyperparameters of its own. One
 * that has ended, or that is not there, has samples that tell nothing: 1 / S is zero.
 */
#include "loops.h"

#include <string.h>

enum { LANES = 4 };
typedef double Lanes __attribute__((vector_size(8 * LANES), aligned(8), may_alias));

/* So far apart samples know nothing of each other: Q is Q at infinity to round-off. */
#define FAR 50.0
/* Terms of the series of the last moment: more than are left above round-off at FAR. */
#define TERMS 256

/* The kernels, b of each, and what they are to records side by side, each of which has its own
 * rate / l, sigma^2 and n^2. Of b numbers a kernel has there are rank, of b + 1 powers, of 2 b - 1
 * moments, of b^2 squares. */
typedef struct {
    int64_t kernels, rank, powers, moments, squares;
    const int64_t *orders;
    Lanes *noise;     /* n^2 */
    Lanes *rates;     /* (kernels) */
    Lanes *intensity; /* (squares): Q_ij per moment 2 b - 2 - i - j */
    Lanes *value;     /* (powers): of k in t_m */
    Lanes *slope;     /* (powers): of dk/dlog l in t_m */
    double *inverse;  /* 1 / m */
} Sum;

/* All records, one after the other: the samples of record r are counts[r] from begins[r] on of times,
 * values (, c) and variances; begins, counts and sets (records). Its hyperparameters are those of
 * the row sets[r] of rates and kernel_variances (sets, kernels) and noises (sets), n^2. */
typedef struct {
    const int64_t *begins, *counts, *sets;
    const double *times, *values, *variances, *rates, *kernel_variances, *noises;
    int64_t records, coordinates;
} Records;

/* The samples of records side by side. */
typedef struct {
    int64_t count, coordinates, begins[LANES], counts[LANES];
    Lanes *apart;  /* (n): s, from the sample before; 0 at the first */
    Lanes *values; /* (n, 1 + c): 1 and x */
    Lanes *noises; /* (n): R */
    Lanes *there;  /* (n): 1, and 0 beyond the end */
} Samples;

/* What the filter leaves. Of symmetric matrices (rank, rank) what is left of the diagonal and each
 * kernel's own block. */
typedef struct {
    int kept;           /* a row a sample; or one row of what is marked for all */
    Lanes *phi;         /* (n, powers): from the sample before; marked */
    Lanes *moments;     /* (n, moments): int s^m exp(-2 s) ds / m! over that step; marked */
    Lanes *predicted;   /* (n, rank, rank): P; marked */
    Lanes *gains;       /* (n, rank): K; marked */
    Lanes *precisions;  /* (n): 1 / S */
    Lanes *innovations; /* (n, 1 + c): v */
    Lanes *updated;     /* (rank, rank): P+ */
    Lanes *means;       /* (rank, 1 + c): m */
} Filter;

/* Allot so many at *work. */
LOOPS_PART double *allotted(double **work, int64_t count)
{
    double *here = *work;
    *work += count;
    return here;
}

LOOPS_PART Lanes *allotted_lanes(double **work, int64_t count)
{
    return (Lanes *)allotted(work, LANES * count);
}

LOOPS_PART void clear(Lanes *to, int64_t count) { memset(to, 0, (size_t)count * sizeof *to); }

/* to += factor from. */
LOOPS_PART void add(Lanes *to, const Lanes *from, const Lanes *factor, int64_t count)
{
    const Lanes by = *factor;
    for (int64_t j = 0; j < count; ++j) to[j] += by * from[j];
}

/* to <- Phi from, of one kernel: b numbers `next` apart, of each of count columns `beside` apart.
 * Both may be the same. */
LOOPS_PART void forward(int64_t order, const Lanes *restrict phi, const Lanes *from, Lanes *to,
                        int64_t next, int64_t count, int64_t beside)
{
    for (int64_t j = 0; j < count; ++j)
        for (int64_t i = 0; i < order; ++i) {
            Lanes moved = phi[0] * from[j * beside + i * next];
            for (int64_t m = 1; m < order; ++m)
                if (i + m < order) moved += phi[m] * from[j * beside + (i + m) * next];
            to[j * beside + i * next] = moved;
        }
}

/* The same with Phi'. */
LOOPS_PART void backward(int64_t order, const Lanes *restrict phi, const Lanes *from, Lanes *to,
                         int64_t next, int64_t count, int64_t beside)
{
    for (int64_t j = 0; j < count; ++j)
        for (int64_t i = order - 1; i >= 0; --i) {
            Lanes moved = phi[0] * from[j * beside + i * next];
            for (int64_t m = 1; m < order; ++m)
                if (m <= i) moved += phi[m] * from[j * beside + (i - m) * next];
            to[j * beside + i * next] = moved;
        }
}

typedef void Turn(int64_t, const Lanes *, const Lanes *, Lanes *, int64_t, int64_t, int64_t);

/* Either, with the usual orders as constants, so that what is in it is unrolled. */
LOOPS_PART void turn(Turn *way, int64_t order, const Lanes *phi, const Lanes *from, Lanes *to,
                     int64_t next, int64_t count, int64_t beside)
{
    switch (order) {
    case 1: way(1, phi, from, to, next, count, beside); break;
    case 2: way(2, phi, from, to, next, count, beside); break;
    case 3: way(3, phi, from, to, next, count, beside); break;
    case 4: way(4, phi, from, to, next, count, beside); break;
    case 5: way(5, phi, from, to, next, count, beside); break;
    default: way(order, phi, from, to, next, count, beside);
    }
}

/* rows (rank, columns) <- Phi rows, or Phi' rows. */
LOOPS_PART void turn_rows(Turn *way, const Sum *sum, const Lanes *phi, Lanes *rows,
                          int64_t columns)
{
    for (int64_t k = 0; k < sum->kernels; ++k) {
        turn(way, sum->orders[k], phi, rows, rows, columns, columns, 1);
        phi += sum->orders[k] + 1;
        rows += sum->orders[k] * columns;
    }
}

/* to <- Phi from Phi', or Phi' from Phi, symmetric. Both may be the same. */
LOOPS_PART void turn_twice(Turn *way, const Sum *sum, const Lanes *phi, const Lanes *from,
                           Lanes *to)
{
    const int64_t rank = sum->rank;
    const Lanes *powers = phi;
    for (int64_t k = 0, at = 0; k < sum->kernels; at += sum->orders[k++]) {
        const int64_t order = sum->orders[k];
        turn(way, order, powers, from + at * rank, to + at * rank, rank, at + order, 1);
        powers += order + 1;
    }
    powers = phi;
    for (int64_t k = 0, at = 0; k < sum->kernels; at += sum->orders[k++]) {
        const int64_t order = sum->orders[k], own = at * rank + at;
        turn(way, order, powers, to + own, to + own, 1, rank - at, rank);
        powers += order + 1;
    }
}

/* found = H rows (rank, columns). */
LOOPS_PART void observe(const Sum *sum, const Lanes *rows, int64_t columns, Lanes *found)
{
    for (int64_t j = 0; j < columns; ++j) found[j] = rows[j];
    for (int64_t k = 1; k < sum->kernels; ++k) {
        rows += sum->orders[k - 1] * columns;
        for (int64_t j = 0; j < columns; ++j) found[j] += rows[j];
    }
}

/* How many of 1 / m are asked for. */
LOOPS_PART int64_t inverses(const Sum *sum) { return 2 * sum->rank + TERMS + 1; }

/* Room for what the kernels are, at *work; without it their sizes alone. */
LOOPS_PART Sum prepared(const int64_t *orders, int64_t kernels, double **work)
{
    Sum sum = {.kernels = kernels, .orders = orders};
    for (int64_t k = 0; k < kernels; ++k) {
        sum.rank += orders[k];
        sum.squares += orders[k] * orders[k];
    }
    sum.powers = sum.rank + kernels;
    sum.moments = 2 * sum.rank - kernels;
    if (!work) return sum;
    sum.noise = allotted_lanes(work, 1);
    sum.rates = allotted_lanes(work, kernels);
    sum.intensity = allotted_lanes(work, sum.squares);
    sum.value = allotted_lanes(work, sum.powers);
    sum.slope = allotted_lanes(work, sum.powers);
    sum.inverse = allotted(work, inverses(&sum));
    sum.inverse[0] = 0.0;
    for (int64_t m = 1; m < inverses(&sum); ++m) sum.inverse[m] = 1.0 / (double)m;
    return sum;
}

/* What the kernels are to the records r, r + 1, ...: those beyond the last are as the last. */
LOOPS_PART void tell(const Sum *sum, const Records *all, int64_t r)
{
    Lanes *intensity = sum->intensity, *value = sum->value, *slope = sum->slope;
    const Lanes one = {1.0, 1.0, 1.0, 1.0};
    int64_t set[LANES];
    for (int64_t l = 0; l < LANES; ++l) {
        set[l] = all->sets[r + l < all->records ? r + l : all->records - 1];
        (*sum->noise)[l] = all->noises[set[l]];
    }
    for (int64_t k = 0; k < sum->kernels; ++k) {
        const int64_t order = sum->orders[k], last = order - 1;
        Lanes variance;
        for (int64_t l = 0; l < LANES; ++l) {
            sum->rates[k][l] = all->rates[set[l] * sum->kernels + k];
            variance[l] = all->kernel_variances[set[l] * sum->kernels + k];
        }
        /* (i + j)! / (i! j!), counted from the last, by Pascal's rule. */
        for (int64_t i = last; i >= 0; --i)
            for (int64_t j = last; j >= 0; --j) {
                Lanes *here = intensity + i * order + j;
                if (i == last || j == last)
                    *here = one;
                else
                    *here = here[order] + here[1];
            }
        /* Q_00 at infinity is sigma^2. */
        const Lanes q = variance * ldexp(1.0, (int)(2 * last + 1)) / intensity[0];
        for (int64_t j = 0; j < order * order; ++j) intensity[j] *= q;
        value[0] = variance;
        clear(slope, 1);
        for (int64_t m = 1; m <= order; ++m) {
            const double fewer = (double)(last - m + 1);
            if (m > last)
                clear(value + m, 1);
            else
                value[m] = value[m - 1] * (2.0 * fewer / ((double)last + fewer));
            slope[m] = (double)m * (value[m - 1] - value[m]);
        }
        intensity += order * order;
        value += order + 1;
        slope += order + 1;
    }
}

/* phi (b + 1) and the moments (2 b - 1) of one kernel's step a. */
LOOPS_PART void step(const Sum *sum, int64_t order, Lanes a, Lanes *phi, Lanes *moments)
{
    const int64_t last = 2 * order - 2;
    const double *inverse = sum->inverse;
    Lanes power;
    double largest = 0.0;
    for (int64_t l = 0; l < LANES; ++l) {
        power[l] = l && a[l] == a[l - 1] ? power[l - 1] : exp(-a[l]);
        largest = a[l] > largest ? a[l] : largest;
    }
    Lanes both = power * power;
    for (int64_t m = 0; m <= order; ++m) {
        phi[m] = power;
        power *= a * inverse[m + 1];
    }
    /* The last moment by its series, of positive terms, and each by the one after it. */
    Lanes term = {1.0, 1.0, 1.0, 1.0}, series = term;
    double most = 1.0;
    for (int64_t k = 1; k <= TERMS && most > 1e-17; ++k) {
        const double factor = 2.0 * inverse[last + 1 + k];
        most *= largest * factor;
        term *= a * factor;
        series += term;
    }
    for (int64_t m = 0; m <= last; ++m) {
        moments[m] = both; /* a^m exp(-2 a) / m! */
        both *= a * inverse[m + 1];
    }
    Lanes later = both * series;
    for (int64_t m = last; m >= 0; --m) {
        const Lanes here = moments[m];
        moments[m] = later;
        later = 2.0 * later + here;
    }
}

/* The same of all kernels, to sample i; the first is from nowhere. */
LOOPS_PART void step_all(const Sum *sum, const Samples *samples, int64_t i, Lanes *phi,
                         Lanes *moments)
{
    for (int64_t k = 0; k < sum->kernels; ++k) {
        const int64_t order = sum->orders[k], count = 2 * order - 1;
        Lanes a = samples->apart[i] * sum->rates[k];
        for (int64_t l = 0; l < LANES; ++l)
            if (!(a[l] < FAR)) a[l] = FAR;
        switch (order) {
        case 1: step(sum, 1, a, phi, moments); break;
        case 2: step(sum, 2, a, phi, moments); break;
        case 3: step(sum, 3, a, phi, moments); break;
        case 4: step(sum, 4, a, phi, moments); break;
        default: step(sum, order, a, phi, moments);
        }
        if (!i) {
            clear(phi, order + 1);
            clear(moments, count);
            for (int64_t m = 0; m < count; ++m) moments[m] += ldexp(0.5, (int)-m);
        }
        phi += order + 1;
        moments += count;
    }
}

/* P += Q. */
LOOPS_PART void disturb(const Sum *sum, const Lanes *moments, Lanes *predicted)
{
    const Lanes *intensity = sum->intensity;
    for (int64_t k = 0; k < sum->kernels; ++k) {
        const int64_t order = sum->orders[k], last = 2 * order - 2;
        for (int64_t i = 0; i < order; ++i)
            for (int64_t j = 0; j < order; ++j)
                predicted[i * sum->rank + j] += intensity[i * order + j] * moments[last - i - j];
        predicted += order * sum->rank + order;
        intensity += order * order;
        moments += 2 * order - 1;
    }
}

/* found (kernels) += tr(Lambda Q) of each kernel. */
LOOPS_PART void trace(const Sum *sum, const Lanes *moments, const Lanes *lambda, Lanes *found)
{
    const Lanes *intensity = sum->intensity;
    for (int64_t k = 0; k < sum->kernels; ++k) {
        const int64_t order = sum->orders[k], last = 2 * order - 2;
        Lanes total = found[k];
        for (int64_t i = 0; i < order; ++i)
            for (int64_t j = 0; j < order; ++j)
                total += lambda[i * sum->rank + j] *
                         (intensity[i * order + j] * moments[last - i - j]);
        found[k] = total;
        lambda += order * sum->rank + order;
        intensity += order * order;
        moments += 2 * order - 1;
    }
}

/* An entry of a symmetric matrix. */
LOOPS_PART const Lanes *entry(const Lanes *matrix, int64_t i, int64_t j, int64_t rank)
{
    return matrix + (i >= j ? i * rank + j : j * rank + i);
}

/* Records r, r + 1, ... side by side, at *work. */
LOOPS_PART Samples taken(const Records *all, int64_t r, const Lanes *noise, double **work)
{
    const int64_t coordinates = all->coordinates, columns = 1 + coordinates;
    Samples samples = {.coordinates = coordinates};
    for (int64_t l = 0; l < LANES && r + l < all->records; ++l) {
        samples.begins[l] = all->begins[r + l];
        samples.counts[l] = all->counts[r + l];
        if (samples.counts[l] > samples.count) samples.count = samples.counts[l];
    }
    samples.apart = allotted_lanes(work, samples.count);
    samples.values = allotted_lanes(work, samples.count * columns);
    samples.noises = allotted_lanes(work, samples.count);
    samples.there = allotted_lanes(work, samples.count);
    for (int64_t i = 0; i < samples.count; ++i)
        for (int64_t l = 0; l < LANES; ++l) {
            const int there = i < samples.counts[l];
            const int64_t at = samples.begins[l] + i;
            samples.there[i][l] = there;
            samples.apart[i][l] = there && i ? all->times[at] - all->times[at - 1] : 0.0;
            samples.noises[i][l] = there ? (*noise)[l] + all->variances[at] : 1.0;
            samples.values[i * columns][l] = 1.0;
            for (int64_t j = 0; j < coordinates; ++j)
                samples.values[i * columns + 1 + j][l] =
                    there ? all->values[at * coordinates + j] : 0.0;
        }
    return samples;
}

/* Where the filter's rows are, at *work. */
LOOPS_PART Filter placed(const Sum *sum, const Samples *samples, int kept, double **work)
{
    const int64_t rows = kept ? samples->count : 1, columns = 1 + samples->coordinates;
    Filter f = {.kept = kept};
    f.phi = allotted_lanes(work, rows * sum->powers);
    f.moments = allotted_lanes(work, rows * sum->moments);
    f.predicted = allotted_lanes(work, rows * sum->rank * sum->rank);
    f.gains = allotted_lanes(work, rows * sum->rank);
    f.precisions = allotted_lanes(work, samples->count);
    f.innovations = allotted_lanes(work, samples->count * columns);
    f.updated = allotted_lanes(work, sum->rank * sum->rank);
    f.means = allotted_lanes(work, sum->rank * columns);
    return f;
}

/* v = y - H m, and m+ of m (rank, columns). */
LOOPS_PART void innovate(const Sum *sum, const Lanes *gain, Lanes *means, int64_t columns,
                         const Lanes *y, Lanes *v)
{
    observe(sum, means, columns, v);
    for (int64_t j = 0; j < columns; ++j) v[j] = y[j] - v[j];
    for (int64_t i = 0; i < sum->rank; ++i) add(means + i * columns, v, gain + i, columns);
}

/* Go through the records; the sums of log S in log_det, infinity where K is not definite. */
LOOPS_PART void filter(const Sum *sum, const Samples *samples, Filter *f, double *log_det)
{
    const int64_t rank = sum->rank, columns = 1 + samples->coordinates;
    clear(f->updated, rank * rank);
    clear(f->means, rank * columns);
    for (int64_t l = 0; l < LANES; ++l) log_det[l] = 0.0;
    for (int64_t i = 0; i < samples->count; ++i) {
        const int64_t row = f->kept ? i : 0;
        Lanes *phi = f->phi + row * sum->powers, *moments = f->moments + row * sum->moments;
        Lanes *predicted = f->predicted + row * rank * rank, *gain = f->gains + row * rank;
        step_all(sum, samples, i, phi, moments);
        turn_twice(forward, sum, phi, f->updated, predicted);
        disturb(sum, moments, predicted);
        Lanes spread = samples->noises[i];
        for (int64_t j = 0; j < rank; ++j) {
            Lanes total = predicted[j * rank];
            for (int64_t k = 1, at = 0; k < sum->kernels; ++k) {
                at += sum->orders[k - 1];
                total += *entry(predicted, j, at, rank);
            }
            gain[j] = total;
        }
        for (int64_t k = 0, at = 0; k < sum->kernels; at += sum->orders[k++]) spread += gain[at];
        for (int64_t l = 0; l < LANES; ++l) {
            if (i >= samples->counts[l]) continue;
            log_det[l] += spread[l] > 0.0 ? log(spread[l]) : INFINITY;
        }
        const Lanes precision = f->precisions[i] = samples->there[i] / spread;
        for (int64_t k = 0, at = 0; k < sum->kernels; at += sum->orders[k++])
            for (int64_t j = at; j < at + sum->orders[k]; ++j) {
                const Lanes factor = precision * gain[j];
                for (int64_t m = 0; m < at + sum->orders[k]; ++m)
                    f->updated[j * rank + m] = predicted[j * rank + m] - factor * gain[m];
            }
        for (int64_t j = 0; j < rank; ++j) gain[j] *= precision;
        turn_rows(forward, sum, phi, f->means, columns);
        innovate(sum, gain, f->means, columns, samples->values + i * columns,
                 f->innovations + i * columns);
    }
}

/* The records r, r + 1, ... as their samples and what the filter leaves, at *work. */
LOOPS_PART Filter filtered(const Sum *sum, const Records *all, int64_t r, int kept,
                           Samples *samples, double *log_det, double **work)
{
    tell(sum, all, r);
    *samples = taken(all, r, sum->noise, work);
    Filter f = placed(sum, samples, kept, work);
    filter(sum, samples, &f, log_det);
    return f;
}

/* Take the means from the innovations: 1' K^-1 1, and x' Pi x. */
LOOPS_PART void centre(const Samples *samples, Filter *f, Lanes *information, Lanes *squares)
{
    const int64_t columns = 1 + samples->coordinates;
    clear(information, 1);
    clear(squares, 1);
    for (int64_t i = 0; i < samples->count; ++i) {
        const Lanes one = f->innovations[i * columns];
        *information += one * one * f->precisions[i];
    }
    for (int64_t l = 0; l < LANES; ++l)
        if (!samples->counts[l]) (*information)[l] = 1.0;
    for (int64_t j = 1; j < columns; ++j) {
        Lanes mean = {0.0};
        for (int64_t i = 0; i < samples->count; ++i) {
            const Lanes *v = f->innovations + i * columns;
            mean += v[0] * v[j] * f->precisions[i];
        }
        mean /= *information;
        for (int64_t i = 0; i < samples->count; ++i) {
            Lanes *v = f->innovations + i * columns;
            v[j] -= mean * v[0];
            *squares += v[j] * v[j] * f->precisions[i];
        }
    }
}

/* Of the samples up to the last of `count`: A (1) and q (1) of record_news. */
LOOPS_PART void sum_up(const Samples *samples, const Filter *f, int64_t count, Lanes *sum,
                       Lanes *square)
{
    const int64_t columns = 1 + samples->coordinates;
    for (int64_t i = 0; i < count; ++i) {
        const Lanes one = f->innovations[i * columns];
        *sum += one * one * f->precisions[i];
    }
    clear(square, 1);
    for (int64_t j = 1; j < columns; ++j) {
        Lanes product = {0.0};
        for (int64_t i = 0; i < count; ++i) {
            const Lanes *v = f->innovations + i * columns, weighed = v[j] * f->precisions[i];
            *square += v[j] * weighed;
            product += v[0] * weighed;
        }
        *square -= product * product / *sum;
    }
}

/* Go back: alpha (n, 1 + c), which is K^-1 1 and Pi x, and tr(K^-1 dK/dtheta) (2 k + 1). */
LOOPS_PART void smooth(const Sum *sum, const Samples *samples, const Filter *f, Lanes *alpha,
                       Lanes *traces, double *work)
{
    const int64_t rank = sum->rank, columns = 1 + samples->coordinates, kernels = sum->kernels;
    Lanes *state = allotted_lanes(&work, rank * columns);
    Lanes *lambda = allotted_lanes(&work, rank * rank), *turned = allotted_lanes(&work, rank);
    Lanes *ends = allotted_lanes(&work, kernels), *signals = allotted_lanes(&work, kernels);
    Lanes *lengths = allotted_lanes(&work, kernels);
    clear(state, rank * columns);
    clear(lambda, rank * rank);
    clear(ends, kernels);
    clear(signals, kernels);
    clear(lengths, kernels);
    Lanes noise = {0.0};
    for (int64_t i = samples->count - 1; i >= 0; --i) {
        const Lanes *gain = f->gains + i * rank, *v = f->innovations + i * columns;
        const Lanes *moments = f->moments + i * sum->moments;
        Lanes *here = alpha + i * columns, delta = f->precisions[i];
        for (int64_t j = 0; j < columns; ++j) here[j] = v[j] * delta;
        for (int64_t j = 0; j < rank; ++j) add(here, state + j * columns, gain + j, columns);
        for (int64_t j = 0; j < rank; ++j) {
            Lanes total = {0.0};
            for (int64_t m = 0; m < rank; ++m) total += gain[m] * *entry(lambda, j, m, rank);
            turned[j] = total;
        }
        for (int64_t j = 0; j < rank; ++j) delta += gain[j] * turned[j];
        noise += delta;
        for (int64_t k = 0, at = 0; k < kernels; at += sum->orders[k++]) {
            for (int64_t j = 0; j < columns; ++j) state[at * columns + j] -= here[j];
            for (int64_t j = 0; j < at + sum->orders[k]; ++j) lambda[at * rank + j] -= turned[j];
            for (int64_t j = at; j < rank; ++j) lambda[j * rank + at] -= turned[j];
            for (int64_t m = 0, to = 0; m <= k; to += sum->orders[m++])
                lambda[at * rank + to] += delta;
        }
        trace(sum, moments, lambda, signals);
        if (!i) break;
        const Lanes *predicted = f->predicted + i * rank * rank;
        for (int64_t k = 0, at = 0; k < kernels; at += sum->orders[k++]) {
            const int64_t last = at + sum->orders[k] - 1;
            Lanes a = samples->apart[i] * sum->rates[k], total = {0.0};
            for (int64_t l = 0; l < LANES; ++l)
                if (!(a[l] < FAR)) a[l] = 0.0;
            for (int64_t s = at; s <= last; ++s)
                for (int64_t j = 0; j < rank; ++j) {
                    Lanes p = *entry(predicted, s, j, rank);
                    if (s < last) p -= *entry(predicted, s + 1, j, rank);
                    total += p * *entry(lambda, s, j, rank);
                }
            lengths[k] += 2.0 * a * total;
            ends[k] -= a * lambda[last * rank + last];
        }
        turn_rows(backward, sum, f->phi + i * sum->powers, state, columns);
        turn_twice(backward, sum, f->phi + i * sum->powers, lambda, lambda);
    }
    const Lanes *intensity = sum->intensity;
    for (int64_t k = 0; k < kernels; ++k) {
        intensity += sum->orders[k] * sum->orders[k];
        traces[2 * k] = 2.0 * signals[k];
        traces[2 * k + 1] = lengths[k] + ends[k] * intensity[-1];
    }
    traces[2 * kernels] = 2.0 * *sum->noise * noise;
}

/* The products u (n, c, p) of dK/dtheta with Pi x, and 1' K^-1 dK/dtheta K^-1 1, ones (p); those
 * of kernel k. */
LOOPS_PART void multiply(const Sum *sum, const Samples *samples, const Filter *f, int64_t k,
                         const Lanes *alpha, Lanes *u, Lanes *ones, double *work)
{
    const int64_t columns = 1 + samples->coordinates, size = 2 * sum->kernels + 1;
    const int64_t order = sum->orders[k];
    int64_t at = 0;
    for (int64_t m = 0; m < k; ++m) at += sum->orders[m] + 1;
    const Lanes *value = sum->value + at, *slope = sum->slope + at;
    Lanes *t = allotted_lanes(&work, (order + 1) * columns);
    for (int64_t i = 0; i < samples->count; ++i) {
        const Lanes *here = alpha + i * columns;
        ones[2 * k] += 2.0 * value[0] * here[0] * here[0];
        for (int64_t j = 1; j < columns; ++j) {
            Lanes *to = u + (i * (columns - 1) + j - 1) * size + 2 * k;
            to[0] = 2.0 * value[0] * here[j];
            clear(to + 1, 1);
        }
    }
    for (int64_t way = 0; way < 2; ++way) { /* those before, those after */
        clear(t, (order + 1) * columns);
        for (int64_t done = 1; done < samples->count; ++done) {
            const int64_t i = way ? samples->count - 1 - done : done;
            const Lanes *here = alpha + i * columns, *last = way ? here + columns : here - columns;
            for (int64_t j = 0; j < columns; ++j) t[j] += last[j];
            turn(backward, order + 1, f->phi + (way ? i + 1 : i) * sum->powers + at, t, t, columns,
                 columns, 1);
            for (int64_t j = 0; j < columns; ++j) {
                Lanes signal = value[0] * t[j], length = slope[0] * t[j];
                for (int64_t m = 1; m <= order; ++m) {
                    signal += value[m] * t[m * columns + j];
                    length += slope[m] * t[m * columns + j];
                }
                Lanes *to = u + (i * (columns - 1) + j - 1) * size + 2 * k;
                if (j) {
                    to[0] += 2.0 * signal;
                    to[1] += length;
                } else {
                    ones[2 * k] += 2.0 * signal * here[0];
                    ones[2 * k + 1] += length * here[0];
                }
            }
        }
    }
}

/* How many doubles of work are needed where the longest record has count samples: room (1). */
int record_room(const int64_t *orders, int64_t kernels, int64_t coordinates, int64_t count,
                int64_t slopes, int64_t *room)
{
    const Sum sum = prepared(orders, kernels, 0);
    const int64_t columns = 1 + coordinates, size = 2 * kernels + 1, rank = sum.rank;
    const int64_t rows = slopes ? count : 1;
    int64_t lanes = count * (3 + columns);
    lanes += rows * (sum.powers + sum.moments + rank * rank + rank) + count * (1 + columns);
    lanes += rank * rank + rank * columns;
    if (slopes) {
        lanes += count * columns + 2 * size + count * coordinates * size;
        const int64_t back = rank * columns + rank * rank + rank + 3 * kernels;
        const int64_t forth = (rank + 2) * coordinates * size + size * (size + 1);
        const int64_t products = sum.powers * columns;
        lanes += back > forth ? back : forth;
        lanes += products;
    }
    lanes += 1 + kernels + sum.squares + 2 * sum.powers;
    *room = inverses(&sum) + LANES * lanes;
    return 0;
}

/* Each record's log|K| + log 1' K^-1 1 and x' Pi x, found (records, 2), infinity both where K is
 * not positive definite; records as in Records, orders (kernels). Records of one length go well
 * side by side. */
LOOPS_WIDE
int record_values(const int64_t *begins, const int64_t *counts, int64_t records,
                  const double *times, const double *values, const double *variances,
                  int64_t coordinates, const int64_t *orders, int64_t kernels,
                  const int64_t *sets, const double *rates, const double *kernel_variances,
                  const double *noises,
                  double *work, double *found)
{
    const Records all = {begins, counts, sets, times, values, variances, rates, kernel_variances,
                         noises, records, coordinates};
    const Sum sum = prepared(orders, kernels, &work);
    for (int64_t r = 0; r < records; r += LANES) {
        double *rest = work, log_det[LANES];
        Samples samples;
        Filter f = filtered(&sum, &all, r, 0, &samples, log_det, &rest);
        Lanes information, squares;
        centre(&samples, &f, &information, &squares);
        for (int64_t l = 0; l < LANES && r + l < records; ++l) {
            const int definite = log_det[l] < INFINITY && information[l] > 0.0;
            found[2 * (r + l)] = definite ? log_det[l] + log(information[l]) : INFINITY;
            found[2 * (r + l) + 1] = definite ? squares[l] : INFINITY;
        }
    }
    return 0;
}

/* What each record's samples from its row `first` >= 1 on add to q and to log|K| + log A, found
 * (records, 2), infinity both where K is not positive definite. Of the mean's prior each set has an
 * information (sets), which A = 1' K^-1 1 has beside; q = x' K^-1 x - |1' K^-1 x|^2 / A. All have
 * more samples than `first`, and the rest is as in record_values. */
LOOPS_WIDE
int record_news(const int64_t *begins, const int64_t *counts, int64_t records,
                const double *times, const double *values, const double *variances,
                int64_t coordinates, const int64_t *orders, int64_t kernels,
                const int64_t *sets, const double *rates, const double *kernel_variances,
                const double *noises,
                const double *information, int64_t first, double *work, double *found)
{
    const Records all = {begins, counts, sets, times, values, variances, rates, kernel_variances,
                         noises, records, coordinates};
    const Sum sum = prepared(orders, kernels, &work);
    for (int64_t r = 0; r < records; r += LANES) {
        double *rest = work, log_det[LANES];
        Samples samples;
        const Filter f = filtered(&sum, &all, r, 0, &samples, log_det, &rest);
        Lanes before, after, known, square;
        for (int64_t l = 0; l < LANES; ++l)
            before[l] = after[l] = information[sets[r + l < records ? r + l : records - 1]];
        sum_up(&samples, &f, first, &before, &known);
        sum_up(&samples, &f, samples.count, &after, &square);
        for (int64_t l = 0; l < LANES && r + l < records; ++l) {
            double spread = log(after[l] / before[l]);
            for (int64_t i = first; i < samples.counts[l]; ++i)
                spread -= log(f.precisions[i][l]);
            const int definite = log_det[l] < INFINITY;
            found[2 * (r + l)] = definite ? square[l] - known[l] : INFINITY;
            found[2 * (r + l) + 1] = definite ? spread : INFINITY;
        }
    }
    return 0;
}

/* The sums over the records of each set of the slope of log p, gradient (sets, p), and of its
 * average information (sets, p, p), with `freedom` degrees; K is positive definite, `many` the
 * number of sets, and the rest as of record_values. */
LOOPS_WIDE
int record_slopes(const int64_t *begins, const int64_t *counts, int64_t records,
                  const double *times, const double *values, const double *variances,
                  int64_t coordinates, const int64_t *orders, int64_t kernels,
                  const int64_t *sets, const double *rates, const double *kernel_variances,
                  const double *noises,
                  int64_t many, double freedom, double *work, double *gradient,
                  double *information)
{
    const Records all = {begins, counts, sets, times, values, variances, rates, kernel_variances,
                         noises, records, coordinates};
    const Sum sum = prepared(orders, kernels, &work);
    const int64_t size = 2 * kernels + 1, columns = coordinates * size;
    memset(gradient, 0, (size_t)(many * size) * sizeof(double));
    memset(information, 0, (size_t)(many * size * size) * sizeof(double));
    for (int64_t r = 0; r < records; r += LANES) {
        double *rest = work, log_det[LANES];
        Samples samples;
        Filter f = filtered(&sum, &all, r, 1, &samples, log_det, &rest);
        Lanes mean_information, squares;
        centre(&samples, &f, &mean_information, &squares);
        Lanes *alpha = allotted_lanes(&rest, samples.count * (1 + coordinates));
        Lanes *traces = allotted_lanes(&rest, size), *ones = allotted_lanes(&rest, size);
        Lanes *u = allotted_lanes(&rest, samples.count * columns);
        smooth(&sum, &samples, &f, alpha, traces, rest);

        clear(ones, size);
        for (int64_t k = 0; k < kernels; ++k)
            multiply(&sum, &samples, &f, k, alpha, u, ones, rest);
        const Lanes twice = 2.0 * *sum.noise;
        for (int64_t i = 0; i < samples.count; ++i) {
            const Lanes *here = alpha + i * (1 + coordinates);
            ones[size - 1] += twice * here[0] * here[0];
            for (int64_t j = 0; j < coordinates; ++j)
                u[i * columns + (j + 1) * size - 1] = twice * here[1 + j];
        }

        /* x' Pi dK/dtheta Pi x; then the u go through the filter as x did. */
        Lanes *explained = allotted_lanes(&rest, size);
        Lanes *products = allotted_lanes(&rest, size * size);
        Lanes *projected = allotted_lanes(&rest, columns), *v = allotted_lanes(&rest, columns);
        Lanes *states = allotted_lanes(&rest, sum.rank * columns);
        clear(explained, size);
        clear(products, size * size);
        clear(projected, columns);
        clear(states, sum.rank * columns);
        for (int64_t i = 0; i < samples.count; ++i) {
            const Lanes *y = u + i * columns, precision = f.precisions[i];
            for (int64_t j = 0; j < coordinates; ++j)
                add(explained, y + j * size, alpha + i * (1 + coordinates) + 1 + j, size);
            turn_rows(forward, &sum, f.phi + i * sum.powers, states, columns);
            innovate(&sum, f.gains + i * sum.rank, states, columns, y, v);
            const Lanes one = precision * f.innovations[i * (1 + coordinates)];
            add(projected, v, &one, columns);
            for (int64_t p = 0; p < size; ++p)
                for (int64_t j = 0; j < coordinates; ++j) {
                    const Lanes factor = precision * v[j * size + p];
                    add(products + p * size, v + j * size, &factor, p + 1);
                }
        }

        for (int64_t l = 0; l < LANES && r + l < records; ++l) {
            const double held = freedom + squares[l], single = mean_information[l];
            const double free = freedom + (double)(coordinates * (samples.counts[l] - 1));
            const double weight = 0.5 * free / held;
            double *slope = gradient + sets[r + l] * size;
            double *square = information + sets[r + l] * size * size;
            for (int64_t p = 0; p < size; ++p) {
                slope[p] += weight * explained[p][l] -
                            0.5 * (double)coordinates * (traces[p][l] - ones[p][l] / single);
                for (int64_t q = 0; q <= p; ++q) {
                    double found = products[p * size + q][l];
                    found -= explained[p][l] * explained[q][l] / held;
                    for (int64_t j = 0; j < coordinates; ++j)
                        found -= projected[j * size + p][l] * projected[j * size + q][l] / single;
                    square[p * size + q] += weight * found;
                    if (q < p) square[q * size + p] += weight * found;
                }
            }
        }
    }
    return 0;
}
