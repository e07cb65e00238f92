# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An estimate that is a Path, over DDS: as it comes, and after its corrections."""

from __future__ import annotations

import json
from pathlib import Path

import data
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from harness import Graph, accounted, values_of
from nav_msgs.msg import Path as PathMessage
from twins.runs import assert_same_summary

from trajeval_ros import se3
from trajeval_ros.online.samples import PoseSamples

pytestmark = pytest.mark.ros
FIXED = {"gp__hyperparameters": "fixed"}
TRUTH, ESTIMATE = data.run(6.0)
POSES = se3.from_position_quaternion(ESTIMATE.positions, ESTIMATE.quaternions)
TWIST = np.array([0.1, 0.0, 0.02, 0.0, 0.01, 0.1])
DRIFT = se3.exp(((ESTIMATE.stamps - ESTIMATE.stamps[0]) / 1e9)[:, None] * TWIST)
DRIFTED = PoseSamples(ESTIMATE.stamps, *se3.to_position_quaternion(DRIFT @ POSES))


def paths(every: int, last: PoseSamples) -> list[PathMessage]:
    """Each drifted pose in its turn, ``every`` so many of them new; at the end the ``last``."""
    poses = data.messages(PoseStamped, DRIFTED)
    made = [
        PathMessage(header=poses[n - 1].header, poses=poses[:n])
        for n in range(every, len(poses), every)
    ]
    corrected = data.messages(PoseStamped, last)
    return [*made, PathMessage(header=corrected[-1].header, poses=corrected)]


def test_loop_closure_shows(graph: Graph, tmp_path: Path) -> None:
    """Online the figures are those of the poses as they came; the latest path is scored beside."""
    graph.start_evaluator(
        **FIXED, estimates=["poses", "path"], output__directory=str(tmp_path / "out")
    )
    truth, poses = graph.publisher("ground_truth"), graph.publisher("poses")
    path = graph.publisher("path", PathMessage)
    metrics = graph.listen(DiagnosticArray, "/evaluator/metrics")
    graph.until_heard(truth, poses, path)
    # The very last message is all that the last poses are known by, corrected ones.
    made = paths(5, ESTIMATE)
    new = (len(ESTIMATE) - 1) // 5 * 5
    online = PoseSamples(
        ESTIMATE.stamps,
        np.concatenate([DRIFTED.positions[:new], ESTIMATE.positions[new:]]),
        np.concatenate([DRIFTED.quaternions[:new], ESTIMATE.quaternions[new:]]),
    )
    streams = (data.messages(PoseStamped, TRUTH), data.messages(PoseStamped, online), made)
    data.publish_in_order((truth, poses, path), streams, 1000.0, (0.0, 0.0, 0.0))
    values = graph.until_accounted("path", len(ESTIMATE))
    assert int(values["received"]) == len(ESTIMATE)
    graph.until_accounted("poses", len(ESTIMATE))
    graph.until_accounted("ground_truth", len(TRUTH))

    def said() -> bool:
        return "after closure" in values_of(graph.health()["path"]).get("latest_path", "")

    graph.until(said, "the latest path in the diagnostics")
    assert graph.call("/evaluator/save").success
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    found = summary["estimates"]["path"]
    assert accounted(found["estimate"], "evaluated")
    assert_same_summary(found["estimate"], summary["estimates"]["poses"]["estimate"])
    assert found["relative"] == pytest.approx(summary["estimates"]["poses"]["relative"], rel=1e-9)
    latest = found["latest_path"]
    assert latest["poses"] == len(ESTIMATE)
    assert latest["scored"] == found["estimate"]["evaluated"]
    assert latest["ate_translation_rmse"] < 0.05 < latest["online"]["ate_translation_rmse"]
    assert "latest_path" not in summary["estimates"]["poses"]
    assert (tmp_path / "out" / "path" / "latest_path.txt").exists()
    assert not (tmp_path / "out" / "poses" / "latest_path.txt").exists()

    def on_metrics() -> float | None:
        names = {status.name: status for message in metrics for status in message.status}
        status = names.get("path: latest_path")
        return None if status is None else float(values_of(status)["ate_translation_rmse"])

    graph.until(on_metrics, "a status of the latest path")


def test_paths_without_stamps_are_an_error_and_the_last_pose_counts(graph: Graph) -> None:
    graph.start_evaluator(**FIXED)
    path = graph.publisher("estimate", PathMessage)
    graph.until_heard(path)
    for number, stamped in enumerate(data.messages(PoseStamped, ESTIMATE[:5]), 1):
        poses = [PoseStamped(pose=stamped.pose) for _ in range(number)]
        path.publish(PathMessage(header=stamped.header, poses=poses))
    graph.until_health("estimate", "the poses of the paths have no stamps", level=2)
    assert int(graph.until_accounted("estimate", 5)["received"]) == 5
