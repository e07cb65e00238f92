# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A segment's process is held to its samples, and changed from the sample on that refutes it.

With ``e_k²`` the square of a sample's standardised innovation over the c coordinates of a group,
χ² of c degrees of freedom when the process fits, two sums look for a change of its variance by a
factor r, as Page's test does,

    S_k = max(0, S_(k-1) + ½ (e_k² (1 - 1/r) - c log r)),

r = 16 for a process that promises too much and r = 1/64 for one that promises too little; less is
for a segment's scale. Where one exceeds its threshold at a sample, the regimes near by are compared
by how well each predicts the samples since that sum was zero, ``-½ Σ (e_k² + c log d_k²)`` plus the
prior, and the best is taken from that sample on (``docs/method.md``, Ground truth), a function of
the samples up to there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops
from trajeval_ros.ground_truth.factors import Observed
from trajeval_ros.ground_truth.hyperparameters import LEAST_NOISE
from trajeval_ros.ground_truth.kernels import Kernel, Matern
from trajeval_ros.ground_truth.likelihood import record_room
from trajeval_ros.ground_truth.process import AS_LEARNED, Process, Regimes
from trajeval_ros.ground_truth.regimes import MOST, PRIOR_STDS, USUAL, Learned, Regime
from trajeval_ros.ground_truth.regression import FLAT, Regression, scale

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]
_Any = TypeVar("_Any")

# Of a group, together.
_COORDINATES = 3
# Ratio of variances looked for and threshold (nats): of a process that promises too much, and of
# one that promises too little, which does no harm for a while. A segment's scale follows smaller
# changes, and an excursion of the motion is not a change of it.
_RATIOS, _THRESHOLDS = np.array([16.0, 1.0 / 64.0]), np.array([15.0, 40.0])
_CAUTIOUS = 1
_STEEPNESS, _OFFSETS = 1.0 - 1.0 / _RATIOS, _COORDINATES * np.log(_RATIOS)
# A regime must predict its samples better than the one before it by so much (nats).
_LEAST_GAIN = 3.0
# Where the variance of a prediction is less than so many times the instrument's, that rules it.
_TELLING = 4.0
# Predicted are the newest samples, so many at most, from so many before them.
_MOST_SAMPLES = 64
_CONTEXT = 24
# Of fewer than this, no regime is taken whose noise is more than twice as large.
_FEW = 24
_PRIOR_STDS = np.array(PRIOR_STDS)
# Noise of 4 times what was learned is rare: where samples refute that, too, so many motions far off
# are looked at. Sooner, a burst of noise would be taken for motion. (In C: NOISY, FAR.)
_NOISY, _FAR = 2, 6
# A search ends after so many rounds.
_ROUNDS = 6
# What of this C is told, in its order.
_SIZES = np.array([_CAUTIOUS, _MOST_SAMPLES, _CONTEXT, _FEW, MOST, _ROUNDS])


@dataclass(frozen=True, slots=True)
class Values:
    """A segment's samples as a regression takes them.

    ``times`` (n,) s; ``values`` (n, G, c), G = 2 or, where each coordinate has variances of its
    own, 6; ``variances`` (n, G), which add to the noise.
    """

    times: Array
    values: Array
    variances: Array

    @property
    def parallel(self) -> int:
        """G."""
        return int(self.values.shape[1])

    def of(self, group: int) -> Values:
        """Those of translation (0) or rotation (1), as groups of their own."""
        size = self.values.shape[1] // 2
        here = slice(group * size, (group + 1) * size)
        return Values(self.times, self.values[:, here], self.variances[:, here])

    def with_noise(self, noise: Array) -> Observed:
        """With the variances of a process' ``noise`` (G,)."""
        return Observed(self.times, self.values, self.variances + noise)

    def __getitem__(self, index: slice) -> Values:
        """Return consecutive samples."""
        return Values(self.times[index], self.values[index], self.variances[index])


class Prediction:
    """How well a group's samples from row ``first`` >= 1 on are predicted by those before each.

    ``values`` of one group. A regime answers with ``Σ e²`` and ``Σ log d²`` over these samples.
    """

    def __init__(self, learned: Learned, values: Values, first: int) -> None:
        """Ask for regimes of what was ``learned``."""
        self._learned, self._values, self._first = learned, values, first

    def __call__(self, regimes: Sequence[Regime]) -> tuple[Array, Array]:
        """Return both of each of the regimes; (r,)."""
        values, count = self._values, len(regimes)
        groups = tuple(self._learned.under(r) for r in regimes for _ in range(values.parallel))
        noise = np.array([group.noise_std**2 for group in groups])
        regression = Regression(self._learned.model.kernels, groups, values.values.shape[2])
        regression.extend(
            Observed(
                values.times,
                np.tile(values.values, (1, count, 1)),
                np.tile(values.variances, (1, count)) + noise,
            )
        )
        news = regression.innovations(self._first).reshape(count, -1, 2).sum(axis=1)
        return news[:, 0], news[:, 1]


def best_regime(
    learned: Learned, start: Regime, values: Values, since: int, ratio: float | None = None
) -> Regime:
    """The regime, of those that can be reached from ``start``, that predicts the samples best.

    ``values`` of one group; the samples from row ``since`` >= 1 on are to be predicted, which under
    ``start`` have a standardised mean square of ``ratio``, which is found if it is not known.
    """
    # Larger noise smooths motion away, and a few samples do not tell the two apart.
    few = len(values.times) - since < _FEW
    noisiest = max(start.noise, 0) + (1 if few else _MOST_SAMPLES)
    if loops.there() and all(isinstance(each, Matern) for each in learned.model.kernels):
        return _best_regime(learned, start, values, since, ratio, noisiest)
    predicted, coordinates = Prediction(learned, values, since), values.values.shape[2]
    if ratio is None:
        squares, _ = predicted([start])
        ratio = float(squares[0]) / values.values[since:].size
    known: dict[Regime, float] = {}

    def look_at(regimes: Iterable[Regime]) -> None:
        missing = sorted({r for r in regimes if r.noise <= noisiest} - known.keys())
        if missing:
            squares, log_dets = predicted(missing)
            costs = (squares + coordinates * log_dets).tolist()
            for regime, cost in zip(missing, costs, strict=True):
                known[regime] = -0.5 * cost + regime.log_prior

    leap = round(0.5 * math.log2(max(ratio, 1e-12)))
    near = (leap, leap - 1, leap - 2) if leap > 0 else (leap, leap + 1)
    moves = [(m, 0) for m in near] + [(0, n) for n in near[:2]] + [(0, 0)]
    look_at([*(start.moved(m, n) for m, n in moves), Regime(0, start.noise), USUAL])
    if leap > 0 and start.noise >= _NOISY:
        # Motion far below the noise shows only once it is many times as lively.
        quiet = Regime(start.motion)
        look_at(quiet.moved(leap + 2 * step, 0) for step in range(1, _FAR + 1))
    for _ in range(_ROUNDS):
        best, looked_at = max(known, key=lambda regime: (known[regime], regime)), len(known)
        look_at(best.moved(m, n) for m, n in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, -1), (-1, 1)))
        if len(known) == looked_at:
            break
    best = max(known, key=lambda regime: (known[regime], regime))
    return best if known[best] > known[start] + _LEAST_GAIN else start


def _best_regime(
    learned: Learned,
    start: Regime,
    values: Values,
    since: int,
    ratio: float | None,
    noisiest: int,
) -> Regime:
    """The same in C."""
    count, parallel, coordinates = values.values.shape
    orders, places = _orders(learned.model.kernels)
    rates, parts = learned.parts()
    found, score = np.empty(2, dtype=np.int64), np.empty(1)
    loops.call(
        "regime_best",
        values.times if parallel == 1 else np.tile(values.times, parallel),
        loops.doubles(values.values.swapaxes(0, 1)),
        loops.doubles(values.variances.T),
        parallel,
        count,
        coordinates,
        places,
        len(orders),
        rates,
        parts,
        learned.accuracy**2,
        LEAST_NOISE**2,
        FLAT**2,
        since,
        np.array(start),
        -1.0 if ratio is None else ratio,
        noisiest,
        MOST,
        _PRIOR_STDS,
        _ROUNDS,
        _LEAST_GAIN,
        np.empty(record_room(orders, coordinates, count, slopes=False)),
        found,
        score,
    )
    return Regime(*found.tolist())


@lru_cache(maxsize=8)
def _orders(kernels: tuple[Kernel, ...]) -> tuple[tuple[int, ...], Counts]:
    """How many coefficients each kernel has."""
    orders = tuple(len(kernel.coefficients) for kernel in kernels if isinstance(kernel, Matern))
    return orders, np.array(orders)


def _rules(process: Process, least: Array) -> tuple[Array, Counts, Array, Array]:
    """What C holds a segment to, how many coefficients each kernel has, rates and variances.

    ``least`` (2,): from which logarithm of a variance on small innovations tell.
    """
    assert process.learned is not None
    _, orders = _orders(process.learned[0].model.kernels)
    instrument = np.square([each.accuracy for each in process.learned])
    numbers = (_STEEPNESS, _OFFSETS, least, instrument, LEAST_NOISE**2, FLAT**2, _PRIOR_STDS)
    rates, parts = zip(*(each.parts() for each in process.learned), strict=True)
    rules = np.hstack([*numbers, _LEAST_GAIN])
    return rules, orders, np.stack(rates), np.stack(parts)


@lru_cache(maxsize=8)
def _room(orders: tuple[int, ...], parallel: int, coordinates: int) -> int:
    """How many numbers ``segment_hold`` needs room for."""
    seen = _MOST_SAMPLES + _CONTEXT
    record = record_room(orders, coordinates, seen, slopes=False)
    return record + parallel // 2 * (2 + coordinates) * seen


class Watch:
    """Page's two sums of translation and rotation each, sample by sample."""

    def __init__(self) -> None:
        """Look at the rows from 1 on."""
        self._limits = np.array([_THRESHOLDS, _THRESHOLDS])
        self._sums = np.zeros(self._limits.shape)
        self._since = np.ones(self._limits.shape, dtype=np.int64)
        self._looked = np.ones(2, dtype=np.int64)

    def restart(self, group: int, row: int) -> None:
        """A group's rows before ``row`` were looked into; more is needed the next time."""
        self._limits[group] *= 2.0
        self._sums[group], self._since[group], self._looked[group] = 0.0, row, row

    @property
    def arrays(self) -> tuple[Array, Array, Counts, Counts]:
        """What goes on: limits, sums, the rows since which these are, and those looked at."""
        return self._limits, self._sums, self._since, self._looked

    @property
    def looked(self) -> int:
        """The first row that was not looked at yet."""
        return min(self._looked.tolist())

    def look(self, news: Array, least: Array) -> list[tuple[int, int, int]]:
        """Look at ``e²`` and ``log d²`` of the rows from ``looked`` on, (G, n, 2).

        A small one tells of a process that promises too little where ``d²`` exceeds the ``least``
        (2,) of its logarithm: elsewhere the instrument's accuracy, which the samples need not show,
        explains it.

        Return, of each group one of whose thresholds is exceeded, the first row at which it is, the
        one since which it was approached, and the group; of these look at all again the next time.
        """
        first = self.looked
        raised = np.empty((2, 2), dtype=np.int64)
        if loops.there():
            loops.call(
                "page_look",
                *loops.strided(news)[:3],
                len(news) // 2,
                first,
                news.shape[1],
                least,
                _STEEPNESS,
                _OFFSETS,
                len(_THRESHOLDS),
                _CAUTIOUS,
                self._limits,
                self._sums,
                self._since,
                self._looked,
                raised,
            )
        else:
            squares = _of_groups(news[..., 0]).sum(axis=1)
            telling = np.asarray((_of_groups(news[..., 1]) > least[:, None, None]).all(axis=1))
            for group in range(2):
                new = slice(int(self._looked[group]) - first, None)
                raised[group] = self._look(group, squares[group, new], telling[group, new])
        found = zip(raised.tolist(), range(2), strict=True)
        return [(row, since, group) for (row, since), group in found if row >= 0]

    def _look(self, group: int, squares: Array, telling: Mask) -> tuple[int, int]:
        """Take a group's next rows if none of them is raised; the first that is, or -1."""
        looked, since = int(self._looked[group]), self._since[group]
        terms = 0.5 * (squares * _STEEPNESS[:, None] - _OFFSETS[:, None])
        terms[_CAUTIOUS] *= telling
        walk = np.cumsum(np.concatenate([self._sums[group][:, None], terms], axis=1), axis=1)
        lowest = np.minimum.accumulate(np.minimum(walk, 0.0), axis=1)
        sums, zero = walk - lowest, walk <= lowest
        exceeded = sums > self._limits[group][:, None]
        if exceeded.any():
            places = np.where(exceeded.any(axis=1), exceeded.argmax(axis=1), len(squares) + 1)
            test = int(places.argmin())
            place = int(places[test])
            before = np.flatnonzero(zero[test, :place])
            begin = looked + int(before[-1]) if len(before) else int(since[test])
            return looked + place - 1, begin
        newest = looked + len(squares) - zero[:, ::-1].argmax(axis=1)
        self._sums[group] = sums[:, -1]
        self._since[group] = np.where(zero.any(axis=1), newest, since)
        self._looked[group] = looked + len(squares)
        return -1, -1


class Epoch(NamedTuple):
    """A stretch of a segment with one process.

    It answers queries that know at least ``first`` samples. The regimes of translation and rotation
    were chosen for the samples from the rows ``since`` on; ``before`` (G,): ``Σ q`` of the samples
    before these.
    """

    first: int
    since: tuple[int, int]
    regimes: Regimes
    process: Process
    regression: Regression
    noise: Array
    before: Array


def epoch_scales(epochs: Sequence[Epoch], counts: Sequence[Counts], squares: Array) -> Array:
    """``s²`` of translation and rotation, (q, 2), of each epoch given its first counts of samples.

    ``squares`` (q, G): `Regression.squares` of all.
    """
    sizes = [len(each) for each in counts]
    since = np.repeat([epoch.since for epoch in epochs], sizes, axis=0)
    least = np.repeat([epoch.process.least_scales for epoch in epochs], sizes, axis=0)
    before = np.repeat([epoch.before for epoch in epochs], sizes, axis=0)
    own = (squares - before).reshape(len(squares), 2, -1).sum(axis=-1)
    return scale(own, np.concatenate(counts)[:, None] - since + 1, _COORDINATES, least)


class Adaptation:
    """The epochs of a segment, oldest first; the owner of their regressions."""

    def __init__(self, process: Process, regimes: Regimes) -> None:
        """Begin with ``regimes``, which the samples before the segment were in."""
        self.process = process
        self._regimes = regimes
        self._watch = Watch()
        self._least = np.log(_TELLING * np.square(process.accuracy))
        self.epochs: list[Epoch] = []
        self.count = 0
        """Number of samples taken."""

    def anew(self) -> Adaptation:
        """The same before its first sample."""
        return Adaptation(self.process, self._regimes)

    def at(self, count: int) -> Epoch:
        """The epoch that answers with the first ``count`` samples."""
        return next(e for e in reversed(self.epochs) if e.first <= max(count, 1))

    def regimes(self, process: Process, count: int, samples: Callable[[], Values]) -> Regimes:
        """The regimes after the first ``count`` samples; under another process, the best for these.

        ``samples``: what gives all of them, where they are needed.
        """
        epoch = self.at(count)
        if process.learned is None or process is self.process:
            return epoch.regimes
        if process.learned == self.process.learned:
            return epoch.regimes
        if count < 3:
            return AS_LEARNED
        values, last = samples()[:count], count - 1
        translation, rotation = (
            best_regime(learned, USUAL, values.of(group), min(since, last))
            for group, (learned, since) in enumerate(zip(process.learned, epoch.since, strict=True))
        )
        return translation, rotation

    def take(self, values: Values) -> None:
        """Take all samples so far, those known already first, and hold the process to them."""
        if not self.epochs:
            self._begin(1, (1, 1), self._regimes, values.parallel)
        hold = self._held
        if self.process.learned is not None and self.epochs[0].regression.is_in_c:
            hold = self._held_in_c
        while True:
            epoch = self.epochs[-1]  # the newest one; the others know what they need
            try:
                refuted = hold(values)
            except np.linalg.LinAlgError:
                if not epoch.regression.count:
                    self.epochs.pop()
                raise
            if refuted is None:
                break
            row, since, group, regime = refuted
            self._begin(
                row + 1,
                _replaced(epoch.since, group, since),
                _replaced(epoch.regimes, group, regime),
                values.parallel,
            )
        self.count = len(values.times)

    def _begin(self, first: int, since: tuple[int, int], regimes: Regimes, parallel: int) -> None:
        """Begin an epoch, which takes samples when it is held to them."""
        process = self.process.under(regimes)
        kernel, noise = process.parts(parallel // 2)
        regression = Regression.of(kernel, 2 * _COORDINATES // parallel)
        before = np.zeros(parallel)
        self.epochs.append(Epoch(first, since, regimes, process, regression, noise, before))

    def _held(self, values: Values) -> tuple[int, int, int, Regime] | None:
        """Let the newest epoch take all samples so far, and hold it to them.

        Where they refute it, the row that does, the one since which, the group and its regime.
        """
        epoch, learned = self.epochs[-1], self.process.learned
        is_new = not epoch.regression.count
        epoch.regression.extend(values.with_noise(epoch.noise))
        if is_new:
            epoch.before[:] = epoch.regression.square(epoch.since)
        while learned is not None and (refuted := self._refuted()) is not None:
            row, since, group, ratio = refuted
            first = max(since, row + 1 - _MOST_SAMPLES)
            begin = max(first - _CONTEXT, 0)
            seen = values[begin : row + 1].of(group)
            regime = best_regime(learned[group], epoch.regimes[group], seen, first - begin, ratio)
            self._watch.restart(group, row + 1)
            if regime != epoch.regimes[group]:
                return row, since, group, regime
        return None

    def _held_in_c(self, values: Values) -> tuple[int, int, int, Regime] | None:
        """The same."""
        process, epoch, watch, found = self.process, self.epochs[-1], self._watch, np.empty(5, int)
        if not process.rules:
            process.rules.append(_rules(process, self._least))
        rules, orders, rates, parts = process.rules[0]
        count, parallel, coordinates = values.values.shape
        work = _room(tuple(orders.tolist()), parallel, coordinates)
        changed = epoch.regression.take(
            "segment_hold",
            values.times,
            loops.doubles(values.values),
            values.variances,
            epoch.noise,
            rules,
            _SIZES,
            orders,
            rates,
            parts,
            np.array(epoch.regimes),
            np.array(epoch.since),
            epoch.before,
            *watch.arrays,
            np.empty(max(work, count * parallel)),
            found,
        )
        if not changed:
            return None
        row, since, group, *regime = found.tolist()
        return row, since, group, Regime(*regime)

    def _refuted(self) -> tuple[int, int, int, float] | None:
        """The first row that refutes the newest epoch, the one since which, and the group.

        And the standardised mean square of the rows between.
        """
        regression = self.epochs[-1].regression
        first = self._watch.looked
        if first >= regression.count:
            return None
        found = self._watch.look(regression.innovations(first), self._least)
        if not found:
            return None
        row, since, group = min(found)
        seen = _of_groups(regression.innovations(since)[..., 0])[group, :, : row + 1 - since]
        return row, since, group, float(seen.sum()) / (seen.shape[1] * _COORDINATES)


def _of_groups(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Those of translation and of rotation apart: (2, G / 2, n) of (G, n)."""
    return values.reshape(2, -1, values.shape[1])


def _replaced(pair: tuple[_Any, _Any], index: int, value: _Any) -> tuple[_Any, _Any]:
    return (value, pair[1]) if index == 0 else (pair[0], value)
