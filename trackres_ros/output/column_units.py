# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Gives the unit of a column of results from its name."""

from __future__ import annotations

UNITS = {
    "s": "s", "ns": "ns", "mps": "m/s", "mps2": "m/s^2", "n": "N", "nm": "N m", "degc": "degC", "k": "K", "w": "W",
}  # fmt: skip
"""The unit in the last word of a column name."""


def unit_of(column: str) -> str:
    """Unit of a column by its name: ``N m`` of ``resistance_torque_nm/front_left``; empty without one."""
    return UNITS.get(column.partition("/")[0].rpartition("_")[2], "")
