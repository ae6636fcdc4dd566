# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A vehicle at constant speed: resistance with cold belts, steady belt temperature, and resistance with warm belts."""

from collections.abc import Callable
from dataclasses import dataclass, replace

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
    """Whole vehicle at one speed; nan if no belt temperature is steady below `WARMEST_K` above the air."""

    # resistance at the sprockets with belts as cold as the air, and in steady state [Nm]
    cold_nm: float
    warm_nm: float
    belt_degc: float  # steady temperature, mean of the assemblies [degC]
    kwh_per_km: float  # energy in steady state


@dataclass(frozen=True, eq=False)
class SteadyAssembly:
    """Equal assemblies at one speed: name of the track, number, and the forces of each."""

    track: str
    count: int
    radius: float
    course: PchipInterpolator  # logarithm of the loss [N] over the belt temperature
    # loss with the belt at the air's temperature, bearing friction and air drag [N]
    cold_loss: float
    bearing: float
    wind: float
    cooled: float  # heat flow out of the belt [W/K]


@dataclass(frozen=True, slots=True)
class FileErrors:
    """Factors on uncertain quantities of a vehicle file; loss, film and radius of one kind of track, or of all if it is empty."""

    track: str = ""
    loss: float = 1.0
    film: float = 1.0
    radius: float = 1.0
    bearing: float = 1.0
    drag: float = 1.0


AS_IT_IS = FileErrors()


@dataclass(frozen=True, eq=False)
class Held:
    """A vehicle without its effects at one speed [m/s] in air of a temperature [degC]."""

    speed: float
    ambient: float
    kinds: tuple[SteadyAssembly, ...]

    def solve(self, off: FileErrors = AS_IT_IS) -> Steady:
        """Its steady state, with some of it off by a factor."""
        way = float(resistance.direction(self.speed))
        cold = warm = force = belts = 0.0
        for kind in self.kinds:
            here = off if off.track in ("", kind.track) else AS_IT_IS
            others = off.bearing * kind.bearing + off.drag * kind.wind
            radius, cooled = here.radius * kind.radius, here.film * kind.cooled

            def loss(belt: float, course: PchipInterpolator = kind.course, factor: float = here.loss) -> float:
                return factor * float(np.exp(course(belt)))

            def excess(belt: float, loss: Callable[[float], float] = loss, cooled: float = cooled) -> float:
                return loss(belt) * self.speed - cooled * (belt - self.ambient)

            hottest = self.ambient + WARMEST_K
            belt = float(brentq(excess, self.ambient, hottest)) if excess(hottest) < 0.0 else np.nan
            at_last = loss(belt) * way + others
            cold += kind.count * radius * (here.loss * kind.cold_loss * way + others)
            warm += kind.count * radius * at_last
            force += kind.count * at_last
            belts += kind.count * belt
        count = sum(kind.count for kind in self.kinds)
        return Steady(float(cold), float(warm), belts / count, float(force) * 1000.0 / J_PER_KWH)


def steady(vehicle: Vehicle, speed: float, ambient: float, weight: float | None = None) -> Steady:
    """The steady state of a vehicle, by the exact methods.

    `vehicle`: with its effects; those without sufficient inputs in a straight drive at one speed are excluded; `speed`: [m/s],
    forward; `ambient`: air [degC]; `weight`: whole weight [N], shared as nominal; by default the vehicle file's. Raises
    InputError beyond the speeds of the vehicle.
    """
    check_speed(vehicle, speed)
    if vehicle.active:
        return _with_effects(vehicle, speed, ambient, weight)
    return held(vehicle, speed, ambient, weight).solve()


def held(vehicle: Vehicle, speed: float, ambient: float, weight: float | None = None) -> Held:
    """A vehicle without its effects at one speed; see `steady`."""
    chassis, nominal = vehicle.chassis, vehicle.nominal_loads()
    loads = nominal if weight is None else weight * nominal / nominal.sum()
    wind = float(resistance.wind_force(speed, chassis.drag_coefficient * chassis.frontal_area, chassis.air_density))
    way = float(resistance.direction(speed))
    belts = ambient + np.linspace(0.0, WARMEST_K, NODES)
    kinds: dict[tuple[str, float], SteadyAssembly] = {}
    for assembly, load in zip(vehicle.assemblies, loads, strict=True):
        known = kinds.get((assembly.track, float(load)))
        if known is not None:
            kinds[assembly.track, float(load)] = replace(known, count=known.count + 1)
            continue
        model = track_model(vehicle, assembly.track)
        radius, network = model.track.sprocket_radius, model.network
        bearing = float(resistance.bearing_force(speed, load, chassis.bearing_friction))
        drag = wind * load / loads.sum()
        drive: Array = np.zeros(NODES)
        for _ in range(DRIVE_PASSES):
            loss = np.asarray(model.loss.loss_force(speed, belts, load, drive).total)
            drive = radius * (loss * way + bearing + drag)
        cooled = float(film_coefficient(speed, network.film_offset, network.film_slope)) * network.area
        course = PchipInterpolator(belts, np.log(loss))
        of = SteadyAssembly(assembly.track, 1, radius, course, float(loss[0]), bearing, float(drag), cooled)
        kinds[assembly.track, float(load)] = of
    return Held(speed, ambient, tuple(kinds.values()))


def _with_effects(vehicle: Vehicle, speed: float, ambient: float, weight: float | None) -> Steady:
    def at(belt: float) -> dict[str, float]:
        found = explain(vehicle, speed, belt, ambient, weight)
        return {"excess": found["heat_w"] - found["cooling_w"], "torque": float(found["torque_nm"]["resistance"])}

    cold = at(ambient)["torque"]
    if at(ambient + WARMEST_K)["excess"] >= 0.0:
        return Steady(cold, np.nan, np.nan, np.nan)
    heats = at(ambient)["excess"] > 0.0  # an effect may cool by itself
    belt = float(brentq(lambda t: at(t)["excess"], ambient, ambient + WARMEST_K, xtol=0.01)) if heats else ambient
    warm = at(belt)["torque"]
    radius = vehicle.track_of(vehicle.assemblies[0]).sprocket_radius
    return Steady(cold, warm, belt, warm / radius * 1000.0 / J_PER_KWH)
