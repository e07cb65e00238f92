/* Copyright 2026 The trajeval_ros authors
 * SPDX-License-Identifier: Apache-2.0
 */
#include "loops.h"

/* The checksum of all files here that this library was built from. */
uint32_t loops_sources(void) { return LOOPS_SOURCES; }
