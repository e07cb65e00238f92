# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One estimate's side of the node: its input, its topics, and what has been said of it."""

from __future__ import annotations

import time

from rclpy.node import Node

from trajeval_ros.node.inputs import Input
from trajeval_ros.node.outputs import Outputs, Row, Table
from trajeval_ros.node.told import Told
from trajeval_ros.online.results import Results
from trajeval_ros.runs.session import Session
from trajeval_ros.runs.statuses import STATUSES, error_model_entries, flatten, latest_path_entries

# The part of the time that the figures of a window, or a comparison, may take before they become
# rarer.
SHARE = 0.1
_LONGEST_WINDOW_PERIOD = 2.0
_QUIET = 0.5


class Estimate:
    """An estimate as the node hears it and speaks of it.

    ``title`` goes before what is said of it: empty where it is the only one.
    """

    def __init__(self, node: Node, session: Session, source: Input, name: str, table: Table):
        """Advertise its topics, below its name where there are several; ``table``: of figures."""
        several = session.is_several
        self.name = name
        self.input = source
        self.title = f"{name}: " if several else ""
        self.outputs = Outputs(node, f"{name}/" if several else "")
        self.latest: int | None = None  # stamp of the newest evaluated pose, ns
        self.causes_told = Told()
        self._session = session
        self._table = table
        self.is_due = False  # whether there are new figures
        self._window: tuple[int, dict[str, str]] | None = None
        self._next_window = 0.0

    def publish(self, results: Results, truth: Input) -> None:
        """Publish what a batch brought."""
        body = truth.child_frame or self.input.child_frame
        self.outputs.publish(results, truth.frame, body)
        self.latest = int(results.evaluations.stamps[-1])
        self.is_due = True

    def publish_due(self, now: float) -> None:
        """Publish the figures if there are new ones; the window's are caught up with in quiet."""
        stale = self._window is None or self._window[0] != self.latest
        if self.is_due or (stale and now >= self._next_window + _QUIET):
            self.publish_metrics(refresh=now >= self._next_window)

    def publish_metrics(self, *, refresh: bool) -> None:
        """Publish the running figures, and those of the window, computed anew if ``refresh``."""
        self.is_due = False
        stamp = self.latest
        if stamp is None or not (self._table.wanted or self.outputs.numbers_wanted):
            return
        begin = time.monotonic()
        if refresh or self._window is None:
            statuses = flatten(self._session.summary(self.name))
            self._window = (stamp, statuses["window"])
            cost = time.monotonic() - begin
            self._next_window = begin + min(
                cost * len(self._session.names) / SHARE, _LONGEST_WINDOW_PERIOD
            )
        else:
            statuses = flatten(self._session.figures(self.name))
        computed, window = self._window
        statuses["window"] = {**window, "age": repr((stamp - computed) / 1e9)}
        self.outputs.publish_numbers(statuses)
        shown = {status: statuses[status] for status in STATUSES}
        models = self._session.error_models_of(self.name)
        if models:
            shown["error_model"] = error_model_entries(models)
        latest_path = self._session.latest_path_of(self.name)
        if latest_path is not None:
            shown["latest_path"] = latest_path_entries(latest_path)
        rows = {f"{self.title}{status}": Row(values) for status, values in shown.items()}
        self._table.publish(stamp, rows)

    def reset(self) -> None:
        """A new run has begun."""
        self.latest = self._window = None
        self.causes_told.clear()
        self.is_due = False
        self.input.reset()
