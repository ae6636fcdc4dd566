# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Advances the track assemblies by one step: belt, measured temperature, and what each adds to torque and its variance."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.belt_heat import loss_force, surface
from trackres_ros.estimator.belt_step import BEHIND_BELTS, pass_gap, roll
from trackres_ros.estimator.belt_uncertainty import belt_variance, correct_belt
from trackres_ros.estimator.constants import Constants
from trackres_ros.estimator.learned_step import learned_elsewhere, learned_hysteresis
from trackres_ros.estimator.records import Inputs
from trackres_ros.estimator.road import Road
from trackres_ros.jit.arithmetic import squared
from trackres_ros.jit.compiled import compiled, inlined
from trackres_ros.model.rubber import log_shift_factor

Array = NDArray[np.float64]

FIRST_OF_ASSEMBLIES, COLUMNS_EACH = len(at.VEHICLE_COLUMNS), len(at.ASSEMBLY_COLUMNS)
DISAGREES = 5.0  # standard deviations between measured and expected belt temperature
# Behind what belts use of the work space: the parts of all assemblies and of each.
PARTS_OF_ALL = BEHIND_BELTS
PARTS_OF_EACH = PARTS_OF_ALL + at.PARTS
BELT_UNSURE, DISAGREEING = int(at.Reason.BELT_UNSURE), int(at.Reason.BELT_SENSOR_DISAGREES)
OUTSIDE = int(at.Reason.OUTSIDE_TABLE)


@compiled
def measure(k: Constants, i: int, belt: Array, measured: float, ambient: float, speed: float) -> int:
    """Correct one belt by a new measurement [degC]; the reasons it gives."""
    shown, of_mean, of_surface = belt[0, at.TEMPERATURE], 1.0, 0.0
    if k.number.belt_shows_surface:
        shown, of_mean, of_surface = surface(k, i, belt, ambient, speed)
    expected_variance = belt_variance(belt, of_mean, of_surface) + k.number.belt_measured_variance
    if squared(measured - shown) > DISAGREES * DISAGREES * expected_variance:
        return DISAGREEING
    correct_belt(belt, measured, k.number.belt_measured_variance, shown, of_mean, of_surface)
    return 0


@inlined
def bear(arm: float, unsigned: float, road: Road, part: Array) -> float:
    """Fill the parts that forces on the whole vehicle have over an arm [m]; what resists without its sign [Nm], of which belts
    have `unsigned`. The uncertainty at rest is that at a crawl: the sign of friction is known, its size is not.
    """
    size = unsigned + arm * (road.rolling_bearing + abs(road.wind))
    part[at.PART_ARM], part[at.PART_UNSIGNED] = arm, size
    part[at.PART_BEARING], part[at.PART_WIND] = arm * road.bearing, arm * road.wind
    part[at.PART_GRADE], part[at.PART_INERTIA] = arm * road.uphill, arm * road.inertia
    return float(size)


@inlined
def advance_assembly(
    k: Constants, i: int, belt: Array, load: float, measured: float, road: Road, learned: Array, part: Array, out: Array
) -> int:
    """Advance one assembly; fills its `part` of the totals and its columns of `out`, returns its reasons."""
    radius, share, log_load = k.assembly[i, at.RADIUS], load / road.weight, math.log(load)
    reasons = 0
    # The drive torque strains the belt and itself depends on the loss, so that of the last step is used.
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
    by_temperature, size = radius * slope, bear(arm, unsigned, road, part)
    part[at.PART_HYSTERESIS] = own
    for cause in range(3):
        part[at.PART_CONSIDER + cause] = (
            by_temperature * belt[0, at.CONSIDER_1 + cause]
            + unsigned * k.assembly[i, at.CONSIDER_LOSS + cause]
            + size * k.assembly[i, at.CONSIDER_RADIUS + cause]
        )
    part[at.PART_CONSIDER + 3] = size * k.assembly[i, at.CONSIDER_RADIUS + 3]
    part[at.PART_CONSIDER_AMBIENT] = by_temperature * belt[0, at.CONSIDER_AMBIENT]
    part[at.PART_NOISE] = by_temperature * by_temperature * (squared(belt[0, at.NOISE_1]) + squared(belt[0, at.NOISE_2]))
    # What a loss, cooling or capacity that is larger by its whole makes of the belt's temperature, the departures by cause tell.
    warmer = learned[at.DEPARTURES + at.OF_BELT]
    for which in range(3):
        kelvin = 0.0
        for cause in range(3):
            kelvin += k.assembly[i, at.CAUSES_OF + 3 * cause + which] * belt[0, at.CONSIDER_1 + cause]
        part[at.PART_BY + which] = by_temperature * kelvin
        warmer += kelvin * learned[at.DEPARTURES + which]
    part[at.PART_BY + at.OF_LOSS] += unsigned
    part[at.PART_BY + at.OF_BELT] = by_temperature
    warmer *= learned[at.LEARNED_ON]
    more = learned_hysteresis(part, learned) * road.sign
    first = FIRST_OF_ASSEMBLIES + i * COLUMNS_EACH
    out[first + at.PER_BELT] = temperature + warmer
    out[first + at.PER_SURFACE] = surface(k, i, belt, road.ambient, road.speed)[0] + warmer
    out[first + at.PER_STD] = std
    out[first + at.PER_LOAD] = load
    out[first + at.PER_RESISTANCE] = resisting + more + learned_elsewhere(part, learned)
    out[first + at.PER_HYSTERESIS] = own + more
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
def advance_assemblies(k: Constants, belts: Array, inputs: Inputs, road: Road, learned: Array, out: Array) -> tuple[Array, int]:
    """Advance all assemblies; the sums of their parts, shape (PARTS,), which lie in the work space, and their reasons."""
    assemblies = belts.shape[0]
    total, parts = k.work[PARTS_OF_ALL:PARTS_OF_EACH], k.work[PARTS_OF_EACH:]
    for column in range(at.PARTS):
        total[column] = 0.0
    for i in range(assemblies):
        parts[i * at.PARTS + at.PART_TWIN] = twin_of(k, i, belts, inputs)
    if assemblies == 0:  # wheels without belts
        size = bear(k.assembly[0, at.RADIUS], 0.0, road, total)
        total[at.PART_CONSIDER + 3] = size * k.assembly[0, at.CONSIDER_RADIUS + 3]
    reasons = 0
    for i in range(assemblies):
        part = parts[i * at.PARTS : (i + 1) * at.PARTS]
        j = int(part[at.PART_TWIN])
        if j == i:
            reasons |= advance_assembly(k, i, belts[i], inputs.load[i], inputs.belt_measured[i], road, learned, part, out)
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
