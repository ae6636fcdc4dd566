# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds coast-downs: stretches of deceleration without drive torque and brakes."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from trackres_ros.diagnosis.base.loading import LoadedBase
from trackres_ros.diagnosis.prepare.checks import check_compared, refuse_repeated
from trackres_ros.diagnosis.prepare.gate import Gated, on_route
from trackres_ros.diagnosis.prepare.resample import resample
from trackres_ros.diagnosis.prepare.session import Array, DriveSession, GateSettings, Mask
from trackres_ros.diagnosis.prepare.speed_smoothing import coasting_errors, confirm_slope, slope_of_altitude, with_slope
from trackres_ros.diagnosis.prepare.torque_checks import at_sprockets, on_one_clock
from trackres_ros.errors import InputError
from trackres_ros.recording.recording import Recording, with_stamps
from trackres_ros.recording.roles import Conversion
from trackres_ros.recording.samples import Series
from trackres_ros.recording.slopes import runs_of
from trackres_ros.recording.topics_files import line_to_write
from trackres_ros.text import figures
from trackres_ros.units import GRAVITY

NO_TORQUE_SHARE = 1e-3  # of weight times radius: a tenth of rolling resistance
DRIVEN_MPS2 = 10.0 * NO_TORQUE_SHARE * GRAVITY  # an acceleration whose inertia alone takes ten times that torque
DRIVEN_SHARE = 0.1  # least share of such accelerations with a torque: more than spikes, and the rest may be downhill
SHORTEST_S, LEAST_FALL_MPS = 10.0, 0.5
SHORTEST_RECORDING_S = SHORTEST_S + 5.0
LEAST_FALL_SHARE = 0.2  # of the initial speed, if no torque is recorded
HARDEST_MPS2 = 0.8  # largest deceleration without brakes, on the flat
AROUND_S, END_S = 5.0, 2.0
CLEAR_SHARE = 0.5  # of the median over time
# A vehicle that only rolls decelerates by a + b v^2. Down to standstill, the median over time is at most 2 a, from any speed.
# So half of the median is at most a, the deceleration at the end.
NAME_DIGITS = 20  # at most, in a number of a file's name


@dataclass(frozen=True, slots=True)
class RollOut:
    """A coast-down, or a piece of one: session, first sample and end."""

    session: int
    begin: int
    end: int


@dataclass(frozen=True, eq=False)
class Rollouts:
    """Sessions with only coast-downs in use, each as its own lap."""

    sessions: tuple[DriveSession, ...]  # on an even grid; a missing torque is zero
    stretches: tuple[RollOut, ...]  # in driving order
    rejections: Mapping[str, int]  # reasons for rejecting other decelerations, with their counts
    notes: tuple[str, ...]  # assumptions, one sentence each
    remedies: tuple[str, ...]  # lines for the topics file that may give recordings a coast-down

    @property
    def count(self) -> int:
        """Number of coast-downs; those in pieces once."""
        return 1 + max(int(session.block.max()) for session in self.sessions)


@dataclass(frozen=True, eq=False)
class _Drive:
    """A recording on an even grid."""

    recording: Recording
    session: DriveSession
    gaps: Mapping[str, Mask]  # steps without a needed measurement
    limit: float | None  # torque that may be measured in a coast-down [Nm]; None without a torque

    def with_ground(self, ground: DriveSession) -> _Drive:
        """The same on known ground: the session with a slope or a torque by place, in use where that is known."""
        return replace(self, session=ground, gaps={**self.gaps, "ground not known": ~ground.used})

    def coasting(
        self, settings: GateSettings, rejections: Counter[str], first_number: int
    ) -> tuple[DriveSession, list[tuple[int, int]]]:
        """The session with only its coast-downs in use, as blocks from a `first_number` number on; and their begins and ends."""
        in_use, block = np.zeros(len(self.session), dtype=bool), np.full(len(self.session), -1, dtype=np.int64)
        is_slowing = _slowing_steps(self.session, self.gaps, settings, self.limit, rejections)
        number, last = first_number - 1, 0
        for begin, end in is_slowing:
            number += number < first_number or not self._rolls_on(last, begin)
            in_use[begin:end], block[begin:end] = True, number
            last = end - 1
        return replace(self.session, used=in_use, block=block), is_slowing

    def _rolls_on(self, last: int, begin: int) -> bool:
        """Whether the vehicle did not turn between two pieces: after a turn its speed is higher than in it."""
        speed = np.abs(self.session.speed[last : begin + 1])
        return bool(speed[-1] < speed.min() + LEAST_FALL_MPS)


def rollouts(recordings: Sequence[Recording], base_file: LoadedBase, step: float) -> Rollouts:
    """Find the coast-downs of recordings, on a grid of `step` [s].

    With a recorded torque, only stretches of zero torque are used. One that stays near zero while the vehicle accelerates is
    treated as not recorded. Stretches off a given route are not used.

    Raises
    ------
    InputError
        A recording without a speed, too short, in another unit, or of the same drive as another one.
    """
    refuse_repeated(recordings)
    sessions: list[DriveSession] = []
    stretches, count = list[RollOut](), 0
    rejections: Counter[str] = Counter()
    notes: list[str] = []
    remedies: list[str] = []
    settings, limit = base_file.known, NO_TORQUE_SHARE * base_file.known.weight * base_file.base.facts.radius
    drives = _with_slopes([_resample(recording, step, settings, limit, notes) for recording in recordings], settings, notes)
    gate_result = on_route(
        Gated(tuple(drive.session for drive in drives), {}, tuple(notes)), base_file.route, base_file.base.acting
    )
    for drive in (drive.with_ground(ground) for drive, ground in zip(drives, gate_result.sessions, strict=True)):
        session, is_slowing = drive.coasting(settings, rejections, count)
        count = max(count, int(session.block.max()) + 1)
        stretches += [RollOut(len(sessions), begin, end) for begin, end in is_slowing]
        sessions.append(session)
        if drive.limit is not None:
            remedies += _of_offset(session, _slows(session, settings)[1], limit, settings.torque_scale)
        elif torques := _torques(drive.recording):
            remedies.append(f"check sensor and unit of {min(torques)} in {session.name}, which {_hardly(limit)}")
    return Rollouts(tuple(sessions), tuple(stretches), dict(rejections), gate_result.notes, tuple(remedies))


def in_driving_order(recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings by their start. If any two overlap, they have no common clock, and all stay as they are given.

    Names in the order of a shell's ``*`` are ordered by their numbers: roll_2 is before roll_10.
    """
    names = [recording.name for recording in recordings]
    if names == sorted(names):
        recordings = sorted(recordings, key=lambda r: re.sub("[0-9]+", lambda number: number[0].zfill(NAME_DIGITS), r.name))
    in_time = sorted(recordings, key=lambda r: r.start_ns)
    overlaps = any(_end_ns(recording) > successor.start_ns for recording, successor in pairwise(in_time))
    return list(recordings) if overlaps else in_time


def _end_ns(recording: Recording) -> int:
    """The last stamp of any role [ns]."""
    ends = (int(s.stamp_ns.max()) for s in with_stamps(recording).series.values() if len(s.stamp_ns))
    return max(ends, default=recording.start_ns)


def _with_slopes(drives: Sequence[_Drive], settings: GateSettings, notes: list[str]) -> list[_Drive]:
    """The drives with slopes from their altitude. Where no torque is measured, the decelerations of all coast-downs must confirm
    them.
    """
    sessions_with_slope = [
        slope_of_altitude(drive.session) if drive.limit is None else with_slope(drive.session) for drive in drives
    ]
    trial, count = dict[int, DriveSession](), 0
    for i, (drive, (ground, _)) in enumerate(zip(drives, sessions_with_slope, strict=True)):
        if drive.limit is None and ground is not drive.session:
            trial[i], is_slowing = drive.with_ground(ground).coasting(settings, Counter(), count)
            count += len(is_slowing)
    errors = coasting_errors(list(trial.values())) if count else None
    for i in trial:
        session = drives[i].session
        sessions_with_slope[i] = (
            (session, "") if errors is None else confirm_slope(session, *sessions_with_slope[i], "force", "N", errors)
        )
    notes += [text for _, text in sessions_with_slope if text]
    return [replace(drive, session=ground) for drive, (ground, _) in zip(drives, sessions_with_slope, strict=True)]


def _torques(recording: Recording) -> list[str]:
    """Roles of the torque with a value."""
    return [r for r, s in recording.series.items() if r.partition("/")[0] == "torque" and np.isfinite(s.value).any()]


def _resample(recording: Recording, step: float, settings: GateSettings, limit: float, notes: list[str]) -> _Drive:
    """The recording on an even grid; with a measured torque only if that exceeds a `limit` [Nm]."""
    reason = "no torque was recorded"
    check_compared(_without_torque(recording), SHORTEST_RECORDING_S)
    try:
        recording, clock_note = on_one_clock(recording)
    except InputError:
        torques = _torques(recording)
        if not torques or any((np.abs(recording.series[r].value) > limit).any() for r in torques):
            raise
        series = {r: s for r, s in recording.series.items() if r not in torques}  # a torque without a course, on any clock
        reason = f"the torque {_hardly(limit)}, and its clock is not the speed's; it is not used"
        recording, clock_note = on_one_clock(replace(recording, series=series, order=None))
    notes += clock_note
    recording = at_sprockets(recording, settings)
    if _torques(recording):
        messages: list[str] = []
        session, gaps = resample(recording, step, settings, messages, SHORTEST_RECORDING_S)
        if not _lacks_torque(session, gaps, limit):
            notes += messages
            return _Drive(recording, replace(session, given=session.given | {"torque"}), gaps, limit)
        reason = f"the torque {_hardly(limit)} (a dead sensor, or another unit), and is not used"
    notes.append(f"{recording.name}: {reason}; deceleration is assumed to be without drive or brakes")
    return _Drive(recording, *resample(_without_torque(recording), step, settings, notes, SHORTEST_RECORDING_S), None)


def _hardly(limit: float) -> str:
    return f"hardly exceeds {figures(limit, 3)} Nm while the vehicle accelerates"


def _lacks_torque(session: DriveSession, gaps: Mapping[str, Mask], limit: float) -> bool:
    """Whether the vehicle accelerates, but hardly ever with a torque above the limit [Nm]."""
    gains = _without_slope(session) > DRIVEN_MPS2
    for mask in gaps.values():
        gains &= ~mask
    lasts = float(gains.sum()) * session.step >= AROUND_S
    return lasts and float((np.abs(session.torque[gains]) > limit).mean()) < DRIVEN_SHARE


def _of_offset(session: DriveSession, is_slowing: Mask, limit: float, scale: float) -> list[str]:
    """Line for the topics file if the torque is nearly constant while slowing down. The sensor shows `scale` times the torque."""
    if not is_slowing.any():
        return []
    low, middle, high = np.percentile(session.torque[is_slowing], (25.0, 50.0, 75.0))
    if abs(middle) <= limit or high - low > limit:
        return []
    offset = float(f"{scale * middle:.3g}")
    line = line_to_write("torque", Conversion(offset=-offset), session.bindings)
    return [f"if the {figures(offset)} Nm while {session.name} slows down are no torque, {line}"]


def _without_torque(recording: Recording) -> Recording:
    if "speed" not in recording.series:
        return recording
    speed = recording.series["speed"]
    zero = Series(speed.stamp_ns, speed.arrival_ns, np.zeros(len(speed.value)))
    return replace(recording, series={**recording.series, "torque": zero}, order=None)


def _slows(session: DriveSession, settings: GateSettings) -> tuple[Array, Mask]:
    """Acceleration along the motion, averaged over a few seconds [m/s^2], and the steps in which it slows down."""
    slows = np.sign(session.speed) * _smooth_values(session.accel, session.step)
    return slows, (slows < 0.0) & (np.abs(session.speed) >= max(settings.slowest, LEAST_FALL_MPS))


def _without_slope(session: DriveSession) -> Array:
    """Acceleration along the motion by all forces but a known slope, averaged over a few seconds [m/s^2]."""
    return np.sign(session.speed) * _smooth_values(session.accel + GRAVITY * session.grade, session.step)


def _slowing_steps(
    session: DriveSession, gaps: Mapping[str, Mask], settings: GateSettings, limit: float | None, rejections: Counter[str]
) -> list[tuple[int, int]]:
    """Stretches of free deceleration: first sample, and the one after the last. `limit` [Nm] is None without a torque."""
    is_decelerating, is_slowing = _slows(session, settings)
    exclusions = dict(gaps)
    if limit is not None:
        exclusions[f"slowing down with a torque above {figures(limit, 3)} Nm"] = np.abs(session.torque) > limit
    for reason, mask in exclusions.items():
        seconds_lost = float((is_slowing & mask).sum()) * session.step
        if seconds_lost >= SHORTEST_S:
            rejections[f"s of {session.name}: {reason}"] += round(seconds_lost)
    for mask in exclusions.values():
        is_slowing &= ~mask
    stretches = []
    ends = math.ceil(END_S / session.step)  # steps that may contain a part of driving or of a stop
    for begin, end in runs_of(is_slowing):
        if limit is None:
            begin, end = _without_held_ends(session, begin, end)
        begin, end = begin + ends, end - ends
        if end <= begin:
            continue
        speed = np.abs(session.speed[begin:end])
        fall, seconds = float(speed[0] - speed[-1]), (end - begin) * session.step
        if seconds < SHORTEST_S or fall < LEAST_FALL_MPS:
            rejections[f"shorter than {SHORTEST_S:g} s, or by less than {LEAST_FALL_MPS:g} m/s"] += 1
        elif limit is None and fall < LEAST_FALL_SHARE * speed[0]:
            rejections[f"by less than {LEAST_FALL_SHARE:.0%} of the speed, with no torque recorded"] += 1
        elif "brake" not in session.given and float(np.min(is_decelerating[begin:end])) < -HARDEST_MPS2:
            rejections[f"harder than {HARDEST_MPS2:g} m/s^2: brakes"] += 1
        else:
            stretches.append((begin, end))
    return stretches


def _without_held_ends(session: DriveSession, begin: int, end: int) -> tuple[int, int]:
    """The part of a stretch from its first to its last clear deceleration: a driver may hold the speed before and after it, and
    noise lowers a held speed too.
    """
    resistance = -_without_slope(session)[begin:end]
    clear_rows = begin + np.flatnonzero(resistance > CLEAR_SHARE * np.median(resistance))
    return (int(clear_rows[0]), int(clear_rows[-1]) + 1) if len(clear_rows) else (begin, begin)


def _smooth_values(values: Array, step: float) -> Array:
    """Moving averages over a few seconds."""
    count = max(1, round(AROUND_S / step))
    return np.asarray(np.convolve(values, np.ones(count), "same") / np.convolve(np.ones(len(values)), np.ones(count), "same"))
