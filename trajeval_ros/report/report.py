# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a report gathers while a run goes on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros.online.results import Notice, Results
from trajeval_ros.report.causes import Cause, likely_causes
from trajeval_ros.report.coverage import Coverage
from trajeval_ros.report.run import Run
from trajeval_ros.report.track import Track

_NO_EXTRINSIC = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


class Report:
    """A run as the report will show it, in bounded memory.

    ``parameters`` are the engine's, ``sources`` say where each trajectory comes from, e.g.
    ``{"ground truth": "/ground_truth", "estimate": "/odom"}``. ``notices``, to be set, are the
    engine's at the time of the report.
    """

    def __init__(self, parameters: Mapping[str, Any], sources: Mapping[str, str]) -> None:
        self.parameters = dict(parameters)
        self.sources = dict(sources)
        self.clear()

    def clear(self) -> None:
        """Start over."""
        self.track = Track()
        self.ground_truth = Coverage()
        self.estimate = Coverage()
        self.notices: tuple[Notice, ...] = ()

    def add(self, results: Results) -> None:
        """Take in what a call of the engine brought about."""
        self.track.add(results)

    def add_received(
        self,
        ground_truth: npt.NDArray[np.int64] | None = None,
        estimate: npt.NDArray[np.int64] | None = None,
    ) -> None:
        """Take in the stamps of what arrived, in nanoseconds, in any order."""
        if ground_truth is not None:
            self.ground_truth.add(ground_truth)
        if estimate is not None:
            self.estimate.add(estimate)

    def causes(self) -> tuple[Cause, ...]:
        """Return what is likely wrong with the data, if anything is."""
        buckets = self.track.buckets()
        if tuple(self.parameters["extrinsic"]) != _NO_EXTRINSIC:
            # The poses are no longer as they were read; who sets this knows their frames.
            return ()
        known = np.trace(buckets["covariance"], axis1=1, axis2=2)
        good = known < 10.0 * np.median(known) if len(known) else np.empty(0, bool)
        chosen = buckets[good]
        return likely_causes(
            chosen["stamp"], chosen["ground_truth"], chosen["estimate"], self.parameters["gauge"]
        )

    def run(self, summary: Mapping[str, Any]) -> Run:
        """Return the run as it stands."""
        return Run(
            summary=summary,
            parameters=self.parameters,
            sources=self.sources,
            notices=self.notices,
            causes=self.causes(),
            buckets=self.track.buckets(),
            ground_truth=self.ground_truth,
            estimate=self.estimate,
        )

    def render(self, summary: Mapping[str, Any]) -> str:
        """Return the page. Without matplotlib it has the tables, and says how to get the rest."""
        # Only now, as most of what the page needs is needed for nothing else.
        from trajeval_ros.report.page import page

        return page(self.run(summary))
