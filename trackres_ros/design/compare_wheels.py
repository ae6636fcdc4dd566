# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Two vehicles without belts side by side: resistance and energy over speed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from trackres_ros.design.compare import vehicle_files
from trackres_ros.design.steady import J_PER_KWH
from trackres_ros.model.operating_point import explain_road
from trackres_ros.text.numbers import figures
from trackres_ros.text.table import table
from trackres_ros.units import KMH_PER_MPS
from trackres_ros.vehicle import RoadVehicle, load_any
from trackres_ros.vehicle.road import SECTION

POINTS, SLOWEST_SHARE = 5, 0.1


def wheels_compared(given: Sequence[str]) -> list[dict[str, Any]] | None:
    """Resistance and energy of two vehicle files without belts at five speeds; None of anything else.

    Returns speed [km/h]; of each file the resistance at its wheels [Nm] and over the way [N], and energy [kWh/km].
    """
    vehicles = [one for one in map(load_any, vehicle_files(given, SECTION)) if isinstance(one, RoadVehicle)]
    if not vehicles:
        return None
    fastest = min(one.chassis.max_speed for one in vehicles)
    rows = []
    for speed in np.linspace(SLOWEST_SHARE * fastest, fastest, POINTS).tolist():
        torques = [explain_road(one, speed)["torque_nm"]["resistance"] for one in vehicles]
        forces = [torque / one.constants.radius for torque, one in zip(torques, vehicles, strict=True)]
        energy = [1e3 * force / J_PER_KWH for force in forces]
        rows.append({"speed_kmh": KMH_PER_MPS * speed, "resistance_nm": torques, "force_n": forces, "kwh_per_km": energy})
    return rows


def wheels_text(rows: Sequence[dict[str, Any]], names: Sequence[str]) -> str:
    """The same as a table to read."""
    head = ["km/h", *(f"{name} [{unit}]" for unit in ("Nm", "N", "kWh/km") for name in names)]
    cells = [
        [figures(row["speed_kmh"]), *(figures(x) for key in ("resistance_nm", "force_n", "kwh_per_km") for x in row[key])]
        for row in rows
    ]
    return "\n".join(["", "Resistance on the level, straight on", table(cells, head)])
