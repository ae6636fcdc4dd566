"""One step of the estimate: belts, motion, torque by part, doubt and feed-forward. Compiled; no I/O, no clock."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackres_ros.compiled import compiled
from trackres_ros.estimator import layout as at
from trackres_ros.estimator.belt_step import (
    add_noise,
    advance_belt,
    belt_variance,
    correct_belt,
    log_speed,
    loss_force,
    surface,
)
from trackres_ros.estimator.constants import Constants
from trackres_ros.estimator.motion_step import advance_motion, start_motion
from trackres_ros.model.resistance import bearing_force, direction, grade_force, inertia_force, wind_force

Array = NDArray[np.float64]

LONGEST_SUBSTEP = 0.5        # s while rolling
MOST_SUBSTEPS = 20000
DISAGREES = 5.0              # standard deviations between measured and expected belt temperature
DRIVING_TEMPERATURES = (-60.0, 150.0)

BELT_UNSURE, DISAGREEING = int(at.Reason.BELT_UNSURE), int(at.Reason.BELT_SENSOR_DISAGREES)
BRIDGED, UNKNOWN = int(at.Reason.GAP_BRIDGED), int(at.Reason.GAP_UNKNOWN)
OUTSIDE, CLAMPED, LIMITED = int(at.Reason.OUTSIDE_TABLE), int(at.Reason.FEEDFORWARD_CLAMPED), int(at.Reason.FEEDFORWARD_RATE_LIMITED)


class Inputs(NamedTuple):
    """What is known at one step; not a number (nan) where it is not. Loads and belt temperatures: one an assembly."""

    speed: float                 # m/s
    load: Array                  # N, own weight included
    ambient: float               # degC
    ambient_std: float           # K
    belt_measured: Array         # degC, nan where there is no new one
    acceleration: float = math.nan   # m/s^2 along the travel, commanded or measured without gravity's part
    grade: float = math.nan      # rise over run, positive uphill the way the vehicle points
    measured_torque: float = math.nan  # Nm at the sprockets, whole vehicle
    reasons: int = 0             # layout.Reason found before the step


@compiled
def start(k: Constants, belts: Array, motion: Array, ambient: float, ambient_std: float) -> None:
    """A cold start: every belt at the ambient temperature, and uncertain."""
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


@compiled
def roll(k: Constants, assembly: int, belt: Array, speed_from: float, speed_to: float, log_load: float,
         drive_torque: float, ambient: float, ambient_std: float, dt: float) -> tuple[float, float]:
    """Advance one belt by dt [s] while the speed goes straight from one value to the other; heat in and out [J]."""
    heat_in, heat_out = 0.0, 0.0
    rolling = speed_from != 0.0 or speed_to != 0.0
    steps = 1
    if rolling and dt > LONGEST_SUBSTEP:
        steps = min(int(math.ceil(dt / LONGEST_SUBSTEP)), MOST_SUBSTEPS)
    for step in range(steps):
        speed = speed_from + (speed_to - speed_from) * (step + 0.5) / steps
        gained, lost = advance_belt(k, assembly, belt, speed, log_load, drive_torque, ambient, ambient_std, dt / steps)
        heat_in += gained
        heat_out += lost
    return heat_in, heat_out


@compiled
def pass_gap(k: Constants, assembly: int, belt: Array, speed_from: float, speed_to: float, log_load: float,
             ambient: float, ambient_std: float, dt: float) -> None:
    """A gap too long to bridge: the middle between resting and driving on all the while, and as uncertain as they differ."""
    rested = belt.copy()
    roll(k, assembly, rested, 0.0, 0.0, log_load, 0.0, ambient, ambient_std, dt)
    roll(k, assembly, belt, speed_from, speed_to, log_load, 0.0, ambient, ambient_std, dt)
    difference_1 = belt[0, at.TEMPERATURE] - rested[0, at.TEMPERATURE]
    difference_2 = belt[1, at.TEMPERATURE] - rested[1, at.TEMPERATURE]
    for node in range(2):
        for column in range(at.BELT_COLUMNS):
            belt[node, column] = 0.5 * (belt[node, column] + rested[node, column])
    add_noise(belt, difference_1 / math.sqrt(12.0), difference_2 / math.sqrt(12.0))


@compiled
def advance(k: Constants, belts: Array, motion: Array, inputs: Inputs, dt: float, out: Array) -> None:
    """Advance the whole estimate by dt [s] to the time of `inputs`; changes `belts` and `motion`, fills one row of results.

    Parameters
    ----------
    k, belts, motion, inputs
        `constants.Constants`; arrays (assemblies, 2, BELT_COLUMNS) and (MOTION_COLUMNS,); `Inputs`.
    dt
        Time since the last step [s], 0 at the first.
    out
        Row of results, shape (columns,), see `layout`.
    """
    assemblies = belts.shape[0]
    reasons = inputs.reasons
    speed, ambient = inputs.speed, inputs.ambient
    last_speed = motion[at.LAST_SPEED] if motion[at.STARTED] > 0.0 else speed
    if motion[at.STARTED] > 0.0 and 0.0 < dt <= k.number.bridge:
        advance_motion(motion, speed, last_speed, dt, k.number.speed_variance, k.number.acceleration_variance, k.number.acceleration_time)
    elif motion[at.STARTED] == 0.0 or dt > 0.0:
        start_motion(motion, speed, k.number.speed_variance, k.number.acceleration_variance)
    if dt > k.number.bridge:
        reasons |= UNKNOWN
    elif dt > k.number.gap:
        reasons |= BRIDGED
    given_accel = not math.isnan(inputs.acceleration)
    accel = inputs.acceleration if given_accel else motion[at.FILTERED_ACCEL]
    grade = 0.0 if math.isnan(inputs.grade) else inputs.grade

    weight = 0.0
    for i in range(assemblies):
        weight += inputs.load[i]
    wind = wind_force(speed, k.number.drag_area, k.number.air_density)
    inertia = inertia_force(accel, weight, k.number.rotating_mass_factor)
    uphill = grade_force(grade, weight)
    bearing = bearing_force(speed, weight, k.number.bearing_friction)
    sign, log10_speed = direction(speed), log_speed(speed)

    hysteresis_nm = bearing_nm = wind_nm = grade_nm = inertia_nm = heat = cooling = common_1 = common_2 = common_3 = 0.0
    common_ambient = own_variance = radius_doubt = 0.0
    for i in range(assemblies):
        belt, load, radius = belts[i], inputs.load[i], k.assembly[i, at.RADIUS]
        share, log_load = load / weight, math.log(load)
        # The drive torque strains the belt and is itself moved by the loss: that of the last step is taken.
        drive = motion[at.LAST_DRIVE] * share
        if dt > k.number.bridge:
            pass_gap(k, i, belt, last_speed, speed, log_load, ambient, inputs.ambient_std, dt)
        elif dt > 0.0:
            heat_in, heat_out = roll(k, i, belt, last_speed, speed, log_load, drive, ambient, inputs.ambient_std, dt)
            heat += heat_in / dt
            cooling += heat_out / dt
        shown, to_core, to_surface = surface(k, i, belt, ambient, speed)
        measured = inputs.belt_measured[i]
        if not math.isnan(measured):
            if not k.number.belt_shows_surface:
                shown, to_core, to_surface = belt[0, at.TEMPERATURE], 1.0, 0.0
            expected_variance = belt_variance(belt, to_core, to_surface) + k.number.belt_measured_variance
            if (measured - shown) ** 2 > DISAGREES * DISAGREES * expected_variance:
                reasons |= DISAGREEING
            else:
                correct_belt(belt, measured, k.number.belt_measured_variance, shown, to_core, to_surface)
        temperature = belt[0, at.TEMPERATURE]
        loss, slope = loss_force(k, i, temperature, log10_speed, log_load, drive)
        own = radius * loss * sign
        std = math.sqrt(belt_variance(belt, 1.0, 0.0))
        if std > k.number.belt_std_warn:
            reasons |= BELT_UNSURE
        first_log_load = k.assembly[i, at.FIRST_LOG_LOAD]
        last_log_load = first_log_load + k.assembly[i, at.STEP_LOG_LOAD] * (k.loss.shape[2] - 1)
        if not (DRIVING_TEMPERATURES[0] < temperature < DRIVING_TEMPERATURES[1]) or not (
                first_log_load - 1e-9 <= log_load <= last_log_load + 1e-9):
            reasons |= OUTSIDE
        by_temperature = radius * slope * sign
        common_1 += by_temperature * belt[0, at.DOUBT_1] + own * k.assembly[i, at.LOSS_DOUBT]
        common_2 += by_temperature * belt[0, at.DOUBT_2] + own * k.assembly[i, at.LOSS_DOUBT + 1]
        common_3 += by_temperature * belt[0, at.DOUBT_3] + own * k.assembly[i, at.LOSS_DOUBT + 2]
        common_ambient += by_temperature * belt[0, at.DOUBT_AMBIENT]
        own_variance += by_temperature * by_temperature * (belt[0, at.NOISE_1] ** 2 + belt[0, at.NOISE_2] ** 2)
        resisting = own + radius * share * (bearing + wind)
        radius_doubt += resisting * k.assembly[i, at.RADIUS_DOUBT + 3]
        common_1 += resisting * k.assembly[i, at.RADIUS_DOUBT]
        common_2 += resisting * k.assembly[i, at.RADIUS_DOUBT + 1]
        common_3 += resisting * k.assembly[i, at.RADIUS_DOUBT + 2]
        hysteresis_nm += own
        bearing_nm += radius * share * bearing
        wind_nm += radius * share * wind
        grade_nm += radius * share * uphill
        inertia_nm += radius * share * inertia
        start_of = len(at.VEHICLE_COLUMNS) + i * len(at.ASSEMBLY_COLUMNS)
        out[start_of + at.PER_BELT] = temperature
        out[start_of + at.PER_SURFACE] = surface(k, i, belt, ambient, speed)[0]
        out[start_of + at.PER_STD] = std
        out[start_of + at.PER_LOAD] = load
        out[start_of + at.PER_RESISTANCE] = resisting
        out[start_of + at.PER_HYSTERESIS] = own

    resistance = hysteresis_nm + bearing_nm + wind_nm
    driving = resistance + grade_nm + inertia_nm
    variance = (common_1**2 + common_2**2 + common_3**2 + common_ambient**2 + own_variance + radius_doubt**2
                + (bearing_nm * k.number.bearing_doubt) ** 2 + (wind_nm * k.number.drag_doubt) ** 2)
    wanted = k.number.feed_hysteresis * hysteresis_nm + k.number.feed_bearing * bearing_nm + k.number.feed_wind * wind_nm + k.number.feed_grade * grade_nm
    if given_accel:  # an acceleration filtered from the speed would feed the controller's own noise back to it
        wanted += k.number.feed_inertia * inertia_nm
    if abs(wanted) > k.number.feedforward_limit:
        wanted = math.copysign(k.number.feedforward_limit, wanted)
        reasons |= CLAMPED
    room = k.number.feedforward_rate * min(dt, k.number.gap)
    if abs(wanted - motion[at.FEEDFORWARD]) > room:
        wanted = motion[at.FEEDFORWARD] + math.copysign(room, wanted - motion[at.FEEDFORWARD])
        reasons |= LIMITED
    motion[at.FEEDFORWARD] = wanted
    motion[at.LAST_SPEED] = speed
    motion[at.LAST_DRIVE] = driving

    out[at.OUT_SPEED] = speed
    out[at.OUT_ACCEL] = accel
    out[at.OUT_WEIGHT] = weight
    out[at.OUT_AMBIENT] = ambient
    out[at.OUT_RESISTANCE] = resistance
    out[at.OUT_HYSTERESIS] = hysteresis_nm
    out[at.OUT_BEARING] = bearing_nm
    out[at.OUT_WIND] = wind_nm
    out[at.OUT_GRADE] = grade_nm
    out[at.OUT_INERTIA] = inertia_nm
    out[at.OUT_DRIVE] = driving
    out[at.OUT_STD] = math.sqrt(variance)
    out[at.OUT_FEEDFORWARD] = wanted
    out[at.OUT_MOTOR] = driving * k.number.motor_gain
    out[at.OUT_MEASURED] = inputs.measured_torque
    out[at.OUT_RESIDUAL] = inputs.measured_torque - driving
    out[at.OUT_HEAT] = heat
    out[at.OUT_COOLING] = cooling
    out[at.OUT_REASONS] = reasons
