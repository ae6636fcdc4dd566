# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Resamples one series to the steps of a session: as means, held, extrapolated, or at the middle of a step."""

from __future__ import annotations

import numpy as np

from trackres_ros.diagnosis.prepare.session import Array, Cumulative, Mask
from trackres_ros.diagnosis.prepare.settings import pace
from trackres_ros.recording.samples import Series

LONGEST_HOLD_S = 2.0  # for channels that change while driving, over a gap
TEMPERATURE_HOLD_S = (10.0, 120.0)  # least and most: a belt changes by some kelvin within minutes
SLOWEST_SPACING = 3.0  # usual spacings without a sample: a gap, for receivers at one sample in a second or in five


def ordered(series: Series, start: int) -> tuple[Array, Array]:
    """Times [s] and finite values, by stamp; of equal stamps the first."""
    finite = np.isfinite(series.value)
    at, index = np.unique(series.stamp_ns[finite], return_index=True)
    return np.asarray((at - start) * 1e-9, dtype=float), series.value[finite][index]


def means(at: Array, value: Array, edges: Array) -> tuple[Array, Mask]:
    """Mean over each step, along straight lines between samples; and the steps without too long a gap."""
    middle = middles(edges)
    after = np.clip(np.searchsorted(at, middle), 1, len(at) - 1)
    step = edges[1] - edges[0]
    known = (at[after] - at[after - 1] <= LONGEST_HOLD_S * pace(step)) & (middle <= at[-1]) & (middle >= at[0])
    return Cumulative.of(at, value).means(edges[:-1], step), known


def held(at: Array, value: Array, edges: Array, default: float) -> Array:
    """The last value before the middle of each step; before the first sample, the first value."""
    if not len(at):
        return np.full(len(edges) - 1, default)
    return value[np.maximum(np.searchsorted(at, middles(edges), side="right") - 1, 0)]


def held_while_sent(at: Array, value: Array, edges: Array) -> Array:
    """The same for a temperature; nan where the sensor is silent for longer than usual: then it has failed, or was not there."""
    if not len(at):
        return np.full(len(edges) - 1, np.nan)
    usual = float(np.percentile(np.diff(at), 90.0)) if len(at) > 1 else 0.0  # of a sensor that sends changes, a long one
    last = np.maximum(np.searchsorted(at, middles(edges), side="right") - 1, 0)
    silent = np.abs(middles(edges) - at[last]) > np.clip(SLOWEST_SPACING * usual, *TEMPERATURE_HOLD_S)
    return np.where(silent, np.nan, value[last])


def carried(at: Array, value: Array, edges: Array) -> Array:
    """The last value before the middle of each step; nan before the first."""
    return np.concatenate(([np.nan], value))[np.searchsorted(at, middles(edges), side="right")]


def read_off(at: Array, value: Array, edges: Array, angle: bool = False) -> Array:
    """The value at the middle of each step, along straight lines between samples; nan in gaps.

    An `angle` wraps at pi: the line then takes the short way, and the result is wrapped again.
    """
    if len(at) < 2:
        return np.full(len(edges) - 1, np.nan)
    middle = middles(edges)
    found = np.interp(middle, at, np.unwrap(value) if angle else value)
    after = np.clip(np.searchsorted(at, middle), 1, len(at) - 1)
    longest = max(LONGEST_HOLD_S, SLOWEST_SPACING * float(np.median(np.diff(at))))
    step = edges[1] - edges[0]
    found[(at[after] - at[after - 1] > longest) | (middle < at[0] - step) | (middle > at[-1] + step)] = np.nan
    return np.asarray((found + np.pi) % (2.0 * np.pi) - np.pi) if angle else found


def any_from(at: Array, value: Array, edges: Array, least: float) -> Mask:
    """Steps in which, or at an edge of which, a value of at least `least` was sampled or is held from the sample before."""
    high = np.concatenate(([0], np.cumsum(value >= least)))
    first = np.maximum(np.searchsorted(at, edges[:-1], side="right") - 1, 0)  # sample held at the start of the step
    behind = np.searchsorted(at, edges[1:], side="right")
    return np.asarray(high[np.maximum(behind, first)] > high[first])


def middles(edges: Array) -> Array:
    """Times of the middles of steps."""
    return np.asarray(0.5 * (edges[1:] + edges[:-1]))
