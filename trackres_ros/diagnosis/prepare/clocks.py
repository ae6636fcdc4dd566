# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks the clocks of one recording: steps back in time, and offsets of minutes or hours to the speed's clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from trackres_ros.diagnosis.prepare.notes import WarningNote
from trackres_ros.diagnosis.prepare.sampling import means, ordered
from trackres_ros.diagnosis.prepare.session import Array
from trackres_ros.diagnosis.prepare.settings import SLOWEST_MPS, STEP_S
from trackres_ros.diagnosis.prepare.torque_checks import CLEARLY_BETTER, LARGEST_SHIFT_S, LEAST_SHIFT_S, SURE
from trackres_ros.errors import InputError
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.roles import base_role
from trackres_ros.recording.samples import Series

SECOND_NS = 1_000_000_000
OVERLAP_SHARE = 0.02  # of samples preceded by one of another part: samples of overlapping parts alternate
SET_BACK_S = 5.0  # more than samples overtake each other in transport
LONG_PAUSE_S, LONGEST_PAUSE_S = 600.0, 86400.0  # within a recording: one to mention, and one from a changed clock
ZONE_S = 900.0  # clocks of two time zones differ by a multiple of it
BOTH_ENDS_S = 10.0  # most difference between the offsets at begin and end of a role
FEWEST = 30  # steps
SLOW_ROLES = ("ambient",)  # hardly change in hours, so a late start is usable
NO_COURSE = ("stood", "passengers")  # recorded at other times than while it drives


class _Offset(NamedTuple):
    """How far the clock of a role is ahead of the speed's [s], and whether the logging times confirm it."""

    seconds: int
    logged: bool


def on_one_clock(recording: Recording) -> tuple[Recording, list[str]]:
    """The recording with every role on the clock of the speed, and notes.

    A role that begins and ends the same time before or after the speed has another clock. A torque is shifted if it then fits the
    speed, and refused if ambiguous. Another role is shifted if the logging times, or such a torque, confirm the offset. Another
    role that is off by a time zone is not used. A clock of speed or torque that was set back is refused.
    """
    series = dict(recording.series)
    torques = [role for role in series if base_role(role) == "torque"]
    several = len(recording.paths) > 1  # bags, which may be given in any order
    for role in ("speed", *torques):
        _refuse_set_back(f"{recording.name}: {role}", series[role], several)
    start = recording.start_ns
    at, speed = ordered(series["speed"], start)
    notes = _pauses(recording.name, at)
    moved: set[int] = set()
    for role in (*torques, *(role for role in series if role not in torques and role != "speed")):
        its = ordered(series[role], start)
        if base_role(role) in NO_COURSE or len(its[0]) < 2 or max(at[0] - its[0][0], its[0][-1] - at[-1]) <= LARGEST_SHIFT_S:
            continue
        where, off = f"{recording.name}: {role}", _offset(series, role, at, its[0])
        given = f"recorded from {its[0][0]:.0f} s to {its[0][-1]:.0f} s, the speed from {at[0]:.0f} s to {at[-1]:.0f} s"
        sure = ""
        if off is not None and role in torques and _goes_better((at, speed), its, off.seconds, where, given):
            moved.add(off.seconds)
            sure = "it then correlates with the speed"
        elif off is not None and role not in torques and off.logged:
            sure = "by the log time"
        elif off is not None and role not in torques and any(abs(off.seconds - other) <= LEAST_SHIFT_S for other in moved):
            sure = "by the torque"
        if off is not None and sure:
            series[role] = replace(series[role], stamp_ns=series[role].stamp_ns - off.seconds * SECOND_NS)
            notes.append(f"{where}: its clock differs from the speed's by {off.seconds:+d} s; corrected ({sure})")
        elif off is None or role in torques or abs(off.seconds - ZONE_S * (round(off.seconds / ZONE_S) or 1)) > BOTH_ENDS_S:
            notes.append(f"{where} is {given}; only the common part is compared")
        elif base_role(role) in SLOW_ROLES:
            notes.append(WarningNote(f"{where} is {given}: its clock seems to be {off.seconds:+d} s off; it is used uncorrected"))
        else:
            del series[role]
            used = "it is not used; correct its times to use it"
            notes.append(WarningNote(f"{where} is {given}: its clock seems to be {off.seconds:+d} s off; {used}"))
    return replace(recording, series=series, order=None), notes


def _refuse_set_back(where: str, series: Series, several: bool) -> None:
    """Refuse a clock that goes back, unless parts that do not overlap were given in another order."""
    stamps = series.stamp_ns[np.isfinite(series.value)]
    back = np.flatnonzero(np.diff(stamps) < -SET_BACK_S * SECOND_NS)
    if not len(back):
        return
    part = np.searchsorted(back, np.arange(len(stamps)), side="left")
    if several and np.count_nonzero(np.diff(part[np.argsort(stamps, kind="stable")])) < OVERLAP_SHARE * len(stamps):
        return
    by, after = (stamps[back[0]] - stamps[back[0] + 1]) / SECOND_NS, (stamps[back[0]] - stamps[0]) / SECOND_NS
    raise InputError(
        where,
        f"times that go back by {by:.0f} s, {after:.0f} s after the beginning",
        "times that increase from beginning to end",
        "correct the later times, or save each part as its own recording; sort parts that are out of order",
    )


def _pauses(name: str, at: Array) -> list[str]:
    """Notes on long pauses of the speed; an `InputError` if one is longer than a day."""
    gaps = np.diff(at)
    longest = int(np.argmax(gaps)) if len(gaps) else 0
    if len(gaps) and gaps[longest] > LONGEST_PAUSE_S:
        given = f"a gap of {gaps[longest] / LONGEST_PAUSE_S:.1f} days, {at[longest] - at[0]:.0f} s after the beginning"
        remedy = "if the clock was set there, correct the earlier times; else save each part as its own recording"
        raise InputError(f"{name}: speed", given, "gaps of a day at most", remedy)
    return [
        f"{name}: no speed for {gaps[i]:.0f} s, {at[i] - at[0]:.0f} s after the beginning; treated as a pause"
        for i in np.flatnonzero(gaps > LONG_PAUSE_S)
    ]


def _offset(series: Mapping[str, Series], role: str, at: Array, its: Array) -> _Offset | None:
    """Clock offset of a role, from the logging times, else from its begin and end; None where neither gives one."""
    logged = round((_ahead_ns(series[role]) - _ahead_ns(series["speed"])) / SECOND_NS)
    if abs(logged) >= LEAST_SHIFT_S and max(at[0] - its[0] + logged, its[-1] - at[-1] - logged) <= LARGEST_SHIFT_S:
        return _Offset(logged, True)
    begin, end = its[0] - at[0], its[-1] - at[-1]
    tolerance = max(BOTH_ENDS_S, 3.0 * float(np.median(np.diff(its))))
    return _Offset(round(0.5 * (begin + end)), False) if abs(begin - end) <= tolerance else None


def _ahead_ns(series: Series) -> float:
    return float(np.median(series.stamp_ns - series.arrival_ns))


def _goes_better(speed: tuple[Array, Array], torque: tuple[Array, Array], seconds: int, where: str, given: str) -> bool:
    """Whether a torque fits the speed better after the shift, not without it; an `InputError` if it fits neither way."""
    as_it_is, moved = (_explained(speed, (torque[0] - off, torque[1])) for off in (0, seconds))
    if moved >= SURE and moved >= as_it_is + CLEARLY_BETTER:
        return True
    if as_it_is >= SURE:
        return False
    raise InputError(
        where,
        f"{given}: its clock may be {seconds:+d} s off",
        "torque and speed on one clock",
        "correct the times of one of them; for a bag with wrong header stamps, set stamp: log in the topics file",
    )


def _explained(speed: tuple[Array, Array], torque: tuple[Array, Array]) -> float:
    """Correlation of a torque with the fitted torque of speed and acceleration; 0 with too few common samples."""
    edges = np.arange(speed[0][0], speed[0][-1], STEP_S)
    v, known = means(*speed, edges)
    shown, measured = means(*torque, edges)
    use = known & measured & (np.abs(v) > SLOWEST_MPS)
    if use.sum() < FEWEST:
        return 0.0
    accel = np.diff(np.interp(edges, *speed)) / STEP_S
    columns = np.column_stack([accel, np.sign(v), v, v * np.abs(v)])[use]
    fitted = columns @ np.linalg.lstsq(columns, shown[use], rcond=None)[0]
    if np.ptp(fitted) == 0.0 or np.ptp(shown[use]) == 0.0:
        return 0.0
    return float(np.corrcoef(fitted, shown[use])[0, 1])
