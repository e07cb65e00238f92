# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Degenerate poses: a documented refusal, a status, or finite figures; never a NaN or a warning."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from twins.degenerate import pairs

from trajeval_ros.alignment import umeyama
from trajeval_ros.alignment.gauge import GAUGES
from trajeval_ros.conventional.running import RunningConventional
from trajeval_ros.diagnosis.causes import likely_causes
from trajeval_ros.likelihood.absolute import RunningAbsolute, absolute
from trajeval_ros.likelihood.noise_equivalent import noise_equivalent_error
from trajeval_ros.likelihood.relative import RunningRelative, relative

SECOND = 1_000_000_000


pytestmark = pytest.mark.filterwarnings("error")


def numbers(value):
    """Every number in a result."""
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from numbers(getattr(value, field.name))
    elif isinstance(value, tuple):
        for each in value:
            yield from numbers(each)
    elif isinstance(value, float | np.floating | np.ndarray):
        yield from np.ravel(value).tolist()


def finite(value):
    return all(np.isfinite(number) for number in numbers(value))


def covariances(count):
    return np.tile(np.diag([1e-4] * 3 + [1e-5] * 3), (count, 1, 1))


def stamps_of(seconds):
    return 1_700_000_000 * SECOND + np.rint(seconds * SECOND).astype(np.int64)


@given(pairs(), st.sampled_from(umeyama.GAUGES))
def test_umeyama(pair, gauge):
    _, truth, estimate = pair
    found = umeyama.align_positions(estimate[:, :3, 3], truth[:, :3, 3], gauge)
    assert finite(found)
    assert found.scale > 0
    np.testing.assert_allclose(found.rotation @ found.rotation.T, np.eye(3), atol=1e-9)
    if len(truth) < (2 if gauge == "yaw_translation" else 3) and gauge != "none":
        assert found.degeneracy is umeyama.Degeneracy.TOO_FEW_POINTS


@given(pairs(), st.sampled_from(sorted(GAUGES)))
def test_absolute(pair, gauge):
    _, truth, estimate = pair
    found = absolute(truth, covariances(len(truth)), estimate, GAUGES[gauge])
    known = found.observability.scale_observed
    assert (found.likelihood is not None) == known
    assert finite(found.likelihood)
    assert finite(found.residual)
    assert finite(found.alignment)
    assert finite(found.covariance if known else found.covariance[:6, :6])
    running = RunningAbsolute(GAUGES[gauge])
    for piece in (slice(0, 1), slice(1, None)):
        running.update(truth[piece], covariances(len(truth))[piece], estimate[piece])
    assert finite(running.total)
    assert finite(running.alignment)
    assert not np.isnan(running.covariance).any()


@given(pairs())
def test_relative(pair):
    _, truth, estimate = pair
    assert finite(relative(truth, covariances(len(truth)), estimate))
    running = RunningRelative()
    assert finite(running.update(truth, covariances(len(truth)), estimate))
    assert finite(running.total)


@given(pairs(), st.sampled_from(umeyama.GAUGES), st.sampled_from(["s", "m"]))
def test_conventional(pair, gauge, unit):
    seconds, truth, estimate = pair
    running = RunningConventional(gauge, 0.5, unit)
    running.update(stamps_of(seconds), truth, estimate)
    assert finite(running.figures())
    assert finite(running.distributions())


@given(pairs(), st.sampled_from(sorted(GAUGES)))
def test_noise_equivalent(pair, gauge):
    _, truth, estimate = pair
    covariance = covariances(len(truth))
    found = absolute(truth, covariance, estimate, GAUGES[gauge])
    used = GAUGES[gauge]
    if not found.observability.scale_observed:
        used = used.without_scale()
    if 6 * len(truth) < used.dimension + 2:
        with pytest.raises(ValueError, match="too few"):
            noise_equivalent_error(truth, covariance, estimate, used, found.alignment)
        return
    noise = noise_equivalent_error(truth, covariance, estimate, used, found.alignment)
    assert finite(noise)
    assert min(noise.translation_std, noise.rotation_std) >= 0


@given(pairs(counts=(30, 90, 400)), st.sampled_from(umeyama.GAUGES))
def test_likely_causes(pair, gauge):
    seconds, truth, estimate = pair
    for cause in likely_causes(stamps_of(seconds), truth, estimate, gauge):
        assert "nan" not in cause.sentence
        assert "inf " not in cause.sentence
