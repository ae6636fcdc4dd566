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
        driven = self.change_std[self.change_std > 0.0]
        return float(np.sqrt(np.mean(driven**2))) if len(driven) else 0.0


def smooth_speed(at: Array, shown: Array, times: Array, longest_gap_s: float) -> SmoothedSpeed | None:
    """Speed at some rising `times` [s] from all samples `shown` [m/s] before and after; None for slow sampling, or a moving
    vehicle with too few samples. Gaps longer than `longest_gap_s` get a straight line.
    """
    if len(at) < FEWEST or float(np.median(np.diff(at))) > SLOWEST_S:
        return None
    new = without_repeats(shown)
    at, shown = at[new], shown[new]
    step = rounding_step(shown)
    grid = _Grid.of(at, shown, times, longest_gap_s)
    if grid.kept.sum() < FEWEST:
        return None
    jerk, noise = _most_likely(grid, step)
    everywhere = np.full(len(grid.at), jerk)
    states, variances = grid.run(everywhere, noise)
    local = everywhere
    for _ in range(LOCAL_TURNS):  # a steady speed has hardly any jerk: its apparent one is sensor error
        squares = grid.squared_jerks(states)
        if np.median(squares) > EVEN * squares.mean():
            break
        local = np.clip(np.sqrt(squares * LOCAL_S), max(LEAST_LOCAL * jerk, HELD), MOST_LOCAL * jerk)
        states, variances = grid.run(local, noise)
    white = noise
    for _ in range(TURNS):  # coloured noise pulls the speed along, and shows fully only afterwards
        alike = _times_alike(grid.shown[grid.sample] - states[grid.sample, 0])
        if alike == 1.0:
            break
        noise = white * np.sqrt(alike)
        states, variances = grid.run(local, noise)
    rest = at_rest(at, shown)
    values = shown.copy()
    values[grid.kept] = states[grid.sample, 0]
    values[rest] = 0.0
    speed = np.interp(times, at, values)
    speed[grid.within] = states[~grid.sample, 0]
    after = np.clip(np.searchsorted(at, times, side="right"), 1, len(at) - 1)
    own = np.where(rest[after] & rest[after - 1], 0.0, np.nan)
    accel = own.copy()
    own[grid.within], accel[grid.within] = states[~grid.sample, 2], states[~grid.sample, 1]
    change = own[1:] + own[:-1]
    joint = np.full(len(times), np.nan)
    joint[grid.within] = variances[~grid.sample]
    change = np.where(np.isfinite(joint[:-1]), joint[:-1], change)
    return SmoothedSpeed(speed, accel, np.sqrt(np.maximum(change, 0.0)), jerk, noise, step)


def without_repeats(shown: Array) -> Mask:
    """Samples without the repeats of a sensor slower than its topic, recognised by a regular rhythm of changes."""
    changes = np.flatnonzero(np.diff(shown, prepend=np.nan) != 0.0)
    lengths = np.diff(changes)
    rhythm = 1
    for length in range(2, LONGEST_REPEAT + 1):
        if len(lengths) >= FEWEST and np.mean(lengths % length == 0) >= REGULAR:
            rhythm = length
    since = np.arange(len(shown)) - np.repeat(changes, np.diff(np.append(changes, len(shown))))
    return np.asarray(since % rhythm == 0)


def rounding_step(shown: Array) -> float:
    """Resolution of a sensor whose few values recur; 0 for others."""
    return resolution(shown) if len(np.unique(shown)) <= 0.5 * len(shown) else 0.0


def resolution(shown: Array) -> float:
    """The smallest difference of values that all others are multiples of; 0 where there is none."""
    values = np.unique(shown)
    apart = np.diff(values)
    apart = apart[apart > SAME * float(np.abs(values).max(initial=0.0))]
    if len(apart) < 2:
        return 0.0
    least = float(np.percentile(apart, 1.0))
    step = float(np.median(apart[apart < 1.5 * least]))
    times = apart / step
    return step if np.mean(np.abs(times - np.round(times)) < WHOLE) >= MULTIPLES else 0.0


def at_rest(at: Array, shown: Array) -> Mask:
    """Samples in lasting runs of zeros."""
    rest = np.zeros(len(shown), dtype=bool)
    for begin, end in runs_of(shown == 0.0):
        rest[begin:end] = at[end - 1] - at[begin] >= REST_S
    return rest


@dataclass(frozen=True, eq=False)
class _Grid:
    """Samples of stretches of driving and the asked times within them, in order; each is cut at gaps and rests."""

    at: Array
    shown: Array
    sample: Mask  # a sample, else a requested time
    begins: Mask
    kept: Mask  # kept samples among all
    within: Mask  # requested times inside, among all

    @classmethod
    def of(cls, at: Array, shown: Array, times: Array, longest_gap_s: float) -> _Grid:
        rest = at_rest(at, shown)
        still = rest[1:] & rest[:-1]  # from one sample to the next
        kept = ~(np.append(still, rest[-1]) & np.concatenate(([rest[0]], still)))
        cut = still | (np.diff(at) > longest_gap_s)
        begins = np.concatenate(([True], cut))
        after = np.searchsorted(at, times, side="right")
        inside = (after > 0) & (after < len(at))
        within = inside & ~cut[np.clip(after, 1, len(at) - 1) - 1]
        every = np.concatenate((at[kept], times[within]))
        order = np.argsort(every, kind="stable")
        count, more = int(kept.sum()), int(within.sum())
        sample = np.repeat((True, False), (count, more))[order]
        values = np.concatenate((shown[kept], np.zeros(more)))[order]
        first = np.concatenate((begins[kept], np.zeros(more, dtype=bool)))[order]
        return cls(every[order], values, sample, first, kept, within)

    def run(self, jerk: Array, noise: float) -> tuple[Array, Array]:
        """Smoothed states, and variances of changes to the next requested time."""
        states, variances = np.empty((len(self.at), 5)), np.full(len(self.at), np.nan)
        turns = np.empty(len(self.at), dtype=bool)
        filter_forward(self.at, self.shown, self.sample, self.begins, jerk, noise, states, turns)
        smooth_backward(self.at, ~self.sample, self.begins, jerk, turns, states, variances)
        return states, variances

    def squared_jerks(self, states: Array) -> Array:
        """Local mean squares of the smoothed acceleration's change [m^2/s^6]."""
        ends = np.clip(np.stack([self.at - LOCAL_S, self.at + LOCAL_S]), self.at[0], self.at[-1])
        before, after = np.interp(ends, self.at, states[:, 1])
        square = Cumulative.of(self.at, ((after - before) / (2.0 * LOCAL_S)) ** 2)
        low, high = np.interp(ends, self.at, square.integral)
        return np.asarray((high - low) / np.maximum(ends[1] - ends[0], 1e-9))


def _most_likely(grid: _Grid, step: float) -> tuple[float, float]:
    """Density of the jerk, and standard deviation of the noise including rounding."""
    piece = np.arange(len(grid.at)) // PIECE
    some = piece % (1 + piece[-1] // MOST_PIECES) == 0
    begins = (grid.begins | np.append(True, np.diff(piece) > 0))[some]
    at, shown, sample = grid.at[some], grid.shown[some], _apart(grid)[some]
    states, turns = np.empty((len(at), 5)), np.empty(len(at), dtype=bool)

    def values(point: Array) -> tuple[float, float]:
        jerk, white = np.exp(point)
        return float(jerk), float(np.hypot(white, step / np.sqrt(12.0)))

    def cost(point: Array) -> float:
        jerk, noise = values(point)
        return filter_forward(at, shown, sample, begins, np.full(len(at), jerk), noise, states, turns)

    bounds = np.log([JERK, NOISE_MPS])
    start = bounds.mean(axis=1)
    corners = start + np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]])
    options = {"initial_simplex": corners, "xatol": 0.02, "fatol": 0.5}
    return values(minimize(cost, start, method="Nelder-Mead", bounds=bounds, options=options).x)


def _apart(grid: _Grid) -> Mask:
    """Samples spaced so that a rounding sensor has mostly changed its step: its error is then white."""
    shown, spacing = grid.shown[grid.sample], float(np.median(np.diff(grid.at[grid.sample])))
    stays = len(shown) / (1 + int(np.count_nonzero(np.diff(shown))))
    every = max(1, int(min(stays, SLOWEST_S / spacing)))
    return np.asarray(grid.sample & (np.cumsum(grid.sample) % every == 0))


def _times_alike(left: Array) -> float:
    """Number of samples with the information of one independent sample: 1 for white noise, more for that of rounding."""
    left = left - left.mean()
    total = float(left @ left)
    alike = 1.0
    for lag in range(1, min(MOST_LAGS, len(left)) if total > 0.0 else 1):
        correlation = float(left[lag:] @ left[:-lag]) / total
        if correlation < STILL_ALIKE:
            break
        alike += 2.0 * correlation
    return alike


@entry
def filter_forward(
    at: Array, shown: Array, sample: Mask, begins: Mask, jerk: Array, noise: float, states: States, turns: Mask
) -> float:
    """Kalman filter: half the deviance of the innovations.

    `at` are times [s], at which `shown` [m/s] are samples, if marked in `sample`, else only the state is computed. Stretches that
    are independent of earlier samples start at `begins`. `jerk` is the density up to each moment [m/s^2/sqrt(s)], `noise` the
    standard deviation of a sample [m/s]. `states` receives speed, acceleration, and variance of the speed, covariance and
    variance of the acceleration, shape (n, 5). `turns` receives the moments at which the acceleration may have changed at
    once: outliers that last begin there, so the filter goes back to that moment and follows them.
    """
    deviance, known, i = 0.0, 0, 0
    v, a, vv, va, aa = 0.0, 0.0, 0.0, 0.0, 0.0
    r = noise * noise
    above, side, first, lasts = False, 0, -1, 0.0  # side of the last innovations, since when, and the first outlier among them
    missed = 0  # of its outliers
    turns[:] = False
    while i < len(at):
        if begins[i]:
            v, a, vv, va, aa, known, first = shown[i], 0.0, UNKNOWN, 0.0, UNKNOWN, 0, -1
        else:
            dt, q = at[i] - at[i - 1], jerk[i] * jerk[i]
            if turns[i]:
                aa += FASTEST * FASTEST
            v += dt * a
            vv += dt * (2.0 * va + dt * aa) + q * dt * dt * dt / 3.0
            va += dt * aa + 0.5 * q * dt * dt
            aa += q * dt
        if sample[i]:
            known += 1
            off = shown[i] - v
            expected = OUTLIER * math.sqrt(vv + r)
            if known <= 3 or (off > 0.0) != above:
                above, side, first = off > 0.0, i, -1
            if known > 3 and abs(off) > expected:
                if first < 0:
                    first, missed = i, 0
                    lasts = LASTS_S if abs(off) < 2.0 * expected + FASTEST * (at[i] - at[i - 1]) else BREAKS_S
                elif at[i] - at[first] >= lasts and not turns[first]:
                    while at[first] - at[side] > LASTS_S:
                        side += 1
                    turns[side] = turns[first] = True
                    if lasts == LASTS_S:
                        deviance += MISSED * missed * 0.5 * OUTLIER * OUTLIER
                    i, first = side, -1
                    v, a = states[i - 1, 0], states[i - 1, 1]
                    vv, va, aa = states[i - 1, 2], states[i - 1, 3], states[i - 1, 4]
                    continue
                missed += 1
            else:
                first = -1
            s = max(vv + r, off * off / (OUTLIER * OUTLIER))
            if known > 2:  # the first two only initialise the stretch
                deviance += 0.5 * (math.log(s) + off * off / s)
            of_speed, of_accel = vv / s, va / s
            v += of_speed * off
            a += of_accel * off
            aa -= of_accel * va
            va -= of_speed * va
            vv -= of_speed * vv
        states[i, 0], states[i, 1], states[i, 2], states[i, 3], states[i, 4] = v, a, vv, va, aa
        i += 1
    return deviance


@entry
def smooth_backward(at: Array, asked: Mask, begins: Mask, jerk: Array, turns: Mask, states: States, variances: Array) -> None:
    """Rauch, Tung and Striebel's pass over the states of `filter_forward`, in place.

    `variances` receives the variance of the change of speed from each of the `asked` times to the next of the stretch,
    shape (n,).
    """
    later, with_v, with_a = -1, 0.0, 0.0  # the next requested time, and covariances of its speed with the state here
    for i in range(len(at) - 1, -1, -1):
        if i == len(at) - 1 or begins[i + 1]:
            later = -1
        else:
            dt, q = at[i + 1] - at[i], jerk[i + 1] * jerk[i + 1]
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
        if asked[i]:
            if later >= 0:
                variances[i] = max(states[i, 2] + states[later, 2] - 2.0 * with_v, 0.0)
            later, with_v, with_a = i, states[i, 2], states[i, 3]


def noise_of_means(at: Array, value: Array, step: float) -> float:
    """Standard deviation of a mean over a step [s] due to sample-to-sample noise; 0 where unknown.

    Second differences show that noise if the sampling is faster than changes of the signal. They exclude slower noise.
    """
    new = without_repeats(value)
    at, value = at[new], value[new]
    if len(at) < FEWEST or float(np.median(np.diff(at))) > SLOWEST_S:
        return 0.0
    noise = MAD_TO_STD * np.median(np.abs(np.diff(value, 2))) / np.sqrt(SECOND_DIFFERENCE)  # a median, as a torque may jump
    return float(noise * np.sqrt(np.median(np.diff(at)) / step))


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
    found, text = slope_of_altitude(session)
    return (found, text) if found is session else confirmed(session, found, text, "torque", "Nm", torque_errors(found))


def slope_of_altitude(session: DriveSession) -> tuple[DriveSession, str]:
    """The session with a slope from its altitude, used where that is known, and a note; unchanged without altitude, with a
    recorded slope, or without samples to compare.

    The distance for the slope follows from the altitude's error: its scatter, and the difference between passes of one
    place. The slope is used if at least half of its variance is not error.
    """
    if "altitude" not in session.given or "grade" in session.given or not session.used.any():
        return session, ""
    error, passes = error_by_revisits(session)
    found = slopes(session.time + 0.5 * session.step, session.speed, session.altitude, error)
    known = np.isfinite(found.value)
    used = session.used & known
    of_error = f", which differs by {error:.1f} m between passes of one place ({passes} places)," if passes else ""
    where = f"{session.name}: the altitude{of_error}"
    if used.sum() < (1.0 - MOST_UNKNOWN) * session.used.sum():
        return session, f"{where} gives a slope on less than half of the distance; it is not used"
    spread = float(np.std(found.value[used]))
    text = f"over {found.length_m:.0f} m with a standard deviation of {found.std:.2%}"
    if spread**2 < found.std**2 / (1.0 - WORTH):
        return session, f"{where} gives no usable slope: slopes {text}, as large as the slopes themselves; it is not used"
    grade = np.where(known, found.value, 0.0)
    given, computed = session.given | {"grade"}, session.computed | {"grade"}
    with_it = replace(session, grade=grade, grade_std=found.std, used=used, given=given, computed=computed)
    return with_it, f"{where} gives a slope {text}"


def confirmed(
    session: DriveSession, found: DriveSession, text: str, what: str, unit: str, errors: tuple[float, float, bool]
) -> tuple[DriveSession, str]:
    """The session with its slope `found` if the errors of a measurement confirm it, else unchanged; and the note with both."""
    without, with_it, surely = errors
    text = f"{text}; the {what} error is {with_it:.4g} {unit} with it and {without:.4g} {unit} without"
    return (found, text) if surely else (session, f"{text}, so it is no usable slope")


def error_by_revisits(session: DriveSession) -> tuple[float, int]:
    """Standard deviation of the altitude's error between passes of a place [m], and the number of pairs; 0 without pairs."""
    from scipy.spatial import cKDTree  # takes a while to load

    x, y = Frame.about(session.latitude, session.longitude).metres(session.latitude, session.longitude)
    known = np.isfinite(x) & np.isfinite(session.altitude)
    piece = np.floor(session.distance / APART_M)
    rows = np.flatnonzero(known & (np.diff(piece, prepend=-1.0) > 0.0))
    if len(rows) < 2:
        return 0.0, 0
    pairs = cKDTree(np.column_stack([x[rows], y[rows]])).query_pairs(SAME_PLACE_M, output_type="ndarray")
    first, second = rows[pairs[:, 0]], rows[pairs[:, 1]]
    again = np.abs(session.time[first] - session.time[second]) > ANOTHER_PASS_S
    apart = np.abs(session.altitude[first] - session.altitude[second])[again]
    if len(apart) < FEWEST_REVISITS:
        return 0.0, 0
    return float(MAD_TO_STD * np.median(apart) / np.sqrt(2.0)), len(apart)


def torque_errors(session: DriveSession) -> tuple[float, float, bool]:
    """Mean torque error without and with the slopes of a session [Nm], and whether the reduction is significant.

    The torque of inertia, rolling and air is fitted, with one factor each. A slope needs the torque of an acceleration of
    g times the slope, so mass and radius need not be known. Significant: two standard deviations over pieces of the drive.
    """
    use = session.used
    mass, torque = session.weight[use] / GRAVITY, session.torque[use]
    pulls = (session.accel[use], session.accel[use] + GRAVITY * session.grade[use])
    columns = (np.column_stack([mass * pull, _resisting(session)]) for pull in pulls)
    return _compared(((torque, x) for x in columns), session.time[use] // PIECE_S)


def coasting_errors(sessions: Sequence[DriveSession]) -> tuple[float, float, bool]:
    """The same for coast-downs, each in use and a block of its own: mean error of the decelerating force [N]."""
    resists = np.concatenate([_resisting(s) for s in sessions])
    forces = (
        np.concatenate([(s.weight / GRAVITY * (s.accel + part * GRAVITY * s.grade))[s.used] for s in sessions])
        for part in (0.0, 1.0)
    )
    return _compared(((force, resists) for force in forces), np.concatenate([s.block[s.used] for s in sessions]))


def _resisting(session: DriveSession) -> Array:
    """Columns for the resistance of rolling and air, of the steps in use."""
    mass, speed = session.weight[session.used] / GRAVITY, session.speed[session.used]
    return np.column_stack([mass * np.sign(speed), mass * speed, speed * np.abs(speed)])


def _compared(fits: Iterable[tuple[Array, Array]], pieces: Array) -> tuple[float, float, bool]:
    """Mean errors of two fits of values by columns, and whether the second is significantly smaller, by the pieces."""
    without, with_it = (np.abs(y - x @ robust_least_squares(x, y)) for y, x in fits)
    _, piece = np.unique(pieces, return_inverse=True)
    gains = np.bincount(piece, without - with_it) / np.bincount(piece)
    surely = len(gains) > 1 and gains.mean() > SURE * np.std(gains, ddof=1) / np.sqrt(len(gains))
    return float(without.mean()), float(with_it.mean()), bool(surely)
