"""A stream of messages through guards and steps, one at a time or in blocks: the same compiled code either way."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackres_ros.effects.stepping import neutral, rest_effects
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.belt_step import SLOWEST_LOG_SPEED
from trackres_ros.estimator.constants import Constants, Numbers
from trackres_ros.estimator.guards import GAP, TOOK_RESET, Memory, admit, forget_others, gather
from trackres_ros.estimator.kernel import Inputs, advance, predict, roll, start
from trackres_ros.jit.compiled import HAVE_NUMBA, compiled, inlined, interpreted
from trackres_ros.units import NANOSECOND

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

STANDING_STILL = (
    at.FILTERED_SPEED, at.FILTERED_ACCEL, at.LAST_SPEED, at.FEEDFORWARD, at.FEEDFORWARD_TARGET, at.LAST_DRIVE, at.LAST_OTHERS,
    at.ROLLS,
)  # fmt: skip
"""What is zero of the motion while nothing moves."""


@inlined
def feed(
    k: Constants,
    memory: Memory,
    belts: Array,
    motion: Array,
    effects: Array,
    loads: Array,
    belt_measured: Array,
    channel: int,
    stamp: int,
    arrival: int,
    value: float,
    out: Array,
) -> bool:
    """Take one message in. An accepted speed makes a step and fills `out`; returns whether it did."""
    outcome, elapsed = admit(k, memory, channel, stamp, arrival, value)
    if outcome == TOOK_RESET:
        forget_others(memory, channel)
        motion[at.STARTED] = at.START_ANEW
    if outcome < 0 or channel != at.SPEED:
        return False
    inputs = gather(k, memory, outcome, motion, loads, belt_measured)
    if motion[at.STARTED] <= 0.0:
        start(k, belts, motion, effects, inputs.ambient, inputs.ambient_std)
    dt = elapsed * NANOSECOND
    if dt > k.number.gap:
        memory.counters[channel, GAP] += 1
    advance(k, belts, motion, effects, inputs, dt, out)
    found = int(out[at.OUT_REASONS])
    for bit in range(memory.reasons.shape[0]):
        memory.reasons[bit] += (found >> bit) & 1
    return True


# The entries take arrays one by one: a tuple of them would cost each call more than the step itself.


@compiled
def feed_one(
    numbers: Sequence[Numbers],
    assembly: Array,
    loss: Array,
    drive: Array,
    limits: Array,
    effect_rows: IntArray,
    effect_values: Array,
    work: Array,
    times: IntArray,
    values: Array,
    counters: IntArray,
    reasons: IntArray,
    belts: Array,
    motion: Array,
    effects: Array,
    loads: Array,
    belt_measured: Array,
    channel: int,
    stamp: int,
    arrival: int,
    value: float,
    out: Array,
) -> bool:
    """`feed` for one message."""
    return feed(
        Constants(numbers[0], assembly, loss, drive, limits, effect_rows, effect_values, work),
        Memory(times, values, counters, reasons),
        belts,
        motion,
        effects,
        loads,
        belt_measured,
        channel,
        stamp,
        arrival,
        value,
        out,
    )


@compiled
def feed_many(
    numbers: Sequence[Numbers],
    assembly: Array,
    loss: Array,
    drive: Array,
    limits: Array,
    effect_rows: IntArray,
    effect_values: Array,
    work: Array,
    times: IntArray,
    values: Array,
    counters: IntArray,
    reasons: IntArray,
    belts: Array,
    motion: Array,
    effects: Array,
    loads: Array,
    belt_measured: Array,
    channels: NDArray[np.integer[Any]],
    stamps: IntArray,
    arrivals: IntArray,
    message_values: Array,
    out: Array,
    out_stamps: IntArray,
    out_arrivals: IntArray,
) -> int:
    """`feed` for many messages; fills one row of `out` with its stamp and arrival [ns] for each step, returns their number."""
    k = Constants(numbers[0], assembly, loss, drive, limits, effect_rows, effect_values, work)
    memory = Memory(times, values, counters, reasons)
    steps = 0
    for i in range(channels.shape[0]):
        message = channels[i], stamps[i], arrivals[i], message_values[i]
        if feed(k, memory, belts, motion, effects, loads, belt_measured, *message, out[steps]):
            out_stamps[steps] = memory.times[at.SPEED, at.LAST_STAMP]
            out_arrivals[steps] = arrivals[i]
            steps += 1
    return steps


@compiled
def step_once(
    numbers: Sequence[Numbers],
    assembly: Array,
    loss: Array,
    drive: Array,
    limits: Array,
    effect_rows: IntArray,
    effect_values: Array,
    work: Array,
    belts: Array,
    motion: Array,
    effects: Array,
    speed: float,
    load: Array,
    ambient: float,
    ambient_std: float,
    belt_measured: Array,
    acceleration: float,
    grade: float,
    yaw_rate: float,
    heading: float,
    distance: float,
    measured_torque: float,
    reasons: int,
    dt: float,
    out: Array,
) -> None:
    """`kernel.advance` for inputs given one by one."""
    inputs = Inputs(
        speed, load, ambient, ambient_std, belt_measured, acceleration, grade, yaw_rate, heading, distance, measured_torque,
        reasons,
    )  # fmt: skip
    k = Constants(numbers[0], assembly, loss, drive, limits, effect_rows, effect_values, work)
    advance(k, belts, motion, effects, inputs, dt, out)


@compiled
def run_series(
    numbers: Sequence[Numbers],
    assembly: Array,
    loss: Array,
    drive: Array,
    limits: Array,
    effect_rows: IntArray,
    effect_values: Array,
    work: Array,
    belts: Array,
    motion: Array,
    effects: Array,
    times: Array,
    speeds: Array,
    weights: Array,
    ambients: Array,
    ambient_std: float,
    accelerations: Array,
    grades: Array,
    yaw_rates: Array,
    headings: Array,
    distances: Array,
    loads: Array,
    no_belts: Array,
    out: Array,
) -> None:
    """`kernel.advance` along arrays of equal length; weights [N] are shared as nominal loads are. One row of `out` a time."""
    k = Constants(numbers[0], assembly, loss, drive, limits, effect_rows, effect_values, work)
    for i in range(times.shape[0]):
        for j in range(loads.shape[0]):
            loads[j] = weights[i] * assembly[j, at.SHARE_OF_ALL]
        inputs = Inputs(
            speeds[i], loads, ambients[i], ambient_std, no_belts, accelerations[i], grades[i], yaw_rates[i], headings[i],
            distances[i], math.nan, 0,
        )  # fmt: skip
        advance(k, belts, motion, effects, inputs, times[i] - times[i - 1] if i > 0 else 0.0, out[i])


@compiled
def predict_series(
    numbers: Sequence[Numbers],
    assembly: Array,
    loss: Array,
    drive: Array,
    limits: Array,
    effect_rows: IntArray,
    effect_values: Array,
    work: Array,
    belts: Array,
    motion: Array,
    effects: Array,
    count: Array,
    times: Array,
    speeds: Array,
    accelerations: Array,
    grades: Array,
    weights: Array,
    ambients: Array,
    yaw_rates: Array,
    headings: Array,
    out: Array,
) -> None:
    """`kernel.predict` along arrays of equal length, from a state that was started or rested. One row of `out` a time."""
    k = Constants(numbers[0], assembly, loss, drive, limits, effect_rows, effect_values, work)
    for i in range(times.shape[0]):
        turning = yaw_rates[i], headings[i], math.nan
        dt = times[i] - times[i - 1] if i > 0 else 0.0
        predict(
            k, belts, motion, effects, count, speeds[i], accelerations[i], grades[i], weights[i], ambients[i], turning, dt, out[i]
        )


@compiled
def rest_vehicle(
    numbers: Sequence[Numbers],
    assembly: Array,
    loss: Array,
    drive: Array,
    limits: Array,
    effect_rows: IntArray,
    effect_values: Array,
    work: Array,
    belts: Array,
    motion: Array,
    effects: Array,
    ambient: float,
    ambient_std: float,
    seconds: float,
) -> None:
    """Let the vehicle stand for a while [s] at an ambient temperature [degC]: belts and effects cool."""
    k = Constants(numbers[0], assembly, loss, drive, limits, effect_rows, effect_values, work)
    for column in STANDING_STILL:
        motion[column] = 0.0
    rest_effects(effect_rows, effect_values, effects, work, ambient, seconds)
    for i in range(belts.shape[0]):
        roll(k, i, belts[i], 0.0, 0.0, SLOWEST_LOG_SPEED, 0.0, 0.0, ambient, ambient_std, seconds)
    neutral(k.work)


@compiled
def start_belts(
    numbers: Sequence[Numbers],
    assembly: Array,
    loss: Array,
    drive: Array,
    limits: Array,
    effect_rows: IntArray,
    effect_values: Array,
    work: Array,
    belts: Array,
    motion: Array,
    effects: Array,
    ambient: float,
    ambient_std: float,
) -> None:
    """`kernel.start`."""
    k = Constants(numbers[0], assembly, loss, drive, limits, effect_rows, effect_values, work)
    start(k, belts, motion, effects, ambient, ambient_std)


@dataclass(frozen=True)
class Entries:
    """The functions an estimator runs, compiled where numba is there or in plain Python; equal numbers either way."""

    compiled: bool
    feed_one: Callable[..., Any]
    feed_many: Callable[..., Any]
    run_series: Callable[..., Any]
    predict_series: Callable[..., Any]
    step_once: Callable[..., Any]
    rest_vehicle: Callable[..., Any]
    start_belts: Callable[..., Any]


COMPILED = Entries(HAVE_NUMBA, feed_one, feed_many, run_series, predict_series, step_once, rest_vehicle, start_belts)


def interpreted_entries() -> Entries:
    """The same in plain Python."""
    known: dict[Any, Any] = {}
    functions = (feed_one, feed_many, run_series, predict_series, step_once, rest_vehicle, start_belts)
    return Entries(False, *(interpreted(function, known) for function in functions))
