# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What ``import trajeval_ros as te`` offers: read, evaluate, compare, look; without ROS."""
