# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A bag whose writer was killed: its whole records, in a bag that ends as it should.

An mcap file is records of one byte, a length of eight and so many bytes, between two magic words.
What comes after the data, an index and where it begins, is written last, and a reader does without
(the specification of MCAP, https://mcap.dev/spec).
"""

import contextlib
import importlib
import os
import struct
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

MAGIC = b"\x89MCAP0\r\n"

_DATA_END, _FOOTER = 0x0F, 0x02
_RECORD = struct.Struct("<BQ")
# Of a chunk: its first and last time, its size, a checksum, the length of the compression's name
# (and the name); then the size of what follows.
_CHUNK_CODE, _CHUNK, _SIZE = 0x06, struct.Struct("<QQQII"), struct.Struct("<Q")
_LARGEST_CHUNK = 1 << 28
# What rosbags brings for whole chunks: in the standard library from Python 3.14 on.
_DECOMPRESSORS = {
    b"zstd": (("compression.zstd", "backports.zstd"), "ZstdDecompressor"),
    b"lz4": (("lz4.frame",), "LZ4FrameDecompressor"),
}
_BLOCK = 1 << 20
# No index: three zeros.
_ENDING = _RECORD.pack(_FOOTER, 20) + bytes(20) + MAGIC


def salvaged(path: Path, folder: Path) -> Path | None:
    """Write the whole records of an mcap file that is cut off into a folder; None for others."""
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            return None
        end = _end_of_whole_records(file, len(MAGIC), path.stat().st_size)
        if end == len(MAGIC):
            return None
        file.seek(end)
        piece = _part_of_chunk(file.read(_LARGEST_CHUNK))
        result = folder / "part.mcap"
        file.seek(0)
        with result.open("wb") as part:
            _copy(file, part, end)
            part.write(piece + _ENDING)
    return result


def _part_of_chunk(data: bytes) -> bytes:
    """Of a chunk that is cut off its whole records, as a chunk that is not compressed."""
    name_at = _RECORD.size + _CHUNK.size
    if len(data) < name_at + _SIZE.size or data[0] != _CHUNK_CODE:
        return b""
    begin, end, _, _, name_size = _CHUNK.unpack_from(data, _RECORD.size)
    records_at = name_at + name_size + _SIZE.size
    records = _unpacked(data[name_at : name_at + name_size], data[records_at:])
    size = _end_of_whole_records(BytesIO(records), 0, len(records))
    if size == 0:
        return b""
    # A checksum of zero says that there is none.
    body = _CHUNK.pack(begin, end, size, 0, 0) + _SIZE.pack(size) + records[:size]
    return _RECORD.pack(_CHUNK_CODE, len(body)) + body


def _unpacked(compression: bytes, data: bytes) -> bytes:
    """As much as can be told of compressed data that are cut off."""
    if not compression:
        return data
    names, kind = _DECOMPRESSORS.get(compression, ((), ""))
    for name in names:
        with contextlib.suppress(ImportError):
            decompressor = getattr(importlib.import_module(name), kind)()
            return bytes(decompressor.decompress(data))
    return b""


def _end_of_whole_records(file: BinaryIO, first: int, size: int) -> int:
    """Where the last whole record of data ends, of those from ``first`` on."""
    end = first
    while True:
        file.seek(end)
        head = file.read(_RECORD.size)
        if len(head) < _RECORD.size:
            break
        code, length = _RECORD.unpack(head)
        after = end + _RECORD.size + length
        if code in (0, _DATA_END, _FOOTER) or after > size:
            break
        end = after
    return end


def _copy(source: BinaryIO, target: BinaryIO, count: int) -> None:
    """Copy so many bytes."""
    while count > 0:
        block = source.read(min(count, _BLOCK))
        if not block:
            break
        target.write(block)
        count -= len(block)


def lone_bag(folder: Path) -> Path | None:
    """The only bag in a folder that has no metadata: its recorder was killed before it wrote it."""
    bags = [entry for entry in sorted(os.listdir(folder)) if entry.endswith((".mcap", ".db3"))]
    return folder / bags[0] if len(bags) == 1 else None
