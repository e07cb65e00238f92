# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A ROS domain that nobody else on this machine is in."""

from __future__ import annotations

import random
import socket
from collections.abc import Iterator
from contextlib import contextmanager

from trajeval_ros.commands.console import CommandError

# Ports of a domain (DDSI-RTPS, 9.6.1): PB + DG d, and for participant p PB + DG d + d1 + 2 p.
_PORT_BASE, _DOMAIN_GAIN, _FIRST_PARTICIPANT, _PARTICIPANT_GAIN = 7400, 250, 10, 2
# Robots are in the low ones; beyond 101 the ports meet Linux's ephemeral ones.
_DOMAINS = range(20, 102)
# Participants take the lowest free number, so that one of the first is there while any is.
_PARTICIPANTS = range(10)


@contextmanager
def own_domain() -> Iterator[int]:
    """Yield the number of a ROS domain that nobody is in, kept from other callers until the end.

    The claim is a TCP port, which DDS leaves alone and the system gives back whatever happens to
    us. In a random order: a domain is not taken again while its dead are remembered.

    Raises
    ------
    CommandError
        If there is none.
    """
    for domain in random.sample(_DOMAINS, len(_DOMAINS)):
        with socket.socket() as claim:
            port = _PORT_BASE + _DOMAIN_GAIN * domain
            if _taken(claim, port) or _inhabited(port):
                continue
            yield domain
            return
    raise CommandError("no ROS domain is free on this machine")


def _inhabited(port: int) -> bool:
    for participant in _PARTICIPANTS:
        with socket.socket(type=socket.SOCK_DGRAM) as probe:
            if _taken(probe, port + _FIRST_PARTICIPANT + _PARTICIPANT_GAIN * participant):
                return True
    return False


def _taken(end: socket.socket, port: int) -> bool:
    """Bind the socket, and say whether somebody else has that port."""
    try:
        end.bind(("", port))
    except OSError:
        return True
    return False
