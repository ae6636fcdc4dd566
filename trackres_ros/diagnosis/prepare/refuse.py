# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Refuses recordings without comparable data: too short, given twice, without torque or speed, too fast or too slow."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from operator import attrgetter
from typing import TypeVar

import numpy as np

from trackres_ros.diagnosis.prepare.notes import WarningNote
from trackres_ros.diagnosis.prepare.same_drive import Course, common_roles, same_drive
from trackres_ros.diagnosis.prepare.session import MOST_LAGS, DriveSession
from trackres_ros.diagnosis.prepare.settings import SLOWEST_MPS, SLOWEST_SHARE, STEP_S, GateSettings
from trackres_ros.errors import InputError, MissingExtraError, one_line
from trackres_ros.recording.choosing import torque_remedy
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.roles import Conversion
from trackres_ros.recording.samples import Series
from trackres_ros.recording.topics_files import line_to_write
from trackres_ros.units import KMH_PER_MPS

SHORTEST_S = 120.0
EARLIEST_CLOCK_S = 6e8  # 1989: an earlier time is relative to the recording's own start
MOST_OVERLAP = 0.1  # of the shorter: too much for a small clock error

Given = TypeVar("Given")
Used = TypeVar("Used")


def duration_s(series: Mapping[str, Series]) -> float:
    """Time from the first speed to the last [s]."""
    speed = series.get("speed")
    at = speed.stamp_ns[np.isfinite(speed.value)] if speed else np.empty(0)
    return float(at.max() - at.min()) * 1e-9 if len(at) else 0.0


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
    given: Iterable[Given],
    use: Callable[[Given], Used],
    refused: list[Refusal],
    name: Callable[[Given], str] = attrgetter("name"),
) -> list[Used]:
    """Results of `use` for each usable recording; the others go to `refused`."""
    made = []
    for one in given:
        try:
            made.append(use(one))
        except MissingExtraError:
            raise
        except InputError as error:
            refused.append(Refusal(name(one), error))
    return made


def nothing_left(refused: Sequence[Refusal]) -> InputError:
    """Error if no recording can be used: the reason of each, equal reasons once."""
    alike: dict[tuple[str, str, str], list[Refusal]] = {}
    for one in sorted(refused, key=lambda one: one.name):
        where = one.error.where
        part = where.removeprefix(one.name) if where.startswith(one.name) else f": {where}"
        alike.setdefault((part, one.error.allowed, one.error.remedy), []).append(one)
    errors = [
        InputError(", ".join(one.name for one in ones) + part, ones[0].error.given, allowed, remedy)
        for (part, allowed, remedy), ones in alike.items()
    ]
    if len(errors) == 1:
        return errors[0]
    reasons = "; ".join(f"{error.where}: {error.given}, {error.remedy or error.allowed}" for error in errors)
    return InputError("recordings", f"{len(refused)}, all unusable", "at least one usable recording", reasons)


def too_short_pieces(where: str, step: float) -> InputError:
    """Error if the samples to fit on come in pieces too short for a fit, in steps of `step` [s]."""
    given = "a torque of the fitted laps that is too short, or has too many gaps"
    allowed = f"driving for more than {MOST_LAGS * step:.3g} s without a gap"
    return InputError(where, given, allowed, "record the torque without gaps, or give a longer recording")


def refuse_repeated(recordings: Sequence[Recording]) -> None:
    """Refuse two recordings of the same file, or of the same speed and torque, in whole or in part: they show one drive twice."""

    @cache
    def course(number: int, roles: tuple[str, ...]) -> Course:
        return Course.of(recordings[number], roles)

    for (i, one), (j, other) in combinations(enumerate(recordings), 2):
        shared = {path.resolve() for path in one.paths} & {path.resolve() for path in other.paths}
        roles = common_roles(one, other)
        if shared or (roles and same_drive(course(i, roles), course(j, roles))):
            in_both = ", ".join(map(str, sorted(shared))) or "the same samples, for a minute of driving or for all of it,"
            raise InputError(
                f"{one.name}, {other.name}",
                f"{in_both} in both",
                "each drive once: a second copy, also of a part, would count as independent evidence",
                "give one of them",
            )


def refuse_overlaps(recordings: Sequence[Recording], notes: list[str]) -> None:
    """Refuse two recordings of the same time of day: they show the same drive twice. Without such a clock none is refused."""
    clocked = [(r.start_ns * 1e-9, r) for r in recordings if r.start_ns * 1e-9 > EARLIEST_CLOCK_S]
    spans = sorted((begin, begin + duration_s(r.series), r.name) for begin, r in clocked)
    for i, (begin, end, name) in enumerate(spans):
        for other_begin, other_end, other in spans[i + 1 :]:
            both = min(end, other_end) - other_begin
            if both > MOST_OVERLAP * min(end - begin, other_end - other_begin) and both > STEP_S:
                raise InputError(
                    f"{name}, {other}",
                    f"{both:.0f} s that both recordings cover",
                    "recordings that do not overlap in time",
                    "give one of them, or join their channels; if the drives differ, correct the wrong clock",
                )
            if both > STEP_S:
                text = f"{name}, {other}: their clocks overlap by {both:.0f} s; treated as consecutive"
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
    what, max_speed = ("vehicle" if settings.is_vehicle else "machine"), settings.max_speed
    fastest = float(np.percentile(np.abs(session.speed), 99.0))
    if fastest < min(SLOWEST_MPS, SLOWEST_SHARE * max_speed):
        raise InputError(session.name, f"speeds up to {fastest:.2g} m/s", f"a {what} that moves")
    if fastest > 1.5 * max_speed:
        raise InputError(
            f"{session.name}: speed",
            f"{fastest:.0f} m/s",
            f"at most the {what}'s {max_speed:g} m/s",
            f"if it is in km/h, {line_to_write('speed', Conversion(1.0 / KMH_PER_MPS), session.bindings)}"
            if settings.is_vehicle
            else "",
        )
