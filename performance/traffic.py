# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Processes of the node's benchmark, each ended by a line on its standard input.

``python -m performance.traffic publish SECONDS RATE EVERY FILE``: ground truth of so many Hz, an
estimate with every so manieth, as soon as both have a subscriber; when each sample went out is
written to FILE.
``python -m performance.traffic meet``: says when both topics have a subscriber.
``python -m performance.traffic subscribe``: a bare node; prints how many messages came.
``python -m performance.traffic listen FILE``: when each metric came is written to FILE.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message

from performance.ground_truth import simulated
from trajeval_ros import se3
from trajeval_ros.ground_truth.segment import Samples

Stamps = npt.NDArray[np.int64]

_SECOND = 1_000_000_000
_QUALITY = QoSProfile(depth=1000)
# Of the publisher: a reliable one goes on without a reader that is late by more than it keeps.
_KEPT = QoSProfile(depth=50_000)


def messages(samples: Samples, every: int, start: int) -> list[bytes]:
    """Return every so manieth of the ``samples`` as a serialised message."""
    made = []
    positions, quaternions = se3.to_position_quaternion(samples.poses[::every])
    stamps = (samples.stamps[::every] + start).tolist()
    for stamp, p, q in zip(stamps, positions.tolist(), quaternions.tolist(), strict=True):
        message = PoseStamped()
        message.header.stamp = Time(sec=stamp // _SECOND, nanosec=stamp % _SECOND)
        message.header.frame_id = "world"
        at, turned = message.pose.position, message.pose.orientation
        at.x, at.y, at.z = p
        turned.x, turned.y, turned.z, turned.w = q
        made.append(serialize_message(message))
    return made


def publishers(node: Node) -> tuple[Publisher, Publisher]:
    """Of ground truth and estimate."""
    truth, estimate = (
        node.create_publisher(PoseStamped, topic, _KEPT) for topic in ("ground_truth", "estimate")
    )
    return truth, estimate


def met(truth: Publisher, estimate: Publisher, period: float = 0.05) -> None:
    """Wait until both have a subscriber."""
    while not (truth.get_subscription_count() and estimate.get_subscription_count()):
        time.sleep(period)


def meet() -> None:
    """Say when there are subscribers."""
    node = Node("traffic")
    topics = publishers(node)
    print("begin", flush=True)
    met(*topics, period=0.002)
    print("met", flush=True)
    sys.stdin.readline()
    node.destroy_node()


def publish(seconds: int, rate: int, every: int, path: str) -> None:
    """Publish, paced by the steady clock; write (stamp, time it went out) of the ground truth."""
    node = Node("traffic")
    truth, estimate = publishers(node)
    met(truth, estimate)
    time.sleep(1.0)
    count = seconds * rate
    start = time.time_ns()
    motion = simulated(0, count, rate)
    samples, estimates = messages(motion, 1, start), messages(motion, every, start)
    print("begin", flush=True)
    sent = np.empty(count, dtype=np.int64)
    begin = time.monotonic_ns()
    for i, message in enumerate(samples):
        ahead = begin + i * _SECOND // rate - time.monotonic_ns()
        if ahead > 0:
            time.sleep(ahead / _SECOND)
        if i % every == 0:
            estimate.publish(estimates[i // every])
        sent[i] = time.monotonic_ns()
        truth.publish(message)
    for publisher in (truth, estimate):
        publisher.wait_for_all_acked(Duration(seconds=10))
    stamps = start + np.arange(count, dtype=np.int64) * (_SECOND // rate)
    np.savez(path, stamps=stamps, sent=sent)
    print("end", flush=True)
    node.destroy_node()


def spin(node: Node) -> None:
    """Spin until a line comes in."""
    ended = threading.Event()

    def wait() -> None:
        sys.stdin.readline()
        ended.set()

    threading.Thread(target=wait, daemon=True).start()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not ended.is_set():
        executor.spin_once(timeout_sec=0.2)


def subscribe() -> None:
    """Count messages."""
    node = Node("bare")
    counts = [0, 0]

    def counter(topic: int) -> Callable[[PoseStamped], None]:
        def count(message: PoseStamped) -> None:
            counts[topic] += 1

        return count

    for k, topic in enumerate(("ground_truth", "estimate")):
        node.create_subscription(PoseStamped, topic, counter(k), _QUALITY)
    spin(node)
    print(*counts, flush=True)


def listen(path: str) -> None:
    """Note when the error of each estimate comes."""
    node = Node("listener")
    stamps: list[int] = []
    times: list[int] = []

    def heard(message: Vector3Stamped) -> None:
        times.append(time.monotonic_ns())
        stamps.append(message.header.stamp.sec * _SECOND + message.header.stamp.nanosec)

    topic = "/evaluator/absolute/translation_error"
    node.create_subscription(Vector3Stamped, topic, heard, QoSProfile(depth=10_000))
    spin(node)
    np.savez(path, stamps=np.array(stamps), times=np.array(times))
    print(len(stamps), flush=True)


def main() -> None:
    """Run one of the processes."""
    rclpy.init(args=[])
    match sys.argv[1:]:
        case ["publish", seconds, rate, every, path]:
            publish(int(seconds), int(rate), int(every), path)
        case ["meet"]:
            meet()
        case ["subscribe"]:
            subscribe()
        case ["listen", path]:
            listen(path)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
