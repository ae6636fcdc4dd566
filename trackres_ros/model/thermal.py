"""Belt temperature, equations (26), (30) and (31): two networks behind one interface.

`lumped` is the paper's: one mean temperature, C dT/dt = P - U A (T - Ta). `core_surface` has two nodes,
C_c dTc/dt = P - K (Tc - Ts) and C_s dTs/dt = K (Tc - Ts) - h A (Ts - Ta), with K = 6 k A / H, which is the resistance between
the mean and the surface of a slab heated evenly. The Biot number is about 4, so the mean is not what an infrared sensor sees.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from trackres_ros.compiled import compiled
from trackres_ros.model import belt as belt_model
from trackres_ros.vehicle import Belt, Rubber

KMH_PER_MPS = 3.6
SERIES_BELOW = 1e-3


class ThermalNetwork(NamedTuple):
    """Thermal constants of one assembly's belt. With `two_nodes` false the whole capacity is `core_capacity`."""

    two_nodes: bool
    core_capacity: float  # J/K
    surface_capacity: float  # J/K
    inner_conductance: float  # W/K, mean to surface
    area: float  # m^2
    film_offset: float  # W/m^2/K
    film_slope: float  # W/m^2/K per m/s


def thermal_network(model: str, belt: Belt, rubber: Rubber) -> ThermalNetwork:
    """Thermal constants for the model `lumped` or `core_surface`."""
    capacity = belt_model.heat_capacity(belt, rubber)
    area = belt_model.cooled_area(belt)
    two_nodes = model == "core_surface"
    at_surface = belt.surface_share * capacity if two_nodes else 0.0
    slope = belt.film_slope * (KMH_PER_MPS if belt.film_speed_unit == "km/h" else 1.0)
    return ThermalNetwork(
        two_nodes,
        capacity - at_surface,
        at_surface,
        6.0 * rubber.conductivity * area / belt.thickness,
        area,
        belt.film_offset,
        slope,
    )


@compiled
def film_coefficient(speed: float, film_offset: float, film_slope: float) -> float:
    """Film coefficient [W/m^2/K] at a speed [m/s], equation (31)."""
    return film_offset + film_slope * abs(speed)


@compiled
def surface_temperature(mean: float, ambient: float, film: float, area: float, inner_conductance: float) -> float:
    """Surface temperature [degC] that goes with a mean one in the lumped model: the flux through layer and film is one."""
    return (inner_conductance * mean + film * area * ambient) / (inner_conductance + film * area)


@compiled
def phi_1(z: float) -> float:
    """(e^z - 1)/z, the mean of a growing exponential."""
    if abs(z) < SERIES_BELOW:
        return 1.0 + z * (0.5 + z * (1.0 / 6.0 + z * (1.0 / 24.0 + z / 120.0)))
    return math.expm1(z) / z


@compiled
def phi_2(z: float) -> float:
    """((e^z - 1)/z - 1)/z, by which the mean departure over a step follows from the rate at its start."""
    if abs(z) < SERIES_BELOW:
        return 0.5 + z * (1.0 / 6.0 + z * (1.0 / 24.0 + z * (1.0 / 120.0 + z / 720.0)))
    return (math.expm1(z) / z - 1.0) / z


@compiled
def phi_matrix(z11: float, z12: float, z21: float, z22: float, order: int) -> tuple[float, float, float, float]:
    """phi_1 or phi_2 (order 1 or 2) of a 2 x 2 matrix with real eigenvalues, row by row.

    Notes
    -----
    Newton's divided difference on the eigenvalues: phi(Z) = phi(l1) I + phi[l1, l2] (Z - l1 I). The off-diagonal terms of
    the belt's matrix are positive, so its eigenvalues are real and apart.
    """
    middle = 0.5 * (z11 + z22)
    spread = math.sqrt(max(0.25 * (z11 - z22) ** 2 + z12 * z21, 1e-300))
    first, second = middle + spread, middle - spread
    if order == 1:
        at_first, at_second = phi_1(first), phi_1(second)
    else:
        at_first, at_second = phi_2(first), phi_2(second)
    slope = (at_first - at_second) / (first - second)
    return at_first + slope * (z11 - first), slope * z12, slope * z21, at_first + slope * (z22 - first)
