# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Smooths speed samples with a Kalman smoother: speed at chosen times, and the variance of its changes.

The state is speed and acceleration, driven by white jerk. A sample is the speed with white noise, at least that of
rounding to the sensor's steps. Jerk and noise maximise the likelihood of all innovations. Forward pass: Bar-Shalom, Li and
Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 6.2.3; backward pass: Rauch, Tung and
Striebel, AIAA Journal 3 (1965) 1445.

A recorded altitude of sufficient accuracy gives a slope the same way, with its standard deviation.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from scipy.optimize import minimize

from trackres_ros.diagnosis.prepare.session import Array, Cumulative, DriveSession, Mask, robust_least_squares
from trackres_ros.kernels.marks import entry
from trackres_ros.recording.slopes import runs_of, slopes
from trackres_ros.route.track import Frame
from trackres_ros.units import GRAVITY, MAD_TO_STD

States = Annotated[Array, (None, 5)]

SLOWEST_S, FEWEST = 0.25, 100  # slower samples, or fewer, do not separate noise from motion
JERK = 0.002, 1.0  # m/s^2/sqrt(s): from a heavy vehicle at constant speed to a pushed robot; assumed
NOISE_MPS = 3e-4, 0.5  # plus rounding: from a hundredth of a wheel encoder's to a poor satellite receiver; assumed
REST_S = 1.0  # so long at exactly zero is standstill, not crawling
SAME = 1e-6  # of the greatest speed: the resolution of six digits
WHOLE, MULTIPLES = 0.1, 0.95  # deviation from a whole number of steps, and the least share of differences within it
LONGEST_REPEAT, REGULAR = 50, 0.95  # samples of one value, and the share of changes in its rhythm
OUTLIER = 5.0  # standard deviations beyond which an innovation gets less weight
FASTEST = 10.0  # m/s^2: no vehicle's speed changes faster
LASTS_S, BREAKS_S = 0.5, 5.0  # so long outliers on one side are motion; where they begin faster than that, a sensor's other level
MISSED = 3.0  # times the deviance of a lost sample, for one of a motion that the jerk does not follow
UNKNOWN = 1e4  # variance of speed and acceleration at the start of a stretch
PIECE, MOST_PIECES = 2000, 30  # samples for estimating jerk and noise
TURNS = 3
LOCAL_TURNS = 5  # of estimating local jerk and smoothing the speed with it
LOCAL_S = 1.0  # to either side of a moment, for its local jerk
LEAST_LOCAL, MOST_LOCAL = 0.02, 4.0  # times the jerk of the whole recording
HELD = 4e-4  # m/s^2/sqrt(s): the least jerk of a speed that is held
EVEN = 0.3  # median over mean of squared jerks: 0.65 where it is white throughout, below 0.1 where steady speeds are held
MOST_LAGS, STILL_ALIKE = 60, 0.02  # samples, and the correlation below which the noise is forgotten
SECOND_DIFFERENCE = 6.0  # variance of a second difference over that of the noise


@dataclass(frozen=True, eq=False)
class SmoothedSpeed:
    """Smoothed speed at chosen times."""

    speed: Array  # at those times [m/s], shape (n,)
    accel: Array  # at those times [m/s^2], shape (n,); 0 at rest, nan over gaps
    change_std: Array  # of the change's error to the next [m/s], shape (n - 1,); 0 at rest, nan over gaps
    jerk: float  # density [m/s^2/sqrt(s)]
    noise: float  # standard deviation of a sample [m/s]
    step: float  # resolution of the sensor [m/s]

    @property
    def typical_change_std(self) -> float:
        """Root mean square of `change_std` while driving [m/s]; 0 where there is none."""
        moving_stds = self.change_std[self.change_std > 0.0]
        return float(np.sqrt(np.mean(moving_stds**2))) if len(moving_stds) else 0.0


def smooth_speed(sample_times: Array, speeds: Array, times: Array, longest_gap_s: float) -> SmoothedSpeed | None:
    """Speed at some rising `times` [s] from all samples `speeds` [m/s] before and after; None for slow sampling, or a moving
    vehicle with too few samples. Gaps longer than `longest_gap_s` get a straight line.
    """
    if len(sample_times) < FEWEST or float(np.median(np.diff(sample_times))) > SLOWEST_S:
        return None
    is_new = without_repeats(speeds)
    sample_times, speeds = sample_times[is_new], speeds[is_new]
    step = rounding_step(speeds)
    grid = _Grid.of(sample_times, speeds, times, longest_gap_s)
    if grid.is_kept.sum() < FEWEST:
        return None
    jerk, noise = _most_likely(grid, step)
    constant_jerk = np.full(len(grid.times), jerk)
    states, variances = grid.run(constant_jerk, noise)
    local_jerk = constant_jerk
    for _ in range(LOCAL_TURNS):  # a steady speed has hardly any jerk: its apparent one is sensor error
        squares = grid.squared_jerks(states)
        if np.median(squares) > EVEN * squares.mean():
            break
        local_jerk = np.clip(np.sqrt(squares * LOCAL_S), max(LEAST_LOCAL * jerk, HELD), MOST_LOCAL * jerk)
        states, variances = grid.run(local_jerk, noise)
    white = noise
    for _ in range(TURNS):  # coloured noise pulls the speed along, and shows fully only afterwards
        count = _correlated_samples(grid.speeds[grid.sample] - states[grid.sample, 0])
        if count == 1.0:
            break
        noise = white * np.sqrt(count)
        states, variances = grid.run(local_jerk, noise)
    rest = at_rest(sample_times, speeds)
    values = speeds.copy()
    values[grid.is_kept] = states[grid.sample, 0]
    values[rest] = 0.0
    speed = np.interp(times, sample_times, values)
    speed[grid.is_within] = states[~grid.sample, 0]
    next_index = np.clip(np.searchsorted(sample_times, times, side="right"), 1, len(sample_times) - 1)
    variance = np.where(rest[next_index] & rest[next_index - 1], 0.0, np.nan)
    accel = variance.copy()
    variance[grid.is_within], accel[grid.is_within] = states[~grid.sample, 2], states[~grid.sample, 1]
    change = variance[1:] + variance[:-1]
    joint = np.full(len(times), np.nan)
    joint[grid.is_within] = variances[~grid.sample]
    change = np.where(np.isfinite(joint[:-1]), joint[:-1], change)
    return SmoothedSpeed(speed, accel, np.sqrt(np.maximum(change, 0.0)), jerk, noise, step)


def without_repeats(speeds: Array) -> Mask:
    """Samples without the repeats of a sensor slower than its topic, recognised by a regular rhythm of changes."""
    changes = np.flatnonzero(np.diff(speeds, prepend=np.nan) != 0.0)
    lengths = np.diff(changes)
    rhythm = 1
    for length in range(2, LONGEST_REPEAT + 1):
        if len(lengths) >= FEWEST and np.mean(lengths % length == 0) >= REGULAR:
            rhythm = length
    repeat_count = np.arange(len(speeds)) - np.repeat(changes, np.diff(np.append(changes, len(speeds))))
    return np.asarray(repeat_count % rhythm == 0)


def rounding_step(speeds: Array) -> float:
    """Resolution of a sensor whose few values recur; 0 for others."""
    return resolution(speeds) if len(np.unique(speeds)) <= 0.5 * len(speeds) else 0.0


def resolution(readings: Array) -> float:
    """The smallest difference of values that all others are multiples of; 0 where there is none."""
    values = np.unique(readings)
    differences = np.diff(values)
    differences = differences[differences > SAME * float(np.abs(values).max(initial=0.0))]
    if len(differences) < 2:
        return 0.0
    smallest_step = float(np.percentile(differences, 1.0))
    step = float(np.median(differences[differences < 1.5 * smallest_step]))
    multiples = differences / step
    return step if np.mean(np.abs(multiples - np.round(multiples)) < WHOLE) >= MULTIPLES else 0.0


def at_rest(times: Array, speeds: Array) -> Mask:
    """Samples in lasting runs of zeros."""
    rest = np.zeros(len(speeds), dtype=bool)
    for begin, end in runs_of(speeds == 0.0):
        rest[begin:end] = times[end - 1] - times[begin] >= REST_S
    return rest


@dataclass(frozen=True, eq=False)
class _Grid:
    """Samples of stretches of driving and the asked times within them, in order; each is cut at gaps and rests."""

    times: Array
    speeds: Array
    sample: Mask  # a sample, else a requested time
    is_begin: Mask
    is_kept: Mask  # kept samples among all
    is_within: Mask  # requested times inside, among all

    @classmethod
    def of(cls, sample_times: Array, speeds: Array, times: Array, longest_gap_s: float) -> _Grid:
        rest = at_rest(sample_times, speeds)
        is_still = rest[1:] & rest[:-1]  # from one sample to the next
        is_kept = ~(np.append(is_still, rest[-1]) & np.concatenate(([rest[0]], is_still)))
        cut = is_still | (np.diff(sample_times) > longest_gap_s)
        is_begin = np.concatenate(([True], cut))
        next_index = np.searchsorted(sample_times, times, side="right")
        is_inside = (next_index > 0) & (next_index < len(sample_times))
        is_within = is_inside & ~cut[np.clip(next_index, 1, len(sample_times) - 1) - 1]
        all_times = np.concatenate((sample_times[is_kept], times[is_within]))
        order = np.argsort(all_times, kind="stable")
        count, request_count = int(is_kept.sum()), int(is_within.sum())
        sample = np.repeat((True, False), (count, request_count))[order]
        values = np.concatenate((speeds[is_kept], np.zeros(request_count)))[order]
        is_first = np.concatenate((is_begin[is_kept], np.zeros(request_count, dtype=bool)))[order]
        return cls(all_times[order], values, sample, is_first, is_kept, is_within)

    def run(self, jerk: Array, noise: float) -> tuple[Array, Array]:
        """Smoothed states, and variances of changes to the next requested time."""
        states, variances = np.empty((len(self.times), 5)), np.full(len(self.times), np.nan)
        turns = np.empty(len(self.times), dtype=bool)
        filter_forward(self.times, self.speeds, self.sample, self.is_begin, jerk, noise, states, turns)
        smooth_backward(self.times, ~self.sample, self.is_begin, jerk, turns, states, variances)
        return states, variances

    def squared_jerks(self, states: Array) -> Array:
        """Local mean squares of the smoothed acceleration's change [m^2/s^6]."""
        ends = np.clip(np.stack([self.times - LOCAL_S, self.times + LOCAL_S]), self.times[0], self.times[-1])
        accel_before, accel_after = np.interp(ends, self.times, states[:, 1])
        square = Cumulative.of(self.times, ((accel_after - accel_before) / (2.0 * LOCAL_S)) ** 2)
        lower_integral, upper_integral = np.interp(ends, self.times, square.integral)
        return np.asarray((upper_integral - lower_integral) / np.maximum(ends[1] - ends[0], 1e-9))


def _most_likely(grid: _Grid, step: float) -> tuple[float, float]:
    """Density of the jerk, and standard deviation of the noise including rounding."""
    piece = np.arange(len(grid.times)) // PIECE
    is_used = piece % (1 + piece[-1] // MOST_PIECES) == 0
    is_begin = (grid.is_begin | np.append(True, np.diff(piece) > 0))[is_used]
    times, speeds, sample = grid.times[is_used], grid.speeds[is_used], _spaced_samples(grid)[is_used]
    states, turns = np.empty((len(times), 5)), np.empty(len(times), dtype=bool)

    def values(point: Array) -> tuple[float, float]:
        jerk, white = np.exp(point)
        return float(jerk), float(np.hypot(white, step / np.sqrt(12.0)))

    def cost(point: Array) -> float:
        jerk, noise = values(point)
        return filter_forward(times, speeds, sample, is_begin, np.full(len(times), jerk), noise, states, turns)

    bounds = np.log([JERK, NOISE_MPS])
    start = bounds.mean(axis=1)
    corners = start + np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]])
    options = {"initial_simplex": corners, "xatol": 0.02, "fatol": 0.5}
    return values(minimize(cost, start, method="Nelder-Mead", bounds=bounds, options=options).x)


def _spaced_samples(grid: _Grid) -> Mask:
    """Samples spaced so that a rounding sensor has mostly changed its step: its error is then white."""
    speeds, spacing = grid.speeds[grid.sample], float(np.median(np.diff(grid.times[grid.sample])))
    repeat_count = len(speeds) / (1 + int(np.count_nonzero(np.diff(speeds))))
    spacing_count = max(1, int(min(repeat_count, SLOWEST_S / spacing)))
    return np.asarray(grid.sample & (np.cumsum(grid.sample) % spacing_count == 0))


def _correlated_samples(residual: Array) -> float:
    """Number of samples with the information of one independent sample: 1 for white noise, more for that of rounding."""
    residual = residual - residual.mean()
    total = float(residual @ residual)
    count = 1.0
    for lag in range(1, min(MOST_LAGS, len(residual)) if total > 0.0 else 1):
        correlation = float(residual[lag:] @ residual[:-lag]) / total
        if correlation < STILL_ALIKE:
            break
        count += 2.0 * correlation
    return count


@entry
def filter_forward(
    times: Array, speeds: Array, sample: Mask, is_begin: Mask, jerk: Array, noise: float, states: States, turns: Mask
) -> float:
    """Kalman filter: half the deviance of the innovations.

    At the `times` [s] marked in `sample`, `speeds` [m/s] are samples; at others only the state is computed. Stretches that
    are independent of earlier samples start at `is_begin`. `jerk` is the density up to each moment [m/s^2/sqrt(s)], `noise` the
    standard deviation of a sample [m/s]. `states` receives speed, acceleration, and variance of the speed, covariance and
    variance of the acceleration, shape (n, 5). `turns` receives the moments at which the acceleration may have changed at
    once: outliers that last begin there, so the filter goes back to that moment and follows them.
    """
    deviance, row_count, i = 0.0, 0, 0
    v, a, vv, va, aa = 0.0, 0.0, 0.0, 0.0, 0.0
    r = noise * noise
    above, side, first_outlier, lasts = (
        False,
        0,
        -1,
        0.0,
    )  # side of the last innovations, since when, and the first outlier among them
    misses = 0  # of its outliers
    turns[:] = False
    while i < len(times):
        if is_begin[i]:
            v, a, vv, va, aa, row_count, first_outlier = speeds[i], 0.0, UNKNOWN, 0.0, UNKNOWN, 0, -1
        else:
            dt, q = times[i] - times[i - 1], jerk[i] * jerk[i]
            if turns[i]:
                aa += FASTEST * FASTEST
            v += dt * a
            vv += dt * (2.0 * va + dt * aa) + q * dt * dt * dt / 3.0
            va += dt * aa + 0.5 * q * dt * dt
            aa += q * dt
        if sample[i]:
            row_count += 1
            error = speeds[i] - v
            limit = OUTLIER * math.sqrt(vv + r)
            if row_count <= 3 or (error > 0.0) != above:
                above, side, first_outlier = error > 0.0, i, -1
            if row_count > 3 and abs(error) > limit:
                if first_outlier < 0:
                    first_outlier, misses = i, 0
                    lasts = LASTS_S if abs(error) < 2.0 * limit + FASTEST * (times[i] - times[i - 1]) else BREAKS_S
                elif times[i] - times[first_outlier] >= lasts and not turns[first_outlier]:
                    while times[first_outlier] - times[side] > LASTS_S:
                        side += 1
                    turns[side] = turns[first_outlier] = True
                    if lasts == LASTS_S:
                        deviance += MISSED * misses * 0.5 * OUTLIER * OUTLIER
                    i, first_outlier = side, -1
                    v, a = states[i - 1, 0], states[i - 1, 1]
                    vv, va, aa = states[i - 1, 2], states[i - 1, 3], states[i - 1, 4]
                    continue
                misses += 1
            else:
                first_outlier = -1
            s = max(vv + r, error * error / (OUTLIER * OUTLIER))
            if row_count > 2:  # the first two only initialise the stretch
                deviance += 0.5 * (math.log(s) + error * error / s)
            of_speed, of_accel = vv / s, va / s
            v += of_speed * error
            a += of_accel * error
            aa -= of_accel * va
            va -= of_speed * va
            vv -= of_speed * vv
        states[i, 0], states[i, 1], states[i, 2], states[i, 3], states[i, 4] = v, a, vv, va, aa
        i += 1
    return deviance


@entry
def smooth_backward(
    times: Array, is_requested: Mask, is_begin: Mask, jerk: Array, turns: Mask, states: States, variances: Array
) -> None:
    """Rauch, Tung and Striebel's pass over the states of `filter_forward`, in place.

    `variances` receives the variance of the change of speed from each of the `is_requested` times to the next of the stretch,
    shape (n,).
    """
    later_row, with_v, with_a = -1, 0.0, 0.0  # the next requested time, and covariances of its speed with the state here
    for i in range(len(times) - 1, -1, -1):
        if i == len(times) - 1 or is_begin[i + 1]:
            later_row = -1
        else:
            dt, q = times[i + 1] - times[i], jerk[i + 1] * jerk[i + 1]
            v, a, vv, va, aa = states[i, 0], states[i, 1], states[i, 2], states[i, 3], states[i, 4]
            v_v, a_v = vv + dt * va, va + dt * aa  # covariances of the state here with the next predicted speed
            next_vv = v_v + dt * a_v + q * dt * dt * dt / 3.0
            next_va, next_aa = a_v + 0.5 * q * dt * dt, aa + q * dt
            if turns[i + 1]:
                turn = FASTEST * FASTEST
                next_vv, next_va, next_aa = next_vv + dt * dt * turn, next_va + dt * turn, next_aa + turn
            det = next_vv * next_aa - next_va * next_va
            g_vv, g_va = (v_v * next_aa - va * next_va) / det, (va * next_vv - v_v * next_va) / det
            g_av, g_aa = (a_v * next_aa - aa * next_va) / det, (aa * next_vv - a_v * next_va) / det
            off_v, off_a = states[i + 1, 0] - v - dt * a, states[i + 1, 1] - a
            d_vv, d_va, d_aa = states[i + 1, 2] - next_vv, states[i + 1, 3] - next_va, states[i + 1, 4] - next_aa
            h_vv, h_va = g_vv * d_vv + g_va * d_va, g_vv * d_va + g_va * d_aa
            h_av, h_aa = g_av * d_vv + g_aa * d_va, g_av * d_va + g_aa * d_aa
            states[i, 0] = v + g_vv * off_v + g_va * off_a
            states[i, 1] = a + g_av * off_v + g_aa * off_a
            states[i, 2] = vv + h_vv * g_vv + h_va * g_va
            states[i, 3] = va + h_vv * g_av + h_va * g_aa
            states[i, 4] = aa + h_av * g_av + h_aa * g_aa
            with_v, with_a = g_vv * with_v + g_va * with_a, g_av * with_v + g_aa * with_a
        if is_requested[i]:
            if later_row >= 0:
                variances[i] = max(states[i, 2] + states[later_row, 2] - 2.0 * with_v, 0.0)
            later_row, with_v, with_a = i, states[i, 2], states[i, 3]


def noise_of_means(times: Array, value: Array, step: float) -> float:
    """Standard deviation of a mean over a step [s] due to sample-to-sample noise; 0 where unknown.

    Second differences show that noise if the sampling is faster than changes of the signal. They exclude slower noise.
    """
    is_new = without_repeats(value)
    times, value = times[is_new], value[is_new]
    if len(times) < FEWEST or float(np.median(np.diff(times))) > SLOWEST_S:
        return 0.0
    noise = MAD_TO_STD * np.median(np.abs(np.diff(value, 2))) / np.sqrt(SECOND_DIFFERENCE)  # a median, as a torque may jump
    return float(noise * np.sqrt(np.median(np.diff(times)) / step))


SAME_PLACE_M = 10.0  # covers lanes and receiver scatter
ANOTHER_PASS_S = 600.0  # after which the receiver error is independent
APART_M = 20.0  # spacing of the compared places within one pass
FEWEST_REVISITS = 30
MOST_UNKNOWN = 0.5  # of a recording
WORTH = 0.5  # least share of the slope's variance that is not error
PIECE_S = 300.0  # correlation time of the errors
SURE = 2.0  # standard deviations


def with_slope(session: DriveSession) -> tuple[DriveSession, str]:
    """The session with a slope from its altitude, and a note; unchanged without a usable one, see `slope_of_altitude`.

    The measured torque must also fit significantly better with these slopes than without.
    """
    result, text = slope_of_altitude(session)
    return (result, text) if result is session else confirm_slope(session, result, text, "torque", "Nm", torque_errors(result))


def slope_of_altitude(session: DriveSession) -> tuple[DriveSession, str]:
    """The session with a slope from its altitude, used where that is known, and a note; unchanged without altitude, with a
    recorded slope, or without samples to compare.

    The distance for the slope follows from the altitude's error: its scatter, and the difference between passes of one
    place. The slope is used if at least half of its variance is not error.
    """
    if "altitude" not in session.given or "grade" in session.given or not session.used.any():
        return session, ""
    error, passes = error_by_revisits(session)
    slope = slopes(session.time + 0.5 * session.step, session.speed, session.altitude, error)
    is_known = np.isfinite(slope.value)
    used_steps = session.used & is_known
    passes_text = f", which differs by {error:.1f} m between passes of one place ({passes} places)," if passes else ""
    where = f"{session.name}: the altitude{passes_text}"
    if used_steps.sum() < (1.0 - MOST_UNKNOWN) * session.used.sum():
        return session, f"{where} gives a slope on less than half of the distance; it is not used"
    spread = float(np.std(slope.value[used_steps]))
    text = f"over {slope.length_m:.0f} m with a standard deviation of {slope.std:.2%}"
    if spread**2 < slope.std**2 / (1.0 - WORTH):
        return session, f"{where} gives no usable slope: slopes {text}, as large as the slopes themselves; it is not used"
    grade = np.where(is_known, slope.value, 0.0)
    roles, computed_roles = session.given | {"grade"}, session.computed | {"grade"}
    result = replace(session, grade=grade, grade_std=slope.std, used=used_steps, given=roles, computed=computed_roles)
    return result, f"{where} gives a slope {text}"


def confirm_slope(
    session: DriveSession,
    session_with_slope: DriveSession,
    text: str,
    quantity: str,
    unit: str,
    errors: tuple[float, float, bool],
) -> tuple[DriveSession, str]:
    """`session_with_slope` if the errors of a measurement confirm it, else unchanged; and the note with both."""
    error_without, with_it, is_sure = errors
    text = f"{text}; the {quantity} error is {with_it:.4g} {unit} with it and {error_without:.4g} {unit} without"
    return (session_with_slope, text) if is_sure else (session, f"{text}, so it is no usable slope")


def error_by_revisits(session: DriveSession) -> tuple[float, int]:
    """Standard deviation of the altitude's error between passes of a place [m], and the number of pairs; 0 without pairs."""
    from scipy.spatial import cKDTree  # takes a while to load

    x, y = Frame.of_positions(session.latitude, session.longitude).metres(session.latitude, session.longitude)
    is_known = np.isfinite(x) & np.isfinite(session.altitude)
    piece = np.floor(session.distance / APART_M)
    rows = np.flatnonzero(is_known & (np.diff(piece, prepend=-1.0) > 0.0))
    if len(rows) < 2:
        return 0.0, 0
    pairs = cKDTree(np.column_stack([x[rows], y[rows]])).query_pairs(SAME_PLACE_M, output_type="ndarray")
    first_rows, second_rows = rows[pairs[:, 0]], rows[pairs[:, 1]]
    is_revisit = np.abs(session.time[first_rows] - session.time[second_rows]) > ANOTHER_PASS_S
    differences = np.abs(session.altitude[first_rows] - session.altitude[second_rows])[is_revisit]
    if len(differences) < FEWEST_REVISITS:
        return 0.0, 0
    return float(MAD_TO_STD * np.median(differences) / np.sqrt(2.0)), len(differences)


def torque_errors(session: DriveSession) -> tuple[float, float, bool]:
    """Mean torque error without and with the slopes of a session [Nm], and whether the reduction is significant.

    The torque of inertia, rolling and air is fitted, with one factor each. A slope needs the torque of an acceleration of
    g times the slope, so mass and radius need not be known. Significant: two standard deviations over pieces of the drive.
    """
    use = session.used
    mass, torque = session.weight[use] / GRAVITY, session.torque[use]
    pulls = (session.accel[use], session.accel[use] + GRAVITY * session.grade[use])
    columns = (np.column_stack([mass * pull, _resistance_columns(session)]) for pull in pulls)
    return _error_change(((torque, x) for x in columns), session.time[use] // PIECE_S)


def coasting_errors(sessions: Sequence[DriveSession]) -> tuple[float, float, bool]:
    """The same for coast-downs, each in use and a block of its own: mean error of the decelerating force [N]."""
    resistance = np.concatenate([_resistance_columns(s) for s in sessions])
    forces = (
        np.concatenate([(s.weight / GRAVITY * (s.accel + part * GRAVITY * s.grade))[s.used] for s in sessions])
        for part in (0.0, 1.0)
    )
    return _error_change(((force, resistance) for force in forces), np.concatenate([s.block[s.used] for s in sessions]))


def _resistance_columns(session: DriveSession) -> Array:
    """Columns for the resistance of rolling and air, of the steps in use."""
    mass, speed = session.weight[session.used] / GRAVITY, session.speed[session.used]
    return np.column_stack([mass * np.sign(speed), mass * speed, speed * np.abs(speed)])


def _error_change(regressions: Iterable[tuple[Array, Array]], pieces: Array) -> tuple[float, float, bool]:
    """Mean errors of two fits of values by columns, and whether the second is significantly smaller, by the pieces."""
    errors_without, with_it = (np.abs(y - x @ robust_least_squares(x, y)) for y, x in regressions)
    _, piece = np.unique(pieces, return_inverse=True)
    gains = np.bincount(piece, errors_without - with_it) / np.bincount(piece)
    is_sure = len(gains) > 1 and gains.mean() > SURE * np.std(gains, ddof=1) / np.sqrt(len(gains))
    return float(errors_without.mean()), float(with_it.mean()), bool(is_sure)
