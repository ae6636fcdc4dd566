# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A vehicle at one speed: what rolling takes while its belts are cold, how warm they become, and what it takes then."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from trackres_ros.model import resistance
from trackres_ros.model.coverage import check_speed
from trackres_ros.model.operating_point import DRIVE_PASSES, explain
from trackres_ros.model.thermal import film_coefficient
from trackres_ros.model.track import track_model
from trackres_ros.vehicle import Vehicle

Array = NDArray[np.float64]

WARMEST_K = 140.0  # above the air, up to which a balance is looked for
NODES = 15  # belt temperatures at which the loss is computed
J_PER_KWH = 3.6e6


@dataclass(frozen=True, slots=True)
class Steady:
    """Whole vehicle at one speed; nan where no belt temperature is steady below `WARMEST_K` above the air.

    Attributes
    ----------
    cold_nm, warm_nm
        Resistance at the sprockets with belts as cold as the air, and as warm as they become [Nm].
    belt_degc
        How warm that is, mean of the assemblies [degC].
    kwh_per_km
        What it then takes.
    """

    cold_nm: float
    warm_nm: float
    belt_degc: float
    kwh_per_km: float


def steady(vehicle: Vehicle, speed: float, ambient: float) -> Steady:
    """The steady state of a vehicle, by the exact methods.

    Parameters
    ----------
    vehicle
        With its effects, of which those count that a straight drive at one speed tells.
    speed
        [m/s], forward.
    ambient
        Air [degC].

    Returns
    -------
    Steady
        See there.

    Raises
    ------
    InputError
        Beyond the speeds of the vehicle.
    """
    check_speed(vehicle, speed)
    return _with_effects(vehicle, speed, ambient) if vehicle.active else _plain(vehicle, speed, ambient)


def _plain(vehicle: Vehicle, speed: float, ambient: float) -> Steady:
    chassis, loads = vehicle.chassis, vehicle.nominal_loads()
    wind = float(resistance.wind_force(speed, chassis.drag_coefficient * chassis.frontal_area, chassis.air_density))
    way = float(resistance.direction(speed))
    belts = ambient + np.linspace(0.0, WARMEST_K, NODES)
    cold = warm = force = 0.0
    found = []
    known: dict[tuple[str, float], tuple[float, float, float]] = {}
    for assembly, load in zip(vehicle.assemblies, loads, strict=True):
        kind = assembly.track, float(load)
        if kind not in known:
            model = track_model(vehicle, assembly.track)
            radius, network = model.track.sprocket_radius, model.network
            others = float(resistance.bearing_force(speed, load, chassis.bearing_friction)) + wind * load / loads.sum()
            drive: Array = np.zeros(NODES)
            for _ in range(DRIVE_PASSES):
                loss = np.asarray(model.loss.loss_force(speed, belts, load, drive).total)
                drive = radius * (loss * way + others)
            cooled = float(film_coefficient(speed, network.film_offset, network.film_slope)) * network.area
            course = PchipInterpolator(belts, np.log(loss))

            def excess(belt: float, course: PchipInterpolator = course, cooled: float = cooled) -> float:
                return float(np.exp(course(belt))) * speed - cooled * (belt - ambient)

            belt = float(brentq(excess, belts[0], belts[-1])) if excess(belts[-1]) < 0.0 else np.nan
            known[kind] = (drive[0], radius * (float(np.exp(course(belt))) * way + others), belt)
        at_first, at_last, belt = known[kind]
        cold, warm, force = cold + at_first, warm + at_last, force + at_last / vehicle.track_of(assembly).sprocket_radius
        found.append(belt)
    return Steady(float(cold), float(warm), float(np.mean(found)), float(force) * 1000.0 / J_PER_KWH)


def _with_effects(vehicle: Vehicle, speed: float, ambient: float) -> Steady:
    def at(belt: float) -> dict[str, float]:
        found = explain(vehicle, speed, belt, ambient)
        return {"excess": found["heat_w"] - found["cooling_w"], "torque": float(found["torque_nm"]["resistance"])}

    cold = at(ambient)["torque"]
    if at(ambient + WARMEST_K)["excess"] >= 0.0:
        return Steady(cold, np.nan, np.nan, np.nan)
    heats = at(ambient)["excess"] > 0.0  # an effect may cool by itself
    belt = float(brentq(lambda t: at(t)["excess"], ambient, ambient + WARMEST_K, xtol=0.01)) if heats else ambient
    warm = at(belt)["torque"]
    radius = vehicle.track_of(vehicle.assemblies[0]).sprocket_radius
    return Steady(cold, warm, belt, warm / radius * 1000.0 / J_PER_KWH)
