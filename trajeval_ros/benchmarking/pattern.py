# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Where estimates lie: ``results/{system}/{sequence}/{run}.txt``."""

from __future__ import annotations

import glob
import os
import re
from dataclasses import dataclass
from pathlib import Path

FIELDS = ("system", "sequence", "run")


class PatternError(ValueError):
    """The text is no pattern; the message is one line."""


@dataclass(frozen=True)
class Pattern:
    """A path with fields in braces. A field stands for a part of one folder's or file's name."""

    text: str

    @classmethod
    def of(cls, text: str) -> Pattern:
        """Check a pattern: ``{system}`` and ``{sequence}`` are in it; ``{run}`` may be."""
        names = re.findall(r"\{([^{}]*)\}", text)
        for name in names:
            if name not in FIELDS:
                raise PatternError(f"{{{name}}} is none of {{system}}, {{sequence}}, {{run}}")
        for name in FIELDS[:2]:
            if name not in names:
                raise PatternError(f"{{{name}}} is missing in {text!r}")
        if re.search(r"[{}]", re.sub(r"\{[a-z]+\}", "", text)):
            raise PatternError(f"a brace without its other in {text!r}")
        return cls(text)

    def of_sequence(self, sequence: str) -> str:
        """The pattern with the sequence in its place."""
        return self.text.replace("{sequence}", sequence)

    def files(self, folder: Path, sequence: str) -> list[tuple[str, str, str]]:
        """System, run and path of every file (or bag's folder) of a sequence, sorted.

        Without ``{run}`` in the pattern there is one run, called ``1``.
        """
        text = os.path.normpath(os.path.join(folder, os.path.expanduser(self.text)))
        parts = re.split(r"\{(\w+)\}", text)
        wild, seen = "", set[str]()
        expression = ""
        for place, part in enumerate(parts):
            if place % 2 == 0:
                wild += glob.escape(part)
                expression += re.escape(part)
            elif part == "sequence":
                wild += glob.escape(sequence)
                expression += re.escape(sequence)
            else:
                wild += "*"
                expression += f"(?P={part})" if part in seen else f"(?P<{part}>[^/]+)"
                seen.add(part)
        found = []
        for path in sorted(glob.glob(wild)):
            match = re.fullmatch(expression, path)
            if match:
                found.append((match["system"], match["run"] if "run" in seen else "1", path))
        return found
