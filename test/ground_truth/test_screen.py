# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of single samples: what is decided is a function of the samples, however they are cut."""

from __future__ import annotations

import contextlib
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trajeval_ros import loops, se3
from trajeval_ros.files.tum import read_tum
from trajeval_ros.ground_truth.faults import Faults
from trajeval_ros.ground_truth.screen import Screen
from trajeval_ros.ground_truth.segment import Samples

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
ACCURACY = (0.0005, 0.00087)


def screened(samples: Samples, edges: list[int]) -> tuple[Any, ...]:
    """What passes, what is left out and why, and the faults, of samples cut at ``edges``."""
    faults = Faults()
    screen = Screen(ACCURACY, faults)
    bounds = [0, *edges, len(samples)]
    found = [screen.accept(samples[a:b]) for a, b in itertools.pairwise(bounds) if b > a]
    found.append(screen.conclude())
    rejected: dict[str, int] = {}
    for each in found:
        for code, count in each.rejected.items():
            rejected[code] = rejected.get(code, 0) + count
    return (
        np.concatenate([each.samples.stamps for each in found]).tolist(),
        np.concatenate([each.samples.poses for each in found]),
        rejected,
        [cut for each in found for cut in each.cuts],
        faults.found,
    )


def assert_the_same(samples: Samples, cuttings: list[list[int]]) -> None:
    whole = screened(samples, [])
    for edges in cuttings:
        found = screened(samples, edges)
        assert found[0] == whole[0]
        np.testing.assert_allclose(found[1], whole[1], atol=1e-9)
        assert found[2:] == whole[2:]


def jolted(seed: int, rate: float, fewest: int = 600) -> Samples:
    """A body that is pushed hard for an instant now and then, left where it was, and mislaid."""
    generator = np.random.default_rng(seed)
    count = max(int(12.0 * rate), fewest)
    time = np.arange(count) / rate
    velocity = np.stack([np.cos(time), np.sin(0.7 * time), 0.3 * np.cos(2 * time)], axis=1)
    for at in generator.integers(40, count - 40, size=8):
        velocity[at:] += generator.normal(scale=generator.choice([0.05, 0.3, 1.5]), size=3)
        more = int(generator.integers(1, 8))
        velocity[at + more :] -= generator.normal(scale=0.3, size=3)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = se3.exp_so3(np.stack([0.2 * time, 0.1 * time, 0.3 * time], axis=1))
    poses[:, :3, 3] = np.cumsum(velocity, axis=0) / rate
    # Noise: of exact samples round-off decides, and that is another on each machine.
    poses[:, :3, 3] += generator.normal(scale=2e-4, size=(count, 3))
    poses[:, :3, :3] @= se3.exp_so3(generator.normal(scale=2e-4, size=(count, 3)))
    for at in generator.integers(60, count - 60, size=3):  # the origin jumps
        poses[at:, :3, 3] += generator.normal(scale=generator.choice([0.02, 0.1, 0.6]), size=3)
    for at in generator.integers(60, count - 60, size=4):  # outliers
        poses[at : at + int(generator.integers(1, 4)), :3, 3] += generator.normal(scale=0.5, size=3)
    at = int(generator.integers(60, count // 3))  # it freezes
    poses[at : at + int(rate * generator.choice([0.2, 2.0, 4.2]))] = poses[at]
    return Samples(START + np.rint(time * SECOND).astype(np.int64), poses)


@pytest.mark.parametrize("rate", [10.0, 30.0, 200.0])
@pytest.mark.parametrize("seed", range(6))
def test_batches_do_not_matter(seed: int, rate: float) -> None:
    samples = jolted(seed, rate)
    generator = np.random.default_rng(100 + seed)
    size = len(samples)
    every = [list(range(step, size, step)) for step in (3, 50)]
    random = [sorted(generator.choice(size, size // 9, replace=False).tolist()) for _ in range(3)]
    assert_the_same(samples, [*every, *random])


def test_batches_do_not_matter_for_a_helicopter_s_ground_truth() -> None:
    path = Path(__file__).parents[3] / "shared/data/euroc_mh04/groundtruth.txt"
    if not path.exists():
        pytest.skip(f"the real data is not here: {path}")
    read = read_tum(str(path)).samples
    samples = Samples(read.stamps, se3.from_position_quaternion(read.positions, read.quaternions))
    assert_the_same(samples, [list(range(7, len(samples), 23))])


@pytest.mark.skipif(not loops.there(), reason="not built, or switched off")
@pytest.mark.parametrize("rate", [5.0, 30.0, 200.0])
@pytest.mark.parametrize("seed", range(4))
def test_the_loop_suspects_what_numpy_does(seed: int, rate: float) -> None:
    samples = jolted(seed, rate)
    found = screened(samples, [7, 9, 31, 200])
    with loops.left_out():
        known = screened(samples, [7, 9, 31, 200])
    assert found[0] == known[0]
    np.testing.assert_allclose(found[1], known[1], atol=1e-9)
    assert found[2:] == known[2:]


def test_another_body_after_a_jump_is_turned_back_and_moved_no_further() -> None:
    time = np.arange(600) / 100.0
    poses = np.tile(np.eye(4), (600, 1, 1))
    poses[:, :3, 3] = np.stack([time, np.sin(time), np.zeros(600)], axis=1)
    samples = Samples(START + np.rint(time * SECOND).astype(np.int64), poses.copy())
    samples.poses[200:, 1, 3] += 4.0
    samples.poses[400:, :3, :3] = np.diag([-1.0, -1.0, 1.0])
    stamps, found, rejected, cuts, faults = screened(samples, [])
    assert len(stamps) == 600
    assert not rejected
    assert cuts == [samples.stamps[200]]
    assert "flip" in {fault.code for fault in faults}
    np.testing.assert_allclose(found, poses, atol=1e-3)


@pytest.mark.parametrize("without", [False, True])
def test_poses_that_differ_by_no_distance_are_repeats_however_they_come(without: bool) -> None:
    """Squares of their differences are zero: these samples were judged, and judged, without end."""
    poses = np.tile(np.eye(4), (300, 1, 1))
    poses[:, 0, 3] = 1e-300 * np.random.default_rng(1).normal(size=300)
    poses[250:, 1, 3] = np.arange(50) * 1e-3
    stamps = START + np.arange(300) * (SECOND // 40)
    with loops.left_out() if without else contextlib.nullcontext():
        assert_the_same(Samples(stamps, poses), [list(range(1, 300)), [7, 40, 41, 251]])
        assert len(screened(Samples(stamps, poses), [])[0]) == 300
