# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A publisher process: ``player.py GROUND_TRUTH.npz ESTIMATE.npz RATE``.

It waits for the subscriptions, publishes everything, merged by stamp, at RATE messages a second,
and ends when all is acknowledged.
"""

import sys
import time

import numpy as np
import rclpy
from data import messages, publish_in_order
from geometry_msgs.msg import PoseStamped
from rclpy.duration import Duration
from rclpy.qos import QoSProfile

from trajeval_ros.online.samples import PoseSamples


def main() -> None:
    rclpy.init(args=[])
    node = rclpy.create_node("player")
    publishers = [
        node.create_publisher(PoseStamped, topic, QoSProfile(depth=1000))
        for topic in ("ground_truth", "estimate")
    ]
    streams = []
    for path in sys.argv[1:3]:
        with np.load(path) as arrays:
            streams.append(messages(PoseStamped, PoseSamples(**arrays)))
    while not all(publisher.get_subscription_count() for publisher in publishers):
        time.sleep(0.01)
    publish_in_order(publishers, streams, float(sys.argv[3]))
    for publisher in publishers:
        publisher.wait_for_all_acked(Duration(seconds=20))


if __name__ == "__main__":
    main()
