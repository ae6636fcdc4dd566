# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Step 0 of the diagnosis: recordings come in; evenly spaced sessions with numbered laps and the rejected samples go out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trackres_ros.diagnosis.prepare.altitude import with_slope
from trackres_ros.diagnosis.prepare.brakes import motor_brakes_alone
from trackres_ros.diagnosis.prepare.clocks import on_one_clock
from trackres_ros.diagnosis.prepare.laps import lap_numbers
from trackres_ros.diagnosis.prepare.order import in_order
from trackres_ros.diagnosis.prepare.refuse import (
    EARLIEST_CLOCK_S,
    SHORTEST_S,
    Refusal,
    check_compared,
    check_speed,
    duration_s,
    each_usable,
    nothing_left,
    refuse_overlaps,
)
from trackres_ros.diagnosis.prepare.resample import is_hidden, resample, step_for
from trackres_ros.diagnosis.prepare.session import DriveSession, Mask
from trackres_ros.diagnosis.prepare.settings import SLOWEST_MPS, STEP_S, GateSettings, pace
from trackres_ros.diagnosis.prepare.usable import BRAKES_ON, is_slow, usable
from trackres_ros.errors import InputError
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.roles import base_role
from trackres_ros.recording.wheels import wheel_notes

LEFT_OUT = "in recordings that are left out"
SLOWER = 5.0  # times the step of half of the driving: slower recordings would blur the others
LONGEST_STEP_S = 60.0  # speed and torque vary within it, so their means hardly show inertia
SHORTEST_MOVING_S = 60.0
LONGEST_BREAK_S = 7 * 86400.0  # between recordings with continuous clocks
CLOCK_OFF_S = 60.0  # most by which a given standing time may be shorter than the clocks' without a conflict


@dataclass(frozen=True, slots=True)
class Exclusion:
    """Excluded time [s], and the reason."""

    reason: str
    seconds: int


@dataclass(frozen=True, eq=False)
class Gated:
    """Recordings that passed the checks.

    Attributes
    ----------
    sessions
        One for each used recording.
    left_out
        Exclusions, by reason.
    notes
        Assumptions, one sentence each.
    """

    sessions: tuple[DriveSession, ...]
    left_out: tuple[Exclusion, ...]
    notes: tuple[str, ...]


def gate(
    recordings: Sequence[Recording], settings: GateSettings, hide: Sequence[str] = (), refused: Sequence[Refusal] = ()
) -> Gated:
    """Check recordings and resample them to an even grid; unusable ones are skipped with a note.

    Parameters
    ----------
    recordings
        In any order; see `in_order`.
    settings
        Of the vehicle.
    hide
        Roles that are not read.
    refused
        Recordings rejected before the gate.

    Returns
    -------
    Gated
        Sessions of one step, cut into laps; exclusions, and assumptions.

    Raises
    ------
    InputError
        If no recording can be used, or too little of all of them, with reasons and remedies.
    """
    refused, given, overlaps = list(refused), in_order(recordings), list[str]()
    known = {one.name for one in refused}
    admitted = each_usable(
        (r for r in given if r.name not in known), lambda recording: _admitted(recording, hide, settings), refused
    )
    step, admitted = _of_one_step(admitted, refused, settings)
    resampled = each_usable(admitted, lambda one: _resampled(one, step, settings), refused)
    refuse_overlaps([one.recording for one in resampled], overlaps)
    not_recorded = settings.friction_brakes and not all("brake" in one.session.given for one in resampled)
    alone = _motor_brakes_alone(resampled, settings, overlaps) if not_recorded and resampled else 0.0
    checked = [_checked(one, settings, alone) for one in resampled]
    seconds = [one.compared_s for one in checked]
    shortest = SHORTEST_MOVING_S * pace(step)
    if max(seconds, default=0.0) >= shortest or sum(seconds) < shortest:
        checked = each_usable(checked, _enough, refused)
    if not checked:
        raise nothing_left(refused)
    left_out = sum((one.left_out for one in checked), Counter[str]())
    unused = [r for r in given if r.name in {one.name for one in refused}]
    left_out[LEFT_OUT] = sum(int(duration_s(r.series)) for r in unused)
    notes = [f"{one.name}: not used: {one.reason}" for one in refused] + overlaps
    if step < STEP_S:
        notes.append(
            f"the speed changes quickly, so torques are compared as means over {step:g} s instead of {STEP_S:g} s; pieces, "
            "gaps and other times shrink by the same factor"
        )
    if step > STEP_S:
        notes.append(f"samples are sparse, so torques are compared as means over {step:.0f} s")
    sessions = _one_after_another(checked, [r for r in unused if _drove(r)], notes)
    return Gated(tuple(sessions), tuple(Exclusion(reason, n) for reason, n in left_out.items() if n), tuple(notes))


@dataclass(frozen=True, eq=False)
class _Admitted:
    """A recording on one clock without hidden roles, its standing time before [s], and notes."""

    recording: Recording
    stood: float
    notes: list[str]

    @property
    def name(self) -> str:
        return self.recording.name


@dataclass(frozen=True, eq=False)
class _Resampled(_Admitted):
    """The recording on an even grid, and its excluded time."""

    session: DriveSession
    unknown: Mapping[str, Mask]
    left_out: Counter[str]

    @property
    def compared_s(self) -> float:
        return float(self.session.used.sum()) * self.session.step


def _admitted(recording: Recording, hide: Sequence[str], settings: GateSettings) -> _Admitted:
    recording = replace(recording, series={role: s for role, s in recording.series.items() if not is_hidden(role, hide)})
    shortest_s = SHORTEST_S * pace(step_for([recording], slowest_speed=settings.slowest))
    check_compared(recording.name, recording.series, shortest_s, recording.torque_candidates)
    recording, notes = on_one_clock(recording)
    check_compared(recording.name, recording.series, shortest_s, recording.torque_candidates)
    return _Admitted(recording, _stood(recording), notes)


def _of_one_step(admitted: Sequence[_Admitted], refused: list[Refusal], settings: GateSettings) -> tuple[float, list[_Admitted]]:
    """Common step [s], and the recordings that suit it: those with far slower sampling are excluded."""
    own = {one.name: step_for([one.recording], slowest_speed=settings.slowest) for one in admitted}
    steps = sorted((own[one.name], duration_s(one.recording.series)) for one in admitted)
    half, so_far = 0.5 * sum(seconds for _, seconds in steps), 0.0
    longest = 0.0
    for step, seconds in steps:
        so_far += seconds
        longest = SLOWER * step
        if so_far > half:
            break

    def suits(one: _Admitted) -> _Admitted:
        step = own[one.name]
        given = f"samples so sparse that torques would be compared as means over {step:.0f} s"
        if step > LONGEST_STEP_S:
            raise InputError(one.name, given, f"at most {LONGEST_STEP_S:.0f} s", "record speed and torque more often")
        if step > longest:
            allowed = f"at most {longest:.0f} s together with the others"
            raise InputError(one.name, given, allowed, "diagnose it without the others")
        return one

    suited = each_usable(admitted, suits, refused)
    return step_for([one.recording for one in suited], slowest_speed=settings.slowest), suited


def _resampled(one: _Admitted, step: float, settings: GateSettings) -> _Resampled:
    session, unknown = resample(one.recording, step, settings, frozenset(), one.notes, SHORTEST_S * pace(step))
    check_speed(session, settings.max_speed)
    return _Resampled(one.recording, one.stood, one.notes, session, unknown, Counter())


def _checked(one: _Resampled, settings: GateSettings, alone: float) -> _Resampled:
    """The session with its mask of comparable samples, and a slope from its altitude."""
    session = replace(one.session, used=usable(one.session, one.unknown, settings, one.left_out, alone))
    if "brake" in session.given:
        one.notes.append(_of_brakes(session, one.unknown[BRAKES_ON], settings))
    session, of_slope = with_slope(session)
    one.notes.extend([of_slope] if of_slope else [])
    one.notes.extend(f"{session.name}: {note}" for note in _of_wheels(one.recording))
    return replace(one, session=session)


def _enough(one: _Resampled) -> _Resampled:
    shortest = SHORTEST_MOVING_S * one.session.pace
    if one.compared_s < shortest:
        given = f"{one.compared_s:.0f} s of driving with a torque; not used: {_listed(one.left_out) or 'nothing'}"
        remedy = "give a longer recording, or check units and topics"
        raise InputError(one.name, given, f"at least {shortest:.3g} s", remedy)
    return one


def _one_after_another(checked: Sequence[_Resampled], unused: Sequence[Recording], notes: list[str]) -> list[DriveSession]:
    """Sessions with consecutive lap numbers and standing times; `unused` are drives in between."""
    ends_ns = [r.start_ns + int(duration_s(r.series) * 1e9) for r in unused]
    sessions: list[DriveSession] = []
    block, end_ns, end_m = 0, None, 0.0
    for one in checked:
        session, begin_ns = one.session, one.recording.start_ns
        notes += one.notes
        follows = end_ns is not None and 0 <= begin_ns - end_ns <= LONGEST_BREAK_S * 1e9 and begin_ns > 0
        off = (begin_ns - end_ns) * 1e-9 if end_ns is not None and follows else np.inf
        since = [(begin_ns - end) * 1e-9 for end in ends_ns if 0 <= begin_ns - end <= LONGEST_BREAK_S * 1e9]
        stood = min(one.stood, *since, np.inf)
        if stood < off - CLOCK_OFF_S:
            session = replace(session, gap=stood, after_unseen=True)
            notes.append(
                f"{session.name}: it had stood for {stood:.0f} s, after an unrecorded drive that is assumed to "
                "have been like this one"
            )
        elif follows:
            session = replace(session, gap=off)
            notes.append(
                f"{session.name}: begins {session.gap:.0f} s after the previous one; the belt temperature is carried over"
            )
        else:
            notes.append(f"{session.name}: the belts start at ambient temperature")
        end_ns = begin_ns + int(session.time[-1] * 1e9)
        session = replace(session, block=lap_numbers(session) + block, distance=session.distance + end_m)
        block, end_m = int(session.block[-1]) + 1, float(session.distance[-1])
        sessions.append(session)
    return sessions


def _drove(recording: Recording) -> bool:
    """Whether an unused recording shows that the vehicle drove before another one."""
    if recording.start_ns * 1e-9 < EARLIEST_CLOCK_S or duration_s(recording.series) < SHORTEST_S:
        return False
    speed = recording.series["speed"].value
    return float(np.nanpercentile(np.abs(speed), 99.0)) > SLOWEST_MPS


def _of_brakes(session: DriveSession, on: Mask, settings: GateSettings) -> str:
    """Note on the time that remains without friction brakes."""
    drives = np.abs(session.speed) >= settings.slowest
    braked, driven, left, braking = (
        round(int(steps.sum()) * session.step)
        for steps in (drives & on, drives, session.used, session.used & (session.torque < 0.0))
    )
    return (
        f"{session.name}: brakes on in {braked} s of {driven} s driven; {left} s remain for comparison, {braking} of them with a "
        "braking torque"
    )


def _of_wheels(recording: Recording) -> list[str]:
    """Notes about the wheel speeds."""
    return wheel_notes(recording.aligned()) if any(base_role(role) == "wheel_speed" for role in recording.series) else []


def _stood(recording: Recording) -> float:
    """Recorded standing time before the drive [s]; infinite if unknown, or too long to matter.

    Raises
    ------
    InputError
        If it is negative.
    """
    series = recording.series.get("stood")
    given = series.value[np.isfinite(series.value)] if series is not None else np.empty(0)
    if not len(given):
        return np.inf
    if given[0] < 0.0:
        raise InputError(
            f"{recording.name}: stood", f"{given[0]:g} s", "0 s or more", "give the time since the previous drive ended"
        )
    return float(given[0]) if given[0] <= LONGEST_BREAK_S else np.inf


def _motor_brakes_alone(resampled: Sequence[_Resampled], settings: GateSettings, notes: list[str]) -> float:
    """Torque down to which the motor brakes alone [Nm]; adds the result to the notes."""
    compared = [~is_slow(one.session, settings) & ~np.any(list(one.unknown.values()), axis=0) for one in resampled]
    alone = motor_brakes_alone([one.session for one in resampled], compared)
    if alone < 0.0:
        notes.append(
            f"down to {alone:.0f} Nm the motor brakes alone, by the speed's changes; below that friction brakes may act too"
        )
    return alone


def _listed(left_out: Counter[str]) -> str:
    return ", ".join(f"{n} s {reason}" for reason, n in left_out.items() if n)
