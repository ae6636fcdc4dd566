# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks stamps against the range of a message: builtin_interfaces/msg/Time has int32 seconds and less than 1e9 nanoseconds."""

from __future__ import annotations

from trackres_ros.units import SECOND_NS

FIRST_NS, LAST_NS = -(2**31) * SECOND_NS, 2**31 * SECOND_NS - 1
UNUSABLE = LAST_NS + 1
"""Marks an invalid stamp; no message can carry it."""


def stamp_ns(seconds: int, nanoseconds: int) -> int:
    """A stamp [ns] from its two numbers, `UNUSABLE` if they are invalid."""
    stamp = seconds * SECOND_NS + nanoseconds
    return stamp if 0 <= nanoseconds < SECOND_NS and is_usable(stamp) else UNUSABLE


def is_usable(stamp: int) -> bool:
    """Whether a message can carry it [ns]."""
    return FIRST_NS <= stamp <= LAST_NS


def nearest_usable(stamp: int) -> int:
    """The nearest stamp [ns] that a message can carry."""
    return min(max(stamp, FIRST_NS), LAST_NS)
