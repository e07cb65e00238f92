# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The files for ROS agree with the code: parameters, analyzers, launch."""

from __future__ import annotations

import ast
import runpy
from pathlib import Path

import pytest
import yaml
from rcl_interfaces.msg import ParameterType

from trajeval_ros.node.parameters import constraints, describe, ros_value
from trajeval_ros.online.parameters import PARAMETERS

ROOT = Path(__file__).parent.parent.parent


def test_evaluator_yaml_is_what_the_table_gives() -> None:
    generated = runpy.run_path(str(ROOT / "config" / "make_evaluator.py"))["text"]()
    written = (ROOT / "config" / "evaluator.yaml").read_text(encoding="utf-8")
    assert written == generated, "run config/make_evaluator.py"


def test_evaluator_yaml_reads_as_the_defaults() -> None:
    text = (ROOT / "config" / "evaluator.yaml").read_text(encoding="utf-8")
    values = yaml.safe_load(text)["/**/evaluator"]["ros__parameters"]
    assert values == {name: ros_value(p.default) for name, p in PARAMETERS.items()}
    assert all(type(values[name]) is type(ros_value(PARAMETERS[name].default)) for name in values)


@pytest.mark.parametrize("name", PARAMETERS)
def test_every_parameter_is_described(name: str) -> None:
    parameter = PARAMETERS[name]
    descriptor = describe(parameter)
    assert descriptor.description.startswith(parameter.description)
    assert descriptor.read_only is not parameter.dynamic
    assert descriptor.type != ParameterType.PARAMETER_NOT_SET
    for bound in (parameter.lower, parameter.upper):
        assert bound is None or repr(bound) in constraints(parameter)
    ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
    if ranges:
        (only,) = ranges
        assert only.from_value <= parameter.default <= only.to_value


def test_analyzers_name_statuses_that_exist() -> None:
    text = (ROOT / "config" / "analyzers.yaml").read_text(encoding="utf-8")
    analyzers = yaml.safe_load(text)["analyzers"]["ros__parameters"]["evaluator"]["analyzers"]
    named = {entry for analyzer in analyzers.values() for entry in analyzer["contains"]}
    statuses = ("estimate", "ground truth", "synchronization")
    statuses += ("clock", "consistency", "performance")
    assert named == {f"evaluator: {status}" for status in statuses}


@pytest.mark.parametrize("name", ["evaluator.launch.py", "replay.launch.py"])
def test_a_launch_file_parses_and_names_what_is_there(name: str) -> None:
    text = (ROOT / "launch" / name).read_text(encoding="utf-8")
    tree = ast.parse(text)
    functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert "generate_launch_description" in functions
    strings = {n.value for n in ast.walk(tree) if isinstance(n, ast.Constant)}
    for file in (s for s in strings if isinstance(s, str) and s.endswith((".yaml", ".rviz"))):
        assert (ROOT / "config" / file).exists()
    for file in (s for s in strings if isinstance(s, str) and s.endswith(".launch.py")):
        assert (ROOT / "launch" / file).exists()


@pytest.mark.parametrize("name", ["evaluator.launch.py", "replay.launch.py"])
def test_a_launch_file_describes_a_launch(name: str) -> None:
    pytest.importorskip("launch_ros", reason="launch_ros comes with ROS 2 only")
    runpy.run_path(str(ROOT / "launch" / name))["generate_launch_description"]()
