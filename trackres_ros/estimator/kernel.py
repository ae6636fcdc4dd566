"""One step of the estimate: belts, motion, torque by part, doubt and feed-forward. Compiled; no I/O, no clock."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackres_ros.effects.stepping import (
    ALL_WELL,
    FIRST_OWN,
    TERM_DRIVE_GAIN,
    TERM_FED,
    TERM_FED_GAIN,
    TERM_FED_INERTIA,
    TERM_GAIN_VARIANCE,
    TERM_LOSS_VARIANCE,
    TERM_TORQUE,
    TERM_VARIANCE,
    WORK,
    look,
    step_effects,
)
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.belt_step import (
    SLOWEST_LOG_SPEED,
    add_noise,
    advance_belt,
    belt_variance,
    correct_belt,
    log_speed,
    loss_force,
    surface,
)
from trackres_ros.estimator.constants import Constants
from trackres_ros.estimator.motion_step import advance_motion, rolls, start_motion
from trackres_ros.jit.compiled import compiled, inlined
from trackres_ros.model.resistance import bearing_force, direction, grade_force, inertia_force, wind_force
from trackres_ros.model.rubber import log_shift_factor

Array = NDArray[np.float64]

FIRST_OF_ASSEMBLIES, COLUMNS_EACH = len(at.VEHICLE_COLUMNS), len(at.ASSEMBLY_COLUMNS)
LONGEST_SUBSTEP = 0.5  # s while rolling
MOST_SUBSTEPS = 20000
DISAGREES = 5.0  # standard deviations between measured and expected belt temperature
FEEDFORWARD_STEP_S = 0.02  # between two outputs at the default rate: so far the feed-forward moves at once, the rest follows
LEAST_DOUBT = 0.001  # of the resistance: torque transducers are no better (class 0.1), so no estimate is

BELT_UNSURE, DISAGREEING = int(at.Reason.BELT_UNSURE), int(at.Reason.BELT_SENSOR_DISAGREES)
BRIDGED, UNKNOWN = int(at.Reason.GAP_BRIDGED), int(at.Reason.GAP_UNKNOWN)
OUTSIDE, CLAMPED, LIMITED = (
    int(at.Reason.OUTSIDE_TABLE),
    int(at.Reason.FEEDFORWARD_CLAMPED),
    int(at.Reason.FEEDFORWARD_RATE_LIMITED),
)
PREDICTED_DRIVE, PREDICTED_BELT, PREDICTED_SKIN, PREDICTED_OUTCOME = range(4)
PREDICTED = 4
# Behind what effects use of the work space: a belt before a gap and after a rest, then the parts of all assemblies and of each.
BEFORE = WORK
RESTED = BEFORE + 2 * at.BELT_COLUMNS
PARTS_OF_ALL = RESTED + 2 * at.BELT_COLUMNS
PARTS_OF_EACH = PARTS_OF_ALL + at.PARTS
SURROUNDINGS, EFFECT_LEFT_OUT = int(at.Reason.SURROUNDINGS), int(at.Reason.EFFECT_LEFT_OUT)


class Inputs(NamedTuple):
    """What is known at one step; not a number (nan) where it is not. Loads and belt temperatures: one an assembly."""

    speed: float  # m/s
    load: Array  # N, own weight included
    ambient: float  # degC
    ambient_std: float  # K
    belt_measured: Array  # degC, nan where there is no new one
    acceleration: float = math.nan  # m/s^2 along the travel, commanded or measured without gravity's part
    grade: float = math.nan  # rise over run, positive uphill the way the vehicle points
    yaw_rate: float = math.nan  # rad/s
    heading: float = math.nan  # rad
    distance: float = math.nan  # m, driven; without one it is counted from the speed
    measured_torque: float = math.nan  # Nm at the sprockets, whole vehicle
    reasons: int = 0  # columns.Reason found before the step


class Carried(NamedTuple):
    """What is carried from step to step; all arrays are changed in place."""

    belts: Array  # (assemblies, 2, BELT_COLUMNS); in a fit one of each kind
    motion: Array  # (MOTION_COLUMNS,)
    effects: Array  # see `stepping.new_memory`


@inlined
def start(k: Constants, carried: Carried, ambient: float, ambient_std: float) -> None:
    """A cold start: every belt at the ambient temperature, and uncertain."""
    belts, motion, effects = carried
    for i in range(belts.shape[0]):
        for node in range(2):
            for column in range(at.BELT_COLUMNS):
                belts[i, node, column] = 0.0
            belts[i, node, at.TEMPERATURE] = ambient
            belts[i, node, at.DOUBT_AMBIENT] = ambient_std
            belts[i, node, at.NOISE_1] = k.number.initial_belt_std
    for column in range(at.MOTION_COLUMNS):
        motion[column] = 0.0
    motion[at.QUANTUM] = 1e9
    for place in range(FIRST_OWN, effects.shape[0]):  # as after a long rest; the distance driven stays
        effects[place] = math.nan


@inlined
def roll(
    k: Constants,
    assembly: int,
    belt: Array,
    speed_from: float,
    speed_to: float,
    log10_middle: float,
    log_load: float,
    drive_torque: float,
    ambient: float,
    ambient_std: float,
    dt: float,
) -> tuple[float, float]:
    """Advance one belt by dt [s] while the speed goes straight from one value to the other; heat in and out [J].

    `log10_middle` is log10 of the speed in the middle, which serves a short step of every belt.
    """
    steps = 1
    if dt > LONGEST_SUBSTEP and not speed_from == speed_to == 0.0:
        steps = min(int(math.ceil(dt / LONGEST_SUBSTEP)), MOST_SUBSTEPS)
    heat_in, heat_out = 0.0, 0.0
    for step in range(steps):
        speed = speed_from + (speed_to - speed_from) * (step + 0.5) / steps
        log10 = log10_middle if steps == 1 else log_speed(speed)
        gained, lost = advance_belt(k, assembly, belt, speed, log10, log_load, drive_torque, ambient, ambient_std, dt / steps)
        heat_in += gained
        heat_out += lost
    return heat_in, heat_out


@compiled
def pass_gap(
    k: Constants,
    assembly: int,
    belt: Array,
    speed_from: float,
    speed_to: float,
    log_load: float,
    ambient: float,
    ambient_std: float,
    dt: float,
) -> None:
    """A gap too long to bridge: the middle between resting and driving on all the while, and as uncertain as they differ."""
    before, rested = k.work[BEFORE:RESTED], k.work[RESTED:PARTS_OF_ALL]
    for node in range(2):
        for column in range(at.BELT_COLUMNS):
            before[node * at.BELT_COLUMNS + column] = belt[node, column]
    roll(k, assembly, belt, 0.0, 0.0, SLOWEST_LOG_SPEED, log_load, 0.0, ambient, ambient_std, dt)
    for node in range(2):
        for column in range(at.BELT_COLUMNS):
            rested[node * at.BELT_COLUMNS + column] = belt[node, column]
            belt[node, column] = before[node * at.BELT_COLUMNS + column]
    roll(
        k, assembly, belt, speed_from, speed_to, log_speed(0.5 * (speed_from + speed_to)), log_load, 0.0, ambient, ambient_std, dt
    )
    difference_1 = belt[0, at.TEMPERATURE] - rested[at.TEMPERATURE]
    difference_2 = belt[1, at.TEMPERATURE] - rested[at.BELT_COLUMNS + at.TEMPERATURE]
    for node in range(2):
        for column in range(at.BELT_COLUMNS):
            belt[node, column] = 0.5 * (belt[node, column] + rested[node * at.BELT_COLUMNS + column])
    add_noise(belt, difference_1 / math.sqrt(12.0), difference_2 / math.sqrt(12.0))


class Road(NamedTuple):
    """What all assemblies share in a step: speeds [m/s], forces on the whole vehicle [N], surroundings, time [s]."""

    last_speed: float
    speed: float
    log10_middle: float
    log10_speed: float
    sign: float
    weight: float
    bearing: float
    rolling_bearing: float  # what `bearing` is at a crawl forward, where it is not yet small by its sign
    wind: float
    uphill: float
    inertia: float
    last_drive: float
    ambient: float
    ambient_std: float
    dt: float


@compiled
def measure(k: Constants, i: int, belt: Array, measured: float, ambient: float, speed: float) -> int:
    """Correct one belt by a new measurement [degC]; the reasons it gives."""
    shown, of_mean, of_surface = belt[0, at.TEMPERATURE], 1.0, 0.0
    if k.number.belt_shows_surface:
        shown, of_mean, of_surface = surface(k, i, belt, ambient, speed)
    expected_variance = belt_variance(belt, of_mean, of_surface) + k.number.belt_measured_variance
    if (measured - shown) ** 2 > DISAGREES * DISAGREES * expected_variance:
        return DISAGREEING
    correct_belt(belt, measured, k.number.belt_measured_variance, shown, of_mean, of_surface)
    return 0


@inlined
def advance_assembly(k: Constants, i: int, belt: Array, load: float, measured: float, road: Road, part: Array, out: Array) -> int:
    """Advance one assembly; fills its `part` of the totals and its columns of `out`, returns its reasons."""
    radius, share, log_load = k.assembly[i, at.RADIUS], load / road.weight, math.log(load)
    reasons = 0
    # The drive torque strains the belt and is itself moved by the loss: that of the last step is taken.
    drive = road.last_drive * share
    part[at.PART_HEAT] = part[at.PART_COOLING] = 0.0
    if road.dt > k.number.bridge:
        pass_gap(k, i, belt, road.last_speed, road.speed, log_load, road.ambient, road.ambient_std, road.dt)
    elif road.dt > 0.0:
        heat_in, heat_out = roll(
            k, i, belt, road.last_speed, road.speed, road.log10_middle, log_load, drive, road.ambient, road.ambient_std, road.dt
        )
        part[at.PART_HEAT] = heat_in / road.dt
        part[at.PART_COOLING] = heat_out / road.dt
    if not math.isnan(measured):
        reasons |= measure(k, i, belt, measured, road.ambient, road.speed)
    temperature = belt[0, at.TEMPERATURE]
    loss, slope = loss_force(k, i, temperature, road.log10_speed, log_load, drive)
    unsigned = radius * loss
    own = unsigned * road.sign
    std = math.sqrt(belt_variance(belt, 1.0, 0.0))
    if std > k.number.belt_std_warn:
        reasons |= BELT_UNSURE
    first_log_load = k.assembly[i, at.FIRST_LOG_LOAD]
    last_log_load = first_log_load + k.assembly[i, at.STEP_LOG_LOAD] * (k.loss.shape[2] - 1)
    reduced = road.log10_speed + log_shift_factor(temperature, k.number.glass_transition, k.number.wlf_c1, k.number.wlf_c2)[0]
    if temperature > k.number.hottest or reduced > k.number.fastest_x:
        reasons |= OUTSIDE
    if not (first_log_load - 1e-9 <= log_load <= last_log_load + 1e-9):
        reasons |= OUTSIDE

    arm = radius * share
    resisting = own + arm * (road.bearing + road.wind)
    # What is in doubt at rest is what it would be at a crawl: the sign of friction is known, its size is not.
    by_temperature, doubted = radius * slope, unsigned + arm * (road.rolling_bearing + abs(road.wind))
    part[at.PART_ARM], part[at.PART_UNSIGNED] = arm, doubted
    part[at.PART_HYSTERESIS], part[at.PART_BEARING], part[at.PART_WIND] = own, arm * road.bearing, arm * road.wind
    part[at.PART_GRADE], part[at.PART_INERTIA] = arm * road.uphill, arm * road.inertia
    for cause in range(3):
        part[at.PART_DOUBT + cause] = (
            by_temperature * belt[0, at.DOUBT_1 + cause]
            + unsigned * k.assembly[i, at.LOSS_DOUBT + cause]
            + doubted * k.assembly[i, at.RADIUS_DOUBT + cause]
        )
    part[at.PART_DOUBT + 3] = doubted * k.assembly[i, at.RADIUS_DOUBT + 3]
    part[at.PART_DOUBT_AMBIENT] = by_temperature * belt[0, at.DOUBT_AMBIENT]
    part[at.PART_NOISE] = by_temperature * by_temperature * (belt[0, at.NOISE_1] ** 2 + belt[0, at.NOISE_2] ** 2)
    first = FIRST_OF_ASSEMBLIES + i * COLUMNS_EACH
    out[first + at.PER_BELT] = temperature
    out[first + at.PER_SURFACE] = surface(k, i, belt, road.ambient, road.speed)[0]
    out[first + at.PER_STD] = std
    out[first + at.PER_LOAD] = load
    out[first + at.PER_RESISTANCE] = resisting
    out[first + at.PER_HYSTERESIS] = own
    return reasons


@inlined
def twin_of(k: Constants, i: int, belts: Array, inputs: Inputs) -> int:
    """An earlier assembly of the same kind, load and belt state, to the bit, with nothing measured on either; else i.

    What happens to it happens to this one, so it need not be computed again.
    """
    if not math.isnan(inputs.belt_measured[i]):
        return i
    for j in range(i):
        if (
            k.assembly[j, at.KIND] != k.assembly[i, at.KIND]
            or inputs.load[j] != inputs.load[i]
            or not math.isnan(inputs.belt_measured[j])
        ):
            continue
        same = True
        for column in range(at.BELT_COLUMNS):
            same &= belts[j, 0, column] == belts[i, 0, column] and belts[j, 1, column] == belts[i, 1, column]
        if same:
            return j
    return i


@inlined
def advance_assemblies(k: Constants, belts: Array, inputs: Inputs, road: Road, out: Array) -> tuple[Array, int]:
    """Advance all assemblies; the sums of their parts, shape (PARTS,), which lie in the work space, and their reasons."""
    assemblies = belts.shape[0]
    total, parts = k.work[PARTS_OF_ALL:PARTS_OF_EACH], k.work[PARTS_OF_EACH:]
    for column in range(at.PARTS):
        total[column] = 0.0
    for i in range(assemblies):
        parts[i * at.PARTS + at.PART_TWIN] = twin_of(k, i, belts, inputs)
    reasons = 0
    for i in range(assemblies):
        part = parts[i * at.PARTS : (i + 1) * at.PARTS]
        j = int(part[at.PART_TWIN])
        if j == i:
            reasons |= advance_assembly(k, i, belts[i], inputs.load[i], inputs.belt_measured[i], road, part, out)
        else:
            for column in range(at.BELT_COLUMNS):
                belts[i, 0, column] = belts[j, 0, column]
                belts[i, 1, column] = belts[j, 1, column]
            for column in range(at.PARTS):
                part[column] = parts[j * at.PARTS + column]
            for column in range(COLUMNS_EACH):
                out[FIRST_OF_ASSEMBLIES + i * COLUMNS_EACH + column] = out[FIRST_OF_ASSEMBLIES + j * COLUMNS_EACH + column]
        for column in range(at.PARTS):
            total[column] += part[column]
    return total, reasons


@inlined
def fade(age: float, max_age: float, fade_s: float) -> float:
    """Share of the feed-forward that is left when the speed is so old [s]: all until `max_age`, none `fade_s` later."""
    return min(1.0, max(0.0, 1.0 - (age - max_age) / fade_s))


@inlined
def towards(here: float, there: float, room: float) -> float:
    """From one value to another, by no more than `room`."""
    return there if abs(there - here) <= room else here + math.copysign(room, there - here)


@inlined
def followed(value: float, target: float, rate: float, age: float) -> float:
    """Where the feed-forward [Nm] of a step is so long after it [s], on its way to the target; the first output is the step's."""
    return towards(value, target, rate * max(0.0, age - FEEDFORWARD_STEP_S))


@inlined
def feedforward(k: Constants, motion: Array, total: Array, of_effects: float, given_accel: bool, dt: float) -> tuple[float, int]:
    """Chosen parts [Nm], limited in size and rate, and the reasons that gives; keeps what it is on its way to in `motion`.

    It begins where the outputs are by now, which have followed their last target, and faded if the speed has paused. From there
    it moves by as much as one output may. A vehicle that stands is fed nothing of what rolling takes.
    """
    number, reasons = k.number, 0
    wanted = number.feed_grade * total[at.PART_GRADE]
    if motion[at.ROLLS] > 0.0:
        wanted += (
            number.feed_hysteresis * total[at.PART_HYSTERESIS]
            + number.feed_bearing * total[at.PART_BEARING]
            + number.feed_wind * total[at.PART_WIND]
            + of_effects
        )
    if given_accel:  # an acceleration filtered from the speed would feed the controller's own noise back to it
        wanted += number.feed_inertia * (total[at.PART_INERTIA] + k.work[TERM_FED_INERTIA])
    wanted *= k.work[TERM_FED_GAIN]
    if abs(wanted) > number.feedforward_limit:
        wanted = math.copysign(number.feedforward_limit, wanted)
        reasons |= CLAMPED
    last = followed(motion[at.FEEDFORWARD], motion[at.FEEDFORWARD_TARGET], number.feedforward_rate, dt)
    last *= fade(dt, number.speed_max_age, number.feedforward_fade)
    moved = towards(last, wanted, number.feedforward_rate * min(dt, FEEDFORWARD_STEP_S))
    if moved != wanted:
        reasons |= LIMITED
    motion[at.FEEDFORWARD_TARGET] = wanted
    return moved, reasons


@inlined
def road_now(
    k: Constants,
    last_speed: float,
    speed: float,
    accel: float,
    grade: float,
    weight: float,
    last_drive: float,
    ambient: float,
    ambient_std: float,
    dt: float,
) -> Road:
    """Forces on the whole vehicle at the end of a step; without a grade the ground is level."""
    number = k.number
    return Road(
        last_speed,
        speed,
        log_speed(0.5 * (last_speed + speed)),
        log_speed(speed),
        direction(speed),
        weight,
        bearing_force(speed, weight, number.bearing_friction),
        number.bearing_friction * weight,
        wind_force(speed, number.drag_area, number.air_density),
        grade_force(0.0 if math.isnan(grade) else grade, weight),
        inertia_force(accel, weight, number.rotating_mass_factor),
        last_drive,
        ambient,
        ambient_std,
        dt,
    )


@inlined
def act(
    k: Constants,
    motion: Array,
    effects: Array,
    speed: float,
    accel: float,
    weight: float,
    ambient: float,
    turning: tuple[float, float, float],
    others: float,
    dt: float,
) -> int:
    """Fill the terms of all effects of a step; how that went.

    Some effects look at the torque that drives, and are a part of it. They get that of the last step, moved by what is known
    already of this one: `others` [Nm], all but belts and effects. `turning` is yaw rate, heading and distance.
    """
    if k.effects.shape[0] == 0:
        return ALL_WELL
    look(k.work, speed, accel, weight, ambient, *turning, motion[at.LAST_DRIVE] + others - motion[at.LAST_OTHERS])
    # Of a gap too long to bridge it is not known how it went: no state of an effect moves, no distance is driven.
    return step_effects(k.effects, k.effect_values, effects, k.work, dt if dt <= k.number.bridge else 0.0)


@inlined
def driving_torque(work: Array, resisting: float, uphill: float, inertia: float) -> tuple[float, float]:
    """Torque at the sprockets [Nm] out of its parts, and what of it is the effects'."""
    without_gain = resisting + work[TERM_TORQUE] + uphill + inertia
    driving = without_gain * work[TERM_DRIVE_GAIN]
    return driving, work[TERM_TORQUE] + driving - without_gain


@inlined
def advance(k: Constants, carried: Carried, inputs: Inputs, dt: float, out: Array) -> None:
    """Advance the whole estimate by dt [s] to the time of `inputs`; changes what it is carried in, fills one row of results.

    Parameters
    ----------
    dt
        Time since the last step [s], 0 at the first.
    out
        Row of results, shape (columns,), see `columns`.
    """
    number, work = k.number, k.work
    belts, motion, effects = carried
    reasons = inputs.reasons
    speed = inputs.speed
    started = motion[at.STARTED] > 0.0
    last_speed = motion[at.LAST_SPEED] if started else speed
    if started and 0.0 < dt <= number.bridge:
        advance_motion(
            motion, speed, last_speed, dt, number.speed_variance, number.acceleration_variance, number.acceleration_time
        )
    elif not started or dt > 0.0:
        start_motion(motion, speed, number.speed_variance, number.acceleration_variance)
    motion[at.ROLLS] = rolls(motion, speed, number.speed_variance)
    if dt > number.bridge:
        reasons |= UNKNOWN
    elif dt > number.gap:
        reasons |= BRIDGED
    given_accel = not math.isnan(inputs.acceleration)
    accel = inputs.acceleration if given_accel else motion[at.FILTERED_ACCEL]
    weight = arm = 0.0
    for i in range(belts.shape[0]):
        weight += inputs.load[i]
        arm += inputs.load[i] * k.assembly[i, at.RADIUS]
    arm /= weight
    air = inputs.ambient, inputs.ambient_std
    road = road_now(k, last_speed, speed, accel, inputs.grade, weight, motion[at.LAST_DRIVE], *air, dt)
    others = arm * (road.bearing + road.wind + road.uphill + road.inertia)
    turning = inputs.yaw_rate, inputs.heading, inputs.distance
    outcome = act(k, motion, effects, speed, accel, weight, inputs.ambient, turning, others, dt)
    if outcome != ALL_WELL:
        reasons |= EFFECT_LEFT_OUT
    if number.surroundings:
        reasons |= SURROUNDINGS
    total, of_assemblies = advance_assemblies(k, belts, inputs, road, out)
    resisting = total[at.PART_HYSTERESIS] + total[at.PART_BEARING] + total[at.PART_WIND]
    driving, of_effects = driving_torque(work, resisting, total[at.PART_GRADE], total[at.PART_INERTIA])
    resistance = resisting + of_effects
    for i in range(belts.shape[0]):  # effects are of the whole vehicle, and shared as the load is
        out[FIRST_OF_ASSEMBLIES + i * COLUMNS_EACH + at.PER_RESISTANCE] += of_effects * (inputs.load[i] / weight)
    # What resists motion is fed forward, so of effects nothing where nothing moves: friction holds a standing vehicle by itself,
    # and whatever else an effect says at rest would push it.
    fed_effects = work[TERM_FED] * abs(direction(speed))
    wanted, of_feedforward = feedforward(k, motion, total, fed_effects, given_accel, dt)
    variance = (
        total[at.PART_NOISE]
        + total[at.PART_DOUBT_AMBIENT] ** 2
        + (total[at.PART_ARM] * road.rolling_bearing * number.bearing_doubt) ** 2
        + (total[at.PART_WIND] * number.drag_doubt) ** 2
        + work[TERM_VARIANCE]
        + work[TERM_LOSS_VARIANCE] * total[at.PART_HYSTERESIS] ** 2
        + work[TERM_GAIN_VARIANCE] * driving**2
    )
    for cause in range(4):
        variance += total[at.PART_DOUBT + cause] ** 2
    motion[at.FEEDFORWARD] = wanted
    motion[at.LAST_SPEED] = speed
    motion[at.LAST_DRIVE] = driving
    motion[at.LAST_OTHERS] = others

    out[at.OUT_SPEED] = speed
    out[at.OUT_ACCEL] = accel
    out[at.OUT_WEIGHT] = weight
    out[at.OUT_AMBIENT] = inputs.ambient
    out[at.OUT_RESISTANCE] = resistance
    out[at.OUT_HYSTERESIS] = total[at.PART_HYSTERESIS]
    out[at.OUT_BEARING] = total[at.PART_BEARING]
    out[at.OUT_WIND] = total[at.PART_WIND]
    out[at.OUT_GRADE] = total[at.PART_GRADE]
    out[at.OUT_INERTIA] = total[at.PART_INERTIA]
    out[at.OUT_EFFECTS] = of_effects
    out[at.OUT_DRIVE] = driving
    out[at.OUT_STD] = max(math.sqrt(variance), LEAST_DOUBT * total[at.PART_UNSIGNED])
    out[at.OUT_FEEDFORWARD] = wanted
    out[at.OUT_MOTOR] = driving * number.motor_gain
    out[at.OUT_MEASURED] = inputs.measured_torque
    out[at.OUT_RESIDUAL] = inputs.measured_torque - driving
    out[at.OUT_HEAT] = total[at.PART_HEAT]
    out[at.OUT_COOLING] = total[at.PART_COOLING]
    out[at.OUT_REASONS] = reasons | of_assemblies | of_feedforward


@inlined
def predict(
    k: Constants, carried: Carried, count: Array, speed: float, accel: float, grade: float, weight: float, ambient: float,
    turning: tuple[float, float, float], dt: float, out: Array,
) -> None:  # fmt: skip
    """The step of `advance` without doubt, feed-forward and shares: what a fit asks for, thousands of times.

    Parameters
    ----------
    carried
        With one belt of each kind, as the rows of `k.assembly`.
    count
        How many assemblies there are of each kind, shape (kinds,).
    out
        `PREDICTED`: driving torque [Nm], mean of the belts' temperatures and of their skins [degC], how the effects went.
    """  # fmt: skip
    belts, motion, effects = carried
    arm = 0.0
    for i in range(belts.shape[0]):
        arm += count[i] * k.assembly[i, at.SHARE_OF_ALL] * k.assembly[i, at.RADIUS]
    last_speed = motion[at.LAST_SPEED] if motion[at.STARTED] > 0.0 else speed
    road = road_now(k, last_speed, speed, accel, grade, weight, motion[at.LAST_DRIVE], ambient, 0.0, dt)
    others = arm * (road.bearing + road.wind + road.uphill + road.inertia)
    outcome = act(k, motion, effects, speed, accel, weight, ambient, turning, others, dt)
    hysteresis = mean = skin = belts_in_all = 0.0
    for i in range(belts.shape[0]):
        belt, share = belts[i], k.assembly[i, at.SHARE_OF_ALL]
        log_load, drive = math.log(share * weight), road.last_drive * share
        if dt > 0.0:
            roll(k, i, belt, last_speed, speed, road.log10_middle, log_load, drive, ambient, 0.0, dt)
        loss, _ = loss_force(k, i, belt[0, at.TEMPERATURE], road.log10_speed, log_load, drive)
        hysteresis += count[i] * k.assembly[i, at.RADIUS] * loss * road.sign
        mean += count[i] * belt[0, at.TEMPERATURE]
        skin += count[i] * surface(k, i, belt, ambient, speed)[0]
        belts_in_all += count[i]
    driving, _ = driving_torque(k.work, hysteresis + arm * (road.bearing + road.wind), arm * road.uphill, arm * road.inertia)
    motion[at.STARTED], motion[at.LAST_SPEED], motion[at.LAST_DRIVE], motion[at.LAST_OTHERS] = 1.0, speed, driving, others
    out[PREDICTED_DRIVE], out[PREDICTED_BELT], out[PREDICTED_SKIN] = driving, mean / belts_in_all, skin / belts_in_all
    out[PREDICTED_OUTCOME] = outcome
