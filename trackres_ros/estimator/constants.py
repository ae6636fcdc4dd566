# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Gathers the kernel's constants: vehicle, tables, uncertainties and settings, as plain arrays and numbers."""

from __future__ import annotations

import functools
import hashlib
import json
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from trackres_ros.arrays import Array, IntArray
from trackres_ros.effects.effect import ALL_KNOWN, conditions
from trackres_ros.effects.stepping import ROW, effect_table, refuse_unusable
from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.motion import ROLLS_FROM
from trackres_ros.estimator.settings import Settings
from trackres_ros.files.cache import cached_arrays
from trackres_ros.model.coverage import OVERSPEED, check_heat, coverage
from trackres_ros.model.hysteresis import METHODS, Spectral
from trackres_ros.model.loss_table import LossTable, fingerprint, loss_table
from trackres_ros.model.resistance import TORQUE_TERMS
from trackres_ros.model.rubber import RubberModel
from trackres_ros.model.thermal import film_coefficient, parting_resistance, thermal_network
from trackres_ros.model.track import load_range, vehicle_constants
from trackres_ros.recording.roles import PLAUSIBLE
from trackres_ros.route.learned import SLOPE, TORQUE, followed_in, frame_of, of_kind
from trackres_ros.route.lookup import CELL_COLUMNS, PLACE_COLUMNS
from trackres_ros.units import GRAVITY
from trackres_ros.vehicle import AnyVehicle, RoadVehicle, Vehicle, variants
from trackres_ros.vehicle.belt_bulk import heat_capacity
from trackres_ros.vehicle.description import FITTED
from trackres_ros.vehicle.gears import gears_of, no_gears

# Uncertainty of a track's parameters

VERSION = 2  # of the cached form
STEP = 0.1  # of a standard deviation, for the differences
REFERENCE_BELT_DEGC = (10.0, 60.0)
REFERENCE_SPEED_SHARE = 0.5  # of the greatest speed
HARMONICS = 512
LOSS, CAPACITY = "rubber.loss_modulus_scale", "rubber.heat_capacity"  # overall factors of a fit, and the film


@dataclass(frozen=True, eq=False)
class ParameterUncertainty:
    """Lower factor, shape (4, 4), of the covariance of ln loss, ln cooling, ln heat capacity and ln sprocket radius."""

    factor: Array

    @property
    def relative(self) -> Array:
        """Standard deviations of the four logarithms, shape (4,)."""
        return np.asarray(np.sqrt((self.factor**2).sum(axis=1)))


def spread(vehicle: Vehicle, track_name: str, cache: Path | None = None) -> ParameterUncertainty:
    """Propagate every range of the file to first order; parameters are independent of each other.

    Notes
    -----
    A wider belt loses more, cools better and holds more heat: the covariance keeps such correlations.

    Where recordings fitted an overall factor, its own range replaces all other ranges of that quantity: the fit compensates
    their errors. The torque was measured at the sprockets, so with the loss their radius is known too. One factor fits film
    offset and slope, so their errors are fully correlated.
    """
    ranges = {path: (q.low, q.high, q.flag == FITTED) for path, q in vehicle.parameters.items()}
    parts = [VERSION, fingerprint(vehicle, track_name), ranges, vehicle.chassis.max_speed, vehicle.thermal]
    key = hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:32]
    arrays = cached_arrays(f"spread-{key}", {"factor": (4, 4)}, lambda: {"factor": _factor(vehicle, track_name)}, cache)
    return ParameterUncertainty(arrays["factor"])


def _factor(vehicle: Vehicle, track_name: str) -> Array:
    speed = REFERENCE_SPEED_SHARE * vehicle.chassis.max_speed

    def logarithms(variation: Vehicle) -> Array:
        by_path = logarithms_at(variation, track_name, speed, np.array(REFERENCE_BELT_DEGC), vehicle)
        return np.array([by_path[:-3].mean(), *by_path[-3:]])

    by_path = slopes(vehicle, track_name, logarithms)
    rows = np.array(list(by_path.values())).reshape(-1, 4)
    covariance = rows.T @ rows + np.diag(np.full(4, 1e-12))
    return np.asarray(np.linalg.cholesky(covariance))


def fits(vehicle: Vehicle, track_name: str, losses: int) -> dict[tuple[str, ...], list[int]]:
    """Columns of `slopes` that recordings fitted, by the paths of the fitted values; `losses`: number of loss columns."""
    belt, (film, capacity, radius) = f"tracks.{track_name}.belt", range(losses, losses + 3)
    columns = {
        (LOSS,): [*range(losses), radius], (f"{belt}.film_offset", f"{belt}.film_slope"): [film], (CAPACITY,): [capacity]
    }  # fmt: skip
    return {paths: path_columns for paths, path_columns in columns.items() if vehicle.parameters[paths[0]].flag == FITTED}


def slopes(vehicle: Vehicle, track_name: str, logarithms: Callable[[Vehicle], Array]) -> dict[str, Array]:
    """Sensitivity of loss, cooling, heat capacity and sprocket radius to one standard deviation of each value.

    Parameters
    ----------
    logarithms
        Of a vehicle: of losses (one or several), cooling, heat capacity and radius, shape (losses + 3,).

    Returns
    -------
    dict
        By path of the value, slopes of the same shape.
    """
    base = logarithms(vehicle)
    variant = variants(vehicle)
    rows: dict[str, Array] = {}
    for path, quantity in vehicle.parameters.items():
        if not path.startswith(("rubber.", f"tracks.{track_name}.")) or isinstance(quantity.value, tuple):
            continue
        if quantity.standard_deviation == 0.0:
            continue
        for sign in (1.0, -1.0):
            step = sign * STEP * quantity.standard_deviation
            try:
                variation = variant({path: quantity.value + step})
            except InputError:  # the geometry does not allow this step, but it allows the opposite one
                continue
            rows[path] = (logarithms(variation) - base) / (sign * STEP)
            break
    belt = f"tracks.{track_name}.belt"
    for fitted_path, columns in fits(vehicle, track_name, len(base) - 3).items():
        for path in rows:
            if path not in fitted_path:
                rows[path][columns] = 0.0
    offset, slope = rows.get(f"{belt}.film_offset"), rows.get(f"{belt}.film_slope")
    if offset is not None and slope is not None and vehicle.parameters[f"{belt}.film_offset"].flag == FITTED:
        offset += rows.pop(f"{belt}.film_slope")
    return rows


def logarithms_at(vehicle: Vehicle, track_name: str, speed: float, belts_degc: Array, base: Vehicle) -> Array:
    """Logarithms of the loss at a speed [m/s] and several belt temperatures, of cooling, heat capacity and sprocket radius.

    `base`: the vehicle before its values were moved. Cooling is that of its film, as if this took a change of the resistance
    inside the belt too: both are in series.
    """
    track, rubber = vehicle.tracks[track_name], RubberModel(vehicle.rubber)
    nominal = load_range(vehicle, track_name).nominal
    spectral = vehicle.hysteresis == Spectral.name
    method = Spectral(track, rubber, HARMONICS) if spectral else METHODS[vehicle.hysteresis](track, rubber)
    loss = method.loss_force(speed, belts_degc, nominal).total
    network, base_network = (thermal_network(v.thermal, v.tracks[track_name].belt, v.rubber) for v in (vehicle, base))
    film = network.area * film_coefficient(speed, network.film_offset, network.film_slope)
    cooling = film / (1.0 + (network.parting - base_network.parting) * film)
    capacity = heat_capacity(track.belt, vehicle.rubber)
    return np.array([*np.log(loss), np.log(cooling), np.log(capacity), np.log(track.sprocket_radius)])


# Constants

LEAST_LOAD_SHARE = 0.1  # of nominal weight: less is not a driving vehicle
LARGEST_LOAD_SHARE = 2.5
LEAST_AIR_STD_K = 1e-3  # of an assumed air, so that a belt's departure due to it is known
LATEST_S = 0.1  # a speed may show a value this old: buses repeat values, and stamps are inexact


class Numbers(NamedTuple):
    """Single constants of the kernel."""

    with_uncertainty: bool  # whether to compute standard deviations and heat, too
    surroundings: bool  # whether effects of the surroundings are among the effects
    slopes_by_place: bool  # whether slopes, or torques, by place are among the surroundings
    torques_by_place: bool
    route_latitude: float  # rad, of the middle of their places
    route_longitude: float
    belt_shows_surface: bool
    torque_at_motor: bool
    motor_ratio: float  # motor speed over sprocket speed; nan where the vehicle file gives none
    motor_efficiency: float
    bearing_friction: float  # bearing friction over weight, at a crawl
    bearing_friction_std: float
    drag_area: float
    drag_area_std: float  # m^2, with that of the air density
    air_density: float
    rotating_mass_factor: float
    nominal_ambient: float
    axles: int
    first_belt: int  # channel of the first assembly's belt temperature
    first_wheel: int  # channel of the wheel speeds; those of single axles and assemblies follow it
    initial_belt_std: float
    process_noise: float
    ambient_std: float
    ambient_unknown_std: float
    belt_measured_variance: float
    gap: float
    bridge: float
    clock_jump_ns: int
    jumps_to_accept: int
    load_hold_ns: int
    passengers_hold_ns: int
    passenger_weight: float  # N each
    ambient_hold_ns: int
    motion_hold_ns: int
    torque_hold_ns: int
    position_hold_ns: int
    stuck_ns: int
    enable_hold_ns: int  # 0: not required
    disagreeing_ns: int
    max_acceleration: float
    speed_slack: float  # m/s: tolerance beyond the greatest acceleration
    speed_variance: float
    acceleration_variance: float
    acceleration_time: float
    feed_hysteresis: float  # 1 where the part is in the feed-forward, else 0
    feed_bearing: float
    feed_wind: float
    feed_grade: float
    feed_inertia: float
    feedforward_rate: float
    feedforward_limit: float
    speed_max_age: float
    slow_input_max_age_ns: int
    feedforward_fade: float
    belt_std_warn: float
    # By default those of wheels without belts.
    first_x: float = 0.0
    step_x: float = 1.0
    glass_transition: float = 0.0
    wlf_c1: float = 0.0
    wlf_c2: float = 1.0
    hottest: float = math.inf  # degC: the rubber data end here
    fastest_x: float = math.inf  # log10(a_T v): the rubber data end here
    two_nodes: bool = False
    rolling_rise: float = 0.0  # s/m, its growth with speed; 0 of tracks
    rolling_rise_std: float = 0.0
    torque_scale: float = 1.0  # shown over true torque; 1 of tracks
    torque_offset: float = 0.0  # shown at no torque, over that scale


class Constants(NamedTuple):
    """Constants of the kernel."""

    number: Numbers
    assembly: Annotated[Array, (None, layout.Assembly.columns)]  # of the assemblies
    loss: Annotated[Array, (None, None, None)]  # (tables, x, load)
    drive: Annotated[Array, (None, None, 2)]  # (tables, x, 2)
    channel_limits: Annotated[Array, (None, 2)]
    effects: Annotated[IntArray, (None, ROW)]
    effect_values: Annotated[Array, (None, None)]  # (rows, most parameters of one)
    route_cells: Annotated[IntArray, (None, CELL_COLUMNS)]  # see route.lookup
    route_places: Annotated[Array, (None, PLACE_COLUMNS)]


Maker = Callable[[Vehicle, str, Path | None], LossTable]
"""Makes the loss table of a kind of track, by its name, with a folder of the cache."""


class Running(NamedTuple):
    """Constants that depend on the running gear, tracks or wheels: assemblies, tables and numbers."""

    assembly: Array
    loss: Array
    drive: Array
    numbers: dict[str, Any]


def check_own_effects(vehicle: AnyVehicle) -> None:
    """Refuse a user's effect that fails although all its inputs are known. In a step it would only be inactive."""
    instant = conditions(vehicle_constants(vehicle), **ALL_KNOWN)
    for active in vehicle.active:
        if active.effect.source is not None:
            refuse_unusable(active, instant)


def make_constants(
    vehicle: AnyVehicle, settings: Settings, cache: Path | None = None, with_uncertainty: bool = True, maker: Maker = loss_table
) -> Constants:
    """Gather the constants; builds the loss tables or takes them from the cache.

    Not `with_uncertainty`: belts without standard deviations and heat, and without the half second that these take at first.
    `maker`: makes the loss table of a kind of track.
    """
    check_own_effects(vehicle)
    runs_on = wheels(vehicle) if isinstance(vehicle, RoadVehicle) else _tracks(vehicle, cache, with_uncertainty, maker)
    chassis, loads = vehicle.chassis, vehicle.nominal_loads()
    table = effect_table(vehicle.own, vehicle.surroundings)
    frame = frame_of(vehicle.route)
    number = Numbers(
        with_uncertainty=with_uncertainty,
        surroundings=bool(vehicle.surroundings or vehicle.route),
        slopes_by_place=of_kind(vehicle.route, SLOPE) is not None,
        torques_by_place=of_kind(vehicle.route, TORQUE) is not None,
        route_latitude=frame.latitude,
        route_longitude=frame.longitude,
        belt_shows_surface=settings.belt_sensor == "surface",
        bearing_friction=chassis.bearing_friction,
        drag_area=chassis.drag_coefficient * chassis.frontal_area,
        drag_area_std=math.hypot(*drag_area_stds(vehicle).values()),
        air_density=chassis.air_density,
        rotating_mass_factor=chassis.rotating_mass_factor,
        nominal_ambient=chassis.ambient,
        initial_belt_std=settings.initial_belt_std_k,
        process_noise=settings.process_noise_k,
        ambient_std=settings.ambient_std_k,
        ambient_unknown_std=max(settings.ambient_unknown_std_k, LEAST_AIR_STD_K),
        belt_measured_variance=settings.belt_measured_std_k**2,
        gap=settings.gap_s,
        bridge=settings.bridge_s,
        jumps_to_accept=int(settings.jumps_to_accept),
        passenger_weight=settings.passenger_kg * GRAVITY,
        max_acceleration=chassis.max_acceleration,
        speed_slack=ROLLS_FROM * settings.speed_std_mps + LATEST_S * chassis.max_acceleration,
        speed_variance=settings.speed_std_mps**2,
        acceleration_variance=settings.acceleration_std**2,
        acceleration_time=settings.acceleration_time_s,
        speed_max_age=settings.speed_max_age_s,
        belt_std_warn=settings.belt_std_warn_k,
        **_gears(vehicle, settings),
        **_places(vehicle),
        **_times_ns(settings),
        **_feedforward(settings, float(np.dot(loads, runs_on.assembly[:, layout.Assembly.radius]))),
        **runs_on.numbers,
    )
    return Constants(
        number,
        runs_on.assembly,
        runs_on.loss,
        runs_on.drive,
        _channel_limits(vehicle),
        table.rows,
        table.values,
        *followed_in(vehicle.route, frame),
    )


def _feedforward(settings: Settings, weight_torque: float) -> dict[str, Any]:
    """Rate, limit, fade and terms of the feed-forward; `weight_torque`: nominal weight times sprocket radius [Nm]."""
    return {
        "feedforward_rate": settings.feedforward_rate,
        "feedforward_limit": settings.feedforward_share * weight_torque,
        "feedforward_fade": settings.feedforward_fade_s,
        **{f"feed_{part}": float(part in settings.feedforward_parts) for part in TORQUE_TERMS},
    }


def _gears(vehicle: AnyVehicle, settings: Settings) -> dict[str, Any]:
    """The gears between motor and sprockets, and whether the measured torque is at the motor."""
    gears, at_motor = gears_of(vehicle), settings.torque_at == "motor"
    if at_motor and gears is None:
        raise no_gears(str(vehicle.source), bool(vehicle.assemblies))
    ratio, efficiency = (math.nan, math.nan) if gears is None else (gears.ratio, gears.efficiency)
    return {"torque_at_motor": at_motor, "motor_ratio": ratio, "motor_efficiency": efficiency}


def _places(vehicle: AnyVehicle) -> dict[str, Any]:
    """Where the channels of loads, belts and wheels are."""
    first_wheel = layout.channels(vehicle).index(layout.WHEELS)
    return {"axles": len(vehicle.axles), "first_belt": first_wheel - len(vehicle.assemblies), "first_wheel": first_wheel}


def _times_ns(settings: Settings) -> dict[str, Any]:
    """Times of the settings that are compared with message times [ns]."""
    names = (
        "clock_jump", "load_hold", "passengers_hold", "ambient_hold", "motion_hold", "torque_hold", "position_hold", "stuck",
        "enable_hold", "slow_input_max_age",
    )  # fmt: skip
    seconds = {name: getattr(settings, f"{name}_s") for name in names} | {"disagreeing": settings.speed_max_age_s}
    return {f"{name}_ns": int(round(value * 1e9)) for name, value in seconds.items()}


@functools.lru_cache(maxsize=2)  # a change of settings must not hold a node's outputs where no file can be cached
def _tracks(vehicle: Vehicle, cache: Path | None, with_uncertainty: bool, maker: Maker) -> Running:
    """Assemblies with belts."""
    names = list(vehicle.tracks)
    tables = [maker(vehicle, name, cache) for name in names]
    for name, table in zip(names, tables, strict=True):
        check_heat(vehicle, name, table)
    ranges = [coverage(vehicle, name) for name in names]
    no_spread = ParameterUncertainty(np.eye(4))
    spreads = {name: spread(vehicle, name, cache) if with_uncertainty else no_spread for name in names}
    axle_names = [axle.name for axle in vehicle.axles]
    loads = vehicle.nominal_loads()
    resistance = parting_resistance(vehicle.active, vehicle_constants(vehicle))
    two_nodes = vehicle.thermal == "core_surface" or resistance > 0.0
    constants = np.empty((len(vehicle.assemblies), layout.CONSIDER_FACTOR))
    for row, load, assembly in zip(map(layout.Assembly, constants), loads, vehicle.assemblies, strict=True):
        track, losses = vehicle.track_of(assembly), tables[names.index(assembly.track)]
        network = thermal_network(vehicle.thermal, track.belt, vehicle.rubber, resistance)
        row.axle = axle_names.index(assembly.axle)
        row.kind = row.table = names.index(assembly.track)
        row.nominal_load, row.radius = load, track.sprocket_radius
        row.capacity, row.surface_share = network.capacity, network.surface_share
        row.inner_conductance, row.skin_conductance = network.conductances
        row.area = network.area
        row.film_offset, row.film_slope = network.film_offset, network.film_slope
        row.first_log_load, row.step_log_load = losses.first_log_load, losses.step_log_load
        row.share_of_all = load / loads.sum()
    factors = np.array([spreads[a.track].factor.ravel() for a in vehicle.assemblies])
    causes = np.array([np.linalg.inv(spreads[a.track].factor[:3, :3]).ravel() for a in vehicle.assemblies])
    return Running(
        np.concatenate([constants, factors, causes], axis=1),
        np.stack([t.loss for t in tables]),
        np.stack([t.drive for t in tables]),
        {
            "first_x": tables[0].first_x,
            "step_x": tables[0].step_x,
            "glass_transition": vehicle.rubber.glass_transition,
            "wlf_c1": vehicle.rubber.wlf_c1,
            "wlf_c2": vehicle.rubber.wlf_c2,
            "hottest": min(limits.hottest for limits in ranges),
            "fastest_x": min(limits.log_reduced_speed for limits in ranges),
            "two_nodes": two_nodes,
            "bearing_friction_std": vehicle.parameters["chassis.bearing_friction"].standard_deviation,
        },
    )


def wheels(vehicle: RoadVehicle) -> Running:
    """All wheels as one, without a belt; the tables are unused."""
    row = np.zeros((1, layout.Assembly.columns))
    assembly = layout.Assembly(row[0])
    assembly.nominal_load, assembly.radius = vehicle.weight, vehicle.values["wheel_radius"]
    assembly.share_of_all = 1.0
    assembly.consider_radius[3] = relative_std(vehicle, "road_load.wheel_radius")
    no_cells = np.zeros((1, 1, 2))
    return Running(
        row,
        no_cells,
        no_cells,
        {
            "bearing_friction_std": vehicle.parameters["road_load.rolling_coefficient"].standard_deviation,
            "rolling_rise": vehicle.values["rolling_rise"],
            "rolling_rise_std": vehicle.parameters["road_load.rolling_rise"].standard_deviation,
            "torque_scale": vehicle.values["torque_scale"],
            "torque_offset": vehicle.values.get("torque_offset", 0.0),
        },
    )


def relative_std(vehicle: AnyVehicle, path: str) -> float:
    """Standard deviation of a value of the file that cannot be 0, over its size."""
    quantity = vehicle.parameters[path]
    return quantity.standard_deviation / float(np.mean(quantity.value))


def relative_weight_std(vehicle: AnyVehicle) -> float:
    """Relative standard deviation of the nominal weight. A load that is not known rests on all axles: their deviations add."""
    if isinstance(vehicle, RoadVehicle):
        return relative_std(vehicle, "road_load.mass")
    counts = Counter(f"tracks.{assembly.track}.own_weight" for assembly in vehicle.assemblies)
    stds = (count * vehicle.parameters[path].standard_deviation for path, count in counts.items())
    load = sum(vehicle.parameters[f"chassis.axles.{axle.name}.load"].standard_deviation for axle in vehicle.axles)
    return math.hypot(load, *stds) / vehicle.weight


def drag_area_stds(vehicle: AnyVehicle) -> dict[str, float]:
    """Standard deviation of the drag area [m^2] by the path of its cause. That of the air density is given as an area."""
    chassis, quantities = vehicle.chassis, vehicle.parameters
    area = chassis.drag_coefficient * chassis.frontal_area
    if isinstance(vehicle, RoadVehicle):
        stds, density = {"road_load.drag_area": quantities["road_load.drag_area"].standard_deviation}, "road_load.air_density"
    else:
        drag, frontal_area, density = (
            quantities["chassis.drag_coefficient"],
            quantities["chassis.frontal_area"],
            "chassis.air_density",
        )
        stds = {"chassis.drag_coefficient": drag.standard_deviation * chassis.frontal_area}
        if drag.flag != FITTED:  # the fit gave the drag of the whole area
            stds["chassis.frontal_area"] = frontal_area.standard_deviation * chassis.drag_coefficient
    return stds | {density: area * relative_std(vehicle, density)}


def _channel_limits(vehicle: AnyVehicle) -> Array:
    """Plausible values of every channel, shape (channels, 2)."""
    loads = vehicle.nominal_loads()
    speed = OVERSPEED * vehicle.chassis.max_speed
    rows = []
    for name in layout.channels(vehicle):
        role, _, place = name.partition("/")
        if role in ("speed", layout.WHEELS):
            rows.append((-speed, speed))
        elif role == "load":
            of_place = (load for load, a in zip(loads, vehicle.assemblies, strict=False) if place in (a.axle, a.name))
            nominal = sum(of_place) if place else sum(loads)
            rows.append((LEAST_LOAD_SHARE * nominal, LARGEST_LOAD_SHARE * nominal))
        else:
            rows.append(PLAUSIBLE[role])
    return np.array(rows, dtype=float)
