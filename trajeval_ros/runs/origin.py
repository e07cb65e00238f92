# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a summary says of where it comes from, so that it can be made again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trajeval_ros import __version__
from trajeval_ros.online.parameters import PARAMETERS, Value

Described = Mapping[str, Any]


def origin(
    parameters: Mapping[str, Value], ground_truth: Described, estimate: Described
) -> dict[str, Any]:
    """Return ``version``, ``inputs`` and ``parameters`` of a summary.

    ``parameters``: every one's value, as they held for the ``estimate``, by the names of a run with
    one. The inputs are as :func:`~trajeval_ros.files.provenance.described` has them, or topics.
    """
    return {
        "version": __version__,
        "inputs": {"ground_truth": dict(ground_truth), "estimate": dict(estimate)},
        "parameters": {name: parameters[name] for name in PARAMETERS},
    }
