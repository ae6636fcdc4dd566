# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Makes effects callable from the compiled step: each is a machine function of one signature, called by its address.

An effect is a Python file; the step is compiled once. They are connected by a table. It has a row for each effect with the
addresses of its `terms` and `lag`, and a row of values of its parameters. A function that cannot be compiled, such as a user's,
has an address too, and runs in plain Python.
"""

from __future__ import annotations

import ctypes
import hashlib
import math
from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module
from types import FunctionType
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from trackres_ros.effects.effect import Active, Conditions, Effect, Lag, Terms, VehicleConstants, values_type
from trackres_ros.jit.arithmetic import length, squared
from trackres_ros.jit.code_cache import CodeCache
from trackres_ros.jit.compiled import HAVE_NUMBA, code_folder, compiled, compiled_anew, inlined
from trackres_ros.units import STANDSTILL_MPS

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

# One row of the table of effects: which effect's own state, its kind (see below), its required inputs, and its two addresses.
STATE, KIND, NEEDS, TERMS_AT, LAG_AT = range(5)
ROW = 5
# Kinds. Fed forward is what belongs to the vehicle; what comes with an acceleration only where that is. A shifted row is the row
# above it with one parameter a standard deviation off: it moves nothing and gives the effect's variance.
UNFED, FED, FED_WITH_ACCEL, SHIFTED = range(4)

# Work space of a step: what effects look at, the facts first; then what one of them answers.
FACTS, ANSWERED = len(VehicleConstants._fields), len(Terms._fields)
LOOKED_AT = FACTS + len(Conditions._fields) - 1
(
    AT_SPEED,
    AT_ACCEL,
    AT_WEIGHT,
    AT_AMBIENT,
    AT_YAW_RATE,
    AT_HEADING,
    AT_DISTANCE,
    AT_DRIVE_TORQUE,
    AT_DIRECTION,
    AT_CURVATURE,
    AT_BELT,
    AT_OWN,
) = range(FACTS, LOOKED_AT)
RADIUS, WEIGHT, CONTACT_LENGTH, STANDSTILL = (
    VehicleConstants._fields.index(name) for name in ("radius", "weight", "contact_length", "standstill")
)
if Conditions._fields[1:] != (
    "speed", "accel", "weight", "ambient", "yaw_rate", "heading", "distance", "drive_torque", "direction", "curvature",
    "belt", "own",
):  # fmt: skip
    raise TypeError("Conditions has other fields than the work space of a step")

# What effects do together in a step. The first are those of `Terms`; fed forward are only the vehicle's own: torque, gain, and
# the torque that comes with an acceleration. Variances are of torque [Nm^2], and relative ones of loss and of driving torque.
(
    TERM_TORQUE,
    TERM_DRIVE_GAIN,
    TERM_LOSS_FACTOR,
    TERM_SOFTENING,
    TERM_FILM_OFFSET,
    TERM_FILM_SLOPE,
    TERM_CONDUCTANCE,
    TERM_SINK,
    TERM_HEAT,
    TERM_INNER_RESISTANCE,
    TERM_FED,
    TERM_FED_GAIN,
    TERM_FED_INERTIA,
    TERM_VARIANCE,
    TERM_LOSS_VARIANCE,
    TERM_GAIN_VARIANCE,
) = range(16)
TERMS = 16
NO_TERMS = (0.0, 1.0, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0)
WORK = TERMS + LOOKED_AT + ANSWERED

# What is remembered: distance [m], speed of the last step [m/s]; then of each effect its own state, its target and time constant.
DISTANCE, LAST_SPEED, FIRST_OWN = range(3)
OWN, TARGET, TIME_CONSTANT = range(3)
EACH = 3

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
SOFTENED_OVER_K = 20.0  # assumed distance of a belt from the temperature about which a softening turns

# Outcome of the effects of a step: all well; one is outside the range in which it was learned; an input of one is not known; one
# gives no number, or one outside of the limits.
ALL_WELL, EXTRAPOLATED, INPUT_UNKNOWN, UNUSABLE = range(4)
ANSWER_EXTRAPOLATED = Terms._fields.index("extrapolated")

ANSWERS = {"terms": ANSWERED, "lag": len(Lag._fields)}
CALL = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)


class EffectTable(NamedTuple):
    """Effects ready for the step."""

    rows: IntArray  # (rows, ROW)
    values: Array  # (rows, most parameters)


def effect_table(
    of_vehicle: Sequence[Active], of_surroundings: Sequence[Active] = (), with_uncertainty: bool = True, machine: bool = True
) -> EffectTable:
    """The effects of a vehicle, which are fed forward, and of its surroundings, with or without their variances; as machine code,
    or in plain Python to save compiling.
    """
    rows: list[tuple[int, ...]] = []
    values: list[tuple[float, ...]] = []
    for state, active in enumerate((*of_vehicle, *of_surroundings)):
        effect = active.effect
        fed = FED_WITH_ACCEL if "accel" in effect.needs else FED
        needs = sum(1 << Conditions._fields.index(need) for need in effect.needs)
        addresses = native(effect, machine)
        rows.append((state, fed if state < len(of_vehicle) else UNFED, needs, *addresses))
        values.append(active.numbers)
        for other in active.shifted() if with_uncertainty else ():
            rows.append((state, SHIFTED, needs, *addresses))
            values.append(other.numbers)
    table = np.zeros((len(rows), max((len(row) for row in values), default=0)))
    for i, row in enumerate(values):
        table[i, : len(row)] = row
    return EffectTable(np.array(rows, dtype=np.int64).reshape(-1, ROW), table)


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


@inlined
def neutral(work: Array) -> None:
    """Neutral terms."""
    for i in range(TERMS):
        work[i] = NO_TERMS[i]


@inlined
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


@compiled
def rest_effects(rows: IntArray, values: Array, memory: Array, work: Array, ambient: float, seconds: float) -> None:
    """Relax the effects' own states for some time at rest [s]; leave the terms at its end."""
    memory[LAST_SPEED] = 0.0
    look(work, 0.0, 0.0, work[TERMS + WEIGHT], ambient, math.nan, math.nan, math.nan, 0.0, math.nan)
    for dt in (0.0, seconds):  # states relax from their present values to their targets at rest
        step_effects(rows, values, memory, work, dt)


@inlined
def usable(answer: Array, most_torque: float) -> bool:
    """Whether an effect's result is a number within the limits."""
    if not abs(answer[0]) <= most_torque:
        return False
    within = True
    for i in range(1, LIMITED):
        within &= LOWEST[i] <= answer[i] <= HIGHEST[i]
    return within


@inlined
def own_state(address: int, values: Array, looked_at: Array, answer: Array, own: Array, dt: float) -> bool:
    """Advance an effect's own state by a step and write it for the effect; return whether it is usable."""
    looked_at[AT_OWN] = 0.0
    if address == 0:
        return True
    state = math.nan
    if not math.isnan(own[OWN]):
        state = own[OWN] + (own[TARGET] - own[OWN]) * -math.expm1(-dt / own[TIME_CONSTANT])
        looked_at[AT_OWN] = state
    for i in range(3):
        answer[i] = math.nan
    call_at(address, looked_at, values, answer)
    target, time_constant, start = answer[0], answer[1], answer[2]
    if not (abs(target) <= MOST_STATE and abs(start) <= MOST_STATE and LEAST_TIME_S <= time_constant < math.inf):
        return False
    if math.isnan(state):
        state = start
    own[OWN], own[TARGET], own[TIME_CONSTANT] = state, target, time_constant
    looked_at[AT_OWN] = state
    return True


@compiled
def step_effects(rows: IntArray, values: Array, memory: Array, work: Array, dt: float) -> int:
    """All effects of a step that ends now, `dt` [s] after the one before.

    Parameters
    ----------
    rows, values
        See `EffectTable`.
    memory
        See `new_memory`; changed.
    work
        See `new_work`, with the known values; its terms are filled. A missing distance is filled with the one driven.

    Returns
    -------
    int
        `ALL_WELL`, or why an effect is missing in the terms.
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
    torque = loss_factor = drive_gain = softening = 0.0
    for row in range(rows.shape[0]):
        kind = rows[row, KIND]
        if kind == SHIFTED:
            if left_out:
                continue
            call_terms(rows[row, TERMS_AT], looked_at, values[row], answer)
            if usable(answer, most_torque):
                of_loss = answer[TERM_LOSS_FACTOR] / loss_factor - 1.0 + (answer[TERM_SOFTENING] - softening) * SOFTENED_OVER_K
                work[TERM_VARIANCE] += squared(answer[TERM_TORQUE] - torque)
                work[TERM_LOSS_VARIANCE] += of_loss * of_loss
                work[TERM_GAIN_VARIANCE] += squared(answer[TERM_DRIVE_GAIN] / drive_gain - 1.0)
            continue
        left_out = True
        for need in range(1, LOOKED_AT - FACTS):
            if rows[row, NEEDS] >> need & 1 and not math.isfinite(looked_at[FACTS + need - 1]):
                outcome = max(outcome, INPUT_UNKNOWN)
                break
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
        add_terms(work, answer)
        if kind != UNFED:
            work[TERM_FED_GAIN] *= drive_gain
            work[TERM_FED if kind == FED else TERM_FED_INERTIA] += torque
    return outcome


@inlined
def add_terms(work: Array, answer: Array) -> None:
    """Add the terms of one effect to the total, as `Terms.with_`."""
    for term in (TERM_TORQUE, TERM_SOFTENING, TERM_HEAT, TERM_INNER_RESISTANCE):
        work[term] += answer[term]
    for term in (TERM_DRIVE_GAIN, TERM_LOSS_FACTOR, TERM_FILM_OFFSET, TERM_FILM_SLOPE):
        work[term] *= answer[term]
    if answer[TERM_CONDUCTANCE] > 0.0:
        work[TERM_CONDUCTANCE] += answer[TERM_CONDUCTANCE]
        work[TERM_SINK] += answer[TERM_CONDUCTANCE] / work[TERM_CONDUCTANCE] * (answer[TERM_SINK] - work[TERM_SINK])


@inlined
def call_terms(address: int, looked_at: Array, values: Array, answer: Array) -> None:
    """Terms of an effect; nan where it does not fill in a term."""
    for i in range(LIMITED):
        answer[i] = math.nan
    call_at(address, looked_at, values, answer)


def call_at(address: int, looked_at: Array, values: Array, answer: Array) -> None:
    """Call the function at an address; compiled code does so without leaving itself."""
    CALL(int(address))(looked_at.ctypes.data, values.ctypes.data, answer.ctypes.data)


def native(effect: Effect, machine: bool = True) -> tuple[int, int]:
    """Addresses of an effect's `terms` and `lag`, 0 without one; of machine code, if allowed and possible."""
    return _address(effect, "terms", machine), _address(effect, "lag", machine) if effect.has_lag else 0


def is_compiled(effect: Effect) -> bool:
    """Whether the step calls machine code for an effect, not plain Python."""
    methods = ("terms", "lag") if effect.has_lag else ("terms",)
    return all(_machine_code(effect, method) is not None for method in methods)


def _address(effect: Effect, method: str, machine: bool) -> int:
    code = _machine_code(effect, method) if machine else None
    if code is not None:
        return int(code.address)
    return ctypes.cast(_callback(effect, method), ctypes.c_void_p).value or 0


def _machine_code(effect: Effect, method: str) -> Any:
    """Machine code of an effect's method; None without numba, or if it cannot be compiled."""
    return _machine(type(effect), method, tuple(q.name for q in effect.parameters)) if HAVE_NUMBA else None


@cache
def _callback(effect: Effect, method: str) -> Any:
    """An effect's method in plain Python as a machine function. It is kept: its address may be in any table."""
    return CALL(_python_function(effect, method, ANSWERS[method]))


def _python_function(effect: Effect, method: str, answered: int) -> Callable[[int, int, int], None]:
    """An effect's method behind the signature of machine code; after a failure the result is nan."""
    run, pack, count = getattr(effect, method), effect.pack, len(effect.parameters)
    given, wanted, out = (ctypes.c_double * n for n in (LOOKED_AT, count, answered))

    def call(looked_at_: int, values_: int, answer_: int) -> None:
        try:
            known = given.from_address(looked_at_)[:]
            answer = run(Conditions(VehicleConstants(*known[:FACTS]), *known[FACTS:]), pack(*wanted.from_address(values_)))
            if answer is None:  # no own state after all
                answer = Lag(0.0, 1.0, 0.0)
            out.from_address(answer_)[:] = [float(x) for x in answer]
        except Exception:  # of any kind, as the code is not ours
            out.from_address(answer_)[:] = [math.nan] * answered

    return call


if HAVE_NUMBA:
    ir: Any = import_module("llvmlite.ir")
    numba: Any = import_module("numba")
    extending: Any = import_module("numba.extending")
    ccallback: Any = import_module("numba.core.ccallback")
    sigutils: Any = import_module("numba.core.sigutils")

    _POINTER = numba.types.CPointer(numba.types.float64)
    _SIGNATURE = sigutils.normalize_signature(numba.types.void(_POINTER, _POINTER, _POINTER))

    @extending.intrinsic  # type: ignore[untyped-decorator]
    def _call(typing: Any, address: Any, looked_at: Any, values: Any, answer: Any) -> Any:  # noqa: ARG001
        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:  # noqa: ARG001
            pointer = ir.IntType(8).as_pointer()
            kind = ir.FunctionType(ir.VoidType(), [pointer] * 3)
            function = builder.inttoptr(given[0], kind.as_pointer())
            builder.call(function, [builder.inttoptr(each, pointer) for each in given[1:]])
            return context.get_dummy_value()

        return numba.types.void(address, looked_at, values, answer), generate

    @extending.overload(call_at)  # type: ignore[untyped-decorator]
    def _call_at(address: Any, looked_at: Any, values: Any, answer: Any) -> Any:  # noqa: ARG001
        def call(address: Any, looked_at: Any, values: Any, answer: Any) -> Any:
            _call(address, looked_at.ctypes.data, values.ctypes.data, answer.ctypes.data)

        return call

    @compiled
    def _terms(
        torque: float = 0.0,
        drive_gain: float = 1.0,
        loss_factor: float = 1.0,
        softening: float = 0.0,
        film_offset_factor: float = 1.0,
        film_slope_factor: float = 1.0,
        conductance: float = 0.0,
        sink: float = 0.0,
        heat: float = 0.0,
        inner_resistance: float = 0.0,
        speed_factor: float = 1.0,
        sensor_gain: float = 1.0,
        sensor_offset: float = 0.0,
        sensor_delay: float = 0.0,
        extrapolated: float = 0.0,
    ) -> Terms:
        """`Terms` with its defaults, which compiled code lacks."""
        return Terms(
            float(torque), float(drive_gain), float(loss_factor), float(softening), float(film_offset_factor),
            float(film_slope_factor), float(conductance), float(sink), float(heat), float(inner_resistance),
            float(speed_factor), float(sensor_gain), float(sensor_offset), float(sensor_delay), float(extrapolated),
        )  # fmt: skip

    @cache
    def _machine(kind: type[Effect], method: str, names: tuple[str, ...]) -> Any:
        """A method of an effect as a machine function; None if that is impossible, as for some users' effects."""
        try:
            return _compile(kind, method, names, ANSWERS[method])
        except Exception:
            if kind.__module__.startswith(f"{__package__}."):
                raise
            return None

    def _compile(kind: type[Effect], method: str, names: tuple[str, ...], answered: int) -> Any:
        python = getattr(kind, method)
        inner = compiled_anew(FunctionType(python.__code__, {**python.__globals__, "Terms": _terms}, python.__name__))
        known = ", ".join(f"x[{i}]" for i in range(FACTS, LOOKED_AT))
        lines = [
            "def call(x_, p_, out_):",
            f"    x, p, out = carray(x_, {LOOKED_AT}), carray(p_, {len(names)}), carray(out_, {answered})",
            f"    at = Conditions(VehicleConstants({', '.join(f'x[{i}]' for i in range(FACTS))}), {known})",
            f"    found = run(None, at, pack({', '.join(f'p[{i}]' for i in range(len(names)))}))",
            *(f"    out[{i}] = found[{i}]" for i in range(answered)),
        ]
        namespace: dict[str, Any] = {"carray": numba.carray, "Conditions": Conditions, "run": inner}
        namespace["VehicleConstants"] = VehicleConstants
        namespace["pack"] = values_type(names)
        exec("\n".join(lines), namespace)
        function = cast(FunctionType, namespace["call"])
        # The name distinguishes codes in the cache: the catalogue is part of its folder's name, a user's file is not.
        known_as = repr((python.__code__.co_filename, python.__code__.co_code, python.__code__.co_consts, _frozen(python)))
        function.__module__ = __name__
        function.__qualname__ = f"{kind.__name__}.{method}.{hashlib.sha256(known_as.encode()).hexdigest()[:16]}"
        found = ccallback.CFunc(function, _SIGNATURE, locals={}, options={"nopython": True, "error_model": "numpy"})
        if kind.__module__.startswith(f"{__package__}.") or _frozen(python) is not None:
            found._cache = CodeCache(function, code_folder)
        found.compile()
        return found

    def _frozen(python: FunctionType) -> list[tuple[str, Any]] | None:
        """Constants of its file that are part of a function's code; None if there are others than plain numbers and `math`."""
        used = {name: python.__globals__[name] for name in python.__code__.co_names if name in python.__globals__}
        numbers = {name: value for name, value in used.items() if isinstance(value, int | float)}
        others = [value for name, value in used.items() if name not in numbers]
        return sorted(numbers.items()) if all(value in (math, np, Terms, Lag) for value in others) else None
