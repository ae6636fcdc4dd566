# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes torque at the sprockets from loss and all other resistances, equations (32) to (36), part by part.

Forces [N] along the travel; a torque is a force times the sprocket pitch radius R1. Positive resists forward travel.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from trackres_ros.arrays import Array
from trackres_ros.kernels.marks import kernel
from trackres_ros.units import GRAVITY, STANDSTILL_MPS

TorqueTerm = Literal["hysteresis", "bearing", "wind", "grade", "inertia"]
TORQUE_TERMS: tuple[TorqueTerm, ...] = get_args(TorqueTerm)
"""Terms of the driving torque by equation, in their order everywhere."""
TORQUE_COLUMNS = {term: f"{term}_nm" for term in (*TORQUE_TERMS, "effects")}
"""The same and the effects, with their columns in the results."""
RESISTANCE_PARTS = {term: column for term, column in TORQUE_COLUMNS.items() if term not in ("grade", "inertia")}
"""Parts of the resistance, and their columns in the results."""
ON_WHEELS = {{"bearing": "rolling"}.get(part, part): column for part, column in RESISTANCE_PARTS.items() if part != "hysteresis"}
"""The same for a vehicle without belts: its rolling resistance is that of tyres and bearings together."""


def resistance_parts(has_belts: bool) -> dict[str, str]:
    """Parts of the resistance of a vehicle with or without belts, and their columns."""
    return RESISTANCE_PARTS if has_belts else ON_WHEELS


def force_along(torque: ArrayLike, of_assemblies: Iterable[ArrayLike], radii: Sequence[float]) -> Array:
    """Force along the way that has the power of all [N].

    Parameters
    ----------
    torque, of_assemblies
        Of the whole vehicle, and of each assembly, shape (times,) or numbers [Nm].
    radii
        Of the assemblies' sprockets [m].
    """
    if len(set(radii)) == 1:
        return np.asarray(torque) / radii[0]
    return np.asarray(sum(np.asarray(part) / radius for part, radius in zip(of_assemblies, radii, strict=True)))


@kernel
def direction(speed: float) -> float:
    """Sign of the speed [m/s], smooth through zero."""
    return math.tanh(speed / STANDSTILL_MPS)


@kernel
def bearing_force(speed: float, weight: float, bearing_friction: float) -> float:
    """Bearing friction [N]. Equation (34) as printed divides by R1 and has the unit N/m; M = f G R1."""
    return bearing_friction * weight * direction(speed)


@kernel
def wind_force(speed: float, drag_area: float, air_density: float) -> float:
    """Drag [N] of C_d A [m^2]. The 76140 of equation (35) belongs to a power; M = 1/2 rho C_d A v abs(v) R1."""
    return 0.5 * air_density * drag_area * speed * abs(speed)


@kernel
def inertia_force(acceleration: float, weight: float, rotating_mass_factor: float) -> float:
    """Force to accelerate [N]. Equation (36) as printed lacks g and divides by R1; M = delta (G/g) a R1."""
    return rotating_mass_factor * weight / GRAVITY * acceleration


@kernel
def grade_force(grade: float, weight: float) -> float:
    """Force up a grade [N]; `grade` is rise over run, positive uphill in the direction the vehicle points."""
    return weight * grade / math.sqrt(1.0 + grade * grade)
