# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Step 0 of the diagnosis: recordings in, evenly spaced sessions with numbered laps out, and what was left out of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trackres_ros.diagnosis.prepare.altitude import with_slope
from trackres_ros.diagnosis.prepare.brakes import motor_brakes_alone
from trackres_ros.diagnosis.prepare.laps import lap_numbers
from trackres_ros.diagnosis.prepare.refuse import check_speed, long_enough, refuse_overlaps
from trackres_ros.diagnosis.prepare.resample import is_hidden, resample, step_for
from trackres_ros.diagnosis.prepare.session import Mask, Session
from trackres_ros.diagnosis.prepare.settings import STEP_S, GateSettings
from trackres_ros.diagnosis.prepare.usable import BRAKES_ON, is_slow, usable
from trackres_ros.errors import InputError
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.roles import base_role
from trackres_ros.recording.wheels import wheel_notes

Resampled = tuple[Session, Mapping[str, Mask]]

SHORTEST_MOVING_S = 60.0
LONGEST_BREAK_S = 7 * 86400.0  # between recordings whose clocks run on
CLOCK_OFF_S = 60.0  # by which a standing time that is given may be shorter than clocks say, and still be the same


@dataclass(frozen=True, slots=True)
class LeftOut:
    """What is not compared [s], and why."""

    reason: str
    seconds: int


@dataclass(frozen=True, eq=False)
class Gated:
    """What passed the gate.

    Attributes
    ----------
    sessions
        One for each recording that is used.
    left_out
        What is not compared, by reason.
    notes
        What was assumed, one sentence each.
    """

    sessions: tuple[Session, ...]
    left_out: tuple[LeftOut, ...]
    notes: tuple[str, ...]


def gate(recordings: Sequence[Recording], settings: GateSettings, hide: Sequence[str] = ()) -> Gated:
    """Check recordings and put them on an even grid.

    Parameters
    ----------
    recordings
        In the order of their times.
    settings
        Of the vehicle.
    hide
        Roles that are not read.

    Returns
    -------
    Gated
        Sessions of one step, cut into laps; what was left out, and what was assumed.

    Raises
    ------
    InputError
        If there is no torque, or too little that can be used; says what to do.
    """
    left_out: Counter[str] = Counter()
    notes: list[str] = []
    sessions: list[Session] = []
    block = 0
    end_ns: int | None = None
    end_m = 0.0
    refuse_overlaps(recordings, notes)
    admitted = long_enough(recordings, left_out, notes)
    step = step_for(admitted)
    if step > STEP_S:
        notes.append(f"samples come so slowly that torques are compared as means over {step:.0f} s")
    resampled = [resample(recording, step, settings, frozenset(hide), notes) for recording in admitted]
    not_recorded = settings.friction_brakes and not all("brake" in session.given for session, _ in resampled)
    alone = _motor_brakes_alone(resampled, settings, notes) if not_recorded else 0.0
    for recording, (session, unknown) in zip(admitted, resampled, strict=True):
        session = replace(session, used=usable(session, unknown, settings, left_out, alone))
        if "brake" in session.given:
            notes.append(_of_brakes(session, unknown[BRAKES_ON], settings))
        session, of_slope = with_slope(session)
        notes += [of_slope] if of_slope else []
        notes += [f"{session.name}: {note}" for note in _of_wheels(recording, hide)]
        check_speed(session, settings.max_speed)
        begin_ns = recording.start_ns
        follows = end_ns is not None and 0 <= begin_ns - end_ns <= LONGEST_BREAK_S * 1e9 and begin_ns > 0
        off = (begin_ns - end_ns) * 1e-9 if end_ns is not None and follows else np.inf
        stood = _stood(recording, hide)
        if stood < off - CLOCK_OFF_S:
            session = replace(session, gap=stood, after_unseen=True)
            notes.append(
                f"{session.name}: it had stood for {stood:.0f} s, after a drive that is not among the recordings and is taken to "
                "have been like this one"
            )
        elif follows:
            session = replace(session, gap=off)
            notes.append(
                f"{session.name}: goes on {session.gap:.0f} s after the one before; the belt's temperature is carried over"
            )
        else:
            notes.append(f"{session.name}: starts soaked at the ambient temperature")
        end_ns = begin_ns + int(session.time[-1] * 1e9)
        laps = lap_numbers(session)
        session = replace(session, block=laps + block, distance=session.distance + end_m)
        block, end_m = int(session.block[-1]) + 1, float(session.distance[-1])
        sessions.append(session)
    seconds = sum(int(s.used.sum()) for s in sessions) * step
    if seconds < SHORTEST_MOVING_S:
        raise InputError(
            ", ".join(r.name for r in recordings),
            f"{seconds:.0f} s of driving with a torque; left out: {_listed(left_out) or 'nothing'}",
            f"at least {SHORTEST_MOVING_S:.0f} s",
            "give a longer recording, or look at units and topics",
        )
    return Gated(tuple(sessions), tuple(LeftOut(reason, n) for reason, n in left_out.items() if n), tuple(notes))


def _of_brakes(session: Session, on: Mask, settings: GateSettings) -> str:
    """What the brakes leave."""
    drives = np.abs(session.speed) >= settings.slowest
    braked, driven, left, braking = (
        round(int(steps.sum()) * session.step)
        for steps in (drives & on, drives, session.used, session.used & (session.torque < 0.0))
    )
    return (
        f"{session.name}: brakes on in {braked} s of {driven} s driven; {left} s are left to compare, {braking} of them with a "
        "torque that brakes"
    )


def _of_wheels(recording: Recording, hide: Sequence[str]) -> list[str]:
    """What wheel speeds show that are not hidden."""
    shown = [role for role in recording.series if not is_hidden(role, hide)]
    if not any(base_role(role) == "wheel_speed" for role in shown):
        return []
    held = recording.aligned()
    return wheel_notes({role: series for role, series in held.items() if not is_hidden(role, hide)})


def _stood(recording: Recording, hide: Sequence[str]) -> float:
    """How long it had stood before, as far as that was recorded [s]; infinite where it was not, or longer than counts.

    Raises
    ------
    InputError
        If it is negative.
    """
    series = recording.series.get("stood")
    given = series.value[np.isfinite(series.value)] if series is not None and "stood" not in hide else np.empty(0)
    if not len(given):
        return np.inf
    if given[0] < 0.0:
        raise InputError(
            f"{recording.name}: stood", f"{given[0]:g} s", "0 s or more", "give the time since the drive before ended"
        )
    return float(given[0]) if given[0] <= LONGEST_BREAK_S else np.inf


def _motor_brakes_alone(resampled: Sequence[Resampled], settings: GateSettings, notes: list[str]) -> float:
    """The torque down to which nothing but the motor brakes [Nm]; adds what was found to the notes."""
    compared = [~is_slow(session, settings) & ~np.any(list(unknown.values()), axis=0) for session, unknown in resampled]
    alone = motor_brakes_alone([session for session, _ in resampled], compared)
    if alone < 0.0:
        notes.append(
            f"down to {alone:.0f} Nm the motor brakes alone, as changes of speed show; below it friction brakes may help"
        )
    return alone


def _listed(left_out: Counter[str]) -> str:
    return ", ".join(f"{n} s {reason}" for reason, n in left_out.items() if n)
