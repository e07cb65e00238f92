# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The conventional errors, ATE and RE, as everyone knows them."""
