# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks recordings: refuses those without comparable data, those of a drive given twice, and implausible units."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from operator import attrgetter
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.prepare.sampling import sort_samples
from trackres_ros.diagnosis.prepare.session import (
    SLOWEST_MPS,
    SLOWEST_SHARE,
    STEP_S,
    Array,
    DriveSession,
    GateSettings,
    Mask,
    SensorFinding,
    WarningNote,
)
from trackres_ros.effects.sensor.speed_scale import SpeedScale
from trackres_ros.errors import InputError, MissingExtraError, one_line
from trackres_ros.recording.bindings import TopicBinding
from trackres_ros.recording.guessing import torque_remedy
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.roles import PLAUSIBLE, ROLES, UNITS, Conversion, base_role
from trackres_ros.recording.samples import Series
from trackres_ros.recording.topics_files import line_to_write
from trackres_ros.text import some_of
from trackres_ros.units import GRAVITY, KMH_PER_MPS

SAME_S, SAME_MPS, SAME_NM = 1e-3, 1e-4, 0.1  # a table rounds by less, and two drives differ by more
SAME = 1.0 + 1e-9  # of the tolerances
PIECE_S, PIECES = 10.0, 6  # of driving at a changing speed: a minute in common is no chance
LONGEST_STEP_S = 2.0  # that a change of speed counts for
PROBES, PROBE_EVERY_S = 8, 0.1  # samples of a piece to compare, and their least distance
MOST_MISSED = 0.1  # of them: a copy may lack samples

Indices = NDArray[np.intp]


def common_roles(recording: Recording, other_recording: Recording) -> tuple[str, ...]:
    """The speed and the torques that both have; empty without a speed."""
    roles = [role for role in recording.series if role in other_recording.series and base_role(role) == "torque"]
    return ("speed", *roles) if "speed" in recording.series and "speed" in other_recording.series else ()


@dataclass(frozen=True, eq=False)
class Course:
    """Speed and torques of a recording at the samples of the speed, by time, whatever the order and number of its rows."""

    times: Array  # [s]
    values: Array  # in units of `SAME_MPS` and `SAME_NM`, the speed first, shape (roles, n)
    order: Indices  # samples by their `_keys`
    keys: Array  # in that order

    @classmethod
    def of(cls, recording: Recording, roles: Sequence[str]) -> Course:
        """The course of a recording that has these roles, the speed first."""
        times, speed = sort_samples(recording.series["speed"], recording.start_ns)
        values = [speed / SAME_MPS]
        for role in roles[1:]:
            torque_times, torque = sort_samples(recording.series[role], recording.start_ns)
            values.append(np.concatenate(([np.nan], torque))[np.searchsorted(torque_times, times, side="right")] / SAME_NM)
        keys = _keys(np.array(values))
        order = np.argsort(keys, kind="stable")
        return cls(times, np.array(values), order, keys[order])

    @property
    def spacing(self) -> float:
        """Usual time between two samples [s]."""
        return float(np.median(np.diff(self.times))) if len(self.times) > 1 else np.inf

    def probes(self) -> Indices:
        """Samples from each piece of driving at a changing speed, shape (pieces, PROBES)."""
        rows = np.arange(0, len(self.times), max(1, round(PROBE_EVERY_S / self.spacing)))
        speed, is_known = self.values[0, rows], np.isfinite(self.values[:, rows]).all(axis=0)
        rows = rows[is_known & (np.abs(np.diff(speed, prepend=np.nan)) > SAME) & (np.abs(speed) > SAME)]
        if not len(rows):
            return np.empty((0, PROBES), np.intp)
        seconds_driven = np.cumsum(np.minimum(np.diff(self.times[rows], prepend=-np.inf), LONGEST_STEP_S))
        ends = np.searchsorted(seconds_driven, np.arange(0.0, seconds_driven[-1], PIECE_S))
        return np.asarray(rows[np.linspace(ends[:-1], ends[1:] - 1, PROBES, axis=1).astype(np.intp)])

    def lacks(self, times: Array, values: Array) -> Mask:
        """At which of some times there is no sample with these values, shape (times,)."""
        next_index = np.clip(np.searchsorted(self.times, times), 1, len(self.times) - 1)
        nearest_index = next_index - (times - self.times[next_index - 1] < self.times[next_index] - times)
        distance = np.abs(self.values[:, nearest_index] - values[:, None])
        return np.asarray((np.abs(self.times[nearest_index] - times) > 2.0 * SAME_S) | ~(distance <= SAME).all(axis=0))


def same_drive(course: Course, other: Course) -> bool:
    """Whether two recordings have equal speeds, and torques if any, at times the same distance apart, but for rounding.

    That holds for all samples since their starts, or for `PIECES` pieces of driving. A constant speed in a part is no proof.
    Nor is an equal speed with another torque: a driving cycle may be driven or simulated twice.
    """
    is_in_step = len(course.times) == len(other.times) > 0 and np.allclose(course.times, other.times, 0.0, SAME_S)
    is_equal = is_in_step and np.allclose(course.values, other.values, 0.0, SAME, equal_nan=True)
    coarse_course, fine_course = (
        (course, other) if course.spacing >= other.spacing else (other, course)
    )  # a copy may have fewer samples
    return is_equal or (
        len(coarse_course.times) > 1
        and len(fine_course.times) > 1
        and _has_pieces(coarse_course, coarse_course.probes(), fine_course)
    )


def _has_pieces(coarse_course: Course, probes: Indices, fine_course: Course) -> bool:
    """Whether another course has `PIECES` pieces in a row.

    The rarest probe of a piece gives possible shifts of time, the others are looked up after the shift.
    """
    values = coarse_course.values[:, probes]
    reach = SAME * float(_keys(np.ones((len(values), 1)))[0])
    first_rows = np.searchsorted(fine_course.keys, _keys(values) - reach)
    last = np.searchsorted(fine_course.keys, _keys(values) + reach, side="right")
    has_match = last > first_rows
    count = np.where(has_match, last - first_rows, len(fine_course.times) + 1)
    is_likely = has_match.mean(axis=1) >= 1.0 - 2.0 * MOST_MISSED
    for piece in range(len(probes) - PIECES + 1):
        if not is_likely[piece : piece + PIECES].all():
            continue
        rarest = int(np.argmin(count[piece]))
        rows = fine_course.order[first_rows[piece, rarest] : last[piece, rarest]]
        rows = rows[(np.abs(fine_course.values[:, rows] - values[:, piece, rarest, None]) <= SAME).all(axis=0)]
        shift, misses = fine_course.times[rows] - coarse_course.times[probes[piece, rarest]], np.zeros(len(rows))
        for number, probe in enumerate(probes[piece : piece + PIECES].T.ravel()):
            misses += fine_course.lacks(coarse_course.times[probe] + shift, coarse_course.values[:, probe])
            is_possible = misses <= 1.0 + MOST_MISSED * number
            shift, misses = shift[is_possible], misses[is_possible]
            if not len(shift):
                break
        if len(shift):
            return True
    return False


def _keys(values: Array) -> Array:
    """One number for the values of each sample, which hardly any other sample has; shape of `values` without its first axis."""
    return np.asarray(np.tensordot(np.sqrt(np.arange(1.0, len(values) + 1.0)), values, axes=1))


SHORTEST_S = 120.0
EARLIEST_CLOCK_S = 6e8  # 1989: an earlier time is relative to the recording's own start
MOST_OVERLAP = 0.1  # of the shorter: too much for a small clock error

Item = TypeVar("Item")
Result = TypeVar("Result")


def duration_s(series: Mapping[str, Series]) -> float:
    """Time from the first speed to the last [s]."""
    speed = series.get("speed")
    stamps = speed.stamp_ns[np.isfinite(speed.value)] if speed else np.empty(0)
    return float(stamps.max() - stamps.min()) * 1e-9 if len(stamps) else 0.0


@dataclass(frozen=True, slots=True)
class Refusal:
    """A recording that cannot be used: its name, and why."""

    name: str
    error: InputError

    @property
    def reason(self) -> str:
        """The reason, without its name."""
        return str(self.error).removeprefix(one_line(self.name)).lstrip(": ")


def each_usable(
    items: Iterable[Item],
    use: Callable[[Item], Result],
    refusals: list[Refusal],
    name: Callable[[Item], str] = attrgetter("name"),
) -> list[Result]:
    """Results of `use` for each usable recording; the others go to `refusals`."""
    results = []
    for item in items:
        try:
            results.append(use(item))
        except MissingExtraError:
            raise
        except InputError as error:
            refusals.append(Refusal(name(item), error))
    return results


def nothing_left(refusals: Sequence[Refusal]) -> InputError:
    """Error if no recording can be used: the reason of each, equal reasons once."""
    groups: dict[tuple[str, str, str], list[Refusal]] = {}
    for refusal in sorted(refusals, key=lambda refusal: refusal.name):
        where = refusal.error.where
        part = where.removeprefix(refusal.name) if where.startswith(refusal.name) else f": {where}"
        groups.setdefault((part, refusal.error.allowed, refusal.error.remedy), []).append(refusal)
    errors = [
        InputError(", ".join(refusal.name for refusal in group) + part, group[0].error.given, allowed, remedy)
        for (part, allowed, remedy), group in groups.items()
    ]
    if len(errors) == 1:
        return errors[0]
    reasons = "; ".join(f"{error.where}: {error.given}, {error.remedy or error.allowed}" for error in errors)
    return InputError("recordings", f"{len(refusals)}, all unusable", "at least one usable recording", reasons)


def refuse_repeated(recordings: Sequence[Recording]) -> None:
    """Refuse two recordings of the same file, or of the same speed and torque, in whole or in part: they show one drive twice."""

    @cache
    def course(number: int, roles: tuple[str, ...]) -> Course:
        return Course.of(recordings[number], roles)

    for (i, recording), (j, other_recording) in combinations(enumerate(recordings), 2):
        shared_paths = {path.resolve() for path in recording.paths} & {path.resolve() for path in other_recording.paths}
        roles = common_roles(recording, other_recording)
        if shared_paths or (roles and same_drive(course(i, roles), course(j, roles))):
            common = ", ".join(map(str, sorted(shared_paths))) or "the same samples, for a minute of driving or for all of it,"
            raise InputError(
                f"{recording.name}, {other_recording.name}",
                f"{common} in both",
                "each drive once: a second copy, also of a part, would count as independent evidence",
                "give one of them",
            )


def refuse_overlaps(recordings: Sequence[Recording], notes: list[str]) -> None:
    """Refuse two recordings of the same time of day: they show the same drive twice. Without such a clock none is refused."""
    recordings_with_clock = [(r.start_ns * 1e-9, r) for r in recordings if r.start_ns * 1e-9 > EARLIEST_CLOCK_S]
    spans = sorted((begin, begin + duration_s(r.series), r.name) for begin, r in recordings_with_clock)
    for i, (begin, end, name) in enumerate(spans):
        for other_begin, other_end, other_recording in spans[i + 1 :]:
            overlap_s = min(end, other_end) - other_begin
            if overlap_s > MOST_OVERLAP * min(end - begin, other_end - other_begin) and overlap_s > STEP_S:
                raise InputError(
                    f"{name}, {other_recording}",
                    f"{overlap_s:.0f} s that both recordings cover",
                    "recordings that do not overlap in time",
                    "give one of them, or join their channels; if the drives differ, correct the wrong clock",
                )
            if overlap_s > STEP_S:
                text = f"{name}, {other_recording}: their clocks overlap by {overlap_s:.0f} s; treated as consecutive"
                notes.append(WarningNote(text))


def check_compared(recording: Recording, shortest_s: float) -> None:
    """Refuse a recording without a torque, without a speed, or too short."""
    name, series = recording.name, recording.series
    if not any(role.partition("/")[0] == "torque" and np.isfinite(s.value).any() for role, s in series.items()):
        raise InputError(
            name,
            f"no torque; roles: {', '.join(series) or 'none'}",
            "a measured torque: without it there is nothing to compare",
            torque_remedy(recording.torque_candidates, of_topics=recording.zero_is_unset),
        )
    if "speed" not in series or not np.isfinite(series["speed"].value).any():
        raise InputError(name, "no finite speed", "a speed")
    seconds = duration_s(series)
    if seconds < shortest_s:
        raise InputError(name, f"{seconds:.3g} s", f"at least {shortest_s:.3g} s of recording")


def check_speed(session: DriveSession, settings: GateSettings) -> None:
    """Refuse a session that never moves, or exceeds the maximum speed."""
    noun, max_speed = ("vehicle" if settings.is_vehicle else "machine"), settings.max_speed
    fastest_mps = float(np.percentile(np.abs(session.speed), 99.0))
    if fastest_mps < min(SLOWEST_MPS, SLOWEST_SHARE * max_speed):
        raise InputError(session.name, f"speeds up to {fastest_mps:.2g} m/s", f"a {noun} that moves")
    if fastest_mps > 1.5 * max_speed:
        raise InputError(
            f"{session.name}: speed",
            f"{fastest_mps:.0f} m/s",
            f"at most the {noun}'s {max_speed:g} m/s",
            f"if it is in km/h, {line_to_write('speed', Conversion(1.0 / KMH_PER_MPS), session.bindings)}"
            if settings.is_vehicle
            else "",
        )


HOTTEST_AIR_DEGC = 50.0  # as a median of hours; the record of a moment in the shade is 57
UNUSUAL_AIR_DEGC = 40.0
WEIGHTS = (0.3, 2.5)  # over that of the vehicle file: range for a lighter or loaded vehicle
USUAL_WEIGHTS = (0.6, 1.7)
AROUND = 1.7  # either way of a unit's factor
FASTEST_TURN, STEEPEST = PLAUSIBLE["yaw_rate"][1], PLAUSIBLE["grade"][1]
SPEED_OFF = 0.01  # against the recorded distance
RELATED = 0.8  # correlation from which the ratio of two series is due to units
FEWEST = 30


def check_units(recording: Recording, settings: GateSettings) -> list[str]:
    """Refuse values in a wrong unit, with the line for the topics file; note unusual ones; `settings`: facts of the vehicle."""
    notes, bindings = [], recording.bindings
    for role, samples in recording.series.items():
        value = samples.value[np.isfinite(samples.value)]
        if not len(value):
            continue
        where, base = f"{recording.name}: {role}", base_role(role)
        middle, largest_value = float(np.median(value)), float(np.percentile(np.abs(value), 95.0))
        if base in ("ambient", "belt"):
            notes += _temperature(where, role, middle, bindings)
        elif base == "yaw_rate" and largest_value > FASTEST_TURN:
            _refuse(where, f"{largest_value:.3g} rad/s", f"at most {FASTEST_TURN:g}", "deg/s", role, bindings)
        elif base == "grade" and largest_value > STEEPEST:
            allowed = f"rise over run, at most {STEEPEST:g}"
            _refuse(where, f"slopes of {largest_value:.3g}", allowed, "%", role, bindings)
        elif base == "heading" and _turns_by(value, 360.0) and not _turns_by(value, 2.0 * np.pi):
            _refuse(where, "jumps of 360", "an angle in rad", "deg", role, bindings)
    notes += _weight(recording, settings)
    return notes


def check_speed_unit(
    name: str,
    bindings: Mapping[str, TopicBinding],
    speed: Array,
    accel: Array,
    recorded_accel: Array | None,
    distance: Array | None,
) -> list[str]:
    """Refuse a speed that recorded acceleration or distance show is not in m/s; a note on a small deviation from the distance.

    `speed` is the mean of each step [m/s] and `accel` its change [m/s^2], shape (n,). Recorded are accelerations [m/s^2], and the
    distance of each step [m], or None.
    """
    if recorded_accel is not None:
        ratio = _ratio(recorded_accel, accel)
        for unit, (factor, _) in _other_units("speed").items():
            if ratio and 1.0 / AROUND**0.5 < ratio / factor < AROUND**0.5:
                statement = f"changes {1.0 / ratio:.2g} times as fast as the recorded acceleration says"
                _refuse(f"{name}: speed", statement, "a speed in m/s", unit, "speed", bindings)
        if ratio and GRAVITY / AROUND**0.5 < 1.0 / ratio < GRAVITY * AROUND**0.5:
            statement = f"{ratio:.2g} times the acceleration from the speed"
            _refuse(f"{name}: accel", statement, "an acceleration in m/s2", "g", "accel", bindings)
    ratio = _ratio(distance, speed) if distance is not None else 0.0
    if ratio:
        for unit, (factor, _) in _other_units("speed").items():
            if 0.9 < ratio / factor < 1.1:
                statement = f"{1.0 / ratio:.2f} times as fast as the recorded distance grows"
                _refuse(f"{name}: speed", statement, "a speed in m/s", unit, "speed", bindings)
        if 0.9 < 1e3 * ratio < 1.1:
            _refuse(f"{name}: distance", f"{ratio:.2g} times the distance from the speed", "metres", "km", "distance", bindings)
        if abs(1.0 / ratio - 1.0) > SPEED_OFF:
            return [speed_off({name: ratio - 1.0})]
    return []


def speed_off(errors: Mapping[str, float]) -> SensorFinding:
    """A speed that the recorded distance contradicts: true over measured speed, minus one, of each recording."""
    value = float(np.median(list(errors.values())))
    excess = 1.0 / (1.0 + value) - 1.0
    statement = (
        f"the speed is {100.0 * abs(excess):.1f} % {'more' if excess > 0.0 else 'less'} than the recorded distance implies"
    )
    return SensorFinding(
        f"{some_of(list(errors), 2)}: {statement}: one of them is wrong", f"T{statement[1:]}", SpeedScale.name, value
    )


def pool_notes(notes: Sequence[str]) -> list[str]:
    """Notes with one finding for all recordings whose speed is off to the same side."""
    errors: dict[bool, dict[str, float]] = {}
    for note in notes:
        if isinstance(note, SensorFinding) and note.effect == SpeedScale.name:
            errors.setdefault(note.value > 0.0, {})[note.partition(": ")[0]] = note.value
    other_notes = [note for note in notes if not (isinstance(note, SensorFinding) and note.effect == SpeedScale.name)]
    return [*map(speed_off, errors.values()), *other_notes]


def _other_units(role: str) -> dict[str, Conversion]:
    """Conversions from the other units of a role."""
    si_unit = ROLES[base_role(role)].unit
    return {unit: conversion for unit, conversion in UNITS[si_unit].items() if unit != si_unit}


def _refuse(where: str, value: str, allowed: str, unit: str, role: str, bindings: Mapping[str, TopicBinding]) -> None:
    raise InputError(where, value, allowed, f"if it is in {unit}, {line_to_write(role, _other_units(role)[unit], bindings)}")


def _temperature(where: str, role: str, middle: float, bindings: Mapping[str, TopicBinding]) -> list[str]:
    coldest_degc, hottest_degc = (
        PLAUSIBLE["ambient"][0],
        HOTTEST_AIR_DEGC if base_role(role) == "ambient" else PLAUSIBLE["belt"][1],
    )
    for unit, (scale, offset) in _other_units(role).items():
        if coldest_degc <= scale * middle + offset <= hottest_degc < middle:
            _refuse(where, f"{middle:.4g} degC (median)", f"{coldest_degc:g} to {hottest_degc:g} degC", unit, role, bindings)
    if not coldest_degc <= middle <= hottest_degc:
        raise InputError(
            where, f"{middle:.4g} degC (median)", f"{coldest_degc:g} to {hottest_degc:g} degC", "is the sensor connected?"
        )
    if base_role(role) == "ambient" and middle > UNUSUAL_AIR_DEGC:
        line = line_to_write(role, _other_units(role)["degF"], bindings)
        statement = f"air of {middle:.0f} degC is unusual"
        return [SensorFinding(f"{where}: {statement}; if it is in degF, {line}", statement.capitalize())]
    return []


def _weight(recording: Recording, settings: GateSettings) -> list[str]:
    """Compare the recorded loads with the vehicle file's of the same parts."""
    finite_values = {role: s.value[np.isfinite(s.value)] for role, s in recording.series.items() if base_role(role) == "load"}
    loads = {role: np.array(np.median(value)) for role, value in finite_values.items() if len(value)}
    roles = ["load"] if "load" in loads else list(loads)
    if not roles:
        return []
    other_load = float(settings.total_load({role: np.array(0.0) for role in loads}))  # nominal, of the parts without a load
    weight = settings.weight - other_load
    share = (float(settings.total_load(loads)) - other_load) / weight
    where, low, high = f"{recording.name}: {', '.join(roles)}", *WEIGHTS
    carrier = "the whole vehicle" if roles == ["load"] else "these parts"
    statement = f"{share * weight:.4g} {ROLES['load'].unit}, {share:.2g} of the {weight:.4g} N of {carrier} in the vehicle file"
    if not low <= share <= high:
        for unit, factor in _other_units("load").items():
            if 1.0 / AROUND < share * factor.scale < AROUND:
                _refuse(where, statement, f"{low:g} to {high:g} of it", unit, "load", recording.bindings)
        remedy = f"give the weight of {carrier}; for a payload, add the empty weight as offset in the topics file"
        raise InputError(where, statement, f"{low:g} to {high:g} of it", remedy)
    if not USUAL_WEIGHTS[0] <= share <= USUAL_WEIGHTS[1]:
        return [
            SensorFinding(f"{where}: {statement}: is each part of the load recorded exactly once?", f"The load is {statement}")
        ]
    return []


def _turns_by(value: Array, full_turn: float) -> bool:
    """Whether an angle jumps by a whole turn, within a twentieth."""
    return bool((np.abs(np.abs(np.diff(value)) / full_turn - 1.0) < 0.05).any())


def _ratio(a: Array, b: Array) -> float:
    """Ratio of a to b, or 0 without a sufficient correlation."""
    is_valid = np.isfinite(a) & np.isfinite(b)
    a, b = a[is_valid], b[is_valid]
    if len(a) < FEWEST or not a.any() or not b.any():
        return 0.0
    correlation = float(a @ b / np.sqrt((a @ a) * (b @ b)))
    return float(a @ b / (b @ b)) / correlation if correlation > RELATED else 0.0
