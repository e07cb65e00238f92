# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the processes of this package use memory: Python's search for garbage, and glibc's malloc.

A process of somebody else's, a notebook, is left as it is. With another libc than glibc nothing
happens to malloc.
"""

import contextlib
import ctypes
import gc
import os
from collections.abc import Iterator

_OBJECTS = 100_000  # 700 by Python's own rule
# Of glibc's malloc.h.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
_LARGE = 32 << 20  # the most that glibc takes for an array whose memory goes back at once
_DEFAULT = 128 << 10


def begin() -> None:
    """Begin a process of ours: it is seldom searched for garbage, of which it makes hardly any.

    From now on up to 64 MB of what is freed are kept for the next arrays. By glibc's own rule
    the memory of a large array goes back at once, and each page of the next one is a fault: a
    thirtieth of a short run.
    """
    gc.set_threshold(_OBJECTS)
    _keep(_LARGE, 64 << 20)


def loaded() -> None:
    """What a process of ours has loaded by now stays to the end: it is no longer searched.

    To look in it for garbage, and once more when the process ends, takes a twentieth of a short
    run, and holds up a node for some 40 ms.
    """
    if gc.get_threshold()[0] == _OBJECTS:
        gc.freeze()


def give_back() -> None:
    """What a process of ours has free goes back to the system: after what took much, and is rare.

    A node that has written its results keeps what these took, some MB, for the next ones: in holes
    that grow with the largest of them. Some milliseconds.
    """
    if gc.get_threshold()[0] == _OBJECTS:
        _trim()


@contextlib.contextmanager
def kept() -> Iterator[None]:
    """Keep what is freed for the next array meanwhile, and give all back to the system at the end.

    For a task of a worker. Dask starts its workers with a threshold of 64 kB, and a quarter of a
    run's time goes to faults. Without any bound, what is free lies scattered, 10 kB more with each
    run.
    """
    _keep(_LARGE, 256 << 20)
    try:
        yield
    finally:
        _keep(_environment("MALLOC_MMAP_THRESHOLD_"), _environment("MALLOC_TRIM_THRESHOLD_"))
        _trim()


def _trim() -> None:
    with contextlib.suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def _keep(mmap: int, trim: int) -> None:
    """Set from which size on an array is mapped by itself, and how much that is free is kept."""
    with contextlib.suppress(OSError, AttributeError, TypeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_MMAP_THRESHOLD, mmap)
        mallopt(_TRIM_THRESHOLD, trim)


def _environment(name: str) -> int:
    """What the process was started with."""
    text = os.environ.get(name, "")
    return int(text) if text.isdecimal() else _DEFAULT
