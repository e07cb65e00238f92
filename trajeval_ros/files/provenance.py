# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which data a summary is of: the files as they were named, and what was in them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

# A bag of more bytes than this is named, and not gone through once more.
_MOST_BYTES = 1 << 30
_TOPIC = ", topic "


def described(source: str) -> dict[str, Any]:
    """Return what ``source``, a trajectory's, is: its ``path`` and ``topic`` as they were named.

    Of a file that can be read also its ``bytes`` and, up to a gigabyte, its ``sha256``; of a folder
    those of all files in it, by name and content. A source that is no path, an array in memory, is
    a ``name``.
    """
    path, _, topic = source.partition(_TOPIC)
    of_topic = {"topic": topic} if topic else {}
    try:
        files = _files(Path(path))
        if not files:
            return {"name": source}
        size = _bytes(files)
        found = {"path": path, **of_topic, "bytes": size}
        if size <= _MOST_BYTES:
            found["sha256"] = _digest(Path(path), files)
        return found
    except OSError:
        # It was read a moment ago, and what it was then cannot be told any more.
        return {"path": path, **of_topic}


def named(source: str) -> dict[str, Any]:
    """Return what ``source`` is by its name alone: where nobody is told, no file is read for it."""
    return {"name": source}


def bytes_of(path: str) -> int:
    """Return the size of a file, or of all files in a folder; of none, 0.

    Raises :class:`OSError` for what cannot be read.
    """
    return _bytes(_files(Path(path)))


def content_of(path: str) -> str:
    """Return the sha256 of a file, or of all files in a folder, however large; of none, ``absent``.

    Raises :class:`OSError` for what cannot be read.
    """
    files = _files(Path(path))
    return _digest(Path(path), files) if files else "absent"


def _files(path: Path) -> list[Path]:
    if path.is_dir():
        return sorted(file for file in path.rglob("*") if file.is_file())
    return [path] if path.is_file() else []


def _bytes(files: list[Path]) -> int:
    return sum(file.stat().st_size for file in files)


def _digest(path: Path, files: list[Path]) -> str:
    if files == [path]:
        return _sha256(path)
    import hashlib

    whole = hashlib.sha256()
    for file in files:
        # As sha256sum prints it: `sha256sum FILES | sha256sum` in the folder finds the same.
        whole.update(f"{_sha256(file)}  {os.fspath(file.relative_to(path))}\n".encode())
    return whole.hexdigest()


def _sha256(path: Path) -> str:
    # Only here: it brings in OpenSSL.
    import hashlib

    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
