# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Serialised messages of what there is of each pose, many at a time.

To make a message of Python objects and to serialise it takes rclpy 10 to 30 µs; a batch of them has
one layout, which NumPy fills in one go, and publishers take the bytes as they are. See `decode` for
the layout.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

_SECOND = 1_000_000_000
_LITTLE_ENDIAN = b"\x00\x01\x00\x00"


def stamped(stamps: Stamps, frame: str, values: Array) -> list[bytes]:
    """Messages that are a std_msgs/Header and doubles: Vector3Stamped, PoseWithCovarianceStamped.

    stamps: (n,), ns. values: (n, k), in the order of the message's fields.
    """
    name = frame.encode() + b"\0"
    rows = np.zeros(len(stamps), dtype=_layout(len(name), values.shape[1]))
    rows["order"], rows["length"], rows["name"] = _LITTLE_ENDIAN, len(name), name
    rows["sec"], rows["nanosec"] = np.divmod(stamps, _SECOND)
    rows["values"] = values
    return _cut(rows)


@lru_cache(maxsize=16)
def _layout(length: int, count: int) -> np.dtype[np.void]:
    """With a name of ``length`` bytes and ``count`` doubles."""
    begin = len(_LITTLE_ENDIAN) + 12
    # Doubles are aligned to their size, from behind the four bytes of the encapsulation.
    first = begin + length + (len(_LITTLE_ENDIAN) - begin - length) % 8
    return np.dtype(
        {
            "names": ["order", "sec", "nanosec", "length", "name", "values"],
            "formats": ["S4", "<i4", "<u4", "<u4", f"S{length}", ("<f8", (count,))],
            "offsets": [0, 4, 8, 12, begin, first],
            "itemsize": first + 8 * count,
        }
    )


def numbers(values: Array) -> list[bytes]:
    """Messages that are a double: Float64. values: (n,)."""
    rows = np.zeros(len(values), dtype=np.dtype([("order", "S4"), ("value", "<f8")]))
    rows["order"], rows["value"] = _LITTLE_ENDIAN, values
    return _cut(rows)


def _cut(rows: npt.NDArray[np.void]) -> list[bytes]:
    """The bytes of each row."""
    size, data = rows.dtype.itemsize, rows.tobytes()
    return [data[begin : begin + size] for begin in range(0, len(data), size)]
