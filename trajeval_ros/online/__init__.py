# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The online engine: poses in, evaluations, figures and notices out; no ROS, no clock."""
