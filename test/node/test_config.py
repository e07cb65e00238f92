# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The files for ROS agree with the code: parameters, analyzers, launch."""

from __future__ import annotations

import ast
import json
import os
import runpy
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
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


# What stands for an executable: it writes down how it was started.
_RECORDER = """#!{python}
import json, pathlib, sys
given = sys.argv[1:]
files = [pathlib.Path(b).read_text() for a, b in zip(given, given[1:]) if a == "--params-file"]
pathlib.Path({record!r}).write_text(json.dumps([given, files]))
"""
_LAUNCH = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
arguments = [pair.split(":=", 1) for pair in sys.argv[2:]]
source = PythonLaunchDescriptionSource(sys.argv[1])
service = LaunchService(noninteractive=True)
description = IncludeLaunchDescription(source, launch_arguments=arguments)
service.include_launch_description(LaunchDescription([description]))
sys.exit(service.run())
"""


class Launched:
    """How an executable was started: its remappings, its parameters, its arguments."""

    def __init__(self, record: Path) -> None:
        self.arguments, files = json.loads(record.read_text(encoding="utf-8"))
        pairs = list(pairwise(self.arguments))
        self.remaps = {given for flag, given in pairs if flag == "-r" and "__" not in given}
        self.parameters: dict[str, object] = {}
        for file in files:
            # rcl's reader knows no tags, and launch_ros writes lists as Python's tuples.
            (values,) = yaml.safe_load(file.replace("!!python/tuple", "")).values()
            self.parameters |= values["ros__parameters"]


@pytest.fixture
def launch(tmp_path: Path) -> Callable[..., dict[str, Launched]]:
    """Launch the file with arguments, really, with executables that write down their start."""
    pytest.importorskip("launch_ros", reason="launch_ros comes with ROS 2 only")
    records = {}
    for package, executable in (("trajeval_ros", "evaluator"), ("rviz2", "rviz2")):
        index = tmp_path / "share" / "ament_index" / "resource_index" / "packages"
        index.mkdir(parents=True, exist_ok=True)
        (index / package).touch()
        path = tmp_path / "lib" / package / executable
        path.parent.mkdir(parents=True)
        records[executable] = tmp_path / f"{executable}.json"
        text = _RECORDER.format(python=sys.executable, record=str(records[executable]))
        path.write_text(text, encoding="utf-8")
        path.chmod(0o755)
    (tmp_path / "share" / "trajeval_ros").mkdir()
    for folder in ("config", "launch"):
        (tmp_path / "share" / "trajeval_ros" / folder).symlink_to(ROOT / folder)
    environment = {"AMENT_PREFIX_PATH": str(tmp_path), "ROS_LOG_DIR": str(tmp_path / "log")}

    def run(**arguments: str) -> dict[str, Launched]:
        command = [sys.executable, "-c", _LAUNCH, str(ROOT / "launch" / "evaluator.launch.py")]
        done = subprocess.run(
            [*command, *(f"{name}:={value}" for name, value in arguments.items())],
            env={**os.environ, **environment},
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
            timeout=240,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return {name: Launched(path) for name, path in records.items() if path.exists()}

    return run


Launch = Callable[..., dict[str, Launched]]


def test_several_estimates_are_launched(launch: Launch) -> None:
    node = launch(estimates="vins=/vins/odometry, orb=/orb/pose")["evaluator"]
    assert node.remaps == {
        "vins:=/vins/odometry",
        "orb:=/orb/pose",
        "ground_truth:=ground_truth",
    }
    assert node.parameters == {"estimates": ["vins", "orb"]}
    with pytest.raises(AssertionError, match="estimates must be name=topic,name=topic"):
        launch(estimates="vins")


def test_a_transform_is_launched_as_a_parameter(launch: Launch) -> None:
    node = launch(estimate="/tf:map.base_link", ground_truth="/vicon")["evaluator"]
    assert node.remaps == {"ground_truth:=/vicon"}
    assert node.parameters["estimate.topic"] == "/tf:map.base_link"
    node = launch(estimates="a=/tf:map.base,b=/b", ground_truth="/tf:w.body")["evaluator"]
    assert node.remaps == {"b:=/b"}
    assert node.parameters == {
        "estimates": ["a", "b"],
        "a.topic": "/tf:map.base",
        "ground_truth.topic": "/tf:w.body",
    }


def test_rviz_shows_each_of_several(launch: Launch) -> None:
    arguments = launch(estimates="vins=/v,orb=/o", rviz="true")["rviz2"].arguments
    view = Path(arguments[arguments.index("-d") + 1]).read_text(encoding="utf-8")
    topics = [
        display["Topic"]["Value"]
        for display in yaml.safe_load(view)["Visualization Manager"]["Displays"]
        if "Topic" in display
    ]
    assert topics == [
        "evaluator/ground_truth/path",
        "evaluator/vins/path",
        "evaluator/orb/path",
        "evaluator/markers",
    ]
