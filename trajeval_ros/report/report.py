# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a report gathers while a run goes on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.conventional.sub_trajectories import Box
from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.diagnosis.causes import likely_causes
from trajeval_ros.diagnosis.fitted import fitted_causes, together
from trajeval_ros.median import median
from trajeval_ros.online.coverage import Way
from trajeval_ros.online.results import Notice, Results
from trajeval_ros.report.coverage import Coverage
from trajeval_ros.report.run import Run
from trajeval_ros.report.track import Records, Track
from trajeval_ros.wall import shield

# A node that runs for weeks does not gather more lines than this.
_MOST_DEFECTS = 20


class Report:
    """A run as the report will show it, in bounded memory.

    ``parameters`` are the engine's, ``sources`` say where each trajectory comes from, e.g.
    ``{"ground truth": "/ground_truth", "estimate": "/odom"}``. ``notices`` and ``way``, to be set,
    are the engine's at the time of the report; ``model`` is the error model, once there is one;
    ``growth``: of a whole run, how errors grow over "time" and "distance"; ``anew``: stamps (ns) at
    which the ground truth's process changed; ``lacks_orientation``: one of the two was read
    without.

    No defect of it is raised: :attr:`defects` has a line for each kind.
    """

    def __init__(self, parameters: Mapping[str, Any], sources: Mapping[str, str]) -> None:
        self.parameters = dict(parameters)
        self.sources = dict(sources)
        self.defects: tuple[str, ...] = ()
        self.clear()

    def clear(self) -> None:
        """Start over."""
        self.track = Track()
        self.ground_truth = Coverage()
        self.estimate = Coverage()
        self.notices: tuple[Notice, ...] = ()
        self.way: Way | None = None
        self.of_rows: tuple[Cause, ...] = ()
        self.lacks_orientation = False
        self.model: Mapping[str, Any] | None = None
        self.growth: Mapping[str, tuple[Box, ...]] = {}
        self.anew: tuple[int, ...] = ()

    def say(self, line: str) -> None:
        """Remember what has failed, in one line; each line once."""
        if line not in self.defects:
            self.defects = (*self.defects, line)[:_MOST_DEFECTS]

    def add(self, results: Results) -> None:
        """Take in what a call of the engine brought about."""
        shield("the record for the report", lambda: self.track.add(results), None, self.say)

    def add_received(
        self,
        ground_truth: npt.NDArray[np.int64] | None = None,
        estimate: npt.NDArray[np.int64] | None = None,
    ) -> None:
        """Take in the stamps of what arrived, in nanoseconds, in any order."""
        for coverage, stamps in ((self.ground_truth, ground_truth), (self.estimate, estimate)):
            if stamps is not None:
                self._add_stamps(coverage, stamps)

    def _add_stamps(self, coverage: Coverage, stamps: npt.NDArray[np.int64]) -> None:
        shield("the record for the report", lambda: coverage.add(stamps), None, self.say)

    def causes(self) -> tuple[Cause, ...]:
        """Return what is likely wrong with the data, if anything is."""
        return shield("the search for likely causes", self.search(), self.of_rows, self.say)

    def search(self) -> Callable[[], tuple[Cause, ...]]:
        """What finds the causes, of what there is by now: it touches nothing of the run."""
        of_rows, lacks_orientation = self.of_rows, self.lacks_orientation
        if any(cause.code == "time_base" for cause in of_rows):
            # Of poses that do not belong together nothing else can be said.
            return lambda: of_rows
        search = partial(_causes_of, self.track.poses(), dict(self.parameters), self.model)

        def found() -> tuple[Cause, ...]:
            of_poses = search()
            if lacks_orientation:
                # Who wrote none knows that it never changes.
                of_poses = tuple(each for each in of_poses if each.code != "constant_orientation")
            return of_rows + of_poses

        return found

    def run(self, summary: Mapping[str, Any]) -> Run:
        """Return the run as it stands; its causes are looked for where the summary has none."""
        told = summary.get("likely_causes")
        causes = self.causes() if told is None else tuple(Cause(**each) for each in told)
        return Run(
            summary=summary,
            parameters=self.parameters,
            sources=self.sources,
            notices=self.notices,
            causes=causes,
            defects=self.defects,
            poses=self.track.poses(),
            ground_truth=self.ground_truth,
            estimate=self.estimate,
            way=self.way,
            growth=self.growth,
            anew=self.anew,
        )

    def render(self, summary: Mapping[str, Any]) -> str:
        """Return the page."""
        page = shield("the report", lambda: self._page(summary), None, self.say)
        return self._plain_page(summary) if page is None else page

    def _page(self, summary: Mapping[str, Any]) -> str:
        # Only now, as most of what the page needs is needed for nothing else.
        from trajeval_ros.report.page import page

        return page(self.run(summary), self.say)

    def _plain_page(self, summary: Mapping[str, Any]) -> str:
        return _plain_page(summary, self.defects)


def render_several(
    reports: Mapping[str, Report],
    summaries: Mapping[str, Mapping[str, Any]],
    sentences: Sequence[str],
) -> str:
    """Return the page of several estimates of one run, by their names.

    ``summaries``: each one's alone; ``sentences``: how they compare.
    """
    defects: list[str] = []

    def page() -> str:
        from trajeval_ros.report.page import page_of_several

        runs = {name: report.run(summaries[name]) for name, report in reports.items()}
        return page_of_several(runs, sentences, defects.append)

    nothing: str | None = None
    found = shield("the report", page, nothing, defects.append)
    return _plain_page(summaries, defects) if found is None else found


def _plain_page(summary: Mapping[str, Any], defects: Sequence[str]) -> str:
    """The figures and why there is no more, so that no page of an earlier run stays."""
    import html
    import json

    said = "".join(f"<p>{html.escape(line)}</p>" for line in defects)
    figures = html.escape(json.dumps(summary, indent=2, default=str))
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        "<title>Trajectory evaluation</title></head><body><h1>Trajectory evaluation</h1>\n"
        f"{said}\n<pre>{figures}</pre></body></html>\n"
    )


def _causes_of(
    poses: Records, parameters: Mapping[str, Any], model: Mapping[str, Any] | None
) -> tuple[Cause, ...]:
    known = np.trace(poses["covariance"], axis1=1, axis2=2)
    good = known < 10.0 * median(known) if len(known) else np.empty(0, bool)
    chosen = poses[good]
    numbers = np.array(parameters["extrinsic"])
    extrinsic = se3.from_position_quaternion(numbers[:3], numbers[3:])
    gauge, offset = parameters["gauge"], float(parameters["estimate.time_offset"])
    found = likely_causes(
        chosen["stamp"],
        chosen["ground_truth"],
        chosen["estimate"],
        gauge,
        time_offset=offset,
        extrinsic=extrinsic,
    )
    if model is None:
        return found
    return together(found, fitted_causes(model, gauge, offset, extrinsic))
