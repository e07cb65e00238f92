# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is known of a node that is watched, in bounded memory; no ROS, no clock."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros.commands.live import LEVELS, Health, State
from trajeval_ros.commands.sent import without_departure
from trajeval_ros.commands.watching.history import Curves, latest, worst
from trajeval_ros.report.covered import percent
from trajeval_ros.report.series import upwards, vertical_axis
from trajeval_ros.report.words import angle, length

_SECOND = 1_000_000_000

ERRORS = ("translation_error", "rotation_error", "translation_band", "rotation_band")
"""Curves of a pose: its absolute error (m, rad), and two standard deviations of the ground truth
along its least certain axis."""

FIGURES: Mapping[str, tuple[str, str]] = {
    "ate_translation": ("conventional", "ate_translation_rmse"),
    "ate_rotation": ("conventional", "ate_rotation_rmse"),
    "re_translation": ("conventional", "re_translation_rmse"),
    "re_rotation": ("conventional", "re_rotation_rmse"),
    "accuracy_translation": ("window", "absolute_noise_equivalent_translation_std"),
    "accuracy_rotation": ("window", "absolute_noise_equivalent_rotation_std"),
    "relative_nats_per_pose": ("window", "relative_nats_per_pose"),
    "absolute_nats_per_pose": ("window", "absolute_nats_per_pose"),
    "relative_chi2_per_dof": ("window", "relative_chi2_per_dof"),
    "absolute_chi2_per_dof": ("window", "absolute_chi2_per_dof"),
    "clock_offset": ("error_model", "window_clock_offset_value"),
    "clock_offset_std": ("error_model", "window_clock_offset_std"),
    "coverage": ("coverage", "time"),
}
"""Curves of ``~/metrics``: status and key."""

GROUND_TRUTH = "ground_truth"
ALONE = "estimate"
"""What an estimate is called that is the only one."""

_DASH = "–"

Json = Any


class _Estimate:
    """One estimate's curves, and its path in the ground truth's frame."""

    def __init__(self) -> None:
        self.errors = Curves(ERRORS, worst)
        self.figures = Curves(tuple(FIGURES), latest)
        self.latest: int | None = None  # stamp of the newest figures, ns


class Watched:
    """A node and the run it evaluates.

    Seconds count from the run's first stamp. What a browser is to know is in `sections`, each with
    a version that grows when it changes, and in `curves`.
    """

    def __init__(self, node: str) -> None:
        """Start with a node of this name, of which nothing is known yet."""
        self._node = node
        self._run = 0
        self._connection: Mapping[str, str] = {}
        self._versions: Counter[str] = Counter()
        self.connect("waiting", f"waiting for {node}")
        self._several = False
        self._clear(())

    def _clear(self, names: Sequence[str]) -> None:
        self._start: int | None = None
        self._state = State(0.0, 0.0)
        self._estimates = {name: _Estimate() for name in names}
        self._paths: dict[str, npt.NDArray[np.float64]] = {}
        self._sent: Counter[str] = Counter()

    # ------------------------------------------------------------------------------ what comes in

    def connect(self, state: str, text: str) -> None:
        """Say how it stands: ``waiting``, ``live``, ``silent``, ``ended``, ``gone``; and why."""
        found = {"state": state, "text": text}
        if found != self._connection:
            self._connection = found
            self._versions["connection"] += 1

    def start_over(self) -> None:
        """A new run has begun; nothing is kept of the one before."""
        if self._start is None and not self._state.health:
            return
        self._run += 1
        for name in self.sections():
            self._versions[name] += 1
        self._clear(tuple(self._estimates))

    def begin(self, stamp: int) -> None:
        """The run has begun at this stamp (ns), or before."""
        if self._start is not None and stamp >= self._start:
            return
        later = 0.0 if self._start is None else (self._start - stamp) / _SECOND
        self._start = stamp
        for name in self.sections():
            self._versions[name] += 1
        for curves in self.curves().values():
            curves.move(later)
        for path in self._paths.values():
            path[:, 0] += later
        self._state.move(later)

    def name_estimates(self, names: Sequence[str], *, several: bool) -> None:
        """The node has these estimates; one that is not one of several is `ALONE`."""
        # The health has them in the node's own order.
        order = list(self._state.health)
        names = sorted(names, key=lambda name: order.index(name) if name in order else len(order))
        if (tuple(self._estimates), self._several) != (tuple(names), several):
            self._several = several
            self._estimates = {name: self._estimates.get(name) or _Estimate() for name in names}
            self._versions["run"] += 1

    def take_metrics(self, stamp: int, statuses: Mapping[str, Mapping[str, str]]) -> None:
        """Take in a message of ``~/metrics``, of one estimate, under a stamp in ns."""
        owner = next(iter(statuses), "").rpartition(": ")[0]
        name = owner or ALONE
        if name not in self._estimates:
            self.name_estimates([*self._estimates, name], several=bool(owner))
        estimate = self._estimates[name]
        if estimate.latest is not None and stamp < estimate.latest:
            self.start_over()
            self.take_metrics(stamp, statuses)
            return
        estimate.latest = stamp
        seconds = self._seconds(stamp)
        self._state.take_metrics(seconds, statuses)
        values = (self._state.figure(*where, of=owner) for where in FIGURES.values())
        estimate.figures.add((seconds, *values))
        self._versions[f"estimate/{name}"] += 1

    def take_errors(self, name: str, rows: Iterable[tuple[int, Sequence[float | None]]]) -> None:
        """Take in poses of an estimate: stamp (ns) and `ERRORS`."""
        for stamp, values in rows:
            if name not in self._estimates:
                self.name_estimates([*self._estimates, name], several=self._several)
            self._estimates[name].errors.add((self._seconds(stamp), *values))

    def take_path(self, name: str, path: npt.NDArray[np.float64], stamps: Sequence[int]) -> None:
        """Take in positions (n, 3) at stamps (n,), of an estimate or `GROUND_TRUTH`.

        One that is not finite is left out: it cannot be drawn, and JSON has no such number.
        """
        finite = np.isfinite(path).all(axis=1)
        if finite.any():
            seconds = [self._seconds(stamps[k]) for k in np.flatnonzero(finite).tolist()]
            self._paths[name] = np.column_stack([seconds, path[finite]])
            self._versions[f"path/{name}"] += 1

    def take_comparison(self, sentences: Mapping[str, str]) -> None:
        """Take in what is said of each pair of estimates."""
        if sentences != self._state.sentences:
            self._state.sentences = dict(sentences)
            self._versions["comparison"] += 1

    def take_health(self, name: str, health: Health) -> None:
        """Take in an entry of ``/diagnostics``."""
        health = without_departure(health, self._sent)
        before = self._state.health.get(name)
        self._state.take_health(name, health)
        if before is None:
            self.name_estimates(list(self._estimates), several=self._several)
        if before is None or (before.level, before.message) != (health.level, health.message):
            self._versions["health"] += 1

    def take_sent(self, counts: Mapping[str, int]) -> None:
        """A publisher has sent all it had: so many messages of each topic."""
        self._sent.update(counts)

    def _seconds(self, stamp: int) -> float:
        self.begin(stamp)
        return (stamp - (self._start or 0)) / _SECOND

    # ---------------------------------------------------------------------------- what is shown

    def sections(self) -> dict[str, Callable[[], Json]]:
        """What there is to show, by its name, each a function that returns it as JSON takes it."""
        found: dict[str, Callable[[], Json]] = {
            "connection": lambda: dict(self._connection),
            "run": self._of_run,
            "health": self._of_health,
            "comparison": lambda: [
                {"pair": pair, "text": text} for pair, text in self._state.sentences.items()
            ],
        }
        for name in self._estimates:
            found[f"estimate/{name}"] = lambda name=name: self._of_estimate(name)  # type: ignore[misc]
        for name in (GROUND_TRUTH, *self._estimates):
            found[f"path/{name}"] = lambda name=name: self._of_path(name)  # type: ignore[misc]
        return found

    def version(self, section: str) -> int:
        """A number that is another one when a section has changed."""
        return self._versions[section]

    def curves(self) -> dict[str, Curves]:
        """The curves, by their name."""
        return {
            f"{what}/{name}": curves
            for name, estimate in self._estimates.items()
            for what, curves in (("errors", estimate.errors), ("figures", estimate.figures))
        }

    @property
    def has_begun(self) -> bool:
        """Whether anything of the run has been heard."""
        return self._start is not None

    @property
    def run(self) -> int:
        """The number of runs before this one."""
        return self._run

    def _of_run(self) -> Json:
        return {
            "node": self._node,
            "number": self._run,
            "start": None if self._start is None else self._start / _SECOND,
            "estimates": list(self._estimates),
        }

    def _of_health(self) -> Json:
        return {
            "now": [
                {"name": name, "level": LEVELS.get(one.level, "?"), "text": one.message}
                for name, one in self._state.health.items()
            ],
            "events": [
                {
                    "seconds": round(event.seconds, 3),
                    "level": LEVELS.get(event.level, "?"),
                    "text": event.text,
                }
                for event in self._state.events
            ],
        }

    def _of_estimate(self, name: str) -> Json:
        owner = name if self._several else ""
        prefix = f"{owner}: " if owner else ""
        statuses = {
            title.removeprefix(prefix): {key: _sent(value) for key, value in figures.items()}
            for title, figures in self._state.metrics.items()
            if title.startswith(prefix)
        }
        return {
            "answer": [
                {"title": title, "text": text} for title, text in self._state.answers.get(owner, [])
            ],
            "tiles": _tiles(self._state, owner),
            "figures": statuses,
        }

    def _of_path(self, name: str) -> Json:
        """A path, its positions flat; an estimate's beside the ground truth at its stamps."""
        path, truth = self._paths.get(name), self._paths.get(GROUND_TRUTH)
        if path is None or truth is None:
            return None
        seconds = np.round(path[:, 0], 3).tolist()
        if name == GROUND_TRUTH:
            up = vertical_axis(truth[:, 1:])
            across, along = (axis for axis in range(3) if axis != up)
            axes = {"across": across, "along": along, "up": up, "sign": upwards(up)}
            return {"seconds": seconds, "positions": _flat(truth[:, 1:]), "axes": axes}
        there = np.column_stack(
            [np.interp(path[:, 0], truth[:, 0], truth[:, axis]) for axis in (1, 2, 3)]
        )
        error = np.linalg.norm(path[:, 1:] - there, axis=1)
        return {
            "seconds": seconds,
            "aligned": _flat(path[:, 1:]),
            "truth": _flat(there),
            "error": [float(f"{value:.4g}") for value in error.tolist()],
        }


def _sent(figure: float | str) -> float | str:
    """A figure as JSON takes it, which has no numbers that are not finite."""
    return figure if isinstance(figure, str) or math.isfinite(figure) else str(figure)


def _flat(positions: npt.NDArray[np.float64]) -> list[float]:
    """To a tenth of a millimetre: to be drawn."""
    found: list[float] = np.round(positions, 4).ravel().tolist()
    return found


def _tiles(state: State, owner: str) -> list[Json]:
    """What is looked at first: a title, a figure in words, and what it is of."""

    def tile(title: str, status: str, key: str, remark: str) -> Json:
        translation, rotation = (
            state.figure(status, key.format(part), of=owner) for part in ("translation", "rotation")
        )
        return {
            "title": title,
            "value": length(translation),
            "remark": remark if rotation is None else f"{angle(rotation)}, {remark}",
        }

    conventional = state.metrics.get(f"{owner}: conventional" if owner else "conventional", {})
    delta = state.figure("conventional", "re_delta", of=owner)
    step = f"over {1.0 if delta is None else delta:g} {conventional.get('re_unit', 's')}"
    window = state.figure("window", "duration", of=owner)
    share = state.figure("coverage", "time", of=owner)
    whole = state.figure("coverage", "duration", of=owner)
    return [
        tile("ATE", "conventional", "ate_{}_rmse", "aligned, whole run"),
        tile("RE", "conventional", "re_{}_rmse", f"{step}, whole run"),
        tile(
            "Accuracy",
            "window",
            "absolute_noise_equivalent_{}_std",
            "noise-equivalent" + ("" if window is None else f", last {window:.0f} s"),
        ),
        {
            "title": "Coverage",
            "value": _DASH if share is None else percent(share),
            "remark": "" if whole is None else f"of {whole:.3g} s",
        },
    ]
