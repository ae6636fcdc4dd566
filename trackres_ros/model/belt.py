# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Models the belt as a rope and as a body: stiffness (5, 6), cooled area, tension (12 to 18), strain round the loop (Figure 10).

The strain of a piece of belt on one way round the loop has two components: through the thickness (indentation under the road
wheels) and along the belt (bending, tension, drive). The loop starts at the front end of the ground run and runs to its rear end,
then over the wrapped wheels in the order of the vehicle file. Every profile is periodic by construction, and continuous: a jump
would make the sum over harmonics diverge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trackres_ros.arrays import Array
from trackres_ros.model import contact
from trackres_ros.units import GRAVITY
from trackres_ros.vehicle import Belt, Rubber, Track
from trackres_ros.vehicle.belt_bulk import arc_length, mass_per_length, wrapped_radius

# Stiffness and tension


def cooled_area(belt: Belt) -> float:
    """Area the air cools [m^2]: the exposed share of 2 (W + H) L_R."""
    return belt.exposed_share * 2.0 * (belt.width + belt.thickness) * belt.loop_length


def axial_stiffness(belt: Belt, rubber_modulus: ArrayLike) -> Array:
    """E_S A [N] of cords and rubber in parallel, equation (5). Equation (6) is this over the belt's section.

    Lugs and tread bars are separated by gaps and carry no tension.
    """
    rubber_area = belt.width * belt.thickness - belt.cord_section
    return np.asarray(belt.cord_modulus * belt.cord_section + np.asarray(rubber_modulus) * rubber_area)


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
    least_tension = least_tension_for_sag(belt.tooth_height / 2.0, mass_per_length(belt, rubber), belt.sag_half_span, stiffness)
    return max(belt.pretension, least_tension)


def bending_moment_of_height(belt: Belt, order: int) -> float:
    """Integral of (h - h0)^order over the thickness [m^(order+1)], about the cord as neutral axis (19 to 21)."""
    top, depth = belt.thickness - belt.cord_height, belt.cord_height
    return (top ** (order + 1) - (-depth) ** (order + 1)) / (order + 1)


def signed_curvature(radius: float, wrap_angle: float, belt: Belt) -> float:
    """Curvature [1/m] of the cord on a wheel, negative where the belt is bent backwards."""
    return math.copysign(1.0 / wrapped_radius(radius, wrap_angle, belt), wrap_angle)


# Strain round the loop

Complex = NDArray[np.complex128]

SERIES_BELOW = 0.3  # the closed transforms of a pulse cancel below it
ANGLES = 64  # multiples of an angle with a sine and cosine of their own; those of the other harmonics are sums of these


@dataclass(frozen=True)
class Profile:
    """A periodic, piecewise linear function of position: values [unit] at rising vertices [m] within one loop."""

    position: Array
    value: Array
    length: float

    def values_at(self, position: ArrayLike) -> Array:
        """Values at positions [m], any shape."""
        return np.asarray(np.interp(np.asarray(position, float), self.position, self.value, period=self.length))

    def amplitudes(self, harmonics: Array) -> Complex:
        """Complex amplitudes A_n of cos(2 pi n s / L + phase), shape (harmonics,): from the jumps of slope, exact."""
        s, y = self.position, self.value
        rise = np.diff(np.append(y, y[0])) / np.diff(np.append(s, s[0] + self.length))
        jumps = rise - np.roll(rise, 1)
        q = 2.0 * np.pi * harmonics / self.length
        return np.asarray(-2.0 / (self.length * q**2) * (jumps @ phases(s, self.length, harmonics)))


@dataclass(frozen=True)
class Loop:
    """Positions on the loop of one track assembly."""

    track: Track
    wheel_positions: Array  # road wheels [m]
    arcs: tuple[tuple[float, float, float], ...]  # start, end [m] and curvature [1/m] of each wrapped wheel
    curvature: Profile  # [1/m]
    drive: Profile  # tension [N] for 1 N of drive force at the sprocket

    @property
    def length(self) -> float:
        """Loop length [m]."""
        return self.track.belt.loop_length


def build_loop(track: Track) -> Loop:
    """Lay out the loop: the ground run, at once the first wrapped wheel, the free length shared evenly between the wheels."""
    belt, wheels = track.belt, track.wrapped_wheels
    lengths = [arc_length(w.radius, w.wrap_angle, belt) for w in wheels]
    free_length = belt.loop_length - track.road_wheels.ground_run - sum(lengths)
    gap = free_length / max(len(wheels) - 1, 1)
    arcs = []
    start = track.road_wheels.ground_run
    for wheel, length in zip(wheels, lengths, strict=True):
        arcs.append((start, start + length, signed_curvature(wheel.radius, wheel.wrap_angle, belt)))
        start += length + gap
    sprocket = next(i for i, w in enumerate(wheels) if w.kind == "sprocket")
    return Loop(
        track,
        np.array(track.road_wheels.positions),
        tuple(arcs),
        _curvature(arcs, belt.curvature_length, belt.loop_length),
        _drive(arcs[sprocket], track.road_wheels.ground_run, belt.loop_length),
    )


def _curvature(arcs: list[tuple[float, float, float]], ramp: float, length: float) -> Profile:
    """Sum of trapezoids: each wheel's curvature over its arc, taken up and given back over `ramp`; each keeps its angle."""
    corners: list[float] = []
    for start, end, _ in arcs:
        corners += [start - ramp / 2, start + ramp / 2, end - ramp / 2, end + ramp / 2]
    position = np.unique(np.mod(np.round(corners, 12), length))
    value = np.zeros_like(position)
    for start, end, curvature in arcs:
        plateau = curvature * min(1.0, (end - start) / ramp)
        half, half_plateau = (end - start + ramp) / 2, abs(end - start - ramp) / 2
        distance = np.abs(np.mod(position - (start + end) / 2 + length / 2, length) - length / 2)
        value += plateau * np.clip((half - distance) / (half - half_plateau), 0.0, 1.0)
    return Profile(position, value, length)


def _drive(sprocket: tuple[float, float, float], ground_run: float, length: float) -> Profile:
    """Tension by the drive, equations (22) and (23): grows along the ground run, is handed to the teeth over the wrap.

    Equation (23) as printed sums F_D-i over k; it means F_D-k. The teeth's steps are spread evenly over the wrap.
    """
    start, end, _ = sprocket
    centre, half = (start + end) / 2, (end - start) / 2
    corners = np.mod(
        np.round([0.0, ground_run, centre - half, centre + half], 12), length
    )  # a last wheel ends where the loop begins
    position, index = np.unique(corners, return_index=True)
    return Profile(position, np.array([0.0, 1.0, 1.0, 0.0])[index], length)


def phases(position: Array, length: float, harmonics: Array) -> Complex:
    """Factors exp(-2 pi i n s / L) of positions s [m] and numbers n of harmonics, shape (positions, harmonics)."""
    sine, cosine = _multiples(2.0 * np.pi / length * position[:, np.newaxis], harmonics)
    return cosine - 1j * sine


def indentation_amplitudes(
    half_length: ArrayLike, radius: float, thickness: float, loop_length: float, harmonics: Array
) -> Array:
    """Real amplitudes A_n of the strain pulse of one contact centred at position 0, shape (..., harmonics), of numbers n.

    The arc of the wheel is taken to fourth order in x/R, (a^2-x^2)/(2R) + (a^4-x^4)/(8R^3), whose transform is closed,
    and scaled to the exact depth.
    """
    a = np.asarray(half_length, float)[..., np.newaxis]
    angle = 2.0 * np.pi / loop_length * a
    parabola, quartic = pulse_transforms(angle * harmonics, *_multiples(angle, harmonics))
    depth = a**2 / (2 * radius) + a**4 / (8 * radius**3)
    exact_depth = radius - np.sqrt(radius**2 - a**2)
    scale = 2.0 / (loop_length * thickness) * exact_depth / depth
    return np.asarray(scale * a**3 / (2 * radius) * parabola + scale * a**5 / (8 * radius**3) * quartic)


def _multiples(angle: Array, harmonics: Array) -> tuple[Array, Array]:
    """Sine and cosine of multiples of an angle, of shape (..., 1); of all from 1 on by the addition theorem from a few."""
    count = len(harmonics)
    if count < harmonics[-1]:
        return np.sin(angle * harmonics), np.cos(angle * harmonics)
    base_angles = angle * np.arange(1, ANGLES + 1)
    offset_angles = (angle * np.arange(0, count, ANGLES))[..., np.newaxis]
    sine, cosine = np.sin(base_angles)[..., np.newaxis, :], np.cos(base_angles)[..., np.newaxis, :]
    sines, cosines = np.sin(offset_angles), np.cos(offset_angles)
    shape = (*angle.shape[:-1], -1)
    return (
        (sines * cosine + cosines * sine).reshape(shape)[..., :count],
        (cosines * cosine - sines * sine).reshape(shape)[..., :count],
    )


def pulse_transforms(z: Array, sine: Array, cosine: Array) -> tuple[Array, Array]:
    """Integrals of (1 - u^2) cos(z u) and (1 - u^4) cos(z u) over -1..1, same shape as z > 0, its sine and its cosine."""
    inverse = 1.0 / z
    square = inverse * inverse
    mean = sine * inverse  # of cos(z u)
    parabola = 4.0 * square * (mean - cosine)
    quartic = 8.0 * square * (3.0 * mean - 1.5 * parabola - cosine)
    is_small = z < SERIES_BELOW
    if is_small.any():
        w = z[is_small] ** 2
        parabola[is_small] = 4.0 / 3.0 * (1.0 - w / 10.0 + w**2 / 280.0 - w**3 / 15120.0)
        quartic[is_small] = 8.0 / 5.0 * (1.0 - 5.0 * w / 42.0 + w**2 / 216.0 - w**3 / 11088.0)
    return parabola, quartic


def through_thickness(loop: Loop, half_lengths: ArrayLike, position: ArrayLike) -> Array:
    """Compressive strain [1] by the road wheels at positions [m], equation (8); `half_lengths` is of shape (wheels,)."""
    wheels = loop.track.road_wheels
    s = np.asarray(position, float)[..., np.newaxis]
    offset = np.mod(s - loop.wheel_positions + loop.length / 2, loop.length) - loop.length / 2
    depth = contact.indentation(offset, np.asarray(half_lengths, float), wheels.radius)
    return np.asarray(depth.sum(axis=-1) / loop.track.belt.thickness)


def along_belt(loop: Loop, height: ArrayLike, position: ArrayLike, steady_strain: float, drive_strain: float) -> Array:
    """Strain [1] along the belt at heights [m] and positions [m], broadcast: bending (20), tension (17) and drive (23).

    Parameters
    ----------
    steady_strain
        Strain of the steady tension, F/(E_S A).
    drive_strain
        Strain of the whole drive force, M_D/(R_D E_S A); negative when braking.
    """
    bending = (np.asarray(height, float) - loop.track.belt.cord_height) * loop.curvature.values_at(position)
    return np.asarray(bending + steady_strain + drive_strain * loop.drive.values_at(position))
