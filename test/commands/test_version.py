# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every command says which version it is."""

import subprocess
import sys

import pytest

from trajeval_ros import __version__
from trajeval_ros.__main__ import COMMANDS


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_says_its_version(name: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "trajeval_ros", name, "--version"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == f"{name} {__version__}\n"
