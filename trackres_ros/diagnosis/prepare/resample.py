# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Resamples a recording to an even grid: means over steps, or held values between samples."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from trackres_ros.diagnosis.prepare.gaps import filled_steps, steps_without_value
from trackres_ros.diagnosis.prepare.refuse import EARLIEST_CLOCK_S, SHORTEST_S, check_compared
from trackres_ros.diagnosis.prepare.sample_noise import noise_of_means
from trackres_ros.diagnosis.prepare.sampling import LONGEST_HOLD_S, any_from, carried, held, means, middles, ordered, read_off
from trackres_ros.diagnosis.prepare.session import Array, Cumulative, DriveSession, Mask, Way
from trackres_ros.diagnosis.prepare.settings import LEAST_SAMPLES, SLOWEST_MPS, STEP_S, GateSettings, pace
from trackres_ros.diagnosis.prepare.speed_smoothing import smooth_speed
from trackres_ros.diagnosis.prepare.turning import turning
from trackres_ros.diagnosis.prepare.unit_checks import check_speed_unit, check_units
from trackres_ros.diagnosis.prepare.usable import BRAKES_ON
from trackres_ros.recording.binding import TopicBinding
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.roles import POSITION
from trackres_ros.recording.samples import Series
from trackres_ros.units import GRAVITY

MOST_UNKNOWN = 0.5  # of a recording
ODOMETER_OFF = 0.15  # of the speed: further off it was reset, or stood still
QUICK, STEADY = 1.0 / 3.0, 0.01
"""Mean square change of the speed over one step, as a share of its mean square. Over 1 s a car or
a bus reaches 0.004, robots driven to and fro 0.03 to 0.17, a carriage on a screw 0.56."""
SHORTER_STEPS_S = (0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
CHANNELS = ("ambient", "grade", "yaw_rate", "heading", "accel")


def step_for(recordings: Sequence[Recording], samples: int = LEAST_SAMPLES, slowest_speed: float = SLOWEST_MPS) -> float:
    """Step in which recordings are compared [s]: the usual one, or longer where speed or torque come slowly, so that some samples
    are in each; or shorter where the speed becomes another within the usual one.

    Parameters
    ----------
    slowest_speed
        What moves less than this on average does not move, and what its speed shows is noise [m/s].

    Notes
    -----
    Of a bus that recorded once in a second, steps of 1 s made a mass of 12.5 t of one of 19 t, and steps from 3 to 8 s one of
    18.1 to 18.9 t: what happens between two samples hides a part of the inertia.

    What resists hangs on the speed at each moment, so the mean of a step has to stand for all of it. Where a third of the speed's
    mean square is another one step later, it does not: the step is then one over which so little changes as does for a vehicle
    on a road in the usual one.
    """
    slowest = 0.0
    for recording in recordings:
        for role, series in recording.series.items():
            at = series.stamp_ns[np.isfinite(series.value)]
            if role.partition("/")[0] in ("speed", "torque") and len(at) > LEAST_SAMPLES:
                slowest = max(slowest, float(np.median(np.diff(np.sort(at)))) * 1e-9)
    usual = STEP_S * max(1, math.ceil(samples * round(slowest, 2) / STEP_S))
    if usual > STEP_S or _changes(recordings, STEP_S, slowest_speed) < QUICK:
        return usual
    possible = [step for step in SHORTER_STEPS_S if step >= samples * slowest] or [STEP_S]
    changes = [_changes(recordings, step, slowest_speed) for step in possible]
    steady = [step for step, share in zip(possible, changes, strict=True) if share <= STEADY]
    return steady[0] if steady else possible[int(np.argmin(changes))]


def _changes(recordings: Sequence[Recording], step: float, slowest_speed: float) -> float:
    """Share of the speed's mean square that is another one step later, or averages out within steps; 0 of what does not move,
    has no speed, or fewer samples than steps, as of a clock that was set.
    """
    alike, whole, count = 0.0, 0.0, 0
    for recording in recordings:
        at, speed = ordered(recording.series["speed"], recording.start_ns) if "speed" in recording.series else (np.empty(0),) * 2
        if len(at) > LEAST_SAMPLES and 3.0 * step < at[-1] < step * len(at):
            edges = np.arange(0.0, at[-1], step)
            (mean, known), (square, _) = means(at, speed, edges), means(at, speed**2, edges)
            both = known[1:] & known[:-1]
            alike += float((mean[1:] * mean[:-1])[both].sum())
            whole += 0.5 * float((square[1:] + square[:-1])[both].sum())
            count += int(both.sum())
    return 1.0 - alike / whole if whole > count * slowest_speed**2 else 0.0


def is_hidden(role: str, hide: Collection[str]) -> bool:
    """Whether a role is not to be read: it is named itself, or all of its kind are."""
    return role in hide or role.partition("/")[0] in hide


def resample(
    recording: Recording,
    step: float,
    settings: GateSettings,
    hide: frozenset[str],
    notes: list[str],
    shortest_s: float = SHORTEST_S,
) -> tuple[DriveSession, dict[str, Mask]]:
    """Put a recording on an even grid.

    Parameters
    ----------
    recording
        With a speed and a torque.
    step
        Of the grid [s].
    settings
        Of the vehicle; its weight and ambient temperature stand in where none is recorded.
    hide
        Roles that are not read.
    notes
        What was assumed is added to them.
    shortest_s
        How long it has to be [s].

    Returns
    -------
    session
        One lap, in which every step is used.
    unknown
        Steps in which something needed was not measured, each of shape (n,), by reason.

    Raises
    ------
    InputError
        No torque, no speed, too short, or another unit.
    """
    series = {role: s for role, s in recording.series.items() if not is_hidden(role, hide)}
    check_compared(recording.name, series, shortest_s, recording.torque_candidates)
    torques = [role for role in series if role.partition("/")[0] == "torque" and np.isfinite(series[role].value).any()]
    start = recording.start_ns
    speed_at, raw_speed = ordered(series["speed"], start)
    edges = np.arange(0.0, speed_at[-1] + 1e-9, step)
    count = len(edges) - 1
    notes += check_units(recording.name, series, settings.weight)
    scale = pace(step)
    unit = settings.slowest / SLOWEST_MPS if scale < 1.0 else 1.0  # of speed and of its noise, which is as much smaller
    smoothed = smooth_speed(speed_at / scale, raw_speed / unit, edges / scale, LONGEST_HOLD_S)
    at_edges = unit * smoothed.speed if smoothed else np.interp(edges, speed_at, raw_speed)
    speed, known = means(speed_at, raw_speed, edges)
    if "torque" in torques:
        torques = ["torque"]
    torque, measured = np.zeros(count), ~_nowhere(count)
    torque_noise, torque_samples = 0.0, [ordered(series[role], start) for role in torques]
    for samples in torque_samples:
        part, there = means(*samples, edges)
        torque, measured = torque + part, measured & there
        torque_noise = float(np.hypot(torque_noise, noise_of_means(*samples, step)))

    def held_on(role: str, default: float) -> Array:
        return held(series[role], start, edges, default) if role in series else np.full(count, default)

    given = frozenset(role for role in CHANNELS if role in series and np.isfinite(series[role].value).any())
    accel, accel_noise = np.diff(at_edges) / step, unit * smoothed.typical_change_std / step if smoothed else 0.0
    way = series.get("distance")
    by_way = np.diff(np.interp(edges, *ordered(way, start))) / step if way and np.isfinite(way.value).any() else None
    notes += check_speed_unit(recording.name, speed, accel, held_on("accel", np.nan) if "accel" in given else None, by_way)
    if "accel" in given:
        mean, there = means(*ordered(series["accel"], start), edges)
        accel, accel_noise = np.where(there, mean, accel), 0.0
    weight, of_load = _weight(series, start, edges, settings.weight)
    given |= {"load"} if of_load else frozenset()
    passengers = carried(series["passengers"], start, edges) if "passengers" in series else np.full(count, np.nan)
    payload = np.zeros(count)
    if np.isfinite(passengers).any():
        given |= {"passengers"}
        notes.append(_of_passengers(recording.name, passengers, step, settings.passenger_kg, of_load))
        if not of_load:
            payload = np.nan_to_num(passengers) * settings.passenger_kg * GRAVITY
            weight = weight + payload
    latitude, longitude = _position(series, start, edges)
    given |= {"position"} if np.isfinite(latitude).any() else frozenset()
    altitude = read_off(series["altitude"], start, edges) if "altitude" in series else np.full(count, np.nan)
    given |= {"altitude"} if np.isfinite(altitude).any() else frozenset()
    steering = np.full(count, np.nan)
    if "steering_angle" in series and np.isfinite(series["steering_angle"].value).sum() > 1:
        given |= {"steering_angle"}
        angle, there = means(*ordered(series["steering_angle"], start), edges)
        steering = np.where(there, angle, np.nan)
    belts = [held(series[role], start, edges, np.nan) for role in series if role.partition("/")[0] == "belt"]
    belt = np.mean(belts, axis=0) if belts else np.full(count, np.nan)
    given |= {"belt"} if belts and np.isfinite(belt).any() else frozenset()
    heading, yaw_rate = held_on("heading", np.nan), np.full(count, np.nan)
    if "yaw_rate" in given and not np.ptp(series["yaw_rate"].value[np.isfinite(series["yaw_rate"].value)]):
        given -= {"yaw_rate"}  # a gyroscope that is there is never still
        notes.append(f"{recording.name}: yaw_rate never changes; treated as not recorded")
    if "yaw_rate" in given:
        yaw_rate = means(*ordered(series["yaw_rate"], start), edges)[0]
    if "yaw_rate" not in given and (made := turning(series, start, edges, speed, settings.slowest, settings.track_width)):
        known_turns = np.isfinite(made.yaw_rate)
        if known_turns.mean() > 1.0 - MOST_UNKNOWN:
            yaw_rate = np.interp(edges[:-1], edges[:-1][known_turns], made.yaw_rate[known_turns])
            given |= {"yaw_rate"}
            notes.append(f"{recording.name}: the yaw rate is computed from {made.made_of}")
    if "yaw_rate" in given and "heading" not in given:
        heading = np.cumsum(np.nan_to_num(yaw_rate)) * step
        given |= {"heading"}
        notes.append(f"{recording.name}: heading is integrated from the yaw rate")
    no_slope = steps_without_value(ordered(series["grade"], start)[0], edges) if "grade" in given else _nowhere(count)
    if no_slope.mean() > MOST_UNKNOWN:
        notes.append(f"{recording.name}: the slope is unknown for {no_slope.mean():.0%} of the time; treated as not recorded")
        given, no_slope = given - {"grade"}, _nowhere(count)
    braked = _nowhere(count)
    if "brake" in series and np.isfinite(series["brake"].value).any():
        given |= {"brake"}
        value = series["brake"].value[np.isfinite(series["brake"].value)]
        from_on = recording.bindings.get("brake", TopicBinding()).brakes_from(value)
        braked = any_from(series["brake"], start, edges, from_on)
        notes.append(
            f"{recording.name}: brakes count as on from {from_on:g}; every other braking force is assumed to be in the "
            "measured torque"
        )
    session = DriveSession(
        name=recording.name,
        step=step,
        time=edges[:-1],
        speed=speed,
        accel=accel,
        weight=weight,
        ambient=held_on("ambient", settings.ambient),
        grade=held_on("grade", 0.0) if "grade" in given else np.zeros(count),
        yaw_rate=yaw_rate,
        heading=heading,
        distance=np.cumsum(_driven(speed, by_way)) * step,
        torque=torque,
        belt=belt,
        used=~_nowhere(count),
        block=np.zeros(count, dtype=np.int64),
        given=given,
        torque_course=_course(torque_samples),
        accel_noise=accel_noise,
        torque_noise=torque_noise,
        belt_shows_surface=settings.belt_shows_surface,
        start_s=start * 1e-9 if start * 1e-9 > EARLIEST_CLOCK_S else np.nan,
        latitude=latitude,
        longitude=longitude,
        altitude=altitude,
        steering_angle=steering,
        passengers=passengers,
        payload=payload,
        way=_way(series, start, speed_at, raw_speed, edges) if "position" in given else None,
    )
    return session, {
        "no speed": ~known,
        "no torque": ~measured,
        **filled_steps(
            (speed_at / scale, raw_speed), [(at / scale, value) for at, value in torque_samples], edges / scale, settings.slowest
        ),
        "slope not known": no_slope,
        BRAKES_ON: braked,
    }


def _driven(speed: Array, by_way: Array | None) -> Array:
    """Distance per time in each step [m/s]: by the odometer, where there is one and it agrees with the speed."""
    by_speed = np.abs(np.nan_to_num(speed))
    if by_way is None:
        return by_speed
    found = np.abs(by_way)
    agrees = np.abs(found - by_speed) <= ODOMETER_OFF * by_speed + SLOWEST_MPS
    return np.where(agrees & (by_speed > SLOWEST_MPS), found, by_speed)  # at rest what it moves by is noise


def _nowhere(count: int) -> Mask:
    return np.zeros(count, dtype=bool)


def _course(torques: Sequence[tuple[Array, Array]]) -> Cumulative:
    """Sum of torques as they were measured."""
    at = np.unique(np.concatenate([t for t, _ in torques]))
    return Cumulative.of(at, np.sum([np.interp(at, t, v) for t, v in torques], axis=0))


def _of_passengers(name: str, passengers: Array, step: float, kg_each: float, of_load: bool) -> str:
    """What becomes of the passengers."""
    if of_load:
        return f"{name}: the weight comes from the load channel, which is assumed to include the passengers"
    first = int(np.argmax(np.isfinite(passengers)))
    empty = f"; treated as empty until the first count, {first * step:.0f} s after the start" if first else ""
    return f"{name}: passengers of {kg_each:g} kg each are added to the empty vehicle{empty}"


def _position(series: dict[str, Series], start: int, edges: Array) -> tuple[Array, Array]:
    """Latitude and longitude [rad]; zeros are what a receiver gives that knows nothing."""
    if not set(POSITION) <= series.keys():
        return np.full(len(edges) - 1, np.nan), np.full(len(edges) - 1, np.nan)
    seen = [replace(s, value=np.where(s.value == 0.0, np.nan, s.value)) for s in (series[role] for role in POSITION)]
    latitude, longitude = read_off(seen[0], start, edges), read_off(seen[1], start, edges, angle=True)
    known = np.isfinite(longitude) & (np.abs(latitude) <= 0.5 * np.pi)
    return np.where(known, latitude, np.nan), np.where(known, longitude, np.nan)


def _way(series: dict[str, Series], start: int, speed_at: Array, speed: Array, edges: Array) -> Way:
    """Where it was at the middle of each `STEP_S` of all steps, or of each step where they are shorter."""
    each = min(STEP_S, edges[1] - edges[0])
    fine = np.arange(0.0, edges[-1] + 0.5 * each, each)
    driven = Cumulative.of(speed_at, np.abs(speed))
    latitude, longitude = _position(series, start, fine)
    return Way(latitude, longitude, np.interp(middles(fine), driven.at, driven.integral))


def _weight(series: dict[str, Series], start: int, edges: Array, nominal: float) -> tuple[Array, bool]:
    """Weight of the whole vehicle [N], and whether it was measured."""
    for roles in (["load"], [r for r in series if r.startswith("load/")]):
        there = [r for r in roles if r in series and np.isfinite(series[r].value).any()]
        if there:
            total = np.sum([held(series[r], start, edges, np.nan) for r in there], axis=0)
            return np.where(np.isfinite(total) & (total > 0.1 * nominal), total, nominal), True
    return np.full(len(edges) - 1, nominal), False
