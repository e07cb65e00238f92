# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Probabilistic, continuous-time evaluation of estimated trajectories, live in ROS 2.

An estimate is scored by its likelihood under a Gaussian-process model of the ground truth,
after Zhang and Scaramuzza, "Rethinking Trajectory Evaluation for SLAM: a Probabilistic,
Continuous-Time Approach" (2019). Frames, units and formulae: ``docs/method.md``.

In Python, without ROS (``docs/python.md``): ::

    import trajeval_ros as te

    result = te.evaluate(te.read_tum("ground_truth.txt"), te.read_tum("estimate.txt"))
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from trajeval_ros.benchmarking.whole import benchmark
    from trajeval_ros.comparison.compare import Comparison
    from trajeval_ros.files.trajectory import TrajectoryFileError
    from trajeval_ros.library.evaluate import evaluate
    from trajeval_ros.library.result import Poses, Result, Results
    from trajeval_ros.library.trajectory import (
        Trajectory,
        read_bag,
        read_euroc,
        read_kitti,
        read_tum,
    )
    from trajeval_ros.library.truth import GroundTruth

__version__ = "0.1.0"

# Loaded when first used: the node and the commands' --help need none of it.
_HOMES = {
    "Comparison": "comparison.compare",
    "GroundTruth": "library.truth",
    "Poses": "library.result",
    "Result": "library.result",
    "Results": "library.result",
    "Trajectory": "library.trajectory",
    "TrajectoryFileError": "files.trajectory",
    "benchmark": "benchmarking.whole",
    "evaluate": "library.evaluate",
    "read_bag": "library.trajectory",
    "read_euroc": "library.trajectory",
    "read_kitti": "library.trajectory",
    "read_tum": "library.trajectory",
}

__all__ = [
    "Comparison",
    "GroundTruth",
    "Poses",
    "Result",
    "Results",
    "Trajectory",
    "TrajectoryFileError",
    "benchmark",
    "evaluate",
    "read_bag",
    "read_euroc",
    "read_kitti",
    "read_tum",
]


def __getattr__(name: str) -> object:
    """Load a public name."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value: object = getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """The public names, loaded or not."""
    return sorted({*globals(), *__all__})
