# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes heat per metre of travel from the strain history, equations (27) to (29): two methods behind one interface.

One counts cycles after ASTM E1049-85, 5.4.4, and fills the strain rainflow matrix of equation (25).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from trackres_ros.arrays import Array
from trackres_ros.model import belt as belt_model
from trackres_ros.model import contact
from trackres_ros.model.belt import Complex, Loop, along_belt, build_loop, indentation_amplitudes, phases
from trackres_ros.model.contact import beam_shares, wheel_loads
from trackres_ros.model.rubber import RubberModel, cubic_weights
from trackres_ros.vehicle import Track

# Rainflow count


class Cycle(NamedTuple):
    """One row of the matrix: range (not amplitude), mean, number (1 or 1/2), and position in the series."""

    range: float
    mean: float
    number: float
    start: int
    end: int


def turning_points(series: Sequence[float]) -> list[int]:
    """Indices of the reversals of a series, its ends included. A flat stretch is represented by its first sample."""
    points = [0] if len(series) else []
    for i in range(1, len(series)):
        step = series[i] - series[points[-1]]
        if step == 0.0:
            continue
        if len(points) > 1 and step * (series[points[-1]] - series[points[-2]]) > 0.0:
            points[-1] = i
        else:
            points.append(i)
    return points


def count_cycles(series: Sequence[float]) -> list[Cycle]:
    """Count the cycles of a series of strains; the residue at the end gives half cycles.

    Parameters
    ----------
    series
        Strains [1] in order, at least the turning points.

    References
    ----------
    ASTM E1049-85 (2017), Standard Practices for Cycle Counting in Fatigue Analysis, 5.4.4.
    """
    cycles: list[Cycle] = []

    def add_cycle(start: int, end: int, count: float) -> None:
        a, b = series[start], series[end]
        cycles.append(Cycle(abs(b - a), (a + b) / 2.0, count, start, end))

    stack: list[int] = []
    for point in turning_points(series):
        stack.append(point)
        while len(stack) >= 3:
            newest_range = abs(series[stack[-1]] - series[stack[-2]])
            previous = abs(series[stack[-2]] - series[stack[-3]])
            if newest_range < previous:
                break
            if len(stack) == 3:  # the range holds the start of the series: half a cycle
                add_cycle(stack[0], stack[1], 0.5)
                stack.pop(0)
            else:
                add_cycle(stack[-3], stack[-2], 1.0)
                del stack[-3:-1]
    for start, end in pairwise(stack):
        add_cycle(start, end, 0.5)
    return cycles


def count_loop(series: Sequence[float]) -> list[Cycle]:
    """Count the cycles of one loop of a periodic series: begun at its maximum, every cycle closes.

    The cycles' indices refer to `series`; the first sample follows again after the last.
    """
    if len(series) < 2:
        return []
    top = max(range(len(series)), key=lambda i: series[i])
    order = [(top + i) % len(series) for i in range(len(series))] + [top]
    return [cycle._replace(start=order[cycle.start], end=order[cycle.end]) for cycle in count_cycles([series[i] for i in order])]


# Methods

HARMONICS = 4096  # doubling them moves the loss by less than 0.1 % (test_hysteresis.py)
VALUES_AT_ONCE = 1 << 14  # points times harmonics of a vectorised evaluation, so that its arrays stay in the processor's cache
BACK_AT_BASE = 0.1  # of a cycle's range: this near to its lesser extreme a passage is over
SLOWEST_SPEED = 1e-9  # m/s; the loss per metre of travel tends to a limit at rest


class LossForce(NamedTuple):
    """Loss per metre of belt travel [N] of one assembly, by cause; `drive` holds its coupling to bending."""

    indentation: Array
    bending: Array
    tension: Array
    drive: Array

    @property
    def total(self) -> Array:
        """Sum of all causes [N]."""
        return np.asarray(self.indentation + self.bending + self.tension + self.drive)


@dataclass(frozen=True, eq=False)
class LossByTorque:
    """Loss at some speeds, belt temperatures and loads as a function of the torque on the sprocket, which alone may then change.

    Indentation and bending [N] do not depend on it; `drive` [N] takes the torque [Nm], broadcast with them.
    """

    indentation: Array
    bending: Array
    drive: Callable[[ArrayLike], Array]

    def loss_at(self, drive_torque: ArrayLike) -> LossForce:
        """Loss per metre of travel [N] at a torque [Nm]."""
        drive = self.drive(drive_torque)
        indentation, bending = (np.broadcast_to(part, drive.shape) for part in (self.indentation, self.bending))
        return LossForce(indentation, bending, np.zeros_like(bending), drive)


class Contact(NamedTuple):
    """Contact under each road wheel, arrays of shape (..., wheels)."""

    half_length: Array
    largest_strain: Array
    frequency: Array
    modulus: Array


class PassageCycle(NamedTuple):
    """A counted cycle and the length of belt [m] strained by one passage of its cause."""

    cycle: Cycle
    passage: float


class LossMethod(ABC):
    """Turns the strain history of one assembly into loss per metre of travel."""

    name: str

    def __init__(self, track: Track, rubber: RubberModel) -> None:
        self.track = track
        self.rubber = rubber
        self.loop: Loop = build_loop(track)
        # road wheels under the same load have the same contact: the first of each kind, and the kind of each wheel
        shares = np.stack([beam_shares(track), beam_shares(track, own_weight=True)]).round(12)
        index, kind = np.unique(shares, axis=1, return_index=True, return_inverse=True)[1:]
        self._first, self._kind = index, np.ravel(kind)

    def contacts(self, speed: ArrayLike, belt_degc: ArrayLike, load: ArrayLike) -> Contact:
        """Contact under each road wheel at speeds [m/s], temperatures [degC] and assembly loads [N], broadcast."""
        wheels, thickness = self.track.road_wheels, self.track.belt.thickness
        loads = wheel_loads(self.track, load)[..., self._first]
        v, t = np.broadcast_arrays(*(np.asarray(x, float)[..., np.newaxis] for x in (speed, belt_degc)))
        shape = np.broadcast_shapes(loads.shape, v.shape)
        v = np.maximum(np.abs(np.broadcast_to(v, shape)), SLOWEST_SPEED)
        half, frequency, modulus = contact.solve_contact(
            np.broadcast_to(loads, shape),
            v,
            lambda f: self.rubber.dynamic_modulus(f, np.broadcast_to(t, shape)),
            wheels.radius,
            wheels.contact_length,
            thickness,
        )
        of_kinds = Contact(half, contact.largest_strain(half, wheels.radius, thickness), frequency, modulus)
        return Contact(*(part[..., self._kind] for part in of_kinds))

    def drive_strain(self, speed: ArrayLike, belt_degc: ArrayLike, drive_torque: ArrayLike) -> Array:
        """Strain of the whole drive force, M_D/(R_D E_S A), equation (23)."""
        frequency = np.maximum(np.abs(np.asarray(speed, float)), SLOWEST_SPEED) / self.loop.length
        stiffness = belt_model.axial_stiffness(self.track.belt, self.rubber.dynamic_modulus(frequency, belt_degc))
        return np.asarray(np.asarray(drive_torque, float) / (self.track.sprocket_radius * stiffness))

    def loss_force(self, speed: ArrayLike, belt_degc: ArrayLike, load: ArrayLike, drive_torque: ArrayLike = 0.0) -> LossForce:
        """Loss per metre of travel [N].

        Parameters
        ----------
        speed, belt_degc, load, drive_torque
            Speed [m/s], belt temperature [degC], load on the assembly with its own weight [N] and torque on its sprocket
            [Nm]; arrays broadcast. The sign of the speed does not matter: reverse mirrors forward.
        """
        return self.by_torque(speed, belt_degc, load).loss_at(drive_torque)

    def by_torque(self, speed: ArrayLike, belt_degc: ArrayLike, load: ArrayLike) -> LossByTorque:
        """Loss as a function of the torque on the sprocket; see `loss_force`."""
        v, t, g = np.broadcast_arrays(*(np.asarray(x, float) for x in (speed, belt_degc, load)))
        v = np.maximum(np.abs(v), SLOWEST_SPEED)
        indentation, bending, by_strain = self._by_strain(v, t, self.contacts(v, t, g).half_length)
        strain_per_torque = self.drive_strain(v, t, 1.0)
        return LossByTorque(indentation, bending, lambda torque: by_strain(np.asarray(torque, float) * strain_per_torque))

    @abstractmethod
    def _by_strain(self, speed: Array, belt_degc: Array, half_length: Array) -> tuple[Array, Array, Callable[[Array], Array]]:
        """Indentation and bending [N], and what the strain of the whole drive force adds [N], as a function of it, broadcast.

        Speeds and temperatures are of one shape, half lengths [m] of (..., wheels).
        """


class Spectral(LossMethod):
    """Exact for linear viscoelasticity: every harmonic of the periodic strain loses pi n A_n^2 E''(n v/L_R) a loop."""

    name = "spectral"

    def __init__(self, track: Track, rubber: RubberModel, harmonics: int = HARMONICS, nodes: Array | None = None) -> None:
        """`nodes`: numbers of the harmonics that are evaluated, by default all; pulse and modulus at others are interpolated."""
        super().__init__(track, rubber)
        orders = np.arange(1, harmonics + 1, dtype=float)
        self.harmonics = orders if nodes is None else nodes
        curvature, drive = self.loop.curvature.amplitudes(orders), self.loop.drive.amplitudes(orders)
        of_wheels = phases(self.loop.wheel_positions, self.loop.length, orders)
        pulses = [of_wheels[self._kind == kind].sum(axis=0) for kind in range(len(self._first))]
        spread = None if nodes is None else cubic_weights(nodes, orders)

        def weights(left_amplitudes: Complex, right_amplitudes: Complex) -> Array:
            products = np.pi * orders * np.real(np.conj(left_amplitudes) * right_amplitudes)
            return products if spread is None else products @ spread

        self._bending, self._drive = weights(curvature, curvature), weights(drive, drive)
        self._coupling = 2.0 * weights(curvature, drive)
        kinds = range(len(pulses))
        self._pulses = [(i, j, (1.0 + (i < j)) * weights(pulses[i], pulses[j])) for i in kinds for j in kinds if i <= j]

    def _by_strain(self, speed: Array, belt_degc: Array, half_length: Array) -> tuple[Array, Array, Callable[[Array], Array]]:
        v, t, half = speed.ravel(), belt_degc.ravel(), half_length.reshape(-1, half_length.shape[-1])[:, self._first]
        parts = np.empty((4, v.size))
        at_once = max(1, VALUES_AT_ONCE // len(self.harmonics))
        for start in range(0, v.size, at_once):
            block = slice(start, start + at_once)
            parts[:, block] = self._parts(v[block], t[block], half[block])
        indentation, bending, coupling, drive_part = parts.reshape(4, *speed.shape)
        return indentation, bending, lambda strain: strain * (coupling + strain * drive_part)

    def _parts(self, speed: Array, belt_degc: Array, half_length: Array) -> tuple[Array, ...]:
        """Indentation and bending [N]; the drive's loss by its strain (coupled to bending) and by its square; shape (points,)."""
        belt, wheels = self.track.belt, self.track.road_wheels
        states, index = np.unique(speed + 1j * belt_degc, return_inverse=True)  # those of many loads are alike
        frequency = states.real[:, np.newaxis] * self.harmonics / self.loop.length
        loss = self.rubber.loss_modulus(frequency, states.imag[:, np.newaxis])[index]
        pulses = [
            indentation_amplitudes(half, wheels.radius, belt.thickness, self.loop.length, self.harmonics)
            for half in half_length.T
        ]
        section = wheels.contact_length * belt.thickness * self.rubber.rubber.layer_stiffening
        power = [(pulses[i] * pulses[j] * loss) @ weights for i, j, weights in self._pulses]
        area, moment_1, moment_2 = (belt.width * belt_model.bending_moment_of_height(belt, order) for order in range(3))
        bending, coupling, drive_part = (
            moment_2 * (loss @ self._bending),
            moment_1 * (loss @ self._coupling),
            area * (loss @ self._drive),
        )
        return section * np.sum(power, axis=0), bending, coupling, drive_part


class RainflowCount(LossMethod):
    """The paper's: each counted cycle loses pi N E''(f_k, T) (range/2)^2, equation (29) corrected.

    Equation (29) as printed squares the range instead of the amplitude, and leaves the integral over the section out.
    The paper leaves a cycle's frequency open. Here a cycle lasts as long as the strain is away from the cycle's lesser
    extreme: the contact, so f = v/(2a), or the wrap of a wheel.
    Low by 16/pi^2 on an isolated parabolic pulse and by about 3 on a bending plateau, because one cycle stands for all
    the harmonics of the pulse.
    """

    name = "rainflow"

    def __init__(self, track: Track, rubber: RubberModel) -> None:
        super().__init__(track, rubber)
        belt = track.belt
        nodes, weights = np.polynomial.legendre.leggauss(8)
        halves = ((0.0, belt.cord_height), (belt.cord_height, belt.thickness))  # bending changes sign at the cord
        self._heights = np.concatenate([low + (high - low) * (nodes + 1) / 2 for low, high in halves])
        self._height_weights = np.concatenate([(high - low) / 2 * weights for low, high in halves])
        self._corners = np.unique(np.concatenate([self.loop.curvature.position, self.loop.drive.position]))
        self._bending_energy = self._along_energy(0.0)

    def _by_strain(self, speed: Array, belt_degc: Array, half_length: Array) -> tuple[Array, Array, Callable[[Array], Array]]:
        section = self.track.road_wheels.contact_length * self.track.belt.thickness * self.rubber.rubber.layer_stiffening
        indentation = np.empty(speed.shape)
        for i in np.ndindex(speed.shape):
            indentation[i] = section * self._lost(self._energy(self.indentation_cycles(half_length[i])), speed[i], belt_degc[i])
        bending = self._lost(self._bending_energy, speed, belt_degc)

        def extra_loss(strain: Array) -> Array:
            strain, v, t, bare_loss = np.broadcast_arrays(strain, speed, belt_degc, bending)
            loss = np.array(bare_loss)
            for i in np.argwhere(strain):
                index = tuple(i)
                loss[index] = self._lost(self._along_energy(strain[index]), v[index], t[index])
            return np.asarray(loss - bare_loss)

        return indentation, bending, extra_loss

    def _along_energy(self, drive_strain: float) -> tuple[Array, Array]:
        """Passages and energies, see `_energy`, of the strain along the belt, integrated over height and width."""
        at_heights = [self._energy(self.along_cycles(height, drive_strain)) for height in self._heights]
        weights = self.track.belt.width * self._height_weights
        return (
            np.concatenate([passages for passages, _ in at_heights]),
            np.concatenate([weight * energies for weight, (_, energies) in zip(weights, at_heights, strict=True)]),
        )

    @staticmethod
    def _energy(cycles: list[PassageCycle]) -> tuple[Array, Array]:
        """Passage [m] of each cycle, and its loss in a loop per loss modulus: pi N (range/2)^2."""
        passages = np.array([c.passage for c in cycles])
        return passages, np.array([np.pi * c.cycle.number * (c.cycle.range / 2.0) ** 2 for c in cycles])

    def _lost(self, energy: tuple[Array, Array], speed: ArrayLike, belt_degc: ArrayLike) -> Array:
        """Loss per metre of travel [N] (over a unit section [N/m^2]) at speeds [m/s] and temperatures [degC]."""
        passages, energies = energy
        frequency = np.asarray(speed, float)[..., np.newaxis] / passages
        return np.asarray(self.rubber.loss_modulus(frequency, np.asarray(belt_degc, float)[..., np.newaxis]) @ energies)

    def indentation_cycles(self, half_lengths: Array) -> list[PassageCycle]:
        """Cycles through the thickness; `half_lengths` [m] is of shape (wheels,)."""
        centres = self.loop.wheel_positions
        corners = np.sort(np.concatenate([centres - half_lengths, centres, centres + half_lengths]))
        depth = contact.indentation(corners[:, np.newaxis] - centres, half_lengths, self.track.road_wheels.radius)
        return self._cycles(corners, depth.sum(axis=1) / self.track.belt.thickness)

    def along_cycles(self, height: float, drive_strain: float, steady_strain: float = 0.0) -> list[PassageCycle]:
        """Cycles along the belt at a height [m]."""
        return self._cycles(self._corners, along_belt(self.loop, height, self._corners, steady_strain, drive_strain))

    def _cycles(self, position: Array, strain: Array) -> list[PassageCycle]:
        values = [float(x) for x in np.round(strain, 12)]
        positions = [float(x) for x in position]
        return [PassageCycle(cycle, self._passage(positions, values, cycle)) for cycle in count_loop(values)]

    def _passage(self, position: list[float], value: list[float], cycle: Cycle) -> float:
        """Length [m] of the stretch round one of the cycle's extremes on which the strain is away from the other: the shorter
        of the two, so neither a steady strain nor the sense of travel matters.
        """
        corners = len(position)
        threshold = cycle.range * (1.0 - BACK_AT_BASE)

        def distance(extreme: int, step: int) -> float:
            index = extreme
            for _ in range(corners):
                index = (index + step) % corners
                if abs(value[index] - value[extreme]) >= threshold:
                    break
            return float(step * (position[index] - position[extreme]) % self.loop.length)

        return min(distance(extreme, 1) + distance(extreme, -1) for extreme in (cycle.start, cycle.end))


METHODS: dict[str, type[LossMethod]] = {method.name: method for method in (Spectral, RainflowCount)}
