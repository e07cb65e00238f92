# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One thread for the linear algebra.

The matrices here have tens to hundreds of rows: more threads only wait for each other, and on a
busy machine they make the whole several times slower. BLAS reads these variables when NumPy is
first imported, so the executables' packages call this first of all. Who sets them keeps them.
"""

import os

_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def use_one_thread() -> None:
    """Ask BLAS for one thread, where the environment says nothing else."""
    for name in _VARIABLES:
        os.environ.setdefault(name, "1")
