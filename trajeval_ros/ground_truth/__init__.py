# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ground truth as overlapping Gaussian-process segments on SE(3)."""
