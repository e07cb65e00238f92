# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters from the command line: the node's own YAML file, and ``--set name=value``."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from trajeval_ros.commands import completion
from trajeval_ros.commands.console import UsageError
from trajeval_ros.online.parameters import (
    ONE,
    PARAMETERS,
    Parameter,
    ParameterError,
    Value,
    complete,
    is_of_ros,
    table,
)

_NODE = "evaluator"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare ``--params`` and ``--set``."""
    parser.add_argument(
        "--params",
        metavar="FILE",
        help="parameters from a YAML file, the node's own; --set goes over it",
    )
    assignment = parser.add_argument(
        "--set",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        dest="assignments",
        help="set a parameter, e.g. gauge=yaw_translation or extrinsic=0.1,0,0,0,0,0,1;"
        " may be repeated; the names are listed below",
    )
    assignment.completer = completion.assignments  # type: ignore[attr-defined]
    parser.epilog = parameter_list()
    parser.formatter_class = argparse.RawDescriptionHelpFormatter


def parameter_list() -> str:
    """Return every parameter with its default and what it is, for ``--help``."""
    lines = ["parameters for --set, with their defaults:"]
    for name, parameter in PARAMETERS.items():
        default = parameter.default
        if isinstance(default, bool):
            shown = str(default).lower()
        elif isinstance(default, tuple):
            shown = ",".join(v if isinstance(v, str) else f"{v:g}" for v in default)
        else:
            shown = f"{default:g}" if isinstance(default, float) else str(default)
        unit = f" {parameter.unit}" if parameter.unit else ""
        choices = f" (of {', '.join(parameter.choices)})" if parameter.choices else ""
        lines.append(f"  {name}={shown}{unit}{choices}")
    lines.append("what each of them means: docs/parameters.md")
    # argparse takes a per cent sign for a format.
    return "\n".join(lines).replace("%", "%%")


def read(
    params: str | None, assignments: Iterable[str], names: Sequence[str] = ONE
) -> dict[str, Value]:
    """Return every parameter's value: assignments over the file over the defaults.

    ``names``: of the estimates.

    Raises
    ------
    UsageError
        For an unknown parameter, a value of the wrong type or out of range, by name.
    """
    known = table(names)
    values: dict[str, object] = {}
    if params is not None:
        values |= read_file(Path(params), known)
    for assignment in assignments:
        name, value = parse_assignment(assignment, known)
        values[name] = value
    if values.get("estimates") == list(ONE):
        # The default, as a file of all parameters has it: the files are given in any case.
        del values["estimates"]
    try:
        return complete(values, names)
    except ParameterError as error:
        raise UsageError(str(error)) from error


def parse_assignment(text: str, known: Mapping[str, Parameter] = PARAMETERS) -> tuple[str, object]:
    """Return the name and the value of ``name=value``, read as the parameter's type."""
    name, equals, value = text.partition("=")
    name, value = name.strip(), value.strip()
    if not equals or not name:
        raise UsageError(f"--set takes name=value, got {text!r}")
    if name not in known:
        raise UsageError(f"unknown parameter {name}{suggestion(name, known)}")
    return name, _parse(value, known[name].default)


def _parse(text: str, like: Value) -> object:
    """Read ``text`` as the type of ``like``; what does not read stays text, refused later."""
    if isinstance(like, str):
        return text
    if isinstance(like, bool):
        return {"true": True, "false": False}.get(text.lower(), text)
    if isinstance(like, tuple):
        entries = text.removeprefix("[").removesuffix("]").replace(",", " ").split()
        return [_parse(entry, like[0]) for entry in entries]
    for number in (int, float):
        try:
            return number(text)
        except ValueError:
            continue
    return text


def suggestion(name: str, parameters: Mapping[str, Parameter] = PARAMETERS) -> str:
    """Return a hint at parameters of a similar name, or nothing."""
    from difflib import get_close_matches

    last = {known.rpartition(".")[2]: known for known in parameters}
    close = get_close_matches(name, parameters, n=1) or [
        last[match] for match in get_close_matches(name.rpartition(".")[2], last, n=1)
    ]
    return f"; did you mean {close[0]}?" if close else ""


def read_file(path: Path, parameters: Mapping[str, Parameter] = PARAMETERS) -> dict[str, object]:
    """Read the node's parameters from a ROS 2 parameter file, or a plain mapping of names."""
    try:
        document = _read_yaml(path)
        if document is None:
            return {}
        if not isinstance(document, Mapping):
            raise UsageError(f"{path} does not hold a mapping of parameters")
        values: dict[str, object] = {}
        for section in _sections(document, path):
            values |= _flatten(section)
    except RecursionError:
        # Brackets by the thousand, or an alias within what it stands for.
        raise UsageError(f"{path} is nested too deeply") from None
    known = {name: value for name, value in values.items() if not is_of_ros(name)}
    for name in known:
        if name not in parameters:
            raise UsageError(f"{path}: unknown parameter {name}{suggestion(name, parameters)}")
    return known


def _read_yaml(path: Path) -> Any:
    import yaml

    class Loader(yaml.SafeLoader):
        """YAML as ROS 2 reads it: ``1e-3`` is a number, which PyYAML takes for a text."""

    Loader.add_implicit_resolver(
        "tag:yaml.org,2002:float",
        re.compile(r"^[-+]?[0-9]+[eE][-+]?[0-9]+$"),
        list("-+0123456789"),
    )
    try:
        return yaml.load(path.read_text(encoding="utf-8"), Loader)
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path} is not a text file") from error
    # PyYAML lets through what int, float and date make of values that only look like theirs.
    except (yaml.YAMLError, ArithmeticError, AttributeError, LookupError, ValueError) as error:
        raise UsageError(f"{path} is not YAML: {' '.join(str(error).split())}") from error


def _sections(document: Mapping[Any, Any], path: Path) -> list[Mapping[Any, Any]]:
    """Return the mappings that hold for the node, in the order of the file."""
    nodes = {
        str(key): value["ros__parameters"]
        for key, value in _unnested(document)
        if isinstance(value, Mapping) and "ros__parameters" in value
    }
    if not nodes:
        return [document]
    ours = [
        section
        for name, section in nodes.items()
        if name.rstrip("/").rpartition("/")[2] in (_NODE, "*", "**")
    ]
    if not ours:
        raise UsageError(f"{path} has parameters for {', '.join(nodes)} only, not for {_NODE}")
    return [section for section in ours if isinstance(section, Mapping)]


def _unnested(document: Mapping[Any, Any]) -> list[tuple[str, Any]]:
    """Return node names with their entries; a namespace may be a level of its own."""
    found = []
    for key, value in document.items():
        if isinstance(value, Mapping) and "ros__parameters" not in value:
            found += [(f"{key}/{inner}", entry) for inner, entry in _unnested(value)]
        else:
            found.append((str(key), value))
    return found


def _flatten(section: Mapping[Any, Any], prefix: str = "") -> dict[str, object]:
    values: dict[str, object] = {}
    for key, value in section.items():
        name = f"{prefix}{key}"
        values |= _flatten(value, f"{name}.") if isinstance(value, Mapping) else {name: value}
    return values
