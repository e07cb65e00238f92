# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recursions as loops in C, used where a C compiler was there when the package was built.

Each stands beside the NumPy code that it replaces, which is what runs without a compiler and what
the tests hold it to, to 1e-9. A loop sums in one order, whatever the processor and wherever an
array lies, so that its digits are those of every batch and of every machine.

The library knows neither Python nor NumPy: a file ``*.c`` here has plain functions of pointers,
64-bit integers and doubles, which return 0, or a number that their caller gives a meaning to.
While one runs, other threads do.
"""

from __future__ import annotations

import ctypes
import os
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import numpy as np
import numpy.typing as npt

# In the environment 0 leaves all to NumPy, and a path is that of another library (`make sanitize`).
SWITCH = "TRAJEVAL_ROS_LOOPS"
_KINDS = tuple(np.dtype(kind) for kind in (np.float64, np.int64, np.uint64, np.uint8, np.bool_))

Argument = np.ndarray | int | float
_byref, _from_buffer = ctypes.byref, ctypes.c_char.from_buffer
_addressof = ctypes.addressof


def _loaded() -> ctypes.CDLL | None:
    """The library, if it was built, from these sources, and is wanted.

    Raises OSError or AttributeError where one is named that cannot be had.
    """
    wanted = os.environ.get(SWITCH)
    if wanted == "0":
        return None
    folder = Path(__file__).parent
    built = (folder / f"_loops{suffix}" for suffix in EXTENSION_SUFFIXES)
    path = Path(wanted) if wanted else next((each for each in built if each.exists()), None)
    if path is None:
        return None
    try:
        library = ctypes.CDLL(str(path))
        library.loops_sources.restype = ctypes.c_uint32
    except (OSError, AttributeError):
        if wanted:
            raise
        return None  # of another machine, or of before
    if sources() in (None, library.loops_sources()):
        return library
    if wanted:
        raise OSError(f"{path} was built from other sources")
    return None


def sources() -> int | None:
    """The checksum of the sources, where they are; a library of others is none."""
    found = sorted(Path(__file__).parent.glob("*.[ch]"))
    checksum = 0
    for path in found:
        checksum = zlib.crc32(path.read_bytes(), checksum)
    return checksum if found else None


_library = _loaded()


def there() -> bool:
    """Whether the loops can be called."""
    return _library is not None


@contextmanager
def left_out() -> Iterator[None]:
    """Let NumPy do all; for tests and benchmarks."""
    global _library
    kept, _library = _library, None
    try:
        yield
    finally:
        _library = kept


def doubles(values: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """As a loop reads them: float64 in C's order; whole numbers' bits would be taken for them."""
    return np.ascontiguousarray(values, dtype=np.float64)


def call(name: str, *arguments: Argument) -> int:
    """Call a function of the library with arrays, integers and floats, and return what it returns.

    Arrays are of the kinds above, in C's order, and those that it writes to are given whole: what
    it is given is read and written in place.
    """
    assert _library is not None, "the loops were not built"
    # A list has its length beforehand. Of what has none Python makes a tuple that it shortens, and
    # keeps 2,000 of each length that there are: 4 MB in some hours.
    return int(getattr(_library, name)(*[*map(_passed, arguments)]))


def address(values: np.ndarray) -> int:
    """Where an array lies, as a loop may take it that reads many; who asks keeps the array."""
    if values.dtype in _KINDS and values.flags.c_contiguous:
        try:
            return _addressof(_from_buffer(values))  # type: ignore[arg-type]
        except (TypeError, ValueError):  # as below
            return int(values.ctypes.data)
    raise _no_array(values)


def strided(values: np.ndarray) -> tuple[int, ...]:
    """Where an array of float64 begins, as `address`, and how many numbers each axis goes on by."""
    if values.dtype != np.float64:
        raise _no_array(values)
    return int(values.ctypes.data), *(stride // values.itemsize for stride in values.strides)


def _no_array(values: np.ndarray) -> TypeError:
    message = f"an array of {values.dtype} with strides {values.strides} is none for C"
    return TypeError(message)


def _passed(argument: Argument) -> object:
    """As C takes it."""
    if isinstance(argument, np.ndarray):
        if argument.dtype in _KINDS:
            try:  # a third of what the other way costs, and that is most of a short call
                return _byref(_from_buffer(argument))  # type: ignore[arg-type]
            except (TypeError, ValueError):  # read-only, empty, or not in C's order
                if argument.flags.c_contiguous:
                    return ctypes.c_void_p(argument.ctypes.data)
        raise _no_array(argument)
    if isinstance(argument, float):
        return ctypes.c_double(argument)
    return ctypes.c_int64(argument)
