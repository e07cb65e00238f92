# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Makes ``docs/images/joint_covariance.png`` with the package itself.

    PYTHONPATH=. .venv/bin/python docs/make_joint_picture.py

Ground truth at 1 Hz, estimates at 20 Hz that are drawn from the ground truth's joint posterior, as
the engine has it: the p-values of their absolute errors under either covariance.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.likelihood.absolute import absolute
from trajeval_ros.likelihood.figures import p_value
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.online.window import joint_covariance

Array = npt.NDArray[np.float64]

IMAGE = Path(__file__).parent / "images" / "joint_covariance.png"
COLORS = {"independent": "#d1495b", "joint": "#1f5fa8"}
SECOND = 1_000_000_000
DRAWS = 500
PARAMETERS = {
    "likelihood.covariance": "joint",
    "gp.hyperparameters": "fixed",
    "gp.translation.signal_std": 0.1,
    "gp.translation.length_scale": 2.0,
    "gp.translation.noise_std": 1e-4,
    "gp.rotation.signal_std": 0.03,
    "gp.rotation.length_scale": 2.0,
    "gp.rotation.noise_std": 1e-4,
    "ground_truth.translation_std": 1e-5,
    "ground_truth.rotation_std": 1e-5,
    "ground_truth.max_gap": 2.0,
}


def stochastic_poses(
    generator: np.random.Generator,
) -> tuple[Array, Array, tuple[Array, ...]]:
    """A ground truth at 1 Hz asked for at 20 Hz over 10 s: poses, covariances, and with others."""
    steps = 0.05 * generator.normal(size=(16, 6)) * np.repeat([1.0, 0.3], 3)
    stamps = 10**18 + SECOND * np.arange(16)
    asked = 10**18 + SECOND + SECOND // 20 * np.arange(200)
    engine = Engine(PARAMETERS)
    engine.add_ground_truth(
        PoseSamples(stamps, *se3.to_position_quaternion(se3.exp(np.cumsum(steps, axis=0))))
    )
    still = np.tile(np.eye(4), (len(asked), 1, 1))
    engine.add_estimate(PoseSamples(asked, *se3.to_position_quaternion(still)))
    results = engine.advance()
    found = results.evaluations
    return found.ground_truth, found.covariance, results.cross


def dense(covariance: Array, cross: tuple[Array, ...]) -> Array:
    """The covariance of all poses; (6 M, 6 M)."""
    count = len(covariance)
    blocks = np.zeros((count, count, 6, 6))
    for i, earlier in enumerate(cross):
        blocks[i, i] = covariance[i]
        blocks[i - len(earlier) : i, i] = earlier
        blocks[i, i - len(earlier) : i] = earlier.swapaxes(-1, -2)
    return blocks.swapaxes(1, 2).reshape(6 * count, 6 * count)


def main() -> None:
    """Draw the picture."""
    generator = np.random.default_rng(8)
    poses, own, cross = stochastic_poses(generator)
    factor = np.linalg.cholesky(dense(own, cross))
    covariances = {"independent": own, "joint": joint_covariance(own, cross)}
    found: dict[str, list[float]] = {name: [] for name in covariances}
    for _ in range(DRAWS):
        error = (factor @ generator.normal(size=len(factor))).reshape(-1, 6)
        for name, covariance in covariances.items():
            likelihood = absolute(poses, covariance, poses @ se3.exp(error)).likelihood
            assert likelihood is not None
            found[name].append(p_value(likelihood.chi2, likelihood.dof))
    figure, axes = plt.subplots(1, 2, figsize=(8.0, 2.8), sharey=True, layout="constrained")
    for axis, (name, values) in zip(axes, found.items(), strict=True):
        axis.hist(values, bins=20, range=(0.0, 1.0), color=COLORS[name])
        axis.axhline(DRAWS / 20, color="#5b6770", linewidth=1)
        axis.set_yscale("log")
        axis.set_title(f"likelihood.covariance: {name}", fontsize=10)
        axis.set_xlabel("p-value of a perfect estimate")
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    axes[0].set_ylabel(f"of {DRAWS} estimates")
    figure.savefig(IMAGE, dpi=110)


if __name__ == "__main__":
    main()
