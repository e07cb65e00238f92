# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Settings as Python writes them: the parameters' names with an underscore for each dot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from trajeval_ros.online.parameters import ONE, ParameterError, Value, complete, table


def parameters_of(settings: Mapping[str, object], names: Sequence[str] = ONE) -> dict[str, Value]:
    """Return every parameter's value; ``relative_delta`` or ``relative.delta`` is the same one.

    Raises :class:`~trajeval_ros.online.parameters.ParameterError`, a ValueError, for what is
    unknown, of the wrong type or out of range; and for one that is given twice.
    """
    known = {name.replace(".", "_"): name for name in table(names)}
    values: dict[str, object] = {}
    for given, value in settings.items():
        name = known.get(given.replace(".", "_"))
        if name is None:
            raise ParameterError(f"unknown setting {given}{_suggestion(given, known)}")
        if name in values:
            raise ParameterError(f"{name} is given twice")
        values[name] = value
    return complete(values, names)


def _suggestion(given: str, known: Mapping[str, str]) -> str:
    from difflib import get_close_matches

    close = get_close_matches(given, known, n=1)
    return f"; did you mean {close[0]}?" if close else ""
