# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compares the range of the rubber data with a vehicle's temperatures and speeds, and with the steady temperatures of its belts.

By time-temperature superposition a sweep at one frequency covers a range of the reduced frequency a_T f. The passage of a road
wheel, which causes most of the loss, has the frequency v / (2a). So the cold end of the sweep is a reduced speed a_T v. Colder or
faster, the moduli keep their last values. Slower and warmer than the warm end they do too, where
rubber hardly changes with frequency; a belt hotter than the sweep is still outside of the data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from trackres_ros.arrays import Array
from trackres_ros.errors import InputError
from trackres_ros.model.contact import half_length_for_force, wheel_loads
from trackres_ros.model.loss_table import LossTable, log_speeds
from trackres_ros.model.rubber import RubberModel
from trackres_ros.model.thermal import film_coefficient
from trackres_ros.model.track import belt_network, load_range
from trackres_ros.text import figures
from trackres_ros.units import KMH_PER_MPS
from trackres_ros.vehicle import AnyVehicle, RoadVehicle, Vehicle

LIVES_DEGC = 150.0  # natural rubber and SBR revert and crack above it (Mark, Erman, Roland, 4th ed., ch. 7)
DESTROYED_DEGC = 300.0  # and decompose by here: no vehicle has driven so
COLDEST_DEGC, PASSES = -150.0, 60
SLOWEST_MPS = 1e-6  # as the kernel's: slower, the loss for each metre no longer changes
OVERSPEED = 1.2  # of the vehicle file's greatest speed
ROUNDING = 1e-9


@dataclass(frozen=True)
class Coverage:
    """Ends of the data for a kind of track."""

    hottest: float  # degC
    log_reduced_speed: float  # log10(a_T v [m/s]) at the cold end of the sweep

    def coldest(self, rubber: RubberModel, speed: float) -> float:
        """Belt temperature [degC] below which the data do not reach at a speed [m/s]."""
        low, high = COLDEST_DEGC, self.hottest
        for _ in range(PASSES):
            centre = 0.5 * (low + high)
            if float(rubber.log_shift(centre)) + np.log10(speed) > self.log_reduced_speed:
                low = centre
            else:
                high = centre
        return high


def coverage(vehicle: Vehicle, track_name: str) -> Coverage:
    """Range of the sweep for a kind of track at nominal load."""
    track, rubber = vehicle.tracks[track_name], vehicle.rubber
    wheels, sweep = track.road_wheels, rubber.sweep_degc
    loads = wheel_loads(track, load_range(vehicle, track_name).nominal)
    # `RubberModel.dynamic_modulus` of the coldest row, without scipy, which takes half a second to load
    modulus = np.hypot(rubber.storage_pa[0], rubber.loss_pa[0] * rubber.loss_modulus_scale) * rubber.layer_stiffening
    half_length = half_length_for_force(loads.mean(), modulus, wheels.radius, wheels.contact_length, track.belt.thickness)
    model = RubberModel(rubber)
    reach = float(model.log_shift(sweep[0]) + np.log10(2.0 * half_length * rubber.sweep_frequency))
    return Coverage(min(float(sweep[-1]), LIVES_DEGC), min(reach, log_speeds(model)[1]))


def beyond(vehicle: AnyVehicle, columns: Mapping[str, Array]) -> list[str]:
    """Sentences on belts outside the rubber data and loads outside the table, of an estimator's columns by name."""
    belts, loads = ({a.name: columns[f"{column}/{a.name}"] for a in vehicle.assemblies} for column in ("belt_degc", "load_n"))
    return [*beyond_data(vehicle, columns["speed_mps"], belts), *beyond_loads(vehicle, loads)]


def beyond_data(vehicle: AnyVehicle, speed: ArrayLike, belt_degc: Mapping[str, ArrayLike]) -> list[str]:
    """Sentences on belts hotter or colder than the rubber data; empty without any.

    Parameters
    ----------
    speed
        [m/s], shape (times,) or one number.
    belt_degc
        Belt temperatures by the name of an assembly [degC], shape (times,) or one number.

    Returns
    -------
    list of str
        Up to two sentences a kind of track.
    """
    if isinstance(vehicle, RoadVehicle):
        return []
    size = np.maximum(np.abs(np.atleast_1d(np.asarray(speed, dtype=float))), SLOWEST_MPS)
    rubber, remarks = RubberModel(vehicle.rubber), []
    for name in vehicle.tracks:
        belts = np.stack([np.atleast_1d(belt_degc[a.name]) for a in vehicle.assemblies if a.track == name])
        limits, speeds = coverage(vehicle, name), np.broadcast_to(size, belts.shape)
        is_hot = belts > limits.hottest
        is_cold = np.asarray(rubber.log_shift(belts)) + np.log10(speeds) > limits.log_reduced_speed
        for mask, side in ((is_hot, "above"), (is_cold & ~is_hot, "below")):
            if not mask.any():
                continue
            index = np.unravel_index(np.argmax(np.where(mask, belts if side == "above" else -belts, -np.inf)), belts.shape)
            end = limits.hottest if side == "above" else limits.coldest(rubber, float(speeds[index]))
            often = f" ({side} that: {np.any(mask, axis=0).mean():.0%} of the samples)" if belts.shape[1] > 1 else ""
            reason = "rubber lives up to" if end == LIVES_DEGC else "the rubber data end at"
            point = f"{belts[index]:.0f} degC at {speeds[index] * KMH_PER_MPS:.0f} km/h"
            remarks.append(
                f"track {name}: a belt is at {point}, but {reason} {end:.0f} degC{often}. The torque is extrapolated, and the "
                "status shows OUTSIDE_TABLE"
            )
    return remarks


def beyond_loads(vehicle: AnyVehicle, load_n: Mapping[str, ArrayLike]) -> list[str]:
    """Sentences on assemblies with a load [N] outside the table of losses; empty without any. `load_n`: as `beyond_data`."""
    if isinstance(vehicle, RoadVehicle):
        return []
    remarks = []
    for name in vehicle.tracks:
        loads = np.stack([np.atleast_1d(load_n[a.name]) for a in vehicle.assemblies if a.track == name])
        limits = load_range(vehicle, name)
        for is_outside, extreme, end, side in (
            (loads < limits.low * (1.0 - ROUNDING), loads.min(), limits.low, "below"),
            (loads > limits.high * (1.0 + ROUNDING), loads.max(), limits.high, "above"),
        ):
            if is_outside.any():
                remark = ", just above its own weight" if side == "below" else ""
                load_text, end_text = figures(extreme / 1e3, 4), figures(end / 1e3, 4)
                remarks.append(
                    f"track {name}: an assembly carries {load_text} kN, but the table ends at {end_text} kN{remark} "
                    f"({side} that: {np.any(is_outside, axis=0).mean():.0%} of the samples). Its loss is that at the end of the "
                    "table, and the status shows OUTSIDE_TABLE"
                )
    return remarks


def check_speed(vehicle: AnyVehicle, speed: float) -> None:
    """Check a speed [m/s] of a vehicle, in either direction.

    Raises
    ------
    InputError
        Beyond the limit of a live estimate.
    """
    limit = OVERSPEED * vehicle.chassis.max_speed
    if not abs(speed) <= limit:
        allowed = f"up to {OVERSPEED:g} times the vehicle file's max_speed, {limit * KMH_PER_MPS:g} km/h"
        raise InputError("speed", f"{abs(speed) * KMH_PER_MPS:g} km/h", allowed)


def balance_degc(vehicle: Vehicle, track_name: str, table: LossTable, speed: float, ambient: float) -> float:
    """Mean belt temperature [degC] at which heat and cooling balance at a speed [m/s] and nominal load.

    Of the effects of the vehicle only their resistance inside the belt acts.
    """
    rubber, network = RubberModel(vehicle.rubber), belt_network(vehicle, track_name)
    cooling = network.area * film_coefficient(speed, network.film_offset, network.film_slope)
    resistance = 1.0 / (network.share_outside(cooling) * cooling)
    load = load_range(vehicle, track_name).nominal

    def heat_surplus(belt_degc: float) -> float:
        return (
            ambient + resistance * speed * float(table.loss_at(np.log10(speed) + rubber.log_shift(belt_degc), load)) - belt_degc
        )

    low, high = ambient, ambient + 1.0
    while heat_surplus(high) > 0.0:
        low, high = high, ambient + 2.0 * (high - ambient)
    for _ in range(PASSES):
        centre = 0.5 * (low + high)
        low, high = (centre, high) if heat_surplus(centre) > 0.0 else (low, centre)
    return high


def check_heat(vehicle: Vehicle, track_name: str, table: LossTable) -> float:
    """The balance at the greatest speed in the file's ambient temperature [degC], if rubber could be there.

    Raises
    ------
    InputError
        If the belt would be destroyed long before, also without a fitted resistance inside it.
    """
    chassis, bare_vehicle = vehicle.chassis, replace(vehicle, effects=(), surroundings=())
    balance = balance_degc(vehicle, track_name, table, chassis.max_speed, chassis.ambient)
    if balance_degc(bare_vehicle, track_name, table, chassis.max_speed, chassis.ambient) > DESTROYED_DEGC:
        raise InputError(
            f"{vehicle.source}: tracks.{track_name}",
            f"a belt that settles at {balance:.0f} degC at {chassis.max_speed * 3.6:.0f} km/h under its nominal load",
            f"values with which it stays below {DESTROYED_DEGC:g} degC, where rubber decomposes",
            "check the unit of the moduli, belt thickness, film coefficient and max_speed",
        )
    return balance
