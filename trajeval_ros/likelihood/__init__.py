# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Likelihoods of an estimate's poses given the ground truth's, and the figures they make."""
