/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Of `se3.c` what other files call.
 */
#ifndef TRAJEVAL_ROS_SE3_H
#define TRAJEVAL_ROS_SE3_H

#include <stdint.h>

int so3_exp(const double *phi, double *rotations, int64_t count, const double *table,
            int64_t terms);
int so3_right_jacobian(const double *phi, double *jacobians, int64_t count, const double *table,
                       int64_t terms);
int so3_log(const double *rotations, double *phi, int64_t count);
int se3_inverse(const double *poses, double *inverses, int64_t count);
void se3_compose(const double *a, const double *b, double *c);
int se3_adjoint(const double *poses, double *adjoints, int64_t count);
int se3_exp(const double *xi, double *poses, int64_t count, const double *table, int64_t terms);
int se3_log(const double *poses, double *xi, int64_t count, const double *table, int64_t terms);
int se3_left_jacobian_inverse(const double *xi, double *jacobians, int64_t count,
                              const double *table, int64_t terms);

#endif
