# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node: takes what has arrived, hands it to the engine in batches, publishes what comes out."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from rclpy.clock import ROSClock
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.service import Service
from std_srvs.srv import Trigger

from trajeval_ros import memory
from trajeval_ros.files.output import OutputError
from trajeval_ros.node import parameters
from trajeval_ros.node.any_message import AnyInput
from trajeval_ros.node.beside import Beside, loading
from trajeval_ros.node.clock import JumpDetector, LeftOver, StampClock
from trajeval_ros.node.compared import Compared
from trajeval_ros.node.diagnostics import Status, check_ending
from trajeval_ros.node.discovery import waiting
from trajeval_ros.node.estimate import SHARE, Estimate
from trajeval_ros.node.figures import summary_lines
from trajeval_ros.node.groups import Gated
from trajeval_ros.node.inputs import BATCH, KNOWN, QUEUE_DEPTH, Input
from trajeval_ros.node.monitor import Monitor
from trajeval_ros.node.outputs import Table, flush
from trajeval_ros.node.schedule import Schedule
from trajeval_ros.node.transforms import TransformInput
from trajeval_ros.node.visualization import Visualization
from trajeval_ros.online.parameters import ONE, Value, names_in, table
from trajeval_ros.online.reference import LEARNED, is_of_ground_truth
from trajeval_ros.online.results import Notice, Results
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.runs.session import Session
from trajeval_ros.wall import shield

# How long what has come may wait for its batch (s). What a batch costs grows slowly with its size:
# beyond their share of the processor they become rarer and larger, by the mean cost of the last ten
# or so. One that closes a segment costs several times as much as the others, and must not make the
# next one wait. Where nobody hears of single poses nobody waits, and of anything of the run still
# less; the queues hold a hundred times as much.
_BATCH_PERIOD = 0.02
_LONGEST_BATCH_PERIOD = 0.04
_UNHEARD_BATCH_PERIOD = 0.2
_UNWATCHED_BATCH_PERIOD = 1.0
# What the middleware holds for a second at 10 kHz makes each message dearer: after a batch that was
# not all there was they are as frequent as where somebody watches for this long (s).
_CROWDED = 10.0
_BATCH_SHARE = 0.05
_SMOOTHING = 0.1
# Of each estimate in a batch: poses that have waited for a lesson are caught up with in several.
_MOST_POSES = 500
# The clock alone can end a wait, of a second and more.
_CLOCK_PERIOD = 0.1
# What a publisher sends before it is found is lost: as long as one is missing they are counted more
# often. One may have gone and another come, so that the count is the same.
_DISCOVERY_PERIOD = 0.2
_FIRST_DISCOVERY_PERIOD = 0.02
_THOROUGH_DISCOVERY_PERIOD = 1.0
_DIAGNOSTICS_PERIOD = 1.0
_CAUSES_PERIOD = 5.0
_COMPARISON_PERIOD = 1.0
# What is missing is said at once, with what there is instead once the graph is known, and then
# every so many periods (s).
_WAITING_PERIOD = 2.0
_WAITING_REPEATED = 5
_ERROR_MODEL_PERIOD = 3.0
_LATEST_PATH_PERIOD = 1.0
_PATH_PERIOD = 1.0
_MARKER_PERIOD = 0.2
# What a subscriber may take at shutdown, s.
_PARTING = 0.5
# At shutdown the queues are emptied of what they can hold (one batch more for what a change of the
# subscription has left), and of what is on its way for this long (s): not of all that publishers
# go on to send.
_LAST_BATCHES = math.ceil(QUEUE_DEPTH / BATCH) + 1
_LAST_ARRIVALS = 0.5

# Of the ground truth and of each estimate.
_Arrived = list[PoseSamples | None]


def _input(node: Node, name: str, values: Mapping[str, Value]) -> Input:
    topic = str(values[f"{name}.topic"]) or name
    reliability = str(values[f"{name}.reliability"])
    if ":" in topic:
        return TransformInput(node, topic, reliability)
    kind = str(values[f"{name}.type"])
    if "/" in kind:
        fields = str(values[f"{name}.field"]), str(values[f"{name}.stamp_field"])
        return AnyInput(node, topic, kind, fields, reliability)
    return Input(node, topic, kind, reliability)


class Evaluator(Node):
    """Scores estimated trajectories against one ground truth while all arrive."""

    def __init__(self) -> None:
        """Declare, subscribe, advertise.

        Raises
        ------
        ParameterError
            For a parameter that is unknown, of the wrong type or out of range.
        """
        self.events = Gated()
        """Events of publishers, such as a reader that asks for more than is offered."""
        self._answered = Gated()  # never opened: services, which `groups.answer` serves
        super().__init__("evaluator", automatically_declare_parameters_from_overrides=True)
        values = parameters.declare(self)
        names = names_in(values)
        self._ground_truth, *inputs = self._inputs = [
            _input(self, name, values) for name in ("ground_truth", *names)
        ]
        topics = (source.state.topic for source in self._inputs)
        sources = dict(zip(("ground truth", *names), topics, strict=True))
        self._session = Session(values, sources, beside=True)
        self._lessons, self._fits, self._searches = Beside(), Beside(), Beside()
        self._paths, self._comparisons = Beside(), Beside()
        parameters.watch(self, table(names), self._session.change)
        self._metrics = Table(self, "~/metrics")
        self._estimates = [
            Estimate(self, self._session, source, name, self._metrics)
            for name, source in zip(names, inputs, strict=True)
        ]
        several = self._session.is_several
        self._compared = Compared(self, self._session, self._estimates) if several else None
        # Of one estimate the topics are those of `estimate`, whatever it is called.
        self._shown = dict(zip(names, names if several else ONE, strict=True))
        self._visualization = Visualization(self, tuple(self._shown.values()))
        self._monitor = Monitor(self, self._session)
        self._stamp_clock = StampClock()
        self._jumps = JumpDetector(len(names))
        self._sieve: LeftOver | None = None
        self._notices_said: set[str] = set()
        self._oriented: dict[int, bool] = {}  # by topic: whether what comes has an orientation
        self._defects_said: set[str] = set()
        self._batch_cost = self._next_fit = self._next_path = self._next_clock = 0.0
        self._next_discovery = self._next_health = self._next_window_fit = 0.0
        self._unheard = _ERROR_MODEL_PERIOD
        self._crowded_until = 0.0
        self._waited = 0
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(Trigger, "~/save", self._on_save)
        self._schedule = Schedule(
            (
                (_BATCH_PERIOD, self._on_batch),
                (_DISCOVERY_PERIOD, self._on_discovery),
                (_CAUSES_PERIOD, self._on_causes),
                (_COMPARISON_PERIOD, self._on_comparison),
                (_WAITING_PERIOD, self._on_waiting),
                (_ERROR_MODEL_PERIOD, self._on_error_model),
                (_LATEST_PATH_PERIOD, self._on_latest_paths),
                (_PATH_PERIOD, self._on_paths),
                (_MARKER_PERIOD, self._on_markers),
            )
        )
        if self._session.error is not None:
            self.get_logger().error(self._session.error)
        self._searches.start(loading)

    def create_publisher(self, *of: Any, **further: Any) -> Publisher:
        """As of any node, with its events behind the gate."""
        return super().create_publisher(*of, **{"callback_group": self.events, **further})

    def create_service(self, *of: Any, **further: Any) -> Service:
        """As of any node, but for the executor."""
        return super().create_service(*of, **{**further, "callback_group": self._answered})

    def work(self) -> float:
        """Do what is due, and return for how long there is nothing to do (s)."""
        return self._schedule.run()

    def close(self) -> bool:
        """Evaluate what is left, write the output folder; say whether that could be done.

        The figures are logged as well, in a few lines: the disk may be full.
        """
        self._take_all()
        self._publish_last()
        self._fits.take(wait=True)
        shield("the log of the figures", self._log_figures, None, self._say_defect)
        written = self._save(last=True) is not None
        publishers = [p for each in self._estimates for p in each.outputs.publishers]
        if self._compared is not None:
            publishers.insert(0, self._compared.table.publisher)
        said = [check_ending(written)]
        shield("the last health", lambda: self._on_diagnostics(said), None, self._say_defect)
        flush([self._metrics.publisher, *publishers, self._monitor.publisher], _PARTING)
        self._session.close()
        return written

    def _log_figures(self) -> None:
        for each in self._estimates:
            latest = self._session.latest_path_of(each.name)
            for line in summary_lines(self._session.figures(each.name), latest):
                self.get_logger().info(f"{each.title}{line}")

    def _publish_last(self) -> None:
        """Publish what there is at the end of a run."""
        self._lessons.take(wait=True)
        self._publish(self._session.finish_all())
        self._paths.take(wait=True)
        self._session.score_latest_paths()
        self._comparisons.take(wait=True)
        for each in self._estimates:
            each.publish_metrics(refresh=True)
        if self._compared is not None:
            self._compared.publish(last=True)

    def rescue(self) -> None:
        """Write the output folder as it is, because something has gone wrong."""
        shield("the rescue", lambda: self._save(last=True), None, self._say_defect)
        self._session.close()

    # -------------------------------------------------------------- periodic work, services

    def _on_batch(self) -> float:
        begin, processor = time.monotonic(), time.thread_time()
        self._take_up(begin)
        before = self._monitor.messages
        self._process()
        self._lessons.start(self._session.lesson_due)
        self._monitor.note_batch(time.monotonic() - begin)
        if self._monitor.messages != before:
            took = min(time.thread_time() - processor, _BATCH_PERIOD)
            self._batch_cost += _SMOOTHING * (took - self._batch_cost)
        for each in self._estimates:
            each.publish_due(begin)
        if begin >= self._next_health:
            # Right after a batch: or a second has the messages of half a second, or of two.
            after = self._next_health + _DIAGNOSTICS_PERIOD
            self._next_health = max(after, begin + 0.5 * _DIAGNOSTICS_PERIOD)
            self._on_diagnostics()
        if not self._is_behind:
            return self._batch_period
        if any(source.is_behind for source in self._inputs):
            self._crowded_until = begin + _CROWDED
        return 0.0

    @property
    def _batch_period(self) -> float:
        """How long what comes may wait (s): as long as those who listen do not notice."""
        if any(each.outputs.is_heard for each in self._estimates):
            period = max(self._batch_cost / _BATCH_SHARE, _BATCH_PERIOD)
            return min(period, _LONGEST_BATCH_PERIOD)
        is_watched = (
            self._metrics.wanted
            or self._visualization.is_wanted
            or any(each.outputs.numbers_wanted for each in self._estimates)
        )
        is_watched = is_watched or time.monotonic() < self._crowded_until
        return _UNHEARD_BATCH_PERIOD if is_watched else _UNWATCHED_BATCH_PERIOD

    def _on_discovery(self) -> float:
        now = time.monotonic()
        is_thorough = now >= self._next_discovery
        if is_thorough:
            self._next_discovery = now + _THOROUGH_DISCOVERY_PERIOD
        for each in self._inputs:
            if is_thorough or each.has_changed:
                each.discover()
        all_found = all(each.is_subscribed for each in self._inputs)
        return _DISCOVERY_PERIOD if all_found else _FIRST_DISCOVERY_PERIOD

    def _on_diagnostics(self, ending: Sequence[Status] = ()) -> None:
        states = [each.state for each in self._inputs]
        self._monitor.publish(states, self.follows_clock, self._ros_now(), ending)

    def _on_comparison(self) -> None:
        if self._compared is not None:
            self._comparisons.start(self._compared.due)

    def _take_up(self, now: float) -> None:
        """Go on with what was learned, fitted and found beside."""
        if self._lessons.take() is not None:
            self._next_clock = now
        if self._searches.take() is not None:
            self._say_causes()
        took = self._fits.take()
        if took is not None:
            self._next_fit = now + took / SHARE
            self._next_window_fit = now + self._unheard
            self._unheard *= 2.0
            for each in self._estimates:
                each.is_due = True
        took = self._paths.take()
        if took is not None:
            self._next_path = now + took / SHARE
            for each in self._estimates:
                each.is_due = True
        took = self._comparisons.take()
        if took is not None and self._compared is not None:
            self._compared.took(took)

    def _on_error_model(self) -> None:
        """Begin the fit of a block or the window; one that took long makes the next one wait."""
        now = time.monotonic()
        if now >= self._next_fit:
            # The window's is for those who listen; for causes alone it becomes ever rarer.
            wanted = self._metrics.wanted or now >= self._next_window_fit
            self._fits.start(partial(self._session.fit_due, of_window=wanted))

    def _on_latest_paths(self) -> None:
        """Score the latest whole trajectories; what takes long makes the next time wait."""
        if time.monotonic() >= self._next_path:
            self._paths.start(self._session.paths_due)

    def _on_causes(self) -> None:
        self._searches.start(self._session.search_due)
        # Saving has looked, too.
        self._say_causes()
        self._log_defects()

    def _say_causes(self) -> None:
        for each in self._estimates:
            causes = self._session.causes_of(each.name)
            come, gone = each.causes_told.news(causes, time.monotonic())
            for cause in come:
                self.get_logger().warning(f"{each.title}{cause.sentence}")
            for cause in gone:
                text = f"{each.title}no longer a likely cause: {cause.text}"
                self.get_logger().info(text)

    def _on_waiting(self) -> None:
        """Say what is missing, until something has come on every topic."""
        turn, self._waited = self._waited, self._waited + 1
        inputs = (*(each.input for each in self._estimates), self._ground_truth)
        silent = {each.state.topic: each.state.publishers for each in inputs if not each.heard}
        if not silent or (turn > 1 and turn % _WAITING_REPEATED):
            return
        text = waiting(silent, self._fitting_topics() if turn else None)
        if text is not None:
            self.get_logger().info(text)

    def _fitting_topics(self) -> dict[str, str]:
        """Topics with poses that other nodes publish, and their types."""
        ours = {each.state.topic for each in self._inputs}
        own = self.get_fully_qualified_name() + "/"
        return {
            topic: KNOWN[kind]
            for topic, kinds in self.get_topic_names_and_types()
            for kind in kinds
            if kind in KNOWN and topic not in ours and not topic.startswith(own)
            if self.count_publishers(topic)
        }

    def _on_paths(self) -> None:
        shield("the paths", self._visualization.publish_paths, None, self._say_defect)

    def _on_markers(self) -> None:
        shield("the markers", self._visualization.publish_markers, None, self._say_defect)

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._process()
        self._lessons.take(wait=True)
        self._publish(self._session.finish_all())
        try:
            copy = self._session.archive()
        except OutputError as error:
            # Nothing is thrown away that could not be kept.
            self.get_logger().error(str(error))
            response.success = False
            response.message = f"not started over, as the run could not be kept: {error}"
            return response
        self._reset()
        response.success = True
        response.message = "started over" + (f"; the run so far is in {copy}" if copy else "")
        self.get_logger().info(f"on request: {response.message}")
        return response

    def _on_save(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._process()
        written = self._save()
        memory.give_back()
        response.success = bool(written)
        response.message = f"written to {written}" if written else self._why_not_written()
        return response

    def _why_not_written(self) -> str:
        return self._session.error or "output.directory is not set"

    # ------------------------------------------------------------------------------------- work

    @property
    def follows_clock(self) -> bool:
        """Whether time is what ``/clock`` says."""
        clock = self.get_clock()
        return isinstance(clock, ROSClock) and clock.ros_time_is_active

    def _ros_now(self) -> int | None:
        """The ROS time in ns; None while there is no ``/clock`` yet."""
        now = self.get_clock().now().nanoseconds
        return int(now) if now > 0 else None

    def _process(self) -> None:
        """Take what has arrived, evaluate what can be, publish it."""
        now = self._ros_now()
        jumped = self._jumps.clock(now)
        arrived = [self._take(source, topic) for topic, source in enumerate(self._inputs)]
        if jumped is not None and now is not None and self.follows_clock:
            self._sieve = LeftOver(now, jumped, time.monotonic(), len(arrived))
            arrived, before = self._parted(self._sieve, arrived)
            self._feed(before, now)
            self._start_over(f"/clock jumped back by {jumped / 1e9:.1f} s")
        elif self._sieve is not None:
            arrived, left_over = self._parted(self._sieve, arrived)
            self._monitor.note_left_over(sum(len(each) for each in left_over if each is not None))
            self._sieve = self._sieve if self._sieve.active(time.monotonic()) else None
        if self._jumps.stamps_jumped():
            arrived, before = self._parted(self._jumps, arrived)
            self._feed(before, now)
            self._start_over("the stamps jumped back")
            for topic, samples in enumerate(arrived):
                if samples is not None:
                    self._jumps.stamps(topic, samples.stamps)
        self._feed(arrived, now)

    @staticmethod
    def _parted(by: LeftOver | JumpDetector, arrived: _Arrived) -> tuple[_Arrived, _Arrived]:
        """What belongs to the run that has begun, and what is of the one before."""
        new: _Arrived = [None] * len(arrived)
        old: _Arrived = [None] * len(arrived)
        for topic, samples in enumerate(arrived):
            if samples is not None:
                mask = by.split(topic, samples.stamps)
                new[topic], old[topic] = _where(samples, ~mask), _where(samples, mask)
        return new, old

    def _take(self, source: Input, topic: int) -> PoseSamples | None:
        decoded = source.take()
        if decoded is None:
            return None
        if len(decoded.samples):
            self._note_orientation(source, topic, decoded.has_orientation)
        self._monitor.note_messages(topic, len(decoded.samples) + decoded.undecodable)
        self._session.note_undecodable(topic, decoded.undecodable)
        self._jumps.stamps(topic, decoded.samples.stamps)
        if source.fixes is not None:
            self._session.note_fixes(topic, source.fixes)
        if decoded.latest_path is not None:
            self._session.take_path(topic, decoded.latest_path)
        return decoded.samples

    def _note_orientation(self, source: Input, topic: int, has_orientation: bool) -> None:
        """What comes has an orientation, or none: positions alone. Another run where it changes."""
        before = self._oriented.get(topic, has_orientation)
        self._oriented[topic] = has_orientation
        if has_orientation:
            self._session.note_orientation(topic)
        if has_orientation != before:
            what = "has an orientation now" if has_orientation else "is of positions alone now"
            self._start_over(f"{source.state.topic} {what}")
        if not has_orientation:
            self._session.note_without_orientation(topic)

    def _take_all(self) -> None:
        """Empty the queues of what they hold by now."""
        deadline = time.monotonic() + _LAST_ARRIVALS
        batches = 0
        while batches < _LAST_BATCHES or time.monotonic() < deadline:
            batches += 1
            before = self._monitor.messages
            self._process()
            if self._monitor.messages == before:
                return

    @property
    def _is_behind(self) -> bool:
        """Whether there is more to do than the last batch has done."""
        return self._session.engine.is_behind or any(source.is_behind for source in self._inputs)

    def _feed(self, arrived: _Arrived, now: int | None) -> None:
        steady = time.monotonic()
        is_idle = all(samples is None for samples in arrived) and not self._is_behind
        if is_idle and steady < self._next_clock:
            return
        self._session.feed(*arrived)
        clock = None
        if steady >= self._next_clock:
            self._next_clock = steady + _CLOCK_PERIOD
            self._stamp_clock.note(self._session.newest_stamps(), now)
            # What is in a queue has come: nothing is given up for it.
            waiting = any(source.is_behind for source in self._inputs)
            clock = None if waiting else self._stamp_clock.now(now)
        self._publish(self._session.advance_all(clock, _MOST_POSES))

    def _publish(self, found: Mapping[str, Results]) -> None:
        for each in self._estimates:
            results = found[each.name]
            for notice in results.notices:
                self._log_once(notice, each.title)
            if len(results.evaluations):
                each.publish(results, self._ground_truth)
                shield("the path", partial(self._show, each.name, results), None, self._say_defect)

    def _show(self, name: str, results: Results) -> None:
        self._visualization.add(self._shown[name], results, self._ground_truth.frame)

    def _log_once(self, notice: Notice, title: str) -> None:
        """Log a notice; of the ground truth, which every estimate has, once."""
        if is_of_ground_truth(notice):
            subject = notice.text if notice.code == LEARNED else notice.code
            if subject in self._notices_said:
                return
            self._notices_said.add(subject)
            title = ""
        self._log(notice._replace(text=f"{title}{notice.text}"))

    def _log(self, notice: Notice) -> None:
        # rclpy keeps a severity a line of code: one line for each.
        logger = self.get_logger()
        if notice.level == "info":
            logger.info(notice.text)
        elif notice.level == "warning":
            logger.warning(notice.text)
        else:
            logger.error(notice.text)

    def _say_defect(self, line: str) -> None:
        """Log what has failed; each line once."""
        if line not in self._defects_said:
            self._defects_said.add(line)
            self.get_logger().error(line)

    def _log_defects(self) -> None:
        for line in self._session.defects:
            self._say_defect(line)

    def _start_over(self, why: str) -> None:
        """Time has jumped back: end the run, keep its results, begin another."""
        self._publish_last()
        self._monitor.note_jump()
        kept = ""
        try:
            copy = self._session.archive()
            kept = f"; the run so far is in {copy}" if copy else ""
        except OutputError as error:
            for line in error.lines:
                self.get_logger().error(line)
        self.get_logger().warning(f"{why}: starting over{kept}")
        self._reset()

    def _reset(self) -> None:
        self._session.reset()
        self._unheard, self._next_window_fit = _ERROR_MODEL_PERIOD, 0.0
        self._stamp_clock = StampClock()
        self._jumps.forget_stamps()
        self._notices_said.clear()
        self._visualization.clear()
        self._ground_truth.reset()
        for each in self._estimates:
            each.reset()
        if self._compared is not None:
            self._compared.reset()
        self._monitor.reset()
        memory.give_back()

    def _save(self, *, last: bool = False) -> str | None:
        """Write the output folder; its path, an empty string if there is none, None on failure."""
        self._fits.take(wait=True)
        self._paths.take(wait=True)
        try:
            path = self._session.save(last=last)
        except OutputError as error:
            for line in error.lines:
                self.get_logger().error(line)
            return None
        finally:
            self._log_defects()
        if path is not None:
            self.get_logger().info(f"results written to {path}")
        return str(path or "")


def _where(samples: PoseSamples, mask: npt.NDArray[np.bool_]) -> PoseSamples:
    covariances = None if samples.covariances is None else samples.covariances[mask]
    return PoseSamples(
        samples.stamps[mask], samples.positions[mask], samples.quaternions[mask], covariances
    )
