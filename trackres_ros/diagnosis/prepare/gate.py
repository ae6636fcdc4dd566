# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Steps 0 and 1: recordings -> sessions. What cannot be used is refused or left out, with reason and count; laps are split."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.prepare.sample_noise import noise_of_means
from trackres_ros.diagnosis.prepare.session import Course, Session, Split
from trackres_ros.diagnosis.prepare.speed_smoothing import smooth_speed
from trackres_ros.diagnosis.prepare.unit_checks import Conversion, check_speed_unit, check_units
from trackres_ros.errors import InputError
from trackres_ros.recording.recording import Recording, Series
from trackres_ros.units import KMH_PER_MPS

Array = NDArray[np.float64]

STEP_S = 1.0  # mean torque over a step against the change of speed over it: exact, whatever happens within
FEWEST_FOR_SPACING = 100
SLOWEST_MPS, SLOWEST_SHARE = 0.3, 0.1  # of the greatest speed; below both friction may be static
LONGEST_HOLD_S = 2.0  # of speed and torque over a gap
SHORTEST_S, SHORTEST_MOVING_S = 120.0, 60.0
FULL_STOP_S = 5.0
LONGEST_UNKNOWN_S, UNUSUAL_SPACING = 5.0, 10.0  # of a slope, and times its usual spacing
MOST_UNKNOWN = 0.5  # of a recording
EARLIEST_CLOCK_S = 6e8  # 1989: a recording that begins before it counts from its own start
MOST_OVERLAP = 0.1  # of the shorter: more is no clock that is a little off
FEWEST_FILLED, SHORTEST_FILLED_S = 5, 3.0
EXACT = 1e-6  # of the largest values: as exact as six digits are written
SAME_SHARE = 1e-9  # of the largest torque: a difference that rounding makes
PIECES, SHORTEST_PIECE_S, LONGEST_PIECE_S = 20, 60.0, 300.0
FEWEST_DRIVES, FEWEST_SESSIONS = 8, 4
HELD_OUT_SHARE = 0.25
LONGEST_BREAK_S = 7 * 86400.0  # between recordings whose clocks run on
BRAKING_MPS2 = -0.5  # with a torque that does not drive: friction brakes may be at work
CHANNEL_OF = {"ambient": "ambient", "grade": "grade", "yaw_rate": "yaw_rate", "heading": "heading", "accel": "accel"}


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Samples that are not compared, and why."""

    reason: str
    samples: int


@dataclass(frozen=True, eq=False)
class Gated:
    """What passed the gate."""

    sessions: tuple[Session, ...]
    left_out: tuple[LeftOut, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class GateSettings:
    """What the gate must know of a vehicle.

    Attributes
    ----------
    weight, max_speed, ambient
        [N], [m/s], [degC]; the first and last stand in where nothing is recorded.
    friction_brakes
        Whether brakes of which nothing is recorded help a torque that brakes.
    belt_shows_surface
        Whether a measured belt temperature is that of the surface, as infrared sees it, or the mean.
    motor_ratio
        Turns of the motor to one of the sprocket; None where the file does not say.
    torque_scale
        Least and most times the expected torque that the file allows to be shown.
    """

    weight: float
    max_speed: float
    ambient: float
    friction_brakes: bool
    belt_shows_surface: bool = False
    motor_ratio: float | None = None
    torque_scale: tuple[float, float] = (1.0, 1.0)

    @property
    def slowest(self) -> float:
        """Speed below which friction may be static [m/s]."""
        return min(SLOWEST_MPS, SLOWEST_SHARE * self.max_speed)


def gate(recordings: Sequence[Recording], known: GateSettings, hide: Sequence[str] = ()) -> Gated:
    """Check recordings and put them on an even grid.

    Parameters
    ----------
    known
        Of the vehicle.
    hide
        Roles to be left unread.

    Raises
    ------
    InputError
        If there is no torque, or too little that can be used; says what to do.
    """
    left_out: dict[str, int] = {}
    notes: list[str] = []
    sessions: list[Session] = []
    block = 0
    end_ns: int | None = None
    end_m = 0.0
    _refuse_overlaps(recordings, notes)
    for recording in _long_enough(recordings, left_out, notes):
        session = _session(recording, known, frozenset(hide), left_out, notes)
        _check_speed(session, known.max_speed)
        begin_ns = recording.start_ns
        if end_ns is not None and 0 <= begin_ns - end_ns <= LONGEST_BREAK_S * 1e9 and begin_ns > 0:
            session = replace(session, gap=(begin_ns - end_ns) * 1e-9)
            notes.append(
                f"{session.name}: goes on {session.gap:.0f} s after the one before; the belt's temperature is carried over"
            )
        else:
            notes.append(f"{session.name}: starts soaked at the ambient temperature")
        end_ns = begin_ns + int(session.time[-1] * 1e9)
        pieces = _pieces(session)
        session = replace(session, block=pieces + block, distance=session.distance + end_m)
        block, end_m = int(session.block[-1]) + 1, float(session.distance[-1])
        sessions.append(session)
    usable = sum(int(s.used.sum()) for s in sessions) * STEP_S
    if usable < SHORTEST_MOVING_S:
        raise InputError(
            ", ".join(r.name for r in recordings),
            f"{usable:.0f} s of driving with a torque; left out: {_listed(left_out) or 'nothing'}",
            f"at least {SHORTEST_MOVING_S:.0f} s",
            "give a longer recording, or look at units and topics",
        )
    return Gated(tuple(sessions), tuple(LeftOut(reason, n) for reason, n in left_out.items() if n), tuple(notes))


def split(sessions: Sequence[Session], held_out: int | Sequence[str] | None = None) -> Split:
    """Choose the blocks never to be looked at before the end: the last ones.

    Parameters
    ----------
    held_out
        How many of the last sessions (where there are several) or blocks, or the names of recordings.

    Raises
    ------
    InputError
        If nothing would be left to fit on, or a name is not among the recordings.
    """
    blocks = [sorted(set(s.block.tolist())) for s in sessions]
    by_session = len(sessions) >= FEWEST_SESSIONS or (isinstance(held_out, int) and held_out < len(sessions) > 1)
    if held_out is not None and not isinstance(held_out, int):
        unknown = [name for name in held_out if not any(name in s.name for s in sessions)]
        if unknown:
            raise InputError("--holdout", unknown[0], f"part of a name among {', '.join(s.name for s in sessions)}")
        chosen = {i for i, s in enumerate(sessions) if any(name in s.name for name in held_out)}
    elif by_session:
        count = held_out if isinstance(held_out, int) else max(1, round(HELD_OUT_SHARE * len(sessions)))
        chosen = set(range(len(sessions) - count, len(sessions)))
    else:
        every = [b for of in blocks for b in of]
        count = held_out if isinstance(held_out, int) else max(1, round(HELD_OUT_SHARE * len(every)))
        if not 0 < count < len(every):
            raise InputError("--holdout", count, f"1 to {len(every) - 1} of the {len(every)} laps or pieces")
        text = f"the last {count} of {len(every)} laps or pieces are held out"
        return Split(tuple(every[:-count]), tuple(every[-count:]), text)
    training = tuple(b for i, of in enumerate(blocks) if i not in chosen for b in of)
    if not training or not chosen:
        raise InputError("--holdout", held_out, f"some, but not all, of the {len(sessions)} recordings")
    text = f"held out: {', '.join(sessions[i].name for i in sorted(chosen))}"
    return Split(training, tuple(b for i in sorted(chosen) for b in blocks[i]), text)


def _duration_s(recording: Recording) -> float:
    """From the first speed to the last [s]."""
    speed = recording.series.get("speed")
    at = speed.stamp_ns[np.isfinite(speed.value)] if speed else np.empty(0)
    return float(at.max() - at.min()) * 1e-9 if len(at) else 0.0


def _long_enough(recordings: Sequence[Recording], left_out: dict[str, int], notes: list[str]) -> list[Recording]:
    """Recordings without those too short to be one; unless all are: then what each lacks is said where it is read."""
    short = [r for r in recordings if "speed" in r.series and _duration_s(r) < SHORTEST_S]
    if len(short) == len(recordings):
        return list(recordings)
    for recording in short:
        seconds = _duration_s(recording)
        notes.append(f"{recording.name}: left out, it has {seconds:.0f} s of {SHORTEST_S:.0f} s at least")
        reason = f"in recordings of less than {SHORTEST_S:.0f} s"
        left_out[reason] = left_out.get(reason, 0) + int(seconds / STEP_S)
    return [r for r in recordings if r not in short]


def _refuse_overlaps(recordings: Sequence[Recording], notes: list[str]) -> None:
    """Two recordings of one time show the same drive twice; without a clock of the day nothing can be said."""
    clocked = [(r.start_ns * 1e-9, r) for r in recordings if r.start_ns * 1e-9 > EARLIEST_CLOCK_S]
    spans = sorted((begin, begin + _duration_s(r), r.name) for begin, r in clocked)
    for i, (begin, end, name) in enumerate(spans):
        for other_begin, other_end, other in spans[i + 1 :]:
            both = min(end, other_end) - other_begin
            if both > MOST_OVERLAP * min(end - begin, other_end - other_begin) and both > STEP_S:
                raise InputError(
                    f"{name}, {other}",
                    f"{both:.0f} s of one time in both",
                    "recordings of different times",
                    "give one of them, or join what each has in one recording",
                )
            if both > STEP_S:
                notes.append(f"{name}, {other}: their clocks overlap by {both:.0f} s; taken for one after the other")


def _filled(at: Array, value: Array) -> list[tuple[float, float]]:
    """Spans [s] in which a series is exactly a straight line that rises or falls: no sensor measures so, but a filled gap is."""
    step, rise = np.diff(at), np.diff(value)
    if len(step) < FEWEST_FILLED:
        return []
    slope = rise / step
    exact = EXACT * max(float(np.percentile(np.abs(value), 99.0)), 1e-12)
    bends = np.abs(slope[1:] - slope[:-1]) * np.minimum(step[1:], step[:-1]) > exact
    ends = np.flatnonzero(np.concatenate(([True], bends, [True])))
    return [
        (float(at[a]), float(at[b]))
        for a, b in pairwise(ends.tolist())
        if b - a >= FEWEST_FILLED and at[b] - at[a] >= SHORTEST_FILLED_S and abs(value[b] - value[a]) > 100.0 * exact
    ]


def _without_value(series: Series, start: int, edges: Array) -> NDArray[np.bool_]:
    """Steps in a gap of a series that is long beside its usual spacing, or before or after all of it by as much."""
    at, _ = _ordered(series, start)
    if len(at) < FEWEST_FOR_SPACING:
        return np.zeros(len(edges) - 1, dtype=bool)
    longest = max(LONGEST_UNKNOWN_S, UNUSUAL_SPACING * float(np.median(np.diff(at))))
    around = np.concatenate(([edges[0] - 0.5 * longest], at, [edges[-1] + 0.5 * longest]))
    gaps = np.flatnonzero(np.diff(around) > longest)
    return _within([(float(around[i]), float(around[i + 1])) for i in gaps], edges)


def _within(spans: Sequence[tuple[float, float]], edges: Array) -> NDArray[np.bool_]:
    """Steps that a span reaches into."""
    inside = np.zeros(len(edges) - 1, dtype=bool)
    for begin, end in spans:
        inside |= (edges[:-1] < end) & (edges[1:] > begin)
    return inside


def _session(
    recording: Recording, vehicle: GateSettings, hide: frozenset[str], left_out: dict[str, int], notes: list[str]
) -> Session:
    series = {role: s for role, s in recording.series.items() if role not in hide and role.partition("/")[0] not in hide}
    torques = [role for role in series if role.partition("/")[0] == "torque" and np.isfinite(series[role].value).any()]
    if not torques:
        raise InputError(
            recording.name,
            f"no torque; roles: {', '.join(series) or 'none'}",
            "a measured torque: without it there is nothing to compare",
        )
    if "speed" not in series or not np.isfinite(series["speed"].value).any():
        raise InputError(recording.name, "no finite speed", "a speed")
    start = recording.start_ns
    speed_at, raw_speed = _ordered(series["speed"], start)
    if speed_at[-1] - speed_at[0] < SHORTEST_S:
        raise InputError(recording.name, f"{speed_at[-1] - speed_at[0]:.0f} s", f"at least {SHORTEST_S:.0f} s of recording")
    edges = np.arange(0.0, speed_at[-1] + 1e-9, STEP_S)
    count = len(edges) - 1
    notes += check_units(recording.name, series, vehicle.weight)
    smoothed = smooth_speed(speed_at, raw_speed, edges, LONGEST_HOLD_S)
    at_edges = smoothed.speed if smoothed else np.interp(edges, speed_at, raw_speed)
    speed, known = _means(speed_at, raw_speed, edges)
    if "torque" in torques:
        torques = ["torque"]
    torque, measured = np.zeros(count), np.ones(count, dtype=bool)
    filled, torque_noise = np.zeros(count, dtype=bool), 0.0
    for role in torques:
        part, there = _means(*_ordered(series[role], start), edges)
        torque, measured = torque + part, measured & there
        torque_noise = float(np.hypot(torque_noise, noise_of_means(*_ordered(series[role], start), STEP_S)))
        filled |= _within(_filled(*_ordered(series[role], start)), edges)
    filled &= _within(_filled(speed_at, raw_speed), edges)

    def held(role: str, default: float) -> Array:
        return _held(series[role], start, edges, default) if role in series else np.full(count, default)

    given = frozenset(role for role in CHANNEL_OF if role in series and np.isfinite(series[role].value).any())
    accel, accel_noise = np.diff(at_edges) / STEP_S, smoothed.typical_change_std / STEP_S if smoothed else 0.0
    way = series.get("distance")
    by_way = np.diff(np.interp(edges, *_ordered(way, start))) / STEP_S if way and np.isfinite(way.value).any() else None
    check_speed_unit(recording.name, speed, accel, held("accel", np.nan) if "accel" in given else None, by_way)
    if "accel" in given:
        mean, there = _means(*_ordered(series["accel"], start), edges)
        accel, accel_noise = np.where(there, mean, accel), 0.0
    weight, of_load = _weight(series, start, edges, vehicle.weight)
    given |= {"load"} if of_load else frozenset()
    belts = [_held(series[role], start, edges, np.nan) for role in series if role.partition("/")[0] == "belt"]
    belt = np.mean(belts, axis=0) if belts else np.full(count, np.nan)
    given |= {"belt"} if belts and np.isfinite(belt).any() else frozenset()
    heading, yaw_rate = held("heading", np.nan), np.full(count, np.nan)
    if "yaw_rate" in given and not np.ptp(series["yaw_rate"].value[np.isfinite(series["yaw_rate"].value)]):
        given -= {"yaw_rate"}  # a gyroscope that is there is never still
        notes.append(f"{recording.name}: yaw_rate never changes; taken for not recorded")
    if "yaw_rate" in given:
        yaw_rate = _means(*_ordered(series["yaw_rate"], start), edges)[0]
    if "yaw_rate" in given and "heading" not in given:
        heading = np.cumsum(np.nan_to_num(yaw_rate)) * STEP_S
        given |= {"heading"}
        notes.append(f"{recording.name}: heading is integrated from the yaw rate")
    no_slope = _without_value(series["grade"], start, edges) if "grade" in given else np.zeros(count, dtype=bool)
    if no_slope.mean() > MOST_UNKNOWN:
        notes.append(f"{recording.name}: the slope is not known for {no_slope.mean():.0%} of it; taken for not recorded")
        given, no_slope = given - {"grade"}, np.zeros(count, dtype=bool)
    session = Session(
        name=recording.name,
        step=STEP_S,
        time=edges[:-1],
        speed=speed,
        accel=accel,
        weight=weight,
        ambient=held("ambient", vehicle.ambient),
        grade=held("grade", 0.0) if "grade" in given else np.zeros(count),
        yaw_rate=yaw_rate,
        heading=heading,
        distance=np.cumsum(np.abs(speed)) * STEP_S,
        torque=torque,
        belt=belt,
        used=measured,
        block=np.zeros(count, dtype=np.int64),
        given=given,
        torque_course=_course([_ordered(series[role], start) for role in torques]),
        accel_noise=accel_noise,
        torque_noise=torque_noise,
        belt_shows_surface=vehicle.belt_shows_surface,
    )
    return replace(session, used=_usable(session, known, measured, filled, no_slope, left_out, vehicle))


def _course(torques: Sequence[tuple[Array, Array]]) -> Course:
    """Sum of torques as they were measured."""
    at = np.unique(np.concatenate([t for t, _ in torques]))
    return Course.of(at, np.sum([np.interp(at, t, v) for t, v in torques], axis=0))


def _usable(
    session: Session,
    known: NDArray[np.bool_],
    measured: NDArray[np.bool_],
    filled: NDArray[np.bool_],
    no_slope: NDArray[np.bool_],
    left_out: dict[str, int],
    vehicle: GateSettings,
) -> NDArray[np.bool_]:
    used = np.ones(len(session), dtype=bool)
    braking = (session.accel < BRAKING_MPS2) & (session.torque <= 0.0)
    if vehicle.friction_brakes:  # used together with a torque that brakes, and for a moment after it
        braking = np.convolve(session.torque <= 0.0, np.ones(3), mode="same") > 0
    slow = np.abs(session.speed) < vehicle.slowest
    stuck = _stuck(session.torque, ~slow)
    for reason, bad in (
        ("no speed", ~known),
        ("no torque", ~measured),
        ("gap filled by straight lines", filled),
        ("slope not known", no_slope),
        (f"slower than {vehicle.slowest:g} m/s", slow),
        ("torque stuck", stuck),
        ("may brake", braking),
    ):
        left_out[reason] = left_out.get(reason, 0) + int((used & bad).sum())
        used &= ~bad
    return used


def _stuck(torque: Array, moving: NDArray[np.bool_], longest_s: float = 30.0) -> NDArray[np.bool_]:
    """Where one torque stays, but for rounding, while moving."""
    changes = np.flatnonzero(~(np.abs(np.diff(torque, prepend=np.nan)) <= SAME_SHARE * np.abs(torque).max()))
    lengths = np.diff(np.append(changes, len(torque)))
    return np.repeat(lengths * STEP_S > longest_s, lengths) & moving


def _check_speed(session: Session, max_speed: float) -> None:
    fastest = float(np.percentile(np.abs(session.speed), 99.0))
    if fastest < SLOWEST_MPS:
        raise InputError(session.name, f"speeds up to {fastest:.2f} m/s", "a vehicle that moves")
    if fastest > 1.5 * max_speed:
        raise InputError(
            f"{session.name}: speed",
            f"{fastest:.0f} m/s",
            f"at most the vehicle's {max_speed:g} m/s",
            f"if it is in km/h, {Conversion(1.0 / KMH_PER_MPS).line('speed')}",
        )


def _pieces(session: Session) -> NDArray[np.int64]:
    """Number of the drive between two stops, where there are enough of them; else of a piece of equal length."""
    standing = np.abs(session.speed) < SLOWEST_MPS
    begins = np.flatnonzero(np.diff(standing.astype(int), prepend=0) == 1)
    ends = np.flatnonzero(np.diff(standing.astype(int), append=0) == -1)
    cuts = [b for b, e in zip(begins, ends, strict=True) if (e - b + 1) * session.step >= FULL_STOP_S and 0 < b < len(session)]
    if len(cuts) >= FEWEST_DRIVES - 1:
        return np.searchsorted(np.array(cuts), np.arange(len(session)), side="right").astype(np.int64)
    duration = len(session) * session.step
    length = min(max(duration / PIECES, SHORTEST_PIECE_S), LONGEST_PIECE_S)
    pieces = max(1, int(duration // length))
    return np.minimum((np.arange(len(session)) * pieces) // len(session), pieces - 1).astype(np.int64)


def _weight(series: dict[str, Series], start: int, edges: Array, nominal: float) -> tuple[Array, bool]:
    """Weight of the whole vehicle [N], and whether it was measured."""
    for roles in (["load"], [r for r in series if r.startswith("load/")]):
        there = [r for r in roles if r in series and np.isfinite(series[r].value).any()]
        if there:
            total = np.sum([_held(series[r], start, edges, np.nan) for r in there], axis=0)
            return np.where(np.isfinite(total) & (total > 0.1 * nominal), total, nominal), True
    return np.full(len(edges) - 1, nominal), False


def _ordered(series: Series, start: int) -> tuple[Array, Array]:
    """Times [s] and values that are finite, by stamp; of equal stamps the first."""
    finite = np.isfinite(series.value)
    at, index = np.unique(series.stamp_ns[finite], return_index=True)
    return np.asarray((at - start) * 1e-9, dtype=float), series.value[finite][index]


def _means(at: Array, value: Array, edges: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Mean over each step, along straight lines between samples; and where no gap there is too long for that."""
    middle = 0.5 * (edges[1:] + edges[:-1])
    after = np.clip(np.searchsorted(at, middle), 1, len(at) - 1)
    known = (at[after] - at[after - 1] <= LONGEST_HOLD_S) & (middle <= at[-1]) & (middle >= at[0])
    return Course.of(at, value).means(edges[:-1], STEP_S), known


def _held(series: Series, start: int, edges: Array, default: float) -> Array:
    """The last finite value before the middle of each step; before the first that one."""
    at, value = _ordered(series, start)
    if not len(at):
        return np.full(len(edges) - 1, default)
    middle = 0.5 * (edges[1:] + edges[:-1])
    return value[np.maximum(np.searchsorted(at, middle, side="right") - 1, 0)]


def _listed(left_out: dict[str, int]) -> str:
    return ", ".join(f"{n} s {reason}" for reason, n in left_out.items() if n)
