# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Who is wrong: two estimates, or the ground truth.

The three-cornered hat of clock comparison (J. Gray and D. Allan, "A method for estimating the
frequency stability of an individual oscillator", 1974): of three that err independently, each one's
variance follows from those of the three differences,

    var(ground truth) = (var(a - g) + var(b - g) - var(a - b)) / 2.

As there, the differences are of steps, which need no common world and do not gather drift: each
one's displacement over a few seconds, in its own body's axes. What calibration explains of them is
taken out first (`calibrated`), since two estimates of one sensor share it. Where they then agree
with each other far better than either does with the ground truth, the ground truth has the larger
part, or the two share an error: sensor, map. Which of these it is, no variance can tell.

Of two real estimators of one run each is 1 to 2.6 times as far from the ground truth as from the
other, and in single stretches of a run up to 5.6 times.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.comparison.calibrated import Displacements, calibrated
from trajeval_ros.comparison.common import Evaluated, pair_nearest
from trajeval_ros.comparison.errors import steps

Array = npt.NDArray[np.float64]
Marks = npt.NDArray[np.bool_]

_STRETCHES = 20
_FEWEST_STRETCHES = 6
_FEWEST = 10  # steps in a stretch
_SHORTEST, _LONGEST = 1.0, 5.0
"""Of a step, s: a stretch of the run, within these."""
_AGREE = 8.0
"""So many times nearer to each other than to the ground truth: above what is usual."""
_AGREE_BESIDE = 0.5 * _AGREE
"""The same for a stretch beside one that is so: what is wrong does not show alike everywhere."""
_RISE = 3.0
"""So many times farther from the ground truth than in the rest of the run, for a part of it."""
_COPIES = 100.0
"""Beyond this two are one output, and say nothing of the ground truth."""
_CANCELS = 1.0 / 3.0
"""Two leaps whose sum is less than this share of the smaller one are there and back: of two random
directions that are equally long one pair in forty is."""


_CONSTANT, _TURNS = 1e-6, 0.2
"""rad, by which orientations that never change differ at most, and those of a robot that turns."""


@dataclasses.dataclass(frozen=True)
class Shared:
    """Two estimates that agree with each other and not with the ground truth.

    Attributes:
        a: name.
        b: name.
        stretches: stamps of the first and the last pose of each, ns, on the ground truth's clock,
            in the order of time; one, from the first pose to the last, for the whole run.
        whole: whether that is the whole run.
        step: what the displacements are over, s.
        from_truth: RMS difference of a displacement from the ground truth's, m; of the nearer one.
        from_each_other: RMS difference of the two, m.
        truth_std: the ground truth's part of it by the three-cornered hat, m.
    """

    a: str
    b: str
    stretches: tuple[tuple[int, int], ...]
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
    if count < _FEWEST_STRETCHES or _never_turns(a):
        return None
    parts = np.array_split(np.arange(len(begin)), count)
    moved_a, moved_b = (calibrated(each, begin, end, parts) for each in (a, b))
    errors = (moved_a.errors, moved_b.errors, moved_a.errors - moved_b.errors)
    # Mean squares, m^2, of each difference over the run, and in each stretch of it.
    squares = np.array([(each**2).sum(axis=-1) for each in errors])
    means = np.array([squares[:, part].mean(axis=1) for part in parts])
    total = squares.mean(axis=1)
    if total[2] * _COPIES**2 <= min(total[0], total[1]):
        return None
    marked = _marked(means, total)
    if not marked.any():
        return None
    inside = np.concatenate([parts[k] for k in np.flatnonzero(marked)])
    to_a, to_b, between = squares[:, inside].mean(axis=1).tolist()
    rows = [(begin[parts[i][0]], end[parts[j - 1][-1]]) for i, j in _runs(marked)]
    return Shared(
        a.name,
        b.name,
        tuple((int(a.stamps[i]), int(a.stamps[j])) for i, j in _joined(moved_a, rows)),
        bool(marked.all()),
        step,
        float(min(to_a, to_b) ** 0.5),
        float(between**0.5),
        float(max(0.5 * (to_a + to_b - between), 0.0) ** 0.5),
    )


def _never_turns(evaluated: Evaluated) -> bool:
    """Whether the ground truth has no orientation, or one that is written for lack of it."""
    turned = [
        float(np.linalg.norm(se3.log_so3(poses[0, :3, :3].T @ poses[:, :3, :3]), axis=-1).max())
        for poses in (evaluated.ground_truth, evaluated.estimate)
    ]
    return turned[0] <= _CONSTANT and turned[1] >= _TURNS


def _marked(means: Array, total: Array) -> Marks:
    """The stretches in which the two agree, and not with the ground truth.

    A part of the run stands out against the rest; a whole run has nothing to stand out against.

    Args:
        means: (K, 3) mean squares of a's and b's differences from the ground truth, and of the
            two, in each stretch.
        total: (3,) over the run.
    """
    nearer = means[:, :2].min(axis=1)
    # The lower quartile, so that a wrong half of the run does not hide itself.
    far = nearer > _RISE**2 * np.quantile(nearer, 0.25)
    agree, nearly = (nearer > least**2 * means[:, 2] for least in (_AGREE, _AGREE_BESIDE))
    marked = np.zeros(len(means), dtype=bool)
    for first, last in _runs(far & nearly):
        marked[first:last] = agree[first:last].any()
    if marked.any():
        return marked
    whole = bool(total[:2].min() > _AGREE**2 * total[2]) and bool(agree.mean() > 0.5)
    return np.full(len(means), whole)


def _runs(marked: Marks) -> list[tuple[int, int]]:
    """First and one past the last of each row of marked stretches."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], marked, [False])).astype(int)))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]


def _joined(moved: Displacements, groups: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Rows of poses, joined where the ground truth leaps at the first and back at the next.

    Displacements between do not show that it is off, but it is.

    Args:
        moved: of one of the two estimates.
        groups: the first and the last pose of each, in the order of time.
    """
    joined: list[tuple[int, int]] = []
    leap: Array | None = None
    for first, last in groups:
        next_leap = moved.leap(first, last)
        if leap is not None:
            left = float(np.linalg.norm(leap + next_leap))
            if left < _CANCELS * min(float(np.linalg.norm(each)) for each in (leap, next_leap)):
                joined[-1] = joined[-1][0], last
                leap = None
                continue
        joined.append((first, last))
        leap = next_leap
    return joined
