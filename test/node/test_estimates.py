# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Several estimates beside one ground truth, each from a process of its own."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import data
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from harness import Graph, Process, accounted, save_samples, values_of
from nav_msgs.msg import Path as PathMessage
from std_msgs.msg import Float64
from twins.runs import assert_same_summary
from visualization_msgs.msg import MarkerArray

from trajeval_ros import se3
from trajeval_ros.commands.evaluate import main as evaluate
from trajeval_ros.online.samples import PoseSamples

pytestmark = pytest.mark.ros

NAMES = ("best_effort", "killed", "fast")
RATES = (20.0, 20.0, 200.0)
STDS = (0.01, 0.02, 0.01)
DURATION = 16.0
# What only `evaluate`, which has all poses, can say; and what differs between topics and files.
OF_FILES = (
    *(
        "error_model",
        "nats_per_second",
        "log_likelihood_nonlinear",
        "drift",
        "headline",
        "likely_causes",
    ),
    *("version", "inputs", "parameters"),
)


def runs() -> tuple[PoseSamples, dict[str, PoseSamples]]:
    """A ground truth, and three estimates in worlds of their own."""
    truth, _ = data.run(DURATION)
    estimates = {}
    for number, (name, rate, std) in enumerate(zip(NAMES, RATES, STDS, strict=True)):
        random = np.random.default_rng(number)
        t = np.arange(0.1 + 0.001 * number, DURATION - 0.5, 1.0 / rate)
        world = se3.exp(0.1 * np.arange(6.0) * (number + 1))
        poses = world @ data.motion(t) @ se3.exp(random.normal(0.0, std, (len(t), 6)))
        estimates[name] = data.samples(t, poses)
    return truth, estimates


class Publishers:
    """Processes that publish at twice the speed, each on its own."""

    def __init__(self, graph: Graph, folder: Path) -> None:
        self._graph = graph
        self._folder = folder

    def start(self, topic: str, samples: PoseSamples, rate: float, reliable: bool = True) -> Any:
        path = self._folder / f"{topic}_{len(samples)}_{samples.stamps[0]}.npz"
        save_samples(path, samples)
        script = str(Path(data.__file__).parent / "publisher.py")
        reliability = "reliable" if reliable else "best_effort"
        return self._graph.start(script, str(path), topic, str(2.0 * rate), reliability)

    def until_published(self, process: Process, count: int) -> None:
        said = f"published {count}\n"
        self._graph.until(lambda: said in process.output, said)


def write_tum(path: Path, samples: PoseSamples) -> Path:
    """Write every digit."""
    rows = np.concatenate([samples.positions, samples.quaternions], axis=1).tolist()
    lines = [
        f"{stamp // data.SECOND}.{stamp % data.SECOND:09d} {' '.join(map(repr, row))}\n"
        for stamp, row in zip(samples.stamps.tolist(), rows, strict=True)
    ]
    path.write_text("".join(lines), encoding="utf-8")
    return path


def received(graph: Graph, status: str) -> int:
    found = graph.health().get(status)
    return -1 if found is None else int(values_of(found).get("received", -1))


def without(figures: Any) -> Any:
    if not isinstance(figures, dict):
        return figures
    return {key: without(value) for key, value in figures.items() if key not in OF_FILES}


def test_three_publishers_one_ground_truth(graph: Graph, tmp_path: Path) -> None:
    """One best effort, one that is killed and returns, one at 200 Hz: as `evaluate` has it."""
    truth, estimates = runs()
    metrics = graph.listen(DiagnosticArray, "/evaluator/metrics")
    comparison = graph.listen(DiagnosticArray, "/evaluator/comparison")
    markers = graph.listen(MarkerArray, "/evaluator/markers", latched=True)
    numbers = {
        name: graph.listen(Float64, f"/evaluator/{name}/relative/log_likelihood") for name in NAMES
    }
    paths = {
        name: graph.listen(PathMessage, f"/evaluator/{name}/path", latched=True)
        for name in ("ground_truth", *NAMES)
    }
    # Each publisher keeps its own time: nothing is given up because another one is ahead.
    options = {"max_wait": 30.0, "fast__extrinsic": [0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]}
    node = graph.start_evaluator(
        estimates=list(NAMES), output__directory=str(tmp_path / "out"), **options
    )
    graph.until_known()
    assert {*NAMES, "ground truth", "synchronization", "consistency"} <= set(graph.health())

    publishers = Publishers(graph, tmp_path)
    half = len(estimates["killed"]) // 2
    first = publishers.start("killed", estimates["killed"][:half], RATES[1])
    processes = {
        "ground_truth": publishers.start("ground_truth", truth, 100.0),
        "best_effort": publishers.start("best_effort", estimates["best_effort"], 20.0, False),
        "fast": publishers.start("fast", estimates["fast"], 200.0),
    }
    publishers.until_published(first, half)
    first.kill()
    graph.until(lambda: received(graph, "killed") == half, "the first half")
    rest = estimates["killed"][half:]
    processes["killed"] = publishers.start("killed", rest, RATES[1])
    sent = {"ground_truth": len(truth), "killed": len(rest)}
    for name, process in processes.items():
        publishers.until_published(process, sent.get(name, len(estimates.get(name, ()))))
    for name in NAMES:
        graph.until(lambda name=name: received(graph, name) == len(estimates[name]), name)
    graph.until(lambda: received(graph, "ground truth") == len(truth), "ground truth")
    assert values_of(graph.health()["best_effort"])["reliability"] == "best_effort"
    assert values_of(graph.health()["fast"])["reliability"] == "reliable"
    graph.until(lambda: all(each and each[-1].poses for each in paths.values()), "paths")
    graph.until(lambda: markers and len(markers[-1].markers) > 3, "markers")
    assert {f"{name}: error" for name in NAMES} < {m.ns for m in markers[-1].markers}
    assert node.end(signal.SIGINT) == 0, node.output

    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert summary["ground_truth"]["received"] == len(truth)
    assert accounted(summary["ground_truth"], "used")
    for name, one in summary["estimates"].items():
        account = one["estimate"]
        assert account["received"] == len(estimates[name])
        assert accounted(account, "evaluated")
        rows = (tmp_path / "out" / name / "poses.csv").read_text(encoding="utf-8")
        assert rows.count("\n") == account["evaluated"] + 1 > 200
        last = pytest.approx(one["relative"]["log_likelihood"], rel=1e-9)
        graph.until(lambda n=name, last=last: numbers[n][-1].data == last, f"the last of {name}")
    statuses = {status.name for message in metrics for status in message.status}
    assert statuses >= {f"{name}: relative" for name in NAMES}
    pairs = {status.name: status for status in comparison[-1].status}
    assert list(pairs) == ["best_effort vs killed", "best_effort vs fast", "killed vs fast"]
    assert "best_effort's" in pairs["best_effort vs killed"].message
    values = values_of(pairs["best_effort vs killed"])
    assert values["re_translation_method"] == "block_t"
    assert float(values["re_translation_interval_high"]) < 1.0

    files = [write_tum(tmp_path / f"{n}.txt", s) for n, s in {"gt": truth, **estimates}.items()]
    settings = ["max_wait=30", "fast.extrinsic=0.1,0,0,0,0,0,1"]
    code = evaluate(
        ["tum", *map(str, files), "--output", str(tmp_path / "files"), "--quiet"]
        + [word for setting in settings for word in ("--set", setting)]
    )
    assert code == 0
    offline = json.loads((tmp_path / "files" / "summary.json").read_text(encoding="utf-8"))
    assert list(summary) == list(offline)
    assert list(summary["estimates"]) == list(offline["estimates"])
    assert_same_summary(summary["ground_truth"], offline["ground_truth"])
    for name, one in summary["estimates"].items():
        assert_same_summary(without(one), without(offline["estimates"][name]))
    for ours, theirs in zip(summary["comparison"], offline["comparison"], strict=True):
        assert_same_summary(without(ours), without(theirs))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("[a, b, a]", "estimates must have different names, got a twice"),
        ("[a, ground_truth]", "an estimate cannot be named ground_truth"),
        ("[a, metrics]", "an estimate cannot be named metrics"),
        ("[a, comparison]", "an estimate cannot be named comparison"),
        ("[a, /b]", "estimates must be named in snake_case, got '/b'"),
        ("[a, run_1]", "an estimate cannot be named run_1"),
        ("a", "estimates must be a list of strings, got 'a'"),
    ],
)
def test_wrong_names_are_refused(graph: Graph, given: str, words: str) -> None:
    node = graph.start_evaluator("-p", f"estimates:={given}")
    assert node.wait() == 2, node.output
    (line,) = [line for line in node.output.splitlines() if line.startswith("evaluator: error: ")]
    assert words in line
