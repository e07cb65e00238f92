# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a page shows: an estimate by its name, with what is drawn of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePath

from trajeval_ros.report.run import Run
from trajeval_ros.report.series import Series, make_series


@dataclass(frozen=True)
class Shown:
    """An estimate of the page. ``series`` is None where no pose of it was evaluated."""

    name: str
    run: Run
    series: Series | None


def shown(runs: Mapping[str, Run]) -> tuple[Shown, ...]:
    """Each run with its series. A name that is empty is taken from where the estimate is from."""
    return tuple(
        Shown(name or source_name(run), run, make_series(run) if len(run.poses) else None)
        for name, run in runs.items()
    )


def source_name(run: Run) -> str:
    """The topic of the estimate, or its file without the folder."""
    path, _, topic = run.sources.get("estimate", "").partition(", topic ")
    return topic or PurePath(path).name or path or "estimate"
