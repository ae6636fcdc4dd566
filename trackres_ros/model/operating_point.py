# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes one operating point by the exact methods: loads, contacts, losses, heat, torque, rainflow matrix."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trackres_ros.effects.effect import SOFTENING_FROM_DEGC, Active, Conditions, Lag, Terms, conditions, together
from trackres_ros.effects.stepping import LEAST_TIME_S, LIMITS, MOST_STATE, MOST_TORQUE
from trackres_ros.model import resistance
from trackres_ros.model.belt import axial_stiffness
from trackres_ros.model.contact import wheel_loads
from trackres_ros.model.coverage import beyond_data, check_speed
from trackres_ros.model.hysteresis import RainflowCount
from trackres_ros.model.resistance import ON_WHEELS, RESISTANCE_PARTS
from trackres_ros.model.thermal import film_coefficient, surface_temperature
from trackres_ros.model.track import TrackModel, steady_tension, track_models, vehicle_constants
from trackres_ros.vehicle import AnyVehicle, Chassis, RoadVehicle, Vehicle

UNKNOWN = {"yaw_rate", "heading", "distance"}  # inputs of effects that an operating point lacks
INACTIVE = "inactive, as its input is no part of a steady straight drive, or its output is not finite or implausible"
DRIVE_PASSES = 4  # the torque strains the belt by 1e-4 of the wheels' strain; a second pass already converges


def explain(
    vehicle: Vehicle, speed: float, belt_degc: float, ambient_degc: float | None = None, weight_n: float | None = None
) -> dict[str, Any]:
    """Compute all results of the model for one steady state.

    Parameters
    ----------
    speed
        [m/s], either sign.
    belt_degc, ambient_degc
        Belt temperature, the mean one, and ambient temperature [degC].
    weight_n
        Whole weight [N], shared as nominal; by default the vehicle file's.

    Returns
    -------
    dict
        Ready for JSON. Torques, heat and cooling are for the whole vehicle; contacts, tension, loss forces and the rainflow
        matrix for the first assembly, followed by the loss forces of the others. The effects of the vehicle file are included,
        except for those that need more than this state (turning, a heading, a distance), and those with an implausible output
        (`effects_left_out`).

    Raises
    ------
    InputError
        Beyond the speeds of the vehicle.
    """
    check_speed(vehicle, speed)
    ambient = vehicle.chassis.ambient if ambient_degc is None else ambient_degc
    weight = vehicle.weight if weight_n is None else weight_n
    state = vehicle_state(vehicle, speed, [belt_degc] * len(vehicle.assemblies), ambient, weight)
    assemblies = state.assemblies
    first_assembly, model = assemblies[0], assemblies[0].model
    contacts = model.loss.contacts(speed, belt_degc, first_assembly.load)
    return {
        "vehicle": vehicle.name,
        "method": vehicle.hysteresis,
        "speed_mps": float(speed),
        "belt_degc": float(belt_degc),
        "ambient_degc": float(ambient),
        "weight_n": float(weight),
        "assemblies": [a.name for a in vehicle.assemblies],
        "wheel_loads_n": [wheel_loads(a.model.track, a.load).tolist() for a in assemblies],
        "contact": [
            {"half_length_m": float(a), "max_strain": float(e), "frequency_hz": float(f), "modulus_mpa": float(m) / 1e6}
            for a, e, f, m in zip(*contacts, strict=True)
        ],
        "tension_n": steady_tension(model, belt_degc, speed),
        "loss_force_n": first_assembly.loss_force,
        "loss_force_by_assembly_n": [a.loss_force for a in assemblies],
        "torque_nm": state.torque,
        "effects_left_out": state.effects_left_out,
        "remarks": [*beyond_data(vehicle, speed, {a.name: belt_degc for a in vehicle.assemblies}), *state.remarks],
        "heat_w": sum(a.heat for a in assemblies),
        "cooling_w": sum(a.cooling for a in assemblies),
        "film_coefficient_w_m2k": first_assembly.film,
        "surface_degc": [a.surface_degc for a in assemblies],
        "rainflow": rainflow_matrix(model, speed, belt_degc, first_assembly.load, first_assembly.drive_torque),
    }


@dataclass(frozen=True, eq=False)
class AssemblyState:
    """One assembly in a steady state; torques are its shares [Nm], film coefficient in W/m^2/K, heat and cooling in W."""

    model: TrackModel
    load: float
    loss_force: dict[str, float]
    drive_torque: float
    torque: dict[str, float]
    film: float
    heat: float
    cooling: float
    surface_degc: float


@dataclass(frozen=True, eq=False)
class VehicleState:
    """A vehicle in a steady state: its assemblies, the mean of its belts' temperatures [degC], torque by part [Nm] and the force
    of the resistance along the way [N].
    """

    assemblies: tuple[AssemblyState, ...]
    belt_degc: float
    torque: dict[str, float]
    force: float
    effects_left_out: list[str]
    remarks: list[str]


def vehicle_state(
    vehicle: Vehicle, speed: float, belts_degc: Sequence[float], ambient: float, weight: float,
    models: Mapping[str, TrackModel] | None = None,
) -> VehicleState:  # fmt: skip
    """A vehicle with its effects at a speed [m/s], with the belt temperature of each assembly; see `explain`.

    `models`: of the kinds of track, by name, if several states of the vehicle share them.
    """
    nominal = vehicle.nominal_loads()
    loads = weight * nominal / nominal.sum()
    kinds = [(a.track, float(load), degc) for a, load, degc in zip(vehicle.assemblies, loads, belts_degc, strict=True)]
    of_tracks = models or track_models(vehicle)
    effects_used, left_out = _effects(vehicle)
    belts = np.array(belts_degc)
    mean = float(belts[0] + (belts - belts[0]).mean())
    instant = conditions(vehicle_constants(vehicle), speed, weight=weight, ambient=ambient, belt=mean)
    terms = _belt_terms(effects_used, instant)
    for _ in range(DRIVE_PASSES):
        by_kind = {
            (track, load, degc): _assembly_state(vehicle.chassis, instant, degc, terms, of_tracks[track], load)
            for track, load, degc in set(kinds)
        }
        assemblies = tuple(by_kind[kind] for kind in kinds)
        torque = dict.fromkeys((*RESISTANCE_PARTS, "inertia"), 0.0)
        for assembly in assemblies:
            for part, value in assembly.torque.items():
                torque[part] += value
        torque["effects"] = _effects_torque(effects_used, instant, torque["hysteresis"] + torque["bearing"] + torque["wind"])
        torque["resistance"] = sum(torque[part] for part in RESISTANCE_PARTS)
        last_terms, terms = terms, _belt_terms(effects_used, instant._replace(drive_torque=torque["resistance"]))
        if terms == last_terms:
            break
    radii = vehicle.sprocket_radii
    arms = loads * radii / (loads @ radii)  # effects act on the whole vehicle, each assembly's part at its own radius
    shares = [sum(assembly.torque.values()) + torque["effects"] * arm for assembly, arm in zip(assemblies, arms, strict=True)]
    force = float(resistance.force_along(torque["resistance"], shares, radii))
    refusals, remarks = _doubtful_effects(effects_used, instant._replace(drive_torque=torque["resistance"]))
    return VehicleState(assemblies, mean, torque, force, [*left_out, *refusals], remarks)


def _belt_terms(effects: Sequence[Active], instant: Conditions) -> Terms:
    """Terms of effects on loss, heat and cooling of the belts."""
    return _sum_terms(effects, instant)._replace(torque=0.0, drive_gain=1.0, extrapolated=0.0)


def _assembly_state(
    chassis: Chassis, instant: Conditions, belt_degc: float, effects: Terms, model: TrackModel, load: float
) -> AssemblyState:
    """Results of an assembly under a load [N], with the terms of effects."""
    speed, direction = instant.speed, float(resistance.direction(instant.speed))
    wind = float(resistance.wind_force(speed, chassis.drag_coefficient * chassis.frontal_area, chassis.air_density))
    loss_factor = float(effects.loss_factor) * math.exp(-effects.softening * (belt_degc - SOFTENING_FROM_DEGC))
    radius, network = model.track.sprocket_radius, model.network
    bearing = float(resistance.bearing_force(speed, load, chassis.bearing_friction))
    by_torque, drive = model.loss.by_torque(speed, belt_degc, load), 0.0
    for _ in range(DRIVE_PASSES):
        loss = by_torque.loss_at(drive)
        total = float(loss.total) * loss_factor
        drive = radius * (total * direction + bearing + wind * load / instant.weight)
    slope = network.film_slope * float(effects.film_slope_factor)
    film = float(film_coefficient(speed, network.film_offset * float(effects.film_offset_factor), slope))
    to_air, to_sink = film * network.area, float(effects.conductance)
    cooling = to_air * (belt_degc - instant.ambient) + to_sink * (belt_degc - float(effects.sink))  # with the surface as warm
    cooling *= network.share_outside(to_air + to_sink)
    node = belt_degc - network.parting * cooling
    # Without the rounding of two inversions in `conductances`
    skin = network.inner_conductance if network.parting == 0.0 else network.conductances[1]
    surface = float(surface_temperature(node, instant.ambient, film, network.area, skin)) if math.isfinite(skin) else node
    return AssemblyState(
        model=model,
        load=float(load),
        loss_force={**{part: float(f) * loss_factor for part, f in loss._asdict().items()}, "total": total},
        drive_torque=drive,
        torque={
            "hysteresis": radius * total * direction,
            "bearing": radius * bearing,
            "wind": radius * wind * load / instant.weight,
        },
        film=film,
        heat=total * abs(speed) + float(effects.heat),
        cooling=cooling,
        surface_degc=surface,
    )


def explain_road(
    vehicle: RoadVehicle, speed: float, ambient_degc: float | None = None, weight_n: float | None = None
) -> dict[str, Any]:
    """The same of a vehicle without belts: torque at the wheels by part, ready for JSON."""
    check_speed(vehicle, speed)
    v, radius = vehicle.values, vehicle.constants.radius
    ambient = v["ambient"] if ambient_degc is None else ambient_degc
    weight = vehicle.weight if weight_n is None else weight_n
    effects_used, left_out = _effects(vehicle)
    coefficient = v["rolling_coefficient"] + v["rolling_rise"] * abs(speed)
    torque = {
        "rolling": radius * float(resistance.bearing_force(speed, weight, coefficient)),
        "wind": radius * float(resistance.wind_force(speed, v["drag_area"], v["air_density"])),
    }
    instant = conditions(vehicle.constants, speed, weight=weight, ambient=ambient)
    torque["effects"] = _effects_torque(effects_used, instant, sum(torque.values()))
    wheel_torque = sum(torque[part] for part in ON_WHEELS)
    refusals, remarks = _doubtful_effects(effects_used, instant._replace(drive_torque=wheel_torque))
    return {
        "vehicle": vehicle.name,
        "method": vehicle.hysteresis,
        "speed_mps": float(speed),
        "ambient_degc": float(ambient),
        "weight_n": float(weight),
        "torque_nm": {**torque, "inertia": 0.0, "resistance": wheel_torque},
        "power_w": wheel_torque / radius * speed,
        "effects_left_out": [*left_out, *refusals],
        "remarks": remarks,
    }


def left_out_at(vehicle: AnyVehicle, speed: float, ambient: float) -> list[str]:
    """Names of the effects that a steady state at a speed [m/s] leaves out, with belts as cold as the air [degC]."""
    effects_used, left_out = _effects(vehicle)
    return [
        *left_out,
        *_doubtful_effects(effects_used, conditions(vehicle_constants(vehicle), speed, ambient=ambient, belt=ambient))[0],
    ]


def _effects(vehicle: AnyVehicle) -> tuple[list[Active], list[str]]:
    """Effects of the vehicle file whose inputs a steady straight drive gives, and the names of the others, with the route."""
    effects_used = [active for active in vehicle.active if not set(active.effect.needs) & UNKNOWN]
    left_out = [active.effect.name for active in vehicle.active if active not in effects_used]
    return effects_used, [*left_out, *(["route"] if vehicle.route else [])]


def _terms(active: Active, instant: Conditions) -> Terms | None:
    """Terms of an effect in a steady state, with its own state at the target; None where the estimator's step refuses it."""
    try:
        lag = active.lag(instant) or Lag(0.0, 1.0, 0.0)
        terms = active.terms(instant, lag.target)
        is_usable = max(abs(lag.target), abs(lag.start)) <= MOST_STATE and LEAST_TIME_S <= lag.time_constant < math.inf
        is_usable &= all(low <= getattr(terms, name) <= high for name, (low, high) in LIMITS.items())
        is_usable &= abs(terms.torque) <= MOST_TORQUE * instant.facts.weight * instant.facts.radius
    except Exception:  # of any kind, as the code may not be ours
        return None
    return terms if is_usable else None


def _sum_terms(effects: Sequence[Active], instant: Conditions) -> Terms:
    """Terms of usable effects in a steady state."""
    return together([terms for active in effects if (terms := _terms(active, instant)) is not None])


def _doubtful_effects(effects: Sequence[Active], instant: Conditions) -> tuple[list[str], list[str]]:
    """Names of the effects with unusable terms, and remarks on learned ones beyond their ranges."""
    refusals, remarks = [], []
    for active in effects:
        terms = _terms(active, instant)
        if terms is None:
            refusals.append(active.effect.name)
        elif terms.extrapolated > 0.0:
            remarks.append(f"{active.effect.name} is outside the range it was fitted on: it keeps its end value")
    return refusals, remarks


def _effects_torque(effects: Sequence[Active], instant: Conditions, other_torque: float) -> float:
    """Torque of effects added to the other parts [Nm]; some depend on the total drive torque."""
    extra = 0.0
    for _ in range(DRIVE_PASSES):
        terms = _sum_terms(effects, instant._replace(drive_torque=other_torque + extra))
        extra = float(terms.torque) + (other_torque + float(terms.torque)) * (float(terms.drive_gain) - 1.0)
    return extra


def rainflow_matrix(model: TrackModel, speed: float, belt_degc: float, load: float, drive_torque: float = 0.0) -> list[list[Any]]:
    """Rows [range, mean, count, component] of one loop, equation (25): through the thickness, and along the outer face."""
    counter = RainflowCount(model.track, model.rubber)
    belt = model.track.belt
    half_lengths = counter.contacts(speed, belt_degc, load).half_length
    stiffness = axial_stiffness(belt, model.rubber.dynamic_modulus(abs(speed) / belt.loop_length, belt_degc))
    steady_strain = steady_tension(model, belt_degc, speed) / float(stiffness)
    strain = float(counter.drive_strain(speed, belt_degc, drive_torque))
    cycles_along = counter.along_cycles(belt.thickness, strain, steady_strain)
    return [
        [float(c.cycle.range), float(c.cycle.mean), float(c.cycle.number), component]
        for component, cycles in (("through", counter.indentation_cycles(np.asarray(half_lengths))), ("along", cycles_along))
        for c in cycles
    ]
