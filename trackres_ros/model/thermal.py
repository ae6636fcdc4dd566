# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Models the belt temperature, equations (26), (30) and (31): two networks with one interface.

`lumped` is the paper's: one mean temperature T, C dT/dt = P - U A (T - Ta). `core_surface` has a core and a surface layer
with the share x of the heat capacity; the rubber of both generates heat. The loss of the whole belt is that at the mean
temperature, so it is C dT/dt = P - h A (Ts - Ta) and x C dTs/dt = x P + (1 - x) K (T - Ts) - h A (Ts - Ta). The conductance
K = 6 k A / H is that between the mean and the surface of an evenly heated slab: in steady state the belt is that
slab, whatever x. The Biot number is about 4, so an infrared sensor does not measure the mean.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from trackres_ros.jit.compiled import compiled, inlined
from trackres_ros.model import belt as belt_model
from trackres_ros.units import KMH_PER_MPS
from trackres_ros.vehicle import Belt, Rubber
from trackres_ros.vehicle.belt_bulk import heat_capacity

SERIES_BELOW = 1e-3
SERIES_TERMS = 15


class ThermalNetwork(NamedTuple):
    """Thermal constants of one assembly's belt."""

    two_nodes: bool
    capacity: float  # J/K
    surface_share: float  # of the capacity, in the surface layer
    inner_conductance: float  # W/K, mean to surface
    area: float  # m^2
    film_offset: float  # W/m^2/K
    film_slope: float  # W/m^2/K per m/s


def thermal_network(model: str, belt: Belt, rubber: Rubber) -> ThermalNetwork:
    """Thermal constants for the model `lumped` or `core_surface`."""
    capacity = heat_capacity(belt, rubber)
    area = belt_model.cooled_area(belt)
    slope = belt.film_slope * (KMH_PER_MPS if belt.film_speed_unit == "km/h" else 1.0)
    return ThermalNetwork(
        model == "core_surface",
        capacity,
        belt.surface_share,
        6.0 * rubber.conductivity * area / belt.thickness,
        area,
        belt.film_offset,
        slope,
    )


@inlined
def film_coefficient(speed: float, film_offset: float, film_slope: float) -> float:
    """Film coefficient [W/m^2/K] at a speed [m/s], equation (31)."""
    return film_offset + film_slope * abs(speed)


@inlined
def surface_temperature(mean: float, ambient: float, film: float, area: float, inner_conductance: float) -> float:
    """Surface temperature [degC] of a mean one in the lumped model: layer and film have the same flux."""
    return (inner_conductance * mean + film * area * ambient) / (inner_conductance + film * area)


@inlined
def phi_1(z: float) -> float:
    """(e^z - 1)/z, the mean of a growing exponential."""
    if abs(z) < SERIES_BELOW:
        return 1.0 + z * (0.5 + z * (1.0 / 6.0 + z * (1.0 / 24.0 + z / 120.0)))
    return math.expm1(z) / z


@inlined
def phi_2(z: float) -> float:
    """((e^z - 1)/z - 1)/z, by which the mean departure over a step follows from the rate at its start."""
    if abs(z) < SERIES_BELOW:
        return 0.5 + z * (1.0 / 6.0 + z * (1.0 / 24.0 + z * (1.0 / 120.0 + z / 720.0)))
    return (math.expm1(z) / z - 1.0) / z


@compiled
def phi_series(z11: float, z12: float, z21: float, z22: float, order: float) -> tuple[float, float, float, float]:
    """The same by its series, for a matrix with no term much above 1."""
    s11, s12, s21, s22 = 1.0, 0.0, 0.0, 1.0
    for n in range(SERIES_TERMS, 0, -1):
        by = 1.0 / (n + order)
        s11, s12, s21, s22 = (
            1.0 + by * (z11 * s11 + z12 * s21),
            by * (z11 * s12 + z12 * s22),
            by * (z21 * s11 + z22 * s21),
            1.0 + by * (z21 * s12 + z22 * s22),
        )
    whole = 1.0 if order == 1.0 else 0.5
    return whole * s11, whole * s12, whole * s21, whole * s22


@compiled
def phi_matrix(z11: float, z12: float, z21: float, z22: float, order: float) -> tuple[float, float, float, float]:
    """phi_1 or phi_2 (order 1.0 or 2.0: as integers, each would be compiled by itself) of a 2 x 2 matrix, row by row.

    Notes
    -----
    Newton's divided difference on the eigenvalues: phi(Z) = phi(l1) I + phi[l1, l2] (Z - l1 I). At rest those of a belt are
    real and distinct. If a steep fall of the loss with temperature makes them complex or equal, the step is short: the series
    is used.
    """
    middle = 0.5 * (z11 + z22)
    half = 0.5 * (z11 - z22)
    squared = half * half + z12 * z21
    size = abs(z11) + abs(z12) + abs(z21) + abs(z22)
    close, least = SERIES_BELOW * size, 1e-5 * size
    if size < 2.0 and squared <= close * close:
        return phi_series(z11, z12, z21, z22, order)
    spread = math.sqrt(max(squared, least * least))
    first, second = middle + spread, middle - spread
    if order == 1.0:
        at_first, at_second = phi_1(first), phi_1(second)
    else:
        at_first, at_second = phi_2(first), phi_2(second)
    slope = (at_first - at_second) / (first - second)
    return at_first + slope * (z11 - first), slope * z12, slope * z21, at_first + slope * (z22 - first)
