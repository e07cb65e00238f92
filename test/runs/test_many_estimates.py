# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Of many estimates a terminal has the pairs of the best."""

from __future__ import annotations

import itertools
from typing import Any

from trajeval_ros.runs.several import against_the_best


class Pair:
    """As much of a comparison as is looked at."""

    def __init__(self, a: str, b: str) -> None:
        self.a, self.b = a, b


def test_of_many_the_best_with_each() -> None:
    errors: dict[str, float | None] = {"p": 0.3, "q": 0.1, "r": None, "s": 0.2}
    summaries = {n: {"conventional": {"ate_translation_rmse": e}} for n, e in errors.items()}
    pairs: list[Any] = [Pair(a, b) for a, b in itertools.combinations(errors, 2)]
    said = [*(f"{one.a} {one.b}" for one in pairs), "a cause"]
    found = against_the_best(summaries, pairs, said)
    assert found[:3] == ("p q", "q r", "q s")
    assert found[3].startswith("Each with q, whose ATE is the smallest")
    assert found[4:] == ("a cause",)
    # Of three all, and where the words have failed what there is.
    few = dict(itertools.islice(summaries.items(), 3))
    assert against_the_best(few, pairs[:3], said[:3]) == tuple(said[:3])
    assert against_the_best(summaries, pairs, ["a cause"]) == ("a cause",)
