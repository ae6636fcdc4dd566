# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Step 0 of the diagnosis: recordings come in; evenly spaced sessions with numbered laps and the rejected samples go out.

Sessions on a known route get the learned values of its places. A replay gets the acceleration that a diagnosis has, from the
speeds before and after, and is compared as a diagnosis compares: in means over its steps.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from trackres_ros.diagnosis.prepare.checks import (
    EARLIEST_CLOCK_S,
    SHORTEST_S,
    Refusal,
    check_compared,
    check_speed,
    duration_s,
    each_usable,
    nothing_left,
    pool_notes,
    refuse_overlaps,
    refuse_repeated,
)
from trackres_ros.diagnosis.prepare.resample import (
    BRAKES_ON,
    MOST_UNKNOWN,
    QUICK,
    STEADY,
    motor_brakes_alone,
    resample,
    smoothed_motion,
    step_for,
    widen,
)
from trackres_ros.diagnosis.prepare.session import (
    ALWAYS_KNOWN,
    MOST_LAGS,
    SLOWEST_MPS,
    STEP_S,
    Array,
    DriveSession,
    GateSettings,
    Mask,
    SensorFinding,
    WarningNote,
    Way,
    lap_numbers,
    pace,
    too_short_pieces,
    whole_past,
)
from trackres_ros.diagnosis.prepare.speed_smoothing import with_slope
from trackres_ros.diagnosis.prepare.torque_checks import at_sprockets, on_one_clock
from trackres_ros.effects.effect import Active
from trackres_ros.errors import InputError
from trackres_ros.estimator.columns import Results
from trackres_ros.estimator.records import Steps
from trackres_ros.recording.recording import Recording, with_stamps
from trackres_ros.recording.samples import Series, standing_time
from trackres_ros.route.learned import SLOPE, RouteMap
from trackres_ros.route.matching import match_tracks
from trackres_ros.route.track import track_of
from trackres_ros.text import number_of, some_of
from trackres_ros.units import SECOND_NS

UNUSED = "in recordings that are left out"
SLOWER = 5.0  # times the step of half of the driving: slower recordings would blur the others
LONGEST_STEP_S = 60.0  # speed and torque vary within it, so their means hardly show inertia
SHORTEST_MOVING_S = 60.0
FEWEST_STEPS = 2 * (MOST_LAGS + 1)  # of one run: as many to compare as the noise needs of their past
LONGEST_BREAK_S = 7 * 86400.0  # between recordings with continuous clocks
CLOCK_OFF_S = 60.0  # most by which a given standing time may be shorter than the clocks' without a conflict
SAME_SHARE = 1e-9  # of the largest torque: a rounding difference
LONGEST_STUCK_S = 30.0
BRAKING_MPS2 = -0.5  # at a torque that does not drive: friction brakes may act


@dataclass(frozen=True, eq=False)
class Gated:
    """Recordings that passed the checks."""

    sessions: tuple[DriveSession, ...]  # one for each used recording, of one step, cut into laps
    exclusions: Mapping[str, int]  # time [s], by reason
    notes: tuple[str, ...]  # assumptions, one sentence each

    @property
    def sensors(self) -> tuple[SensorFinding, ...]:
        """The warnings on sensors, which the verdict says too."""
        return tuple(note for note in self.notes if isinstance(note, SensorFinding))

    @property
    def warnings(self) -> tuple[str, ...]:
        """The notes on which the user should act."""
        return tuple(note for note in self.notes if isinstance(note, WarningNote))


def gate(
    recordings: Sequence[Recording], settings: GateSettings, hide: Sequence[str] = (), refusals: Sequence[Refusal] = ()
) -> Gated:
    """Check recordings and resample them to an even grid; unusable ones are skipped with a note.

    Roles in `hide` are not read. `refusals` are recordings rejected before the gate.

    Raises
    ------
    InputError
        If no recording can be used, or too little of all of them, with reasons and remedies.
    """
    refusals, recordings, overlaps = list(refusals), in_order([with_stamps(r) for r in recordings]), list[str]()
    refused_names = {refusal.name for refusal in refusals}
    drives_admitted = each_usable(
        (r for r in recordings if r.name not in refused_names), lambda recording: _admit(recording, hide, settings), refusals
    )
    step, drives_admitted = _common_step(drives_admitted, refusals, settings)
    drives_resampled = each_usable(drives_admitted, lambda drive: _resample_drive(drive, step, settings), refusals)
    refuse_repeated([drive.recording for drive in drives_resampled])
    refuse_overlaps([drive.recording for drive in drives_resampled], overlaps)
    not_recorded = settings.friction_brakes and not all("brake" in drive.session.given for drive in drives_resampled)
    motor_braking = _motor_brakes_alone(drives_resampled, settings, overlaps) if not_recorded and drives_resampled else 0.0
    drives_checked = [_check_drive(drive, settings, motor_braking) for drive in drives_resampled]
    seconds = [drive.compared_s for drive in drives_checked]
    shortest_s = SHORTEST_MOVING_S * pace(step)
    if sum(seconds) < shortest_s or (settings.is_vehicle and max(seconds, default=0.0) >= shortest_s):
        drives_checked = each_usable(drives_checked, partial(_long_enough, settings=settings), refusals)
    if not drives_checked:
        raise nothing_left(refusals)
    exclusions = sum((drive.exclusions for drive in drives_checked), Counter[str]())
    unused_recordings = [r for r in recordings if r.name in {refusal.name for refusal in refusals}]
    exclusions[UNUSED] = sum(int(duration_s(r.series)) for r in unused_recordings)
    notes: list[str] = [*(WarningNote(f"{refusal.name}: not used: {refusal.reason}") for refusal in refusals), *overlaps]
    if step < STEP_S:
        notes.append(
            f"the speed changes quickly, so torques are compared as means over {step:g} s instead of {STEP_S:g} s; pieces, "
            "gaps and other times shrink by the same factor"
        )
    if step > STEP_S:
        notes.append(f"samples are sparse, so torques are compared as means over {step:.0f} s")
    sessions = _in_sequence(drives_checked, [r for r in unused_recordings if _drove(r)], notes, settings.has_belt)
    return Gated(tuple(sessions), {reason: n for reason, n in exclusions.items() if n}, tuple(pool_notes(notes)))


@dataclass(frozen=True, eq=False)
class _Admitted:
    """A recording on one clock without hidden roles, its standing time before [s], and notes."""

    recording: Recording
    standing_s: float
    notes: list[str]

    @property
    def name(self) -> str:
        return self.recording.name


@dataclass(frozen=True, eq=False)
class _Resampled(_Admitted):
    """The recording on an even grid, and its excluded time."""

    session: DriveSession
    gaps: Mapping[str, Mask]
    exclusions: Counter[str]

    @property
    def compared_s(self) -> float:
        return float(self.session.used.sum()) * self.session.step


def step_of(recordings: Sequence[Recording], settings: GateSettings) -> float:
    """Common step of recordings of a vehicle [s], see `step_for`."""
    return step_for(recordings, slowest_speed=settings.slowest, quick_share=QUICK if settings.is_vehicle else STEADY)


def _shortest_s(step: float, settings: GateSettings) -> float:
    """Shortest recording [s]. Short runs of a machine on a bench count together, as each is one of a kind."""
    return SHORTEST_S * pace(step) if settings.is_vehicle else FEWEST_STEPS * step


def _admit(recording: Recording, hide: Sequence[str], settings: GateSettings) -> _Admitted:
    original, recording = recording, replace(recording, order=None).without(hide)
    shortest_s = _shortest_s(step_of([recording], settings), settings)
    check_compared(recording, shortest_s)
    recording, notes = on_one_clock(recording)
    recording = at_sprockets(recording, settings)
    check_compared(recording, shortest_s)
    notes += [f"{recording.name}: {note}" for note in original.wheel_notes(recording.series)]
    return _Admitted(recording, _standing_time(recording), notes)


def _common_step(
    drives_admitted: Sequence[_Admitted], refusals: list[Refusal], settings: GateSettings
) -> tuple[float, list[_Admitted]]:
    """Common step [s], and the recordings that suit it: those with far slower sampling are excluded."""
    steps_by_name = {drive.name: step_of([drive.recording], settings) for drive in drives_admitted}
    steps = sorted((steps_by_name[drive.name], duration_s(drive.recording.series)) for drive in drives_admitted)
    time_sums = np.cumsum([seconds for _, seconds in steps])

    def check_step(drive: _Admitted) -> _Admitted:
        step = steps_by_name[drive.name]
        longest_s = SLOWER * steps[np.searchsorted(time_sums, 0.5 * time_sums[-1], side="right")][0]
        statement = f"samples so sparse that torques would be compared as means over {step:.0f} s"
        if step > LONGEST_STEP_S:
            raise InputError(drive.name, statement, f"at most {LONGEST_STEP_S:.0f} s", "record speed and torque more often")
        if step > longest_s:
            allowed = f"at most {longest_s:.0f} s together with the others"
            raise InputError(drive.name, statement, allowed, "diagnose it without the others")
        return drive

    suitable_drives = each_usable(drives_admitted, check_step, refusals)
    return step_of([drive.recording for drive in suitable_drives], settings), suitable_drives


def _resample_drive(drive: _Admitted, step: float, settings: GateSettings) -> _Resampled:
    session, gaps = resample(drive.recording, step, settings, drive.notes, _shortest_s(step, settings))
    check_speed(session, settings)
    return _Resampled(drive.recording, drive.standing_s, drive.notes, session, gaps, Counter())


def _check_drive(drive: _Resampled, settings: GateSettings, motor_braking: float) -> _Resampled:
    """The session with its mask of comparable samples, and a slope from its altitude."""
    session = replace(drive.session, used=usable_steps(drive.session, drive.gaps, settings, drive.exclusions, motor_braking))
    if "brake" in session.given:
        drive.notes.append(_brake_note(session, drive.gaps[BRAKES_ON], settings))
    session, note = with_slope(session)
    drive.notes.extend([note] if note else [])
    return replace(drive, session=session)


def _long_enough(drive: _Resampled, settings: GateSettings) -> _Resampled:
    shortest_s = SHORTEST_MOVING_S * drive.session.pace
    if drive.compared_s < shortest_s:
        exclusion_text = ", ".join(f"{n} s {reason}" for reason, n in drive.exclusions.items() if n)
        noun = "driving" if settings.is_vehicle else "motion"
        statement = f"{drive.compared_s:.3g} s of {noun} with a torque; not used: {exclusion_text or 'nothing'}"
        suffix = "" if settings.is_vehicle else " in all recordings together"
        remedy = "give a longer recording, or check units and topics"
        raise InputError(drive.name, statement, f"at least {shortest_s:.3g} s{suffix}", remedy)
    if not whole_past(drive.session.used, MOST_LAGS).any():
        raise too_short_pieces(drive.name, drive.session.step)
    return drive


def _in_sequence(
    drives: Sequence[_Resampled], unused_recordings: Sequence[Recording], notes: list[str], has_belt: bool
) -> list[DriveSession]:
    """Sessions with consecutive lap numbers and standing times; `unused_recordings` are drives in between."""
    ends_ns = [r.start_ns + int(duration_s(r.series) * 1e9) for r in unused_recordings]
    sessions: list[DriveSession] = []
    block, end_ns, end_m = 0, None, 0.0
    for drive in drives:
        session, begin_ns = drive.session, drive.recording.start_ns
        notes += drive.notes
        is_next = end_ns is not None and 0 <= begin_ns - end_ns <= LONGEST_BREAK_S * 1e9 and begin_ns > 0
        pause_s = (begin_ns - end_ns) * 1e-9 if end_ns is not None and is_next else np.inf
        pauses = [(begin_ns - end) * 1e-9 for end in ends_ns if 0 <= begin_ns - end <= LONGEST_BREAK_S * 1e9]
        standing_s = min(drive.standing_s, *pauses, np.inf)
        if standing_s < pause_s - CLOCK_OFF_S:
            session = replace(session, gap=standing_s, after_unseen=True)
            notes.append(
                f"{session.name}: it had stood for {standing_s:.0f} s, after an unrecorded drive that is assumed to "
                "have been like this one"
            )
        elif is_next:
            session = replace(session, gap=pause_s)
            belt_text = "; the belt temperature is carried over" if has_belt else ""
            notes.append(f"{session.name}: begins {session.gap:.0f} s after the previous one{belt_text}")
        elif has_belt:
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


def _brake_note(session: DriveSession, is_braked: Mask, settings: GateSettings) -> str:
    """Note on the time that remains without friction brakes."""
    drives = np.abs(session.speed) >= settings.slowest
    brake_steps, drive_steps, rest, braking_steps = (
        round(int(steps.sum()) * session.step)
        for steps in (drives & is_braked, drives, session.used, session.used & (session.torque * session.ahead < 0.0))
    )
    return (
        f"{session.name}: brakes on in {brake_steps} s of {drive_steps} s driven; {rest} s remain for comparison, "
        f"{braking_steps} of them with a braking torque"
    )


def _standing_time(recording: Recording) -> float:
    """Recorded standing time before the drive [s]; infinite if unknown, or too long to matter."""
    series = recording.series.get("stood")
    standing_s = np.nan if series is None else standing_time(series.value, recording.name)
    return standing_s if standing_s <= LONGEST_BREAK_S else np.inf


def _motor_brakes_alone(drives: Sequence[_Resampled], settings: GateSettings, notes: list[str]) -> float:
    """Torque down to which the motor brakes alone [Nm]; adds the result to the notes."""
    compared_steps = [~is_slow(drive.session, settings) & ~np.any(list(drive.gaps.values()), axis=0) for drive in drives]
    motor_braking = motor_brakes_alone([drive.session for drive in drives], compared_steps)
    if motor_braking < 0.0:
        notes.append(
            f"down to {motor_braking:.0f} Nm the motor brakes alone, by the speed's changes; "
            "below that friction brakes may act too"
        )
    return motor_braking


def in_order(recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings by their start; those with equal starts by their samples: of speed, then of the other roles.

    Without a common clock all start at 0 s. Their order is then arbitrary but reproducible: the hold-out set depends on it.
    """

    def digests(recording: Recording) -> list[str]:
        roles = sorted(recording.series, key=lambda role: (role != "speed", role))
        series = [recording.series[role] for role in roles]
        content = [(s.stamp_ns - recording.start_ns).tobytes() + s.value.tobytes() for s in series]
        return [hashlib.blake2b(data, digest_size=16).hexdigest() for data in content]

    return sorted(recordings, key=lambda r: (r.start_ns, digests(r), r.name))


def usable_steps(
    session: DriveSession, gaps: Mapping[str, Mask], settings: GateSettings, exclusions: Counter[str], motor_braking: float
) -> Mask:
    """Steps with a comparable torque; `exclusions` receives the seconds of the others, each under its first reason.

    `gaps` are steps without a needed measurement, each of shape (n,), by reason. Down to the torque `motor_braking` [Nm], zero or
    negative, the motor brakes alone.
    """
    used_steps = np.ones(len(session), dtype=bool)
    torque = session.torque * session.ahead
    is_braking = (session.accel * session.ahead < BRAKING_MPS2) & (torque <= 0.0)
    if settings.friction_brakes:  # applied with a braking torque, and for a moment after it
        is_braking = widen(torque < motor_braking if motor_braking < 0.0 else torque <= 0.0)
    if "brake" in session.given or settings.friction_brakes is None:  # all braking except the torque is known
        is_braking = np.zeros(len(session), dtype=bool)
    is_crawling = is_slow(session, settings)
    is_stuck = _stuck_steps(session.torque, session.step, ~is_crawling, LONGEST_STUCK_S * session.pace)
    for reason, mask in (
        *((reason, mask) for reason, mask in gaps.items() if reason != BRAKES_ON),
        (f"slower than {settings.slowest:g} m/s", is_crawling),
        ("torque stuck", is_stuck),
        (BRAKES_ON, gaps[BRAKES_ON]),
        ("may brake", is_braking),
    ):
        exclusions[reason] += round(int((used_steps & mask).sum()) * session.step)
        used_steps &= ~mask
    return used_steps


def is_slow(session: DriveSession, settings: GateSettings) -> Mask:
    """Steps in which friction may be static."""
    return np.asarray(np.abs(session.speed) < settings.slowest)


def _stuck_steps(torque: Array, step: float, is_moving: Mask, longest_s: float) -> Mask:
    """Steps with a constant torque, but for rounding, while moving."""
    changes = np.flatnonzero(~(np.abs(np.diff(torque, prepend=np.nan)) <= SAME_SHARE * np.abs(torque).max()))
    lengths = np.diff(np.append(changes, len(torque)))
    return np.repeat(lengths * step > longest_s, lengths) & is_moving


def on_route(gate_result: Gated, route: Sequence[RouteMap], acting_effects: Sequence[Active] = ()) -> Gated:
    """Sessions with torque and, if not recorded, slope of the route by position; samples off the route are excluded.

    The notes name what lacks an input: values of the route, and effects of the vehicle file and its surroundings,
    `acting_effects`.
    """
    sessions, notes = list(gate_result.sessions), list(gate_result.notes)
    notes += _left_out(sessions, route, acting_effects)
    for route_map in route:
        for i, session in enumerate(sessions):
            if "position" not in session.given or (route_map.kind == SLOPE and "grade" in session.given):
                continue
            values = _values_along(session, route_map)
            is_known = np.isfinite(values)
            notes.append(f"{session.name}: {100.0 * is_known.mean():.0f} % of it is on the route with known {route_map.kind}s")
            if is_known.mean() <= MOST_UNKNOWN:
                notes[-1] = WarningNote(f"{notes[-1]}; they are not used")
                continue
            values = np.where(is_known, values, 0.0)
            session = replace(session, used=session.used & is_known)
            if route_map.kind == SLOPE:
                sessions[i] = replace(session, grade=values, given=session.given | {"grade"})
            else:
                sessions[i] = replace(session, torque_by_place=values)
    return replace(with_fewer_steps(gate_result, sessions, "off the route"), notes=tuple(notes))


def _left_out(sessions: Sequence[DriveSession], route: Sequence[RouteMap], acting_effects: Sequence[Active]) -> list[str]:
    """A note for each effect, or kind of value of the route, that lacks an input in some sessions."""
    owner = "of the vehicle or its surroundings"
    needs_by_effect: dict[str, Sequence[str]] = {
        f"{active.effect.name} {owner}": active.effect.needs for active in acting_effects
    }
    needs_by_effect |= {f"{values.kind} of the route": ("position",) for values in route}
    names_by_input: dict[tuple[str, str], list[str]] = {}
    for session in sessions:
        for name, needed_inputs in needs_by_effect.items():
            missing_inputs = [need for need in needed_inputs if need not in ALWAYS_KNOWN and need not in session.given]
            if missing_inputs and not (name == f"{SLOPE} of the route" and "grade" in session.given):
                names_by_input.setdefault((name, ", ".join(missing_inputs)), []).append(session.name)
    return [
        WarningNote(f"{some_of(names)}: {name} is left out, as {missing_inputs} is not known")
        for (name, missing_inputs), names in names_by_input.items()
    ]


def with_fewer_steps(gate_result: Gated, sessions: Sequence[DriveSession], reason: str) -> Gated:
    """The same sessions with fewer compared steps; their time is excluded for a reason."""
    seconds_before, seconds_after = (sum(s.used.sum() * s.step for s in group) for group in (gate_result.sessions, sessions))
    lost_seconds = {reason: round(seconds_before - seconds_after)} if seconds_before > seconds_after else {}
    return replace(gate_result, sessions=tuple(sessions), exclusions={**gate_result.exclusions, **lost_seconds})


def way_of(session: DriveSession) -> Way:
    """Positions of a session; without positions within its steps, those at their middles."""
    if session.way is not None:
        return session.way
    distance_steps = np.abs(np.nan_to_num(session.speed)) * session.step
    return Way(session.latitude, session.longitude, np.cumsum(distance_steps) - 0.5 * distance_steps)


def _values_along(session: DriveSession, route: RouteMap) -> Array:
    """Means over each step of the values learned in the direction of travel, a slope along the heading; nan where unknown."""
    way = way_of(session)
    track = track_of(way.driven, *route.frame.metres(way.latitude, way.longitude))
    match = match_tracks(route.places, [track])[0].select(track.nearest_index(way.driven))
    route_values = route.value[match.place, (match.sign < 0.0).astype(int)]
    is_known = np.isfinite(route_values) & (match.share > 0.0) & match.is_known[:, np.newaxis]
    share = np.where(is_known, match.share, 0.0)
    total = share.sum(axis=1)
    values = (share * np.where(is_known, route_values, 0.0)).sum(axis=1) / np.where(total > 0.0, total, np.nan)
    mean = values.reshape(len(session), -1).mean(axis=1)
    return np.asarray(np.where((session.speed < 0.0) & (route.kind == SLOPE), -mean, mean))


RECORDED_ACCELERATION = "the acceleration is recorded, so it is not computed from the speeds on both sides"


def with_acceleration(recording: Recording, settings: GateSettings) -> Recording:
    """A recording with an acceleration [m/s^2] at each of its speeds, from those before and after; logged just before the speed.

    One with a recorded acceleration keeps that, with a note. Raises InputError for a recording without two speeds.
    """
    if "accel" in recording.series and np.isfinite(recording.series["accel"].value).any():
        return replace(recording, notes=(*recording.notes, RECORDED_ACCELERATION))
    recording = recording.without(["accel"])  # a role may have no sample
    speed_log, speed = recording.series["speed"], with_stamps(recording).series["speed"]
    finite_rows = np.flatnonzero(np.isfinite(speed.value))
    stamps, first_rows, stamp_of = np.unique(speed.stamp_ns[finite_rows], return_index=True, return_inverse=True)
    if len(stamps) < 2:
        raise InputError(
            recording.name, number_of(len(stamps), "usable speed"), "two or more, for an acceleration from both sides"
        )
    times = (stamps - stamps[0]) / SECOND_NS
    motion = smoothed_motion(times, speed.value[finite_rows][first_rows], times, step_of([recording], settings), settings.slowest)
    accel = motion.accel[stamp_of]
    finite_accel = np.isfinite(accel)
    rows, order = finite_rows[finite_accel], recording.log_order()
    places = np.flatnonzero(order == list(recording.series).index("speed"))[rows]
    return replace(
        recording,
        series={**recording.series, "accel": Series(speed_log.stamp_ns[rows], speed_log.arrival_ns[rows], accel[finite_accel])},
        order=np.insert(order, places, np.int16(len(recording.series))),
    )


class ComparedTorque:
    """Residual torque of a replay in the steps that a diagnosis compares."""

    def __init__(self, recording: Recording, settings: GateSettings) -> None:
        """Take the steps of a recording. Raises InputError where a diagnosis would refuse it, with the reason."""
        (self._session,) = gate([recording], settings).sessions
        self._start_ns = with_stamps(recording).start_ns
        self._sum, self._number = np.zeros((2, len(self._session)))  # of the residuals in each step [Nm]

    def writer(self, write: Callable[[Steps], None]) -> Callable[[Steps], None]:
        """A function that adds rows of a replay to the comparison, and writes them."""

        def take(steps: Steps) -> None:
            self._add(steps)
            write(steps)

        return take

    def _add(self, steps: Steps) -> None:
        residual = steps.rows[:, Results.residual_nm]
        step = np.floor((steps.stamp_ns - self._start_ns) / (self._session.step * SECOND_NS)).astype(int)
        is_inside = np.isfinite(residual) & (step >= 0) & (step < len(self._session))
        np.add.at(self._sum, step[is_inside], residual[is_inside])
        np.add.at(self._number, step[is_inside], 1.0)

    def as_dict(self) -> dict[str, Any]:
        """Mean absolute residual of the steps' means [Nm], the length of a step and the number of steps, ready for JSON."""
        steps = self._session.used & (self._number > 0.0)
        means = self._sum[steps] / self._number[steps]
        error = float(np.abs(means).mean()) if steps.any() else None
        return {"mean_error_nm": error, "step_s": self._session.step, "steps": int(steps.sum())}
