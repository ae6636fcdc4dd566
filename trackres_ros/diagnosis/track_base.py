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
from trackres_ros.diagnosis.session import Session
from trackres_ros.diagnosis.vehicle_file import write_track_vehicle
from trackres_ros.effects.effect import SOFTENING_FROM_DEGC, Active
from trackres_ros.effects.facts import facts_of
from trackres_ros.model.belt import GRAVITY
from trackres_ros.model.loss_table import LossTable, loss_table
from trackres_ros.model.thermal import ThermalNetwork, phi_1, thermal_network
from trackres_ros.vehicle import Vehicle

Array = NDArray[np.float64]

LOSS, BEARING, DRAG, FILM, CAPACITY = "loss_modulus_scale", "bearing_friction", "drag_coefficient", "film_scale", "capacity_scale"
CONDUCTIVITY, SURFACE_SHARE = "conductivity", "surface_share"
MOST_AT_SURFACE = 0.8
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
        self.includes = tuple(active.effect.name for active in vehicle.effects)
        self.facts = facts_of(vehicle)
        first = vehicle.track_of(vehicle.assemblies[0])

        def known(name: str, path: str) -> BaseParameter:
            q = vehicle.parameters[path]
            assert isinstance(q.value, float)
            return BaseParameter(name, q.unit, q.value, q.standard_deviation, 0.2 * q.low, 3.0 * q.high)

        film = vehicle.parameters[f"tracks.{first.name}.belt.film_offset"]
        assert isinstance(film.value, float)
        self.parameters: tuple[BaseParameter, ...] = (
            known(LOSS, "rubber.loss_modulus_scale"),
            known(BEARING, "chassis.bearing_friction"),
            known(DRAG, "chassis.drag_coefficient"),
            BaseParameter(FILM, "1", 1.0, film.standard_deviation / film.value, 0.2, 5.0),
            BaseParameter(CAPACITY, "1", 1.0, CAPACITY_STD, 0.3, 3.0),
        )
        if vehicle.thermal == "core_surface":
            # Two nodes stand for a belt in which the temperature changes throughout: where they are to be is not known well.
            share = known(SURFACE_SHARE, f"tracks.{first.name}.belt.surface_share")
            self.parameters += (known(CONDUCTIVITY, "rubber.conductivity"), replace(share, high=min(share.high, MOST_AT_SURFACE)))

    def predict(
        self, sessions: Sequence[Session], values: Values, effects: Sequence[Active], drive: Sequence[Array]
    ) -> list[Predicted]:
        """See `base.Base`."""
        temperatures: list[tuple[float, float] | None] = [None] * len(self._groups)
        found = []
        for session, course in zip(
            sessions, courses(sessions, self.facts, [*self.vehicle.effects, *effects], drive), strict=True
        ):
            loss_torque, belts, skins = (np.zeros(len(session)) for _ in range(3))
            for i, group in enumerate(self._groups):
                loss, belt, skin, temperatures[i] = self._roll(group, session, course, values, temperatures[i])
                loss_torque += group.count * group.radius * loss
                belts += group.count / self.facts.assemblies * belt
                skins += group.count / self.facts.assemblies * skin
            found.append(self._torque(session, course, values, loss_torque, belts, skins))
        return found

    def write(self, path: Path, values: Values, effects: Sequence[Active], text: str) -> None:
        """See `base.Base`."""
        write_track_vehicle(self.vehicle, path, values, [*self.vehicle.effects, *effects], text)

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
