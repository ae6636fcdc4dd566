"""A diagnosis of an hour at 100 Hz, with the share of each step; and a fit against the same fit on scipy's solve_ivp."""

from __future__ import annotations

import math
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from measuring import alternated, at_least, at_most, median_ratio
from scipy.integrate import solve_ivp

from trackres_ros.compiled import compiled
from trackres_ros.diagnosis import diagnose, load_base, read_recordings
from trackres_ros.diagnosis.base import full
from trackres_ros.diagnosis.fitting import Problem, fit
from trackres_ros.diagnosis.gate import gate
from trackres_ros.diagnosis.track_base import CAPACITY, FILM, LOSS, TrackBase
from trackres_ros.diagnosis.trial import drives, write_recordings
from trackres_ros.effects import Active, catalogue
from trackres_ros.model.loss_table import look_up
from trackres_ros.model.rubber import log_shift_factor

EFFECT = "viscous_bearing"
SEED = 2
REPEATS = 2
TOLERANCE = 1e-6
TARGETS = {
    "whole diagnosis of an hour at 100 Hz [s]": at_most(120),
    "fit with solve_ivp over fit": at_least(50),
    "largest difference of the two torques [%]": at_most(0.5),
}


@compiled
def rate(
    t: float, y: Any, step: float, speed: Any, log_load: Any, ambient: float, axes: Any, table: Any, rubber: Any, thermal: Any
) -> float:
    """dT/dt [K/s] of one belt."""
    i = min(int(t / step), len(speed) - 1)
    shift, _ = log_shift_factor(y[0], rubber[0], rubber[1], rubber[2])
    travel = abs(speed[i])
    x = shift + (math.log10(travel) if travel > 1e-6 else -6.0)
    loss, _ = look_up(table, 0, axes[0], axes[1], axes[2], axes[3], x, log_load[i])
    film = thermal[1] + thermal[2] * travel
    return float((loss * thermal[4] * travel - film * thermal[3] * (y[0] - ambient)) / thermal[0])


class BySolveIvp(TrackBase):
    """The same base with the temperatures by scipy."""

    def _roll(self, group: Any, session: Any, course: Any, values: Any, before: Any) -> Any:  # noqa: ARG002
        rubber, network = self.vehicle.rubber, group.network
        scale = values[LOSS] / rubber.loss_modulus_scale
        thermal = np.array(
            [
                network.capacity * values[CAPACITY],
                network.film_offset * values[FILM],
                network.film_slope * values[FILM],
                network.area,
                scale,
            ]
        )
        axes = np.array([group.table.first_x, group.table.step_x, group.table.first_log_load, group.table.step_log_load])
        constants = np.array([rubber.glass_transition, rubber.wlf_c1, rubber.wlf_c2])
        speed, log_load, ambient = full(course.at.speed, session), np.log(session.weight * group.share), float(session.ambient[0])
        table = group.table.loss[np.newaxis]
        solved = solve_ivp(
            lambda t, y: [rate(t, y, session.step, speed, log_load, ambient, axes, table, constants, thermal)],
            (0.0, session.time[-1]), [ambient], "LSODA", session.time, rtol=TOLERANCE, atol=TOLERANCE, max_step=session.step,
        )  # fmt: skip
        belt = solved.y[0]
        loss = np.empty_like(belt)
        for i, degc in enumerate(belt):
            shift, _ = log_shift_factor(degc, *constants)
            x = shift + (math.log10(abs(speed[i])) if abs(speed[i]) > 1e-6 else -6.0)
            loss[i] = scale * look_up(table, 0, *axes, x, log_load[i])[0]
        return loss, belt, belt, (float(belt[-1]), float(belt[-1]))


def run(minutes: float = 60.0, step_s: float = 0.01, quick: bool = False) -> dict[str, float]:
    """All numbers."""
    loaded, effects = load_base("xgd24d"), catalogue()
    rng = np.random.default_rng(SEED)
    found: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        sessions = drives(loaded.base, loaded.known.max_speed, 1, minutes, rng, step_s)
        paths = write_recordings(loaded.base, Path(folder), sessions, [Active(effects[EFFECT], effects[EFFECT].values())], rng)
        stages: list[tuple[str, float]] = [("reading", time.perf_counter())]
        recordings = read_recordings(paths, None)
        diagnosis = diagnose(
            recordings,
            loaded,
            seed=SEED,
            quick=quick,
            said=lambda stage: stages.append((stage.split(":")[0].split(",")[0], time.perf_counter())),
        )
        end = time.perf_counter()
    found["whole diagnosis of an hour at 100 Hz [s]"] = end - stages[0][1]
    shares: dict[str, float] = {}
    for (name, begin), (_, after) in zip(stages, [*stages[1:], ("", end)], strict=True):
        shares[name] = shares.get(name, 0.0) + after - begin
    found |= {f"share of {name} [%]": 100.0 * s / (end - stages[0][1]) for name, s in shares.items()}
    found |= _fits(loaded, gate(recordings, loaded.known, hide=["belt"]).sessions)
    assert diagnosis.verdict.sentence
    return found


def _fits(loaded: Any, sessions: Any) -> dict[str, float]:
    still, masks = tuple(np.zeros(len(s)) for s in sessions), tuple(s.used for s in sessions)
    bases = {"ours": loaded.base, "solve_ivp": BySolveIvp(loaded.base.vehicle)}
    fits = {name: (lambda base=base: fit(Problem(base, sessions, masks, still), rounds=1)) for name, base in bases.items()}
    ends = {name: run_it() for name, run_it in fits.items()}  # compiled from here on
    times = alternated(fits, REPEATS)
    values = ends["ours"].base_values
    ours, theirs = (np.concatenate([p.torque for p in base.predict(sessions, values, (), still)]) for base in bases.values())
    return {
        "fit [ms]": 1e3 * min(times["ours"]),
        "fit with solve_ivp over fit": median_ratio(times["solve_ivp"], times["ours"]),
        "largest difference of the two torques [%]": 100.0 * float(np.abs(ours - theirs).max() / np.abs(ours).max()),
    }
