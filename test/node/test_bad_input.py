# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whatever arrives, the node lives, is right afterwards, and accounts for every message."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import data
import pytest
from geometry_msgs.msg import PoseStamped
from harness import Graph, Process, accounted, values_of
from rclpy.serialization import serialize_message

from trajeval_ros.commands.domain import own_domain

pytestmark = pytest.mark.ros

DURATION = 5.0
Messages = list[Any]
Spoil = Callable[[Messages], dict[str, int]]


class Rig:
    """One node for all of the tests below: each begins with a reset."""

    def __init__(self, folder: Path, graph: Graph) -> None:
        self.graph = graph
        self.out = folder / "out"
        self.node: Process = graph.start_evaluator(
            output__directory=str(self.out), gp__hyperparameters="fixed", max_wait=1.0
        )
        self.publishers = [graph.publisher(topic) for topic in ("ground_truth", "estimate")]
        graph.until_heard(*self.publishers)
        # Fewer messages than shared memory has room for: what does not find any comes 3 s later.
        truth, estimate = data.run(DURATION, ground_truth_rate=60.0)
        self.sizes = (len(truth), len(estimate))
        self.samples = (truth, estimate)

    def messages(self) -> tuple[Messages, Messages]:
        truth, estimate = (data.messages(PoseStamped, each) for each in self.samples)
        return truth, estimate

    def play(self, truth: Messages, estimate: Messages) -> dict[str, Any]:
        """Publish, wait until all has been received, save, and check the accounts."""
        assert self.graph.call("/evaluator/reset").success
        # In the order of the lists, two topics interleaved, whatever the stamps are.
        longest = max(len(truth), len(estimate), 1)
        for k in range(longest):
            for publisher, stream in zip(self.publishers, (truth, estimate), strict=True):
                begin, end = (i * len(stream) // longest for i in (k, k + 1))
                for message in stream[begin:end]:
                    publisher.publish(message)
            if k % 20 == 0:
                self.graph.spin(0.005)
        return self.accounts(len(truth), len(estimate))

    def accounts(self, truth: int, estimate: int) -> dict[str, Any]:
        """Wait until all has been received, and return a summary with which diagnostics agree."""

        def saved() -> dict[str, Any] | None:
            before = self.graph.health()
            assert self.graph.call("/evaluator/save").success
            summary = json.loads((self.out / "summary.json").read_text(encoding="utf-8"))
            counts = (summary["ground_truth"]["received"], summary["estimate"]["received"])
            same = agree(before, summary)
            return summary if counts == (truth, estimate) and same else None

        summary = self.graph.until(saved, f"{truth} and {estimate} received")
        assert accounted(summary["estimate"], "evaluated")
        account = summary["ground_truth"]
        held = account["received"] - account["used"] - sum(account["rejected"].values())
        assert held in (0, 1)
        assert self.node.child.poll() is None
        return summary


def agree(health: dict[str, Any], summary: dict[str, Any]) -> bool:
    """Whether diagnostics and summary.json have the same accounts."""
    if not health:
        return False
    for topic, used in (("ground_truth", "used"), ("estimate", "evaluated")):
        values = values_of(health[topic.replace("_", " ")])
        account = summary[topic]
        rejected = {
            key.removeprefix("rejected_"): int(value)
            for key, value in values.items()
            if key.startswith("rejected_")
        }
        if (int(values["received"]), int(values[used]), rejected) != (
            account["received"],
            account[used],
            account["rejected"],
        ):
            return False
    return True


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    folder = tmp_path_factory.mktemp("bad_input")
    with own_domain() as domain:
        graph = Graph(domain, folder)
        yield Rig(folder, graph)
        graph.close()


@pytest.fixture
def rig(started: Rig) -> Rig:
    assert started.node.child.poll() is None, started.node.output
    return started


def evaluated(rig: Rig) -> int:
    """How many of the estimates are evaluated before the end of a good run."""
    lag = 0.3
    newest = int(rig.samples[0].stamps[-1]) - round(lag * 1e9)
    return int((rig.samples[1].stamps <= newest).sum())


def test_a_good_run(rig: Rig) -> None:
    summary = rig.play(*rig.messages())
    assert summary["estimate"]["rejected"] == {}
    assert summary["estimate"]["evaluated"] == evaluated(rig)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("topic", [0, 1])
def test_not_finite_anywhere(rig: Rig, topic: int, value: float) -> None:
    streams = rig.messages()
    fields = (
        lambda m: setattr(m.pose.position, "x", value),
        lambda m: setattr(m.pose.position, "z", value),
        lambda m: setattr(m.pose.orientation, "w", value),
    )
    for k, spoil in enumerate(fields):
        spoil(streams[topic][20 + 3 * k])
    summary = rig.play(*streams)
    rejected = summary[("ground_truth", "estimate")[topic]]["rejected"]
    assert rejected == {"non_finite": 3}
    assert summary["estimate"]["evaluated"] == evaluated(rig) - (3 if topic else 0)


@pytest.mark.parametrize("topic", [0, 1])
def test_quaternions_and_huge_values(rig: Rig, topic: int) -> None:
    streams = rig.messages()
    stream = streams[topic]
    stream[10].pose.orientation.x = 5.0
    orientation = stream[12].pose.orientation
    orientation.x = orientation.y = orientation.z = orientation.w = 0.0
    stream[14].pose.position.y = 1e300
    summary = rig.play(*streams)
    rejected = summary[("ground_truth", "estimate")[topic]]["rejected"]
    assert rejected == {
        "unnormalized_quaternion": 1,
        "zero_quaternion": 1,
        "implausible_position": 1,
    }


def set_stamp(message: Any, stamp: int) -> None:
    message.header.stamp = data.stamp_message(stamp)


def test_stamps_zero_negative_future_repeated_out_of_order(rig: Rig) -> None:
    truth, estimate = rig.messages()
    stamps = rig.samples[1].stamps.tolist()
    set_stamp(estimate[20], 0)
    set_stamp(estimate[25], -5 * data.SECOND)
    set_stamp(estimate[30], stamps[30] + 365 * 86_400 * data.SECOND)
    set_stamp(estimate[35], stamps[34])
    # Later than max_wait: at 20 Hz it is 20 poses.
    estimate.insert(70, estimate.pop(40))
    summary = rig.play(truth, estimate)
    rejected = summary["estimate"]["rejected"]
    assert sum(rejected.values()) == 5
    assert rejected["duplicate_stamp"] == 1
    assert rejected["stamp_jump"] == 1
    assert summary["estimate"]["evaluated"] == evaluated(rig) - 5


def test_ground_truth_a_year_apart(rig: Rig) -> None:
    truth, estimate = rig.messages()
    for message, stamp in zip(truth, rig.samples[0].stamps.tolist(), strict=True):
        set_stamp(message, stamp - 365 * 86_400 * data.SECOND)
    summary = rig.play(truth, estimate)
    assert summary["estimate"]["evaluated"] == 0
    rig.graph.until_health("synchronization", "no overlap", level=2)


def test_frames_empty_and_changing(rig: Rig) -> None:
    truth, estimate = rig.messages()
    for k, message in enumerate(estimate):
        message.header.frame_id = ("map", "", "odom", "m" * 300)[k % 4]
    summary = rig.play(truth, estimate)
    assert summary["estimate"]["evaluated"] == evaluated(rig)
    changes = values_of(rig.graph.health()["estimate"])["frame_changes"]
    assert changes == str(len(estimate) - 1)
    # Said while it lasts.
    rig.graph.until_health("estimate", "messages/s", level=0)
    assert rig.graph.call("/evaluator/reset").success
    rig.graph.until(
        lambda: values_of(rig.graph.health()["estimate"])["frame_changes"] == "0", "a new count"
    )


def test_bytes_that_are_no_message(rig: Rig) -> None:
    truth, estimate = rig.messages()
    for k in (20, 30):
        estimate[k] = serialize_message(estimate[k])[:40]
    truth[50] = serialize_message(truth[50])[:40]
    summary = rig.play(truth, estimate)
    assert summary["estimate"]["rejected"] == {"undecodable": 2}
    assert summary["ground_truth"]["rejected"] == {"undecodable": 1}
    assert summary["estimate"]["evaluated"] == evaluated(rig) - 2
    # Over: no error any more.
    rig.graph.until_health("estimate", "messages/s", level=0)


def test_a_likely_cause_is_said_while_the_run_goes_on(rig: Rig) -> None:
    truth, estimate = rig.messages()
    for message in estimate:
        turned = message.pose.orientation
        turned.x, turned.y, turned.z, turned.w = turned.w, turned.x, turned.y, turned.z
    rig.play(truth, estimate)
    status = rig.graph.until_health("consistency", "in the order w x y z", level=1)
    values = values_of(status)
    assert "deg as it stands" in values["likely_cause_quaternion_order"]
    assert values["advice_quaternion_order"] == "write the estimate's quaternions as x y z w"
    rig.graph.until(lambda: "likely cause: the estimate's" in rig.node.output, "a line in the log")
    # Mended: saving looks for causes again, and the diagnostics after it say what it found.
    assert rig.play(*rig.messages())["likely_causes"] == []
    rig.graph.received["/diagnostics"].clear()
    status = rig.graph.until_health("consistency", "agrees with itself", level=0)
    assert not [key for key in values_of(status) if key.startswith(("likely_cause", "advice"))]


def test_a_likely_cause_that_no_longer_holds_is_withdrawn_in_the_log(rig: Rig) -> None:
    truth, estimate = rig.messages()
    for message in estimate[:60]:
        turned = message.pose.orientation
        turned.x, turned.y, turned.z, turned.w = 0.0, 0.0, 0.0, 1.0
    rig.play(truth, estimate[:60])
    said = "the estimate's orientation never changes"
    rig.graph.until(lambda: f"likely cause: {said}" in rig.node.output, "a cause in the log")
    withdrawn = f"no longer a likely cause: {said}"
    assert withdrawn not in rig.node.output
    for message in estimate[60:]:
        rig.publishers[1].publish(message)
    rig.graph.until(lambda: withdrawn in rig.node.output, "its withdrawal")


@pytest.mark.parametrize("alone", ["ground_truth", "estimate"])
def test_one_topic_only(rig: Rig, alone: str) -> None:
    truth, estimate = rig.messages()
    summary = rig.play(*((truth, []) if alone == "ground_truth" else ([], estimate)))
    assert summary["estimate"]["evaluated"] == 0
    missing = "estimate" if alone == "ground_truth" else "ground truth"
    rig.graph.until_health("synchronization", f"waiting for {missing}")


def test_a_burst_of_ten_thousand(rig: Rig) -> None:
    """Received and lost make up what was sent, and what was received is accounted for."""
    assert rig.graph.call("/evaluator/reset").success
    truth, _ = data.run(100.0)
    messages = data.messages(PoseStamped, truth)
    assert len(messages) == 10_000
    before = int(values_of(rig.graph.health()["ground truth"])["lost"])
    for message in messages:
        rig.publishers[0].publish(message)

    def complete() -> bool:
        values = values_of(rig.graph.health()["ground truth"])
        lost = int(values["lost"]) - before
        return int(values["received"]) + lost == len(messages)

    rig.graph.until(complete, "all received or counted as lost")
    values = values_of(rig.graph.health()["ground truth"])
    rig.accounts(int(values["received"]), 0)


def test_the_estimate_jumps_and_restarts_at_the_origin(rig: Rig) -> None:
    truth, estimate = rig.messages()
    for message in estimate[40:60]:
        message.pose.position.x += 100.0
    for message in estimate[60:]:
        message.pose.position.x = message.pose.position.y = message.pose.position.z = 0.0
    summary = rig.play(truth, estimate)
    assert summary["estimate"]["evaluated"] == evaluated(rig)
    assert summary["relative"]["translation_rmse"] > 1.0


def test_ground_truth_lost_for_a_minute(rig: Rig) -> None:
    truth, estimate = data.run(70.0, ground_truth_rate=50.0)
    streams = [data.messages(PoseStamped, each) for each in (truth, estimate)]
    seconds = (truth.stamps - data.START) / 1e9
    kept = [m for m, t in zip(streams[0], seconds, strict=True) if not 4.0 < t < 64.0]
    summary = rig.play(kept, streams[1])
    lost = summary["estimate"]["rejected"]["no_ground_truth"]
    assert 0.9 < lost / (58.0 * 20) < 1.1
    assert summary["estimate"]["evaluated"] > 100


def test_a_good_run_after_all_that(rig: Rig) -> None:
    test_a_good_run(rig)
    assert "Traceback" not in rig.node.output
    assert rig.node.end() == 0
