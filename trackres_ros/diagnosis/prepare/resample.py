# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Resamples a recording to an even grid, with a yaw rate and the limit of the motor's braking where these are not recorded."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from trackres_ros.diagnosis.prepare.checks import EARLIEST_CLOCK_S, check_compared, check_speed_unit, check_units
from trackres_ros.diagnosis.prepare.sampling import (
    LONGEST_HOLD_S,
    any_from,
    carry_value,
    filled_steps,
    held_while_sent,
    hold_value,
    means,
    middles,
    read_off,
    sort_samples,
    steps_without_value,
)
from trackres_ros.diagnosis.prepare.session import (
    LEAST_SAMPLES,
    SLOWEST_MPS,
    STEP_S,
    Array,
    Cumulative,
    DriveSession,
    GateSettings,
    LiveFilter,
    Mask,
    WarningNote,
    Way,
    pace,
    robust_least_squares,
)
from trackres_ros.diagnosis.prepare.speed_smoothing import noise_of_means, smooth_speed
from trackres_ros.estimator.settings import Settings
from trackres_ros.files.dataclass_reader import limits_of
from trackres_ros.recording.bindings import TopicBinding
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.roles import POSITION, base_role
from trackres_ros.recording.samples import Series
from trackres_ros.units import EARTH_M, GRAVITY, MAD_TO_STD

SIDES = ("left", "right")
LONGEST_GAP_S = 2.0
REACHES_S = (1.0, 2.0, 4.0)  # of positions to either side; the shortest precise enough is used
SURE_RADPS = 0.03  # largest acceptable standard deviation of a yaw rate
FEWEST_MOVING = 60  # steps
MAD_OF_SECOND_DIFFERENCE = MAD_TO_STD / 6.0**0.5


class Turning(NamedTuple):
    """Yaw rate [rad/s], positive to the left, mean over each step, nan where unknown; and its source."""

    yaw_rate: Array
    made_of: str


def turn_rates(
    series: Mapping[str, Series], start: int, edges: Array, speed: Array, slowest_mps: float, track_width: float | None
) -> Turning | None:
    """Yaw rate [rad/s] from the heading, else the sides' wheel speeds, else positions; None if none suffices.

    `start` [ns] is that of the `edges` of the steps [s], shape (n + 1,). `speed` is the mean over each step [m/s], shape (n,).
    Positions give a direction above `slowest_mps` [m/s]. `track_width` is the distance of left from right wheels [m].
    """
    if "heading" in series and np.isfinite(series["heading"].value).sum() > 1:
        return Turning(_angle_rate(*sort_samples(series["heading"], start), edges), "heading")
    sides = [_side(series, side, start, edges) for side in SIDES]
    if track_width is not None and sides[0] is not None and sides[1] is not None:
        return Turning((sides[1] - sides[0]) / track_width, f"wheel speeds of both sides, {track_width:g} m apart")
    if "latitude" in series and "longitude" in series:
        yaw_rate = _path_turn(series, start, edges, speed, slowest_mps)
        return None if yaw_rate is None else Turning(yaw_rate, "positions")
    return None


def _angle_rate(times: Array, angle: Array, edges: Array) -> Array:
    """Change of an angle over each step."""
    is_known = (edges[:-1] >= times[0]) & (edges[1:] <= times[-1])
    next_index = np.clip(np.searchsorted(times, edges[1:]), 1, len(times) - 1)
    is_known &= times[next_index] - times[next_index - 1] <= LONGEST_GAP_S
    return np.where(is_known, np.diff(np.interp(edges, times, np.unwrap(angle))) / np.diff(edges), np.nan)


def _side(series: Mapping[str, Series], side: str, start: int, edges: Array) -> Array | None:
    """Mean wheel speed of one side over each step; None without any."""
    roles = [role for role in series if role.startswith("wheel_speed/") and side in role.partition("/")[2].split("_")]
    values = [
        Cumulative.of(*sort_samples(series[r], start)).means(edges[:-1], edges[1] - edges[0])
        for r in roles
        if _has_samples(series[r])
    ]
    return np.asarray(np.mean(values, axis=0)) if values else None


def _has_samples(series: Series) -> bool:
    return int(np.isfinite(series.value).sum()) > 1


def _path_turn(series: Mapping[str, Series], start: int, edges: Array, speed: Array, slowest_mps: float) -> Array | None:
    """Turn of the path from before a step to after it; nan at near standstill, or between forward and reverse."""
    (times, north), (east_times, east) = (sort_samples(series[role], start) for role in ("latitude", "longitude"))
    if len(times) < FEWEST_MOVING or len(east_times) < FEWEST_MOVING:
        return None
    middle = 0.5 * (edges[1:] + edges[:-1])
    east = np.interp(times, east_times, np.unwrap(east))
    x, y = EARTH_M * np.cos(np.median(north)) * (east - east[0]), EARTH_M * (north - north[0])
    noise = max(MAD_OF_SECOND_DIFFERENCE * float(np.median(np.abs(np.diff(z, 2)))) for z in (x, y))
    is_moving = np.abs(speed) > slowest_mps
    if is_moving.sum() < FEWEST_MOVING:
        return None
    typical_mps = float(np.median(np.abs(speed[is_moving])))
    spacing = float(np.median(np.diff(times)))
    precise_reaches = [r for r in REACHES_S if 6.0**0.5 * noise <= SURE_RADPS * typical_mps * r**2 and r >= spacing]
    if not precise_reaches:
        return None
    reach = precise_reaches[0]
    step_before, point, step_after = (
        np.interp(middle + shift, times, x) + 1j * np.interp(middle + shift, times, y) for shift in (-reach, 0.0, reach)
    )
    angles = np.angle((step_after - point) * np.conj(point - step_before))
    directions = [np.interp(middle + shift, middle, np.sign(speed) * is_moving) for shift in (-reach, 0.0, reach)]
    is_known = (np.abs(np.sum(directions, axis=0)) > 3.0 - 1e-9) & (middle - reach >= times[0]) & (middle + reach <= times[-1])
    return np.where(is_known, angles / reach, np.nan)


FEWEST_DRIVING = 300  # steps
FEWEST_OF_A_LEVEL, LEVELS = 40, 25
FAR_STDS = 4.0  # of driving steps: a larger residual means a friction brake
MOST_FAR = 0.1  # of the steps of a level, beyond the share while driving; a fit tolerates a few outliers
MOST_LOST = 0.2  # of a braking torque: a gear loss of a tenth in both directions


def motor_brakes_alone(sessions: Sequence[DriveSession], compared_steps: Sequence[Mask]) -> float:
    """Torque in the direction of travel [Nm], zero or negative, down to which the motor brakes alone; zero where unknown.

    The torque of driving steps depends on speed, acceleration and slope. With friction brakes, the vehicle decelerates more
    than its torque explains: much more in some steps of a torque level, or a little in all of them. Braking steps are checked
    level by level, from the smallest torque on, up to the first level with either sign. Compared are the moving steps of each
    session with known speed and torque.
    """
    torque, columns = (np.concatenate(rows) for rows in zip(*map(_rows, sessions, compared_steps), strict=True))
    drives = np.concatenate([~widen(s.torque * s.ahead <= 0.0)[m] for s, m in zip(sessions, compared_steps, strict=True)])
    if drives.sum() < FEWEST_DRIVING:
        return 0.0
    values = robust_least_squares(columns[drives], torque[drives])
    residual = torque - columns @ values
    middle = float(np.median(residual[drives]))
    std = MAD_TO_STD * float(np.median(np.abs(residual[drives] - middle)))
    usual_share = float((residual[drives] > middle + FAR_STDS * std).mean())
    brakes = np.flatnonzero(torque <= 0.0)
    order = brakes[np.argsort(-torque[brakes])]
    motor_braking = 0.0
    for level in np.array_split(order, max(1, min(LEVELS, len(order) // FEWEST_OF_A_LEVEL))):
        if len(level) < FEWEST_OF_A_LEVEL:
            break
        level_residual = float(np.median(residual[level]))
        far_share = float((residual[level] > level_residual + FAR_STDS * std).mean())
        if far_share > usual_share + MOST_FAR or level_residual - middle > std + MOST_LOST * abs(float(np.median(torque[level]))):
            break
        motor_braking = float(torque[level[-1]])
    return motor_braking


def widen(steps: Mask) -> Mask:
    """Steps and their neighbours."""
    return np.asarray(np.convolve(steps, np.ones(3), mode="same") > 0)


def _rows(session: DriveSession, compared_steps: Mask) -> tuple[Array, Array]:
    """The torque in the direction of travel, and its possible dependencies."""
    v, weight, direction = session.speed * session.ahead, session.weight, session.ahead
    columns = (
        weight,
        weight * v,
        v**2,
        weight * session.accel * direction / GRAVITY,
        weight * np.nan_to_num(session.grade) * direction,
    )
    return (session.torque * direction)[compared_steps], np.column_stack(columns)[compared_steps]


BRAKES_ON = "brakes on"
MOST_UNKNOWN = 0.5  # of a recording
ODOMETER_OFF = 0.15  # of the speed: a larger deviation means a reset or stuck odometer
QUICK, STEADY = 1.0 / 3.0, 0.01
"""Mean square change of the speed over one step, as a share of its mean square. Over 1 s a car or
a bus reaches 0.004, robots driven to and fro 0.03 to 0.17, a carriage on a screw 0.56."""
SHORTER_STEPS_S = (0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
CHANNELS = ("ambient", "grade", "yaw_rate", "heading", "accel")
COMPUTED = ("accel", "yaw_rate", "heading")  # from others where they are not recorded


def step_for(
    recordings: Sequence[Recording], samples: int = LEAST_SAMPLES, slowest_speed: float = SLOWEST_MPS, quick_share: float = QUICK
) -> float:
    """Common step of recordings [s]: the usual one; longer for slow speed or torque, so that each step has several samples;
    or shorter where the speed changes within the usual one by more than `quick_share`. Mean speeds below the slowest [m/s] are
    standstill and noise.

    Notes
    -----
    Changes between two samples hide a part of the inertia. For a bus of 19 t recorded once per second, steps of 1 s gave
    a mass of 12.5 t, and steps from 3 to 8 s one of 18.1 to 18.9 t.

    Resistance depends on the current speed, so the mean speed must represent the whole step. It does not where a third of
    the speed's mean square changes within one step. The step is then chosen so that the speed changes as little as that of
    a road vehicle in the usual one. A machine that is no vehicle has no usual one: `quick_share` is `STEADY` for it.
    """
    slowest_s = 0.0
    for recording in recordings:
        for role, series in recording.series.items():
            stamps = series.stamp_ns[np.isfinite(series.value)]
            if role.partition("/")[0] in ("speed", "torque") and len(stamps) > LEAST_SAMPLES:
                slowest_s = max(slowest_s, float(np.median(np.diff(np.sort(stamps)))) * 1e-9)
    usual_step = STEP_S * max(1, math.ceil(samples * round(slowest_s, 2) / STEP_S))
    if usual_step > STEP_S or _changes(recordings, STEP_S, slowest_speed) < quick_share:
        return usual_step
    possible_steps = [step for step in SHORTER_STEPS_S if step >= samples * slowest_s] or [STEP_S]
    changes = [_changes(recordings, step, slowest_speed) for step in possible_steps]
    steady_steps = [step for step, share in zip(possible_steps, changes, strict=True) if share <= STEADY]
    return steady_steps[0] if steady_steps else possible_steps[int(np.argmin(changes))]


def _changes(recordings: Sequence[Recording], step: float, slowest_speed: float) -> float:
    """Share of the speed's mean square that changes by the next step, or averages out within steps; 0 at standstill, without
    a speed, or with fewer samples than steps.
    """
    products, squares, count = 0.0, 0.0, 0
    for recording in recordings:
        times, speed = (
            sort_samples(recording.series["speed"], recording.start_ns) if "speed" in recording.series else (np.empty(0),) * 2
        )
        if len(times) > LEAST_SAMPLES and 3.0 * step < times[-1] < step * len(times):
            edges = np.arange(0.0, times[-1], step)
            (mean, is_known), (square, _) = means(times, speed, edges), means(times, speed**2, edges)
            is_valid = is_known[1:] & is_known[:-1]
            products += float((mean[1:] * mean[:-1])[is_valid].sum())
            squares += 0.5 * float((square[1:] + square[:-1])[is_valid].sum())
            count += int(is_valid.sum())
    return 1.0 - products / squares if squares > count * slowest_speed**2 else 0.0


@dataclass(frozen=True, eq=False)
class _Grid:
    """Readable channels of a recording, and their even grid; notes receive the assumptions, and `given` the known roles."""

    name: str
    bindings: Mapping[str, TopicBinding]
    series: Mapping[str, Series]
    start: int
    edges: Array
    step: float
    settings: GateSettings
    notes: list[str]
    given: set[str]

    @property
    def count(self) -> int:
        return len(self.edges) - 1

    @property
    def nan(self) -> Array:
        return np.full(self.count, np.nan)

    @property
    def no_steps(self) -> Mask:
        return np.zeros(self.count, dtype=bool)

    def has_role(self, role: str) -> bool:
        return role in self.series and bool(np.isfinite(self.series[role].value).any())

    def samples(self, role: str) -> tuple[Array, Array]:
        return sort_samples(self.series[role], self.start) if role in self.series else (np.empty(0), np.empty(0))

    def set_default(self, role: str, values: Array) -> Array:
        """The values; the role is given if any is known."""
        if np.isfinite(values).any():
            self.given.add(role)
        return values

    def held_values(self, role: str, default: float) -> Array:
        return hold_value(*self.samples(role), self.edges, default)


@dataclass(frozen=True, eq=False)
class _Speed:
    """Samples of the speed, its means, the steps with a known value, acceleration with its noise, odometer speed, and the live
    filter of an unrecorded acceleration.
    """

    times: Array
    raw: Array
    mean: Array
    set_default: Mask
    accel: Array
    accel_noise: float
    by_way: Array | None
    live: LiveFilter | None


def resample(
    recording: Recording, step: float, settings: GateSettings, notes: list[str], shortest_s: float
) -> tuple[DriveSession, dict[str, Mask]]:
    """Put a recording with a speed and a torque on an even grid of `step` [s]; `notes` receives the assumptions.

    Weight and ambient temperature of the `settings` replace missing ones. The session is one lap with every step in use. Returned
    with it are the steps without a needed measurement, each of shape (n,), by reason.

    Raises
    ------
    InputError
        No torque, no speed, shorter than `shortest_s`, or another unit.
    """
    series = recording.series
    check_compared(recording, shortest_s)
    edges = np.arange(0.0, sort_samples(series["speed"], recording.start_ns)[0][-1] + 1e-9, step)
    notes += check_units(recording, settings)
    grid = _Grid(recording.name, recording.bindings, series, recording.start_ns, edges, step, settings, notes, set())
    grid.given.update(role for role in CHANNELS if grid.has_role(role))
    speed, (torques, torque, torque_known, torque_noise) = _speed(grid), _torque(grid)
    weight, payload, passengers = _load(grid)
    latitude, longitude, altitude = _place(grid)
    belts = [held_while_sent(*grid.samples(role), edges) for role in series if role.partition("/")[0] == "belt"]
    belt = grid.set_default("belt", np.mean(belts, axis=0) if belts else grid.nan)
    steering_angle = _steering(grid)
    yaw_rate, heading = _turn_rates(grid, speed)
    no_slope = _slope(grid)
    brake_steps = _brake_steps(grid, recording.bindings.get("brake", TopicBinding()))
    session = DriveSession(
        name=recording.name,
        step=step,
        time=edges[:-1],
        speed=speed.mean,
        accel=speed.accel,
        weight=weight,
        ambient=grid.held_values("ambient", settings.ambient),
        grade=grid.held_values("grade", 0.0) if "grade" in grid.given else np.zeros(grid.count),
        yaw_rate=yaw_rate,
        heading=heading,
        distance=np.cumsum(_signed_speed(speed.mean, speed.by_way)) * step,
        torque=torque,
        belt=belt,
        used=~grid.no_steps,
        block=np.zeros(grid.count, dtype=np.int64),
        given=frozenset(grid.given),
        computed=frozenset(c for c in COMPUTED if not grid.has_role(c) and c in {*grid.given, "accel"}),
        torque_course=_course(torques),
        accel_noise=speed.accel_noise,
        torque_noise=torque_noise,
        belt_shows_surface=settings.belt_shows_surface,
        start_s=grid.start * 1e-9 if grid.start * 1e-9 > EARLIEST_CLOCK_S else np.nan,
        latitude=latitude,
        longitude=longitude,
        altitude=altitude,
        steering_angle=steering_angle,
        passengers=passengers,
        payload=payload,
        bindings=recording.bindings,
        live_filter=speed.live,
        way=_way(grid, speed) if "position" in grid.given else None,
    )
    scale = pace(step)
    samples = [(times / scale, value) for times, value in ((speed.times, speed.raw), *torques)]
    return session, {
        "no speed": ~speed.set_default,
        "no torque": ~torque_known,
        **filled_steps(samples[0], samples[1:], edges / scale, settings.slowest),
        "slope not known": no_slope,
        BRAKES_ON: brake_steps,
    }


def _speed(grid: _Grid) -> _Speed:
    """Speed, and acceleration as measured or derived from it."""
    times, raw = grid.samples("speed")
    motion = smoothed_motion(times, raw, grid.edges, grid.step, grid.settings.slowest)
    mean, is_known = means(times, raw, grid.edges)
    accel, accel_noise = np.diff(motion.speed) / grid.step, motion.change_std / grid.step
    by_way = np.diff(np.interp(grid.edges, *grid.samples("distance"))) / grid.step if grid.has_role("distance") else None
    measured = grid.held_values("accel", np.nan) if grid.has_role("accel") else None
    grid.notes.extend(check_speed_unit(grid.name, grid.bindings, mean, accel, measured, by_way))
    if measured is not None:
        mean_accel, is_measured = means(*grid.samples("accel"), grid.edges)
        accel, accel_noise = np.where(is_measured, mean_accel, accel), 0.0
    return _Speed(times, raw, mean, is_known, accel, accel_noise, by_way, motion.live if measured is None else None)


class SmoothedMotion(NamedTuple):
    """Speed [m/s] and acceleration [m/s^2] at chosen times, the typical error of a change of the speed between two [m/s], and the
    live filter of such speeds.
    """

    speed: Array
    accel: Array
    change_std: float
    live: LiveFilter | None = None


def smoothed_motion(sample_times: Array, speeds: Array, times: Array, step: float, slowest_mps: float) -> SmoothedMotion:
    """Motion at some rising `times` [s] from all `speeds` [m/s] before and after; along lines between slow samples.

    The smoother's constants are a vehicle's: `step` [s] and the speed `slowest_mps` [m/s] scale a quick machine to one.
    """
    scale = pace(step)
    unit = slowest_mps / SLOWEST_MPS if scale < 1.0 else 1.0
    smooth_curve = smooth_speed(sample_times / scale, speeds / unit, times / scale, LONGEST_HOLD_S)
    if smooth_curve is None:
        accel = np.interp(times, sample_times, np.gradient(speeds, sample_times))
        return SmoothedMotion(np.interp(times, sample_times, speeds), accel, 0.0)
    accel = unit / scale * smooth_curve.accel
    live = _live_filter(accel, unit * smooth_curve.noise, unit / scale**1.5 * smooth_curve.jerk)
    return SmoothedMotion(unit * smooth_curve.speed, accel, unit * smooth_curve.typical_change_std, live)


def _live_filter(accel: Array, noise: float, jerk: float) -> LiveFilter | None:
    """Singer's acceleration with the spread of the smoothed one [m/s^2] and with its jerk [m/s^2/sqrt(s)]: jerk^2 = 2 std^2/time.

    `noise`: standard deviation of a speed [m/s]. None where nothing moves.
    """
    changes = accel[np.isfinite(accel) & (accel != 0.0)]
    if not len(changes):
        return None
    std = float(np.sqrt(np.mean(changes**2)))
    values = LiveFilter(noise, std, 2.0 * (std / jerk) ** 2)
    limits = limits_of(Settings)
    return LiveFilter(*(float(np.clip(x, limits[name].low, limits[name].high)) for name, x in values._asdict().items()))


def _torque(grid: _Grid) -> tuple[list[tuple[Array, Array]], Array, Mask, float]:
    """The true torque, or the sum of its parts: samples of each, means of the sum, steps with a known value, and its noise."""
    roles = [role for role in grid.series if role.partition("/")[0] == "torque" and grid.has_role(role)]
    readings = [grid.samples(role) for role in (["torque"] if "torque" in roles else roles)]
    samples = [(times, value / grid.settings.torque_scale) for times, value in readings]
    torque, is_known, noise = np.zeros(grid.count), ~grid.no_steps, 0.0
    for part_samples in samples:
        part, part_known = means(*part_samples, grid.edges)
        torque, is_known = torque + part, is_known & part_known
        noise = float(np.hypot(noise, noise_of_means(*part_samples, grid.step)))
    return samples, torque, is_known, noise


def _load(grid: _Grid) -> tuple[Array, Array, Array]:
    """Weight of the whole vehicle, from its load or from loads of axles and assemblies; where unknown, the vehicle file's with
    counted passengers. The weight of passengers where no load is recorded [N], and their number.
    """
    passengers = grid.set_default("passengers", carry_value(*grid.samples("passengers"), grid.edges))
    kg_each, nominal = grid.settings.passenger_kg, grid.settings.weight
    payload = np.nan_to_num(passengers) * kg_each * GRAVITY
    weight = nominal + payload
    if loads := {r: grid.held_values(r, np.nan) for r in grid.series if base_role(r) == "load" and grid.has_role(r)}:
        grid.given.add("load")
        total = grid.settings.total_load(loads, payload)
        weight = np.where(np.isfinite(total) & (total > 0.1 * nominal), total, weight)
        payload = np.zeros(grid.count)
        if "passengers" in grid.given:
            grid.notes.append(f"{grid.name}: the weight comes from the load channel, which is assumed to include the passengers")
    elif "passengers" in grid.given:
        first_row = int(np.argmax(np.isfinite(passengers)))
        empty_text = (
            f"; treated as empty until the first count, {first_row * grid.step:.0f} s after the start" if first_row else ""
        )
        grid.notes.append(f"{grid.name}: passengers of {kg_each:g} kg each are added to the empty vehicle{empty_text}")
    return weight, payload, passengers


def _place(grid: _Grid) -> tuple[Array, Array, Array]:
    """Latitude and longitude [rad], and altitude [m]."""
    latitude, longitude = _position(grid.series, grid.start, grid.edges)
    altitude = grid.set_default("altitude", read_off(*grid.samples("altitude"), grid.edges))
    return grid.set_default("position", latitude), longitude, altitude


def _steering(grid: _Grid) -> Array:
    times, value = grid.samples("steering_angle")
    if len(times) < 2:
        return grid.nan
    angle, is_known = means(times, value, grid.edges)
    grid.given.add("steering_angle")
    return np.where(is_known, angle, np.nan)


def _turn_rates(grid: _Grid, speed: _Speed) -> tuple[Array, Array]:
    """Yaw rate and heading, measured or derived."""
    series, edges, settings = grid.series, grid.edges, grid.settings
    heading, yaw_rate = grid.held_values("heading", np.nan), grid.nan
    if "yaw_rate" in grid.given and not np.ptp(series["yaw_rate"].value[np.isfinite(series["yaw_rate"].value)]):
        grid.given.remove("yaw_rate")  # a gyroscope is never exactly still
        grid.notes.append(WarningNote(f"{grid.name}: yaw_rate never changes; treated as not recorded"))
    if "yaw_rate" in grid.given:
        yaw_rate = means(*grid.samples("yaw_rate"), edges)[0]
    elif turn := turn_rates(series, grid.start, edges, speed.mean, settings.slowest, settings.track_width):
        known_turns = np.isfinite(turn.yaw_rate)
        if known_turns.mean() > 1.0 - MOST_UNKNOWN:
            yaw_rate = np.interp(edges[:-1], edges[:-1][known_turns], turn.yaw_rate[known_turns])
            grid.given.add("yaw_rate")
            grid.notes.append(f"{grid.name}: the yaw rate is computed from {turn.made_of}")
    if "yaw_rate" in grid.given and "heading" not in grid.given:
        heading = np.cumsum(np.nan_to_num(yaw_rate)) * grid.step
        grid.given.add("heading")
        grid.notes.append(f"{grid.name}: heading is integrated from the yaw rate")
    return yaw_rate, heading


def _slope(grid: _Grid) -> Mask:
    """Steps without a slope; if these are the majority, the slope is treated as not recorded."""
    gaps = steps_without_value(grid.samples("grade")[0], grid.edges) if "grade" in grid.given else grid.no_steps
    if gaps.mean() > MOST_UNKNOWN:
        text = f"{grid.name}: the slope is unknown for {100.0 * gaps.mean():.0f} % of the time; treated as not recorded"
        grid.notes.append(WarningNote(text))
        grid.given.remove("grade")
        return grid.no_steps
    return gaps


def _brake_steps(grid: _Grid, binding: TopicBinding) -> Mask:
    if not grid.has_role("brake"):
        return grid.no_steps
    grid.given.add("brake")
    value = grid.series["brake"].value
    threshold = binding.brakes_from(value[np.isfinite(value)])
    grid.notes.append(
        f"{grid.name}: brakes count as on from {threshold:g}; every other braking force is assumed to be in the measured torque"
    )
    return any_from(*grid.samples("brake"), grid.edges, threshold)


def _signed_speed(speed: Array, by_way: Array | None) -> Array:
    """Distance per time in each step [m/s]: from the odometer if it agrees with the speed."""
    by_speed = np.abs(np.nan_to_num(speed))
    if by_way is None:
        return by_speed
    by_odometer = np.abs(by_way)
    agrees = np.abs(by_odometer - by_speed) <= ODOMETER_OFF * by_speed + SLOWEST_MPS
    return np.where(agrees & (by_speed > SLOWEST_MPS), by_odometer, by_speed)  # at rest its motion is noise


def _course(torques: Sequence[tuple[Array, Array]]) -> Cumulative:
    times = np.unique(np.concatenate([t for t, _ in torques]))
    return Cumulative.of(times, np.sum([np.interp(times, t, v) for t, v in torques], axis=0))


def _position(series: Mapping[str, Series], start: int, edges: Array) -> tuple[Array, Array]:
    """Latitude and longitude [rad]; a receiver without a fix gives zeros."""
    if not set(POSITION) <= series.keys():
        return np.full(len(edges) - 1, np.nan), np.full(len(edges) - 1, np.nan)
    fixes = [replace(s, value=np.where(s.value == 0.0, np.nan, s.value)) for s in (series[role] for role in POSITION)]
    north, east = (sort_samples(s, start) for s in fixes)
    latitude, longitude = read_off(*north, edges), read_off(*east, edges, angle=True)
    is_known = np.isfinite(longitude) & (np.abs(latitude) <= 0.5 * np.pi)
    return np.where(is_known, latitude, np.nan), np.where(is_known, longitude, np.nan)


def _way(grid: _Grid, speed: _Speed) -> Way:
    """Position at the middle of each `STEP_S` of all steps, or of each step where they are shorter."""
    spacing = min(STEP_S, grid.edges[1] - grid.edges[0])
    grid_times = np.arange(0.0, grid.edges[-1] + 0.5 * spacing, spacing)
    distance = Cumulative.of(speed.times, np.abs(speed.raw))
    latitude, longitude = _position(grid.series, grid.start, grid_times)
    return Way(latitude, longitude, np.interp(middles(grid_times), distance.times, distance.integral))
