"""The paper's model of a track vehicle as a base: belt loss at the belt's temperature, bearings, air, inertia, known slope."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis import belt_series as at
from trackres_ros.diagnosis.base import BaseParameter, Course, Predicted, Values, as_sensed, courses, full
from trackres_ros.diagnosis.belt_series import CONSTANTS, roll_along
from trackres_ros.diagnosis.kept import Kept
from trackres_ros.diagnosis.session import Session
from trackres_ros.diagnosis.vehicle_file import rubber_share, write_track_vehicle
from trackres_ros.effects.effect import SOFTENING_FROM_DEGC, Active
from trackres_ros.effects.facts import facts_of
from trackres_ros.model.belt import GRAVITY
from trackres_ros.model.loss_table import LossTable, loss_table
from trackres_ros.model.thermal import ThermalNetwork, phi_1, thermal_network
from trackres_ros.vehicle import Vehicle
from trackres_ros.vehicle.reading import FITTED
from trackres_ros.vehicle.schema import BELT, CHASSIS, RUBBER

Array = NDArray[np.float64]

LOSS, BEARING, DRAG, FILM, CAPACITY = "loss_modulus_scale", "bearing_friction", "drag_coefficient", "film_scale", "capacity_scale"
CONDUCTIVITY, SURFACE_SHARE = "conductivity", "surface_share"
MOST_AT_SURFACE = 0.8
# What a fit may come to whatever range the file gives, which after a diagnosis is that of what was learned: a fifth of the lower
# and three times the upper end of what data sheets of the shipped vehicles say.
PLAUSIBLE = {
    LOSS: (0.16, 3.6),
    BEARING: (0.0008, 0.036),
    DRAG: (0.12, 3.0),
    CONDUCTIVITY: (0.04, 1.05),
    SURFACE_SHARE: (0.02, MOST_AT_SURFACE),
}
PLAUSIBLE_FILM, PLAUSIBLE_CAPACITY = (0.2, 5.0), (0.3, 3.0)  # factors on the file's
CAPACITY_STD = 0.15  # relative: thickness, section of lugs and specific heat of the file's ranges together


@dataclass(frozen=True, eq=False)
class _Group:
    """Assemblies of one kind that carry one share of the weight: their belts are alike."""

    count: int
    share: float  # of the weight, on each
    radius: float
    table: LossTable
    network: ThermalNetwork
    surface_share: float


class TrackBase:
    """Base model `track`; see `base.Base`."""

    name = "track"
    has_belt = True

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle = vehicle
        self._groups = _groups(vehicle)
        self.includes = tuple(active.effect.name for active in vehicle.active)
        self.facts = facts_of(vehicle)
        self.torque_scale = 1.0
        self.rotating_mass_factor = vehicle.chassis.rotating_mass_factor
        first = vehicle.track_of(vehicle.assemblies[0])
        limits = {**RUBBER, **CHASSIS, **BELT}

        def known(name: str, path: str) -> BaseParameter:
            q, limit, (low, high) = vehicle.parameters[path], limits[name], PLAUSIBLE[name]
            assert isinstance(q.value, float)
            low, high = max(limit.low, min(low, 0.2 * q.low)), min(limit.high, max(high, 3.0 * q.high))
            return BaseParameter(name, q.unit, q.value, q.standard_deviation, low, high)

        film, capacity = vehicle.parameters[f"tracks.{first.name}.belt.film_offset"], vehicle.parameters["rubber.heat_capacity"]
        assert isinstance(film.value, float)
        assert isinstance(capacity.value, float)
        share = rubber_share(vehicle)
        learned = capacity.flag == FITTED
        capacity_std = share * capacity.standard_deviation / capacity.value if learned else CAPACITY_STD
        self.parameters: tuple[BaseParameter, ...] = (
            known(LOSS, "rubber.loss_modulus_scale"),
            known(BEARING, "chassis.bearing_friction"),
            known(DRAG, "chassis.drag_coefficient"),
            BaseParameter(FILM, "1", 1.0, film.standard_deviation / film.value, *_film_factors(vehicle)),
            BaseParameter(CAPACITY, "1", 1.0, capacity_std, *_capacity_factors(capacity.value, share)),
        )
        if vehicle.thermal == "core_surface":
            # Two nodes stand for a belt in which the temperature changes throughout: where they are to be is not known well.
            of_surface = known(SURFACE_SHARE, f"tracks.{first.name}.belt.surface_share")
            of_surface = replace(of_surface, high=min(of_surface.high, MOST_AT_SURFACE))
            self.parameters += (known(CONDUCTIVITY, "rubber.conductivity"), of_surface)

    def predict(
        self, sessions: Sequence[Session], values: Values, effects: Sequence[Active], drive: Sequence[Array]
    ) -> list[Predicted]:
        """See `base.Base`."""
        temperatures: list[tuple[float, float] | None] = [None] * len(self._groups)
        found = []
        for session, course in zip(
            sessions, courses(sessions, self.facts, [*self.vehicle.active, *effects], drive), strict=True
        ):
            loss_torque, belts, skins = (np.zeros(len(session)) for _ in range(3))
            for i, group in enumerate(self._groups):
                loss, belt, skin, temperatures[i] = self._roll(group, session, course, values, temperatures[i])
                loss_torque += group.count * group.radius * loss
                belts += group.count / self.facts.assemblies * belt
                skins += group.count / self.facts.assemblies * skin
            found.append(self._torque(session, course, values, loss_torque, belts, skins))
        return found

    def write(self, path: Path, kept: Kept, text: str) -> list[Path]:
        """See `base.Base`."""
        return write_track_vehicle(self.vehicle, path, kept, text)

    def _torque(self, session: Session, course: Course, values: Values, loss: Array, belt: Array, skin: Array) -> Predicted:
        chassis, radius = self.vehicle.chassis, self.facts.radius
        speed, direction = np.asarray(course.at.speed), np.asarray(course.at.direction)
        area = values[DRAG] * chassis.frontal_area
        inertia = chassis.rotating_mass_factor * session.weight / GRAVITY
        force = (
            values[BEARING] * session.weight * direction
            + 0.5 * chassis.air_density * area * speed * np.abs(speed)
            + inertia * session.accel_apart
        )
        if "grade" in session.given:
            force = force + session.weight * session.grade / np.sqrt(1.0 + session.grade**2)
        slow = (loss * direction + radius * force + course.terms.torque) * course.terms.drive_gain
        # No effect acts on the rest of the inertia: what the speed's own noise makes of it would tell for or against it.
        quick = radius * inertia * (session.accel - session.accel_apart)
        return Predicted(as_sensed(slow, course.terms, session) + quick, slow, belt, skin)

    def _roll(
        self, group: _Group, session: Session, course: Course, values: Values, before: tuple[float, float] | None
    ) -> tuple[Array, Array, Array, tuple[float, float]]:
        """Loss [N], mean and seen surface [degC] of one belt of a group, and what it ends with."""
        rubber, network, terms = self.vehicle.rubber, group.network, course.terms
        constants = np.empty(CONSTANTS)
        constants[at.FIRST_X], constants[at.STEP_X] = group.table.first_x, group.table.step_x
        constants[at.FIRST_LOG_LOAD], constants[at.STEP_LOG_LOAD] = group.table.first_log_load, group.table.step_log_load
        constants[at.GLASS_TRANSITION], constants[at.WLF_C1] = rubber.glass_transition, rubber.wlf_c1
        constants[at.WLF_C2] = rubber.wlf_c2
        constants[at.CAPACITY] = network.capacity * values[CAPACITY]
        constants[at.SURFACE_SHARE], constants[at.AREA] = group.surface_share, network.area
        constants[at.FILM_OFFSET] = network.film_offset * values[FILM]
        constants[at.FILM_SLOPE] = network.film_slope * values[FILM]
        inner = network.inner_conductance
        if network.two_nodes:
            inner *= values[CONDUCTIVITY] / rubber.conductivity
            constants[at.SURFACE_SHARE] = values[SURFACE_SHARE]
        own = 1.0 / inner if network.two_nodes else 0.0
        constants[at.INNER_RESISTANCE] = own + terms.inner_resistance
        constants[at.SOFTENING], constants[at.SOFTENING_FROM] = terms.softening, SOFTENING_FROM_DEGC
        ambient = full(session.ambient, session)
        start = (float(ambient[0]), float(ambient[0]))
        if before is not None and np.isfinite(session.gap):
            start = _rested(before, session.gap, float(ambient[0]), constants)
        loss, mean, skin = (np.empty(len(session)) for _ in range(3))
        roll_along(
            constants,
            group.table.loss[np.newaxis],
            session.step,
            full(course.at.speed, session),
            np.log(session.weight * group.share),
            ambient,
            full(terms.loss_factor, session) * (values[LOSS] / rubber.loss_modulus_scale),
            full(terms.film_offset_factor, session),
            full(terms.film_slope_factor, session),
            full(terms.conductance, session),
            full(terms.sink, session),
            full(terms.heat, session),
            *start,
            loss,
            mean,
            skin,
        )
        end = (float(mean[-1]), float(skin[-1]))
        # A sensor sees the surface. What of the inner resistance has no node of its own lies between the last node and it.
        left = 1.0 / inner - constants[at.INNER_RESISTANCE]
        if left > at.LEAST_RESISTANCE:
            travel = np.abs(course.at.speed)
            film = constants[at.FILM_OFFSET] * full(terms.film_offset_factor, session)
            film = film + constants[at.FILM_SLOPE] * full(terms.film_slope_factor, session) * travel
            to_air = film * network.area  # as in `model.thermal.surface_temperature`, for a series
            skin = (skin / left + to_air * ambient) / (1.0 / left + to_air)
        return loss, mean, skin, end


def _rested(before: tuple[float, float], seconds: float, ambient: float, constants: Array) -> tuple[float, float]:
    """Temperatures of a belt after a rest: its mean cools through film and inner resistance, and the surface has met it."""
    mean = before[0]
    rate = (
        -1.0 / (1.0 / (constants[at.FILM_OFFSET] * constants[at.AREA]) + constants[at.INNER_RESISTANCE]) / constants[at.CAPACITY]
    )
    mean += rate * (mean - ambient) * seconds * phi_1(rate * seconds)
    return mean, mean


def _groups(vehicle: Vehicle) -> list[_Group]:
    loads = vehicle.nominal_loads()
    kinds: dict[tuple[str, float], int] = {}
    for assembly, load in zip(vehicle.assemblies, loads, strict=True):
        key = (assembly.track, round(float(load / loads.sum()), 6))
        kinds[key] = kinds.get(key, 0) + 1
    return [
        _Group(
            count,
            share,
            vehicle.tracks[track].sprocket_radius,
            loss_table(vehicle, track),
            thermal_network(vehicle.thermal, vehicle.tracks[track].belt, vehicle.rubber),
            vehicle.tracks[track].belt.surface_share,
        )
        for (track, share), count in kinds.items()
    ]


def _film_factors(vehicle: Vehicle) -> tuple[float, float]:
    """Bounds of the factor on the film coefficient, with which no belt leaves what a vehicle file may say."""
    low, high = PLAUSIBLE_FILM
    for name in vehicle.tracks:
        for key in ("film_offset", "film_slope"):
            value, limit = vehicle.parameters[f"tracks.{name}.belt.{key}"].value, BELT[key]
            assert isinstance(value, float)
            if value > 0.0:
                low, high = max(low, limit.low / value), min(high, limit.high / value)
    return low, high


def _capacity_factors(heat_capacity: float, share: float) -> tuple[float, float]:
    """The same for the heat that a belt holds, of which the rubber has a share."""
    (low, high), limit = PLAUSIBLE_CAPACITY, RUBBER["heat_capacity"]
    least, most = (1.0 + share * (end / heat_capacity - 1.0) for end in (limit.low, limit.high))
    return max(low, least), min(high, most)
