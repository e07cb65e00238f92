# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ground truth's side of the engine: its samples, from the topic to the process.

One for all estimates: it is modelled, learned and forgotten once, and answers each of them.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from trajeval_ros.ground_truth.faults import EXPLANATIONS, Fault, Faults
from trajeval_ros.ground_truth.hyperparameters import Hyperparameters
from trajeval_ros.ground_truth.screen import Screen, Screened
from trajeval_ros.ground_truth.segment import Samples
from trajeval_ros.ground_truth.stamping import Stamping
from trajeval_ros.ground_truth.trajectory import GroundTruth
from trajeval_ros.online.accounting import Reason
from trajeval_ros.online.coverage import Odometer, Presence
from trajeval_ros.online.disorder import Disorder
from trajeval_ros.online.intake import Accepted, Intake
from trajeval_ros.online.results import Notice, TopicHealth
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.online.settings import GroundTruthSettings
from trajeval_ros.online.turned import CONSTANT, Turned

Stamps = npt.NDArray[np.int64]

_OF_ROTATION = "; rotation"
LEARNED = "hyperparameters_learned"
_OF_GROUND_TRUTH = "ground_truth_"


class Reference:
    """Takes ground-truth samples; :attr:`ground_truth` answers."""

    def __init__(self, settings: GroundTruthSettings, *, beside: bool = False) -> None:
        """Start without samples; ``beside`` as of `GroundTruth`."""
        self._learned = settings.learned
        self._lesson: tuple[Hyperparameters, str] | None = None
        self._intake = Intake(settings.use_covariance, settings.axes)
        self._faults = Faults()
        self._disorder = Disorder()
        self._stamping = Stamping(settings.regularize_stamps)
        process = settings.process
        self._screen = Screen((process.translation_std, process.rotation_std), self._faults)
        self.ground_truth = GroundTruth(process, self._faults, beside=beside)
        self.odometer = Odometer(process.translation_std)
        self.presence = Presence()
        self.lacks_orientation = False
        self._turned = Turned(CONSTANT)
        self._fresh: list[Samples] = []

    @property
    def known(self) -> Stamps:
        """Stamps of the retained samples and, after them, of those that are held back."""
        held = self._screen.held, self._stamping.held, self._disorder.held
        return np.concatenate([self.ground_truth.stamps, *held])

    @property
    def newest(self) -> int | None:
        """Stamp (ns) of the newest sample let in."""
        return self._intake.last

    def note_without_orientation(self) -> None:
        """The samples' orientations are none."""
        self.lacks_orientation = True
        self.ground_truth.note_without_orientation()

    @property
    def never_turns(self) -> bool:
        """Whether all samples have the same orientation."""
        return self._turned.most <= CONSTANT

    @property
    def is_ready(self) -> bool:
        """Whether there are samples and the hyperparameters are known."""
        truth = self.ground_truth
        return truth.hyperparameters is not None and len(truth.stamps) > 0

    def add(self, samples: PoseSamples, max_wait: int = 0) -> None:
        """Take samples, in the order of their arrival; ``max_wait`` (ns): how late they may be."""

        def late(stamp: int, newest: int) -> bool:
            return self._disorder.takes(stamp, newest, max_wait)

        self._append(self._intake.accept(samples, late))

    def confirm(self, now: int) -> None:
        """Let in the samples held back if their stamps are not after ``now`` (ns)."""
        self._append(self._intake.confirm(now))
        self._append_ordered(self._disorder.confirm(now))
        self._append_stamped(self._stamping.confirm(now))

    def conclude(self) -> None:
        """No more samples will come."""
        self._append(self._intake.conclude())
        self._append_ordered(self._disorder.conclude())
        self._append_stamped(self._stamping.conclude())
        self._append_screened(self._screen.conclude())
        self.ground_truth.conclude()

    def _append(self, accepted: Accepted) -> None:
        if len(accepted.stamps):
            samples = Samples(accepted.stamps, accepted.poses, accepted.covariances)
            assert self._intake.last is not None
            self._append_ordered(self._disorder.accept(samples, self._intake.last))

    def _append_ordered(self, samples: Samples) -> None:
        if len(samples):
            self._append_stamped(self._stamping.accept(samples))

    def _append_stamped(self, samples: Samples) -> None:
        if len(samples):
            self._append_screened(self._screen.accept(samples))

    def _append_screened(self, screened: Screened) -> None:
        for code, count in screened.rejected.items():
            self._intake.account.reject(Reason(code), count)
        if len(screened.samples):
            self.ground_truth.append(screened.samples, screened.cuts)
            self._fresh.append(screened.samples)
            self._turned.add(screened.samples.poses)
            self.presence.add(screened.samples.stamps)
            self.odometer.add(screened.samples.stamps, screened.samples.poses[:, :3, 3])

    def fresh(self) -> tuple[Samples, ...]:
        """The samples that were let in since it was last asked."""
        found, self._fresh = tuple(self._fresh), []
        return found

    @property
    def has_orientation(self) -> bool:
        """Whether there are orientations, as far as it shows: they are given, and change."""
        return not (self.lacks_orientation or self.never_turns)

    def learned(self, of_positions: bool) -> tuple[Notice, ...]:
        """What has been learned, if it is to be; ``of_positions`` alone, where there is no more."""
        hyperparameters = self.ground_truth.hyperparameters
        if hyperparameters is None or not self._learned:
            return ()
        fit = self.ground_truth.fit
        # Each estimate asks, and the words cost more than the rest of what it asks for.
        if self._lesson is None or self._lesson[0] is not hyperparameters:
            self._lesson = (hyperparameters, _described(hyperparameters))
        text = self._lesson[1]
        if of_positions:
            text = text[: text.index(_OF_ROTATION)]
        found = [Notice("info", LEARNED, text)]
        if fit is not None and fit.stamp_std:
            text = f"the ground truth's stamps are uncertain to {1e3 * fit.stamp_std:.2g} ms"
            found.append(
                Notice("info", "ground_truth_stamps", f"{text}: counted as noise along the motion")
            )
        return tuple(found)

    @property
    def faults(self) -> tuple[Fault, ...]:
        """What is wrong with the ground truth, in the order of :data:`EXPLANATIONS`."""
        account, fit = self._intake.account, self.ground_truth.fit
        repeated = account.count(Reason.DUPLICATE_STAMP) / max(account.received, 1)
        of_stamps = self._stamping.faults(0.0 if fit is None else fit.stamp_std, repeated)
        found = {fault.code: fault for fault in (*self._faults.found, *of_stamps)}
        return tuple(found[code] for code in EXPLANATIONS if code in found)

    def faulty(self) -> tuple[Notice, ...]:
        """What is wrong with the ground truth, or may be."""
        faults = self.faults
        named = tuple(
            Notice(
                "warning",
                f"{_OF_GROUND_TRUTH}{fault.code}",
                f"ground truth: {fault.text} ({_when(fault)})",
            )
            for fault in faults
        )
        if not self._stamping.is_whole_seconds or any(f.code == "stamps_quantised" for f in faults):
            return named
        text = (
            "the ground truth's stamps are whole seconds: right for satellites' epochs; if they "
            "were rounded, all of them are off by up to a second"
        )
        return (*named, Notice("info", f"{_OF_GROUND_TRUTH}whole_seconds", text))

    def health(self) -> TopicHealth:
        """Return the topic's account."""
        account = self._intake.account
        held = self._intake.held + len(self._disorder.held)
        held += len(self._stamping.held) + len(self._screen.held)
        used = account.received - account.rejected_total - held
        return self._intake.health(used, held)


def _when(fault: Fault) -> str:
    """The stamps of a fault, as its topic or file has them."""
    begin, end = f"{fault.begin * 1e-9:.3f} s", f"{fault.end * 1e-9:.3f} s"
    return f"at {begin}" if begin == end else f"{begin} to {end}"


def is_of_ground_truth(notice: Notice) -> bool:
    """Whether a notice is the same for every estimate."""
    return notice.code == LEARNED or notice.code.startswith(_OF_GROUND_TRUTH)


def _described(hyperparameters: Hyperparameters) -> str:
    groups = ((hyperparameters.translation, "m"), (hyperparameters.rotation, "rad"))
    texts = []
    for name, (group, unit) in zip(("translation", "rotation"), groups, strict=True):
        parts = [f"{c.std:.3g} {unit} over {c.length_scale:.3g} s" for c in group.components]
        texts.append(f"{name} {' + '.join(parts)}, noise {group.noise_std:.3g} {unit}")
    return "learned " + "; ".join(texts)
