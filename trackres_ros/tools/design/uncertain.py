# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes the uncertainty of a difference between two vehicle files from their ranges.

To first order, as the live estimate propagates them (`estimator.constants`). An error of a value that both files share
cancels. Errors of differing values are independent.
"""

from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from trackres_ros.estimator.constants import drag_area_stds, fits, logarithms_at, slopes
from trackres_ros.tools.design.steady import Array, FileErrors
from trackres_ros.vehicle import Vehicle
from trackres_ros.vehicle.description import FITTED

STEP = 0.01  # of a factor, for the derivatives
BEARING, DRAG = "chassis.bearing_friction", "chassis.drag_coefficient"
AREA = "chassis.frontal_area"
STEADY_COLUMNS = 0, 1, 3  # of slopes with one loss: loss, film and radius


@dataclass(frozen=True, eq=False)
class LogDerivatives:
    """Sensitivity of a drive's quantities, as logarithms, to one standard deviation of each value."""

    belts_degc: Array  # temperatures of the loss
    # by track, then by path: loss at each of those temperatures, film, heat capacity and radius
    of_track: Mapping[str, Mapping[str, Array]]
    # by path, unlike the others the change itself: bearing friction, and drag area [m^2]
    bearing_friction: Mapping[str, float]
    drag_area: Mapping[str, float]
    # of these two: the file's value, or the standard deviation of one of 0
    sizes: tuple[float, float]


def slopes_of(vehicle: Vehicle, speed: float, belts_degc: Array) -> LogDerivatives:
    """The slopes at a speed [m/s] and some belt temperatures [degC]."""

    def logarithms(track: str) -> Callable[[Vehicle], Array]:
        return lambda moved: logarithms_at(moved, track, speed, belts_degc, vehicle)

    chassis = vehicle.chassis
    friction, area = {BEARING: vehicle.parameters[BEARING].standard_deviation}, drag_area_stds(vehicle)
    of_area = chassis.drag_coefficient * chassis.frontal_area
    sizes = chassis.bearing_friction or friction[BEARING] or 1.0, of_area or sum(area.values()) or 1.0
    of_track = {name: slopes(vehicle, name, logarithms(name)) for name in vehicle.tracks}
    return LogDerivatives(belts_degc, of_track, friction, area, sizes)


def absorbed(vehicle: Vehicle, speed: float, belt_degc: float) -> dict[str, str]:
    """Fitted values by the paths of the values whose errors they have absorbed.

    A value is absorbed if the greater part of its effect at a speed [m/s] and belt temperature is on fitted quantities. The heat
    capacity has no part in it: it does not affect a steady state.
    """
    found = {AREA: DRAG} if vehicle.parameters[DRAG].flag == FITTED else {}
    fitted = {name: fits(vehicle, name, 1) for name in vehicle.tracks}
    if not any(fitted.values()):
        return found
    unfitted = {path: replace(quantity, flag="") for path, quantity in vehicle.parameters.items()}
    known = slopes_of(replace(vehicle, parameters=unfitted), speed, np.array([belt_degc]))
    # by path, then by fitted value; what no fit has absorbed under an empty name
    parts: defaultdict[str, defaultdict[str, float]] = defaultdict(lambda: defaultdict(float))
    for name, paths in known.of_track.items():
        by = {column: of for of, columns in fitted[name].items() for column in columns}
        for path, slope in paths.items():
            for column in STEADY_COLUMNS:
                of = by.get(column, ("",))
                parts[path]["" if path in of else of[0]] += abs(float(slope[column]))
    for path, part in parts.items():
        left = part.pop("", 0.0)
        if sum(part.values()) > left:
            found[path] = max(part, key=part.__getitem__)
    return found


def moved(known: LogDerivatives, outcomes: Callable[[FileErrors, float], Array], belts_degc: Array) -> dict[str, Array]:
    """Sensitivity of some outcomes to one standard deviation of each value, by path, shape (outcomes,).

    `outcomes`: of errors, and of a factor on the heat capacity, shape (outcomes,); `belts_degc`: belt temperature of the loss in
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
    friction, area = known.sizes
    for off, size, of_chassis in (
        (FileErrors(bearing_friction=STEP * friction), friction, known.bearing_friction),
        (FileErrors(drag_area=STEP * area), area, known.drag_area),
    ):
        change = by(off)
        for path, std in of_chassis.items():
            add(path, change * (std / size))
    return found


def difference_std(
    vehicles: tuple[Vehicle, Vehicle], changes: tuple[Mapping[str, Array], Mapping[str, Array]]
) -> tuple[Array, Array]:
    """Standard deviations of the second less the first, shape (outcomes,) each: from values that both files have alike, and with
    the ranges of those that differ too.

    An equal value has one error in both files; the narrower of its two ranges holds.
    """
    one, other = changes
    common = own = np.zeros_like(next(iter(one.values())))
    for path in {**one, **other}:
        quantities = [vehicle.parameters[path] for vehicle in vehicles if path in vehicle.parameters]
        stds = [quantity.standard_deviation for quantity in quantities]
        alike = len(quantities) == len(vehicles) and quantities[0].value == quantities[1].value
        if alike and min(stds) == 0.0:
            continue
        if alike and path in one and path in other:
            common = common + (min(stds) * (other[path] / stds[1] - one[path] / stds[0])) ** 2
        else:
            own = own + sum(change[path] ** 2 for change in changes if path in change)
    return np.sqrt(common), np.sqrt(common + own)
