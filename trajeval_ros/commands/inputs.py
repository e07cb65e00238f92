# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The two trajectories that ``evaluate`` and ``replay`` work on, as sub-commands by format."""

from __future__ import annotations

import argparse
import itertools
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import NoReturn

from trajeval_ros.commands.console import CommandError, Progress, UsageError
from trajeval_ros.commands.figures import table
from trajeval_ros.files.recognise import Recognised, recognise
from trajeval_ros.files.span import Instant, SpanError, cut_all, span_of, words
from trajeval_ros.files.trajectory import Trajectory, TrajectoryFileError

FORMATS = ("tum", "euroc", "kitti", "bag")
AUTO = "auto"
SECOND = 1_000_000_000


@dataclass(frozen=True)
class Inputs:
    """Ground truth and estimates as read; ``names`` (n,) of the estimates.

    ``remarks``: what was assumed in reading them, a line each.
    """

    ground_truth: Trajectory
    estimates: tuple[Trajectory, ...]
    names: tuple[str, ...]
    remarks: tuple[str, ...] = ()

    @property
    def estimate(self) -> Trajectory:
        """The only estimate."""
        (estimate,) = self.estimates
        return estimate


def _differences(*read: Trajectory) -> tuple[str, ...]:
    """What was read differently from the plain formats, a line a file."""
    return tuple(f"{one.source}: {'; '.join(one.remarks)}" for one in read if one.remarks)


def add_formats(
    parser: argparse.ArgumentParser,
    add_options: Callable[[argparse.ArgumentParser], None],
    *,
    several: bool = False,
) -> None:
    """Declare one sub-command a format; ``add_options`` declares what they share.

    ``several``: whether more than one estimate may be named.
    """
    formats = parser.add_subparsers(dest="format", metavar="FORMAT", required=True)
    tum = formats.add_parser(
        "tum", help="TUM files: stamp[s] tx ty tz qx qy qz qw", allow_abbrev=False
    )
    _add_files(tum, "GROUND_TRUTH", "ESTIMATE", several)
    euroc = formats.add_parser(
        "euroc",
        help="EuRoC ground truth (csv, ns, w x y z) and an estimate in TUM's format",
        allow_abbrev=False,
    )
    _add_files(
        euroc, "GROUND_TRUTH.csv", "ESTIMATE (TUM's format; EuRoC's where it ends in .csv)", several
    )
    kitti = formats.add_parser(
        "kitti", help="KITTI files: the twelve numbers of 3x4 matrices", allow_abbrev=False
    )
    _add_files(kitti, "GROUND_TRUTH", "ESTIMATE", several)
    _add_times(kitti)
    bag = formats.add_parser(
        "bag",
        help="two topics of a bag: ROS 1, or ROS 2 (a folder, sqlite3, mcap); by header stamps",
        allow_abbrev=False,
    )
    bag.add_argument("bag", metavar="BAG", help="file or folder; without topics: lists them")
    _add_topics(bag, several)
    auto = formats.add_parser(
        AUTO,
        help="each file's format by its content; it is what is done where no format is named",
        allow_abbrev=False,
    )
    auto.add_argument(
        "files",
        metavar="FILE",
        nargs="+",
        help="GROUND_TRUTH and ESTIMATE, tum, euroc or kitti; or a bag, with its topics",
    )
    _add_times(auto)
    _add_topics(auto, several)
    for each in (tum, euroc, kitti, bag, auto):
        _add_span(each)
        each.set_defaults(command_of_one=not several)
        each.add_argument(
            "--strict",
            action="store_true",
            help="refuse what is not as the format has it, instead of reading it and saying so",
        )
        add_options(each)


def _add_files(
    parser: argparse.ArgumentParser, ground_truth: str, estimate: str, several: bool
) -> None:
    parser.add_argument("ground_truth", metavar="GROUND_TRUTH", help=ground_truth)
    parser.add_argument("estimate", metavar="ESTIMATE", help=estimate, nargs="+" if several else 1)


def _add_span(parser: argparse.ArgumentParser) -> None:
    for name, text in (("start", "leave out what comes before"), ("end", "and what comes after")):
        parser.add_argument(
            f"--{name}",
            metavar="T",
            type=_instant,
            help=f"{text}: seconds since the ground truth's first pose, or a stamp (s, ns) where it"
            " is 1e8 or more",
        )


def _instant(text: str) -> Instant:
    try:
        return Instant.of(text)
    except SpanError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def cut(arguments: argparse.Namespace, data: Inputs, time_offsets: Sequence[float]) -> Inputs:
    """Return the inputs cut to ``--start`` and ``--end``; a remark says what was left out.

    ``time_offsets`` (s) are added to the stamps of the estimates.

    Raises
    ------
    CommandError
        Where nothing is left.
    """
    try:
        span = span_of(arguments.start, arguments.end, data.ground_truth)
        if span is None:
            return data
        offsets = [round(offset * SECOND) for offset in time_offsets]
        truth, estimates = cut_all(
            span,
            data.ground_truth,
            dict(zip(data.names, data.estimates, strict=True)),
            dict(zip(data.names, offsets, strict=True)),
        )
    except SpanError as error:
        raise CommandError(str(error)) from error
    kept = tuple(estimates.values())
    remarks = (*data.remarks, words(span, truth, kept))
    return replace(data, ground_truth=truth, estimates=kept, remarks=remarks)


def _add_times(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--times",
        metavar="TIMES",
        help="the stamps of KITTI's poses, one a row, s (default: 10 Hz, the benchmark's)",
    )


def _add_topics(parser: argparse.ArgumentParser, several: bool) -> None:
    topic = "a topic, or /tf:PARENT.CHILD for a transform"
    parser.add_argument("--ground-truth", metavar="TOPIC", help=topic)
    parser.add_argument(
        "--estimate",
        metavar="TOPIC",
        action="append",
        default=[],
        help=topic + ("; repeat it for several estimates" if several else ""),
    )


def with_format(argv: Sequence[str]) -> list[str]:
    """Return the arguments with ``auto`` in front where they do not begin with a format."""
    named = not argv or argv[0] in (*FORMATS, AUTO, "-h", "--help", "--version")
    return [*argv] if named else [AUTO, *argv]


def recognised(arguments: argparse.Namespace) -> argparse.Namespace:
    """Return the arguments of ``auto`` as those of the format that is found; others as they are.

    Raises
    ------
    CommandError
        For what cannot be read.
    UsageError
        For files that do not make up a ground truth and an estimate.
    """
    if arguments.format != AUTO:
        return arguments
    files: list[str] = arguments.files
    if PurePath(files[0]).name == files[0] and "." not in files[0] and not Path(files[0]).exists():
        raise UsageError(
            f"there is neither a file nor a format {files[0]!r}; formats: {', '.join(FORMATS)}"
        )
    try:
        found = [recognise(file) for file in files]
    except TrajectoryFileError as error:
        raise CommandError(str(error)) from error
    given = vars(arguments)
    if len(files) == 1 and found[0].format == "bag":
        return argparse.Namespace(**{**given, "format": "bag", "bag": files[0]})
    for file, kind in zip(files, found, strict=True):
        if kind.format not in _FILE_READERS:
            raise CommandError(f"{file}: it is {kind.evidence}, which does not go with other files")
    if arguments.ground_truth is not None or arguments.estimate:
        raise UsageError("--ground-truth and --estimate name topics, and there is no bag")
    if len(files) == 1 or (arguments.command_of_one and len(files) > 2):
        raise UsageError("name a ground truth and an estimate, in this order")
    names = {"ground_truth": files[0], "estimate": files[1:], "found": tuple(found)}
    return argparse.Namespace(**{**given, **names})


def read(arguments: argparse.Namespace) -> Inputs:
    """Read what the command line names, ``auto`` as `recognised`.

    Raises
    ------
    CommandError
        For what cannot be read as a trajectory; names the file and the row. With ``--strict`` also
        for what is not as its format has it.
    """
    try:
        inputs = _READERS[arguments.format](arguments)
    except TrajectoryFileError as error:
        raise CommandError(str(error)) from error
    differences = _differences(inputs.ground_truth, *inputs.estimates)
    if arguments.strict and differences:
        raise CommandError(f"--strict: {differences[0]}")
    return replace(inputs, remarks=inputs.remarks + differences)


def _read_tum(arguments: argparse.Namespace) -> Inputs:
    from trajeval_ros.files.tum import read_tum

    return _inputs(arguments.estimate, read_tum(arguments.ground_truth), read_tum)


def _read_euroc(arguments: argparse.Namespace) -> Inputs:
    from trajeval_ros.files.euroc import read_euroc
    from trajeval_ros.files.tum import read_tum

    def read_estimate(path: str) -> Trajectory:
        return (read_euroc if path.lower().endswith(".csv") else read_tum)(path)

    return _inputs(arguments.estimate, read_euroc(arguments.ground_truth), read_estimate)


def _read_kitti(arguments: argparse.Namespace) -> Inputs:
    from trajeval_ros.files.kitti import read_kitti

    def read_file(path: str) -> Trajectory:
        return read_kitti(path, arguments.times)

    data = _inputs(arguments.estimate, read_file(arguments.ground_truth), read_file)
    return data if arguments.times else replace(data, remarks=(_TEN_HERTZ,))


def _read_auto(arguments: argparse.Namespace) -> Inputs:
    found: tuple[Recognised, ...] = arguments.found
    paths = (arguments.ground_truth, *arguments.estimate)
    ground_truth, *estimates = (
        _FILE_READERS[kind.format](path, arguments) for path, kind in zip(paths, found, strict=True)
    )
    files: dict[str, list[str]] = {}
    for path, kind in zip(paths, found, strict=True):
        files.setdefault(f"{kind.format} ({kind.evidence})", []).append(path)
    remarks = ["read as " + "; as ".join(f"{k}: {', '.join(p)}" for k, p in files.items())]
    if arguments.times is None and any(kind.format == "kitti" for kind in found):
        remarks.append(_TEN_HERTZ)
    return Inputs(ground_truth, tuple(estimates), names_of(arguments.estimate), tuple(remarks))


def _tum_file(path: str, arguments: argparse.Namespace) -> Trajectory:
    from trajeval_ros.files.tum import read_tum

    return read_tum(path)


def _euroc_file(path: str, arguments: argparse.Namespace) -> Trajectory:
    from trajeval_ros.files.euroc import read_euroc

    return read_euroc(path)


def _kitti_file(path: str, arguments: argparse.Namespace) -> Trajectory:
    from trajeval_ros.files.kitti import read_kitti

    return read_kitti(path, arguments.times)


def _read_bag(arguments: argparse.Namespace) -> Inputs:
    from trajeval_ros.files.bag import read_bag

    topics = (arguments.ground_truth, *arguments.estimate)
    if arguments.command_of_one and len(topics) > 2:
        raise UsageError("one --estimate is enough")
    with Progress("reading", 0, "messages") as progress:
        if arguments.ground_truth is None or not arguments.estimate:
            _list_candidates(arguments.bag, progress)
        ground_truth, *estimates = read_bag(arguments.bag, topics, progress.update)
    return Inputs(ground_truth, tuple(estimates), names_of(arguments.estimate))


def _inputs(
    paths: Sequence[str], ground_truth: Trajectory, read_estimate: Callable[[str], Trajectory]
) -> Inputs:
    return Inputs(ground_truth, tuple(map(read_estimate, paths)), names_of(paths))


def names_of(paths: Sequence[str]) -> tuple[str, ...]:
    """Return a name in snake_case for each of several files or topics, by what they are called.

    One is ``estimate``, whatever it is called; files of the same name are told apart by their
    folders.
    """
    from trajeval_ros.online.parameters import ONE, is_taken

    if len(paths) <= 1:
        return ONE
    stems = [PurePath(path).stem for path in paths]
    told_apart = len(set(stems)) == len(stems)
    sources = stems if told_apart else [str(PurePath(path).with_suffix("")) for path in paths]
    names: list[str] = []
    for source in sources:
        name = re.sub(r"[^a-z0-9]+", "_", source.lower()).strip("_") or ONE[0]
        if not name[0].isalpha() or is_taken(name):
            name = f"{ONE[0]}_{name}"
        numbered = (f"{name}_{number}" for number in itertools.count(2))
        names.append(name if name not in names else next(n for n in numbered if n not in names))
    return tuple(names)


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
    AUTO: _read_auto,
}
# A single file, of a format that was recognised.
_FILE_READERS: dict[str, Callable[[str, argparse.Namespace], Trajectory]] = {
    "tum": _tum_file,
    "euroc": _euroc_file,
    "kitti": _kitti_file,
}
_TEN_HERTZ = "no --times: the poses of KITTI's files are taken to be 0.1 s apart, from 0 s"


def check_overlap(ground_truth: Trajectory, estimate: Trajectory, time_offset: float) -> None:
    """Refuse trajectories that have no time in common.

    Raises
    ------
    CommandError
        Names both ranges.
    """
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
