# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a run says of a GNSS receiver's fixes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trajeval_ros.files.fixes import FixCounts
from trajeval_ros.online.results import Level, Notice


def notices_of_fixes(
    fixes: Mapping[str, FixCounts | None], parameters: Mapping[str, Any]
) -> tuple[Notice, ...]:
    """Of what modes they are, and how that is taken.

    ``fixes``: of ``ground truth`` and ``estimate``; ``parameters``: of a run with it alone.
    """
    found = []
    for title, counts in fixes.items():
        if counts is None:
            continue
        used = bool(parameters[f"{title.replace(' ', '_')}.use_covariance"])
        # Fixes that are as good as each other, or as certain as each says, are no trouble.
        mixed = counts.kinds > 1 and not used
        level: Level = "warning" if mixed or (used and counts.assumed) else "info"
        found.append(Notice(level, "fixes", counts.sentence(title, used)))
    return tuple(found)


def put_fixes_into(summary: dict[str, Any], fixes: Mapping[str, FixCounts | None]) -> None:
    """Add the counts to the accounts of a summary, where there are any."""
    for title, counts in fixes.items():
        if counts is not None:
            account = summary[title.replace(" ", "_")]
            summary[title.replace(" ", "_")] = {**account, "fixes": counts.named}
