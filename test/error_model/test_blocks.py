# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Blocks together are what all of them by least squares say, and of any number as much is kept."""

import pickle

import numpy as np
import pytest

from trajeval_ros import se3
from trajeval_ros.error_model.blocks import NO_BLOCKS
from trajeval_ros.error_model.changes import Stretch
from trajeval_ros.error_model.model import ErrorModel, Figure, Jump
from trajeval_ros.error_model.nuisances import Nuisances
from trajeval_ros.error_model.process import GROUPS, Kind

SECOND = 1_000_000_000
STD = np.array([1e-3, 1e-5, 5e-3, 4e-3, 6e-3, 2e-3, 3e-3, 1e-3, 1e-3])
TRUE = Nuisances(0.02, 3e-5, se3.exp(np.array([0.1, -0.05, 0.2, 0.02, 0.01, -0.03])), 1.02)


def model(rng, seconds, kind=Kind.DRIFT, std=STD, apart=1.0, **more):
    """One of a block whose middle is so many seconds after the run's first one's."""
    root = np.diag(std) @ np.linalg.qr(rng.normal(size=(9, 9)))[0] * rng.uniform(0.5, 2.0)
    off = apart * root @ rng.normal(size=9)
    offset = TRUE.clock_offset + TRUE.clock_rate * seconds
    sizes = rng.lognormal(np.log(0.01), 0.2, (2, len(kind.names)))
    groups = {
        group: {name: Figure(v, 0.1 * v) for name, v in zip(kind.names, own.tolist(), strict=True)}
        for group, own in zip(GROUPS, sizes, strict=True)
    }
    poses = int(rng.integers(150, 400))
    fixed = ErrorModel(
        *(kind, groups, TRUE._replace(clock_offset=offset).moved(off), root @ root.T, (), poses),
        *(9.0 * poses, 8.0 * poses, rng.uniform(0.8, 1.2), rng.uniform(-0.1, 0.1, (2, 5)), ()),
        {Kind.DRIFT: 9.0, Kind.WANDER: rng.uniform(7.0, 8.0)},
    )
    return fixed._replace(**more)


def blocks(models, every=20):
    found = NO_BLOCKS
    for number, each in enumerate(models):
        begin = number * every * SECOND
        found = found.with_one(begin, begin + (every - 1) * SECOND, each)
    return found


@pytest.mark.parametrize(("sharper", "tolerance"), [(1.0, 1e-9), (1e6, 1e-6)])
def test_they_are_the_least_squares_of_all(sharper, tolerance):
    # A clock known to a nanosecond goes off by milliseconds: what they scatter by is there still.
    rng = np.random.default_rng(1)
    models = [model(rng, 20.0 * i, std=STD / sharper, apart=2.0) for i in range(30)]
    run = blocks(models).together()
    # Every block's nuisances as rows about the first's, the clock about the middle of the run.
    rows, right, reference = [], [], models[0].nuisances
    for number, each in enumerate(models):
        root = np.linalg.cholesky(np.linalg.inv(each.covariance)).T
        design = np.eye(9)
        design[0, 1] = 20.0 * number - 0.5 * 20.0 * 29
        n = each.nuisances
        turned = se3.log(se3.compose(n.extrinsic, se3.inverse(reference.extrinsic)))
        clock = n.clock_offset - reference.clock_offset, n.clock_rate
        rows.append(root @ design)
        right.append(root @ [*clock, *turned, np.log(n.scale / reference.scale)])
    rows, right = np.concatenate(rows), np.concatenate(right)
    step, (left,), *_ = np.linalg.lstsq(rows, right, rcond=None)
    expected = reference._replace(clock_rate=0.0).moved(step)
    np.testing.assert_allclose(run.nuisances.vector, expected.vector, rtol=1e-9, atol=1e-12)
    larger = max(left / (9 * 29), 1.0)
    np.testing.assert_allclose(
        run.std, np.sqrt(larger * np.diag(np.linalg.inv(rows.T @ rows))), rtol=tolerance
    )
    there = TRUE._replace(clock_offset=TRUE.clock_offset + TRUE.clock_rate * 290.0)
    assert (np.abs(run.nuisances.vector - there.vector) < 4.0 * run.std).all()
    assert larger > 2.0
    poses = np.array([each.poses for each in models])
    assert run.poses == poses.sum()
    share = poses / poses.sum()
    assert run.chi2_per_dof == pytest.approx(share @ [each.chi2_per_dof for each in models])
    white = np.einsum("n,ngl->gl", share, [each.whiteness for each in models])
    np.testing.assert_allclose(run.whiteness, white, rtol=1e-9)
    assert run.alternatives[Kind.WANDER] == pytest.approx(
        share @ [each.alternatives[Kind.WANDER] for each in models]
    )


def test_figures_are_geometric_means_over_the_process_of_most_poses():
    rng = np.random.default_rng(2)
    kinds = [Kind.DRIFT] * 4 + [Kind.WANDER]
    models = [model(rng, 20.0 * i, kind, poses=300) for i, kind in enumerate(kinds)]
    run = blocks(models).together()
    assert run.kind is Kind.DRIFT
    values = [each.groups["rotation"]["drift_std"].value for each in models[:4]]
    logarithms = np.log(values)
    found = run.groups["rotation"]["drift_std"]
    assert found.value == pytest.approx(np.exp(logarithms.mean()), rel=1e-9)
    excess = max(((logarithms - logarithms.mean()) ** 2).sum() / 0.01 / 3.0, 1.0)
    assert found.std == pytest.approx(found.value * np.sqrt(excess * 0.01 / 4.0), rel=1e-9)


def test_a_figure_that_no_block_tells_has_no_standard_deviation():
    rng = np.random.default_rng(3)
    untold = {group: {"jitter_std": Figure(0.02, np.nan, (0.0, np.inf))} for group in GROUPS}
    models = [model(rng, 20.0 * i, groups=untold) for i in range(3)]
    found = blocks(models).together().groups["translation"]["jitter_std"]
    assert found.value == pytest.approx(0.02, rel=1e-9)
    assert np.isnan(found.std)


def test_of_a_day_no_more_is_kept_than_of_some_hours():
    rng = np.random.default_rng(4)
    jumps = (Jump(1, 0.1, 0.2),)
    models = [model(rng, 0.0, jumps=jumps) for _ in range(50)]
    some, day, sizes = NO_BLOCKS, NO_BLOCKS, []
    for number in range(4400):
        begin = number * 20 * SECOND
        day = day.with_one(begin, begin + 19 * SECOND, models[number % 50])
        sizes.append(len(pickle.dumps(day)) if number % 20 == 0 or 1000 < number < 1040 else 0)
        some = day if number == 49 else some
    assert max(sizes) < 1.01 * max(sizes[:1100])
    run = day.together()
    assert (run.poses, len(run.jumps)) == (88 * some.poses, 100)
    assert run.log_likelihood == pytest.approx(88 * some.log_likelihood, rel=1e-9)
    begins = [each.begin for each in run.clock_stretches]
    assert begins == sorted(begins)
    assert (begins[0], run.clock_stretches[-1].end) == (0, (4399 * 20 + 19) * SECOND)
    offset = models[4399 % 50].nuisances.clock_offset
    assert run.clock_stretches[-1] == Stretch(
        4399 * 20 * SECOND, (4399 * 20 + 19) * SECOND, offset, float(models[4399 % 50].std[0])
    )


def test_of_none_there_is_no_model():
    assert NO_BLOCKS.together() is None
