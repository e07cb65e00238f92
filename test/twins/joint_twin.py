# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The joint covariance of the ground truth's errors by its definition: pair by pair, dense."""

import numpy as np
from scipy.linalg import sqrtm
from twins import gp_twin
from twins.likelihood_twin import dense

from trajeval_ros import se3
from trajeval_ros.ground_truth.regression import scale

NAMES = ("Matern52",)


def joint(segmentation, process, stamps, until, names=NAMES):
    """V (6 q, 6 q) of all queries with each other."""
    size = len(stamps)
    v, blended = np.zeros((6 * size, 6 * size)), np.zeros((size, 6, 6))
    for part in segmentation:
        weights = part.weight(stamps)
        for i in range(size):
            for j in range(size):
                if weights[i] > 0.0 and weights[j] > 0.0:
                    block = _block(part.segment, process, stamps, until, i, j, names)
                    v[_rows(i), _rows(j)] += weights[i] * weights[j] * block
                    if i == j:
                        blended[i] += weights[i] * block
    unmixing = [sqrtm(b @ np.linalg.inv(v[_rows(i), _rows(i)])) for i, b in enumerate(blended)]
    for i in range(size):
        for j in range(size):
            v[_rows(i), _rows(j)] = unmixing[i] @ v[_rows(i), _rows(j)] @ unmixing[j].T
    return v


def _rows(i):
    return slice(6 * i, 6 * i + 6)


def _block(segment, process, stamps, until, i, j, names):
    """``B_i s_i C(t_i, t_j | the larger set) s_j B_j^T`` of one segment."""
    pair = stamps[[i, j]]
    local = np.zeros((6, 6))
    for g, group in enumerate(process.groups):
        columns = slice(3 * g, 3 * g + 3)
        _, covariance = _posterior(segment, group, pair, max(until[i], until[j]), columns, names)
        scales = [_scale(segment, process, g, columns, until[k], names) for k in (i, j)]
        local[columns, columns] = np.eye(3) * covariance[0, 1] * np.sqrt(scales[0] * scales[1])
    to_body = []
    for k, stamp in zip((i, j), pair, strict=True):
        phi, _ = _posterior(
            segment, process.groups[1], np.array([stamp]), until[k], slice(3, 6), names
        )
        matrix = np.zeros((6, 6))
        matrix[:3, :3] = se3.exp_so3(phi[0]).T
        matrix[3:, 3:] = se3.right_jacobian(np.append(np.zeros(3), phi[0]))[3:, 3:]
        to_body.append(matrix)
    return to_body[0] @ local @ to_body[1].T


def _known(segment, until):
    return int(np.searchsorted(segment.samples.stamps, until, side="right"))


def _posterior(segment, group, stamps, until, columns, names):
    n = _known(segment, until)
    return gp_twin.posterior(
        names,
        group.components,
        segment.times[:n],
        segment.coordinates[:n, columns],
        np.full(n, group.noise_std**2),
        (stamps - segment.start) * 1e-9,
    )


def _scale(segment, process, g, columns, until, names):
    n, group = _known(segment, until), process.groups[g]
    times, values = segment.times[:n], segment.coordinates[:n, columns]
    k = gp_twin.kernel(names, group.components, times, times) + group.noise_std**2 * np.eye(n)
    # Not by `gp_twin.square`: the huge variance of the mean costs it ten digits.
    inverse, ones = np.linalg.inv(k), np.ones(n)
    flat = 1.0 / (gp_twin.FLAT**2 * sum(c.std**2 for c in group.components))
    known = inverse @ ones
    square = np.trace(values.T @ inverse @ values) - ((known @ values) ** 2).sum() / (
        flat + known.sum()
    )
    least = process.least_scales[g]
    return scale(np.array([square]), np.array([n]), 3, least)[0]


def from_rows(covariances, cross):
    """V, dense, of the answers' own covariances and `Posterior.cross`."""
    size = len(covariances)
    rows = np.zeros((size, size, 6, 6))
    rows[:, 0] = covariances
    for i, blocks in enumerate(cross):
        for k, block in enumerate(blocks[::-1], start=1):
            rows[i, k] = block.T
    return dense(rows)
