# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Clock, mounting and scale, from the error model's fit: as small as the data show them.

What is not the estimator's fault is named where the fit gains more by it than chance gives, and it
is large enough that somebody would set it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from trajeval_ros import se3
from trajeval_ros.diagnosis.cause import Cause, earlier_or_later, too_early
from trajeval_ros.diagnosis.rotations import Array
from trajeval_ros.error_model.nuisances import NAMES, OBSERVED_STD

GAIN = 10.0
"""Nats that a nuisance gains beyond doubt: 4.5 standard deviations, a chance of 7e-6, of nine."""

# A vector of three gains so much as rarely as one of three numbers gains `GAIN`, whatever its axes.
_GAIN_OF_THREE = 12.1
# So many standard deviations are beyond doubt; of two offsets of the clock, of the difference.
_APART = math.sqrt(2.0 * GAIN)
# s, m, rad, 1: below, nobody sets anything.
_SHORTEST, _NEAREST, _LEAST_TURN, _LEAST_SCALE = 5e-4, 5e-3, np.radians(0.1), 2e-3
# Clocks of one kind differ by more.
_FASTEST = 1e-5
# m, rad: less than a sample of the ground truth is good to is none of the estimate's.
_OF_A_SAMPLE = {"length": 5e-4, "angle": 5e-4}
# What is known no better is not named, however far from nothing: a fit of poses that do not belong
# together has such values.
_SEEN = dict(zip(NAMES, OBSERVED_STD.tolist(), strict=True))
# Of fewer poses, the scatter of a fit is not known well.
_ENOUGH = 200
_FITTED = ("clock_offset", "clock_rate", "body_frame", "scale")
# With these causes the poses are what they were read as, and a fit of them holds: it has a scale.
_OF_POSES_AS_READ = {
    *_FITTED,
    *("millimetres", "centimetres", "clock_change", "stamp_jitter", "lost"),
    "ground_truth_or_shared",
}
# Beyond what crystals differ by: 1e-4 is 6 ms a minute.
_LEAST_RATE = 1e-4


def fitted_causes(
    model: Mapping[str, Any], gauge: str, time_offset: float, extrinsic: Array
) -> tuple[Cause, ...]:
    """Return what the error model (as in ``summary.json``) says is not the estimator's fault.

    time_offset (s) and extrinsic (4, 4) have been applied already; an advice is the value to set.
    """
    if model["poses"] < _ENOUGH:
        return ()
    return (
        *clock_causes(model, time_offset),
        *_rate(model),
        *_changes(model),
        *_scattered_stamps(model),
        *_body_frame(model, extrinsic),
        *(_scale(model) if gauge not in ("none", "sim3") else ()),
    )


def together(coarse: tuple[Cause, ...], fitted: tuple[Cause, ...]) -> tuple[Cause, ...]:
    """What is found by gross signs, but for what the fit says better.

    Where poses are misread, a fit of them says nothing.
    """
    if any(cause.code not in _FITTED for cause in coarse):
        return coarse
    codes = {cause.code for cause in fitted}
    return (*(cause for cause in coarse if cause.code not in codes), *fitted)


def is_misread(codes: Iterable[str]) -> bool:
    """Whether likely causes, by their codes, say that poses are not what they were read as."""
    return not set(codes) <= _OF_POSES_AS_READ


def beyond_doubt(model: Mapping[str, Any]) -> tuple[str, ...]:
    """Which of clock, clock rate, lever arm, mounting and scale, as far as there, are not nothing.

    By 4.5 standard deviations; lever arm and mounting by what is as rare of three components
    together, since of nothing a length is 1.6 standard deviations already. Less than half a
    millisecond, millimetre or milliradian is nothing, nor is a rate of less than 10 ppm.
    """

    def number(name: str, nothing: float = 0.0) -> bool:
        return bool(abs(model[name]["value"] - nothing) > _APART * model[name]["std"])

    def vector(name: str) -> bool:
        figures = model["extrinsic"]
        is_told = figures[f"{name}_nats"] > _GAIN_OF_THREE
        return bool(is_told and figures[name]["value"] > _OF_A_SAMPLE[name])

    clock = number("clock_offset") and abs(model["clock_offset"]["value"]) > _SHORTEST
    if "rotation" not in model["extrinsic"]:  # against positions alone
        arm = lever_arm_is_beyond_doubt(model["extrinsic"]["translation"])
        told = {"clock": clock, "lever arm": arm}
    else:
        told = {
            "clock": clock,
            "clock rate": number("clock_rate") and abs(model["clock_rate"]["value"]) > _FASTEST,
            "lever arm": vector("length"),
            "mounting": vector("angle"),
            "scale": number("scale", 1.0),
        }
    return tuple(name for name, beyond in told.items() if beyond)


def digits_of(std: float, most: int) -> int:
    """The decimals of a figure that is known to ``std``: two digits of that, ``most`` at most."""
    return min(max(1 - math.floor(math.log10(max(std, 10.0**-most))), 0), most)


def told_lever_arm(
    arm: Mapping[str, Any] | None, model: Mapping[str, Any] | None
) -> Mapping[str, Any] | None:
    """The lever arm that positions alone tell, as uncertain as the estimate's own error makes it.

    ``model``: the run's error model, if any: a drift through the whole run looks like a lever arm.
    """
    if arm is None or model is None:
        return arm
    wider = model["extrinsic"]["translation"]["std"]
    return {
        "value": arm["value"],
        "std": [max(pair) for pair in zip(arm["std"], wider, strict=True)],
    }


def lever_arm_is_beyond_doubt(arm: Mapping[str, Any]) -> bool:
    """Whether the lever arm that positions alone tell differs from nothing, as `beyond_doubt`."""
    pairs = zip(*_of(arm), strict=True)
    is_told = any(abs(value) > _APART * std for value, std in pairs if std <= _SEEN["x"])
    return is_told and shown_of_lever_arm(arm)[0] > _OF_A_SAMPLE["length"]


def shown_of_lever_arm(arm: Mapping[str, Any]) -> tuple[float, float, tuple[str, ...]]:
    """How long the lever arm that positions alone tell is, its standard deviation, m.

    Of the axes that the motion shows, and the names of those that it does not.
    """
    values, stds = (np.array(each, dtype=np.float64) for each in _of(arm))
    seen = stds <= _SEEN["x"]
    size = float(np.linalg.norm(values[seen]))
    along = float(np.linalg.norm(values[seen] * stds[seen])) / size if size > 0.0 else 0.0
    return size, along, tuple(name for name, known in zip("xyz", seen, strict=True) if not known)


def lever_arm_to_set(arm: Mapping[str, Any]) -> Array:
    """The lever arm that positions alone tell, (3,), m; zero along axes that are not shown."""
    values, stds = (np.array(each, dtype=np.float64) for each in _of(arm))
    return np.where(stds <= _SEEN["x"], values, 0.0)


def lever_arm_causes(arm: Mapping[str, Any], applied: Array) -> tuple[Cause, ...]:
    """Return what positions alone say of where their point is on the estimate's body.

    applied: the extrinsic (4, 4), set already; the advice is the value to set.
    """
    size, std, unseen = shown_of_lever_arm(arm)
    if not lever_arm_is_beyond_doubt(arm) or size < _NEAREST:
        return ()
    shift = np.eye(4)
    shift[:3, 3] = -lever_arm_to_set(arm)
    of = (
        f" along its axes but {' and '.join(unseen)}, which the turns do not show" if unseen else ""
    )
    numbers = np.concatenate(se3.to_position_quaternion(shift @ applied))
    digits = digits_of(std, 4)
    return (
        Cause(
            "lever_arm",
            f"the ground truth is of a point {size:.{digits}f} ± {std:.{digits}f} m from the"
            f" estimate's body{of or ', which its turns show'}",
            f"set extrinsic={','.join(f'{number:.5g}' for number in numbers)}",
        ),
    )


def _of(vector: Mapping[str, Any]) -> tuple[Sequence[float], Sequence[float]]:
    return vector["value"], vector["std"]


def disagree(model: Mapping[str, Any]) -> bool:
    """Whether positions and orientations, each alone, say different clock offsets."""
    by = model.get("clock_offset_by")
    if not by:
        return False
    first, second = by["translation"], by["rotation"]
    apart = abs(first["value"] - second["value"])
    return bool(apart > _APART * math.hypot(first["std"], second["std"]) and apart > _SHORTEST)


def clock_causes(model: Mapping[str, Any], applied: float) -> tuple[Cause, ...]:
    """Return what the error model says of the clock; ``applied``: s, the offset set already."""
    value, std = model["clock_offset"]["value"], model["clock_offset"]["std"]
    gained = 0.5 * (value / std) ** 2
    if gained < GAIN or abs(value) < _SHORTEST or std > _SEEN["clock_offset"]:
        return ()
    whole = applied + value
    but = ""
    if disagree(model):
        positions = model["clock_offset_by"]["translation"]
        but = f"; by positions alone {1e3 * (applied + positions['value']):+.0f} ms,"
        but += " so it puts orientations right and not positions"
        if model["clock_offset_by"]["rotation"]["std"] > positions["std"]:
            but = "; orientations alone say otherwise"
    digits = digits_of(1e3 * std, 4)
    known = f" (estimate.time_offset is {applied:g})" if applied else ""
    return (
        Cause(
            "clock_offset",
            f"{too_early(1e3 * whole, digits, 'ms', f' ± {1e3 * std:.{digits}f}')}{known}:"
            f" {gained:,.0f} nats better with {1e3 * whole:+.{digits}f} ms added to them{but}",
            f"set estimate.time_offset={whole:.{digits + 3}f}",
        ),
    )


def _rate(model: Mapping[str, Any]) -> tuple[Cause, ...]:
    """A clock that runs fast or slow, by what is to be added to its stamps a second."""
    value, std = model["clock_rate"]["value"], model["clock_rate"]["std"]
    gained = 0.5 * (value / std) ** 2
    if gained < GAIN or abs(value) < _LEAST_RATE or std > _SEEN["clock_rate"]:
        return ()
    digits = digits_of(1e2 * std, 7)
    side = "fast" if value < 0.0 else "slow"
    return (
        Cause(
            "clock_rate",
            f"the estimate's clock runs {abs(1e2 * value):.{digits}f} ± {1e2 * std:.{digits}f} %"
            f" {side}: {gained:,.0f} nats",
            f"multiply the time since its first stamp by {1.0 + value:.{digits + 2}f}; live, let"
            " the clocks agree (PTP, NTP)",
        ),
    )


def _changes(model: Mapping[str, Any]) -> tuple[Cause, ...]:
    found = []
    for change in model.get("clock_changes", ())[:1]:
        size, when = change["after"] - change["before"], 0.5e-9 * (change["begin"] + change["end"])
        found.append(
            Cause(
                "clock_change",
                f"the estimate's stamps are {1e3 * abs(size):.1f} ± {1e3 * change['std']:.1f} ms"
                f" {earlier_or_later(size)} from stamp {when:.1f} s on",
                "look what its driver did then; evaluate the parts before and after by themselves",
            )
        )
    return tuple(found)


def _scattered_stamps(model: Mapping[str, Any]) -> tuple[Cause, ...]:
    """Stamps that are not those of the measurement."""
    scatter = model.get("stamp_std")
    if not scatter or model["stamp_nats"] < GAIN or scatter["value"] < _SHORTEST:
        return ()
    value, std = 1e3 * scatter["value"], 1e3 * scatter["std"]
    digits = digits_of(std, 4)
    return (
        Cause(
            "stamp_jitter",
            f"the estimate's stamps scatter by {value:.{digits}f} ± {std:.{digits}f} ms: its"
            " positions and orientations are off by the same times"
            f" ({model['stamp_nats']:,.0f} nats)",
            "stamp its poses with the time of the measurement, not of their arrival",
        ),
    )


def _body_frame(model: Mapping[str, Any], applied: Array) -> tuple[Cause, ...]:
    """What of lever arm and turn is beyond doubt, and the pose that has that and no more."""
    extrinsic = model["extrinsic"]
    pose = np.array(extrinsic["pose"])
    to_set, doubtless, found = np.array([*np.zeros(6), 1.0]), beyond_doubt(model), []
    arm, turn = ("length", slice(3)), ("angle", slice(3, 7))  # and where in the pose it is
    for title, name, (size_of, into), least, factor, unit, seen in (
        ("lever arm", "lever arm", arm, _NEAREST, 1e3, "mm", _SEEN["x"]),
        ("mounting", "turn", turn, _LEAST_TURN, math.degrees(1.0), "degrees", _SEEN["yaw"]),
    ):
        figure = extrinsic[size_of]
        if title not in doubtless or figure["value"] < least or figure["std"] > seen:
            continue
        gained = extrinsic[f"{size_of}_nats"]
        size, std = factor * figure["value"], factor * figure["std"]
        digits = digits_of(std, 4)
        found.append(
            f"a {name} of {size:.{digits}f} ± {std:.{digits}f} {unit} ({gained:,.0f} nats)"
        )
        to_set[into] = pose[into]
    if not found:
        return ()
    whole = se3.compose(se3.from_position_quaternion(to_set[:3], to_set[3:]), applied)
    numbers = np.concatenate(se3.to_position_quaternion(whole))
    shown = ",".join(f"{number:.5g}" for number in numbers)
    return (
        Cause(
            "body_frame",
            f"the estimate's body frame is not the ground truth's: {' and '.join(found)}",
            f"set extrinsic={shown}",
        ),
    )


def _scale(model: Mapping[str, Any]) -> tuple[Cause, ...]:
    value, std = model["scale"]["value"], model["scale"]["std"]
    logarithm = math.log(value)
    gained = 0.5 * (logarithm * value / std) ** 2
    if (
        "scale" not in beyond_doubt(model)
        or abs(logarithm) < _LEAST_SCALE
        or std > _SEEN["scale"] * value
    ):
        return ()
    digits = digits_of(std, 5)
    shown = f"{value:.{digits}f}"
    return (
        Cause(
            "scale",
            f"the estimate's positions need a factor of {shown} ± {std:.{digits}f}:"
            f" {gained:,.0f} nats",
            f"multiply the estimate's positions by {shown}, or set gauge=sim3",
        ),
    )
