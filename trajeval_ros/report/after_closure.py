# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a trajectory that is corrected later gains by it, in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def after_closure(figures: Mapping[str, Any] | None) -> str | None:
    """Return one clause of ``latest_path`` of a summary; None where there is nothing to say."""
    if figures is None:
        return None
    before, after = figures["online"]["ate_translation_rmse"], figures["ate_translation_rmse"]
    if before is None or after is None:
        return None
    return (
        f"online ATE {before:.3g} m, after closure {after:.3g} m"
        f" ({figures['scored']:,} of the latest path's {figures['poses']:,} poses)"
    )
