# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An estimate's world in the ground truth's: closed forms, gauges, what the motion determines."""
