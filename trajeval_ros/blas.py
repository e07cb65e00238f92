# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One thread for the linear algebra.

The matrices here have tens to hundreds of rows: more threads only wait for each other, and on a
busy machine they make the whole several times slower. BLAS reads these variables when NumPy is
first imported, so the executables' packages call `use_one_thread` first of all. Who sets them keeps
them. In a process of somebody else's, a notebook, NumPy has long been imported, and its threads are
not ours to take away: there they are held `one_thread` for as long as something is evaluated.
"""

import contextlib
import ctypes
import os
from collections.abc import Callable, Iterator
from pathlib import Path

_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
# OpenBLAS as distributions name its functions, and as the wheels of NumPy and SciPy do.
_NAMES = tuple(
    (f"{prefix}openblas_get_num_threads{suffix}", f"{prefix}openblas_set_num_threads{suffix}")
    for prefix in ("", "scipy_")
    for suffix in ("", "64_")
)
_MAPS = Path("/proc/self/maps")


def use_one_thread() -> None:
    """Ask BLAS for one thread, where the environment says nothing else."""
    for name in _VARIABLES:
        os.environ.setdefault(name, "1")


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Let every OpenBLAS of this process have one thread, and then as many as before.

    Where there is none, or none can be found (not on Linux), nothing happens.
    """
    before = [(put, get()) for get, put in _pools()]
    for put, _ in before:
        put(1)
    try:
        yield
    finally:
        for put, count in before:
            put(count)


def _pools() -> list[tuple[Callable[[], int], Callable[[int], object]]]:
    """How to get and to set the number of threads of each OpenBLAS that is loaded."""
    try:
        lines = _MAPS.read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    except OSError:
        return []
    files = {line.split(maxsplit=5)[-1] for line in lines if "blas" in line}
    found: list[tuple[Callable[[], int], Callable[[int], object]]] = []
    for file in sorted(file for file in files if Path(file).is_file()):
        try:
            library = ctypes.CDLL(file)
        except OSError:
            continue
        for get, put in _NAMES:
            if hasattr(library, get) and hasattr(library, put):
                found.append((getattr(library, get), getattr(library, put)))
                break
    return found
