# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A process that subscribes to what the node publishes, reliably, and says so."""

import sys

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, Vector3Stamped
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64

TOPICS = {
    "metrics": DiagnosticArray,
    "ground_truth/pose": PoseWithCovarianceStamped,
    "relative/log_likelihood": Float64,
    "absolute/translation_error": Vector3Stamped,
}


def main() -> None:
    rclpy.init(args=[])
    node = rclpy.create_node("listener")

    def say(topic: str) -> None:
        sys.stdout.write(f"heard {topic}\n")
        sys.stdout.flush()

    for topic, kind in TOPICS.items():
        node.create_subscription(
            kind, f"/evaluator/{topic}", lambda _, topic=topic: say(topic), QoSProfile(depth=10)
        )
    rclpy.spin(node)


if __name__ == "__main__":
    main()
