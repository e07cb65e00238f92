# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How uncertain the samples' stamps are, and what that means for each sample.

A driver that stamps on arrival jitters: a sample stamped t was taken at t - ε, ``ε ~ N(0, σ_t²)``,
and lies off by ``ẋ ε``, along the motion and nowhere else. That tells it from all other noise. Of
the residual from the cubic through two neighbours on either side,

    r_k = s_k (x_k - Σ_j w_kj x_(k+j)),  j = ±1, ±2,  s_k² (1 + Σ_j w_kj²) = 1,

two that follow each other have, of stamps and of white noise n, the covariance

    E[r_k r_(k+1)] = -c_k (σ_t² ẋ² + n²)   along the motion, and without σ_t across,

    c_k = s_k s_(k+1) (w_k1 + w_(k+1),-1 - w_k,-1 w_(k+1),-2 - w_k2 w_(k+1),1),

while motion that a cubic does not follow has a positive one. Where samples are taken every h, and
the stamps alone are uneven, residuals are ``-s_k h ẋ Σ_j w_kj j``; those of right stamps have
nothing to do with that, whatever the motion (``docs/method.md``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops
from trajeval_ros.ground_truth.ticks import coarsest, middle, on_even_clock
from trajeval_ros.median import median

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

HISTORY = 120
"""So many samples before one may be needed for its slope."""

# A slope is a straight line's through so many samples up to the one that it belongs to: the newest,
# or, where these lie closer together than jitter allows (s), every so many; none older than this
# (s) but the one before.
_ROWS = 16
_STRIDE = 8
_SHORTEST = 0.1
_LONGEST = 0.5
# Segments with fewer samples, or fewer segments, do not tell.
_FEWEST_SAMPLES = 12
_FEWEST_SEGMENTS = 4
# The estimate stands out from its scatter over the segments so much, in translation and rotation
# together; and what it does to a sample from the instrument's accuracy.
_SIGNIFICANT = 3.0
# In each of the two so much where positions and orientations are off by the same times; and so much
# in both where residuals tell that samples were taken evenly.
_AGREED, _ENOUGH = 1.0, 2.0
# Between samples further apart than this (s) motion is not told from noise of the stamps by what is
# along it; and further apart than the other only where residuals do not say that stamps are right:
# so many standard deviations above its value, the share of uneven intervals is less than this.
_RAREST, _RARE = 0.25, 0.15
_SURELY, _LEAST_SHARE = 3.0, 0.1
# An interval counts as no longer than the usual one by so many of it.
_IRREGULAR = 2.0
# Samples with an interval so much longer than the usual one beside them may not be taken evenly.
_EVEN = 2.5
# Neighbouring samples share noise: residuals scatter as the sums of so many that follow each other.
_TOGETHER = 6
# None is missing where it is longer by less than so much of it.
_NONE_MISSING = 0.5
# So large a share of the intervals are unlike the usual one where stamps were rounded.
_UNEVEN = 0.05
# Ticks finer than this share of the usual interval matter only where the poses show them.
_COARSE = 0.25
# A sample tells where it is this share of the time between its neighbours off their midst.
_DIFFERENT = 0.01
# Single residuals count as no more than so many times the median of their squares.
_CLIPPED = 100.0
# Velocities are those between so many samples before and after.
_REACH = 8
# The neighbours that a cubic goes through.
_NEAR = (-2, -1, 1, 2)


def slopes(times: Array, coordinates: Array, first: int) -> Array:
    """The slopes ``ẋ`` of the rows from ``first`` on, each from the rows up to it; (n - first, c).

    ``times`` (n,) s and ``coordinates`` (n, c). Zero for a row without one before it.
    """
    rows = np.arange(first, len(times))
    back = np.arange(_ROWS)
    near, far = rows[:, None] - back, rows[:, None] - _STRIDE * back
    reach = times[rows] - times[np.maximum(near[:, -1], 0)]
    dense = (reach < _SHORTEST) & (far[:, 3] >= 0)
    index = np.where(dense[:, None], far, near)
    used = index >= 0
    index = np.maximum(index, 0)
    apart = times[index] - times[rows, None]
    used &= (apart >= -_LONGEST) | (back == 1)
    count = used.sum(axis=1)
    apart = np.where(used, apart, 0.0)
    apart -= (apart.sum(axis=1) / count)[:, None]
    apart = np.where(used, apart, 0.0)
    square = (apart**2).sum(axis=1)
    product = (apart[:, :, None] * coordinates[index]).sum(axis=1)
    known = square > 0.0
    return np.asarray(
        np.where(known[:, None], product, 0.0) / np.where(known, square, 1.0)[:, None]
    )


class Rounding(NamedTuple):
    """What rounding makes the stamps uncertain by, s.

    ``std``: as white noise, if their coarseness is rounding. Where it is for sure, and the samples
    are too rare to learn it: ``least``, as white noise, and ``shared``, by which stamps that follow
    each other may be off together.
    """

    std: float
    least: float = 0.0
    shared: float = 0.0


def rounding(stamps: Sequence[Stamps], segments: Sequence[tuple[Array, Array]]) -> Rounding:
    """How coarse the ``stamps`` (n,) of segments are; ``segments`` as for `stamp_noise`."""
    if not len(stamps):
        return Rounding(0.0)
    steps = np.concatenate([np.diff(each) for each in stamps])
    usual = median(steps)
    tick = coarsest(np.concatenate(stamps), usual)
    uneven = np.abs(steps - usual) > 0.5 * tick
    if not tick or uneven.mean() < _UNEVEN:
        return Rounding(0.0)
    if usual <= 1e9 * _RAREST:
        return Rounding(1e-9 * tick / math.sqrt(12.0))
    # The poses tell where the motion is slow enough; and no samples that are missing leave stamps
    # within a tick of even ones for long.
    evenly = _evenly(segments)
    told = evenly > _SIGNIFICANT
    told |= tick >= _COARSE * usual and on_even_clock(stamps, tick)
    if evenly < -_SIGNIFICANT or not told:
        return Rounding(0.0)
    # Uniform within the tick. Most programs cut off: then all stamps are half a tick early on
    # average, and no number of samples shows it.
    return Rounding(0.0, 1e-9 * tick / math.sqrt(12.0), 0.5e-9 * tick)


def _evenly(segments: Sequence[tuple[Array, Array]]) -> float:
    """How clearly the samples were taken at even times, in standard deviations of a coin's."""
    balance, count = 0, 0
    for times, x in segments:
        share = (times[2:] - times[1:-1]) / (times[2:] - times[:-2])
        tells = np.abs(share - 0.5) > _DIFFERENT
        sizes = []
        for a in (share, np.full(len(share), 0.5)):
            residual = x[1:-1] - a[:, None] * x[:-2] - (1.0 - a[:, None]) * x[2:]
            residual /= np.sqrt(1.0 + a**2 + (1.0 - a) ** 2)[:, None]
            sizes.append((residual.reshape(-1, 2, 3) ** 2).sum(axis=2)[tells])
        balance += int(np.sign(sizes[0] - sizes[1]).sum())
        count += 2 * int(tells.sum())
    return balance / math.sqrt(max(count, 1))


def stamp_noise(
    segments: Sequence[tuple[Array, Array]], accuracy: tuple[float, float], rounded: float = 0.0
) -> float:
    """The standard deviation ``σ_t`` of the stamps, s; zero where it does not show.

    ``segments``: ``times`` (n,) s and ``coordinates`` (n, 6) of each; ``accuracy``: the
    instrument's, of translation (m) and rotation (rad); ``rounded``: what rounding explains of it.
    """
    if sum(len(times) >= _FEWEST_SAMPLES for times, _ in segments) < _FEWEST_SEGMENTS:
        return 0.0
    enough = [(times, x) for times, x in segments if len(times) >= _FEWEST_SAMPLES]
    usual = median(np.concatenate([np.diff(times) for times, _ in segments]))
    found = [_found([(t, x[:, 3 * g : 3 * g + 3]) for t, x in enough], usual) for g in (0, 1)]
    evenly = math.hypot(*(max(each.evenly, 0.0) for each in found)) > _SIGNIFICANT
    if usual > _RARE and _are_right(found):
        return 0.0
    agreed = all(each.significance > _AGREED for each in found) and _agree(enough)
    agreed = agreed or evenly
    most = _of_intervals([times for times, _ in segments], usual, agreed, evenly)
    most = max(most, rounded**2)
    told = []
    for each, least in zip(found, accuracy, strict=True):
        capped = min(each.variance, most)
        # What it does to a sample, while the body moves.
        if capped * each.speed >= least**2:
            told.append((each.significance**2, capped))
    weight = math.fsum(each for each, _ in told)
    if not weight > (_ENOUGH if evenly else _SIGNIFICANT) ** 2:
        return 0.0
    return math.sqrt(math.fsum(each * variance for each, variance in told) / weight)


def _of_intervals(times: Sequence[Array], usual: float, agreed: bool, evenly: bool) -> float:
    """The most that the variance of the stamps can be, s², by their intervals.

    White noise of the stamps makes an interval long and the next one short, with the covariance
    ``-σ_t²``; missing samples do not. Where it has none, what looks like noise of the stamps is
    motion that the samples are too rare for. A throttle takes it away, too: it lets a stamp pass so
    long after the last that it let pass, be that late or not. So where positions and orientations
    have ``agreed`` on the noise, or residuals say that samples were taken ``evenly``, it is enough
    that intervals scatter as much; in the latter case long ones are late, too.
    """
    if usual > _RAREST and not evenly:
        return 0.0
    offs = [np.clip(np.diff(each) - usual, -usual, _IRREGULAR * usual) for each in times]
    if agreed:
        every = np.concatenate(offs)
        if evenly:
            return float((np.minimum(every, usual) ** 2).mean())
        return float((every[every < _NONE_MISSING * usual] ** 2).mean())
    products = -math.fsum(float((off[:-1] * off[1:]).sum()) for off in offs)
    return max(products / max(sum(len(off) - 1 for off in offs), 1), 0.0)


class _Found(NamedTuple):
    """What a group's residuals show.

    ``variance`` of the stamps, s², and its ``significance``, in standard deviations; ``speed``: the
    mean square of the body's where it moves; ``share``: that of uneven intervals which is the
    stamps' alone, with its ``scatter``, zero where none tells.
    """

    significance: float
    variance: float
    speed: float
    share: float = 0.0
    scatter: float = 0.0

    @property
    def evenly(self) -> float:
        """How clearly samples were taken at even times, in standard deviations."""
        return self.share / self.scatter if self.scatter > 0.0 else 0.0


def _are_right(found: Sequence[_Found]) -> bool:
    """Whether the residuals say that samples were taken when they are stamped."""
    known = [each for each in found if each.scatter > 0.0]
    weights = [each.scatter**-2 for each in known]
    share = math.fsum(w * each.share for w, each in zip(weights, known, strict=True))
    total = math.fsum(weights)
    return total > 0.0 and share + _SURELY * math.sqrt(total) < _LEAST_SHARE * total


def _found(segments: Sequence[tuple[Array, Array]], usual: float) -> _Found:
    """Of ``times`` (n,) and a group's coordinates (n, 3) of each segment; ``usual``: step, s."""
    sums = np.array([neighbours(*each, usual) for each in segments]).T
    excess, squares, counts, across, due, scattered, expected = sums
    whole = max(float(expected.sum()), 1e-300)
    share, scatter = float(due.sum()) / whole, math.sqrt(float(scattered.sum())) / whole
    # Motion that bends aside is no noise across, which along the motion there were more than of.
    excess += np.minimum(across, 0.0)
    if not squares.sum() > 0.0 or not excess.sum() > max(across.sum(), 0.0):
        return _Found(0.0, 0.0, 0.0, share, scatter)
    variance = float(excess.sum() / squares.sum())
    speed = float((squares**2).sum() / (squares * counts).sum())
    off = float(np.sqrt(((excess - variance * squares) ** 2).sum()))
    return _Found(float(excess.sum()) / max(off, 1e-300), variance, speed, share, scatter)


def _agree(segments: Sequence[tuple[Array, Array]]) -> bool:
    """Whether positions and orientations are off by the same times.

    Then a sample's residuals along the motion have the same sign in both, and its neighbour's the
    other one. Where motion bends between the samples, neighbours' signs are the same.
    """
    same, following = 0.0, 0.0
    for times, x in segments:
        one, other = (_residuals(times, x[:, 3 * g : 3 * g + 3]).along for g in (0, 1))
        same += float((one * other).sum())
        following += float((one[:-1] * other[1:] + other[:-1] * one[1:]).sum())
    return same > 0.0 > following


class Sums(NamedTuple):
    """What a segment's residuals add up to.

    ``excess`` along the motion, the squared speeds beside it and their number, what is ``across``;
    and of residuals times what they would be of samples taken at even times, the sum, the square of
    its scatter, and what it would be then.
    """

    excess: float
    squares: float
    number: float
    across: float
    due: float
    scattered: float
    expected: float


def neighbours(times: Array, x: Array, usual: float) -> Sums:
    """Of ``times`` (n,) and a group's coordinates (n, 3); ``usual``: interval, s."""
    if loops.there():
        reach = min(_REACH, (len(times) - 1) // 2)
        found, work = np.empty(len(Sums._fields)), np.empty(14 * len(times))
        place, wide, _ = loops.strided(x)
        loops.call(
            "stamp_sums",
            loops.doubles(times),
            place,
            wide,
            len(x),
            reach,
            _CLIPPED,
            usual,
            _EVEN,
            _TOGETHER,
            work,
            found,
        )
        return Sums(*found.tolist())
    along, across, speed, weight, even = _residuals(times, x)
    sideways = 0.5 * (across[:-1] * across[1:]).sum(axis=1)
    products = along[:-1] * along[1:] - sideways
    moving = (speed[:-1] > 0.0) & (speed[1:] > 0.0) & (weight > 0.0)
    longest = np.lib.stride_tricks.sliding_window_view(np.diff(times), len(_NEAR)).max(axis=1)
    wanted = np.where(longest < _EVEN * usual, usual * speed * even, 0.0)
    due = along * wanted
    together = np.add.reduceat(due, np.arange(0, len(due), _TOGETHER))
    # Divided by the weight it would give the bursts, where the weight is small, all the say.
    return Sums(
        float(-products[moving].sum()),
        float((weight * speed[:-1] * speed[1:])[moving].sum()),
        float(moving.sum()),
        float(-sideways[moving].sum()),
        float(due.sum()),
        float((together**2).sum()),
        float((wanted**2).sum()),
    )


class _Residuals(NamedTuple):
    """Those of a segment's inner samples from the cubic through their neighbours.

    ``along`` the motion (n,) and ``across`` it (n, 3); ``speed`` (n,) of the motion; ``weight``
    (n - 1,): what of white noise two that follow each other share, with the other sign; ``even``
    (n,): what ``along`` would be at unit speed of samples taken at even times, in intervals.
    """

    along: Array
    across: Array
    speed: Array
    weight: Array
    even: Array


def _residuals(times: Array, x: Array) -> _Residuals:
    """Of a group's coordinates x (n + 4, 3)."""
    index = np.arange(2, len(times) - 2)
    near = index[:, None] + np.array(_NEAR)
    apart = times[near] - times[index, None]
    shares = np.stack([_share(apart, j) for j in range(len(_NEAR))], axis=1)
    scale = 1.0 / np.sqrt(1.0 + (shares**2).sum(axis=1))
    residual = (x[index] - (shares[:, :, None] * x[near]).sum(axis=1)) * scale[:, None]
    one, next_one = shares[:-1].T, shares[1:].T
    weight = one[2] + next_one[1] - one[1] * next_one[0] - one[3] * next_one[2]
    reach = min(_REACH, (len(times) - 1) // 2)
    low, high = np.maximum(index - reach, 0), np.minimum(index + reach, len(times) - 1)
    velocity = (x[high] - x[low]) / (times[high] - times[low])[:, None]
    speed = np.linalg.norm(velocity, axis=1)
    direction = velocity / np.where(speed > 0.0, speed, 1.0)[:, None]
    limit = math.sqrt(_CLIPPED * middle((residual**2).sum(axis=1)))
    size = np.linalg.norm(residual, axis=1)
    residual *= np.minimum(1.0, limit / np.where(size > 0.0, size, 1.0))[:, None]
    along = (residual * direction).sum(axis=1)
    across = residual - along[:, None] * direction
    even = -scale * (shares @ np.array(_NEAR, dtype=np.float64))
    return _Residuals(along, across, speed, weight * scale[:-1] * scale[1:], even)


def _share(apart: Array, j: int) -> Array:
    """Of the neighbour j in the cubic's value at zero; (n,). ``apart`` (n, 4): where they are."""
    others = [i for i in range(len(_NEAR)) if i != j]
    return np.asarray(np.prod([apart[:, i] / (apart[:, i] - apart[:, j]) for i in others], axis=0))
