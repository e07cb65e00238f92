# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The way from NumPy to C; what the loops compute is held to NumPy where it is used."""

import ctypes
import gc
import os
import subprocess
import sys
from importlib import util
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import numpy as np
import pytest

from trajeval_ros import loops

ROOT = Path(__file__).parents[2]

built = pytest.mark.skipif(not loops.there(), reason="not built, or switched off")


def test_what_was_built_is_of_these_sources():
    """Or else `make install` builds it anew; an older one is not used."""
    folder = Path(loops.__file__).parent
    library = next(folder.glob(f"_loops*{EXTENSION_SUFFIXES[0]}"), None)
    if library is None:
        pytest.skip("not built")
    built = ctypes.CDLL(str(library)).loops_sources
    built.restype = ctypes.c_uint32
    assert built() == loops.sources()


@built
def test_a_library_of_other_sources_is_none(monkeypatch):
    there = loops._library._name
    monkeypatch.setenv(loops.SWITCH, there)
    assert loops._loaded() is not None
    monkeypatch.setattr(loops, "sources", lambda: 1)
    with pytest.raises(OSError, match="other sources"):
        loops._loaded()
    monkeypatch.delenv(loops.SWITCH)
    assert loops._loaded() is None
    monkeypatch.setattr(loops, "sources", lambda: None)
    monkeypatch.setenv(loops.SWITCH, there)
    assert loops._loaded() is not None


@built
@pytest.mark.parametrize(
    "array", [np.zeros((4, 4))[:, ::2], np.zeros(3, dtype=np.float32), np.zeros((2, 3)).T]
)
def test_an_array_that_c_would_misread_is_refused(array):
    with pytest.raises(TypeError, match="none for C"):
        loops.call("loops_sources", array)


@built
@pytest.mark.parametrize("count", [3, 12, 18])
def test_calls_leave_nothing_behind(count):
    arguments = [np.zeros(1)] * count
    gc.collect()  # Python keeps tuples for later, and gives them back here alone
    before = sys.getallocatedblocks()
    for _ in range(1000):
        loops.call("loops_sources", *arguments)
    assert sys.getallocatedblocks() - before < 100


def test_what_is_no_library_is_none(tmp_path, monkeypatch):
    monkeypatch.delenv(loops.SWITCH, raising=False)
    monkeypatch.setattr(loops, "__file__", str(tmp_path / "__init__.py"))
    assert loops._loaded() is None
    (tmp_path / f"_loops{EXTENSION_SUFFIXES[0]}").write_bytes(b"of another machine")
    assert loops._loaded() is None
    monkeypatch.setenv(loops.SWITCH, str(tmp_path / f"_loops{EXTENSION_SUFFIXES[0]}"))
    with pytest.raises(OSError, match="_loops"):
        loops._loaded()


@built
@pytest.mark.parametrize("count", [0, 3])
def test_an_array_may_be_empty_or_read_only(count):
    array = np.zeros(count)
    array.flags.writeable = False
    assert loops.call("so3_log", array, array, 0) == 0


@built
def test_they_can_be_left_out():
    with loops.left_out():
        assert not loops.there()
    assert loops.there()


def test_they_are_switched_off_by_the_environment():
    words = "from trajeval_ros import loops; print(loops.there())"
    environment = {**os.environ, loops.SWITCH: "0", "PYTHONPATH": str(ROOT)}
    said = subprocess.run(
        [sys.executable, "-c", words], env=environment, capture_output=True, text=True, check=True
    )
    assert said.stdout.strip() == "False"


@built
def test_a_library_of_another_place_is_taken_where_it_is_named(tmp_path):
    words = "from trajeval_ros import loops; print(loops._library._name, loops.there())"
    there = tmp_path / "elsewhere.so"
    there.write_bytes(Path(loops._library._name).read_bytes())
    environment = {**os.environ, loops.SWITCH: str(there), "PYTHONPATH": str(ROOT)}
    said = subprocess.run(
        [sys.executable, "-c", words], env=environment, capture_output=True, text=True, check=True
    )
    assert said.stdout.split() == [str(there), "True"]


def test_a_package_without_a_compiler_is_built_and_works(tmp_path):
    pytest.importorskip("setuptools")
    assert util.find_spec("trajeval_ros") is not None
    environment = {**os.environ, "CC": "/nowhere/cc", "PYTHONDONTWRITEBYTECODE": "1"}
    build = [sys.executable, "setup.py", "-q", "build_ext", "--build-lib", str(tmp_path / "lib")]
    build += ["--build-temp", str(tmp_path / "temp")]
    done = subprocess.run(build, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert not list(tmp_path.rglob("*.so"))


def test_a_library_of_before_is_not_installed_without_a_compiler(tmp_path):
    pytest.importorskip("setuptools")
    old = tmp_path / "lib" / "trajeval_ros" / "loops" / f"_loops{EXTENSION_SUFFIXES[0]}"
    old.parent.mkdir(parents=True)
    old.write_bytes(b"of other sources")
    os.utime(old, (0, 0))
    environment = {**os.environ, "CC": "/nowhere/cc", "PYTHONDONTWRITEBYTECODE": "1"}
    build = [sys.executable, "setup.py", "-q", "build_ext", "--build-lib", str(tmp_path / "lib")]
    build += ["--build-temp", str(tmp_path / "temp")]
    done = subprocess.run(build, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert not old.exists()


def test_a_compiler_has_nothing_to_say(tmp_path):
    """Warnings are errors here, as everywhere."""
    pytest.importorskip("setuptools")
    environment = {**os.environ, "CFLAGS": "-Werror"}
    build = [sys.executable, "setup.py", "build_ext", "--build-lib", str(tmp_path / "lib")]
    build += ["--build-temp", str(tmp_path / "temp")]
    done = subprocess.run(build, cwd=ROOT, env=environment, capture_output=True, text=True)
    if "command 'gcc' failed: No such file" in done.stderr + done.stdout:
        pytest.skip("there is no C compiler")
    assert done.returncode == 0, done.stderr
    assert "warning:" not in done.stderr, done.stderr
    assert list(tmp_path.rglob("_loops*.so"))


@pytest.mark.parametrize("values", [[1, 2], np.array([True, False]), np.ones((4, 3))[::2].T])
def test_doubles_are_what_a_loop_reads(values):
    found = loops.doubles(values)
    assert found.dtype == np.float64
    assert found.flags.c_contiguous
    np.testing.assert_array_equal(found, values)
