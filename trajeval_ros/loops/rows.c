/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Rows of numbers in a plain text: ASCII, numbers apart by blanks, tabs and commas, `#` begins a
 * comment. Whatever else is in a text is for the reader in Python to judge.
 *
 * The digits of a number make an integer m < 10^19, and the number is m 10^k. Where m <= 2^53 and
 * |k| <= 22 both m and 10^|k| are doubles, and the one operation on them rounds to the nearest, as
 * is right (Clinger, "How to read floating point numbers accurately", 1990). Others are strtod's.
 */
#include <float.h>
#include <stdbool.h>
#include <stdlib.h>

#include "loops.h"

#define MOST_DIGITS 19
#define LARGEST_EXACT (1ULL << 53)
#define MOST_TENS 22
/* Beyond any that a double has: no exponent that is written overflows. */
#define LARGEST_EXPONENT 100000

static const double TENS[MOST_TENS + 1] = {
    1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
    1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};

/* A number as it is written: -+ digits 10^-decimals, unless `many` digits were left out. */
typedef struct {
    uint64_t digits;
    int64_t decimals;
    bool negative, many;
    double value;
} Number;

static bool is_digit(uint8_t letter) { return letter >= '0' && letter <= '9'; }

static bool is_blank(uint8_t letter) { return letter == ' ' || letter == '\t' || letter == ','; }

/* Where the line of `at` ends: at its line feed, or the carriage return before. */
static bool ends_line(const uint8_t *at) { return *at == '\n' || (*at == '\r' && at[1] == '\n'); }

/* Behind a word in small letters if it stands at `at` in letters of any size, else NULL. */
static const uint8_t *behind(const uint8_t *at, const char *word) {
    for (; *word; word++, at++)
        if ((*at | 0x20) != (uint8_t)*word) return NULL;
    return at;
}

/* `nan`, `inf` and `infinity`, behind the sign. */
static const uint8_t *not_finite(const uint8_t *at, Number *number) {
    const uint8_t *end = behind(at, "nan");
    number->value = end ? NAN : INFINITY;
    if (!end) end = behind(at, "infinity");
    if (!end) end = behind(at, "inf");
    number->digits = 0, number->decimals = 0, number->many = false;
    if (number->negative) number->value = -number->value;
    return end;
}

/* The number at `at`; returns what is behind it, or NULL where there is none. */
static const uint8_t *read_number(const uint8_t *at, Number *number) {
    const uint8_t *const begin = at;
    uint64_t digits = 0;
    int64_t decimals = 0, significant = 0, seen = 0;
    bool point = false;
    number->negative = *at == '-';
    if (*at == '-' || *at == '+') at++;
    if (!is_digit(*at) && *at != '.') return not_finite(at, number);
    for (;; at++) {
        if (*at == '.' && !point) {
            point = true;
            continue;
        }
        if (!is_digit(*at)) break;
        seen++;
        significant += significant || *at != '0';
        if (significant > MOST_DIGITS) continue;
        digits = 10 * digits + (uint64_t)(*at - '0');
        decimals += point;
    }
    if (!seen) return NULL;
    if ((*at | 0x20) == 'e') {
        bool down = *++at == '-';
        int64_t exponent = 0;
        if (*at == '-' || *at == '+') at++;
        if (!is_digit(*at)) return NULL;
        for (; is_digit(*at); at++)
            if (exponent < LARGEST_EXPONENT) exponent = 10 * exponent + (*at - '0');
        decimals += down ? exponent : -exponent;
    }
    number->digits = digits, number->decimals = decimals;
    number->many = significant > MOST_DIGITS;
    if (FLT_EVAL_METHOD == 0 && digits <= LARGEST_EXACT && llabs(decimals) <= MOST_TENS &&
        !number->many) {
        double magnitude = (double)digits;
        magnitude = decimals > 0 ? magnitude / TENS[decimals] : magnitude * TENS[-decimals];
        number->value = number->negative ? -magnitude : magnitude;
        return at;
    }
    char *end;
    number->value = strtod((const char *)begin, &end);
    /* Somebody else's locale has another point. */
    return (const uint8_t *)end == at ? at : NULL;
}

/* Behind a comment, at the line's end; NULL where it has other letters than ASCII's. */
static const uint8_t *behind_comment(const uint8_t *at) {
    for (; !ends_line(at); at++)
        if ((*at < ' ' && *at != '\t') || *at > '~') return NULL;
    return at;
}

/* The numbers of the line at `at`, values (columns), and how many there are; returns its end. */
static const uint8_t *read_line(const uint8_t *at, int64_t columns, double *values, Number *first,
                                int64_t *count) {
    Number number;
    for (*count = 0;; (*count)++) {
        while (is_blank(*at)) at++;
        if (*at == '#') return behind_comment(at);
        if (ends_line(at)) return at;
        if (*count == columns) return NULL;
        at = read_number(at, &number);
        if (!at || !(is_blank(*at) || *at == '#' || ends_line(at))) return NULL;
        values[*count] = number.value;
        if (*count == 0) *first = number;
    }
}

/* Reads text (size), whole lines behind so many `before`, whose rows are of so many `columns`, and
 * `most` at most.
 *
 * values (most, columns); lines (most): the number of each in the file, from 1; of the first column
 * digits (most) and decimals (most): it is digits 10^-decimals, where it is finite.
 *
 * Returns how many rows there are, or -1 where the text is not plain, rows are of other columns, or
 * a number of the first has more digits than 64 bits hold.
 */
int64_t rows(const uint8_t *text, int64_t size, int64_t before, int64_t columns, int64_t most,
             double *values, int64_t *lines, int64_t *digits, int64_t *decimals) {
    const uint8_t *at = text, *const end = text + size;
    int64_t row = 0, line = before;
    if (!size || end[-1] != '\n') return -1;
    while (at < end) {
        Number first = {0};
        int64_t count;
        if (row == most) return -1;
        at = read_line(at, columns, values + row * columns, &first, &count);
        if (!at) return -1;
        at += 1 + (*at == '\r');
        line++;
        if (!count) continue;
        if (count != columns || first.many || first.digits > INT64_MAX) return -1;
        lines[row] = line;
        digits[row] = first.negative ? -(int64_t)first.digits : (int64_t)first.digits;
        decimals[row] = first.decimals;
        row++;
    }
    return row;
}
