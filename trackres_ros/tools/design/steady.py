# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A vehicle at constant speed: resistance with cold belts, steady belt temperature, and resistance with warm belts."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from trackres_ros.model import resistance
from trackres_ros.model.coverage import beyond_data, check_speed
from trackres_ros.model.operating_point import DRIVE_PASSES, VehicleState, vehicle_state
from trackres_ros.model.rubber import MonotoneCubic
from trackres_ros.model.thermal import ThermalNetwork, film_coefficient
from trackres_ros.model.track import track_models
from trackres_ros.vehicle import Vehicle

Array = NDArray[np.float64]

WARMEST_K = 140.0  # above the air, up to which a balance is looked for
NODES = 15  # belt temperatures at which the loss is computed
J_PER_KWH = 3.6e6
ALONE = 500  # vehicles that this process solves itself: at 400 two workers took longer, as they must begin
OUTCOMES = "cold_nm", "warm_nm", "belt_degc", "kwh_per_km"
TOLERANCE_K, PASSES = 0.01, 10  # of a balance with effects, and of several kinds of track in turn


@dataclass(frozen=True, slots=True)
class Steady:
    """Whole vehicle at one speed; nan if no belt temperature is steady below `WARMEST_K` above the air."""

    # resistance at the sprockets with belts as cold as the air, and in steady state [Nm]
    cold_nm: float
    warm_nm: float
    belt_degc: float  # steady temperature, mean of the assemblies [degC]
    kwh_per_km: float  # energy in steady state
    belts_degc: Mapping[str, float] = field(default_factory=dict)  # steady temperature of each assembly, by its name

    @property
    def outcomes(self) -> tuple[float, ...]:
        """Values of `OUTCOMES`."""
        return tuple(getattr(self, name) for name in OUTCOMES)


@dataclass(frozen=True, eq=False)
class SteadyAssembly:
    """Equal assemblies at one speed: name of the track, their names, and the forces of each."""

    track: str
    names: tuple[str, ...]
    radius: float
    course: MonotoneCubic  # logarithm of the loss [N] over the belt temperature
    # loss with the belt at the air's temperature, bearing friction and air drag [N]
    cold_loss: float
    bearing: float
    wind: float
    bearing_each: float  # of a bearing friction of 1, and of a drag area of 1 m^2
    wind_each: float
    film: float  # heat flow from the surface of the belt to the air [W/K]
    network: ThermalNetwork


@dataclass(frozen=True, slots=True)
class FileErrors:
    """Errors of uncertain quantities of a vehicle file: factors on loss, film and radius of one kind of track, or of all if it is
    empty; bearing friction and drag area [m^2] that are added, as the file's may be 0.
    """

    track: str = ""
    loss: float = 1.0
    film: float = 1.0
    radius: float = 1.0
    bearing_friction: float = 0.0
    drag_area: float = 0.0


AS_IT_IS = FileErrors()


@dataclass(frozen=True, eq=False)
class PlainVehicle:
    """A vehicle without its effects at one speed [m/s] in air of a temperature [degC]."""

    speed: float
    ambient: float
    kinds: tuple[SteadyAssembly, ...]

    def solve(self, errors: FileErrors = AS_IT_IS) -> Steady:
        """Its steady state, with some of it off."""
        way = float(resistance.direction(self.speed))
        cold = warm = force = 0.0
        belts: dict[str, float] = {}
        for kind in self.kinds:
            local = errors if errors.track in ("", kind.track) else AS_IT_IS
            forces = kind.bearing + kind.wind
            forces += errors.bearing_friction * kind.bearing_each + errors.drag_area * kind.wind_each
            radius, film = local.radius * kind.radius, local.film * kind.film
            cooled = kind.network.share_outside(film) * film

            def loss(belt: float, course: MonotoneCubic = kind.course, factor: float = local.loss) -> float:
                return factor * float(np.exp(course(belt)))

            def excess(belt: float, loss: Callable[[float], float] = loss, cooled: float = cooled) -> float:
                return loss(belt) * self.speed - cooled * (belt - self.ambient)

            hottest = self.ambient + WARMEST_K
            belt = float(brentq(excess, self.ambient, hottest)) if excess(hottest) < 0.0 else np.nan
            at_last = loss(belt) * way + forces
            count = len(kind.names)
            cold += count * radius * (local.loss * kind.cold_loss * way + forces)
            warm += count * radius * at_last
            force += count * at_last
            belts |= dict.fromkeys(kind.names, belt)
        mean = sum(belts.values()) / len(belts)
        return Steady(float(cold), float(warm), mean, float(force) * 1000.0 / J_PER_KWH, belts)


def steady(vehicle: Vehicle, speed: float, ambient: float, weight: float | None = None) -> Steady:
    """The steady state of a vehicle, by the exact methods.

    `vehicle`: with its effects; those without sufficient inputs in a straight drive at one speed are excluded; `speed`: [m/s],
    forward; `ambient`: air [degC]; `weight`: whole weight [N], shared as nominal; by default the vehicle file's. Raises
    InputError beyond the speeds of the vehicle.
    """
    check_speed(vehicle, speed)
    return solver(vehicle, speed, ambient, weight)(AS_IT_IS)


def remarks_on(vehicle: Vehicle, speed: ArrayLike, ambient: ArrayLike, states: Sequence[Steady]) -> list[str]:
    """Sentences on belts outside the rubber data in steady states, as cold as the air or settled; see `beyond_data`.

    `speed`, `ambient`: of each state [m/s], [degC], shape (states,).
    """
    names = [assembly.name for assembly in vehicle.assemblies]
    ambient = np.broadcast_to(np.asarray(ambient, dtype=float), len(states))
    cold = dict.fromkeys(names, ambient)
    belts_found = {name: np.array([state.belts_degc.get(name, np.nan) for state in states]) for name in names}
    hottest = ambient + WARMEST_K  # of a belt without a balance
    warm = {name: np.where(np.isnan(belts), hottest, belts) for name, belts in belts_found.items()}
    return list(dict.fromkeys(text for belts in (cold, warm) for text in beyond_data(vehicle, speed, belts)))


def solver(vehicle: Vehicle, speed: float, ambient: float, weight: float | None = None) -> Callable[[FileErrors], Steady]:
    """The steady state of a vehicle as a function of errors of its file; see `steady`."""
    if not vehicle.active:
        return plain_vehicle(vehicle, speed, ambient, weight).solve
    return lambda errors: _with_effects(with_errors(vehicle, errors), speed, ambient, weight, errors)


def with_errors(vehicle: Vehicle, errors: FileErrors) -> Vehicle:
    """A vehicle with errors in its values, but for the loss."""
    tracks = {}
    for name, track in vehicle.tracks.items():
        local, belt = errors if errors.track in ("", name) else AS_IT_IS, track.belt
        belt = replace(belt, film_offset=local.film * belt.film_offset, film_slope=local.film * belt.film_slope)
        tracks[name] = replace(track, belt=belt, sprocket_radius=local.radius * track.sprocket_radius)
    chassis, area = vehicle.chassis, vehicle.chassis.drag_coefficient * vehicle.chassis.frontal_area + errors.drag_area
    friction = chassis.bearing_friction + errors.bearing_friction
    chassis = replace(chassis, bearing_friction=friction, drag_coefficient=area, frontal_area=1.0)
    return replace(vehicle, tracks=tracks, chassis=chassis)


def plain_vehicle(vehicle: Vehicle, speed: float, ambient: float, weight: float | None = None) -> PlainVehicle:
    """A vehicle without its effects at one speed; see `steady`."""
    chassis, nominal = vehicle.chassis, vehicle.nominal_loads()
    loads = nominal if weight is None else weight * nominal / nominal.sum()
    drag_each = resistance.wind_force(speed, 1.0, chassis.air_density) / loads.sum()  # for a load of 1 N, as the next
    bearing_each = resistance.bearing_force(speed, 1.0, 1.0)
    drag, bearing = drag_each * chassis.drag_coefficient * chassis.frontal_area, bearing_each * chassis.bearing_friction
    way = float(resistance.direction(speed))
    belts = ambient + WARMEST_K * np.linspace(0.0, 1.0, NODES) ** 2  # densest where the loss is steep
    names: dict[tuple[str, float], list[str]] = {}
    for assembly, load in zip(vehicle.assemblies, loads, strict=True):
        names.setdefault((assembly.track, float(load)), []).append(assembly.name)
    kinds: dict[tuple[str, float], SteadyAssembly] = {}
    for track, model in track_models(vehicle).items():
        of_track = np.array([load for name, load in names if name == track])
        radius, network = model.track.sprocket_radius, model.network
        by_torque, drive = model.loss.by_torque(speed, belts[:, np.newaxis], of_track), np.zeros((NODES, len(of_track)))
        for _ in range(DRIVE_PASSES):
            loss = by_torque.loss_at(drive).total
            drive = radius * (loss * way + (bearing + drag) * of_track)
        film = float(film_coefficient(speed, network.film_offset, network.film_slope)) * network.area
        for load, course in zip(of_track.tolist(), loss.T, strict=True):
            forces = float(course[0]), load * bearing, load * drag, load * bearing_each, load * drag_each
            course_log, same_names = MonotoneCubic(belts, np.log(course)), tuple(names[track, load])
            kinds[track, load] = SteadyAssembly(track, same_names, radius, course_log, *forces, film, network)
    return PlainVehicle(speed, ambient, tuple(kinds[kind] for kind in names))


def _with_effects(vehicle: Vehicle, speed: float, ambient: float, weight: float | None, errors: FileErrors) -> Steady:
    kinds = [(assembly.track, float(load)) for assembly, load in zip(vehicle.assemblies, vehicle.nominal_loads(), strict=True)]
    total_weight = vehicle.weight if weight is None else weight
    losses = {name: errors.loss for name in vehicle.tracks if errors.track in ("", name)}
    models = track_models(vehicle)

    def state(belts: Mapping[tuple[str, float], float]) -> VehicleState:
        return vehicle_state(vehicle, speed, [belts[kind] for kind in kinds], ambient, total_weight, losses, models)

    def excess(kind: tuple[str, float], degc: float) -> float:
        assembly_state = state({**belts, kind: degc}).assemblies[kinds.index(kind)]
        return assembly_state.heat - assembly_state.cooling

    def is_settled(kind: tuple[str, float]) -> bool:
        return excess(kind, belts[kind] - TOLERANCE_K) > 0.0 > excess(kind, belts[kind] + TOLERANCE_K)

    belts = dict.fromkeys(kinds, ambient)
    cold = float(state(belts).torque["resistance"])
    for _ in range(PASSES):  # effects may depend on the mean of the belts
        for kind in belts:
            belts[kind] = _balance(partial(excess, kind), ambient)
            if np.isnan(belts[kind]):
                return Steady(cold, np.nan, np.nan, np.nan)
        if len(belts) == 1 or all(map(is_settled, belts)):
            break
    warm = state(belts)
    settled_degc = {assembly.name: belts[kind] for assembly, kind in zip(vehicle.assemblies, kinds, strict=True)}
    return Steady(cold, float(warm.torque["resistance"]), warm.belt_degc, warm.force * 1000.0 / J_PER_KWH, settled_degc)


def _balance(excess: Callable[[float], float], ambient: float) -> float:
    """Belt temperature [degC] at which heat and cooling are equal; an effect may cool below the air. Nan without one."""
    low, high = ambient, ambient + WARMEST_K
    if excess(high) >= 0.0:
        return np.nan
    if not excess(ambient) > 0.0:
        low, high = ambient - WARMEST_K, ambient
        if not excess(low) > 0.0:
            return np.nan
    return float(brentq(excess, low, high, xtol=TOLERANCE_K))
