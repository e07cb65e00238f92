# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``--require``: what the figures must be, as a condition on ``summary.json``."""

from __future__ import annotations

import argparse
import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from trajeval_ros.commands.console import UsageError
from trajeval_ros.commands.summary_paths import is_of_one, why_unknown

Figures = Mapping[str, Any]
Scalar = float | int | str | bool | None

_OPERATORS: dict[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
_CONDITION = re.compile(r"\s*([A-Za-z_]\w*(?:\.\w+)*)\s*(<=|>=|==|!=|<|>)\s*(\S+)\s*")
_WORDS: dict[str, Scalar] = {"true": True, "false": False, "null": None}


@dataclass(frozen=True)
class Requirement:
    """``path comparison value``, such as ``conventional.ate_translation_rmse < 0.05``; SI units."""

    path: tuple[str, ...]
    comparison: str
    value: Scalar
    text: str

    @classmethod
    def of(cls, text: str) -> Requirement:
        """Parse a condition; the type of an option for argparse."""
        match = _CONDITION.fullmatch(text)
        if match is None:
            raise argparse.ArgumentTypeError(
                f"{text!r} is not a figure, one of {' '.join(_OPERATORS)}, and a value, as in"
                " 'conventional.ate_translation_rmse < 0.05'"
            )
        path, comparison, word = match.groups()
        value = _value(word)
        if comparison not in ("==", "!=") and (not _is_number(value) or value != value):
            raise argparse.ArgumentTypeError(f"{text!r}: {word!r} is not a number")
        return cls(tuple(path.split(".")), comparison, value, f"{path} {comparison} {word}")

    def holds(self, found: Scalar) -> bool:
        """Whether it holds of a value; no order holds of one that is absent."""
        if self.comparison in ("==", "!="):
            return _OPERATORS[self.comparison](found, self.value)
        return _is_number(found) and _OPERATORS[self.comparison](found, self.value)


@dataclass(frozen=True)
class Verdict:
    """What became of a requirement: whether it ``holds``, and a line with the value."""

    holds: bool
    line: str


def check(requirements: Sequence[Requirement], names: Sequence[str]) -> None:
    """Refuse what no summary of these estimates can have, before anything is computed.

    Raises
    ------
    UsageError
        It names the figures that are near.
    """
    for requirement in requirements:
        why = why_unknown(requirement.path, names, group=requirement.value is None)
        if why is not None:
            raise UsageError(f"--require: {why}")


def judge(
    requirements: Sequence[Requirement], summary: Figures, names: Sequence[str]
) -> list[Verdict]:
    """Hold the requirements to a summary, in this order.

    With several estimates, ``names``, a path that begins with one's name, ``ground_truth`` or
    ``comparison`` is of that one; any other is required of each estimate.
    """
    return [
        Verdict(
            requirement.holds(value),
            f"{who}{requirement.text}: it is {'absent' if value is None else value}",
        )
        for requirement in requirements
        for who, value in _values(requirement, summary, names)
    ]


def _values(
    requirement: Requirement, summary: Figures, names: Sequence[str]
) -> Iterator[tuple[str, Scalar]]:
    """Whose it is, for the line, and the value."""
    path = requirement.path
    if len(names) == 1:
        yield "", _look_up(summary, path)
        return
    estimates = summary["estimates"]
    if is_of_one(path, names):
        yield "", _look_up(estimates[path[0]], path[1:])
    elif path[0] in summary:
        yield "", _look_up(summary, path)
    else:
        for name in names:
            yield f"{name}: ", _look_up(estimates[name], path)


def _look_up(figures: Any, path: tuple[str, ...]) -> Scalar:
    """The value; None where it is absent, and a word for a group of figures that is there."""
    value = figures
    for place, key in enumerate(path):
        if isinstance(value, list) and key.isdecimal() and int(key) < len(value):
            value = value[int(key)]
        elif isinstance(value, Mapping) and key in value:
            value = value[key]
        elif key == "cut" or path[place - 1 : place] == ("rejected",):
            # Where nothing was cut, or no pose rejected for a reason, it is not listed.
            return 0
        else:
            return None
    found: Scalar = "there" if isinstance(value, Mapping | list) else value
    return found


def _value(word: str) -> Scalar:
    if word in _WORDS:
        return _WORDS[word]
    for kind in (int, float):
        try:
            return kind(word)
        except ValueError:
            continue
    return word.strip("'\"")


def _is_number(value: Scalar) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
