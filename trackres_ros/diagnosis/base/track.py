# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The paper's model of a track vehicle as a base: belt loss at the belt's temperature, bearings, air, inertia, known slope."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from trackres_ros.diagnosis.base.base import Acting, BaseParameter, Values
from trackres_ros.diagnosis.base.simulated import FileBase, simulate_sessions
from trackres_ros.diagnosis.prepare.session import Array, DriveSession
from trackres_ros.effects.effect import Active
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.constants import Constants, make_constants
from trackres_ros.estimator.settings import Settings
from trackres_ros.model.loss_table import loss_table
from trackres_ros.model.thermal import parting_resistance, thermal_network
from trackres_ros.model.track import vehicle_constants
from trackres_ros.vehicle import Vehicle
from trackres_ros.vehicle.belt_bulk import heat_capacity
from trackres_ros.vehicle.description import BELT, CHASSIS, FITTED, RUBBER
from trackres_ros.vehicle.writing.changes import FileChanges
from trackres_ros.vehicle.writing.vehicle_file import rubber_share, write_track_vehicle

LOSS, BEARING, DRAG, FILM, CAPACITY = "loss_modulus_scale", "bearing_friction", "drag_coefficient", "film_scale", "capacity_scale"
CONDUCTIVITY, SURFACE_SHARE = "conductivity", "surface_share"
FILMS = "film_offset", "film_slope"
MOST_AT_SURFACE = 0.8
# Bounds of a fit, independent of the file's range, which after a diagnosis is a learned one: a fifth of the lower
# and three times the upper end of the data sheet ranges of the shipped vehicles.
PLAUSIBLE = {
    LOSS: (0.16, 3.6),
    BEARING: (0.0008, 0.036),
    DRAG: (0.12, 3.0),
    CONDUCTIVITY: (0.04, 1.05),
    SURFACE_SHARE: (0.02, MOST_AT_SURFACE),
}
PLAUSIBLE_FILM, PLAUSIBLE_CAPACITY = (0.2, 5.0), (0.3, 3.0)  # factors on the file's
LOSS_TABLES = 4  # in the cache
LESS_LOSS = 0.8  # times the file's loss modulus scale, for the derivative of the loss table
CAPACITY_STD = 0.15  # relative: thickness, lug section and specific heat of the file's ranges together


class TrackBase(FileBase):
    """Base model `track`; see `base.Base`."""

    name = "track"
    has_belt = rolls = True
    vehicle: Vehicle

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        self._constants = make_constants(vehicle, Settings(), with_uncertainty=False)
        self._networks = {
            name: thermal_network(vehicle.thermal, track.belt, vehicle.rubber) for name, track in vehicle.tracks.items()
        }
        self._firsts, self._count = _kinds(self._constants)
        shares = np.array([rubber_share(vehicle, vehicle.assemblies[i].track) for i in self._firsts])
        self._of_rubber = shares / shares[0]  # relative change of a belt's heat capacity, over that of the first one
        self._loss_tables: tuple[tuple[tuple[float, slice], Array], ...] = ()
        self.includes = tuple(active.effect.name for active in vehicle.active)
        self.facts = vehicle_constants(vehicle)
        first_track = vehicle.track_of(vehicle.assemblies[0])
        self.parts = {
            "belt": first_track.belt.loop_length,
            "sprocket": 2.0 * math.pi * first_track.sprocket_radius,
            "road wheels": 2.0 * math.pi * first_track.road_wheels.radius,
        }
        self.rotating_mass_factor = vehicle.chassis.rotating_mass_factor
        limits = {**RUBBER, **CHASSIS, **BELT}

        def known(name: str, path: str) -> BaseParameter:
            q, limit, (low, high) = vehicle.parameters[path], limits[name], PLAUSIBLE[name]
            assert isinstance(q.value, float)
            low, high = max(limit.low, min(low, 0.2 * q.low)), min(limit.high, max(high, 3.0 * q.high))
            return BaseParameter(name, q.unit, q.value, q.standard_deviation, low, high, (q.low, q.high))

        film = vehicle.parameters[f"tracks.{first_track.name}.belt.film_offset"]
        capacity = vehicle.parameters["rubber.heat_capacity"]
        assert isinstance(film.value, float)
        assert isinstance(capacity.value, float)
        share = float(shares[0])
        is_learned = capacity.flag == FITTED
        capacity_std = share * capacity.standard_deviation / capacity.value if is_learned else CAPACITY_STD
        # Factors on the belt's heat capacity from the rubber's share: by the limits of a file, and by the range of this one.
        (least_capacity, most_capacity), by_file = (
            (1.0 + share * (bounds.low / capacity.value - 1.0), 1.0 + share * (bounds.high / capacity.value - 1.0))
            for bounds in (RUBBER["heat_capacity"], capacity)
        )
        limits_of_fit = max(PLAUSIBLE_CAPACITY[0], least_capacity), min(PLAUSIBLE_CAPACITY[1], most_capacity)
        film_std = film.standard_deviation / film.value
        film_factors = _belt_factors(vehicle, FILMS, *PLAUSIBLE_FILM, by_file=False)
        films_by_file = _belt_factors(vehicle, FILMS, 0.0, np.inf, by_file=True)
        fitted_parameters = [
            known(LOSS, "rubber.loss_modulus_scale"),
            known(BEARING, "chassis.bearing_friction"),
            known(DRAG, "chassis.drag_coefficient"),
            BaseParameter(FILM, "1", 1.0, film_std, *film_factors, films_by_file, film.value),
            BaseParameter(
                CAPACITY, "1", 1.0, capacity_std, *limits_of_fit, by_file, heat_capacity(first_track.belt, vehicle.rubber)
            ),
        ]
        if vehicle.thermal == "core_surface":
            # Two nodes approximate a continuous temperature profile, so their positions are uncertain.
            surface_share = known(SURFACE_SHARE, f"tracks.{first_track.name}.belt.surface_share")
            fitted_parameters += [known(CONDUCTIVITY, "rubber.conductivity"), _of_all_belts(vehicle, surface_share)]
        self._by_default = {q.name: q.nominal for q in fitted_parameters}
        # A value whose range in the file has no width is exact, and so is a factor on such a value.
        self.parameters = tuple(q for q in fitted_parameters if q.by_file[0] < q.by_file[1])

    def _own_effects(self, _: Values) -> Sequence[Active]:
        return self.vehicle.active

    def _simulate(self, sessions: Sequence[DriveSession], values: Values, acting_effects: Acting) -> list[Array]:
        k, belts = self._constants_with(values, acting_effects, self._loads(sessions)), len(self._firsts)
        cooling, by_speed = (values[FILM] * factors for factors in (self.facts.cooling, self.facts.cooling_by_speed))
        facts = self.facts._replace(drag_area=k.number.drag_area, cooling=cooling, cooling_by_speed=by_speed)
        return simulate_sessions(k, self._count, belts, facts, sessions, acting_effects)

    def _loads(self, sessions: Sequence[DriveSession]) -> slice:
        """Columns of the loss table between which the belts are loaded, with one more on either side."""
        rows = self._constants.assembly[self._firsts].T
        weights = [weight for session in sessions for weight in session.weights]
        loads = np.array([*(weight * rows[at.Assembly.share_of_all] for weight in weights), rows[at.Assembly.nominal_load]])
        nodes = (np.log(loads) - rows[at.Assembly.first_log_load]) / rows[at.Assembly.step_log_load]
        first_node, last = np.clip([nodes.min(), nodes.max()], 0, self._constants.loss.shape[2] - 2).astype(int).tolist()
        return slice(max(first_node - 1, 0), last + 3)

    def _scaled_table(self, loss: float, loads: slice) -> Array:
        """Loss table for a multiple of the file's loss modulus, nan at other loads; cached, because a fit step reuses a few."""
        if loss == 1.0:
            return self._constants.loss
        loss_table = next((table for table_key, table in self._loss_tables if table_key == (loss, loads)), None)
        if loss_table is None:
            loss_table = np.full_like(self._constants.loss, np.nan)
            loss_table[:, :, :2] = self._constants.loss[:, :, :2]  # looked up at rest, where no loss heats
            power = math.log(loss) * self._loss_power[:, :, loads]
            loss_table[:, :, loads] = self._constants.loss[:, :, loads] * np.exp(power)  # faster than a power
            self._loss_tables = (((loss, loads), loss_table), *self._loss_tables[: LOSS_TABLES - 1])
        return loss_table

    @cached_property
    def _loss_power(self) -> Array:
        """Power with which a value of the loss table grows with the loss modulus scale: a lossier belt is stiffer, too."""
        rubber = self.vehicle.rubber
        soft_vehicle = replace(self.vehicle, rubber=replace(rubber, loss_modulus_scale=LESS_LOSS * rubber.loss_modulus_scale))
        losses = np.stack([loss_table(soft_vehicle, name).loss for name in soft_vehicle.tracks])
        return np.asarray(np.log(losses / self._constants.loss) / math.log(LESS_LOSS))

    def write(self, path: Path, file_changes: FileChanges, text: str) -> list[Path]:
        """See `base.Base`."""
        return write_track_vehicle(self.vehicle, path, file_changes, text)

    def _constants_with(self, values: Values, acting_effects: Acting, loads: slice) -> Constants:
        """Constants of the step with other parameter values, for some columns of the loss table."""
        k, vehicle = self._constants, self.vehicle
        resistance = parting_resistance(acting_effects.step_effects, self.facts)
        number = k.number._replace(
            bearing_friction=values[BEARING],
            drag_area=values[DRAG] * vehicle.chassis.frontal_area,
            two_nodes=vehicle.thermal == "core_surface" or resistance > 0.0,
        )
        assembly = k.assembly[self._firsts]
        assembly[:, at.Assembly.film_offset] *= values[FILM]
        assembly[:, at.Assembly.film_slope] *= values[FILM]
        assembly[:, at.Assembly.capacity] *= 1.0 + self._of_rubber * (values[CAPACITY] - 1.0)
        shares = assembly[:, at.Assembly.surface_share]
        assembly[:, at.Assembly.surface_share] = values.get(SURFACE_SHARE, shares[0]) * (shares / shares[0])
        conducts = values.get(CONDUCTIVITY, vehicle.rubber.conductivity) / vehicle.rubber.conductivity
        for row, i in zip(assembly, self._firsts, strict=True):
            network = self._networks[vehicle.assemblies[i].track]
            network = network._replace(inner_conductance=conducts * network.inner_conductance, of_effects=resistance)
            row[at.Assembly.inner_conductance], row[at.Assembly.skin_conductance] = network.conductances
        loss = values[LOSS] / vehicle.rubber.loss_modulus_scale
        return k._replace(
            number=number,
            assembly=assembly,
            loss=self._scaled_table(loss, loads),
            drive=loss * k.drive,
        )


def _kinds(k: Constants) -> tuple[list[int], Array]:
    """Groups of assemblies with the same kind and weight share, whose belts are alike: one of each, and their count."""
    groups: dict[tuple[float, float], list[int]] = {}
    for i, row in enumerate(k.assembly):
        groups.setdefault((row[at.Assembly.kind], round(float(row[at.Assembly.share_of_all]), 6)), []).append(i)
    return [rows[0] for rows in groups.values()], np.array([len(rows) for rows in groups.values()], dtype=float)


def _of_all_belts(vehicle: Vehicle, first_parameter: BaseParameter) -> BaseParameter:
    """The share of the first belt at its surface, with bounds for those of all belts, which change in proportion."""
    share, largest_share = first_parameter.nominal, min(first_parameter.high, MOST_AT_SURFACE)
    low, high = _belt_factors(vehicle, (first_parameter.name,), first_parameter.low / share, largest_share / share, by_file=False)
    file_range = _belt_factors(vehicle, (first_parameter.name,), 0.0, np.inf, by_file=True)
    return replace(first_parameter, low=share * low, high=share * high, by_file=(share * file_range[0], share * file_range[1]))


def _belt_factors(vehicle: Vehicle, keys: Sequence[str], low: float, high: float, by_file: bool) -> tuple[float, float]:
    """Factors that keep values of every belt within the limits of a vehicle file, or `by_file` inside their own ranges there."""
    for name in vehicle.tracks:
        for key in keys:
            q = vehicle.parameters[f"tracks.{name}.belt.{key}"]
            limit = q if by_file else BELT[key]
            assert isinstance(q.value, float)
            if q.value > 0.0:
                low, high = max(low, limit.low / q.value), min(high, limit.high / q.value)
    return low, high
