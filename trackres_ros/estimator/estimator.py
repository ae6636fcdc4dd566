"""The estimator: frozen inputs, state and results; a pure step; and a session that takes messages as they come."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trackres_ros.effects.effect import Conditions
from trackres_ros.effects.facts import facts_of
from trackres_ros.estimator import layout as at
from trackres_ros.estimator.constants import Constants, kernel_arguments, make_constants
from trackres_ros.estimator.effects_step import LAST_SPEED, EffectsStep
from trackres_ros.estimator.effects_step import cooled as cooled_effects
from trackres_ros.estimator.effects_step import new_memory as new_effects_memory
from trackres_ros.estimator.guards import Memory, new_memory
from trackres_ros.estimator.kernel import Inputs
from trackres_ros.estimator.session import COMPILED, Entries
from trackres_ros.estimator.settings import Settings
from trackres_ros.vehicle import Vehicle

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """What is carried from step to step; see `layout` and `belt_step` for what stands where. Not to be changed."""

    belts: Array  # (assemblies, 2, BELT_COLUMNS)
    motion: Array  # (MOTION_COLUMNS,)
    effects: Array = field(default_factory=lambda: new_effects_memory(0))  # see `effects_step`


class Estimate:
    """One row of results by name: torques [Nm] positive where they resist forward travel, temperatures [degC].

    Every name of `layout.columns` works as a key, `estimate["belt_degc/front_left"]`; the most used are attributes.
    """

    __slots__ = ("index", "row")

    def __init__(self, row: Array, index: Mapping[str, int]) -> None:
        self.row = row
        self.index = index

    def __getitem__(self, name: str) -> float:
        return float(self.row[self.index[name]])

    @property
    def resistance_torque_nm(self) -> float:
        """Hysteresis, bearings and wind, whole vehicle, at the sprockets [Nm]."""
        return float(self.row[at.OUT_RESISTANCE])

    @property
    def resistance_std_nm(self) -> float:
        """Standard deviation of the resistance torque [Nm]."""
        return float(self.row[at.OUT_STD])

    @property
    def feedforward_torque_nm(self) -> float:
        """Chosen parts, limited in rate and size [Nm]."""
        return float(self.row[at.OUT_FEEDFORWARD])

    @property
    def reasons(self) -> at.Reason:
        """Why the status is not plainly good."""
        return at.Reason(int(self.row[at.OUT_REASONS]))

    @property
    def status(self) -> str:
        """`ok`, or `warn` where a reason matters to who uses the torque."""
        return "warn" if self.reasons & ~at.HARMLESS else "ok"

    def reason_texts(self) -> list[str]:
        """One sentence for each reason."""
        return [text for reason, text in at.REASON_TEXT.items() if reason & self.reasons]

    def belt_degc(self) -> Array:
        """Mean belt temperature of each assembly [degC]."""
        return self._of_assemblies(at.PER_BELT)

    def belt_std_k(self) -> Array:
        """Standard deviation of each of them [K]."""
        return self._of_assemblies(at.PER_STD)

    def _of_assemblies(self, column: int) -> Array:
        return self.row[len(at.VEHICLE_COLUMNS) + column :: len(at.ASSEMBLY_COLUMNS)]


@dataclass(frozen=True, eq=False)
class Steps:
    """Results of a block of messages: one row a step."""

    stamp_ns: IntArray
    arrival_ns: IntArray
    rows: Array  # (steps, columns)


class Estimator:
    """Resistance torque and belt temperatures of one vehicle; holds what never changes, so one serves many sessions.

    Examples
    --------
    >>> from trackres_ros.vehicle import load
    >>> estimator = Estimator(load("xgd24d"))
    >>> inputs = estimator.inputs(speed=50 / 3.6, ambient=15.0)
    >>> state = estimator.cold_start(inputs)
    >>> state, estimate = estimator.step(state, inputs, 0.1)
    >>> 3500 < estimate.resistance_torque_nm < 3700
    True
    """

    def __init__(
        self, vehicle: Vehicle, settings: Settings | None = None, cache: Path | None = None, entries: Entries = COMPILED
    ) -> None:
        self.vehicle = vehicle
        self.settings = settings or Settings()
        self.entries = entries
        self.constants: Constants = make_constants(vehicle, self.settings, cache)
        self.kernel_arguments = kernel_arguments(self.constants, entries.compiled)
        self.assemblies = tuple(a.name for a in vehicle.assemblies)
        self.channels = at.channels(vehicle)
        self.columns = at.columns(vehicle)
        self.column_index = {name: i for i, name in enumerate(self.columns)}
        self._no_belts = np.full(len(self.assemblies), math.nan)
        self.effects = EffectsStep(vehicle.effects, vehicle.surroundings, facts_of(vehicle))

    def inputs(
        self,
        speed: float,
        weight: float | None = None,
        ambient: float | None = None,
        belt_measured: Array | None = None,
        load: Array | None = None,
        acceleration: float = math.nan,
        grade: float = math.nan,
        measured_torque: float = math.nan,
    ) -> Inputs:
        """Inputs of a step from what is known, the rest nominal.

        Parameters
        ----------
        speed
            [m/s].
        weight, load
            Whole weight [N], shared as nominal; or the load of each assembly, shape (assemblies,).
        ambient
            [degC].
        belt_measured
            New belt temperatures [degC], nan where there is none.
        acceleration, grade, measured_torque
            [m/s^2], rise over run, and [Nm]; nan where not known.
        """
        k = self.constants
        loads = k.assembly[:, at.NOMINAL_LOAD].copy() if load is None else np.asarray(load, dtype=float)
        if weight is not None:
            loads = weight * (k.assembly[:, at.SHARE_OF_ALL] if load is None else loads / loads.sum())
        return Inputs(
            float(speed),
            loads,
            k.number.nominal_ambient if ambient is None else float(ambient),
            k.number.ambient_unknown_std if ambient is None else k.number.ambient_std,
            self._no_belts if belt_measured is None else np.asarray(belt_measured, dtype=float),
            float(acceleration),
            float(grade),
            float(measured_torque),
        )

    def cold_start(self, inputs: Inputs, belt_degc: float | None = None, belt_std_k: float | None = None) -> State:
        """State of belts that are at the ambient temperature, or at a known one [degC] with a standard deviation [K]."""
        memory = new_effects_memory(len(self.effects.effects))
        state = State(np.empty((len(self.assemblies), 2, at.BELT_COLUMNS)), np.empty(at.MOTION_COLUMNS), memory)
        self.entries.start_belts(*self.kernel_arguments, state.belts, state.motion, inputs.ambient, inputs.ambient_std)
        if belt_degc is not None:
            state.belts[:, :, at.TEMPERATURE] = belt_degc
            state.belts[:, :, at.DOUBT_AMBIENT] = 0.0
        if belt_std_k is not None:
            state.belts[:, :, at.NOISE_1] = belt_std_k
        return state

    def step(self, state: State, inputs: Inputs, dt: float) -> tuple[State, Estimate]:
        """Advance by dt [s] to the time of `inputs`. Pure: the state given is left as it was."""
        belts, motion, row = state.belts.copy(), state.motion.copy(), np.empty(len(self.columns))
        effects, arguments = state.effects, self.kernel_arguments
        if self.effects.effects:
            arguments = (*arguments[:-1], arguments[-1].copy())
            now = self._conditions(inputs, motion)
            effects = self.effects.step(effects, now, float(dt), arguments[-1])
        self.entries.step_once(
            *arguments,
            belts,
            motion,
            inputs.speed,
            inputs.load,
            inputs.ambient,
            inputs.ambient_std,
            inputs.belt_measured,
            inputs.acceleration,
            inputs.grade,
            inputs.measured_torque,
            inputs.reasons,
            float(dt),
            row,
        )
        return State(belts, motion, effects), Estimate(row, self.column_index)

    def _conditions(self, inputs: Inputs, motion: Array) -> Conditions:
        accel = inputs.acceleration if math.isfinite(inputs.acceleration) else float(motion[at.FILTERED_ACCEL])
        return Conditions(
            self.effects.facts, inputs.speed, accel, float(inputs.load.sum()), inputs.ambient, math.nan, math.nan, math.nan,
            float(motion[at.LAST_DRIVE]),
        )  # fmt: skip

    def run(
        self,
        state: State,
        time_s: Array,
        speed: Array,
        weight: ArrayLike,
        ambient: ArrayLike,
        acceleration: ArrayLike = math.nan,
        grade: ArrayLike = math.nan,
    ) -> tuple[State, Array]:
        """`step` along a whole series: the same numbers, without a call for each.

        Parameters
        ----------
        state
            State at the first time.
        time_s, speed
            Rising times [s] and speeds [m/s], shape (times,).
        weight, ambient, acceleration, grade
            Whole weight [N], ambient temperature [degC], acceleration [m/s^2] and grade, each a number or shape (times,); nan
            where the last two are unknown.

        Returns
        -------
        state, rows
            State at the last time; results, shape (times, columns).
        """
        times = np.ascontiguousarray(time_s, dtype=float)
        if self.effects.effects:
            return self._run_step_by_step(state, times, speed, weight, ambient, acceleration, grade)
        series = [
            np.ascontiguousarray(np.broadcast_to(np.asarray(a, dtype=float), times.shape)).copy()
            for a in (speed, weight, ambient, acceleration, grade)
        ]
        belts, motion = state.belts.copy(), state.motion.copy()
        rows = np.empty((len(times), len(self.columns)))
        number = self.constants.number
        self.entries.run_series(
            *self.kernel_arguments,
            belts,
            motion,
            times,
            series[0],
            series[1],
            series[2],
            number.ambient_std,
            series[3],
            series[4],
            np.empty(len(self.assemblies)),
            self._no_belts,
            rows,
        )
        return State(belts, motion), rows

    def _run_step_by_step(self, state: State, times: Array, *given: ArrayLike) -> tuple[State, Array]:
        series = [np.broadcast_to(np.asarray(a, dtype=float), times.shape) for a in given]
        rows = np.empty((len(times), len(self.columns)))
        for i, (v, w, ambient, accel, grade) in enumerate(zip(*series, strict=True)):
            inputs = self.inputs(v, weight=w, ambient=ambient, acceleration=accel, grade=grade)
            state, estimate = self.step(state, inputs, times[i] - times[i - 1] if i else 0.0)
            rows[i] = estimate.row
        return state, rows

    def rest(self, state: State, ambient: float, seconds: float) -> State:
        """The state after standing, or being switched off, for a while at an ambient temperature [degC]."""
        belts, motion = state.belts.copy(), state.motion.copy()
        self.entries.rest_belts(
            *self.kernel_arguments, belts, float(ambient), self.constants.number.ambient_unknown_std, float(seconds)
        )
        motion[at.FEEDFORWARD] = motion[at.FEEDFORWARD_TARGET] = motion[at.ROLLS] = 0.0
        effects = state.effects
        if self.effects.effects and seconds > 0.0:
            nothing = np.array(at.NO_TERMS)
            still = replace(self._conditions(self.inputs(0.0, ambient=ambient), motion), drive_torque=0.0)
            effects = effects.copy()
            effects[LAST_SPEED] = 0.0
            effects = self.effects.step(self.effects.step(effects, still, 0.0, nothing), still, seconds, nothing)
        return State(belts, motion, effects)

    def session(self) -> Session:
        """A new session: a stream of messages through the guards."""
        return Session(self)


class Session:
    """One stream of messages: guards, state and counters. `handle` takes one message, `handle_block` many, with equal results."""

    def __init__(self, estimator: Estimator) -> None:
        self.estimator = estimator
        assemblies = len(estimator.assemblies)
        self.memory: Memory = new_memory(len(estimator.channels))
        self.belts = np.zeros((assemblies, 2, at.BELT_COLUMNS))
        self.motion = np.zeros(at.MOTION_COLUMNS)
        self.effects = new_effects_memory(len(estimator.effects.effects))
        self._terms = np.array(at.NO_TERMS)
        self._loads = np.zeros(assemblies)
        self._arguments = (
            *estimator.kernel_arguments[:-1],
            self._terms,
            *self.memory,
            self.belts,
            self.motion,
            self._loads,
            np.zeros(assemblies),
        )
        self._channel = {name: i for i, name in enumerate(estimator.channels)}

    @property
    def started(self) -> bool:
        """Whether a speed was accepted yet."""
        return bool(self.motion[at.STARTED] > 0.0)

    @property
    def state(self) -> State:
        """A copy of the state now."""
        return State(self.belts.copy(), self.motion.copy(), self.effects.copy())

    def begin(self, state: State) -> None:
        """Begin from a known state instead of a cold start."""
        self.belts[:], self.motion[:] = state.belts, state.motion
        if len(state.effects) == len(self.effects):
            self.effects = state.effects.copy()
        self.motion[at.STARTED] = 0.5

    def adopt(self, other: Session) -> None:
        """Go on where another session of the same vehicle is: all it remembers, under this one's settings."""
        self.belts[:], self.motion[:], self._loads[:] = other.belts, other.motion, other._loads
        self.effects = other.effects.copy()
        for mine, its in zip(self.memory, other.memory, strict=True):
            mine[:] = its

    def start_anew(self, time_went_back: bool) -> None:
        """Forget belts and messages, as at a cold start; counters stay. The next estimate says so if time went back."""
        self.memory.times[:], self.memory.values[:] = 0, math.nan
        self.effects = cooled_effects(self.effects)
        self.motion[at.STARTED] = at.START_ANEW if time_went_back else 0.0

    def channel(self, name: str) -> int:
        """Index of a channel by its name, such as `speed` or `load/front`; KeyError if the vehicle has none of that name."""
        return self._channel[name]

    def handle(self, channel: int, stamp_ns: int, arrival_ns: int, value: float) -> Estimate | None:
        """Take in one message; an estimate if it was an accepted speed, else None."""
        row = np.empty(len(self.estimator.columns))
        effects = self._effects_by(channel, stamp_ns, arrival_ns, value) if self.estimator.effects.effects else self.effects
        stepped = self.estimator.entries.feed_one(*self._arguments, channel, stamp_ns, arrival_ns, value, row)
        if not stepped:
            return None
        self.effects = effects
        return Estimate(row, self.estimator.column_index)

    def _effects_by(self, channel: int, stamp_ns: int, arrival_ns: int, value: float) -> Array:
        """Prepare the terms of the step that a speed would make; the effects' memory after it, should it be accepted."""
        if channel != at.SPEED or not math.isfinite(value):
            return self.effects
        k, times = self.estimator.constants, self.memory.times

        def held(which: int, hold_ns: int, otherwise: float) -> float:
            fresh = times[which, at.SEEN] and arrival_ns - times[which, at.LAST_ARRIVAL] <= hold_ns
            return float(self.memory.values[which]) if fresh else otherwise

        number = k.number
        weight = float(self._loads.sum()) or float(k.assembly[:, at.NOMINAL_LOAD].sum())
        accel = held(at.ACCEL, number.motion_hold_ns, float(self.motion[at.FILTERED_ACCEL]))
        ambient = held(at.AMBIENT, number.ambient_hold_ns, number.nominal_ambient)
        turning = held(at.YAW_RATE, number.motion_hold_ns, math.nan), held(at.HEADING, number.motion_hold_ns, math.nan)
        drive = float(self.motion[at.LAST_DRIVE])
        now = Conditions(self.estimator.effects.facts, value, accel, weight, ambient, *turning, math.nan, drive)
        elapsed = (stamp_ns - times[at.SPEED, at.LAST_STAMP]) * 1e-9 if times[at.SPEED, at.SEEN] else 0.0
        if not 0.0 <= elapsed <= number.bridge:  # a jump or a long gap: how it went is not known, least of all by the stamps
            elapsed = 0.0
        return self.estimator.effects.step(self.effects, now, elapsed, self._terms)

    def handle_block(self, channel: NDArray[np.int16], stamp_ns: IntArray, arrival_ns: IntArray, value: Array) -> Steps:
        """Take in many messages, arrays of shape (messages,) in the order they arrived."""
        if self.estimator.effects.effects:
            return self._one_by_one(channel, stamp_ns, arrival_ns, value)
        most = int(np.count_nonzero(channel == at.SPEED))
        rows = np.empty((most + 1, len(self.estimator.columns)))
        stamps, arrivals = np.empty((2, most + 1), dtype=np.int64)
        steps = self.estimator.entries.feed_many(*self._arguments, channel, stamp_ns, arrival_ns, value, rows, stamps, arrivals)
        return Steps(stamps[:steps], arrivals[:steps], rows[:steps])

    def _one_by_one(self, channel: NDArray[np.int16], stamp_ns: IntArray, arrival_ns: IntArray, value: Array) -> Steps:
        stamps, arrivals, rows = [], [], []
        for message in zip(channel.tolist(), stamp_ns.tolist(), arrival_ns.tolist(), value.tolist(), strict=True):
            estimate = self.handle(*message)
            if estimate is not None:
                stamps.append(int(self.memory.times[at.SPEED, at.LAST_STAMP]))
                arrivals.append(message[2])
                rows.append(estimate.row)
        columns = len(self.estimator.columns)
        return Steps(np.array(stamps, np.int64), np.array(arrivals, np.int64), np.array(rows).reshape(-1, columns))

    def counts(self) -> Iterator[tuple[str, at.Count, int]]:
        """All counters that are not zero: channel, counter, number."""
        for i, name in enumerate(self.estimator.channels):
            for count in at.Count:
                if self.memory.counters[i, count]:
                    yield name, count, int(self.memory.counters[i, count])

    def reason_counts(self) -> dict[at.Reason, int]:
        """Each reason that held, and at how many steps."""
        return {reason: int(number) for reason, number in zip(at.REASON_TEXT, self.memory.reasons, strict=True) if number}
