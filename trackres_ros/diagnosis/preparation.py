# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The first stage: recordings come in; sessions with fitted and hold-out laps go out, with the candidate effects."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from trackres_ros.diagnosis.base.base import Base
from trackres_ros.diagnosis.base.instrument import usual_offset
from trackres_ros.diagnosis.base.loading import LoadedBase
from trackres_ros.diagnosis.prepare.checks import Refusal
from trackres_ros.diagnosis.prepare.gate import Gated, gate, on_route, with_fewer_steps
from trackres_ros.diagnosis.prepare.session import Array, DriveSession, Mask, SensorFinding, Split, split_laps
from trackres_ros.diagnosis.prepare.torque_checks import aligned_clock, check_torque, faulty_torques, inconsistent_scale_notes
from trackres_ros.effects import catalogue
from trackres_ros.effects.effect import Effect
from trackres_ros.effects.sensor.torque_offset import TorqueOffset
from trackres_ros.effects.vehicle.rotating_inertia import RotatingInertia
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.roles import Conversion
from trackres_ros.recording.slopes import runs_of
from trackres_ros.recording.topics_files import line_to_write
from trackres_ros.text import figures
from trackres_ros.units import STANDSTILL_MPS


@dataclass(frozen=True, eq=False)
class DiagnosisOptions:
    """Options of a diagnosis."""

    hide: Sequence[str] = ()  # roles that are not read
    holdout: int | Sequence[str] | None = None  # see `session.split`
    seed: int = 1  # of all random draws: equal seeds give equal results
    quick: bool = False  # fewer draws
    effects_dir: Path | None = None  # folder with user effects
    keep_suspected: bool = False  # keep effects that fit but are not confirmed on hold-out laps
    on_stage: Callable[[str], None] = lambda _: None  # callback with the name of each stage
    unread: Sequence[Refusal] = ()  # recordings that could not be read


BY_DEFAULT = DiagnosisOptions()


LEAST_S = 60.0  # of stops with a reading of zero, or of one other value
FEWEST_STOPS, ALIKE = 2.0, 0.25  # with one other value, as many as equally long ones; and their spread over it


@dataclass(frozen=True, eq=False)
class PreparedSessions:
    """Sessions to diagnose, with their base and candidate effects."""

    vehicle: LoadedBase
    gated: Gated  # sessions that passed the gate
    split: Split
    nominal: tuple[Array, ...]  # torque of each session with the values of the vehicle file [Nm]
    recorded: tuple[DriveSession, ...]  # the sessions without values from a route
    effects: Mapping[str, Effect]  # candidates

    @property
    def base(self) -> Base:
        """The model of the vehicle."""
        return self.vehicle.base

    @property
    def sessions(self) -> tuple[DriveSession, ...]:
        """The sessions that passed the gate."""
        return self.gated.sessions


def prepare(recordings: Sequence[Recording], vehicle: LoadedBase, options: DiagnosisOptions) -> PreparedSessions:
    """Check, clean and split recordings."""
    base, facts = vehicle.base, vehicle.base.facts
    options.on_stage("checks: units, clocks, gaps")
    gate_result, nominal, recorded_sessions = checked_sessions(recordings, vehicle, options.hide, options.unread)
    effects_by_name = catalogue(options.effects_dir, facts.weight * facts.radius, on_tyres=not base.has_belt)
    effects = {
        name: effect.beyond(base.rotating_mass_factor) if isinstance(effect, RotatingInertia) else effect
        for name, effect in effects_by_name.items()
        if effect.only_of in ("", "rolls" if base.rolls else "slides") and (vehicle.known.is_vehicle or not effect.of_belts)
    }
    gate_result, base, effects = remove_offset(gate_result, base, effects)
    vehicle = replace(vehicle, base=base)
    return PreparedSessions(
        vehicle, gate_result, split_laps(gate_result.sessions, options.holdout), nominal, recorded_sessions, effects
    )


def remove_offset(gate_result: Gated, base: Base, effects: Mapping[str, Effect]) -> tuple[Gated, Base, dict[str, Effect]]:
    """Remove a sensor offset from the candidate effects, and from the base's instrument, if the torque sensor reads zero at rest
    for long; with a note. If all stops have another common reading, only a warning is noted.
    """
    limit = usual_offset(base)
    seconds = seconds_without_torque(gate_result.sessions, limit)
    if not seconds or TorqueOffset.name not in effects:
        warning = "" if seconds else _offset_at_rest(gate_result.sessions, limit, base.torque_scale)
        return replace(gate_result, notes=(*gate_result.notes, *filter(None, [warning]))), base, dict(effects)
    note = f"the torque is 0 Nm at rest, within {figures(limit)} Nm over {seconds:.0f} s: the sensor has no offset"
    corrected_base = copy.copy(base)
    corrected_base.includes = (*base.includes, TorqueOffset.name)  # so no fit adds one
    return (
        replace(gate_result, notes=(*gate_result.notes, note)),
        corrected_base,
        {n: e for n, e in effects.items() if n != TorqueOffset.name},
    )


def seconds_without_torque(sessions: Sequence[DriveSession], largest_torque: float) -> float:
    """Total time at rest with a measured torque of at most `largest_torque` [Nm], thus zero [s]; 0 where too short to decide.

    At other stops a slope may hold a torque, or a start is near.
    """
    seconds = sum(seconds for seconds, torque in _stops(sessions) if abs(torque) <= largest_torque)
    return seconds if seconds >= LEAST_S else 0.0


def _offset_at_rest(sessions: Sequence[DriveSession], largest_torque: float, scale: float) -> str:
    """Note on a torque of more than `largest_torque` [Nm] at which all stops agree, with the line that corrects it; empty without
    one.

    The sensor shows `scale` times the torque.
    """
    stops = np.array(_stops(sessions)).reshape(-1, 2)
    seconds, torque = stops.T
    if seconds.sum() < LEAST_S or seconds.sum() ** 2 < FEWEST_STOPS * (seconds**2).sum():
        return ""
    mean = float(np.average(torque, weights=seconds))
    spread = math.sqrt(float(np.average((torque - mean) ** 2, weights=seconds)))
    if abs(mean) <= largest_torque or spread > ALIKE * abs(mean):
        return ""
    reading = figures(scale * mean)
    line = line_to_write("torque", Conversion(offset=-float(reading)), *(s.bindings for s in sessions))
    statement = f"the torque is {reading} Nm at rest, alike in {len(stops)} stops of {seconds.sum():.0f} s together"
    offset = "if neither a slope, a load nor a brake holds it, the sensor has an offset"
    return SensorFinding(f"{statement}; {offset}; {line}", f"T{statement[1:]}", TorqueOffset.name, scale * mean)


def _stops(sessions: Sequence[DriveSession]) -> list[tuple[float, float]]:
    """Time of each stop with a measured torque [s], and the median of its readings [Nm]."""
    stops = []
    for session in sessions:
        is_still = np.abs(session.speed) < STANDSTILL_MPS
        is_stop = (
            is_still & np.roll(is_still, 1) & np.roll(is_still, -1) & _has_torque_sample(session)
        )  # no part of a start within the step
        is_stop[[0, -1]] = False
        for begin, end in runs_of(is_stop):
            stops.append((session.step * (end - begin), float(np.median(session.torque[begin:end]))))
    return stops


def _has_torque_sample(session: DriveSession) -> Mask:
    """Steps that contain a torque sample."""
    if session.torque_course is None:
        return np.zeros(len(session), dtype=bool)
    edges = np.append(session.time, session.time[-1] + session.step)
    return np.asarray(np.histogram(session.torque_course.times, edges)[0] > 0)


def checked_sessions(
    recordings: Sequence[Recording], vehicle: LoadedBase, hide: Sequence[str] = (), refusals: Sequence[Refusal] = ()
) -> tuple[Gated, tuple[Array, ...], tuple[DriveSession, ...]]:
    """Sessions that passed the gate and the torque checks, their torque from the vehicle file [Nm], and the same sessions
    without values from a route.

    If only some recordings have a plainly wrong torque, these are dropped, else that is an error. The gate then runs again
    on the rest, because a recording also sets the belt temperature at the start of the next one.
    """

    def by_file(sessions: Sequence[DriveSession]) -> list[Array]:
        return [p.torque for p in vehicle.base.predict(sessions, vehicle.base.nominal, ())]

    refusals = list(refusals)
    while True:
        gate_result = gate(recordings, vehicle.known, hide, refusals)
        routed_result = on_route(gate_result, vehicle.route, vehicle.base.acting)
        model_torques = by_file(routed_result.sessions)
        alignments = [aligned_clock(s, e) for s, e in zip(routed_result.sessions, model_torques, strict=True)]
        sessions = tuple(s for s, _ in alignments)
        resistances = by_file([replace(s, accel=np.zeros(len(s))) for s in sessions])
        settings = replace(vehicle.known, torque_share=vehicle.base.share_limits(sessions) or vehicle.known.torque_share)
        faults = faulty_torques(sessions, model_torques, resistances, settings)
        if not faults:
            break
        refusals += faults
    doubts = check_torque(sessions, model_torques, resistances, settings)
    clock_notes = [note for _, note in alignments if note]
    notes = (*routed_result.notes, *clock_notes, *doubts, *inconsistent_scale_notes(sessions, model_torques, settings.is_vehicle))
    corrected_result = with_fewer_steps(routed_result, sessions, "torque lost by the correction of its clock")
    return replace(corrected_result, notes=notes), tuple(model_torques), gate_result.sessions
