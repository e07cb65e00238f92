# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A part of a run in time, and trajectories cut to it."""

from __future__ import annotations

import dataclasses
import decimal
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from trajeval_ros.files.trajectory import Integers, Trajectory

Mask = npt.NDArray[np.bool_]

_SECOND = 1_000_000_000
# Seconds from the beginning of a run are fewer than these, three years; stamps are more: the
# sensors' clocks count from 1970, and this is 1973. In nanoseconds likewise.
_FIRST_STAMP = 100_000_000
# A stamp that was not set, or is wrong, is no beginning: the next lies more than an hour later.
_HOUR = 3600 * _SECOND


class SpanError(ValueError):
    """A span that is none, or holds nothing; the message is one line."""


class OrderError(SpanError):
    """A span that ends before it begins."""


@dataclasses.dataclass(frozen=True)
class Instant:
    """A time as the user gave it, exact to the nanosecond.

    Attributes:
        nanoseconds: since the run began; or the stamp.
        is_stamp: which of the two.
        text: as given.
    """

    nanoseconds: int
    is_stamp: bool
    text: str

    @classmethod
    def of(cls, value: str | float) -> Instant:
        """Of seconds since the run began, or a stamp in s or ns: it is the size that tells.

        Below 1e8 it is seconds since the beginning; from there on a stamp, in s, or from 1e17 on
        in ns.

        Raises:
            SpanError: no number, one that is negative or not finite, or of neither size.
        """
        text = str(value)
        try:
            number = decimal.Decimal(text)
        except decimal.InvalidOperation:
            raise SpanError(f"not a number: {text!r}") from None
        if not number.is_finite() or number < 0:
            raise SpanError(f"must be finite and not negative: {text}")
        if number >= _FIRST_STAMP * _SECOND:
            if number >= 2**63:
                raise SpanError(f"out of the range of nanoseconds: {text}")
            return cls(int(number), True, text)
        if number >= 2**63 // _SECOND:
            raise SpanError(f"neither seconds nor nanoseconds since 1970: {text}")
        return cls(round(number * _SECOND), number >= _FIRST_STAMP, text)


@dataclasses.dataclass(frozen=True)
class Span:
    """From `begin` to `end`, both included, ns on the ground truth's clock; None: open.

    ``text`` says it: "from 10 s to 40 s after the ground truth begins".
    """

    begin: int | None
    end: int | None
    text: str


def span_of(start: Instant | None, end: Instant | None, truth: Trajectory) -> Span | None:
    """The span on the ground truth's clock; None where it is open at both ends.

    Raises:
        OrderError: it ends before it begins.
        SpanError: the ground truth has no pose.
    """
    if start is None and end is None:
        return None
    if len(truth) == 0:
        raise SpanError(f"{truth.source}: it has no pose, so nothing can be cut")
    first = _first(truth.stamps)
    bounds = [
        None if one is None else one.nanoseconds + (0 if one.is_stamp else first)
        for one in (start, end)
    ]
    begin_ns, end_ns = bounds
    if begin_ns is not None and end_ns is not None and end_ns <= begin_ns:
        assert start is not None
        assert end is not None
        raise OrderError(f"the end, {_said(end, first)}, is not after the start, {start.text}")
    words = [
        f"{word} {'the stamp ' if one.is_stamp else ''}{one.text}{'' if one.is_stamp else ' s'}"
        for word, one in (("from", start), ("to", end))
        if one is not None
    ]
    given = [one for one in (start, end) if one is not None]
    since = "" if all(one.is_stamp for one in given) else " after the ground truth begins"
    return Span(begin_ns, end_ns, " ".join(words) + since)


def cut_all(
    span: Span, truth: Trajectory, estimates: Mapping[str, Trajectory], offsets: Mapping[str, int]
) -> tuple[Trajectory, dict[str, Trajectory]]:
    """Cut a ground truth and its estimates, by name, whose ``offsets`` (ns) are added to stamps.

    The ground truth keeps the sample before and the one after, where it has them: every pose of
    the span has a sample on either side of it.

    Raises:
        SpanError: nothing of one of them is left.
    """
    left = _cut(truth, _around(truth.stamps, span))
    cut = {
        name: _cut(one, _within(one.stamps + offsets[name], span))
        for name, one in estimates.items()
    }
    for one in (left, *cut.values()):
        if len(one) == 0:
            raise SpanError(f"{one.source}: no pose of it lies {span.text}")
    return left, cut


def words(span: Span, truth: Trajectory, estimates: Sequence[Trajectory]) -> str:
    """What has been cut, in one line."""
    parts = [
        f"{one.cut:,} of {one.cut + len(one):,} {what}"
        for one, what in (
            *((one, f"poses of {one.source}") for one in estimates),
            (truth, "samples of the ground truth"),
        )
    ]
    return f"{span.text}; left out: {', '.join(parts)}; seconds below count from there"


def _first(stamps: Integers) -> int:
    ordered = np.unique(stamps)
    alone = np.diff(ordered) > _HOUR
    return int(ordered[int(np.argmin(alone)) if len(alone) and not alone.all() else 0])


def _said(instant: Instant, first: int) -> str:
    if instant.is_stamp:
        return instant.text
    return f"{instant.text} s after the ground truth's first stamp {first / _SECOND:.3f} s"


def _within(stamps: Integers, span: Span) -> Mask:
    inside = np.ones(len(stamps), dtype=np.bool_)
    if span.begin is not None:
        inside &= stamps >= span.begin
    if span.end is not None:
        inside &= stamps <= span.end
    return inside


def _around(stamps: Integers, span: Span) -> Mask:
    """Those within, and the nearest before and after."""
    begin, end = span.begin, span.end
    if begin is not None and (stamps <= begin).any():
        begin = int(stamps[stamps <= begin].max())
    if end is not None and (stamps >= end).any():
        end = int(stamps[stamps >= end].min())
    return _within(stamps, dataclasses.replace(span, begin=begin, end=end))


def _cut(trajectory: Trajectory, inside: Mask) -> Trajectory:
    covariances = trajectory.covariances
    return dataclasses.replace(
        trajectory,
        stamps=trajectory.stamps[inside],
        positions=trajectory.positions[inside],
        quaternions=trajectory.quaternions[inside],
        rows=trajectory.rows[inside],
        covariances=None if covariances is None else covariances[inside],
        cut=trajectory.cut + int(np.count_nonzero(~inside)),
    )
