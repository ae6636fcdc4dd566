# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes the uncertainty of loss, cooling, heat capacity and sprocket radius from the ranges of the vehicle file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.errors import InputError
from trackres_ros.files.cache import cached_arrays
from trackres_ros.model.hysteresis import METHODS, Spectral
from trackres_ros.model.loss_table import fingerprint
from trackres_ros.model.rubber import RubberModel
from trackres_ros.model.thermal import film_coefficient, thermal_network
from trackres_ros.model.track import load_range
from trackres_ros.vehicle import Vehicle, variants
from trackres_ros.vehicle.belt_bulk import heat_capacity
from trackres_ros.vehicle.description import FITTED

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

    def logarithms(moved: Vehicle) -> Array:
        found = logarithms_at(moved, track_name, speed, np.array(REFERENCE_BELT_DEGC), vehicle)
        return np.array([found[:-3].mean(), *found[-3:]])

    found = slopes(vehicle, track_name, logarithms)
    rows = np.array(list(found.values())).reshape(-1, 4)
    covariance = rows.T @ rows + np.diag(np.full(4, 1e-12))
    return np.asarray(np.linalg.cholesky(covariance))


def fits(vehicle: Vehicle, track_name: str, losses: int) -> dict[tuple[str, ...], list[int]]:
    """Columns of `slopes` that recordings fitted, by the paths of the fitted values; `losses`: number of loss columns."""
    belt, (film, capacity, radius) = f"tracks.{track_name}.belt", range(losses, losses + 3)
    columns = {
        (LOSS,): [*range(losses), radius], (f"{belt}.film_offset", f"{belt}.film_slope"): [film], (CAPACITY,): [capacity]
    }  # fmt: skip
    return {paths: of for paths, of in columns.items() if vehicle.parameters[paths[0]].flag == FITTED}


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
                moved = variant({path: quantity.value + step})
            except InputError:  # the geometry does not allow this step, but it allows the opposite one
                continue
            rows[path] = (logarithms(moved) - base) / (sign * STEP)
            break
    belt = f"tracks.{track_name}.belt"
    for fitted, columns in fits(vehicle, track_name, len(base) - 3).items():
        for path in rows:
            if path not in fitted:
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
    network, before = (thermal_network(v.thermal, v.tracks[track_name].belt, v.rubber) for v in (vehicle, base))
    film = network.area * film_coefficient(speed, network.film_offset, network.film_slope)
    cooling = film / (1.0 + (network.parting - before.parting) * film)
    capacity = heat_capacity(track.belt, vehicle.rubber)
    return np.array([*np.log(loss), np.log(cooling), np.log(capacity), np.log(track.sprocket_radius)])
