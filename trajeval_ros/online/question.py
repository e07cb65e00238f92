# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What estimates ask of the ground truth, all at once and nothing twice."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.ground_truth.joint import JointCovariance
from trajeval_ros.ground_truth.trajectory import Posterior

Stamps = npt.NDArray[np.int64]
Ask = Callable[[Stamps, Stamps], Posterior]


class Question(NamedTuple):
    """The ground truth at ``stamps`` (n,), ns, by the samples up to ``until`` (n,); ``joint``ly."""

    stamps: Stamps
    until: Stamps
    joint: JointCovariance | None = None


def answered(questions: Sequence[Question], ask: Ask) -> list[Posterior | None]:
    """The answer to each question, none of them joint; None where nothing is asked.

    Repetitions of a run, and systems that answer the same images, have stamps in common. What
    several ask is answered once; those that ask all the same hold the same arrays.
    """
    asked = [question for question in questions if len(question.stamps)]
    distinct = {_content(question): question for question in asked}
    if not distinct:
        return [None] * len(questions)
    parts = dict(zip(distinct, _divided(distinct.values(), ask), strict=True))
    return [parts[_content(q)] if len(q.stamps) else None for q in questions]


def _content(question: Question) -> tuple[bytes, bytes]:
    return question.stamps.tobytes(), question.until.tobytes()


def _divided(questions: Iterable[Question], ask: Ask) -> list[Posterior]:
    """The answers to questions that differ; of one alone, the answer itself."""
    several = list(questions)
    if len(several) == 1:
        return [ask(several[0].stamps, several[0].until)]
    stamps, until = (
        np.concatenate([getattr(question, part) for question in several])
        for part in ("stamps", "until")
    )
    _, first, place = np.unique(stamps, return_index=True, return_inverse=True)
    if not np.array_equal(until[first][place], until):
        first = place = np.arange(len(stamps))
    answer = ask(stamps[first], until[first])
    ends = np.cumsum([len(question.stamps) for question in several])
    return [answer[part] for part in np.split(place, ends[:-1])]
