# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Steps all effects of a vehicle, each through the numbers of its `terms` and `lag`, see `calls`.

They are in a table, with a row for each effect and a row of values of its parameters. So the step is compiled once, whatever
effects there are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Annotated, NamedTuple

import numpy as np

from trackres_ros.arrays import Array, IntArray
from trackres_ros.effects.calls import call_at, numbers_of, reads_drag_area
from trackres_ros.effects.effect import (
    ANSWERED,
    FACTS,
    LOOKED_AT,
    SOFTENING_FROM_DEGC,
    Active,
    Conditions,
    Effect,
    Terms,
    VehicleConstants,
)
from trackres_ros.errors import InputError
from trackres_ros.kernels.marks import kernel, length, squared
from trackres_ros.units import STANDSTILL_MPS

# One row of the table of effects: which effect's own state, its kind (see below), its required inputs, and its two numbers.
STATE, KIND, NEEDS, TERMS_AT, LAG_AT = range(5)
ROW = 5
Rows = Annotated[IntArray, (None, ROW)]
Table = Annotated[Array, (None, None)]
# Kinds. Fed forward is what belongs to the vehicle; what comes with an acceleration only where that is. A shifted row is the row
# above it with one parameter a standard deviation off: it moves nothing and gives the effect's variance. A row with more drag is
# the same with a drag area a square metre larger: it gives what the effect's torque gains by that.
UNFED, FED, FED_WITH_ACCEL, SHIFTED, WITH_MORE_DRAG = range(5)

# Work space of a step: what effects look at, the facts first; then what one of them answers.
(
    AT_SPEED, AT_ACCEL, AT_WEIGHT, AT_AMBIENT, AT_YAW_RATE, AT_HEADING, AT_DISTANCE, AT_DRIVE_TORQUE, AT_DIRECTION, AT_CURVATURE,
    AT_BELT, AT_OWN,
) = range(FACTS, LOOKED_AT)  # fmt: skip
RADIUS, WEIGHT, DRAG_AREA, CONTACT_LENGTH, STANDSTILL, COOLING, COOLING_BY_SPEED = (
    VehicleConstants._fields.index(name)
    for name in ("radius", "weight", "drag_area", "contact_length", "standstill", "cooling", "cooling_by_speed")
)
if Conditions._fields[1:] != (
    "speed", "accel", "weight", "ambient", "yaw_rate", "heading", "distance", "drive_torque", "direction", "curvature",
    "belt", "own",
):  # fmt: skip
    raise TypeError("Conditions has other fields than the work space of a step")

# What effects do together in a step. The first are those of `Terms`; fed forward are only the vehicle's own: torque, gain, and
# the torque that comes with an acceleration. Variances are of torque [Nm^2], and relative ones of loss, driving torque, cooling.
# The last is what the torque gains with the drag area [Nm/m^2].
(
    TERM_TORQUE, TERM_DRIVE_GAIN, TERM_LOSS_FACTOR, TERM_SOFTENING, TERM_FILM_OFFSET, TERM_FILM_SLOPE, TERM_CONDUCTANCE,
    TERM_SINK, TERM_HEAT, TERM_INNER_RESISTANCE, TERM_FED, TERM_FED_GAIN, TERM_FED_INERTIA, TERM_VARIANCE, TERM_LOSS_VARIANCE,
    TERM_GAIN_VARIANCE, TERM_COOLING_VARIANCE, TERM_BY_DRAG_AREA,
) = range(18)  # fmt: skip
TERMS = 18
NO_TERMS = (0.0, 1.0, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
WORK = TERMS + LOOKED_AT + ANSWERED

# What is remembered: distance [m], speed of the last step [m/s]; then of each effect its own state, its target and time constant,
# and the share of a constant ambient temperature in the state since the start, or since that was first assumed.
DISTANCE, LAST_SPEED, FIRST_OWN = range(3)
OWN, TARGET, TIME_CONSTANT, OF_AIR = range(4)
EACH = 4

# Outside of these limits an effect of whatever kind is a mistake: they are an order of magnitude wider than the catalogue.
MOST_TORQUE = 10.0  # times weight times radius
LIMITS = {
    "torque": (-math.inf, math.inf),
    "drive_gain": (0.1, 10.0),
    "loss_factor": (0.01, 100.0),
    "softening": (-0.1, 0.1),  # 1/K
    "film_offset_factor": (0.01, 100.0),
    "film_slope_factor": (0.01, 100.0),
    "conductance": (0.0, 1e5),  # W/K
    "sink": (-100.0, 200.0),  # degC
    "heat": (-1e5, 1e5),  # W
    "inner_resistance": (0.0, 1.0),  # K/W
}
if tuple(LIMITS) != Terms._fields[: len(LIMITS)]:
    raise TypeError("the limits stand in another order than the fields of Terms")
LOWEST, HIGHEST = (tuple(pair[i] for pair in LIMITS.values()) for i in (0, 1))
LIMITED = len(LIMITS)
MOST_STATE = 1e9
LEAST_TIME_S = 1e-3
LAG_LIMITS = {"target": (-MOST_STATE, MOST_STATE), "time_constant": (LEAST_TIME_S, math.inf), "start": (-MOST_STATE, MOST_STATE)}
USABLE = "finite, plausible terms, with all values of its parameters within their bounds"

# Outcome of the effects of a step: all well; one is outside the range in which it was learned; an input of one is not known; one
# gives no number, or one outside of the limits.
ALL_WELL, EXTRAPOLATED, INPUT_UNKNOWN, UNUSABLE = range(4)
ANSWER_EXTRAPOLATED = Terms._fields.index("extrapolated")


class EffectTable(NamedTuple):
    """Effects ready for the step."""

    rows: Rows
    values: Table  # (rows, most parameters)


def effect_table(of_vehicle: Sequence[Active], of_surroundings: Sequence[Active] = ()) -> EffectTable:
    """The effects of a vehicle, which are fed forward, and of its surroundings, with the rows that move nothing."""
    rows: list[tuple[int, ...]] = []
    values: list[tuple[float, ...]] = []
    for state, active in enumerate((*of_vehicle, *of_surroundings)):
        fed, *of_effect = _row(active.effect)
        rows.append((state, fed if state < len(of_vehicle) else UNFED, *of_effect))
        values.append(active.numbers)
        if reads_drag_area(active.effect):
            rows.append((state, WITH_MORE_DRAG, *of_effect))
            values.append(active.numbers)
        for other in active.shifted():
            rows.append((state, SHIFTED, *of_effect))
            values.append(other.numbers)
    return EffectTable(np.array(rows, dtype=np.int64).reshape(-1, ROW), _values(values))


def fit_table(of_vehicle: Sequence[Active]) -> EffectTable:
    """The same for a fit, without the rows that move nothing."""
    return EffectTable(_fit_rows(tuple(a.effect for a in of_vehicle)), _values([a.numbers for a in of_vehicle]))


@lru_cache(maxsize=256)
def _fit_rows(effects: tuple[Effect, ...]) -> IntArray:
    """Rows of effects in a fit: it changes only their values, thousands of times."""
    rows = [(state, *_row(effect)) for state, effect in enumerate(effects)]
    return np.array(rows, dtype=np.int64).reshape(-1, ROW)


def _row(effect: Effect) -> tuple[int, int, int, int]:
    """An effect's row after its state, if it is fed forward."""
    fed = FED_WITH_ACCEL if "accel" in effect.needs else FED
    return fed, sum(1 << Conditions._fields.index(need) for need in effect.needs), *numbers_of(effect)


def _values(values: Sequence[tuple[float, ...]]) -> Array:
    table = np.zeros((len(values), max(map(len, values), default=0)))
    for i, row in enumerate(values):
        table[i, : len(row)] = row
    return table


def refuse_unusable(active: Active, at: Conditions) -> None:
    """Raise the error of a user's effect that fails under known conditions, or gives no plausible numbers there."""
    where = f"{active.effect.source}: effect {active.effect.name}"
    try:
        lag = active.lag(at)
        terms = active.terms(at, 0.0 if lag is None else lag.start)
        said = {**terms._asdict(), **({} if lag is None else lag._asdict())}
        bad = {name: value for name, value in said.items() if not math.isfinite(value)}
    except Exception as error:  # of any kind, as the code is not ours
        raise InputError(where, f"{type(error).__name__}: {error}", USABLE) from error
    most = MOST_TORQUE * at.facts.weight * at.facts.radius
    for name, (low, high) in {**LIMITS, "torque": (-most, most), **({} if lag is None else LAG_LIMITS)}.items():
        if not low <= said[name] <= high:
            bad[name] = said[name]
    if bad:
        said_of = ", ".join(f"{name} {value:g}" for name, value in bad.items())
        raise InputError(where, f"{said_of} with {dict(active.values)} at {at.speed:g} m/s", USABLE)


def new_memory(count: int) -> Array:
    """Memory of so many effects at the very beginning."""
    memory = np.full(FIRST_OWN + EACH * count, math.nan)
    memory[DISTANCE] = memory[LAST_SPEED] = 0.0
    return memory


def cooled(memory: Array) -> Array:
    """Memory after a restart: effects' own states as after a long rest; the distance driven stays."""
    fresh = new_memory((len(memory) - FIRST_OWN) // EACH)
    fresh[DISTANCE] = memory[DISTANCE]
    return fresh


def new_work(facts: VehicleConstants) -> Array:
    """Work space of a step for a vehicle, with neutral terms."""
    work = np.full(WORK, math.nan)
    work[:TERMS] = NO_TERMS
    work[TERMS : TERMS + FACTS] = facts
    return work


@kernel
def neutral(work: Array) -> None:
    """Neutral terms."""
    for i in range(TERMS):
        work[i] = NO_TERMS[i]


@kernel
def look(
    work: Array,
    speed: float,
    accel: float,
    weight: float,
    ambient: float,
    yaw_rate: float,
    heading: float,
    distance: float,
    drive_torque: float,
    belt: float,
) -> None:
    """Write known values of a step for the effects; units of `Conditions`. A missing distance is integrated from the speed."""
    looked_at = work[TERMS : TERMS + LOOKED_AT]
    looked_at[AT_SPEED], looked_at[AT_ACCEL], looked_at[AT_WEIGHT], looked_at[AT_AMBIENT] = speed, accel, weight, ambient
    looked_at[AT_YAW_RATE], looked_at[AT_HEADING], looked_at[AT_DISTANCE] = yaw_rate, heading, distance
    looked_at[AT_DRIVE_TORQUE], looked_at[AT_DIRECTION] = drive_torque, math.tanh(speed / looked_at[STANDSTILL])
    looked_at[AT_BELT] = belt
    turning = abs(yaw_rate)
    looked_at[AT_CURVATURE] = turning / length(speed, looked_at[CONTACT_LENGTH] * turning + STANDSTILL_MPS)


@kernel
def rest_effects(rows: Rows, values: Table, memory: Array, work: Array, ambient: float, seconds: float) -> None:
    """Relax the effects' own states for some time at rest [s]; leave the terms at its end."""
    memory[LAST_SPEED] = 0.0
    look(work, 0.0, 0.0, work[TERMS + WEIGHT], ambient, math.nan, math.nan, math.nan, 0.0, math.nan)
    for dt in (0.0, seconds):  # states relax from their present values to their targets at rest
        step_effects(rows, values, memory, work, dt)


@kernel
def usable(answer: Array, most_torque: float) -> bool:
    """Whether an effect's result is a number within the limits."""
    if not abs(answer[0]) <= most_torque:
        return False
    within = True
    for i in range(1, LIMITED):
        within &= LOWEST[i] <= answer[i] <= HIGHEST[i]
    return within


@kernel
def is_known(needs: int, looked_at: Array) -> bool:
    """Whether all that an effect needs is known."""
    known = True
    for need in range(1, LOOKED_AT - FACTS):
        if needs >> need & 1 and not math.isfinite(looked_at[FACTS + need - 1]):
            known = False
    return known


@kernel
def call_lag(function: int, looked_at: Array, values: Array, answer: Array) -> bool:
    """Target, time constant and start of an effect's own state; whether they are usable."""
    for i in range(3):
        answer[i] = math.nan
    call_at(function, looked_at, values, answer)
    works: bool = abs(answer[0]) <= MOST_STATE and abs(answer[2]) <= MOST_STATE and LEAST_TIME_S <= answer[1] < math.inf
    return works


@kernel
def after(rows: Rows, values: Table, work: Array, row: int, own: Array, dt: float) -> tuple[float, float]:
    """An effect's own state after some time [s] in the conditions of the work space, and the share of the air in it; unchanged
    where they are unknown.
    """
    looked_at, answer = work[TERMS : TERMS + LOOKED_AT], work[TERMS + LOOKED_AT :]
    looked_at[AT_OWN] = own[OWN]
    if is_known(rows[row, NEEDS], looked_at) and call_lag(rows[row, LAG_AT], looked_at, values[row], answer):
        passed = -math.expm1(-dt / answer[1])
        return own[OWN] + (answer[0] - own[OWN]) * passed, own[OF_AIR] + (1.0 - own[OF_AIR]) * passed
    return own[OWN], own[OF_AIR]


@kernel
def pass_gap_of_effects(
    rows: Rows, values: Table, memory: Array, work: Array, speed: float, weight: float, ambient: float, dt: float
) -> None:
    """Pass a gap too long to bridge (ours): as `belt.pass_gap` the mean of a rest and of a drive throughout, at a speed
    [m/s].
    """
    for row in range(rows.shape[0]):
        own = memory[FIRST_OWN + EACH * rows[row, STATE] :]
        if rows[row, KIND] >= SHIFTED or rows[row, LAG_AT] == 0 or math.isnan(own[OWN]):
            continue
        look(work, 0.0, 0.0, weight, ambient, math.nan, math.nan, math.nan, 0.0, math.nan)
        rested, rested_air = after(rows, values, work, row, own, dt)
        look(work, speed, 0.0, weight, ambient, math.nan, math.nan, math.nan, 0.0, math.nan)
        driven, driven_air = after(rows, values, work, row, own, dt)
        own[OWN], own[OF_AIR] = 0.5 * (rested + driven), 0.5 * (rested_air + driven_air)


@kernel
def move_effects(
    rows: Rows, values: Table, memory: Array, work: Array, speed: float, weight: float, before: float, ambient: float
) -> None:
    """Move the effects' own states by what their start gains from one ambient temperature [degC] to another, times the share of
    the air in them.
    """
    looked_at, answer = work[TERMS : TERMS + LOOKED_AT], work[TERMS + LOOKED_AT :]
    for row in range(rows.shape[0]):
        own = memory[FIRST_OWN + EACH * rows[row, STATE] :]
        if rows[row, KIND] >= SHIFTED or rows[row, LAG_AT] == 0 or math.isnan(own[OWN]):
            continue
        for sign in (-1.0, 1.0):
            look(work, speed, 0.0, weight, ambient if sign > 0.0 else before, math.nan, math.nan, math.nan, 0.0, math.nan)
            looked_at[AT_OWN] = 0.0
            if is_known(rows[row, NEEDS], looked_at) and call_lag(rows[row, LAG_AT], looked_at, values[row], answer):
                own[OWN] += sign * own[OF_AIR] * answer[2]
                own[TARGET] += sign * answer[0]


@kernel
def own_state(function: int, values: Array, looked_at: Array, answer: Array, own: Array, dt: float) -> bool:
    """Advance an effect's own state by a step and write it for the effect; return whether it is usable."""
    looked_at[AT_OWN] = 0.0
    if function == 0:
        return True
    state = math.nan
    if not math.isnan(own[OWN]):
        passed = -math.expm1(-dt / own[TIME_CONSTANT])
        state = own[OWN] + (own[TARGET] - own[OWN]) * passed
        own[OF_AIR] += (1.0 - own[OF_AIR]) * passed
        looked_at[AT_OWN] = state
    if not call_lag(function, looked_at, values, answer):
        return False
    target, time_constant, start = answer[0], answer[1], answer[2]
    if math.isnan(state):
        state, own[OF_AIR] = start, 1.0
    own[OWN], own[TARGET], own[TIME_CONSTANT] = state, target, time_constant
    looked_at[AT_OWN] = state
    return True


@kernel
def step_effects(rows: Rows, values: Table, memory: Array, work: Array, dt: float) -> int:
    """All effects of a step that ends now, `dt` [s] after the one before; return `ALL_WELL`, or why one is missing in the terms.

    The work space has the known values; its terms are filled, and a missing distance by the one driven. The memory is changed.
    """
    looked_at, answer = work[TERMS : TERMS + LOOKED_AT], work[TERMS + LOOKED_AT :]
    memory[DISTANCE] += abs(memory[LAST_SPEED]) * dt
    memory[LAST_SPEED] = looked_at[AT_SPEED]
    if math.isnan(looked_at[AT_DISTANCE]):
        looked_at[AT_DISTANCE] = memory[DISTANCE]
    else:
        memory[DISTANCE] = looked_at[AT_DISTANCE]
    most_torque = MOST_TORQUE * looked_at[WEIGHT] * looked_at[RADIUS]
    neutral(work)
    outcome = ALL_WELL
    left_out = False
    torque = loss_factor = drive_gain = softening = cooling = inner_resistance = 0.0
    for row in range(rows.shape[0]):
        kind = rows[row, KIND]
        if kind == SHIFTED:
            if left_out:
                continue
            call_terms(rows[row, TERMS_AT], looked_at, values[row], answer)
            if usable(answer, most_torque):
                of_loss = answer[TERM_LOSS_FACTOR] / loss_factor - 1.0
                if looked_at[COOLING] > 0.0:  # there are belts; what the inside keeps back is as if the outside took less
                    of_loss -= (answer[TERM_SOFTENING] - softening) * (looked_at[AT_BELT] - SOFTENING_FROM_DEGC)
                    of_inside = (answer[TERM_INNER_RESISTANCE] - inner_resistance) * cooling
                    work[TERM_COOLING_VARIANCE] += squared(cooling_of(answer, looked_at) / cooling - 1.0 - of_inside)
                work[TERM_VARIANCE] += squared(answer[TERM_TORQUE] - torque)
                work[TERM_LOSS_VARIANCE] += of_loss * of_loss
                work[TERM_GAIN_VARIANCE] += squared(answer[TERM_DRIVE_GAIN] / drive_gain - 1.0)
            continue
        if kind == WITH_MORE_DRAG:
            if not left_out:
                call_with_more_drag(rows[row, TERMS_AT], looked_at, values[row], answer)
                work[TERM_BY_DRAG_AREA] += answer[TERM_TORQUE] - torque if usable(answer, most_torque) else 0.0
            continue
        left_out = True
        if not is_known(rows[row, NEEDS], looked_at):
            outcome = max(outcome, INPUT_UNKNOWN)
        else:
            first = FIRST_OWN + EACH * rows[row, STATE]
            if own_state(rows[row, LAG_AT], values[row], looked_at, answer, memory[first : first + EACH], dt):
                call_terms(rows[row, TERMS_AT], looked_at, values[row], answer)
                left_out = not usable(answer, most_torque)
            if left_out:
                outcome = UNUSABLE
        if left_out:
            continue
        if answer[ANSWER_EXTRAPOLATED] > 0.0:
            outcome = max(outcome, EXTRAPOLATED)
        torque, drive_gain = answer[TERM_TORQUE], answer[TERM_DRIVE_GAIN]
        loss_factor, softening = answer[TERM_LOSS_FACTOR], answer[TERM_SOFTENING]
        cooling, inner_resistance = cooling_of(answer, looked_at), answer[TERM_INNER_RESISTANCE]
        add_terms(work, answer)
        if kind != UNFED:
            work[TERM_FED_GAIN] *= drive_gain
            work[TERM_FED if kind == FED else TERM_FED_INERTIA] += torque
    return outcome


@kernel
def cooling_of(answer: Array, looked_at: Array) -> float:
    """Conductance of one belt to its surroundings with one effect [W/K]; 0 without belts."""
    at_rest, by_speed = looked_at[COOLING] * answer[TERM_FILM_OFFSET], looked_at[COOLING_BY_SPEED] * answer[TERM_FILM_SLOPE]
    return float(at_rest + by_speed * abs(looked_at[AT_SPEED]) + answer[TERM_CONDUCTANCE])


@kernel
def add_terms(work: Array, answer: Array) -> None:
    """Add the terms of one effect to the total, as `Terms.with_`."""
    for term in (TERM_TORQUE, TERM_SOFTENING, TERM_HEAT, TERM_INNER_RESISTANCE):
        work[term] += answer[term]
    for term in (TERM_DRIVE_GAIN, TERM_LOSS_FACTOR, TERM_FILM_OFFSET, TERM_FILM_SLOPE):
        work[term] *= answer[term]
    if answer[TERM_CONDUCTANCE] > 0.0:
        work[TERM_CONDUCTANCE] += answer[TERM_CONDUCTANCE]
        work[TERM_SINK] += answer[TERM_CONDUCTANCE] / work[TERM_CONDUCTANCE] * (answer[TERM_SINK] - work[TERM_SINK])


@kernel
def call_with_more_drag(function: int, looked_at: Array, values: Array, answer: Array) -> None:
    """Terms of an effect of a vehicle whose drag area is a square metre larger."""
    area = looked_at[DRAG_AREA]
    looked_at[DRAG_AREA] = area + 1.0
    call_terms(function, looked_at, values, answer)
    looked_at[DRAG_AREA] = area


@kernel
def call_terms(function: int, looked_at: Array, values: Array, answer: Array) -> None:
    """Terms of an effect; nan where it does not fill in a term."""
    for i in range(LIMITED):
        answer[i] = math.nan
    call_at(function, looked_at, values, answer)
