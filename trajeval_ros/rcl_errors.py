# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What ROS says when something is wrong, in one line."""

from __future__ import annotations

import re


def first_line(error: Exception) -> str:
    """The message without the places in rcl's source that it ends with."""
    lines = re.sub(r", at [^ ,]+:\d+", "", str(error)).strip().splitlines()
    return lines[0] if lines else type(error).__name__
