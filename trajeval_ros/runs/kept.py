# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every evaluated pose of a run, for the figures that need them all at once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros.comparison.common import Evaluated
from trajeval_ros.online.results import NO_EVALUATIONS, Evaluations, Results
from trajeval_ros.online.whole_run import Poses

_COLUMNS = tuple(field.name for field in fields(Evaluations))
# What no figure of a whole run is made of.
_ERRORS = ("relative_error", "absolute_error")
_LIKELIHOODS = ("chi2", "log_det", "log_likelihood", "relative_log_likelihood")
_OF_POSES_ALONE = frozenset((*_ERRORS, *_LIKELIHOODS))


class WholeRun:
    """Some 600 bytes a pose, or 730 with all; what is asked for are views of them, not copies."""

    def __init__(self, most: int, *, with_all: bool = False) -> None:
        """Room for so many poses, which is taken as they come.

        Without ``with_all`` errors and likelihoods of single poses are NaN: they are told by then.
        """
        self._columns: dict[str, npt.NDArray[Any]] = {}
        for name in _COLUMNS:
            none = getattr(NO_EVALUATIONS, name)
            shape = (most, *none.shape[1:])
            if with_all or name not in _OF_POSES_ALONE:
                self._columns[name] = np.empty(shape, dtype=none.dtype)
            else:
                self._columns[name] = np.broadcast_to(np.nan, shape)
        self._cross: list[npt.NDArray[np.float64]] = []
        self._ends = [0]

    def add(self, results: Results) -> None:
        """Keep the poses."""
        begin, end = self._ends[-1], self._ends[-1] + len(results.evaluations)
        for name, column in self._columns.items():
            if column.flags.writeable:
                column[begin:end] = getattr(results.evaluations, name)
        self._ends.append(end)
        self._cross.extend(results.cross)

    @property
    def evaluations(self) -> Evaluations:
        """All of them."""
        return Evaluations(**{name: self._column(name) for name in _COLUMNS})

    @property
    def parts(self) -> Iterator[Evaluations]:
        """The same as they came."""
        columns = self.evaluations
        for begin, end in pairwise(self._ends):
            yield Evaluations(*(getattr(columns, name)[begin:end] for name in _COLUMNS))

    @property
    def stamps(self) -> npt.NDArray[np.int64]:
        """Of the poses, (N,) ns, the estimate's own."""
        return self._column("stamps")

    @property
    def poses(self) -> Poses:
        """What the figures of the whole run are of."""
        names = ("stamps", "ground_truth", "covariance", "estimate", "sampled")
        return Poses(**{name: self._column(name) for name in names}, cross=tuple(self._cross))

    def known(self, name: str, offset: int) -> Evaluated:
        """Return the poses outside the ground truth's gaps: within, the errors would be its own.

        Their stamps on the ground truth's clock are ``offset`` (ns) later.
        """
        poses = self.poses
        known = slice(None) if poses.sampled.all() else poses.sampled
        return Evaluated(
            name, poses.stamps[known] + offset, poses.ground_truth[known], poses.estimate[known]
        )

    def _column(self, name: str) -> npt.NDArray[Any]:
        return self._columns[name][: self._ends[-1]]
