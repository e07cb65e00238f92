# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What an engine holds in memory."""

import gc

import numpy as np


def size_of(thing, seen):
    """Bytes of the arrays that an engine holds."""
    if id(thing) in seen:
        return 0
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        base = thing if thing.base is None else thing.base
        if base is not thing and id(base) in seen:
            return 0
        seen.add(id(base))
        return getattr(base, "nbytes", thing.nbytes)
    if isinstance(thing, str | int | float | type) or callable(thing):
        return 0
    if type(thing).__module__.split(".")[0] not in ("trajeval_ros", "builtins", "collections"):
        return 0
    return sum(size_of(part, seen) for part in gc.get_referents(thing))


def held(engine):
    return size_of(engine, set())
