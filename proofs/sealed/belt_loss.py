# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Models the truth's belt: loss per metre of travel from the Fourier series of the strain that a point of it sees in one loop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from proofs.sealed.data_sheet import Array, DataSheet
from proofs.sealed.material import Material

POINTS = 8192  # round the loop
LOG_SPEEDS = np.linspace(-6.0, 8.0, 141)  # log10 of speed [m/s] times a_T
LOAD_SHARES = np.array([0.4, 0.6, 0.8, 1.0, 1.25, 1.6, 2.0])  # of an assembly's nominal load
ITERATIONS = 30


@dataclass(frozen=True, eq=False)
class BeltLoss:
    """Tables of the loss per metre of travel [N] of one assembly over `LOG_SPEEDS`."""

    indentation: Array  # evenly through the thickness, shape (loads, speeds)
    bending: Array  # of a belt all at one temperature, shape (speeds,)


def belt_loss(sheet: DataSheet, material: Material) -> BeltLoss:
    """Compute the tables."""
    nominal = sheet["weight"] / sheet.assemblies
    speeds = 10.0**LOG_SPEEDS
    indentation = np.array([_indentation(sheet, material, share * nominal, speeds) for share in LOAD_SHARES])
    return BeltLoss(indentation, _bending(sheet, material, speeds))


def _harmonics(series: Array) -> Array:
    return np.asarray(2.0 * np.abs(np.fft.rfft(series))[1:-1] / len(series))


def _dissipated(amplitudes: Array, material: Material, loop: float, speed: float) -> float:
    """Energy per volume and loop [J/m^3]."""
    n = np.arange(1, len(amplitudes) + 1)
    keep = amplitudes > 1e-4 * amplitudes.max()
    return float((np.pi * n[keep] * amplitudes[keep] ** 2 * material.loss(2.0 * np.pi * n[keep] * speed / loop)).sum())


def _indentation(sheet: DataSheet, material: Material, load: float, speeds: Array) -> Array:
    loop, thickness = sheet["track.belt.loop_length"], sheet["track.belt.thickness"]
    width = sheet["track.road_wheels.contact_length"]
    place = np.arange(POINTS) * loop / POINTS
    found = []
    for half, speed in zip(_half_contacts(sheet, material, load, speeds), speeds.tolist(), strict=True):
        strain = np.zeros(POINTS)
        for at in sheet.wheel_positions:
            near = np.clip(1.0 - ((place - at - half) / half) ** 2, 0.0, None)
            strain += half * half / (2.0 * sheet["track.road_wheels.radius"] * thickness) * near
        found.append(_dissipated(_harmonics(strain), material, loop, speed) * width * thickness)
    return np.array(found)


def _half_contacts(sheet: DataSheet, material: Material, load: float, speeds: Array) -> list[float]:
    """Half the length of a wheel's contact [m] at each speed: it, its frequency and the modulus hang on each other."""
    on_wheel, width = load / len(sheet.wheel_positions), sheet["track.road_wheels.contact_length"]
    radius, thickness = sheet["track.road_wheels.radius"], sheet["track.belt.thickness"]
    halves = [0.02] * len(speeds)
    for _ in range(ITERATIONS):
        moduli = material.size(2.0 * np.pi * speeds / (2.0 * np.array(halves))).tolist()
        lengths = [(1.5 * on_wheel * radius * thickness / (modulus * width)) ** (1.0 / 3.0) for modulus in moduli]
        halves = [0.5 * half + 0.5 * length for half, length in zip(halves, lengths, strict=True)]
    return halves


def _bending(sheet: DataSheet, material: Material, speeds: Array) -> Array:
    loop, thickness, neutral = sheet["track.belt.loop_length"], sheet["track.belt.thickness"], sheet["track.belt.cord_height"]
    smooth = sheet["track.belt.curvature_length"]
    arcs = [(radius + neutral) * angle for radius, angle in sheet.wraps]
    free = (loop - sheet["track.road_wheels.ground_run"] - sum(arcs)) / (len(arcs) + 1)
    place = np.arange(POINTS) * loop / POINTS
    curvature = np.zeros(POINTS)
    begin = sheet["track.road_wheels.ground_run"]
    for (radius, _), arc in zip(sheet.wraps, arcs, strict=True):
        begin += free
        rise = np.clip((place - begin) / smooth + 0.5, 0.0, 1.0)
        fall = np.clip((place - begin - arc) / smooth + 0.5, 0.0, 1.0)
        curvature += (np.sin(0.5 * np.pi * rise) ** 2 - np.sin(0.5 * np.pi * fall) ** 2) / (radius + neutral)
        begin += arc
    amplitudes = _harmonics(curvature)
    moment = ((thickness - neutral) ** 3 + neutral**3) / 3.0 * sheet["track.belt.width"]
    return np.array([_dissipated(amplitudes, material, loop, v) for v in speeds]) * moment
