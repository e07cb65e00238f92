# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ROS parameters from the engine's table: declared, described, ranged, refused with a reason."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    ParameterType,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from trajeval_ros.online.parameters import (
    Parameter,
    ParameterError,
    Value,
    complete,
    is_of_ros,
    names_in,
    table,
)

_LARGEST_INTEGER = 2**63 - 1
_TYPES = {
    bool: ParameterType.PARAMETER_BOOL,
    int: ParameterType.PARAMETER_INTEGER,
    float: ParameterType.PARAMETER_DOUBLE,
    str: ParameterType.PARAMETER_STRING,
}

Change = Callable[[Mapping[str, object]], None]
"""Validates changed parameters and puts them into effect, all or, with a ParameterError, none."""


def declare(node: Node) -> dict[str, Value]:
    """Declare every parameter on ``node`` and return the values.

    ``node`` must have been made with ``automatically_declare_parameters_from_overrides``: so every
    override is known here, also one that no parameter answers to, and an integer where a floating
    point number is expected (``ground_truth.max_gap: 20``) can be taken as what is meant.

    Raises
    ------
    ParameterError
        For an override that is unknown, of the wrong type or out of range.
    """
    given = node.get_parameters(node.list_parameters([], 0).names)
    overrides = {parameter.name: parameter.value for parameter in given}
    sim_time = overrides.get("use_sim_time")
    if not isinstance(sim_time, bool):
        raise ParameterError(f"use_sim_time must be a bool, got {sim_time!r}")
    ours = {name: value for name, value in overrides.items() if not is_of_ros(name)}
    names = names_in(ours)
    values = complete(ours, names)
    for name in ours:
        node.undeclare_parameter(name)
    for name, parameter in table(names).items():
        node.declare_parameter(
            name, ros_value(values[name]), describe(parameter), ignore_override=True
        )
    return values


def watch(node: Node, known: Mapping[str, Parameter], change: Change) -> None:
    """Let ``change`` answer every attempt to change one of the ``known`` parameters at run time."""

    def convert(parameters: list[RosParameter]) -> list[RosParameter]:
        return [_as_declared(parameter, known.get(parameter.name)) for parameter in parameters]

    def answer(parameters: Iterable[RosParameter]) -> SetParametersResult:
        given = {parameter.name: parameter.value for parameter in parameters}
        try:
            # rclpy refuses it only after us, when ours would be in effect.
            if not isinstance(given.get("use_sim_time", False), bool):
                raise ParameterError("use_sim_time must be a bool")
            change({name: value for name, value in given.items() if name in known})
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_pre_set_parameters_callback(convert)
    node.add_on_set_parameters_callback(answer)


def _as_declared(parameter: RosParameter, known: Parameter | None) -> RosParameter:
    """An integer, where it is set, as the floating point number that is declared."""
    if (
        known is not None
        and isinstance(known.default, float)
        and parameter.type_ == RosParameter.Type.INTEGER
    ):
        return RosParameter(parameter.name, RosParameter.Type.DOUBLE, float(parameter.value))
    return parameter


def ros_value(value: Value) -> bool | int | float | str | list[object]:
    """Return the value as rclpy takes it."""
    return list[object](value) if isinstance(value, tuple) else value


def _type_of(value: Value) -> int:
    if not isinstance(value, tuple):
        return _TYPES[type(value)]
    if isinstance(value[0], str):
        return ParameterType.PARAMETER_STRING_ARRAY
    return ParameterType.PARAMETER_DOUBLE_ARRAY


def describe(parameter: Parameter) -> ParameterDescriptor:
    """Return the descriptor that ``ros2 param describe`` shows."""
    descriptor = ParameterDescriptor(
        name=parameter.name,
        type=_type_of(parameter.default),
        description=_description(parameter),
        additional_constraints=constraints(parameter),
        read_only=not parameter.dynamic,
    )
    if parameter.lower is None and parameter.upper is None:
        return descriptor
    least = parameter.lower
    if isinstance(parameter.default, int):
        descriptor.integer_range = [
            IntegerRange(
                from_value=-_LARGEST_INTEGER if least is None else int(least),
                to_value=_LARGEST_INTEGER if parameter.upper is None else int(parameter.upper),
                step=0,
            )
        ]
    else:
        descriptor.floating_point_range = [
            FloatingPointRange(
                from_value=-sys.float_info.max if least is None else float(least),
                to_value=sys.float_info.max if parameter.upper is None else float(parameter.upper),
                step=0.0,
            )
        ]
    return descriptor


def _description(parameter: Parameter) -> str:
    return (
        f"{parameter.description} [{parameter.unit}]" if parameter.unit else (parameter.description)
    )


def constraints(parameter: Parameter) -> str:
    """Return what a value must be, in words: a descriptor's range cannot exclude its bounds."""
    words = []
    if parameter.choices:
        instead = ", or package/msg/Type" if parameter.is_open else ""
        words.append("one of " + ", ".join(parameter.choices) + instead)
    if parameter.lower is not None:
        words.append(f"at least {parameter.lower!r}")
    if parameter.upper is not None:
        words.append(f"at most {parameter.upper!r}")
    return ", ".join(words)
