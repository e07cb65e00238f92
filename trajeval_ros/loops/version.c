/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 */
#include "loops.h"

int loops_version(void) { return LOOPS_VERSION; }
