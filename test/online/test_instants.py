# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A ground truth that is sparser than the estimate: the conventional figures at its instants."""

import numpy as np
import numpy.typing as npt
import pytest

from trajeval_ros import se3
from trajeval_ros.alignment.umeyama import align_positions
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.instants import Instants
from trajeval_ros.online.samples import PoseSamples

Array = npt.NDArray[np.float64]
SECOND = 1_000_000_000


def handheld(seconds: Array) -> Array:
    """Motion with 0.7 Hz in it, which samples at 1 Hz do not show."""
    frequency = np.array([0.13, 0.31, 0.7])
    phase = np.arange(18.0).reshape(6, 3)
    size = np.array([0.5, 0.3, 0.05]) * np.array([1, 1, 1, 0.4, 0.4, 0.4])[:, None]
    angle = 2 * np.pi * frequency * np.asarray(seconds)[:, None, None] + phase
    return se3.exp((size * np.sin(angle)).sum(axis=2))


def stamps_of(seconds: Array) -> npt.NDArray[np.int64]:
    return np.rint(seconds * 1e9).astype(np.int64) + 1_700_000_000 * SECOND


def samples(seconds: Array, poses: Array) -> PoseSamples:
    return PoseSamples(stamps_of(seconds), *se3.to_position_quaternion(poses))


def estimated(seconds: Array) -> Array:
    noise = np.random.default_rng(0).normal(size=(len(seconds), 6)) * 0.02
    world = se3.exp(np.array([1.0, 2.0, 3.0, 0.1, 0.2, 2.0]))
    return np.asarray(se3.compose(se3.compose(world, handheld(seconds)), se3.exp(noise)))


def run(truth_step: float, pieces: int = 1) -> Engine:
    engine = Engine({"ground_truth.max_gap": 3.0})
    truth_at, at = np.arange(0.0, 60.0, truth_step), np.arange(0.33, 58.0, 0.05)
    truth, estimate = samples(truth_at, handheld(truth_at)), samples(at, estimated(at))
    for k in range(pieces):
        begin, end = stamps_of(np.array([k, k + 1]) * 60.0 / pieces)
        for whole, add in ((truth, engine.add_ground_truth), (estimate, engine.add_estimate)):
            inside = (whole.stamps >= begin) & (whole.stamps < end)
            parts = whole.stamps[inside], whole.positions[inside], whole.quaternions[inside]
            add(PoseSamples(*parts))
        engine.advance()
    engine.finish()
    return engine


@pytest.mark.parametrize("step", [1.0, 4.0])
def test_the_interpolation_of_the_ground_truth_is_no_error_of_the_estimate(step: float) -> None:
    engine = run(step)
    conventional = engine.summary()["conventional"]
    assert conventional["at"] == "ground_truth"
    # 2 cm an axis, and what interpolation of the estimate smooths of it.
    assert 0.02 < conventional["ate_translation_rmse"] < 0.04
    assert [n.code for n in engine.notices()].count("at_ground_truth") == 1


def test_a_dense_ground_truth_is_asked_at_the_estimates_instants() -> None:
    engine = run(0.02)
    conventional = engine.summary()["conventional"]
    assert conventional["at"] == "estimate"
    assert conventional["poses"] > 1000
    assert "at_ground_truth" not in [n.code for n in engine.notices()]


def test_the_figures_do_not_depend_on_the_batches() -> None:
    whole, pieces = (run(1.0, count).summary()["conventional"] for count in (1, 12))
    for key in ("poses", "ate_translation_rmse", "ate_rotation_rmse", "re_translation_rmse"):
        assert whole[key] == pytest.approx(pieces[key], rel=1e-9)


def test_against_the_obvious_way() -> None:
    truth_at, at = np.arange(0.5, 50.0, 1.0), np.arange(0.0, 50.0, 0.1)
    truth, estimate = handheld(truth_at), estimated(at)
    instants = Instants("se3", 1.0, "s")
    instants.add_ground_truth(stamps_of(truth_at), truth)
    for part in np.array_split(np.arange(len(at)), 7):
        instants.add_estimate(stamps_of(at[part]), estimate[part])
    expected = []
    for second in truth_at[1:]:
        i = int(np.searchsorted(at, second - 1e-9))
        w = (second - at[i - 1]) / (at[i] - at[i - 1])
        step = se3.log(se3.compose(se3.inverse(estimate[i - 1]), estimate[i]))
        expected.append(se3.compose(estimate[i - 1], se3.exp(w * step)))
    assert instants.figures is not None
    assert instants.count == len(expected)
    found = instants.figures.figures()
    aligned = align_positions(np.array(expected)[:, :3, 3], truth[1:, :3, 3], "se3")
    assert found.ate_translation_rmse == pytest.approx(aligned.rmse, rel=1e-9)


def test_an_estimate_as_sparse_as_the_ground_truth_is_not_interpolated() -> None:
    instants = Instants("se3", 1.0, "s")
    at = np.arange(0.0, 50.0, 1.0)
    instants.add_ground_truth(stamps_of(at), handheld(at))
    instants.add_estimate(stamps_of(at + 0.4), handheld(at + 0.4))
    assert instants.figures is None
    assert instants.count == 0


def test_samples_that_no_pose_asks_for_wait_in_bounded_memory() -> None:
    """However they come, the newest are kept, and are as good as if all had been."""
    stamps = stamps_of(np.arange(90_000.0))
    poses = np.broadcast_to(np.eye(4), (len(stamps), 4, 4))
    figures = []
    for size in (1_000, 45_000):
        instants = Instants("se3", 1.0, "s")
        for begin in range(0, len(stamps), size):
            instants.add_ground_truth(stamps[begin : begin + size], poses[begin : begin + size])
            assert instants._waiting <= 40_000 + size
        at = stamps_of(np.arange(89_900.0, 89_990.0, 0.25) + 0.1)
        instants.add_estimate(at, np.broadcast_to(np.eye(4), (len(at), 4, 4)))
        assert instants.figures is not None
        figures.append((instants.count, instants.figures.figures().pairs))
        assert sum(len(each) for each, _ in instants._samples) < 20
    assert figures[0] == figures[1]
    assert figures[0][0] == 89
