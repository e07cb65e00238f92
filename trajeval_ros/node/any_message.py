# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An input of any installed message type: ``package/msg/Type`` and the field that is the pose."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import groupby
from typing import Any

import numpy as np
from rclpy.node import Node

from trajeval_ros.node.decode import Decoded, deserialized
from trajeval_ros.node.inputs import Input
from trajeval_ros.online.samples import PoseSamples

_STEP = re.compile(r"([A-Za-z]\w*)(?:\[([^\]]*)\])?(?:\.|$)")
_ELEMENT = re.compile(r"(?:sequence<)?([^<>,\[\]]+)(?:, \d+>|>|\[\d+\])")
_POSES = (("position", "orientation"), ("translation", "rotation"))
# As PX4 has it: arrays, the quaternion as w x y z.
_ARRAYS = ("position", "q")
# What an integer counts, ns, by the end of its name; otherwise, as PX4's, microseconds.
_UNITS = {"_ns": 1, "_nsec": 1, "_ms": 1_000_000}
_MICROSECOND = 1_000
_LATEST = 2**63 - 1
_XYZ = {"x", "y", "z"}


class FieldError(ValueError):
    """A type or a field that cannot be used; the message is one line."""


@dataclass(frozen=True, slots=True)
class _Step:
    """One field on the way, and which of its elements where it is a list."""

    name: str
    chosen: str | None

    def of(self, message: Any) -> Any:
        """Return the field's value; raises FieldError where the list has no such element."""
        value = getattr(message, self.name)
        if self.chosen is None:
            return value
        key, equals, wanted = self.chosen.partition("=")
        if not equals:
            try:
                return value[int(key)]
            except IndexError:
                raise FieldError(f"{self.name} has {len(value)} elements, no [{key}]") from None
        for element in value:
            if str(getattr(element, key)) == wanted:
                return element
        there = ", ".join(str(getattr(element, key)) for element in value) or "none"
        raise FieldError(f"{self.name} has no {key}={wanted}; there are: {there}")


class AnyInput(Input):
    """The poses in one field of each message.

    Messages are read one at a time by the type's own definition. One that lacks the chosen element
    (a rigid body out of sight) is counted as undecodable.
    """

    def __init__(
        self, node: Node, name: str, type_name: str, fields: tuple[str, str], reliability: str
    ) -> None:
        """Make the input ``name``; ``fields``: of the pose and of the stamp."""
        self._refused: str | None = None
        self._missing: str | None = None
        self._known: Mapping[str, str] = {}
        try:
            self._class = import_type(type_name)
            self._pose, (self._at, self._turned) = pose_path(self._class, type_name, fields[0])
            self._stamp = stamp_path(self._class, type_name, fields[1])
            self._known = {type_name: type_name}
        except FieldError as error:
            self._refused = str(error)
            node.get_logger().error(f"{name}: {error}")
        super().__init__(node, name, "auto", reliability)

    def discover(self) -> None:
        """As every input; nothing is to be heard of a type that cannot be used."""
        if self._refused is None:
            super().discover()

    @property
    def _problem(self) -> str | None:
        problem = self._refused or self._missing
        return problem and f"{self._topic}: {problem}"

    def _message(self, type_name: str) -> Any:
        return self._class

    def _decode(self, type_name: str, messages: Sequence[bytes]) -> Decoded:
        stamps: list[int] = []
        rows: list[tuple[float, ...]] = []
        frames: list[str] = []
        child_frame = ""
        missing: str | None = None
        undecodable = 0
        for raw in messages:
            message = deserialized(raw, self._class)
            if message is None:
                undecodable += 1
                continue
            try:
                pose, stamp = _follow(self._pose, message), _follow(self._stamp, message)
            except FieldError as error:
                missing = str(error)
                undecodable += 1
                continue
            stamps.append(_nanoseconds(stamp, self._stamp[-1].name))
            rows.append(_numbers(getattr(pose, self._at), getattr(pose, self._turned)))
            frames.append(str(getattr(getattr(message, "header", None), "frame_id", "")))
            child_frame = str(getattr(message, "child_frame_id", ""))
        self._missing = None if stamps else missing
        values = np.array(rows, dtype=np.float64).reshape(-1, 7)
        return Decoded(
            PoseSamples(np.array(stamps, dtype=np.int64), values[:, :3], values[:, 3:], None),
            tuple(frame for frame, _ in groupby(frames)),
            child_frame,
            undecodable,
        )


def import_type(type_name: str) -> Any:
    """Return the class of ``package/msg/Type``; raises FieldError where it is not installed."""
    package, _, name = type_name.split("/")
    try:
        module = import_module(f"{package}.msg")
    except ImportError:
        apt = package.replace("_", "-")
        raise FieldError(
            f"{type_name}: the package {package} is not installed or not sourced"
            f" (apt install ros-jazzy-{apt}, where it is released)"
        ) from None
    found = getattr(module, name, None)
    if found is None or not hasattr(found, "get_fields_and_field_types"):
        raise FieldError(f"the package {package} has no message {name}")
    return found


def pose_path(kind: Any, type_name: str, field: str) -> tuple[tuple[_Step, ...], tuple[str, str]]:
    """Return the way to the pose, and what its position and orientation are called there."""
    path, found = _resolve(kind, type_name, field)
    fields = _fields_of(found)
    for at, turned in _POSES:
        if at in fields and turned in fields:
            return path, (at, turned)
    if [_length(fields.get(name, "")) for name in _ARRAYS] == [3, 4]:
        return path, _ARRAYS
    if set(fields) == _XYZ:
        raise FieldError(
            f"field {field} of {type_name} is a position only, which cannot be evaluated live:"
            " name the field of a pose"
        )
    has = f"has {', '.join(fields)}" if fields else f"is of type {found}"
    raise FieldError(f"field {field} of {type_name} is no pose: it {has}")


def stamp_path(kind: Any, type_name: str, field: str) -> tuple[_Step, ...]:
    """Return the way to the stamp."""
    path, found = _resolve(kind, type_name, field)
    if path and set(_fields_of(found)) != {"sec", "nanosec"} and "int" not in found:
        raise FieldError(
            f"stamp_field {field} of {type_name} is no ROS time, it is of type {found}"
        )
    return path


def _length(found: str) -> int:
    """How many numbers an array of a fixed length has, such as ``float[3]``; 0 for what is none."""
    match = re.fullmatch(r"(?:float|double)\[(\d+)\]", found)
    return int(match[1]) if match else 0


def _nanoseconds(stamp: Any, name: str) -> int:
    if isinstance(stamp, int):
        ends = (unit for end, unit in _UNITS.items() if name.endswith(end))
        return min(stamp * next(ends, _MICROSECOND), _LATEST)
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _numbers(at: Any, turned: Any) -> tuple[float, ...]:
    if hasattr(at, "x"):
        return (at.x, at.y, at.z, turned.x, turned.y, turned.z, turned.w)
    w, *xyz = map(float, turned)
    return (*map(float, at), *xyz, w)


def _follow(path: Sequence[_Step], message: Any) -> Any:
    for step in path:
        message = step.of(message)
    return message


def _resolve(kind: Any, type_name: str, field: str) -> tuple[tuple[_Step, ...], str]:
    """Return the steps of a field, and the type it is of; raises FieldError."""
    path: list[_Step] = []
    if field == ".":
        return (), type_name
    fields, where, found, position = kind.get_fields_and_field_types(), type_name, type_name, 0
    while position < len(field):
        match = _STEP.match(field, position)
        if match is None:
            raise FieldError(f"{field!r} is no field: expected as in poses[name=drone].pose")
        position, step = match.end(), _Step(match[1], match[2])
        if step.name not in fields:
            there = f"; there are {', '.join(fields)}" if fields else ""
            hint = ", a position only" if {"latitude", "longitude"} <= set(fields) else ""
            raise FieldError(f"{where}{hint} has no field {step.name}{there}")
        found = fields[step.name]
        element = _ELEMENT.fullmatch(found)
        if (element is None) != (step.chosen is None):
            needs = "is a list: choose as in [0] or [name=drone]" if element else "is no list"
            raise FieldError(f"field {step.name} of {where} {needs}")
        if element is not None:
            found = element[1]
        fields, where = _fields_of(found), found
        _check_chosen(step, fields, found)
        path.append(step)
    return tuple(path), found


def _check_chosen(step: _Step, fields: Mapping[str, str], found: str) -> None:
    if step.chosen is None or re.fullmatch(r"-?\d+", step.chosen):
        return
    key, equals, _ = step.chosen.partition("=")
    if not equals or key not in fields:
        there = ", ".join(fields) or "none"
        raise FieldError(
            f"{step.name}[{step.chosen}]: {key!r} is neither an index nor a field of {found};"
            f" there are {there}"
        )


def _fields_of(found: str) -> Mapping[str, str]:
    """The fields of a type as a definition names it (``package/Type``); none of a plain value."""
    package, slash, name = found.partition("/")
    if not slash:
        return {}
    fields: Mapping[str, str] = import_type(
        f"{package}/msg/{name.rpartition('/')[2]}"
    ).get_fields_and_field_types()
    return fields
