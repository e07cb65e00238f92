# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two estimates of one run, compared on what both cover."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros.alignment.umeyama import Gauge
from trajeval_ros.comparison.common import Coverage, Evaluated, Extent, coverage, pair_nearest
from trajeval_ros.comparison.errors import errors_of, steps
from trajeval_ros.comparison.ratio import Method, Ratio, Unit, best_method, ratio_in, ratio_of
from trajeval_ros.conventional.step_pairs import StepUnit


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Estimate a against estimate b. Each ratio is RMSE of a over RMSE of b: below 1, a is better.

    Each is None where one of the two has no such figure, for the reasons that it would have none
    by itself. ATE: aligned over the common poses, each by itself. RE: over all steps of `delta`
    between common poses, which overlap.

    Attributes:
        a: name.
        b: name.
        coverage: what both and what one alone covers.
        ate_translation: m.
        ate_rotation: rad.
        re_translation: m.
        re_rotation: rad.
        since: stamp, ns on the ground truth's clock, before which poses of one have been forgotten
            and those of the other left out; None where none have.

    >>> import numpy as np
    >>> import trajeval_ros as te
    >>> time = np.arange(0.0, 20.0, 0.1)
    >>> poses = np.tile(np.eye(4), (len(time), 1, 1))
    >>> poses[:, :3, 3] = np.stack([np.cos(time), np.sin(2 * time), np.sin(time)], axis=1)
    >>> truth = te.Trajectory(time, poses)
    >>> rough = poses.copy()
    >>> rough[:, :3, 3] += 0.05 * np.random.default_rng(1).normal(size=(len(time), 3))
    >>> results = te.evaluate(truth, {"truth": truth, "rough": te.Trajectory(time, rough)})
    >>> (found,) = results.comparison
    >>> found.a, found.b, found.coverage.common.poses
    ('truth', 'rough', 200)
    >>> found.re_translation.unit, found.re_translation.ratio < 0.1
    ('m', True)
    """

    a: str
    b: str
    coverage: Coverage
    ate_translation: Ratio | None
    ate_rotation: Ratio | None
    re_translation: Ratio | None
    re_rotation: Ratio | None
    since: int | None = None

    def figures(self) -> dict[str, object]:
        """By name, as in ``summary.json``."""
        ratios = {
            "ate_translation": self.ate_translation,
            "ate_rotation": self.ate_rotation,
            "re_translation": self.re_translation,
            "re_rotation": self.re_rotation,
        }
        return {
            "a": self.a,
            "b": self.b,
            "common": self.coverage.common._asdict(),
            "only_a": self.coverage.only_a._asdict(),
            "only_b": self.coverage.only_b._asdict(),
            "since_ns": self.since,
            **{name: None if r is None else r.figures() for name, r in ratios.items()},
        }


_UNITS: dict[str, Unit] = {"translation": "m", "rotation": "rad"}


def read(figures: Mapping[str, Any]) -> Comparison:
    """The comparison that ``summary.json`` has the ``figures`` of.

    Raises:
        LookupError, TypeError, ValueError: figures of something else.
    """
    ratios = {}
    for name in ("ate_translation", "ate_rotation", "re_translation", "re_rotation"):
        found = figures[name]
        ratios[name] = None if found is None else ratio_in(found, _UNITS[name.partition("_")[2]])
    covered = Coverage(*(Extent(**figures[part]) for part in ("common", "only_a", "only_b")))
    return Comparison(figures["a"], figures["b"], covered, **ratios, since=figures.get("since_ns"))


def compare(
    a: Evaluated,
    b: Evaluated,
    gauge: Gauge = "se3",
    delta: float = 1.0,
    unit: StepUnit = "s",
    method: Method | None = None,
    seed: int = 0,
) -> Comparison:
    """Compare two estimates of one run.

    Args:
        a: an estimate with the ground truth at its stamps.
        b: another one.
        gauge: of each one's alignment.
        delta: RE's step, s, m or f, above zero.
        unit: `s`, `m` (along the ground truth) or `f` (common poses).
        method: where intervals come from; the stationary bootstrap where arch is installed.
        seed: of the bootstrap: the same inputs give the same figures.

    Raises:
        ValueError: an unknown gauge or unit, or a delta that is not positive and finite.
        ImportError: `stationary_bootstrap` is asked for, and arch is not installed.
    """
    index_a, index_b = pair_nearest(a.stamps, b.stamps)
    covered = coverage(a.stamps, b.stamps, len(index_a))
    common_a, common_b = a[index_a], b[index_b]
    begin, end = steps(common_a, delta, unit)
    errors_a, errors_b = (
        errors_of(common, begin, end, gauge, delta, unit) for common in (common_a, common_b)
    )
    method = method or best_method()

    def ratio(
        one: npt.NDArray[np.float64] | None, other: npt.NDArray[np.float64] | None, unit: Unit
    ) -> Ratio | None:
        if one is None or other is None or len(one) == 0:
            return None
        return ratio_of(one, other, unit, method, seed)

    return Comparison(
        a=a.name,
        b=b.name,
        coverage=covered,
        ate_translation=ratio(errors_a.ate_translation, errors_b.ate_translation, "m"),
        ate_rotation=ratio(errors_a.ate_rotation, errors_b.ate_rotation, "rad"),
        re_translation=ratio(errors_a.re_translation, errors_b.re_translation, "m"),
        re_rotation=ratio(errors_a.re_rotation, errors_b.re_rotation, "rad"),
    )


__all__ = ["Comparison", "Coverage", "Evaluated", "Extent", "Ratio", "compare"]
