# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""North, east, down and forward, right, down become ROS's axes."""

import numpy as np
import pytest
from twins.runs import FIXED, Run, assert_same_summary, handed_over, poses_of, samples, simulated

from trajeval_ros import se3
from trajeval_ros.online.axes import turned
from trajeval_ros.online.parameters import ParameterError, complete
from trajeval_ros.online.samples import PoseSamples

# Their own axes in those of ROS; each is its own inverse.
WORLD, BODY = np.eye(4), np.diag([1.0, -1.0, -1.0, 1.0])
WORLD[:3, :3] = [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]


def test_a_known_attitude():
    """Heading east, level, 3 m north, 2 m east, 5 m up."""
    heading = np.pi / 2.0
    quaternion = np.array([[0.0, 0.0, np.sin(heading / 2.0), np.cos(heading / 2.0)]])
    there = turned(PoseSamples(np.array([1]), np.array([[3.0, 2.0, -5.0]]), quaternion), "ned_frd")
    assert there.positions.tolist() == [[2.0, 3.0, 5.0]]
    pose = poses_of(there)[0]
    # East is ENU's first axis: the body's axes, forward, left, up, are the world's.
    np.testing.assert_allclose(pose[:3, :3], np.eye(3), atol=1e-12)


def test_the_matrices_are_the_twin():
    rng = np.random.default_rng(1)
    poses = se3.exp(rng.normal(size=(50, 6)))
    given = samples(np.arange(50), poses)
    np.testing.assert_allclose(poses_of(turned(given, "ned_frd")), WORLD @ poses @ BODY, atol=1e-12)
    assert turned(given, "as_given") is given
    factor = rng.normal(size=(50, 6, 6))
    covariances = factor @ factor.swapaxes(1, 2)
    about = turned(samples(np.arange(50), poses, covariances), "ned_frd").covariances
    assert about is not None
    world = np.kron(np.eye(2), WORLD[:3, :3])
    np.testing.assert_allclose(about, world @ covariances @ world.T, atol=1e-12)


@pytest.mark.parametrize("topic", ["estimate", "ground_truth"])
def test_declared_axes_give_the_same_figures(topic):
    run = simulated(3, 8.0)
    expected, _ = handed_over(FIXED, run)
    topics = {"ground_truth": run.ground_truth, "estimate": run.estimate}
    given = topics[topic]
    topics[topic] = samples(given.stamps, WORLD @ poses_of(given) @ BODY)
    engine, _ = handed_over({**FIXED, f"{topic}.axes": "ned_frd"}, Run(**topics))
    assert_same_summary(engine.summary(), expected.summary(), 1e-6)


def test_what_names_transforms_and_what_does_not():
    assert complete({"estimate.type": "TFMessage", "estimate.topic": "/tf:map.base_link"})
    with pytest.raises(ParameterError, match=r"many transforms: name one, as in estimate\.topic"):
        complete({"estimate.type": "tf2_msgs/msg/TFMessage", "estimate.topic": "/tf"})
    with pytest.raises(ParameterError, match=r"names a transform, but estimate\.type is Odo"):
        complete({"estimate.type": "Odometry", "estimate.topic": "/tf:map.base_link"})
    with pytest.raises(ParameterError, match=r"ground_truth\.axes must be one of as_given, ned"):
        complete({"ground_truth.axes": "ned"})
