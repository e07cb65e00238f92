# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Memory of our own processes: kept where it is said to be, and nobody else's touched."""

from __future__ import annotations

import gc
import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from trajeval_ros import memory

ROOT = Path(__file__).resolve().parents[1]
of_glibc = pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="of glibc's allocator")

FAULTS = """
import ctypes
import resource
import numpy as np
from trajeval_ros import memory

# Where the system makes all pages huge ones, a fault is one for 512 of them.
PR_SET_THP_DISABLE = 41
ctypes.CDLL(None).prctl(PR_SET_THP_DISABLE, 1, 0, 0, 0)

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(50):
        np.ones(1 << 18)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

"""


def said(code: str) -> list[int]:
    """The numbers that another process prints, with malloc as Dask starts its workers."""
    environment = {**os.environ, "MALLOC_TRIM_THRESHOLD_": "65536", "PYTHONPATH": str(ROOT)}
    found = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, check=True, text=True
    )
    return [int(each) for each in found.stdout.split()]


@of_glibc
def test_a_task_s_memory_is_not_faulted_in_array_by_array() -> None:
    """But for the first time that a page is used; and afterwards it is given back."""
    outside, inside, again = said(
        FAULTS
        + """
outside = faults()
with memory.kept():
    inside = faults()
print(outside, inside, faults())
"""
    )
    assert inside < 0.1 * outside
    assert again > 0.5 * outside


@of_glibc
def test_a_process_of_ours_keeps_what_is_freed() -> None:
    before, after = said(FAULTS + "before = faults()\nmemory.begin()\nprint(before, faults())")
    assert after < 0.1 * before


@of_glibc
def test_of_much_that_is_freed_the_system_gets_most_back() -> None:
    """So that the peak of a long run is what it needs, and no sum of what it has needed."""
    held = said(
        """
import resource
import numpy as np
from trajeval_ros import memory

def held():
    return int(open("/proc/self/statm").read().split()[1]) * resource.getpagesize()

memory.begin()
before = held()
parts = [np.ones(1 << 17) for _ in range(300)]
between = held()
del parts
print(before, between, held())
"""
    )
    before, between, after = held
    assert between - before > 300e6
    assert after - before < 0.3 * (between - before)


@of_glibc
def test_what_is_free_between_is_given_back_where_it_is_ours() -> None:
    """What is at the end is still there, so that malloc has only holes to give back."""
    untouched, as_it_was, before, after = said(
        """
import resource
import numpy as np
from trajeval_ros import memory

def held():
    return int(open("/proc/self/statm").read().split()[1]) * resource.getpagesize()

memory._keep(32 << 20, 64 << 20)
parts = [np.ones(1 << 15) for _ in range(200)]
last = np.ones(1 << 15)
del parts
between = held()
memory.give_back()
print(between, held())
memory.begin()
memory.give_back()
print(between, held())
"""
    )
    assert as_it_was > 0.9 * untouched
    assert after < before - 30e6


def test_what_is_loaded_is_no_longer_searched() -> None:
    code = "import gc\nfrom trajeval_ros import memory\nmemory.begin()\nmemory.loaded()\n"
    enabled, frozen = said(code + "print(int(gc.isenabled()), gc.get_freeze_count())")
    assert enabled
    assert frozen > 1000


def test_a_process_of_somebody_else_s_is_left_as_it_is() -> None:
    before = gc.get_freeze_count(), gc.get_threshold()
    memory.loaded()
    assert (gc.get_freeze_count(), gc.get_threshold()) == before
