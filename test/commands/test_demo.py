# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``demo``: publisher, node and subscriber as three real processes over DDS."""

import json
import os
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from trajeval_ros.commands import demo
from trajeval_ros.commands.live import State
from trajeval_ros.commands.simulate import write_files, write_two
from trajeval_ros.comparison.compare import read

ADDRESS = "http://127.0.0.1:8765/"
ROOT = Path(__file__).resolve().parents[2]
ENVIRONMENT = {
    **os.environ,
    "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
}


def command(name: str, *arguments: object) -> list[str]:
    return [sys.executable, "-m", f"trajeval_ros.commands.{name}", *map(str, arguments)]


def run(name: str, *arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(name, *arguments),
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        cwd=cwd,
        env=ENVIRONMENT,
    )


def close(live: Any, read: Any, path: str = "") -> None:
    """Assert that everything in ``read`` is in ``live``, numbers to 1e-9."""
    if isinstance(read, dict):
        for key in read:
            close(live[key], read[key], f"{path}.{key}")
    elif isinstance(read, list):
        assert len(live) == len(read), path
        for index, value in enumerate(read):
            close(live[index], value, f"{path}[{index}]")
    elif isinstance(read, float):
        assert live == pytest.approx(read, rel=1e-9, abs=1e-15), path
    else:
        assert live == read, path


def assert_live_is_as_from_files(live: dict[str, Any], file: dict[str, Any]) -> None:
    """Whether the node's summary is that of ``evaluate``, but for what only one of them can say."""
    assert file.pop("likely_causes") == []
    # Files here, topics there.
    file.pop("inputs")
    file["parameters"].pop("output.directory")
    # evaluate fits the run as a whole, the node in blocks; the window is the same.
    assert file.pop("error_model")["fit"] == "whole"
    assert live.pop("error_model", {"fit": "blocks"})["fit"] == "blocks"
    models = [each["window"].pop("error_model") for each in (live, file)]
    offsets = [model["clock_offset"]["value"] for model in models]
    assert offsets[0] == pytest.approx(offsets[1], abs=1e-9)
    # evaluate has all poses in memory at the end, the node does not.
    file["absolute"].pop("log_likelihood_nonlinear")
    assert file.pop("drift")["all_pairs"]["pairs"] > 100
    assert file.pop("headline")["worst"]["translation"] > 0.0
    # Round-off itself, so not the same in both.
    assert live["absolute"]["consistency"] < 1e-9
    file["absolute"].pop("consistency")
    close(live, file)


@pytest.mark.ros
def test_live_figures_are_those_of_the_files(tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="needs ROS 2")
    truth, estimate = write_files(tmp_path, 24.0, 3)
    shown = run(
        "demo",
        *("--ground-truth", truth, "--estimate", estimate),
        *("--rate", 10, "--output", tmp_path / "live"),
        cwd=tmp_path,
    )
    assert shown.returncode == 0, shown.stdout + shown.stderr
    assert "none lost" in shown.stdout
    assert "replaying 10x" in shown.stdout, "the node's figures have been heard meanwhile"
    if find_spec("aiohttp") is not None:
        assert "In a browser: http://127.0.0.1:" in shown.stdout
    report = tmp_path / "live" / "report.html"
    assert f"Report: {report}" in shown.stdout
    assert report.is_file()

    offline = run("evaluate", "tum", truth, estimate, "--output", tmp_path / "file", cwd=tmp_path)
    assert offline.returncode == 0, offline.stderr
    figures = {
        name: json.loads((tmp_path / name / "summary.json").read_text(encoding="utf-8"))
        for name in ("live", "file")
    }
    assert_live_is_as_from_files(figures["live"], figures["file"])


@pytest.mark.ros
def test_two_estimates_side_by_side_and_which_is_better(tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="needs ROS 2")
    truth, drifting, corrected = write_two(tmp_path, 40.0, 1)
    shown = run(
        "demo",
        *("--ground-truth", truth, "--estimate", drifting, "--estimate", corrected),
        *("--rate", 8, "--output", tmp_path / "live"),
        cwd=tmp_path,
    )
    assert shown.returncode == 0, shown.stdout + shown.stderr
    assert "none lost" in shown.stdout
    assert "drifting: ATE" in shown.stdout
    assert "corrected's translation drifts" in shown.stdout
    # The report of all, which those of each lie beside.
    assert shown.stdout.count("Report: ") == 1
    assert f"Report: {tmp_path / 'live' / 'report.html'}\n" in shown.stdout
    for name in (".", "drifting", "corrected"):
        assert (tmp_path / "live" / name / "report.html").is_file()
    summary = json.loads((tmp_path / "live" / "summary.json").read_text(encoding="utf-8"))
    (pair,) = summary["comparison"]
    assert pair["re_translation"]["interval"][0] > 1.0
    # What was written is what was compared; the nats are of the error models.
    assert read(pair).figures() == {k: v for k, v in pair.items() if k != "nats_per_second"}


@pytest.mark.ros
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_a_signal_leaves_no_process_behind(number: signal.Signals, tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="needs ROS 2")
    truth, estimate = write_files(tmp_path, 120.0, 3)
    output = tmp_path / "live"
    shown = subprocess.Popen(
        command(
            *("demo", "--ground-truth", truth, "--estimate", estimate),
            *("--rate", 6, "--output", output),
        ),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        env=ENVIRONMENT,
        # Under nohup it is ignored, and the demo leaves it at that.
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),
    )
    try:
        assert shown.stdout is not None
        assert any(line.startswith("replaying") for line in shown.stdout)
        assert len(processes_about(tmp_path)) == 3
        shown.send_signal(number)
        if number is signal.SIGHUP:
            # Shell and kernel both send it; the second must not disturb the children's end.
            while not ignored(shown.pid, number) and shown.poll() is None:
                time.sleep(0.01)
            shown.send_signal(number)
        _, errors = shown.communicate(timeout=240)
        assert shown.returncode == 130, errors
        assert errors == "demo: error: interrupted\n"
    finally:
        shown.terminate()
    assert processes_about(tmp_path) == []
    assert (output / "summary.json").is_file(), "the node has written what there was"


def ignored(process: int, number: signal.Signals) -> bool:
    """Whether a process ignores a signal by now."""
    text = Path(f"/proc/{process}/status").read_text(encoding="utf-8")
    mask = next(line for line in text.splitlines() if line.startswith("SigIgn:")).split()[1]
    return bool(int(mask, 16) >> (number - 1) & 1)


def processes_about(path: Path) -> list[str]:
    """Command lines that name the folder."""
    found = []
    for process in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = process.read_bytes().replace(b"\0", b" ").decode()
        except OSError:
            continue  # it has ended since
        if str(path) in line and "trajeval_ros" in line:
            found.append(line)
    return found


def test_the_page_is_offered_once_and_opened_where_there_is_a_screen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []
    monkeypatch.setattr(demo.webbrowser, "open", opened.append)
    monkeypatch.delenv("SSH_CONNECTION", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(demo.sys.stdout, "isatty", lambda: True, raising=False)
    for display, asked, expected in (("", True, []), (":0", False, []), (":0", True, [ADDRESS])):
        opened.clear()
        monkeypatch.setenv("DISPLAY", display) if display else monkeypatch.delenv(
            "DISPLAY", raising=False
        )
        page, state = demo._Page(tmp_path, opens=asked), State(0.0, 1.0)
        page._child = object()  # type: ignore[assignment]
        log = tmp_path / "watch.log"
        log.write_text("", encoding="utf-8")
        page.offer(state)
        assert state.page == ""
        log.write_text(f"Watching /evaluator at {ADDRESS}\n", encoding="utf-8")
        for _ in range(2):
            page.offer(state)
        assert state.page == ADDRESS
        # There is none elsewhere than on Linux without a display.
        assert opened == (expected if demo.sys.platform != "darwin" else [ADDRESS] * asked)


@pytest.mark.parametrize("option", ["--ground-truth", "--estimate"])
def test_one_file_without_the_other_is_wrong_usage(option: str, tmp_path: Path) -> None:
    result = run("demo", option, "a.txt", cwd=tmp_path)
    assert result.returncode == 2
    assert "give both" in result.stderr


def test_bad_files_are_refused_before_anything_starts(tmp_path: Path) -> None:
    result = run("demo", "--ground-truth", "a.txt", "--estimate", "b.txt", cwd=tmp_path)
    assert result.returncode == 1
    assert result.stderr == "demo: error: a.txt: it cannot be read: no such file or directory\n"


def test_an_interruption_that_rclpy_makes_another_error_of_is_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def takes_a_message(arguments: object) -> int:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt as error:
            raise RuntimeError("Unable to convert call argument") from error
        return 0

    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.getsignal(number) for number in numbers}
    monkeypatch.setattr(demo, "demo", takes_a_message)
    monkeypatch.setattr(demo, "_interruptions", [])
    try:
        # A shell's background job, and its children, ignore it from the start.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        assert demo.main([]) == 130
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert "interrupted" in capsys.readouterr().err
