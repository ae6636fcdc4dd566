# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes distance, time, resistance, energy and belt temperatures of a drive from rows of results.

As in the step, the speed is linear between rows, also over a gap that the estimate bridges.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.estimator.records import Steps
from trackres_ros.estimator.settings import Settings
from trackres_ros.model.resistance import force_along
from trackres_ros.text import decimals, figures
from trackres_ros.units import NANOSECOND, SECOND_NS, STANDSTILL_MPS
from trackres_ros.vehicle import AnyVehicle, Vehicle

RESISTANCE = "resistance_torque_nm"
MEGA, MJ_PER_KWH = 1e6, 3.6


def steps_of(time_s: Array, longest_s: float = math.inf) -> Array:
    """Time from the row before to each row [s]; 0 for the first, after a longer step, and where time does not rise."""
    step = np.diff(time_s, prepend=time_s[:1])
    return np.where((step > 0.0) & (step <= longest_s), step, 0.0)


class StepTimes:
    """Times of the steps of a replay as the guards have them: by the stamps, or by arrival where the stamps jumped."""

    def __init__(self, settings: Settings) -> None:
        self._jump_ns, self._bridge_s = round(settings.clock_jump_s * SECOND_NS), settings.bridge_s
        self._last: tuple[int, int] | None = None

    def step_times(self, steps: Steps) -> Array:
        """Time of each step of the next block [s]; 0 for the first of all, for one back, and over a gap too long to bridge."""
        stamp, arrival = steps.stamp_ns, steps.arrival_ns
        last_stamp, last_arrival = self._last or (int(stamp[0]), int(arrival[0]))
        self._last = int(stamp[-1]), int(arrival[-1])
        stamp_step, arrival_step = np.diff(stamp, prepend=last_stamp), np.diff(arrival, prepend=last_arrival)
        is_jump = (stamp_step < 0) | (
            np.maximum(stamp_step - np.maximum(arrival_step, 0), arrival_step - stamp_step) > self._jump_ns
        )
        step = np.where(is_jump, np.maximum(arrival_step, 0), stamp_step) * NANOSECOND
        return np.where(step <= self._bridge_s, step, 0.0)


def summed(step_s: Array, rate: Array, speed: Array) -> float:
    """Sum over the steps before each row, see `steps_of`, of a rate that is zero with the speed.

    It is linear between rows; a step in which the vehicle turns back has two parts, with zero between them. Where one end is
    unknown the other counts; a step with two unknown ends adds nothing.
    """
    return float(np.nansum(_parts(step_s, rate, speed)))


def _parts(step_s: Array, rate: Array, speed: Array) -> Array:
    old_rate, old_speed = np.concatenate([rate[:1], rate[:-1]]), np.concatenate([speed[:1], speed[:-1]])
    start_rate, end_rate = np.where(np.isnan(old_rate), rate, old_rate), np.where(np.isnan(rate), old_rate, rate)
    turns = old_speed * speed < 0.0
    stop_share = np.abs(old_speed) / np.where(turns, np.abs(old_speed) + np.abs(speed), 1.0)  # it stands, as a share of the step
    return np.asarray(
        step_s * 0.5 * np.where(turns, stop_share * start_rate + (1.0 - stop_share) * end_rate, start_rate + end_rate)
    )


def under_way_s(step_s: Array, speed: Array) -> Array:
    """Time of each step with a speed above standstill [s]; 0 where a speed is unknown."""
    old_speed = np.concatenate([speed[:1], speed[:-1]])
    low, high = np.minimum(old_speed, speed), np.maximum(old_speed, speed)
    with np.errstate(invalid="ignore"):
        stop_share = (np.clip(STANDSTILL_MPS, low, high) - np.clip(-STANDSTILL_MPS, low, high)) / (high - low)
    share = np.where(high > low, 1.0 - stop_share, np.abs(speed) > STANDSTILL_MPS)
    return np.asarray(step_s * np.nan_to_num(share))


def energy_j(vehicle: AnyVehicle, step_s: Array, columns: Mapping[str, Array], name: str = RESISTANCE) -> float:
    """Energy of a torque at the sprockets along a drive [J]: of each assembly by its own radius.

    `step_s`: see `steps_of`; `columns`: results by name, shape (rows,); `name`: the torque's. Unknown values add nothing.
    """
    return summed(step_s, columns["speed_mps"] * _force(vehicle, columns, name), columns["speed_mps"])


def _force(vehicle: AnyVehicle, columns: Mapping[str, Array], name: str) -> Array:
    if isinstance(vehicle, Vehicle):
        return force_along(columns[name], _of_assemblies(vehicle, columns, name), vehicle.sprocket_radii)
    return columns[name] / vehicle.constants.radius


def _of_assemblies(vehicle: Vehicle, columns: Mapping[str, Array], name: str) -> Iterator[Array]:
    """Shares of the assemblies in a torque, as the step has them: forces on the vehicle by load and radius."""
    names = [assembly.name for assembly in vehicle.assemblies]
    arms = [columns[f"load_n/{assembly}"] * radius for assembly, radius in zip(names, vehicle.sprocket_radii, strict=True)]
    for assembly, arm in zip(names, arms, strict=True):
        if f"{name}/{assembly}" in columns:
            yield columns[f"{name}/{assembly}"]
        elif name == "drive_torque_nm":  # grade and inertia too, besides the resistance
            yield columns[f"{RESISTANCE}/{assembly}"] + (columns[name] - columns[RESISTANCE]) * (arm / sum(arms))
        else:
            yield columns[name] * (arm / sum(arms))


class DriveTotals:
    """Distance, time, resistance, energy and belt temperatures of a drive, added up block by block.

    The totals are the same to the bit, however the rows are divided into blocks.
    """

    def __init__(self, vehicle: AnyVehicle) -> None:
        self._vehicle = vehicle
        self._sums = np.zeros(5)
        self._rates = np.empty((4, 0))  # of the last row
        self._largest = self._coldest = self._warmest = math.nan

    @property
    def duration_s(self) -> float:
        """Time of all steps [s]."""
        return round(float(self._sums[0]), 6)

    def add(self, step_s: Array, columns: Mapping[str, Array]) -> None:
        """Add rows: the time from the row before to each [s], shape (rows,), and their columns, each of that shape."""
        speed, torque = columns["speed_mps"], columns[RESISTANCE]
        moving_torque = np.where(np.abs(speed) > STANDSTILL_MPS, np.abs(torque), np.nan)
        rates = np.stack([speed, np.abs(speed), moving_torque, speed * _force(self._vehicle, columns, RESISTANCE)])
        rates = np.concatenate([self._rates if self._rates.size else rates[:, :1], rates], axis=1)
        self._rates, step = rates[:, -1:], np.concatenate([[0.0], step_s])
        v, size, resistance, power = rates
        under_way = under_way_s(step, v)  # a resistance does not go to zero with the speed, so `size` for it, which never turns
        parts = [step, under_way, _parts(step, size, v), _parts(under_way, resistance, size), _parts(step, power, v)]
        self._sums = np.cumsum(np.column_stack([self._sums, np.nan_to_num(parts)]), axis=1)[:, -1]
        self._largest = float(np.fmax(self._largest, np.fmax.reduce(np.abs(torque))))
        for belt in (values for name, values in columns.items() if name.startswith("belt_degc/")):
            self._coldest = float(np.fmin(self._coldest, np.fmin.reduce(belt)))
            self._warmest = float(np.fmax(self._warmest, np.fmax.reduce(belt)))

    def as_dict(self) -> dict[str, float]:
        """The totals; those of the belts if there are any."""
        _, under_way, distance, resistance_sum, energy = self._sums.tolist()
        energy_mj = energy / MEGA
        belts = {"coldest_belt_degc": self._coldest, "warmest_belt_degc": self._warmest} if self._vehicle.assemblies else {}
        return {
            "distance_m": distance,
            "under_way_s": under_way,
            "mean_resistance_nm": resistance_sum / max(under_way, 1e-9),
            "largest_resistance_nm": self._largest,
            "energy_mj": energy_mj,
            "kwh_per_km": energy_mj / MJ_PER_KWH / max(distance / 1000.0, 1e-9) if distance > 0.0 else 0.0,
            **belts,
        }


def sum_drive(vehicle: AnyVehicle, time_s: Array, columns: Mapping[str, Array]) -> dict[str, float]:
    """Totals of a drive without gaps; see `DriveTotals`.

    `time_s`: shape (rows,) [s]; `columns`: the columns of the vehicle's results, each of that shape.
    """
    totals = DriveTotals(vehicle)
    totals.add(steps_of(time_s), columns)
    return totals.as_dict()


def drive_text(totals: Mapping[str, float]) -> str:
    """The same in a sentence."""
    if not totals["under_way_s"]:
        return "The vehicle stood the whole time"
    way, minutes = _shown(totals["distance_m"] / 1000.0, 2), _shown(totals["under_way_s"] / 60.0, 1)
    mean, peak = _shown(totals["mean_resistance_nm"]), _shown(totals["largest_resistance_nm"])
    energy, each_km = _shown(totals["energy_mj"], 1), _shown(totals["kwh_per_km"], 2)
    belts = ""
    if "coldest_belt_degc" in totals:
        belts = f"; belts {decimals(totals['coldest_belt_degc'], 1)} to {decimals(totals['warmest_belt_degc'], 1)} degC"
    return (
        f"The drive: {way} km, {minutes} min of driving; mean resistance {mean} Nm, at most {peak} Nm; {energy} MJ "
        f"({each_km} kWh/km){belts}"
    )


def _shown(value: float, places: int = 0) -> str:
    """A number with a given number of decimals; a small number with two figures."""
    return decimals(value, places) if abs(value) >= 10.0 ** (1 - places) else figures(value, 2)
