# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files: trajectories in the formats of the field, and the output folder."""
