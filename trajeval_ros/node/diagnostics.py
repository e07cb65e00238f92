# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node's health: pure functions from what is known to a level, a sentence and values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import IntEnum

from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.files.fixes import FixCounts
from trajeval_ros.node.inputs import InputState
from trajeval_ros.online.results import Health, TopicHealth
from trajeval_ros.runs.session import UNDECODABLE

_SECOND = 1_000_000_000
_SILENCE = 5.0
_CONSISTENT = 1e-6
# Of the standardised innovations; one when the process fits.
_MISFIT = 3.0
_YEAR = 366 * 86_400 * _SECOND


class Level(IntEnum):
    """The levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing to say."""

    level: Level
    text: str


# Findings and values.
Further = tuple[Sequence[Finding], Mapping[str, object]]


@dataclass(frozen=True, slots=True)
class Status:
    """One entry of ``/diagnostics``."""

    name: str
    level: Level
    message: str
    values: Mapping[str, str] = field(default_factory=dict)


def merge(
    name: str, findings: Iterable[Finding], otherwise: str, values: Mapping[str, object]
) -> Status:
    """One status of all findings: the worst first, its level for the whole."""
    ordered = sorted(findings, key=lambda finding: -finding.level)
    level = ordered[0].level if ordered else Level.OK
    message = "; ".join(finding.text for finding in ordered) or otherwise
    texts = {
        key: repr(value) if isinstance(value, float) else str(value)
        for key, value in values.items()
        if value is not None
    }
    return Status(name, level, message, texts)


def joined(statuses: Mapping[str, Status]) -> Status:
    """Join one status of several estimates, by their names; of one it is as it is.

    What is well is not said beside what is not; what is the same of all is said once.
    """
    found = list(statuses.values())
    if len(found) == 1:
        return found[0]
    worst = max(status.level for status in found)
    texts = {status.message for status in found}
    said = [(n, s) for n, s in statuses.items() if s.level > Level.OK] or statuses.items()
    ordered = sorted(said, key=lambda entry: -entry[1].level)
    message = "; ".join(f"{name}: {status.message}" for name, status in ordered)
    values = {
        f"{name}.{key}": value
        for name, status in statuses.items()
        for key, value in status.values.items()
    }
    return Status(found[0].name, worst, message if len(texts) > 1 else texts.pop(), values)


@dataclass(frozen=True, slots=True)
class Traffic:
    """A topic in the last period: messages a second, and seconds since the last one (or None)."""

    rate: float
    silence: float | None
    rejected: Mapping[str, int]
    lost: int
    frame_changes: int


def check_topic(
    name: str,
    state: InputState,
    health: TopicHealth,
    traffic: Traffic,
    used: str,
    further: Further = ((), {}),
) -> Status:
    """Whether a topic has publishers, is heard, and sends what can be used.

    ``further`` is what there is to say of what it sends: it goes before the rest of its level.
    """
    findings = [*further[0]]
    findings += [Finding(Level.ERROR, problem) for problem in state.plan.problems]
    findings += _check_presence(state, health, traffic)
    if traffic.lost:
        findings.append(Finding(Level.WARN, f"{traffic.lost} messages lost on the way"))
    rejected = dict(traffic.rejected)
    undecodable = rejected.pop(UNDECODABLE, 0)
    if rejected:
        reasons = ", ".join(f"{count} {reason}" for reason, count in rejected.items())
        findings.append(Finding(Level.WARN, f"rejected in the last second: {reasons}"))
    if undecodable:
        findings.append(Finding(Level.ERROR, f"{undecodable} messages are not readable"))
    if traffic.frame_changes:
        findings.append(
            Finding(
                Level.WARN, f"frame_id changed {traffic.frame_changes} times; is one source meant?"
            )
        )
    offer = state.plan.offer
    values: dict[str, object] = {
        "topic": state.topic,
        "publishers": len(state.publishers),
        "type": offer.type_name if offer else "",
        "reliability": offer.reliability if offer else "",
        "durability": offer.durability if offer else "",
        "received": health.received,
        used: health.used,
        "pending": health.pending,
        "rejected": sum(health.rejected.values()),
        **{f"rejected_{reason}": count for reason, count in health.rejected.items()},
        "lost": state.lost,
        "frame_changes": state.frame_changes,
        "rate": traffic.rate,
        "silence": traffic.silence,
        "first_stamp": _seconds(health.first_stamp),
        "latest_stamp": _seconds(health.latest_stamp),
        **further[1],
    }
    return merge(name, findings, f"{traffic.rate:.1f} messages/s", values)


def _check_presence(state: InputState, health: TopicHealth, traffic: Traffic) -> list[Finding]:
    if not state.publishers:
        text = "no publisher" if traffic.silence is None else "its publisher is gone"
        return [Finding(Level.WARN, f"{state.topic}: {text}")]
    # Many publish transforms, each its own.
    if len(state.publishers) > 1 and not state.is_shared:
        nodes = ", ".join(sorted({publisher.node for publisher in state.publishers}))
        return [
            Finding(
                Level.WARN, f"{state.topic}: {len(state.publishers)} publishers ({nodes}) are mixed"
            )
        ]
    if state.plan.problems:
        return []
    if traffic.silence is None:
        return [Finding(Level.WARN, f"{state.topic}: a publisher, but no message yet")]
    if traffic.silence > _SILENCE:
        return [Finding(Level.WARN, f"{state.topic}: no message for {traffic.silence:.0f} s")]
    return []


def check_ending(written: bool) -> Status:
    """What the node says last: it was asked to end, and whether what it had to write is there."""
    if written:
        return Status("run", Level.OK, "ended")
    return Status("run", Level.ERROR, "ended, and could not write the output folder")


def check_synchronization(health: Health, time_offset: int, tolerance: int) -> Status:
    """Whether the two trajectories are of the same time.

    ``time_offset`` (ns) is added to the estimate's stamps; ``tolerance`` (ns) is how far the topics
    may be apart before something is wrong.
    """
    estimate = _range(health.estimate, time_offset)
    truth = _range(health.ground_truth, 0)
    values: dict[str, object] = {"pending": health.estimate.pending}
    name = "synchronization"
    if estimate is None or truth is None:
        missing = [
            title for title, each in (("estimate", estimate), ("ground truth", truth)) if not each
        ]
        return merge(name, [], f"waiting for {' and '.join(missing)}", values)
    apart = max(estimate[0] - truth[1], truth[0] - estimate[1])
    behind = estimate[1] - truth[1]
    values["estimate_ahead"] = behind / _SECOND
    findings = []
    if apart > tolerance and not health.estimate.used:
        findings.append(
            Finding(
                Level.ERROR,
                f"no overlap: estimate {_span(estimate)}, ground truth {_span(truth)}; "
                "check use_sim_time and clock synchronisation",
            )
        )
    elif behind > tolerance:
        findings.append(
            Finding(
                Level.WARN,
                f"the ground truth ends {behind / _SECOND:.1f} s before the newest estimate",
            )
        )
    return merge(name, findings, "the trajectories overlap", values)


@dataclass(frozen=True, slots=True)
class ClockState:
    """The ROS clock: its time (ns, None before the first ``/clock``), and what it has done."""

    use_sim_time: bool
    now: int | None
    publishers: int
    stands_still: float
    jumps: int
    left_over: int


def check_clock(clock: ClockState, found: Sequence[Health]) -> Status:
    """Whether the clock runs, and is that of the stamps; ``found``: of each estimate."""
    findings = []
    values: dict[str, object] = {
        "use_sim_time": str(clock.use_sim_time).lower(),
        "now": _seconds(clock.now),
        "jumps_back": clock.jumps,
        "left_over_messages": clock.left_over,
    }
    newest = [
        stamp
        for health in found
        for stamp in (health.estimate.latest_stamp, health.ground_truth.latest_stamp)
        if stamp is not None
    ]
    if clock.now is None:
        who = "" if clock.publishers else ", which nobody publishes"
        findings.append(Finding(Level.WARN, f"waiting for /clock{who}"))
    elif clock.use_sim_time and clock.stands_still > _SILENCE:
        findings.append(Finding(Level.WARN, f"/clock stands still for {clock.stands_still:.0f} s"))
    if clock.now is not None and newest:
        late = (clock.now - max(newest)) / _SECOND
        values["stamp_age"] = late
        if abs(late) > 60.0 and not clock.use_sim_time:
            side = "behind" if late > 0 else "ahead of"
            findings.append(
                Finding(
                    Level.WARN,
                    f"the newest stamp is {abs(late):.0f} s {side} the clock; for recorded data"
                    " publish /clock and set use_sim_time",
                )
            )
    return merge("clock", findings, "running", values)


def check_consistency(health: Health, causes: Sequence[Cause] = ()) -> Status:
    """Whether estimate and ground truth mean the same, and the computation agrees with itself.

    ``causes`` are what is likely wrong with the data. First-order AE must be RE, and until the
    hyperparameters are known nothing is evaluated.
    """
    findings = [Finding(Level.WARN, cause.sentence) for cause in causes]
    if health.consistency is not None and health.consistency > _CONSISTENT:
        findings.append(
            Finding(
                Level.WARN,
                f"relative and first-order absolute likelihood differ by {health.consistency:.1e},"
                " more than round-off",
            )
        )
    known = health.hyperparameters
    groups = {} if known is None else {"translation": known.translation, "rotation": known.rotation}
    if not health.truth_turns:
        groups.pop("rotation", None)
    values: dict[str, object] = {
        "segments": health.segments,
        "relative_difference": health.consistency,
        "hyperparameters": "learning" if known is None else "known",
        **{f"gp.{g}.{name}": v for g, group in groups.items() for name, v in group.named.items()},
        **{f"likely_cause_{cause.code}": cause.text for cause in causes},
        **{f"advice_{cause.code}": cause.advice for cause in causes},
    }
    return merge(
        "consistency",
        findings,
        "learning the ground truth's hyperparameters"
        if known is None
        else "no likely cause of an error is found, and the computation agrees with itself",
        values,
    )


def check_fixes(title: str, fixes: FixCounts | None, use_covariance: bool) -> Further:
    """What there is to say of a GNSS receiver's fixes."""
    if fixes is None:
        return (), {}
    values: dict[str, object] = {f"fixes_{mode}": count for mode, count in fixes.named.items()}
    values["fixes"] = fixes.sentence(title, use_covariance)
    if fixes.kinds > 1 and not use_covariance:
        return (Finding(Level.WARN, fixes.sentence(title, use_covariance)),), values
    return (), values


def both(one: Further, other: Further) -> Further:
    """What there is to say of two things."""
    return (*one[0], *other[0]), {**one[1], **other[1]}


def check_process(health: Health) -> Further:
    """What there is to say of the ground truth: its faults, and how its process fits."""
    findings = [Finding(Level.WARN, fault.text) for fault in health.faults]
    values: dict[str, object] = {}
    for fault in health.faults:
        values[fault.code] = fault.count
        values[f"{fault.code}_last"] = _seconds(fault.end)
    fit = health.fit
    if fit is not None:
        fits = max(fit.mean_squares) < _MISFIT
        named = {k: v for k, v in fit.named.items() if health.truth_turns or "rotation" not in k}
        values |= named | {"segments_adapted": fit.adapted}
        if not health.truth_turns:
            values["orientation"] = "none: positions alone"
        values["process"] = "fits" if fits else "does not fit"
        if not fits:
            findings.append(Finding(Level.WARN, "its process does not fit its samples"))
    return findings, values


@dataclass(frozen=True, slots=True)
class Load:
    """The last period's work: share of a core, longest batch (s), evaluated estimates a second."""

    processor: float
    longest_batch: float
    evaluated_rate: float
    output_error: str | None


def check_performance(load: Load) -> Status:
    """Whether the node keeps up, and can write what it is to write."""
    findings = []
    if load.output_error is not None:
        findings.append(Finding(Level.ERROR, load.output_error))
    if load.processor > 0.9:
        findings.append(
            Finding(Level.WARN, f"busy: {100 * load.processor:.0f} % of a processor core")
        )
    values: dict[str, object] = {
        "processor": load.processor,
        "longest_batch": load.longest_batch,
        "evaluated_rate": load.evaluated_rate,
    }
    return merge("performance", findings, f"{100 * load.processor:.0f} % of a core", values)


def _range(health: TopicHealth, offset: int) -> tuple[int, int] | None:
    if health.first_stamp is None or health.latest_stamp is None:
        return None
    return health.first_stamp + offset, health.latest_stamp + offset


def _seconds(stamp: int | None) -> float | None:
    return None if stamp is None else stamp / _SECOND


def _span(interval: tuple[int, int]) -> str:
    return f"{_moment(interval[0])} to {_moment(interval[1])}"


def _moment(stamp: int) -> str:
    """Seconds, and the date too where they are since 1970."""
    seconds = f"{stamp / _SECOND:.3f}"
    if not _YEAR < stamp < 250 * _YEAR:
        return seconds
    return f"{seconds} ({datetime.fromtimestamp(stamp // _SECOND, UTC):%Y-%m-%d %H:%M:%S})"
