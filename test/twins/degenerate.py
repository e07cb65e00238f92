# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Motions that are no motion, or hardly: positions and orientations degenerate by themselves."""

import numpy as np
from hypothesis import strategies as st

from trajeval_ros import se3

SPATIAL, COPLANAR, COLLINEAR, CONSTANT, TWO, EQUAL = (
    "spatial",
    "coplanar",
    "collinear",
    "constant",
    "two",
    "equal in pairs",
)
SHAPES = (SPATIAL, COPLANAR, COLLINEAR, CONSTANT, TWO, EQUAL)
_FREE = {SPATIAL: 3, COPLANAR: 2, COLLINEAR: 1, CONSTANT: 0, TWO: 3, EQUAL: 3}


def curve(shape, seconds, phase):
    """Three coordinates over time, (n, 3), of a shape in a general attitude."""
    frequency = np.array([0.7, 0.9, 0.5])
    if shape == EQUAL:
        seconds = np.repeat(seconds[::2], 2)[: len(seconds)]
    if shape == TWO:
        seconds = np.where(np.arange(len(seconds)) < len(seconds) // 2, 0.0, 1.0)
    free = np.sin(seconds[:, None] * frequency + phase) * (np.arange(3) < _FREE[shape])
    return free @ se3.exp_so3(np.array([0.3, -0.5, 0.9])).T


def poses(position_shape, orientation_shape, seconds, phase=0.0, extent=1.0, origin=0.0):
    """T_world_body (n, 4, 4)."""
    made = np.tile(np.eye(4), (len(seconds), 1, 1))
    made[:, :3, :3] = se3.exp_so3(0.8 * curve(orientation_shape, seconds, phase + 1.0))
    made[:, :3, 3] = extent * curve(position_shape, seconds, phase) + origin
    return made


def shapes():
    return st.sampled_from(SHAPES)


@st.composite
def pairs(draw, counts=(1, 2, 3, 40, 90)):
    """Seconds (n,), ground truth and estimate (n, 4, 4), each of a degenerate shape of its own."""
    count = draw(st.sampled_from(counts))
    seconds = np.arange(count) * draw(st.sampled_from([0.05, 0.5]))
    truth, estimate = (
        poses(
            draw(shapes()),
            draw(shapes()),
            seconds,
            draw(st.sampled_from([0.0, 0.4])),
            draw(st.sampled_from([1e-9, 1.0, 1e4])),
            draw(st.sampled_from([0.0, 5e5])),
        )
        for _ in range(2)
    )
    return seconds, truth, estimate
