# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How far an estimate is from the ground truth: likelihoods, alignments and conventional errors."""
