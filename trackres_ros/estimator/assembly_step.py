# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Advances the track assemblies by one step: belt, measured temperature, and contributions to the torque and its variance."""

from __future__ import annotations

import math

from trackres_ros.arrays import Array
from trackres_ros.effects.stepping import TERM_COOLING_VARIANCE, TERM_LOSS_VARIANCE
from trackres_ros.estimator.belt_heat import loss_force, surface
from trackres_ros.estimator.belt_step import BEHIND_BELTS, pass_gap, roll
from trackres_ros.estimator.belt_uncertainty import belt_variance, correct_belt
from trackres_ros.estimator.columns import (
    BELT_COLUMNS,
    OF_BELT,
    OF_COOLING,
    OF_LOSS,
    PARTS,
    Assembly,
    Belt,
    Learned,
    OfAssembly,
    Part,
    Reason,
    Results,
)
from trackres_ros.estimator.constants import Constants
from trackres_ros.estimator.learned_step import learned_elsewhere, learned_hysteresis
from trackres_ros.estimator.records import Inputs
from trackres_ros.estimator.road import Road
from trackres_ros.kernels.arithmetic import squared
from trackres_ros.kernels.marks import kernel
from trackres_ros.model.rubber import log_shift_factor

FIRST_OF_ASSEMBLIES, COLUMNS_EACH = Results.columns, OfAssembly.columns
KIND = Assembly.kind
DISAGREES = 5.0  # standard deviations between measured and expected belt temperature
# Offset in the work space, after the belts' entries: the parts of all assemblies and of each.
PARTS_OF_ALL = BEHIND_BELTS
PARTS_OF_EACH = PARTS_OF_ALL + PARTS
BELT_UNSURE, DISAGREEING = int(Reason.BELT_UNSURE), int(Reason.BELT_SENSOR_DISAGREES)
OUTSIDE = int(Reason.OUTSIDE_TABLE)


@kernel
def measure(k: Constants, assembly: Assembly, belt: Array, measured: float, ambient: float, speed: float) -> int:
    """Correct one belt by a new measurement [degC]; return the reasons."""
    shown, of_mean, of_surface = Belt(belt[0]).temperature, 1.0, 0.0
    if k.number.belt_shows_surface:
        shown, of_mean, of_surface = surface(k, assembly, belt, ambient, speed)
    expected_variance = belt_variance(belt, of_mean, of_surface) + k.number.belt_measured_variance
    if squared(measured - shown) > DISAGREES * DISAGREES * expected_variance:
        return DISAGREEING
    correct_belt(belt, measured, k.number.belt_measured_variance, shown, of_mean, of_surface)
    return 0


@kernel
def bear(arm: float, unsigned: float, road: Road, part: Part) -> float:
    """Fill the parts (34 to 36) of the forces on the whole vehicle at an arm R_1 G/G_v [m]; return the unsigned resistance [Nm].

    The belts' share of it is `unsigned`. At rest it is that of a crawl: friction has a known sign there but no known size.
    """
    part.arm, part.unsigned = arm, unsigned + arm * (road.rolling_bearing + abs(road.wind))
    part.bearing, part.wind = arm * road.bearing, arm * road.wind
    part.grade, part.inertia = arm * road.uphill, arm * road.inertia
    return part.unsigned


@kernel
def outside(k: Constants, assembly: Assembly, temperature: float, log10_speed: float, log_load: float) -> int:
    """Reason to report where T, x = log10(a_T v) or ln G are outside the rubber data or the table, else 0."""
    x = log10_speed + log_shift_factor(temperature, k.number.glass_transition, k.number.wlf_c1, k.number.wlf_c2)[0]
    last_log_load = assembly.first_log_load + assembly.step_log_load * (k.loss.shape[2] - 1)
    within = assembly.first_log_load - 1e-9 <= log_load <= last_log_load + 1e-9
    return OUTSIDE if temperature > k.number.hottest or x > k.number.fastest_x or not within else 0


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
    departures, by = learned.departures, part.by
    warmer = departures[OF_BELT]
    for which in range(3):
        kelvin = 0.0
        for cause in range(3):
            kelvin += assembly.causes_of[3 * cause + which] * mean.consider[cause]
        part.warming[which] = kelvin
        by[which] = by_temperature * kelvin
        warmer += kelvin * departures[which]
    by[OF_LOSS] += unsigned
    by[OF_BELT] = by_temperature
    return float(warmer * learned.on)


@kernel
def warming_variance(work: Array, part: Part) -> float:
    """Variance of a belt's temperature [K^2] due to the ranges of effects, as if these departed from the beginning (ours)."""
    warming = part.warming
    of_loss, of_cooling = work[TERM_LOSS_VARIANCE], work[TERM_COOLING_VARIANCE]
    return float(of_loss * squared(warming[OF_LOSS]) + of_cooling * squared(warming[OF_COOLING]))


@kernel
def advance_assembly(
    k: Constants, assembly: Assembly, belt: Array, load: float, measured: float, road: Road, learned: Learned, part: Part,
    result: OfAssembly,
) -> int:  # fmt: skip
    """Advance one assembly; fill its `part` of the totals and its result, return its reasons.

    Its torque is M_h = R_1 sign(v) F_h (33), and its load share of the resistance of the whole vehicle.
    """
    share, log_load, reasons, mean = load / road.weight, math.log(load), 0, Belt(belt[0])
    # The drive torque strains the belt and itself depends on the loss, so the last step's torque is used.
    drive = road.last_drive * share
    part.heat = part.cooling = 0.0
    if road.dt > k.number.bridge:
        pass_gap(k, assembly, belt, road.last_speed, road.speed, log_load, road.ambient, road.ambient_std, road.dt)
    elif road.dt > 0.0:
        heat_in, heat_out = roll(
            k, assembly, belt, road.last_speed, road.speed, road.log10_middle, log_load, drive, road.ambient, road.ambient_std,
            road.dt,
        )  # fmt: skip
        part.heat, part.cooling = heat_in / road.dt, heat_out / road.dt
    if not math.isnan(measured):
        reasons |= measure(k, assembly, belt, measured, road.ambient, road.speed)
    loss, slope = loss_force(k, assembly, mean.temperature, road.log10_speed, log_load, drive)
    unsigned, by_temperature = assembly.radius * loss, assembly.radius * slope
    part.hysteresis = unsigned * road.sign
    reasons |= outside(k, assembly, mean.temperature, road.log10_speed, log_load)

    arm = assembly.radius * share
    resisting = part.hysteresis + arm * (road.bearing + road.wind)
    bear(arm, unsigned, road, part)
    fill_causes(assembly, mean, by_temperature, unsigned, part)
    warmer = fill_departures(assembly, mean, by_temperature, unsigned, learned, part)
    std = math.sqrt(belt_variance(belt, 1.0, 0.0) + warming_variance(k.work, part))
    if std > k.number.belt_std_warn:
        reasons |= BELT_UNSURE
    more = learned_hysteresis(part, learned) * road.sign
    result.belt_degc = mean.temperature + warmer
    result.surface_degc = surface(k, assembly, belt, road.ambient, road.speed)[0] + warmer
    result.belt_std_k, result.load_n = std, load
    result.resistance_torque_nm = resisting + more + learned_elsewhere(part, learned)
    result.hysteresis_nm = part.hysteresis + more
    return reasons


@kernel
def twin_of(k: Constants, i: int, belts: Array, inputs: Inputs) -> int:
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
        same = True
        for column in range(BELT_COLUMNS):
            same &= belts[j, 0, column] == belts[i, 0, column] and belts[j, 1, column] == belts[i, 1, column]
        if same:
            return j
    return i


@kernel
def advance_assemblies(k: Constants, belts: Array, inputs: Inputs, road: Road, learned: Learned, out: Array) -> tuple[Array, int]:
    """Advance all assemblies; return the sums of their parts, a `Part` in the work space, and their reasons."""
    assemblies = belts.shape[0]
    total, parts = k.work[PARTS_OF_ALL:PARTS_OF_EACH], k.work[PARTS_OF_EACH:]
    for column in range(PARTS):
        total[column] = 0.0
    for i in range(assemblies):
        Part(parts[i * PARTS : (i + 1) * PARTS]).twin = twin_of(k, i, belts, inputs)
    if assemblies == 0:  # wheels without belts
        wheels, whole = Assembly(k.assembly[0]), Part(total)
        whole.consider[3] = bear(wheels.radius, 0.0, road, whole) * wheels.consider_radius[3]
    reasons = 0
    for i in range(assemblies):
        numbers, first = parts[i * PARTS : (i + 1) * PARTS], FIRST_OF_ASSEMBLIES + i * COLUMNS_EACH
        part = Part(numbers)
        j = int(part.twin)
        if j == i:
            reasons |= advance_assembly(
                k, Assembly(k.assembly[i]), belts[i], inputs.load[i], inputs.belt_measured[i], road, learned, part,
                OfAssembly(out[first : first + COLUMNS_EACH]),
            )  # fmt: skip
        else:
            for column in range(BELT_COLUMNS):
                belts[i, 0, column] = belts[j, 0, column]
                belts[i, 1, column] = belts[j, 1, column]
            for column in range(PARTS):
                numbers[column] = parts[j * PARTS + column]
            for column in range(COLUMNS_EACH):
                out[first + column] = out[FIRST_OF_ASSEMBLIES + j * COLUMNS_EACH + column]
        for column in range(PARTS):
            total[column] += numbers[column]
    return total, reasons
