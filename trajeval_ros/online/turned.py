# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether orientations ever change."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# rad, by which orientations that never change differ at most, and those of a robot that turns.
CONSTANT, TURNS = 1e-6, 0.2


class Turned:
    """How far orientations are from the first one, at most."""

    def __init__(self, enough: float) -> None:
        """More than ``enough`` (rad) is not looked for."""
        self.most = 0.0
        """rad."""
        self._enough = enough
        self._first: Array | None = None

    def add(self, poses: Array) -> None:
        """Take poses, (n, 4, 4)."""
        if self.most > self._enough or not len(poses):
            return
        if self._first is None:
            self._first = poses[0, :3, :3].copy()
        # |A - B| = 2 sqrt(2) sin(a / 2) of two rotations that are a apart: exact near zero.
        apart = np.linalg.norm(poses[:, :3, :3] - self._first, axis=(1, 2)).max()
        angle = 2.0 * np.arcsin(min(float(apart) / np.sqrt(8.0), 1.0))
        self.most = max(self.most, float(angle))
