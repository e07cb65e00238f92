# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""BLAS has one thread while something is evaluated, and as many as before otherwise."""

from collections.abc import Iterator

import numpy as np
import pytest

import trajeval_ros as te
from trajeval_ros import blas
from trajeval_ros.online.engine import Engine


@pytest.fixture
def two_threads() -> Iterator[list[int]]:
    """Two threads for every BLAS there is; yields how many each has."""
    pools = blas._pools()
    if not pools:
        pytest.skip("there is no OpenBLAS here that can be asked")
    before = [get() for get, _ in pools]
    for _, put in pools:
        put(2)
    if any(get() != 2 for get, _ in pools):
        pytest.skip("this OpenBLAS has one thread at the most")
    yield [2] * len(pools)
    for (_, put), count in zip(pools, before, strict=True):
        put(count)


def counts() -> list[int]:
    return [get() for get, _ in blas._pools()]


def test_threads_are_given_back_also_after_an_error(two_threads: list[int]) -> None:
    seen: list[int] = []
    with pytest.raises(ZeroDivisionError), blas.one_thread():
        seen += [*counts(), 1 // 0]
    assert seen == []
    assert counts() == two_threads
    with blas.one_thread():
        seen += counts()
    assert seen == [1] * len(two_threads)
    assert counts() == two_threads


def test_an_evaluation_has_one(two_threads: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    advance = Engine.advance_all

    def watched(self: Engine, now: int | None) -> object:
        seen.append(counts())
        return advance(self, now)

    monkeypatch.setattr(Engine, "advance_all", watched)
    time = np.arange(0.0, 10.0, 0.05)
    poses = np.tile(np.eye(4), (len(time), 1, 1))
    poses[:, :3, 3] = np.stack([np.cos(time), np.sin(2 * time), np.sin(time)], axis=1)
    te.evaluate(te.Trajectory(time, poses), te.Trajectory(time, poses))
    assert seen
    assert all(each == [1] * len(two_threads) for each in seen)
    assert counts() == two_threads


def test_without_a_list_of_libraries_nothing_happens(
    monkeypatch: pytest.MonkeyPatch, tmp_path: object
) -> None:
    monkeypatch.setattr(blas, "_MAPS", blas.Path(str(tmp_path)) / "none")
    with blas.one_thread():
        assert blas._pools() == []
