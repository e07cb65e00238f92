# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors over sub-trajectories as their definitions read: loops over poses, plain matrices."""

import itertools
import math

import numpy as np


def path(poses):
    """The path travelled from the first pose to each, m."""
    places = [0.0]
    for before, after in itertools.pairwise(poses):
        places.append(places[-1] + math.dist(before[:3, 3], after[:3, 3]))
    return places


def error(truth_i, truth_j, estimate_i, estimate_j):
    """Translation, m, and rotation, rad, of ``(estimate step)^-1 (truth step)``."""
    truth = np.linalg.inv(truth_i) @ truth_j
    estimate = np.linalg.inv(estimate_i) @ estimate_j
    wrong = np.linalg.inv(estimate) @ truth
    cosine = 0.5 * (np.trace(wrong[:3, :3]) - 1.0)
    return np.linalg.norm(wrong[:3, 3]), math.acos(max(-1.0, min(1.0, cosine)))


def kitti(truth, estimate):
    """Rows (length, translation error / length, rotation error / length) of the benchmark."""
    place = path(truth)
    rows = []
    for first in range(0, len(truth), 10):
        for length in range(100, 801, 100):
            last = next(
                (i for i in range(first, len(place)) if place[i] > place[first] + length), None
            )
            if last is None:
                continue
            translation, rotation = error(
                truth[first], truth[last], estimate[first], estimate[last]
            )
            rows.append((length, translation / length, rotation / length))
    return np.array(rows).reshape(-1, 3)


def nearest_ahead(place, ahead, tolerance):
    """Pairs (i, j), j > i the first of those nearest to ``ahead`` further on than i."""
    pairs = []
    for i in range(len(place) - 1):
        off = [abs((place[j] - place[i]) - ahead) for j in range(i + 1, len(place))]
        best = min(range(len(off)), key=off.__getitem__)
        if off[best] <= tolerance:
            pairs.append((i, i + 1 + best))
    return pairs
