# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Estimates the delay of the measured torque behind the speed [s], with its standard deviation.

Each window of 20 s with changes of speed gives a delay and its quality. The delays of the last windows give the mean, and their
scatter its standard deviation.

References
----------
R. T. Birge, The calculation of errors by the method of least squares, Phys. Rev. 40 (1932) 207-227.
C. H. Knapp, G. C. Carter, The generalized correlation method for estimation of time delay, IEEE Trans. Acoust. Speech Signal
Process. 24 (1976) 320-327.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from trackres_ros.arrays import Array, Mask
from trackres_ros.learning.gate import AGAINST_SHARE, BRAKING_MPS2, SLOWEST_MPS
from trackres_ros.units import NANOSECOND, SECOND_NS

# One window

EARLIEST_S, LATEST_S = -0.5, 1.0  # delays searched: a delay up to 0.5 s needs both flanks of its peak
GRID_S = 0.05
WINDOW_S = 20.0
SMOOTH_S = 0.3  # least standard deviation of the kernel: an acceleration in less time is mostly noise of the speed
SMOOTH_SPACINGS = 0.7  # minimum standard deviation over the time between two samples: values between them are unknown
REACH = 3.0  # of the kernel, in standard deviations
SLOWEST_RATE_HZ = 1.0
MARGIN_S = REACH * SMOOTH_SPACINGS / SLOWEST_RATE_HZ
SPAN_S = LATEST_S - EARLIEST_S + WINDOW_S + 2.0 * MARGIN_S
LONGEST_GAP_S = 2.5  # at 1 Hz one sample may be missing
GAP_SPACINGS, LEAST_GAP_S = 3.5, 0.5  # a longer pause than this, over the typical spacing and at least, is a gap
LEAST_SAMPLES = 8
BESIDE_BRAKES_S = 1.0  # excluded on either side of braking: the delay of the torque may be as long
LEAST_SHARE = 0.25  # of a window that must be usable
LEAST_EXPLAINED, LEAST_EXPLAINED_BRAKING = 0.6, 0.9  # share of the expected changes: below, another cause drives or brakes
GAINS = (0.6, 1.5)  # expected over measured changes: beyond, the torque is not the one that moves this vehicle
GAIN_STD = 0.1  # assumed: uncertainty of load, mass and torque sensor
SPEED_SHARE = 0.02  # assumed: unmodelled change of the resistance per m/s, of the rolling torque
ALIKE_S = 1.5  # points of a window further apart than this are independent
LEAST_ALIKE = 0.1  # assumed: no noise alternates so well that it counts for less than a tenth of white noise
FITTED = 5.0  # values of a window: level, trend, resistance over speed, gain, delay
ROUNDING = 1e-9
WORST_STD_S = 0.1  # a window with a larger uncertainty has no excitation

_TIMES = np.arange(round(SPAN_S / GRID_S) + 1) * GRID_S
_DELAYS = np.arange(round(EARLIEST_S / GRID_S), round(LATEST_S / GRID_S) + 1)
_INNER = round((MARGIN_S - EARLIEST_S) / GRID_S) + np.arange(round(WINDOW_S / GRID_S))


def window_delay(speeds: Array, torques: Array, rolling_nm: float) -> tuple[float, float] | None:
    """Delay from the samples of one window, and its variance.

    Parameters
    ----------
    speeds
        Time [s], speed [m/s], resistance [Nm] and inertia per m/s^2 [Nm s^2/m]; shape (samples, 4).
    torques
        Time [s] and measured torque [Nm]; shape (samples, 2).
    rolling_nm
        Size of the rolling resistance torque [Nm]: during stronger braking, friction brakes may act.

    Returns
    -------
    tuple or None
        Delay [s] and variance [s^2]; None without excitation.

    Notes
    -----
    All series are smoothed equally. Then expected(t) = gain * measured(t + delay) + a + b t + c speed(t): level, warming and an
    unmodelled growth of the resistance with speed are no delay. Gain and c have priors, since under an exponentially decaying
    acceleration another gain looks like another delay. The expected torque is on the left, as its noise, from the
    differentiated speed, is larger. The sum of squares is smallest at the delay, interpolated between points of the grid by a
    parabola.
    """
    if min(len(speeds), len(torques)) < LEAST_SAMPLES:
        return None
    (kept_speed, spacing), (kept_torque, torque_spacing) = (_near_samples(series[:, 0]) for series in (speeds, torques))
    smooth = min(max(SMOOTH_S, SMOOTH_SPACINGS * max(spacing, torque_spacing)), MARGIN_S / REACH)
    speed, resistance, inertia = (np.interp(_TIMES, speeds[:, 0], speeds[:, i]) for i in (1, 2, 3))
    torque = np.interp(_TIMES, torques[:, 0], torques[:, 1])
    is_usable = kept_speed & (np.abs(speed) > SLOWEST_MPS)
    mean, slope = _kernels(smooth)
    accel = np.convolve(speed, slope, "same")
    expected = np.convolve(resistance, mean, "same") + inertia * accel
    measured_torque, smooth_speed = np.convolve(torque, mean, "same"), np.convolve(speed, mean, "same")
    ahead = np.sign(speed)
    brakes = (accel * ahead < BRAKING_MPS2) & (measured_torque * ahead <= AGAINST_SHARE * rolling_nm)
    reach = REACH * smooth
    has_torque = _reached_points(_clear_points(kept_torque, reach))
    series = np.stack([expected, measured_torque, smooth_speed])
    # If the torque follows the braking too, no friction brakes act; else braking is excluded.
    least_share = LEAST_EXPLAINED_BRAKING if brakes.any() else LEAST_EXPLAINED
    result = _fit_delay(series, has_torque & _clear_points(is_usable, reach), smooth, rolling_nm, least_share)
    if result is None and brakes.any():
        is_usable &= _clear_points(~brakes, BESIDE_BRAKES_S)
        result = _fit_delay(series, has_torque & _clear_points(is_usable, reach), smooth, rolling_nm, LEAST_EXPLAINED)
    return result


def _kernels(smooth: float) -> tuple[Array, Array]:
    """A mean over a standard deviation [s], and a slope of it, by the grid."""
    times = np.arange(-round(REACH * smooth / GRID_S), round(REACH * smooth / GRID_S) + 1) * GRID_S
    mean = np.exp(-0.5 * (times / smooth) ** 2)
    mean /= mean.sum()
    slope = -times * mean
    return mean, slope / -(slope * times).sum()


def _fit_delay(
    series: Array, is_usable: Mask, smooth: float, rolling_nm: float, least_explained: float
) -> tuple[float, float] | None:
    """Delay and variance by the points of the grid that are usable; see `window_delay`."""
    expected, torque, speed = series
    inner = _INNER[is_usable[_INNER]]
    if len(inner) < LEAST_SHARE * WINDOW_S / GRID_S:
        return None
    base = np.linalg.qr(np.column_stack([np.ones(len(inner)), inner - inner.mean()]))[0]
    by_delay = np.vstack([torque[inner[None, :] + _DELAYS[:, None]], speed[inner], expected[inner]])
    by_delay -= (by_delay @ base) @ base.T
    (over_speed, parts), by_delay = by_delay[-2:], by_delay[:-2]
    correlation = 2.0 * math.sqrt(math.pi) * smooth / GRID_S  # smoothed points of the grid per independent one
    freedom = max(len(inner) - FITTED * correlation, correlation)
    products = (
        (by_delay**2).sum(axis=1),
        by_delay @ over_speed,
        float(over_speed @ over_speed),
        by_delay @ parts,
        float(over_speed @ parts),
    )
    square_sum, priors = float(parts @ parts), (0.0, 0.0)
    for _ in range(2):  # a fit without priors gives the noise, which sets the weight of the priors
        unexplained, gains, slopes = _least_squares(*products, *priors)
        index = int(np.argmin(unexplained))
        noise = max(square_sum + float(unexplained[index]), ROUNDING * square_sum) / freedom
        priors = noise * correlation / GAIN_STD**2, noise * correlation / (SPEED_SHARE * rolling_nm) ** 2
    if not 0 < index < len(_DELAYS) - 1 or not GAINS[0] < gains[index] < GAINS[1]:
        return None
    residual = parts - gains[index] * by_delay[index] - slopes[index] * over_speed
    residual_before, at_best, residual_after = unexplained[index - 1 : index + 2].tolist()
    bend = residual_before + residual_after - 2.0 * at_best
    if bend <= 0.0 or float(residual @ residual) > (1.0 - least_explained) * square_sum:
        return None
    delay = (_DELAYS[index] + 0.5 * (residual_before - residual_after) / bend) * GRID_S
    slope = gains[index] * (by_delay[index + 1] - by_delay[index - 1]) / (2.0 * GRID_S)  # per second of delay
    basis = np.stack([by_delay[index], over_speed])
    own_part = slope - np.linalg.solve(basis @ basis.T + np.diag(priors), basis @ slope) @ basis
    spread = np.zeros((2, len(expected)))  # no data between the usable points
    spread[:, inner] = own_part, residual
    variance = float(residual @ residual) / freedom * _correlation_factor(*spread) / max(float(slope @ own_part), 1e-300)
    return (float(delay), variance) if variance < WORST_STD_S**2 else None


def _least_squares(
    uu: Array, uv: Array, vv: float, um: Array, vm: float, of_gain: float, of_slope: float
) -> tuple[Array, Array, Array]:
    """Fit m = gain * u + slope * v for each delay from the products of u, v and m, with priors at a gain of 1 and a slope of 0.

    Returns the sum of squares less that of m, gain and slope, each of shape (delays,).
    """
    a_11, a_12, a_22 = uu + of_gain, uv, vv + of_slope
    determinant = np.maximum(a_11 * a_22 - a_12**2, 1e-12 * uu * vv + 1e-300)
    b_1 = um + of_gain
    gains, slopes = (a_22 * b_1 - a_12 * vm) / determinant, (a_11 * vm - a_12 * b_1) / determinant
    return of_gain - gains * b_1 - slopes * vm, gains, slopes


def _correlation_factor(slope: Array, noise: Array) -> float:
    """Effect of the noise on a fitted slope, relative to white noise of the same size.

    An acceleration from a noisy speed has alternating noise, which moves the delay much less than other noise would.
    """
    reach = round(ALIKE_S / GRID_S)
    of_slope, of_noise = (np.correlate(np.pad(signal, reach), signal, "valid")[reach:] for signal in (slope, noise))
    weights = 1.0 - np.arange(reach + 1) / (reach + 1.0)
    weights[1:] *= 2.0
    return max(float((weights * of_slope * of_noise).sum()) / max(float(of_slope[0] * of_noise[0]), 1e-300), LEAST_ALIKE)


def _near_samples(times: Array) -> tuple[Mask, float]:
    """Points of the grid outside gaps of the samples, shape of `_TIMES`; and the typical spacing of the samples [s]."""
    spacing = np.diff(times)
    typical = float(np.median(spacing))
    longest_gap = min(max(GAP_SPACINGS * typical, LEAST_GAP_S), LONGEST_GAP_S)
    next_index = np.searchsorted(times, _TIMES, side="right")
    inside = (next_index > 0) & (next_index < len(times))
    is_near = np.zeros(len(_TIMES), dtype=bool)
    is_near[inside] = spacing[next_index[inside] - 1] <= longest_gap
    return is_near, typical


def _reached_points(is_good: Mask) -> Mask:
    """Points of `_INNER` where all points used by any delay are good."""
    bad_count = np.concatenate([[0], np.cumsum(~is_good)])
    is_reached = np.zeros(len(is_good), dtype=bool)
    is_reached[_INNER] = bad_count[_INNER + _DELAYS[-1] + 1] == bad_count[_INNER + _DELAYS[0]]
    return is_reached


def _clear_points(is_good: Mask, reach_s: float) -> Mask:
    """Points where all within a reach are good; beyond the ends all are."""
    reach = round(reach_s / GRID_S)
    bad_count = np.concatenate([[0], np.cumsum(~is_good)])
    index = np.arange(len(is_good))
    return np.asarray(bad_count[np.minimum(index + reach + 1, len(is_good))] == bad_count[np.maximum(index - reach, 0)])


# Several windows

APART_NS = 9_000_000  # between two kept samples: at 100 Hz all are kept
PAST = 40  # windows that are kept
LEAST_WINDOW_STD_S = 0.01  # assumed: no window is better, as a filter delays slow changes more than fast ones
LEAST_STD_S = 0.003  # assumed: common to all windows
FIRST_STD_S = 0.3  # assumed: prior
OUTLIER = 3.0  # standard deviations: a window further off has a lower weight
AS_SAID = 4.0  # assumed number of prior windows whose scatter agrees with their variances
LATE = 3  # last windows that can reveal a changed delay
CHANGED_STDS, CHANGED_S = 4.0, 0.015  # by which their mean is then off
LEAST_WINDOWS = 6
KNOWN_STD_S = 0.01  # so that 95 % are within 20 ms


@dataclass
class KeptDelays:
    """Delays of the last windows; all of it is kept over a restart. Window number n is at n modulo `PAST`."""

    count: int = 0  # windows with a delay so far
    fresh: int = 0  # those since the last start: another topics file may have moved the torque since
    delays: Array = field(default_factory=lambda: np.zeros(PAST))  # s
    variances: Array = field(default_factory=lambda: np.zeros(PAST))  # s^2; 0 for none

    def add(self, delay: float, variance: float) -> None:
        """Add the delay of a window; forget the earlier ones if the last ones agree on another."""
        place = self.count % PAST
        self.delays[place], self.variances[place] = delay, max(variance, LEAST_WINDOW_STD_S**2)
        self.count += 1
        self.fresh += 1
        recent_places = [(self.count - 1 - lag) % PAST for lag in range(LATE)]
        old_variances = self.variances.copy()
        old_variances[recent_places] = 0.0
        if np.count_nonzero(old_variances) < LATE:
            return
        old_delay, old_std = _weighted_mean(self.delays, old_variances)
        recent_delay, recent_std = _weighted_mean(self.delays[recent_places], self.variances[recent_places])
        if abs(recent_delay - old_delay) > max(CHANGED_STDS * math.hypot(old_std, recent_std), CHANGED_S):
            old_variances[old_variances > 0.0] = 0.0
            old_variances[recent_places] = self.variances[recent_places]
            self.variances[:] = old_variances

    @property
    def value(self) -> tuple[float, float]:
        """The delay and its standard deviation [s]."""
        return _weighted_mean(self.delays, self.variances)

    @property
    def is_known(self) -> bool:
        """Whether the delay is known: from enough consistent windows, some of them since the start."""
        has_windows = np.count_nonzero(self.variances) >= LEAST_WINDOWS and self.fresh >= LATE
        return bool(has_windows) and self.value[1] < KNOWN_STD_S


def _weighted_mean(delays: Array, variances: Array) -> tuple[float, float]:
    """Robust weighted mean of windows and its standard deviation [s], from their scatter if that exceeds their variances."""
    has_window = variances > 0.0
    n = int(np.count_nonzero(has_window))
    if n == 0:
        return 0.0, FIRST_STD_S
    x, weights = delays[has_window], 1.0 / variances[has_window]
    order = np.argsort(x, kind="stable")
    median = int(np.searchsorted(np.cumsum(weights[order]), 0.5 * weights.sum()))
    mean, scale, trust = float(x[order][median]), 1.0, np.ones(n)
    for _ in range(5):
        distance = np.abs(x - mean) * np.sqrt(weights) / scale
        trust = OUTLIER / np.maximum(distance, OUTLIER)
        used = weights * trust
        mean = float((used * x).sum() / used.sum())
        if n > 1:
            freedom = AS_SAID + n - 1.0
            scale = math.sqrt(max((AS_SAID + float((used * (x - mean) ** 2).sum())) / freedom, 1.0))
    small_sample = (AS_SAID + n - 1.0) / (AS_SAID + n - 3.0)  # Student's t: the scatter of few is uncertain
    variance = scale * scale * small_sample / float((weights * trust).sum())
    total_weight = 1.0 / (1.0 / variance + FIRST_STD_S**-2)
    return mean * total_weight / variance, math.hypot(math.sqrt(total_weight), LEAST_STD_S)


@dataclass
class DelaySamples:
    """Samples of a window with its margins: times [s] since its beginning, and values."""

    speed: list[tuple[float, float, float, float]] = field(default_factory=list)  # time, speed, resistance, inertia by m/s^2
    torque: list[tuple[float, float]] = field(default_factory=list)


class DelayEstimator:
    """Takes steps one by one, of a vehicle with a rolling resistance torque [Nm]; each window of them gives a delay."""

    def __init__(self, rolling_nm: float) -> None:
        self._rolling_nm = rolling_nm
        self.reset()

    def reset(self) -> None:
        """Forget all."""
        self.kept = KeptDelays()
        self._begin(0)

    def restart(self) -> None:
        """Restart the time; delays of earlier windows stay, but need confirmation."""
        self.kept.fresh = 0
        self._begin(0)

    def _begin(self, stamp_ns: int) -> None:
        self._origin_ns, self._seen_ns, self._torque_ns = stamp_ns, 0, 0
        self._samples = DelaySamples()

    def take(
        self,
        stamp_ns: int,  # of the speed
        speed: float,  # m/s
        resisting_nm: float,  # modelled drive torque without inertia
        inertia: float,  # torque of the inertia per m/s^2 [Nm s^2/m]
        torque_ns: int,  # stamp of the measured torque
        torque_nm: float,
        is_usable: bool = True,  # whether speed and estimate can be trusted now; if not, the whole window is discarded
    ) -> None:
        """Add a speed and the last measured torque."""
        samples, origin = self._samples, self._origin_ns
        passed_ns = stamp_ns - self._seen_ns
        is_behind = torque_ns < self._torque_ns  # the clock of the torque was set back
        if not is_usable or is_behind or not samples.speed or not 0 <= passed_ns <= LONGEST_GAP_S * SECOND_NS:
            self._begin(stamp_ns)
            samples, origin = self._samples, stamp_ns
            if not is_usable:
                return
        elif passed_ns < APART_NS:
            return
        self._seen_ns = stamp_ns
        time_s = (stamp_ns - origin) * NANOSECOND
        samples.speed.append((time_s, speed, resisting_nm, inertia))
        if torque_ns >= self._torque_ns + APART_NS and torque_ns > origin - SECOND_NS and math.isfinite(torque_nm):
            self._torque_ns = torque_ns
            samples.torque.append(((torque_ns - origin) * NANOSECOND, torque_nm))
        if time_s < SPAN_S + LONGEST_GAP_S:
            return
        self._advance()
        delay = window_delay(np.array(samples.speed), np.array(samples.torque).reshape(-1, 2), self._rolling_nm)
        if delay:
            self.kept.add(*delay)

    def _advance(self) -> None:
        """Begin the next window at the end of this one."""
        self._origin_ns += round(WINDOW_S * SECOND_NS)
        self._samples = DelaySamples(
            [(time - WINDOW_S, v, r, i) for time, v, r, i in self._samples.speed if time >= WINDOW_S - LONGEST_GAP_S],
            [(time - WINDOW_S, torque) for time, torque in self._samples.torque if time >= WINDOW_S - LONGEST_GAP_S],
        )
