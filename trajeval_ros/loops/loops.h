/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * What every file here knows. Arrays are in C's order; their shapes stand beside their names.
 */
#ifndef TRAJEVAL_ROS_LOOPS_H
#define TRAJEVAL_ROS_LOOPS_H

#include <math.h>
#include <stdint.h>

/* That of the functions' arguments, which `__init__.py` has too. */
#define LOOPS_VERSION 1

#endif
