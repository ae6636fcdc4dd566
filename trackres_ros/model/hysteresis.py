# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes heat per metre of travel from the strain history, equations (27) to (29): two methods behind one interface."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from trackres_ros.arrays import Array
from trackres_ros.model import belt as belt_model
from trackres_ros.model import contact, rainflow
from trackres_ros.model.loads import beam_shares, wheel_loads
from trackres_ros.model.rubber import RubberModel
from trackres_ros.model.strain_history import Loop, along_belt, build_loop, indentation_amplitudes
from trackres_ros.vehicle import Track

HARMONICS = 4096  # doubling them moves the loss by less than 0.1 % (test_hysteresis.py)
POINTS_AT_ONCE = 8  # of a vectorised evaluation, so that its arrays stay in the processor's cache
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


class Contact(NamedTuple):
    """Contact under each road wheel, arrays of shape (..., wheels)."""

    half_length: Array
    largest_strain: Array
    frequency: Array
    modulus: Array


class PassageCycle(NamedTuple):
    """A counted cycle and the length of belt [m] strained by one passage of its cause."""

    cycle: rainflow.Cycle
    passage: float


class LossMethod(ABC):
    """Turns the strain history of one assembly into loss per metre of travel."""

    name: str

    def __init__(self, track: Track, rubber: RubberModel) -> None:
        self.track = track
        self.rubber = rubber
        self.loop: Loop = build_loop(track)

    def contacts(self, speed: ArrayLike, belt_degc: ArrayLike, load: ArrayLike) -> Contact:
        """Contact under each road wheel at speeds [m/s], temperatures [degC] and assembly loads [N], broadcast."""
        wheels, thickness = self.track.road_wheels, self.track.belt.thickness
        loads = wheel_loads(self.track, load)
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
        return Contact(half, contact.largest_strain(half, wheels.radius, thickness), frequency, modulus)

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
        given = np.broadcast_arrays(*(np.asarray(x, float) for x in (speed, belt_degc, load, drive_torque)))
        v, t, g, m = (np.ravel(x) for x in given)
        v = np.maximum(np.abs(v), SLOWEST_SPEED)
        half, strain = self.contacts(v, t, g).half_length, self.drive_strain(v, t, m)
        parts = np.empty((4, v.size))
        for start in range(0, v.size, POINTS_AT_ONCE):
            block = slice(start, start + POINTS_AT_ONCE)
            parts[:, block] = self._loss(v[block], t[block], half[block], strain[block])
        return LossForce(*(part.reshape(given[0].shape) for part in parts))

    @abstractmethod
    def _loss(self, speed: Array, belt_degc: Array, half_length: Array, drive_strain: Array) -> tuple[Array, ...]:
        """Indentation, bending, tension and drive [N] at points of shape (points,); half lengths [m] of (points, wheels)."""


class Spectral(LossMethod):
    """Exact for linear viscoelasticity: every harmonic of the periodic strain loses pi n A_n^2 E''(n v/L_R) a loop."""

    name = "spectral"

    def __init__(self, track: Track, rubber: RubberModel, harmonics: int = HARMONICS) -> None:
        super().__init__(track, rubber)
        self.harmonics = np.arange(1, harmonics + 1, dtype=float)
        curvature = self.loop.curvature.amplitudes(self.harmonics)
        drive = self.loop.drive.amplitudes(self.harmonics)
        weight = np.pi * self.harmonics
        self._bending = weight * np.abs(curvature) ** 2
        self._drive = weight * np.abs(drive) ** 2
        self._coupling = weight * 2.0 * np.real(np.conj(curvature) * drive)
        q = 2.0 * np.pi * self.harmonics / self.loop.length
        phases = np.exp(-1j * np.outer(self.loop.wheel_positions, q))
        shares = np.stack([beam_shares(track), beam_shares(track, own_weight=True)]).round(12)
        first, group = np.unique(shares, axis=1, return_index=True, return_inverse=True)[1:]
        group = np.ravel(group)
        # wheels under the same load have the same pulse: one representative and the sum of their phases
        self._alike = [(int(wheel), phases[group == k].sum(axis=0)) for k, wheel in enumerate(first)]

    def _loss(self, speed: Array, belt_degc: Array, half_length: Array, drive_strain: Array) -> tuple[Array, ...]:
        belt, wheels = self.track.belt, self.track.road_wheels
        (speeds, temperatures), at = np.unique([speed, belt_degc], axis=1, return_inverse=True)  # those of many loads are alike
        frequency = speeds[:, np.newaxis] * self.harmonics / self.loop.length
        loss = self.rubber.loss_modulus(frequency, temperatures[:, np.newaxis])[np.ravel(at)]
        width, moment = belt.width, [belt_model.bending_moment_of_height(belt, order) for order in range(3)]
        bending = width * moment[2] * (loss @ self._bending)
        coupling, alone = drive_strain * moment[1] * (loss @ self._coupling), drive_strain**2 * moment[0] * (loss @ self._drive)
        drive = width * (coupling + alone)
        real, imaginary = np.zeros(loss.shape), np.zeros(loss.shape)
        for wheel, phase in self._alike:
            pulse = indentation_amplitudes(
                half_length[:, wheel], wheels.radius, belt.thickness, self.loop.length, len(self.harmonics)
            )
            real += pulse * phase.real
            imaginary += pulse * phase.imag
        section = wheels.contact_length * belt.thickness * self.rubber.rubber.layer_stiffening
        power = (real * real + imaginary * imaginary) * self.harmonics
        indentation = section * np.pi * np.einsum("pn,pn->p", power, loss)
        return indentation, bending, np.zeros_like(bending), drive


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

    def _loss(self, speed: Array, belt_degc: Array, half_length: Array, drive_strain: Array) -> tuple[Array, ...]:
        section = self.track.road_wheels.contact_length * self.track.belt.thickness * self.rubber.rubber.layer_stiffening
        indentation = np.array(
            [
                section * float(self._lost(self._energy(self.indentation_cycles(a)), v, t))
                for a, v, t in zip(half_length, speed, belt_degc, strict=True)
            ]
        )
        bending = self._lost(self._bending_energy, speed, belt_degc)
        both = bending.copy()
        for i in np.flatnonzero(drive_strain):
            both[i] = self._lost(self._along_energy(drive_strain[i]), speed[i], belt_degc[i])
        return indentation, bending, np.zeros_like(bending), both - bending

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
        middle = self.loop.wheel_positions
        corners = np.sort(np.concatenate([middle - half_lengths, middle, middle + half_lengths]))
        depth = contact.indentation(corners[:, np.newaxis] - middle, half_lengths, self.track.road_wheels.radius)
        return self._cycles(corners, depth.sum(axis=1) / self.track.belt.thickness)

    def along_cycles(self, height: float, drive_strain: float, steady_strain: float = 0.0) -> list[PassageCycle]:
        """Cycles along the belt at a height [m]."""
        return self._cycles(self._corners, along_belt(self.loop, height, self._corners, steady_strain, drive_strain))

    def _cycles(self, position: Array, strain: Array) -> list[PassageCycle]:
        values = [float(x) for x in np.round(strain, 12)]
        positions = [float(x) for x in position]
        return [PassageCycle(cycle, self._passage(positions, values, cycle)) for cycle in rainflow.count_loop(values)]

    def _passage(self, position: list[float], value: list[float], cycle: rainflow.Cycle) -> float:
        """Length [m] of the stretch round one of the cycle's extremes on which the strain is away from the other: the shorter
        of the two, so neither a steady strain nor the sense of travel matters.
        """
        corners = len(position)
        near = cycle.range * (1.0 - BACK_AT_BASE)

        def distance(extreme: int, step: int) -> float:
            at = extreme
            for _ in range(corners):
                at = (at + step) % corners
                if abs(value[at] - value[extreme]) >= near:
                    break
            return float(step * (position[at] - position[extreme]) % self.loop.length)

        return min(distance(extreme, 1) + distance(extreme, -1) for extreme in (cycle.start, cycle.end))


METHODS: dict[str, type[LossMethod]] = {method.name: method for method in (Spectral, RainflowCount)}
