# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The health checks and the flat figures, on values alone."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.ground_truth.hyperparameters import (
    Component,
    GroupHyperparameters,
    Hyperparameters,
)
from trajeval_ros.node.diagnostics import (
    ClockState,
    Finding,
    Level,
    Load,
    Traffic,
    check_clock,
    check_consistency,
    check_performance,
    check_synchronization,
    check_topic,
    merge,
)
from trajeval_ros.node.discovery import Endpoint, Offer, Plan
from trajeval_ros.node.inputs import InputState
from trajeval_ros.online.parameters import PARAMETERS
from trajeval_ros.online.results import Health, TopicHealth
from trajeval_ros.runs.statuses import STATUSES, flatten

SECOND = 1_000_000_000
NOW = 1_700_000_000 * SECOND

SLAM = Endpoint("/slam", "geometry_msgs/msg/PoseStamped", "reliable", "volatile")
HEARD = Plan(Offer("PoseStamped", "reliable", "volatile"), ())
INPUT = InputState("/estimate", (SLAM,), HEARD, lost=0, frame_changes=0)
TOPIC = TopicHealth(10, 7, 1, {"non_finite": 2}, NOW, NOW + 5 * SECOND)
TRAFFIC = Traffic(rate=20.0, silence=0.05, rejected={}, lost=0, frame_changes=0)
HEALTH = Health(TOPIC, TOPIC, None, 0, None)
CLOCK = ClockState(False, NOW + 5 * SECOND, 0, 0.0, 0, 0)


def test_merge_takes_the_worst_level_and_says_the_worst_first() -> None:
    findings = [Finding(Level.WARN, "a"), Finding(Level.ERROR, "b")]
    status = merge("name", findings, "fine", {"x": 0.1, "none": None, "n": 3})
    assert (status.level, status.message) == (Level.ERROR, "b; a")
    assert status.values == {"x": "0.1", "n": "3"}
    assert merge("name", [], "fine", {}).level == Level.OK


def test_a_good_topic_accounts_for_its_messages() -> None:
    status = check_topic("estimate", INPUT, TOPIC, TRAFFIC, "evaluated")
    assert (status.level, status.message) == (Level.OK, "20.0 messages/s")
    values = {key: status.values[key] for key in ("received", "evaluated", "pending", "rejected")}
    assert values == {"received": "10", "evaluated": "7", "pending": "1", "rejected": "2"}
    assert status.values["rejected_non_finite"] == "2"


@pytest.mark.parametrize(
    ("state", "traffic", "level", "words"),
    [
        (replace(INPUT, publishers=()), replace(TRAFFIC, silence=None), 1, "no publisher"),
        (replace(INPUT, publishers=()), TRAFFIC, 1, "its publisher is gone"),
        (INPUT, replace(TRAFFIC, silence=None), 1, "a publisher, but no message yet"),
        (INPUT, replace(TRAFFIC, silence=7.2), 1, "no message for 7 s"),
        (replace(INPUT, publishers=(SLAM, SLAM)), TRAFFIC, 1, "2 publishers (/slam) are mixed"),
        (INPUT, replace(TRAFFIC, lost=4), 1, "4 messages lost on the way"),
        (INPUT, replace(TRAFFIC, rejected={"zero_stamp": 1}), 1, "rejected in the last second: 1"),
        (replace(INPUT, plan=Plan(None, ("a problem",))), TRAFFIC, 2, "a problem"),
        (INPUT, replace(TRAFFIC, rejected={"undecodable": 3}), 2, "3 messages are not readable"),
        (INPUT, replace(TRAFFIC, frame_changes=2), 1, "frame_id changed 2 times"),
    ],
)
def test_what_is_wrong_with_a_topic(
    state: InputState, traffic: Traffic, level: int, words: str
) -> None:
    status = check_topic("estimate", state, TOPIC, traffic, "evaluated")
    assert status.level == level
    assert words in status.message


def test_what_is_over_is_in_the_values_alone() -> None:
    topic = replace(TOPIC, rejected={"undecodable": 2})
    status = check_topic("estimate", replace(INPUT, frame_changes=3), topic, TRAFFIC, "evaluated")
    assert (status.level, status.message) == (Level.OK, "20.0 messages/s")
    assert status.values["rejected_undecodable"] == "2"
    assert status.values["frame_changes"] == "3"


def at(begin: float, end: float, used: int = 0) -> TopicHealth:
    return TopicHealth(10, used, 0, {}, NOW + round(begin * SECOND), NOW + round(end * SECOND))


@pytest.mark.parametrize(
    ("estimate", "truth", "level", "words"),
    [
        (at(0, 5), at(0, 5), 0, "overlap"),
        (at(0, 5), at(-3600, -1800), 2, "no overlap"),
        (at(-3600, -1800), at(0, 5), 2, "no overlap"),
        # Once evaluated, they did overlap; now the ground truth is missing.
        (at(0, 50, used=3), at(0, 20), 1, "ends 30.0 s before the newest estimate"),
        # The ground truth has not come yet: that is what max_wait is for.
        (at(0, 5), at(0, 4), 0, "overlap"),
    ],
)
def test_synchronization(estimate: TopicHealth, truth: TopicHealth, level: int, words: str) -> None:
    health = Health(estimate, truth, None, 0, None)
    status = check_synchronization(health, 0, 2 * SECOND)
    assert status.level == level
    assert words in status.message


def test_the_time_offset_counts() -> None:
    health = Health(at(3600, 3605), at(0, 5), None, 0, None)
    assert check_synchronization(health, 0, SECOND).level == Level.ERROR
    assert check_synchronization(health, -3600 * SECOND, SECOND).level == Level.OK


def test_synchronization_waits_for_whom_it_misses() -> None:
    silent = TopicHealth(0, 0, 0, {}, None, None)
    status = check_synchronization(Health(silent, at(0, 5), None, 0, None), 0, SECOND)
    assert status.message == "waiting for estimate"


@pytest.mark.parametrize(
    ("clock", "level", "words"),
    [
        (CLOCK, 0, "running"),
        (replace(CLOCK, use_sim_time=True, now=None), 1, "waiting for /clock, which nobody"),
        (replace(CLOCK, use_sim_time=True, now=None, publishers=1), 1, "waiting for /clock"),
        (replace(CLOCK, use_sim_time=True, stands_still=9.0), 1, "/clock stands still for 9 s"),
        (replace(CLOCK, now=NOW + 1000 * SECOND), 1, "995 s behind the clock"),
        (replace(CLOCK, now=NOW - 1000 * SECOND), 1, "1005 s ahead of the clock"),
    ],
)
def test_clock(clock: ClockState, level: int, words: str) -> None:
    status = check_clock(clock, [HEALTH])
    assert status.level == level
    assert words in status.message


def test_consistency() -> None:
    assert "learning" in check_consistency(HEALTH).message
    assert check_consistency(HEALTH._replace(consistency=1e-12)).level == Level.OK
    assert check_consistency(HEALTH._replace(consistency=1e-3)).level == Level.WARN


def test_learned_hyperparameters_are_given_by_the_names_of_the_parameters() -> None:
    group = GroupHyperparameters((Component(0.1, 2.0), Component(0.2, 3.0)), 1e-3)
    status = check_consistency(HEALTH._replace(hyperparameters=Hyperparameters(group, group)))
    values = {name: value for name, value in status.values.items() if name.startswith("gp.")}
    assert set(values) <= set(PARAMETERS)
    assert values["gp.translation.signal_std"] == "0.1"
    assert values["gp.translation.smooth_length_scale"] == "3.0"
    assert values["gp.rotation.noise_std"] == "0.001"


def test_likely_causes_are_said_with_evidence_and_advice() -> None:
    causes = (
        Cause("millimetres", "the estimate is in millimetres: ...", "divide by 1000"),
        Cause("clock_offset", "the estimate's clock is off", "set estimate.time_offset=0.1"),
    )
    status = check_consistency(HEALTH, causes)
    assert status.level == Level.WARN
    assert status.message == (
        "likely cause: the estimate is in millimetres: .... To try: divide by 1000.; "
        "likely cause: the estimate's clock is off. To try: set estimate.time_offset=0.1."
    )
    assert status.values["likely_cause_millimetres"] == causes[0].text
    assert status.values["advice_clock_offset"] == causes[1].advice


def test_performance() -> None:
    load = Load(processor=0.2, longest_batch=0.01, evaluated_rate=20.0, output_error=None)
    assert check_performance(load).message == "20 % of a core"
    assert check_performance(replace(load, processor=0.97)).level == Level.WARN
    assert check_performance(replace(load, output_error="no room")).message == "no room"


def test_flat_figures() -> None:
    alignment = {"pose": [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0], "scale": None, "covariance": None}
    summary = {
        "estimate": {"received": 3},
        "gauge": "se3",
        "relative": {"chi2": 0.1, "dof": 6, "log_likelihood": None, "log_det": math.inf},
        "absolute": {"alignment": alignment, "unobserved_axes": [[1.0]]},
        "window": {"poses": 2, "relative": {"chi2": 1e-300}, "absolute": {"ending": "converged"}},
        "conventional": {"re_unit": "s", "distributions": {"ate_translation": {"max": 1.0}}},
        "coverage": {"time": 0.5, "longest_loss": {"duration": 2.5}},
    }
    flat = flatten(summary)
    assert tuple(flat) == STATUSES
    assert flat["conventional"] == {"re_unit": "s"}
    assert flat["coverage"] == {"time": "0.5", "longest_loss_duration": "2.5"}
    assert flat["relative"] == {"chi2": "0.1", "dof": "6.0"}
    assert flat["absolute"]["alignment_qw"] == "1.0"
    assert "alignment_scale" not in flat["absolute"]
    assert "unobserved_axes" not in flat["absolute"]
    assert flat["window"] == {
        "poses": "2.0",
        "relative_chi2": "1e-300",
        "absolute_ending": "converged",
    }
