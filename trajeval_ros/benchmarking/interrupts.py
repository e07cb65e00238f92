# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the processes of a benchmark's own cluster load as they start."""

from __future__ import annotations

import signal
from typing import Any


def dask_setup(worker: Any) -> None:
    """Leave Ctrl-C to the command, which a terminal sends to its workers as well."""
    del worker
    signal.signal(signal.SIGINT, signal.SIG_IGN)
