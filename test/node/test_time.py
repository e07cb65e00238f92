# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The clock: not there, standing still, jumping back; stamps of another epoch."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import data
import pytest
from geometry_msgs.msg import PoseStamped
from harness import Graph, accounted, values_of
from rosgraph_msgs.msg import Clock
from visualization_msgs.msg import Marker, MarkerArray

from trajeval_ros.online.samples import PoseSamples

pytestmark = pytest.mark.ros

FIXED = {"gp__hyperparameters": "fixed"}
DURATION = 6.0


class Bag:
    """A player with a clock, as ``ros2 bag play --clock`` is one."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.clock = graph.publisher("/clock", Clock)
        self.now = DURATION
        self.publishers = [graph.publisher(topic) for topic in ("ground_truth", "estimate")]
        truth, estimate = data.run(DURATION)
        self.streams = [data.messages(PoseStamped, each) for each in (truth, estimate)]
        graph.until_heard(self.clock, *self.publishers)

    @property
    def sizes(self) -> tuple[int, ...]:
        return tuple(len(stream) for stream in self.streams)

    def tick(self, seconds: float) -> None:
        stamp = data.START + round(seconds * data.SECOND)
        self.clock.publish(Clock(clock=data.stamp_message(stamp)))

    def play(self, jumps: int = 0) -> None:
        """Publish all, with a tick before each tenth of a second; the node spins in between.

        After the first tenth the node is to have seen so many jumps.
        """
        for tenth in range(round(DURATION * 10)):
            self.tick(tenth / 10)
            if tenth == 1:
                self.graph.until(partial(self._have_jumped, jumps), f"{jumps} jumps counted")
            begin = data.START + tenth * data.SECOND // 10
            for publisher, stream in zip(self.publishers, self.streams, strict=True):
                for message in stream:
                    stamp = message.header.stamp.sec * data.SECOND + message.header.stamp.nanosec
                    if begin <= stamp < begin + data.SECOND // 10:
                        publisher.publish(message)
            self.graph.spin(0.01)

    def _have_jumped(self, jumps: int) -> bool:
        # A node that is busy takes the newest tick only.
        self.tick(0.1)
        clock = self.graph.health().get("clock")
        return clock is not None and values_of(clock)["jumps_back"] == str(jumps)


def received(graph: Graph, sizes: tuple[int, ...]) -> None:
    for topic, size in zip(("ground_truth", "estimate"), sizes, strict=True):
        graph.until_accounted(topic, size)


def summary_in(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "summary.json").read_text(encoding="utf-8"))


def test_waiting_for_the_clock_and_then_it_comes(graph: Graph) -> None:
    graph.start_evaluator(use_sim_time=True, **FIXED)
    graph.until_health("clock", "waiting for /clock, which nobody publishes", level=1)
    bag = Bag(graph)
    graph.until_health("clock", "waiting for /clock", level=1)
    bag.play()
    received(graph, bag.sizes)
    graph.until(partial(is_running, bag), "a clock that runs")
    # The clock stands still and the diagnostics go on, on the steady clock.
    graph.until_health("clock", "/clock stands still", level=1)


def is_running(bag: Bag) -> bool:
    """Whether the node says so of a clock that goes on."""
    bag.now += 0.01
    bag.tick(bag.now)
    status = bag.graph.health()["clock"]
    return "running" in status.message and status.level == bytes([0])


def test_a_bag_that_loops_saves_and_starts_over(graph: Graph, tmp_path: Path) -> None:
    out = tmp_path / "out"
    # What a burst has no room for comes 3 s later; at ten times the speed.
    node = graph.start_evaluator(
        use_sim_time=True, output__directory=str(out), max_wait=60.0, **FIXED
    )
    markers = graph.listen(MarkerArray, "/evaluator/markers", latched=True)
    bag = Bag(graph)
    bag.play()
    received(graph, bag.sizes)
    for run in (1, 2):
        bag.play(jumps=run)
        graph.until(lambda run=run: (out / f"run_{run}" / "summary.json").exists(), "a saved run")
        summary = summary_in(out / f"run_{run}")
        # What comes before the clock's jump is seen is out of order in the old run.
        late = summary["estimate"]["rejected"].get("out_of_order", 0)
        assert summary["estimate"]["received"] - late <= bag.sizes[1], summary["estimate"]
        assert summary["estimate"]["evaluated"] > 0.8 * bag.sizes[1], summary["estimate"]
        assert accounted(summary["estimate"], "evaluated")
    assert node.output.count("/clock jumped back by") == 2
    last = bag.streams[1][-1].header.stamp
    newest = repr((last.sec * data.SECOND + last.nanosec) / data.SECOND)
    graph.until(
        lambda: values_of(graph.health()["estimate"]).get("latest_stamp") == newest,
        "the last stamp",
    )
    assert any(m.markers[0].action == Marker.DELETEALL for m in markers)
    assert node.end() == 0
    total = sum(
        summary_in(folder)["estimate"]["received"] for folder in (out / "run_1", out / "run_2", out)
    )
    left_over = int(values_of(graph.health()["clock"])["left_over_messages"])
    assert total + left_over == 3 * bag.sizes[1], summary["estimate"]


@pytest.mark.parametrize("rate", [1000.0, 20_000.0])  # the second: both runs in a batch or two
def test_stamps_that_jump_back_without_a_clock_start_over(
    graph: Graph, tmp_path: Path, rate: float
) -> None:
    out = tmp_path / "out"
    node = graph.start_evaluator(output__directory=str(out), **FIXED)
    truth, estimate = data.run(DURATION)
    publishers = [graph.publisher(topic) for topic in ("ground_truth", "estimate")]
    graph.until_heard(*publishers)
    streams = [data.messages(PoseStamped, each) for each in (truth, estimate)]
    for _ in range(2):
        data.publish_in_order(publishers, streams, rate=rate)
    graph.until(lambda: (out / "run_1" / "summary.json").exists(), "a saved run")
    graph.until(lambda: "the stamps jumped back" in node.output, "a word in the log")
    assert node.end() == 0
    runs = [summary_in(out / "run_1"), summary_in(out)]
    assert sum(run["estimate"]["received"] for run in runs) == 2 * len(estimate)
    assert runs[0]["estimate"]["evaluated"] > 0
    assert all(accounted(run["estimate"], "evaluated") for run in runs)


def test_another_epoch_is_no_overlap_with_both_ranges(graph: Graph) -> None:
    graph.start_evaluator(**FIXED)
    truth, estimate = data.run(3.0)
    year = 365 * 86_400 * data.SECOND
    later = PoseSamples(estimate.stamps + year, estimate.positions, estimate.quaternions)
    publishers = [graph.publisher(topic) for topic in ("ground_truth", "estimate")]
    graph.until_heard(*publishers)
    streams = [data.messages(PoseStamped, each) for each in (truth, later)]
    for publisher, stream in zip(publishers, streams, strict=True):
        data.publish_in_order([publisher], [stream])
    status = graph.until_health("synchronization", "no overlap: estimate 17315", level=2)
    assert "(2024-11-13" in status.message
    assert "ground truth 1700000000.000 (2023-11-14" in status.message
    assert "check use_sim_time and clock synchronisation" in status.message
    graph.until_health("clock", "behind the clock; for recorded data", level=1)
    values = graph.until_accounted("estimate", len(estimate))
    total = int(values["evaluated"]) + int(values["pending"]) + int(values["rejected"])
    assert total == len(estimate)
