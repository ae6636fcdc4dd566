# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fits in, chosen effects out: what can be seen, what gains, what is told apart, and what held-out laps confirm."""
