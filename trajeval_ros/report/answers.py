# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a person asks first, in words.

How good the estimate is, what kind of error it has, what is not its fault, where it is worst, and
whether the ground truth can be trusted there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from trajeval_ros.diagnosis.cause import earlier_or_later
from trajeval_ros.diagnosis.fitted import (
    beyond_doubt,
    digits_of,
    disagree,
    is_misread,
    shown_of_lever_arm,
    told_lever_arm,
)
from trajeval_ros.error_model.nuisances import NAMES, OBSERVED_STD
from trajeval_ros.report import covered
from trajeval_ros.report.after_closure import after_closure
from trajeval_ros.report.jumps import of_ground_truth

Figures = Mapping[str, Any]

# What is known no better is not said to be nothing; and what they are called.
_SEEN = dict(zip(NAMES, OBSERVED_STD.tolist(), strict=True))
_TITLES = (
    ("clock", ("clock_offset",)),
    ("clock rate", ("clock_rate",)),
    ("lever arm", ("x", "y", "z")),
    ("mounting", ("roll", "pitch", "yaw")),
    ("scale", ("scale",)),
)
# Drift by distance is said where the mean speed is 1 m/s and more.
_FAST = 1.0
# A time that is known to no more than this share of it tells no bounds.
_UNTOLD = 0.5
# 95 % of a normal distribution lie within so many standard deviations.
_BOUND = 1.96
# Autocorrelations beyond this say that the model does not hold.
WHITE = 0.2
# The noise of a sample is the assumed accuracy where it is no more than this times as large.
_OF_THE_FLOOR = 1.5
SHORT = 0.5
"""m: below, millimetres."""
# From here on there are as many digits as there are.
_MANY = 1000.0


def _two_digits(value: float) -> str:
    text = f"{value:.2g}"
    return f"{float(text):,.0f}" if "e+" in text else text


def _number(
    value: float, std: float | None, factor: float = 1.0, interval: list[float | None] | None = None
) -> str:
    """A figure with its standard deviation, to two digits of the latter; to three with none.

    Of one that has an interval, that.
    """
    value *= factor
    if interval is not None:
        low, high = (None if end is None else _two_digits(end * factor) for end in interval)
        if high is None or low is None:
            return f"> {low or f'{value:.2g}'}"
        return f"{low} to {high}" if interval[0] else f"< {high}"
    if std is None:
        return f"{value:.3g}" if abs(value) < _MANY else f"{value:,.0f}"
    std *= factor
    if not std > 0.0:
        return f"{value:.3g}"
    digits = digits_of(std, 9)
    # The zero takes the sign of what is rounded to it.
    return f"{round(value, digits) + 0.0:.{digits}f} ± {std:.{digits}f}"


def _length(figure: Figures, unit: str = "") -> str:
    value, std, interval = figure["value"], figure["std"], figure.get("interval")
    if max(abs(value), std or 0.0, *(end or 0.0 for end in interval or ())) < SHORT:
        return f"{_number(value, std, 1e3, interval)} mm{unit}"
    return f"{_number(value, std, 1.0, interval)} m{unit}"


def _angle(figure: Figures, unit: str = "") -> str:
    number = _number(figure["value"], figure["std"], math.degrees(1.0), figure.get("interval"))
    return f"{number} deg{unit}"


def first_lines(summary: Figures, parameters: Figures) -> list[str]:
    """Return the first lines of a result: what :func:`answer` says, as a terminal shows it."""
    return [
        f"{'' if further else title:13} {line}"
        for title, text in answer(summary, parameters)
        for further, line in enumerate(text.split("\n"))
    ]


def answer(summary: Figures, parameters: Figures) -> list[tuple[str, str]]:
    """Return how good it is, what kind of error, whose fault, where, each with its title.

    A text has a line break where one may be.
    """
    if summary.get("position_only"):
        return [
            *_how_good(summary, parameters),
            *_on_positions(summary),
            *_where(summary, parameters),
        ]
    if is_misread(cause["code"] for cause in summary.get("likely_causes", ())):
        text = "not told: the poses are not what they were read as, see the likely cause"
        return [*_how_good(summary, parameters), ("Kind of error", text)]
    return [
        *_how_good(summary, parameters),
        *sentences(summary),
        *_where(summary, parameters),
    ]


def _headline(summary: Figures) -> Figures:
    return summary.get("headline") or {}


def _start(summary: Figures) -> float:
    """When the run begins, s; zero where that is not known."""
    worst = _headline(summary).get("worst")
    return 0.0 if worst is None else worst["stamp"] * 1e-9 - worst["seconds_from_start"]


def _how_good(summary: Figures, parameters: Figures) -> list[tuple[str, str]]:
    conventional = summary["conventional"]
    step = f"{parameters['relative.delta']:g} {parameters['relative.unit']}"
    gauge = "not aligned" if summary["gauge"] == "none" else f"aligned by {summary['gauge']}"
    parts = [
        f"{title} {', '.join(shown)}"
        for title, name in ((f"ATE ({gauge})", "ate"), (f"RE (over {step})", "re"))
        if (shown := _with_interval(conventional, _headline(summary).get("intervals", {}), name))
    ]
    coverage = summary.get("coverage")
    if coverage:
        parts.append(f"over {covered.of_the_run(coverage)}")
        lost = covered.losses(coverage)
        parts += [lost] if lost else []
    found = [("How good", ";\n".join(parts))] if parts else []
    said = after_closure(summary.get("latest_path"))
    return [*found, ("As a whole", said)] if said else found


def _with_interval(conventional: Figures, intervals: Figures, name: str) -> list[str]:
    """Translation and rotation, each with its 95 % interval where there is one."""
    found = []
    for part, show in (("translation", _length), ("rotation", _angle)):
        key = f"{name}_{part}_rmse"
        rmse = conventional.get(key)
        if rmse is None:
            continue
        interval = intervals.get(key, {}).get("interval")
        between = ""
        if interval is not None:
            # In the unit of the figure itself, whatever theirs would be.
            factor = 1e3 if part == "translation" and rmse < SHORT else 1.0
            factor = math.degrees(1.0) if part == "rotation" else factor
            between = " ({} to {})".format(*(_number(v, None, factor) for v in interval))
        found.append(f"{show(_plain(rmse))}{between}")
    return found


def _where(summary: Figures, parameters: Figures) -> list[tuple[str, str]]:
    """Where it is worst, and how well the ground truth is known."""
    found = []
    worst, known = (_headline(summary).get(name) for name in ("worst", "ground_truth"))
    if worst is not None:
        found.append(
            (
                "Worst",
                f"{_length(_plain(worst['translation']))} at {worst['seconds_from_start']:.1f} s,"
                f" where the ground truth is known to {_length(_plain(worst['ground_truth_std']))}",
            )
        )
    if known is not None:
        text = f"the ground truth is known to {_length(_plain(known['translation_std']))}"
        if known["rotation_std"] is not None:
            text += f", {_angle(_plain(known['rotation_std']))}"
        floor = assumed_accuracy(summary, parameters)
        if floor is not None:
            text += f" (a sample is assumed to be good to {_length(_plain(floor))} at best)"
        if known["share_in_gaps"]:
            text += f";\n{covered.percent(known['share_in_gaps'])} of the poses lie in its gaps,"
            text += " and count in the likelihoods alone"
        found.append(("Trust", text))
    return found


def sentences(summary: Figures) -> list[tuple[str, str]]:
    """Return what the error model says, each with its title; nothing where nothing was fitted.

    A text has a line break where one may be. Times are said from the run's start on.
    """
    model = summary.get("error_model")
    if model is None:
        return []
    start = _start(summary)
    return [
        *leading(model, _headline(summary).get("without")),
        *_not_observed(model),
        *_jumps(model["jumps"], of_ground_truth(model["jumps"], summary), start),
        *_doubts(model, start),
    ]


def leading(model: Figures, without: Figures | None = None) -> list[tuple[str, str]]:
    """What kind of error it is, and what is not its fault; none of the model's lists is read."""
    return [("Kind of error", _kind(model)), ("Not its fault", _faults(model, without))]


def _kind(model: Figures) -> str:
    translation, rotation = model["translation"], model.get("rotation")
    if rotation is None:
        return _kind_of_positions(model["model"], translation)
    jitter = f"jitter {_length(_bounded(translation['jitter_std']))},"
    jitter += f" {_angle(_bounded(rotation['jitter_std']))}"
    if model["model"] == "wander":
        parts = f"wander {_wander(translation, _length)}, {_wander(rotation, _angle)}"
    else:
        parts = f"drift {_length(_bounded(translation['long_run_drift']), '/√s')},"
        parts += f" {_angle(_bounded(rotation['long_run_drift']), '/√s')}"
        far = translation.get("long_run_drift_by_distance")
        if far is not None and far["value"] < _FAST * translation["long_run_drift"]["value"]:
            parts += f" ({_length(_bounded(far), '/√m')})"
        if "velocity_std" in translation:
            parts += (
                f"\n(velocity error {_length(_bounded(translation['velocity_std']), '/s')} over"
            )
            parts += f" {_number(**translation['velocity_time'])} s)"
    return f"{jitter};\n{parts}"


def _bounded(figure: Figures) -> Figures:
    """A size that is less than its standard deviation, as its 95 % bound, where it has none yet."""
    value, std = figure["value"], figure["std"]
    return figure if std is None or value >= std else _within(figure)


def _within(figure: Figures) -> Figures:
    """What a size is at most: its 95 % bound."""
    bound = figure["value"] + _BOUND * figure["std"]
    return {**figure, "interval": figure.get("interval") or [0.0, bound]}


def _wander(part: Figures, sized: Callable[..., str]) -> str:
    """Its bounds and time; where the run is too short to tell them, the walk that it is so far."""
    time, walk = part["wander_time"], part.get("short_run_drift")
    if walk is not None and time["std"] is not None and time["std"] > _UNTOLD * time["value"]:
        return f"so far a drift of {sized(walk, '/√s')}"
    return f"{sized(_bounded(part['wander_std']))} over {_number(**time)} s"


def _kind_of_positions(kind: str, translation: Figures) -> str:
    jitter = f"jitter {_length(_bounded(translation['jitter_std']))}; "
    if kind == "wander":
        time = _number(**translation["wander_time"])
        return f"{jitter}wander {_length(_bounded(translation['wander_std']))} over {time} s"
    return f"{jitter}drift {_length(_bounded(translation['long_run_drift']), '/√s')}"


def _faults(model: Figures, without: Figures | None) -> str:
    """What is there beyond doubt, and within what there is none of the rest."""
    clock, rate, scale = model["clock_offset"], model["clock_rate"], model["scale"]
    doubtless = beyond_doubt(model)
    # Within doubt a length is no estimate: of nothing it is 1.6 standard deviations.
    arm, mounting = (
        model["extrinsic"][size] if name in doubtless else _within(model["extrinsic"][size])
        for name, size in (("lever arm", "length"), ("mounting", "angle"))
    )
    shown = {
        "clock": (clock["std"], "clock_offset", f"{_number(**clock, factor=1e3)} ms"),
        "clock rate": (rate["std"], "clock_rate", f"{_number(**rate, factor=1e6)} ppm"),
        "lever arm": (max(model["extrinsic"]["translation"]["std"]), "x", _length(arm)),
        "mounting": (max(model["extrinsic"]["rotation"]["std"]), "roll", _angle(mounting)),
        "scale": (scale["std"], "scale", _number(**scale)),
    }
    found = [f"{name} {shown[name][2]}" for name in doubtless]
    none = [
        f"{name} {text}"
        for name, (std, seen, text) in shown.items()
        if name not in doubtless and std <= _SEEN[seen]
    ]
    gain = model["nats_per_pose"] - model["nats_per_pose_uncorrected"]
    stamps = _stamps(model)
    if not found:
        nothing = (
            f"nothing beyond doubt ({', '.join(none)})" if none else "nothing that can be told"
        )
        return f"{stamps}.\nElse {nothing}" if stamps else nothing
    rest = f".\nNothing beyond doubt in {', '.join(none)}" if none else ""
    rest = f".\nBesides, {stamps}{rest}" if stamps else rest
    return f"{', '.join(found)}: {_number(gain, None)} nats a pose{_better(without)}{rest}"


def _stamps(model: Figures) -> str:
    """By how much its stamps scatter, and what that alone moves its poses by."""
    if "stamp_std" not in model:
        return ""
    moved = model["stamp_errors"]
    scatter = _number(**model["stamp_std"], factor=1e3)
    sizes = f"{_length(_plain(moved['translation']))}, {_angle(_plain(moved['rotation']))}"
    return f"its stamps scatter by {scatter} ms: {sizes} of its error"


def _on_positions(summary: Figures) -> list[tuple[str, str]]:
    """Of a ground truth without orientation: where its point is on the body, if elsewhere."""
    model = summary.get("error_model")
    arm = told_lever_arm(summary.get("lever_arm"), model)
    without = _headline(summary).get("without")
    found = [] if model is None else [("Kind of error", _kind(model))]
    if arm is not None and without is not None:
        size, std, unseen = shown_of_lever_arm(arm)
        text = f"lever arm {_length({'value': size, 'std': std})}"
        text += f" ({', '.join(unseen)}: the motion does not show it)" if unseen else ""
        found.append(("Not its fault", f"{text}{_better(without)}"))
    return found if model is None else [*found, *_correlated(model)]


def _better(without: Figures | None) -> str:
    """What the conventional figures are without them."""
    if without is None:
        return ""
    parts = [
        f"{name.upper()} {', '.join(shown)}"
        for name in ("ate", "re")
        if (shown := _errors(without, name))
    ]
    return f".\nWithout: {'; '.join(parts)}" if parts else ""


def _errors(figures: Figures, name: str) -> list[str]:
    translation, rotation = (figures.get(f"{name}_{p}_rmse") for p in ("translation", "rotation"))
    shown = [] if translation is None else [_length(_plain(translation))]
    return shown if rotation is None else [*shown, _angle(_plain(rotation))]


def assumed_accuracy(summary: Figures, parameters: Figures) -> float | None:
    """What a sample's position is assumed to be good to, m, where that and no noise rules it."""
    learned = summary["ground_truth"].get("hyperparameters")
    floor = float(parameters["ground_truth.translation_std"])
    if learned is None or parameters["gp.hyperparameters"] == "fixed":
        return None
    return floor if learned["translation"]["noise_std"] <= _OF_THE_FLOOR * floor else None


def _plain(value: float) -> dict[str, float | None]:
    return {"value": value, "std": None}


def _not_observed(model: Figures) -> list[tuple[str, str]]:
    hidden = {name for each in model["unobserved"] for name in each["of"]}
    parts = []
    for title, names in _TITLES:
        of = [name for name in names if name in hidden]
        if of:
            axes = "" if len(of) == len(names) else f" ({', '.join(of)})"
            parts.append(f"{title}{axes}")
    if not parts:
        return []
    return [("Not observed", f"{', '.join(parts)}: the motion does not show it")]


def _jumps(jumps: Sequence[Figures], blamed: Sequence[bool], start: float) -> list[tuple[str, str]]:
    """How many, and the largest; ``blamed``: whether the ground truth itself has jumped there."""
    own = [jump for jump, not_its in zip(jumps, blamed, strict=True) if not not_its]
    if not jumps:
        return []
    largest = max(own or jumps, key=lambda jump: jump["translation"])
    text = (
        f"{len(own) or len(jumps)}, the largest {_length(_plain(largest['translation']))},"
        f" {math.degrees(largest['rotation']):.2g} deg"
        f" at {largest['stamp'] * 1e-9 - start:.1f} s"
    )
    if not own:
        text += ", where the ground truth itself jumps"
    elif len(own) < len(jumps):
        text += f"; {len(jumps) - len(own)} more where the ground truth itself jumps"
    return [("Jumps", text)]


def _doubts(model: Figures, start: float) -> list[tuple[str, str]]:
    found = []
    if disagree(model):
        by = model["clock_offset_by"]
        first, second = (_number(**by[group], factor=1e3) for group in ("translation", "rotation"))
        text = f"positions alone say a clock of {first} ms, orientations alone {second} ms:\n"
        found.append(("Doubt", f"{text}no one offset puts both right"))
    for change in model.get("clock_changes", ())[:3]:
        size, when = change["after"] - change["before"], 0.5e-9 * (change["begin"] + change["end"])
        shown = f"{_number(abs(size), change['std'], 1e3)} ms {earlier_or_later(size)}"
        found.append(("Clock", f"its stamps are {shown} from {when - start:.1f} s on"))
    if not model.get("converged", True):
        text = "the search for the likeliest errors did not reach the end: the ± are too small"
        found.append(("Doubt", text))
    return [*found, *_correlated(model)]


def _correlated(model: Figures) -> list[tuple[str, str]]:
    worst = max(abs(lag) for part in model["whiteness"].values() for lag in part)
    if worst <= WHITE:
        return []
    text = f"errors are correlated beyond the model (by {worst:.2f}): the ± are too small"
    return [("Doubt", text)]


def applied_line(
    before: Figures, after: Figures, names: Sequence[str], doubted: Sequence[str]
) -> str:
    """What an evaluation with corrections changed.

    ``names``: of what was set; ``doubted``: of what was to be, and is within doubt.
    """
    are = "it was" if len(doubted) == 1 else "they were"
    left = f"{', '.join(doubted)}, within doubt, left as {are}" if doubted else ""
    if not names:
        return f"Applied       nothing: {left}"
    changes = []
    for name, part, factor, unit in (
        ("ATE", "translation", 1.0, "m"),
        ("ATE", "rotation", math.degrees(1.0), "deg"),
        ("RE", "translation", 1.0, "m"),
        ("RE", "rotation", math.degrees(1.0), "deg"),
    ):
        key = f"{name.lower()}_{part}_rmse"
        errors = [each["conventional"].get(key) for each in (before, after)]
        if None not in errors:
            old, new = (factor * error for error in errors)
            changes.append(f"{name} {old:.4g} to {new:.4g} {unit}")
    line = f"Applied       {', '.join(names)}: {', '.join(changes)}"
    return f"{line}; {left}" if left else line
