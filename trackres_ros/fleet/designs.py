# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Two designs side by side: resistance over speed and belt temperature, and the energy that one drive takes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trackres_ros.errors import InputError, one_line
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.files.resources import find_vehicle
from trackres_ros.files.yamls import read_yaml
from trackres_ros.model.coverage import OVERSPEED
from trackres_ros.model.operating_point import explain
from trackres_ros.model.vehicle_constants import vehicle_constants
from trackres_ros.offline.energy import energy_j, steps_of
from trackres_ros.offline.profile import read_profile
from trackres_ros.offline.simulate import Drive, run_drive, through_points
from trackres_ros.text.numbers import decimals, figures
from trackres_ros.text.table import table
from trackres_ros.units import GRAVITY, KMH_PER_MPS
from trackres_ros.vehicle import Vehicle, load

POINTS = 5  # of speed, and of temperature
SLOWEST_KMH, COLDEST_DEGC, WARMEST_DEGC = 5.0, -20.0, 80.0
BELTS_DEGC = -60.0, 150.0  # what a belt may have
STAGES, HOLD_S, RAMP_S, STEP_S = (1 / 3, 2 / 3, 1.0), 600.0, 30.0, 0.5
J_PER_KWH = 3.6e6
TABLES = ("Resistance [Nm]", "torque_nm", 1.0, 0), ("Resistance over weight [%]", "coefficient", 100.0, 2)


@dataclass(frozen=True, slots=True)
class Grid:
    """What two designs are compared over: speeds [km/h], belt temperatures [degC], and the speed profile of a drive."""

    vehicles: tuple[Vehicle, ...]
    speeds_kmh: tuple[float, ...]
    belts_degc: tuple[float, ...]
    cycle: Path | None

    @property
    def points(self) -> int:
        """How many operating points there are, of all vehicles."""
        return len(self.vehicles) * len(self.speeds_kmh) * len(self.belts_degc)


def asked_of(given: Sequence[str], speed_kmh: str | None, belt_degc: str | None, cycle: Path | None) -> Grid | None:
    """The grid for two vehicle files with tracks, of ranges as A:B; None of anything else.

    Raises
    ------
    InputError
        If a range is none, or is given for something else.
    """
    try:
        files = [find_vehicle(name) for name in given]
    except InputError:
        files = []
    if not files or not all("tracks" in read_yaml(file) for file in files):
        for option, value in (("--speed-kmh", speed_kmh), ("--belt-degc", belt_degc), ("--cycle", cycle)):
            if value is not None:
                raise InputError(option, value, "only with two vehicle files with tracks")
        return None
    vehicles = tuple(load(file) for file in files)
    fastest = KMH_PER_MPS * min(v.chassis.max_speed for v in vehicles)
    speeds = _span("--speed-kmh", speed_kmh, (0.1, OVERSPEED * fastest), (SLOWEST_KMH, fastest))
    return Grid(vehicles, speeds, _span("--belt-degc", belt_degc, BELTS_DEGC, (COLDEST_DEGC, WARMEST_DEGC)), cycle)


def _span(option: str, given: str | None, limits: tuple[float, float], usual: tuple[float, float]) -> tuple[float, ...]:
    """Evenly spaced values from A to B."""
    (low, high), (first, last) = limits, usual
    if given is not None:
        begin, colon, end = given.partition(":")
        try:
            first, last = float(begin), float(end)
            if not (colon and low <= first < last <= high):
                raise ValueError
        except ValueError:
            allowed = f"A:B with {figures(low)} <= A < B <= {figures(high)}, as {figures(usual[0])}:{figures(usual[1])}"
            raise InputError(option, given, allowed) from None
    return tuple(round(first + i * (last - first) / (POINTS - 1), 1) for i in range(POINTS))


def compare_designs(grid: Grid, advance: Callable[[float], None] = lambda _: None) -> dict[str, Any]:
    """Resistance of each vehicle at steady speeds and belt temperatures, and what a drive takes: ten minutes each at a third, two
    thirds and all of the slower one's speed, where no cycle is given.

    Parameters
    ----------
    advance
        Takes that one more point is done.

    Returns
    -------
    dict
        Ready for JSON: torque [Nm] and coefficient (resistance over weight) by vehicle, belt temperature and speed; kWh/km of the
        drive, and per tonne.
    """
    drive = driven(grid.cycle, min(v.chassis.max_speed for v in grid.vehicles))
    found = []
    named = [v.name for v in grid.vehicles]
    # Two versions of one vehicle bear one name: their files tell them apart.
    shown = named if len(set(named)) == len(named) else [one_line(v.source.stem) for v in grid.vehicles]
    for vehicle, name in zip(grid.vehicles, shown, strict=True):
        radius = vehicle_constants(vehicle).radius
        torque = np.empty((len(grid.belts_degc), len(grid.speeds_kmh)))
        for i, degc in enumerate(grid.belts_degc):
            for j, kmh in enumerate(grid.speeds_kmh):
                torque[i, j] = explain(vehicle, kmh / KMH_PER_MPS, degc)["torque_nm"]["resistance"]
                advance(1)
        estimator = Estimator(vehicle)
        rows = run_drive(estimator, drive)
        resistance = rows[:, estimator.column_index["resistance_torque_nm"]]
        step = steps_of(drive.time_s)
        metres, energy = float((step * np.abs(drive.speed)).sum()), energy_j(step, drive.speed, resistance, radius)
        each_km = energy / J_PER_KWH / (metres / 1000.0)
        tonnes = vehicle.weight / GRAVITY / 1000.0
        found.append(
            {
                "vehicle": name,
                "weight_n": vehicle.weight,
                "torque_nm": torque.tolist(),
                "coefficient": (torque / radius / vehicle.weight).tolist(),
                "drive": {"km": metres / 1000.0, "kwh_per_km": each_km, "wh_per_km_and_t": 1000.0 * each_km / tonnes},
            }
        )
    return {"speeds_kmh": list(grid.speeds_kmh), "belts_degc": list(grid.belts_degc), "designs": found}


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


def driven(cycle: Path | None, fastest_mps: float) -> Drive:
    """A drive by its speed profile, or ten minutes each at a third, two thirds and all of a greatest speed."""
    if cycle is not None:
        recording = read_profile(cycle)
        return through_points(recording.time_s("speed"), recording.series["speed"].value, STEP_S)
    times, speeds = [0.0], [0.0]
    for share in STAGES:
        times += [times[-1] + RAMP_S, times[-1] + RAMP_S + HOLD_S]
        speeds += [share * fastest_mps] * 2
    return through_points(np.array(times), np.array(speeds), STEP_S)
