# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Many runs of systems on sequences: evaluated on Dask, in tables, held to a baseline."""
