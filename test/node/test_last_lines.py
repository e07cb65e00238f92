# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The figures at a node's end."""

from trajeval_ros.node.figures import summary_lines
from trajeval_ros.online.engine import Engine


def test_of_nothing_there_are_no_figures() -> None:
    summary = Engine({}).summary()
    assert summary_lines(summary) == [
        "nothing was evaluated; estimates: 0 received, 0 evaluated",
    ]
    summary["estimate"] |= {"received": 7, "rejected": {"no_ground_truth": 7, "invalid_pose": 0}}
    (line,) = summary_lines(summary)
    assert line.endswith("7 received, 0 evaluated, 7 rejected (7 no_ground_truth)")
