# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publisher, node and subscriber as three processes: the figures are the engine's."""

from __future__ import annotations

import json
import math
import signal
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import data
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Vector3Stamped
from harness import MAX_WAIT, Graph, accounted, save_samples, values_of
from std_msgs.msg import Float64

from trajeval_ros import se3
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed
from trajeval_ros.online.samples import PoseSamples

pytestmark = pytest.mark.ros


def leaves(figures: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in figures.items():
        if isinstance(value, Mapping):
            yield from leaves(value, f"{path}{key}.")
        elif isinstance(value, list):
            yield from leaves({str(i): v for i, v in enumerate(value)}, f"{path}{key}.")
        else:
            yield f"{path}{key}", value


# How far first-order AE and RE are apart is round-off itself.
ROUND_OFF = ("consistency",)


def assert_same_figures(actual: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
    # The error model is fitted beside the engine; `test_session` compares it with a file's.
    assert actual["window"].pop("error_model")["poses"] > 40
    # What a summary says of where it comes from is not the engine's.
    of_engine = {key: value for key, value in actual.items() if key in expected}
    found, wanted = dict(leaves(of_engine)), dict(leaves(expected))
    assert found.keys() == wanted.keys()
    for path, value in wanted.items():
        if path.endswith(ROUND_OFF):
            continue
        if isinstance(value, float):
            assert found[path] == pytest.approx(value, rel=1e-9, abs=1e-12), path
        else:
            assert found[path] == value, path


def engine_on(parameters: dict[str, Any], truth: PoseSamples, estimate: PoseSamples) -> Any:
    engine = Engine(parameters)
    results = list(feed(engine, truth, estimate))
    return engine.summary(), results


def test_three_processes_and_the_figures_are_the_engines(graph: Graph, tmp_path: Path) -> None:
    truth, estimate = data.run(12.0)
    save_samples(tmp_path / "truth.npz", truth)
    save_samples(tmp_path / "estimate.npz", estimate)
    relative = graph.listen(Float64, "/evaluator/relative/log_likelihood")
    absolute = graph.listen(Float64, "/evaluator/absolute/log_likelihood")
    metrics = graph.listen(DiagnosticArray, "/evaluator/metrics")
    poses = graph.listen(PoseWithCovarianceStamped, "/evaluator/ground_truth/pose")
    errors = {
        which: graph.listen(Vector3Stamped, f"/evaluator/{which}_error")
        for which in ("relative/translation", "relative/rotation", "absolute/translation")
    }
    node = graph.start_evaluator(output__directory=str(tmp_path / "out"))
    graph.until_known()
    player = graph.start(
        str(Path(data.__file__).parent / "player.py"),
        str(tmp_path / "truth.npz"),
        str(tmp_path / "estimate.npz"),
        "1500",
    )
    assert player.wait() == 0, player.output
    graph.until_accounted("estimate", len(estimate))
    graph.until_accounted("ground_truth", len(truth))
    assert node.end(signal.SIGINT) == 0, node.output

    expected, results = engine_on({"max_wait": MAX_WAIT}, truth, estimate)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["estimate"]["received"] == len(estimate)
    assert summary["ground_truth"]["received"] == len(truth)
    assert summary.pop("likely_causes") == []
    assert_same_figures(summary, json.loads(json.dumps(expected)))
    assert accounted(summary["estimate"], "evaluated")
    assert accounted(summary["ground_truth"], "used")
    assert (tmp_path / "out" / "report.html").stat().st_size > 1000
    assert (tmp_path / "out" / "poses.csv").read_text().count("\n") == len(estimate) + 1

    evaluations = [r.evaluations for r in results if len(r.evaluations)]
    stamps = np.concatenate([e.stamps for e in evaluations])
    graph.until(lambda: len(poses) >= len(stamps), "a pose an estimate")
    graph.until(lambda: len(relative) >= len(stamps), "a log-likelihood an estimate")
    steps = len(stamps) - 1
    graph.until(lambda: all(len(e) >= steps for e in errors.values()), "errors")
    graph.until(lambda: nanoseconds(metrics[-1]) == stamps[-1], "the last metrics")
    totals = np.concatenate([e.relative_log_likelihood for e in evaluations])
    np.testing.assert_allclose([m.data for m in relative], totals, rtol=1e-9, atol=1e-9)
    assert absolute[-1].data == pytest.approx(expected["absolute"]["log_likelihood"], rel=1e-9)

    check_poses(poses, stamps, evaluations)
    check_errors(errors, stamps, evaluations)
    check_metrics(metrics, int(stamps[-1]), expected)


def check_poses(poses: list[Any], stamps: Any, evaluations: list[Any]) -> None:
    assert [nanoseconds(m) for m in poses] == stamps.tolist()
    assert {m.header.frame_id for m in poses} == {"map"}
    truth = np.concatenate([e.ground_truth for e in evaluations])
    covariance = np.concatenate([e.covariance for e in evaluations])
    np.testing.assert_allclose(
        [[m.pose.pose.position.x, m.pose.pose.position.y, m.pose.pose.position.z] for m in poses],
        truth[:, :3, 3],
        rtol=1e-9,
    )
    published = np.array([m.pose.covariance for m in poses]).reshape(-1, 6, 6)
    expected = se3.covariance_to_fixed_axes(covariance, truth)
    np.testing.assert_allclose(published, expected, rtol=1e-6, atol=1e-12 * expected.max())


def check_errors(errors: dict[str, list[Any]], stamps: Any, evaluations: list[Any]) -> None:
    steps = np.concatenate([e.relative_error for e in evaluations])
    for which, columns in (
        ("relative/translation", slice(0, 3)),
        ("relative/rotation", slice(3, 6)),
    ):
        heard = errors[which]
        # The first pose ends no step.
        assert [nanoseconds(m) for m in heard] == stamps[1:].tolist()
        vectors = [[m.vector.x, m.vector.y, m.vector.z] for m in heard]
        np.testing.assert_allclose(vectors, steps[1:, columns], rtol=1e-7, atol=1e-12)
    assert nanoseconds(errors["absolute/translation"][0]) == stamps[0]


def check_metrics(metrics: list[Any], newest: int, expected: dict[str, Any]) -> None:
    last = metrics[-1]
    assert nanoseconds(last) == newest
    statuses = {status.name: values_of(status) for status in last.status}
    names = ["relative", "absolute", "window", "conventional", "coverage"]
    # Some seconds later, once there has been time for a fit.
    assert list(statuses) in (names, [*names, "error_model"])
    for name, key, figure in (
        ("relative", "log_likelihood", expected["relative"]["log_likelihood"]),
        ("relative", "chi2_per_dof", expected["relative"]["chi2_per_dof"]),
        ("absolute", "log_likelihood", expected["absolute"]["log_likelihood"]),
        ("absolute", "alignment_x", expected["absolute"]["alignment"]["pose"][0]),
        ("window", "relative_chi2", expected["window"]["relative"]["chi2"]),
        ("conventional", "ate_translation_rmse", expected["conventional"]["ate_translation_rmse"]),
        ("coverage", "time", expected["coverage"]["time"]),
        ("coverage", "path_length", expected["coverage"]["path_length"]),
    ):
        assert float(statuses[name][key]) == pytest.approx(figure, rel=1e-9), (name, key)
    numbers = [v for name, values in statuses.items() for v in values.values() if is_number(v)]
    assert all(math.isfinite(float(number)) for number in numbers)


def is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def nanoseconds(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


@pytest.mark.parametrize(
    ("delays", "rate"),
    [((0.0, 7.2), 3000.0), ((7.2, 0.0), 3000.0), ((0.3, 0.0), 600.0)],
    ids=["estimate late", "ground truth late", "slow"],
)
def test_the_order_of_arrival_does_not_matter(
    graph: Graph, tmp_path: Path, delays: tuple[float, float], rate: float
) -> None:
    """The topics delayed against each other by up to max_wait, at several speeds."""
    truth, estimate = data.run(10.0)
    out = tmp_path / "out"
    parameters = {"gauge": "yaw_translation", "max_wait": 8.0}
    node = graph.start_evaluator(output__directory=str(out), **parameters)
    publishers = [graph.publisher(topic) for topic in ("ground_truth", "estimate")]
    graph.until_heard(*publishers)
    streams = [data.messages(PoseStamped, each) for each in (truth, estimate)]
    data.publish_in_order(publishers, streams, rate, delays)
    graph.until_accounted("estimate", len(estimate))
    graph.until_accounted("ground_truth", len(truth))
    assert node.end() == 0
    expected, _ = engine_on(parameters, truth, estimate)
    summary = json.loads((out / "summary.json").read_text())
    assert summary.pop("likely_causes") == []
    assert_same_figures(summary, json.loads(json.dumps(expected)))
    assert summary["estimate"]["evaluated"] == len(estimate)
