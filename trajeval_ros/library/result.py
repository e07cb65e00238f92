# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What an evaluation has found, to be read, plotted or shown in a notebook."""

from __future__ import annotations

import dataclasses
import html
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.comparison.compare import Comparison
from trajeval_ros.comparison.words import sentences
from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.online.ate import ate_errors
from trajeval_ros.online.results import Evaluations, Notice
from trajeval_ros.report import Report, answers, render_several

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

# What of a pose the engine hands out; its errors follow from the alignment of the whole run.
_HANDED_OUT = (
    "stamps",
    "ground_truth",
    "covariance",
    "estimate",
    "relative_error",
    "chi2",
    "log_likelihood",
    "sampled",
)
_AXES = ("x", "y", "z", "qx", "qy", "qz", "qw")


@dataclasses.dataclass(frozen=True, eq=False)
class Poses:
    """Every evaluated pose of a run, in the order of time.

    Attributes:
        stamps: (M,) int64 ns, the estimate's own.
        ground_truth: (M, 4, 4) T_world_body at these stamps.
        covariance: (M, 6, 6) of its right perturbation: body frame, translation first, m and rad.
        estimate: (M, 4, 4), in its own world, of the ground truth's body.
        relative_error: (M, 6) of the step that ends at each pose, m and rad, body frame; NaN for
            the first.
        chi2: (M,) of that step, given the past.
        log_likelihood: (M,) of that step, given the past, nats; they sum to `relative`'s.
        sampled: (M,) where the ground truth was sampled as usual, not in a gap: what conventional
            figures and comparisons are of.
        ate_translation, ate_rotation: (M,) absolute errors under `conventional.alignment`, m and
            rad, whose root mean squares are the ATE; NaN in gaps, and where there is none.

    >>> import numpy as np
    >>> import trajeval_ros as te
    >>> time = np.arange(0.0, 20.0, 0.1)
    >>> poses = np.tile(np.eye(4), (len(time), 1, 1))
    >>> poses[:, :3, 3] = np.stack([np.cos(time), np.sin(2 * time), np.sin(time)], axis=1)
    >>> truth = te.Trajectory(time, poses)
    >>> found = te.evaluate(truth, truth).poses
    >>> len(found), found.ground_truth.shape, found.covariance.shape
    (200, (200, 4, 4), (200, 6, 6))
    >>> bool(np.nanmax(found.ate_translation) < 0.002)
    True
    """

    stamps: Stamps
    ground_truth: Array
    covariance: Array
    estimate: Array
    relative_error: Array
    chi2: Array
    log_likelihood: Array
    sampled: npt.NDArray[np.bool_]
    ate_translation: Array
    ate_rotation: Array

    @classmethod
    def of(cls, evaluations: Evaluations, conventional: Mapping[str, Any]) -> Poses:
        """Take what the engine handed out; ``conventional``: that part of the summary."""
        joined = {name: getattr(evaluations, name) for name in _HANDED_OUT}
        errors = ate_errors(conventional, joined["ground_truth"], joined["estimate"])
        translation, rotation = (np.where(joined["sampled"], part, np.nan) for part in errors)
        return cls(**joined, ate_translation=translation, ate_rotation=rotation)

    def __len__(self) -> int:
        return len(self.stamps)

    def to_pandas(self) -> Any:
        """Return a ``pandas.DataFrame``, a row a pose; the index is the stamp, ns.

        Columns as in ``poses.csv``, without the covariance but for its diagonal's square roots,
        ``std_0`` to ``std_5``. Raises :class:`ImportError` where pandas is not installed.
        """
        import pandas as pd

        columns: dict[str, npt.NDArray[Any]] = {}
        for prefix, poses in (("gt", self.ground_truth), ("est", self.estimate)):
            values = np.concatenate(se3.to_position_quaternion(poses), axis=1)
            names = (f"t{axis}" if len(axis) == 1 else axis for axis in _AXES)
            columns |= {f"{prefix}_{name}": values[:, i] for i, name in enumerate(names)}
        std = np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
        columns |= {f"std_{i}": std[:, i] for i in range(6)}
        columns |= {f"e_{i}": self.relative_error[:, i] for i in range(6)}
        columns |= {"chi2": self.chi2, "log_likelihood": self.log_likelihood}
        columns |= {"sampled": self.sampled}
        columns |= {"ate_translation": self.ate_translation, "ate_rotation": self.ate_rotation}
        return pd.DataFrame(columns, index=pd.Index(self.stamps, name="stamp_ns"))


class Result:
    """One estimate's evaluation; made by :func:`~trajeval_ros.evaluate`.

    ``name``; ``summary``: the figures of ``summary.json``; ``poses``: :class:`Poses`; ``causes``:
    what is likely wrong with the data, with evidence and advice; ``notices``: what else is to be
    known. Printed it is the first screen of ``evaluate``; in a notebook it shows its report.

    >>> import numpy as np
    >>> import trajeval_ros as te
    >>> time = np.arange(0.0, 20.0, 0.1)
    >>> poses = np.tile(np.eye(4), (len(time), 1, 1))
    >>> poses[:, :3, 3] = np.stack([np.cos(time), np.sin(2 * time), np.sin(time)], axis=1)
    >>> truth = te.Trajectory(time, poses)
    >>> result = te.evaluate(truth, truth)
    >>> result.name, result.summary["estimate"]["received"], result.causes
    ('estimate', 200, ())
    >>> [notice.code for notice in result.notices if notice.level == "warning"]
    []
    """

    def __init__(
        self,
        name: str,
        summary: Mapping[str, Any],
        poses: Poses,
        causes: tuple[Cause, ...],
        record: Report,
    ) -> None:
        self.name = name
        self.summary = summary
        self.poses = poses
        self.causes = causes
        self._record = record

    @property
    def notices(self) -> tuple[Notice, ...]:
        """What the engine has to say of the run."""
        return self._record.notices

    @property
    def error_model(self) -> Mapping[str, Any] | None:
        """The estimator's own error (``docs/error_model.md``); None where none could be fitted."""
        return self.summary.get("error_model")

    def report(self, path: str | os.PathLike[str]) -> Path:
        """Write ``report.html``, one self-contained page, to ``path``; return it.

        Raises :class:`OSError` where it cannot be written.
        """
        written = Path(path)
        written.write_text(self._record.render(self.summary), encoding="utf-8")
        return written

    def _repr_html_(self) -> str:
        return _framed(self._record.render(self.summary), self.name)

    def __str__(self) -> str:
        """What a terminal shows first: how good, what kind of error, whose fault, where."""
        lines = answers.first_lines(self.summary, self._record.parameters)
        return "\n".join(line.rstrip() for line in lines) or repr(self)

    def __repr__(self) -> str:
        figures = self.summary["conventional"]
        said = []
        for key, factor, unit in (
            ("ate_translation_rmse", 1.0, "m"),
            ("ate_rotation_rmse", 180.0 / np.pi, "deg"),
        ):
            if figures.get(key) is not None:
                said.append(f"{factor * figures[key]:.4g} {unit}")
        ate = f", ATE {', '.join(said)}" if said else ""
        return f"Result({self.name!r}, {len(self.poses):,} poses{ate})"


class Results(dict[str, Result]):
    """Results by name, and what there is to say of all of them.

    ``comparison``: one :class:`Comparison` for each pair; ``causes``: what is likely wrong by what
    they have in common, with evidence and advice; ``defects``: a line for each of these two that
    failed, while the results hold.

    >>> import numpy as np
    >>> import trajeval_ros as te
    >>> time = np.arange(0.0, 20.0, 0.1)
    >>> poses = np.tile(np.eye(4), (len(time), 1, 1))
    >>> poses[:, :3, 3] = np.stack([np.cos(time), np.sin(2 * time), np.sin(time)], axis=1)
    >>> truth = te.Trajectory(time, poses)
    >>> noise = np.random.default_rng(1).normal(size=(2, len(time), 3))
    >>> estimates = {}
    >>> for name, std, each in zip(["fine", "rough"], [0.01, 0.05], noise):
    ...     noisy = poses.copy()
    ...     noisy[:, :3, 3] += std * each
    ...     estimates[name] = te.Trajectory(time, noisy)
    >>> results = te.evaluate(truth, estimates)
    >>> list(results), results.causes, results.defects
    (['fine', 'rough'], (), ())
    >>> results.sentences
    ("fine's translation drifts ... both cover 20 s.",)
    """

    comparison: tuple[Comparison, ...]
    causes: tuple[Cause, ...]
    defects: tuple[str, ...]

    def __init__(
        self,
        results: Mapping[str, Result],
        comparison: Sequence[Comparison],
        causes: Sequence[Cause] = (),
        defects: Sequence[str] = (),
    ) -> None:
        super().__init__(results)
        self.comparison = tuple(comparison)
        self.causes = tuple(causes)
        self.defects = tuple(defects)

    @property
    def sentences(self) -> tuple[str, ...]:
        """Each comparison as a sentence that a person can repeat."""
        return tuple(f"{text}." for text in sentences(self.comparison))

    def report(self, path: str | os.PathLike[str]) -> Path:
        """Write one self-contained page of all, overlaid and compared, to ``path``; return it.

        Raises :class:`OSError` where it cannot be written.
        """
        written = Path(path)
        written.write_text(self._page(), encoding="utf-8")
        return written

    def _page(self) -> str:
        said = (*self.sentences, *(cause.sentence for cause in self.causes), *self.defects)
        records = {name: result._record for name, result in self.items()}
        return render_several(records, {name: one.summary for name, one in self.items()}, said)

    def _repr_html_(self) -> str:
        return _framed(self._page(), ", ".join(self))


def _framed(page: str, title: str) -> str:
    """A page within a notebook's."""
    return (
        f'<iframe srcdoc="{html.escape(page, quote=True)}" sandbox="allow-scripts"'
        f' title="{html.escape(title)}" style="width:100%;height:900px;border:0"></iframe>'
    )
