# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``python -m performance [NAME ...]``: measures, prints tables, and writes them below docs/."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import time
from collections.abc import Sequence

NAMES = {
    "calibration": "how well the ground truth knows what it does not know, on real data",
    "recordings": "the same, on recordings that no constant was chosen with",
    "ground_truth": "queries, learning and appending, beside scikit-learn; memory of an hour",
    "likelihoods": "windowed RE beside bare LAPACK; the cost and memory of a million poses",
    "commands": "the command evaluate as a process, beside evo_ape and evo_rpe",
    "estimates": "what a second estimate costs beside the first, and ten",
    "benchmark": "200 runs beside evo's commands, a worker's memory, the scheduler's overhead",
    "node": "the node's cost a message beside a bare subscriber's; its delay",
}

# One thread a process, on both sides of every ratio. Before NumPy is imported.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    listed = "\n".join(f"  {name:14}{what}" for name, what in NAMES.items())
    parser = argparse.ArgumentParser(
        prog="python -m performance",
        description=f"Measure, print, and write below docs/. The benchmarks:\n{listed}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "names", nargs="*", metavar="NAME", choices=[*NAMES, []], help="all of them by default"
    )
    parser.add_argument("--list", action="store_true", help="list the benchmarks")
    parser.add_argument("--no-docs", action="store_true", help="print only, write nothing")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run benchmarks; return 0, or 1 where one could not be run."""
    from performance import tables
    from trajeval_ros import loops

    arguments = make_parser().parse_args(argv)
    if arguments.list:
        for name, what in NAMES.items():
            print(f"{name:14}{what}")
        return 0
    if not loops.there():
        print("The loops in C are not built from these sources, or switched off: NumPy's figures.")
    skipped = False
    for name in arguments.names or NAMES:
        begin = time.monotonic()
        print(f"\n{name}: {NAMES[name]}\n", flush=True)
        try:
            for table in importlib.import_module(f"performance.{name}").run():
                if isinstance(table, tables.Table):
                    print(table.text() + "\n", flush=True)
                if not arguments.no_docs:
                    tables.write(table)
        except tables.SkippedError as reason:
            print(f"skipped: {reason}", flush=True)
            skipped = True
        print(f"({name}: {time.monotonic() - begin:.0f} s)", flush=True)
    return int(skipped and bool(arguments.names))


if __name__ == "__main__":
    sys.exit(main())
