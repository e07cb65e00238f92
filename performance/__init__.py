# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the package is measured by; ``make bench`` runs all of it."""
