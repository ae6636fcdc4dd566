# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Steps all effects of a vehicle, each through the numbers of its `terms` and `lag`, see `calls`.

They are in a table, with a row for each effect and a row of values of its parameters. So the step is compiled once, whatever
effects there are.
"""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Sequence
from functools import lru_cache
from typing import Annotated, Any, NamedTuple

import numpy as np

from trackres_ros.arrays import Array, IntArray
from trackres_ros.effects.calls import call_at, numbers_of, reads_drag_area
from trackres_ros.effects.effect import (
    ANSWERED,
    FACTORS,
    FACTS,
    LOOKED_AT,
    SOFTENING_FROM_DEGC,
    SUMS,
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
NOT_FED, FED, FED_WITH_ACCEL, SHIFTED, WITH_MORE_DRAG = range(5)

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
LIMITED = len(LIMITS)
NAMES = Terms._fields[:LIMITED]  # terms of the step; those behind them depend on the parameters alone
LOWEST, HIGHEST = (tuple(LIMITS[name][end] for name in NAMES) for end in (0, 1))
MOST_STATE = 1e9
LEAST_TIME_S = 1e-3
LAG_LIMITS = {"target": (-MOST_STATE, MOST_STATE), "time_constant": (LEAST_TIME_S, math.inf), "start": (-MOST_STATE, MOST_STATE)}
USABLE = "finite, plausible terms, with all values of its parameters within their bounds"

# Numbers that effects read: the facts first, then the conditions.
FACT: Any = VehicleConstants(*range(FACTS))
NOW: Any = Conditions(*(None, *range(FACTS, LOOKED_AT)))

# Places of the terms that effects have together in a step. The first are those of `Terms`. Fed forward are only those of the
# vehicle: torque, gain, and the torque that comes with an acceleration. Variances are of torque [Nm^2], and relative ones of
# loss, driving torque and cooling.
# The last is what the torque gains with the drag area [Nm/m^2].
NEUTRAL_TERMS = {name: Terms._field_defaults[name] for name in NAMES} | {
    "fed": 0.0, "fed_gain": 1.0, "fed_inertia": 0.0, "variance": 0.0, "loss_variance": 0.0, "gain_variance": 0.0,
    "cooling_variance": 0.0, "by_drag_area": 0.0,
}  # fmt: skip
NEUTRAL = tuple(NEUTRAL_TERMS.values())
TERM_COUNT = len(NEUTRAL)
TERM: Any = namedtuple("Term", NEUTRAL_TERMS)(*range(TERM_COUNT))
ADDED, MULTIPLIED = (tuple(getattr(TERM, name) for name in NAMES if name in names) for names in (SUMS, FACTORS))

# Outcome of the effects of a step: all well; one is outside the range in which it was learned; an input of one is not known; one
# gives no number, or one outside of the limits.
ALL_WELL, EXTRAPOLATED, INPUT_UNKNOWN, UNUSABLE = range(4)
ANSWER_EXTRAPOLATED = Terms._fields.index("extrapolated")


class EffectScratch(NamedTuple):
    """Memory of effects within one step."""

    terms: Annotated[Array, (TERM_COUNT,)]  # of all effects, see `TERM`
    conditions: Annotated[Array, (LOOKED_AT,)]  # what they read: facts of the vehicle, and conditions of the step
    answer: Annotated[Array, (ANSWERED,)]  # terms of one of them


class EffectTable(NamedTuple):
    """Effects ready for the step."""

    rows: Rows
    values: Table  # (rows, most parameters)


def effect_table(of_vehicle: Sequence[Active], of_surroundings: Sequence[Active] = ()) -> EffectTable:
    """The effects of a vehicle, which are fed forward, and of its surroundings, with the rows that move nothing."""
    rows: list[tuple[int, ...]] = []
    values: list[tuple[float, ...]] = []
    for state, active in enumerate((*of_vehicle, *of_surroundings)):
        feed, *of_effect = _row(active.effect)
        rows.append((state, feed if state < len(of_vehicle) else NOT_FED, *of_effect))
        values.append(active.numbers)
        if reads_drag_area(active.effect):
            rows.append((state, WITH_MORE_DRAG, *of_effect))
            values.append(active.numbers)
        for shift in active.shifted():
            rows.append((state, SHIFTED, *of_effect))
            values.append(shift.numbers)
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
    feed = FED_WITH_ACCEL if "accel" in effect.needs else FED
    return feed, sum(1 << Conditions._fields.index(need) for need in effect.needs), *numbers_of(effect)


def _values(values: Sequence[tuple[float, ...]]) -> Array:
    table = np.zeros((len(values), max(map(len, values), default=0)))
    for i, row in enumerate(values):
        table[i, : len(row)] = row
    return table


def refuse_unusable(active: Active, instant: Conditions) -> None:
    """Raise the error of a user's effect that fails under known conditions, or gives no plausible numbers there."""
    place = f"{active.effect.source}: effect {active.effect.name}"
    try:
        lag = active.lag(instant)
        terms = active.terms(instant, 0.0 if lag is None else lag.start)
        answers = {**terms._asdict(), **({} if lag is None else lag._asdict())}
        faults = {name: value for name, value in answers.items() if not math.isfinite(value)}
    except Exception as error:  # of any kind, as the code is not ours
        raise InputError(place, f"{type(error).__name__}: {error}", USABLE) from error
    limit = MOST_TORQUE * instant.facts.weight * instant.facts.radius
    for name, (low, high) in {**LIMITS, "torque": (-limit, limit), **({} if lag is None else LAG_LIMITS)}.items():
        if not low <= answers[name] <= high:
            faults[name] = answers[name]
    if faults:
        said_of = ", ".join(f"{name} {value:g}" for name, value in faults.items())
        raise InputError(place, f"{said_of} with {dict(active.values)} at {instant.speed:g} m/s", USABLE)


def new_memory(count: int) -> Array:
    """Memory of a number of effects before the first step."""
    memory = np.full(FIRST_OWN + EACH * count, math.nan)
    memory[DISTANCE] = memory[LAST_SPEED] = 0.0
    return memory


def cool_memory(memory: Array) -> Array:
    """Memory after a restart: effects' own states as after a long rest; the distance driven stays."""
    cold_memory = new_memory((len(memory) - FIRST_OWN) // EACH)
    cold_memory[DISTANCE] = memory[DISTANCE]
    return cold_memory


def new_effect_scratch(facts: VehicleConstants) -> EffectScratch:
    """Scratch memory for a vehicle, with neutral terms."""
    conditions = np.full(LOOKED_AT, math.nan)
    conditions[:FACTS] = facts
    return EffectScratch(np.array(NEUTRAL), conditions, np.full(ANSWERED, math.nan))


@kernel
def reset_terms(terms: Array) -> None:
    """Set neutral terms."""
    for term in range(TERM_COUNT):
        terms[term] = NEUTRAL[term]


@kernel
def set_conditions(
    conditions: Array,
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
    """Set the conditions that effects read; units of `Conditions`. A missing distance is integrated from the speed."""
    conditions[NOW.speed], conditions[NOW.accel], conditions[NOW.weight], conditions[NOW.ambient] = speed, accel, weight, ambient
    conditions[NOW.yaw_rate], conditions[NOW.heading], conditions[NOW.distance] = yaw_rate, heading, distance
    conditions[NOW.drive_torque] = drive_torque
    conditions[NOW.direction] = math.tanh(speed / conditions[FACT.standstill])
    conditions[NOW.belt] = belt
    turn_rate = abs(yaw_rate)
    conditions[NOW.curvature] = turn_rate / length(speed, conditions[FACT.contact_length] * turn_rate + STANDSTILL_MPS)


@kernel
def rest_effects(rows: Rows, values: Table, memory: Array, scratch: EffectScratch, ambient: float, seconds: float) -> None:
    """Relax the effects' own states for some time at rest [s]; leave the terms at its end."""
    memory[LAST_SPEED] = 0.0
    weight = scratch.conditions[FACT.weight]
    set_conditions(scratch.conditions, 0.0, 0.0, weight, ambient, math.nan, math.nan, math.nan, 0.0, math.nan)
    for dt in (0.0, seconds):  # states relax from their present values to their targets at rest
        step_effects(rows, values, memory, scratch, dt)


@kernel
def is_usable(answer: Array, most_torque: float) -> bool:
    """Whether an effect's result is a number within the limits."""
    if not abs(answer[0]) <= most_torque:
        return False
    is_within = True
    for i in range(1, LIMITED):
        is_within &= LOWEST[i] <= answer[i] <= HIGHEST[i]
    return is_within


@kernel
def is_known(needs: int, conditions: Array) -> bool:
    """Whether all that an effect needs is known."""
    has_needs = True
    for need in range(1, LOOKED_AT - FACTS):
        if needs >> need & 1 and not math.isfinite(conditions[FACTS + need - 1]):
            has_needs = False
    return has_needs


@kernel
def call_lag(function: int, conditions: Array, values: Array, answer: Array) -> bool:
    """Target, time constant and start of an effect's own state; whether they are usable."""
    for i in range(3):
        answer[i] = math.nan
    call_at(function, conditions, values, answer)
    is_valid: bool = abs(answer[0]) <= MOST_STATE and abs(answer[2]) <= MOST_STATE and LEAST_TIME_S <= answer[1] < math.inf
    return is_valid


@kernel
def relaxed_state(
    rows: Rows, values: Table, scratch: EffectScratch, row: int, state_row: Array, dt: float
) -> tuple[float, float]:
    """An effect's own state after some time [s] under the conditions set, and the share of the air in it; unchanged where they
    are unknown.
    """
    conditions, answer = scratch.conditions, scratch.answer
    conditions[NOW.own] = state_row[OWN]
    if is_known(rows[row, NEEDS], conditions) and call_lag(rows[row, LAG_AT], conditions, values[row], answer):
        share = -math.expm1(-dt / answer[1])
        return state_row[OWN] + (answer[0] - state_row[OWN]) * share, state_row[OF_AIR] + (1.0 - state_row[OF_AIR]) * share
    return state_row[OWN], state_row[OF_AIR]


@kernel
def has_state(rows: Rows, row: int, state_row: Array) -> bool:
    """Whether a row is an effect of its own with a state that has begun."""
    return bool(rows[row, KIND] < SHIFTED and rows[row, LAG_AT] != 0 and not math.isnan(state_row[OWN]))


@kernel
def pass_gap_of_effects(
    rows: Rows, values: Table, memory: Array, scratch: EffectScratch, speed: float, weight: float, ambient: float, dt: float
) -> None:
    """Pass a gap too long to bridge (ours): as `belt.pass_gap` the mean of a rest and of a drive throughout, at a speed [m/s]."""
    for row in range(rows.shape[0]):
        state_row = memory[FIRST_OWN + EACH * rows[row, STATE] :]
        if not has_state(rows, row, state_row):
            continue
        set_conditions(scratch.conditions, 0.0, 0.0, weight, ambient, math.nan, math.nan, math.nan, 0.0, math.nan)
        rested_state, rested_air = relaxed_state(rows, values, scratch, row, state_row, dt)
        set_conditions(scratch.conditions, speed, 0.0, weight, ambient, math.nan, math.nan, math.nan, 0.0, math.nan)
        driven_state, driven_air = relaxed_state(rows, values, scratch, row, state_row, dt)
        state_row[OWN], state_row[OF_AIR] = 0.5 * (rested_state + driven_state), 0.5 * (rested_air + driven_air)


@kernel
def correct_air_of_effects(
    rows: Rows,
    values: Table,
    memory: Array,
    scratch: EffectScratch,
    speed: float,
    weight: float,
    old_ambient: float,
    ambient: float,
) -> None:
    """Correct the effects' own states after the ambient temperature was corrected from one value [degC] to another.

    An effect's `lag` gives a start and a target at both temperatures. The target moves by its difference. The state moves by the
    difference of the starts, times the share of the air in the state.
    """
    conditions, answer = scratch.conditions, scratch.answer
    for row in range(rows.shape[0]):
        state_row = memory[FIRST_OWN + EACH * rows[row, STATE] :]
        if not has_state(rows, row, state_row):
            continue
        for sign in (-1.0, 1.0):
            air = ambient if sign > 0.0 else old_ambient
            set_conditions(conditions, speed, 0.0, weight, air, math.nan, math.nan, math.nan, 0.0, math.nan)
            conditions[NOW.own] = 0.0
            if is_known(rows[row, NEEDS], conditions) and call_lag(rows[row, LAG_AT], conditions, values[row], answer):
                state_row[OWN] += sign * state_row[OF_AIR] * answer[2]
                state_row[TARGET] += sign * answer[0]


@kernel
def advance_state(function: int, values: Array, conditions: Array, answer: Array, state_row: Array, dt: float) -> bool:
    """Advance an effect's own state by a step and write it for the effect; return whether it is usable."""
    conditions[NOW.own] = 0.0
    if function == 0:
        return True
    state = math.nan
    if not math.isnan(state_row[OWN]):
        share = -math.expm1(-dt / state_row[TIME_CONSTANT])
        state = state_row[OWN] + (state_row[TARGET] - state_row[OWN]) * share
        state_row[OF_AIR] += (1.0 - state_row[OF_AIR]) * share
        conditions[NOW.own] = state
    if not call_lag(function, conditions, values, answer):
        return False
    target, time_constant, start = answer[0], answer[1], answer[2]
    if math.isnan(state):
        state, state_row[OF_AIR] = start, 1.0
    state_row[OWN], state_row[TARGET], state_row[TIME_CONSTANT] = state, target, time_constant
    conditions[NOW.own] = state
    return True


@kernel
def step_effects(rows: Rows, values: Table, memory: Array, scratch: EffectScratch, dt: float) -> int:
    """All effects of a step that ends now, `dt` [s] after the one before; return `ALL_WELL`, or why one is missing in the terms.

    The conditions are set before. The terms are filled, and a missing distance by the one driven. The memory is changed.
    """
    terms, conditions, answer = scratch.terms, scratch.conditions, scratch.answer
    memory[DISTANCE] += abs(memory[LAST_SPEED]) * dt
    memory[LAST_SPEED] = conditions[NOW.speed]
    if math.isnan(conditions[NOW.distance]):
        conditions[NOW.distance] = memory[DISTANCE]
    else:
        memory[DISTANCE] = conditions[NOW.distance]
    most_torque = MOST_TORQUE * conditions[FACT.weight] * conditions[FACT.radius]
    reset_terms(terms)
    outcome = ALL_WELL
    is_inactive = False
    torque = loss_factor = drive_gain = softening = cooling = inner_resistance = 0.0
    for row in range(rows.shape[0]):
        kind = rows[row, KIND]
        if kind == SHIFTED:
            if is_inactive:
                continue
            call_terms(rows[row, TERMS_AT], conditions, values[row], answer)
            if is_usable(answer, most_torque):
                of_loss = answer[TERM.loss_factor] / loss_factor - 1.0
                if conditions[FACT.cooling] > 0.0:  # with belts: heat that stays inside counts as less cooling outside
                    of_loss -= (answer[TERM.softening] - softening) * (conditions[NOW.belt] - SOFTENING_FROM_DEGC)
                    of_inside = (answer[TERM.inner_resistance] - inner_resistance) * cooling
                    terms[TERM.cooling_variance] += squared(cooling_of(answer, conditions) / cooling - 1.0 - of_inside)
                terms[TERM.variance] += squared(answer[TERM.torque] - torque)
                terms[TERM.loss_variance] += of_loss * of_loss
                terms[TERM.gain_variance] += squared(answer[TERM.drive_gain] / drive_gain - 1.0)
            continue
        if kind == WITH_MORE_DRAG:
            if not is_inactive:
                call_with_more_drag(rows[row, TERMS_AT], conditions, values[row], answer)
                terms[TERM.by_drag_area] += answer[TERM.torque] - torque if is_usable(answer, most_torque) else 0.0
            continue
        is_inactive = True
        if not is_known(rows[row, NEEDS], conditions):
            outcome = max(outcome, INPUT_UNKNOWN)
        else:
            start = FIRST_OWN + EACH * rows[row, STATE]
            if advance_state(rows[row, LAG_AT], values[row], conditions, answer, memory[start : start + EACH], dt):
                call_terms(rows[row, TERMS_AT], conditions, values[row], answer)
                is_inactive = not is_usable(answer, most_torque)
            if is_inactive:
                outcome = UNUSABLE
        if is_inactive:
            continue
        if answer[ANSWER_EXTRAPOLATED] > 0.0:
            outcome = max(outcome, EXTRAPOLATED)
        torque, drive_gain = answer[TERM.torque], answer[TERM.drive_gain]
        loss_factor, softening = answer[TERM.loss_factor], answer[TERM.softening]
        cooling, inner_resistance = cooling_of(answer, conditions), answer[TERM.inner_resistance]
        add_terms(terms, answer)
        if kind != NOT_FED:
            terms[TERM.fed_gain] *= drive_gain
            terms[TERM.fed if kind == FED else TERM.fed_inertia] += torque
    return outcome


@kernel
def cooling_of(answer: Array, conditions: Array) -> float:
    """Conductance of one belt to its surroundings with one effect [W/K]; 0 without belts."""
    at_rest = conditions[FACT.cooling] * answer[TERM.film_offset_factor]
    by_speed = conditions[FACT.cooling_by_speed] * answer[TERM.film_slope_factor]
    return float(at_rest + by_speed * abs(conditions[NOW.speed]) + answer[TERM.conductance])


@kernel
def add_terms(terms: Array, answer: Array) -> None:
    """Add the terms of one effect to the total, as `Terms.with_`."""
    for term in ADDED:
        terms[term] += answer[term]
    for term in MULTIPLIED:
        terms[term] *= answer[term]
    if answer[TERM.conductance] > 0.0:
        terms[TERM.conductance] += answer[TERM.conductance]
        terms[TERM.sink] += answer[TERM.conductance] / terms[TERM.conductance] * (answer[TERM.sink] - terms[TERM.sink])


@kernel
def call_with_more_drag(function: int, conditions: Array, values: Array, answer: Array) -> None:
    """Terms of an effect of a vehicle whose drag area is a square metre larger."""
    area = conditions[FACT.drag_area]
    conditions[FACT.drag_area] = area + 1.0
    call_terms(function, conditions, values, answer)
    conditions[FACT.drag_area] = area


@kernel
def call_terms(function: int, conditions: Array, values: Array, answer: Array) -> None:
    """Terms of an effect; nan where it does not fill in a term."""
    for i in range(LIMITED):
        answer[i] = math.nan
    call_at(function, conditions, values, answer)
