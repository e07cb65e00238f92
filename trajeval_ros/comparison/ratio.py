# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ratio of two RMSEs of one run, and what can be told from it.

Errors a_i and b_i at the same instants share the ground truth's error, the scene and the motion.
So one statistic is made of both, theta = log(RMSE(a) / RMSE(b)), and its standard deviation comes
from the series itself: of the sums of a_i^2 and of b_i^2 in `BINS` stretches of the run, stretches
are drawn anew, in blocks, for both at once.

- `stationary_bootstrap`: D. Politis and J. Romano, "The stationary bootstrap", JASA 89, 1994, with
  the block length L of D. Politis and H. White (2004; corrected by A. Patton, 2009), for
  theta's linear part z_i = (a_i^2 / mean a^2 - b_i^2 / mean b^2) / 2; by the library arch.
- `block_t`: where arch is not installed. Student's t of the means of z in `BLOCKS` blocks
  (R. Ibragimov and U. Müller, "t-statistic based correlation and heterogeneity robust inference",
  JBES 28, 2010). Simpler, and wider.

The bootstrap's variance is that of a kernel estimate with weights exp(-|lag| / L), and is corrected
for what is known of one, n being the number of stretches:

- the mean has been taken out: a share of 2 L / n is missing;
- the kernel cuts correlation off: to first order a share of G / (L S) of it, S and G being the sums
  over all lags of the autocovariance and of it times the lag. The block length of Politis and White
  is (n G^2 / S^2)^(1/3), which gives G / S but for its sign, that of the first autocovariance;
- it is itself uncertain, as a chi-squared of n / L degrees of freedom: Student's t has these.

Simulated, with noise that is remembered for up to a twentieth of the run, 5 % of equals then come
out different in 3 to 8 % of runs; without the corrections in 5 to 16 %.

None of this holds where z is one walk through the whole run, as the ATE of odometry that only
drifts is: a second run would be another walk, and of equals half come out "different". So Dickey
and Fuller's test for a unit root asks first, and where it cannot exclude one there is the ratio
and no interval.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.likelihood.tails import student_quantile, student_tail

Array = npt.NDArray[np.float64]
Method = Literal["stationary_bootstrap", "block_t"]
Unit = Literal["m", "rad"]

BINS = 128
"""Stretches that the run is cut into. Few enough that the block length, of which arch looks for
no more than 3 sqrt(n), may be a quarter of the run."""
BLOCKS = 10
"""Blocks of `block_t`, as Ibragimov and Müller advise: few, so that they are independent."""
FEWEST = 20
_REPLICATES = 1000
# Dickey and Fuller's 1 % is -3.43. Squares of an aligned walk reject more often than a walk does,
# in 17 % of runs; below this, 5 to 9 %, of which half come out different. Of noise that is
# remembered for a twentieth of the run three quarters pass.
_UNIT_ROOT_ABOVE = -4.0
_ALIKE = 1e-12


class Reason(enum.StrEnum):
    """Why there is no interval."""

    TOO_FEW = "too_few"
    """Fewer than 20 errors."""
    ONE_WALK = "one_walk"
    """The errors drift through the whole run: as if there were one of them."""
    ZERO = "zero"
    """One of the two has no error at all."""


class Ratio(NamedTuple):
    """RMSE of a over RMSE of b.

    Attributes:
        rmse_a: in `unit`.
        rmse_b: in `unit`.
        unit: m or rad.
        errors: how many of each.
        ratio: None where b has no error.
        interval: 95 % interval of the ratio; None for a `reason`.
        p_value: of the ratio being 1, two-sided; None for a `reason`.
        method: where interval and p-value come from; None for a `reason`.
        independent: degrees of freedom of Student's t: about as many independent stretches.
        reason: why there is no interval; None where there is one.
    """

    rmse_a: float
    rmse_b: float
    unit: Unit
    errors: int
    ratio: float | None
    interval: tuple[float, float] | None = None
    p_value: float | None = None
    method: Method | None = None
    independent: float | None = None
    reason: Reason | None = None

    def figures(self) -> dict[str, object]:
        """By name, as in ``summary.json``."""
        return {
            "ratio": self.ratio,
            "interval": None if self.interval is None else list(self.interval),
            "p_value": self.p_value,
            "method": self.method,
            "reason": None if self.reason is None else str(self.reason),
            "rmse_a": self.rmse_a,
            "rmse_b": self.rmse_b,
            "errors": self.errors,
        }


def ratio_in(figures: Mapping[str, Any], unit: Unit) -> Ratio:
    """The ratio that has these `figures`, but for its degrees of freedom."""
    given = dict(figures)
    interval, reason = given.pop("interval"), given.pop("reason")
    return Ratio(
        **given,
        unit=unit,
        interval=None if interval is None else (interval[0], interval[1]),
        reason=None if reason is None else Reason(reason),
    )


def best_method() -> Method:
    """The stationary bootstrap where arch is installed."""
    try:
        import arch  # noqa: F401
    except ImportError:
        return "block_t"
    return "stationary_bootstrap"


def ratio_of(a: Array, b: Array, unit: Unit, method: Method | None = None, seed: int = 0) -> Ratio:
    """The ratio of the RMSEs of two paired series of errors, in the order of time.

    Args:
        a: (N,), in `unit`, N >= 1.
        b: (N,), at the same instants.
        unit: m or rad.
        method: `best_method()` where None.
        seed: of the bootstrap.

    Raises:
        ValueError: series of different lengths, none, or errors that are not finite.
        ImportError: `stationary_bootstrap` is asked for, and arch is not installed.
    """
    if a.shape != b.shape or a.ndim != 1 or len(a) == 0:
        raise ValueError(f"errors must be (N,) and as many, N >= 1, got {a.shape} and {b.shape}")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError("errors must be finite")
    # In units of the largest, so that no square is lost.
    largest = float(max(np.abs(a).max(), np.abs(b).max())) or 1.0
    squares_a, squares_b = (a / largest) ** 2, (b / largest) ** 2
    rmse_a, rmse_b = (largest * float(np.sqrt(s.mean())) for s in (squares_a, squares_b))
    ratio = rmse_a / rmse_b if rmse_b > 0.0 else None
    plain = Ratio(rmse_a, rmse_b, unit, len(a), ratio)
    if ratio is None or ratio == 0.0:
        return plain._replace(reason=Reason.ZERO)
    if len(a) < FEWEST:
        return plain._replace(reason=Reason.TOO_FEW)
    edges = np.linspace(0, len(a), min(BINS, len(a)) + 1).astype(int)[:-1]
    sums_a, sums_b = np.add.reduceat(squares_a, edges), np.add.reduceat(squares_b, edges)
    linear = 0.5 * (sums_a / sums_a.mean() - sums_b / sums_b.mean())
    method = method or best_method()
    if np.abs(linear).max() <= _ALIKE:
        # One is a multiple of the other: nothing is left to chance.
        std, dof = 0.0, float(len(linear))
    elif may_be_a_walk(linear):
        return plain._replace(reason=Reason.ONE_WALK)
    elif method == "stationary_bootstrap":
        std, dof = _bootstrap(sums_a, sums_b, linear, seed)
    else:
        std, dof = block_t(linear)
    log_ratio = float(np.log(ratio))
    half = student_quantile(0.025, dof) * std
    return plain._replace(
        interval=(float(np.exp(log_ratio - half)), float(np.exp(log_ratio + half))),
        p_value=_p_value(log_ratio, std, dof),
        method=method,
        independent=dof,
    )


def _p_value(log_ratio: float, std: float, dof: float) -> float:
    if std == 0.0:
        return 1.0 if abs(log_ratio) <= _ALIKE else 0.0
    return 2.0 * student_tail(abs(log_ratio) / std, dof)


def _bootstrap(a: Array, b: Array, linear: Array, seed: int) -> tuple[float, float]:
    """Standard deviation of theta, corrected, and its degrees of freedom."""
    from arch.bootstrap import StationaryBootstrap, optimal_block_length

    blocks: Any = StationaryBootstrap  # annotated with whole lengths alone; it takes any above 1
    count = len(linear)
    best = float(optimal_block_length(linear)["stationary"].iloc[0])
    block = min(best if best >= 1.0 else 1.0, count / 3.0)
    drawn = blocks(block, a, b, seed=seed).apply(_log_ratio, _REPLICATES)
    cut_off = (best**3 / count) ** 0.5 / block if best > 0.0 else 0.0
    if linear[1:] @ linear[:-1] < 0.0:
        cut_off = -cut_off
    variance = float(drawn.var(ddof=1)) * (1.0 + cut_off) / (1.0 - 2.0 * block / count)
    return variance**0.5, count / block


def _log_ratio(a: Array, b: Array) -> Array:
    return np.asarray([0.5 * np.log(a.sum() / b.sum())])


def block_t(linear: Array) -> tuple[float, float]:
    """Standard deviation of theta from the means in blocks, and its degrees of freedom."""
    means = np.array([block.mean() for block in np.array_split(linear, BLOCKS)])
    return float(means.std(ddof=1)) / BLOCKS**0.5, BLOCKS - 1.0


def may_be_a_walk(series: Array) -> bool:
    """Whether Dickey and Fuller's test, with a mean and one lag, cannot exclude a unit root."""
    steps = np.diff(series)
    design = np.stack((np.ones(len(steps) - 1), series[1:-1], steps[:-1]), axis=1)
    solution, _, rank, _ = np.linalg.lstsq(design, steps[1:], rcond=None)
    if rank < 3:
        return False
    left_over = steps[1:] - design @ solution
    variance = left_over @ left_over / (len(left_over) - 3)
    std = float(np.sqrt(variance * np.linalg.inv(design.T @ design)[1, 1]))
    return bool(solution[1] > _UNIT_ROOT_ABOVE * std)
