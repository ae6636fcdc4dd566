# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A vehicle at constant speed: resistance with cold belts, steady belt temperature, and resistance with warm belts."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from trackres_ros.model import resistance
from trackres_ros.model.coverage import beyond_data, check_speed
from trackres_ros.model.operating_point import DRIVE_PASSES, VehicleState, vehicle_state
from trackres_ros.model.rubber import MonotoneCubic
from trackres_ros.model.thermal import film_coefficient
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


def steady(vehicle: Vehicle, speed: float, ambient: float, weight: float | None = None) -> Steady:
    """The steady state of a vehicle, by the exact methods.

    `vehicle`: with its effects; those without sufficient inputs in a straight drive at one speed are excluded; `speed`: [m/s],
    forward; `ambient`: air [degC]; `weight`: whole weight [N], shared as nominal; by default the vehicle file's. Raises
    InputError beyond the speeds of the vehicle.
    """
    check_speed(vehicle, speed)
    if vehicle.active:
        return _with_effects(vehicle, speed, ambient, weight)
    return _without_effects(vehicle, speed, ambient, weight)


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


def _without_effects(vehicle: Vehicle, speed: float, ambient: float, weight: float | None) -> Steady:
    chassis, nominal = vehicle.chassis, vehicle.nominal_loads()
    loads = nominal if weight is None else weight * nominal / nominal.sum()
    drag_area = chassis.drag_coefficient * chassis.frontal_area
    forces = resistance.bearing_force(speed, 1.0, chassis.bearing_friction)  # of a load of 1 N, with those of the air
    forces = float(forces + resistance.wind_force(speed, drag_area, chassis.air_density) / loads.sum())
    way = float(resistance.direction(speed))
    belts = ambient + WARMEST_K * np.linspace(0.0, 1.0, NODES) ** 2  # densest where the loss is steep
    names: dict[tuple[str, float], list[str]] = {}
    for assembly, load in zip(vehicle.assemblies, loads, strict=True):
        names.setdefault((assembly.track, float(load)), []).append(assembly.name)
    cold = warm = force = 0.0
    belts_degc: dict[str, float] = {}
    for track, model in track_models(vehicle).items():
        of_track = np.array([load for name, load in names if name == track])
        radius, network = model.track.sprocket_radius, model.network
        by_torque, drive = model.loss.by_torque(speed, belts[:, np.newaxis], of_track), np.zeros((NODES, len(of_track)))
        for _ in range(DRIVE_PASSES):
            loss = by_torque.loss_at(drive).total
            drive = radius * (loss * way + forces * of_track)
        film = float(film_coefficient(speed, network.film_offset, network.film_slope)) * network.area
        for load, course in zip(of_track.tolist(), loss.T, strict=True):
            belt, warm_loss = _settled(MonotoneCubic(belts, np.log(course)), speed, ambient, network.share_outside(film) * film)
            same_names = names[track, load]
            cold += len(same_names) * radius * (float(course[0]) * way + forces * load)
            warm += len(same_names) * radius * (warm_loss * way + forces * load)
            force += len(same_names) * (warm_loss * way + forces * load)
            belts_degc |= dict.fromkeys(same_names, belt)
    belts_degc = {assembly.name: belts_degc[assembly.name] for assembly in vehicle.assemblies}
    mean = sum(belts_degc.values()) / len(belts_degc)
    return Steady(cold, warm, mean, force * 1000.0 / J_PER_KWH, belts_degc)


def _settled(log_loss: MonotoneCubic, speed: float, ambient: float, cooling: float) -> tuple[float, float]:
    """Belt temperature [degC] at which a loss [N] heats as much as the air cools [W/K], and that loss; nan without one."""

    def excess(belt: float) -> float:
        return float(np.exp(log_loss(belt))) * speed - cooling * (belt - ambient)

    hottest = ambient + WARMEST_K
    belt = float(brentq(excess, ambient, hottest)) if excess(hottest) < 0.0 else np.nan
    return belt, float(np.exp(log_loss(belt)))


def _with_effects(vehicle: Vehicle, speed: float, ambient: float, weight: float | None) -> Steady:
    kinds = [(assembly.track, float(load)) for assembly, load in zip(vehicle.assemblies, vehicle.nominal_loads(), strict=True)]
    total_weight = vehicle.weight if weight is None else weight
    models = track_models(vehicle)

    def state(belts: Mapping[tuple[str, float], float]) -> VehicleState:
        return vehicle_state(vehicle, speed, [belts[kind] for kind in kinds], ambient, total_weight, models)

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
