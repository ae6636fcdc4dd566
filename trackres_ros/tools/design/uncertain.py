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
        return lambda variant: logarithms_at(variant, track, speed, belts_degc, vehicle)

    chassis = vehicle.chassis
    friction, area = {BEARING: vehicle.parameters[BEARING].standard_deviation}, drag_area_stds(vehicle)
    of_area = chassis.drag_coefficient * chassis.frontal_area
    sizes = chassis.bearing_friction or friction[BEARING] or 1.0, of_area or sum(area.values()) or 1.0
    of_track = {name: slopes(vehicle, name, logarithms(name)) for name in vehicle.tracks}
    return LogDerivatives(belts_degc, of_track, friction, area, sizes)


def absorbing_fits(vehicle: Vehicle, speed: float, belt_degc: float) -> dict[str, str]:
    """Fitted values by the paths of the values whose errors they have absorbed.

    A value is absorbed if the greater part of its effect at a speed [m/s] and belt temperature is on fitted quantities. The heat
    capacity has no part in it: it does not affect a steady state.
    """
    fits_by_path = {AREA: DRAG} if vehicle.parameters[DRAG].flag == FITTED else {}
    fitted_columns = {name: fits(vehicle, name, 1) for name in vehicle.tracks}
    if not any(fitted_columns.values()):
        return fits_by_path
    unfitted = {path: replace(quantity, flag="") for path, quantity in vehicle.parameters.items()}
    derivatives = slopes_of(replace(vehicle, parameters=unfitted), speed, np.array([belt_degc]))
    # by path, then by fitted value; what no fit has absorbed under an empty name
    parts: defaultdict[str, defaultdict[str, float]] = defaultdict(lambda: defaultdict(float))
    for name, paths in derivatives.of_track.items():
        owners = {column: owner for owner, columns in fitted_columns[name].items() for column in columns}
        for path, slope in paths.items():
            for column in STEADY_COLUMNS:
                owner = owners.get(column, ("",))
                parts[path]["" if path in owner else owner[0]] += abs(float(slope[column]))
    for path, part in parts.items():
        remainder = part.pop("", 0.0)
        if sum(part.values()) > remainder:
            fits_by_path[path] = max(part, key=part.__getitem__)
    return fits_by_path


def sensitivities(
    derivatives: LogDerivatives, outcomes: Callable[[FileErrors, float], Array], belts_degc: Array
) -> dict[str, Array]:
    """Sensitivity of some outcomes to one standard deviation of each value, by path, shape (outcomes,).

    `outcomes`: of errors, and of a factor on the heat capacity, shape (outcomes,); `belts_degc`: belt temperature of the loss in
    each outcome, shape (outcomes,).
    """
    nominal = outcomes(FileErrors(), 1.0)

    def gradient(errors: FileErrors, capacity: float = 1.0) -> Array:
        return (outcomes(errors, capacity) - nominal) / STEP

    grown = 1.0 + STEP
    changes: dict[str, Array] = {}

    def add(path: str, change: Array) -> None:
        changes[path] = changes.get(path, np.zeros_like(nominal)) + change

    for track, paths in derivatives.of_track.items():
        per_loss, per_film, per_radius = (gradient(FileErrors(track, **{name: grown})) for name in ("loss", "film", "radius"))
        per_capacity = gradient(FileErrors(track), grown)
        for path, track_slopes in paths.items():
            *losses, film, capacity, radius = track_slopes.tolist()
            loss = np.interp(belts_degc, derivatives.belts_degc, losses)
            add(path, per_loss * loss + per_film * film + per_capacity * capacity + per_radius * radius)
    friction, area = derivatives.sizes
    for errors, size, of_chassis in (
        (FileErrors(bearing_friction=STEP * friction), friction, derivatives.bearing_friction),
        (FileErrors(drag_area=STEP * area), area, derivatives.drag_area),
    ):
        change = gradient(errors)
        for path, std in of_chassis.items():
            add(path, change * (std / size))
    return changes


def difference_std(
    vehicles: tuple[Vehicle, Vehicle], changes: tuple[Mapping[str, Array], Mapping[str, Array]]
) -> tuple[Array, Array]:
    """Standard deviations of the second less the first, shape (outcomes,) each: from values that both files have alike, and with
    the ranges of those that differ too.

    An equal value has one error in both files; the narrower of its two ranges holds.
    """
    first, second = changes
    common = separate = np.zeros_like(next(iter(first.values())))
    for path in {**first, **second}:
        quantities = [vehicle.parameters[path] for vehicle in vehicles if path in vehicle.parameters]
        stds = [quantity.standard_deviation for quantity in quantities]
        is_same = len(quantities) == len(vehicles) and quantities[0].value == quantities[1].value
        if is_same and min(stds) == 0.0:
            continue
        if is_same and path in first and path in second:
            common = common + (min(stds) * (second[path] / stds[1] - first[path] / stds[0])) ** 2
        else:
            separate = separate + sum(change[path] ** 2 for change in changes if path in change)
    return np.sqrt(common), np.sqrt(common + separate)
