# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``python -m fuzz``: random damage to every input; each case is a function of seed and number."""

from __future__ import annotations

import argparse
import importlib
import resource
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

FAMILIES = ("text", "bags", "cdr", "parameters", "relations")
_MEMORY = 8 << 30


@dataclass(frozen=True)
class Found:
    """What became of a case; ``failure`` is None where all held."""

    number: int
    family: str
    became: str
    failure: str | None


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", type=int, default=400, help="how many, of all families together")
    parser.add_argument("--only", default=",".join(FAMILIES), help="families, by commas")
    parser.add_argument("--case", type=int, help="this one alone")
    parser.add_argument("--keep", default="fuzz-failures", help="where failing inputs are kept")
    return parser


def run_case(seed: int, number: int, folder: Path) -> Found:
    """Run a case in an empty folder."""
    import numpy as np

    from fuzz.oracle import Failure

    family = FAMILIES[number % len(FAMILIES)]
    module = importlib.import_module(f"fuzz.{family}")
    try:
        became = module.case(np.random.default_rng([seed, number]), folder)
    except Failure as failure:
        return Found(number, family, "failed", str(failure))
    return Found(number, family, became, None)


def run(seed: int, numbers: Sequence[int], keep: Path) -> list[Found]:
    """Run cases, print those that fail, and keep their inputs."""
    found, missing = [], set()
    for number in numbers:
        family = FAMILIES[number % len(FAMILIES)]
        if family in missing:
            continue
        with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
            try:
                each = run_case(seed, number, Path(name))
            except ImportError as error:
                print(f"{family} left out: {error}", flush=True)
                missing.add(family)
                continue
            found.append(each)
            if each.failure is not None or len(numbers) == 1:
                kept = keep / f"{seed}-{number}"
                shutil.rmtree(kept, ignore_errors=True)
                shutil.copytree(name, kept)
                said = each.failure or each.became
                print(f"seed {seed} case {number} ({family}): {said}; kept in {kept}", flush=True)
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Return 0 if all held, 1 otherwise."""
    arguments = make_parser().parse_args(argv)
    wanted = arguments.only.split(",")
    if not set(wanted) <= set(FAMILIES):
        print(f"error: the families are {', '.join(FAMILIES)}", file=sys.stderr)
        return 2
    numbers = [arguments.case]
    if arguments.case is None:
        rounds = range(arguments.cases * len(FAMILIES) // len(wanted))
        numbers = [k for k in rounds if FAMILIES[k % len(FAMILIES)] in wanted]
    begin = time.monotonic()
    found = run(arguments.seed, numbers, Path(arguments.keep))
    failed = [each for each in found if each.failure is not None]
    print(f"\n{'family':12}{'cases':>7}{'evaluated':>11}{'refused':>9}{'failed':>8}")
    for family in wanted:
        became = Counter(
            each.became if each.became in ("evaluated", "failed") else "refused"
            for each in found
            if each.family == family
        )
        figures = (became.total(), became["evaluated"], became["refused"], became["failed"])
        print(f"{family:12}{figures[0]:7}{figures[1]:11}{figures[2]:9}{figures[3]:8}")
    print(f"seed {arguments.seed}, {time.monotonic() - begin:.0f} s")
    return int(bool(failed))


if __name__ == "__main__":
    # A damaged length must not take the machine down. Of a process of its own: it is for good.
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    sys.exit(main())
