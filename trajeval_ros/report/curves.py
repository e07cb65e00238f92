# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An estimate's errors pose by pose, as figures and recordings show them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.alignment.gauge import Similarity
from trajeval_ros.comparison.compare import Evaluated
from trajeval_ros.comparison.errors import errors_of, steps
from trajeval_ros.online.ate import ate_errors
from trajeval_ros.online.settings import EvaluationSettings
from trajeval_ros.report.track import Records

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

_SECOND = 1_000_000_000


@dataclass(frozen=True)
class Curves:
    """What is drawn of an estimate; angles in degrees, times in ns on the ground truth's clock.

    ``stamps`` (M,) with ``ground_truth`` and ``estimate`` (M, 3), aligned as for ATE, whose errors
    are ``translation`` and ``rotation`` (M,); ``known_at`` (B,) with two standard deviations of the
    ground truth, ``known`` (translation, rotation); ``steps_end`` (K,) with the errors of the steps
    that end there, ``re`` (translation, rotation). NaN where there is none.
    """

    name: str
    stamps: npt.NDArray[np.int64]
    ground_truth: Array
    estimate: Array
    ate: tuple[Array, Array]
    known_at: npt.NDArray[np.int64]
    known: tuple[Array, Array]
    steps_end: npt.NDArray[np.int64]
    re: tuple[Array, Array]
    re_step: str

    @property
    def has_rotation(self) -> bool:
        """Whether the orientations mean something."""
        return bool(np.isfinite(self.ate[1]).any())


def curves(
    evaluated: Evaluated,
    summary: Mapping[str, Any],
    buckets: Records,
    settings: EvaluationSettings,
    offset: int,
) -> Curves | None:
    """Compute them from the poses of an estimate; None where it has no ATE.

    ``offset`` (ns): what is added to the stamps of ``buckets``.
    """
    conventional = summary["conventional"]
    if len(evaluated) == 0 or conventional.get("ate_translation_rmse") is None:
        return None
    translation, rotation = ate_errors(conventional, evaluated.ground_truth, evaluated.estimate)
    delta, unit = settings.relative_delta, settings.relative_unit
    begin, end = steps(evaluated, delta, unit)
    errors = errors_of(evaluated, begin, end, settings.gauge.name, delta, unit)
    nothing = np.full(len(end), np.nan)
    turned = conventional.get("re_rotation_rmse") is not None
    spread = [
        2.0 * np.sqrt(np.linalg.eigvalsh(buckets["covariance"][:, part, part])[:, -1])
        for part in (slice(3), slice(3, None))
    ]
    return Curves(
        name=evaluated.name,
        stamps=evaluated.stamps,
        ground_truth=evaluated.ground_truth[:, :3, 3],
        estimate=aligned(evaluated, summary)[:, :3, 3],
        ate=(translation, np.degrees(rotation)),
        known_at=buckets["stamp"] + offset,
        known=(spread[0], np.degrees(spread[1])),
        steps_end=evaluated.stamps[end],
        re=(
            nothing if errors.re_translation is None else errors.re_translation,
            np.degrees(errors.re_rotation) if turned else nothing,
        ),
        re_step=f"{delta:g} {unit if unit != 'f' else 'poses'}",
    )


def aligned(evaluated: Evaluated, summary: Mapping[str, Any]) -> Array:
    """The estimate's poses (M, 4, 4) in the ground truth's world, as ATE has them."""
    found = summary["conventional"]["alignment"]
    pose = np.array(found["pose"])
    alignment = Similarity(se3.from_position_quaternion(pose[:3], pose[3:]), found["scale"])
    return alignment.apply(evaluated.estimate)


def largest(stamps: Stamps, values: Array, most: int) -> tuple[Stamps, Array]:
    """The largest value of each of at most so many (``most``) stretches, and its stamp."""
    size = -(-len(values) // most)
    if size <= 1:
        return stamps, values
    padding = -len(values) % size
    rows = np.concatenate([np.nan_to_num(values, nan=-1.0), np.full(padding, -1.0)])
    chosen = np.argmax(rows.reshape(-1, size), axis=1) + size * np.arange(len(rows) // size)
    return stamps[chosen], values[chosen]


def breaks(stamps: Stamps) -> npt.NDArray[np.intp]:
    """Before which points a line is broken: there was nothing for long."""
    gaps = np.diff(stamps)
    if len(gaps) == 0:
        return np.empty(0, np.intp)
    return np.flatnonzero(gaps > max(10.0 * float(np.median(gaps)), 0.5 * _SECOND)) + 1
