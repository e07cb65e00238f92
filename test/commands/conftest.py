# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the tests of the commands share."""

from pathlib import Path

import pytest

from trajeval_ros.commands.simulate import write_files


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A simulated run of 20 s: its ground truth and its estimate."""
    return write_files(tmp_path_factory.mktemp("run"), 20.0, 3)
