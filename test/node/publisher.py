# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A process with one publisher: ``publisher.py SAMPLES.npz TOPIC RATE RELIABILITY``.

It waits for a subscription, publishes everything at RATE messages a second, says ``published N``
when all is on its way, and stays until it is ended.
"""

import sys
import time

import numpy as np
import rclpy
from data import messages, publish_in_order
from geometry_msgs.msg import PoseStamped
from rclpy.duration import Duration
from rclpy.qos import QoSProfile, ReliabilityPolicy

from trajeval_ros.online.samples import PoseSamples


def main() -> None:
    path, topic, rate, reliability = sys.argv[1:5]
    rclpy.init(args=[])
    node = rclpy.create_node(f"publisher_{topic}")
    quality = QoSProfile(depth=1000, reliability=ReliabilityPolicy[reliability.upper()])
    publisher = node.create_publisher(PoseStamped, topic, quality)
    with np.load(path) as arrays:
        stream = messages(PoseStamped, PoseSamples(**arrays))
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    publish_in_order([publisher], [stream], float(rate))
    publisher.wait_for_all_acked(Duration(seconds=20))
    sys.stdout.write(f"published {len(stream)}\n")
    sys.stdout.flush()
    while True:
        time.sleep(1.0)


if __name__ == "__main__":
    main()
