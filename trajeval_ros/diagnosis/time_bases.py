# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What relates stamps that have little or no time in common: another unit, epoch or zone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.diagnosis.cause import Cause, too_early
from trajeval_ros.diagnosis.rotations import SECOND, Array, Stamps, between
from trajeval_ros.median import median

Indices = npt.NDArray[np.intp]
Speed = Callable[[Array, Indices, Indices], Array]

# s. Offsets that clocks have, and what they are called; either trajectory may be ahead.
_LEAP_SECONDS = 18.0
_GPS_EPOCH = 315_964_800.0
_NTP_EPOCH = 2_208_988_800.0
_NAMED = (
    (_LEAP_SECONDS, "GPS time is 18 s ahead of UTC"),
    (37.0, "TAI is 37 s ahead of UTC"),
    (19.0, "TAI is 19 s ahead of GPS time"),
    (_GPS_EPOCH, "one counts from 1980, as GPS does, the other from 1970"),
    (_GPS_EPOCH - _LEAP_SECONDS, "one counts from 1980 by GPS time, the other from 1970 by UTC"),
    (_NTP_EPOCH, "one counts from 1900, as NTP does, the other from 1970"),
)
_HALF_HOUR = 1800.0
_MOST_HALF_HOURS = 28
_FACTORS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}
# Of the shorter of two spans, what has to be common once they are right.
_COMMON = 0.5
# And the shorter of the longer, where a unit is in question: units are a factor of 1000 apart.
_PART = 0.1
# s since 1970, from the year 2000 on; and less than this is a count since a start.
_EPOCH, _SINCE_START = 946_684_800.0, 1e8

# The search by motion: at least so long (s) and so many steps in common, at most so many in all;
# what the best correlation has to be, and all others at most, by this factor, further off (s).
_LEAST_SPAN, _LEAST_COUNT, _MOST_COUNT = 10.0, 100, 400_000
_CORRELATION, _SECOND_BEST, _APART = 0.8, 0.8, 1.0
# So many offsets at most are worth a trial, where a motion repeats itself.
_MOST_PEAKS = 8


def time_base(ground_truth: Stamps, estimate: Stamps, applied: float = 0.0) -> Cause | None:
    """What the sizes of stamps (N,) and (M,), ns, say of how they are related; None if nothing.

    ``applied`` (s) has been added to the estimate's already.
    """
    truth, other = _span(ground_truth), _span(estimate)
    for title, stamps, dense in (
        ("estimate", estimate, ground_truth),
        ("ground truth", ground_truth, estimate),
    ):
        if _are_frame_numbers(stamps) and not _are_frame_numbers(dense):
            return Cause(
                "frame_numbers",
                f"the {title}'s stamps look like frame numbers ({stamps[0] // SECOND},"
                f" {stamps[0] // SECOND + 1}, ...)",
                f"write the frames' own stamps, s, into the {title}'s first column",
            )
    for factor, unit in _FACTORS.items():
        if _alike(truth, (other[0] / factor, other[1] / factor)):
            return _unit("estimate", unit)
        if _alike((truth[0] / factor, truth[1] / factor), other):
            return _unit("ground truth", unit)
    return _offset(truth, other, applied)


def _unit(title: str, unit: str) -> Cause:
    short = {"milliseconds": "ms", "microseconds": "us", "nanoseconds": "ns"}[unit]
    return Cause(
        "time_unit",
        f"the {title}'s stamps are {unit}, by their size",
        f"say so in a first row of names: t [{short}],x,y,z,qx,qy,qz,qw",
    )


def _offset(truth: tuple[float, float], other: tuple[float, float], applied: float) -> Cause | None:
    """An offset that clocks are known for."""
    if _common(truth, other) >= _COMMON:
        return None
    known = [(sign * offset, name) for offset, name in _NAMED for sign in (1.0, -1.0)]
    for count in range(-_MOST_HALF_HOURS, _MOST_HALF_HOURS + 1):
        hours = abs(count) * _HALF_HOUR / 3600.0
        known.append((count * _HALF_HOUR, f"a time zone, {hours:g} h"))
    fitting = [
        (abs(other[0] + offset - truth[0]) + abs(other[1] + offset - truth[1]), offset, name)
        for offset, name in known
        if offset and _common(truth, (other[0] + offset, other[1] + offset)) >= _COMMON
    ]
    if fitting:
        _, offset, name = min(fitting)
        text = f"{name}: {too_early(offset, 0)}"
        return Cause("time_base", text, f"set estimate.time_offset={applied + offset:.10g}")
    for title, since_start, absolute in (
        ("estimate", other, truth),
        ("ground truth", truth, other),
    ):
        if since_start[1] < _SINCE_START and absolute[0] > _EPOCH:
            return Cause(
                "time_base",
                f"the {title}'s stamps count from a start (of the robot, or of the recording), the"
                " other's from 1970",
                f"if both begin together, set"
                f" estimate.time_offset={applied + truth[0] - other[0]:.3f}",
            )
    return None


def usual_name(offset: float) -> str:
    """What clocks that are off by this (s), to a second, have in common; empty for nothing."""
    names = (name for known, name in _NAMED if abs(abs(offset) - known) < 1.0)
    return next(names, "")


def _are_frame_numbers(stamps: Stamps) -> bool:
    """Whole seconds, one after the other, from a small one on."""
    if len(stamps) < 3 or stamps[0] < 0 or stamps[0] > 1e6 * SECOND or (stamps % SECOND).any():
        return False
    return bool(median(np.diff(stamps)) == SECOND)


def _span(stamps: Stamps) -> tuple[float, float]:
    return float(stamps.min()) / SECOND, float(stamps.max()) / SECOND


def _common(a: tuple[float, float], b: tuple[float, float]) -> float:
    """The share of the shorter of two spans that the other has, too."""
    shorter = min(a[1] - a[0], b[1] - b[0])
    return (min(a[1], b[1]) - max(a[0], b[0])) / shorter if shorter > 0.0 else 0.0


def _alike(a: tuple[float, float], b: tuple[float, float]) -> bool:
    """Whether two spans are of one recording: neither is a small part of the other."""
    longer, shorter = max(a[1] - a[0], b[1] - b[0]), min(a[1] - a[0], b[1] - b[0])
    return _common(a, b) >= _COMMON and shorter >= _PART * longer


class Found(NamedTuple):
    """An offset (s) to add to the estimate's stamps, how well, and to what (s) it is known."""

    offset: float
    correlation: float
    within: float


def offset_by_motion(
    truth_stamps: Stamps, truth: Array, estimate_stamps: Stamps, estimate: Array
) -> Found | None:
    """The offset at which the two move alike, however far off it is; None where none stands out.

    Stamps (N,) and (M,) ns, increasing, poses (N, 4, 4) and (M, 4, 4). Angular speed, or where
    that tells nothing the speed, correlated at every offset at which half of the shorter is common.
    """
    for found in _by_motion(truth_stamps, truth, estimate_stamps, estimate):
        if found and (
            len(found) == 1 or found[1].correlation <= _SECOND_BEST * found[0].correlation
        ):
            return found[0]
    return None


def offsets_by_motion(
    truth_stamps: Stamps, truth: Array, estimate_stamps: Stamps, estimate: Array
) -> tuple[Found, ...]:
    """The offsets at which the two move alike, the best first, also where several do."""
    found = _by_motion(truth_stamps, truth, estimate_stamps, estimate)
    return tuple(each for way in found for each in way)


def _by_motion(
    truth_stamps: Stamps, truth: Array, estimate_stamps: Stamps, estimate: Array
) -> Iterator[tuple[Found, ...]]:
    """By each of the speeds."""
    spans = [float(stamps[-1] - stamps[0]) / SECOND for stamps in (truth_stamps, estimate_stamps)]
    step = max(median(np.diff(s)) / SECOND for s in (truth_stamps, estimate_stamps))
    if min(spans) < _LEAST_SPAN or step <= 0.0:
        return
    if min(spans) < _LEAST_COUNT * step or sum(spans) > _MOST_COUNT * step:
        return
    # A lag of zero: both begin together.
    begin = float(truth_stamps[0] - estimate_stamps[0]) / SECOND
    for way in (_turning, _moving):
        a, b = (
            _sampled(stamps, way, poses, step)
            for stamps, poses in ((truth_stamps, truth), (estimate_stamps, estimate))
        )
        peaks = _peaks(a, b, max(1, round(_APART / step)))
        # A speed is over three steps.
        yield tuple(Found(begin + lag * step, value, 3 * step) for lag, value in peaks)


def _turning(poses: Array, first: Indices, second: Indices) -> Array:
    return np.asarray(np.linalg.norm(between(poses[:, :3, :3], first, second), axis=1))


def _moving(poses: Array, first: Indices, second: Indices) -> Array:
    return np.asarray(np.linalg.norm(poses[second, :3, 3] - poses[first, :3, 3], axis=1))


def _sampled(stamps: Stamps, way: Speed, poses: Array, step: float) -> Array:
    """A speed at every ``step`` (s) from the first stamp on, over three of them."""
    seconds = (stamps - stamps[0]) / SECOND
    second = np.searchsorted(seconds, seconds + 3 * step)
    first = np.flatnonzero(second < len(stamps))
    second = second[first]
    speed = way(poses, first, second) / (seconds[second] - seconds[first])
    grid = np.arange(0.0, seconds[-1], step)
    # One wild sample rules no correlation.
    limit = 5.0 * median(speed) + 1e-9
    middle = 0.5 * (seconds[first] + seconds[second])
    return np.asarray(np.interp(grid, middle, np.minimum(speed, limit)))


def _peaks(a: Array, b: Array, apart: int) -> list[tuple[float, float]]:
    """Lags of ``b`` (steps, of its first sample after that of ``a``), the best correlation first.

    None lower than what is too low; so many at most, more than ``apart`` from each other.
    """
    size = 1 << (len(a) + len(b)).bit_length()
    least = min(len(a), len(b)) // 2

    def correlated(x: Array, y: Array) -> Array:
        return np.fft.irfft(np.fft.rfft(x, size) * np.conj(np.fft.rfft(y, size)), size)

    a, b = a - a.mean(), b - b.mean()
    if min(a.std(), b.std()) <= 0.0:
        return []
    ones_a, ones_b = np.ones(len(a)), np.ones(len(b))
    count = np.rint(correlated(ones_a, ones_b))
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_a, mean_b = correlated(a, ones_b) / count, correlated(ones_a, b) / count
        spread_a = correlated(a * a, ones_b) / count - mean_a**2
        spread_b = correlated(ones_a, b * b) / count - mean_b**2
        value = (correlated(a, b) / count - mean_a * mean_b) / np.sqrt(spread_a * spread_b)
    # What hardly varies in common correlates by chance.
    lively = (spread_a > 0.1 * a.var()) & (spread_b > 0.1 * b.var())
    value = np.where((count >= least) & lively & np.isfinite(value), value, -1.0)
    found: list[tuple[float, float]] = []
    left = value.copy()
    while len(found) < _MOST_PEAKS:
        best = int(np.argmax(left))
        here = float(left[best])
        if here < _CORRELATION:
            break
        before, after = value[best - 1], value[(best + 1) % size]
        bend = before - 2 * here + after
        vertex = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
        lag = best if best < len(a) else best - size
        found.append((lag + float(vertex), here))
        distance = np.abs((np.arange(size) - best + size // 2) % size - size // 2)
        left[distance <= apart] = -1.0
    return found
