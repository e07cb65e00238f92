# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Child processes that never outlive us."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self


class Child:
    """One of our own executables, run as ``python -m``; what it prints goes to a log file.

    In a process group of its own, so that Ctrl-C in the terminal reaches us alone and we end the
    children in order. At the end of the context it is interrupted, and killed where it has not
    ended ``patience`` seconds later.
    """

    def __init__(
        self, module: str, arguments: Sequence[str], log: Path, patience: float = 5.0
    ) -> None:
        self.name = module.rpartition(".")[2]
        self.log = log
        self._patience = patience
        with log.open("wb") as output:
            self._process = subprocess.Popen(
                [sys.executable, "-m", module, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def exit_code(self) -> int | None:
        """Return the exit code, or None while it runs."""
        return self._process.poll()

    def interrupt(self, patience: float) -> int:
        """Send SIGINT, wait, and return the exit code; kill what does not end in time."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
        try:
            return self._process.wait(patience)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()

    def last_words(self, lines: int = 1) -> str:
        """Return the end of its log, on one line."""
        text = self.log.read_text(encoding="utf-8", errors="replace")
        return " / ".join(text.strip().splitlines()[-lines:]) or "(it printed nothing)"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self.interrupt(self._patience)
        finally:
            # Interrupted ourselves.
            if self._process.poll() is None:
                self._process.kill()
                self._process.wait()
