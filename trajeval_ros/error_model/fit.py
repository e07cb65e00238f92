# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The fit of an error model: a search by chains of one axis, then the likelihood's maximum."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.error_model.described import described, reached
from trajeval_ros.error_model.likelihood import Data, Likelihood
from trajeval_ros.error_model.maximum import UNFINISHED, climb, penalised, promised, reweighted
from trajeval_ros.error_model.model import ErrorModel
from trajeval_ros.error_model.nuisances import (
    COUNT,
    Ask,
    Nuisances,
    Truth,
    prepare,
    rounded,
    to_resolution,
)
from trajeval_ros.error_model.observed import shown
from trajeval_ros.error_model.process import Kind
from trajeval_ros.error_model.recorded import Recorded
from trajeval_ros.error_model.search import (
    LARGEST_STD,
    MANY,
    Guess,
    bounds,
    elsewhere,
    part_of,
    search,
    stretches,
)
from trajeval_ros.error_model.stamping import (
    Scatter,
    described_scatter,
    likeliest_scatter,
    shared_scatter,
    with_scatter,
)
from trajeval_ros.error_model.start import start
from trajeval_ros.error_model.system import AXES

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

ENOUGH = 40
"""Poses below which there is no fit: of nine nuisances and the world's six freedoms."""

# On the way, cubics between the answers that are there stand for new ones, and at their ends shifts
# (s) along the twists, where they give so great a share of the poses.
_NEAR = 5e-3
_ALMOST_ALL = 0.98
_ITERATIONS = 8
# After a longer step, in standard deviations, the parameters are found anew.
_FAR = 3.0
# A step of the nuisances of less than this share of its standard deviation is the last: it is taken
# to first order, and what the second would add is a small part of it.
_CONVERGED = 0.3
# Where a Gauss-Newton step is longer (s), it is cut: the ground truth bends.
_LONGEST_STEP = 0.1
# A process with more parameters has to gain so many nats a parameter more: what four more, or two
# with a time that nothing tells where there is none, gain by chance once in a hundred times.
_PENALTY = 2.0
# A search ends where another step gains less than this, nats: on the way, and at its end.
_COARSE = 0.5
_FINE = 0.05
# A process that is likeliest with a scale (its logarithm) so far from where a walk is takes the
# motion itself for an error, metres a second of it: there is no maximum of it nearby.
_FARTHEST = np.log(2.0)
# Nuisances that are there leave smaller errors, or not much larger ones. Those that make the mean
# square of how errors change so many times larger, over 16, 64 ... poses, are none, as of jitter
# that is about another point of the body: a lever arm to there is likely, and a drift makes up for
# it. Changes of less than a tenth of the ground truth's own uncertainty say nothing: orientations
# may be copies of its own.
_LARGER, _NOTHING = 4.0, 0.1
_FIRST_LAG, _NEXT_LAG, _LAST_SHARE = 16, 4, 4
_TINY = np.finfo(np.float64).tiny
# The maximum is found where another step gains less than this, nats, or after so many steps.
_GAIN = 5e-3
_STEPS = 25
# Outliers are others where they promise so much, nats.
_OTHER_OUTLIERS = 1.0
# Stamps that scatter have to gain so many nats, as a nuisance that is named.
_GAIN_OF_SCATTER = 10.0


def fit(
    stamps: Stamps,
    estimate: Array,
    ask: Ask,
    known: Truth | None = None,
    most_scatter: float = np.inf,
    *,
    parts: bool = True,
) -> ErrorModel | None:
    """Fit the error model.

    stamps: (N,) ns, increasing, on the estimate's clock. estimate: (N, 4, 4). ask: the ground truth
    at given stamps, which is asked anew at the clock offset found. known: its answers at
    ``stamps``, where they are there already. most_scatter: of stamps that can be told, s. parts:
    whether parts of the time, and each group alone, are asked for the clock. None with fewer than
    `ENOUGH` poses, or where the likelihood has no maximum (errors of exactly nothing).
    """
    if len(stamps) < ENOUGH:
        return None
    try:
        return _fit(_Problem(stamps, estimate, ask, known), most_scatter, parts)
    except np.linalg.LinAlgError:
        return None


def _fit(problem: _Problem, most_scatter: float, parts: bool) -> ErrorModel | None:
    nuisances = problem.start()
    if not problem.enough(nuisances):
        nuisances = Nuisances.none()
        if not problem.enough(nuisances):
            return None
    found = _found(problem, nuisances)
    if found is None:
        return None
    variance = shared_scatter(found.here)
    scattered = None if variance is None else _with_scatter(problem, found, variance)
    scatter: Scatter | None = None
    if scattered is not None and scattered[1].value <= most_scatter:
        found, scatter = scattered
    stamps = problem.kept(found.nuisances)
    given = stamps, found.nuisances, found.here, found.alternatives, scatter
    return described(*given, parts=parts)


class _Found(NamedTuple):
    """A maximum. alternatives: nats a pose of each process."""

    nuisances: Nuisances
    here: Likelihood
    alternatives: dict[Kind, float]


def _with_scatter(
    problem: _Problem, plain: _Found, variance: float
) -> tuple[_Found, Scatter] | None:
    """The maximum where stamps scatter, from one where they do not; None where that gains little.

    variance: s², of theirs, about.
    """
    problem.scatter_stamps(variance)
    try:
        found = _found(problem, plain.nuisances)
        if found is None:
            return None
        low, high = (each.ravel() for each in bounds(found.here.kind, found.here.data))
        here, value, std = likeliest_scatter(found.here, variance, low, high)
    except np.linalg.LinAlgError:
        return None
    gained = reached(here) - reached(plain.here)
    if gained < _GAIN_OF_SCATTER:
        return None
    return found._replace(here=here), described_scatter(here, value, std, gained)


def _found(problem: _Problem, nuisances: Nuisances) -> _Found | None:
    """The maximum, from ``nuisances``; None where there is none."""
    least, nothing = problem.errors(nuisances), problem.nothing(nuisances)
    moved, drift = problem.improved(nuisances, Kind.DRIFT, None, coarse=True)
    misled = _is_larger(problem.errors(moved), least, nothing)
    if misled:
        drift = problem.without_drift(nuisances)
    else:
        nuisances = moved
    candidates = problem.candidates(nuisances, drift)
    for best in sorted(candidates, key=lambda kind: -candidates[kind].score):
        moved, guess = problem.improved(nuisances, best, candidates[best].guess, coarse=False)
        guess = guess if misled else problem.elsewhere(moved, guess)
        if not problem.enough(moved, near=False):
            problem.stay_near()
        moved, here = problem.maximum(moved, guess)
        if _has_run_away(here):
            return None
        is_near = abs(np.log(moved.scale / nuisances.scale)) < _FARTHEST
        if is_near and not _is_larger(here.data.errors, least, nothing):
            # The others are behind by as much as they were where all three were found.
            ahead = _nats_per_pose(here) - candidates[best].nats_per_pose
            alternatives = {kind: each.nats_per_pose + ahead for kind, each in candidates.items()}
            return _Found(moved, here, alternatives)
        del candidates[best]
    return None


def _is_larger(errors: Array, others: Array, nothing: Array) -> bool:
    """Whether errors (n, 6) change by much more than others (m, 6), in positions or rotations.

    nothing: (2,), the mean square of changes that say nothing.
    """
    lag, last = _FIRST_LAG, min(len(errors), len(others)) // _LAST_SHARE
    while lag <= last:
        size, other = (
            np.square(each[lag:] - each[:-lag]).mean(axis=0).reshape(2, 3).sum(axis=1)
            for each in (errors, others)
        )
        if (size > _LARGER * np.maximum(other, nothing)).any():
            return True
        lag *= _NEXT_LAG
    return False


def _has_run_away(found: Likelihood) -> bool:
    """Whether an error is as large as can be: there is no maximum, as of poses that are misread."""
    sizes = [not name.endswith("time") for name in found.kind.names]
    return bool((found.parameters[:, sizes] >= np.log(LARGEST_STD) - 1e-3).any())


def _nats_per_pose(found: Likelihood) -> float:
    return reached(found) / found.count


class _Candidate(NamedTuple):
    """A process near its maximum, and how good it is there.

    ``score``: what is maximal, less what more parameters gain by chance.
    """

    guess: Guess
    score: float
    nats_per_pose: float

    @staticmethod
    def of(guess: Guess, data: Data, gauge: Array) -> _Candidate:
        """Its likelihood, of a hundred arrays as long as the run, is not kept."""
        weighted = data.weighted(*guess.weights)
        found = Likelihood(guess.kind, guess.parameters, weighted, gauge)
        score = penalised(found) - _PENALTY * found.parameters.size
        return _Candidate(guess, score, _nats_per_pose(found))


class _Problem:
    """The estimate, and the ground truth to ask; the owner of its latest answers."""

    def __init__(self, stamps: Stamps, estimate: Array, ask: Ask, known: Truth | None) -> None:
        self._stamps, self._estimate, self._ask = stamps, to_resolution(estimate), ask
        self._near = None if known is None else _recorded(stamps, rounded(known))
        self._exact: tuple[Stamps, Truth] | None = None
        self._latest: tuple[Stamps, Truth] | None = None
        self._moved: tuple[Nuisances, Stamps] | None = None
        self._ready: tuple[Nuisances, Truth, tuple[Data, Array]] | None = None
        self._part: tuple[Data, Array] | None = None
        self._stays_near = False
        self._scatter = 0.0

    def scatter_stamps(self, variance: float) -> None:
        """From now on the estimate's stamps have a variance, s²."""
        self._scatter, self._ready, self._part = variance, None, None

    def stay_near(self) -> None:
        """Ask no more: live, nothing is known between poses that are far apart."""
        self._stays_near = True

    def start(self) -> Nuisances:
        """The nuisances to begin with."""
        return start(self._stamps, self._estimate, self._nearby)

    def _asked(self, stamps: Stamps) -> Truth:
        """The ground truth at ``stamps`` (N,), on its own clock."""
        if self._exact is None or not _same(stamps, self._exact[0]):
            self._exact = stamps, rounded(self._ask(stamps))
            recorded = _recorded(*self._exact)
            self._near = self._near if recorded is None else recorded
        return self._exact[1]

    def _nearby(self, stamps: Stamps) -> Truth:
        """As `_asked`, but from answers nearby, where there are some; the same when asked again."""
        if self._latest is None or not _same(stamps, self._latest[0]):
            found = None if self._near is None else self._near.at(stamps, _NEAR)
            least = 0.0 if self._near is None else _ALMOST_ALL * len(self._near.stamps)
            if found is None or found.valid.sum() < least:
                found = self._asked(stamps)
            self._latest = stamps, found
        return self._latest[1]

    def _truth(self, nuisances: Nuisances, near: bool) -> Truth:
        if self._moved is None or self._moved[0] is not nuisances:
            self._moved = nuisances, nuisances.stamps(self._stamps)
        stamps = self._moved[1]
        return self._nearby(stamps) if near or self._stays_near else self._asked(stamps)

    def enough(self, nuisances: Nuisances, near: bool = True) -> bool:
        """Whether enough poses have a ground truth."""
        return int(self._truth(nuisances, near).valid.sum()) >= ENOUGH

    def kept(self, nuisances: Nuisances) -> Stamps:
        """The stamps that have one."""
        return self._stamps[self._truth(nuisances, near=False).valid]

    def improved(
        self, nuisances: Nuisances, kind: Kind, guess: Guess | None, *, coarse: bool
    ) -> tuple[Nuisances, Guess]:
        """Gauss-Newton on the nuisances, near the maximum of one process.

        Returns the nuisances, and what is found there, whose θ is what is left of a step.
        """
        gain = _COARSE if coarse else _FINE
        data, gauge = self._prepared(nuisances, near=True, part=coarse)
        found = search(kind, data, gauge, gain, guess)
        for _ in range(_ITERATIONS):
            step, covariance = self._step(found, data, gauge)
            if _is_short(step, covariance):
                break
            step = step * min(1.0, _LONGEST_STEP / max(abs(float(step[0])), 1e-12))
            proposed = nuisances.moved(step)
            if not self.enough(proposed):
                break
            nuisances = proposed
            data, gauge = self._prepared(nuisances, near=True, part=coarse)
            found = search(kind, data, gauge, gain, found._replace(theta=found.theta - step))
        return nuisances, found

    def without_drift(self, nuisances: Nuisances) -> Guess:
        """The maximum at these nuisances that is near jitter alone."""
        data, gauge = self._prepared(nuisances, near=True, part=True)
        begin = bounds(Kind.DRIFT, data)[0].copy()
        steps = np.square(np.diff(data.errors, axis=0)).reshape(-1, 2, 3)
        jitter = 0.5 * np.median(steps, axis=0).mean(axis=1)
        begin[:, 0] = np.maximum(begin[:, 0], 0.5 * np.log(np.maximum(jitter, _TINY)))
        none = np.zeros(COUNT), np.eye(COUNT)
        guess = Guess(Kind.DRIFT, begin, data.measured, data.moved, *none)
        return search(Kind.DRIFT, data, gauge, _COARSE, guess)

    def errors(self, nuisances: Nuisances) -> Array:
        """With these taken off, (n, 6)."""
        return self._prepared(nuisances, near=True)[0].errors

    def nothing(self, nuisances: Nuisances) -> Array:
        """Mean squares of changes, of positions and rotations, that say nothing; (2,)."""
        known = self._prepared(nuisances, near=True)[0].known
        return np.asarray(2.0 * AXES * (_NOTHING * known) ** 2)

    def candidates(self, nuisances: Nuisances, drift: Guess) -> dict[Kind, _Candidate]:
        """Each process near its maximum; the ones that have none are left out."""
        data, gauge = self._prepared(nuisances, near=True)
        many = len(drift.measured) < len(data.times)
        whole = search(Kind.DRIFT, data, gauge, _COARSE, drift) if many else drift
        found = {}
        for kind in Kind:
            try:
                guess = whole
                if kind is not Kind.DRIFT:
                    guess = search(kind, *self._prepared(nuisances, True, True), _COARSE, drift)
                    if many:
                        # The outliers of all poses are known by now.
                        guess = guess._replace(measured=whole.measured, moved=whole.moved)
                        if kind is Kind.VELOCITY:
                            guess.parameters[:, :2] = whole.parameters
                        guess = search(kind, data, gauge, _COARSE, guess)
                found[kind] = _Candidate.of(guess, data, gauge)
            except np.linalg.LinAlgError:
                continue
        if not found:
            raise np.linalg.LinAlgError("no process has a likelihood")
        return found

    def elsewhere(self, nuisances: Nuisances, guess: Guess) -> Guess:
        """The guess, or what other starts find where that is likelier."""
        data, gauge = self._prepared(nuisances, near=True)
        other = elsewhere(guess, data, gauge, _COARSE)
        if other is None:
            return guess
        # The axes of a group are alike in a search alone.
        both = _Candidate.of(guess, data, gauge), _Candidate.of(other, data, gauge)
        return max(both, key=lambda each: each.score).guess

    def maximum(self, nuisances: Nuisances, guess: Guess) -> tuple[Nuisances, Likelihood]:
        """The maximum of the likelihood, with the ground truth asked just there.

        The parameters are found once, with the weights that there are, unless others promise more:
        asked just there, a pose may be an outlier that was none, or none that was one. A step of
        the nuisances hardly changes either.
        """
        before = self._truth(nuisances, near=True).valid
        low, high = (each.ravel() for each in bounds(guess.kind, self._prepared(nuisances)[0]))
        weights, parameters, climbs = guess.weights, guess.parameters, True
        for last in (*[False] * _ITERATIONS, True):
            data, gauge = self._prepared(nuisances)
            known = self._truth(nuisances, near=False).valid
            weights, before = _carried(weights, before, known), known
            weighted = data.weighted(*weights)
            asked = Likelihood(guess.kind, parameters, weighted, gauge)
            here = reweighted(asked, _OTHER_OUTLIERS)
            climbs |= here is not asked
            del asked  # a hundred arrays as long as the run
            if climbs:
                here = climb(here, low, high, _GAIN, _STEPS, near=True, weighted=False)
            weights, parameters = here.weights, here.parameters
            jitter = np.exp(2.0 * parameters[:, 0])
            step, covariance = shown(here.theta, here.theta_covariance, jitter, data, gauge)
            proposed = nuisances.moved(step)
            if last or _is_short(step, covariance) or not self.enough(proposed, near=False):
                break
            nuisances, climbs = proposed, not _is_short(step, covariance, _FAR)
        if promised(here, low, high) > UNFINISHED:
            # As where a component is nearly nothing, the curvature of where it began has misled.
            here = climb(here, low, high, _GAIN, _STEPS, weighted=False)
        return nuisances, here

    def _step(self, guess: Guess, data: Data, gauge: Array) -> tuple[Array, Array]:
        weighted = data.weighted(*guess.weights)
        jitter = np.exp(2.0 * guess.parameters[:, 0])
        return shown(guess.theta, guess.theta_covariance, jitter, weighted, gauge)

    def _prepared(
        self, nuisances: Nuisances, near: bool = False, part: bool = False
    ) -> tuple[Data, Array]:
        reference = self._truth(nuisances, near)
        if (
            self._ready is None
            or self._ready[0] is not nuisances
            or self._ready[1] is not reference
        ):
            self._ready = self._part = None  # nothing is there twice
            self._ready = nuisances, reference, self._errors(nuisances, reference)
        data, gauge = self._ready[2]
        if not part or len(data.times) <= MANY:
            return data, gauge
        if self._part is None:
            chosen = stretches(len(data.times))
            self._part = part_of(data, chosen), gauge[chosen]
        return self._part

    def _errors(self, nuisances: Nuisances, reference: Truth) -> tuple[Data, Array]:
        good = reference.valid
        kept = Truth(
            reference.poses[good], reference.covariances[good], reference.twists[good], good[good]
        )
        data, gauge = prepare(self._stamps[good], self._estimate[good], kept, nuisances)
        return (with_scatter(data, self._scatter) if self._scatter else data), gauge


def _carried(weights: tuple[Array, Array], before: Mask, now: Mask) -> tuple[Array, Array]:
    """Weights of the poses ``before``, of all (N,), and of the steps to them, for those ``now``."""
    if np.array_equal(before, now):
        return weights
    of_poses, of_moves = np.ones((2, len(before), 2))
    of_poses[before], of_moves[np.flatnonzero(before)[1:]] = weights
    kept = np.flatnonzero(now)
    # A step over poses that are not there any more may leap as theirs did.
    return of_poses[now], np.maximum.reduceat(of_moves[: kept[-1] + 1], kept[:-1] + 1, axis=0)


def _same(stamps: Stamps, others: Stamps) -> bool:
    return stamps is others or bool((stamps == others).all())


def _recorded(stamps: Stamps, truth: Truth) -> Recorded | None:
    good = truth.valid
    if good.all():
        return Recorded(stamps, truth.poses, truth.covariances, truth.twists)  # nothing is copied
    if not good.any():
        return None
    return Recorded(stamps[good], truth.poses[good], truth.covariances[good], truth.twists[good])


def _is_short(step: Array, covariance: Array, share: float = _CONVERGED) -> bool:
    return bool((np.abs(step) < share * np.sqrt(np.diag(covariance))[:COUNT]).all())
