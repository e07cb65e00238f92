/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * What record.c tells other files of records.
 */
#ifndef TRAJEVAL_ROS_RECORD_H
#define TRAJEVAL_ROS_RECORD_H

#include "loops.h"

int record_values(const int64_t *begins, const int64_t *counts, int64_t records,
                  const double *times, const double *values, const double *variances,
                  int64_t coordinates, const int64_t *orders, int64_t kernels,
                  const int64_t *sets, const double *rates, const double *kernel_variances,
                  const double *noises,
                  double *work, double *found);

int record_news(const int64_t *begins, const int64_t *counts, int64_t records,
                const double *times, const double *values, const double *variances,
                int64_t coordinates, const int64_t *orders, int64_t kernels,
                const int64_t *sets, const double *rates, const double *kernel_variances,
                const double *noises,
                const double *information, int64_t first, double *work, double *found);

int record_slopes(const int64_t *begins, const int64_t *counts, int64_t records,
                  const double *times, const double *values, const double *variances,
                  int64_t coordinates, const int64_t *orders, int64_t kernels,
                  const int64_t *sets, const double *rates, const double *kernel_variances,
                  const double *noises,
                  int64_t many, double freedom, double *work, double *gradient,
                  double *information);

#endif
