# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes distance, time, resistance, energy and belt temperatures of a drive from rows of results.

As in the step, the speed is linear between rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.model.resistance import at_first_radius
from trackres_ros.model.vehicle_constants import vehicle_constants
from trackres_ros.output.preview import longest_step
from trackres_ros.text.numbers import decimals, figures
from trackres_ros.units import STANDSTILL_MPS
from trackres_ros.vehicle import AnyVehicle, Vehicle

RESISTANCE = "resistance_torque_nm"
MEGA, MJ_PER_KWH = 1e6, 3.6


def steps_of(time_s: Array) -> Array:
    """Time from the row before to each row [s]; 0 for the first, after a gap, and where time does not rise."""
    step = np.diff(time_s, prepend=time_s[:1])
    return np.where((step > 0.0) & (step <= longest_step(time_s)), step, 0.0)


def summed(step_s: Array, rate: Array) -> float:
    """Sum of a rate over the steps before each row, see `steps_of`, by the mean of both ends of a step.

    Where one end is unknown the other counts; a step with two unknown ends adds nothing.
    """
    before = np.concatenate([rate[:1], rate[:-1]])
    first, last = np.where(np.isnan(before), rate, before), np.where(np.isnan(rate), before, rate)
    return float(np.nansum(step_s * 0.5 * (first + last)))


def under_way_s(step_s: Array, speed: Array) -> Array:
    """Time of each step with a speed above standstill [s]; 0 where a speed is unknown."""
    before = np.concatenate([speed[:1], speed[:-1]])
    low, high = np.minimum(before, speed), np.maximum(before, speed)
    with np.errstate(invalid="ignore"):
        stood = (np.clip(STANDSTILL_MPS, low, high) - np.clip(-STANDSTILL_MPS, low, high)) / (high - low)
    share = np.where(high > low, 1.0 - stood, np.abs(speed) > STANDSTILL_MPS)
    return np.asarray(step_s * np.nan_to_num(share))


def energy_j(vehicle: AnyVehicle, step_s: Array, of: Mapping[str, Array], name: str = RESISTANCE) -> float:
    """Energy of a torque at the sprockets along a drive [J]: of each assembly by its own radius.

    `step_s`: see `steps_of`; `of`: the columns of a vehicle's results, shape (rows,); `name`: the torque's. Unknown values add
    nothing.
    """
    torque = of[name]
    if isinstance(vehicle, Vehicle):
        torque = at_first_radius(torque, _of_assemblies(vehicle, of, name), vehicle.sprocket_radii)
    return summed(step_s, of["speed_mps"] * torque) / vehicle_constants(vehicle).radius


def _of_assemblies(vehicle: Vehicle, of: Mapping[str, Array], name: str) -> Iterator[Array]:
    """Shares of the assemblies in a torque, as the step has them: effects by load, forces on the vehicle by load and radius."""
    names = [assembly.name for assembly in vehicle.assemblies]
    loads = [of[f"load_n/{assembly}"] for assembly in names]
    arms = [load * radius for load, radius in zip(loads, vehicle.sprocket_radii, strict=True)]
    for assembly, load, arm in zip(names, loads, arms, strict=True):
        if f"{name}/{assembly}" in of:
            yield of[f"{name}/{assembly}"]
        elif name == "effects_nm":
            yield of[name] * (load / of["weight_n"])
        elif name == "drive_torque_nm":  # a grade and the inertia beside the resistance
            yield of[f"{RESISTANCE}/{assembly}"] + (of[name] - of[RESISTANCE]) * (arm / sum(arms))
        else:
            yield of[name] * (arm / sum(arms))


def taken(vehicle: AnyVehicle, time_s: Array, of: Mapping[str, Array]) -> dict[str, float]:
    """Summary of a drive: distance, time, resistance, energy and temperatures, of the belts if there are any.

    `time_s`: shape (rows,) [s]; `of`: the columns of the vehicle's results, each of that shape.
    """
    step, speed, torque = steps_of(time_s), of["speed_mps"], of[RESISTANCE]
    belts_degc = [values for name, values in of.items() if name.startswith("belt_degc/")]
    under_way, torque_there = under_way_s(step, speed), np.where(np.abs(speed) > STANDSTILL_MPS, np.abs(torque), np.nan)
    energy_mj = energy_j(vehicle, step, of) / MEGA
    driven = summed(step, np.abs(speed))
    belts = {}
    if belts_degc:
        belts = {"coldest_belt_degc": float(np.nanmin(belts_degc)), "warmest_belt_degc": float(np.nanmax(belts_degc))}
    return {
        "distance_m": driven,
        "under_way_s": float(under_way.sum()),
        "mean_resistance_nm": summed(under_way, torque_there) / max(float(under_way.sum()), 1e-9),
        "largest_resistance_nm": float(np.nanmax(np.abs(torque))),
        "energy_mj": energy_mj,
        "kwh_per_km": energy_mj / MJ_PER_KWH / max(driven / 1000.0, 1e-9) if driven > 0.0 else 0.0,
        **belts,
    }


def taken_text(of: Mapping[str, float]) -> str:
    """The same in a sentence."""
    if not of["under_way_s"]:
        return "The vehicle stood the whole time"
    way, minutes = _shown(of["distance_m"] / 1000.0, 2), _shown(of["under_way_s"] / 60.0, 1)
    mean, largest = _shown(of["mean_resistance_nm"]), _shown(of["largest_resistance_nm"])
    energy, each_km = _shown(of["energy_mj"], 1), _shown(of["kwh_per_km"], 2)
    belts = ""
    if "coldest_belt_degc" in of:
        belts = f"; belts {decimals(of['coldest_belt_degc'], 1)} to {decimals(of['warmest_belt_degc'], 1)} degC"
    return (
        f"The drive: {way} km, {minutes} min of driving; mean resistance {mean} Nm, at most {largest} Nm; {energy} MJ "
        f"({each_km} kWh/km){belts}"
    )


def _shown(value: float, places: int = 0) -> str:
    """A number with so many decimals; a small one with two figures."""
    return decimals(value, places) if abs(value) >= 10.0 ** (1 - places) else figures(value, 2)
