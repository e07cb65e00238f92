# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``evaluate``: the node's engine on files, as fast as it goes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from trajeval_ros.commands import console

DESCRIPTION = """\
Score estimated trajectories against one ground truth, from files. Reference first, then one
estimate or several.
The figures are those of the node evaluator on the same data."""

_APPLICABLE = ("clock_offset", "extrinsic", "scale")

EPILOG = """\
exit codes: 0 done; 1 the data could not be evaluated, or a file not be written; 2 wrong usage"""


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    from trajeval_ros.commands import inputs

    parser = argparse.ArgumentParser(
        prog="evaluate",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    console.add_version(parser)
    inputs.add_formats(parser, _add_options, several=True)
    return parser


def _add_options(parser: argparse.ArgumentParser) -> None:
    from trajeval_ros.commands import settings

    settings.add_arguments(parser)
    parser.add_argument(
        "--output",
        metavar="DIR",
        help="write summary.json, poses.csv and report.html to this folder",
    )
    parser.add_argument(
        "--apply",
        metavar="WHAT",
        type=_applicable,
        default=(),
        help="evaluate again with what the error model has found, of clock_offset,extrinsic,scale;"
        " the files are those of the second evaluation",
    )


def _applicable(text: str) -> tuple[str, ...]:
    """What ``--apply`` names."""
    names = tuple(name.strip() for name in text.split(","))
    for name in names:
        if name not in _APPLICABLE:
            raise argparse.ArgumentTypeError(f"{name!r} is none of {', '.join(_APPLICABLE)}")
    return names


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    from trajeval_ros.commands import inputs

    given = sys.argv[1:] if argv is None else argv
    arguments = make_parser().parse_args(inputs.with_format(given))
    return console.run(lambda: evaluate(arguments), "evaluate")


def evaluate(arguments: argparse.Namespace) -> int:
    """Read, feed the engine, write, print."""
    from trajeval_ros.commands import inputs, settings

    arguments = inputs.recognised(arguments)
    names = inputs.names_of(arguments.estimate)
    parameters = settings.read(arguments.params, arguments.assignments, names)
    data = inputs.read(arguments)
    offsets = [float(parameters[f"{name}.time_offset"]) for name in data.names]  # type: ignore[arg-type]
    for estimate, offset in zip(data.estimates, offsets, strict=True):
        inputs.check_overlap(data.ground_truth, estimate, offset)
    data = inputs.cut(arguments, data, offsets)
    # Only now, so that wrong usage and bad files are known at once: this brings in SciPy.
    from trajeval_ros.commands import scoring

    output = arguments.output or str(parameters["output.directory"])
    return scoring.score(data, parameters, output, arguments.apply)


if __name__ == "__main__":
    sys.exit(main())
