# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Step 0, second half: checks units, signs and clocks of the torque against the vehicle file.

Clocks of one recording step back in time, or are minutes or hours off the speed's clock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.prepare.checks import Refusal, each_usable
from trackres_ros.diagnosis.prepare.sampling import means, sort_samples
from trackres_ros.diagnosis.prepare.session import (
    SLOWEST_MPS,
    STEP_S,
    Array,
    Cumulative,
    DriveSession,
    GateSettings,
    Mask,
    SensorFinding,
    WarningNote,
)
from trackres_ros.errors import InputError
from trackres_ros.recording.bindings import TopicBinding
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.roles import Conversion, base_role
from trackres_ros.recording.samples import Series
from trackres_ros.recording.topics_files import line_to_write, torque_causes, torque_line
from trackres_ros.units import KMH_PER_MPS, MAD_TO_STD, NANOSECOND
from trackres_ros.vehicle.gears import no_gears

SURE = 0.5  # correlation for a certain wrong sign or unit
HEALTHY = (0.62, 1.7)  # of the inertia: covers a gear loss of a quarter, rotating parts and a sensor gain together
FAR_OFF = (0.05, 20.0)  # of the total, where inertia does not show
ONE_WAY = 0.1  # of the energy that flows either way: a smaller balance has no certain sign
TAKEN_BACK = 0.3  # of the expected energy: so much with the other sign is no offset of the sensor
NEAR = 1.35  # either way of a factor
ROBUST_TURNS, OUTLIER = 5, 2.0
LARGEST_SHIFT_S = 30
FEWEST_COMPARED = 30  # steps, for a correlation; at least the largest shift
LEAST_SHIFT_S = 2
SMALL_ERROR = 0.2  # of the torque
UNLIKE = 1.8  # times the torque: more than load, ground and weather change between two drives of one vehicle
CLEARLY_BETTER = 0.05  # in correlation


def aligned_clock(session: DriveSession, model_torque: Array) -> tuple[DriveSession, str]:
    """The session with its torque shifted to the best correlation with the speed, and a note.

    Shifts only by whole steps from `LEAST_SHIFT_S` on: a shorter delay is physical, or a sensor's. Both halves must agree: on
    hills without a recorded slope, a smooth drive correlates best at another time by chance. And none with the other sign may
    correlate as well where it is: a motion to and fro then fits half a period later.
    """
    if session.used.sum() < FEWEST_COMPARED:
        return session, ""
    shifts = range(-LARGEST_SHIFT_S, LARGEST_SHIFT_S + 1)
    used_by_shift = {s: _shift_series(session.used, -s, filler=False) & session.used for s in shifts}
    first_half = np.cumsum(session.used) <= 0.5 * session.used.sum()

    def correlations(part: Mask) -> list[float]:
        return [
            _correlation(_shift_series(session.torque, -s), model_torque, session.speed, used_by_shift[s] & part) for s in shifts
        ]

    all_correlations = correlations(session.used)
    best_index = int(np.argmax(all_correlations))
    shift, gain = shifts[best_index], all_correlations[best_index] - abs(all_correlations[LARGEST_SHIFT_S])
    if abs(shift) < LEAST_SHIFT_S or gain < CLEARLY_BETTER or all_correlations[best_index] < SURE:
        return session, ""
    if any(abs(int(np.argmax(correlations(half_mask))) - best_index) > LEAST_SHIFT_S for half_mask in (first_half, ~first_half)):
        return session, ""
    course = session.torque_course and Cumulative(
        session.torque_course.times - shift * session.step, session.torque_course.integral
    )
    new_session = replace(session, torque=_shift_series(session.torque, -shift), used=used_by_shift[shift], torque_course=course)
    return new_session, f"{session.name}: the torque's clock differs from the speed's by {shift * session.step:+g} s; corrected"


def check_torque(
    sessions: Sequence[DriveSession], model_torques: Sequence[Array], resistances: Sequence[Array], settings: GateSettings
) -> list[str]:
    """Refuse a torque with a plainly wrong sign or unit, or of a part, with the remedy; warn where that is in doubt.

    `model_torques` is the torque of each session from the vehicle file [Nm], and `resistances` the same without inertia. The
    resistance may be several times the data sheet's. The inertia may not, because the mass is known. So the torque is compared
    with the inertia torque where that shows; for a machine beside any offset and friction.
    """
    used_masks = [s.used for s in sessions]
    m, e, r, v = (
        np.concatenate([x[u] for x, u in zip(series, used_masks, strict=True)])
        for series in ([s.torque for s in sessions], model_torques, resistances, [s.speed for s in sessions])
    )
    where = f"{', '.join(s.name for s in sessions)}: torque"
    if np.ptp(m) == 0.0:
        raise InputError(where, f"always {m[0]:g} Nm", "a torque that changes; is the sensor connected?")
    if not e.any():
        raise InputError(f"{where} of the model", "always 0", "a torque that depends on speed or acceleration")
    # A vehicle that only speeds up hardly separates an offset from its inertia; its resistance has the friction anyway.
    columns = r[:, np.newaxis] if settings.is_vehicle else np.stack([r, np.ones(len(r)), np.sign(v)], axis=1)
    inertia = _inertia(m, e - r, columns)
    notes = _sign_notes(where, (m, e, v), inertia, sessions, settings)
    low, high = HEALTHY[0] * settings.torque_share[0], HEALTHY[1] * settings.torque_share[1]
    allowed = "the torque of the whole vehicle at its sprockets, in Nm" if settings.is_vehicle else "the torque of the model"
    if not (inertia.lower_share <= high and inertia.upper_share >= low):
        share = float(np.sqrt(inertia.lower_share * inertia.upper_share))
        statement = f"about {share:.2g} times the expected torque, by the speed's changes"
        if inertia.correlation >= SURE:
            raise InputError(where, statement, allowed, _remedy(share, sessions, settings))
        notes.append(_doubt(where, statement, _remedy(share, sessions, settings)))
    slope, size = float(m @ e / (e @ e)), float(np.sqrt((m @ m) / (e @ e)))
    least_share, most_share = FAR_OFF[0] * settings.torque_share[0], FAR_OFF[1] * settings.torque_share[1]
    if size <= least_share or size > most_share + settings.friction / float(np.sqrt(np.mean(e**2))):
        raise InputError(where, f"about {size:.2g} times the expected torque", allowed, _remedy(size, sessions, settings))
    if not least_share < abs(slope) < most_share:
        notes.append(_doubt(where, f"about {slope:.2g} times the expected torque", _remedy(abs(slope), sessions, settings)))
    return notes


def _doubt(where: str, statement: str, remedy: str) -> str:
    return SensorFinding(f"{where}: {statement}, unless the model lacks much; {remedy}", f"The torque is {statement}")


def _sign_notes(
    where: str, series: tuple[Array, Array, Array], inertia: _Inertia, sessions: Sequence[DriveSession], settings: GateSettings
) -> list[str]:
    """Refuse a torque whose sign the energy contradicts; warn where only the torque's course does.

    What moves takes energy from its motor, over a drive as a whole. On hills without a recorded slope the torque may
    nevertheless fall where a rise is expected: uphill one pushes harder, and goes slower. `series` are measured and expected
    torque [Nm] and speed, of shape (n,).
    """
    m, e, v = series
    work = float(e @ v)
    energy = float(m @ v) / work if abs(work) > ONE_WAY * float(np.abs(e * v).sum()) else 0.0
    correlation = float(np.corrcoef(m, e)[0, 1]) if np.ptp(e) > 0.0 else 0.0
    is_reversed = energy < -TAKEN_BACK
    if not (is_reversed or correlation < -SURE):
        return []
    line = line_to_write("torque", Conversion(-1.0), *(s.bindings for s in sessions))
    energy_text = f"{energy:.2g} times the expected energy" if energy else "an energy of no certain sign"
    statement = f"{energy_text}, and a correlation of {correlation:.2f} with the expected torque"
    is_wrong = inertia.correlation < SURE if is_reversed else not energy and inertia.correlation < -SURE
    if is_wrong:
        motion = "driving forward" if settings.is_vehicle else "moving forward"
        raise InputError(where, statement, f"a torque that is positive when {motion}", line)
    reason = "a slope that is not recorded" if settings.is_vehicle else "something that the model lacks"
    sign_text = "its sign is right by the energy" if energy > 0.0 else f"if the sign is wrong, {line}"
    sentence = f"The torque has a correlation of {correlation:.2f} with the expected torque: {reason} may do this"
    return [SensorFinding(f"{where}: {statement}: {reason} may do this; {sign_text}", sentence)]


def faulty_torques(
    sessions: Sequence[DriveSession], model_torques: Sequence[Array], resistances: Sequence[Array], settings: GateSettings
) -> list[Refusal]:
    """Sessions that `check_torque` refuses one by one; none if it refuses all of them."""
    refusals: list[Refusal] = []

    def check(item: tuple[DriveSession, Array, Array]) -> None:
        session, torque, resistance = item
        check_torque([session], [torque], [resistance], settings)

    results = each_usable(zip(sessions, model_torques, resistances, strict=True), check, refusals, lambda item: item[0].name)
    return refusals if results else []


@dataclass(frozen=True)
class _Inertia:
    """Bounds of measured over expected inertia torque, as errors of the speed hide a part of it; and their correlation.

    The lower bound assumes an exact inertia, the upper bound an exact torque.
    """

    lower_share: float
    upper_share: float
    correlation: float


def _inertia(measured: Array, inertia: Array, other_columns: Array) -> _Inertia:
    """The share of the inertia, robustly, beside `other_columns`: resistance, or that, offset and friction, shape (n, k)."""
    weight, columns = np.ones(len(measured)), np.column_stack([inertia, other_columns])
    columns = columns / np.maximum(np.abs(columns).max(axis=0), 1e-300)

    def residual_after(x: Array, regressors: Array) -> Array:
        root = np.sqrt(weight)
        return np.asarray(x - regressors @ np.linalg.lstsq(regressors * root[:, np.newaxis], x * root, rcond=None)[0])

    for _ in range(ROBUST_TURNS):
        residual = residual_after(measured, columns)
        scale = MAD_TO_STD * float(np.median(np.abs(residual))) or 1.0
        weight = np.minimum(1.0, OUTLIER * scale / np.maximum(np.abs(residual), 1e-12))
    x, y = residual_after(inertia, columns[:, 1:]), residual_after(measured, columns[:, 1:])
    xy, xx, yy = (float((weight * a) @ b) for a, b in ((x, y), (x, x), (y, y)))
    correlation = xy / np.sqrt(xx * yy) if xx > 0.0 and yy > 0.0 else 0.0
    return _Inertia(xy / xx, yy / xy, correlation) if xx > 0.0 and xy > 0.0 else _Inertia(0.0, np.inf, correlation)


def _remedy(share: float, sessions: Sequence[DriveSession], settings: GateSettings) -> str:
    """Possible causes of this ratio to the expected torque, and the line for the topics file."""
    remedies, bindings = [], [s.bindings for s in sessions]
    causes = torque_causes(None if settings.gears is None else settings.gears.ratio, *bindings, is_vehicle=settings.is_vehicle)
    near = [name for name, cause in causes.items() if 1.0 / NEAR < share * cause.factor < NEAR]
    nearest_cause = min(near, key=lambda name: abs(np.log(share * causes[name].factor)), default="")
    fastest_mps = max(float(np.percentile(np.abs(s.speed), 99.0)) for s in sessions)
    if 1.0 / NEAR < share * KMH_PER_MPS < NEAR and fastest_mps > KMH_PER_MPS * SLOWEST_MPS:
        remedies.append(f"if the speed is in km/h, {line_to_write('speed', Conversion(1.0 / KMH_PER_MPS), *bindings)}")
    if nearest_cause:
        remedies.append(f"if it is {nearest_cause}, {torque_line(causes[nearest_cause], 1.0, *bindings)}")
    elif settings.is_vehicle:
        remedies.append(
            "write at: motor for a torque at the motor, and scale: 2.0 for the torque of one side of two, in the topics file"
        )
    else:
        remedies.append("scale in the topics file converts a unit; if the model is off, widen the ranges of its parameters")
    return "; ".join(remedies)


LOOK_AT = "check units, signs and that torque, speed and load belong to the whole vehicle; check the vehicle file"


def nothing_to_conclude(
    names: str, r2: Mapping[str, float], mae: Mapping[str, float], size: float, notes: Sequence[str] = ()
) -> InputError | None:
    """The error if no stage of the model predicts the torque of hold-out laps better than its mean, by R2 and mean error [Nm].

    A steady drive's torque hardly varies, so R2 means nothing if the error is small relative to `size`, the mean torque [Nm].
    """
    best_stage = max(r2, key=lambda stage: r2[stage])
    if r2[best_stage] >= 0.0 or min(mae.values()) < SMALL_ERROR * size:
        return None
    return InputError(
        f"{names}: torque",
        f"R2 {r2[best_stage]:.2f} on hold-out laps, with a mean error of {mae[best_stage]:.3g} Nm "
        f"at a mean torque of {size:.3g} Nm",
        "a torque that depends on speed and load; without it no conclusion is possible",
        "; ".join((*notes, LOOK_AT)),
    )


def inconsistent_scale_notes(sessions: Sequence[DriveSession], model_torques: Sequence[Array], is_vehicle: bool) -> list[str]:
    """Notes on recordings whose ratio of measured to expected torque differs from the others."""
    used_pairs = [(s.torque[s.used], e[s.used]) for s, e in zip(sessions, model_torques, strict=True)]
    shares = [float(m @ e) / max(float(e @ e), 1e-12) for m, e in used_pairs]
    middle = float(np.median(shares)) if len(shares) > 2 else max(shares)
    return [
        SensorFinding(
            f"{s.name}: its torque is {share:.2g} times the expected one, but {middle:.2g} times in other recordings: is it the "
            f"same {'vehicle' if is_vehicle else 'machine'}?",
            f"The torque of {s.name} is {share:.2g} times the expected one, but {middle:.2g} times in other recordings",
        )
        for s, share in zip(sessions, shares, strict=True)
        if s.used.sum() > 60 and not 1.0 / UNLIKE < share / middle < UNLIKE
    ]


def _correlation(a: Array, b: Array, speed: Array, used_steps: Mask) -> float:
    """Correlation of two torques beside any offset and friction, thus less their means forward and in reverse."""
    if used_steps.sum() < FEWEST_COMPARED:
        return 0.0
    x, y, forward = a[used_steps], b[used_steps], speed[used_steps] > 0.0
    for side in (forward, ~forward):
        if side.any():
            x[side] -= x[side].mean()
            y[side] -= y[side].mean()
    size = float(np.sqrt((x @ x) * (y @ y)))
    return (
        float(x @ y) / size
        if size > 1e-12 * float(np.sqrt((a[used_steps] @ a[used_steps]) * (b[used_steps] @ b[used_steps])))
        else 0.0
    )


def _shift_series(series: NDArray[Any], steps: int, filler: Any = None) -> NDArray[Any]:
    """The series shifted by steps, earlier if negative; where that is unknown, it repeats the edge, or has the given value."""
    if steps == 0:
        return series
    edge = np.full(abs(steps), series[0 if steps > 0 else -1] if filler is None else filler)
    return np.concatenate((edge, series[:-steps]) if steps > 0 else (series[-steps:], edge))


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
    log_offset: bool


def at_sprockets(recording: Recording, settings: GateSettings) -> Recording:
    """The recording with its torques at the sprockets, where the topics file says that they are at the motor.

    Raises InputError without gears in the vehicle file.
    """
    motor = [role for role in recording.series if base_role(role) == "torque" and _at_motor(recording.bindings, role)]
    if not motor:
        return recording
    gears = settings.gears
    if gears is None:
        raise no_gears(f"{recording.name}: {motor[0]}", settings.has_belt)
    times, speed = sort_samples(recording.series["speed"], recording.start_ns)
    series, bindings = dict(recording.series), dict(recording.bindings)
    for role in motor:
        samples = series[role]
        at_samples = np.interp((samples.stamp_ns - recording.start_ns) * NANOSECOND, times, speed)
        series[role] = replace(samples, value=gears.at_sprockets(samples.value, at_samples))
        bindings[role] = replace(bindings[role], gear_ratio=gears.ratio)
    return replace(recording, series=series, bindings=bindings)


def _at_motor(bindings: Mapping[str, TopicBinding], role: str) -> bool:
    return role in bindings and bindings[role].at == "motor"


def on_one_clock(recording: Recording) -> tuple[Recording, list[str]]:
    """The recording with every role on the clock of the speed, and notes.

    A role that begins and ends the same time before or after the speed has another clock. A torque is shifted if it then fits the
    speed, and refused if ambiguous. Another role is shifted if the logging times, or such a torque, confirm the offset. Another
    role that is off by a time zone is not used. A clock of speed or torque that was set back is refused.
    """
    series = dict(recording.series)
    torques = [role for role in series if base_role(role) == "torque"]
    has_several = len(recording.paths) > 1  # bags, which may be given in any order
    for role in ("speed", *torques):
        _refuse_set_back(f"{recording.name}: {role}", series[role], has_several)
    start = recording.start_ns
    times, speed = sort_samples(series["speed"], start)
    notes = _pauses(recording.name, times)
    shifts: set[int] = set()
    for role in (*torques, *(role for role in series if role not in torques and role != "speed")):
        samples = sort_samples(series[role], start)
        if (
            base_role(role) in NO_COURSE
            or len(samples[0]) < 2
            or max(times[0] - samples[0][0], samples[0][-1] - times[-1]) <= LARGEST_SHIFT_S
        ):
            continue
        where, offset = f"{recording.name}: {role}", _offset(series, role, times, samples[0])
        statement = (
            f"recorded from {samples[0][0]:.0f} s to {samples[0][-1]:.0f} s, the speed from {times[0]:.0f} s to {times[-1]:.0f} s"
        )
        evidence = ""
        if offset is not None and role in torques and _goes_better((times, speed), samples, offset.seconds, where, statement):
            shifts.add(offset.seconds)
            evidence = "it then correlates with the speed"
        elif offset is not None and role not in torques and offset.log_offset:
            evidence = "by the log time"
        elif (
            offset is not None
            and role not in torques
            and any(abs(offset.seconds - other_shift) <= LEAST_SHIFT_S for other_shift in shifts)
        ):
            evidence = "by the torque"
        if offset is not None and evidence:
            series[role] = replace(series[role], stamp_ns=series[role].stamp_ns - offset.seconds * SECOND_NS)
            notes.append(f"{where}: its clock differs from the speed's by {offset.seconds:+d} s; corrected ({evidence})")
        elif (
            offset is None
            or role in torques
            or abs(offset.seconds - ZONE_S * (round(offset.seconds / ZONE_S) or 1)) > BOTH_ENDS_S
        ):
            notes.append(f"{where} is {statement}; only the common part is compared")
        elif base_role(role) in SLOW_ROLES:
            notes.append(
                WarningNote(f"{where} is {statement}: its clock seems to be {offset.seconds:+d} s off; it is used uncorrected")
            )
        else:
            del series[role]
            remedy_text = "it is not used; correct its times to use it"
            notes.append(WarningNote(f"{where} is {statement}: its clock seems to be {offset.seconds:+d} s off; {remedy_text}"))
    return replace(recording, series=series, order=None), notes


def _refuse_set_back(where: str, series: Series, has_several: bool) -> None:
    """Refuse a clock that goes back, unless parts that do not overlap were given in another order."""
    stamps = series.stamp_ns[np.isfinite(series.value)]
    back = np.flatnonzero(np.diff(stamps) < -SET_BACK_S * SECOND_NS)
    if not len(back):
        return
    part = np.searchsorted(back, np.arange(len(stamps)), side="left")
    if has_several and np.count_nonzero(np.diff(part[np.argsort(stamps, kind="stable")])) < OVERLAP_SHARE * len(stamps):
        return
    step_s, offset_s = (stamps[back[0]] - stamps[back[0] + 1]) / SECOND_NS, (stamps[back[0]] - stamps[0]) / SECOND_NS
    raise InputError(
        where,
        f"times that go back by {step_s:.0f} s, {offset_s:.0f} s after the beginning",
        "times that increase from beginning to end",
        "correct the later times, or save each part as its own recording; sort parts that are out of order",
    )


def _pauses(name: str, times: Array) -> list[str]:
    """Notes on long pauses of the speed; an `InputError` if one is longer than a day."""
    gaps = np.diff(times)
    longest_index = int(np.argmax(gaps)) if len(gaps) else 0
    if len(gaps) and gaps[longest_index] > LONGEST_PAUSE_S:
        days, seconds = gaps[longest_index] / LONGEST_PAUSE_S, times[longest_index] - times[0]
        statement = f"a gap of {days:.1f} days, {seconds:.0f} s after the beginning"
        remedy = "if the clock was set there, correct the earlier times; else save each part as its own recording"
        raise InputError(f"{name}: speed", statement, "gaps of a day at most", remedy)
    return [
        f"{name}: no speed for {gaps[i]:.0f} s, {times[i] - times[0]:.0f} s after the beginning; treated as a pause"
        for i in np.flatnonzero(gaps > LONG_PAUSE_S)
    ]


def _offset(series: Mapping[str, Series], role: str, speed_times: Array, times: Array) -> _Offset | None:
    """Clock offset of a role, from the logging times, else from its begin and end; None where neither gives one."""
    log_offset = round((_ahead_ns(series[role]) - _ahead_ns(series["speed"])) / SECOND_NS)
    if (
        abs(log_offset) >= LEAST_SHIFT_S
        and max(speed_times[0] - times[0] + log_offset, times[-1] - speed_times[-1] - log_offset) <= LARGEST_SHIFT_S
    ):
        return _Offset(log_offset, True)
    begin, end = times[0] - speed_times[0], times[-1] - speed_times[-1]
    tolerance = max(BOTH_ENDS_S, 3.0 * float(np.median(np.diff(times))))
    return _Offset(round(0.5 * (begin + end)), False) if abs(begin - end) <= tolerance else None


def _ahead_ns(series: Series) -> float:
    return float(np.median(series.stamp_ns - series.arrival_ns))


def _goes_better(speed: tuple[Array, Array], torque: tuple[Array, Array], seconds: int, where: str, statement: str) -> bool:
    """Whether a torque fits the speed better after the shift, not without it; an `InputError` if it fits neither way."""
    present_share, new_share = (_explained_share(speed, (torque[0] - offset, torque[1])) for offset in (0, seconds))
    if new_share >= SURE and new_share >= present_share + CLEARLY_BETTER:
        return True
    if present_share >= SURE:
        return False
    raise InputError(
        where,
        f"{statement}: its clock may be {seconds:+d} s off",
        "torque and speed on one clock",
        "correct the times of one of them; for a bag with wrong header stamps, set stamp: log in the topics file",
    )


def _explained_share(speed: tuple[Array, Array], torque: tuple[Array, Array]) -> float:
    """Correlation of a torque with the fitted torque of speed and acceleration; 0 with too few common samples."""
    edges = np.arange(speed[0][0], speed[0][-1], STEP_S)
    v, is_known = means(*speed, edges)
    torques, measured = means(*torque, edges)
    use = is_known & measured & (np.abs(v) > SLOWEST_MPS)
    if use.sum() < FEWEST:
        return 0.0
    accel = np.diff(np.interp(edges, *speed)) / STEP_S
    columns = np.column_stack([accel, np.sign(v), v, v * np.abs(v)])[use]
    torque_fit = columns @ np.linalg.lstsq(columns, torques[use], rcond=None)[0]
    if np.ptp(torque_fit) == 0.0 or np.ptp(torques[use]) == 0.0:
        return 0.0
    return float(np.corrcoef(torque_fit, torques[use])[0, 1])
