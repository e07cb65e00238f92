# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The two trajectories that ``evaluate`` and ``replay`` work on, as sub-commands by format."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from typing import NoReturn

from trajeval_ros.commands.console import CommandError, Progress, UsageError
from trajeval_ros.commands.figures import table
from trajeval_ros.files.trajectory import Trajectory, TrajectoryFileError

SECOND = 1_000_000_000


@dataclass(frozen=True)
class Inputs:
    """Ground truth and estimate as read."""

    ground_truth: Trajectory
    estimate: Trajectory


def add_formats(
    parser: argparse.ArgumentParser, add_options: Callable[[argparse.ArgumentParser], None]
) -> None:
    """Declare one sub-command a format; ``add_options`` declares what they share."""
    formats = parser.add_subparsers(dest="format", metavar="FORMAT", required=True)
    tum = formats.add_parser(
        "tum", help="TUM files: stamp[s] tx ty tz qx qy qz qw", allow_abbrev=False
    )
    _add_files(tum, "GROUND_TRUTH", "ESTIMATE")
    euroc = formats.add_parser(
        "euroc",
        help="EuRoC ground truth (csv, ns, w x y z) and an estimate in TUM's format",
        allow_abbrev=False,
    )
    _add_files(euroc, "GROUND_TRUTH.csv", "ESTIMATE (TUM's format; EuRoC's where it ends in .csv)")
    kitti = formats.add_parser(
        "kitti", help="KITTI files: the twelve numbers of 3x4 matrices", allow_abbrev=False
    )
    _add_files(kitti, "GROUND_TRUTH", "ESTIMATE")
    kitti.add_argument("--times", required=True, metavar="TIMES", help="the stamps, one a row, s")
    bag = formats.add_parser(
        "bag",
        help="two topics of a bag: ROS 1, or ROS 2 (a folder, sqlite3, mcap); by header stamps",
        allow_abbrev=False,
    )
    bag.add_argument("bag", metavar="BAG", help="file or folder; without topics: lists them")
    for option in ("ground-truth", "estimate"):
        bag.add_argument(
            f"--{option}", metavar="TOPIC", help="a topic, or /tf:PARENT.CHILD for a transform"
        )
    for each in (tum, euroc, kitti, bag):
        add_options(each)


def _add_files(parser: argparse.ArgumentParser, ground_truth: str, estimate: str) -> None:
    parser.add_argument("ground_truth", metavar="GROUND_TRUTH", help=ground_truth)
    parser.add_argument("estimate", metavar="ESTIMATE", help=estimate)


def read(arguments: argparse.Namespace) -> Inputs:
    """Read what the command line names.

    Raises
    ------
    CommandError
        For what cannot be read as a trajectory; names the file and the row.
    """
    try:
        return _READERS[arguments.format](arguments)
    except TrajectoryFileError as error:
        raise CommandError(str(error)) from error


def _read_tum(arguments: argparse.Namespace) -> Inputs:
    from trajeval_ros.files.tum import read_tum

    return Inputs(read_tum(arguments.ground_truth), read_tum(arguments.estimate))


def _read_euroc(arguments: argparse.Namespace) -> Inputs:
    from trajeval_ros.files.euroc import read_euroc
    from trajeval_ros.files.tum import read_tum

    read_estimate = read_euroc if arguments.estimate.lower().endswith(".csv") else read_tum
    return Inputs(read_euroc(arguments.ground_truth), read_estimate(arguments.estimate))


def _read_kitti(arguments: argparse.Namespace) -> Inputs:
    from trajeval_ros.files.kitti import read_kitti

    return Inputs(
        read_kitti(arguments.ground_truth, arguments.times),
        read_kitti(arguments.estimate, arguments.times),
    )


def _read_bag(arguments: argparse.Namespace) -> Inputs:
    from trajeval_ros.files.bag import read_bag

    topics = (arguments.ground_truth, arguments.estimate)
    with Progress("reading", 0, "messages") as progress:
        if None in topics:
            _list_candidates(arguments.bag, progress)
        ground_truth, estimate = read_bag(arguments.bag, topics, progress.update)
    return Inputs(ground_truth, estimate)


def _list_candidates(bag: str, progress: Progress) -> NoReturn:
    """Print the topics that hold a trajectory, and ask for two of them."""
    from trajeval_ros.files.bag import list_candidates

    candidates = list_candidates(bag, progress.update)
    if not candidates:
        raise CommandError(f"{bag}: no topic in it holds a trajectory")
    rows = [("topic", "type", "count", "rate")]
    rows += [
        (c.topic, c.message_type, f"{c.count:,}", "-" if c.rate is None else f"{c.rate:.1f} Hz")
        for c in candidates
    ]
    print("\n".join(table(rows, left=2)), flush=True)
    raise UsageError("name two of these topics with --ground-truth and --estimate")


_READERS: dict[str, Callable[[argparse.Namespace], Inputs]] = {
    "tum": _read_tum,
    "euroc": _read_euroc,
    "kitti": _read_kitti,
    "bag": _read_bag,
}


def check_overlap(inputs: Inputs, time_offset: float) -> None:
    """Refuse trajectories that have no time in common.

    Raises
    ------
    CommandError
        Names both ranges.
    """
    ground_truth, estimate = inputs.ground_truth, inputs.estimate
    for trajectory in (ground_truth, estimate):
        if len(trajectory) == 0:
            raise CommandError(f"{trajectory.source}: no row has a finite stamp")
    offset = round(time_offset * SECOND)
    first, last = _range(estimate)
    known_first, known_last = _range(ground_truth)
    if last + offset < known_first or first + offset > known_last:
        shifted = f" (with the time offset of {time_offset:g} s)" if offset else ""
        raise CommandError(
            "the trajectories do not overlap in time:"
            f" ground truth {_in_seconds(known_first)} to {_in_seconds(known_last)},"
            f" estimate {_in_seconds(first + offset)} to {_in_seconds(last + offset)}{shifted}"
        )


def _range(trajectory: Trajectory) -> tuple[int, int]:
    return int(trajectory.stamps.min()), int(trajectory.stamps.max())


def _in_seconds(stamp: int) -> str:
    return f"{stamp / SECOND:.3f} s"
