# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Models the belt as a rope and as a body: stiffness (5, 6), cooled area, tension (12 to 18)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from trackres_ros.arrays import Array
from trackres_ros.units import GRAVITY
from trackres_ros.vehicle import Belt, Rubber
from trackres_ros.vehicle.belt_bulk import mass_per_length, wrapped_radius


def cooled_area(belt: Belt) -> float:
    """Area the air cools [m^2]: the exposed share of 2 (W + H) L_R."""
    return belt.exposed_share * 2.0 * (belt.width + belt.thickness) * belt.loop_length


def axial_stiffness(belt: Belt, rubber_modulus: ArrayLike) -> Array:
    """E_S A [N] of cords and rubber in parallel, equation (5). Equation (6) is this over the belt's section.

    Lugs and tread bars are separated by gaps and carry no tension.
    """
    plain = belt.width * belt.thickness - belt.cord_section
    return np.asarray(belt.cord_modulus * belt.cord_section + np.asarray(rubber_modulus) * plain)


def catenary_sag(tension: ArrayLike, mass: float, half_span: float, stiffness: float) -> Array:
    """Sag [m] of an elastic catenary below its ends, equation (14) with its signs restored.

    Parameters
    ----------
    tension
        Horizontal tension F at the lowest point [N].
    mass, half_span, stiffness
        Mass per length q [kg/m], length from the lowest point to the support a_j [m], E_S A [N].

    Notes
    -----
    q g a^2 / (2 EA) + (F / (q g)) [sqrt(1 + (q g a / F)^2) - 1]; the square root is written so that it does not cancel.
    """
    weight = mass * GRAVITY * half_span
    ratio = weight / np.asarray(tension, float)
    return np.asarray(weight * half_span / (2.0 * stiffness) + half_span * ratio / (np.sqrt(1.0 + ratio**2) + 1.0))


def least_tension_for_sag(sag: float, mass: float, half_span: float, stiffness: float) -> float:
    """Least tension [N] at which the belt sags no more than `sag` [m], equation (15) with its sign corrected.

    With D = h_d/2 - q g a^2/(2EA): F = q g (a^2 - D^2)/(2D).

    Raises
    ------
    ValueError
        If the belt stretches further than the sag under its own weight: no tension can hold it.
    """
    depth = sag - mass * GRAVITY * half_span**2 / (2.0 * stiffness)
    if depth <= 0.0:
        raise ValueError(f"a sag of {sag:g} m is less than the belt's own stretch; no tension holds it")
    return mass * GRAVITY * max(half_span**2 - depth**2, 0.0) / (2.0 * depth)


def belt_tension(belt: Belt, rubber: Rubber, rubber_modulus: float) -> float:
    """Steady belt tension [N]: the spring's, or the greater one that limits the sag to half a tooth height.

    A steady tension dissipates nothing, equations (16) to (18): only its range round the loop does.
    """
    stiffness = float(axial_stiffness(belt, rubber_modulus))
    needed = least_tension_for_sag(belt.tooth_height / 2.0, mass_per_length(belt, rubber), belt.sag_half_span, stiffness)
    return max(belt.pretension, needed)


def bending_moment_of_height(belt: Belt, order: int) -> float:
    """Integral of (h - h0)^order over the thickness [m^(order+1)], about the cord as neutral axis (19 to 21)."""
    above, below = belt.thickness - belt.cord_height, belt.cord_height
    return (above ** (order + 1) - (-below) ** (order + 1)) / (order + 1)


def signed_curvature(radius: float, wrap_angle: float, belt: Belt) -> float:
    """Curvature [1/m] of the cord on a wheel, negative where the belt is bent backwards."""
    return math.copysign(1.0 / wrapped_radius(radius, wrap_angle, belt), wrap_angle)
