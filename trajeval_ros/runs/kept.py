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


class WholeRun:
    """Some 900 bytes a pose; what is asked for are views of them, not copies."""

    def __init__(self) -> None:
        self._parts: dict[str, list[npt.NDArray[Any]]] = {
            name: [getattr(NO_EVALUATIONS, name)] for name in _COLUMNS
        }
        self._cross: list[npt.NDArray[np.float64]] = []
        self._ends = [0]

    def add(self, results: Results) -> None:
        """Keep the poses."""
        for name, parts in self._parts.items():
            parts.append(getattr(results.evaluations, name))
        self._ends.append(self._ends[-1] + len(results.evaluations))
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
        stamps, truth, estimate, sampled = (
            self._column(field) for field in ("stamps", "ground_truth", "estimate", "sampled")
        )
        return Evaluated(name, stamps[sampled] + offset, truth[sampled], estimate[sampled])

    def _column(self, name: str) -> npt.NDArray[Any]:
        """Joined when it is first asked for; the parts go."""
        parts = self._parts[name]
        if len(parts) > 1:
            parts[:] = [np.concatenate(parts)]
        return parts[0]
