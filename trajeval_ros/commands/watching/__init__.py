# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page of ``watch``: what the node publishes, kept in bounded memory and served to browsers."""
