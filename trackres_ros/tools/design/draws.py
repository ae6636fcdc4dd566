# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws the uncertain values of vehicle files from their ranges.

A value that several files have alike is drawn once for all of them; values that differ are drawn apart.
"""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr, ndtri

from trackres_ros.errors import InputError
from trackres_ros.estimator.constants import fits, logarithms_at, slopes
from trackres_ros.tools.design.steady import Array
from trackres_ros.tools.design.values import AIR, LOADS, scalars
from trackres_ros.vehicle import Vehicle, variants
from trackres_ros.vehicle.description import FITTED, Quantity

DRAG, AREA = "chassis.drag_coefficient", "chassis.frontal_area"
CONDITIONS = (AIR, "chassis.max_speed", "chassis.max_acceleration")
STEADY_COLUMNS = 0, 1, 3  # of slopes with one loss: loss, film and radius
INTERVAL = (2.5, 97.5)  # percentiles
MOST_LOST = 0.25  # of the draws: with more of them the ranges do not go together

Values = dict[str, float]
"""Values of a vehicle file by path."""


def absorbing_fits(vehicle: Vehicle, speed: float, belt_degc: float) -> dict[str, str]:
    """Fitted values by the paths of the values whose errors they have absorbed.

    A value is absorbed if the greater part of its effect at a speed [m/s] and belt temperature is on fitted quantities. The heat
    capacity has no part in it: it does not affect a steady state.
    """
    fits_by_path = {AREA: DRAG} if vehicle.parameters[DRAG].flag == FITTED else {}
    fitted_columns = {name: fits(vehicle, name, 1) for name in vehicle.tracks}
    if not any(fitted_columns.values()):
        return fits_by_path
    unfitted = replace(vehicle, parameters={path: replace(quantity, flag="") for path, quantity in vehicle.parameters.items()})

    def logarithms(track: str) -> Callable[[Vehicle], Array]:
        return lambda variant: logarithms_at(variant, track, speed, np.array([belt_degc]), unfitted)

    # by path, then by fitted value; what no fit has absorbed under an empty name
    parts: defaultdict[str, defaultdict[str, float]] = defaultdict(lambda: defaultdict(float))
    for name in vehicle.tracks:
        owners = {column: owner for owner, columns in fitted_columns[name].items() for column in columns}
        for path, slope in slopes(unfitted, name, logarithms(name)).items():
            for column in STEADY_COLUMNS:
                owner = owners.get(column, ("",))
                parts[path]["" if path in owner else owner[0]] += abs(float(slope[column]))
    for path, part in parts.items():
        remainder = part.pop("", 0.0)
        if sum(part.values()) > remainder:
            fits_by_path[path] = max(part, key=part.__getitem__)
    return fits_by_path


def uncertain_values(vehicle: Vehicle, speed: float, belt_degc: float) -> dict[str, Quantity]:
    """Single values of a file that can change alone in their range, by path, but for loads and other conditions.

    Without those whose error a fit has absorbed at a speed [m/s] and belt temperature. A range may have no width.
    """
    make, absorbed = variants(vehicle), absorbing_fits(vehicle, speed, belt_degc)

    def can_change(path: str, quantity: Quantity) -> bool:
        try:
            for end in {quantity.low, quantity.high} - {quantity.value}:
                make({path: end})
        except InputError:  # such as one of the angles that close a loop
            return False
        return True

    paths = [path for path in scalars(vehicle) if path not in (*CONDITIONS, *absorbed) and not path.endswith(LOADS)]
    quantities = {path: vehicle.parameters[path] for path in paths}
    return {path: q for path, q in quantities.items() if can_change(path, q)}


def draws(uncertain: Sequence[Mapping[str, Quantity]], count: int, seed: int) -> list[tuple[Values, ...]]:
    """Values of each vehicle in each draw: normal about the file's value, cut at the ends of its range.

    `uncertain`: of each vehicle, see `uncertain_values`. Equal values of several vehicles are one, in the narrowest of their
    ranges; one without width is known. The order of the vehicles does not matter.

    Notes
    -----
    Each value's own draws fill its distribution evenly: a Latin hypercube.
    """
    columns: dict[tuple[str, object], Quantity] = {}
    for quantities in uncertain:
        for path, quantity in quantities.items():
            columns[path, quantity.value] = min(
                columns.get((path, quantity.value), quantity), quantity, key=lambda each: (each.standard_deviation, each.low)
            )
    random, drawn = np.random.default_rng(seed), dict[tuple[str, object], Array]()
    for key in sorted(columns, key=str):
        if columns[key].standard_deviation > 0.0:
            shares = (random.permutation(count) + random.random(count)) / count
            drawn[key] = _in_range(columns[key], shares)
    return [
        tuple(
            {path: float(drawn[path, q.value][number]) for path, q in quantities.items() if (path, q.value) in drawn}
            for quantities in uncertain
        )
        for number in range(count)
    ]


def _in_range(quantity: Quantity, shares: Array) -> Array:
    """Values of a quantity at shares of its cumulative distribution."""
    value, std = float(np.mean(quantity.value)), quantity.standard_deviation
    low, high = ndtr((quantity.low - value) / std), ndtr((quantity.high - value) / std)
    return np.asarray(np.clip(value + std * ndtri(low + shares * (high - low)), quantity.low, quantity.high))


@dataclass(frozen=True, slots=True)
class Distribution:
    """Outcome of two designs over all draws: 95 % intervals, and the probability that the second has less. None if unknown."""

    one: tuple[float, float] | None
    other: tuple[float, float] | None
    difference: tuple[float, float] | None
    less: float | None


def distribution(one: Array, other: Array) -> Distribution:
    """Sum up one outcome of two designs, each of shape (draws,); nan for an impossible vehicle or no balance.

    Draws that are equal count half for each. Nothing is known if more than `MOST_LOST` of the draws are lost.
    """
    usable = np.isfinite(one) & np.isfinite(other)
    if usable.mean() < 1.0 - MOST_LOST:
        return Distribution(None, None, None, None)
    one, other = one[usable], other[usable]
    ends = [tuple(np.percentile(values, INTERVAL).tolist()) for values in (one, other, other - one)]
    return Distribution(ends[0], ends[1], ends[2], float((other < one).mean() + 0.5 * (other == one).mean()))
