# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""``benchmark``: many runs of several systems on several sequences."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from trajeval_ros.commands import completion, console
from trajeval_ros.commands.benchmark_progress import BenchmarkProgress

if TYPE_CHECKING:
    from trajeval_ros.benchmarking.manifest import Manifest
    from trajeval_ros.benchmarking.work import Row

DESCRIPTION = """\
Evaluate many runs: every estimate that a manifest names, on all cores or on a Dask cluster.
Writes results.csv as it goes, and at the end results.parquet, tables (md, tex, html), a report."""

EPILOG = """\
examples:
  benchmark --discover DIR                      writes DIR/manifest.yaml, of what lies there
  benchmark manifest.yaml --output results
  benchmark manifest.yaml --output results --resume
  benchmark manifest.yaml --output new --baseline results --fail-on regression

exit codes: 0 done; 1 no run could be evaluated, or the cluster is gone; 2 wrong usage, or a
mistake in the manifest; 3 significantly worse than the baseline"""


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="benchmark",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    console.add_version(parser)
    parser.add_argument("manifest", metavar="MANIFEST", nargs="?", help="docs/benchmark.md has it")
    parser.add_argument("--output", metavar="DIR", help="where results and tables are written")
    parser.add_argument(
        "--discover", metavar="DIR", help="write DIR/manifest.yaml, of what lies in DIR"
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="a Dask scheduler, such as tcp://host:8786, whose workers see the same files",
    )
    where.add_argument(
        "--workers",
        metavar="N",
        type=console.integer(1, 1024),
        help="processes on this machine (default: its cores)",
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help="keep the rows in DIR whose files and parameters are the same as now",
    )
    parser.add_argument(
        "--baseline", metavar="RESULTS", help="results.parquet of an earlier one, or its folder"
    )
    parser.add_argument(
        "--fail-on",
        choices=["regression"],
        help="exit code 3 where a system is significantly worse than in the baseline",
    )
    parser.add_argument(
        "--junit", metavar="FILE", help="write the comparison with the baseline as JUnit XML"
    )
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = make_parser()
    completion.complete(parser)
    arguments = parser.parse_args(sys.argv[1:] if argv is None else argv)
    return console.run(lambda: benchmark(arguments), "benchmark")


def benchmark(arguments: argparse.Namespace) -> int:
    """Discover; or evaluate, print, and hold to the baseline."""
    from trajeval_ros.benchmarking.manifest import ManifestError, discover, read_manifest

    _check(arguments)
    try:
        if arguments.discover is not None:
            print(f"Written: {discover(arguments.discover)}")
            return console.DONE
        manifest = read_manifest(Path(arguments.manifest))
    except ManifestError as error:
        for problem in error.problems:
            console.fail("benchmark", problem, console.WRONG_USAGE)
        return console.WRONG_USAGE
    try:
        import distributed  # noqa: F401
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise console.CommandError(
            f"{error.name} is not installed: pip install 'trajeval_ros[benchmark]'"
        ) from error
    # Read before anything runs: wrong usage is known at once.
    before = _baseline(arguments.baseline) if arguments.baseline else None
    rows = _rows(arguments, manifest)
    _say(rows, Path(arguments.output).expanduser())
    code = console.DONE
    if before is not None:
        code = _gate(arguments, rows, before)
    if not any(row["status"] == "ok" for row in rows):
        return console.fail("benchmark", "no run could be evaluated", console.NOT_EVALUATED)
    return code


def _check(arguments: argparse.Namespace) -> None:
    if arguments.discover is not None:
        if arguments.manifest is not None or arguments.output is not None:
            raise console.UsageError("--discover writes a manifest, and does nothing else")
        return
    if arguments.manifest is None:
        raise console.UsageError("name a MANIFEST, or a folder with --discover")
    if arguments.output is None:
        raise console.UsageError("--output is needed: where the results go")
    for option in ("fail_on", "junit"):
        if getattr(arguments, option) is not None and arguments.baseline is None:
            raise console.UsageError(f"--{option.replace('_', '-')} needs a --baseline")


def _baseline(path: str) -> list[Row]:
    from trajeval_ros.benchmarking.results import ResultsError, read_brief

    try:
        return read_brief(Path(path).expanduser())
    except ResultsError as error:
        raise console.UsageError(f"--baseline: {error}") from error


def _rows(arguments: argparse.Namespace, manifest: Manifest) -> list[Row]:
    from trajeval_ros.benchmarking.cluster import ClusterError, cluster
    from trajeval_ros.benchmarking.results import ResultsError
    from trajeval_ros.benchmarking.whole import OutputExistsError, run

    folder = Path(arguments.output).expanduser()
    progress = BenchmarkProgress()
    try:
        with (
            cluster(arguments.scheduler, arguments.workers) as client,
            progress,
        ):
            return run(manifest, folder, client, resume=arguments.resume, progress=progress.update)
    except KeyboardInterrupt:
        done, total = sum(progress.done.values()), sum(progress.total.values())
        print(f"{done:,} of {total:,} runs are done; --resume goes on with them", file=sys.stderr)
        raise
    except (OutputExistsError, ResultsError) as error:
        raise console.UsageError(f"--output: {error}") from error
    except ClusterError as error:
        raise console.CommandError(f"{error}; --resume goes on with what is done") from error
    except (FileExistsError, NotADirectoryError, PermissionError) as error:
        # Anything but a folder that can be written.
        text = f"cannot write {error.filename}: {error.strerror}"
        raise console.CommandError(text) from error


def _say(rows: Sequence[Row], folder: Path) -> None:
    from trajeval_ros.benchmarking.grids import summary
    from trajeval_ros.benchmarking.table import compare
    from trajeval_ros.benchmarking.tables import markdown

    print(markdown(summary(compare(rows))))
    for row in rows:
        if row["status"] != "ok":
            name = "/".join(str(row[part]) for part in ("system", "sequence", "run"))
            print(f"{row['status']}: {name}: {row['error']}")
    print(
        f"Written: report.html, results.csv, .parquet, tables.md, .tex, .html in {folder}",
        flush=True,
    )


def _gate(arguments: argparse.Namespace, rows: Sequence[Row], before: Sequence[Row]) -> int:
    from trajeval_ros.benchmarking.gate import GateError, judge, write_junit
    from trajeval_ros.benchmarking.whole import publish

    try:
        verdict = judge(rows, before)
    except GateError as error:
        raise console.CommandError(f"--baseline: {error}") from error
    publish(Path(arguments.output).expanduser(), rows, verdict)
    print(f"\nBaseline      {arguments.baseline}")
    for change in verdict.changes:
        print(f"  {change.line}")
    for system, sequence in verdict.missing:
        print(f"  {system} has no run on {sequence} any more")
    sys.stdout.flush()
    if arguments.junit is not None:
        path = Path(arguments.junit).expanduser()
        try:
            write_junit(path, verdict)
        except OSError as error:
            raise console.CommandError(f"--junit: {path}: {error.strerror}") from error
    if arguments.fail_on == "regression" and verdict.regressed:
        return console.fail("benchmark", "worse than the baseline", console.NOT_GOOD_ENOUGH)
    return console.DONE


if __name__ == "__main__":
    sys.exit(main())
