# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Simulates a vehicle by a second model, with any phenomena to be found, and records it as imperfect sensors show it.

Each phenomenon has another form here than in the catalogue of the diagnosis, as in nature.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from proofs.sealed.belt import (
    BELOW_TG_K,
    KELVIN,
    LAYERS,
    LOAD_SHARES,
    LOG_SPEEDS,
    SHIFT_ABOVE_TG_K,
    BeltLoss,
    DataSheet,
    Material,
    belt_loss,
    fit_material,
    native,
    read_data_sheet,
    roll,
)
from proofs.sealed.drives import OnStreet, SealedDrive
from proofs.sealed.phenomena import LOAD, PROGRAM, TOWN_PHENOMENA, Adds, Journey, Seen, acting, loaded
from trackres_ros.arrays import Array

Hidden = Mapping[str, Mapping[str, float]]
"""Phenomena that are switched on, by the catalogue's names, with the values of their parameters here."""

G = 9.81
LEAST_LOSS = 0.2  # of the rubber's, whatever a program does to it


@dataclass(frozen=True)
class Build:
    """How one vehicle differs from its data sheet: factors, and the conductivity of its belt [W/m/K]."""

    loss: float = 1.0
    bearing: float = 1.0
    drag: float = 1.0
    film: float = 1.0
    capacity: float = 1.0
    conductivity: float = 0.26


@dataclass(frozen=True, eq=False)
class TruthRun:
    """True values of a drive, series of shape (n,)."""

    torque: Array  # at the sprockets [Nm]
    shown: Array  # at the sensor [Nm]
    belt: Array  # mean temperature [degC]
    added: dict[str, Array]  # torque of each phenomenon [Nm]; for a program, or with friction brakes: at the sensor
    weight: Array  # including the load [N]


class _Design(NamedTuple):
    """Constants of all vehicles of a data sheet."""

    sheet: DataSheet
    material: Material
    tables: BeltLoss


@cache
def _design(path: Path) -> _Design:
    sheet = read_data_sheet(path)
    material = fit_material(sheet)
    return _Design(sheet, material, belt_loss(sheet, material))


def simulate_truth(path: Path, build: Build, hidden: Hidden, drives: Sequence[SealedDrive]) -> list[TruthRun]:
    """Drive one after the other, each with a belt at the air's temperature at first; wear and running-in continue."""
    design = _design(path)
    result, driven = [], 0.0
    for drive in drives:
        with_all = _one(design, build, hidden, drive, driven)
        added = {}
        for name in hidden:
            without = _one(design, build, _without(hidden, name), drive, driven)
            location = 1 if name == PROGRAM or drive.street is not None else 0  # brakes supply a part of the torques of a town
            added[name] = with_all[location] - without[location]
        result.append(TruthRun(*with_all, added, _with_load(hidden, drive, driven).weight))
        driven += float(np.abs(drive.speed).sum() * drive.step)
    return result


def _without(hidden: Hidden, name: str) -> Hidden:
    return {key: value for key, value in hidden.items() if key != name}


def _with_load(hidden: Hidden, drive: SealedDrive, driven: float) -> SealedDrive:
    return loaded(drive, hidden[LOAD], driven) if LOAD in hidden else drive


def _one(design: _Design, build: Build, hidden: Hidden, drive: SealedDrive, driven: float) -> tuple[Array, Array, Array]:
    sheet = design.sheet
    drive = _with_load(hidden, drive, driven)
    journey = Journey(sheet, drive, driven)
    acts: dict[str, Array] = {}
    if PROGRAM in hidden:  # it follows the torque and the belt as they are without it
        torque, _, belt = _one(design, build, _without(hidden, PROGRAM), drive, driven)
        acts = acting(hidden, Seen(journey, belt, torque))
    rub = _run(design, build, hidden, journey, np.ones(len(drive)), acts)
    if "tension_torque" in hidden:  # the torque stretches the belt, which changes the torque: once round is near enough
        pull = np.abs(_resistance(sheet, build, hidden, journey, rub[0])) / (sheet.assemblies * sheet["track.sprocket_radius"])
        more = np.sqrt(1.0 + 2.0 * hidden["tension_torque"]["share"] * pull / sheet["track.belt.pretension"])
        rub = _run(design, build, hidden, journey, more, acts)
    force, belt = rub
    torque = _resistance(sheet, build, hidden, journey, force)
    torque = torque * (1.0 + acts.get("gain", 0.0)) + acts.get("torque", 0.0) * journey.direction
    if "drivetrain_efficiency" in hidden:
        eta = hidden["drivetrain_efficiency"]["efficiency"]
        losses = (1.0 / eta - 1.0) * np.abs(torque) ** 0.97 * sheet["weight"] ** 0.03
        torque = torque + losses * journey.direction
    if "drivetrain_drag" in hidden:
        torque = torque + hidden["drivetrain_drag"]["drag"] * (1.0 + 0.01 * journey.travel) * journey.direction
    return torque, _sensor(torque, hidden, journey) + acts.get("sensor", 0.0), belt


def _run(
    design: _Design, build: Build, hidden: Hidden, at: Journey, more: Array, acts: Mapping[str, Array]
) -> tuple[Array, Array]:
    """Loss per metre of one belt [N], and mean temperature [degC]."""
    drive, n, sheet, material = at.drive, len(at.drive), design.sheet, design.material
    belt = _belt(sheet)
    rubber = belt["width"] * belt["thickness"] - belt["cord_section"] + belt["lug_section"]
    capacity = build.capacity * belt["loop_length"] * (
        rubber * sheet["rubber.density"] * sheet["rubber.heat_capacity"]
        + belt["cord_section"] * belt["cord_density"] * belt["cord_heat_capacity"]
    )  # fmt: skip
    area = belt["exposed_share"] * 2.0 * (belt["width"] + belt["thickness"]) * belt["loop_length"]
    heights = (np.arange(LAYERS) + 0.5) / LAYERS * belt["thickness"] - belt["cord_height"]
    force, mean = np.empty(n), np.empty(n)
    row = np.interp(at.load, LOAD_SHARES, np.arange(len(LOAD_SHARES)))
    sun = hidden.get("solar", {}).get("flux", 0.0) + acts.get("heat", np.zeros(n))
    ground = hidden.get("ground_conduction", {}).get("conductance", 0.0)
    native(roll)(
        drive.step,
        np.ascontiguousarray(drive.speed),
        row,
        drive.ambient,
        np.ascontiguousarray(_loss_factor(build, hidden, at, more, acts) * np.ones(n)),
        np.ascontiguousarray(_film(build, hidden, at, acts)),
        0.5 * sun,  # a face sees it half of the way round
        ground * at.travel**0.45,
        float(LOG_SPEEDS[0]),
        float(LOG_SPEEDS[1] - LOG_SPEEDS[0]),
        design.tables.indentation,
        design.tables.bending,
        heights**2 / (heights**2).sum(),
        np.array([material.glass_transition, material.c1, material.c2, SHIFT_ABOVE_TG_K, BELOW_TG_K]),
        hidden.get("compound_temperature", {}).get("activation", 0.0),
        capacity,
        area,
        build.conductivity * 0.5 * area / (belt["thickness"] / LAYERS),
        np.full(LAYERS, drive.ambient[0]),
        np.empty(LAYERS),
        force,
        mean,
    )
    return force, mean


def _belt(sheet: DataSheet) -> dict[str, float]:
    return {key.removeprefix("track.belt."): value for key, value in sheet.numbers.items() if key.startswith("track.belt.")}


def _film(build: Build, hidden: Hidden, at: Journey, acts: Mapping[str, Array]) -> Array:
    """Film coefficient of the belt [W/m^2/K]."""
    belt = _belt(at.sheet)
    film = build.film * (belt["film_offset"] + belt["film_slope"] * at.travel)
    if "convection" in hidden:
        p = hidden["convection"]
        film = build.film * (p["offset"] * belt["film_offset"] + p["slope"] * belt["film_slope"] * 1.3 * at.travel**0.9)
    if "rain" in hidden:
        film = film * hidden["rain"]["factor"] + 4.0  # and some evaporates
    if "still_air" in hidden:
        film = film * (1.0 - hidden["still_air"]["share"] / (1.0 + (at.travel / 1.2) ** 4))
    return np.asarray(film * np.exp(acts.get("cooling", 0.0)))


def _loss_factor(build: Build, hidden: Hidden, at: Journey, more: Array, acts: Mapping[str, Array]) -> Array:
    """Loss of the rubber over that of the data sheet."""
    factor = build.loss * more * np.maximum(1.0 + acts.get("loss", 0.0), LEAST_LOSS)
    if "frequency" in hidden:
        factor = factor * (1.0 + hidden["frequency"]["per_e"] * np.log(np.maximum(at.travel, 0.1) / 5.0))
    if "payne" in hidden:
        p = hidden["payne"]
        factor = factor * (1.0 + p["height"] * (1.0 - at.load ** p["power"]))
    if "mullins" in hidden:
        p = hidden["mullins"]
        factor = factor * (1.0 + p["excess"] / (1.0 + at.distance / p["distance"]) ** 1.5)
    return np.asarray(factor)


def _resistance(sheet: DataSheet, build: Build, hidden: Hidden, at: Journey, force: Array) -> Array:
    """Torque at the sprockets that rolls and accelerates the vehicle [Nm]."""
    drive, radius = at.drive, sheet["track.sprocket_radius"]
    weight = drive.weight
    drag = 0.5 * sheet["chassis.air_density"] * build.drag * sheet["chassis.drag_coefficient"] * sheet["chassis.frontal_area"]
    turning = sheet["chassis.rotating_mass_factor"] - 1.0 + hidden.get("rotating_inertia", {}).get("more", 0.0)
    turns = sheet["weight"] if LOAD in hidden else weight  # people and goods do not turn with the wheels
    total = radius * (
        sheet.assemblies * force * at.direction
        + build.bearing * sheet["chassis.bearing_friction"] * weight * at.direction
        + drag * at.speed * at.travel
        + (weight + turning * turns) / G * drive.accel
        + (0.0 if drive.slope is None else weight * np.sin(np.arctan(drive.slope)))
    )
    for name, adds in PHENOMENA.items():
        if name in hidden:
            total = total + adds(at, hidden[name], total)
    return np.asarray(total)


def _sensor(torque: Array, hidden: Hidden, at: Journey) -> Array:
    shown = torque
    if at.drive.street is not None:  # friction brakes sit behind the sensor, and hold the vehicle where it stands
        brakes = at.drive.street.brakes
        shown = np.where(at.travel > 0.0, torque - brakes * np.minimum(torque, 0.0), 0.0)
    if "delay" in hidden:
        time = np.arange(len(torque)) * at.step
        shown = np.interp(time - hidden["delay"]["time"], time, shown)
    if "torque_gain" in hidden:
        shown = (1.0 + hidden["torque_gain"]["error"]) * shown
    if "torque_offset" in hidden:  # and it creeps a little
        creep = 1.0 + 0.1 * np.sin(np.arange(len(torque)) * at.step / 900.0)
        shown = shown + hidden["torque_offset"]["offset"] * creep
    return shown


def _grade_profile(at: Journey, p: Mapping[str, float], _: Array) -> Array:
    rise = p["rise"] * np.cos(at.drive.heading - p["towards"]) + 0.1 * p["rise"] * np.cos(2.0 * at.drive.heading)
    return at.climbing(rise)


def _turning_scrub(at: Journey, p: Mapping[str, float], _: Array) -> Array:
    arm = 0.25 * at.sheet["track.road_wheels.ground_run"] * at.sheet["track.sprocket_radius"]
    return p["friction"] * arm * at.drive.weight * at.curvature / (1.0 + 3.0 * at.curvature) * at.direction


def _cornering(at: Journey, p: Mapping[str, float], _: Array) -> Array:
    side = at.drive.weight / G * np.abs(at.speed * at.drive.yaw_rate)
    return at.sheet["track.sprocket_radius"] * side * np.tan(p["compliance"] * side) * at.direction


def _viscous_bearing(at: Journey, p: Mapping[str, float], _: Array) -> Array:
    warm = at.lagged(at.drive.ambient + p["rise"] * at.travel**0.9, p["seconds"], float(at.drive.ambient[0]))
    thin = np.exp(p["activation"] * (1.0 / (warm + KELVIN) - 1.0 / (20.0 + KELVIN)))
    return p["coefficient"] * at.travel**0.6 * thin * at.direction


def _headwind(at: Journey, p: Mapping[str, float], _: Array) -> Array:
    drag = 0.5 * at.sheet["chassis.air_density"] * at.sheet["chassis.drag_coefficient"] * at.sheet["chassis.frontal_area"]
    gusts = 1.0 + 0.25 * np.sin(np.arange(len(at.speed)) * at.step / 37.0) * np.cos(np.arange(len(at.speed)) * at.step / 11.0)
    through = at.speed + p["wind"] * gusts * np.cos(at.drive.heading - p["towards"])
    return np.asarray(at.sheet["track.sprocket_radius"] * drag * (through * np.abs(through) - at.speed * at.travel))


def _lug_friction(at: Journey, p: Mapping[str, float], torque: Array) -> Array:
    tension = at.sheet["track.belt.pretension"] * at.sheet.assemblies * at.sheet["track.sprocket_radius"]
    return (p["of_tension"] * tension + p["of_torque"] * np.sqrt(torque**2 + 200.0**2)) * at.direction


def _roadwheel_tyres(at: Journey, p: Mapping[str, float], _: Array) -> Array:
    warm = at.lagged(at.drive.ambient + p["rise"] * at.travel**0.9, p["seconds"], float(at.drive.ambient[0]))
    return p["torque"] * at.load**1.3 * np.exp(p["activation"] * (1.0 / (warm + KELVIN) - 1.0 / 293.15)) * at.direction


def _warmup(at: Journey, p: Mapping[str, float], _: Array) -> Array:
    cold = 1.0 - at.lagged((at.travel > 0.3).astype(float), p["seconds"], 0.0)
    return p["torque"] * (0.7 * cold + 0.3 * cold**2) * at.direction


PHENOMENA: dict[str, Adds] = {
    "grade": lambda at, p, _: at.climbing(p["grade"]),
    "grade_profile": _grade_profile,
    "turning_scrub": _turning_scrub,
    "cornering": _cornering,
    "viscous_bearing": _viscous_bearing,
    "stribeck": lambda at, p, _: (p["constant"] + p["breakaway"] / (1.0 + (at.travel / p["speed"]) ** 2)) * at.direction,
    "headwind": _headwind,
    "roadwheel_tyres": _roadwheel_tyres,
    "soft_ground": lambda at, p, _: p["torque"] * (0.9 * at.load ** p["power"] + 0.1) * at.direction,
    "vibration": lambda at, p, _: p["torque"] * np.exp(-0.5 * ((at.travel - p["speed"]) / p["width"]) ** 2) * at.direction,
    "warmup": _warmup,
    "lug_friction": _lug_friction,
    **TOWN_PHENOMENA,
}
"""Additional torques; the others act in the belt, on the drive train or in a sensor."""


POSITION = ("latitude_deg", "longitude_deg")
RESTING_MPS = 1e-3  # a standing encoder gives no counts
HEAVY_TAILS = 5.0  # degrees of freedom of the torque's white noise
EARTH_M, LATITUDE_DEG, LONGITUDE_DEG = 6_371_000.0, 48.0, 9.0  # radius, and where the towns are
SECOND_S, MINUTE_S = 1.0, 60.0  # between positions; correlation length of their error
# Errors of any instrument, which are no finding: less than a hidden `delay`, `torque_offset` or `torque_gain` adds.
SPEED_STEPS_MPS = (0.02, 0.05)
MOST_LAG_S, MOST_OFFSET_NM, MOST_GAIN = 0.1, 15.0, 0.005
LOST_S, SEEN_S = (20.0, 60.0), 900.0  # how long narrow streets hide the satellites, and for how long they are seen in the mean


@dataclass(frozen=True)
class Sensors:
    """Quality of the instruments, recorded channels, and roughness of the road."""

    torque_nm: float = 30.0
    torque_share: float = 0.01  # of the torque
    torque_step_nm: float = 5.0
    road: float = 0.0005  # slope that no one measured, standard deviation
    road_m: float = 30.0  # over which it changes
    torque_lag_s: float = 0.0  # of first order, as of a filter
    torque_offset_nm: float = 0.0
    torque_gain: float = 1.0
    speed_mps: float = 0.01
    speed_step_mps: float = 0.02
    dropouts: float = 0.002  # share of samples, in bursts
    ambient_off_k: float = 0.0  # of the air's temperature: sun, exhaust
    belt_measured: bool = True
    load_measured: bool = True
    every_s: float = 0.0  # between rows; as often as is simulated where it is less than that
    position_m: float = 5.0  # standard deviation of the slowly varying error; in towns
    position_white_m: float = 1.0
    altitude_m: float = 4.0
    altitude_white_m: float = 0.5


def drawn_sensors(rng: np.random.Generator, belt_measured: bool = False) -> Sensors:
    """Good instruments, each with a lag, an offset and a gain of its own."""
    return Sensors(
        belt_measured=belt_measured,
        speed_step_mps=float(rng.uniform(*SPEED_STEPS_MPS)),
        torque_lag_s=float(rng.uniform(0.0, MOST_LAG_S)),
        torque_offset_nm=float(rng.uniform(-MOST_OFFSET_NM, MOST_OFFSET_NM)),
        torque_gain=float(1.0 + rng.uniform(-MOST_GAIN, MOST_GAIN)),
    )


def record(
    path: Path, drive: SealedDrive, truth: TruthRun, sensors: Sensors, radius: float, start_s: float, rng: np.random.Generator
) -> None:
    """Write one recording."""
    n = len(drive)
    white = rng.standard_t(HEAVY_TAILS, n) * np.sqrt((HEAVY_TAILS - 2.0) / HEAVY_TAILS)
    torque = truth.shown + road_slopes(drive, sensors, rng) * drive.weight * radius
    torque = sensors.torque_gain * lagging(torque, sensors.torque_lag_s, drive.step) + sensors.torque_offset_nm
    torque = torque + white * (sensors.torque_nm + sensors.torque_share * np.abs(truth.shown) + 20.0 * np.abs(drive.accel))
    torque = np.round(torque / sensors.torque_step_nm) * sensors.torque_step_nm
    speed = drive.speed + rng.normal(0.0, sensors.speed_mps, n)
    speed = np.round(speed / sensors.speed_step_mps) * sensors.speed_step_mps
    speed = np.where(np.abs(drive.speed) < RESTING_MPS, 0.0, speed)
    columns: dict[str, Array] = {
        "time_s": np.asarray(start_s + np.arange(n) * drive.step),
        "speed_mps": speed,
        "weight_n": drive.weight,
        "ambient_degc": np.round(drive.ambient + sensors.ambient_off_k, 1),
        "yaw_rate_radps": drive.yaw_rate + rng.normal(0.0, 0.003, n),
        "heading_rad": drive.heading,
        "torque_nm": np.where(_bursts(n, sensors.dropouts, rng), np.nan, torque),
    }
    if drive.slope is not None:
        columns["grade"] = drive.slope
    if sensors.belt_measured:
        columns["belt_degc"] = truth.belt + rng.normal(0.0, 0.4, n)
    if not sensors.load_measured:
        del columns["weight_n"]
    if drive.street is not None:
        del columns["heading_rad"]  # a compass among cars and tracks is useless
        columns |= _in_town(drive.street, drive.step, sensors, rng)
    every = max(1, round(sensors.every_s / drive.step))
    rows = np.column_stack(list(columns.values()))[::every]
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(columns) + "\n")
        np.savetxt(file, rows, delimiter=",", fmt=["%.8f" if name in POSITION else "%.5f" for name in columns])


def _in_town(street: OnStreet, step: float, sensors: Sensors, rng: np.random.Generator) -> dict[str, Array]:
    """Samples of a satellite receiver, one per second, and of a brake switch."""
    n, per_sample = len(street.x), round(SECOND_S / step)
    known = (np.arange(n) % per_sample == 0) & ~street.covered & ~_lost(n, step, rng)

    def shown(series: Array, drift: float, white: float) -> Array:
        return np.where(known, series + wandering(n, step, drift, rng) + rng.normal(0.0, white, n), np.nan)

    x, y = (shown(series, sensors.position_m, sensors.position_white_m) for series in (street.x, street.y))
    parallel_m = EARTH_M * np.cos(np.radians(LATITUDE_DEG))
    return {
        POSITION[0]: LATITUDE_DEG + np.degrees(y / EARTH_M),
        POSITION[1]: LONGITUDE_DEG + np.degrees(x / parallel_m),
        "altitude_m": shown(400.0 + street.height, sensors.altitude_m, sensors.altitude_white_m),
        "brake_on": (street.brakes > 0.0).astype(float),
    }


def wandering(n: int, step: float, std: float, rng: np.random.Generator) -> Array:
    """An error that varies within a minute."""
    keep = np.exp(-step / MINUTE_S)
    shocks = rng.normal(0.0, std * np.sqrt(1.0 - keep**2), n)
    return np.asarray(lfilter([1.0], [1.0, -keep], shocks, zi=[keep * rng.normal(0.0, std)])[0])


def _lost(n: int, step: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    output, i = np.zeros(n, dtype=bool), int(rng.exponential(SEEN_S) / step)
    while i < n:
        held = int(rng.uniform(*LOST_S) / step)
        output[i : i + held] = True
        i += held + int(rng.exponential(SEEN_S) / step)
    return output


def lagging(series: Array, seconds: float, step: float) -> Array:
    """Output of a first-order filter for a piecewise linear series; it starts settled."""
    if seconds < 1e-3 * step:
        return series
    keep = np.exp(-step / seconds)
    new = 1.0 - seconds / step * (1.0 - keep)  # of the newest sample; the rest is of the one before
    output, _ = lfilter([new, 1.0 - keep - new], [1.0, -keep], series, zi=[(1.0 - new) * series[0]])
    return np.asarray(output)


def road_slopes(drive: SealedDrive, sensors: Sensors, rng: np.random.Generator) -> Array:
    """Slope over distance that comes and goes."""
    keep = np.exp(-np.abs(drive.speed) * drive.step / sensors.road_m)
    shocks = rng.normal(0.0, 1.0, len(drive)) * np.sqrt(1.0 - keep**2)
    output, time_now = np.empty(len(drive)), rng.normal()
    for i in range(len(drive)):
        time_now = keep[i] * time_now + shocks[i]
        output[i] = time_now
    return sensors.road * output


def _bursts(n: int, share: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    output = np.zeros(n, dtype=bool)
    for begin in rng.integers(0, n, rng.poisson(share * n / 10.0)):
        output[begin : begin + rng.integers(3, 18)] = True
    return output
