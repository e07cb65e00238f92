# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the samples were stamped: late, by a regular clock; in coarse ticks; or when they were taken.

Stamps alone do not tell a regular clock that was seen late from samples that were taken late. The
poses do, while the body moves: of

    r_k = x_k - a x_(k-1) - (1 - a) x_(k+1),  a = (t_(k+1) - t_k) / (t_(k+1) - t_(k-1)),

that with the right times is nearer to zero, more often than not. Divided by ``√(1 + a² + (1 -
a)²)`` noise alone favours neither.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.ground_truth import ticks
from trajeval_ros.ground_truth.clock import RegularClock
from trajeval_ros.ground_truth.faults import Fault
from trajeval_ros.ground_truth.segment import Samples

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

_NANO = 1e-9
_EVER = int(np.iinfo(np.int64).max)
# Stamps that go on as they are are looked at so many, and of so long (ns), at a time; ticks show in
# so many.
_BATCH = 64
_TOGETHER = 250_000_000
# Whether the poses are for the clock is asked anew with every so many samples.
_BLOCK = 32
# A sample tells where its two times share the time between its neighbours so differently.
_DIFFERENT = 0.01
# The balance of those that tell, in its standard deviations, from which on it does.
_CLEAR = 5.0
# Ticks without a regular clock behind them are a fault where the stamps are uncertain by so much.
_UNCERTAIN = 0.1
# So many whole seconds are no chance.
_ENOUGH = 10
# Stamps repeat because they are coarse where so large a share of them do.
_REPEATED = 0.5


@dataclass(frozen=True, slots=True)
class _Decided:
    """Samples whose stamps are decided on; the stamps as measured and as of the clock, (n,)."""

    measured: Stamps
    regular: Stamps
    poses: Array

    def __len__(self) -> int:
        return len(self.measured)

    def __add__(self, later: _Decided) -> _Decided:
        return _Decided(
            np.concatenate([self.measured, later.measured]),
            np.concatenate([self.regular, later.regular]),
            np.concatenate([self.poses, later.poses]),
        )

    def __getitem__(self, index: slice) -> _Decided:
        return _Decided(self.measured[index], self.regular[index], self.poses[index])


class Stamping:
    """Looks at all samples' stamps, and replaces them by the regular clock's where it is to."""

    def __init__(self, regularize: bool) -> None:
        """Start without samples."""
        self._regularize = regularize
        self._clock = RegularClock()
        self._waiting: list[Samples] = []
        self._held = _NONE
        self._before: _Decided | None = None
        self._for, self._asked = 0, 0
        self._count, self._follows, self._newest = 0, True, -_EVER
        self._late = _Late()
        self._coarse = _Coarse()

    @property
    def held(self) -> Stamps:
        """Stamps of the samples held back; (n,)."""
        return self._held.stamps if self._regularize else self._held.stamps[:0]

    def accept(self, samples: Samples) -> Samples:
        """Take later samples; return those that may go on."""
        if self._regularize:
            return self._decided(samples)
        self._waiting.append(samples)
        lasted = samples.stamps[-1] - self._waiting[0].stamps[0]
        if lasted >= _TOGETHER and sum(map(len, self._waiting)) >= _BATCH:
            self._look()
        return samples

    def confirm(self, until: int) -> Samples:
        """No more samples come up to the clock's look-ahead after ``until`` (ns)."""
        return self._decided(_NONE, until) if self._regularize else _NONE

    def conclude(self) -> Samples:
        """No more samples will come."""
        if not self._regularize:
            self._look(_EVER)
            return _NONE
        return self._decided(_NONE, _EVER)

    def _look(self, until: int | None = None) -> None:
        """Look at the samples that have gone on."""
        samples, self._waiting = _joined(self._waiting), []
        self._decided(samples, until)

    def _decided(self, samples: Samples, until: int | None = None) -> Samples:
        """Those whose stamps can be decided on, stamped as they are to be."""
        known = self._held + samples if len(self._held) else samples
        timed = [self._clock.accept(samples.stamps)]
        if until == _EVER:
            timed.append(self._clock.conclude())
        elif until is not None:
            timed.append(self._clock.confirm(until))
        measured, regular = (
            np.concatenate([getattr(each, part) for each in timed])
            for part in ("measured", "regular")
        )
        count = len(measured)
        self._held = known[count:]
        self._coarse.add(measured)
        decided = _Decided(measured, regular, known.poses[:count])
        first = _BLOCK - self._count % _BLOCK
        edges = [0, *range(first, count, _BLOCK), count]
        if (measured == regular).all():
            edges = [0, count]  # the poses have no choice
        stamps = [self._stamps(decided[a:b]) for a, b in pairwise(edges) if b > a]
        return replace(known[:count], stamps=np.concatenate([_NONE.stamps, *stamps]))

    def _stamps(self, samples: _Decided) -> Stamps:
        """The stamps of some samples, of one block where the poses have a choice."""
        stamps = samples.regular if self._follows else samples.measured
        # Where it goes from one to the other, the stamps go on.
        steps = np.arange(len(stamps))
        stamps = np.maximum.accumulate(np.maximum(stamps - steps, self._newest + 1)) + steps
        self._newest = int(stamps[-1])
        self._late.add(samples)
        self._vote(samples)
        begun, self._count = self._count // _BLOCK, self._count + len(stamps)
        if self._count // _BLOCK > begun:
            self._follows = self._balance > -_CLEAR
        return np.asarray(stamps)

    def _vote(self, samples: _Decided) -> None:
        """Count the samples that are smoother at the clock's times, and those that tell."""
        known = samples if self._before is None else self._before + samples
        self._before = known[max(len(known) - 2, 0) :]
        if len(known) < 3 or (known.measured == known.regular).all():
            return
        shares = [_shares(stamps) for stamps in (known.measured, known.regular)]
        tells = np.abs(shares[0] - shares[1]) > _DIFFERENT
        if not tells.any():
            return
        between = np.swapaxes(known.poses[:-2, :3, :3], 1, 2)
        steps = [
            np.concatenate(
                [
                    later[:, :3, 3] - known.poses[:-2, :3, 3],
                    se3.log_so3(between @ later[:, :3, :3]),
                ],
                axis=1,
            )[tells]
            for later in (known.poses[1:-1], known.poses[2:])
        ]
        sizes = []
        for share in shares:
            a = share[tells, None]
            residual = (steps[0] - (1.0 - a) * steps[1]) / np.sqrt(1.0 + a**2 + (1.0 - a) ** 2)
            sizes.append((residual.reshape(-1, 2, 3) ** 2).sum(axis=2))
        measured, regular = sizes
        self._for += int((regular < measured).sum())
        self._asked += int((regular != measured).sum())

    @property
    def _balance(self) -> float:
        """How clearly the poses are for the clock, or against it, in standard deviations."""
        return (2.0 * self._for - self._asked) / math.sqrt(max(self._asked, 1))

    @property
    def is_whole_seconds(self) -> bool:
        """Whether every stamp was a whole second."""
        return self._coarse.is_whole

    @property
    def is_regular(self) -> bool:
        """Whether the stamps are those of a regular clock that was seen late, or sampled late."""
        period = self._clock.period
        return period is not None and self._clock.sums.tells(period)

    def faults(self, stamp_std: float, repeated: float) -> tuple[Fault, ...]:
        """What is wrong with the stamps.

        ``stamp_std``: what was learned of their noise, s; ``repeated``: the share of stamps that
        were those before them.
        """
        found: list[Fault] = []
        period, regular = self._clock.period, self.is_regular
        if period is not None and regular and self._balance > _CLEAR:
            found.append(self._late.fault(period, self._regularize))
        tick = self._coarse.tick * _NANO
        uncertain = self._balance > 0.0 if regular else stamp_std > _UNCERTAIN * tick
        coarse = self._coarse.fault(uncertain, repeated >= _REPEATED)
        return (*found, *([] if coarse is None else [coarse]))


class _Late:
    """How late the stamps are."""

    def __init__(self) -> None:
        self._count, self._sum, self._most = 0, 0, 0
        self._span = (0, 0)

    def add(self, samples: _Decided) -> None:
        late = samples.measured - samples.regular
        mended = np.flatnonzero(late != 0)
        if not len(mended):
            return
        begin, end = (int(samples.measured[i]) for i in (mended[0], mended[-1]))
        self._span = (self._span[0] if self._count else begin, end)
        self._count += len(mended)
        self._sum += int(late.sum())
        self._most = max(self._most, int(late.max()))

    def fault(self, period: float, mended: bool) -> Fault:
        mean, most = (round(1e-6 * late) for late in (self._sum / self._count, self._most))
        taken = "are taken" if mended else "can be taken, by ground_truth.stamps: regularize"
        detail = (
            f"one in {1e3 * period:.4g} ms, {mean} ms late on average, {most} ms at most: "
            f"the clock's stamps {taken}"
        )
        return Fault("stamps_late", *self._span, self._count, detail)


class _Coarse:
    """Ticks that the stamps are on."""

    def __init__(self) -> None:
        self._last = _NONE.stamps
        self._whole, self._seen = True, 0
        self._regular_tick = 0
        self.tick = 0
        self._count = 0
        self._span = (0, 0)
        self._all = (0, 0)

    @property
    def is_whole(self) -> bool:
        return self._whole and self._seen >= _ENOUGH

    def add(self, stamps: Stamps) -> None:
        if not len(stamps):
            return
        self._all = (self._all[0] if self._seen else int(stamps[0]), int(stamps[-1]))
        self._seen += len(stamps)
        self._whole = self._whole and ticks.whole_seconds(stamps)
        self._last = np.concatenate([self._last, stamps])
        whole = len(self._last) // _BATCH * _BATCH
        if whole:
            self._look(self._last[:whole].reshape(-1, _BATCH))
            self._last = self._last[whole:]

    def _look(self, blocks: Stamps) -> None:
        found = ticks.resolutions(blocks)
        self._regular_tick = max(self._regular_tick, int(found.max()))
        rounded = np.flatnonzero(ticks.quantised(blocks, found))
        if len(rounded):
            begin, end = int(blocks[rounded[0], 0]), int(blocks[rounded[-1], -1])
            self._span = (self._span[0] if self._count else begin, end)
            self._count += blocks.shape[1] * len(rounded)
            self.tick = max(self.tick, int(found[rounded].max()))

    def fault(self, uncertain: bool, repeated: bool) -> Fault | None:
        """The fault; ``uncertain``: the poses say so, too."""
        if self._count and (uncertain or self._whole):
            return Fault("stamps_quantised", *self._span, self._count, _named(self.tick))
        if repeated and self._regular_tick:
            return Fault("stamps_quantised", *self._all, self._seen, _named(self._regular_tick))
        return None


def _named(tick: int) -> str:
    return "whole seconds" if tick == ticks.SECOND else f"ticks of {1e-6 * tick:.4g} ms"


def _shares(stamps: Stamps) -> Array:
    """``a`` of the samples but for the first and the last; (n - 2,)."""
    return np.asarray((stamps[2:] - stamps[1:-1]) / (stamps[2:] - stamps[:-2]))


def _joined(samples: list[Samples]) -> Samples:
    found = samples[0] if samples else _NONE
    for more in samples[1:]:
        found = found + more
    return found


_NONE = Samples(np.empty(0, dtype=np.int64), np.empty((0, 4, 4)))
