# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Likely causes of a large error: what people get wrong about their data, with the evidence.

Each test looks at what its mistake, and nothing else, changes:

- Rotations between two instants, seen in the body frame, are the same for estimate and ground
  truth up to a constant turn of the body frame, ``phi_gt = B phi_est``, whatever the two worlds.
  The best B is Wahba's problem. What no B explains is a quaternion that was read wrongly.
- The size of the trajectories is compared by the scale of a Sim(3) alignment.
- Angular speed, which no frame changes, is compared in time.
- What never changes at all is compared with nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.metrics.umeyama import align_positions

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

SECOND = 1_000_000_000

# Pairs of poses at least this far apart, so that the rotation between them stands above the noise.
_STEP = 0.5
# Root mean square rotation of a pair, rad, below which there is nothing to compare.
_TURNING = 0.03
_FEWEST = 30
# Unexplained shares of the rotation: what is wrong as it stands, what is explained by a cause.
# Real estimates leave 0.02 to 0.15 unexplained, a wrongly read quaternion 0.7 to 2.
_WRONG = 0.4
_EXPLAINED = 0.25
# A scale further from 1 than this, that removes this share of the error. The scale of good odometry
# wanders by 15 % within 13 s, so shorter runs show a gross one only. At rest there is none: the
# error left over must be this small a share of the motion.
_SCALE = 0.05
_GROSS_SCALE = 0.5
_SCALE_SPAN = 15.0
_GAIN = 0.6
_MOVING = 0.3
# Offsets of the clocks: looked for up to, named from, and only where angular speeds correlate this
# well and what the correlation lacks of 1 falls to this share.
_LONGEST_OFFSET = 3.0
_SHORTEST_OFFSET = 0.03
_CORRELATION = 0.7
_CORRELATION_LACK = 0.3
# Angular speeds that spread by less (rad/s) are one.
_STEADY = 1e-9
# What never changes: by less than round-off, m and rad, while the other trajectory goes this far.
_STILL = 1e-6
_MOVED = 0.1
_TURNED = 0.2


@dataclass(frozen=True, slots=True)
class Cause:
    """``code`` in snake_case, ``text`` with the evidence, ``advice``: what to set."""

    code: str
    text: str
    advice: str

    @property
    def sentence(self) -> str:
        """What is wrong and what to do about it."""
        return f"likely cause: {self.text}. To try: {self.advice}."


def likely_causes(
    stamps: Stamps, ground_truth: Array, estimate: Array, gauge: str
) -> tuple[Cause, ...]:
    """Return what is likely wrong; nothing for data that are only inaccurate.

    ``stamps`` (B,) ns, ``ground_truth`` and ``estimate`` (B, 4, 4), each in a world of its own, at
    instants where the ground truth is known well.
    """
    if len(stamps) < _FEWEST:
        return ()
    stuck = _stuck(ground_truth, estimate)
    if stuck:
        return stuck
    scale = _scale(stamps, ground_truth[:, :3, 3], estimate[:, :3, 3], gauge)
    rotations = ground_truth[:, :3, :3], estimate[:, :3, :3]
    constant = _constant_orientation(stamps, *rotations)
    if constant:
        return (*constant, *scale)
    return (*_rotations(stamps, *rotations), *scale, *_clock(stamps, *rotations))


def _angles(rotation: Array) -> Array:
    """How far each rotation (B, 3, 3) is from the first, rad."""
    turned = se3.log_so3(rotation[0].T @ rotation)
    return np.asarray(np.linalg.norm(turned, axis=-1))


def _distances(position: Array) -> Array:
    """How far each position (B, 3) is from the first, m."""
    return np.asarray(np.linalg.norm(position - position[0], axis=-1))


def _stuck(ground_truth: Array, estimate: Array) -> tuple[Cause, ...]:
    """An estimate at one pose, of a robot that moves or turns."""
    if _distances(estimate[:, :3, 3]).max() > _STILL or _angles(estimate[:, :3, :3]).max() > _STILL:
        return ()
    moved = float(_distances(ground_truth[:, :3, 3]).max())
    turned = float(_angles(ground_truth[:, :3, :3]).max())
    if moved < _MOVED and turned < _TURNED:
        return ()
    return (
        Cause(
            "stuck",
            f"the estimate stays at one pose, while the ground truth goes {moved:.3g} m away"
            f" from its first pose and turns by {np.degrees(turned):.0f} degrees",
            "see whether the estimator tracks at all, and whether this is its topic or file",
        ),
    )


def _constant_orientation(
    stamps: Stamps, ground_truth: Array, estimate: Array
) -> tuple[Cause, ...]:
    """An orientation that nobody filled in."""
    for title, constant, other_title, other in (
        ("estimate", estimate, "ground truth", ground_truth),
        ("ground truth", ground_truth, "estimate", estimate),
    ):
        turned = float(_angles(other).max())
        if _angles(constant).max() > _STILL or turned < _TURNED:
            continue
        # A slow turn against a ground truth at rest is drift.
        if constant is ground_truth and not _turns(stamps, estimate):
            continue
        x, y, z, w = _quaternion(constant[0])
        return (
            Cause(
                "constant_orientation",
                f"the {title}'s orientation never changes (x y z w is {x:.3g} {y:.3g} {z:.3g}"
                f" {w:.3g} throughout), while the {other_title} turns by"
                f" {np.degrees(turned):.0f} degrees: many a converter writes 0 0 0 1",
                f"write the {title}'s own quaternions; until then no figure of rotation holds",
            ),
        )
    return ()


def _turns(stamps: Stamps, rotation: Array) -> bool:
    """Whether orientations change within a step by more than noise."""
    between = _between(rotation, *_pairs(stamps, _STEP))
    return len(between) >= _FEWEST and bool(np.sqrt((between**2).sum(axis=1).mean()) >= _TURNING)


def _quaternion(rotation: Array) -> list[float]:
    """x, y, z, w of a rotation (3, 3)."""
    pose = np.eye(4)
    pose[:3, :3] = rotation
    return [float(value) + 0.0 for value in se3.to_position_quaternion(pose)[1]]


@dataclass(frozen=True, slots=True)
class _Fit:
    """The turn B (3, 3) that explains rotations best, and the shares it leaves unexplained."""

    turn: Array
    as_is: float
    turned: float
    axes: int


def _fit(truth: Array, other: Array) -> _Fit:
    """Wahba's problem: B minimising ``sum |truth_k - B other_k|²`` over rotation vectors (P, 3)."""
    u, singular, vt = np.linalg.svd(truth.T @ other)
    sign = np.sign(np.linalg.det(u @ vt))
    turn = u @ np.diag([1.0, 1.0, sign]) @ vt
    size = float(np.sqrt((truth**2).sum()))

    def share(unexplained: Array) -> float:
        # Of no rotation at all nothing can be explained.
        return float(np.linalg.norm(unexplained)) / size if size > 0.0 else 1.0

    return _Fit(
        turn=turn,
        as_is=share(truth - other),
        turned=share(truth - other @ turn.T),
        axes=int((singular > 0.02 * singular[0]).sum()),
    )


def _pairs(stamps: Stamps, step: float) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Indices of poses at least ``step`` seconds apart, and not much more."""
    later = np.searchsorted(stamps, stamps + round(step * SECOND))
    first = np.flatnonzero(later < len(stamps))
    second = later[first]
    near = stamps[second] - stamps[first] < round(3 * step * SECOND)
    return first[near], second[near]


def _between(rotation: Array, first: npt.NDArray[np.intp], second: npt.NDArray[np.intp]) -> Array:
    """Rotation vectors from the first to the second of each pair, body frame, (P, 3)."""
    return se3.log_so3(rotation[first].swapaxes(-1, -2) @ rotation[second])


def _rotations(stamps: Stamps, ground_truth: Array, estimate: Array) -> tuple[Cause, ...]:
    """Quaternions read wrongly, or a body frame that is turned."""
    first, second = _pairs(stamps, _STEP)
    if not _turns(stamps, ground_truth):
        return ()
    fit = _fit(_between(ground_truth, first, second), _between(estimate, first, second))
    if fit.as_is < _WRONG:
        return ()
    reread, cause = _misread(fit, first, second, ground_truth, estimate)
    # About one axis, a turn of the body by 180 degrees looks like conjugated quaternions.
    turned = fit.turned < _EXPLAINED and (fit.axes > 1 or fit.turned < reread.as_is)
    if turned:
        return (_turned_body(fit),)
    return (cause,) if reread.turned < _EXPLAINED else ()


def _misread(
    fit: _Fit,
    first: npt.NDArray[np.intp],
    second: npt.NDArray[np.intp],
    ground_truth: Array,
    estimate: Array,
) -> tuple[_Fit, Cause]:
    """The reading of the quaternions that explains the rotations best.

    Two readings that mirror each other differ by constant turns of world and body alone (both are
    orthogonal maps of R⁴ with determinant -1), so that each explains what the other does; the
    right one is the one that needs no turn of the body besides.
    """
    readings = []
    for title, poses, other in (
        ("estimate", estimate, ground_truth),
        ("ground truth", ground_truth, estimate),
    ):
        known = _between(other, first, second)
        for code, reread, mistake, advice in _READINGS:
            again = _fit(known, _between(reread(poses), first, second))
            text = (
                f"the {title}'s quaternions {mistake}: {100 * fit.turned:.0f} % of the rotation is"
                f" unexplained as it stands, {100 * again.turned:.0f} % otherwise"
            )
            readings.append((again, Cause(code, text, advice.format(title))))
    return min(readings, key=lambda reading: reading[0].as_is)


def _reordered(rotation: Array) -> Array:
    """The rotations as they are if w x y z was read as x y z w."""
    poses = np.tile(np.eye(4), (len(rotation), 1, 1))
    poses[:, :3, :3] = rotation
    x, y, z, w = np.moveaxis(se3.to_position_quaternion(poses)[1], -1, 0)
    again = np.stack([y, z, w, x], axis=-1)
    return se3.from_position_quaternion(np.zeros((len(rotation), 3)), again)[:, :3, :3]


def _inverted(rotation: Array) -> Array:
    return rotation.swapaxes(-1, -2)


_READINGS = (
    (
        "quaternion_order",
        _reordered,
        "are in the order w x y z",
        "write the {}'s quaternions as x y z w",
    ),
    (
        "quaternion_conjugated",
        _inverted,
        "are conjugated, of the world in the body",
        "invert the {}'s rotations",
    ),
)


def _turned_body(fit: _Fit) -> Cause:
    """A constant turn between the two body frames."""
    degrees = float(np.degrees(np.linalg.norm(se3.log_so3(fit.turn))))
    text = (
        f"the estimate's body frame is turned by {degrees:.0f} degrees against the ground truth's:"
        f" {100 * fit.as_is:.0f} % of the rotation is unexplained as it stands,"
        f" {100 * fit.turned:.0f} % with that turn"
    )
    if fit.axes < 2:
        return Cause(
            "body_frame",
            f"{text} (seen about one axis only)",
            "set extrinsic to the estimate's body frame in the ground truth's",
        )
    numbers = ",".join(f"{value:.3g}" for value in _quaternion(fit.turn))
    return Cause(
        "body_frame", text, f"set extrinsic=0,0,0,{numbers}, with the lever arm for the zeros"
    )


def _scale(stamps: Stamps, ground_truth: Array, estimate: Array, gauge: str) -> tuple[Cause, ...]:
    """Millimetres for metres, or a trajectory of no known scale."""
    if gauge in ("none", "sim3"):
        return ()
    similar = align_positions(estimate, ground_truth, "sim3")
    rigid = align_positions(estimate, ground_truth, "se3")
    scale = float(similar.scale)
    long = stamps[-1] - stamps[0] >= _SCALE_SPAN * SECOND
    least = np.log1p(_SCALE if long else _GROSS_SCALE)
    motion = float(np.sqrt(ground_truth.var(axis=0).sum()))
    left_over = min(_GAIN * rigid.rmse, _MOVING * motion)
    if not (scale > 0 and abs(np.log(scale)) > least and similar.rmse < left_over):
        return ()
    evidence = f"aligned with the scale {scale:.4g} the error falls from {rigid.rmse:.3g} m"
    evidence += f" to {similar.rmse:.3g} m"
    for title, factor in (("estimate", 1e-3), ("ground truth", 1e3)):
        if abs(np.log10(scale / factor)) < 0.1:
            return (
                Cause(
                    "millimetres",
                    f"the {title} is in millimetres: {evidence}",
                    f"divide the {title}'s positions by 1000",
                ),
            )
    return (Cause("scale", f"the estimate's scale is not 1: {evidence}", "set gauge=sim3"),)


def _clock(stamps: Stamps, ground_truth: Array, estimate: Array) -> tuple[Cause, ...]:
    """An offset between the two clocks, from the angular speeds."""
    step = float(np.median(np.diff(stamps))) / SECOND
    if not 0.0 < step <= 0.25:
        return ()
    count = int((stamps[-1] - stamps[0]) / SECOND / step)
    longest = int(_LONGEST_OFFSET / step)
    if not 4 * longest < count < 1_000_000:
        return ()
    first, second = _pairs(stamps, 3 * step)
    if len(first) < _FEWEST:
        return ()
    middle = (stamps[first] + stamps[second] - 2 * stamps[0]) / (2.0 * SECOND)
    length = (stamps[second] - stamps[first]) / SECOND
    grid = np.arange(count) * step
    truth, other = (
        np.interp(grid, middle, np.linalg.norm(_between(r, first, second), axis=1) / length)
        for r in (ground_truth, estimate)
    )
    # Where nothing was scored, interpolation is no evidence.
    scored = np.abs(grid - middle[np.searchsorted(middle[:-1], grid)]) < 2 * step
    lags = np.arange(-longest, longest + 1)
    correlation = np.array([_correlation(truth, other, scored, int(lag)) for lag in lags])
    best = int(np.argmax(correlation))
    if not 0 < best < len(lags) - 1:
        return ()
    # The vertex of the parabola through the best lag and its neighbours.
    before, here, after = correlation[best - 1 : best + 2]
    bend = before - 2 * here + after
    vertex = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    offset = float(lags[best] + vertex) * step
    lack = (1.0 - here) / max(1.0 - correlation[longest], 1e-3)
    if abs(offset) < _SHORTEST_OFFSET or here < _CORRELATION or lack > _CORRELATION_LACK:
        return ()
    return (
        Cause(
            "clock_offset",
            f"the estimate's clock is off by {-offset:.3f} s: the angular speeds correlate to"
            f" {here:.3f} when {offset:+.3f} s are added to its stamps,"
            f" to {correlation[longest]:.3f} as they stand",
            f"set estimate.time_offset={offset:.3f}",
        ),
    )


def _correlation(truth: Array, other: Array, scored: npt.NDArray[np.bool_], lag: int) -> float:
    """Correlation of the estimate with the ground truth ``lag`` steps later."""
    count = len(truth)
    here = slice(max(0, -lag), min(count, count - lag))
    there = slice(max(0, lag), min(count, count + lag))
    both = scored[here] & scored[there]
    a, b = other[here][both], truth[there][both]
    if len(a) < _FEWEST or min(a.std(), b.std()) < _STEADY:
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])
