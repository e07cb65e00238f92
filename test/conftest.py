# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the whole suite."""

import os
import signal
from collections.abc import Iterator

import pytest
from hypothesis import settings

from trajeval_ros import blas
from trajeval_ros.commands.domain import own_domain

blas.use_one_thread()  # before any test imports NumPy

# The same inputs in every run, and no time limit on one example: the machine may be busy.
settings.register_profile("repeatable", derandomize=True, deadline=None, print_blob=True)
# HYPOTHESIS_PROFILE=search looks for new counterexamples, many more of them.
settings.register_profile("search", max_examples=2000, deadline=None, print_blob=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))

# What a shell starts in the background ignores SIGINT, and so would every process of a test.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def domain() -> Iterator[int]:
    """A ROS domain of this test's own."""
    with own_domain() as number:
        yield number
