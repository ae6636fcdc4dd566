# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Provides a pure step from state to state, and a session that processes messages in order of arrival."""

from __future__ import annotations

import math
from collections.abc import Iterator
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trackres_ros import checks
from trackres_ros.arrays import Array, IntArray
from trackres_ros.effects.stepping import EACH, FIRST_OWN, OF_AIR
from trackres_ros.effects.stepping import cool_memory as cooled_effects
from trackres_ros.effects.stepping import new_memory as new_effects_memory
from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.constants import Constants, make_constants
from trackres_ros.estimator.guards import Memory, ambient_now, new_memory
from trackres_ros.estimator.kernel import COMPILED, Entries, Messages, start
from trackres_ros.estimator.plausible import NOTHING_TRACKED
from trackres_ros.estimator.records import (
    FIRST_NS,
    LARGEST,
    LAST_NS,
    LEAST_WEIGHT,
    LONGEST_STEP_S,
    DriveSeries,
    Estimate,
    GroundSeries,
    Inputs,
    Scratch,
    State,
    Steps,
    bounded_array,
    check_inputs,
    duration,
    floats,
    is_as_compiled,
    new_scratch,
    number,
    times,
    whole_numbers,
)
from trackres_ros.estimator.settings import Settings
from trackres_ros.model.track import vehicle_constants
from trackres_ros.route.follower import NOTHING_YET
from trackres_ros.vehicle import AnyVehicle, RoadVehicle, Vehicle, load_any

LONGEST_STEP = LONGEST_STEP_S, "for a longer pause call rest, which takes any"
UNKNOWN_GROUND = math.nan, math.nan, math.nan, 0.0
ALONG = (
    "speed", "weight", "ambient", "acceleration", "grade", "yaw_rate", "heading", "distance", *DriveSeries._fields[-4:],
)  # fmt: skip
"""Arguments of `Estimator.run` that are series, as in `DriveSeries`."""


class Estimator:
    """Estimate resistance torque [Nm] and belt temperatures [degC] of one vehicle; one estimator serves many sessions.

    `step` is pure: state and inputs in, state and estimate out. `run` repeats it along a series; `session` takes messages in
    order of arrival, with guards against invalid ones.

    Parameters
    ----------
    vehicle
        From `trackres_ros.load_vehicle`, the path of its file, or the name of a shipped one.
    settings
        Parameters of the estimator; config/trackres.yaml has the defaults.
    cache
        Folder of computed tables; by default the user's.
    entries
        The kernels, as C where that was built.

    Attributes
    ----------
    assemblies, columns, channels
        Names of the track assemblies (none without belts), of the results in a row, and of a session's message channels.

    Examples
    --------
    >>> import trackres_ros as tr
    >>> estimator = tr.Estimator(tr.load_vehicle("xgd24d"))
    >>> inputs = estimator.inputs(speed=50 / 3.6, ambient=15.0)
    >>> state = estimator.cold_start(inputs)
    >>> state, estimate = estimator.step(state, inputs, 0.1)
    >>> 3500 < estimate.resistance_torque_nm < 3700
    True
    >>> estimator
    <Estimator of xgd24d: assemblies front_left, front_right, rear_left, rear_right; spectral, lumped>
    """

    def __init__(
        self,
        vehicle: AnyVehicle | str | PathLike[str],
        settings: Settings | None = None,
        cache: str | PathLike[str] | None = None,
        entries: Entries = COMPILED,
    ) -> None:
        vehicle = vehicle if isinstance(vehicle, Vehicle | RoadVehicle) else load_any(vehicle)
        if not isinstance(settings, Settings | None):
            raise InputError("settings", settings, "what Parameters.settings makes, or None")
        self.vehicle = vehicle
        self.settings = settings or Settings()
        self.entries = entries
        folder = None if cache is None else checks.path(cache, "cache")
        self.constants: Constants = make_constants(vehicle, self.settings, folder)
        self.assemblies = tuple(a.name for a in vehicle.assemblies)
        self.channels = layout.channels(vehicle)
        self.columns = layout.columns(vehicle)
        self.column_index = {name: i for i, name in enumerate(self.columns)}
        self.facts = vehicle_constants(vehicle)
        self._sizes = len(self.constants.assembly), len(self.assemblies)
        self._no_belts = np.full(len(self.assemblies), math.nan)
        effects = new_effects_memory(len(vehicle.active))
        belts = len(self.assemblies), 2, layout.BELT_COLUMNS
        self._state_shapes = belts, (layout.Motion.columns,), effects.shape, (layout.Learned.columns,)

    def __repr__(self) -> str:
        names = ", ".join(active.effect.name for active in self.vehicle.active)
        with_effects = f", with {names}" if names else ""
        model = f"assemblies {', '.join(self.assemblies)}; {self.vehicle.hysteresis}, {self.vehicle.thermal}"
        return f"<Estimator of {self.vehicle.name}: {model if self.assemblies else 'road load, no belts'}{with_effects}>"

    def inputs(
        self,
        speed: float,
        weight: float | None = None,
        ambient: float | None = None,
        belt_measured: Array | None = None,
        load: Array | None = None,
        acceleration: float = math.nan,
        grade: float = math.nan,
        yaw_rate: float = math.nan,
        heading: float = math.nan,
        distance: float = math.nan,
        measured_torque: float = math.nan,
    ) -> Inputs:
        """Make the inputs of a step from known values; None is nominal.

        Parameters
        ----------
        speed
            [m/s].
        weight, load
            Whole weight [N], shared as nominal; or the load of each assembly, shape (assemblies,).
        ambient
            [degC].
        belt_measured
            New belt temperatures [degC], nan without one.
        acceleration, grade, yaw_rate, heading, distance, measured_torque
            [m/s^2], rise over run, [rad/s], [rad], [m] and [Nm]; nan where unknown. An unknown distance is integrated
            from the speed. The last four are for effects and the residual.

        Raises
        ------
        InputError
            For an array of another shape, what is no number, a speed, weight, load or ambient temperature that is not finite, and
            a weight or loads that are not above 0.
        """
        k = self.constants
        raw = Inputs(
            speed,
            k.assembly[:, layout.Assembly.nominal_load] if load is None else load,
            k.number.nominal_ambient if ambient is None else ambient,
            k.number.ambient_unknown_std if ambient is None else k.number.ambient_std,
            self._no_belts if belt_measured is None else belt_measured,
            acceleration,
            grade,
            yaw_rate,
            heading,
            distance,
            measured_torque,
        )
        inputs = self._checked(raw)
        if weight is None:
            return inputs
        shares = k.assembly[:, layout.Assembly.share_of_all] if load is None else inputs.load / inputs.load.sum()
        return inputs._replace(load=number(weight, "weight", LEAST_WEIGHT) * shares)

    def cold_start(self, inputs: Inputs, belt_degc: float | None = None, belt_std_k: float | None = None) -> State:
        """Make the state of belts at the ambient temperature, or at a known one [degC] with a standard deviation [K].

        Of `inputs` only the ambient temperature is used. By default the standard deviation is that of the settings. Raises
        InputError for what is no finite number, and for a negative standard deviation.
        """
        inputs = self._checked(inputs)
        belts = np.empty((len(self.assemblies), 2, layout.BELT_COLUMNS))
        effects = new_effects_memory(len(self.vehicle.active))
        state = State(belts, np.empty(layout.Motion.columns), effects, np.zeros(layout.Learned.columns))
        self.entries.start_belts(self.constants, state, inputs.ambient, inputs.ambient_std)
        if belt_degc is not None:
            state.belts[:, :, layout.Belt.temperature] = number(belt_degc, "belt_degc")
            state.belts[:, :, layout.Belt.consider_ambient] = 0.0
        if belt_std_k is not None:
            state.belts[:, :, layout.Belt.noise_1] = number(belt_std_k, "belt_std_k", low=0.0)
        return state

    def step(self, state: State, inputs: Inputs, dt: float) -> tuple[State, Estimate]:
        """Advance by dt [s] to the time of `inputs`. Pure: the given state does not change.

        Returns
        -------
        state, estimate
            State after the step; torques [Nm] and temperatures [degC] by name.

        Raises
        ------
        InputError
            For a dt that is negative, no number or above a week, a state or inputs of another vehicle, or values that `inputs`
            refuses.
        """
        next_state, elapsed, row = self._copy(state), duration(dt, "dt", *LONGEST_STEP), np.empty(len(self.columns))
        if not is_as_compiled(inputs, *self._sizes):
            inputs = self._checked(inputs)
        if not self.entries.step_once(self.constants, next_state, self.scratch(), inputs, elapsed, row):
            self._checked(inputs)  # which says why
        return next_state, Estimate(row, self.column_index)

    def _checked(self, inputs: Inputs) -> Inputs:
        return check_inputs(inputs, *self._sizes)

    def scratch(self) -> Scratch:
        """New scratch memory, as threads must not share one."""
        return new_scratch(self.facts, *self._sizes)

    def run(
        self,
        state: State,
        time_s: Array,
        speed: Array,
        weight: ArrayLike,
        ambient: ArrayLike,
        acceleration: ArrayLike = math.nan,
        grade: ArrayLike = math.nan,
        yaw_rate: ArrayLike = math.nan,
        heading: ArrayLike = math.nan,
        distance: ArrayLike = math.nan,
        ground: GroundSeries | None = None,
    ) -> tuple[State, Array]:
        """Run `step` along a series: the same numbers, without a call per step.

        Parameters
        ----------
        state
            State at the first time.
        time_s, speed
            Times [s] that do not fall, and speeds [m/s], shape (times,).
        weight, ambient, acceleration, grade, yaw_rate, heading, distance
            Whole weight [N], ambient temperature [degC], and the others of `inputs`; each a number or shape (times,), all but the
            first two nan where unknown.
        ground
            Ground from the surroundings, see `along_route`; by default none.

        Returns
        -------
        state, rows
            State at the last time; results, shape (times, columns).

        Raises
        ------
        InputError
            For times that fall, dates, a series of another length, values that `inputs` refuses, or a state of another vehicle.
        """
        at_times = times(time_s, "time_s")
        if not isinstance(ground, GroundSeries | None):
            raise InputError("ground", ground, "what along_route gives, or None")
        arguments = (speed, weight, ambient, acceleration, grade, yaw_rate, heading, distance, *(ground or UNKNOWN_GROUND))
        series = DriveSeries(at_times, *(_at_each(at_times, a, name) for a, name in zip(arguments, ALONG, strict=True)))
        next_state, rows = self._copy(state), np.empty((len(at_times), len(self.columns)))
        self.entries.run_series(self.constants, next_state, self.scratch(), series, self.constants.number.ambient_std, rows)
        return next_state, rows

    def along_route(self, time_s: Array, speed: Array, latitude: Array, longitude: Array) -> GroundSeries:
        """Look up the ground along a drive in the surroundings, as live: only from positions up to each time.

        Parameters
        ----------
        time_s, speed
            Times [s] that do not fall, and speeds [m/s], shape (times,).
        latitude, longitude
            Positions [rad], nan where missing; shape (times,).

        Returns
        -------
        GroundSeries
            Series for `run`; nan off the route, and for a vehicle without one.

        Raises
        ------
        InputError
            For times that fall, dates, a series of another length, or a speed that is not finite.
        """
        at_times = times(time_s, "time_s")
        arguments = (("speed", speed), ("latitude", latitude), ("longitude", longitude))
        series = (bounded_array(a, name, at_times.shape, nan_allowed=name != "speed") for name, a in arguments)
        ground = np.empty((len(at_times), len(GroundSeries._fields)))
        self.entries.follow_series(self.constants, np.array(NOTHING_YET), at_times, *series, ground)
        return GroundSeries(*ground.T)

    def rest(self, state: State, ambient: float | None, seconds: float) -> State:
        """Compute the state after standing or being switched off for some time [s] at an ambient temperature [degC].

        None is the last known one: a session that begins from the state moves its belts once it knows the air. More than a week
        counts as a week. The given state does not change. Raises InputError for a negative time, a temperature that is no finite
        number, or a state of another vehicle.
        """
        next_state, std = self._copy(state), self.constants.number.ambient_unknown_std
        pause = min(duration(seconds, "seconds"), LONGEST_STEP_S)
        air = math.nan if ambient is None else number(ambient, "ambient")
        self.entries.rest_vehicle(self.constants, next_state, self.scratch(), air, std, pause)
        return next_state

    def check(self, state: State) -> None:
        """Raise InputError for a state with other arrays than those of this vehicle."""
        if not isinstance(state, State):
            raise InputError("state", state, "a state", "begin with cold_start")
        shapes = state.belts.shape, state.motion.shape, state.effects.shape, state.learned.shape
        if shapes != self._state_shapes:
            expected = f"{self._state_shapes}, those of {self.vehicle.name}"
            raise InputError("state", f"arrays of shape {shapes}", expected, "begin with cold_start")

    def _copy(self, state: State) -> State:
        self.check(state)
        return State(state.belts.copy(), state.motion.copy(), state.effects.copy(), state.learned.copy())

    def session(self) -> Session:
        """Begin a session: a stream of messages through the guards."""
        return Session(self)


def _at_each(at_times: Array, values: ArrayLike, name: str) -> Array:
    """A number, or one for each time, as a series of its own."""
    is_required = name in ("speed", "weight", "ambient")
    array = bounded_array(values, name, low=LEAST_WEIGHT if name == "weight" else -LARGEST, nan_allowed=not is_required)
    if array.shape not in ((), (1,), at_times.shape):
        raise InputError(name, f"an array of shape {array.shape}", f"a number, or shape {at_times.shape} as time_s")
    return np.array(np.broadcast_to(array, at_times.shape), order="C")


class Session:
    """One stream of messages: guards, state and counters. `handle` takes one message, `handle_block` many, with equal results."""

    def __init__(self, estimator: Estimator) -> None:
        self.estimator = estimator
        assemblies = len(estimator.assemblies)
        self.memory: Memory = new_memory(len(estimator.channels))
        self.belts = np.zeros((assemblies, 2, layout.BELT_COLUMNS))
        self.motion = np.zeros(layout.Motion.columns)
        self.effects = new_effects_memory(len(estimator.vehicle.active))
        self.learned = np.zeros(layout.Learned.columns)
        self._channels = len(estimator.channels)
        self._channel = {name: i for i, name in enumerate(estimator.channels)}
        self._columns = len(estimator.columns)
        bound = estimator.entries.bound
        self._k, self._memory, self._scratch = bound(estimator.constants), bound(self.memory), bound(estimator.scratch())
        self._carried = bound(State(self.belts, self.motion, self.effects, self.learned))

    @property
    def started(self) -> bool:
        """Whether a speed was accepted yet."""
        return bool(self.motion[layout.Motion.started] > 0.0)

    @property
    def has_past(self) -> bool:
        """Whether there is something to go on with: belts, or after a reset the last known air."""
        return self.started or bool(self.motion[layout.Motion.started] == layout.START_COLD)

    @property
    def state(self) -> State:
        """A copy of the state now."""
        return State(self.belts.copy(), self.motion.copy(), self.effects.copy(), self.learned.copy())

    @property
    def share_of_air(self) -> float:
        """Share of an assumed air in the belts' temperature, without belts in the effects' own states; 0 while it is measured."""
        std = float(self.motion[layout.Motion.air_std])
        if std == 0.0:
            return 0.0
        if not len(self.belts):
            return float(np.nan_to_num(self.effects[FIRST_OWN + OF_AIR :: EACH]).max(initial=0.0))
        return min(float(np.abs(self.belts[:, 0, layout.Belt.consider_ambient]).max()) / std, 1.0)

    def begin(self, state: State) -> None:
        """Begin from a known state instead of a cold start. Raises InputError for the state of another vehicle."""
        self.estimator.check(state)
        self.belts[:], self.motion[:], self.effects[:], self.learned[:] = state
        self.motion[layout.Motion.started] = layout.RESTS

    def copy_from(self, other: Session) -> None:
        """Continue from another session of the same vehicle, with its whole memory and this one's settings."""
        self.belts[:], self.motion[:] = other.belts, other.motion
        self.effects[:], self.learned[:] = other.effects, other.learned
        for target, source in zip(self.memory, other.memory, strict=True):
            target[:] = source

    def start_anew(self) -> None:
        """Reset belts and messages after time went back, as at a cold start; counters stay. The next estimate reports it."""
        self.memory.times[:], self.memory.values[:] = 0, math.nan
        self.memory.followed[:], self.memory.tracked[:], self.memory.runs[:] = NOTHING_YET, NOTHING_TRACKED, math.nan
        self.effects[:] = cooled_effects(self.effects)
        self.motion[layout.Motion.started] = layout.START_ANEW

    def start_cold(self, is_driving: bool) -> None:
        """Reset belts and effects; other inputs stay.

        While the vehicle is driving, belts begin at the ambient temperature known now, and the feed-forward goes on. Else they
        begin at the next speed, and the time until then does not count.
        """
        k, memory = self.estimator.constants, self.memory
        if self.started and is_driving:
            motion = layout.Motion(self.motion)
            ambient, std, reason = ambient_now(k, memory, motion, int(memory.times[layout.SPEED, layout.Times.last_arrival]))
            start(k, State(self.belts, self.motion.copy(), self.effects, self.learned), ambient, std)
            motion.air, motion.air_std = ambient, std if reason else 0.0
        elif self.started:  # otherwise it starts cold anyway
            memory.times[layout.SPEED, layout.Times.seen], memory.values[layout.SPEED] = 0, math.nan
            self.motion[layout.Motion.started] = layout.START_COLD

    def channel(self, name: str) -> int:
        """Index of a channel by its name, such as `speed` or `load/front`; KeyError for an unknown name."""
        return self._channel[name]

    def handle(self, channel: int, stamp_ns: int, arrival_ns: int, value: float) -> Estimate | None:
        """Process one message; return an estimate if it was an accepted speed, else None.

        Raises InputError for what is no channel or no number; a value that cannot be used, also nan, is counted.
        """
        has_plain_types = type(channel) is type(stamp_ns) is type(arrival_ns) is int and type(value) is float
        if not (has_plain_types and 0 <= channel < self._channels and FIRST_NS <= stamp_ns <= LAST_NS >= arrival_ns >= FIRST_NS):
            message = self._messages(*([part] for part in (channel, stamp_ns, arrival_ns, value)))
            channel, stamp_ns, arrival_ns, value = (part.tolist()[0] for part in message)
        return self.feed(channel, stamp_ns, arrival_ns, value)

    def feed(self, channel: int, stamp_ns: int, arrival_ns: int, value: float) -> Estimate | None:
        """`handle` without its checks, for numbers that are of these types already: another channel writes outside the arrays."""
        row, estimator = np.empty(self._columns), self.estimator
        has_row = estimator.entries.feed(
            self._k.given, self._memory.given, self._carried.given, self._scratch.given, channel, stamp_ns,
            arrival_ns, value, row,
        )  # fmt: skip
        return Estimate(row, estimator.column_index) if has_row else None

    def handle_block(self, channel: NDArray[np.integer[Any]], stamp_ns: IntArray, arrival_ns: IntArray, value: Array) -> Steps:
        """Process many messages, arrays of shape (messages,) in the order of arrival.

        Raises InputError for different lengths, and as `handle`.
        """
        messages = self._messages(channel, stamp_ns, arrival_ns, value)
        speed_count = int(np.count_nonzero(messages.channels == layout.SPEED))
        rows = np.empty((speed_count + 1, len(self.estimator.columns)))
        of_steps = np.empty((2, speed_count + 1), dtype=np.int64)
        pointers = self._k.given, self._memory.given, self._carried.given, self._scratch.given
        steps = self.estimator.entries.feed_all(*pointers, messages, rows, *of_steps)
        return Steps(of_steps[0, :steps], of_steps[1, :steps], rows[:steps])

    def _messages(self, channel: ArrayLike, stamp_ns: ArrayLike, arrival_ns: ArrayLike, value: ArrayLike) -> Messages:
        """Messages from outside, with arrays for which the kernels are compiled."""
        messages = Messages(
            whole_numbers(channel, "channel", 0, self._channels - 1),
            whole_numbers(stamp_ns, "stamp_ns", FIRST_NS, LAST_NS),
            whole_numbers(arrival_ns, "arrival_ns", FIRST_NS, LAST_NS),
            floats(value, "value"),
        )
        if len({part.shape for part in messages}) > 1 or messages.values.ndim != 1:
            shapes = f"arrays of shape {[part.shape for part in messages]}"
            raise InputError("channel, stamp_ns, arrival_ns, value", shapes, "arrays of one length, shape (messages,)")
        return messages

    def counts(self, base: IntArray | int = 0) -> Iterator[tuple[str, layout.Count, int]]:
        """All counters that are not zero: channel, counter, number; since `base`, a copy of them."""
        numbers = self.memory.counters - base
        for i, name in enumerate(self.estimator.channels):
            for count in layout.Count:
                if numbers[i, count]:
                    yield name, count, int(numbers[i, count])

    def reason_counts(self, base: IntArray | int = 0) -> dict[layout.Reason, int]:
        """Each reason that occurred, and its number of steps; since `base`, a copy of these numbers."""
        return {
            reason: int(number) for reason, number in zip(layout.REASON_TEXT, self.memory.reasons - base, strict=True) if number
        }
