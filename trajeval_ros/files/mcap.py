# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags that are written: one mcap file, whole or not at all.

Written with the library rosbags, the extra ``bags``; no ROS is needed. The messages are those of
Jazzy. A message is logged at its stamp.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trajeval_ros.files.partial import workshop

Serialize = Callable[[Any, str], bytes]


class BagWriteError(Exception):
    """The bag cannot be written; the message, one line, names path and reason."""


@dataclass(frozen=True)
class Topic:
    """A topic's type, such as ``nav_msgs/msg/Path``; ``latched``: for those who come later too."""

    kind: str
    latched: bool = False


def message_types() -> tuple[Mapping[str, Any], Serialize]:
    """The message types by name, and what makes a message's bytes of it and its type's name.

    Raises
    ------
    BagWriteError
        If rosbags is not installed.
    """
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise BagWriteError("writing bags needs the library rosbags: pip install rosbags") from None
    store = get_typestore(Stores.ROS2_JAZZY)

    def serialize(message: Any, kind: str) -> bytes:
        return bytes(store.serialize_cdr(message, kind))

    return store.types, serialize


def write_mcap(
    path: Path, topics: Mapping[str, Topic], messages: Iterable[tuple[int, str, bytes]]
) -> None:
    """Write the messages: when (ns), topic, bytes. A reader sees the old file or the new one.

    Raises
    ------
    BagWriteError
        If rosbags is not installed, or the file cannot be written.
    """
    message_types()
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    path = path.absolute()
    try:
        with workshop(path) as folder:
            # The library writes a folder with the file in it, which is called as it is.
            bag = folder / path.stem
            with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
                connections = {
                    name: writer.add_connection(
                        name,
                        topic.kind,
                        typestore=store,
                        offered_qos_profiles=[_quality(topic.latched)],
                    )
                    for name, topic in topics.items()
                }
                for when, name, raw in messages:
                    writer.write(connections[name], when, raw)
            os.replace(bag / f"{bag.name}.mcap", path)
    except OSError as error:
        raise BagWriteError(f"cannot write {path}: {error.strerror or error}") from error


def _quality(latched: bool) -> Any:
    """What the node offers: reliable, the last 100, or the last one also to those who come late."""
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    never = QosTime(9_223_372_036, 854_775_807)
    return Qos(
        QosHistory.KEEP_LAST,
        1 if latched else 100,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        never,
        never,
        QosLiveliness.AUTOMATIC,
        never,
        False,
    )
