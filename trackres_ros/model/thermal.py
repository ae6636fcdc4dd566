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
from collections.abc import Sequence
from typing import NamedTuple

from trackres_ros.effects.effect import Active, VehicleConstants, terms_by_parameters
from trackres_ros.effects.stepping import LIMITS
from trackres_ros.kernels.marks import kernel
from trackres_ros.model import belt as belt_model
from trackres_ros.units import KMH_PER_MPS
from trackres_ros.vehicle import Belt, Rubber
from trackres_ros.vehicle.belt_bulk import heat_capacity

SERIES_BELOW = 1e-3
SERIES_TERMS = 15
LEAST_RESISTANCE = 1e-6  # K/W: below it mean and surface of a belt are one


class ThermalNetwork(NamedTuple):
    """Thermal constants of one assembly's belt."""

    two_nodes: bool  # of the file's model; with a resistance of effects the belt has two in any case
    capacity: float  # J/K
    surface_share: float  # of the capacity, in the surface layer
    inner_conductance: float  # W/K, mean to surface
    area: float  # m^2
    film_offset: float  # W/m^2/K
    film_slope: float  # W/m^2/K per m/s
    of_effects: float = 0.0  # K/W, see `parting_resistance`

    @property
    def parting(self) -> float:
        """Resistance between the mean temperature and the last node, which is cooled [K/W]; 0 with one node.

        With two nodes in the file, the rubber's own resistance is between them and an effect's adds to it.
        """
        return self.of_effects + (1.0 / self.inner_conductance if self.two_nodes else 0.0)

    @property
    def conductances(self) -> tuple[float, float]:
        """Conductance between the two nodes of a belt, and from its last node to the skin that a sensor measures [W/K].

        With one node in the file, the rest of the resistance is between the last node and the skin.
        """
        parting = self.parting
        remainder = 1.0 / self.inner_conductance - parting
        inner = 1.0 / parting if parting > 0.0 else self.inner_conductance
        return inner, 1.0 / remainder if remainder > LEAST_RESISTANCE else math.inf

    def share_outside(self, cooling: float) -> float:
        """Share of the steady difference between the mean temperature and the surroundings that lies outside of the last node.

        `cooling`: from the last node to the surroundings [W/K]. Heat arises in all of the rubber, so all of it passes the
        resistance inside: the two are in series.
        """
        return 1.0 / (1.0 + self.parting * cooling)


def thermal_network(model: str, belt: Belt, rubber: Rubber, of_effects: float = 0.0) -> ThermalNetwork:
    """Thermal constants for the model `lumped` or `core_surface`, with the `parting_resistance` of effects [K/W]."""
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
        of_effects,
    )


def parting_resistance(effects: Sequence[Active], facts: VehicleConstants) -> float:
    """Resistance of effects between the mean of a belt and its surface [K/W]. With it the belt has two nodes, whatever the file
    says.

    It depends on the parameters alone. An effect that fails, such as a user's own, adds nothing.
    """
    total = 0.0
    for active in effects:
        try:
            resistance = float(terms_by_parameters((active.effect,), (active.numbers,), facts).inner_resistance)
        except Exception:  # of any kind, as the code is not ours
            continue
        low, high = LIMITS["inner_resistance"]
        total += resistance if low <= resistance <= high else 0.0
    return total if total > LEAST_RESISTANCE else 0.0


@kernel
def film_coefficient(speed: float, film_offset: float, film_slope: float) -> float:
    """Film coefficient [W/m^2/K] at a speed [m/s], equation (31)."""
    return film_offset + film_slope * abs(speed)


@kernel
def surface_temperature(mean: float, ambient: float, film: float, area: float, inner_conductance: float) -> float:
    """Surface temperature [degC] of a mean one in the lumped model: layer and film have the same flux."""
    return (inner_conductance * mean + film * area * ambient) / (inner_conductance + film * area)


@kernel
def phi_1(z: float) -> float:
    """(e^z - 1)/z, the mean of a growing exponential."""
    if abs(z) < SERIES_BELOW:
        return 1.0 + z * (0.5 + z * (1.0 / 6.0 + z * (1.0 / 24.0 + z / 120.0)))
    return math.expm1(z) / z


@kernel
def phi_2(z: float) -> float:
    """((e^z - 1)/z - 1)/z, by which the mean departure over a step follows from the rate at its start."""
    if abs(z) < SERIES_BELOW:
        return 0.5 + z * (1.0 / 6.0 + z * (1.0 / 24.0 + z * (1.0 / 120.0 + z / 720.0)))
    return (math.expm1(z) / z - 1.0) / z


@kernel
def phi_series(z11: float, z12: float, z21: float, z22: float, order: float) -> tuple[float, float, float, float]:
    """The same by its series, for a matrix with no term much above 1."""
    s11, s12, s21, s22 = 1.0, 0.0, 0.0, 1.0
    for n in range(SERIES_TERMS, 0, -1):
        factor = 1.0 / (n + order)
        s11, s12, s21, s22 = (
            1.0 + factor * (z11 * s11 + z12 * s21),
            factor * (z11 * s12 + z12 * s22),
            factor * (z21 * s11 + z22 * s21),
            1.0 + factor * (z21 * s12 + z22 * s22),
        )
    scale = 1.0 if order == 1.0 else 0.5
    return scale * s11, scale * s12, scale * s21, scale * s22


@kernel
def phi_matrix(z11: float, z12: float, z21: float, z22: float, order: float) -> tuple[float, float, float, float]:
    """phi_1 or phi_2 (order 1.0 or 2.0: as integers, each would be compiled by itself) of a 2 x 2 matrix, row by row.

    Notes
    -----
    Newton's divided difference on the eigenvalues: phi(Z) = phi(l1) I + phi[l1, l2] (Z - l1 I). At rest those of a belt are
    real and distinct. If a steep fall of the loss with temperature makes them complex or equal, the step is short: the series
    is used.
    """
    centre = 0.5 * (z11 + z22)
    half = 0.5 * (z11 - z22)
    squared = half * half + z12 * z21
    size = abs(z11) + abs(z12) + abs(z21) + abs(z22)
    close, least_spread = SERIES_BELOW * size, 1e-5 * size
    if size < 2.0 and squared <= close * close:
        return phi_series(z11, z12, z21, z22, order)
    spread = math.sqrt(max(squared, least_spread * least_spread))
    root_1, root_2 = centre + spread, centre - spread
    if order == 1.0:
        phi_at_1, phi_at_2 = phi_1(root_1), phi_1(root_2)
    else:
        phi_at_1, phi_at_2 = phi_2(root_1), phi_2(root_2)
    slope = (phi_at_1 - phi_at_2) / (root_1 - root_2)
    return phi_at_1 + slope * (z11 - root_1), slope * z12, slope * z21, phi_at_1 + slope * (z22 - root_1)
