# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The estimator's error model: how good an estimate is, and what is not its fault."""
