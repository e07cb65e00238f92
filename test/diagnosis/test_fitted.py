# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Causes from the error model's fit: named when they matter, with the value to set."""

import numpy as np
import pytest
from error_model.test_fit import DRIFT, VELOCITY, WANDER, ask, estimate

from trajeval_ros import se3
from trajeval_ros.diagnosis.cause import Cause, too_early
from trajeval_ros.diagnosis.fitted import (
    beyond_doubt,
    disagree,
    fitted_causes,
    is_misread,
    lever_arm_causes,
    lever_arm_is_beyond_doubt,
    shown_of_lever_arm,
    together,
    told_lever_arm,
)
from trajeval_ros.error_model.fit import fit
from trajeval_ros.error_model.named import named
from trajeval_ros.error_model.nuisances import Nuisances
from trajeval_ros.error_model.process import Kind
from trajeval_ros.report.answers import answer, leading, sentences

FINE = np.log([[5e-4, 3e-3], [5e-4, 1e-3]])
ARM = se3.exp(np.array([0.03, 0.0, 0.02, 0.0, 0.0, 0.0]))
NONE = np.eye(4)


def causes(
    nuisances, parameters=FINE, kind=Kind.DRIFT, gauge="se3", offset=0.0, frame=NONE, **more
):
    found = fit(*estimate(kind, parameters, nuisances, **more), ask)
    return {c.code: c for c in fitted_causes(named(found), gauge, offset, frame)}


def test_some_milliseconds_are_named_with_the_value_to_set():
    found = causes(Nuisances(0.005, 0.0, NONE, 1.0))
    assert set(found) == {"clock_offset"}
    advised = float(found["clock_offset"].advice.removeprefix("set estimate.time_offset="))
    assert advised == pytest.approx(0.005, abs=1e-3)
    assert " ± " in found["clock_offset"].text
    # An advice is what to set, whatever is set.
    found = causes(Nuisances(0.005, 0.0, NONE, 1.0), offset=0.1)
    advised = float(found["clock_offset"].advice.removeprefix("set estimate.time_offset="))
    assert advised == pytest.approx(0.105, abs=1e-3)


def test_centimetres_of_a_lever_arm_are_named_on_top_of_what_is_set():
    frame = se3.exp(np.array([0.0, 0.1, 0.0, 0.0, 0.0, np.pi / 2]))
    found = causes(Nuisances(0.0, 0.0, ARM, 1.0), frame=frame)
    assert set(found) == {"body_frame"}
    numbers = [
        float(x) for x in found["body_frame"].advice.removeprefix("set extrinsic=").split(",")
    ]
    pose = se3.from_position_quaternion(np.array(numbers[:3]), np.array(numbers[3:]))
    off = se3.log(pose @ se3.inverse(ARM @ frame))
    assert np.abs(off[:3]).max() < 0.01
    assert np.abs(off[3:]).max() < 0.01


def test_of_a_lever_arm_that_positions_tell_the_axes_that_the_turns_show_are_said():
    arm = {"value": [0.3, 0.4, 0.05], "std": [0.003, 0.004, 9.9]}
    size, std, unseen = shown_of_lever_arm(arm)
    assert (size, unseen) == (pytest.approx(0.5), ("z",))
    assert std == pytest.approx(np.hypot(0.3 * 0.003, 0.4 * 0.004) / 0.5)
    (cause,) = lever_arm_causes(arm, NONE)
    assert " 0.5000 ± 0.0037 m " in cause.text
    assert "but z, which the turns do not show" in cause.text
    assert cause.advice.startswith("set extrinsic=-0.3,-0.4,0,")
    # Of what is not shown, nothing is beyond doubt, however far off it is.
    unknown = {"value": [0.0, 0.0, 50.0], "std": [0.003, 0.004, 9.9]}
    assert not lever_arm_is_beyond_doubt(unknown)
    assert lever_arm_causes(unknown, NONE) == ()
    unknown["std"] = [float("inf")] * 3
    assert shown_of_lever_arm(unknown) == (0.0, 0.0, ("x", "y", "z"))


def mounted(arm, turn, covariance):
    """An error model with such an extrinsic, m and rad, and such a covariance of the nuisances."""
    found = fit(*estimate(Kind.DRIFT, FINE, Nuisances.none()), ask)
    extrinsic = se3.exp(np.array([0.0, 0.0, 0.0, *turn]))
    extrinsic[:3, 3] = arm
    nuisances = Nuisances.none()._replace(extrinsic=extrinsic)
    return named(found._replace(nuisances=nuisances, covariance=covariance))


def test_a_cause_and_the_headline_say_the_same_and_the_advice_sets_no_more():
    """A lever arm within doubt is no part of what is advised for a turn beyond it."""
    stds = [1e-4, 1e-5, 0.024, 0.02, 3.0, 1e-3, 2e-3, 1e-3, 1e-3]
    model = mounted([0.06, -0.06, 0.0], [0.0, 0.0, 0.02], np.diag(np.square(stds)))
    faults = dict(leading(model))["Not its fault"]
    assert faults.startswith("mounting 1.146 ± 0.057 deg: ")
    assert "Nothing beyond doubt in" in faults
    assert "lever arm" not in faults
    (cause,) = (c for c in fitted_causes(model, "se3", 0.0, NONE) if c.code == "body_frame")
    assert "a turn of 1.146 ± 0.057 degrees" in cause.text
    assert "lever arm" not in cause.text
    assert cause.advice.startswith("set extrinsic=0,0,0,0,0,0.0099998,")


def test_a_size_is_known_along_itself_with_what_its_components_share():
    stds = [1e-4, 1e-5, 0.003, 0.004, 0.02, 1e-3, 2e-3, 1e-3, 1e-3]
    covariance = np.diag(np.square(stds))
    covariance[2, 3] = covariance[3, 2] = -0.5 * 0.003 * 0.004
    model = mounted([0.06, 0.08, 0.0], [0.0, 0.0, 0.0], covariance)
    # 0.6² 9 + 0.8² 16 - 0.6 0.8 12 = 7.72 mm².
    length, angle = (model["extrinsic"][name] for name in ("length", "angle"))
    assert length == pytest.approx({"value": 0.1, "std": 1e-3 * 7.72**0.5})
    assert angle == pytest.approx({"value": 0.0, "std": 2e-3})
    assert "lever arm 100.0 ± 2.8 mm" in dict(leading(model))["Not its fault"]
    (cause,) = (c for c in fitted_causes(model, "se3", 0.0, NONE) if c.code == "body_frame")
    assert "a lever arm of 100.0 ± 2.8 mm" in cause.text


def test_what_is_beyond_doubt_does_not_hang_on_the_axes_and_no_size_within_doubt_has_a_std():
    """Of 4.6 standard deviations of nothing, one number has a chance of 4e-6, a length of 1e-4."""
    std, turns = np.radians(0.05), se3.exp_so3(np.array([0.3, -0.8, 0.5]))
    stds = [1e-4, 1e-5, *[0.01] * 3, *[std] * 3, 1e-3]
    for size, beyond in ((4.6, False), (5.0, True)):
        for direction in (np.array([1.0, 0.0, 0.0]), turns[:, 0], turns[:, 1]):
            model = mounted(np.zeros(3), size * std * direction, np.diag(np.square(stds)))
            angle = model["extrinsic"]["angle"]
            assert angle["value"] / angle["std"] == pytest.approx(size)
            assert model["extrinsic"]["angle_nats"] == pytest.approx(0.5 * size**2)
            assert ("mounting" in beyond_doubt(model)) == beyond
            faults = dict(leading(model))["Not its fault"]
            if beyond:
                assert faults.startswith("mounting 0.250 ± 0.050 deg: ")
            else:
                # 0.23 and 1.96 times 0.05 degrees.
                assert "lever arm < 20 mm, mounting < 0.33 deg" in faults


@pytest.mark.parametrize(
    ("of", "inside"),
    [
        ({"clock_offset": 4e-4, "clock_rate": 8e-6}, ()),
        ({"clock_offset": 6e-4, "clock_rate": 1.2e-5}, ("clock", "clock rate")),
    ],
)
def test_what_nobody_could_set_is_none(of, inside):
    """However surely it is there."""
    model = mounted(np.array([4e-4, 0.0, 0.0]), np.zeros(3), np.eye(9) * 1e-12)
    for name, value in of.items():
        model[name] = {"value": value, "std": 1e-7}
    assert beyond_doubt(model) == inside
    model["extrinsic"]["length"]["value"] = 6e-4
    assert "lever arm" in beyond_doubt(model)


@pytest.mark.parametrize(("size", "beyond"), [(4e-4, False), (6e-4, True)])
def test_nor_is_a_lever_arm_that_positions_alone_tell(size, beyond):
    arm = {"value": [size, 0.0, 0.0], "std": [1e-6, 1e-6, 1e-6]}
    assert lever_arm_is_beyond_doubt(arm) == beyond


@pytest.mark.parametrize(
    ("offset", "text"),
    [(0.00868, "stamps are 8.7 ± 0.3 ms too early"), (-18.0, "stamps are 18 s too late")],
)
def test_on_which_side_stamps_are_off_is_a_word_and_no_sign(offset, text):
    digits, unit, known = (1, "ms", " ± 0.3") if offset > 0.0 else (0, "s", "")
    said = too_early(offset * (1e3 if unit == "ms" else 1.0), digits, unit, known)
    assert said == f"the estimate's {text}"


def test_to_which_side_stamps_change_is_the_same_word_everywhere():
    """Poses from the 800th on are stamped 12 ms too early: so much more is to be added to them."""
    stamps, found = estimate(Kind.DRIFT, FINE, Nuisances.none(), count=1600)
    late = stamps.copy()
    late[800:] -= 12_000_000
    model = named(fit(late, found, ask))
    (cause,) = (c for c in fitted_causes(model, "se3", 0.0, NONE) if c.code == "clock_change")
    assert " ms earlier from " in cause.text
    summary = {"error_model": model, "ground_truth": {}}
    assert " ms earlier from " in dict(sentences(summary))["Clock"]


def test_a_size_within_its_uncertainty_is_a_bound():
    """As of the node's run in blocks, whose parameters have no profile."""
    model = named(fit(*estimate(Kind.DRIFT, FINE, Nuisances.none()), ask))
    model["translation"]["jitter_std"] = {"value": 1e-6, "std": 1.3e-4}
    assert dict(leading(model))["Kind of error"].startswith("jitter < 0.26 mm, ")


def test_a_scale_is_named_but_where_it_is_free():
    nuisances = Nuisances(0.0, 0.0, NONE, 1.02)
    factor = causes(nuisances)["scale"].advice.split()[5].rstrip(",")
    assert float(factor) == pytest.approx(1.02, abs=3e-3)
    assert causes(nuisances, gauge="sim3") == {}


def test_a_clock_that_runs_fast_is_named_with_what_undoes_it():
    found = causes(Nuisances(0.0, -2e-3, NONE, 1.0))
    assert "clock_rate" in found
    assert " % fast" in found["clock_rate"].text
    factor = found["clock_rate"].advice.split()[8].rstrip(";")
    assert float(factor) == pytest.approx(0.998, abs=1e-4)
    assert "clock_rate" not in causes(Nuisances(0.0, 5e-5, NONE, 1.0))


def test_what_the_motion_does_not_show_is_not_named():
    """However far from nothing it comes out: its standard deviation is as large as any value."""
    model = named(fit(*estimate(Kind.DRIFT, FINE, Nuisances.none()), ask))
    model["scale"] = {"value": 570.0, "std": 570.0}
    model["clock_offset"] = {"value": -1.6, "std": 0.35}
    assert fitted_causes(model, "se3", 0.0, NONE) == ()


@pytest.mark.parametrize(
    ("kind", "parameters"),
    [(Kind.DRIFT, DRIFT), (Kind.DRIFT, FINE), (Kind.VELOCITY, VELOCITY), (Kind.WANDER, WANDER)],
)
def test_no_false_alarm(kind, parameters):
    for seed in range(4):
        assert causes(Nuisances.none(), parameters, kind, seed=seed) == {}


def test_few_poses_say_nothing():
    assert causes(Nuisances(0.005, 0.0, NONE, 1.0), count=150) == {}


def test_misread_poses_are_not_fitted_and_the_finer_of_two_is_kept():
    clock = Cause("clock_offset", "finer", "")
    assert together((Cause("quaternion_order", "", ""),), (clock,))[0].code == "quaternion_order"
    assert len(together((Cause("quaternion_order", "", ""),), (clock,))) == 1
    coarse = (Cause("clock_offset", "coarse", ""), Cause("scale", "", ""))
    assert [c.text for c in together(coarse, (clock,)) if c.code == "clock_offset"] == ["finer"]
    assert {c.code for c in together(coarse, (clock,))} == {"clock_offset", "scale"}


def test_positions_and_orientations_of_different_times_are_said():
    early = estimate(Kind.DRIFT, FINE, Nuisances(0.035, 0.0, NONE, 1.0), count=600)
    late = estimate(Kind.DRIFT, FINE, Nuisances(-0.035, 0.0, NONE, 1.0), count=600)
    mixed = early[1].copy()
    mixed[:, :3, :3] = late[1][:, :3, :3]
    model = named(fit(early[0], mixed, ask))
    by = model["clock_offset_by"]
    assert by["translation"]["value"] == pytest.approx(0.035, abs=0.01)
    assert by["rotation"]["value"] == pytest.approx(-0.035, abs=0.02)
    assert disagree(model)
    assert not disagree(named(fit(*early, ask)))


@pytest.mark.parametrize(
    ("codes", "misread"),
    [
        ((), False),
        (("scale", "lost"), False),
        (("millimetres",), False),
        (("time_base",), True),
        (("scale", "mirrored"), True),
    ],
)
def test_whether_there_is_an_answer(codes, misread):
    """Of poses that are not what they were read as nothing is said but that."""
    assert is_misread(codes) is misread
    causes = [{"code": code, "text": "", "advice": ""} for code in codes]
    conventional = {"ate_translation_rmse": 1.0, "ate_rotation_rmse": 1.0}
    summary = {"likely_causes": causes, "gauge": "se3", "conventional": conventional}
    parameters = {"relative.delta": 1.0, "relative.unit": "s"}
    told = dict(answer(summary, parameters))
    assert ("not told" in told.get("Kind of error", "")) is misread


@pytest.mark.parametrize(("widest", "beyond"), [(0.003, True), (0.02, False)])
def test_a_lever_arm_is_as_uncertain_as_the_error_model_has_it(widest: float, beyond: bool) -> None:
    """16 mm at five standard deviations of noise alone, and at less than one of a drift."""
    arm = {"value": [-0.004, -0.0162, 0.0], "std": [0.006, 0.003, 0.006]}
    model = {"extrinsic": {"translation": {"value": [0.0] * 3, "std": [0.006, widest, 0.006]}}}
    told = told_lever_arm(arm, model)
    assert told is not None
    assert lever_arm_is_beyond_doubt(told) == beyond
    assert told_lever_arm(arm, None) == arm
    assert told_lever_arm(None, model) is None
