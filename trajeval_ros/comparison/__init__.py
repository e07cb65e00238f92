# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which of two estimates is better: paired, on what both cover, and whether it can be told."""
