# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""SE(3): against power series in 60 digits, and the identities that define the maps.

One harness of inputs, `batches`: every batch shape, filled from every kind of tangent vector
that a formula could fail at. Tolerances are multiples of the float64 spacing EPS at the size of
what is compared, small rotations included: an error of 1e-26 in a rotation of 1e-12 fails.
"""

from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from twins import se3_twin as twin

from trajeval_ros import loops, se3

Array = npt.NDArray[np.float64]

EPS = float(np.finfo(np.float64).eps)
SHAPES: tuple[tuple[int, ...], ...] = ((), (1,), (3,), (2, 3), (0,), (2, 0))


@pytest.fixture(autouse=True, scope="module")
def _no_floating_point_warnings() -> Iterator[None]:
    # Underflow is no fault: the high powers of a small angle are zero.
    with np.errstate(divide="raise", over="raise", invalid="raise"):
        yield


# --------------------------------------------------------------------------------------------
# Inputs
# --------------------------------------------------------------------------------------------
def _unit(v: tuple[float, float, float]) -> Array:
    norm = float(np.linalg.norm(v))
    return np.array(v) / norm if norm > 0.1 else np.array([1.0, 0.0, 0.0])


def _log_uniform(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(float(np.log10(low)), float(np.log10(high))).map(lambda e: float(10.0**e))


_DIRECTIONS = st.tuples(*[st.floats(-1.0, 1.0, allow_subnormal=False)] * 3).map(_unit)


def _tangents(
    length: st.SearchStrategy[float], angle: st.SearchStrategy[float]
) -> st.SearchStrategy[Array]:
    return st.builds(
        lambda metres, u, radians, v: np.concatenate([metres * u, radians * v]),
        length,
        _DIRECTIONS,
        angle,
        _DIRECTIONS,
    )


_NONE = st.just(0.0)
_LENGTHS = st.one_of(_NONE, st.floats(0.01, 10.0), _log_uniform(1e-9, 10.0))
_SMALL_ANGLES = _log_uniform(1e-12, 1.0)
_ANGLES = st.floats(0.01, np.pi)
_NEAR_PI = st.integers(1, 17).map(lambda k: float(np.pi - 10.0**-k))

TANGENTS = {
    "zero": st.just(np.zeros(6)),
    "pure translation": _tangents(_LENGTHS, _NONE),
    "pure rotation": _tangents(_NONE, st.one_of(_SMALL_ANGLES, _ANGLES, _NEAR_PI)),
    "small rotation": _tangents(_LENGTHS, _SMALL_ANGLES),
    "any rotation": _tangents(_LENGTHS, _ANGLES),
    "about where the series end": _tangents(_LENGTHS, st.floats(1.999, 2.001)),
    "near pi": _tangents(_LENGTHS, _NEAR_PI),
    "large translation": _tangents(
        _log_uniform(10.0, 1e7), st.one_of(_NONE, _SMALL_ANGLES, _ANGLES, _NEAR_PI)
    ),
}
BEYOND_PI = _tangents(_LENGTHS, st.floats(np.pi, 6.0))


@st.composite
def batches(draw: st.DrawFn, count: int | None = None) -> Array:
    """A batch of tangent vectors, (..., 6), or so many of one shape, (count, ..., 6)."""
    shape = draw(st.sampled_from(SHAPES))
    full = shape if count is None else (count, *shape)
    drawn = [draw(st.one_of(*TANGENTS.values())) for _ in range(int(np.prod(full, dtype=int)))]
    return np.array(drawn).reshape(*full, 6)


def elements(batch: Array, dimensions: int) -> Array:
    """A batch of vectors (1 dimension) or matrices (2), in a row."""
    return batch.reshape(-1, *batch.shape[batch.ndim - dimensions :])


def sample(shape: tuple[int, ...], seed: int = 0) -> Array:
    """Tangent vectors, with angles evenly from 0 to pi, for what needs no search."""
    rng = np.random.default_rng(seed)
    xi = rng.standard_normal((*shape, 6))
    angle = np.pi * rng.random((*shape, 1))
    xi[..., 3:] *= angle / np.linalg.norm(xi[..., 3:], axis=-1, keepdims=True)
    return xi


# --------------------------------------------------------------------------------------------
# The size of what round-off is relative to
# --------------------------------------------------------------------------------------------
def _rotation_size(xi: Array) -> Array:
    """1 on the diagonal of a function of hat(phi), the angle beside it, (..., 3, 3)."""
    angle = np.linalg.norm(xi[..., 3:], axis=-1)[..., None, None]
    return np.where(np.eye(3) == 1.0, 1.0, np.minimum(angle, 1.0))


def _pose_size(xi: Array) -> Array:
    out = np.zeros((*xi.shape[:-1], 4, 4))
    out[..., :3, :3] = _rotation_size(xi)
    out[..., :3, 3] = np.linalg.norm(xi[..., :3], axis=-1)[..., None]
    return out


def _jacobian_size(xi: Array) -> Array:
    out = np.zeros((*xi.shape[:-1], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = _rotation_size(xi)
    out[..., :3, 3:] = np.linalg.norm(xi[..., :3], axis=-1)[..., None, None]
    return out


def assert_close(actual: Array, expected: Array, size: Array | float, spacings: float) -> None:
    assert actual.shape == expected.shape
    error = np.abs(actual - expected)
    assert (error <= spacings * EPS * np.asarray(size)).all(), (
        f"off by {np.max(error - spacings * EPS * np.asarray(size))} more than allowed"
    )


def assert_exact(actual: Array, expected: twin.Exact, size: Array, spacings: float) -> None:
    error = twin.distance(actual, expected)
    assert (error <= spacings * EPS * size).all(), f"{error / EPS} spacings, of {size}"


# --------------------------------------------------------------------------------------------
# Against the twins
# --------------------------------------------------------------------------------------------
def test_hat_is_the_cross_product() -> None:
    v, u = sample((2, 5)), sample((2, 5), seed=1)
    np.testing.assert_allclose(
        (se3.hat(v[..., :3]) @ u[..., :3, None])[..., 0],
        np.cross(v[..., :3], u[..., :3]),
        rtol=0.0,
        atol=4.0 * EPS,
    )


@given(batches())
def test_exp(xi: Array) -> None:
    pose = se3.exp(xi)
    assert pose.shape == (*xi.shape[:-1], 4, 4)
    assert_close(se3.exp_so3(xi[..., 3:]), pose[..., :3, :3], 1.0, 4.0)
    for x, t in zip(elements(xi, 1), elements(pose, 2), strict=True):
        assert_exact(t, twin.exp(x), _pose_size(x), 6.0)


@given(batches())
def test_jacobians(xi: Array) -> None:
    left, left_inverse = se3.left_jacobian(xi), se3.left_jacobian_inverse(xi)
    assert left.shape == left_inverse.shape == (*xi.shape[:-1], 6, 6)
    assert_close(se3.right_jacobian(xi), se3.left_jacobian(-xi), _jacobian_size(xi), 4.0)
    of_rotation = se3.right_jacobian(xi)[..., 3:, 3:]
    assert_close(se3.right_jacobian_so3(xi[..., 3:]), of_rotation, 1.0, 4.0)
    assert_close(
        se3.right_jacobian_inverse(xi), se3.left_jacobian_inverse(-xi), _jacobian_size(xi), 4.0
    )
    for x, j, i in zip(elements(xi, 1), elements(left, 2), elements(left_inverse, 2), strict=True):
        expected = twin.left_jacobian(x)
        assert_exact(j, expected, _jacobian_size(x), 6.0)
        assert_exact(i, twin.matrix_inverse(expected), _jacobian_size(x), 8.0)


@given(BEYOND_PI)
def test_angles_beyond_pi(xi: Array) -> None:
    # Towards 2 pi the inverse grows without bound, and with it its condition.
    assert_exact(se3.exp(xi), twin.exp(xi), _pose_size(xi), 8.0)
    expected = twin.left_jacobian(xi)
    assert_exact(se3.left_jacobian(xi), expected, _jacobian_size(xi), 8.0)
    size = np.abs(twin.matrix_inverse(expected).astype(np.float64)).max()
    assert_exact(se3.left_jacobian_inverse(xi), twin.matrix_inverse(expected), size, 100.0)


def test_many_turns() -> None:
    xi = np.array([[1.0, 0.0, 0.0, 0.0, 2e6 * np.pi, 0.5], [0.0, 1.0, 0.0, 1e30, 0.0, 0.0]])
    for pose in se3.exp(xi):
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=8.0 * EPS)
    assert np.isfinite(se3.left_jacobian(xi)).all()


def test_coefficients() -> None:
    # A Jacobian hides the small ones, D' above all, so here each by itself.
    angles = [*np.geomspace(1e-12, np.pi, 200), *np.linspace(1.98, 2.02, 41), 4.0, 6.0]
    x = np.square(angles)
    columns = (*se3._exponential_coefficients(x), *se3._logarithm_coefficients(x))
    actual = np.stack([column[:, 0, 0] for column in columns], axis=-1)
    for row, one in zip(actual, x, strict=True):
        expected = twin.coefficients(float(one))
        size = np.abs(expected.astype(np.float64))
        size[0] = 1.0  # A and B' pass zero beyond pi, A at pi
        size[3] = max(size[3], 0.01)
        assert_exact(row, expected, size * [2.0, 4.0, 4.0, 12.0, 24.0, 6.0, 64.0], 1.0)


def test_coefficients_at_zero() -> None:
    zero = np.zeros(())
    actual = (*se3._exponential_coefficients(zero), *se3._logarithm_coefficients(zero))
    assert [float(c[0, 0]) for c in actual] == [1, 1 / 2, 1 / 6, -1 / 12, -1 / 60, 1 / 12, 1 / 360]


@given(batches())
def test_log(xi: Array) -> None:
    for x in elements(xi, 1):
        pose = twin.exp(x).astype(np.float64)
        actual = se3.log(pose)
        angle, length = np.linalg.norm(x[3:]), np.linalg.norm(x[:3])
        assert np.linalg.norm(actual[3:]) <= np.pi * (1.0 + EPS)
        assert_close(se3.log_so3(pose[:3, :3]), actual[3:], 4.0, 1.0)
        if angle < np.pi - 1e-14:
            assert_close(actual, x, np.repeat([length, angle], 3), 6.0)
        else:  # the pose as rounded may have turned by less than pi about the opposite axis
            assert_exact(pose, twin.exp(actual), _pose_size(x), 6.0)


def test_against_scipy() -> None:
    for xi in sample((20,)):
        pose = scipy.linalg.expm(twin.wedge(xi))
        np.testing.assert_allclose(se3.exp(xi), pose, rtol=0.0, atol=1e-13)
        logarithm = scipy.linalg.logm(pose).real
        np.testing.assert_allclose(twin.wedge(se3.log(pose)), logarithm, rtol=0.0, atol=1e-10)
        adjoint = scipy.linalg.expm(twin.ad(xi))
        np.testing.assert_allclose(se3.adjoint(se3.exp(xi)), adjoint, rtol=0.0, atol=1e-13)


# --------------------------------------------------------------------------------------------
# Identities
# --------------------------------------------------------------------------------------------
@given(batches())
def test_exp_of_log_is_the_pose(xi: Array) -> None:
    pose = se3.exp(xi)
    assert_close(se3.exp(se3.log(pose)), pose, _pose_size(xi), 12.0)


@given(batches())
def test_inverse(xi: Array) -> None:
    pose = se3.exp(xi)
    assert_close(se3.inverse(pose), se3.exp(-xi), _pose_size(xi), 8.0)
    assert_close(
        se3.compose(pose, se3.inverse(pose)),
        np.broadcast_to(np.eye(4), pose.shape),
        np.maximum(_pose_size(xi), np.eye(4)),
        8.0,
    )


@given(batches(count=2))
def test_adjoint_moves_a_perturbation_to_the_other_side(pair: Array) -> None:
    pose, xi = se3.exp(pair[0]), pair[1]
    moved = (se3.adjoint(pose) @ xi[..., None])[..., 0]
    lengths = np.linalg.norm(pair[..., :3], axis=-1).sum(axis=0)
    size = np.ones(pose.shape)
    size[..., :3, 3] = 1e-300 + lengths[..., None]
    assert_close(
        se3.compose(pose, se3.exp(xi)), se3.compose(se3.exp(moved), pose), 4.0 * size, 32.0
    )


@given(batches())
def test_left_jacobian_is_the_adjoint_times_the_right_one(xi: Array) -> None:
    adjoint = se3.adjoint(se3.exp(xi))
    assert_close(se3.left_jacobian(xi), adjoint @ se3.right_jacobian(xi), _jacobian_size(xi), 24.0)


@given(batches())
def test_jacobian_times_its_inverse(xi: Array) -> None:
    product = se3.right_jacobian(xi) @ se3.right_jacobian_inverse(xi)
    identity = np.broadcast_to(np.eye(6), product.shape)
    assert_close(product, identity, _jacobian_size(xi), 24.0)


def test_jacobians_are_derivatives() -> None:
    h = 1e-6
    xi = sample((50, 1))
    steps = h * np.eye(6)
    pose, back = se3.exp(xi), se3.inverse(se3.exp(xi))
    ahead, behind = se3.exp(xi + steps), se3.exp(xi - steps)

    def derivative(difference: Callable[[Array], Array]) -> Array:
        columns = (difference(ahead) - difference(behind)) / (2.0 * h)
        return np.asarray(columns.swapaxes(-1, -2))

    right = derivative(lambda moved: se3.log(se3.compose(back, moved)))
    np.testing.assert_allclose(se3.right_jacobian(xi[:, 0]), right, rtol=0.0, atol=1e-8)
    left = derivative(lambda moved: se3.log(se3.compose(moved, back)))
    np.testing.assert_allclose(se3.left_jacobian(xi[:, 0]), left, rtol=0.0, atol=1e-8)

    small = sample((50, 1))
    small[..., 3:] *= 0.9  # a step must not cross pi, where the logarithm jumps
    pose = se3.exp(small)
    ahead, behind = se3.exp(steps), se3.exp(-steps)
    right_inverse = derivative(lambda moved: se3.log(se3.compose(pose, moved)))
    np.testing.assert_allclose(
        se3.right_jacobian_inverse(small[:, 0]), right_inverse, rtol=0.0, atol=1e-7
    )
    left_inverse = derivative(lambda moved: se3.log(se3.compose(moved, pose)))
    np.testing.assert_allclose(
        se3.left_jacobian_inverse(small[:, 0]), left_inverse, rtol=0.0, atol=1e-7
    )


# --------------------------------------------------------------------------------------------
# Rotations that are not quite, and half turns
# --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("deviation", [1e-9, 1e-6, 1e-4])
def test_log_is_that_of_the_nearest_rotation(deviation: float) -> None:
    rotation = se3.exp_so3(sample((300,))[:, 3:])
    noise = np.random.default_rng(1).uniform(-1.0, 1.0, rotation.shape)
    distorted = rotation + deviation * noise
    u, _, vt = np.linalg.svd(distorted)
    actual = se3.exp_so3(se3.log_so3(distorted))
    np.testing.assert_allclose(actual, u @ vt, rtol=0.0, atol=4.0 * deviation**2 + 64.0 * EPS)


@pytest.mark.parametrize(
    "axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, -1, 0), (0, 1, -1), (-1, 1, 1)]
)
def test_half_turns(axis: tuple[int, int, int]) -> None:
    n = np.array(axis) / np.linalg.norm(axis)
    half_turn = 2.0 * np.outer(n, n) - np.eye(3)
    phi = se3.log_so3(half_turn)
    assert np.linalg.norm(phi) == pytest.approx(np.pi, rel=2.0 * EPS)
    np.testing.assert_allclose(np.abs(phi @ n), np.pi, rtol=4.0 * EPS)


# --------------------------------------------------------------------------------------------
# Interpolation
# --------------------------------------------------------------------------------------------
@given(batches(count=2))
def test_interpolation_ends_at_its_ends(pair: Array) -> None:
    a, b = se3.exp(pair)
    lengths = np.linalg.norm(pair[..., :3], axis=-1).sum(axis=0)
    size = np.ones(a.shape)
    size[..., :3, 3] = 1e-300 + lengths[..., None]
    zero = np.zeros(a.shape[:-2])
    assert (se3.interpolate(a, b, zero) == a).all()
    assert_close(se3.interpolate(a, b, zero + 1.0), b, size, 48.0)


def test_interpolation_is_at_constant_velocity() -> None:
    a, b = se3.exp(sample((5,))), se3.exp(sample((5,), seed=1))
    weights = np.linspace(-0.5, 1.0, 7)
    path = se3.interpolate(a, b, weights[:, None])
    assert path.shape == (7, 5, 4, 4)
    steps = se3.log(se3.compose(se3.inverse(path[:-1]), path[1:]))
    np.testing.assert_allclose(steps, np.broadcast_to(steps[0], steps.shape), atol=1e-13)
    np.testing.assert_allclose(
        se3.interpolate(a[0], b[0], 0.25), se3.interpolate(b[0], a[0], 0.75), atol=1e-14
    )


# --------------------------------------------------------------------------------------------
# Quaternions
# --------------------------------------------------------------------------------------------
@given(batches())
def test_quaternion_there_and_back(xi: Array) -> None:
    pose = se3.exp(xi)
    position, quaternion = se3.to_position_quaternion(pose)
    assert position.shape == (*xi.shape[:-1], 3)
    assert quaternion.shape == (*xi.shape[:-1], 4)
    assert (position == pose[..., :3, 3]).all()
    assert (quaternion[..., 3] >= 0.0).all()
    assert_close(se3.from_position_quaternion(position, quaternion), pose, _pose_size(xi), 8.0)


def test_quaternion_has_the_scalar_last_and_half_the_angle() -> None:
    _, quaternion = se3.to_position_quaternion(se3.exp(np.array([1, 2, 3, 0, 0, 0.5])))
    np.testing.assert_allclose(quaternion, [0, 0, np.sin(0.25), np.cos(0.25)], atol=EPS)
    turned = se3.from_position_quaternion([0, 0, 0], [0, 0, np.sqrt(0.5), np.sqrt(0.5)])
    np.testing.assert_allclose(turned[:3, 0], [0, 1, 0], atol=2.0 * EPS)


@given(_DIRECTIONS, st.floats(-1.0, 1.0), _log_uniform(1e-300, 1e300))
def test_quaternion_is_normalised(v: Array, w: float, scale: float) -> None:
    quaternion = np.array([*v, w])
    pose = se3.from_position_quaternion(np.zeros(3), quaternion)
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=4.0 * EPS)
    for same in (scale * quaternion, -quaternion):
        rescaled = se3.from_position_quaternion(np.zeros(3), same)
        # Each component of the scaled one is rounded, and an entry is a sum of two products of two,
        # over the square of the norm: some six units of round-off.
        np.testing.assert_allclose(rescaled, pose, rtol=0.0, atol=8.0 * EPS)


@pytest.mark.parametrize(
    ("position", "quaternion", "problem"),
    [
        ([0, 0, 0], [0, 0, 0, 0], "quaternion is zero"),
        ([0, 0, 0], [0, 0, 0, np.nan], "quaternion is not finite"),
        ([0, 0, 0], [0, np.inf, 0, 1], "quaternion is not finite"),
        ([0, np.nan, 0], [0, 0, 0, 1], "position is not finite"),
        ([0, 0, -np.inf], [0, 0, 0, 1], "position is not finite"),
    ],
)
def test_what_is_no_pose_is_refused(
    position: list[float], quaternion: list[float], problem: str
) -> None:
    with pytest.raises(ValueError, match=f"{problem}[^(]*$"):
        se3.from_position_quaternion(position, quaternion)
    positions = [[0.0, 0.0, 0.0], position]
    quaternions = [[0.0, 0.0, 0.0, 1.0], quaternion]
    with pytest.raises(ValueError, match=rf"{problem}.* \(index 1\)"):
        se3.from_position_quaternion(positions, quaternions)


# --------------------------------------------------------------------------------------------
# Covariances
# --------------------------------------------------------------------------------------------
def test_covariance_in_fixed_axes_is_that_of_the_fixed_axes_errors() -> None:
    # Without chance: each column of a factor of the covariance as one small perturbation.
    scale = 1e-6
    pose = se3.exp(sample((20, 1)))
    factor = np.random.default_rng(2).standard_normal((20, 6, 6))
    moved = se3.compose(pose, se3.exp(scale * factor.swapaxes(-1, -2)))
    translation = moved[..., :3, 3] - pose[..., :3, 3]
    rotation = se3.log_so3(moved[..., :3, :3] @ pose[..., :3, :3].swapaxes(-1, -2))
    error = np.concatenate([translation, rotation], axis=-1) / scale
    np.testing.assert_allclose(
        se3.covariance_to_fixed_axes(factor @ factor.swapaxes(-1, -2), pose[:, 0]),
        error.swapaxes(-1, -2) @ error,
        atol=2e-4,
    )


@given(batches())
def test_covariance_there_and_back(xi: Array) -> None:
    pose = se3.exp(xi)
    covariance = np.diag([1.0, 4.0, 9.0, 1e-4, 4e-4, 9e-4]) + 1e-5
    fixed = se3.covariance_to_fixed_axes(covariance, pose)
    assert fixed.shape == (*xi.shape[:-1], 6, 6)
    back = se3.covariance_from_fixed_axes(fixed, pose)
    np.testing.assert_allclose(back, np.broadcast_to(covariance, back.shape), atol=1e-14)
    rotation = pose[..., :3, :3]
    for rows in (slice(0, 3), slice(3, 6)):
        for columns in (slice(0, 3), slice(3, 6)):
            block = rotation @ covariance[rows, columns] @ rotation.swapaxes(-1, -2)
            np.testing.assert_allclose(fixed[..., rows, columns], block, atol=1e-14)


# --------------------------------------------------------------------------------------------
# Batches
# --------------------------------------------------------------------------------------------
OF_TANGENT: dict[str, Callable[[Array], Array]] = {
    "hat": lambda xi: se3.hat(xi[..., :3]),
    "exp_so3": lambda xi: se3.exp_so3(xi[..., 3:]),
    "exp": se3.exp,
    "left_jacobian": se3.left_jacobian,
    "right_jacobian": se3.right_jacobian,
    "right_jacobian_so3": lambda xi: se3.right_jacobian_so3(xi[..., 3:]),
    "left_jacobian_inverse": se3.left_jacobian_inverse,
    "right_jacobian_inverse": se3.right_jacobian_inverse,
}
OF_POSE: dict[str, Callable[[Array], Array]] = {
    "log_so3": lambda pose: se3.log_so3(pose[..., :3, :3]),
    "log": se3.log,
    "inverse": se3.inverse,
    "compose": lambda pose: se3.compose(pose, pose, pose),
    "adjoint": se3.adjoint,
    "interpolate": lambda pose: se3.interpolate(pose, se3.inverse(pose), 0.25),
    "position": lambda pose: se3.to_position_quaternion(pose)[0],
    "quaternion": lambda pose: se3.to_position_quaternion(pose)[1],
    "from_position_quaternion": lambda pose: se3.from_position_quaternion(
        *se3.to_position_quaternion(pose)
    ),
    "covariance_to_fixed_axes": lambda pose: se3.covariance_to_fixed_axes(np.eye(6), pose),
    "covariance_from_fixed_axes": lambda pose: se3.covariance_from_fixed_axes(np.eye(6), pose),
}
EVERY_MAP = [
    *((name, sample, function) for name, function in OF_TANGENT.items()),
    *((name, lambda shape: se3.exp(sample(shape)), function) for name, function in OF_POSE.items()),
]
over_every_map = pytest.mark.parametrize(
    ("make", "function"),
    [(make, function) for _, make, function in EVERY_MAP],
    ids=[name for name, _, _ in EVERY_MAP],
)
Maker = Callable[[tuple[int, ...]], Array]
Map = Callable[[Array], Array]


@over_every_map
def test_a_batch_is_its_elements(make: Maker, function: Map) -> None:
    for shape in (*SHAPES, (4, 1, 5)):
        batch = make(shape)
        before = batch.copy()
        actual = function(batch)
        assert (batch == before).all()  # an input is never written to
        assert not np.shares_memory(actual, batch)
        assert actual.dtype == np.float64
        dimensions = actual.ndim - len(shape)
        assert actual.shape[: len(shape)] == shape
        assert dimensions == function(make(())).ndim
        inputs = elements(batch, batch.ndim - len(shape))
        for one, alone in zip(elements(actual, dimensions), inputs, strict=True):
            np.testing.assert_allclose(one, function(alone), rtol=0.0, atol=16.0 * EPS)


@over_every_map
def test_strided_input(make: Maker, function: Map) -> None:
    batch = make((6,))
    np.testing.assert_allclose(
        function(batch[::2]), function(batch[::2].copy()), rtol=0.0, atol=16.0 * EPS
    )


@pytest.mark.parametrize("name", sorted(OF_TANGENT.keys() - {"hat"}))
def test_nan_in_a_tangent_vector_comes_out(name: str) -> None:
    xi = sample((3,))
    xi[1] = np.nan
    actual = OF_TANGENT[name](xi)
    assert np.isnan(actual[1, :3, :3]).all()
    assert np.isfinite(actual[[0, 2]]).all()


@pytest.mark.parametrize("element", [(0, 0), (2, 1), (1, 1), (0, 2)])
def test_nan_in_a_rotation_comes_out(element: tuple[int, int]) -> None:
    pose = se3.exp(sample((3,)))
    pose[1][element] = np.nan
    for actual in (se3.log(pose), se3.to_position_quaternion(pose)[1]):
        assert np.isnan(actual[1]).all()
        assert np.isfinite(actual[[0, 2]]).all()


def test_poses_of_different_batch_shapes_broadcast() -> None:
    first, second = se3.exp(sample((4, 1))), se3.exp(sample((5,), seed=1))
    assert se3.compose(first, second).shape == (4, 5, 4, 4)
    assert se3.compose(first, second, second[0]).shape == (4, 5, 4, 4)
    position, quaternion = se3.to_position_quaternion(first)
    origin = se3.from_position_quaternion([0.0, 0.0, 0.0], quaternion)
    there = se3.from_position_quaternion(position, quaternion)
    assert_close(origin[..., :3, :3], there[..., :3, :3], 1.0, 4.0)
    assert se3.from_position_quaternion(position, [0.0, 0.0, 0.0, 2.0]).shape == (4, 1, 4, 4)
    assert se3.covariance_to_fixed_axes(np.eye(6)[None], first).shape == (4, 1, 6, 6)


def test_covariance_in_fixed_axes_is_that_of_drawn_poses():
    """Monte Carlo: position and small rotation vector about the parent's axes, as ROS has them."""
    rng = np.random.default_rng(3)
    pose = se3.exp(np.array([0.4, -1.0, 2.0, 0.9, -0.5, 1.3]))
    root = rng.normal(size=(6, 6)) * np.repeat([0.02, 0.01], 3)
    drawn = pose @ se3.exp(rng.normal(size=(200_000, 6)) @ root)
    turned = se3.log_so3(drawn[:, :3, :3] @ pose[:3, :3].T)
    seen = np.cov(np.concatenate([drawn[:, :3, 3] - pose[:3, 3], turned], axis=-1).T)
    expected = se3.covariance_to_fixed_axes(root.T @ root, pose)
    size = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        seen / np.outer(size, size), expected / np.outer(size, size), atol=0.02
    )


# --------------------------------------------------------------------------------------------
# The loops in C and NumPy
# --------------------------------------------------------------------------------------------
built = pytest.mark.skipif(not loops.there(), reason="not built, or switched off")

OF_TANGENTS: dict[str, Callable[[Array], Array]] = {
    "exp": se3.exp,
    "exp_so3": lambda xi: se3.exp_so3(xi[..., 3:]),
    "right_jacobian_so3": lambda xi: se3.right_jacobian_so3(xi[..., 3:]),
    "left_jacobian": se3.left_jacobian,
    "right_jacobian": se3.right_jacobian,
    "left_jacobian_inverse": se3.left_jacobian_inverse,
    "right_jacobian_inverse": se3.right_jacobian_inverse,
}
OF_POSES: dict[str, Callable[[Array], Array]] = {
    "log": se3.log,
    "log_so3": lambda pose: se3.log_so3(pose[..., :3, :3]),
    "quaternion": lambda pose: se3.to_position_quaternion(pose)[1],
    "inverse": se3.inverse,
    "adjoint": se3.adjoint,
    "interpolate": lambda pose: se3.interpolate(np.eye(4), pose, 0.3),
    "round trip": lambda pose: se3.from_position_quaternion(*se3.to_position_quaternion(pose)),
}


def assert_as_numpy(function: Callable[[Array], Array], values: Array, size: float) -> None:
    kept = values.copy()
    found = function(values)
    with loops.left_out():
        expected = function(values)
    np.testing.assert_array_equal(values, kept)
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * size)


@built
@pytest.mark.parametrize("name", OF_TANGENTS)
@settings(max_examples=30, deadline=None)
@given(xi=batches())
def test_a_loop_of_tangents_is_what_numpy_does(name: str, xi: Array) -> None:
    assert_as_numpy(OF_TANGENTS[name], xi, 1.0 + np.abs(xi).max(initial=0.0))
    assert_as_numpy(OF_TANGENTS[name], np.swapaxes(xi[None], 0, -2), 1e7)  # strided


@built
@pytest.mark.parametrize("name", OF_POSES)
@settings(max_examples=30, deadline=None)
@given(xi=batches())
def test_a_loop_of_poses_is_what_numpy_does(name: str, xi: Array) -> None:
    pose = se3.exp(np.where(np.abs(xi) < 3.1, xi, 3.0))  # at pi either sign is right
    assert_as_numpy(OF_POSES[name], pose, 10.0)
    assert_as_numpy(OF_POSES[name], np.swapaxes(pose[None], 0, -3), 10.0)


@built
@pytest.mark.parametrize("name", ["log", "log_so3", "quaternion"])
def test_half_turns_have_the_same_sign(name: str) -> None:
    poses = [np.diag([1, -1, -1, 1.0]), np.diag([-1, 1, -1, 1.0]), np.diag([-1, -1, 1, 1.0])]
    poses.append(np.eye(4)[[1, 0, 2, 3]] * [1, 1, -1, 1])
    assert_as_numpy(OF_POSES[name], np.array(poses), 1.0)


@built
@pytest.mark.parametrize("name", [*OF_TANGENTS, *list(OF_POSES)[:-1]])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_spreads_as_numpy_has_it(name: str, bad: float) -> None:
    tangents = name in OF_TANGENTS
    function = OF_TANGENTS[name] if tangents else OF_POSES[name]
    good = sample((40,), seed=2)[-1]
    good = good if tangents else se3.exp(good)
    for place in range(6 if tangents else 12):
        values = good.copy()
        values.flat[place] = bad
        with np.errstate(all="ignore"):
            found = function(values)
            with loops.left_out():
                expected = function(values)
        np.testing.assert_array_equal(np.isfinite(found), np.isfinite(expected))
        if np.isnan(bad):
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


@built
@pytest.mark.parametrize("shape", [(5,), (2, 5), (2, 4)])
def test_a_wrong_shape_is_not_read(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"shape|broadcast|mismatch"):
        se3.left_jacobian(np.zeros(shape))
