# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A whole recording, temperatures and all torques: the estimator against LSODA, the paper's algorithm and a plain loop."""

from __future__ import annotations

import math
import statistics

import numpy as np
from bench_export import with_three_effects
from measuring import START_NS, alternated, at_least, at_most, median_ratio, seconds, uneven_loads
from numpy.typing import NDArray
from rivals import PaperAlgorithm, Road, by_odeint, by_odeint_each_sample, by_solve_ivp, limit, plain

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.model.track import with_methods
from trackres_ros.offline.simulate import SimulatedDrive, laps, ramp_and_hold
from trackres_ros.vehicle import load

Array = NDArray[np.float64]

DURATION_S, STEP_S = 2500.0, 0.01
REPEATS = 7
EXACT_SAMPLES = 200  # of the paper's algorithm, spread over the recording, scaled to all
RESTARTED_SAMPLES = 2000  # of the LSODA that starts anew at each sample, scaled to all
KMH = 1 / 3.6
LAP_SPEED_KMH, LAP_M, RAMP_S, STOP_S = 30.0, 2 * math.pi * 100.0, 15.0, 20.0  # section 3.2.2
HELD_KMH, HELD_RAMP_S = 50.0, 50.0  # section 4.2
SPEED_NOISE = 0.02  # m/s
AMBIENT_DEGC = 15.0
MOVING = 0.5  # m/s: torques are compared relatively above

TARGETS = {
    "laps: run over the limit": at_most(1.3),
    "laps: session with guards over the limit": at_most(2.5),
    "laps: run with three effects over without": at_most(2),
    "laps: session with three effects over without": at_most(2),
    "laps: LSODA (odeint) over run": at_least(30),
    "laps: LSODA (solve_ivp) over run": at_least(30),
    "held: LSODA (odeint) over run": at_least(30),
    "held: LSODA (solve_ivp) over run": at_least(30),
    "rainflow at each sample over run": at_least(10_000),
    "rainflow at each sample over session with guards": at_least(10_000),
    "spectral at each sample over run": at_least(10_000),
    "spectral at each sample over session with guards": at_least(10_000),
    "rainflow at each sample, largest difference of the torque [%]": at_most(0.3),
    "spectral at each sample, largest difference of the torque [%]": at_most(0.3),
    "LSODA, largest error of its torque [%]": at_most(0.1),
}


def _road(estimator: Estimator, drive: SimulatedDrive, noise: float) -> Road:
    speed = drive.speed + np.random.default_rng(1).normal(0.0, noise, len(drive.speed)) * (drive.speed > 0.0)
    return Road(drive.time_s, np.maximum(speed, 0.0), drive.acceleration.copy(), uneven_loads(estimator), AMBIENT_DEGC)


def _cut(drive: SimulatedDrive, duration_s: float) -> SimulatedDrive:
    count = int(round(duration_s / STEP_S)) + 1
    return SimulatedDrive(drive.time_s[:count], drive.speed[:count], drive.acceleration[:count])


def roads(estimator: Estimator, duration_s: float) -> dict[str, Road]:
    """The two drives: laps with a stop after each, with noise on the speed; and a speed that is reached and held."""
    one_lap_s = LAP_M / (LAP_SPEED_KMH * KMH) + RAMP_S + STOP_S
    lap_drive = laps(LAP_SPEED_KMH * KMH, LAP_M, math.ceil(duration_s / one_lap_s), RAMP_S, STOP_S, STEP_S)
    held = ramp_and_hold(HELD_KMH * KMH, HELD_RAMP_S, duration_s, STEP_S)
    return {"laps": _road(estimator, _cut(lap_drive, duration_s), SPEED_NOISE), "held": _road(estimator, held, 0.0)}


def by_run(estimator: Estimator, road: Road) -> Array:
    """Rows of results by `Estimator.run`; nominal shares of the load, as it takes only the whole weight."""
    state = estimator.cold_start(estimator.inputs(float(road.speed[0]), ambient=road.ambient))
    return estimator.run(state, road.time, road.speed, road.loads.sum(), road.ambient, road.acceleration)[1]


def by_session(estimator: Estimator, road: Road) -> Array:
    """Rows of results by `Session.handle_block`: through all guards, one load an assembly, an acceleration with each speed."""
    session = estimator.session()
    for name, newton in zip(estimator.assemblies, road.loads, strict=True):
        session.handle(session.channel(f"load/{name}"), START_NS, START_NS, float(newton))
    session.handle(at.AMBIENT, START_NS, START_NS, road.ambient)
    count = len(road.time)
    stamps = np.repeat(START_NS + np.round(road.time * 1e9).astype(np.int64), 2)
    channels = np.tile(np.array([at.ACCEL, at.SPEED], dtype=np.int16), count)
    return session.handle_block(channels, stamps, stamps, np.column_stack([road.acceleration, road.speed]).ravel()).rows


def _largest_percent(ours: Array, theirs: Array, moving: NDArray[np.bool_]) -> float:
    return float(100.0 * np.abs(ours[moving] / theirs[moving] - 1.0).max())


def _against_lsoda(estimator: Estimator, name: str, road: Road, repeats: int) -> dict[str, float]:
    p, moving = plain(estimator), road.speed > MOVING
    _, true = limit(p, road)
    rivals = {
        "run": lambda: by_run(estimator, road),
        "session": lambda: by_session(estimator, road),
        "limit": lambda: limit(p, road),
        "LSODA (odeint)": lambda: by_odeint(p, road),
        "LSODA (solve_ivp)": lambda: by_solve_ivp(p, road),
    }
    for rival in rivals.values():
        rival()
    times = alternated(rivals, repeats)
    result = {f"{name}: run, a sample [us]": 1e6 * statistics.median(times["run"]) / len(road.time)}
    for rival in ("LSODA (odeint)", "LSODA (solve_ivp)"):
        result[f"{name}: {rival} over run"] = median_ratio(times[rival], times["run"])
        result[f"{name}: {rival} over the limit"] = median_ratio(times[rival], times["limit"])
    result[f"{name}: run over the limit"] = median_ratio(times["run"], times["limit"])
    result[f"{name}: session with guards over the limit"] = median_ratio(times["session"], times["limit"])
    errors = [_largest_percent(solve(p, road)[1][:, 0], true[:, 0], moving) for solve in (by_odeint, by_solve_ivp)]
    result[f"{name}: LSODA, largest error of its torque [%]"] = max(errors)
    rows = by_session(estimator, road)
    ours = rows[:, at.Results.hysteresis_nm]
    result[f"{name}: session against the limit, largest difference [%]"] = _largest_percent(ours, true[:, 0], moving)
    return result


def _with_effects(estimator: Estimator, road: Road, repeats: int) -> dict[str, float]:
    """Three effects, with the ranges that a diagnosis writes, over none."""
    loaded = Estimator(with_three_effects(estimator.vehicle))
    rivals = {
        "run": lambda: by_run(estimator, road),
        "run with effects": lambda: by_run(loaded, road),
        "session": lambda: by_session(estimator, road),
        "session with effects": lambda: by_session(loaded, road),
    }
    for rival in rivals.values():
        rival()
    times = alternated(rivals, repeats)
    return {
        f"laps: {way} with three effects over without": median_ratio(times[f"{way} with effects"], times[way])
        for way in ("run", "session")
    }


def _against_restarted(estimator: Estimator, road: Road, samples: int) -> float:
    """LSODA started anew at every sample over our run, by time a sample."""
    part = Road(road.time[:samples], road.speed[:samples], road.acceleration[:samples], road.loads, road.ambient)
    p = plain(estimator)
    theirs = seconds(lambda: by_odeint_each_sample(p, part)) / len(part.time)
    return theirs / (seconds(lambda: by_run(estimator, road)) / len(road.time))


def _against_paper(method: str, road: Road, samples: int) -> dict[str, float]:
    """The paper's algorithm at samples spread over the recording, each from our own state one sample before."""
    estimator = Estimator(with_methods(load("xgd24d"), method))
    algorithm = PaperAlgorithm(estimator, road)
    rows = by_session(estimator, road)
    belts = rows[:, len(at.VEHICLE_COLUMNS) + at.OfAssembly.belt_degc :: len(at.ASSEMBLY_COLUMNS)]
    moving = 1 + np.flatnonzero(road.speed[1:] > MOVING)
    chosen = moving[np.linspace(0, len(moving) - 1, min(samples, len(moving))).astype(int)]
    algorithm.sample(int(chosen[0]), belts[chosen[0] - 1], 0.0)
    spent, ours_spent, session_spent, worst = [], [], [], 0.0
    for place, n in enumerate(chosen.tolist()):
        out = []
        spent.append(
            seconds(lambda n=n, out=out: out.append(algorithm.sample(n, belts[n - 1], rows[n - 1, at.Results.drive_torque_nm])))
        )
        theirs = out[0][1][:3].sum()
        worst = max(worst, abs(rows[n, at.Results.resistance_torque_nm] / theirs - 1.0))
        if place % max(samples // REPEATS, 1) == 0:
            ours_spent.append(seconds(lambda: by_run(estimator, road)) / len(road.time))
            session_spent.append(seconds(lambda: by_session(estimator, road)) / len(road.time))
    return {
        f"{method} at each sample, one sample [ms]": 1e3 * statistics.median(spent),
        f"{method} at each sample over run": statistics.median(spent) / statistics.median(ours_spent),
        f"{method} at each sample over session with guards": statistics.median(spent) / statistics.median(session_spent),
        f"{method} at each sample, largest difference of the torque [%]": 100.0 * worst,
    }


def run(
    duration_s: float = DURATION_S, repeats: int = REPEATS, exact_samples: int = EXACT_SAMPLES, restarted: int = RESTARTED_SAMPLES
) -> dict[str, float]:
    """Measure a recording of a length [s] at 100 Hz; the median of repeats counts.

    The paper's algorithm is timed at `exact_samples`, the LSODA that starts anew each time at so many samples.
    """
    estimator = Estimator(load("xgd24d"))
    result: dict[str, float] = {}
    drives = roads(estimator, duration_s)
    for name, road in drives.items():
        result |= _against_lsoda(estimator, name, road, repeats)
    result["LSODA, largest error of its torque [%]"] = max(
        result.pop(f"{name}: LSODA, largest error of its torque [%]") for name in drives
    )
    result |= _with_effects(estimator, drives["laps"], repeats)
    result["laps: LSODA started anew at each sample over run"] = _against_restarted(estimator, drives["laps"], restarted)
    for method in ("rainflow", "spectral"):
        result |= _against_paper(method, drives["laps"], exact_samples)
    return result
