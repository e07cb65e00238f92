# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What was put into a simulated estimate comes out, with standard deviations that hold."""

import json
import re

import numpy as np
import pytest
from twins.runs import motion

from performance.error_model import drawn, erring
from trajeval_ros import loops, se3
from trajeval_ros.error_model.fit import ENOUGH, _carried, _found, _Problem, fit
from trajeval_ros.error_model.likelihood import Likelihood
from trajeval_ros.error_model.maximum import climb, penalised
from trajeval_ros.error_model.named import named
from trajeval_ros.error_model.nuisances import NAMES, OBSERVED_STD, Nuisances, Truth
from trajeval_ros.error_model.process import GROUPS, Kind
from trajeval_ros.error_model.search import Guess, bounds, search
from trajeval_ros.report.answers import leading

DRIFT = np.log([[1e-3, 1e-2], [1e-3, 2e-3]])
WANDER = np.log([[1e-3, 2e-2, 1.0], [1e-3, 1e-2, 1.0]])
VELOCITY = np.log([[1e-3, 3e-3, 4e-2, 0.7], [1e-3, 1e-3, 1e-2, 0.7]])


def ask(stamps, path=motion):
    """A ground truth that is known to half a millimetre and a milliradian."""
    seconds, step = np.asarray(stamps) * 1e-9, 1e-4
    poses = path(seconds)
    twists = se3.log(se3.inverse(path(seconds - step)) @ path(seconds + step)) / (2 * step)
    std = np.repeat([5e-4, 1e-3], 3)
    covariances = np.tile(np.diag(std**2), (len(seconds), 1, 1))
    return Truth(poses, covariances, twists, np.ones(len(seconds), dtype=np.bool_))


def estimate(kind, parameters, nuisances=None, seed=0, count=400, rate=20.0, path=motion):
    """An estimate that errs as the model says, and the stamps that it is given."""
    rng = np.random.default_rng(seed)
    stamps = np.rint(np.arange(count) / rate * 1e9).astype(np.int64) + 10**9
    nuisances = nuisances or Nuisances.none()
    known = ask(nuisances.stamps(stamps), path)
    truth = known.poses @ se3.exp(rng.normal(size=(count, 6)) * np.repeat([5e-4, 1e-3], 3))
    error = drawn(rng, kind, parameters, stamps * 1e-9, known.poses[:, :3, 3])
    poses = erring(truth, error)
    poses = se3.compose(poses, nuisances.extrinsic)
    poses[:, :3, 3] /= nuisances.scale
    return stamps, poses


def is_covered(figure, value):
    """Within four standard deviations, or twice the interval."""
    if figure.interval is None:
        return abs(figure.value - value) < 4.0 * figure.std
    return 0.5 * figure.interval[0] <= value <= 2.0 * figure.interval[1]


def nuisance_scores(found, nuisances):
    """By how many standard deviations each is off, (9,)."""
    off = [
        found.nuisances.clock_offset - nuisances.clock_offset,
        found.nuisances.clock_rate - nuisances.clock_rate,
        *se3.log(found.nuisances.extrinsic @ se3.inverse(nuisances.extrinsic)),
        np.log(found.nuisances.scale / nuisances.scale),
    ]
    return np.array(off) / found.std


def with_outliers(seed):
    """An estimate that wanders, of which poses are lost, and whose world leaps."""
    stamps, poses = estimate(Kind.WANDER, WANDER, seed=seed)
    rng = np.random.default_rng(seed)
    sizes = np.repeat([0.05, 0.01], 3)
    lost = rng.random(len(poses)) < 0.02
    poses[lost] = poses[lost] @ se3.exp(rng.normal(size=(lost.sum(), 6)) * sizes)
    for leap in np.flatnonzero(rng.random(len(poses)) < 0.01):
        poses[leap:] = se3.exp(rng.normal(size=6) * sizes) @ poses[leap:]
    return stamps, poses


@pytest.mark.parametrize("seed", [1, 2, 4])
def test_no_other_start_ends_higher_where_outliers_are_many(seed):
    problem = _Problem(*with_outliers(seed), ask, None)
    found = _found(problem, problem.start())
    here = found.here
    data, gauge = problem._prepared(found.nuisances)
    low, high = (each.ravel() for each in bounds(here.kind, data))
    plain = np.ones((here.count, 2)), np.ones((here.count - 1, 2))
    begin = Guess(here.kind, here.parameters, *plain, np.zeros(9), np.eye(9))
    for start in (None, begin):
        end = search(here.kind, data, gauge, 0.05, start)
        there = Likelihood(here.kind, end.parameters, data, gauge).at(end.parameters, end.weights)
        there = climb(there, low, high, 5e-3, 25, near=True, weighted=False)
        assert penalised(there) < penalised(here) + 1.0


@pytest.mark.parametrize(
    ("kind", "parameters"),
    [(Kind.DRIFT, DRIFT), (Kind.VELOCITY, VELOCITY), (Kind.WANDER, WANDER)],
)
def test_parameters_and_nuisances_come_out(kind, parameters):
    nuisances = Nuisances(0.03, 2e-4, se3.exp(np.array([0.1, -0.05, 0.02, 0.05, 0.0, -0.1])), 1.02)
    found = fit(*estimate(kind, parameters, nuisances), ask)
    assert found is not None
    assert found.kind is kind
    assert found.converged
    assert (np.abs(nuisance_scores(found, nuisances)) < 4.0).all()
    for group, values in zip(GROUPS, np.exp(parameters), strict=True):
        for name, value in zip(kind.names, values, strict=True):
            figure = found.groups[group][name]
            assert is_covered(figure, value), (group, name)
    assert found.chi2_per_dof == pytest.approx(1.0, abs=0.1)
    assert np.abs(found.whiteness).max() < 0.15


def test_nothing_is_found_where_nothing_is():
    scores = [
        nuisance_scores(fit(*estimate(Kind.DRIFT, DRIFT, seed=s), ask), Nuisances.none())
        for s in range(5)
    ]
    assert (np.abs(scores) < 4.0).all()
    assert 0.6 < np.std(scores) < 1.4


@pytest.mark.parametrize(
    "nuisances",
    [
        Nuisances(0.6, 0.0, np.eye(4), 1.0),
        Nuisances(0.0, 0.0, se3.exp(np.array([0.3, 0.0, 0.0, 0.0, np.pi / 2, 0.0])), 1.0),
        Nuisances(0.0, 0.0, np.eye(4), 1000.0),
    ],
    ids=["clock", "mounting", "millimetres"],
)
def test_large_ones_are_found(nuisances):
    found = fit(*estimate(Kind.DRIFT, DRIFT, nuisances), ask)
    assert (np.abs(nuisance_scores(found, nuisances)) < 4.5).all()


@pytest.mark.skipif(
    not loops.there(), reason="NumPy finds no maximum there, so that none is fitted"
)
def test_innovations_that_are_exactly_nothing_have_no_correlation():
    def standing(seconds):
        return np.tile(np.eye(4), (len(seconds), 1, 1))

    stamps = np.arange(400) * 50_000_000 + 10**9
    poses = standing(stamps)
    poses[:, :3, 3] += np.random.default_rng(0).normal(0.0, 0.01, (400, 3))
    found = fit(stamps, poses, lambda asked: ask(asked, standing))
    assert found is not None
    assert (found.whiteness[1] == 0.0).all()
    assert (found.whiteness[0] != 0.0).all()
    json.dumps(named(found), allow_nan=False)


def test_what_the_motion_does_not_show_is_named():
    def straight(seconds):
        poses = np.tile(np.eye(4), (len(seconds), 1, 1))
        poses[:, 0, 3] = 2.0 * seconds
        return poses

    stamps, poses = estimate(Kind.DRIFT, DRIFT, path=straight)
    found = fit(stamps, poses, lambda stamps: ask(stamps, straight))
    names = {name for each in found.unobserved for name in each.names}
    assert {"clock_offset", "x", "y", "z"} <= names
    assert not {"scale"} & names
    assert len(found.std) == len(NAMES)


def noisy(path):
    """A ground truth that trembles by a tenth of a millimetre and half a milliradian."""
    rng = np.random.default_rng(7)
    phases, rates = rng.uniform(0.0, 6.3, (6, 8)), rng.uniform(5.0, 60.0, (6, 8))
    sizes = np.repeat([1e-4, 5e-4], 3)

    def trembling(seconds):
        waves = np.sin(np.multiply.outer(seconds, rates) + phases).sum(axis=2) / 2.0
        return path(seconds) @ se3.exp(waves * sizes)

    return trembling


def still(seconds):
    return np.tile(np.eye(4), (len(seconds), 1, 1))


def spinning(seconds):
    step = np.zeros((len(seconds), 6))
    step[:, 5] = 0.5 * np.asarray(seconds)
    return se3.exp(step)


def along_x(seconds):
    poses = still(seconds)
    poses[:, 0, 3] = np.asarray(seconds)
    return poses


@pytest.mark.parametrize(
    ("path", "hidden"),
    [
        (still, {"clock_offset", "x", "y", "z", "roll", "pitch", "yaw", "scale"}),
        (spinning, {"z", "yaw", "scale"}),
        (along_x, {"x", "y", "z", "roll"}),
    ],
    ids=["stands", "turns on the spot", "drives straight"],
)
def test_noise_is_not_taken_for_what_the_motion_does_not_show(path, hidden):
    # 5 mm and 5 mrad, many times the ground truth's: its trembling would be followed anywhere.
    parameters = np.log([[5e-3, 1e-4], [5e-3, 1e-4]])
    path = noisy(path)
    stamps, poses = estimate(Kind.DRIFT, parameters, count=2000, path=path)
    found = fit(stamps, poses, lambda stamps: ask(stamps, path))
    assert hidden <= {name for each in found.unobserved for name in each.names}
    assert (np.abs(nuisance_scores(found, Nuisances.none())) < 4.5).all()
    for group in GROUPS:
        assert found.groups[group]["jitter_std"].value == pytest.approx(5e-3, rel=0.05)
    for name in hidden:
        assert abs(found.nuisances.vector[NAMES.index(name)]) < OBSERVED_STD[NAMES.index(name)]


@pytest.mark.parametrize("what", ["outliers", "every second pose off"])
def test_whatever_a_standing_robots_errors_are_no_clock_is_blamed(what):
    path = noisy(still)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        more = np.zeros((2000, 6))
        if what == "outliers":
            more[rng.choice(2000, 40, replace=False)] = rng.normal(0.0, 0.2, (40, 6))
        else:
            more[::2, 0] = 0.03
        parameters = np.log([[2e-3, 1e-5], [2e-3, 1e-5]])
        stamps, poses = estimate(Kind.DRIFT, parameters, count=2000, seed=seed, path=path)
        found = fit(stamps, poses @ se3.exp(more), lambda stamps: ask(stamps, path))
        assert "clock_offset" in {name for each in found.unobserved for name in each.names}
        assert abs(found.nuisances.clock_offset) < 4.5 * found.std[0]


def test_a_jump_is_named_and_does_not_rule_the_fit():
    stamps, poses = estimate(Kind.DRIFT, DRIFT)
    shift = np.eye(4)
    shift[:3, 3] = [0.5, -0.3, 0.0]
    poses[250:] = shift @ poses[250:]
    found = fit(stamps, poses, ask)
    assert [jump.stamp for jump in found.jumps] == [stamps[250]]
    assert found.jumps[0].translation == pytest.approx(np.hypot(0.5, 0.3), abs=0.02)
    drift = found.groups["translation"]["drift_std"]
    assert abs(drift.value - 1e-2) < 4.0 * drift.std


def test_a_wander_that_the_run_is_too_short_for_is_a_drift_so_far():
    slow = np.log([[1e-3, 0.3, 400.0], [1e-3, 1e-2, 1.0]])
    found = fit(*estimate(Kind.WANDER, slow), ask)
    assert found.kind is Kind.WANDER
    part = found.groups["translation"]
    assert part["wander_time"].std > 0.5 * part["wander_time"].value
    walk = part["short_run_drift"]
    assert walk.std < 0.1 * walk.value
    assert abs(walk.value - 0.3 * np.sqrt(2.0 / 400.0)) < 4.0 * walk.std
    kind = dict(leading(named(found)))["Kind of error"]
    assert re.search(r"wander so far a drift of 2[\d.]+ ± [\d.]+ mm/√s, 0.5\d+ ±", kind)


@pytest.mark.parametrize("copied", ["orientations", "positions"])
def test_an_estimate_with_a_half_that_is_a_copy_of_the_ground_truth_has_a_model(copied):
    """Any nuisances make errors larger that are round-off, and nobody is misled by those."""
    stamps, poses = estimate(Kind.DRIFT, DRIFT)
    truth = ask(stamps).poses
    if copied == "orientations":
        poses[:, :3, :3] = truth[:, :3, :3]
    else:
        poses[:, :3, 3] = truth[:, :3, 3]
    found = fit(stamps, poses, ask)
    assert found is not None
    assert (np.abs(nuisance_scores(found, Nuisances.none())) < 4.0).all()


def test_bounds_stay_as_they_are():
    stamps, poses = estimate(Kind.DRIFT, DRIFT)
    problem, none = _Problem(stamps, poses, ask, None), Nuisances.none()
    data, _ = problem._prepared(none, near=True, part=True)
    before = [each.copy() for each in bounds(Kind.DRIFT, data)]
    problem.without_drift(none)
    for each, expected in zip(bounds(Kind.DRIFT, data), before, strict=True):
        np.testing.assert_array_equal(each, expected)


def test_too_few_poses_and_no_ground_truth_have_no_model():
    stamps, poses = estimate(Kind.DRIFT, DRIFT, count=ENOUGH - 1)
    assert fit(stamps, poses, ask) is None
    stamps, poses = estimate(Kind.DRIFT, DRIFT, count=ENOUGH + 1)
    nothing = Truth(
        np.zeros((41, 4, 4)), np.zeros((41, 6, 6)), np.zeros((41, 6)), np.zeros(41, bool)
    )
    assert fit(stamps, poses, lambda stamps: nothing) is None


def test_names_are_those_of_the_summary():
    summary = named(fit(*estimate(Kind.DRIFT, DRIFT, count=100), ask))
    assert summary["model"] == "drift"
    for group in GROUPS:
        assert {"jitter_std", "drift_std", "long_run_drift"} <= set(summary[group])
        by_time, by_distance = (
            summary[group][name]["value"]
            for name in ("long_run_drift", "long_run_drift_by_distance")
        )
        positions = motion(np.arange(100) / 20.0)[:, :3, 3]
        speed = np.linalg.norm(np.diff(positions, axis=0), axis=1).sum() / 4.95
        assert by_time / by_distance == pytest.approx(np.sqrt(speed), rel=0.05)
    assert set(summary["clock_offset"]) == {"value", "std"}
    assert len(summary["extrinsic"]["translation"]["value"]) == 3


def test_a_leap_to_a_pose_that_the_ground_truth_loses_stays_one():
    before, now = np.ones((2, 6), dtype=np.bool_)
    now[3] = False
    poses, steps = np.ones((6, 2)), np.ones((5, 2))
    poses[4], steps[2] = 5.0, [7.0, 1.0]
    measured, moved = _carried((poses, steps), before, now)
    np.testing.assert_array_equal(measured[:, 0], [1.0, 1.0, 1.0, 5.0, 1.0])
    np.testing.assert_array_equal(moved, [[1.0, 1.0], [1.0, 1.0], [7.0, 1.0], [1.0, 1.0]])


def test_what_nuisances_gain_is_what_the_likelihood_lacks_without_them():
    """The alignment is another one then: of a wander it is among what is fitted."""
    stamps, poses = estimate(Kind.WANDER, WANDER, Nuisances(0.01, 0.0, np.eye(4), 1.0))
    found = fit(stamps, poses, ask)
    assert found.kind is Kind.WANDER
    parameters = np.log([[each.value for each in found.groups[g].values()][:3] for g in GROUPS])
    data, gauge = _Problem(stamps, poses, ask, None)._prepared(Nuisances.none())
    without = Likelihood(found.kind, parameters, data, gauge)
    theta = without.theta[: len(NAMES)]
    own = without.theta_covariance[: len(NAMES), : len(NAMES)]
    lacks = found.log_likelihood - without.at_theta + 0.5 * theta @ np.linalg.solve(own, theta)
    assert found.log_likelihood - found.uncorrected == pytest.approx(lacks, rel=0.2)
