# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The commands: ``evaluate``, ``replay``, ``simulate`` and ``demo``."""

from trajeval_ros import blas

blas.use_one_thread()
