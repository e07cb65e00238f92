# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests with real processes; without rclpy they are skipped."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

try:
    import rclpy
except ImportError:
    collect_ignore_glob = ["test_*.py"]
else:
    del rclpy


@pytest.fixture
def graph(domain: int, tmp_path: Path) -> Iterator[object]:
    from harness import Graph

    made = Graph(domain, tmp_path)
    yield made
    made.close()
