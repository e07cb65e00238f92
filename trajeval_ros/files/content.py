# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The text of a file, or of standard input, whatever it is packed or encoded in."""

import os
import sys
import zlib
from typing import NamedTuple

from trajeval_ros.files.trajectory import TrajectoryFileError

PathLike = str | os.PathLike[str]

STANDARD_INPUT = "-"

_GZIP = b"\x1f\x8b"
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")
# What text has of control characters.
_IN_TEXT = frozenset("\t\n\v\f\r")


class Content(NamedTuple):
    """A file's text.

    Attributes:
        source: the file as the user named it.
        text: all of it, with line feeds.
        remarks: what is unlike a plain file of UTF-8, a clause each.
    """

    source: str
    text: str
    remarks: tuple[str, ...]


def read_content(path: PathLike) -> Content:
    """Read a text: UTF-8, UTF-16 with its mark, or Latin-1; gzip'd or not; ``-``: standard input.

    Raises:
        TrajectoryFileError: it cannot be read, or is not text.
    """
    source = os.fspath(path)
    remarks: list[str] = []
    text = _text(source, _read(source), remarks)
    name = "standard input" if source == STANDARD_INPUT else source
    return Content(name, text, tuple(remarks))


def text_of(source: str, head: bytes, *, cut: bool) -> str:
    """The whole lines of the first bytes of a file, as `read_content` would read it.

    Raises:
        TrajectoryFileError: it is not text.
    """
    if cut and not head.startswith(_GZIP):
        end = b"\n\0" if head.startswith(_UTF_16[0]) else b"\n"
        head = head[: head.rfind(end) + len(end)] if end in head else head
    text = _text(source, head, [])
    return text[: text.rfind("\n") + 1] if cut and "\n" in text else text


def _text(source: str, data: bytes, remarks: list[str]) -> str:
    if data.startswith(_GZIP):
        data = _unpacked(source, data, remarks)
    stripped = data.rstrip(b"\0")
    if len(stripped) < len(data) and stripped and not data.startswith(_UTF_16):
        remarks.append(f"{len(data) - len(stripped):,} zero bytes at the end are left out")
        data = stripped
    text = _decoded(source, data, remarks)
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    return text


def _read(source: str) -> bytes:
    try:
        if source == STANDARD_INPUT:
            return sys.stdin.buffer.read()
        with open(source, "rb") as file:
            return file.read()
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise TrajectoryFileError(source, f"it cannot be read: {reason}") from None


def _unpacked(source: str, data: bytes, remarks: list[str]) -> bytes:
    """What gzip packed, which may be several pieces; of a cut one what can be read."""
    parts: list[bytes] = []
    while data.startswith(_GZIP):
        unpacker = zlib.decompressobj(wbits=zlib.MAX_WBITS | 16)
        try:
            parts.append(unpacker.decompress(data))
        except zlib.error:
            raise TrajectoryFileError(source, "it is a damaged gzip file") from None
        if not unpacker.eof:
            remarks.append("the gzip file is cut off: its readable part")
            break
        data = unpacker.unused_data
    return b"".join(parts)


def _decoded(source: str, data: bytes, remarks: list[str]) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        pass
    if data.startswith(_UTF_16):
        remarks.append("encoded in UTF-16")
        # A killed writer may have left half a character.
        return data.decode("utf-16", errors="ignore")
    text = data.decode("latin-1")
    if any(c < " " and c not in _IN_TEXT for c in text):
        raise TrajectoryFileError(source, "it is not a text file")
    remarks.append("not UTF-8: taken for Latin-1")
    return text
