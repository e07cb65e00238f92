# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Who is wrong: two estimates, or the ground truth.

The three-cornered hat of clock comparison (J. Gray and D. Allan, "A method for estimating the
frequency stability of an individual oscillator", 1974): of three that err independently, each one's
variance follows from those of the three differences,

    var(ground truth) = (var(a - g) + var(b - g) - var(a - b)) / 2.

As there, the differences are of steps, which need no common world and do not gather drift: each
one's displacement over a few seconds, in its own body's axes. Where two estimates agree with each
other far better than either does with the ground truth, the ground truth has the larger part, or
the two share an error: sensor, calibration, map. Which of these it is, no variance can tell.

Of two real estimators of one run each is 0.2 to 2.5 times as far from the ground truth as from the
other, and in single stretches of a run up to 6 times, with no more than a 2.3-fold rise against the
rest where the two agree.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.comparison.common import Evaluated, Indices, pair_nearest
from trajeval_ros.comparison.errors import steps

Array = npt.NDArray[np.float64]

_STRETCHES = 20
_FEWEST_STRETCHES = 6
_FEWEST = 10  # steps in a stretch
_SHORTEST, _LONGEST = 1.0, 5.0
"""Of a step, s: a stretch of the run, within these."""
_AGREE = 8.0
"""So many times nearer to each other than to the ground truth: above what is usual."""
_RISE = 3.0
"""So many times farther from the ground truth than in the rest of the run, for a part of it."""
_COPIES = 100.0
"""Beyond this two are one output, and say nothing of the ground truth."""


@dataclasses.dataclass(frozen=True)
class Shared:
    """Two estimates that agree with each other and not with the ground truth.

    Attributes:
        a: name.
        b: name.
        begin: stamp of the first pose, ns, on the ground truth's clock.
        end: of the last.
        whole: whether that is the whole run.
        step: what the displacements are over, s.
        from_truth: RMS difference of a displacement from the ground truth's, m; of the nearer one.
        from_each_other: RMS difference of the two, m.
        truth_std: the ground truth's part of it by the three-cornered hat, m.
    """

    a: str
    b: str
    begin: int
    end: int
    whole: bool
    step: float
    from_truth: float
    from_each_other: float
    truth_std: float

    @property
    def ratio(self) -> float:
        """How many times better they agree with each other."""
        return self.from_truth / self.from_each_other


def shared_error(estimates: Sequence[Evaluated]) -> Shared | None:
    """The clearest error that two of the estimates share against the ground truth; None if none."""
    found = [_of_pair(a, b) for a, b in combinations(estimates, 2)]
    known = [one for one in found if one is not None]
    return max(known, key=lambda one: one.ratio, default=None)


def _of_pair(a: Evaluated, b: Evaluated) -> Shared | None:
    index_a, index_b = pair_nearest(a.stamps, b.stamps)
    a, b = a[index_a], b[index_b]
    if len(a) < _FEWEST_STRETCHES * _FEWEST:
        return None
    seconds = float(a.stamps[-1] - a.stamps[0]) * 1e-9
    step = min(max(seconds / _STRETCHES, _SHORTEST), _LONGEST)
    begin, end = steps(a, step, "s")
    count = min(_STRETCHES, len(begin) // _FEWEST)
    if count < _FEWEST_STRETCHES:
        return None
    from_a, from_b = (_differences(each, begin, end) for each in (a, b))
    errors = (from_a, from_b, from_a - from_b)
    # Mean squares, m^2, of each difference over the run, and in each stretch of it.
    squares = np.array([(each**2).sum(axis=-1) for each in errors])
    parts = np.array_split(np.arange(len(begin)), count)
    means = np.array([squares[:, part].mean(axis=1) for part in parts])
    total = squares.mean(axis=1)
    if total[2] * _COPIES**2 <= min(total[0], total[1]):
        return None
    marked = _marked(means, total)
    if not marked.any():
        return None
    inside = np.concatenate([parts[k] for k in np.flatnonzero(marked)])
    to_a, to_b, between = squares[:, inside].mean(axis=1).tolist()
    return Shared(
        a.name,
        b.name,
        int(a.stamps[begin[inside[0]]]),
        int(a.stamps[end[inside[-1]]]),
        bool(marked.all()),
        step,
        float(min(to_a, to_b) ** 0.5),
        float(between**0.5),
        float(max(0.5 * (to_a + to_b - between), 0.0) ** 0.5),
    )


def _marked(means: Array, total: Array) -> npt.NDArray[np.bool_]:
    """The stretches in which the two agree, and not with the ground truth.

    A part of the run stands out against the rest; a whole run has nothing to stand out against.

    Args:
        means: (K, 3) mean squares of a's and b's differences from the ground truth, and of the
            two, in each stretch.
        total: (3,) over the run.
    """
    nearer = means[:, :2].min(axis=1)
    agree = nearer > _AGREE**2 * means[:, 2]
    # The lower quartile, so that a wrong half of the run does not hide itself.
    usual = np.quantile(nearer, 0.25)
    marked = agree & (nearer > _RISE**2 * usual)
    if marked.any():
        return np.asarray(marked)
    whole = bool(total[:2].min() > _AGREE**2 * total[2]) and bool(agree.mean() > 0.5)
    return np.full(len(means), whole)


def _differences(evaluated: Evaluated, begin: Indices, end: Indices) -> Array:
    """How far each displacement is from the ground truth's, (K, 3), m, in the body's axes."""
    moved, truth = (
        se3.compose(se3.inverse(poses[begin]), poses[end])[:, :3, 3]
        for poses in (evaluated.estimate, evaluated.ground_truth)
    )
    difference: Array = moved - truth
    return difference
