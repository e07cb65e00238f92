# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a worker's allocator does with memory that is free: kept within a task, given back after."""

from __future__ import annotations

import contextlib
import ctypes
import os
from collections.abc import Iterator

# Of glibc's malloc.h.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
_KEPT, _LARGE = 256 << 20, 32 << 20  # the most that glibc takes for the latter
_DEFAULT = 128 << 10


@contextlib.contextmanager
def kept_memory() -> Iterator[None]:
    """Keep what is freed for the next array meanwhile, and give all back to the system at the end.

    Dask starts its workers with a threshold of 64 kB, by which the memory of every larger array
    goes back at once and each page of the next one is a fault: a quarter of a run's time. Without
    any bound, what is free lies scattered, 10 kB more with each run. With another libc than glibc
    nothing happens.
    """
    _set(_LARGE, _KEPT)
    try:
        yield
    finally:
        _set(*(_environment(name) for name in ("MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_")))
        with contextlib.suppress(OSError, AttributeError, TypeError):
            ctypes.CDLL(None).malloc_trim(0)


def _set(mmap: int, trim: int) -> None:
    with contextlib.suppress(OSError, AttributeError, TypeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_MMAP_THRESHOLD, mmap)
        mallopt(_TRIM_THRESHOLD, trim)


def _environment(name: str) -> int:
    """What the process was started with."""
    text = os.environ.get(name, "")
    return int(text) if text.isdecimal() else _DEFAULT
