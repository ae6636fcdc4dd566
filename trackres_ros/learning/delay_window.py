# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds the delay of the torque behind the speed in one window of samples [s], and its quality.

References
----------
C. H. Knapp, G. C. Carter, The generalized correlation method for estimation of time delay, IEEE Trans. Acoust. Speech Signal
Process. 24 (1976) 320-327.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from trackres_ros.learning.gate import AGAINST_SHARE, BRAKING_MPS2, SLOWEST_MPS

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

EARLIEST_S, LATEST_S = -0.5, 1.0  # delays that are searched: a delay up to 0.5 s needs both flanks of its peak
GRID_S = 0.05
WINDOW_S = 20.0
SMOOTH_S = 0.3  # least standard deviation of the kernel: an acceleration in less time is mostly noise of the speed
SMOOTH_SPACINGS = 0.7  # least standard deviation over the time between two samples: what lies between them is not known
REACH = 3.0  # of the kernel, in standard deviations
SLOWEST_RATE_HZ = 1.0
MARGIN_S = REACH * SMOOTH_SPACINGS / SLOWEST_RATE_HZ
SPAN_S = LATEST_S - EARLIEST_S + WINDOW_S + 2.0 * MARGIN_S
LONGEST_GAP_S = 2.5  # at 1 Hz one sample may be missing
GAP_SPACINGS, LEAST_GAP_S = 3.5, 0.5  # a longer pause than this, over the typical spacing and at least, is a gap
LEAST_SAMPLES = 8
BESIDE_BRAKES_S = 1.0  # left out on either side of braking: the torque may be so late
LEAST_SHARE = 0.25  # of a window that must be usable
LEAST_EXPLAINED, LEAST_EXPLAINED_BRAKING = 0.6, 0.9  # of the expected changes: else something other drives or brakes
GAINS = (0.6, 1.5)  # expected over measured changes: beyond, the torque is not the one that moves this vehicle
GAIN_STD = 0.1  # assumed: what load, mass and torque sensor leave open
SPEED_SHARE = 0.02  # assumed: of the rolling torque, by which a resistance may change with a m/s other than the model says
ALIKE_S = 1.5  # points of a window further apart than this are independent
LEAST_ALIKE = 0.1  # assumed: no noise alternates so well that it counts for less than a tenth of white noise
FITTED = 5.0  # values of a window: level, trend, resistance over speed, gain, delay
ROUNDING = 1e-9
WORST_STD_S = 0.1  # a window that is less sure has no excitation

_TIMES = np.arange(round(SPAN_S / GRID_S) + 1) * GRID_S
_DELAYS = np.arange(round(EARLIEST_S / GRID_S), round(LATEST_S / GRID_S) + 1)
_INNER = round((MARGIN_S - EARLIEST_S) / GRID_S) + np.arange(round(WINDOW_S / GRID_S))


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
    All series are smoothed alike. Then expected(t) = gain * measured(t + delay) + a + b t + c speed(t): level, warming and a
    resistance that grows otherwise with the speed are no delay. Gain and c have priors, as an acceleration that decays
    exponentially looks the same with another gain as with another delay. The expected torque is on the left as its noise, out of
    the differentiated speed, is the larger one. The sum of squares is smallest at the delay, between points of the grid by a
    parabola.
    """
    if min(len(speeds), len(torques)) < LEAST_SAMPLES:
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
    reach = REACH * smooth
    there = _reached(_clear(kept_torque, reach))
    series = np.stack([expected, measured, smooth_speed])
    # Where the torque follows what braking takes too, no friction brakes are at work; else braking is left out.
    least = LEAST_EXPLAINED_BRAKING if brakes.any() else LEAST_EXPLAINED
    found = _fitted(series, there & _clear(usable, reach), smooth, rolling_nm, least)
    if found is None and brakes.any():
        usable &= _clear(~brakes, BESIDE_BRAKES_S)
        found = _fitted(series, there & _clear(usable, reach), smooth, rolling_nm, LEAST_EXPLAINED)
    return found


def _kernels(smooth: float) -> tuple[Array, Array]:
    """A mean over a standard deviation [s], and a slope of it, by the grid."""
    times = np.arange(-round(REACH * smooth / GRID_S), round(REACH * smooth / GRID_S) + 1) * GRID_S
    mean = np.exp(-0.5 * (times / smooth) ** 2)
    mean /= mean.sum()
    slope = -times * mean
    return mean, slope / -(slope * times).sum()


def _fitted(series: Array, usable: Mask, smooth: float, rolling_nm: float, least_explained: float) -> tuple[float, float] | None:
    """Delay and variance by the points of the grid that are usable; see `window_delay`."""
    expected, measured, speed = series
    inner = _INNER[usable[_INNER]]
    if len(inner) < LEAST_SHARE * WINDOW_S / GRID_S:
        return None
    base = np.linalg.qr(np.column_stack([np.ones(len(inner)), inner - inner.mean()]))[0]
    by_delay = np.vstack([measured[inner[None, :] + _DELAYS[:, None]], speed[inner], expected[inner]])
    by_delay -= (by_delay @ base) @ base.T
    (over_speed, left), by_delay = by_delay[-2:], by_delay[:-2]
    alike = 2.0 * math.sqrt(math.pi) * smooth / GRID_S  # points of the grid that tell as much as one, so smoothed
    free = max(len(inner) - FITTED * alike, alike)
    products = (
        (by_delay**2).sum(axis=1),
        by_delay @ over_speed,
        float(over_speed @ over_speed),
        by_delay @ left,
        float(over_speed @ left),
    )
    whole, tied = float(left @ left), (0.0, 0.0)
    for _ in range(2):  # a fit without priors tells the noise, by which the priors count
        unexplained, gains, slopes = _least_squares(*products, *tied)
        best = int(np.argmin(unexplained))
        noise = max(whole + float(unexplained[best]), ROUNDING * whole) / free
        tied = noise * alike / GAIN_STD**2, noise * alike / (SPEED_SHARE * rolling_nm) ** 2
    if not 0 < best < len(_DELAYS) - 1 or not GAINS[0] < gains[best] < GAINS[1]:
        return None
    residual = left - gains[best] * by_delay[best] - slopes[best] * over_speed
    before, at_best, after = unexplained[best - 1 : best + 2].tolist()
    bend = before + after - 2.0 * at_best
    if bend <= 0.0 or float(residual @ residual) > (1.0 - least_explained) * whole:
        return None
    delay = (_DELAYS[best] + 0.5 * (before - after) / bend) * GRID_S
    moved = gains[best] * (by_delay[best + 1] - by_delay[best - 1]) / (2.0 * GRID_S)  # by a delay that is a second longer
    fitted = np.stack([by_delay[best], over_speed])
    alone = moved - np.linalg.solve(fitted @ fitted.T + np.diag(tied), fitted @ moved) @ fitted
    spread = np.zeros((2, len(expected)))  # nothing between the usable points
    spread[:, inner] = alone, residual
    variance = float(residual @ residual) / free * _alike(*spread) / max(float(moved @ alone), 1e-300)
    return (float(delay), variance) if variance < WORST_STD_S**2 else None


def _least_squares(
    uu: Array, uv: Array, vv: float, um: Array, vm: float, of_gain: float, of_slope: float
) -> tuple[Array, Array, Array]:
    """Fit m = gain * u + slope * v for each delay out of the products of u, v and m, with ties to a gain of 1 and a slope of 0.

    Returns the sum of squares less that of m, gain and slope, each of shape (delays,).
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
    found[_INNER] = bad[_INNER + _DELAYS[-1] + 1] == bad[_INNER + _DELAYS[0]]
    return found


def _clear(good: Mask, reach_s: float) -> Mask:
    """Where all within a reach is good; beyond the ends all is."""
    reach = round(reach_s / GRID_S)
    bad = np.concatenate([[0], np.cumsum(~good)])
    at = np.arange(len(good))
    return np.asarray(bad[np.minimum(at + reach + 1, len(good))] == bad[np.maximum(at - reach, 0)])
