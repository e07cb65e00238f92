# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``evaluate``: the node's engine on files, as fast as it goes."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Sequence
from typing import Any

from trajeval_ros.commands import console

DESCRIPTION = """\
Score an estimated trajectory against ground truth, from files. Reference first, estimate second.
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
    inputs.add_formats(parser, _add_options)
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
    arguments = make_parser().parse_args(argv)
    return console.run(lambda: evaluate(arguments), "evaluate")


def evaluate(arguments: argparse.Namespace) -> int:
    """Read, feed the engine, write, print."""
    from trajeval_ros.commands import figures, inputs, settings
    from trajeval_ros.files.output import FILES, OutputError, OutputFolder
    from trajeval_ros.report import Report, answers

    parameters = settings.read(arguments.params, arguments.assignments)
    data = inputs.read(arguments)
    inputs.check_overlap(data, float(parameters["estimate.time_offset"]))  # type: ignore[arg-type]
    # Only now, so that wrong usage and bad files are known at once: this brings in SciPy.
    from trajeval_ros.commands import scoring

    sources = {"ground truth": data.ground_truth.source, "estimate": data.estimate.source}
    output = arguments.output or parameters["output.directory"]
    before: dict[str, Any] | None = None
    if arguments.apply:
        before, _ = scoring.score(data, parameters, Report(parameters, sources), None)
        data, parameters = scoring.corrected(data, parameters, before, arguments.apply)
    report = Report(parameters, sources)
    failures: dict[str, str] = {}
    full = ""
    with contextlib.ExitStack() as stack:
        folder = None
        try:
            folder = stack.enter_context(OutputFolder(str(output))) if output else None
        except OutputError as error:
            if not error.full:
                raise console.CommandError(str(error)) from error
            full = str(error)
        summary, places = scoring.score(data, parameters, report, folder)
        try:
            if output and folder is None:
                # There may be room by now: not for the rows, which are gone.
                folder = stack.enter_context(OutputFolder(str(output)))
                folder.lack(summary["estimate"]["evaluated"], full)
            if folder is not None:
                folder.write(summary, report.render, last=True)
        except OutputError as error:
            failures = error.failures or dict.fromkeys(FILES, str(error))

    print(f"{sources['estimate']} against {sources['ground truth']}\n")
    lines = answers.error_model_lines(summary.get("error_model"))
    lines += answers.applied_lines(before, summary, arguments.apply)
    print("\n".join([*lines, ""] if lines else []))
    print("\n".join(figures.summary_lines(summary, parameters)))
    remarks = [
        f"likely cause: {cause['text']}. To try: {cause['advice']}."
        for cause in summary["likely_causes"]
    ]
    remarks += [f"{notice.level}: {notice.text}" for notice in report.notices]
    remarks += places
    remarks += [f"error: {line}" for line in report.defects]
    if remarks:
        print("\n" + "\n".join(remarks))
    written = [name for name in FILES if name not in failures]
    if folder is not None and written:
        print(f"\nWritten: {', '.join(written)} in {folder.path}")
    sys.stdout.flush()
    for line in dict.fromkeys(failures.values()):
        console.fail("evaluate", line, console.NOT_EVALUATED)
    return console.NOT_EVALUATED if failures else console.DONE


if __name__ == "__main__":
    sys.exit(main())
