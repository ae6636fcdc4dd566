"""The estimator: frozen inputs, state and results; a pure step; and a session that takes messages as they come."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trackres_ros.estimator import layout as at
from trackres_ros.estimator.constants import Constants, kernel_arguments, make_constants
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
        state = State(np.empty((len(self.assemblies), 2, at.BELT_COLUMNS)), np.empty(at.MOTION_COLUMNS))
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
        self.entries.step_once(
            *self.kernel_arguments,
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
        return State(belts, motion), Estimate(row, self.column_index)

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

    def rest(self, state: State, ambient: float, seconds: float) -> State:
        """The state after standing, or being switched off, for a while at an ambient temperature [degC]."""
        belts, motion = state.belts.copy(), state.motion.copy()
        self.entries.rest_belts(
            *self.kernel_arguments, belts, float(ambient), self.constants.number.ambient_unknown_std, float(seconds)
        )
        motion[at.FEEDFORWARD] = 0.0
        return State(belts, motion)

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
        self._arguments = (
            *estimator.kernel_arguments,
            *self.memory,
            self.belts,
            self.motion,
            np.zeros(assemblies),
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
        return State(self.belts.copy(), self.motion.copy())

    def begin(self, state: State) -> None:
        """Begin from a known state instead of a cold start."""
        self.belts[:], self.motion[:] = state.belts, state.motion
        self.motion[at.STARTED] = 0.5

    def adopt(self, other: Session) -> None:
        """Go on where another session of the same vehicle is: all it remembers, under this one's settings."""
        self.belts[:], self.motion[:] = other.belts, other.motion
        for mine, its in zip(self.memory, other.memory, strict=True):
            mine[:] = its

    def start_anew(self, time_went_back: bool) -> None:
        """Forget belts and messages, as at a cold start; counters stay. The next estimate says so if time went back."""
        self.memory.times[:], self.memory.values[:] = 0, math.nan
        self.motion[at.STARTED] = at.START_ANEW if time_went_back else 0.0

    def channel(self, name: str) -> int:
        """Index of a channel by its name, such as `speed` or `load/front`; KeyError if the vehicle has none of that name."""
        return self._channel[name]

    def handle(self, channel: int, stamp_ns: int, arrival_ns: int, value: float) -> Estimate | None:
        """Take in one message; an estimate if it was an accepted speed, else None."""
        row = np.empty(len(self.estimator.columns))
        stepped = self.estimator.entries.feed_one(*self._arguments, channel, stamp_ns, arrival_ns, value, row)
        return Estimate(row, self.estimator.column_index) if stepped else None

    def handle_block(self, channel: NDArray[np.int16], stamp_ns: IntArray, arrival_ns: IntArray, value: Array) -> Steps:
        """Take in many messages, arrays of shape (messages,) in the order they arrived."""
        most = int(np.count_nonzero(channel == at.SPEED))
        rows = np.empty((most + 1, len(self.estimator.columns)))
        stamps, arrivals = np.empty((2, most + 1), dtype=np.int64)
        steps = self.estimator.entries.feed_many(*self._arguments, channel, stamp_ns, arrival_ns, value, rows, stamps, arrivals)
        return Steps(stamps[:steps], arrivals[:steps], rows[:steps])

    def counts(self) -> Iterator[tuple[str, at.Count, int]]:
        """All counters that are not zero: channel, counter, number."""
        for i, name in enumerate(self.estimator.channels):
            for count in at.Count:
                if self.memory.counters[i, count]:
                    yield name, count, int(self.memory.counters[i, count])

    def reason_counts(self) -> dict[at.Reason, int]:
        """Each reason that held, and at how many steps."""
        return {reason: int(number) for reason, number in zip(at.REASON_TEXT, self.memory.reasons, strict=True) if number}
