# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run: the engine, its records and the folder that they go to; live, or of whole trajectories."""
