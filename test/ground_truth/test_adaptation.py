# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros import loops
from trajeval_ros.ground_truth.adaptation import Watch


def looked(squares, telling, cuts):
    """What a watch says of each batch, as long as it says nothing, and which rows are left."""
    watch, said = Watch(), []
    for begin, end in zip([0, *cuts], [*cuts, len(squares)], strict=True):
        said.append(watch.look(squares[begin:end], telling[begin:end]))
        if said[-1] is not None:
            watch.restart(said[-1][0] + 1)
            said.append(
                watch.look(squares[watch.looked - 1 : end], telling[watch.looked - 1 : end])
            )
            break
    return said, watch.looked


@pytest.mark.skipif(not loops.there(), reason="not built, or switched off")
@given(
    count=st.integers(0, 120),
    before=st.floats(0.001, 30.0),
    after=st.floats(0.001, 100.0),
    share=st.floats(0.0, 1.0),
    cuts=st.sets(st.integers(0, 120), max_size=3),
    seed=st.integers(0, 999),
)
def test_the_loop_raises_where_numpy_does(count, before, after, share, cuts, seed):
    rng = np.random.default_rng(seed)
    scale = np.where(np.arange(count) < count // 2, before, after)
    squares, telling = scale * rng.chisquare(3, count), rng.uniform(size=count) < share
    cuts = sorted(cut for cut in cuts if cut <= count)
    found = looked(squares, telling, cuts)
    with loops.left_out():
        assert looked(squares, telling, cuts) == found
    if all(each is None for each in found[0]):
        assert looked(squares, telling, []) == ([None], 1 + count)


def test_a_change_is_raised_at_the_row_that_shows_it_with_the_one_it_began_at():
    squares = np.array([0.0] * 20 + [200.0] * 5)
    assert Watch().look(squares, np.zeros(25, dtype=bool)) == (21, 21)
    assert Watch().look(np.full(200, 1e-3), np.ones(200, dtype=bool)) is not None
    # What does not tell is no sign of a process that promises too little.
    assert Watch().look(np.full(200, 1e-3), np.zeros(200, dtype=bool)) is None
