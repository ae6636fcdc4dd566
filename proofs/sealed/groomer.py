# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Simulates an electric snow groomer, a third truth: another vehicle, another belt model, a logger of its own, slow physics.

Its physics shares no code with the other truths, which it shares the drivers with.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from proofs.sealed.cases import whitened
from proofs.sealed.drives import SealedDrive, drive, trapezoids
from proofs.sealed.phenomena import CREEP_MPS
from trackres_ros.arrays import Array
from trackres_ros.files.documents import read_yaml
from trackres_ros.files.resources import config_dir

MINUTES, FASTEST_MPS = 25.0, 6.0
RATIO, RADIUS_M = 38.0, 0.38  # of the gearbox; of the sprockets
NOMINAL_T, ROTATING = 9.4, 1.25  # mass; translating and rotating mass over it
# At the nominal mass and -5 degC: losses of the belts and the wheels [Nm at the sprockets], as the vehicle file has them.
BELTS_NM, WHEELS_NM = 930.0, 350.0
COLD_DEGC, KELVIN = -5.0, 273.15
LOAD_POWER, SPEED_POWER = 4.0 / 3.0, 0.05  # of a cylinder on a layer; of rubber's loss at these frequencies
STIFFENS_K = 930.0  # activation temperature of the loss: 1.3 % a kelvin
DRAG = 0.5 * 1.3 * 0.9 * 6.4  # of the air [N s^2/m^2]
# Belts of two layers: core and skin. Conductances [W/K], the skin's also a metre per second, and heat capacities [J/K].
CORE_JK, SKIN_JK, INSIDE_WK, FILM_WK, FILM_WK_PER_MPS = 520e3, 180e3, 2500.0, 920.0, 28.0
SKIN_SHARE = 0.3  # of the loss
# What the logger writes.
SPEED_NOISE_MPS, MOTOR_NOISE_NM, AIR_NOISE_K = 0.015, 0.8, 0.1
HEADS = "Zeit [s];Geschwindigkeit [km/h];Motormoment [Nm];Masse [t];Außentemperatur [°C]"
TOPICS = f"""time: {{column: "Zeit [s]"}}
speed: {{column: "Geschwindigkeit [km/h]", unit: km/h}}
load: {{column: "Masse [t]", unit: t}}
ambient: {{column: "Außentemperatur [°C]"}}
torque: {{column: "Motormoment [Nm]", scale: {RATIO}}}
"""
APART_K = (2.0, 6.0)  # by which the air goes above and below the threshold
# Of the hidden physics.
SOFT_K = 0.3  # over which a switch by temperature acts
PER_K = 0.1  # share of the size of a drag that grows in the cold
HEAVY_T, LATE_S = 9.6, 900.0


@dataclass(frozen=True)
class Groomer:
    """A groomer and its drives."""

    hide: str  # of `HIDDEN`, or "none"
    size: float  # [Nm]
    at: float  # air temperature of a threshold, which each drive crosses [degC]
    gear: float  # efficiency from the motor, where the torque is measured, to the sprockets
    masses: tuple[float, ...]  # of each drive [t]
    seed: int
    name: str = ""


@dataclass(frozen=True, eq=False)
class Snow:
    """True values of a drive on snow, series of shape (n,)."""

    drive: SealedDrive
    hidden: Array  # torque at the sprockets [Nm]
    torque: Array  # at the sprockets, with it [Nm]
    motor: Array  # [Nm]
    belt: Array  # mean temperature [degC]


HIDDEN: dict[str, Callable[[Groomer, SealedDrive, float], Array]] = {
    "cold": lambda g, d, _: np.asarray(g.size * (0.5 - 0.5 * np.tanh((d.ambient - g.at) / SOFT_K))),
    "cool": lambda g, d, _: np.asarray(g.size * PER_K * np.maximum(g.at - d.ambient, 0.0)),
    "load": lambda g, d, mass: np.full(len(d), g.size * (mass > HEAVY_T)),
    "late": lambda g, d, _: np.full(len(d), g.size) * (np.arange(len(d)) * d.step > LATE_S),
}
"""Drag of each kind of hidden physics [Nm], by the groomer, the drive and its mass [t]."""


def snow_drives(g: Groomer) -> list[Snow]:
    """All drives of a groomer, each with a belt at the air's temperature at first."""
    rng = np.random.default_rng([g.seed, *b"snow"])
    return [_simulated(g, _planned(g, mass, rng), mass) for mass in g.masses]


def _planned(g: Groomer, mass: float, rng: np.random.Generator) -> SealedDrive:
    """A drive of a restless or a steady driver, in air that wanders about the threshold and crosses it."""
    make = drive if rng.random() < 0.5 else trapezoids
    item = make(MINUTES, mass * 9810.0, g.at, FASTEST_MPS, rng)
    count = int(rng.integers(4, 7))
    sides = np.resize(rng.permutation((-1.0, 1.0)), count) * rng.uniform(*APART_K, count)
    even = np.linspace(0.0, np.pi * (count - 1), len(item))
    turn, share = np.minimum((even / np.pi).astype(int), count - 2), 0.5 - 0.5 * np.cos(even % np.pi)
    share[-1] = 1.0
    air = g.at + sides[turn] + share * (sides[turn + 1] - sides[turn])
    still = np.zeros(len(item))
    return SealedDrive(item.step, item.speed, item.accel, still, still, item.weight, air)


def _simulated(g: Groomer, one: SealedDrive, mass: float) -> Snow:
    load, travel = mass / NOMINAL_T, np.abs(one.speed)
    direction = one.speed / np.hypot(one.speed, CREEP_MPS)
    rolling = BELTS_NM * load**LOAD_POWER * (np.maximum(travel, 0.3) / 3.5) ** SPEED_POWER * np.abs(direction)
    loss, belt = np.empty(len(one)), np.empty(len(one))
    core = skin = float(one.ambient[0])
    film = FILM_WK + FILM_WK_PER_MPS * travel
    for i, air in enumerate(one.ambient.tolist()):
        belt[i] = (CORE_JK * core + SKIN_JK * skin) / (CORE_JK + SKIN_JK)
        loss[i] = rolling[i] * np.exp(STIFFENS_K * (1.0 / (belt[i] + KELVIN) - 1.0 / (COLD_DEGC + KELVIN)))
        heat, through = loss[i] * travel[i] / RADIUS_M, INSIDE_WK * (core - skin)
        core += one.step * ((1.0 - SKIN_SHARE) * heat - through) / CORE_JK
        skin += one.step * (SKIN_SHARE * heat + through - film[i] * (skin - air)) / SKIN_JK
    hidden = HIDDEN[g.hide](g, one, mass) * direction if g.hide in HIDDEN else np.zeros(len(one))
    wheels = WHEELS_NM * load * direction
    inertia = mass * 1000.0 * ROTATING * one.accel * RADIUS_M
    torque = loss * np.sign(one.speed) + wheels + DRAG * one.speed * travel * RADIUS_M + inertia + hidden
    motor = np.where(torque * one.speed > 0.0, torque / g.gear, torque * g.gear) / RATIO
    return Snow(one, hidden, torque, motor, belt)


def write_table(path: Path, snow: Snow, mass: float, rng: np.random.Generator) -> None:
    """Write a drive as a German logger does: commas in numbers, semicolons between them, Latin letters of one byte."""
    item = snow.drive

    def noisy(series: Array, std: float) -> Array:
        return np.asarray(series + rng.normal(0.0, std, len(item)))

    speed = np.where(item.speed > 0.0, np.maximum(noisy(item.speed, SPEED_NOISE_MPS), 0.0), 0.0)
    columns = (
        np.arange(len(item)) * item.step, 3.6 * speed, noisy(snow.motor, MOTOR_NOISE_NM), np.full(len(item), mass),
        noisy(item.ambient, AIR_NOISE_K),
    )  # fmt: skip
    rows = (";".join(f"{x:.1f}" for x in row).replace(".", ",") for row in np.column_stack(columns))
    path.write_text("\n".join((HEADS, *rows)) + "\n", encoding="latin-1")


VEHICLE = Path(__file__).with_name("groomer.yaml")
NONE, GEARBOX = "none", "drivetrain_efficiency"
KINDS = (NONE, *HIDDEN)
SIZES_NM, AT_DEGC, GEARS, DRIVES = (250.0, 500.0), (-8.0, -2.0), (0.90, 0.97), (3, 5)
DIRECT_SHARE = 0.2  # of the cases: the torque is measured behind the gearbox
LIGHT_DRIVES_T, HEAVY_DRIVES_T = (8.8, 9.5), (9.8, 10.4)
ABSOLUTE = 0.7979  # mean of the absolute value of a normal variable, over its standard deviation


def draw_groomers(counts: Mapping[str, int], seed: int) -> list[Groomer]:
    """Groomers with so many cases of each kind, and names that say nothing; each has light and heavy drives."""
    rng = np.random.default_rng(seed)
    drawings = [_drawn(kind, rng) for kind, count in counts.items() for _ in range(count)]
    numbers = np.random.default_rng([seed, *b"names"]).permutation(len(drawings))
    return [replace(g, name=f"case{number:03d}") for number, g in zip(numbers.tolist(), drawings, strict=True)]


def _drawn(kind: str, rng: np.random.Generator) -> Groomer:
    count = int(rng.integers(DRIVES[0], DRIVES[1] + 1))
    heavy = int(rng.integers(1, count))
    masses = [*rng.uniform(*HEAVY_DRIVES_T, heavy), *rng.uniform(*LIGHT_DRIVES_T, count - heavy)]
    gear = 1.0 if rng.random() < DIRECT_SHARE else float(rng.uniform(*GEARS))
    shown = tuple(round(float(mass), 1) for mass in rng.permutation(masses))
    return Groomer(kind, float(rng.uniform(*SIZES_NM)), float(rng.uniform(*AT_DEGC)), gear, shown, int(rng.integers(2**31)))


def label(g: Groomer) -> dict[str, Any]:
    """The label of a groomer's case, as `second` reads it."""
    effects: list[dict[str, Any]] = []
    if g.hide != NONE:
        numbers = {"threshold": g.at, "size_nm": g.size} if g.hide in ("cold", "cool") else {}
        effects = [{"name": g.hide, "d_prime": detectability(snow_drives(g)), "acceptable": [], **numbers}]
    one_s = ABSOLUTE * RATIO * MOTOR_NOISE_NM / np.sqrt(10.0)
    return {
        "case": g.name, "level": "outside" if effects else NONE, "effects": effects, "identifiable": False, "given": [],
        "driving": "snow", "tolerated": [] if g.gear == 1.0 else [GEARBOX], "noise_mae": [{"one_s": float(one_s)}],
        "gear": g.gear, "masses": g.masses,
    }  # fmt: skip


def detectability(drives: list[Snow]) -> float:
    """Detectability d' of the hidden torque after a re-fit: without the part that load, belt
    temperature, speed and driving torque explain.
    """

    def white(of: list[Array]) -> Array:
        return whitened(of, [s.drive for s in drives])

    way = [np.sign(s.drive.speed) for s in drives]
    weights = [w * s.drive.weight for w, s in zip(way, drives, strict=True)]
    absorbed = [
        way, weights, [w * s.belt for w, s in zip(weights, drives, strict=True)],
        [s.drive.speed**2 for s in drives], [np.abs(s.torque) for s in drives], [s.drive.accel * s.drive.weight for s in drives],
    ]  # fmt: skip
    taken, added = np.linalg.qr(np.column_stack([white(of) for of in absorbed]))[0], white([s.hidden for s in drives])
    return float(np.linalg.norm(added - taken @ (taken.T @ added)))


def record_groomer(into: Path, g: Groomer) -> None:
    """Write the folder of a case: a table of each drive, and the files of vehicle and topics."""
    into.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng([g.seed, *b"sensors"])
    for number, (snow, mass) in enumerate(zip(snow_drives(g), g.masses, strict=True), start=1):
        write_table(into / f"session{number}.csv", snow, mass, rng)
    content = read_yaml(VEHICLE)
    content["rubber"]["file"] = str(config_dir() / content["rubber"]["file"])
    (into / "vehicle.yaml").write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    (into / "topics.yaml").write_text(TOPICS, encoding="utf-8")
