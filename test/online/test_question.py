# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What several ask is answered once, and as if each had asked alone."""

import numpy as np
from twins.runs import FIXED, SECOND, START, motion, samples

from trajeval_ros.online.engine import Engine
from trajeval_ros.online.question import Question, answered

EVERY = START + np.arange(20, 180) * (SECOND // 20)
"""Stamps half way between those of a ground truth of 10 Hz, and at them."""


class Asked:
    """A ground truth of ten seconds that counts what it is asked."""

    def __init__(self):
        engine = Engine(FIXED, whole=True)
        stamps = START + np.arange(120) * (SECOND // 10)
        engine.add_ground_truth(samples(stamps, motion((stamps - START) / SECOND)))
        engine.finish()
        self.truth = engine._reference.ground_truth
        self.count = 0

    def __call__(self, stamps, until):
        self.count += len(stamps)
        return self.truth.posterior(stamps, until, twists=True)


def question(stamps, later=1):
    return Question(stamps, stamps + later * SECOND)


def test_those_who_ask_the_same_hold_the_same_arrays():
    ask = Asked()
    first, none, again = answered(
        [question(EVERY), question(EVERY[:0]), question(EVERY.copy())], ask
    )
    assert none is None
    assert first.poses is again.poses
    assert ask.count == len(EVERY)


def test_what_some_have_in_common_is_asked_once():
    ask = Asked()
    parts = [EVERY[::2], EVERY[::3], EVERY[5:50]]
    answers = answered([question(part) for part in parts], ask)
    assert ask.count == len(np.unique(np.concatenate(parts)))
    for part, answer in zip(parts, answers, strict=True):
        alone = ask(part, part + SECOND)
        np.testing.assert_allclose(answer.poses, alone.poses, rtol=0, atol=1e-12)
        np.testing.assert_allclose(answer.covariances, alone.covariances, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(answer.twists.means, alone.twists.means, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(answer.sampled, alone.sampled)


def test_the_same_stamp_by_other_samples_is_another_question():
    """As when the wait is changed on the way: one pose had waited longer than the other."""
    ask = Asked()
    here = EVERY[:4]
    soon, late = answered([Question(here, here + SECOND // 10), Question(here, here + SECOND)], ask)
    alone = ask(here, here + SECOND)
    np.testing.assert_allclose(late.covariances, alone.covariances, rtol=1e-9, atol=1e-15)
    assert not np.allclose(soon.covariances, late.covariances, rtol=1e-3, atol=0)
