# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A thread for what takes a part of a second, so that messages are taken and figures go on."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from importlib import import_module
from typing import Any

from trajeval_ros.runs.beside import Outcome, Work, outcome_of

_HANDED_OVER = 1e-4  # s
# What the core loads where it first needs it: 0.1 s in which messages would wait.
_LATER = ("csv", "scipy.linalg.lapack", "scipy.special")


class Beside:
    """Does one piece of work at a time.

    In a thread and not in a process, which takes 70 MB and a start of its own. It shares the
    interpreter, which rclpy leaves and wants back at every message: with Python's 5 ms until it is
    handed over that is 200 messages a second as long as the work lasts, and with `_HANDED_OVER`
    some thousands.
    """

    def __init__(self) -> None:
        """Start idle, without a thread."""
        sys.setswitchinterval(_HANDED_OVER)
        self._thread = ThreadPoolExecutor(1, "beside")
        self._work: tuple[Work, Future[tuple[Outcome, float]]] | None = None

    def start(self, due: Callable[[], Work | None]) -> None:
        """Begin with what is ``due``, unless something is being done."""
        if self._work is None:
            work = due()
            if work is not None:
                self._work = work, self._thread.submit(_done, work.do)

    def take(self, *, wait: bool = False) -> float | None:
        """Hand over what has been done, if something has or after a ``wait`` for it.

        The processor time that it took (s); None where nothing was handed over.
        """
        if self._work is None:
            return None
        work, future = self._work
        if not (wait or future.done()):
            return None
        self._work = None
        outcome, took = future.result()
        work.take(outcome)
        return took


def loading() -> Work:
    """Have what is needed later loaded, once all is there to receive."""
    return Work(lambda: [import_module(name) for name in _LATER], lambda loaded: None)


def _done(do: Callable[[], Any]) -> tuple[Outcome, float]:
    """The outcome, and the processor time that it took (s)."""
    begin = time.thread_time()
    outcome = outcome_of(do)
    return outcome, time.thread_time() - begin
