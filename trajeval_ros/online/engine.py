# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The online engine: a pure function of its inputs.

An estimate is evaluated as soon as the first ground-truth sample at or after ``t + lag`` is there,
and exactly with the samples up to that one. Which estimates are evaluated, and with what, depends
on the stamps alone, never on when a message arrived; the clock only tells when to give up waiting
(``docs/architecture.md``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
import numpy.typing as npt

from trajeval_ros.conventional.running import ConventionalFigures
from trajeval_ros.error_model.nuisances import Truth
from trajeval_ros.ground_truth.lessons import Lesson
from trajeval_ros.ground_truth.process import Process
from trajeval_ros.ground_truth.trajectory import Posterior
from trajeval_ros.online.coverage import Way
from trajeval_ros.online.parameters import ONE, ParameterError, Value, complete, table
from trajeval_ros.online.question import Question, answered
from trajeval_ros.online.reference import Reference
from trajeval_ros.online.results import Health, Notice, Results
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.online.settings import Settings, settings_of
from trajeval_ros.online.track import CONDITIONED, Track

Stamps = npt.NDArray[np.int64]


class Engine:
    """Scores estimated trajectories against one ground truth while all arrive.

    The ground truth is modelled once, and each estimate has a track of its own: what becomes of an
    estimate is what would become of it alone. The name of an estimate may be left out where there
    is one.
    """

    def __init__(
        self,
        parameters: Mapping[str, object],
        names: Sequence[str] = ONE,
        whole: bool = False,
        *,
        beside: bool = False,
    ) -> None:
        """Take the parameters, of which those that are missing have their defaults.

        ``names``: of the estimates. ``whole``: keep all ground truth, so that `truth` answers
        at any time of a run. ``beside``: the owner sees to each :attr:`lesson`, as it likes, and
        what needs its answer waits for it. Raises
        :class:`~trajeval_ros.online.parameters.ParameterError`.
        """
        self._whole = whole
        self._beside = beside
        self._values = complete(parameters, names)
        self._names = tuple(names)
        self._settings = settings_of(self._values, self._names)
        self.reset()

    def reset(self) -> None:
        """Start over, with the parameters as they are."""
        self._reference = Reference(self._settings.ground_truth, beside=self._beside)
        self._tracks = {name: self._new_track(name) for name in self._names}

    def reset_estimate(self, name: str | None = None) -> None:
        """Start over with one estimate; ground truth and the other estimates go on.

        What the ground truth has forgotten of its past for this estimate stays forgotten.
        """
        name = self.only(name)
        before = self._tracks[name]
        self._tracks[name] = self._new_track(name, before.begin)
        self._tracks[name].lacks_orientation = before.lacks_orientation

    def _new_track(self, name: str, begin: int | None = None) -> Track:
        settings = self._settings
        own = settings.estimates[name]
        return Track(own, settings.evaluation, settings.timing, self._reference, begin)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the estimates."""
        return self._names

    @property
    def parameters(self) -> Mapping[str, Value]:
        """Every parameter's value."""
        return dict(self._values)

    @property
    def settings(self) -> Settings:
        """What the parameters say."""
        return self._settings

    def set(self, name: str, value: object) -> None:
        """Change a dynamic parameter.

        Raises :class:`~trajeval_ros.online.parameters.ParameterError` for one that is unknown,
        read-only or out of range.
        """
        known = table(self._names)
        if name not in known:
            raise ParameterError(f"unknown parameter {name}")
        if not known[name].dynamic:
            raise ParameterError(f"{name} is read-only while the engine runs")
        self._values[name] = known[name].validate(value)
        self._settings = settings_of(self._values, self._names)
        for track in self._tracks.values():
            track.change(self._settings.evaluation, self._settings.timing)

    def note_without_orientation(self, name: str | None) -> None:
        """The quaternions of an estimate, or where None of the ground truth, are none.

        Before the first pose: positions that have been scored with an orientation are left out.
        """
        if name is None:
            self._reference.note_without_orientation()
        else:
            self._track(name).lacks_orientation = True

    def lacks_orientation(self, name: str | None = None) -> bool:
        """Whether one of an estimate and the ground truth is known to have none."""
        return self._reference.lacks_orientation or self._track(name).lacks_orientation

    def is_position_only(self, name: str | None = None) -> bool:
        """Whether an estimate is scored by positions alone: the one or the other has no more."""
        return self._track(name).is_position_only

    def add_ground_truth(self, samples: PoseSamples) -> None:
        """Take ground-truth samples, in the order of their arrival."""
        self._reference.add(samples, self._settings.timing.max_wait)
        self._pass_on()

    def add_estimate(self, samples: PoseSamples, name: str | None = None) -> None:
        """Take poses of an estimate, in the order of their arrival."""
        self._track(name).add(samples)

    def advance(self, now: int | None = None) -> Results:
        """Evaluate all that can be of the only estimate; `advance_all` is for several.

        ``now`` (ns) is the time on the clock of the stamps; without it nothing is given up.
        """
        name = self.only(None)
        return self.advance_all(now)[name]

    def advance_all(self, now: int | None = None, most: int | None = None) -> dict[str, Results]:
        """Evaluate all that can be of every estimate; ``now`` as for `advance`.

        ``most``: so many poses of each, the oldest; then the rest `is_behind`, for further calls.
        """
        if now is not None:
            self._reference.confirm(now - self._settings.timing.max_wait)
            self._pass_on()
        found = self._answered([track.advance(now, most) for track in self._tracks.values()])
        self._forget()
        return found

    @property
    def is_behind(self) -> bool:
        """Whether more could be evaluated than the last call was to."""
        return any(track.is_behind for track in self._tracks.values())

    def finish(self) -> Results:
        """No more data will come: evaluate or reject all that is pending of the only estimate."""
        name = self.only(None)
        return self.finish_all()[name]

    def finish_all(self) -> dict[str, Results]:
        """No more data will come: evaluate or reject all that is pending."""
        self._reference.conclude()
        self._pass_on()
        return self._answered([track.finish() for track in self._tracks.values()])

    def _answered(self, questions: Sequence[Question]) -> dict[str, Results]:
        """Ask the ground truth once for all tracks, and score each by its part of the answer."""
        ask = self._reference.ground_truth.posterior
        answers: list[Posterior | None]
        if any(question.joint is not None for question in questions):
            answers = [
                ask(q.stamps, q.until, q.joint, twists=True) if len(q.stamps) else None
                for q in questions
            ]
        else:
            answers = answered(questions, partial(ask, twists=True))
        scored = zip(self._tracks.items(), answers, strict=True)
        return {name: track.score(answer) for (name, track), answer in scored}

    def newest_stamps(self) -> list[int]:
        """The newest stamps let in (ns), one a topic, on the ground truth's clock."""
        newest = (self._reference.newest, *(track.newest for track in self._tracks.values()))
        return [stamp for stamp in newest if stamp is not None]

    def _pass_on(self) -> None:
        """Tell every track the samples that were let in."""
        for samples in self._reference.fresh():
            for track in self._tracks.values():
                track.add_ground_truth(samples)

    def _forget(self) -> None:
        """Drop the ground truth that no track asks for any more.

        None holds up the others: each lets go of what is older than the patience there is.
        """
        begins = [track.begin for track in self._tracks.values()]
        known = [begin for begin in begins if begin is not None]
        if len(known) < len(begins):
            return
        if self._whole:
            self._reference.ground_truth.rest(min(known), CONDITIONED)
        else:
            self._reference.ground_truth.forget(min(known))

    @property
    def lesson(self) -> Lesson | None:
        """The lesson of the ground truth's process that is due, if one is; it takes 0.1 s."""
        return self._reference.ground_truth.lesson

    def teach(self, lesson: Lesson, process: Process | None) -> None:
        """Take what a lesson has taught; nothing where it is no longer the one that is due."""
        if lesson is self.lesson:
            self._reference.ground_truth.teach(lesson, process)

    def way(self) -> Way:
        """The whole way of the ground truth, in bounded memory."""
        return self._reference.odometer.way()

    def truth(self, stamps: Stamps, name: str | None = None) -> Truth:
        """The ground truth at ``stamps`` (n,), on its own clock, as an estimate is answered."""
        return self._track(name).truth(stamps)

    def notices(self, name: str | None = None) -> tuple[Notice, ...]:
        """Return what there is to say of an estimate's run, at most one notice a code.

        After :meth:`finish` it is a function of the data alone, as the figures are; what
        :class:`~trajeval_ros.online.results.Results` announced on the way need not hold any more.
        """
        return self._track(name).notices()

    def health(self, name: str | None = None) -> Health:
        """Return the state of an estimate, of the ground truth and of the computation."""
        return self._track(name).health()

    def figures(self, name: str | None = None) -> dict[str, object]:
        """Return an estimate's summary without what takes milliseconds.

        That is ``window`` and ``conventional.distributions``.
        """
        return self._track(name).figures()

    def conventional(self, name: str | None = None) -> ConventionalFigures:
        """The conventional figures of the run."""
        return self._track(name).conventional

    def summary(self, name: str | None = None) -> dict[str, object]:
        """Return the figures of an estimate's run so far, as ``summary.json`` has them."""
        return self._track(name).summary()

    def _track(self, name: str | None) -> Track:
        return self._tracks[self.only(name)]

    def only(self, name: str | None) -> str:
        """Return the name; that of the only estimate if none is given.

        Raises ValueError for one that there is not, and for none where there are several.
        """
        if name is None:
            if len(self._names) > 1:
                raise ValueError(f"which of the estimates {', '.join(self._names)} is meant?")
            return self._names[0]
        if name not in self._tracks:
            raise ValueError(f"no estimate is called {name}: there is {', '.join(self._names)}")
        return name
