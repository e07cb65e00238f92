# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run, as the page and the figures see it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from trajeval_ros.conventional.sub_trajectories import Box
from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.online.coverage import Way
from trajeval_ros.online.results import Notice
from trajeval_ros.report.coverage import Coverage
from trajeval_ros.report.track import Records


@dataclass(frozen=True)
class Run:
    """Everything the report shows.

    ``summary`` and ``parameters`` are the engine's, ``poses`` are :data:`track.FIELDS` records in
    time order, ``sources`` say where each trajectory comes from, ``defects`` what failed, ``way``
    is the ground truth's, also where there is no estimate, ``growth`` of a whole run how errors
    grow over "time" and "distance", ``anew`` stamps (ns) at which the ground truth's process
    changed.
    """

    summary: Mapping[str, Any]
    parameters: Mapping[str, Any]
    sources: Mapping[str, str]
    notices: tuple[Notice, ...]
    causes: tuple[Cause, ...]
    defects: tuple[str, ...]
    poses: Records
    ground_truth: Coverage
    estimate: Coverage
    way: Way | None = None
    growth: Mapping[str, tuple[Box, ...]] = field(default_factory=dict)
    anew: tuple[int, ...] = ()
