# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Probabilistic, continuous-time evaluation of estimated trajectories, live in ROS 2.

An estimate is scored by its likelihood under a Gaussian-process model of the ground truth,
after Zhang and Scaramuzza, "Rethinking Trajectory Evaluation for SLAM: a Probabilistic,
Continuous-Time Approach" (2019). Frames, units and formulae: ``docs/method.md``.
"""

__version__ = "0.1.0"
