# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""``simulate``: make up a run and write it as two TUM files."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from trajeval_ros.commands import completion, console

DESCRIPTION = """\
Make up a run and write it as two TUM files, ground_truth.txt and estimate.txt: an aggressive
flight, ground truth at 100 Hz with noise, jittered stamps and two dropouts, an estimate at 20 Hz
that drifts, in a world frame of its own. The same seed gives the same files."""


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
    import numpy as np

    from trajeval_ros import se3
    from trajeval_ros.commands.simulation import simulate
    from trajeval_ros.files.trajectory import Trajectory, TrajectoryFileError
    from trajeval_ros.files.tum import write_tum

    run = simulate(duration, seed)
    paths = directory / "ground_truth.txt", directory / "estimate.txt"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for path, poses in zip(paths, (run.ground_truth, run.estimate), strict=True):
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
