# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``~/comparison``: several estimates, each pair of them, while they arrive."""

from __future__ import annotations

import time
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node

from trajeval_ros.comparison.compare import Comparison
from trajeval_ros.comparison.words import sentence
from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.node.estimate import SHARE, Estimate
from trajeval_ros.node.outputs import Row, Table
from trajeval_ros.runs.beside import Work
from trajeval_ros.runs.session import Session
from trajeval_ros.runs.statuses import flatten_comparison
from trajeval_ros.wall import shield

_LONGEST_PERIOD = 60.0


class Compared:
    """The publisher of ``~/comparison``: a status a pair, ``<a> vs <b>``.

    And ``ground truth``, where what the estimates have in common speaks against it.

    Intervals are those of blocks and Student's t, as the bootstrap's library is not in apt, and the
    bootstrap takes a hundred times as long.
    """

    def __init__(self, node: Node, session: Session, estimates: Sequence[Estimate]) -> None:
        """Advertise the topic."""
        self.table = Table(node, "~/comparison")
        self._node = node
        self._said: set[str] = set()
        self._session = session
        self._estimates = estimates
        self._next = 0.0
        self._run = 0
        self._published: int | None = None

    def publish(self, *, last: bool = False) -> None:
        """Publish at once what is `due`."""
        work = self.due(last=last)
        if work is not None:
            work.at_once()

    def due(self, *, last: bool = False) -> Work | None:
        """What is to be published if there is anything new, and it is time to or ``last``."""
        stamps = [one.latest for one in self._estimates if one.latest is not None]
        if not stamps or max(stamps) == self._published:
            return None
        if time.monotonic() < self._next and not last:
            return None
        stamp = self._published = max(stamps)
        run = self._run

        def take(compared: tuple[Comparison, ...], causes: tuple[Cause, ...]) -> None:
            # Of a run that has ended, nothing.
            if run == self._run:
                shield(
                    "the publication of the comparison",
                    lambda: self._publish(stamp, compared, causes),
                    None,
                    self._session.say,
                )

        return self._session.comparison("block_t", take, pairs=self.table.wanted)

    def took(self, seconds: float) -> None:
        """What took long makes the next time wait."""
        self._next = time.monotonic() + min(seconds / SHARE, _LONGEST_PERIOD)

    def _publish(
        self, stamp: int, compared: tuple[Comparison, ...], causes: tuple[Cause, ...]
    ) -> None:
        for cause in causes:
            if cause.code not in self._said:
                self._said.add(cause.code)
                self._node.get_logger().warning(cause.sentence)
        if compared:
            rows = {
                f"{found.a} vs {found.b}": Row(flatten_comparison(found), sentence(found))
                for found in compared
            }
            for cause in causes:
                rows["ground truth"] = Row({}, cause.sentence, DiagnosticStatus.WARN)
            self.table.publish(stamp, rows)

    def reset(self) -> None:
        """A new run has begun."""
        self._published = None
        self._run += 1
        self._said.clear()
