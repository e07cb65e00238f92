# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node ``evaluator``: the engine between ROS topics."""

from trajeval_ros import blas

blas.use_one_thread()
