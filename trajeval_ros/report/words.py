# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the report says: sentences and tables, from the figures."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from trajeval_ros.ground_truth.hyperparameters import FURTHER_COMPONENTS
from trajeval_ros.likelihood.figures import p_value as two_sided_p_value
from trajeval_ros.online.accounting import Reason
from trajeval_ros.online.parameters import PARAMETERS
from trajeval_ros.report import covered
from trajeval_ros.report.answers import SHORT, assumed_accuracy
from trajeval_ros.report.coverage import SECOND, Coverage
from trajeval_ros.report.run import Run
from trajeval_ros.report.series import Array, Series, coverage_gaps, span

Figures = Mapping[str, Any]
Row = tuple[str, str, str]

_DASH = "–"
_NOT_TOLD_APART = 0.01
_UNSCALED = ("Relative ", "Pose to pose", "Absolute, first order")


def number(value: float | None, digits: int = 4) -> str:
    """Return a figure in few characters, thousands separated, or a dash for None."""
    if value is None:
        return _DASH
    if isinstance(value, int):
        return f"{value:,}".replace("-", "−")
    size = abs(value)
    if size < 1e3:
        text = f"{value:.{digits}g}"
    elif size < 1e9:
        text = f"{value:,.0f}"
    elif size < 1e15:
        text = f"{value / 1e12:.{digits}g} T" if size >= 1e12 else f"{value / 1e9:.{digits}g} G"
    else:
        text = f"{value:.{digits - 1}e}"
    return text.replace("-", "−")


def length(metres: float | None) -> str:
    """Return a length as the first lines of a result say it: below half a metre in millimetres."""
    if metres is None:
        return _DASH
    if metres >= 1000.0:
        return f"{metres:,.0f} m"
    return f"{metres:.3g} m" if metres >= SHORT else f"{1e3 * metres:.3g} mm"


def angle(radians: float | None) -> str:
    """Return an angle in degrees."""
    return _DASH if radians is None else f"{math.degrees(radians):.3g}°"


def p_value(figures: Figures) -> float | None:
    """Return how often an estimate as good as the ground truth has a χ² as far out, either side."""
    if figures.get("p_value") is not None:
        return float(figures["p_value"])
    chi2, dof = figures.get("chi2"), figures.get("dof")
    if chi2 is None or not dof:
        return None
    return float(two_sided_p_value(chi2, dof))


def verdict(run: Run, series: Series | None) -> str:
    """Return how good it is, where it is bad, and whether the ground truth can be trusted."""
    if series is None:
        return "No estimate has been evaluated."
    if not series.shows_errors:
        return lead(run)
    worst = series.worst
    return (
        f"{lead(run)} The estimate is furthest off at {series.seconds[worst]:.1f} s, by"
        f" <b>{length(series.translation_error[worst])}</b>, where the ground truth is known to"
        f" {length(series.translation_band[worst])} (two standard deviations)."
        f" {_trust(run, series)}"
    )


def lead(run: Run) -> str:
    """Return how much is covered, and whether the estimate can be told from the ground truth."""
    return " ".join(filter(None, (_covered(run.summary["coverage"]), not_told_apart(run))))


def not_told_apart(run: Run) -> str:
    """Say so where the errors are within what the ground truth is known to; else nothing."""
    # A relative likelihood does not know the scale.
    which = "absolute" if run.summary["gauge"] == "sim3" else "relative"
    likelihood = run.summary[which]
    probability = p_value(likelihood)
    if probability is None:
        return ""
    alike = probability > _NOT_TOLD_APART or likelihood["chi2_per_dof"] < 1.0
    return "The estimate cannot be told from the ground truth." if alike else ""


def spread(name: str, series: Series) -> list[str]:
    """A sentence on the size of the errors for each part; ``name``: of the estimate, if said."""
    if not series.shows_errors:
        return []
    parts: list[tuple[str, Array, Callable[[float], str]]] = [
        ("Translation", series.translation_error, length)
    ]
    if series.has_rotation:
        parts.append(("Rotation", series.rotation_error, angle))
    said = []
    known = series.known
    aside = "" if known.all() else " (where the ground truth is known as well as usual)"
    for part, every, show in parts:
        errors = every[known]
        median, most = (show(float(value)) for value in np.quantile(errors, (0.5, 0.95)))
        largest = int(np.argmax(errors))
        title = f"{name}, {part.lower()}" if name else part
        said.append(
            f"{title}: median {median}, nineteen in twenty below {most}, largest"
            f" {show(float(errors[largest]))} at {series.seconds[known][largest]:.1f} s{aside}."
        )
    return said


def _covered(coverage: Figures) -> str:
    """How much of the run there is an estimate for."""
    lost = covered.losses(coverage)
    share = coverage["time"]
    if share is None:
        return ""
    text = f"The estimate covers <b>{covered.percent(share)}</b> of"
    text += f" {covered.seconds(coverage['duration'])}"
    return f"{text}{': it was ' + lost if lost else ''}."


def _trust(run: Run, series: Series) -> str:
    gaps = coverage_gaps(run.ground_truth)
    typical = length(float(np.median(series.translation_band)))
    text = f"The ground truth is typically known to {typical}{_assumed(run)}"
    if not gaps:
        return f"{text} and has no gap."
    longest = max(gaps, key=lambda gap: gap.seconds)
    at = (longest.start - series.start) / SECOND
    unscored = run.summary["estimate"]["rejected"].get("no_ground_truth", 0)
    count = "one gap" if len(gaps) == 1 else f"{len(gaps)} gaps, the longest"
    tail = f"; {unscored:,} estimates in there have no score" if unscored else ""
    return f"{text} and has {count} of {longest.seconds:.1f} s at {at:.0f} s{tail}."


def _assumed(run: Run) -> str:
    """Say so where the ground truth's accuracy is the one that was assumed, and not found."""
    floor = assumed_accuracy(run.summary, run.parameters)
    if floor is None:
        return ""
    return (
        f" (two standard deviations; a sample is assumed to be good to {length(floor)} at best:"
        " set ground_truth.translation_std)"
    )


def tiles(run: Run, series: Series | None) -> list[Row]:
    """Return the figures that everybody looks for first."""
    summary = run.summary
    scaled = summary["gauge"] == "sim3"
    which = "absolute" if scaled else "relative"
    conventional, likelihood = summary["conventional"], summary[which]
    estimate = summary["estimate"]
    gauge = "not aligned" if summary["gauge"] == "none" else f"aligned, {summary['gauge']}"
    ratio = likelihood.get("chi2_per_dof")
    rotation = f"and {angle(conventional.get('ate_rotation_rmse'))}, "
    of_positions = summary.get("position_only")
    relative = (
        f"RE over {_step(run)}",
        length(conventional.get("re_translation_rmse")),
        f"and {angle(conventional.get('re_rotation_rmse'))}, RMSE",
    )
    return [
        (
            "ATE, absolute error",
            length(conventional.get("ate_translation_rmse")),
            f"{'' if of_positions else rotation}RMSE, {gauge}",
        ),
        *([] if of_positions else [relative]),
        ("Coverage", *_coverage(summary["coverage"])),
        (
            f"{which.capitalize()} log-likelihood",
            _short(likelihood.get("log_likelihood")),
            f"nats; χ²/dof {_short(ratio)}, p-value {_probability(p_value(likelihood))}",
        ),
        *([("Scale correction", *_scale(summary))] if scaled else []),
        (
            "Estimates evaluated",
            f"{estimate['evaluated']:,}",
            f"of {estimate['received']:,} received",
        ),
        ("Ground truth", _rate(run.ground_truth), _samples(run)),
    ]


def _coverage(coverage: Figures) -> tuple[str, str]:
    if coverage["time"] is None:
        return _DASH, ""
    distance = coverage["distance"]
    way = f"of {covered.seconds(coverage['duration'])}"
    if distance is not None:
        way += f", {covered.percent(distance)} of {length(coverage['path_length'])}"
    lost = covered.losses(coverage)
    return covered.percent(coverage["time"]), f"{way}; {lost or 'never lost'}"


def _scale(summary: Figures) -> tuple[str, str]:
    """The scale of ATE's alignment, which the error model's need not equal: no ± of that here."""
    found = summary["conventional"]["alignment"]["scale"]
    if found is None:
        return _DASH, ""
    return f"{found:.5g}", "ground-truth metres to one of the estimate's, by ATE's alignment"


def _step(run: Run) -> str:
    return f"{run.parameters['relative.delta']:g} {run.parameters['relative.unit']}"


def _short(value: float | None) -> str:
    if value is None:
        return _DASH
    for size, suffix in ((1e9, " G"), (1e6, " M"), (1e4, " k")):
        if abs(value) >= size:
            scale = 1e3 if suffix == " k" else size
            return f"{value / scale:.4g}{suffix}".replace("-", "−")
    return f"{value:,.4g}".replace("-", "−")


def _probability(value: float | None) -> str:
    if value is None:
        return _DASH
    return "< 0.0001" if value < 1e-4 else f"{value:.3g}"


def _rate(coverage: Coverage) -> str:
    if coverage.total < 2 or coverage.earliest is None or coverage.latest is None:
        return _DASH
    gaps = coverage_gaps(coverage)
    silent = sum(gap.seconds for gap in gaps)
    seconds = (coverage.latest - coverage.earliest) / SECOND - silent
    if seconds <= 0:
        return _DASH
    return f"{(coverage.total - 1 - len(gaps)) / seconds:.3g} Hz"


def _samples(run: Run) -> str:
    gaps = coverage_gaps(run.ground_truth)
    lacking = f"{len(gaps)} gaps, {sum(gap.seconds for gap in gaps):.1f} s" if gaps else "no gap"
    return f"{run.summary['ground_truth']['used']:,} samples, {lacking}"


def figures(run: Run) -> list[Row]:
    """Return the table of figures, each with what it says."""
    summary = run.summary
    relative, absolute = summary["relative"], summary["absolute"]
    window = summary["window"]
    conventional = summary["conventional"]
    equivalent = [
        show(window["absolute"].get(f"noise_equivalent_{part}_std"))
        for part, show in (("translation", length), ("rotation", angle))
    ]
    last = f"the last {run.parameters['window.duration']:g} s"
    rows = [
        (
            "Relative log-likelihood",
            f"{number(relative.get('log_likelihood'))} nats",
            f"of the motion between neighbouring estimates, over the whole run;"
            f" {number(relative.get('nats_per_pose'))} nats a pose",
        ),
        (
            "Relative χ²",
            number(relative.get("chi2")),
            f"with {number(relative.get('dof'))} degrees of freedom; p-value"
            f" {_probability(p_value(relative))}",
        ),
        (
            "Relative log-determinant",
            number(relative.get("log_det")),
            "how uncertain the ground truth is: larger where it is known less well",
        ),
        (
            "Relative χ² per degree of freedom",
            number(relative.get("chi2_per_dof")),
            "1 for an estimate as good as the ground truth",
        ),
        (
            "Pose to pose, translation and rotation",
            f"{length(relative.get('translation_rmse'))}, {angle(relative.get('rotation_rmse'))}",
            "RMSE of the step from one estimate to the next, in gaps of the ground truth too",
        ),
        (
            "Absolute log-likelihood",
            f"{number(absolute.get('log_likelihood'))} nats",
            f"running, integrated over the gauge {summary['gauge']}",
        ),
        (
            "Absolute, first order",
            f"{number(absolute.get('log_likelihood_first_order'))} nats",
            "the paper's; equal to the relative one up to round-off",
        ),
    ]
    if absolute.get("log_likelihood_nonlinear") is not None:
        rows.append(
            (
                "Absolute, nonlinear",
                f"{number(absolute['log_likelihood_nonlinear'])} nats",
                "over all poses at the best alignment; its distance from first order says how far"
                " first order holds",
            )
        )
    rows += [
        (
            "Absolute χ² per degree of freedom",
            number(absolute.get("chi2_per_dof")),
            f"with {number(absolute.get('dof'))} degrees of freedom",
        ),
        (
            "Aligned by likelihood, translation and rotation",
            f"{length(absolute.get('translation_rmse'))}, {angle(absolute.get('rotation_rmse'))}",
            "RMSE under the likelihood-weighted alignment, in gaps of the ground truth too",
        ),
        (
            f"Relative log-likelihood of {last}",
            f"{number(window['relative'].get('log_likelihood'))} nats",
            f"χ²/dof {number(window['relative'].get('chi2_per_dof'))}; taken alone, so it compares",
        ),
        (
            f"Absolute log-likelihood of {last}",
            f"{number(window['absolute'].get('log_likelihood'))} nats",
            f"χ²/dof {number(window['absolute'].get('chi2_per_dof'))}; nonlinear, aligned anew",
        ),
        (
            f"Noise-equivalent error of {last}",
            ", ".join(equivalent),
            "the white noise that explains the errors, the ground truth's own share taken out",
        ),
        (
            "ATE",
            f"{length(conventional.get('ate_translation_rmse'))},"
            f" {angle(conventional.get('ate_rotation_rmse'))}",
            "conventional absolute error, RMSE after aligning the positions",
        ),
        *_distribution(conventional, "ate", "ATE"),
        (
            f"RE over {_step(run)}",
            f"{length(conventional.get('re_translation_rmse'))},"
            f" {angle(conventional.get('re_rotation_rmse'))}",
            "conventional relative error, RMSE",
        ),
        *_distribution(conventional, "re", "RE"),
        *_over_all_pairs(run.summary.get("drift") or {}, _step(run)),
        *_kitti(run.summary.get("drift") or {}),
    ]
    if summary.get("position_only"):
        return _of_positions(rows)
    if summary["gauge"] == "sim3":
        # A step of the estimate is not in metres, and its likelihood means nothing.
        return [row for row in rows if not row[0].startswith(_UNSCALED)]
    return rows


def _of_positions(rows: Iterable[Row]) -> list[Row]:
    """The rows that need no orientation, without what is of one."""
    both = ", translation and rotation"
    return [
        (title.removesuffix(both), value.removesuffix(f", {_DASH}"), text)
        for title, value, text in rows
        if ", rotation," not in title and not title.startswith(("RE over", "RE, ", "Noise"))
    ]


def _over_all_pairs(drift: Mapping[str, Any], step: str) -> list[Row]:
    found = drift.get("all_pairs")
    if not found:
        return []
    translation, rotation = (found[f"re_{part}_rmse"] for part in ("translation", "rotation"))
    return [
        (
            f"RE over {step}, all pairs",
            f"{length(translation)}, {angle(rotation)}",
            f"RMSE of {found['pairs']:,} steps, from every pose; they overlap",
        )
    ]


def _kitti(drift: Mapping[str, Any]) -> list[Row]:
    """The benchmark's drift, over all lengths and over each."""
    found = drift.get("kitti")
    if not found:
        return []
    return [
        (
            f"Drift over {each['length']:g} m" if "length" in each else "Drift, KITTI's",
            f"{number(100.0 * each['translation'])} %, {angle(each['rotation'])}/m",
            f"mean of {each['subsequences']:,} sub-trajectories"
            + ("" if "length" in each else " of 100 to 800 m"),
        )
        for each in (found, *found["lengths"])
    ]


def _distribution(conventional: Mapping[str, Any], name: str, title: str) -> list[Row]:
    """Two rows: translation and rotation."""
    rows: list[Row] = []
    for part, show in (("translation", length), ("rotation", angle)):
        found = conventional.get("distributions", {}).get(f"{name}_{part}") or {}
        values = (show(found.get(key)) for key in ("median", "max"))
        rest = ", ".join(f"{key} {show(found.get(key))}" for key in ("mean", "std", "min"))
        rows.append((f"{title}, {part}, median and maximum", ", ".join(values), rest))
    return rows


def accounts(run: Run) -> list[Row]:
    """Return what became of every message."""
    rows: list[Row] = []
    for key, title, taken in (
        ("estimate", "Estimate", "evaluated"),
        ("ground_truth", "Ground truth", "used"),
    ):
        counts = run.summary[key]
        coverage = run.estimate if key == "estimate" else run.ground_truth
        rows.append((f"{title}, received", f"{counts['received']:,}", _rate(coverage)))
        rows.append((f"{title}, {taken}", f"{counts[taken]:,}", ""))
        if counts.get("pending"):
            rows.append((f"{title}, pending", f"{counts['pending']:,}", "not decided yet"))
        rows += [
            (f"{title}, {reason}", f"{count:,}", _REASONS[reason])
            for reason, count in counts["rejected"].items()
            if count
        ]
        if counts.get("cut"):
            rows.append((f"{title}, cut", f"{counts['cut']:,}", "outside of --start and --end"))
    return rows


# Those of the engine, and the node's own.
_REASONS = {str(reason): reason.explanation for reason in Reason} | {
    "undecodable": "the bytes are not those of the message's type",
}


# Prefix of the names of a kernel's two numbers -> what it stands for.
_COMPONENTS = {"": "motion"} | {f"{part}_": text for part, text in FURTHER_COMPONENTS.items()}


def model(run: Run) -> list[Row]:
    """Return the Gaussian process as it was."""
    truth = run.summary["ground_truth"]
    hyperparameters = truth.get("hyperparameters")
    learned = run.parameters["gp.hyperparameters"] == "auto"
    rows: list[Row] = [
        ("Kernel", html.escape(str(run.parameters["gp.kernel"])), f"{truth['segments']:,} segments")
    ]
    if hyperparameters is None:
        return [*rows, ("Hyperparameters", _DASH, "too little ground truth to learn them")]
    source = "learned from the first segments" if learned else "as set by parameter"
    for group, show in (("translation", length), ("rotation", angle)):
        values = hyperparameters[group]
        if values is None:  # of positions alone
            continue
        for name, title in _COMPONENTS.items():
            scale = values.get(f"{name}length_scale")
            std = values.get(f"{name}std", values.get(f"{name}signal_std"))
            if std and scale:
                rows.append(
                    (f"{group.capitalize()}, {title}", f"{show(std)} over {scale:.3g} s", source)
                )
        rows.append((f"{group.capitalize()}, noise", show(values["noise_std"]), "of one sample"))
    fit = truth.get("fit")
    if fit is not None:
        means = f"{fit['translation_mean_square']:.2g}"
        if fit["rotation_mean_square"] is None:
            rows.append(("Fit", means, "1 is a process that fits"))
        else:
            means = f"{means}, {fit['rotation_mean_square']:.2g}"
            rows.append(("Fit, translation and rotation", means, "1 is a process that fits"))
        adapted = f"{fit['segments_adapted']:,} of {fit['segments_closed']:,}"
        rows.append(("Segments that changed it", adapted, "their samples refuted it"))
        if fit["stamp_std"]:
            uncertain = f"{1e3 * fit['stamp_std']:.2g} ms"
            rows.append(("Stamps, uncertain to", uncertain, "noise along the motion, learned"))
    for fault in truth.get("faults", ()):
        span = f"{fault['begin'] / SECOND:.3f} s to {fault['end'] / SECOND:.3f} s"
        rows.append((f"Fault: {fault['code']}", span, html.escape(fault["text"])))
    return rows


def parameters(run: Run) -> list[tuple[str, str, str, bool]]:
    """Return every parameter with its value, what it is, and whether it was changed."""
    rows = []
    for name, parameter in PARAMETERS.items():
        value = run.parameters.get(name, parameter.default)
        if isinstance(value, list | tuple):
            shown, value = ", ".join(_shown(entry) for entry in value), tuple(value)
        else:
            shown = str(value).lower() if isinstance(value, bool) else str(value)
        same = value == parameter.default
        unit = f" ({parameter.unit})" if parameter.unit else ""
        rows.append((name, shown or '""', f"{parameter.description}{unit}", not same))
    return rows


def _shown(entry: float | str) -> str:
    return entry if isinstance(entry, str) else f"{entry:g}"


def when(run: Run) -> str:
    """Return the span of the data."""
    start, end = span(run)
    if end <= start:
        return ""
    return f"Data from stamp {start / SECOND:.3f} s to {end / SECOND:.3f} s."
