# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses whose world and body have other axes than ROS has them: turned as declared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trajeval_ros.online.samples import PoseSamples

AS_GIVEN, NED_FRD = "as_given", "ned_frd"
AXES = (AS_GIVEN, NED_FRD)
"""As they are; or north, east, down and forward, right, down, which become east, north, up and
forward, left, up (REP 103)."""

# East, north, up in the axes north, east, down; a half turn about an axis between the first two.
_WORLD = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def turned(samples: PoseSamples, axes: str) -> PoseSamples:
    """Return the poses in ROS's axes; quaternions keep their norm, whatever it is.

    With W the turn of the world and B that of the body, ``p -> W p`` and ``R -> W R B``.
    """
    if axes == AS_GIVEN:
        return samples
    x, y, z, w = np.moveaxis(samples.quaternions, -1, 0)
    # (1, 1, 0, 0) / sqrt(2) * q * (1, 0, 0, 0), two half turns; with the other sign.
    quaternions = np.stack([x + y, x - y, w - z, w + z], axis=-1) / np.sqrt(2.0)
    covariances = samples.covariances
    if covariances is not None:
        # About the world's fixed axes.
        both = np.kron(np.eye(2), _WORLD)
        covariances = both @ covariances @ both.T
    return replace(
        samples,
        positions=samples.positions @ _WORLD.T,
        quaternions=quaternions,
        covariances=covariances,
    )
