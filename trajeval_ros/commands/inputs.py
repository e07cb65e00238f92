# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The two trajectories that ``evaluate`` and ``replay`` work on, as sub-commands by format."""

from __future__ import annotations

import argparse
import itertools
import re
from collections.abc import Callable, Sequence
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, NamedTuple, NoReturn

from trajeval_ros.commands.console import Answered, CommandError, Progress, UsageError
from trajeval_ros.commands.figures import table
from trajeval_ros.files import sources
from trajeval_ros.files.content import STANDARD_INPUT
from trajeval_ros.files.trajectory import Trajectory, TrajectoryFileError
from trajeval_ros.wall import shield

if TYPE_CHECKING:
    from trajeval_ros.files.recognise import Recognised
    from trajeval_ros.files.span import Instant

FORMATS = ("tum", "euroc", "kitti", "bag")
AUTO = "auto"
SECOND = 1_000_000_000


class Inputs(NamedTuple):
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
    asked: str | None = None,
) -> None:
    """Declare one sub-command a format; ``add_options`` declares what they share.

    ``several``: whether more than one estimate may be named. ``asked``: the only format that needs
    its options, where that is known; to declare all takes some milliseconds.
    """
    formats = parser.add_subparsers(dest="format", metavar="FORMAT", required=True)
    tum = formats.add_parser(
        "tum", help="TUM files: stamp[s] tx ty tz qx qy qz qw", allow_abbrev=False
    )
    _add_files(tum, "the reference", "what is to be scored", several)
    euroc = formats.add_parser(
        "euroc",
        help="EuRoC ground truth (csv, ns, w x y z) and an estimate in TUM's format",
        allow_abbrev=False,
    )
    _add_files(
        euroc, "the reference, csv", "in TUM's format; EuRoC's where it ends in .csv", several
    )
    kitti = formats.add_parser(
        "kitti", help="KITTI files: the twelve numbers of 3x4 matrices", allow_abbrev=False
    )
    _add_files(kitti, "the reference", "what is to be scored", several)
    _add_times(kitti)
    bag = formats.add_parser(
        "bag",
        help="two topics of a bag: ROS 1, or ROS 2 (a folder, sqlite3, mcap); by header stamps",
        allow_abbrev=False,
    )
    bag.add_argument("bag", metavar="BAG", help="file or folder; without topics: lists them")
    bag.add_argument(
        "topics",
        metavar="TOPIC",
        nargs="*",
        help="the ground truth's and the estimate's, as with the two options",
    )
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
        help="GROUND_TRUTH and ESTIMATE; or a bag, with its topics. Here and wherever a file is"
        " named, its format may stand before it: tum:FILE, euroc:FILE, kitti:FILE:TIMES,"
        " npz:FILE:TIMES, nerfstudio:FILE, bag:BAG:TOPIC",
    )
    _add_times(auto)
    _add_topics(auto, several)
    for each in (tum, euroc, bag):
        each.set_defaults(times=None)
    for each in (tum, euroc, kitti, bag, auto):
        _add_span(each)
        each.set_defaults(command_of_one=not several)
        if asked is not None and each is not formats.choices.get(asked):
            continue
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
    from trajeval_ros.files.span import Instant, SpanError

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
    UsageError
        Where the end comes before the start.
    """
    if arguments.start is arguments.end is None:
        return data
    from trajeval_ros.files.span import OrderError, SpanError, cut_all, span_of, words

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
    except OrderError as error:
        raise UsageError(str(error)) from error
    except SpanError as error:
        raise CommandError(str(error)) from error
    kept = tuple(estimates.values())
    remarks = (*data.remarks, words(span, truth, kept))
    return data._replace(ground_truth=truth, estimates=kept, remarks=remarks)


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
    if arguments.format == "bag":
        return _with_topics(arguments, arguments.topics)
    if arguments.format != AUTO:
        return arguments
    from trajeval_ros.files.recognise import recognise

    files: list[str] = arguments.files
    unnamed = [file for file in files if sources.split(file)[0] is None]
    if unnamed[:1] == [STANDARD_INPUT]:
        raise UsageError("name the format of the standard input: tum:- or euroc:-")
    if files[:1] == unnamed[:1] and _is_word(files[0]):
        raise UsageError(
            f"there is neither a file nor a format {files[0]!r}; formats: {', '.join(FORMATS)}"
        )
    topics = files[1:] if not any(Path(one).exists() for one in files[1:]) else []
    try:
        found = [recognise(one) if one in unnamed and one not in topics else None for one in files]
        given = vars(arguments)
        if found[0] is not None and found[0].format == "bag" and len(files) == 1 + len(topics):
            bag = argparse.Namespace(**{**given, "format": "bag", "bag": files[0]})
            return _with_topics(bag, topics)
        found = [recognise(one) if one in unnamed else None for one in files]
    except TrajectoryFileError as error:
        raise CommandError(str(error)) from error
    for file, kind in zip(files, found, strict=True):
        if kind is not None and kind.format == "bag":
            raise CommandError(f"{file}: it is {kind.evidence}: which topic? name bag:{file}:TOPIC")
    if arguments.ground_truth is not None or arguments.estimate:
        raise UsageError("--ground-truth and --estimate name topics, and there is no bag")
    if len(files) == 1 or (arguments.command_of_one and len(files) > 2):
        raise UsageError("name a ground truth and an estimate, in this order")
    names = {"ground_truth": files[0], "estimate": files[1:], "found": tuple(found)}
    return argparse.Namespace(**{**given, **names})


def _with_topics(arguments: argparse.Namespace, topics: Sequence[str]) -> argparse.Namespace:
    """The arguments with topics that stand behind the bag, as with the options."""
    if not topics:
        return arguments
    if arguments.ground_truth is not None or arguments.estimate:
        raise UsageError("name the topics behind the bag, or by --ground-truth and --estimate")
    if len(topics) == 1:
        raise UsageError("name two topics: the ground truth's and the estimate's, in this order")
    named = {"ground_truth": topics[0], "estimate": list(topics[1:])}
    return argparse.Namespace(**{**vars(arguments), **named})


def _is_word(file: str) -> bool:
    """Whether it looks like a format rather than a file."""
    return PurePath(file).name == file and "." not in file and not Path(file).exists()


def read(arguments: argparse.Namespace) -> Inputs:
    """Read what the command line names, ``auto`` as `recognised`.

    Raises
    ------
    CommandError
        For what cannot be read as a trajectory; names the file and the row. With ``--strict`` also
        for what is not as its format has it.
    """
    try:
        inputs = _read_bag(arguments) if arguments.format == "bag" else _read_files(arguments)
    except TrajectoryFileError as error:
        raise CommandError(str(error)) from error
    differences = _differences(inputs.ground_truth, *inputs.estimates)
    if arguments.strict and differences:
        raise CommandError(f"--strict: {differences[0]}")
    return inputs._replace(remarks=inputs.remarks + differences)


def _read_files(arguments: argparse.Namespace) -> Inputs:
    """Two files or more, of the formats that stand before their names or of the command's."""
    paths = (arguments.ground_truth, *arguments.estimate)
    if paths.count(STANDARD_INPUT) + sum(path.endswith(f":{STANDARD_INPUT}") for path in paths) > 1:
        raise UsageError("only one of them can be the standard input")
    found: tuple[Recognised | None, ...] = getattr(arguments, "found", (None,) * len(paths))
    read: list[Trajectory] = []
    files: dict[str, list[str]] = {}
    stampless = False
    for place, (path, kind) in enumerate(zip(paths, found, strict=True)):
        format_, name = sources.split(path)
        if format_ is None:
            format_ = _default(arguments.format, path, place) if kind is None else kind.format
        with Progress(f"reading {path}", 0, "messages") as progress:
            read.append(sources.read(format_, name, arguments.times, progress.update))
        stampless |= format_ == "kitti" and arguments.times is None and name == read[-1].source
        if kind is not None:
            files.setdefault(f"{kind.format} ({kind.evidence})", []).append(path)
    remarks = ["read as " + "; as ".join(f"{k}: {', '.join(p)}" for k, p in files.items())]
    remarks = (remarks if files else []) + ([_TEN_HERTZ] if stampless else [])
    return Inputs(read[0], tuple(read[1:]), names_of(arguments.estimate), tuple(remarks))


def _default(command: str, path: str, place: int) -> str:
    """The format of the file at a place of the command line, the ground truth at 0."""
    if command == "euroc" and place and not path.lower().endswith(".csv"):
        return "tum"
    return command


def _read_bag(arguments: argparse.Namespace) -> Inputs:
    from trajeval_ros.files.bag import read_bag

    topics = (arguments.ground_truth, *arguments.estimate)
    if arguments.command_of_one and len(topics) > 2:
        raise UsageError("one --estimate is enough")
    with Progress("reading", 0, "messages") as progress:
        if arguments.ground_truth is None or not arguments.estimate:
            asked = arguments.ground_truth is None and not arguments.estimate
            _list_candidates(arguments.bag, progress, asked)
        named = [sources.split(topic) for topic in topics]
        of_bag = [topic for format_, topic in named if format_ is None]
        in_bag = iter(read_bag(arguments.bag, of_bag, progress.update) if of_bag else ())
        ground_truth, *estimates = (
            next(in_bag) if format_ is None else sources.read(format_, name)
            for format_, name in named
        )
    return Inputs(ground_truth, tuple(estimates), names_of(arguments.estimate))


def names_of(paths: Sequence[str]) -> tuple[str, ...]:
    """Return a name in snake_case for each of several files or topics, by what they are called.

    One is ``estimate``, whatever it is called; files of the same name are told apart by their
    folders.
    """
    from trajeval_ros.online.parameters import ONE, is_taken

    if len(paths) <= 1:
        return ONE
    paths = [sources.place_of(path) for path in paths]
    stems = [PurePath(path).stem for path in paths]
    told_apart = len(set(stems)) == len(stems)
    called = stems if told_apart else [str(PurePath(path).with_suffix("")) for path in paths]
    names: list[str] = []
    for source in called:
        name = re.sub(r"[^a-z0-9]+", "_", source.lower()).strip("_") or ONE[0]
        if not name[0].isalpha() or is_taken(name):
            name = f"{ONE[0]}_{name}"
        numbered = (f"{name}_{number}" for number in itertools.count(2))
        names.append(name if name not in names else next(n for n in numbered if n not in names))
    return tuple(names)


def _list_candidates(bag: str, progress: Progress, asked: bool) -> NoReturn:
    """Print the topics that hold a trajectory, and ask for two of them.

    Without any topic on the command line the list is what was ``asked`` for.
    """
    from trajeval_ros.files.bag import list_candidates

    candidates = list_candidates(bag, progress.update)
    if not candidates:
        raise CommandError(f"{bag}: no topic in it holds a trajectory")
    rows = [("topic", "type", "count", "rate")]
    # Without its package, and the table fits a terminal.
    types = (re.sub(r"\w+/(msg/)?(?=\w)", "", c.message_type) for c in candidates)
    rows += [
        (c.topic, kind, f"{c.count:,}", "-" if c.rate is None else f"{c.rate:.1f} Hz")
        for c, kind in zip(candidates, types, strict=True)
    ]
    print("\n".join(table(rows, left=2)), flush=True)
    if asked:
        print(
            "\nName two of them behind the bag: the ground truth's, then the estimate's", flush=True
        )
        raise Answered
    raise UsageError("name two of these topics, with --ground-truth and with --estimate")


_TEN_HERTZ = "no --times: the poses of KITTI's files are taken to be 0.1 s apart, from 0 s"


def check_overlap(ground_truth: Trajectory, estimate: Trajectory, time_offset: float) -> None:
    """Refuse trajectories that have no time in common.

    Raises
    ------
    CommandError
        Names both ranges, and what is likely to be the reason.
    """
    for trajectory in (ground_truth, estimate):
        if len(trajectory) == 0:
            raise CommandError(f"{trajectory.source}: no row has a finite stamp")
    offset = round(time_offset * SECOND)
    first, last = _range(estimate)
    known_first, known_last = _range(ground_truth)
    if last + offset < known_first or first + offset > known_last:
        shifted = f" (with the time offset of {time_offset:g} s)" if offset else ""
        # Only where it comes to that: it searches.
        from trajeval_ros.commands.overlap import likely_reason

        # What goes wrong in explaining does not take the place of what is explained.
        reason = shield(
            "the search for the reason",
            lambda: likely_reason(ground_truth, estimate, time_offset),
            "",
            lambda line: None,
        )
        raise CommandError(
            "the trajectories do not overlap in time:"
            f" ground truth {_in_seconds(known_first)} to {_in_seconds(known_last)},"
            f" estimate {_in_seconds(first + offset)} to {_in_seconds(last + offset)}{shifted}"
            f"{reason}"
        )


def _range(trajectory: Trajectory) -> tuple[int, int]:
    return int(trajectory.stamps.min()), int(trajectory.stamps.max())


def _in_seconds(stamp: int) -> str:
    return f"{stamp / SECOND:.3f} s"
