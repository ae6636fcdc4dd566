# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Diagnoses of an hour at 100 Hz, with the share of each stage, and of three drives; a fit against one on scipy's solve_ivp."""

from __future__ import annotations

import functools
import math
import re
import tempfile
import time
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from measuring import alternated, at_least, at_most, median_ratio
from scipy.integrate import solve_ivp

from trackres_ros.arrays import Array
from trackres_ros.building.kernel_source import built_in
from trackres_ros.diagnosis import DiagnosisOptions, diagnose, load_base, read_recordings
from trackres_ros.diagnosis.base.base import Acting, Predicted
from trackres_ros.diagnosis.base.track import TrackBase
from trackres_ros.diagnosis.inference.fitting import Problem, fit
from trackres_ros.diagnosis.prepare.gate import gate
from trackres_ros.effects import Active, catalogue
from trackres_ros.estimator.columns import Assembly
from trackres_ros.evaluation.synthetic import drives, write_recordings
from trackres_ros.model.loss_table import look_up
from trackres_ros.model.rubber import log_shift_factor
from trackres_ros.units import GRAVITY, STANDSTILL_MPS

EFFECT = "viscous_bearing"
SEED = 2
REPEATS = 2
TOLERANCE = 1e-6
_STAGE = re.compile(r".*?(?= beside|[:,]|$)")
TARGETS = {
    "whole diagnosis of an hour at 100 Hz [s]": at_most(10),
    "whole diagnosis of three drives of 20 minutes at 10 Hz [s]": at_most(10),
    "fit with solve_ivp over fit": at_least(50),
    "largest difference of the two torques [%]": at_most(0.5),
}


def rate(
    t: float, temperature: float, step: float, speed: Array, log_load: Array, ambient: float,
    belt: Annotated[Array, (Assembly.columns,)], numbers: Array, table: Annotated[Array, (None, None, None)],
) -> float:  # fmt: skip
    """dT/dt [K/s] of one belt, its speed straight from sample to sample."""
    own = Assembly(belt)
    place = min(t / step, len(speed) - 1.000001)
    i = int(place)
    travel = abs(speed[i] + (place - i) * (speed[i + 1] - speed[i]))
    shift, _ = log_shift_factor(temperature, numbers[2], numbers[3], numbers[4])
    x = shift + (math.log10(travel) if travel > 1e-6 else -6.0)
    loss, _ = look_up(table, 0, numbers[0], numbers[1], own.first_log_load, own.step_log_load, x, log_load[i + 1])
    film = own.film_offset + own.film_slope * travel
    return float((loss * travel - film * own.area * (temperature - ambient)) / own.capacity)


@functools.cache
def _compiled_rate() -> Any:
    with tempfile.TemporaryDirectory() as folder:
        module = built_in(Path(folder), {"rate": rate})
    return rate if module is None else module.rate


class BySolveIvp(TrackBase):
    """The same base with the temperatures by scipy; of a vehicle with one kind of belt and without effects."""

    def predict(self, sessions: Any, values: Any, effects: Any) -> list[Predicted]:  # noqa: ARG002
        k = self._with(values, Acting.of((), self.facts), self._loads(sessions))
        n, belt, own = k.number, k.assembly[0], Assembly(k.assembly[0])
        numbers = np.array([n.first_x, n.step_x, n.glass_transition, n.wlf_c1, n.wlf_c2])
        found, compiled = [], _compiled_rate()
        for session in sessions:
            speed, log_load = session.speed, np.log(session.weight * own.share_of_all)
            ambient = float(session.ambient[0])
            arguments = (session.step, speed, log_load, ambient, belt, numbers, k.loss)
            solved = solve_ivp(
                lambda t, y, given=arguments: [compiled(t, y[0], *given)], (0.0, session.time[-1]), [ambient], "LSODA",
                session.time, rtol=TOLERANCE, atol=TOLERANCE, max_step=session.step,
            )  # fmt: skip
            degc = solved.y[0]
            loss = np.empty_like(degc)
            for i, one in enumerate(degc):
                shift, _ = log_shift_factor(one, *numbers[2:])
                x = shift + (math.log10(abs(speed[i])) if abs(speed[i]) > 1e-6 else -6.0)
                loss[i] = look_up(k.loss, 0, *numbers[:2], own.first_log_load, own.step_log_load, x, log_load[i])[0]
            sign = np.tanh(speed / STANDSTILL_MPS)
            force = len(self.vehicle.assemblies) * loss * sign + n.bearing_friction * session.weight * sign
            force += 0.5 * n.air_density * n.drag_area * speed * np.abs(speed)
            force += n.rotating_mass_factor * session.weight / GRAVITY * session.accel
            torque = self.facts.radius * force
            found.append(Predicted(torque, torque, degc, degc))
        return found


def run(minutes: float = 60.0, step_s: float = 0.01) -> dict[str, float]:
    """All numbers."""
    loaded = load_base("xgd24d")
    recordings, stages = _diagnosed(loaded, 1, minutes, step_s)
    whole = _lasted(stages)
    found = {"whole diagnosis of an hour at 100 Hz [s]": whole}
    _, of_three = _diagnosed(loaded, 3, minutes / 3.0, 0.1)
    found["whole diagnosis of three drives of 20 minutes at 10 Hz [s]"] = _lasted(of_three)
    shares: dict[str, float] = {}
    for (name, since), (_, after) in pairwise(stages):
        shares[name] = shares.get(name, 0.0) + after - since
    found |= {f"share of {name} [%]": 100.0 * s / whole for name, s in shares.items()}
    return found | _fits(loaded, gate(recordings, loaded.known, hide=["belt"]).sessions)


def _diagnosed(loaded: Any, count: int, minutes: float, step_s: float) -> tuple[Any, list[tuple[str, float]]]:
    """Recordings with an effect that is missing, and when each stage of their diagnosis began, with its end."""
    rng, effect = np.random.default_rng(SEED), catalogue()[EFFECT]
    with tempfile.TemporaryDirectory() as folder:
        sessions = drives(loaded.base, loaded.known.max_speed, count, minutes, rng, step_s)
        paths = write_recordings(loaded.base, Path(folder), sessions, [Active(effect, effect.values())], rng)
        stages = [("reading", time.perf_counter())]
        recordings = read_recordings(paths, None)

        def on_stage(stage: str) -> None:
            stages.append((_STAGE.match(stage)[0].rstrip(), time.perf_counter()))

        assert diagnose(recordings, loaded, DiagnosisOptions(seed=SEED, on_stage=on_stage)).verdict.sentence
    return recordings, [*stages, ("", time.perf_counter())]


def _lasted(stages: list[tuple[str, float]]) -> float:
    return stages[-1][1] - stages[0][1]


def _fits(loaded: Any, sessions: Any) -> dict[str, float]:
    masks = tuple(s.used for s in sessions)
    bases = {"ours": loaded.base, "solve_ivp": BySolveIvp(loaded.base.vehicle)}
    fits = {name: (lambda base=base: fit(Problem(base, sessions, masks), rounds=1)) for name, base in bases.items()}
    ends = {name: run_it() for name, run_it in fits.items()}  # compiled from here on
    times = alternated(fits, REPEATS)
    values = ends["ours"].base_values
    ours, theirs = (np.concatenate([p.torque for p in base.predict(sessions, values, ())]) for base in bases.values())
    return {
        "fit [ms]": 1e3 * min(times["ours"]),
        "fit with solve_ivp over fit": median_ratio(times["solve_ivp"], times["ours"]),
        "largest difference of the two torques [%]": 100.0 * float(np.abs(ours - theirs).max() / np.abs(ours).max()),
    }
