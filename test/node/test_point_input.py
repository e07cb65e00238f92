# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ground truth without orientation, over DDS: a total station's points, and GNSS fixes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import data
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped, Vector3Stamped
from harness import Graph, accounted, values_of
from sensor_msgs.msg import NavSatFix, NavSatStatus
from std_msgs.msg import Float64

import trajeval_ros as te
from trajeval_ros import se3
from trajeval_ros.online.samples import PoseSamples

pytestmark = pytest.mark.ros
FIXED = {"gp__hyperparameters": "fixed"}
TRUTH, ESTIMATE = data.run(8.0)


def points(samples: PoseSamples) -> list[PointStamped]:
    """The positions alone."""
    made = []
    for stamped in data.messages(PoseStamped, samples):
        point = PointStamped(header=stamped.header)
        position = stamped.pose.position
        point.point.x, point.point.y, point.point.z = position.x, position.y, position.z
        made.append(point)
    return made


def fixes(samples: PoseSamples) -> list[NavSatFix]:
    """The positions about a place, and at the end a message without a fix."""
    pyproj = pytest.importorskip("pyproj")
    back = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +inv +proj=topocentric +ellps=WGS84 +lon_0=8.5 +lat_0=47.3 +h_0=400"
        " +step +inv +proj=cart +ellps=WGS84 +step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    made = []
    for stamped in data.messages(PoseStamped, samples):
        position = stamped.pose.position
        fix = NavSatFix(header=stamped.header)
        fix.longitude, fix.latitude, fix.altitude = back.transform(
            position.x, position.y, position.z
        )
        fix.status.status = NavSatStatus.STATUS_GBAS_FIX
        fix.position_covariance = np.diag([4e-4, 4e-4, 1e-3]).ravel()
        fix.position_covariance_type = NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN
        made.append(fix)
    made[-1].status.status = NavSatStatus.STATUS_NO_FIX
    return made


@pytest.mark.parametrize(("made", "kind"), [(points, PointStamped), (fixes, NavSatFix)])
def test_positions_are_evaluated_and_orientations_are_absent(
    made: Callable[[PoseSamples], list[Any]], kind: Any, graph: Graph, tmp_path: Path
) -> None:
    sent = made(TRUTH)
    graph.start_evaluator(**FIXED, output__directory=str(tmp_path / "out"))
    truth, estimate = graph.publisher("ground_truth", kind), graph.publisher("estimate")
    errors = graph.listen(Vector3Stamped, "/evaluator/relative/rotation_error")
    steps = graph.listen(Vector3Stamped, "/evaluator/relative/translation_error")
    metrics = graph.listen(DiagnosticArray, "/evaluator/metrics")
    likelihoods = graph.listen(Float64, "/evaluator/relative/log_likelihood")
    graph.until_heard(truth, estimate)
    data.publish_in_order(
        (truth, estimate), (sent, data.messages(PoseStamped, ESTIMATE)), 1000.0, (0.0, 0.0)
    )
    graph.until_accounted("ground_truth", len(TRUTH))
    graph.until_accounted("estimate", len(ESTIMATE))
    assert graph.call("/evaluator/save").success
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert accounted(summary["estimate"], "evaluated")
    assert accounted(summary["ground_truth"], "used")
    assert summary["position_only"] is True
    for name in ("ate_rotation_rmse", "re_translation_rmse", "re_rotation_rmse"):
        assert summary["conventional"][name] is None
    told = of_files()
    assert summary["absolute"]["consistency"] < 1e-9
    if kind is PointStamped:
        for part in ("relative", "absolute"):
            for key in ("log_likelihood", "chi2", "translation_rmse"):
                assert summary[part][key] == pytest.approx(told[part][key], rel=1e-9)
                of_window = summary["window"][part].get(key)
                assert of_window == pytest.approx(told["window"][part].get(key), rel=1e-9)
            assert summary[part]["rotation_rmse"] is None
        assert summary["lever_arm"]["value"] == pytest.approx(told["lever_arm"]["value"], abs=1e-9)
    assert summary["error_model"]["model"] in ("drift", "wander")
    assert "rotation" not in summary["error_model"]
    likelihood = pytest.approx(summary["relative"]["log_likelihood"], rel=1e-6)
    graph.until(lambda: likelihoods and likelihoods[-1].data == likelihood, "the last likelihood")
    fewest = 0.8 * summary["estimate"]["evaluated"]
    graph.until(lambda: len(steps) > fewest, "an error a step")
    lever_arm = pytest.approx(summary["lever_arm"]["value"][0])

    def absolute() -> dict[str, str]:
        statuses = {each.name: values_of(each) for each in metrics[-1].status}
        return statuses["absolute"]

    graph.until(lambda: metrics and float(absolute()["lever_arm_x"]) == lever_arm, "the lever arm")
    assert "rotation_rmse" not in absolute()
    assert all(cause["code"] != "constant_orientation" for cause in summary["likely_causes"])
    assert not errors
    if kind is PointStamped:
        found = summary["conventional"]["ate_translation_rmse"]
        assert found == pytest.approx(told["conventional"]["ate_translation_rmse"], rel=1e-9)
    else:
        # The ellipsoid's metres are those that were put in, about the first fix.
        assert summary["ground_truth"]["rejected"] == {"non_finite": 1}
        fixes = {k: n for k, n in summary["ground_truth"]["fixes"].items() if n}
        assert fixes == {"fixed": len(TRUTH) - 1, "none": 1}
        health = values_of(graph.health()["ground truth"])
        assert health["fixes_fixed"] == str(len(TRUTH) - 1)
        assert "RTK fixed" in health["fixes"]
        found = summary["conventional"]["ate_translation_rmse"]
        assert found == pytest.approx(told["conventional"]["ate_translation_rmse"], rel=1e-2)


def test_a_topic_that_has_orientations_now_begins_another_run(graph: Graph, tmp_path: Path) -> None:
    """And one that has none any more; what was evaluated is kept."""
    process = graph.start_evaluator(**FIXED, output__directory=str(tmp_path / "out"))
    estimate = graph.publisher("estimate")
    poses = data.messages(PoseStamped, ESTIMATE)
    unturned = data.messages(PoseStamped, TRUTH)
    for each in unturned:
        each.pose.orientation.w = each.pose.orientation.x = 0.0
        each.pose.orientation.y = each.pose.orientation.z = 0.0
    half = len(TRUTH) // 2
    middle = sum(stamp < TRUTH.stamps[half] for stamp in ESTIMATE.stamps)
    first = graph.publisher("ground_truth")
    graph.until_heard(first, estimate)
    for publisher, messages in ((estimate, poses[:middle]), (first, unturned[:half])):
        for each in messages:
            publisher.publish(each)
    graph.until_accounted("ground_truth", half)
    graph.until_accounted("estimate", middle)
    for publisher, messages in (
        (first, data.messages(PoseStamped, TRUTH)[half:]),
        (estimate, poses[middle:]),
    ):
        for each in messages:
            publisher.publish(each)
    graph.until_accounted("ground_truth", len(TRUTH) - half)
    graph.until_accounted("estimate", len(poses) - middle)
    assert graph.call("/evaluator/save").success
    assert "/ground_truth has an orientation now: starting over" in process.output
    folders = (tmp_path / "out" / "run_1", tmp_path / "out")
    runs = [json.loads((folder / "summary.json").read_text()) for folder in folders]
    assert runs[0]["position_only"] is True
    assert runs[0]["lever_arm"] is not None or runs[0]["conventional"]["poses"] > 0
    assert "position_only" not in runs[1]
    assert runs[1]["conventional"]["ate_rotation_rmse"] is not None
    # A wrong one among those that have one is a wrong one.
    first.publish(unturned[-1])
    graph.until_accounted("ground_truth", len(TRUTH) - half + 1)
    assert values_of(graph.health()["ground truth"])["rejected_zero_quaternion"] == "1"


def of_files() -> dict[str, Any]:
    """The summary of the same positions without a node."""
    identity = np.tile([0.0, 0.0, 0.0, 1.0], (len(TRUTH), 1))
    poses = [
        se3.from_position_quaternion(TRUTH.positions, identity),
        se3.from_position_quaternion(ESTIMATE.positions, ESTIMATE.quaternions),
    ]
    truth, estimate = (
        te.Trajectory(stamps, each)
        for stamps, each in zip((TRUTH.stamps, ESTIMATE.stamps), poses, strict=True)
    )
    return te.evaluate(truth, estimate, gp_hyperparameters="fixed").summary
