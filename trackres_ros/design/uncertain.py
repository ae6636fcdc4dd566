# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes the uncertainty of a difference between two vehicle files from their ranges.

To first order, as the live estimate propagates them (`estimator.uncertainty`). An error of a value that both files share
cancels. Errors of differing values are independent.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackres_ros.design.steady import FileErrors
from trackres_ros.estimator.uncertainty import logarithms_at, slopes
from trackres_ros.vehicle import Vehicle
from trackres_ros.vehicle.reading import FITTED

Array = NDArray[np.float64]

STEP = 0.01  # of a factor, for the derivatives
BEARING, DRAG = "chassis.bearing_friction", "chassis.drag_coefficient"
OF_DRAG = (DRAG, "chassis.frontal_area", "chassis.air_density")


@dataclass(frozen=True, eq=False)
class LogDerivatives:
    """Sensitivity of a drive's quantities, as logarithms, to one standard deviation of each value."""

    belts_degc: Array  # temperatures of the loss
    # by track, then by path: loss at each of those temperatures, film, heat capacity and radius
    of_track: Mapping[str, Mapping[str, Array]]
    # by path: bearing friction, and air drag
    bearing: Mapping[str, float]
    drag: Mapping[str, float]


def slopes_of(vehicle: Vehicle, speed: float, belts_degc: Array) -> LogDerivatives:
    """The slopes at a speed [m/s] and some belt temperatures [degC]."""

    def logarithms(track: str) -> Callable[[Vehicle], Array]:
        return lambda moved: logarithms_at(moved, track, speed, belts_degc, vehicle)

    def relative(path: str) -> float:
        quantity = vehicle.parameters[path]
        return quantity.standard_deviation / max(abs(float(np.mean(quantity.value))), 1e-12)

    fitted = vehicle.parameters[DRAG].flag == FITTED  # of the whole area
    drag = {path: relative(path) for path in OF_DRAG if not (fitted and path == "chassis.frontal_area")}
    of_track = {name: slopes(vehicle, name, logarithms(name)) for name in vehicle.tracks}
    return LogDerivatives(belts_degc, of_track, {BEARING: relative(BEARING)}, drag)


def moved(known: LogDerivatives, outcomes: Callable[[FileErrors, float], Array], belts_degc: Array) -> dict[str, Array]:
    """Sensitivity of some outcomes to one standard deviation of each value, by path, shape (outcomes,).

    `outcomes`: of factors, and of a factor on the heat capacity, shape (outcomes,); `belts_degc`: belt temperature of the loss in
    each outcome, shape (outcomes,).
    """
    nominal = outcomes(FileErrors(), 1.0)

    def by(off: FileErrors, capacity: float = 1.0) -> Array:
        return (outcomes(off, capacity) - nominal) / STEP

    more = 1.0 + STEP
    found: dict[str, Array] = {}

    def add(path: str, change: Array) -> None:
        found[path] = found.get(path, np.zeros_like(nominal)) + change

    for track, paths in known.of_track.items():
        per_loss, per_film, per_radius = (by(FileErrors(track, **{name: more})) for name in ("loss", "film", "radius"))
        per_capacity = by(FileErrors(track), more)
        for path, of in paths.items():
            *losses, film, capacity, radius = of.tolist()
            loss = np.interp(belts_degc, known.belts_degc, losses)
            add(path, per_loss * loss + per_film * film + per_capacity * capacity + per_radius * radius)
    for off, of_chassis in ((FileErrors(bearing=more), known.bearing), (FileErrors(drag=more), known.drag)):
        change = by(off)
        for path, relative in of_chassis.items():
            add(path, change * relative)
    return found


def difference_std(
    vehicles: tuple[Vehicle, Vehicle], changes: tuple[Mapping[str, Array], Mapping[str, Array]]
) -> tuple[Array, Array]:
    """Standard deviations of the second less the first, shape (outcomes,) each: from values that both files have alike, and with
    the ranges of those that differ too.
    """
    one, other = changes
    common = own = np.zeros_like(next(iter(one.values())))
    for path in {**one, **other}:
        quantities = [vehicle.parameters.get(path) for vehicle in vehicles]
        alike = quantities[0] is not None and quantities[1] is not None and quantities[0].value == quantities[1].value
        if alike and path in one and path in other:
            common = common + (other[path] - one[path]) ** 2
        else:
            own = own + sum(change[path] ** 2 for change in changes if path in change)
    return np.sqrt(common), np.sqrt(common + own)


def half_width(std: float) -> float:
    """Of a 95 % interval."""
    return 1.96 * std if math.isfinite(std) else math.nan
