# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Models the truth's belt from a data sheet: rubber after Maxwell and WLF, loss per metre of travel, and temperature.

The sheet is what a maker would print: the plain numbers of a vehicle file, nothing computed.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import nnls

from trackres_ros.arrays import Array
from trackres_ros.files.documents import read_yaml
from trackres_ros.kernels.compiler import load_module
from trackres_ros.kernels.extension import Extension
from trackres_ros.kernels.flow import translate_body
from trackres_ros.kernels.functions import Translator
from trackres_ros.kernels.marks import interpreted, kernel


@dataclass(frozen=True, eq=False)
class DataSheet:
    """Numbers by dotted path [SI, degC], and the temperature sweep of the rubber: T [degC], E', E'' [Pa]."""

    numbers: dict[str, float]
    wheel_positions: Array
    wraps: tuple[tuple[float, float], ...]  # radius [m] and angle [rad], in the order the loop runs
    assemblies: int
    sweep: Array  # (3, temperatures)

    def __getitem__(self, path: str) -> float:
        return self.numbers[path]


def read_data_sheet(path: Path) -> DataSheet:
    """Read a track vehicle's file with one kind of track."""
    content = read_yaml(path)
    (track,) = content["tracks"].values()
    numbers: dict[str, float] = {}
    for name, part in (("rubber", content["rubber"]), ("chassis", content["chassis"]), ("track", track)):
        _collect(name, part, numbers)
    axles = sum(axle["load"]["value"] for axle in content["chassis"]["axles"])
    numbers["weight"] = axles + len(content["assemblies"]) * numbers["track.own_weight"]
    wraps = tuple(
        (wheel["radius"]["value"] if "radius" in wheel else numbers["track.sprocket_radius"], wheel["wrap_angle"]["value"])
        for wheel in track["wrapped_wheels"]
    )
    with (path.parent / content["rubber"]["file"]).open(encoding="utf-8", newline="") as lines:
        rows = list(csv.DictReader(lines))
    columns = ("T_degC", "E_storage_MPa_10Hz", "E_loss_MPa_10Hz")
    sweep = np.array([[float(row[name]) for row in rows] for name in columns])
    sweep[1:] *= 1e6
    positions = np.array(track["road_wheels"]["positions"]["value"], dtype=float)
    return DataSheet(numbers, positions, wraps, len(content["assemblies"]), sweep)


def _collect(prefix: str, part: Any, numbers: dict[str, float]) -> None:
    for key, entry in part.items():
        if isinstance(entry, dict) and isinstance(entry.get("value"), int | float):
            numbers[f"{prefix}.{key}"] = float(entry["value"])
        elif isinstance(entry, dict):
            _collect(f"{prefix}.{key}", entry, numbers)


ELEMENTS_PER_DECADE = 2
SHIFT_ABOVE_TG_K = 50.0
BELOW_TG_K = 40.0  # the shift function has a pole further down; it goes on straight from here

AT_ONCE = 64  # frequencies, whose elements the processor keeps at hand


@dataclass(frozen=True, eq=False)
class Material:
    """Moduli [Pa] and relaxation times [s] at the reference temperature, and the constants of the shift."""

    equilibrium: float
    moduli: Array
    times: Array
    glass_transition: float
    c1: float
    c2: float

    def log_shift(self, degc: ArrayLike) -> Array:
        """log10 a_T."""
        above = np.maximum(np.asarray(degc, dtype=float) - self.glass_transition, -BELOW_TG_K) - SHIFT_ABOVE_TG_K
        return np.asarray(-self.c1 * above / (self.c2 + above))

    def loss(self, omega_shifted: ArrayLike) -> Array:
        """Loss modulus [Pa] at an angular frequency times a_T [rad/s]."""
        omega = np.asarray(omega_shifted, dtype=float)
        if omega.size > AT_ONCE:
            flat = omega.ravel()
            parts = [self.loss(flat[i : i + AT_ONCE]) for i in range(0, flat.size, AT_ONCE)]
            return np.concatenate(parts).reshape(omega.shape)
        x = omega[..., np.newaxis] * self.times
        below = x * x
        below += 1.0
        x *= self.moduli
        x /= below
        return np.asarray(x.sum(axis=-1))

    def size(self, omega_shifted: ArrayLike) -> Array:
        """Size of the complex modulus [Pa]."""
        x = np.asarray(omega_shifted, dtype=float)[..., np.newaxis] * self.times
        storage = self.equilibrium + (self.moduli * x * x / (1.0 + x * x)).sum(axis=-1)
        return np.asarray(np.hypot(storage, self.loss(omega_shifted)))


def fit_material(sheet: DataSheet) -> Material:
    """The elements that make the sheet's temperature sweep at one frequency, by non-negative least squares of relative errors."""
    degc, storage, loss = sheet.sweep
    blank = Material(
        0.0, np.empty(0), np.empty(0), sheet["rubber.glass_transition"], sheet["rubber.wlf_c1"], sheet["rubber.wlf_c2"]
    )
    omega = 2.0 * np.pi * sheet["rubber.sweep_frequency"] * 10.0 ** blank.log_shift(degc)
    decades = np.log10(omega.max() / omega.min()) + 2.0
    times = 1.0 / np.geomspace(omega.min() / 10.0, omega.max() * 10.0, int(decades * ELEMENTS_PER_DECADE))
    x = omega[:, np.newaxis] * times
    rows_storage = np.column_stack([x * x / (1.0 + x * x), np.ones(len(omega))]) / storage[:, np.newaxis]
    rows_loss = np.column_stack([x / (1.0 + x * x), np.zeros(len(omega))]) / loss[:, np.newaxis]
    result, _ = nnls(np.vstack([0.3 * rows_storage, rows_loss]), np.concatenate([np.full(len(omega), 0.3), np.ones(len(omega))]))
    return Material(float(result[-1]), result[:-1], times, blank.glass_transition, blank.c1, blank.c2)


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
    results = []
    for half, speed in zip(_half_contacts(sheet, material, load, speeds), speeds.tolist(), strict=True):
        strain = np.zeros(POINTS)
        for position in sheet.wheel_positions:
            near = np.clip(1.0 - ((place - position - half) / half) ** 2, 0.0, None)
            strain += half * half / (2.0 * sheet["track.road_wheels.radius"] * thickness) * near
        results.append(_dissipated(_harmonics(strain), material, loop, speed) * width * thickness)
    return np.array(results)


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


LAYERS = 15
KELVIN = 273.15


@kernel
def roll(
    step: float,
    speed: Array,
    load_row: Array,
    ambient: Array,
    factor: Array,
    film: Array,
    outer_flux: Array,
    ground: Array,
    first_log_speed: float,
    step_log_speed: float,
    indentation: Annotated[Array, (None, None)],
    bending: Array,
    bending_share: Array,
    shift_constants: Array,
    activation: float,
    capacity: float,
    area: float,
    conductance: float,
    layers: Array,
    rates: Array,
    force: Array,
    mean: Array,
) -> None:
    """Fill loss per metre [N] and mean temperature [degC]; change the layers' temperatures.

    Parameters
    ----------
    speed, load_row, ambient, factor, film, outer_flux, ground
        Series of shape (n,): travel speed [m/s], row in the table (a fraction between rows), air [degC], factor on the
        loss, film coefficient [W/m^2/K], what the sun brings to the outer face [W/m^2], conductance to the ground [W/K].
    indentation, bending
        Tables of `belt_loss`, shapes (loads, speeds) and (speeds,).
    bending_share
        Of each layer, shape (layers,).
    shift_constants
        Glass transition, c1, c2, temperature above the first that is the reference, and where the shift goes on straight.
    activation
        A further exp(activation (1/T - 1/313 K)) on the loss [K]; 0 for none.
    capacity, area, conductance
        Of one belt [J/K], of both faces [m^2], from the middle of a layer to that of the next [W/K].
    layers, rates
        Temperatures of the layers, inside first [degC], and as much space.
    """
    count = len(layers)
    each = capacity / count
    last = indentation.shape[1] - 2
    for i in range(speed.shape[0]):
        travel = abs(speed[i])
        log_speed = math.log10(travel) if travel > 1e-6 else -6.0
        row = min(int(load_row[i]), indentation.shape[0] - 2)
        part = load_row[i] - row
        total = warmth = 0.0
        for j in range(count):
            above = max(layers[j] - shift_constants[0], -shift_constants[4]) - shift_constants[3]
            x = log_speed - shift_constants[1] * above / (shift_constants[2] + above)
            place = (x - first_log_speed) / step_log_speed
            k = min(max(int(place), 0), last)
            share = place - k
            pressed = (1.0 - part) * ((1.0 - share) * indentation[row, k] + share * indentation[row, k + 1]) + part * (
                (1.0 - share) * indentation[row + 1, k] + share * indentation[row + 1, k + 1]
            )
            bent = (1.0 - share) * bending[k] + share * bending[k + 1]
            more = math.exp(activation * (1.0 / (layers[j] + KELVIN) - 1.0 / 313.15))
            lost = (pressed / count + bent * bending_share[j]) * more * factor[i]
            total += lost
            warmth += layers[j]
            rates[j] = lost * travel
        force[i] = total
        mean[i] = warmth / count
        # A face and half a layer behind it in series; the face itself holds no heat.
        to_face = 2.0 * conductance
        face = 0.5 * film[i] * area
        inner = (to_face * layers[0] + face * ambient[i]) / (to_face + face)
        outer = (to_face * layers[count - 1] + (face + ground[i]) * ambient[i] + outer_flux[i] * 0.5 * area) / (
            to_face + face + ground[i]
        )
        rates[0] += to_face * (inner - layers[0])
        rates[count - 1] += to_face * (outer - layers[count - 1])
        for j in range(count - 1):
            flow = conductance * (layers[j] - layers[j + 1])
            rates[j] -= flow
            rates[j + 1] += flow
        for j in range(count):
            layers[j] += step * rates[j] / each


@cache
def native(kernel: FunctionType) -> Any:
    """The kernel as C; itself where plain Python is requested or no compiler is there. It takes a second, once in a process."""
    if interpreted():
        return kernel
    translator = Translator(translate_body)
    translator.is_checked = False
    name = f"proofs_{kernel.__name__}"
    module = load_module(name, Extension(name, translator, {kernel.__name__: kernel}).text())
    return kernel if module is None else getattr(module, kernel.__name__)
