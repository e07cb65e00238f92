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
heard = {"ground_truth": [], "estimate": [], "clock": []}


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


node.create_subscription(kind, ground_truth_topic, listen("ground_truth"), 1000)
node.create_subscription(kind, estimate_topic, listen("estimate"), 1000)
node.create_subscription(Clock, "/clock", lambda m: heard["clock"].append(nanoseconds(m.clock)), 10)
executor = SingleThreadedExecutor()
executor.add_node(node)
deadline = time.monotonic() + float(seconds)
while time.monotonic() < deadline and len(heard["ground_truth"]) + len(heard["estimate"]) < int(
    expected
):
    executor.spin_once(timeout_sec=0.1)
for _ in range(20):
    executor.spin_once(timeout_sec=0.01)
sys.stdout.write(json.dumps(heard) + "\n")
node.destroy_node()
rclpy.shutdown()
