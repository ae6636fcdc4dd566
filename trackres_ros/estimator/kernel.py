# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes the steps of the estimate: belts, motion, torque by part, its standard deviation and the feed-forward.

A stream of messages passes guards and steps, one message at a time or in blocks: the same compiled code either way. It has no
I/O and no clock.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, TypeVar

from trackres_ros.arrays import Array, IntArray
from trackres_ros.effects.stepping import (
    ALL_WELL,
    EACH,
    EXTRAPOLATED,
    FACT,
    FIRST_OWN,
    OF_AIR,
    TERM,
    correct_air_of_effects,
    reset_terms,
    rest_effects,
)
from trackres_ros.effects.vehicle.drivetrain_efficiency import drives
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.assemblies import (
    COLUMNS_EACH,
    FIRST_OF_ASSEMBLIES,
    Moment,
    Road,
    advance_assemblies,
    advance_belt,
    begin_step,
    end_step,
    learn_from,
    learned_variance,
)
from trackres_ros.estimator.belt import SLOWEST_LOG_SPEED, add_noise, loss_force, roll_belt, surface
from trackres_ros.estimator.columns import (
    BELT_COLUMNS,
    OF_COOLING,
    OF_LOSS,
    RESTS,
    TEMPERATURE,
    Assembly,
    Belt,
    Learned,
    Motion,
    OfAssembly,
    Part,
    Results,
    Times,
)
from trackres_ros.estimator.constants import Constants
from trackres_ros.estimator.feedforward import feedforward, update_feedforward
from trackres_ros.estimator.guards import (
    ACCEPTED_AFTER_RESET,
    AMBIENT_NOMINAL,
    GAP,
    Memory,
    admit_message,
    follow_along,
    forget_others,
    gather_inputs,
    is_missing,
    longest_age,
    place_reason,
    take_new_position,
)
from trackres_ros.estimator.motion import advance_motion, rolling_state, start_motion
from trackres_ros.estimator.records import LARGEST, DriveSeries, Inputs, Scratch, State
from trackres_ros.kernels.marks import COMPILED as HAVE_C
from trackres_ros.kernels.marks import Bound, entry, kernel, squared
from trackres_ros.model.resistance import direction, wind_force
from trackres_ros.units import NANOSECOND

# A step

LEAST_STD_SHARE = 0.001  # of the resistance: torque transducers are no better (class 0.1), so no estimate is

RADIUS, RESISTANCE_OF_ONE = Assembly.radius, OfAssembly.resistance_torque_nm
BRIDGED, UNKNOWN = int(layout.Reason.GAP_BRIDGED), int(layout.Reason.GAP_UNKNOWN)
SURROUNDINGS, EFFECT_LEFT_OUT = int(layout.Reason.SURROUNDINGS), int(layout.Reason.EFFECT_LEFT_OUT)
OFF_ROUTE = int(layout.Reason.OFF_ROUTE)
OUTSIDE_LEARNED = int(layout.Reason.OUTSIDE_LEARNED)
PREDICTED_DRIVE, PREDICTED_BELT, PREDICTED_SKIN, PREDICTED_OUTCOME = range(4)
PREDICTED = 4


@kernel
def start(k: Constants, state: State, ambient: float, ambient_std: float) -> None:
    """A cold start: every belt at the ambient temperature, and uncertain."""
    belts, motion, effects, _ = state
    for i in range(belts.shape[0]):
        for node in range(2):
            for column in range(BELT_COLUMNS):
                belts[i, node, column] = 0.0
            belt = Belt(belts[i, node])
            belt.temperature, belt.consider_ambient, belt.noise_1 = ambient, ambient_std, k.number.initial_belt_std
    for column in range(motion.shape[0]):
        motion[column] = 0.0
    Motion(motion).quantum, Motion(motion).air = 1e9, ambient
    for place in range(FIRST_OWN, effects.shape[0]):  # as after a long rest; the distance driven stays
        effects[place] = math.nan


@kernel
def correct_air(
    k: Constants,
    state: State,
    scratch: Scratch,
    speed: float,
    weight: float,
    ambient: float,
    ambient_std: float,
    is_assumed: bool,
) -> None:
    """Set the ambient temperature of a step. If the last one was only assumed, correct belts and effects by its error (ours).

    Notes
    -----
    A belt keeps the departure [K] that one standard deviation of the assumed air gives it. Their ratio is the share of the air in
    its temperature: 1 after a start or a long rest, less after a short one. The belt moves by this share of the correction, to
    first order. It never moves by more than the whole correction.

    While the air is measured, that departure is due to the thermometer. When the air is first assumed, it joins the random part,
    and the departure due to the assumed air begins at zero.
    """
    motion = Motion(state.motion)
    if motion.air_std > 0.0 and not (is_assumed and ambient == motion.air and ambient_std == motion.air_std):
        for i in range(state.belts.shape[0]):
            for node in range(2):
                belt = Belt(state.belts[i, node])
                belt.temperature += min(belt.consider_ambient / motion.air_std, 1.0) * (ambient - motion.air)
                belt.consider_ambient *= ambient_std / motion.air_std
        correct_air_of_effects(k.effects, k.effect_values, state.effects, scratch.effects, speed, weight, motion.air, ambient)
        motion.air_std = ambient_std
    elif motion.air_std == 0.0 and is_assumed:
        for i in range(state.belts.shape[0]):
            mean, skin = Belt(state.belts[i, 0]), Belt(state.belts[i, 1])
            of_mean, of_skin = mean.consider_ambient, skin.consider_ambient
            add_noise(state.belts[i], squared(of_mean), of_mean * of_skin, squared(of_skin))
            mean.consider_ambient = skin.consider_ambient = 0.0
        for place in range(FIRST_OWN, state.effects.shape[0], EACH):
            state.effects[place + OF_AIR] = 0.0
        motion.air_std = ambient_std
    motion.air = ambient
    if not is_assumed:
        motion.air_std = 0.0


@kernel
def advance(k: Constants, state: State, scratch: Scratch, inputs: Inputs, dt: float, row: Array) -> None:
    """Advance the whole estimate by dt [s] to the time of `inputs`; change the carried state, fill one row of results.

    Parameters
    ----------
    dt
        Time since the last step [s], 0 at the first.
    row
        Row of results, shape (columns,), see `columns`.

    Notes
    -----
    M = R_1 [sign(v) sum F_h + sign(v) f_b G_v + 1/2 rho_a C_d A_f v|v| + G_v sin(gamma) + delta_m G_v/g dv/dt] (32 to 36; the
    grade is ours). Effects and learned terms are added (ours).
    """
    number, terms = k.number, scratch.effects.terms
    belts, motion, learned = state.belts, Motion(state.motion), Learned(state.learned)
    reasons = inputs.reasons
    speed = inputs.speed
    has_motion = motion.started > RESTS
    last_speed = motion.last_speed if has_motion else speed
    if has_motion and 0.0 < dt <= number.bridge:
        advance_motion(
            motion, speed, last_speed, dt, number.speed_variance, number.acceleration_variance, number.acceleration_time
        )
    elif not has_motion or dt > 0.0:
        start_motion(motion, speed, number.speed_variance, number.acceleration_variance)
    motion.rolls = rolling_state(motion, speed, number.speed_variance)
    if dt > number.bridge:
        reasons |= UNKNOWN
    elif dt > number.gap:
        reasons |= BRIDGED
    accel = motion.filtered_accel if math.isnan(inputs.acceleration) else inputs.acceleration
    weight = arm = belt_degc = 0.0
    for i in range(belts.shape[0]):
        belt_degc += belts[i, 0, TEMPERATURE] / belts.shape[0]
    if belts.shape[0] == 0:
        belt_degc = math.nan
    for i in range(inputs.load.shape[0]):
        weight += inputs.load[i]
        arm += inputs.load[i] * k.assembly[i, RADIUS]
    arm /= weight
    grade = inputs.slope_by_place if math.isnan(inputs.grade) else inputs.grade
    moment = Moment(
        speed, accel, grade, weight, arm, belt_degc, inputs.ambient, inputs.ambient_std, inputs.yaw_rate, inputs.heading,
        inputs.distance, inputs.torque_by_place,
    )  # fmt: skip
    road = begin_step(k, state, scratch, moment, last_speed, dt)
    if road.outcome == EXTRAPOLATED:
        reasons |= OUTSIDE_LEARNED
    elif road.outcome != ALL_WELL:
        reasons |= EFFECT_LEFT_OUT
    if number.surroundings:
        reasons |= SURROUNDINGS
    if is_missing(k, inputs.grade, inputs.slope_by_place, inputs.torque_by_place):
        reasons |= OFF_ROUTE
    reasons |= advance_assemblies(k, scratch, belts, inputs, road, learned, row)
    total, result, gain = Part(scratch.parts[0]), Results(row), terms[TERM.drive_gain]
    lasting = learn_from(total, learned, road.sign, gain, terms[TERM.by_drag_area] * number.drag_area)
    resistance = total.hysteresis + total.bearing + total.wind
    drive_torque, of_effects = end_step(state, scratch, road, resistance + lasting, total.grade, total.inertia)
    of_effects += lasting
    for i in range(belts.shape[0]):  # effects act on the whole vehicle: their force is shared by load
        at_own_radius = inputs.load[i] * k.assembly[i, RADIUS] / (weight * arm)
        row[FIRST_OF_ASSEMBLIES + i * COLUMNS_EACH + RESISTANCE_OF_ONE] += of_effects * at_own_radius
    # Only resistance to motion is fed forward, so no effects at standstill: friction holds a standing vehicle by itself,
    # and any other torque of an effect at rest would push it.
    fed_effects = (terms[TERM.fed] + lasting) * abs(direction(speed))
    motion.feedforward, of_feedforward = feedforward(k, terms, motion, total, fed_effects, inputs, dt)
    variance = torque_variance(k, terms, total, learned, road, drive_torque, inputs.torque_by_place_std)
    variance += load_variance(total, road, inputs.load_std / weight, gain)
    motion.air = inputs.ambient

    result.speed_mps, result.accel_mps2 = speed, accel
    result.weight_n, result.ambient_degc = weight, inputs.ambient
    result.resistance_torque_nm, result.effects_nm, result.drive_torque_nm = resistance + of_effects, of_effects, drive_torque
    result.hysteresis_nm, result.bearing_nm, result.wind_nm = total.hysteresis, total.bearing, total.wind
    result.grade_nm, result.inertia_nm = total.grade, total.inertia
    result.resistance_std_nm = max(math.sqrt(variance), LEAST_STD_SHARE * total.unsigned * gain)
    motor_gain = 1.0 / (number.motor_ratio * number.motor_efficiency ** drives(drive_torque, road.sign, weight, arm))
    result.feedforward_torque_nm, result.motor_torque_nm = motion.feedforward, drive_torque * motor_gain
    measured_torque = inputs.measured_torque / number.torque_scale - number.torque_offset
    result.measured_torque_nm, result.residual_nm = measured_torque, measured_torque - drive_torque
    result.heat_w, result.cooling_w = total.heat, total.cooling
    result.reasons = reasons | of_feedforward


@kernel
def torque_variance(
    k: Constants, terms: Array, total: Part, learned: Learned, road: Road, drive_torque: float, of_place_std: float
) -> float:
    """Variance of the resistance [Nm^2]: var M of docs/model.md, plus the variances of effects and of a torque by place (ours).

    Each cause is summed over the assemblies before squaring: heating of all belts stays one cause. Learned variances replace
    those of the file. The gears' gain is on all torques behind them; that of learned torques has it already.
    """
    number, torque_by, gain = k.number, total.torque_by, terms[TERM.drive_gain]
    of_place = 0.0 if math.isnan(of_place_std) else of_place_std * road.sign
    variance: float = (
        (terms[TERM.variance] + terms[TERM.loss_variance] * squared(torque_by[OF_LOSS])) * squared(gain)
        + terms[TERM.cooling_variance] * squared(torque_by[OF_COOLING] * gain)
        + terms[TERM.gain_variance] * squared(drive_torque)
        + squared(of_place * gain)
    )
    of_bearing = squared(total.arm * road.weight * number.bearing_friction_std)
    of_wind = squared(total.arm * wind_force(road.speed, number.drag_area_std, number.air_density))
    if learned.on > 0.0:  # departures scale the file's values, so a value of 0 keeps its range
        file_variance = (of_bearing if number.bearing_friction == 0.0 else 0.0) + (of_wind if number.drag_area == 0.0 else 0.0)
        return variance + file_variance * squared(gain) + learned_variance(total, learned, road.rolling_bearing, gain)
    of_file = (
        total.noise
        + squared(total.consider_ambient)
        + of_bearing
        + squared(total.arm * road.weight * road.speed * number.rolling_rise_std)
        + of_wind
    )
    variance += of_file * squared(gain)
    for cause in range(4):
        variance += squared(total.consider[cause] * gain)
    return variance


@kernel
def load_variance(total: Part, road: Road, relative_std: float, gain: float) -> float:
    """Variance of the resistance [Nm^2] by a relative standard deviation of the load, to which all but the wind is taken to be
    proportional (ours).
    """
    return squared((total.unsigned - total.arm * abs(road.wind)) * relative_std * gain)


@kernel
def predict(k: Constants, state: State, scratch: Scratch, count: Array, series: DriveSeries, i: int, row: Array) -> None:
    """The step of `advance` without uncertainty, feed-forward and shares: for a fit, which needs thousands of runs.

    Parameters
    ----------
    state
        With one belt per kind, as the rows of `k.assembly`; none for wheels without belts.
    count
        Number of assemblies of each kind, shape (kinds,).
    series, i
        The drive, and the index of the present time in it.
    row
        `PREDICTED`: driving torque [Nm], mean of the belts' temperatures and of their skins [degC], the effects' reasons.
    """
    belts, motion, terms = state.belts, Motion(state.motion), scratch.effects.terms
    arm = belts_in_all = belt_degc = 0.0
    for kind in range(count.shape[0]):
        assembly = Assembly(k.assembly[kind])
        arm += count[kind] * assembly.share_of_all * assembly.radius
    for kind in range(belts.shape[0]):
        belts_in_all += count[kind]
        belt_degc += count[kind] * belts[kind, 0, TEMPERATURE]
    belt_degc = belt_degc / belts_in_all if belts.shape[0] > 0 else math.nan
    speed, dt = series.speeds[i], series.times[i] - series.times[i - 1] if i > 0 else 0.0
    moment = Moment(
        speed, series.accelerations[i], series.grades[i], series.weights[i], arm, belt_degc, series.ambients[i], 0.0,
        series.yaw_rates[i], series.headings[i], series.distances[i], series.torques_by_place[i],
    )  # fmt: skip
    road = begin_step(k, state, scratch, moment, motion.last_speed if motion.started > RESTS else speed, dt)
    hysteresis = mean = skin = 0.0
    for kind in range(belts.shape[0]):
        belt, assembly = belts[kind], Assembly(k.assembly[kind])
        share = assembly.share_of_all
        log_load, drive = math.log(share * road.weight), road.last_drive * share
        advance_belt(k, scratch, assembly, belt, log_load, drive, road)
        loss, _ = loss_force(k, terms, assembly, belt[0, TEMPERATURE], road.log10_speed, log_load, drive)
        hysteresis += count[kind] * assembly.radius * loss * road.sign
        mean += count[kind] * belt[0, TEMPERATURE]
        skin += count[kind] * surface(k, terms, assembly, belt, road.ambient, road.speed)[0]
    resistance = hysteresis + arm * (road.bearing + road.wind)
    row[PREDICTED_DRIVE], _ = end_step(state, scratch, road, resistance, arm * road.uphill, arm * road.inertia)
    row[PREDICTED_BELT] = mean / belts_in_all if belts.shape[0] > 0 else math.nan
    row[PREDICTED_SKIN] = skin / belts_in_all if belts.shape[0] > 0 else math.nan
    row[PREDICTED_OUTCOME] = road.outcome


# Runs of steps

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
    state: State,
    scratch: Scratch,
    channel: int,
    stamp: int,
    arrival: int,
    value: float,
    row: Array,
) -> bool:
    """Take one message in. An accepted speed makes a step and fills `row`; returns whether it did."""
    motion = Motion(state.motion)
    update_feedforward(k, memory, motion, arrival)
    outcome, elapsed = admit_message(k, memory, channel, stamp, arrival, value, motion.quantum)
    if outcome == ACCEPTED_AFTER_RESET:
        forget_others(memory, channel)
        motion.started = layout.START_ANEW
    if outcome >= 0 and (channel == layout.LATITUDE or channel == layout.LONGITUDE):
        take_new_position(k, memory.times, memory.values, memory.followed)
    if outcome < 0 or channel != layout.SPEED:
        update_feedforward(k, memory, motion, arrival)
        return False
    inputs = gather_inputs(k, memory, scratch, outcome, elapsed, motion)
    is_assumed = inputs.reasons & AMBIENT_NOMINAL != 0
    if motion.started <= 0.0:
        start(k, state, inputs.ambient, inputs.ambient_std)
        if is_assumed:
            motion.air_std = inputs.ambient_std
    elif is_assumed or motion.air_std > 0.0:
        weight = 0.0
        for i in range(inputs.load.shape[0]):
            weight += inputs.load[i]
        correct_air(k, state, scratch, inputs.speed, weight, inputs.ambient, inputs.ambient_std, is_assumed)
    dt = elapsed * NANOSECOND
    if dt > k.number.gap:
        memory.counters[channel, GAP] += 1
    advance(k, state, scratch, inputs, dt, row)  # with the age that was allowed while it waited
    oldest = longest_age(k, memory)
    motion.longest_age = oldest if oldest > k.number.speed_max_age else 0.0
    reasons = int(Results(row).reasons)
    for bit in range(memory.reasons.shape[0]):
        memory.reasons[bit] += (reasons >> bit) & 1
    return True


@kernel
def feed_all(
    k: Constants,
    memory: Memory,
    state: State,
    scratch: Scratch,
    messages: Messages,
    rows: Annotated[Array, (None, None)],
    out_stamps: IntArray,
    out_arrivals: IntArray,
) -> int:
    """`feed` for many messages; fills one row of `rows` with its stamp and arrival [ns] for each step, returns their number."""
    steps = 0
    for i in range(messages.channels.shape[0]):
        message = messages.channels[i], messages.stamps[i], messages.arrivals[i], messages.values[i]
        if feed(k, memory, state, scratch, *message, rows[steps]):
            of_speed = Times(memory.times[layout.SPEED])
            out_stamps[steps], out_arrivals[steps] = of_speed.last_stamp, of_speed.last_arrival
            steps += 1
    return steps


@kernel
def advance_once(k: Constants, state: State, scratch: Scratch, inputs: Inputs, dt: float, row: Array) -> bool:
    """`advance` for inputs from outside; false for values that `records.check_inputs` refuses: here a check costs nothing."""
    is_usable = (
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
        is_usable = is_usable and not abs(value) > LARGEST
    for i in range(inputs.belt_measured.shape[0]):
        is_usable = is_usable and not abs(inputs.belt_measured[i]) > LARGEST
    total = 0.0
    for i in range(inputs.load.shape[0]):
        is_usable = is_usable and 0.0 <= inputs.load[i] <= LARGEST
        total += inputs.load[i]
    if not is_usable or total <= 0.0:
        return False
    advance(k, state, scratch, inputs, dt, row)
    return True


@kernel
def advance_along(
    k: Constants,
    state: State,
    scratch: Scratch,
    series: DriveSeries,
    ambient_std: float,
    rows: Annotated[Array, (None, None)],
) -> None:
    """`advance` along a drive. One row of `rows` a time."""
    loads, no_belts = scratch.loads, scratch.belt_measured
    for j in range(no_belts.shape[0]):
        no_belts[j] = math.nan
    for i in range(series.times.shape[0]):
        for j in range(loads.shape[0]):
            loads[j] = series.weights[i] * Assembly(k.assembly[j]).share_of_all
        grade, slope, torque = series.grades[i], series.slopes_by_place[i], series.torques_by_place[i]
        inputs = Inputs(
            series.speeds[i], loads, series.ambients[i], ambient_std, no_belts, series.accelerations[i], grade,
            series.yaw_rates[i], series.headings[i], series.distances[i], math.nan, slope, torque,
            series.torque_stds_by_place[i], place_reason(k, series.places_known[i] > 0.0, grade, slope, torque), 1.0, 0.0,
        )  # fmt: skip
        advance(k, state, scratch, inputs, series.times[i] - series.times[i - 1] if i > 0 else 0.0, rows[i])


@kernel
def predict_along(
    k: Constants,
    state: State,
    scratch: Scratch,
    count: Array,
    series: DriveSeries,
    rows: Annotated[Array, (None, PREDICTED)],
) -> None:
    """`predict` along a drive, from a state that was started or rested. One row of `rows` a time."""
    for i in range(series.times.shape[0]):
        predict(k, state, scratch, count, series, i, rows[i])


@kernel
def rest(k: Constants, state: State, scratch: Scratch, ambient: float, ambient_std: float, seconds: float) -> None:
    """Let the vehicle stand for some time [s] at an ambient temperature [degC], nan for the last known: all cools."""
    motion = Motion(state.motion)
    motion.filtered_speed = motion.filtered_accel = motion.last_speed = motion.rolls = 0.0
    motion.feedforward = motion.feedforward_target = motion.last_drive = motion.last_others = 0.0
    motion.update_age = motion.to_zero = 0.0
    if motion.started > 0.0:
        motion.started = layout.RESTS
    is_assumed = math.isnan(ambient)
    air = motion.air if is_assumed else ambient
    effects = scratch.effects
    correct_air(k, state, scratch, 0.0, effects.conditions[FACT.weight], air, ambient_std, is_assumed)
    rest_effects(k.effects, k.effect_values, state.effects, effects, air, seconds)
    for i in range(state.belts.shape[0]):
        assembly, belt = Assembly(k.assembly[i]), state.belts[i]
        roll_belt(k, effects.terms, assembly, belt, 0.0, 0.0, SLOWEST_LOG_SPEED, 0.0, 0.0, air, ambient_std, seconds)
    reset_terms(effects.terms)


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
