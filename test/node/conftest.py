# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests with real processes; without rclpy they are skipped."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

try:
    import rclpy
except ImportError:
    collect_ignore_glob = ["test_*.py"]
else:
    del rclpy

_NUMBER = itertools.count()


def domain() -> int:
    """A ROS domain of this test's own; beyond 101 the ports meet Linux's ephemeral ones."""
    return 1 + (os.getpid() * 13 + next(_NUMBER)) % 100


@pytest.fixture
def graph(tmp_path: Path) -> Iterator[object]:
    from harness import Graph

    made = Graph(domain(), tmp_path)
    yield made
    made.close()
