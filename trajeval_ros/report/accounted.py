# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What became of every message, in one line."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def account(counts: Mapping[str, Any], taken: str) -> str:
    """Return one line that accounts for every message: received = taken + pending + rejected."""
    parts = [f"{counts['received']:,} received", f"{counts[taken]:,} {taken}"]
    if counts.get("pending"):
        parts.append(f"{counts['pending']:,} pending")
    rejected = {reason: count for reason, count in counts["rejected"].items() if count}
    if rejected:
        reasons = ", ".join(f"{count:,} {reason}" for reason, count in rejected.items())
        parts.append(f"{sum(rejected.values()):,} rejected ({reasons})")
    if counts.get("cut"):
        parts.append(f"{counts['cut']:,} cut away")
    return ", ".join(parts)
