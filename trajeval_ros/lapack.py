# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""SciPy's wrappers of LAPACK, loaded when the first of them is called.

To load them takes longer than many a file to be evaluated: with the loops in C they are not needed.
"""

from typing import Any


def __getattr__(name: str) -> Any:
    """Return a function of :mod:`scipy.linalg.lapack`, and have it from now on."""
    if name.startswith("_"):
        # What Python itself asks of a module.
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from scipy.linalg import lapack

    function = globals()[name] = getattr(lapack, name)
    return function
