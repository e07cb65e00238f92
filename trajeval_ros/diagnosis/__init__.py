# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is likely wrong with the data, with the evidence: a file a family of causes."""
