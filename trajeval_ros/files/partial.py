# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files that are there whole or not at all: written beside their place, then renamed.

What is being written is called ``.NAME.*.partial`` and locked by its process, so that what a killed
one has left is told from what a living one writes.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO


def lock(descriptor: int) -> None:
    """Show that a living process writes it; not every file system can."""
    with contextlib.suppress(OSError):
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def remove_leftovers(folder: Path, *patterns: str) -> None:
    """Remove what killed processes have left: those of living ones are locked."""
    for pattern in patterns:
        for path in folder.glob(pattern):
            with contextlib.suppress(OSError), _opened(path) as descriptor:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if path.is_dir():
                    import shutil

                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink()


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[IO[bytes]]:
    """Yield a file to be filled, which then takes the place of ``path``."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with partial.open("wb") as file:
            lock(file.fileno())
            yield file
        partial.replace(path)
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)


@contextlib.contextmanager
def workshop(path: Path) -> Iterator[Path]:
    """Yield a folder beside ``path`` to make it in; it goes, with whatever is left in it.

    The folder of ``path`` is made, and what killed processes left of files of its kind is removed.
    """
    import tempfile

    path.parent.mkdir(parents=True, exist_ok=True)
    kind = f".*{path.suffix}" if path.suffix else f".{path.name}"
    remove_leftovers(path.parent, f"{kind}.*.partial")
    with (
        tempfile.TemporaryDirectory(
            dir=path.parent, prefix=f".{path.name}.", suffix=".partial"
        ) as folder,
        _opened(Path(folder)) as descriptor,
    ):
        lock(descriptor)
        yield Path(folder)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[int]:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        yield descriptor
    finally:
        os.close(descriptor)
