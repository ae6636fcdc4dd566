# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Stores the limits of the last fleet run for later evaluations of its rows."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from trackres_ros.files.jsons import parse_json
from trackres_ros.files.own_files import read, write
from trackres_ros.fleet.vehicles import HIGHEST_LIMIT, Fleet

FILE, MOST_BYTES = "fleet.json", 1 << 24


def keep(folder: Path, fleet: Fleet) -> None:
    """Write the limits of a fleet."""
    limits: dict[str, float] = {}
    for vehicle in fleet.vehicles.values():
        limits |= vehicle.limits
    write(folder / FILE, (json.dumps({"limits": limits}, indent=2) + "\n").encode())


def limits_of(folder: Path, given: Mapping[str, float]) -> dict[str, float]:
    """Limits of the last run, and the given ones in their place."""
    try:
        kept = {str(name): float(of) for name, of in parse_json(read(folder / FILE, MOST_BYTES))["limits"].items()}
        return {**{name: limit for name, limit in kept.items() if 0.0 <= limit <= HIGHEST_LIMIT}, **given}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return dict(given)
