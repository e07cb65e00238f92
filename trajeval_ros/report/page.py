# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page."""

from __future__ import annotations

import html
import json

from trajeval_ros.report.run import Run


def page(run: Run) -> str:
    """Return ``report.html``."""
    text = html.escape(json.dumps(run.summary, indent=2))
    return f"<!doctype html><meta charset=utf-8><title>trajeval_ros</title><pre>{text}</pre>"
