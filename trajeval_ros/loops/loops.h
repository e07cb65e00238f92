/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * What every file here knows. Arrays are in C's order; their shapes stand beside their names.
 */
#ifndef TRAJEVAL_ROS_LOOPS_H
#define TRAJEVAL_ROS_LOOPS_H

#include <math.h>
#include <stdint.h>

/* Before a function that is compiled for AVX2 too, and before those that are compiled into it.
 * Nothing is fused or summed in another order: the digits are the same. */
#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__)
#define LOOPS_WIDE __attribute__((target_clones("avx2", "default")))
#define LOOPS_PART static inline __attribute__((always_inline))
#else
#define LOOPS_WIDE
#define LOOPS_PART static inline
#endif

/* Four numbers, wherever they lie. */
typedef double Lanes __attribute__((vector_size(4 * sizeof(double)), aligned(sizeof(double)),
                                    may_alias));

#endif
