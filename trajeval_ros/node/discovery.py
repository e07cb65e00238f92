# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How to subscribe to a topic, decided from its publishers; no ROS calls here."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

_MOST_SHOWN = 8

Reliability = Literal["reliable", "best_effort"]
Durability = Literal["volatile", "transient_local"]


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A publisher as the graph shows it; ``type_name`` as in ``geometry_msgs/msg/PoseStamped``."""

    node: str
    type_name: str
    reliability: Reliability
    durability: Durability


@dataclass(frozen=True, slots=True)
class Offer:
    """A subscription: the type's short name and its quality of service."""

    type_name: str
    reliability: Reliability
    durability: Durability


@dataclass(frozen=True, slots=True)
class Plan:
    """What to subscribe to (None: nothing that could be), and why some publisher is not heard."""

    offer: Offer | None
    problems: tuple[str, ...]


def plan(
    topic: str,
    publishers: Sequence[Endpoint],
    type_name: str,
    reliability: str,
    known: Mapping[str, str],
    current: Offer | None,
) -> Plan:
    """Decide how to subscribe to ``topic`` (its resolved name, for the messages).

    ``type_name`` and ``reliability`` are the parameters' values (``auto`` among them), ``known``
    the types that can be read, by ROS name. Without a publisher ``current`` stays: it may come
    back. A reliable subscription hears no best-effort publisher, a transient-local one no volatile
    publisher; so each asks for no more than the least of its publishers offers.
    """
    readable = [p for p in publishers if p.type_name in known]
    chosen = _choose_type(readable, type_name, known, current)
    problems = _type_problems(topic, publishers, known, chosen, type_name)
    if chosen is None:
        return Plan(None, problems)
    heard = [p for p in readable if known[p.type_name] == chosen]
    asked, more = _choose_reliability(topic, heard, reliability, current)
    if heard:
        latched = all(p.durability == "transient_local" for p in heard)
        durability: Durability = "transient_local" if latched else "volatile"
    else:
        durability = "volatile" if current is None else current.durability
    return Plan(Offer(chosen, asked, durability), (*problems, *more))


def waiting(
    silent: Mapping[str, Sequence[Endpoint]], fitting: Mapping[str, str] | None
) -> str | None:
    """Return what the node waits for, and what there is instead; None where nothing is missing.

    ``silent``: the topics on which nothing has come yet, with their publishers; ``fitting``: the
    topics of a type that can be read that others publish, with that type's short name; None while
    they are not known.
    """
    if not silent:
        return None
    named = []
    for topic, publishers in silent.items():
        # The middleware knows a publisher before it knows whose it is.
        nodes = {p.node if "_UNKNOWN_" not in p.node else "a node" for p in publishers}
        by = ", ".join(sorted(nodes))
        named.append(f"{topic} ({by} publishes it, no message yet)" if nodes else topic)
    text = f"waiting for {' and '.join(named)}"
    if fitting is None or all(silent.values()):
        return text
    others = [f"{topic} ({kind})" for topic, kind in sorted(fitting.items()) if topic not in silent]
    if not others:
        return f"{text}; no other topic of a fitting type is published"
    shown = ", ".join(others[:_MOST_SHOWN])
    more = f" and {len(others) - _MOST_SHOWN} more" if len(others) > _MOST_SHOWN else ""
    return f"{text}; of a fitting type there is {shown}{more}: remap with -r NAME:=TOPIC"


def _choose_type(
    readable: Sequence[Endpoint], type_name: str, known: Mapping[str, str], current: Offer | None
) -> str | None:
    if type_name != "auto":
        return type_name
    counts = Counter(known[p.type_name] for p in readable)
    if current is not None and (not counts or counts[current.type_name]):
        return current.type_name
    # The most frequent one; the first seen, where they are equal.
    return counts.most_common(1)[0][0] if counts else None


def _type_problems(
    topic: str,
    publishers: Sequence[Endpoint],
    known: Mapping[str, str],
    chosen: str | None,
    type_name: str,
) -> tuple[str, ...]:
    """One line for each type that is published and not heard."""
    parameter = "auto" if type_name == "auto" else f"{type_name}, set by parameter"
    problems = []
    for other in sorted({p.type_name for p in publishers}):
        nodes = ", ".join(sorted({p.node for p in publishers if p.type_name == other}))
        if other not in known:
            readable = ", ".join(known.values())
            problems.append(
                f"{topic}: {nodes} publishes {other}, which cannot be read;"
                f" remap to a topic of type {readable}"
            )
        elif known[other] != chosen:
            problems.append(
                f"{topic}: {nodes} publishes {known[other]}, but {chosen} is subscribed to"
                f" ({parameter}); set the type parameter, or remap one of the publishers"
            )
    return tuple(problems)


def _choose_reliability(
    topic: str, heard: Sequence[Endpoint], reliability: str, current: Offer | None
) -> tuple[Reliability, tuple[str, ...]]:
    unreliable = [p for p in heard if p.reliability == "best_effort"]
    if reliability == "best_effort":
        return "best_effort", ()
    if reliability == "reliable":
        nodes = ", ".join(sorted({p.node for p in unreliable}))
        remedy = "set the reliability parameter to auto or best_effort"
        problem = f"{topic}: {nodes} publishes best effort, which a reliable subscription"
        return "reliable", (f"{problem} cannot hear; {remedy}",) if unreliable else ()
    if not heard:
        return ("reliable" if current is None else current.reliability), ()
    return ("best_effort" if unreliable else "reliable"), ()
