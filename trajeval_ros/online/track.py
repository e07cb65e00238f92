# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An estimate's side of the engine: its poses, from the topic to the figures."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.conventional.running import ENOUGH_TO_ALIGN, ConventionalFigures
from trajeval_ros.error_model.nuisances import Truth
from trajeval_ros.ground_truth.joint import JointCovariance
from trajeval_ros.ground_truth.segment import Samples
from trajeval_ros.ground_truth.trajectory import Posterior
from trajeval_ros.likelihood.gaussian import CovarianceError, positive_definite
from trajeval_ros.online.accounting import Reason
from trajeval_ros.online.coverage import Presence, coverage
from trajeval_ros.online.doubts import CovarianceDoubts
from trajeval_ros.online.evaluation import Evaluation
from trajeval_ros.online.intake import Accepted, Intake
from trajeval_ros.online.positions import notices_on_positions
from trajeval_ros.online.question import Question
from trajeval_ros.online.reference import LEARNED, Reference
from trajeval_ros.online.results import NO_EVALUATIONS, Evaluations, Health, Notice, Results
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.online.settings import EstimateSettings, EvaluationSettings, Timing
from trajeval_ros.online.summary import distributions, summarize, window_figures
from trajeval_ros.online.summary_on_positions import (
    on_positions,
    window_on_positions,
    without_rotation,
)
from trajeval_ros.online.turned import CONSTANT, TURNS, Turned
from trajeval_ros.online.window import EvaluatedPoses
from trajeval_ros.online.withdrawn import Withdrawn

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

CONDITIONED = 20_000
"""Of a ground truth that is kept whole, so many samples are ready to answer: 4 kB each, not 0.5."""

_SELF_CHECK = 1e-6
_STRAINED = 0.2
_FAR_MORE_RARELY = 4.0
# Where poses come a few at a time, it is looked for news so often (ns).
_NEWS_PERIOD = 1_000_000_000


@dataclass(frozen=True, slots=True)
class _Pending:
    """Estimates that wait for their ground truth; ``stamps`` are on the ground truth's clock."""

    stamps: Stamps
    poses: Array
    covariances: Array | None

    def __len__(self) -> int:
        return len(self.stamps)

    def where(self, mask: Mask | Stamps | slice) -> _Pending:
        covariances = None if self.covariances is None else self.covariances[mask]
        return _Pending(self.stamps[mask], self.poses[mask], covariances)

    def joined(self, later: _Pending) -> _Pending:
        """With poses that came later, by stamp."""
        covariances = later.covariances
        if self.covariances is not None and later.covariances is not None:
            covariances = np.concatenate([self.covariances, later.covariances])
        both = _Pending(
            np.concatenate([self.stamps, later.stamps]),
            np.concatenate([self.poses, later.poses]),
            covariances,
        )
        if self.stamps[-1] < later.stamps[0]:
            return both
        return both.where(np.argsort(both.stamps))


_NOBODY = _Pending(np.empty(0, dtype=np.int64), np.empty((0, 4, 4)), None)


class Track:
    """Scores one estimate. What becomes of it does not depend on what other tracks do."""

    def __init__(
        self,
        settings: EstimateSettings,
        evaluation: EvaluationSettings,
        timing: Timing,
        reference: Reference,
        begin: int | None = None,
    ) -> None:
        """Start without poses; ``begin`` (ns): nothing before it can be asked any more."""
        self._settings = settings
        self._timing = timing
        self._reference = reference
        self._ground_truth = reference.ground_truth
        self._from_body = settings.from_body
        self._estimates = Intake(settings.use_covariance, settings.axes)
        self._evaluation = Evaluation(evaluation)
        self._joint = JointCovariance() if evaluation.joint else None
        self._pending = self._chosen = _NOBODY
        self._newest_estimate: int | None = None
        self._decided: int | None = None  # stamp of the newest pose that has been chosen or judged
        self._withdrawn = Withdrawn()
        self._first_singular: int | None = None
        self._doubts = CovarianceDoubts()
        self._announced: set[str] = set()
        self._next_alignment = ENOUGH_TO_ALIGN
        self._looked_for_news: list[int | None] = [None, None]
        self._wants_news = True
        self._begin = begin
        self._presence = Presence()
        self.lacks_orientation = False
        self._turned = Turned(TURNS)
        self.is_behind = False
        """Whether more can be evaluated than `advance` was to choose."""

    def change(self, evaluation: EvaluationSettings, timing: Timing) -> None:
        """Go on with another window and another wait."""
        self._evaluation.window_duration = evaluation.window
        self._timing = timing

    @property
    def begin(self) -> int | None:
        """Stamp (ns) before which it asks for nothing any more; None while all may be asked."""
        return self._begin

    @property
    def newest(self) -> int | None:
        """Stamp (ns) of the newest pose let in, on the ground truth's clock."""
        own = self._estimates.last
        return None if own is None else own + self._settings.time_offset

    @property
    def is_position_only(self) -> bool:
        """Whether one of the two has no orientation: none is given, or one that never changes.

        That of a ground truth which has the same all along while the estimate turns is none.
        """
        if self.lacks_orientation or self._reference.lacks_orientation:
            return True
        return self._reference.never_turns and self._turned.most >= TURNS

    def add(self, samples: PoseSamples) -> None:
        """Take poses, in the order of their arrival."""
        if samples.covariances is not None and self._settings.use_covariance:
            self._doubts.look_at(samples.covariances)
        self._append(self._estimates.accept(samples, self._late))

    def _late(self, stamp: int, newest: int) -> bool:
        """Whether a pose with a stamp before the ``newest`` (ns, its own) still has a place."""
        at = stamp + self._settings.time_offset
        undecided = self._decided is None or at > self._decided
        in_time = newest - stamp <= self._timing.max_wait
        return undecided and in_time and at not in self._pending.stamps

    def add_ground_truth(self, samples: Samples) -> None:
        """Take samples of the ground truth, beside what `Reference` answers."""
        self._evaluation.add_ground_truth(samples.stamps, samples.poses)

    def _append(self, accepted: Accepted) -> None:
        if not len(accepted.stamps):
            return
        # T_world_gtbody = T_world_estbody (T_gtbody_estbody)^-1, and the covariance goes along by
        # the adjoint.
        covariances = accepted.covariances
        if covariances is not None:
            adjoint = se3.adjoint(se3.inverse(self._from_body))
            covariances = adjoint @ covariances @ adjoint.T
        stamps = accepted.stamps + self._settings.time_offset
        arrived = _Pending(stamps, se3.compose(accepted.poses, self._from_body), covariances)
        newest = self._newest_estimate
        self._newest_estimate = int(stamps[-1]) if newest is None else max(newest, int(stamps[-1]))
        self._presence.add(stamps)
        if self._reference.never_turns:
            self._turned.add(arrived.poses)
        self._pending = self._pending.joined(arrived) if len(self._pending) else arrived

    def advance(self, now: int | None, most: int | None = None) -> Question:
        """Choose what can be evaluated, ``most`` poses, after the ground truth was told the time.

        With ``most`` there are notices once a second of ``now``, or of stamps; else at each call.
        What the ground truth is to be asked; :meth:`score` takes the answer.
        """
        self._wants_news = most is None or self._is_time_for_news(now)
        if now is not None:
            certain = now - self._timing.max_wait
            self._append(self._estimates.confirm(certain - self._settings.time_offset))
            self._give_up(now)
        count = self._answerable(now)
        self.is_behind = most is not None and count > most
        question = self._choose(min(count, count if most is None else most))
        self._forget()
        return question

    def _is_time_for_news(self, now: int | None) -> bool:
        """Whether a second has gone by; without ``now``, as where a node is behind, by stamps."""
        times = [now, self._newest_estimate]
        before = self._looked_for_news
        due = any(
            time is not None and (last is None or abs(time - last) >= _NEWS_PERIOD)
            for time, last in zip(times, before, strict=True)
        )
        if due:
            self._looked_for_news = [
                last if time is None else time for time, last in zip(times, before, strict=True)
            ]
        return due

    def finish(self) -> Question:
        """Choose all that is pending, after the ground truth has been concluded."""
        self._append(self._estimates.conclude())
        self._next_alignment, self._wants_news = 0, True
        self.is_behind = False
        return self._choose(len(self._pending))

    def score(self, answer: Posterior | None) -> Results:
        """Evaluate what was chosen, by the ground truth's answer; None where nothing was asked."""
        chosen, self._chosen = self._chosen, _NOBODY
        if answer is None:
            return self._results(NO_EVALUATIONS, ())
        covariance = answer.covariances
        if chosen.covariances is not None:
            # To first order the two errors add up: the two body frames differ by the error itself.
            covariance = covariance + chosen.covariances
        assert answer.twists is not None
        self._drop_positions()
        poses = EvaluatedPoses(
            chosen.stamps,
            answer.poses,
            covariance,
            chosen.poses,
            answer.cross,
            answer.twists.means,
            answer.nearest,
        )
        return self._results(*self._score(poses, self._settings.time_offset, answer.sampled))

    def _answerable(self, now: int | None) -> int:
        """Number of pending estimates that can be decided, the oldest ones.

        Those that are at least ``lag`` older than the newest sample; and those whose last sample,
        at most ``patience`` later, must have come by ``now``.
        """
        if not self._reference.is_ready:
            return 0
        stamps = self._ground_truth.stamps
        latest = int(stamps[-1]) - self._timing.lag
        if now is not None:
            latest = max(latest, now - self._timing.patience - self._timing.max_wait - 1)
        if self._ground_truth.known_until is not None:
            latest = min(latest, self._ground_truth.known_until)
        return int(np.searchsorted(self._pending.stamps, latest, side="right"))

    def _choose(self, count: int) -> Question:
        """Decide which of the ``count`` oldest pending estimates are evaluated."""
        if count:
            self._decided = int(self._pending.stamps[count - 1])
            chosen = self._pending.where(slice(count))
            self._pending = self._pending.where(slice(count, None))
            self._chosen = chosen.where(self._judge(chosen.stamps))
        stamps = self._chosen.stamps
        return Question(stamps, self._until(stamps) if len(stamps) else stamps, self._joint)

    def _drop_positions(self) -> None:
        """Positions alone are looked at as long as it may turn out that there is nothing else."""
        if self._reference.has_orientation and not self.lacks_orientation:
            self._evaluation.drop_positions()

    def _score(
        self, answered: EvaluatedPoses, offset: int, sampled: Mask
    ) -> tuple[Evaluations, tuple[Array, ...]]:
        """Evaluate poses but for those whose covariance is not positive definite.

        By itself, or as the joint covariance goes on with it.
        """
        numbers = self._withdrawn.number(len(answered))
        good = positive_definite(answered.covariance)
        self._withdraw(answered.stamps[~good], numbers[~good])
        scored = self._score_good(answered, offset, sampled, numbers, good)
        if answered.cross is not None:
            self._withdrawn.forget(len(answered.cross[-1]))
        return scored

    def _score_good(
        self, answered: EvaluatedPoses, offset: int, sampled: Mask, numbers: Stamps, good: Mask
    ) -> tuple[Evaluations, tuple[Array, ...]]:
        """Evaluate the ``good`` poses but for those that the joint covariance does not go on with.

        Each attempt leaves out all poses withdrawn so far.
        """
        while good.any():
            poses = answered.where(good)
            if poses.cross is not None:
                cross = self._withdrawn.left_out(numbers[good], poses.cross)
                poses = replace(poses, cross=cross)
            try:
                return self._evaluation.add(poses, offset, sampled[good]), poses.cross or ()
            except CovarianceError as error:
                index = np.flatnonzero(good)[error.index]
                good[index] = False
                self._withdraw(answered.stamps[[index]], numbers[[index]])
        return NO_EVALUATIONS, ()

    def _withdraw(self, stamps: Stamps, numbers: Stamps) -> None:
        """Reject poses whose covariance cannot be factored."""
        if not len(stamps):
            return
        self._withdrawn.add(numbers)
        self._estimates.account.reject(Reason.SINGULAR_COVARIANCE, len(stamps))
        first = int(stamps.min())
        if self._first_singular is None or first < self._first_singular:
            self._first_singular = first

    def _until(self, stamps: Stamps) -> Stamps:
        """Stamp of the last sample that answers each of ``stamps`` (n,).

        The first one at or after ``t + lag``; or, where that is more than ``patience`` after t, the
        last one before.
        """
        samples = self._ground_truth.stamps
        complete = np.searchsorted(samples, stamps + self._timing.lag)
        latest = np.searchsorted(samples, stamps + self._timing.patience, side="right") - 1
        return np.asarray(samples[np.minimum(complete, latest)])

    def truth(self, stamps: Stamps) -> Truth:
        """The ground truth at ``stamps`` (n,), increasing, as a pose there is answered."""
        samples, count = self._ground_truth.stamps, len(stamps)
        valid = np.zeros(count, dtype=np.bool_)
        poses, covariances = np.zeros((count, 4, 4)), np.zeros((count, 6, 6))
        twists, after = np.zeros((count, 6)), np.zeros(count, dtype=np.int64)
        if self._reference.is_ready:
            after = np.searchsorted(samples, stamps)
            before = np.searchsorted(samples, stamps, side="right") - 1
            to_next = samples[np.minimum(after, len(samples) - 1)] - stamps
            to_last = stamps - samples[np.maximum(before, 0)]
            valid = (after < len(samples)) & (before >= 0) & (to_next <= self._timing.patience)
            valid &= np.minimum(to_next, to_last) <= self._timing.max_gap
            valid &= ~self._ground_truth.is_cut(stamps)
            if self._ground_truth.begin is not None:
                valid &= stamps >= self._ground_truth.begin
        chosen = np.flatnonzero(valid)
        stretches = np.flatnonzero(np.diff(after[chosen] // CONDITIONED)) + 1
        for some in np.split(chosen, stretches) if len(chosen) else ():
            posterior = self._ground_truth.posterior(
                stamps[some], self._until(stamps[some]), twists=True
            )
            poses[some], covariances[some] = posterior.poses, posterior.covariances
            assert posterior.twists is not None
            twists[some] = posterior.twists.means
        return Truth(poses, covariances, twists, valid)

    def _judge(self, stamps: Stamps) -> Mask:
        """Which estimates can be scored, (n,); count the others."""
        samples = self._ground_truth.stamps
        account = self._estimates.account
        if not self._reference.is_ready:
            account.reject(Reason.NO_GROUND_TRUTH, len(stamps))
            return np.zeros(len(stamps), dtype=np.bool_)
        begin = self._begin
        late = stamps < (samples[0] if begin is None else begin)
        late &= begin is not None
        after = np.searchsorted(samples, stamps)
        before = np.searchsorted(samples, stamps, side="right") - 1
        to_next = samples[np.minimum(after, len(samples) - 1)] - stamps
        to_last = stamps - samples[np.maximum(before, 0)]
        nearest = np.minimum(np.abs(to_next), np.abs(to_last))
        far = ~late & (nearest > self._timing.max_gap)
        bracketed = (after < len(samples)) & (before >= 0) & (to_next <= self._timing.patience)
        outside = ~late & ~far & (~bracketed | self._ground_truth.is_cut(stamps))
        account.reject(Reason.TOO_LATE, int(late.sum()))
        account.reject(Reason.NO_GROUND_TRUTH, int(far.sum()))
        account.reject(Reason.OUTSIDE_GROUND_TRUTH, int(outside.sum()))
        return np.asarray(~late & ~far & ~outside)

    def _give_up(self, now: int) -> None:
        """Reject pending estimates without any sample near them, where one should have come by now.

        A sample that serves an estimate is stamped at most ``max_gap`` after it and may come
        ``max_wait`` late. Where one before the estimate serves it already, the next one may lie
        behind a gap: those estimates wait for it.
        """
        if not len(self._pending):
            return
        stamps, gap, wait = self._pending.stamps, self._timing.max_gap, self._timing.max_wait
        if int(stamps[0]) + max(gap, self._timing.lag) + wait >= now:
            return
        samples = self._reference.known
        served = np.zeros(len(stamps), dtype=np.bool_)
        if len(samples):
            near = np.searchsorted(samples, stamps - gap)
            served = samples[np.minimum(near, len(samples) - 1)] >= stamps - gap
        given_up = ~served & (stamps + max(gap, self._timing.lag) + wait < now)
        if given_up.any():
            self._estimates.account.reject(Reason.NO_GROUND_TRUTH, int(given_up.sum()))
            self._pending = self._pending.where(~given_up)

    def _forget(self) -> None:
        """Move on :attr:`begin`: to what no pose to come asks for, or what is too old to be."""
        if not self._reference.is_ready or self._ground_truth.lesson is not None or self.is_behind:
            return
        newest, held = int(self._ground_truth.stamps[-1]), self._estimates.held_stamp
        oldest = newest - self._timing.patience - self._timing.max_wait
        waiting = newest if self._newest_estimate is not None else oldest
        if self._newest_estimate is not None:
            # Late ones may come, but not before what has been decided.
            late = self._newest_estimate - self._timing.max_wait
            waiting = min(waiting, late if self._decided is None else max(late, self._decided))
        if len(self._pending):
            waiting = min(waiting, int(self._pending.stamps[0]))
        if held is not None:
            waiting = min(waiting, held + self._settings.time_offset)
        before = max(oldest, waiting)
        self._begin = before if self._begin is None else max(before, self._begin)

    def _results(self, evaluations: Evaluations, cross: tuple[Array, ...]) -> Results:
        if self.is_position_only:
            evaluations = self._evaluation.on_positions(evaluations)
            found = self._evaluation.newest_positions
            absolute = None if found is None else found.absolute
            return Results(
                evaluations,
                self._news(),
                None if absolute is None else absolute.log_likelihood,
                self._evaluation.alignment if found is None else found.alignment,
                cross,
                position_only=True,
            )
        return Results(
            evaluations,
            self._news(),
            self._evaluation.absolute_log_likelihood,
            self._evaluation.alignment,
            cross,
        )

    def _news(self) -> tuple[Notice, ...]:
        """The notices that are new since the last time: each code once a run, but each lesson."""
        if not self._wants_news:
            return ()
        count, undetermined = self._evaluation.count, False
        # It takes the waiting poses in and aligns all, as much as the rest of a call.
        if count >= self._next_alignment:
            undetermined = self._evaluation.conventional.is_rotation_undetermined
            self._next_alignment = 2 * count
        found = self._notices(undetermined)
        news = tuple(n for n in found if _subject(n) not in self._announced)
        self._announced |= {_subject(n) for n in news}
        return news

    def notices(self) -> tuple[Notice, ...]:
        """Return what there is to say of the run as it stands, at most one notice a code.

        After :meth:`finish` it is a function of the data alone, as the figures are; what
        :class:`~trajeval_ros.online.results.Results` announced on the way need not hold any more.
        """
        conventional = self._evaluation.conventional
        found = self._notices(conventional.is_rotation_undetermined)
        return (*found, *self._swapped(), *self._as_good())

    def _swapped(self) -> tuple[Notice, ...]:
        """A ground truth that comes far more rarely than the estimate may be the estimate."""
        truth, own = self._reference.presence.usual_interval, self._presence.usual_interval
        if truth is None or own is None or truth < _FAR_MORE_RARELY * own:
            return ()
        text = (
            f"the ground truth comes at {_rate(truth)} Hz, and the estimate at {_rate(own)} Hz:"
            " have the two been swapped? The ground truth is named first"
        )
        return (Notice("info", "sparse_ground_truth", text),)

    def _as_good(self) -> tuple[Notice, ...]:
        """An ATE that may be the ground truth's own: a copy of its samples has one, too.

        It is compared with the process, which smooths what the samples have of noise.
        """
        hyperparameters = self._ground_truth.hyperparameters
        ate = self._evaluation.conventional.figures().ate_translation_rmse
        if hyperparameters is None or ate is None or self._evaluation.count < ENOUGH_TO_ALIGN:
            return ()
        noise = hyperparameters.translation.noise_std
        if ate > math.sqrt(3.0) * noise:
            return ()
        text = (
            f"the ATE of {1e3 * ate:.2g} mm is no more than the ground truth's own noise: samples "
            f"are taken to be good to {1e3 * noise:.2g} mm an axis, and the ground truth is a "
            "smooth curve through them, so that even a copy of the samples is off by as much"
        )
        return (Notice("info", "as_good_as_ground_truth", text),)

    def _notices(self, undetermined: bool) -> tuple[Notice, ...]:
        """The notices; ``undetermined``: whether the conventional alignment's rotation is."""
        found = self._all_notices(undetermined)
        return notices_on_positions(found) if self.is_position_only else found

    def _all_notices(self, undetermined: bool) -> tuple[Notice, ...]:
        of_positions = self.is_position_only and not self._reference.has_orientation
        found = list(self._reference.learned(of_positions))
        consistency = self._evaluation.consistency
        if consistency is not None and consistency > _SELF_CHECK:
            found.append(
                Notice(
                    "warning",
                    "inconsistent_likelihoods",
                    f"relative and first-order absolute likelihood differ by {consistency:.1e}, "
                    "more than round-off",
                )
            )
        strain = self._evaluation.strain
        if strain is not None and strain > _STRAINED:
            found.append(
                Notice(
                    "warning",
                    "first_order_strained",
                    f"running and first-order absolute likelihood differ by {100.0 * strain:.0f} "
                    "%: first order does not hold (ground-truth gaps, long runs), so the relative "
                    "likelihood is not calibrated",
                )
            )
        if self._first_singular is not None:
            found.append(
                Notice(
                    "warning",
                    "singular_covariance",
                    f"the covariance of the pose at {self._first_singular} ns is not positive "
                    "definite: are ground truth's or estimate's covariances right?",
                )
            )
        if undetermined:
            text = (
                "the motion is not larger than the errors (of a scale, too), or along a line: the "
                "alignment's rotation is not determined, and the conventional rotation error is "
                "left out"
            )
            found.append(Notice("warning", "alignment_undetermined", text))
        if self._evaluation.is_at_ground_truth:
            text = (
                "the ground truth is sparser than the estimate: the conventional figures are at its"
                " own instants, the estimate interpolated there"
            )
            found.append(Notice("info", "at_ground_truth", text))
        return (*found, *self._reference.faulty(), *self._doubts.notices())

    def health(self) -> Health:
        """Return the state of the inputs and of the computation."""
        return Health(
            self._estimates.health(
                self._evaluation.count, len(self._pending) + self._estimates.held
            ),
            self._reference.health(),
            self._ground_truth.hyperparameters,
            self._ground_truth.segments,
            self._consistency,
            self._reference.faults,
            self._ground_truth.fit,
            self._reference.has_orientation or not self.is_position_only,
        )

    @property
    def _consistency(self) -> float | None:
        if not self.is_position_only:
            return self._evaluation.consistency
        found = self._evaluation.positions
        return None if found is None else found.consistency

    @property
    def conventional(self) -> ConventionalFigures:
        """The conventional figures of the run."""
        return self._evaluation.conventional.figures()

    def figures(self) -> dict[str, object]:
        """Return the summary without what takes milliseconds.

        That is ``window`` and ``conventional.distributions``.
        """
        figures = summarize(self.health(), self._evaluation)
        figures["coverage"] = coverage(self._reference.odometer.way(), self._presence)
        return self._told(figures)

    def _told(self, figures: dict[str, object]) -> dict[str, object]:
        """The figures without what contains an orientation, where there is none."""
        if not self.is_position_only:
            neither = self._reference.never_turns and self._turned.most <= CONSTANT
            return without_rotation(figures) if neither and self._evaluation.count else figures
        turns = self._reference.has_orientation
        return on_positions(figures, self._evaluation.positions, truth_turns=turns)

    def summary(self) -> dict[str, object]:
        """Return the figures of the run so far, as ``summary.json`` has them."""
        figures, evaluation = self.figures(), self._evaluation
        conventional = figures["conventional"]
        assert isinstance(conventional, dict)
        told = {
            **figures,
            "conventional": {**conventional, "distributions": distributions(evaluation)},
        }
        window = evaluation.window()
        of_window = window_figures(window, evaluation.gauge)
        if self.is_position_only:
            return {
                **self._told(told),
                "window": window_on_positions(of_window, window, evaluation.gauge),
            }
        return {**self._told(told), "window": of_window}


def _rate(interval: float) -> str:
    """Hz, of an interval in s."""
    return f"{1.0 / interval:.0f}" if interval <= 0.1 else f"{1.0 / interval:.2g}"


def _subject(notice: Notice) -> str:
    """What a notice is announced once for: its code, or the lesson that it tells."""
    return notice.text if notice.code == LEARNED else notice.code
