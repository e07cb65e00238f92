/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Rows of `files/columns.py`: each number as the shortest text that reads back as the same, Python's
 * repr. After R. Giulietti, "The Schubfach way to render doubles", 2021; figures in comments are
 * its. Where a compiler knows no integers of 128 bits nothing is written.
 */
#include <string.h>

#include "loops.h"

#ifdef __SIZEOF_INT128__

/* 10^k = g 2^(...), rounded up to 128 bits of which the first is set, high half first. */
enum { LEAST_POWER = -292, MOST_DIGITS = 20, LONGEST = 24 };

/* floor(log10(2^q)), of 3/4 of it, and floor(log2(10^e)). */
static int log10_of_2(int q) { return (int)(((int64_t)q * 1262611) >> 22); }
static int log10_of_3_4(int q) { return (int)(((int64_t)q * 1262611 - 524031) >> 22); }
static int log2_of_10(int e) { return (int)(((int64_t)e * 1741647) >> 19); }

/* The upper 64 bits of the product; what is cut off is told by the last bit (figure 8). */
static uint64_t to_odd(const uint64_t *g, uint64_t c)
{
    __extension__ typedef unsigned __int128 wide;
    const wide low = (wide)g[1] * c, high = (wide)g[0] * c + (uint64_t)(low >> 64);
    return (uint64_t)(high >> 64) | ((uint64_t)high > 1);
}

/* The shortest decimal that lies nearer to m 2^q than to its neighbours, and of those the nearest:
 * returns its digits, and the power of ten in *exponent. `uneven`: the neighbour below is nearer. */
static uint64_t shortest(uint64_t m, int q, int uneven, const uint64_t *powers, int *exponent)
{
    const int k = uneven ? log10_of_3_4(q) : log10_of_2(q), h = q + log2_of_10(-k) + 1;
    const uint64_t *g = powers + 2 * (-k - LEAST_POWER), odd = m & 1;
    const uint64_t low = to_odd(g, (4 * m - 2 + (uint64_t)uneven) << h) + odd;
    const uint64_t here = to_odd(g, (4 * m) << h), high = to_odd(g, (4 * m + 2) << h) - odd;
    const uint64_t s = here / 4, t = s / 10;
    if (s >= 10) {
        const int below = low <= 40 * t, above = 40 * t + 40 <= high;
        *exponent = k + 1;
        if (below != above)
            return t + (uint64_t)above;
    }
    const int below = low <= 4 * s, above = 4 * s + 4 <= high;
    *exponent = k;
    if (below != above)
        return s + (uint64_t)above;
    return s + (here > 4 * s + 2 || (here == 4 * s + 2 && (s & 1)));
}

/* Decimal digits of a number from `out` on; how many. */
static int whole(uint64_t number, char *out)
{
    char reversed[MOST_DIGITS];
    int n = 0;
    do
        reversed[n++] = (char)('0' + number % 10);
    while (number /= 10);
    for (int i = 0; i < n; i++)
        out[i] = reversed[n - 1 - i];
    return n;
}

/* Digits with a point behind the first `before`, of which there may be more or less than there are
 * digits; how long. */
static int pointed(const char *digits, int n, int before, char *out)
{
    char *at = out;
    if (before <= 0)
        *at++ = '0';
    for (int i = 0; i < before; i++)
        *at++ = i < n ? digits[i] : '0';
    *at++ = '.';
    for (int i = before; i < 0; i++)
        *at++ = '0';
    for (int i = before < 0 ? 0 : before; i < n; i++)
        *at++ = digits[i];
    if (before >= n)
        *at++ = '0';
    return (int)(at - out);
}

/* A number as Python writes it, one that is none as nothing; how long, LONGEST at the most. */
static int64_t number(double value, const uint64_t *powers, char *out)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    const uint64_t fraction = bits & ((UINT64_C(1) << 52) - 1);
    const int biased = (int)(bits >> 52 & 0x7ff);
    char *at = out;
    if (biased == 0x7ff && fraction)
        return 0;
    if (bits >> 63)
        *at++ = '-';
    if (biased == 0x7ff) {
        memcpy(at, "inf", 3);
        return at + 3 - out;
    }
    char digits[MOST_DIGITS];
    int n = 1, exponent = 0;
    digits[0] = '0';
    if (biased || fraction) {
        const uint64_t m = biased ? fraction | UINT64_C(1) << 52 : fraction;
        const int q = (biased ? biased : 1) - 1075;
        n = whole(shortest(m, q, biased > 1 && !fraction, powers, &exponent), digits);
        for (; n > 1 && digits[n - 1] == '0'; n--)
            exponent++;
    }
    const int before = n + exponent;
    if (before > -4 && before <= 16)
        return at + pointed(digits, n, before, at) - out;
    *at++ = digits[0];
    if (n > 1) {
        *at++ = '.';
        memcpy(at, digits + 1, (size_t)n - 1);
        at += n - 1;
    }
    const int power = before - 1;
    *at++ = 'e';
    *at++ = power < 0 ? '-' : '+';
    if (power < 10 && power > -10)
        *at++ = '0';
    return at + whole((uint64_t)(power < 0 ? -power : power), at) - out;
}

/* The last columns of a row: whether it is `sampled`, blanks up to `width`, and two numbers. */
static char *tail(int sampled, int64_t width, const double *errors, const uint64_t *powers,
                  char *out)
{
    char texts[2][LONGEST];
    const int64_t first = number(errors[0], powers, texts[0]);
    const int64_t second = number(errors[1], powers, texts[1]);
    memset(out, ' ', (size_t)width);
    out[0] = ',';
    out[1] = (char)('0' + sampled);
    char *at = out + width - second - 1;
    memcpy(at + 1, texts[1], (size_t)second);
    *at = ',';
    at -= first + 1;
    memcpy(at + 1, texts[0], (size_t)first);
    *at = ',';
    return out + width;
}

/* Rows of stamps (n,), values (n, m), and the columns of `tail`, from `out` on, which has room for
 * 25 characters a number and `width` of the tail. How long they are. */
int digits_rows(const int64_t *stamps, const double *values, const char *sampled, int64_t n,
                int64_t m, int64_t width, const uint64_t *powers, char *out)
{
    static const double nothing[2] = {NAN, NAN};
    char *at = out;
    for (int64_t i = 0; i < n; i++, values += m) {
        if (stamps[i] < 0)
            *at++ = '-';
        at += whole(stamps[i] < 0 ? -(uint64_t)stamps[i] : (uint64_t)stamps[i], at);
        for (int64_t j = 0; j < m; j++) {
            *at++ = ',';
            at += number(values[j], powers, at);
        }
        at = tail(sampled[i], width, nothing, powers, at);
        *at++ = '\n';
    }
    return (int)(at - out);
}

/* Put errors (n, 2) in the tails of rows, `length` characters, of those that are sampled. Not 0 where one
 * is not whole. */
int digits_tails(char *rows, int64_t length, const double *errors, int64_t width,
                 const uint64_t *powers)
{
    for (char *at = rows; at < rows + length; at++, errors += 2) {
        at = memchr(at, '\n', (size_t)(rows + length - at));
        if (!at || at - rows < width)
            return 1;
        if (at[1 - width] == '1')
            tail(1, width, errors, powers, at - width);
    }
    return 0;
}

#else

int digits_rows(void) { return -1; }
int digits_tails(void) { return -1; }

#endif
