# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Advances the track assemblies by one step: forces on the vehicle, belts, and contributions to the torque and its variance.

A learned departure d from the file moves the torque by d times its sensitivity, which for belts includes the warming due to the
departure. This is first order: at a departure of a fifth the error is less than a hundredth of the torque. All of it is ours.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from trackres_ros.arrays import Array
from trackres_ros.effects.stepping import ALL_WELL, FACT, TERM, pass_gap_of_effects, set_conditions, step_effects
from trackres_ros.estimator.belt import belt_variance, correct_belt, log_speed, loss_force, pass_gap, roll_belt, surface
from trackres_ros.estimator.columns import (
    BELT_COLUMNS,
    LEARNABLE,
    OF_BEARING,
    OF_BELT,
    OF_COOLING,
    OF_DRAG,
    OF_LOSS,
    OF_MASS,
    PARTS,
    Assembly,
    Belt,
    Learned,
    Motion,
    OfAssembly,
    Part,
    Reason,
    Results,
)
from trackres_ros.estimator.constants import Constants
from trackres_ros.estimator.records import Inputs, Scratch, State
from trackres_ros.kernels.marks import kernel, squared
from trackres_ros.model.resistance import bearing_force, direction, grade_force, inertia_force, wind_force
from trackres_ros.model.rubber import log_shift_factor

# The step of the vehicle, live and in a fit


class Moment(NamedTuple):
    """Conditions at the end of a step; nan where unknown."""

    speed: float  # m/s
    accel: float  # m/s^2
    grade: float  # rise over run
    weight: float  # N
    arm: float  # m, radius of the sprockets: their mean by load
    belt: float  # degC, mean of the belts after the last step
    ambient: float  # degC
    ambient_std: float  # K
    yaw_rate: float  # rad/s
    heading: float  # rad
    distance: float  # m
    torque_by_place: float  # Nm against travel


class Road(NamedTuple):
    """Shared quantities of all assemblies in a step: speeds [m/s], forces on the whole vehicle [N], surroundings, time [s]."""

    last_speed: float
    speed: float
    log10_middle: float
    log10_speed: float
    sign: float
    weight: float
    bearing: float
    rolling_bearing: float  # `bearing` in forward travel, also at a crawl, where the smooth sign does not reduce it yet
    wind: float
    uphill: float
    inertia: float
    last_drive: float  # Nm, driving torque of the last step
    of_place: float  # Nm, torque by place
    others: float  # Nm, driving torque but for belts and effects
    ambient: float
    ambient_std: float
    outcome: int  # of the effects
    dt: float


@kernel
def begin_step(k: Constants, state: State, scratch: Scratch, moment: Moment, last_speed: float, dt: float) -> Road:
    """Forces on the whole vehicle at the end of a step, and the terms of all effects in the scratch memory.

    An unknown grade is level. The torque by place is sign(v) times the torque against travel (ours): 0 where unknown, and at
    standstill.

    Notes
    -----
    Bearing sign(v) f_b G_v (34), wind 1/2 rho_a C_d A_f v|v| (35), inertia delta_m G_v/g dv/dt (36), corrected as in
    `model.resistance`. Ours: the grade G_v sin(gamma), f_b that grows with the speed, and tanh(v/v_0) for sign(v).
    """
    number, motion = k.number, Motion(state.motion)
    speed, weight = moment.speed, moment.weight
    sign, rolling = direction(speed), number.bearing_friction + number.rolling_rise * abs(speed)
    bearing = bearing_force(speed, weight, rolling)
    wind = wind_force(speed, number.drag_area, number.air_density)
    uphill = grade_force(0.0 if math.isnan(moment.grade) else moment.grade, weight)
    inertia = inertia_force(moment.accel, weight, number.rotating_mass_factor)
    of_place = 0.0 if math.isnan(moment.torque_by_place) else moment.torque_by_place * sign
    other_torque = of_place + moment.arm * (bearing + wind + uphill + inertia)
    outcome = apply_effects(k, state, scratch, moment, other_torque, dt)
    return Road(
        last_speed, speed, log_speed(0.5 * (last_speed + speed)), log_speed(speed), sign, weight, bearing, rolling * weight, wind,
        uphill, inertia, motion.last_drive, of_place, other_torque, moment.ambient, moment.ambient_std, outcome, dt,
    )  # fmt: skip


@kernel
def apply_effects(k: Constants, state: State, scratch: Scratch, moment: Moment, other_torque: float, dt: float) -> int:
    """Fill the terms of all effects in a step; return the effects' reasons.

    Some effects depend on the driving torque, and contribute to it. They get the last step's torque, corrected by the known
    parts of this one: `other_torque` [Nm], all but belts and effects.
    """
    if k.effects.shape[0] == 0:
        return ALL_WELL
    motion, learned, conditions = Motion(state.motion), Learned(state.learned), scratch.effects.conditions
    # As in a file with the learned drag; the rest that is learned is no fact for effects.
    conditions[FACT.drag_area] = k.number.drag_area * (1.0 + learned.on * learned.departures[OF_DRAG])
    drive = motion.last_drive + other_torque - motion.last_others
    is_bridged = dt <= k.number.bridge
    if not is_bridged:
        mean_speed = 0.5 * (motion.last_speed + moment.speed)
        pass_gap_of_effects(
            k.effects, k.effect_values, state.effects, scratch.effects, mean_speed, moment.weight, moment.ambient, dt
        )
    set_conditions(
        conditions, moment.speed, moment.accel, moment.weight, moment.ambient, moment.yaw_rate, moment.heading, moment.distance,
        drive, moment.belt,
    )  # fmt: skip
    # The drive during a gap too long to bridge is unknown: the distance stays.
    return step_effects(k.effects, k.effect_values, state.effects, scratch.effects, dt if is_bridged else 0.0)


@kernel
def advance_belt(
    k: Constants, scratch: Scratch, assembly: Assembly, belt: Array, log_load: float, drive: float, road: Road
) -> tuple[float, float]:
    """Advance one belt by a step with its share of the last driving torque [Nm]; return heat in and out [J], 0 in a gap."""
    if road.dt > k.number.bridge:
        pass_gap(k, scratch, assembly, belt, road.last_speed, road.speed, log_load, road.ambient, road.ambient_std, road.dt)
    elif road.dt > 0.0:
        return roll_belt(
            k, scratch.effects.terms, assembly, belt, road.last_speed, road.speed, road.log10_middle, log_load, drive,
            road.ambient, road.ambient_std, road.dt,
        )  # fmt: skip
    return 0.0, 0.0


@kernel
def end_step(state: State, scratch: Scratch, road: Road, resistance: float, uphill: float, inertia: float) -> tuple[float, float]:
    """Torque M at the sprockets [Nm]: the sum of its parts (32) and effects, times the effects' gain (ours). Also return the
    effects' and the place's share. Remember the step for the next one.
    """
    motion, terms = Motion(state.motion), scratch.effects.terms
    without_gain = resistance + terms[TERM.torque] + road.of_place + uphill + inertia
    drive_torque = without_gain * terms[TERM.drive_gain]
    motion.started, motion.last_speed, motion.last_drive, motion.last_others = 1.0, road.speed, drive_torque, road.others
    return drive_torque, terms[TERM.torque] + road.of_place + drive_torque - without_gain


# Learned departures

BELTS = OF_BELT + 1  # the first departures act through hysteresis


@kernel
def learned_hysteresis(part: Part, learned: Learned) -> float:
    """Learned change of the hysteresis [Nm], without its sign: the sum of d dM/dd."""
    extra, departures, torque_by = 0.0, learned.departures, part.torque_by
    for index in range(BELTS):
        extra += departures[index] * torque_by[index]
    return float(extra * learned.on)


@kernel
def learned_elsewhere(part: Part, learned: Learned) -> float:
    """Learned change of bearings and wind [Nm]."""
    departures = learned.departures
    return float((departures[OF_BEARING] * part.bearing + departures[OF_DRAG] * part.wind) * learned.on)


@kernel
def learn_from(total: Part, learned: Learned, sign: float, drive_gain: float, of_drag: float) -> float:
    """Keep the sensitivities of a step, and move its parts by the learned departures; return the slow disturbance before the gain
    [Nm].

    Parameters
    ----------
    total
        Parts of all assemblies by the file; they are changed.
    sign
        Direction of travel, smooth through zero: nothing pushes at rest.
    drive_gain
        Effects' gain of a torque at the sprockets. The disturbance is learned with it, as the sensor shows it.
    of_drag
        The effects' torque that grows with the drag area, at that of the file [Nm]; they look at the learned one themselves.
    """
    departures, sensitivities, torque_by = learned.departures, learned.sensitivities, total.torque_by
    for index in range(BELTS):
        sensitivities[index] = torque_by[index] * sign * drive_gain
    sensitivities[OF_BEARING] = total.bearing * drive_gain
    sensitivities[OF_DRAG] = (total.wind + of_drag) * drive_gain
    sensitivities[OF_MASS] = total.inertia * drive_gain
    if learned.on <= 0.0:
        return 0.0
    total.hysteresis += learned_hysteresis(total, learned) * sign
    total.bearing *= 1.0 + departures[OF_BEARING]
    total.wind *= 1.0 + departures[OF_DRAG]
    total.inertia *= 1.0 + departures[OF_MASS]
    return float(learned.torque * sign / drive_gain)


@kernel
def learned_variance(total: Part, learned: Learned, rolling_bearing: float, drive_gain: float) -> float:
    """Variance of the resistance due to the learned departures and the slow disturbance [Nm^2]: s'FF's + slow^2.

    s are the sensitivities without the sign of travel, as at rest friction has a size too; `rolling_bearing` is that of the
    bearings [N]. F is the factor of the departures' covariance. Inertia is no resistance, so its s is excluded.
    """
    variance, factor, torque_by = squared(learned.slow), learned.factor, total.torque_by
    bearing, wind = total.arm * rolling_bearing * drive_gain, abs(learned.sensitivities[OF_DRAG])
    for column in range(OF_MASS):
        projection = factor[OF_BEARING * LEARNABLE + column] * bearing + factor[OF_DRAG * LEARNABLE + column] * wind
        for row in range(BELTS):
            projection += factor[row * LEARNABLE + column] * torque_by[row] * drive_gain
        variance += squared(projection)
    return float(variance)


# Assemblies

FIRST_OF_ASSEMBLIES, COLUMNS_EACH = Results.columns, OfAssembly.columns
KIND = Assembly.kind
DISAGREES = 5.0  # standard deviations between measured and expected belt temperature
BELT_UNSURE, DISAGREEING = int(Reason.BELT_UNSURE), int(Reason.BELT_SENSOR_DISAGREES)
OUTSIDE = int(Reason.OUTSIDE_TABLE)


@kernel
def compare_belt(
    k: Constants, terms: Array, assembly: Assembly, belt: Array, measured_degc: float, ambient: float, speed: float
) -> int:
    """Correct one belt by a new measurement [degC]; return the reasons."""
    shown_degc, of_mean, of_surface = Belt(belt[0]).temperature, 1.0, 0.0
    if k.number.belt_shows_surface:
        shown_degc, of_mean, of_surface = surface(k, terms, assembly, belt, ambient, speed)
    expected_variance = belt_variance(belt, of_mean, of_surface) + k.number.belt_measured_variance
    if squared(measured_degc - shown_degc) > DISAGREES * DISAGREES * expected_variance:
        return DISAGREEING
    correct_belt(belt, measured_degc, k.number.belt_measured_variance, shown_degc, of_mean, of_surface)
    return 0


@kernel
def fill_forces(arm: float, unsigned: float, road: Road, part: Part) -> float:
    """Fill the parts (34 to 36) of the forces on the whole vehicle at an arm R_1 G/G_v [m]; return the unsigned resistance [Nm].

    The belts' share of it is `unsigned`. At rest it is that of a crawl: friction has a known sign there but no known size.
    """
    part.arm, part.unsigned = arm, unsigned + arm * (road.rolling_bearing + abs(road.wind))
    part.bearing, part.wind = arm * road.bearing, arm * road.wind
    part.grade, part.inertia = arm * road.uphill, arm * road.inertia
    return part.unsigned


@kernel
def range_reason(k: Constants, assembly: Assembly, temperature: float, log10_speed: float, log_load: float) -> int:
    """Reason to report where T, x = log10(a_T v) or ln G are outside the rubber data or the table, else 0."""
    x = log10_speed + log_shift_factor(temperature, k.number.glass_transition, k.number.wlf_c1, k.number.wlf_c2)[0]
    last_log_load = assembly.first_log_load + assembly.step_log_load * (k.loss.shape[2] - 1)
    is_in_range = assembly.first_log_load - 1e-9 <= log_load <= last_log_load + 1e-9
    return OUTSIDE if temperature > k.number.hottest or x > k.number.fastest_x or not is_in_range else 0


@kernel
def fill_causes(assembly: Assembly, mean: Belt, by_temperature: float, unsigned: float, part: Part) -> None:
    """Fill the torque departure [Nm] by cause of uncertainty: dM/dT d_c + M_h Lambda_1c + M_res Lambda_4c."""
    consider, departures = part.consider, mean.consider
    for cause in range(3):
        consider[cause] = (
            by_temperature * departures[cause]
            + unsigned * assembly.consider_loss[cause]
            + part.unsigned * assembly.consider_radius[cause]
        )
    consider[3] = part.unsigned * assembly.consider_radius[3]
    part.consider_ambient = by_temperature * mean.consider_ambient
    part.noise = by_temperature * by_temperature * (squared(mean.noise_1) + squared(mean.noise_2))


@kernel
def fill_departures(
    assembly: Assembly, mean: Belt, by_temperature: float, unsigned: float, learned: Learned, part: Part
) -> float:
    """Fill the torque [Nm] per relative departure of loss, cooling and capacity, and the belt's learned warming [K].

    The temperature change per relative departure follows from the departures by cause (ours).
    """
    departures, torque_by = learned.departures, part.torque_by
    warming_k = departures[OF_BELT]
    for index in range(3):
        kelvin = 0.0
        for cause in range(3):
            kelvin += assembly.causes_of[3 * cause + index] * mean.consider[cause]
        part.belt_change[index] = kelvin
        torque_by[index] = by_temperature * kelvin
        warming_k += kelvin * departures[index]
    torque_by[OF_LOSS] += unsigned
    torque_by[OF_BELT] = by_temperature
    return float(warming_k * learned.on)


@kernel
def belt_change_variance(terms: Array, part: Part) -> float:
    """Variance of a belt's temperature [K^2] due to the ranges of effects, taken to depart since the start (ours)."""
    change = part.belt_change
    of_loss, of_cooling = terms[TERM.loss_variance], terms[TERM.cooling_variance]
    return float(of_loss * squared(change[OF_LOSS]) + of_cooling * squared(change[OF_COOLING]))


@kernel
def advance_assembly(
    k: Constants, scratch: Scratch, assembly: Assembly, belt: Array, load: float, measured_degc: float, road: Road,
    learned: Learned, part: Part, result: OfAssembly,
) -> int:  # fmt: skip
    """Advance one assembly; fill its `part` of the totals and its result, return its reasons.

    Its torque is M_h = R_1 sign(v) F_h (33), and its load share of the resistance of the whole vehicle.
    """
    share, log_load, reasons, mean = load / road.weight, math.log(load), 0, Belt(belt[0])
    terms = scratch.effects.terms
    # The drive torque strains the belt and itself depends on the loss, so the last step's torque is used.
    drive = road.last_drive * share
    heat_in, heat_out = advance_belt(k, scratch, assembly, belt, log_load, drive, road)
    part.heat = heat_in / road.dt if road.dt > 0.0 else 0.0
    part.cooling = heat_out / road.dt if road.dt > 0.0 else 0.0
    if not math.isnan(measured_degc):
        reasons |= compare_belt(k, terms, assembly, belt, measured_degc, road.ambient, road.speed)
    loss, slope = loss_force(k, terms, assembly, mean.temperature, road.log10_speed, log_load, drive)
    unsigned, by_temperature = assembly.radius * loss, assembly.radius * slope
    part.hysteresis = unsigned * road.sign
    reasons |= range_reason(k, assembly, mean.temperature, road.log10_speed, log_load)

    arm = assembly.radius * share
    resistance = part.hysteresis + arm * (road.bearing + road.wind)
    fill_forces(arm, unsigned, road, part)
    fill_causes(assembly, mean, by_temperature, unsigned, part)
    warming_k = fill_departures(assembly, mean, by_temperature, unsigned, learned, part)
    std = math.sqrt(belt_variance(belt, 1.0, 0.0) + belt_change_variance(terms, part))
    if std > k.number.belt_std_warn:
        reasons |= BELT_UNSURE
    extra = learned_hysteresis(part, learned) * road.sign
    result.belt_degc = mean.temperature + warming_k
    result.surface_degc = surface(k, terms, assembly, belt, road.ambient, road.speed)[0] + warming_k
    result.belt_std_k, result.load_n = std, load
    result.resistance_torque_nm = resistance + extra + learned_elsewhere(part, learned)
    result.hysteresis_nm = part.hysteresis + extra
    return reasons


@kernel
def equal_assembly(k: Constants, i: int, belts: Array, inputs: Inputs) -> int:
    """Index of an earlier assembly with the same kind, load and belt state, to the bit, both without a measurement; else i.

    The two evolve equally, so the second need not be computed.
    """
    if not math.isnan(inputs.belt_measured[i]):
        return i
    for j in range(i):
        if (
            k.assembly[j, KIND] != k.assembly[i, KIND]
            or inputs.load[j] != inputs.load[i]
            or not math.isnan(inputs.belt_measured[j])
        ):
            continue
        is_same = True
        for column in range(BELT_COLUMNS):
            is_same &= belts[j, 0, column] == belts[i, 0, column] and belts[j, 1, column] == belts[i, 1, column]
        if is_same:
            return j
    return i


@kernel
def advance_assemblies(
    k: Constants, scratch: Scratch, belts: Array, inputs: Inputs, road: Road, learned: Learned, row: Array
) -> int:
    """Advance all assemblies and sum their contributions up in `scratch.parts`; return their reasons."""
    assemblies, parts = belts.shape[0], scratch.parts
    for column in range(PARTS):
        parts[0, column] = 0.0
    if assemblies == 0:  # wheels without belts
        wheels, total = Assembly(k.assembly[0]), Part(parts[0])
        total.consider[3] = fill_forces(wheels.radius, 0.0, road, total) * wheels.consider_radius[3]
    for i in range(assemblies):
        Part(parts[1 + i]).equal = equal_assembly(k, i, belts, inputs)
    reasons = 0
    for i in range(assemblies):
        part, offset = Part(parts[1 + i]), FIRST_OF_ASSEMBLIES + i * COLUMNS_EACH
        j = int(part.equal)
        if j == i:
            reasons |= advance_assembly(
                k, scratch, Assembly(k.assembly[i]), belts[i], inputs.load[i], inputs.belt_measured[i], road, learned, part,
                OfAssembly(row[offset : offset + COLUMNS_EACH]),
            )  # fmt: skip
        else:
            for column in range(BELT_COLUMNS):
                belts[i, 0, column] = belts[j, 0, column]
                belts[i, 1, column] = belts[j, 1, column]
            for column in range(PARTS):
                parts[1 + i, column] = parts[1 + j, column]
            for column in range(COLUMNS_EACH):
                row[offset + column] = row[FIRST_OF_ASSEMBLIES + j * COLUMNS_EACH + column]
        for column in range(PARTS):
            parts[0, column] += parts[1 + i, column]
    return reasons
