# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A chain's loops in C say what NumPy says, which has another way: a factor for a filter."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros import loops
from trajeval_ros.error_model.factored import Factored
from trajeval_ros.error_model.filtered import FILTERED, SMOOTHED, Filtered
from trajeval_ros.error_model.process import Kind
from trajeval_ros.error_model.series import Series

pytestmark = pytest.mark.skipif(not loops.there(), reason="not built, or switched off")


def logs(low, high):
    return st.floats(np.log(low), np.log(high))


# Neither noise so small beside the other that NumPy loses it in a difference.
PARAMETERS = {
    Kind.DRIFT: st.tuples(logs(1e-3, 5e-3), logs(1e-2, 0.1)),
    Kind.VELOCITY: st.tuples(logs(1e-3, 5e-3), logs(1e-2, 0.1), logs(1e-2, 0.3), logs(0.02, 3.0)),
    Kind.WANDER: st.tuples(logs(1e-3, 5e-3), logs(1e-2, 0.1), logs(0.02, 10.0)),
}


@st.composite
def chains(draw):
    """A process, and errors of irregular poses with outliers, as it may be far from."""
    kind = draw(st.sampled_from(list(Kind)))
    count = draw(st.one_of(st.integers(2, 5), st.integers(6, 200)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    intervals = rng.uniform(0.02, 0.2, count - 1)
    if draw(st.booleans()):
        intervals[rng.integers(count - 1)] = draw(st.sampled_from([0.01, 5.0]))
    errors = np.cumsum(1e-2 * rng.normal(size=(3, count)), axis=1)
    errors += draw(st.sampled_from([0.0, 0.1])) + 1e-3 * rng.normal(size=(3, count))
    weights = [np.exp(3.0 * np.maximum(rng.normal(size=n) - 1.5, 0.0)) for n in (count, count - 1)]
    variance = draw(st.sampled_from([1e-9, 1e-6, 1e-4])) * rng.uniform(0.5, 2.0, count)
    return kind, np.array(draw(PARAMETERS[kind])), Series(intervals, errors, variance, *weights)


def assert_close(found, expected, scale=None):
    scale = np.abs(expected).max(initial=1e-300) if scale is None else scale
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * scale)


@given(chains())
def test_both_say_the_same(chain):
    found, expected = Filtered(*chain), Factored(*chain)
    series = chain[2]
    size = max(float(np.abs(expected.residual).max()), float(np.abs(series.errors).max()) * 1e-3)
    assert_close(found.value, expected.value, max(abs(expected.value), series.errors.size))
    assert_close(found.states, expected.states, max(size, np.abs(expected.states).max()))
    assert_close(found.residual, expected.residual, size)
    assert_close(found.moves, expected.moves)
    assert_close(found.noise, expected.noise)
    assert_close(found.gradient(), expected.gradient(), max(np.abs(expected.gradient()).max(), 1.0))
    assert_close(found.average_information(), expected.average_information())
    jitter = series.measured * np.exp(2.0 * chain[1][0])
    for part, (own, least) in enumerate(
        [(jitter, jitter + series.variance), (expected.noise,) * 2]
    ):
        pairs = [each.disturbances()[2 * part : 2 * part + 2] for each in (found, expected)]
        # What is known of each, and its score, as shares of what the neighbours' places would tell.
        known = [1.0 / (rest + own) for _, rest in pairs]
        scores = [np.sqrt(square) * each for (square, _), each in zip(pairs, known, strict=True)]
        assert_close(known[0] * least, known[1] * least, 1.0)
        assert_close(*scores)
    columns = np.random.default_rng(1).normal(size=(series.errors.shape[1], 3, 2))
    columns[..., 1] += 1.0
    # NumPy has them as a difference from these.
    squares = float(((columns**2).sum(axis=(1, 2)) / (series.variance + jitter)).max())
    assert_close(found.products(columns), expected.products(columns), squares)
    assert_close(found.smoothed(columns), expected.smoothed(columns))


def test_records_are_as_long_as_in_c():
    assert 8 * loops.call("chain_filtered_size") == FILTERED.itemsize
    assert 8 * loops.call("chain_smoothed_size") == SMOOTHED.itemsize


def dense(mp, kind, parameters, series):
    """Log L, P and V, to as many digits as mpmath has, by the errors' covariance V."""
    count = len(series.variance)
    jitter, *own = [mp.exp(2 * each) for each in parameters]
    cov, noise = mp.zeros(count), mp.zeros(count)
    time = mp.exp(parameters[-1])
    state = mp.zeros(2)
    if kind is not Kind.DRIFT:
        state[1, 1] = own[-2]
    steps = []
    for interval, factor in zip(series.intervals, series.moved, strict=True):
        dt, factor = mp.mpf(float(interval)), mp.mpf(float(factor))
        f, q = mp.matrix([[1, 0], [0, 0]]), mp.zeros(2)
        if kind is not Kind.WANDER:
            q[0, 0] = dt * own[0] * factor
        if kind is not Kind.DRIFT:
            a, variance = mp.exp(-dt / time), own[-2]
            q[1, 1] = variance * (1 - a * a)
            f[1, 1] = a
            if kind is Kind.VELOCITY:
                f[0, 1] = time * (1 - a)
                integral = 2 * dt / time - 3 + 4 * a - a * a
                q[0, 0] += variance * time**2 * integral * factor
                q[0, 1] = q[1, 0] = variance * time * (1 - a) ** 2
            else:
                q[1, 1] *= factor
        steps.append((f, q))
    seen = 1 if kind is Kind.WANDER else 0
    for i in range(count):
        across = state.copy()
        for j in range(i, count):
            cov[i, j] = cov[j, i] = across[seen, seen]
            if j < count - 1:
                across = steps[j][0] * across
        if i < count - 1:
            f, q = steps[i]
            state = f * state * f.T + q
        noise[i, i] = mp.mpf(float(series.variance[i])) + jitter * mp.mpf(float(series.measured[i]))
    cov += noise
    inverse, ones = cov**-1, mp.ones(count, 1)
    told = (ones.T * inverse * ones)[0]
    projected = inverse - inverse * ones * ones.T * inverse / told
    squares = sum((z * projected * z.T)[0] for z in (row(mp, each) for each in series.errors))
    return -(squares + 3 * (mp.log(mp.det(cov)) + mp.log(told))) / 2, projected, cov


def row(mp, values):
    return mp.matrix([[mp.mpf(float(each)) for each in values]])


EXTREME = {
    Kind.DRIFT: [(1e-1, 1e-6), (1e-7, 1.0), (1e-7, 1e-7), (1e3, 1e3)],
    Kind.VELOCITY: [(1e-1, 1e-6, 1e-6, 0.01), (1e-7, 1e-7, 0.1, 1e3), (1e-7, 0.1, 1e-4, 0.05)],
    Kind.WANDER: [(1e-1, 1e-6, 1.0), (1e-7, 1.0, 0.3), (1e-7, 1.0, 1e4), (1e-5, 1e-7, 0.01)],
}


@pytest.mark.parametrize(
    ("kind", "sizes"), [(kind, sizes) for kind in Kind for sizes in EXTREME[kind]]
)
def test_no_digits_are_lost_where_one_noise_is_nothing_beside_the_other(kind, sizes):
    mp = pytest.importorskip("mpmath")
    rng = np.random.default_rng(4)
    count = 5
    parameters = np.log(sizes)
    series = Series(
        np.array([0.05, 0.002, 5.0, 1e6]),
        100.0 + 1e-2 * rng.normal(size=(3, count)),
        1e-9 * rng.uniform(0.5, 2.0, count),
        np.array([1.0, 1.0, 50.0, 1.0, 1.0]),
        np.array([1.0, 2.0, 1.0, 1.0]),
    )
    found = Filtered(kind, parameters, series)
    with mp.workdps(80):
        exact = [mp.mpf(float(each)) for each in parameters]
        value, projected, _ = dense(mp, kind, exact, series)
        step = mp.mpf(10) ** -25
        slopes, gradient = [], []
        for j in range(len(exact)):
            ends = []
            for sign in (1, -1):
                there = list(exact)
                there[j] += sign * step
                ends.append(dense(mp, kind, there, series))
            gradient.append((ends[0][0] - ends[1][0]) / (2 * step))
            slopes.append((ends[0][2] - ends[1][2]) / (2 * step))
        variates = [[row(mp, z) * projected * slope for slope in slopes] for z in series.errors]
        information = [
            [
                float(sum((v[i] * projected * v[j].T)[0] for v in variates) / 2)
                for j in range(len(exact))
            ]
            for i in range(len(exact))
        ]
        gradient = [float(each) for each in gradient]
    assert_close(found.value, float(value), max(abs(float(value)), 15.0))
    assert_close(found.gradient(), np.array(gradient))
    assert_close(found.average_information(), np.array(information))
    assert all(np.isfinite(each).all() for each in found.disturbances())


def put(name, number, value):
    def changed(series):
        array = getattr(series, name).copy()
        array[..., number] = value
        return series._replace(**{name: array})

    return changed


@pytest.mark.parametrize("kind", list(Kind))
@pytest.mark.parametrize(
    "broken",
    [
        put("errors", 3, np.nan),
        put("errors", 0, np.inf),
        put("variance", 2, np.nan),
        put("variance", 2, -1.0),
        put("intervals", 1, 0.0),
        put("intervals", 1, -0.1),
        put("intervals", 1, np.nan),
        put("measured", 4, np.nan),
        put("measured", 4, np.inf),
        put("moved", 1, 0.0),
        put("moved", 1, np.nan),
    ],
)
@pytest.mark.parametrize("arithmetic", [Factored, Filtered])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_where_there_is_no_likelihood_both_say_so(kind, broken, arithmetic):
    rng = np.random.default_rng(1)
    series = Series(
        np.full(7, 0.1), rng.normal(size=(3, 8)), np.full(8, 1e-6), np.ones(8), np.ones(7)
    )
    parameters = np.log([1e-2, 1e-2, 0.1, 1.0][: len(kind.names)])
    assert np.isfinite(arithmetic(kind, parameters, series).value)
    with pytest.raises(np.linalg.LinAlgError):
        arithmetic(kind, parameters, broken(series))


@pytest.mark.parametrize("kind", list(Kind))
def test_one_pose_alone_tells_of_its_process_what_numpy_says(kind):
    series = Series(np.empty(0), np.ones((3, 1)), np.ones(1), np.ones(1), np.empty(0))
    parameters = np.log([1e-2, 1e-2, 0.1, 1.0][: len(kind.names)])
    found, expected = Filtered(kind, parameters, series), Factored(kind, parameters, series)
    np.testing.assert_allclose(found.value, expected.value, atol=1e-12)
    np.testing.assert_allclose(found.gradient(), expected.gradient(), atol=1e-9)
