# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Estimates by how much the measured torque comes later than the speed, from changes of speed, and how sure that is.

Over windows of 20 s the torque that driving takes after the model, resistance and inertia of the changing speed, is shifted in time
until it fits the measured torque best. The delays of many windows together give the mean, and what they differ by its standard
deviation.

References
----------
C. H. Knapp, G. C. Carter, The generalized correlation method for estimation of time delay, IEEE Trans. Acoust. Speech Signal
Process. 24 (1976) 320-327.
R. T. Birge, The calculation of errors by the method of least squares, Phys. Rev. 40 (1932) 207-227.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trackres_ros.learning.gate import AGAINST_SHARE, BRAKING_MPS2, SLOWEST_MPS
from trackres_ros.units import NANOSECOND, SECOND_NS

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

EARLIEST_S, LATEST_S = -0.5, 1.0  # delays that are looked for: half a second at most is wanted, and its peak needs both flanks
GRID_S = 0.05
WINDOW_S = 20.0
SMOOTH_S = 0.3  # standard deviation of the kernel: of a speed in steps of 5 cm/s less noise is left than a brisk start makes
SMOOTH_SPACINGS = 0.7  # and so many times the time between two samples at least: what lies between them is not known
REACH = 3.0  # standard deviations
APART_NS = 9_000_000  # between two kept samples: at 100 Hz every one
LONGEST_GAP_S = 2.5  # between two samples, at a rate of 1 Hz with one missing
GAP_SPACINGS, LEAST_GAP_S = 3.5, 0.5  # a gap is so many times the typical spacing
BESIDE_BRAKES_S = 1.0  # on either side of braking: the torque may be so late
LEAST_SHARE = 0.25  # of a window that must be usable
LEAST_EXPLAINED = 0.6  # of the torque's changes: else something else changes it
LEAST_EXPLAINED_BRAKING = 0.9  # the same where it brakes
GAINS = (0.6, 1.5)  # measured over expected: else it is not this vehicle's torque that follows
GAIN_STD = 0.1  # assumed: loads and masses are known so well
SPEED_SHARE = 0.02  # assumed: by so much of what rolling takes a m/s changes the resistance more or less than the model says
ALIKE_S = 1.5  # points of a window that are further apart count as independent
LEAST_ALIKE = 0.1  # no noise goes to and fro so well that it moves the delay less than a tenth as much noise that is white
WORST_STD_S = 0.1  # of one window: less is no excitation
FITTED = 5.0  # values of a window: level, slope, resistance over speed, gain, delay
LEAST_WINDOW_STD_S = 0.01  # assumed: no window is better, as a filter delays fast changes by less than slow ones
LEAST_STD_S = 0.003  # assumed: the same of all together
FIRST_STD_S = 0.3  # assumed: what is known before anything was driven
PAST = 40  # windows that are kept
OUTLIER = 3.0  # standard deviations: windows further off weigh less
AS_SAID = 4.0  # windows as far apart as they say are assumed beside those that were seen
LATE = 3  # windows that may tell that the delay has changed
CHANGED_STDS, CHANGED_S = 4.0, 0.015
LEAST_WINDOWS = 6
KNOWN_STD_S = 0.01  # half of the error that is allowed
MARGIN_S = REACH * SMOOTH_SPACINGS * 1.0  # at 1 Hz
SPAN_S = LATEST_S - EARLIEST_S + WINDOW_S + 2.0 * MARGIN_S  # of a window with its margins


@dataclass
class KeptDelays:
    """Delays of the last windows; all of it is kept over a restart.

    Attributes
    ----------
    count
        Windows that told of a delay so far.
    fresh
        Of them since the last start: until some agree, another topics file may have moved the torque.
    delays, variances
        Of the last windows [s] and [s^2]; number n stands at n modulo their length. A variance of 0: none.
    """

    count: int = 0
    fresh: int = 0
    delays: Array = field(default_factory=lambda: np.zeros(PAST))
    variances: Array = field(default_factory=lambda: np.zeros(PAST))

    def see(self, delay: float, variance: float) -> None:
        """Take in the delay of a window; forget those before where the last ones agree on another."""
        place = self.count % PAST
        self.delays[place], self.variances[place] = delay, max(variance, LEAST_WINDOW_STD_S**2)
        self.count += 1
        self.fresh += 1
        late = [(self.count - 1 - back) % PAST for back in range(LATE)]
        before = self.variances.copy()
        before[late] = 0.0
        if np.count_nonzero(before) < LATE:
            return
        old, old_std = _together(self.delays, before)
        new, new_std = _together(self.delays[late], self.variances[late])
        if abs(new - old) > max(CHANGED_STDS * math.hypot(old_std, new_std), CHANGED_S):
            before[before > 0.0] = 0.0
            before[late] = self.variances[late]
            self.variances[:] = before

    @property
    def windows(self) -> int:
        """How many count."""
        return int(np.count_nonzero(self.variances))

    @property
    def value(self) -> tuple[float, float]:
        """The delay and its standard deviation [s]."""
        return _together(self.delays, self.variances)

    @property
    def known(self) -> bool:
        """Whether the delay is known: by enough windows, some of them since the start, that agree."""
        return self.windows >= LEAST_WINDOWS and self.fresh >= LATE and self.value[1] < KNOWN_STD_S

    @property
    def share(self) -> float:
        """Of the windows that are needed at least."""
        return min(self.windows / LEAST_WINDOWS, 1.0)


def _together(delays: Array, variances: Array) -> tuple[float, float]:
    """Robust weighted mean of windows and its standard deviation [s], by what they differ by if that is more than they say."""
    some = variances > 0.0
    n = int(np.count_nonzero(some))
    if n == 0:
        return 0.0, FIRST_STD_S
    x, weights = delays[some], 1.0 / variances[some]
    order = np.argsort(x, kind="stable")
    middle = int(np.searchsorted(np.cumsum(weights[order]), 0.5 * weights.sum()))
    mean, scale, trust = float(x[order][middle]), 1.0, np.ones(n)
    for _ in range(5):
        off = np.abs(x - mean) * np.sqrt(weights) / scale
        trust = OUTLIER / np.maximum(off, OUTLIER)
        used = weights * trust
        mean = float((used * x).sum() / used.sum())
        if n > 1:
            free = AS_SAID + n - 1.0
            scale = math.sqrt(max((AS_SAID + float((used * (x - mean) ** 2).sum())) / free, 1.0))
    few = (AS_SAID + n - 1.0) / (AS_SAID + n - 3.0)  # Student's t: what few differ by is not known well
    variance = scale * scale * few / float((weights * trust).sum())
    known = 1.0 / (1.0 / variance + FIRST_STD_S**-2)
    return mean * known / variance, math.hypot(math.sqrt(known), LEAST_STD_S)


@dataclass
class Samples:
    """Samples of a window with its margins: times [s] since its beginning, and what was seen."""

    speed: list[tuple[float, float, float, float]] = field(default_factory=list)  # time, speed, resistance, inertia by m/s^2
    torque: list[tuple[float, float]] = field(default_factory=list)


class DelayEstimator:
    """Takes steps one by one; a window of them at a time tells of the delay.

    Parameters
    ----------
    rolling_nm
        Size of the torque that rolling takes [Nm].
    """

    def __init__(self, rolling_nm: float) -> None:
        self._rolling_nm = rolling_nm
        self.kept = KeptDelays()
        self._begin(0)

    def reset(self) -> None:
        """Forget all."""
        self.kept = KeptDelays()
        self._begin(0)

    def restart(self) -> None:
        """Time begins anew: what other windows told stays, and has to be confirmed."""
        self.kept.fresh = 0
        self._begin(0)

    def _begin(self, stamp_ns: int) -> None:
        self._origin_ns, self._seen_ns, self._torque_ns = stamp_ns, 0, 0
        self._samples = Samples()

    def take(
        self,
        stamp_ns: int,
        speed: float,
        resisting_nm: float,
        inertia: float,
        torque_ns: int,
        torque_nm: float,
        usable: bool = True,
    ) -> None:
        """Take in a speed and the last torque that was measured.

        Parameters
        ----------
        stamp_ns, speed
            Of the speed [ns] and [m/s].
        resisting_nm, inertia
            What driving takes after the model but for inertia [Nm], and torque of the inertia by m/s^2 [Nm s^2/m].
        torque_ns, torque_nm
            Stamp [ns] and measured torque [Nm].
        usable
            Whether speed and estimate may be trusted now; where not, all of the window is left out.
        """
        samples, origin = self._samples, self._origin_ns
        passed_ns = stamp_ns - self._seen_ns
        if not usable or not samples.speed or not 0 <= passed_ns <= LONGEST_GAP_S * SECOND_NS:
            self._begin(stamp_ns)
            samples, origin = self._samples, stamp_ns
            if not usable:
                return
        elif passed_ns < APART_NS:
            return
        self._seen_ns = stamp_ns
        now = (stamp_ns - origin) * NANOSECOND
        samples.speed.append((now, speed, resisting_nm, inertia))
        if torque_ns >= self._torque_ns + APART_NS and torque_ns > origin - SECOND_NS and math.isfinite(torque_nm):
            self._torque_ns = torque_ns
            samples.torque.append(((torque_ns - origin) * NANOSECOND, torque_nm))
        if now < SPAN_S + LONGEST_GAP_S:
            return
        found = window_delay(np.array(samples.speed), np.array(samples.torque).reshape(-1, 2), self._rolling_nm)
        if found:
            self.kept.see(*found)
        self._advance()

    def _advance(self) -> None:
        """The next window begins where this one ends."""
        self._origin_ns += round(WINDOW_S * SECOND_NS)
        self._samples = Samples(
            [(time - WINDOW_S, *rest) for time, *rest in self._samples.speed if time >= WINDOW_S - LONGEST_GAP_S],
            [(time - WINDOW_S, torque) for time, torque in self._samples.torque if time >= WINDOW_S - LONGEST_GAP_S],
        )


_TIMES = np.arange(round(SPAN_S / GRID_S) + 1) * GRID_S
_LAGS = np.arange(round(EARLIEST_S / GRID_S), round(LATEST_S / GRID_S) + 1)
_INNER = round((LATEST_S + MARGIN_S) / GRID_S) + np.arange(round(WINDOW_S / GRID_S))


def window_delay(speeds: Array, torques: Array, rolling_nm: float) -> tuple[float, float] | None:
    """The delay that the samples of one window tell of, and its variance.

    Parameters
    ----------
    speeds
        Time [s], speed [m/s], resistance [Nm] and inertia by m/s^2 [Nm s^2/m]; shape (samples, 4).
    torques
        Time [s] and measured torque [Nm]; shape (samples, 2).
    rolling_nm
        Size of the torque that rolling takes [Nm]: while it brakes with less, friction brakes may be at work.

    Returns
    -------
    tuple or None
        Delay [s] and variance [s^2]; None where nothing tells of it.

    Notes
    -----
    With all series smoothed alike, measured = gain * expected(t - delay) + a + b t + c speed: level, warming and a resistance that
    grows by another slope with the speed are no delay. The delay is where the sum of squares that `expected` explains beside them
    is largest, between points of the grid by a parabola, and its curvature there says how sharply that is known.
    """
    if len(speeds) < 8 or len(torques) < 8:
        return None
    (kept_speed, spacing), (kept_torque, torque_spacing) = (_near(series[:, 0]) for series in (speeds, torques))
    smooth = min(max(SMOOTH_S, SMOOTH_SPACINGS * max(spacing, torque_spacing)), MARGIN_S / REACH)
    speed, resisting, inertia = (np.interp(_TIMES, speeds[:, 0], speeds[:, i]) for i in (1, 2, 3))
    torque = np.interp(_TIMES, torques[:, 0], torques[:, 1])
    usable = kept_speed & (np.abs(speed) > SLOWEST_MPS)
    mean, slope = _kernels(smooth)
    accel = np.convolve(speed, slope, "same")
    expected = np.convolve(resisting, mean, "same") + inertia * accel
    measured, smooth_speed = np.convolve(torque, mean, "same"), np.convolve(speed, mean, "same")
    ahead = np.sign(speed)
    brakes = (accel * ahead < BRAKING_MPS2) & (measured * ahead <= AGAINST_SHARE * rolling_nm)
    there, reach = _clear(kept_torque, REACH * smooth), REACH * smooth
    series = np.stack([expected, measured, smooth_speed])
    # Where the torque follows what braking takes too, no friction brakes are at work; else braking is left out.
    found = _fitted(series, there & _reached(_clear(usable, reach)), smooth, rolling_nm, LEAST_EXPLAINED_BRAKING)
    if found is None and brakes.any():
        usable &= _clear(~brakes, BESIDE_BRAKES_S)
        found = _fitted(series, there & _reached(_clear(usable, reach)), smooth, rolling_nm, LEAST_EXPLAINED)
    return found


def _kernels(smooth: float) -> tuple[Array, Array]:
    """A mean over a standard deviation [s], and a slope of it, by the grid."""
    times = np.arange(-round(REACH * smooth / GRID_S), round(REACH * smooth / GRID_S) + 1) * GRID_S
    mean = np.exp(-0.5 * (times / smooth) ** 2)
    mean /= mean.sum()
    slope = -times * mean
    return mean, slope / -(slope * times).sum()


def _fitted(
    series: Array, usable: Mask, smooth: float, rolling_nm: float, least_explained: float
) -> tuple[float, float] | None:
    """Delay and variance by the points of the grid that are usable; see `window_delay`."""
    expected, measured, speed = series
    inner = _INNER[usable[_INNER]]
    if len(inner) < LEAST_SHARE * WINDOW_S / GRID_S:
        return None
    base = np.linalg.qr(np.column_stack([np.ones(len(inner)), inner - inner.mean()]))[0]
    by_lag = np.vstack([expected[inner[None, :] - _LAGS[:, None]], speed[inner], measured[inner]])
    by_lag -= (by_lag @ base) @ base.T
    (over_speed, left), by_lag = by_lag[-2:], by_lag[:-2]
    alike = 2.0 * math.sqrt(math.pi) * smooth / GRID_S  # points of the grid that tell as much as one, so smoothed
    free = max(len(inner) - FITTED * alike, alike)
    products = (by_lag**2).sum(axis=1), by_lag @ over_speed, float(over_speed @ over_speed), by_lag @ left, float(over_speed @ left)
    whole, tied = float(left @ left), (0.0, 0.0)
    for _ in range(2):  # the size of the noise, by which the priors count, is that of a fit without them
        unexplained, gains, slopes = _by_delay(*products, *tied)
        best = int(np.argmin(unexplained))
        noise = (whole + float(unexplained[best])) / free
        tied = noise * alike / GAIN_STD**2, noise * alike / (SPEED_SHARE * rolling_nm) ** 2
    if not 0 < best < len(_LAGS) - 1 or not GAINS[0] < gains[best] < GAINS[1]:
        return None
    residual = left - gains[best] * by_lag[best] - slopes[best] * over_speed
    before, at_best, after = unexplained[best - 1 : best + 2].tolist()
    bend = before + after - 2.0 * at_best
    if bend <= 0.0 or float(residual @ residual) > (1.0 - least_explained) * whole:
        return None
    delay = (_LAGS[best] + 0.5 * (before - after) / bend) * GRID_S
    moved = gains[best] * (by_lag[best + 1] - by_lag[best - 1]) / (2.0 * GRID_S)  # by a delay that is one second shorter
    fitted = np.stack([by_lag[best], over_speed])
    alone = moved - np.linalg.solve(fitted @ fitted.T + np.diag(tied), fitted @ moved) @ fitted
    spread = np.zeros((2, len(expected)))  # nothing between the usable points
    spread[:, inner] = alone, residual
    variance = float(residual @ residual) / free * _alike(*spread) / max(float(moved @ alone), 1e-300)
    return (float(delay), variance) if variance < WORST_STD_S**2 else None


def _by_delay(
    uu: Array, uv: Array, vv: float, um: Array, vm: float, of_gain: float, of_slope: float
) -> tuple[Array, Array, Array]:
    """Least squares of measured = gain * u + slope * v for each delay, by their products, with a gain near 1 and a slope near 0.

    Returns the sum of squares that is left less that of the measured, the gain and the slope, each shape (delays,).
    """
    first, second, third = uu + of_gain, uv, vv + of_slope
    determinant = np.maximum(first * third - second**2, 1e-12 * uu * vv + 1e-300)
    right = um + of_gain
    gains, slopes = (third * right - second * vm) / determinant, (first * vm - second * right) / determinant
    return of_gain - gains * right - slopes * vm, gains, slopes


def _alike(slope: Array, noise: Array) -> float:
    """How many times as far as white noise of its size the noise moves what a slope is fitted by.

    What noise of the speed makes of an acceleration goes to and fro, and moves the delay much less than other noise would.
    """
    reach = round(ALIKE_S / GRID_S)
    of_slope, of_noise = (np.correlate(np.pad(one, reach), one, "valid")[reach:] for one in (slope, noise))
    weights = 1.0 - np.arange(reach + 1) / (reach + 1.0)
    weights[1:] *= 2.0
    return max(float((weights * of_slope * of_noise).sum()) / max(float(of_slope[0] * of_noise[0]), 1e-300), LEAST_ALIKE)


def _near(times: Array) -> tuple[Mask, float]:
    """Where the grid lies in no gap of the samples, shape of `_TIMES`; the typical spacing of the samples [s]."""
    spacing = np.diff(times)
    typical = float(np.median(spacing))
    longest = min(max(GAP_SPACINGS * typical, LEAST_GAP_S), LONGEST_GAP_S)
    after = np.searchsorted(times, _TIMES, side="right")
    inside = (after > 0) & (after < len(times))
    near = np.zeros(len(_TIMES), dtype=bool)
    near[inside] = spacing[after[inside] - 1] <= longest
    return near, typical


def _reached(good: Mask) -> Mask:
    """Where all points are good that any delay looks at; only of `_INNER`."""
    bad = np.concatenate([[0], np.cumsum(~good)])
    found = np.zeros(len(good), dtype=bool)
    found[_INNER] = bad[_INNER - _LAGS[0] + 1] == bad[_INNER - _LAGS[-1]]
    return found


def _clear(good: Mask, reach_s: float) -> Mask:
    """Where all within a reach is good; beyond the ends all is."""
    reach = round(reach_s / GRID_S)
    bad = np.concatenate([[0], np.cumsum(~good)])
    at = np.arange(len(good))
    return np.asarray(bad[np.minimum(at + reach + 1, len(good))] == bad[np.maximum(at - reach, 0)])
