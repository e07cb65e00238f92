# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bodies that stand, drive, spin and are carried about, and their noisy samples."""

import numpy as np
from scipy.signal import lfilter
from twins import runs

from trajeval_ros import se3

STEP = 0.004

# Forward and sideways speed (m/s), angular speed (rad/s), and how fast they change (Hz).
KINDS = {
    "rest": (0.0, 0.0, 0.0, 1.0),
    "creep": (0.02, 0.005, 0.02, 0.2),
    "drive": (1.5, 0.0, 0.4, 0.3),
    "spin": (0.0, 0.0, 1.5, 0.3),
    "hand": (0.5, 0.5, 1.0, 1.0),
    "gentle": (0.1, 0.1, 0.2, 0.3),
    "fast": (1.5, 1.5, 1.5, 0.7),
    "aggressive": (1.5, 1.5, 3.0, 1.5),
}


def _wander(rng, count, corner):
    """A smooth random signal of unit standard deviation."""
    decay = np.exp(-2.0 * np.pi * corner * STEP)
    signal = rng.normal(size=count)
    for _ in range(3):
        signal = lfilter([1.0 - decay], [1.0, -decay], signal)
    return signal / signal.std()


class Profile:
    """The motion through phases ``(kind, seconds)``."""

    def __init__(self, rng, *phases):
        self.duration = sum(seconds for _, seconds in phases)
        count = int(self.duration / STEP) + 2
        times = np.arange(count) * STEP
        edge = np.hanning(round(0.3 / STEP) + 2)[1:-1]
        twist = np.zeros((count, 6))
        begin = 0.0
        for kind, seconds in phases:
            forward, sideways, turning, corner = KINDS[kind]
            inside = ((times >= begin) & (times < begin + seconds)).astype(float)
            on = np.convolve(inside, edge / edge.sum(), "same")
            ahead = kind in ("drive", "creep")
            speeds = [_wander(rng, count, corner) for _ in range(6)]
            twist[:, 0] += on * forward * (1.0 + 0.3 * speeds[0] if ahead else speeds[0])
            twist[:, 1:3] += (on * sideways)[:, None] * np.transpose(speeds[1:3])
            tilt = 0.02 if ahead else 0.5
            twist[:, 3:5] += (on * turning * tilt)[:, None] * np.transpose(speeds[3:5])
            twist[:, 5] += on * turning * speeds[5]
            begin += seconds
        steps = se3.exp(twist * STEP)
        self._poses = np.empty((count, 4, 4))
        self._poses[0] = np.eye(4)
        for i in range(1, count):
            self._poses[i] = self._poses[i - 1] @ steps[i - 1]

    def at(self, times):
        """Poses at times (n,) s; (n, 4, 4)."""
        place = np.asarray(times) / STEP
        index = np.clip(place.astype(int), 0, len(self._poses) - 2)
        return se3.interpolate(self._poses[index], self._poses[index + 1], place - index)


def noisy(rng, poses, translation, rotation):
    """Poses with white noise, m and rad, either a number or (n,)."""
    noise = rng.normal(size=(2, len(poses), 3))
    result = poses.copy()
    result[:, :3, 3] += noise[0] * np.reshape(translation, (-1, 1))
    turns = se3.exp_so3(noise[1] * np.reshape(rotation, (-1, 1)))
    result[:, :3, :3] = poses[:, :3, :3] @ turns
    return result


def samples(times, poses):
    """As they arrive."""
    return runs.samples(runs.nanoseconds(times), poses)
