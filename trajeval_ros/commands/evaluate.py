# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""``evaluate``: the node's engine on files, as fast as it goes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from trajeval_ros import memory
from trajeval_ros.commands import completion, console, evo_options

if TYPE_CHECKING:
    from trajeval_ros.commands.baseline import Baseline
    from trajeval_ros.commands.exports import Exports
    from trajeval_ros.commands.requirements import Requirement
    from trajeval_ros.commands.scoring import Outcome

DESCRIPTION = """\
Score estimated trajectories against one ground truth, from files. Reference first, then one
estimate or several.
The figures are those of the node evaluator on the same data."""

_APPLICABLE = ("clock_offset", "extrinsic", "scale")

EPILOG = """\
examples:
  evaluate GROUND_TRUTH ESTIMATE --output results    two files of any format
  evaluate tum GROUND_TRUTH A.txt B.txt              which of two is better
  evaluate bag run.mcap                              the topics with a trajectory
  evaluate bag run.mcap /ground_truth /odom          two of them
  evaluate tum GROUND_TRUTH ESTIMATE --set gauge=sim3 --set relative.delta=5
  evaluate tum --help                                all options and parameters

several runs of each of several systems, with medians: benchmark --help

exit codes: 0 done; 1 the data could not be evaluated, or a file not be written; 2 wrong usage;
3 evaluated, and not as good as --require or --baseline asks for"""


def make_parser(asked: str | None = None) -> argparse.ArgumentParser:
    """Return the parser of the command line; ``asked``: of one format alone."""
    from trajeval_ros.commands import inputs

    parser = argparse.ArgumentParser(
        prog="evaluate",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    console.add_version(parser)
    inputs.add_formats(parser, _add_options, several=True, asked=asked)
    return parser


def _add_options(parser: argparse.ArgumentParser) -> None:
    from trajeval_ros.commands import settings

    settings.add_arguments(parser)
    parser.add_argument(
        "--output",
        metavar="DIR",
        help="write summary.json, poses.csv and report.html to this folder (default: none of them)",
    )
    parser.add_argument(
        "--mcap",
        metavar="FILE",
        help="write what the node would have published, and the trajectories, to this bag",
    )
    parser.add_argument(
        "--rerun",
        metavar="FILE",
        help="write trajectories, the ground truth's uncertainty and errors for Rerun (.rrd)",
    )
    parser.add_argument(
        "--figures",
        metavar="DIR",
        help="write the figures of a paper to this folder: PDF and SVG, for one column and for two",
    )
    parser.add_argument(
        "--apply",
        metavar="WHAT",
        type=_applicable,
        default=(),
        help="evaluate again with what the error model has found, of clock_offset,extrinsic,scale;"
        " the files are those of the second evaluation",
    )
    parser.add_argument(
        "--align-origin",
        action="store_true",
        help="lay the first pose of an estimate on the ground truth's, and align nothing else: all"
        " hangs on that one pose",
    )
    parser.add_argument(
        "--require",
        metavar="CONDITION",
        type=_requirement,
        action="append",
        default=[],
        help="what a figure of summary.json must be, such as"
        " 'conventional.ate_translation_rmse < 0.05'; SI units; exit code 3 where it is not;"
        " repeatable. With several estimates of each, or of one: NAME.conventional...",
    )
    parser.add_argument(
        "--baseline",
        metavar="SUMMARY",
        help="the summary.json of an earlier run, or its folder; exit code 3 where an estimate is"
        " significantly worse than it was, by its poses where poses.csv lies beside it",
    )
    parser.add_argument(
        "--json",
        action="store_true",
        help="print the summary alone on stdout, as in summary.json; all else goes to stderr",
    )
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")


def _requirement(text: str) -> Requirement:
    """What ``--require`` asks for."""
    from trajeval_ros.commands.requirements import Requirement

    return Requirement.of(text)


def _applicable(text: str) -> tuple[str, ...]:
    """What ``--apply`` names."""
    names = tuple(name.strip() for name in text.split(","))
    for name in names:
        if name not in _APPLICABLE:
            raise argparse.ArgumentTypeError(f"{name!r} is none of {', '.join(_APPLICABLE)}")
    return names


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code; without ``argv``, as a process of its own."""
    if argv is None:
        memory.begin()
    from trajeval_ros.commands import inputs

    given = sys.argv[1:] if argv is None else argv
    if completion.is_asked():
        completion.complete(make_parser(), inputs.with_format)
    whole = inputs.with_format(given)
    arguments, unknown = make_parser(*whole[:1]).parse_known_args(whole)
    if unknown:
        return console.fail("evaluate", evo_options.refusal(unknown), console.WRONG_USAGE)
    arguments.given = tuple(given)
    return console.run(lambda: evaluate(arguments), "evaluate")


def evaluate(arguments: argparse.Namespace) -> int:
    """Evaluate, print, and hold the figures to what is required of them."""
    with console.directed(quiet=arguments.quiet, to_stderr=arguments.json):
        outcome = _outcome(arguments)
        good = _requirements_hold(arguments.require, outcome)
        good = _is_no_worse(outcome) and good
    if arguments.json:
        import json

        print(json.dumps(outcome.summary, indent=2, allow_nan=False))
    sys.stdout.flush()
    failures = [
        *outcome.failures,
        *(f"--baseline: {one.failure}" for one in outcome.judgements.values() if one.failure),
    ]
    for line in failures:
        console.fail("evaluate", line, console.NOT_EVALUATED)
    if failures:
        return console.NOT_EVALUATED
    return console.DONE if good else console.NOT_GOOD_ENOUGH


def _outcome(arguments: argparse.Namespace) -> Outcome:
    """Read, feed the engine, write, print."""
    from trajeval_ros.commands import inputs, settings

    arguments = inputs.recognised(arguments)
    names = inputs.names_of(arguments.estimate)
    if arguments.require:
        from trajeval_ros.commands.requirements import check

        check(arguments.require, names)
    parameters = settings.read(arguments.params, arguments.assignments, names)
    # Before this run's files take their place.
    earlier: Mapping[str, Baseline] = {}
    if arguments.baseline:
        from trajeval_ros.commands import baseline

        earlier = baseline.read(arguments.baseline, names)
    if arguments.align_origin and parameters["gauge"] not in ("se3", "none"):
        gauge = parameters["gauge"]
        raise console.UsageError(f"--align-origin aligns by itself: it excludes gauge={gauge}")
    exports = _exports(arguments)
    data = inputs.read(arguments)
    offsets = [float(parameters[f"{name}.time_offset"]) for name in data.names]  # type: ignore[arg-type]
    for estimate, offset in zip(data.estimates, offsets, strict=True):
        inputs.check_overlap(data.ground_truth, estimate, offset)
    data = inputs.cut(arguments, data, offsets)
    # Only now, so that wrong usage and bad files are known at once: this brings in SciPy.
    from trajeval_ros.commands import scoring

    memory.loaded()
    output = arguments.output or str(parameters["output.directory"])
    return scoring.score(
        data,
        parameters,
        output,
        arguments.apply,
        earlier,
        align_origin=arguments.align_origin,
        given=arguments.given,
        exports=exports,
        is_told=bool(output or exports or arguments.json or arguments.require),
    )


def _exports(arguments: argparse.Namespace) -> Exports | None:
    """What is to be written for other tools; refused here where it could not be."""
    if not (arguments.mcap or arguments.rerun or arguments.figures):
        return None
    from trajeval_ros.commands.exports import Exports

    exports = Exports(arguments.mcap, arguments.rerun, arguments.figures)
    exports.require_libraries()
    return exports


def _requirements_hold(requirements: Sequence[Requirement], outcome: Outcome) -> bool:
    """Say of each requirement whether it holds; return whether all do."""
    if not requirements:
        return True
    from trajeval_ros.commands.requirements import judge

    verdicts = judge(requirements, outcome.summary, tuple(outcome.found))
    for number, verdict in enumerate(v for v in verdicts if v.holds):
        print(("" if number else "\n") + f"Required      {verdict.line}")
    sys.stdout.flush()
    failed = [verdict for verdict in verdicts if not verdict.holds]
    for verdict in failed:
        console.fail("evaluate", f"required: {verdict.line}", console.NOT_GOOD_ENOUGH)
    return not failed


def _is_no_worse(outcome: Outcome) -> bool:
    """Say how each estimate compares with its baseline; return whether none is worse."""
    several = len(outcome.judgements) > 1
    for name, judgement in outcome.judgements.items():
        console.say(["", *([f"{name}:"] if several else []), *judgement.said])
    sys.stdout.flush()
    good = True
    for name, judgement in outcome.judgements.items():
        for line in judgement.worse:
            good = False
            owner = f"{name}: " if several else ""
            console.fail("evaluate", f"worse than before: {owner}{line}", console.NOT_GOOD_ENOUGH)
    return good


if __name__ == "__main__":
    sys.exit(main())
