# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Serialised messages with wrong bytes, through the node's decoder and into its accounts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message

from fuzz import oracle
from fuzz.text import SECOND, Track, corrupted, damaged, good_run
from trajeval_ros.node.decode import POSE_TYPES, PoseType, decode
from trajeval_ros.online.parameters import complete
from trajeval_ros.runs.session import UNDECODABLE, Session

_TOPICS = ("ground_truth", "estimate")
Stream = tuple[PoseType, list[bytes]]


def serialised(kind: PoseType, track: Track) -> list[bytes]:
    """Return the poses as messages of a type."""
    made = []
    # What the message's 32 bits of seconds hold.
    stamps = track.held(-2e18, 2e18).tolist()
    poses = zip(stamps, track.positions.tolist(), track.quaternions.tolist(), strict=True)
    for stamp, at, turned in poses:
        message: Any = kind.message()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, SECOND)
        message.header.frame_id = "map"
        if kind.name == "TransformStamped":
            moved, turn = message.transform.translation, message.transform.rotation
        else:
            pose = message.pose.pose if kind.has_covariance else message.pose
            moved, turn = pose.position, pose.orientation
        moved.x, moved.y, moved.z = at
        turn.x, turn.y, turn.z, turn.w = turned
        if kind.has_covariance:
            message.pose.covariance = (1e-4 * np.eye(6)).reshape(-1)
        made.append(serialize_message(message))
    return made


def wrong(rng: np.random.Generator, raw: bytes) -> bytes:
    """Return a message with wrong bytes, at times in its encapsulation or a string's length."""
    chance = rng.random()
    if chance < 0.2:
        return bytes(rng.integers(0, 12, 2, dtype=np.uint8)) + raw[2:]
    if chance < 0.4:
        length = int(rng.choice([0, 1, 2**16, 2**31, 2**32 - 1]))
        return raw[:12] + length.to_bytes(4, "little") + raw[16:]
    return corrupted(rng, raw)


def case(rng: np.random.Generator, folder: Path) -> str:
    """Damage messages of both topics, decode them in batches, feed them, check the accounts."""
    values: dict[str, object] = {"gauge": str(rng.choice(["se3", "none", "sim3"]))}
    values |= {f"{topic}.use_covariance": bool(rng.random() < 0.3) for topic in _TOPICS}
    streams = []
    for topic, track in zip(_TOPICS, good_run(int(rng.integers(4))), strict=True):
        kind = POSE_TYPES[str(rng.choice(list(POSE_TYPES)))]
        chosen = damaged(rng, track) if rng.random() < 0.3 else track
        share = rng.choice([0.0, 0.02, 0.5])
        raw = [wrong(rng, r) if rng.random() < share else r for r in serialised(kind, chosen)]
        streams.append((kind, raw))
        (folder / f"{topic}.{kind.name}").write_bytes(b"".join(raw))
    session = Session(complete(values), {"ground truth": "/a", "estimate": "/b"})
    with oracle.guarded():
        _check_end(session, streams, _feed(rng, session, streams))
    return "evaluated"


def _feed(rng: np.random.Generator, session: Session, streams: list[Stream]) -> list[int]:
    """Feed batches of any size; return how many could not be decoded."""
    undecodable, done = [0, 0], [0, 0]
    while any(n < len(raw) for n, (_, raw) in zip(done, streams, strict=True)):
        for k, (kind, raw) in enumerate(streams):
            batch = raw[done[k] : done[k] + int(rng.integers(1, 60))]
            done[k] += len(batch)
            decoded = decode(kind, batch)
            count = len(decoded.samples) + decoded.undecodable
            oracle.require(count == len(batch), f"{count} of {len(batch)} messages decoded")
            oracle.require(bool(decoded.frames) == bool(len(decoded.samples)), "frames")
            session.note_undecodable(k, decoded.undecodable)
            undecodable[k] += decoded.undecodable
            session.feed(*((decoded.samples, None) if k == 0 else (None, decoded.samples)))
        newest = session.newest_stamps()
        session.advance(max(newest) if newest and rng.random() < 0.5 else None)
        oracle.check_accounts(session.figures())
    return undecodable


def _check_end(session: Session, streams: list[Stream], undecodable: list[int]) -> None:
    session.finish()
    session.look_for_causes()
    summary: Any = session.summary()
    oracle.check_accounts(summary)
    for topic, (_, raw), expected in zip(_TOPICS, streams, undecodable, strict=True):
        account = summary[topic]
        oracle.require(account["received"] == len(raw), f"{account['received']} of {len(raw)}")
        found = account["rejected"].get(UNDECODABLE, 0)
        oracle.require(found == expected, f"{found} of {expected} undecodable")
