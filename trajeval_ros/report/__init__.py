# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report: one self-contained page that shows a run."""

from trajeval_ros.report.report import Report, render_several

__all__ = ["Report", "render_several"]
