# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A publisher that has left: a warning, unless what it had was received whole."""

from __future__ import annotations

import pytest

from trajeval_ros.commands.live import Health
from trajeval_ros.commands.sent import without_departure

GONE = "/estimate: its publisher is gone"


def health(message: str, received: int) -> Health:
    return Health(1, message, {"topic": "/estimate", "received": str(received)})


def test_a_topic_that_was_received_whole_is_well() -> None:
    found = without_departure(health(GONE, 240), {"/estimate": 240, "/ground_truth": 1200})
    assert (found.level, found.message) == (0, "all has been sent")


@pytest.mark.parametrize(
    "sent",
    [
        pytest.param({}, id="it left in the middle"),
        pytest.param({"/estimate": 241}, id="one did not come"),
        pytest.param({"/estimate": 200}, id="another one left in the middle"),
        pytest.param({"/ground_truth": 240}, id="another topic"),
    ],
)
def test_a_departure_in_the_middle_stays_a_warning(sent: dict[str, int]) -> None:
    assert without_departure(health(GONE, 240), sent) == health(GONE, 240)


def test_what_else_there_is_to_say_stays() -> None:
    found = without_departure(
        health(f"3 messages lost on the way; {GONE}", 240), {"/estimate": 240}
    )
    assert (found.level, found.message) == (1, "3 messages lost on the way")
