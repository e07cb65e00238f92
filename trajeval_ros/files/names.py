# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Columns by their names: which of them are a stamp, a position and a quaternion."""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeVar

Value = TypeVar("Value", int, float)

POSITION = ("x", "y", "z")
QUATERNION = ("qx", "qy", "qz", "qw")

SECONDS_EXPONENT = 9
"""Of ten, from seconds to nanoseconds."""

_EXPONENTS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 9),
    **dict.fromkeys(("ms", "msec", "millisec", "milliseconds"), 6),
    **dict.fromkeys(("us", "usec", "microsec", "microseconds", "µs"), 3),
    **dict.fromkeys(("ns", "nsec", "nanosec", "nanoseconds"), 0),
}
_METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "km": 1e3}

# The better a name says that it is the pose's own stamp, the earlier it stands here.
_STAMPS = ("stamp", "timestamp", "timestamps", "time", "times", "t", "utime")
# Of the log, not of the pose.
_LOGGED = {"bag", "rosbag", "rosbagtimestamp", "receive", "received", "recv", "arrival", "log"}
_OF_QUATERNION = {"q", "quat", "quaternion", "orientation", "ori", "rotation", "rot", "attitude"}
_OF_OTHERS = {
    *("v", "vel", "velocity", "twist", "linear", "angular", "w", "omega", "gyro", "a", "acc"),
    *("accel", "acceleration", "b", "ba", "bg", "bias", "cov", "covariance", "std", "sigma", "var"),
}
_AXIS = re.compile(r"(q|quat|t|p|pos)?([xyzw])")
# PX4's q[0] to q[3], and q0 to q3: w first.
_NUMBERED = re.compile(r"q_?\[?([0-3])\]?")


class Columns(NamedTuple):
    """Where in a row things stand.

    Attributes:
        stamp: the column of the stamp, and that of its nanoseconds if it is in two.
        exponent: the stamp's unit as a power of ten in nanoseconds; None where it is not said.
        position: the columns of x, y and z.
        metres: of one unit of the positions.
        quaternion: the columns of x, y, z and w; empty where there are none.
    """

    stamp: tuple[int, ...]
    exponent: int | None
    position: tuple[int, ...]
    metres: float
    quaternion: tuple[int, ...]


def split_names(line: str) -> list[str]:
    """The names in a header, which commas separate, or blanks where there is no comma."""
    line = line.strip().lstrip("#%").strip()
    if "," in line:
        return [name.strip().strip("\"'") for name in line.rstrip(",").split(",")]
    # A unit belongs to the name before it.
    return [name.strip("\"'") for name in re.sub(r"\s+([\[(])", r"\1", line).split()]


def columns_of(names: Sequence[str]) -> Columns | None:
    """The columns that names say; None unless they name a stamp and a position, each once."""
    roles: dict[str, int] = {}
    stamps: list[tuple[int, int]] = []
    for column, name in enumerate(names):
        rank = _stamp_rank(name)
        if rank is not None:
            stamps.append((rank, column))
            continue
        role = _role(name)
        if role is None:
            continue
        if role in roles:
            return None
        roles[role] = column
    missing = {role for role in QUATERNION if role not in roles}
    if not set(POSITION) <= roles.keys() or len(missing) not in (0, len(QUATERNION)):
        return None
    stamp: tuple[int, ...]
    exponent: int | None
    if "sec" in roles and "nanosec" in roles:
        stamp, exponent = (roles["sec"], roles["nanosec"]), SECONDS_EXPONENT
    elif stamps and [rank for rank, _ in stamps].count(min(stamps)[0]) == 1:
        stamp, exponent = (min(stamps)[1],), _unit(names[min(stamps)[1]], _EXPONENTS)
    else:
        return None
    units = {_unit(names[roles[role]], _METRES) or 1.0 for role in POSITION}
    if len(units) > 1:
        return None
    return Columns(
        stamp,
        exponent,
        tuple(roles[role] for role in POSITION),
        units.pop(),
        () if missing else tuple(roles[role] for role in QUATERNION),
    )


def _unit(name: str, units: Mapping[str, Value]) -> Value | None:
    """The unit in brackets, or after an underscore."""
    bracketed = re.search(r"[\[(]\s*([a-zµ]+)\s*[\])]", name.lower())
    word = bracketed.group(1) if bracketed else name.lower().rpartition("_")[2]
    return units.get(word)


def _tokens(name: str) -> list[str]:
    """Words of a name: of ``field.pose.position.x``, ``posX`` or ``p_RS_R_x [m]``."""
    plain = re.sub(r"[\[(].*?[\])]", " ", name)
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", plain)
    return [word for word in re.split(r"[^a-z0-9µ]+", parted.lower()) if word]


def _stamp_rank(name: str) -> int | None:
    """How well a name says that it is the stamp, 0 the best; None if it does not."""
    tokens = _tokens(name)
    if tokens and tokens[-1] in _EXPONENTS and len(tokens) > 1 and tokens[-2] in _STAMPS:
        # header.stamp.secs is half a stamp, timestamp_ns a whole one.
        if tokens[-1] in ("sec", "secs", "nsec", "nsecs", "nanosec"):
            return None
        tokens = tokens[:-1]
    if not tokens or tokens[-1] not in _STAMPS:
        return None
    logged = name.lstrip("#").startswith("%") or bool(_LOGGED & set(tokens))
    return _STAMPS.index(tokens[-1]) + (len(_STAMPS) if logged else 0)


def _role(name: str) -> str | None:
    """``x``, ``qx``, ``sec`` ...; None for what is no part of a pose."""
    numbered = _NUMBERED.fullmatch(name.strip().lower())
    if numbered:
        return ("qw", "qx", "qy", "qz")[int(numbered.group(1))]
    tokens = _tokens(name)
    if not tokens:
        return None
    *before, last = tokens
    if last in ("sec", "secs"):
        return "sec"
    if last in ("nsec", "nsecs", "nanosec", "nanosecs"):
        return "nanosec"
    found = _AXIS.fullmatch(last)
    if found is None or _OF_OTHERS & set(before):
        return None
    prefix, axis = found.groups()
    words = {*before, prefix} if prefix else set(before)
    if words & _OF_QUATERNION or axis == "w":
        return f"q{axis}"
    return axis
