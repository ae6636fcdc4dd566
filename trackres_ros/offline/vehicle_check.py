# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes derived values of a vehicle file: masses, loads, temperatures and the error of its tables."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from trackres_ros.errors import InputError
from trackres_ros.estimator.constants import check_own_effects, spread
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.model import belt as belt_model
from trackres_ros.model.contact import hinge_position, wheel_loads
from trackres_ros.model.coverage import check_heat, coverage
from trackres_ros.model.loss_table import LossTable, drive_share, interpolation_error, loss_table, reverse_share
from trackres_ros.model.track import TrackModel, load_range, steady_tension, track_model
from trackres_ros.vehicle import AnyVehicle, RoadVehicle, Vehicle
from trackres_ros.vehicle.belt_bulk import heat_capacity, mass_per_length
from trackres_ros.vehicle.description import FLAGS

SHOWN_SPEED_SHARES = (0.05, 0.25, 1.0)  # of the greatest speed
SLOWEST = 0.05  # m/s: the softest belt is a hot one that creeps
LARGEST_ERROR = 0.01  # of the loss, between its table and the exact method
DEEP_STRAIN = 0.5  # of the thickness below a wheel: above it a layer is no longer an elastic foundation


def check_vehicle(vehicle: AnyVehicle, points: int) -> dict[str, Any]:
    """Derived values of a vehicle, ready for JSON; tables of belts are compared with the exact method at random points.

    Raises InputError if the physics excludes a value.
    """
    if isinstance(vehicle, RoadVehicle):
        return _check_road(vehicle)
    check_own_effects(vehicle)
    rubber = vehicle.rubber
    tracks, remarks = {}, []
    for name, track in vehicle.tracks.items():
        model, loads = track_model(vehicle, name), load_range(vehicle, name)
        began = time.perf_counter()
        table = loss_table(vehicle, name)
        took = time.perf_counter() - began
        errors = np.abs(interpolation_error(model, table, loads, vehicle.chassis.max_speed, points))
        physics, found = _physics(vehicle, name, model, table)
        remarks += found
        if errors.max() > LARGEST_ERROR:
            remarks.append(
                f"track {name}: the loss in estimates and exports is up to {errors.max():.1%} off. The rubber's moduli change "
                "too steeply for its table: check the rubber file and the WLF constants"
            )
        stiffness = float(belt_model.axial_stiffness(track.belt, model.rubber.dynamic_modulus(10.0, vehicle.chassis.ambient)))
        tension, mass = steady_tension(model, vehicle.chassis.ambient), mass_per_length(track.belt, rubber)
        uncertain = ("loss", "cooling", "heat_capacity", "sprocket_radius")
        tracks[name] = {
            "wheel_loads_n": wheel_loads(track, loads.nominal).tolist(),
            "hinge_position_m": hinge_position(track),
            "belt_mass_kg": mass * track.belt.loop_length,
            "mass_per_length_kg_m": mass,
            "heat_capacity_j_k": heat_capacity(track.belt, rubber),
            "cooled_area_m2": belt_model.cooled_area(track.belt),
            "axial_stiffness_n": stiffness,
            "tension_n": tension,
            "sag_m": float(belt_model.catenary_sag(tension, mass, track.belt.sag_half_span, stiffness)),
            "uncertainty": dict(zip(uncertain, spread(vehicle, name).relative.tolist(), strict=True)),
            "table": {
                "seconds": took,
                "load_range_n": [loads.low, loads.high],
                "largest_error": float(errors.max()),
                "rms_error": float(np.sqrt((errors**2).mean())),
                "points": points,
                "drive_torque_share": drive_share(table, loads, track.sprocket_radius),
                "reverse_share": reverse_share(table, loads, track.sprocket_radius),
            },
            **physics,
        }
    return {
        **_common(vehicle),
        "assemblies": {a.name: float(n) for a, n in zip(vehicle.assemblies, vehicle.nominal_loads(), strict=True)},
        "rubber_file": str(vehicle.rubber_source),
        "tracks": tracks,
        "remarks": remarks,
    }


def _common(vehicle: AnyVehicle) -> dict[str, Any]:
    """Values common to all vehicle files."""
    flags = [quantity.flag for quantity in vehicle.parameters.values()]
    return {
        "vehicle": vehicle.name,
        "title": vehicle.title,
        "file": str(vehicle.source),
        "hysteresis": vehicle.hysteresis,
        "thermal": vehicle.thermal,
        "weight_n": vehicle.weight,
        "quantities": {flag: flags.count(flag) for flag in FLAGS},
        "effects": {a.effect.name: dict(a.values) for a in vehicle.effects},
    }


def _check_road(vehicle: RoadVehicle) -> dict[str, Any]:
    """Derived values without belts: resistance, its standard deviation and power at some speeds, on level ground."""
    estimator, points = Estimator(vehicle), []
    for share in SHOWN_SPEED_SHARES:
        inputs = estimator.inputs(share * vehicle.chassis.max_speed, acceleration=0.0)
        _, estimate = estimator.step(estimator.cold_start(inputs), inputs, 0.0)
        torque = estimate.resistance_torque_nm
        points.append(
            {
                "speed_mps": inputs.speed,
                "resistance_torque_nm": torque,
                "resistance_std_nm": estimate.resistance_std_nm,
                "power_w": torque / vehicle.constants.radius * inputs.speed,
            }
        )
    return {**_common(vehicle), "friction_brakes": vehicle.friction_brakes, "level_ground": points, "remarks": []}


def _physics(vehicle: Vehicle, name: str, model: TrackModel, table: LossTable) -> tuple[dict[str, Any], list[str]]:
    """Range of the rubber data for one kind of track, its steady belt temperature, and remarks on both."""
    chassis, covered = vehicle.chassis, coverage(vehicle, name)
    settles = check_heat(vehicle, name, table)
    strain = float(model.loss.contacts(SLOWEST, covered.hottest, load_range(vehicle, name).nominal).largest_strain.max())
    if strain >= 1.0:
        raise InputError(
            f"{vehicle.source}: tracks.{name}",
            f"a road wheel that indents the belt by {strain:.0%} of its thickness",
            "less than 100 %",
            "check the unit of the moduli, the thickness, and radius, number and contact length of the road wheels",
        )
    speeds = [share * chassis.max_speed for share in SHOWN_SPEED_SHARES]
    coldest = [covered.coldest(model.rubber, speed) for speed in speeds]
    remarks = []
    ambient = vehicle.parameters["chassis.ambient"].low
    if coldest[-1] > ambient:
        remarks.append(
            f"track {name}: the rubber data end at {coldest[-1]:.0f} degC at {chassis.max_speed * 3.6:.0f} km/h, and the file's "
            f"ambient temperature begins at {ambient:g} degC. Below, the end values are used, and the status shows OUTSIDE_TABLE"
        )
    if settles > covered.hottest:
        remarks.append(
            f"track {name}: at {chassis.max_speed * 3.6:.0f} km/h the belt settles at {settles:.0f} degC, and the data or the "
            f"life of its rubber end at {covered.hottest:.0f} degC. Above, the status shows OUTSIDE_TABLE"
        )
    if strain > DEEP_STRAIN:
        remarks.append(
            f"track {name}: a road wheel indents a hot belt by {strain:.0%} of its thickness: too deep for the contact model"
        )
    physics = {
        "balance_degc": settles,
        "largest_strain": strain,
        "rubber_data": {"speed_mps": speeds, "coldest_degc": coldest, "hottest_degc": covered.hottest},
    }
    return physics, remarks
