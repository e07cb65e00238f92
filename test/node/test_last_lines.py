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


def test_a_large_likelihood_is_written_as_everywhere_else() -> None:
    summary = Engine({}).summary()
    summary["estimate"] |= {"received": 3, "evaluated": 3}
    summary["relative"] |= {"log_likelihood": -231_062_811.0, "chi2_per_dof": 3.5e7}
    (line,) = (each for each in summary_lines(summary) if each.startswith("relative"))
    assert line == "relative log-likelihood: -231.063 M nats, chi2/dof 35 M"
