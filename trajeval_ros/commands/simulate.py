# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""``simulate``: make up a run and write it as two TUM files."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from trajeval_ros.commands import completion, console

if TYPE_CHECKING:
    from trajeval_ros.commands.simulation import Poses

DESCRIPTION = """\
Make up a run and write it as two TUM files, ground_truth.txt and estimate.txt: an aggressive
flight, ground truth at 100 Hz with noise, jittered stamps and two dropouts, an estimate at 20 Hz
that drifts, in a world frame of its own. The same seed gives the same files."""


# m and rad per square root of a second: a third of the other's.
_CORRECTED = (0.004, 0.0007)


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="simulate",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    console.add_version(parser)
    parser.add_argument("directory", metavar="DIR", help="where to write the two files")
    parser.add_argument(
        "--duration",
        type=console.number(10.0, 86400.0),
        default=80.0,
        metavar="S",
        help="length of the run in seconds (default: 80)",
    )
    parser.add_argument(
        "--seed",
        type=console.integer(0, 2**32 - 1),
        default=1,
        metavar="N",
        help="of the random numbers (default: 1)",
    )
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = make_parser()
    completion.complete(parser)
    arguments = parser.parse_args(argv)
    return console.run(lambda: write(arguments), "simulate")


def write(arguments: argparse.Namespace) -> int:
    """Simulate and write."""
    ground_truth, estimate = write_files(
        Path(arguments.directory), arguments.duration, arguments.seed
    )
    print(f"{ground_truth}\n{estimate}")
    return console.DONE


def write_files(directory: Path, duration: float, seed: int) -> tuple[Path, Path]:
    """Write ``ground_truth.txt`` and ``estimate.txt`` and return their paths."""
    from trajeval_ros.commands.simulation import simulate

    run = simulate(duration, seed)
    ground_truth, estimate = _write(
        directory, {"ground_truth.txt": run.ground_truth, "estimate.txt": run.estimate}
    )
    return ground_truth, estimate


def write_two(directory: Path, duration: float, seed: int) -> tuple[Path, Path, Path]:
    """Write a ground truth and two estimates, of which one drifts and one is corrected.

    Returns the paths of ``ground_truth.txt``, ``drifting.txt`` and ``corrected.txt``.
    """
    from trajeval_ros.commands.simulation import simulate

    run = simulate(duration, seed)
    better = simulate(duration, seed + 1, drift_std=_CORRECTED)
    ground_truth, drifting, corrected = _write(
        directory,
        {
            "ground_truth.txt": run.ground_truth,
            "drifting.txt": run.estimate,
            "corrected.txt": better.estimate,
        },
    )
    return ground_truth, drifting, corrected


def _write(directory: Path, files: Mapping[str, Poses]) -> list[Path]:
    import numpy as np

    from trajeval_ros import se3
    from trajeval_ros.files.trajectory import Trajectory, TrajectoryFileError
    from trajeval_ros.files.tum import write_tum

    paths = [directory / name for name in files]
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for path, poses in zip(paths, files.values(), strict=True):
            position, quaternion = se3.to_position_quaternion(poses.poses)
            rows = np.arange(len(poses.stamps))
            write_tum(path, Trajectory(poses.stamps, position, quaternion, rows, str(path)))
    except OSError as error:
        raise console.CommandError(f"cannot write {directory}: {error.strerror}") from error
    except TrajectoryFileError as error:
        raise console.CommandError(str(error)) from error
    return paths


if __name__ == "__main__":
    sys.exit(main())
