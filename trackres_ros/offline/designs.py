# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Two designs side by side: resistance over speed and belt temperature, and the energy that one drive takes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trackres_ros.estimator.estimator import Estimator
from trackres_ros.model.operating_point import explain
from trackres_ros.model.vehicle_constants import vehicle_constants
from trackres_ros.offline.profile import read_profile
from trackres_ros.offline.simulate import Drive, run_drive, through_points
from trackres_ros.text.numbers import decimals
from trackres_ros.text.table import table
from trackres_ros.units import GRAVITY, KMH_PER_MPS
from trackres_ros.vehicle import Vehicle

POINTS = 5  # of speed, and of temperature
SLOWEST_KMH, COLDEST_DEGC, WARMEST_DEGC = 5.0, -20.0, 80.0
STAGES, HOLD_S, RAMP_S, STEP_S = (1 / 3, 2 / 3, 1.0), 600.0, 30.0, 0.5
J_PER_KWH = 3.6e6
TABLES = ("Resistance [Nm]", "torque_nm", 1.0, 0), ("Resistance over weight [%]", "coefficient", 100.0, 2)


def compare_designs(
    vehicles: Sequence[Vehicle],
    speeds_kmh: Sequence[float],
    belts_degc: Sequence[float],
    cycle: Path | None = None,
    advance: Callable[[float], None] = lambda _: None,
) -> dict[str, Any]:
    """Resistance of each vehicle at steady speeds and belt temperatures, and what a drive takes.

    Parameters
    ----------
    speeds_kmh, belts_degc
        The grid [km/h], [degC].
    cycle
        Speed profile of the drive, as `trackres simulate --profile` takes it; ten minutes each at a third, two thirds and all of
        the slower one's speed without.
    advance
        Takes that one more point is done.

    Returns
    -------
    dict
        Ready for JSON: torque [Nm] and coefficient (resistance over weight) by vehicle, belt temperature and speed; kWh/km of the
        drive, and per tonne.
    """
    drive = _driven(cycle, min(v.chassis.max_speed for v in vehicles))
    found = []
    for vehicle in vehicles:
        radius = vehicle_constants(vehicle).radius
        torque = np.empty((len(belts_degc), len(speeds_kmh)))
        for i, degc in enumerate(belts_degc):
            for j, kmh in enumerate(speeds_kmh):
                torque[i, j] = explain(vehicle, kmh / KMH_PER_MPS, degc)["torque_nm"]["resistance"]
                advance(1)
        estimator = Estimator(vehicle)
        rows = run_drive(estimator, drive)
        resistance = rows[:, estimator.column_index["resistance_torque_nm"]]
        driven = float(np.abs(drive.speed).sum() * STEP_S)
        energy = float((resistance * drive.speed).sum() * STEP_S / radius)
        each_km = energy / J_PER_KWH / (driven / 1000.0)
        tonnes = vehicle.weight / GRAVITY / 1000.0
        found.append(
            {
                "vehicle": vehicle.name,
                "weight_n": vehicle.weight,
                "torque_nm": torque.tolist(),
                "coefficient": (torque / radius / vehicle.weight).tolist(),
                "drive": {"km": driven / 1000.0, "kwh_per_km": each_km, "wh_per_km_and_t": 1000.0 * each_km / tonnes},
            }
        )
    return {"speeds_kmh": list(speeds_kmh), "belts_degc": list(belts_degc), "designs": found}


def designs_text(found: Mapping[str, Any]) -> str:
    """The tables."""
    head = ("belt [degC]", *(f"{kmh:g} km/h" for kmh in found["speeds_kmh"]))
    parts = []
    for what, key, scale, places in TABLES:
        for design in found["designs"]:
            rows = [
                (f"{degc:g}", *(decimals(scale * x, places) for x in row))
                for degc, row in zip(found["belts_degc"], design[key], strict=True)
            ]
            parts.append(f"{what} of {design['vehicle']}\n{table(rows, head, indent=2)}")
    for design in found["designs"]:
        of = design["drive"]
        parts.append(
            f"{design['vehicle']}: {decimals(of['kwh_per_km'], 2)} kWh/km against resistance on {decimals(of['km'], 1)} km, "
            f"{decimals(of['wh_per_km_and_t'])} Wh/km for each tonne"
        )
    return "\n".join(parts)


def draw_designs(found: Mapping[str, Any], path: Path) -> Path:
    """Resistance over weight of all designs over speed, a line for each belt temperature."""
    from matplotlib.figure import Figure

    from trackres_ros.output.plots import write_figure

    figure = Figure(figsize=(8.0, 4.5), layout="constrained")
    axes = figure.subplots(1, len(found["designs"]), sharey=True, squeeze=False)[0]
    for one, design in zip(axes, found["designs"], strict=True):
        for i, degc in enumerate(found["belts_degc"]):
            share = i / max(len(found["belts_degc"]) - 1, 1)
            percent, colour = 100.0 * np.array(design["coefficient"][i]), (share, 0.25, 1.0 - share)
            one.plot(found["speeds_kmh"], percent, color=colour, label=f"{degc:g} degC")
        one.set_title(design["vehicle"])
        one.set_xlabel("speed [km/h]")
        one.grid(alpha=0.3)
    axes[0].set_ylabel("resistance over weight [%]")
    axes[0].set_ylim(bottom=0.0)
    figure.legend(*axes[0].get_legend_handles_labels(), title="belt", loc="outside right center")
    write_figure(figure, path)
    return path


def _driven(cycle: Path | None, fastest_mps: float) -> Drive:
    if cycle is not None:
        recording = read_profile(cycle)
        return through_points(recording.time_s("speed"), recording.series["speed"].value, STEP_S)
    times, speeds = [0.0], [0.0]
    for share in STAGES:
        times += [times[-1] + RAMP_S, times[-1] + RAMP_S + HOLD_S]
        speeds += [share * fastest_mps] * 2
    return through_points(np.array(times), np.array(speeds), STEP_S)
