# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Samples of one series: its gaps, and its resampling to the steps of a session."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.prepare.session import Array, Cumulative, Mask, pace
from trackres_ros.diagnosis.prepare.speed_smoothing import resolution
from trackres_ros.kernels.marks import entry
from trackres_ros.recording.samples import Series

Samples = tuple[Array, Array]
Indices = NDArray[np.intp]

FILLED_BY_LINES, REPEATED = "gap filled by straight lines", "last value repeated"
FEWEST_FILLED, SHORTEST_FILLED_S = 5, 3.0
EXACT = 1e-6  # of the largest values: the resolution of six digits
LEAST_RISE = 20.0  # times the resolution: a line with a smaller rise may be constant
UNUSUAL = 20.0
"""Multiple of the usual length of a straight run, from which one series alone shows a filled gap. Real drives reach 10: a car,
a bus and four robots, 16 h in all. Their speeds were as recorded and rounded to 0.1 and 1 km/h, torques to 1, 10 and 50 Nm.
"""
LONGEST_UNKNOWN_S, UNUSUAL_SPACING = 5.0, 10.0  # of a slope, and times its usual spacing
FEWEST_FOR_SPACING = 100


def filled_steps(speed: Samples, torques: Sequence[Samples], edges: Array, slowest_mps: float) -> dict[str, Mask]:
    """Steps with a filled-in speed or torque, by reason; `edges` of the steps [s] have the shape (n + 1,).

    A line filled a gap where speed and torque are both straight within their resolution, or one is straight far longer than
    usual. A last value was repeated where both stay constant far longer than usual, above the speed `slowest_mps`
    [m/s].
    """
    of_speed, *of_torques = (_straight_steps(samples, edges) for samples in (speed, *torques))
    any_torque, long_torque = (np.any(masks, axis=0) for masks in zip(*of_torques, strict=True))
    is_moving = np.abs(np.interp(edges[:-1], *speed)) > slowest_mps
    constant_steps = [_constant(samples, edges) for samples in (speed, *torques)]
    return {
        FILLED_BY_LINES: (of_speed[0] & any_torque) | of_speed[1] | long_torque,
        REPEATED: np.all(constant_steps, axis=0) & is_moving,
    }


def _straight_steps(samples: Samples, edges: Array) -> tuple[Mask, Mask]:
    """Steps in which a series is a rising or falling straight line, and those in which it is so far longer than usual."""
    times, value = samples
    largest_error = EXACT * max(float(np.percentile(np.abs(value), 99.0)), 1e-12)
    tolerance = max(resolution(value) * (1.0 + EXACT), largest_error)
    masks = [np.zeros(len(edges) - 1, dtype=bool) for _ in range(2)]
    forward, last = _straight_runs(times, value, tolerance), len(times) - 1
    run_begins, ends = _straight_runs(
        -times[::-1], value[::-1].copy(), tolerance
    )  # a run that began before a gap includes a part of its line
    for first_rows, end in (forward, (last - ends, last - run_begins)):
        count, rise = end - first_rows, np.abs(value[end] - value[first_rows])
        is_filled = (
            (count >= FEWEST_FILLED) & (times[end] - times[first_rows] >= SHORTEST_FILLED_S) & (rise > LEAST_RISE * tolerance)
        )
        for mask, rows in zip(masks, (is_filled, is_filled & (count >= UNUSUAL * _usual_count(count[rise > 0.0]))), strict=True):
            mask |= _steps_within(times[first_rows[rows]], times[end[rows]], edges)
    return masks[0], masks[1]


def _constant(samples: Samples, edges: Array) -> Mask:
    """Steps in which a series stays constant far longer than usual."""
    times, value = samples
    first_rows = np.flatnonzero(np.diff(value, prepend=np.nan) != 0.0)
    last = np.append(first_rows[1:], len(value)) - 1
    count = last - first_rows
    is_long = (count >= max(FEWEST_FILLED, UNUSUAL * _usual_count(count + 1))) & (
        times[last] - times[first_rows] >= SHORTEST_FILLED_S
    )
    return _steps_within(times[first_rows[is_long]], times[last[is_long]], edges)


def _usual_count(counts: Indices) -> float:
    """Weighted median run length: half of the samples are in runs up to it."""
    if not len(counts):
        return np.inf
    counts = np.sort(counts)
    count_sums = np.cumsum(counts)
    return float(counts[np.searchsorted(count_sums, 0.5 * count_sums[-1])])


def _straight_runs(times: Array, value: Array, tolerance: float) -> tuple[Indices, Indices]:
    """First and last samples of straight runs; each run begins at the end of the previous one."""
    corners = np.zeros(len(times), dtype=bool)
    mark_corners(times, value, tolerance, corners)
    first_rows = np.flatnonzero(corners)
    return first_rows, np.append(first_rows[1:], len(times) - 1)


@entry
def mark_corners(times: Array, value: Array, tolerance: float, corners: Mask) -> None:
    """Mark the starts of straight runs: a line from the first sample passes all others of a run within a tolerance."""
    i = 0
    while i < len(times) - 1:
        corners[i] = True
        low, high, k = -np.inf, np.inf, i + 1
        while k < len(times):
            low = max(low, (value[k] - tolerance - value[i]) / (times[k] - times[i]))
            high = min(high, (value[k] + tolerance - value[i]) / (times[k] - times[i]))
            if low > high:
                break
            k += 1
        i = k - 1


def steps_without_value(times: Array, edges: Array) -> Mask:
    """Steps in a gap that is long relative to the usual spacing, or that far before or after the series."""
    if len(times) < FEWEST_FOR_SPACING:
        return np.zeros(len(edges) - 1, dtype=bool)
    longest_s = max(LONGEST_UNKNOWN_S, UNUSUAL_SPACING * float(np.median(np.diff(times))))
    bounds = np.concatenate(([edges[0] - 0.5 * longest_s], times, [edges[-1] + 0.5 * longest_s]))
    gaps = np.flatnonzero(np.diff(bounds) > longest_s)
    return _steps_within(bounds[gaps], bounds[gaps + 1], edges)


def _steps_within(begin_times: Array, end_times: Array, edges: Array) -> Mask:
    """Steps that overlap one of some spans."""
    is_inside = np.zeros(len(edges) - 1, dtype=bool)
    for begin, end in zip(begin_times, end_times, strict=True):
        is_inside |= (edges[:-1] < end) & (edges[1:] > begin)
    return is_inside


LONGEST_HOLD_S = 2.0  # for channels that change while driving, over a gap
TEMPERATURE_HOLD_S = (10.0, 120.0)  # least and most: a belt changes by some kelvin within minutes
SLOWEST_SPACING = 3.0  # usual spacings without a sample: a gap, for receivers at one sample in a second or in five


def sort_samples(series: Series, start: int) -> tuple[Array, Array]:
    """Times [s] and finite values, by stamp; of equal stamps the first."""
    is_finite = np.isfinite(series.value)
    stamps, index = np.unique(series.stamp_ns[is_finite], return_index=True)
    return np.asarray((stamps - start) * 1e-9, dtype=float), series.value[is_finite][index]


def means(times: Array, value: Array, edges: Array) -> tuple[Array, Mask]:
    """Mean over each step, along straight lines between samples; and the steps without too long a gap."""
    middle = middles(edges)
    next_index = np.clip(np.searchsorted(times, middle), 1, len(times) - 1)
    step = edges[1] - edges[0]
    is_known = (
        (times[next_index] - times[next_index - 1] <= LONGEST_HOLD_S * pace(step)) & (middle <= times[-1]) & (middle >= times[0])
    )
    return Cumulative.of(times, value).means(edges[:-1], step), is_known


def hold_value(times: Array, value: Array, edges: Array, default: float) -> Array:
    """The last value before the middle of each step; before the first sample, the first value."""
    if not len(times):
        return np.full(len(edges) - 1, default)
    return value[np.maximum(np.searchsorted(times, middles(edges), side="right") - 1, 0)]


def held_while_sent(times: Array, value: Array, edges: Array) -> Array:
    """The same for a temperature; nan where the sensor is silent for longer than usual: then it has failed, or was not there."""
    if not len(times):
        return np.full(len(edges) - 1, np.nan)
    usual_spacing = (
        float(np.percentile(np.diff(times), 90.0)) if len(times) > 1 else 0.0
    )  # of a sensor that sends changes, a long one
    last = np.maximum(np.searchsorted(times, middles(edges), side="right") - 1, 0)
    is_silent = np.abs(middles(edges) - times[last]) > np.clip(SLOWEST_SPACING * usual_spacing, *TEMPERATURE_HOLD_S)
    return np.where(is_silent, np.nan, value[last])


def carry_value(times: Array, value: Array, edges: Array) -> Array:
    """The last value before the middle of each step; nan before the first."""
    return np.concatenate(([np.nan], value))[np.searchsorted(times, middles(edges), side="right")]


def read_off(times: Array, value: Array, edges: Array, angle: bool = False) -> Array:
    """The value at the middle of each step, along straight lines between samples; nan in gaps.

    An `angle` wraps at pi: the line then takes the short way, and the result is wrapped again.
    """
    if len(times) < 2:
        return np.full(len(edges) - 1, np.nan)
    middle = middles(edges)
    readings = np.interp(middle, times, np.unwrap(value) if angle else value)
    next_index = np.clip(np.searchsorted(times, middle), 1, len(times) - 1)
    longest_s = max(LONGEST_HOLD_S, SLOWEST_SPACING * float(np.median(np.diff(times))))
    step = edges[1] - edges[0]
    readings[
        (times[next_index] - times[next_index - 1] > longest_s) | (middle < times[0] - step) | (middle > times[-1] + step)
    ] = np.nan
    return np.asarray((readings + np.pi) % (2.0 * np.pi) - np.pi) if angle else readings


def any_from(times: Array, value: Array, edges: Array, threshold: float) -> Mask:
    """Steps in which, or at an edge of which, a value of at least `threshold` was sampled or is held from the sample before."""
    counts_above = np.concatenate(([0], np.cumsum(value >= threshold)))
    first_rows = np.maximum(np.searchsorted(times, edges[:-1], side="right") - 1, 0)  # sample held at the start of the step
    last = np.searchsorted(times, edges[1:], side="right")
    return np.asarray(counts_above[np.maximum(last, first_rows)] > counts_above[first_rows])


def middles(edges: Array) -> Array:
    """Times of the middles of steps."""
    return np.asarray(0.5 * (edges[1:] + edges[:-1]))
