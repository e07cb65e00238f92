/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Where a search for a process begins (error_model/structure.py, error_model/start.py): the structure
 * function of errors, the non-negative variances that explain it, and the correlation of two speeds
 * at many offsets.
 */
#include "chain.h"
#include "solve.h"

#include <string.h>

static const double ROUND_OFF = 1e-12;

/* The k-th smallest of a (n,), to its place, with none larger before it (Hoare, Wirth). */
static double selected(int64_t n, int64_t k, double *a)
{
    int64_t low = 0, high = n - 1;
    while (low < high) {
        const double pivot = a[k];
        int64_t i = low, j = high;
        while (i <= j) {
            while (a[i] < pivot)
                i++;
            while (pivot < a[j])
                j--;
            if (i <= j) {
                const double kept = a[i];
                a[i++] = a[j];
                a[j--] = kept;
            }
        }
        if (j < k)
            low = i;
        if (k < i)
            high = j;
    }
    return a[k];
}

static double median(int64_t n, double *a)
{
    const double upper = selected(n, n / 2, a);
    if (n % 2)
        return upper;
    double lower = a[0];
    for (int64_t i = 1; i < n / 2; i++)
        lower = fmax(lower, a[i]);
    return 0.5 * (lower + upper);
}

/* The variance on one axis of differences over steps[l] poses each, none of which lie further apart
 * in time than longest[l]: by the median of the squares over three axes, then by means that are
 * clipped at `rare` of it. errors (3, N), times (N,), steps, longest and variances (lags,), work (N,).
 * Returns how many there are; after the first without any difference there is none. */
int structure(int64_t count, int64_t lags, const double *errors, const double *times,
              const int64_t *steps, const double *longest, double of_median, double rare,
              int64_t clipped, double *variances, double *work)
{
    for (int64_t l = 0; l < lags; l++) {
        int64_t n = 0;
        for (int64_t i = 0; i + steps[l] < count; i++) {
            const int64_t later = i + steps[l];
            if (!(times[later] - times[i] < longest[l]))
                continue;
            double square = 0.0;
            for (int x = 0; x < 3; x++) {
                const double apart = errors[x * count + later] - errors[x * count + i];
                square += apart * apart;
            }
            work[n++] = square;
        }
        if (n == 0)
            return (int)l;
        double variance = median(n, work) / of_median;
        for (int64_t c = 0; c < clipped; c++) {
            const double most = rare * variance;
            double sum = 0.0;
            for (int64_t i = 0; i < n; i++)
                sum += work[i] > most ? most : work[i];
            variance = sum / (double)n / 3.0;
        }
        variances[l] = variance;
    }
    return (int)lags;
}

/* Non-negative least squares of each of m problems in k <= 3 unknowns: the best of all choices of
 * unknowns that are not zero. normal (m, k, k), right (m, k); squares: of the right-hand sides before
 * all; best (m, k), and the squares that are left, cost (m,). */
int nonnegative(int64_t m, int64_t size, const double *normal, const double *right, double squares,
                double *best, double *cost)
{
    const int k = (int)size;
    for (int64_t i = 0; i < m; i++, normal += k * k, right += k, best += k, cost++) {
        *cost = INFINITY;
        for (int c = 0; c < k; c++)
            best[c] = 0.0;
        for (int chosen = 1; chosen < 1 << k; chosen++) {
            double a[MOST][MOST], x[MOST], trace = 0.0, left = squares;
            int index[MOST], n = 0, proper = 1;
            for (int c = 0; c < k; c++)
                if (chosen >> c & 1) {
                    trace += normal[c * k + c];
                    index[n++] = c;
                }
            for (int r = 0; r < n; r++) {
                x[r] = right[index[r]];
                for (int c = 0; c < n; c++)
                    a[r][c] = normal[index[r] * k + index[c]] + (r == c ? 1e-12 * trace : 0.0);
            }
            if (solve(n, a, x))
                continue;
            for (int r = 0; r < n; r++) {
                proper = proper && x[r] >= 0.0;
                left -= x[r] * right[index[r]];
            }
            if (!proper || !(left < *cost))
                continue;
            *cost = left;
            for (int c = 0; c < k; c++)
                best[c] = 0.0;
            for (int r = 0; r < n; r++)
                best[index[r]] = x[r];
        }
    }
    return 0;
}

/* A structure function (lags,), the number of lags, which is 0 of too few poses; as `structure` of
 * structure.py. times (N,), rest (N,): work. */
static int64_t set_structure(int64_t count, const double *errors, const double *intervals,
                             const double *variance, const Beginning *rules, double *lags,
                             double *found, double *times, double *rest)
{
    int64_t steps[LAGS], n = 1;
    double longest[LAGS];
    memcpy(rest, intervals, (count - 1) * sizeof *rest);
    const double interval = median(count - 1, rest);
    const double most = fmax(rules->longest * (double)count, 3.0);
    for (steps[0] = 1; n < LAGS && (double)steps[n - 1] * rules->growth < most; n++) {
        const int64_t next = (int64_t)((double)steps[n - 1] * rules->growth);
        steps[n] = next > steps[n - 1] ? next : steps[n - 1] + 1;
    }
    for (int64_t l = 0; l < n; l++)
        longest[l] = rules->gap * interval * (double)steps[l];
    times[0] = 0.0;
    for (int64_t i = 0; i + 1 < count; i++)
        times[i + 1] = times[i] + intervals[i];
    n = structure(count, n, errors, times, steps, longest, rules->of_median, rules->rare,
                  (int64_t)rules->clipped, found, rest);
    memcpy(rest, variance, count * sizeof *rest);
    const double known = median(count, rest);
    for (int64_t l = 0; l < n; l++) {
        const double raw = 0.5 * found[l];
        lags[l] = interval * (double)steps[l];
        found[l] = fmax(fmax(raw - known, 0.1 * raw), 1e-14);
    }
    return n;
}

/* What each variance of a process with a time adds at a lag, (k,). */
static void set_design(int64_t kind, double lag, double time, double *row)
{
    const double h = lag / time;
    row[0] = 1.0;
    if (kind == WANDER) {
        row[1] = -expm1(-h);
        return;
    }
    row[1] = 0.5 * lag;
    if (kind == VELOCITY)
        row[2] = time * time * (h + expm1(-h));
}

/* Parameters (starts, 4) at which to begin, the likeliest first, as `starts` of structure.py. Returns
 * how many there are. work: (2 N,). */
int structure_starts(int64_t kind, int64_t count, const double *errors, const double *intervals,
                     const double *variance, const Beginning *rules, double *starts, double *work)
{
    double lags[LAGS], found[LAGS], weight[LAGS], largest = 0.0, squares = 0.0;
    double normal[TIMES * 9], right[TIMES * 3], best[TIMES * 3], cost[TIMES], times[TIMES];
    double least[3], last[TIMES];
    const int k = kind == VELOCITY ? 3 : 2, m = kind == DRIFT ? 1 : TIMES;
    const int64_t n =
        set_structure(count, errors, intervals, variance, rules, lags, found, work, work + count);
    if (n == 0)
        return 0;
    for (int64_t l = 0; l < n; l++)
        largest = fmax(largest, found[l]);
    for (int64_t l = 0; l < n; l++) {
        weight[l] = 1.0 / fmax(found[l], 1e-6 * largest + 1e-300) / sqrt(lags[l]);
        squares += found[l] * weight[l] * (found[l] * weight[l]);
    }
    const double first = log10(2.0 * lags[0]);
    const double span = log10(fmax(2.0 * lags[n - 1], 8.0 * lags[0])) - first;
    memset(normal, 0, sizeof normal);
    memset(right, 0, sizeof right);
    for (int i = 0; i < m; i++) {
        double *const a = normal + i * k * k, *const b = right + i * k;
        times[i] = pow(10.0, first + span * i / (TIMES - 1));
        for (int64_t l = 0; l < n; l++) {
            double row[3];
            set_design(kind, lags[l], times[i], row);
            last[i] = row[k - 1];
            for (int r = 0; r < k; r++) {
                row[r] *= weight[l];
                b[r] += row[r] * (found[l] * weight[l]);
                for (int c = 0; c <= r; c++)
                    a[r * k + c] = a[c * k + r] += row[r] * row[c];
            }
        }
    }
    nonnegative(m, k, normal, right, squares, best, cost);
    least[0] = rules->least * found[0];
    least[1] = 2.0 * rules->least * found[0] / lags[0];
    least[2] = 0.0;
    int chosen = 0, order[TIMES];
    for (int i = 0; i < m; i++) {
        if (!((i == 0 || cost[i] <= cost[i - 1]) && (i + 1 == m || cost[i] <= cost[i + 1])))
            continue;
        int place = chosen++;
        for (; place > 0 && cost[order[place - 1]] > cost[i]; place--)
            order[place] = order[place - 1];
        order[place] = i;
    }
    if (chosen > (int)rules->starts)
        chosen = (int)rules->starts;
    for (int j = 0; j < chosen; j++) {
        const int i = order[j];
        double *const to = starts + PARAMETERS * j;
        if (kind != DRIFT) /* something of the process, as it would be the tenth of what there is */
            least[k - 1] = 0.1 * found[n - 1] / fmax(last[i], 1e-300);
        for (int r = 0; r < k; r++)
            to[r] = 0.5 * log(fmax(best[i * k + r], least[r]));
        if (kind != DRIFT)
            to[k] = log(times[i]);
    }
    return chosen;
}

static double mean_of(int64_t n, const double *values)
{
    double sum = 0.0;
    for (int64_t i = 0; i < n; i++)
        sum += values[i];
    return n ? sum / (double)n : 0.0;
}

/* Pearson's correlation of speeds (n,) at times (n,) with others (m,) at their times (m,), which are
 * interpolated where they are later by each of the offsets (lags,); both increase. Zero where either
 * does not vary, or there are none. work: (m,). */
int correlations(int64_t n, int64_t m, int64_t lags, const double *times, const double *speeds,
                 const double *other_times, const double *others, const double *offsets,
                 double *found, double *work)
{
    /* About their means, that the sums of products keep their digits. */
    const double own = mean_of(n, speeds), other = mean_of(m, others);
    double *const slopes = work;
    slopes[m - 1] = 0.0;
    for (int64_t i = 0; i + 1 < m; i++)
        slopes[i] = (others[i + 1] - others[i]) / (other_times[i + 1] - other_times[i]);
    for (int64_t l = 0; l < lags; l++) {
        double count = 0.0, x = 0.0, y = 0.0, xx = 0.0, xy = 0.0, yy = 0.0;
        int64_t at = 0;
        for (int64_t i = 0; i < n; i++) {
            const double time = times[i] + offsets[l];
            if (time < other_times[0])
                continue;
            if (!(time <= other_times[m - 1]))
                break;
            while (at + 1 < m && other_times[at + 1] <= time)
                at++;
            const double here = speeds[i] - own;
            const double there = others[at] + slopes[at] * (time - other_times[at]) - other;
            count += 1.0;
            x += here;
            y += there;
            xx += here * here;
            xy += here * there;
            yy += there * there;
        }
        const double share = count > 0.0 ? 1.0 / count : 0.0;
        const double a = xx - share * x * x, b = yy - share * y * y;
        /* What round-off leaves of a series that does not vary is no variance. */
        const int varies = a > ROUND_OFF * xx && b > ROUND_OFF * yy;
        found[l] = varies ? (xy - share * x * y) / sqrt(a * b) : 0.0;
    }
    return 0;
}
