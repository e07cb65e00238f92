# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Random damage to every input, and a day at speed: ``make fuzz``, ``make soak``."""

from trajeval_ros import blas

# Small matrices. Before anything imports NumPy.
blas.use_one_thread()
