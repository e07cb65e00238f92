# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A subscriber in a process of its own: writes what it hears to a file, one JSON line a message."""

import json
import sys
import time

import rclpy
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rosgraph_msgs.msg import Clock

ground_truth_topic, estimate_topic, expected, seconds, *names = sys.argv[1:]
kinds = {
    k.__name__: k for k in (PoseStamped, PoseWithCovarianceStamped, Odometry, TransformStamped)
}
kind = kinds[names[0]] if names else PoseStamped
rclpy.init()
node = rclpy.create_node("listener")
# The clock: time, and when it came.
heard = {"ground_truth": [], "estimate": [], "clock": []}
QUEUE = 10_000  # however slow this process is


def nanoseconds(stamp) -> int:
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def parts(message):
    if kind is TransformStamped:
        return message.transform.translation, message.transform.rotation
    pose = message.pose if kind is PoseStamped else message.pose.pose
    return pose.position, pose.orientation


def listen(name: str):
    def hear(message) -> None:
        position, orientation = parts(message)
        heard[name].append(
            [
                nanoseconds(message.header.stamp),
                message.header.frame_id,
                [position.x, position.y, position.z],
                [orientation.x, orientation.y, orientation.z, orientation.w],
            ]
        )

    return hear


def tick(message) -> None:
    heard["clock"].append([nanoseconds(message.clock), time.monotonic_ns()])


def is_all_there() -> bool:
    poses = heard["ground_truth"] + heard["estimate"]
    if len(poses) < int(expected) or not heard["clock"]:
        return False
    # The last tick is that of the last pose, and comes after it.
    return heard["clock"][-1][0] >= max(pose[0] for pose in poses)


node.create_subscription(kind, ground_truth_topic, listen("ground_truth"), QUEUE)
node.create_subscription(kind, estimate_topic, listen("estimate"), QUEUE)
node.create_subscription(Clock, "/clock", tick, QUEUE)
executor = SingleThreadedExecutor()
executor.add_node(node)
deadline = time.monotonic() + float(seconds)
while time.monotonic() < deadline and not is_all_there():
    executor.spin_once(timeout_sec=0.1)
# A buffered writer of its own: with PYTHONUNBUFFERED, what a stopped process had not yet written of
# a pipe's 64 kB when it was continued is lost (a short write of a raw file).
with open(1, "w", encoding="utf-8", closefd=False) as output:
    json.dump(heard, output)
node.destroy_node()
rclpy.shutdown()
