# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What never changes at all: an estimate at one pose, an orientation that nobody filled in."""

from __future__ import annotations

import numpy as np

from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.diagnosis.rotations import Array, Stamps, angles, distances, quaternion, turns

# By less than round-off, m and rad, while the other trajectory goes this far.
_STILL = 1e-6
_MOVED = 0.1
_TURNED = 0.2


def stuck(ground_truth: Array, estimate: Array) -> tuple[Cause, ...]:
    """An estimate at one pose, of a robot that moves or turns."""
    if distances(estimate[:, :3, 3]).max() > _STILL or angles(estimate[:, :3, :3]).max() > _STILL:
        return ()
    moved = float(distances(ground_truth[:, :3, 3]).max())
    turned = float(angles(ground_truth[:, :3, :3]).max())
    if moved < _MOVED and turned < _TURNED:
        return ()
    return (
        Cause(
            "stuck",
            f"the estimate stays at one pose, while the ground truth goes {moved:.3g} m away"
            f" from its first pose and turns by {np.degrees(turned):.0f} degrees",
            "see whether the estimator tracks at all, and whether this is its topic or file",
        ),
    )


def constant_orientation(stamps: Stamps, ground_truth: Array, estimate: Array) -> tuple[Cause, ...]:
    """An orientation that nobody filled in."""
    for title, constant, other_title, other in (
        ("estimate", estimate, "ground truth", ground_truth),
        ("ground truth", ground_truth, "estimate", estimate),
    ):
        turned = float(angles(other).max())
        if angles(constant).max() > _STILL or turned < _TURNED:
            continue
        # A slow turn against a ground truth at rest is drift.
        if constant is ground_truth and not turns(stamps, estimate):
            continue
        x, y, z, w = quaternion(constant[0])
        return (
            Cause(
                "constant_orientation",
                f"the {title}'s orientation never changes (x y z w is {x:.3g} {y:.3g} {z:.3g}"
                f" {w:.3g} throughout), while the {other_title} turns by"
                f" {np.degrees(turned):.0f} degrees: many a converter writes 0 0 0 1",
                f"write the {title}'s own quaternions, if it has any; until then no figure that"
                " needs them holds",
            ),
        )
    return ()
