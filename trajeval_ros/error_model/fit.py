# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The error model of an estimate: how good it is, and what is not its fault."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.error_model.changes import ClockChange, Stretch, clock_changes
from trajeval_ros.error_model.likelihood import Data, Likelihood
from trajeval_ros.error_model.maximum import (
    JUMP,
    Maximum,
    at,
    maximum,
    rough,
    uncertainty,
    upper_limit,
)
from trajeval_ros.error_model.nuisances import (
    NAMES,
    OBSERVED_STD,
    PRIOR_STD,
    Ask,
    Nuisances,
    Truth,
    prepare,
)
from trajeval_ros.error_model.process import GROUPS, Kind
from trajeval_ros.error_model.start import start

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

ENOUGH = 40
"""Poses below which there is no fit: of nine nuisances and the world's six freedoms."""

# Shifts (s) along the twists that stand for a new answer of the ground truth on the way.
_NEAR = 5e-3
_ITERATIONS = 8
# A rough search ends where another step gains less than this, nats, and after a few steps.
_ROUGH_GAIN = 0.2
_FEW = 6
_FULL = 25
# A search begins in so many poses, since each step of it takes time.
_STRETCH = 300
# A step of less than this share of its standard deviation is the last.
_CONVERGED = 0.05
# Where a Gauss-Newton step is longer (s), it is cut: the ground truth bends.
_LONGEST_STEP = 0.1
# A process with more parameters has to gain so many nats a parameter more (Akaike).
_PENALTY = 1.0
_LAGS = 5
# Stretches of time, of so many poses at least, by which the scatter of the nuisances is judged.
_BLOCK = 20
_BLOCKS = 40
# A change of the clock is looked for between parts of so many poses that last so long (s).
_PART = 60
_PART_DURATION = 5.0
_FIXED = 1e16
# A group's noise is so much larger in variance where it is left out.
_IGNORED = 1e10
# The columns of a nuisance have to vary so many times more than errors of the ground truth do; and
# the variance, in units of `OBSERVED_STD`, of a direction that the motion does not show.
_BEYOND_ERRORS = 4.0
_UNKNOWN = 100.0
# Where a standard deviation is known no better than this, its logarithm is no Gaussian any more.
_ROUGH = 0.3


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure with its standard deviation."""

    value: float
    std: float


@dataclass(frozen=True, slots=True)
class Jump:
    """A move that no drift explains. stamp: ns, of the pose after it; sizes in m and rad."""

    stamp: int
    translation: float
    rotation: float


@dataclass(frozen=True, slots=True)
class Unobserved:
    """A direction of the nuisances that the motion does not show.

    direction: (9,), in the order of `NAMES`, s, 1, m, rad and 1, one standard deviation long.
    """

    direction: Array

    @property
    def names(self) -> tuple[str, ...]:
        """The nuisances that take part, the strongest first."""
        share = np.abs(self.direction) / OBSERVED_STD
        order = np.argsort(-share)
        return tuple(NAMES[i] for i in order if share[i] > 0.3 * share.max())


@dataclass(frozen=True, slots=True)
class ErrorModel:
    """What is fitted.

    kind: the likeliest process. groups: its parameters, of translation (m) and rotation (rad).
    nuisances, covariance: (9, 9), in the order of `NAMES`; extrinsic as a step from the left.
    log_likelihood: of the errors at the fitted parameters and nuisances, nats, up to the
    alignment, of ``poses`` poses; uncorrected: with no nuisance at all, at the same parameters.
    chi2_per_dof, whiteness: of the innovations; the autocorrelations (2, lags), from lag 1 on.
    alternatives: nats a pose of each process. clock_changes: other than at a steady rate;
    clock_stretches: what parts of the run say of the offset.
    clock_by_group: the clock offset by positions alone and by orientations alone.
    """

    kind: Kind
    groups: dict[str, dict[str, Figure]]
    nuisances: Nuisances
    covariance: Array
    unobserved: tuple[Unobserved, ...]
    poses: int
    log_likelihood: float
    uncorrected: float
    chi2_per_dof: float
    whiteness: Array
    jumps: tuple[Jump, ...]
    alternatives: dict[Kind, float]
    clock_changes: tuple[ClockChange, ...] = ()
    clock_stretches: tuple[Stretch, ...] = ()
    clock_by_group: tuple[Figure, ...] = ()

    @property
    def std(self) -> Array:
        """Standard deviations of the nuisances, (9,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def nats_per_pose(self) -> float:
        """``log_likelihood`` a pose."""
        return self.log_likelihood / self.poses


def fit(stamps: Stamps, estimate: Array, ask: Ask) -> ErrorModel | None:
    """Fit the error model.

    stamps: (N,) ns, increasing, on the estimate's clock. estimate: (N, 4, 4). ask: the ground truth
    at given stamps; it is asked anew at every clock offset tried. None with fewer than `ENOUGH`
    poses, or where the likelihood has no maximum (errors of exactly nothing).
    """
    try:
        return _fit(stamps, estimate, ask)
    except np.linalg.LinAlgError:
        return None


def _fit(stamps: Stamps, estimate: Array, ask: Ask) -> ErrorModel | None:
    if len(stamps) < ENOUGH:
        return None
    problem = _Problem(stamps, estimate, ask)
    nuisances = start(stamps, estimate, problem.ask)
    if not problem.enough(nuisances):
        nuisances = Nuisances.none()
        if not problem.enough(nuisances):
            return None
    found = problem.first(nuisances)
    nuisances, found = problem.improve(nuisances, found, _ITERATIONS, near=True)
    candidates = _candidates(found)
    best = max(candidates, key=_score)
    nuisances, best = problem.improve(nuisances, best, _ITERATIONS, near=True)
    best = maximum(best.kind, best.parameters, best.data, best.gauge)
    nuisances, best = problem.improve(nuisances, best, 2)
    best = problem.exact(nuisances, best)
    alternatives = {c.kind: c.likelihood.at_theta / len(c.data.times) for c in candidates}
    alternatives[best.kind] = best.likelihood.at_theta / len(best.data.times)
    return _described(problem.kept(nuisances), nuisances, best, alternatives)


def _candidates(drift: Maximum) -> list[Maximum]:
    """The three processes, each at its maximum."""
    part = _stretch(drift)
    found = []
    for kind in Kind:
        begin = drift.parameters
        if kind is not Kind.DRIFT:
            begin = _first(kind, part)
            begin = maximum(kind, begin, part.data, part.gauge, _ROUGH_GAIN, _FEW).parameters
        found.append(maximum(kind, begin, drift.data, drift.gauge, _ROUGH_GAIN, _FEW))
    return found


def _stretch(found: Maximum) -> Maximum:
    """The middle of a run, as it is or so many poses of it."""
    count = len(found.data.times)
    if count <= _STRETCH:
        return found
    begin = (count - _STRETCH) // 2
    return _part(found, begin, begin + _STRETCH, found.data.precision)


def _part(found: Maximum, begin: int, end: int, precision: Array) -> Maximum:
    """At the same parameters, of the poses from ``begin`` to before ``end``.

    precision: of the nuisances' prior.
    """
    poses, moves = slice(begin, end), slice(begin, end - 1)
    data = found.data
    part = Data(
        data.times[poses],
        data.errors[poses],
        data.covariance[poses],
        data.travel[moves],
        data.nuisances[poses],
        precision,
        data.measured[poses],
        data.moved[moves],
    )
    return at(found.kind, found.parameters, part, found.gauge[poses])


def _score(found: Maximum) -> float:
    """The restricted log-likelihood, less what more parameters gain by chance."""
    return found.likelihood.value - _PENALTY * found.parameters.size


def _first(kind: Kind, drift: Maximum) -> Array:
    """The likeliest of a few starts."""
    span = float(drift.data.times[-1] - drift.data.times[0])
    known = drift.parameters
    interval = float(np.median(np.diff(drift.data.times)))
    starts = []
    for time in (0.5, 5.0, 50.0) if kind is Kind.WANDER else (0.5,):
        if time > max(span, 0.5):
            continue
        begin = rough(kind, drift.data, max(time, 2.0 * interval))
        begin[:, 0] = known[:, 0]
        if kind is Kind.WANDER:
            begin[:, 1] = known[:, 1] + 0.5 * np.log(0.5 * time)
        else:
            begin[:, 1] = known[:, 1] - np.log(4.0)
            begin[:, 2] = known[:, 1] - 0.5 * (np.log(2.0) + begin[:, 3])
        starts.append(begin)
    return max(starts, key=lambda s: Likelihood(kind, s, drift.data, drift.gauge).value)


class _Problem:
    """The estimate, and the ground truth to ask; the owner of its latest answer."""

    def __init__(self, stamps: Stamps, estimate: Array, ask: Ask) -> None:
        self._stamps, self._estimate, self._ask_anew = stamps, estimate, ask
        self._known: tuple[Stamps, Truth] | None = None

    def ask(self, stamps: Stamps, near: bool = False) -> Truth:
        """The ground truth at ``stamps`` (N,), on its own clock.

        ``near``: on the way there, a small shift along the twists does.
        """
        if self._known is not None:
            asked, answer = self._known
            shift = (stamps - asked) * 1e-9
            if not shift.any():
                return answer
            if near and np.abs(shift).max() < _NEAR:
                moved = answer.poses @ se3.exp(answer.twists * shift[:, None])
                return replace(answer, poses=moved)
        answer = self._ask_anew(stamps)
        self._known = stamps, answer
        return answer

    def enough(self, nuisances: Nuisances, near: bool = False) -> bool:
        """Whether enough poses have a ground truth."""
        return int(self.ask(nuisances.stamps(self._stamps), near).valid.sum()) >= ENOUGH

    def kept(self, nuisances: Nuisances) -> Stamps:
        """The stamps that have one."""
        return self._stamps[self.ask(nuisances.stamps(self._stamps)).valid]

    def first(self, nuisances: Nuisances) -> Maximum:
        """The drift at the nuisances given, from nothing."""
        data, gauge = self._prepared(nuisances)
        return maximum(Kind.DRIFT, rough(Kind.DRIFT, data), data, gauge, _ROUGH_GAIN, _FEW)

    def improve(
        self, nuisances: Nuisances, found: Maximum, iterations: int, near: bool = False
    ) -> tuple[Nuisances, Maximum]:
        """Gauss-Newton on the nuisances, the ground truth asked anew at each step.

        Where it need not be exact yet (``near``), only after a shift of some milliseconds.

        The parameters are those of ``found``, fitted anew where a step has changed the errors by
        much. Returns the nuisances and what is found there, whose θ is what is left of a step.
        """
        for _ in range(iterations):
            std = np.sqrt(np.diag(found.likelihood.theta_covariance))[: len(NAMES)]
            step, _ = _shown(found.likelihood)
            if (np.abs(step) < _CONVERGED * std).all():
                break
            step = step * min(1.0, _LONGEST_STEP / max(abs(float(step[0])), 1e-12))
            proposed = nuisances.moved(step)
            if not self.enough(proposed, near):
                break
            nuisances = proposed
            data, gauge = self._prepared(nuisances, near)
            same = len(found.data.times) == len(data.times)
            if same and (np.abs(step) < 3.0 * std).all():
                data = replace(data, measured=found.data.measured, moved=found.data.moved)
                found = at(found.kind, found.parameters, data, gauge)
            else:
                # Other poses have no weights yet.
                rounds = _FEW // 2 if same else _FULL
                found = maximum(found.kind, found.parameters, data, gauge, _ROUGH_GAIN, rounds)
        return nuisances, found

    def exact(self, nuisances: Nuisances, found: Maximum) -> Maximum:
        """What is found, with the ground truth asked just there."""
        if not self.enough(nuisances):
            return found
        data, gauge = self._prepared(nuisances)
        if len(found.data.times) != len(data.times):
            return maximum(found.kind, found.parameters, data, gauge)
        data = replace(data, measured=found.data.measured, moved=found.data.moved)
        return at(found.kind, found.parameters, data, gauge)

    def _prepared(self, nuisances: Nuisances, near: bool = False) -> tuple[Data, Array]:
        reference = self.ask(nuisances.stamps(self._stamps), near)
        good = reference.valid
        kept = Truth(
            reference.poses[good], reference.covariances[good], reference.twists[good], good[good]
        )
        return prepare(self._stamps[good], self._estimate[good], kept, nuisances)


def _described(
    stamps: Stamps, nuisances: Nuisances, found: Maximum, alternatives: dict[Kind, float]
) -> ErrorModel:
    here = found.likelihood
    count = len(NAMES)
    inflation = np.maximum(here.clustered_ratio(_blocks(here.count))[:count], 1.0)
    step, covariance = _shown(here)
    covariance = covariance * inflation * inflation[:, None]
    stretches = _stretches(stamps, nuisances, found, np.sqrt(np.diag(covariance)))
    clocks = _clock_by_group(nuisances, found)
    nuisances = nuisances.moved(step)
    white = here.innovations()
    autocorrelation = np.array(
        [
            [
                float((part[lag:] * part[:-lag]).sum() / (part**2).sum())
                for lag in range(1, _LAGS + 1)
            ]
            for part in (white[:, :3], white[:, 3:])
        ]
    )
    theta = np.concatenate([nuisances.vector, np.zeros(len(here.theta) - count)])
    seen = np.linalg.inv(here.theta_covariance)
    return ErrorModel(
        found.kind,
        _groups(found),
        nuisances,
        covariance,
        unobserved(covariance),
        here.count,
        here.at_theta,
        here.at_theta - 0.5 * float(theta @ seen @ theta),
        float((white**2).mean()),
        autocorrelation,
        _jumps(stamps, here),
        alternatives,
        clock_changes(stretches),
        tuple(stretches),
        clocks,
    )


def _clock_by_group(nuisances: Nuisances, found: Maximum) -> tuple[Figure, ...]:
    """The clock offset by positions alone and by orientations alone.

    Where the two differ, they were not taken at one time, or the errors are of another kind.
    """
    here = found.likelihood
    figures = []
    for group in range(2):
        ignored = np.ones(2)
        ignored[1 - group] = _IGNORED
        data = replace(found.data, measured=found.data.measured * ignored)
        try:
            alone = Likelihood(found.kind, here.parameters, data, found.gauge)
            inflation = max(float(alone.clustered_ratio(_blocks(here.count))[0]), 1.0)
        except np.linalg.LinAlgError:
            return ()
        offset = nuisances.clock_offset + float(alone.theta[0])
        figures.append(Figure(offset, inflation * float(alone.theta_covariance[0, 0]) ** 0.5))
    return tuple(figures)


def _stretches(stamps: Stamps, nuisances: Nuisances, found: Maximum, std: Array) -> list[Stretch]:
    """What parts of a run say of the clock, all else being as the whole says.

    nuisances: at which the errors of ``found`` are. std: (9,), the whole's.
    """
    seconds = (stamps - stamps[0]) * 1e-9
    edges = [0]
    for i in range(_PART, len(stamps)):
        if i - edges[-1] >= _PART and seconds[i] - seconds[edges[-1]] >= _PART_DURATION:
            edges.append(i)
    precision = 1.0 / std**2
    precision[0] = PRIOR_STD[0] ** -2
    precision[1] = _FIXED
    # As much larger than the model says as the whole's is.
    whole = found.likelihood.theta_covariance[0, 0] ** 0.5
    parts = []
    for begin, end in itertools.pairwise(edges):
        try:
            here = _part(found, begin, end, precision).likelihood
        except np.linalg.LinAlgError:
            continue
        middle = 0.5 * (seconds[begin] + seconds[end - 1] - seconds[-1])
        offset = nuisances.clock_offset + nuisances.clock_rate * middle + here.theta[0]
        spread = std[0] / whole * here.theta_covariance[0, 0] ** 0.5
        parts.append(
            Stretch(int(stamps[begin]), int(stamps[end - 1]), float(offset), float(spread))
        )
    return parts


def _blocks(count: int) -> int:
    """Into how many stretches so many poses are cut."""
    return min(max(count // _BLOCK, 4), _BLOCKS)


def _groups(found: Maximum) -> dict[str, dict[str, Figure]]:
    """Each parameter's value and standard deviation, and the long-run drift's.

    Also by distance, at the mean speed.
    """
    covariance = uncertainty(found, _blocks(found.likelihood.count))
    names = found.kind.names
    size = len(names)
    data = found.data
    way = float(np.linalg.norm(data.travel, axis=1).sum())
    speed = way / float(data.times[-1] - data.times[0])
    groups: dict[str, dict[str, Figure]] = {}
    for g, group in enumerate(GROUPS):
        values = np.exp(found.parameters[g])
        here = slice(g * size, (g + 1) * size)
        own = covariance[here, here]
        figures = {}
        for i, name in enumerate(names):
            std = float(values[i]) * float(own[i, i]) ** 0.5
            if not name.endswith("time") and not std < _ROUGH * values[i]:
                std = max(np.nan_to_num(std), upper_limit(found, g, i) - float(values[i]))
            figures[name] = Figure(float(values[i]), std)
        if found.kind is not Kind.WANDER:
            drift = figures["long_run_drift"] = _long_run(values, own)
            if speed > 0.0:
                by_time = float(np.sqrt(speed))
                by_distance = Figure(drift.value / by_time, drift.std / by_time)
                figures["long_run_drift_by_distance"] = by_distance
        groups[group] = figures
    return groups


def _long_run(values: Array, covariance: Array) -> Figure:
    """``sqrt(w² + 2 σ² T)``, and its standard deviation by the delta method."""
    drift = values[1] ** 2
    velocity = 2.0 * values[2] ** 2 * values[3] if len(values) > 2 else 0.0
    total = float(np.sqrt(drift + velocity))
    slope = np.zeros(len(values))
    slope[1] = drift / total
    if len(values) > 2:
        slope[2], slope[3] = velocity / total, 0.5 * velocity / total
    variance = float(slope @ np.nan_to_num(covariance) @ slope)
    return Figure(total, float(np.sqrt(max(variance, 0.0))))


def _shown(here: Likelihood) -> tuple[Array, Array]:
    """θ (9,) of the nuisances with its covariance (9, 9), as far as the motion shows them.

    In the directions that it does not show there is nothing, and the covariance is large: there,
    each step would be as long as its standard deviation, and none the last.
    """
    information, seen, hidden = _directions(here)
    known = seen.T @ information @ seen
    right = seen.T @ information @ (here.theta[: len(NAMES)] / OBSERVED_STD)
    theta = seen @ np.linalg.solve(known, right) * OBSERVED_STD
    scaled = seen @ np.linalg.inv(known) @ seen.T
    scaled += _UNKNOWN * hidden @ hidden.T
    return theta, np.asarray(scaled * OBSERVED_STD * OBSERVED_STD[:, None])


def _directions(here: Likelihood) -> tuple[Array, Array, Array]:
    """The information (9, 9) of the nuisances in units of `OBSERVED_STD`, seen and hidden axes.

    Axes: orthonormal columns, (9, r) and (9, 9 - r). Hidden is what the data do not tell to within
    one unit, and what only errors of the ground truth tell: the attitude of a robot that does not
    turn varies by its noise, and a lever arm would follow that as it follows motion.
    """
    count, data = len(NAMES), here.data
    units = OBSERVED_STD * OBSERVED_STD[:, None]
    information = np.linalg.inv(here.theta_covariance[:count, :count]) * units
    # How much the columns vary beyond what an alignment takes up, weighted; and how much they would
    # if they were errors.
    both = np.concatenate([here.gauge, data.nuisances], axis=2)
    squares = np.einsum("nij,nik->jk", both, here.weight @ both)
    taken = squares[6:, :6] @ np.linalg.pinv(squares[:6, :6], hermitian=True) @ squares[:6, 6:]
    weight = np.einsum("nii->ni", here.weight).reshape(-1, 2, 3).mean(axis=2)
    noise = np.einsum("nii->ni", data.covariance).reshape(-1, 2, 3).mean(axis=2)
    errors = np.zeros(count)
    errors[2:5] = 2.0 * (noise[:, 1] * weight[:, 0]).sum()
    errors[5:8] = 2.0 * (noise[:, 1] * weight[:, 1]).sum()
    errors[8] = 3.0 * (noise[:, 0] * weight[:, 0]).sum()
    beyond = (squares[6:, 6:] - taken - _BEYOND_ERRORS * np.diag(errors)) * units
    values, vectors = np.linalg.eigh(beyond)
    moved, hidden = vectors[:, values > 0.0], vectors[:, values <= 0.0]
    values, vectors = np.linalg.eigh(moved.T @ information @ moved)
    vectors = moved @ vectors
    seen = vectors[:, values >= 1.0]
    return information, seen, np.concatenate([hidden, vectors[:, values < 1.0]], axis=1)


def unobserved(covariance: Array) -> tuple[Unobserved, ...]:
    """The principal directions, in units of `OBSERVED_STD`, longer than one."""
    scaled = covariance / OBSERVED_STD / OBSERVED_STD[:, None]
    values, vectors = np.linalg.eigh(scaled)
    return tuple(
        Unobserved(float(value) ** 0.5 * vector * OBSERVED_STD)
        for value, vector in zip(values[::-1], vectors.T[::-1], strict=True)
        if value > 1.0
    )


def _jumps(stamps: Stamps, here: Likelihood) -> tuple[Jump, ...]:
    _, _, square, rest = here.disturbances()
    variance = here.own_noise() / here.data.moved + rest
    found = np.flatnonzero((square > JUMP**2 * variance).any(axis=1))
    sizes = np.sqrt(square)
    return tuple(
        Jump(int(stamps[i + 1]), float(sizes[i, 0]), float(sizes[i, 1])) for i in found.tolist()
    )
