# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Holds constants of nature and of units, and the speed limit of standstill; imports nothing."""

from __future__ import annotations

GRAVITY = 9.80665  # m/s^2, ISO 80000-3
KMH_PER_MPS = 3.6
ZERO_DEGC_K = 273.15  # K
NANOSECOND = 1e-9  # s
SECOND_NS = 1_000_000_000
STANDSTILL_MPS = 0.05  # m/s, assumed: over it friction changes its sign smoothly; a fifth of 1 km/h
MAD_TO_STD = 1.4826
DEGREE = 0.017453292519943295  # rad
EARTH_M = 6371008.8  # mean radius, IUGG
