# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds defects in the samples of one role: stamps, gaps, quantisation, stuck sensors and dropouts."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from trackres_ros.recording.roles import ROLES, base_role
from trackres_ros.recording.samples import Finding, FloatArray, IntArray, Series, set_stamps
from trackres_ros.text import figures, number_of

MOVING_MPS, DROP_SAMPLES = 0.5, 3
"""A short drop to 0 is a dropout where the samples on both sides are faster [m/s]; assumed: above the noise of a
standing wheel, and shorter than any stop, even where each sample is published twice or thrice."""
OFFSET_NS = 500_000_000
"""Header stamps this far from log time are another clock, not a delay [ns]; assumed, above any transport delay."""
GAP_NS = 1_000_000_000
GAP_FACTOR = 10
"""A gap is longer than both a second and ten median steps; assumed: it affects a belt's temperature."""
STUCK_NS = 60_000_000_000
"""A changing quantity does not keep one value this long [ns]; assumed."""
SAME_LEVEL = 1e-6
"""Levels closer than this share of the largest are one, but for rounding, of float32 too."""
GRID_TOLERANCE = 1e-3
"""How far a step may be from a whole number of quanta [quanta]; float32 in km/h needs 1e-5."""


def findings_of(role: str, samples: Series, start: tuple[int, int], zero_is_unset: bool) -> list[Finding]:
    """Find the defects of one role: kinds ``empty``, ``non_finite``, ``zero_stamp``, ``duplicate_stamp``, ``backward_stamp``,
    ``stamp_jump``, ``stamp_offset``, ``gap``, ``quantised``, ``stuck``, ``dropout``.

    `role`: the unit and the normal range depend on it; `samples`: in log order; `start`: stamp and arrival [ns] of
    the first valid speed; `zero_is_unset`: whether stamp 0 means "never set".
    """
    unit, lively = ROLES[base_role(role)].unit, ROLES[base_role(role)].lively
    finite = np.isfinite(samples.value)
    if not finite.any():
        text = "no sample at all" if not len(samples) else f"none of {len(samples)} values is finite"
        return [Finding(role, "empty", len(samples), float("nan"), text)]
    found: list[Finding] = []

    def note(kind: str, at: NDArray[np.intp], text: str) -> None:
        if at.size:
            of_log = zero_is_unset and not samples.stamp_ns[at[0]]
            clock = samples.arrival_ns if of_log else samples.stamp_ns
            found.append(Finding(role, kind, int(at.size), (int(clock[at[0]]) - start[of_log]) / 1e9, text))

    bad = np.flatnonzero(~finite)
    note("non_finite", bad, f"{number_of(bad.size, 'value is', 'values are')} not finite")
    unset = np.flatnonzero(samples.stamp_ns == 0) if zero_is_unset else bad[:0]
    note("zero_stamp", unset, f"{number_of(unset.size, 'stamp is', 'stamps are')} zero (never set)")
    _look_at_stamps(samples, np.flatnonzero(samples.stamp_ns != 0) if zero_is_unset else np.arange(len(samples)), note)
    value = samples.value[finite]
    runs = np.flatnonzero(np.concatenate(([True], value[1:] != value[:-1])))
    step = _quantum(value, runs)
    if step:
        repeats = 1.0 - len(runs) / len(value)
        text = f"values are quantised in steps of {_step_text(step, unit)}; {repeats:.0%} repeat the previous one"
        note("quantised", np.flatnonzero(finite)[:1], text)
    if lively:
        _look_for_stuck(samples, np.flatnonzero(finite), runs, set_stamps(samples) if zero_is_unset else samples.stamp_ns, note)
    if base_role(role) == "speed":
        _look_for_drops(samples, note)
    return found


class _Note(Protocol):
    def __call__(self, kind: str, at: NDArray[np.intp], text: str) -> None: ...


def _look_at_stamps(samples: Series, rows: NDArray[np.intp], note: _Note) -> None:
    """Note duplicate and backward stamps, gaps, jumps ahead of log time, and an offset from it; `rows` are those whose stamp was
    set.
    """
    if not rows.size:
        return
    stamp = samples.stamp_ns[rows]
    step = np.diff(stamp)
    same, back = np.flatnonzero(step == 0), np.flatnonzero(step < 0)
    note("duplicate_stamp", rows[same + 1], f"{number_of(same.size, 'stamp equals', 'stamps equal')} the previous one")
    if back.size:
        earlier, most = number_of(back.size, "stamp is", "stamps are"), _span(int(-step[back].min()))
        text = f"{earlier} earlier than the previous one, by up to {most}"
        note("backward_stamp", rows[back + 1], text)
    offset = int(np.median(stamp - samples.arrival_ns[rows]))
    if abs(offset) > OFFSET_NS:
        side = "before" if offset < 0 else "after"
        note("stamp_offset", rows, f"header stamps are {_span(abs(offset))} {side} log time (median)")
    forward = step[step > 0]
    if forward.size:
        limit = max(GAP_NS, GAP_FACTOR * int(np.median(forward)))
        waited = np.diff(samples.arrival_ns[rows])
        ahead = step - waited
        jumps = np.flatnonzero((step > limit) & (ahead > limit))
        if jumps.size:
            jumping, most = number_of(jumps.size, "stamp jumps", "stamps jump"), _span(int(ahead[jumps].max()))
            note("stamp_jump", rows[jumps], f"{jumping} ahead of log time, by up to {most}")
        paused = np.where(ahead > limit, waited, step)
        gaps = np.flatnonzero((step > limit) & (paused > limit))
        if gaps.size:
            text = f"{number_of(gaps.size, 'gap')} longer than {_span(limit)}, the longest {_span(int(paused[gaps].max()))}"
            note("gap", rows[gaps], text)


def _look_for_stuck(samples: Series, rows: NDArray[np.intp], runs: NDArray[np.intp], stamp_ns: IntArray, note: _Note) -> None:
    """Note runs of one non-zero value that last longer than `STUCK_NS`; `runs` are their starts among `rows`."""
    last = np.append(runs[1:], len(rows)) - 1
    lasting = stamp_ns[rows[last]] - stamp_ns[rows[runs]]
    stuck = (lasting > STUCK_NS) & (samples.value[rows[runs]] != 0.0)
    if stuck.any():
        at = np.flatnonzero(np.repeat(stuck, last - runs + 1))
        longest = _span(int(lasting[stuck].max()))
        text = f"{number_of(int(stuck.sum()), 'period')} with one non-zero value for more than 60 s, at most {longest}"
        note("stuck", rows[at], text)


def _look_for_drops(samples: Series, note: _Note) -> None:
    """Note where speed is exactly 0 for a sample or a few, and moving right before and after."""
    zero = np.concatenate(([False], samples.value == 0.0, [False]))
    start, stop = np.flatnonzero(zero[1:] & ~zero[:-1]), np.flatnonzero(zero[:-1] & ~zero[1:])
    inside = (start > 0) & (stop < len(samples)) & (stop - start <= DROP_SAMPLES)
    start, stop = start[inside], stop[inside]
    moving = (np.abs(samples.value[start - 1]) > MOVING_MPS) & (np.abs(samples.value[stop]) > MOVING_MPS)
    at = start[moving]
    note("dropout", at, f"{number_of(at.size, 'dropout')} to exactly 0 for {DROP_SAMPLES} samples or fewer while moving")


def _quantum(value: FloatArray, runs: NDArray[np.intp]) -> float:
    """Return the step a sensor quantises to, or 0.

    All values are on one grid, and either most values last for several samples or the same few recur;
    a steady ramp of a computed profile does neither.
    """
    levels = np.unique(value)
    if len(levels) < 3 or len(value) < 20:
        return 0.0
    steps = np.diff(levels)
    steps = steps[steps > SAME_LEVEL * np.abs(levels).max()]
    if len(steps) < 2:
        return 0.0
    step = float(steps.min())
    ratio = steps / step
    if float(np.abs(ratio - np.rint(ratio)).max()) > GRID_TOLERANCE:
        return 0.0
    lasting = float(np.median(np.diff(np.append(runs, len(value)))))
    return step if lasting >= 2.0 or len(runs) >= 4 * len(steps) else 0.0


def _span(span_ns: int) -> str:
    """Return a span of time in the unit a reader would choose."""
    for size, unit in ((86400e9, "days"), (3600e9, "h"), (60e9, "min"), (1e9, "s"), (1e6, "ms")):
        if span_ns >= (2 if unit in ("h", "min") else 1) * size:
            return f"{figures(span_ns / size)} {unit}"
    return f"{span_ns} ns"


def _step_text(step: float, unit: str) -> str:
    return f"{figures(step, 4)} m/s ({figures(step * 3.6)} km/h)" if unit == "m/s" else f"{figures(step, 4)} {unit}"
