# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Distributes the load over the road wheels, equation (1), and solves the contact under each, equations (7) to (11).

Balance beams form a tree. A rigid wheel rolls on a Winkler layer.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from trackres_ros.arrays import Array
from trackres_ros.vehicle import Beam, Track

# Load of each wheel


def beam_shares(track: Track, own_weight: bool = False) -> Array:
    """Share of the load that each road wheel carries, shape (wheels,), sum 1.

    Parameters
    ----------
    track
        The assembly's geometry.
    own_weight
        Take the split of the assembly's own weight (alpha_2) at the top beam instead of the axle load's (alpha_1).

    Notes
    -----
    Equation (1) with its stage-1 matrix corrected to [[1-a1, 1-a2], [a1, a2]]: as printed the columns of the second row
    are swapped, and the loads do not sum to the weight. A beam of any depth and road wheels of any number follow alike.
    """
    shares = np.zeros(len(track.road_wheels.positions))

    def hang(end: Beam | int, share: float) -> None:
        if isinstance(end, Beam):
            front_split = end.own_weight_split if own_weight else end.split
            hang(end.front, share * (1.0 - front_split))
            hang(end.rear, share * front_split)
        else:
            shares[end] += share

    hang(track.beams, 1.0)
    return shares


def hinge_position(track: Track, own_weight: bool = False) -> float:
    """Position [m] on the ground run below which the load acts on the top beam: where moments balance."""
    return float(beam_shares(track, own_weight) @ np.array(track.road_wheels.positions))


def wheel_loads(track: Track, load: ArrayLike) -> Array:
    """Load [N] of each road wheel, shape (..., wheels).

    Parameters
    ----------
    load
        Load on the assembly with its own weight [N], any shape.
    """
    total = np.asarray(load, dtype=float)[..., np.newaxis]
    own_weight = np.minimum(track.own_weight, total)
    return np.asarray((total - own_weight) * beam_shares(track) + own_weight * beam_shares(track, own_weight=True))


# Contact

LARGEST_HALF_LENGTH = 0.98  # of the wheel radius; above it the layer would wrap the wheel
NEWTON_PASSES = 20
NEWTON_TOLERANCE = 1e-14  # of the wheel radius
MODULUS_PASSES = 60
MODULUS_TOLERANCE = 1e-10  # relative change of the half length between passes


def indentation(x: ArrayLike, half_length: ArrayLike, radius: float) -> Array:
    """Depth [m] at x [m] from the middle of the contact, 0 outside, equation (8)."""
    x, a = np.broadcast_arrays(np.asarray(x, float), np.asarray(half_length, float))
    inside = np.minimum(np.abs(x), a)
    return np.asarray(np.sqrt(radius**2 - inside**2) - np.sqrt(radius**2 - a**2))


def largest_strain(half_length: ArrayLike, radius: float, thickness: float) -> Array:
    """Compressive strain in the middle of the contact, equation (8) at x = 0."""
    a = np.asarray(half_length, float)
    return np.asarray((radius - np.sqrt(radius**2 - a**2)) / thickness)


def contact_force(half_length: ArrayLike, modulus: ArrayLike, radius: float, length: float, thickness: float) -> Array:
    """Wheel load [N] that a contact of half length a [m] carries, equation (10) in closed form.

    F = (E L / H) [R^2 asin(a/R) - a sqrt(R^2 - a^2)], about 2 E L a^3 / (3 R H) for small a.
    """
    a = np.asarray(half_length, float)
    u = a / radius
    closed_form = np.arcsin(u) - u * np.sqrt(1.0 - u * u)
    series = u**3 * (2.0 / 3.0 + u * u / 5.0)  # the difference above cancels for small u
    return np.asarray(np.asarray(modulus) * length / thickness * radius**2 * np.where(u < 1e-3, series, closed_form))


def half_length_for_force(force: ArrayLike, modulus: ArrayLike, radius: float, length: float, thickness: float) -> Array:
    """Contact half length [m] under a wheel load [N], by Newton's method on the closed form.

    Notes
    -----
    The paper searches a = j R / 1000 until within 1 % of the load, equation (11). As F is proportional to a^3, one step moves F
    by 3/j, so below j = 150 the search can step over the window and not end. Newton on the cube root of F, which is nearly
    linear in a, converges from the small-contact solution in a few passes for any load.
    """
    force, modulus = np.broadcast_arrays(np.asarray(force, float), np.asarray(modulus, float))
    a = _small_half_length(force, modulus, radius, length, thickness)
    for _ in range(NEWTON_PASSES):
        last_a, a = a, _nearer_half_length(a, force, modulus, radius, length, thickness)
        if np.all(np.abs(a - last_a) <= NEWTON_TOLERANCE * radius):
            break
    return np.asarray(a)


def _small_half_length(force: Array, modulus: Array, radius: float, length: float, thickness: float) -> Array:
    """Half length [m] of a small contact, no longer than the largest."""
    return np.minimum(np.cbrt(1.5 * radius * force / (modulus * length / thickness)), LARGEST_HALF_LENGTH * radius)


def _nearer_half_length(a: Array, force: Array, modulus: Array, radius: float, length: float, thickness: float) -> Array:
    """Half length [m] after a step of Newton's method."""
    force_at_a = np.maximum(contact_force(a, modulus, radius, length, thickness), 1e-300)
    slope = modulus * length / thickness * 2.0 * a * a / np.sqrt(radius**2 - a * a)
    root = np.cbrt(force_at_a)
    with np.errstate(invalid="ignore"):
        step = np.where(a > 0, (np.cbrt(force) - root) * 3.0 * root * root / np.maximum(slope, 1e-300), 0.0)
    return np.clip(a + step, 0.0, LARGEST_HALF_LENGTH * radius)


def solve_contact(
    force: ArrayLike, speed: ArrayLike, modulus_at: Callable[[Array], Array], radius: float, length: float, thickness: float
) -> tuple[Array, Array, Array]:
    """Half length [m], frequency [Hz] and modulus [Pa] that fit each other under a wheel load.

    Parameters
    ----------
    force, speed
        Wheel load [N] and speed [m/s], broadcast.
    modulus_at
        abs(E*) [Pa] at frequencies [Hz] of the same shape. The frequency of a passage is v / (2a).

    Notes
    -----
    Each pass takes the modulus at the last half length and one step of Newton's method, so both converge together.
    """
    force, speed = np.broadcast_arrays(np.asarray(force, float), np.abs(np.asarray(speed, float)))
    modulus = modulus_at(np.maximum(speed, 1e-9) / (0.1 * radius))
    a = _small_half_length(force, modulus, radius, length, thickness)
    for _ in range(MODULUS_PASSES):
        modulus = modulus_at(speed / np.maximum(2.0 * a, 1e-12))
        last_a, a = a, _nearer_half_length(a, force, modulus, radius, length, thickness)
        if np.all(np.abs(a - last_a) <= MODULUS_TOLERANCE * a):
            break
    return a, speed / np.maximum(2.0 * a, 1e-12), modulus
