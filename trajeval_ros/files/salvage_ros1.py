# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A ROS 1 bag whose writer was killed, or of which a part is missing: its whole messages.

After a line of magic a bag is records: the size of a header, its fields, the size of the data, the
data. A field is its size, and ``name=value``. Chunks are records whose data are records, compressed
or not: connections, which say what a topic holds, and messages. What comes last is an index, which
is made anew (the format of bags, version 2.0, http://wiki.ros.org/Bags/Format/2.0).
"""

import bz2
import importlib
import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

MAGIC = b"#ROSBAG V2.0\n"

_SIZE, _TIME = struct.Struct("<I"), struct.Struct("<II")
_MESSAGE, _CHUNK, _CONNECTION = b"\x02", b"\x05", b"\x07"
_SECOND = 1_000_000_000
# A record that says that it is larger is damaged, bytes.
_LARGEST = 1 << 30

_Fields = dict[str, bytes]


def salvaged_ros1(path: Path, folder: Path) -> Path | None:
    """Write the whole messages of a bag into another in the folder; None for what is no bag."""
    from rosbags.rosbag1 import Writer

    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            return None
        result = folder / "part.bag"
        connections: dict[bytes, Any] = {}
        same: dict[tuple[bytes, ...], Any] = {}
        with Writer(result) as writer:
            for fields, data in _messages_and_connections(file):
                number = fields["conn"]
                if fields["op"] == _CONNECTION and number not in connections:
                    connections[number] = _added(writer, fields, data, same)
                elif fields["op"] == _MESSAGE and number in connections:
                    seconds, nanoseconds = _TIME.unpack(fields["time"])
                    writer.write(connections[number], seconds * _SECOND + nanoseconds, data)
    return result if connections else None


def _added(writer: Any, fields: _Fields, data: bytes, same: dict[tuple[bytes, ...], Any]) -> Any:
    """A connection as the other bag has it; one of several of the ``same`` topic and type."""
    said = _fields(data)
    key = fields["topic"], said["type"], said["md5sum"]
    if key not in same:
        package, _, name = said["type"].decode().partition("/")
        same[key] = writer.add_connection(
            fields["topic"].decode(),
            f"{package}/msg/{name}",
            msgdef=said["message_definition"].decode(),
            md5sum=said["md5sum"].decode(),
        )
    return same[key]


def _messages_and_connections(file: BinaryIO) -> Iterator[tuple[_Fields, bytes]]:
    for fields, data in _records(file):
        if fields.get("op") == _CHUNK:
            inner = _unpacked(fields["compression"], data)
            yield from (
                record
                for record in _records(BytesIO(inner), whole=True)
                if record[0].get("op") in (_MESSAGE, _CONNECTION)
            )


def _records(file: BinaryIO, whole: bool = False) -> Iterator[tuple[_Fields, bytes]]:
    """Header and data of each record; of the last one, unless ``whole``, what there is."""
    while True:
        header = _sized(file)
        if header is None or len(header[0]) < header[1]:
            return
        data = _sized(file)
        if data is None or (whole and len(data[0]) < data[1]):
            return
        yield _fields(header[0]), data[0]


def _sized(file: BinaryIO) -> tuple[bytes, int] | None:
    """Bytes that have their size in front, and the size, which may be more; None at the end."""
    head = file.read(_SIZE.size)
    if len(head) < _SIZE.size:
        return None
    (size,) = _SIZE.unpack(head)
    if size > _LARGEST:
        return None
    return file.read(size), size


def _fields(header: bytes) -> _Fields:
    found: _Fields = {}
    stream = BytesIO(header)
    while (field := _sized(stream)) is not None:
        name, _, value = field[0].partition(b"=")
        found[name.decode()] = value
    return found


def _unpacked(compression: bytes, data: bytes) -> bytes:
    """As much as can be told of compressed data, which may be cut off."""
    if compression == b"bz2":
        return bz2.BZ2Decompressor().decompress(data)
    if compression == b"lz4":
        return bytes(importlib.import_module("lz4.frame").LZ4FrameDecompressor().decompress(data))
    return data
