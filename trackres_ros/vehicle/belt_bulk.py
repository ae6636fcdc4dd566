# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Mass and heat capacity of a belt of rubber and cords, equation (26), and its cord on a wheel, equation (20)."""

from __future__ import annotations

from trackres_ros.vehicle.description import Belt, Rubber


def rubber_section(belt: Belt) -> float:
    """Section of rubber [m^2]: the belt without its cords, and the lugs and tread bars standing out of it."""
    return belt.width * belt.thickness - belt.cord_section + belt.lug_section


def mass_per_length(belt: Belt, rubber: Rubber) -> float:
    """Mass per length q [kg/m]; the paper's text calls it a weight."""
    return rubber_section(belt) * rubber.density + belt.cord_section * belt.cord_density


def heat_capacity(belt: Belt, rubber: Rubber) -> float:
    """Heat capacity of the whole loop [J/K], equation (26): L_R (rho A_r c_p + rho_s A_w c_s)."""
    return belt.loop_length * (
        rubber_section(belt) * rubber.density * rubber.heat_capacity
        + belt.cord_section * belt.cord_density * belt.cord_heat_capacity
    )


def wrapped_radius(radius: float, wrap_angle: float, belt: Belt) -> float:
    """Radius [m] of the cord round a wheel: R + h0, equation (20); a wheel on the outer face carries H - h0 below it."""
    return radius + (belt.cord_height if wrap_angle >= 0 else belt.thickness - belt.cord_height)


def arc_length(radius: float, wrap_angle: float, belt: Belt) -> float:
    """Length of cord [m] on a wrapped wheel."""
    return abs(wrap_angle) * wrapped_radius(radius, wrap_angle, belt)
