# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Takes a stream of messages through guards and steps, one at a time or in blocks: the same compiled code either way."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, TypeVar

from trackres_ros.arrays import Array, IntArray
from trackres_ros.effects.stepping import TERMS, WEIGHT, neutral, rest_effects
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.belt_heat import SLOWEST_LOG_SPEED
from trackres_ros.estimator.belt_step import roll
from trackres_ros.estimator.between_steps import turn
from trackres_ros.estimator.by_place import follow_along, of_place, position_came
from trackres_ros.estimator.columns import Assembly, Motion, Results, Times
from trackres_ros.estimator.constants import Constants
from trackres_ros.estimator.guards import (
    ACCEPTED_AFTER_RESET,
    AMBIENT_NOMINAL,
    GAP,
    Memory,
    admit,
    forget_others,
    gather,
    longest_age,
)
from trackres_ros.estimator.kernel import PREDICTED, advance, follow_air, predict, start
from trackres_ros.estimator.records import LARGEST, DriveSeries, Inputs, State
from trackres_ros.kernels.marks import COMPILED as HAVE_C
from trackres_ros.kernels.marks import Bound, entry, kernel
from trackres_ros.units import NANOSECOND

Record = TypeVar("Record")


class Messages(NamedTuple):
    """Messages in the order they arrived, shape (messages,)."""

    channels: IntArray
    stamps: IntArray  # ns
    arrivals: IntArray  # ns
    values: Array


@kernel
def feed(
    k: Constants,
    memory: Memory,
    carried: State,
    loads: Array,
    belt_measured: Array,
    channel: int,
    stamp: int,
    arrival: int,
    value: float,
    out: Array,
) -> bool:
    """Take one message in. An accepted speed makes a step and fills `out`; returns whether it did."""
    motion = Motion(carried.motion)
    turn(k, memory, motion, arrival)
    outcome, elapsed = admit(k, memory, channel, stamp, arrival, value, motion.quantum)
    if outcome == ACCEPTED_AFTER_RESET:
        forget_others(memory, channel)
        motion.started = at.START_ANEW
    if outcome >= 0 and (channel == at.LATITUDE or channel == at.LONGITUDE):
        position_came(k, memory.times, memory.values, memory.followed)
    if outcome < 0 or channel != at.SPEED:
        turn(k, memory, motion, arrival)
        return False
    inputs = gather(k, memory, outcome, elapsed, motion, loads, belt_measured)
    assumed = inputs.reasons & AMBIENT_NOMINAL != 0
    if motion.started <= 0.0:
        start(k, carried, inputs.ambient, inputs.ambient_std)
        if assumed:
            motion.air_std = inputs.ambient_std
    elif assumed or motion.air_std > 0.0:
        weight = 0.0
        for i in range(loads.shape[0]):
            weight += loads[i]
        follow_air(k, carried, inputs.speed, weight, inputs.ambient, inputs.ambient_std, assumed)
    dt = elapsed * NANOSECOND
    if dt > k.number.gap:
        memory.counters[channel, GAP] += 1
    advance(k, carried, inputs, dt, out)  # with the age that was allowed while it waited
    longest = longest_age(k, memory)
    motion.longest_age = longest if longest > k.number.speed_max_age else 0.0
    found = int(Results(out).reasons)
    for bit in range(memory.reasons.shape[0]):
        memory.reasons[bit] += (found >> bit) & 1
    return True


@kernel
def feed_all(
    k: Constants,
    memory: Memory,
    carried: State,
    loads: Array,
    belt_measured: Array,
    messages: Messages,
    out: Annotated[Array, (None, None)],
    out_stamps: IntArray,
    out_arrivals: IntArray,
) -> int:
    """`feed` for many messages; fills one row of `out` with its stamp and arrival [ns] for each step, returns their number."""
    steps = 0
    for i in range(messages.channels.shape[0]):
        message = messages.channels[i], messages.stamps[i], messages.arrivals[i], messages.values[i]
        if feed(k, memory, carried, loads, belt_measured, *message, out[steps]):
            of_speed = Times(memory.times[at.SPEED])
            out_stamps[steps], out_arrivals[steps] = of_speed.last_stamp, of_speed.last_arrival
            steps += 1
    return steps


@kernel
def advance_once(k: Constants, carried: State, inputs: Inputs, dt: float, out: Array) -> bool:
    """`kernel.advance` for inputs from outside; false for values that `records.checked` refuses: here a check costs nothing."""
    usable = (
        inputs.ambient_std >= 0.0
        and inputs.reasons >= 0
        and inputs.fed >= 0.0
        and inputs.load_std >= 0.0
        and not math.isnan(inputs.speed + inputs.ambient)
    )
    for value in (
        inputs.speed, inputs.ambient, inputs.ambient_std, inputs.acceleration, inputs.grade, inputs.yaw_rate, inputs.heading,
        inputs.distance, inputs.measured_torque, inputs.slope_by_place, inputs.torque_by_place, inputs.torque_by_place_std,
        inputs.fed, inputs.load_std,
    ):  # fmt: skip
        usable = usable and not abs(value) > LARGEST
    for i in range(inputs.belt_measured.shape[0]):
        usable = usable and not abs(inputs.belt_measured[i]) > LARGEST
    total = 0.0
    for i in range(inputs.load.shape[0]):
        usable = usable and 0.0 <= inputs.load[i] <= LARGEST
        total += inputs.load[i]
    if not usable or total <= 0.0:
        return False
    advance(k, carried, inputs, dt, out)
    return True


@kernel
def advance_along(
    k: Constants,
    carried: State,
    series: DriveSeries,
    ambient_std: float,
    loads: Array,
    no_belts: Array,
    out: Annotated[Array, (None, None)],
) -> None:
    """`kernel.advance` along a drive. One row of `out` a time."""
    for i in range(series.times.shape[0]):
        for j in range(loads.shape[0]):
            loads[j] = series.weights[i] * Assembly(k.assembly[j]).share_of_all
        grade, slope, torque = series.grades[i], series.slopes_by_place[i], series.torques_by_place[i]
        inputs = Inputs(
            series.speeds[i], loads, series.ambients[i], ambient_std, no_belts, series.accelerations[i], grade,
            series.yaw_rates[i], series.headings[i], series.distances[i], math.nan, slope, torque,
            series.torque_stds_by_place[i], of_place(k, series.places_known[i] > 0.0, grade, slope, torque), 1.0, 0.0,
        )  # fmt: skip
        advance(k, carried, inputs, series.times[i] - series.times[i - 1] if i > 0 else 0.0, out[i])


@kernel
def predict_along(
    k: Constants, carried: State, count: Array, series: DriveSeries, out: Annotated[Array, (None, PREDICTED)]
) -> None:
    """`kernel.predict` along a drive, from a state that was started or rested. One row of `out` a time."""
    for i in range(series.times.shape[0]):
        turning = series.yaw_rates[i], series.headings[i], series.distances[i]
        dt = series.times[i] - series.times[i - 1] if i > 0 else 0.0
        predict(
            k, carried, count, series.speeds[i], series.accelerations[i], series.grades[i], series.torques_by_place[i],
            series.weights[i], series.ambients[i], turning, dt, out[i],
        )  # fmt: skip


@kernel
def rest(k: Constants, carried: State, ambient: float, ambient_std: float, seconds: float) -> None:
    """Let the vehicle stand for some time [s] at an ambient temperature [degC], nan for the last known: all cools."""
    motion = Motion(carried.motion)
    motion.filtered_speed = motion.filtered_accel = motion.last_speed = motion.rolls = 0.0
    motion.feedforward = motion.feedforward_target = motion.last_drive = motion.last_others = 0.0
    motion.turned = motion.unfed = 0.0
    if motion.started > 0.0:
        motion.started = at.RESTS
    assumed = math.isnan(ambient)
    air = motion.air if assumed else ambient
    follow_air(k, carried, 0.0, k.work[TERMS + WEIGHT], air, ambient_std, assumed)
    rest_effects(k.effects, k.effect_values, carried.effects, k.work, air, seconds)
    for i in range(carried.belts.shape[0]):
        roll(k, Assembly(k.assembly[i]), carried.belts[i], 0.0, 0.0, SLOWEST_LOG_SPEED, 0.0, 0.0, air, ambient_std, seconds)
    neutral(k.work)


@dataclass(frozen=True)
class Entries:
    """Functions that an estimator runs, compiled or in plain Python, with equal results."""

    compiled: bool
    feed: Callable[..., bool]
    feed_all: Callable[..., int]
    run_series: Callable[..., None]
    predict_series: Callable[..., None]
    step_once: Callable[..., bool]
    rest_vehicle: Callable[..., None]
    start_belts: Callable[..., None]
    follow_series: Callable[..., None]

    def bound(self, record: Record) -> Bound[Record]:
        """A record for many calls of them."""
        return Bound(record, self.compiled)

    def __reduce__(self) -> tuple[object, ...]:
        """Copied or in another process they are the same functions, or those that it has."""
        return _entries_of, (self.compiled,)


_KERNELS: tuple[Callable[..., Any], ...] = (
    feed, feed_all, advance_along, predict_along, advance_once, rest, start, follow_along,
)  # fmt: skip
COMPILED = Entries(HAVE_C, *map(entry, _KERNELS))
INTERPRETED = Entries(False, *_KERNELS)


def _entries_of(compiled: bool) -> Entries:
    return COMPILED if compiled else INTERPRETED
