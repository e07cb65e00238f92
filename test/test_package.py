# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The packaging: what colcon, pip, rosdep and a reader find agrees with what is there."""

import ast
import re
import runpy
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest
import setuptools

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "trajeval_ros"
MANIFEST = ElementTree.parse(ROOT / "package.xml").getroot()
HEADER = ["# Copyright 2026 The trajeval_ros authors", "# SPDX-License-Identifier: Apache-2.0"]

# import name -> rosdep key, where they differ
ROSDEP_KEYS = {"numpy": "python3-numpy", "scipy": "python3-scipy", "yaml": "python3-yaml"}
# import name -> the extra of setup.py that brings it
OPTIONAL = {
    "rerun": "rerun",
    "aiohttp": "watch",
    "pyproj": "gnss",
    "argcomplete": "completion",
    "arch": "comparison",
    "dask": "benchmark",
    "distributed": "benchmark",
    "matplotlib": "report",
    "pandas": "tables",
    "pyarrow": "benchmark",
    "rich": "terminal",
    "rosbags": "bags",
}


@pytest.fixture
def arguments(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What setup.py hands to setuptools."""
    handed: dict[str, Any] = {}
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(setuptools, "setup", handed.update)
    runpy.run_path("setup.py")
    return handed


def sources() -> list[Path]:
    directories = ("performance", "fuzz", "launch", "test", "trajeval_ros")
    found = (path for name in directories for path in (ROOT / name).rglob("*.py"))
    return [ROOT / "setup.py", *sorted(found)]


def imports(path: Path) -> set[str]:
    """Top-level names of the modules outside the package that a file imports, anywhere in it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names.add(node.module.partition(".")[0])
    return names - set(sys.stdlib_module_names) - {"trajeval_ros"}


def test_version_is_the_same_everywhere(arguments: dict[str, Any]) -> None:
    changelog = (ROOT / "CHANGELOG.rst").read_text(encoding="utf-8")
    released = re.findall(r"^(\d+\.\d+\.\d+) \(\d{4}-\d{2}-\d{2}\)$", changelog, re.MULTILINE)
    assert MANIFEST.findtext("version") == arguments["version"] == released[0]


def test_name_licence_and_maintainer_are_the_same_everywhere(arguments: dict[str, Any]) -> None:
    assert MANIFEST.findtext("name") == arguments["name"] == PACKAGE.name
    assert MANIFEST.findtext("license") == arguments["license"] == "Apache-2.0"
    assert MANIFEST.findtext("maintainer") == arguments["maintainer"]
    maintainer = MANIFEST.find("maintainer")
    assert maintainer is not None
    assert maintainer.get("email") == arguments["maintainer_email"]


@pytest.mark.filterwarnings("ignore::DeprecationWarning:catkin_pkg")
def test_manifest_and_changelog_are_what_ros_tools_read() -> None:
    catkin_package = pytest.importorskip("catkin_pkg.package")
    catkin_changelog = pytest.importorskip("catkin_pkg.changelog")
    warnings: list[str] = []
    package = catkin_package.parse_package(str(ROOT / "package.xml"), warnings=warnings)
    assert warnings == []
    assert package.get_build_type() == "ament_python"
    changelog = catkin_changelog.get_changelog_from_path(str(ROOT), "trajeval_ros")
    versions = [version for version, _date, _content in changelog.foreach_version()]
    assert package.version in versions


def test_every_subpackage_is_packaged(arguments: dict[str, Any]) -> None:
    directories = {path.parent for path in PACKAGE.rglob("*.py")}
    assert set(arguments["packages"]) == {
        ".".join(directory.relative_to(ROOT).parts) for directory in directories
    }


def test_every_executable_has_its_main(arguments: dict[str, Any]) -> None:
    scripts = dict(
        re.fullmatch(r"(\w+) = (\S+)", line).groups()  # type: ignore[union-attr]
        for line in arguments["entry_points"]["console_scripts"]
    )
    assert set(scripts) == {
        "evaluator",
        "evaluate",
        "replay",
        "demo",
        "simulate",
        "benchmark",
        "watch",
    }
    for target in scripts.values():
        module, _, function = target.partition(":")
        tree = ast.parse((ROOT / f"{module.replace('.', '/')}.py").read_text(encoding="utf-8"))
        names = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        assert function in names, target


def test_data_files_are_there_and_installed(arguments: dict[str, Any]) -> None:
    installed = dict(arguments["data_files"])
    for paths in installed.values():
        for path in paths:
            assert (ROOT / path).is_file(), path
    share = "share/trajeval_ros"
    assert installed["share/ament_index/resource_index/packages"] == ["resource/trajeval_ros"]
    assert installed[share] == ["package.xml"]
    assert "config/evaluator.yaml" in installed[f"{share}/config"]
    assert "launch/evaluator.launch.py" in installed[f"{share}/launch"]
    for directory in ("config", "launch", "dashboards"):
        there = {path for path in (ROOT / directory).glob("*") if path.is_file()}
        there -= {ROOT / "config" / "make_evaluator.py"}  # it writes evaluator.yaml
        assert {ROOT / path for path in installed[f"{share}/{directory}"]} == there


def test_every_import_is_declared(arguments: dict[str, Any]) -> None:
    keys = {node.text for node in MANIFEST.findall("exec_depend")}
    used: set[str] = set()
    for directory in (PACKAGE, ROOT / "launch"):
        for path in directory.rglob("*.py"):
            used |= imports(path)
    undeclared = {name for name in used - set(OPTIONAL) if ROSDEP_KEYS.get(name, name) not in keys}
    assert undeclared == set()
    for name, extra in OPTIONAL.items():
        assert any(need.startswith(name) for need in arguments["extras_require"][extra])


def test_node_imports_nothing_optional() -> None:
    for path in (PACKAGE / "node").rglob("*.py"):
        assert imports(path) & set(OPTIONAL) == set(), path


def test_tests_need_nothing_but_what_is_declared(arguments: dict[str, Any]) -> None:
    assert {"python3-pytest", "python3-hypothesis"} <= {
        node.text for node in MANIFEST.findall("test_depend")
    }
    # colcon test takes pytest when it finds it in this extra.
    assert any(need.startswith("pytest") for need in arguments["extras_require"]["test"])


@pytest.mark.parametrize("path", sources(), ids=lambda path: str(path.relative_to(ROOT)))
def test_source_starts_with_the_licence(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").splitlines()
    start = 1 if lines and lines[0].startswith("#!") else 0
    assert lines[start : start + 2] == HEADER


def lint_imports(directory: Path) -> subprocess.CompletedProcess[str]:
    pytest.importorskip("importlinter")
    command = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    return subprocess.run(
        [sys.executable, "-c", command, "--no-logo", "--no-cache"],
        cwd=directory,
        capture_output=True,
        text=True,
        check=False,
    )


def test_architecture_contracts_hold() -> None:
    result = lint_imports(ROOT)
    assert result.returncode == 0, result.stdout


@pytest.mark.parametrize(
    ("module", "line", "contract"),
    [
        ("se3.py", "import scipy", "SE(3) is NumPy alone"),
        ("se3.py", "from trajeval_ros import online", "One way in"),
        ("ground_truth/__init__.py", "from trajeval_ros import likelihood", "One way in"),
        ("likelihood/__init__.py", "from rclpy.node import Node", "Nothing below the node"),
        ("online/__init__.py", "def now():\n    import time", "Nothing below the node"),
        ("online/__init__.py", "import matplotlib.pyplot", "The mathematics and the engine"),
    ],
)
def test_architecture_contracts_notice(
    module: str, line: str, contract: str, tmp_path: Path
) -> None:
    shutil.copytree(PACKAGE, tmp_path / "trajeval_ros")
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    with (tmp_path / "trajeval_ros" / module).open("a", encoding="utf-8") as file:
        file.write(f"\n{line}\n")
    result = lint_imports(tmp_path)
    assert result.returncode == 1
    assert re.search(rf"^{re.escape(contract)}[^.]*?BROKEN$", result.stdout, re.MULTILINE)


@pytest.mark.parametrize("name", ["ESTIMATE", "GROUND_TRUTH"])
def test_make_demo_refuses_one_file_without_the_other(name: str) -> None:
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    result = subprocess.run(
        ["make", "--no-print-directory", "demo", f"{name}=a file.txt"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 2
    assert result.stderr.startswith(f"error: {name} is set and ")


def test_no_two_files_of_tests_share_a_name() -> None:
    """Pytest imports them by their names alone: of two, it refuses one."""
    names = [path.name for path in (ROOT / "test").rglob("test_*.py")]
    assert sorted(names) == sorted(set(names))
