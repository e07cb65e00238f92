# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether a publisher that has left had sent all it had: then its departure is no warning."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

from trajeval_ros.commands.live import Health

SENT = "replay: sent"
"""The status on ``/diagnostics`` in which ``replay`` says, at the end, how much of each topic."""

_DEPARTED = re.compile(r"(\S+): its publisher is gone$")


def without_departure(health: Health, sent: Mapping[str, int]) -> Health:
    """Health in which a departure is no finding where the topic was received whole.

    ``sent``: messages of each topic, as their publishers have said once all were out. Of one that
    left in the middle nothing is said, so more, or fewer, are received, and the warning stays.
    """
    findings = health.message.split("; ")
    others = [finding for finding in findings if not _was_whole(finding, health, sent)]
    if len(others) == len(findings):
        return health
    if others:
        return replace(health, message="; ".join(others))
    return replace(health, level=0, message="all has been sent")


def _was_whole(finding: str, health: Health, sent: Mapping[str, int]) -> bool:
    found = _DEPARTED.search(finding)
    count = sent.get(found[1]) if found else None
    return count is not None and str(count) == health.values.get("received")
