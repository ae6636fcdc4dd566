# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The rules of the guards one by one, in plain Python: stamp, arrival and earlier messages decide on a message."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest

from trackres_ros.effects import VehicleConstants
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator import guards
from trackres_ros.estimator.columns import Count, Reason
from trackres_ros.estimator.guards import (
    ACCEPTED_AFTER_DOUBT,
    ACCEPTED_AFTER_JUMP,
    ACCEPTED_AFTER_RESET,
    ACCEPTED_IN_ORDER,
    new_memory,
)
from trackres_ros.estimator.plausible import NOTHING_TRACKED
from trackres_ros.estimator.records import new_scratch
from trackres_ros.route.follower import NOTHING_YET

S, MS = 1_000_000_000, 1_000_000
T = 1_700_000_000 * S
JUMP, AMBIENT_HOLD, MOTION_HOLD, TORQUE_HOLD, LOAD_HOLD, STUCK = 2 * S, 300 * S, 1 * S, 3 * S, 60 * S, 30 * S
PASSENGERS_HOLD, BRIDGE_S = 1000 * S, 31
AXLES, ASSEMBLIES = 2, 4
NAMED = {"axle": layout.FIRST_AXLE, "assembly": layout.FIRST_AXLE + AXLES, "belt": layout.FIRST_AXLE + AXLES + ASSEMBLIES}
WHEELS = layout.FIRST_AXLE + AXLES + 2 * ASSEMBLIES
CHANNELS = WHEELS + 1 + AXLES + ASSEMBLIES
SHARES_OF_ALL = (0.3, 0.3, 0.25, 0.15)

admit, held_value = guards.admit_message, guards.held_value
gather, gather_loads = guards.gather_inputs, guards.gather_loads
forget_others = guards.forget_others


@pytest.fixture
def k():
    """Constants of a vehicle with two axles and four assemblies."""
    assembly = np.zeros((ASSEMBLIES, layout.CONSIDER_FACTOR + 16))
    assembly[:, layout.Assembly.axle] = (0, 0, 1, 1)
    assembly[:, layout.Assembly.nominal_load] = (60e3, 61e3, 62e3, 63e3)
    assembly[:, layout.Assembly.share_of_all] = SHARES_OF_ALL
    limits = np.tile([-1e6, 1e6], (CHANNELS, 1))
    limits[layout.SPEED] = (-20.0, 25.0)
    number = SimpleNamespace(
        clock_jump_ns=JUMP, jumps_to_accept=3, load_hold_ns=LOAD_HOLD, ambient_hold_ns=AMBIENT_HOLD, motion_hold_ns=MOTION_HOLD,
        passengers_hold_ns=PASSENGERS_HOLD, passenger_weight=700.0,
        slopes_by_place=False, torques_by_place=False, torque_hold_ns=TORQUE_HOLD, torque_at_motor=False, stuck_ns=STUCK,
        axles=AXLES, first_wheel=WHEELS, first_belt=NAMED["belt"],
        speed_variance=4e-4, speed_max_age=0.5, slow_input_max_age_ns=S,
        max_acceleration=8.0, speed_slack=1.0, enable_hold_ns=0, disagreeing_ns=S, bridge=BRIDGE_S,
        nominal_ambient=15.0, ambient_std=0.5, ambient_unknown_std=9.0,
    )  # fmt: skip
    return SimpleNamespace(number=number, assembly=assembly, channel_limits=limits)


class Guard:
    """Memory and the messages of it."""

    def __init__(self, k):
        self.k, self.memory = k, new_memory(CHANNELS)

    def send(self, stamp, value=8.0, channel=layout.SPEED, arrival=None):
        """Outcome and time elapsed of a message; the stamp and arrival [ns] since `T`, a stamp of None for none."""
        arrival_ns = stamp if arrival is None else arrival
        return admit(self.k, self.memory, channel, 0 if stamp is None else T + stamp, T + arrival_ns, value, 0.0)

    def counts(self, channel=layout.SPEED):
        return {Count(i).name: int(n) for i, n in enumerate(self.memory.counters[channel]) if n}

    def of(self, column, channel=layout.SPEED):
        return int(self.memory.times[channel, column])

    def inputs(self, outcome=ACCEPTED_IN_ORDER, started=1.0, quantum=0.0):
        motion = layout.Motion(np.zeros(layout.Motion.columns))
        motion.started, motion.quantum, motion.last_speed = started, quantum, self.memory.values[layout.SPEED]
        scratch = new_scratch(VehicleConstants(*[1.0] * 8), ASSEMBLIES, ASSEMBLIES)
        self.loads, self.belts = scratch.loads, scratch.belt_measured
        return gather(self.k, self.memory, scratch, outcome, 0, motion)

    def reasons(self, **given):
        return Reason(self.inputs(**given).reasons)


@pytest.fixture
def guard(k):
    return Guard(k)


def test_outcomes_are_no_negative_numbers_which_refusals_are():
    assert (ACCEPTED_IN_ORDER, ACCEPTED_AFTER_JUMP, ACCEPTED_AFTER_RESET, ACCEPTED_AFTER_DOUBT) == (0, 1, 2, 3)


def test_it_begins_with_nothing(guard):
    assert guard.counts() == {}
    assert np.isnan(guard.memory.values).all()
    assert not guard.memory.times.any()
    assert not guard.memory.reasons.any()
    assert guard.memory.times.shape == (CHANNELS, layout.Times.columns)
    assert guard.memory.counters.shape == (CHANNELS, len(Count))


# One message after another


def test_good_messages_are_taken_with_the_time_between(guard):
    assert guard.send(0, 8.0) == (ACCEPTED_IN_ORDER, 0)
    assert guard.send(20 * MS, 8.1) == (ACCEPTED_IN_ORDER, 20 * MS)
    assert guard.counts() == {"ACCEPTED": 2}
    assert guard.memory.values[layout.SPEED] == 8.1
    assert (guard.of(layout.Times.seen), guard.of(layout.Times.fresh), guard.of(layout.Times.last_stamp) - T) == (1, 1, 20 * MS)


@pytest.mark.parametrize(
    ("value", "refused"),
    [
        (math.nan, "NON_FINITE"), (math.inf, "NON_FINITE"), (-math.inf, "NON_FINITE"), (25.01, "OUT_OF_RANGE"),
        (-20.01, "OUT_OF_RANGE"), (25.0, ""), (-20.0, ""),
    ],
)  # fmt: skip
def test_values_that_cannot_be_are_counted_and_leave_no_trace(guard, value, refused):
    outcome, elapsed = guard.send(0, value)
    if refused:
        assert (outcome, elapsed) == (-Count[refused], 0)
        assert guard.counts() == {refused: 1}
        assert not guard.of(layout.Times.seen)
        guard.send(1, value)
        assert guard.counts() == {refused: 2}
    else:
        assert outcome == ACCEPTED_IN_ORDER


def test_limits_are_those_of_the_channel(guard):
    assert guard.send(0, 30.0, layout.LOAD)[0] == ACCEPTED_IN_ORDER
    assert guard.send(0, 30.0, layout.SPEED)[0] == -Count.OUT_OF_RANGE


@pytest.mark.parametrize(
    ("offset", "refused"),
    [(0, "DUPLICATE"), (-1, "LATE"), (-JUMP, "LATE"), (-JUMP - 1, "BACKWARD"), (1, ""), (JUMP, ""), (JUMP + 1, "FUTURE")],
)
def test_order_is_by_stamps(guard, offset, refused):
    """While arrival stands still."""
    guard.send(0)
    outcome, elapsed = guard.send(offset, arrival=0)
    assert (outcome, elapsed) == ((-Count[refused], 0) if refused else (ACCEPTED_IN_ORDER, offset))
    assert guard.counts() == {"ACCEPTED": 1, refused: 1} if refused else {"ACCEPTED": 2}
    assert guard.of(layout.Times.last_stamp) == (T if refused else T + offset)


def test_a_pause_in_which_arrival_goes_on_too_is_no_jump(guard):
    guard.send(0)
    assert guard.send(3600 * S) == (ACCEPTED_IN_ORDER, 3600 * S)
    assert guard.send(7200 * S, arrival=7200 * S - JUMP) == (ACCEPTED_IN_ORDER, 3600 * S)
    assert guard.send(10800 * S, arrival=9000 * S)[0] == -Count.FUTURE


def test_counters_count_on(guard):
    guard.send(0)
    for n in (1, 2):
        guard.send(0)
        guard.send(-1)
        guard.send(-3600 * S, arrival=n)
        guard.send(3600 * S + n, arrival=n)
        assert guard.counts() == {"ACCEPTED": 1, "DUPLICATE": n, "LATE": n, "BACKWARD": n, "FUTURE": n}


# Without a stamp


def test_without_a_stamp_the_arrival_counts(guard):
    assert guard.send(None, arrival=5 * S) == (ACCEPTED_IN_ORDER, 0)
    assert guard.of(layout.Times.last_stamp) == T + 5 * S
    assert guard.send(None, arrival=6 * S) == (ACCEPTED_IN_ORDER, S)
    assert guard.counts() == {"ACCEPTED": 2, "ZERO_STAMP": 2}


def test_without_a_stamp_the_offset_of_the_source_stays(guard):
    guard.send(-500 * S, arrival=0)
    assert guard.send(None, arrival=S) == (ACCEPTED_IN_ORDER, S)
    assert guard.of(layout.Times.last_stamp) == T - 499 * S
    assert guard.of(layout.Times.last_arrival) == T + S


def test_time_that_begins_at_zero_is_a_time(k):
    memory = new_memory(CHANNELS)
    assert admit(k, memory, layout.SPEED, 0, 0, 8.0, 0.0) == (ACCEPTED_IN_ORDER, 0)
    assert memory.counters[layout.SPEED, Count.ZERO_STAMP] == 0
    assert admit(k, memory, layout.SPEED, 10 * MS, 10 * MS, 8.0, 0.0) == (ACCEPTED_IN_ORDER, 10 * MS)


# Jumps


@pytest.mark.parametrize(("jump", "refused"), [(3600 * S, "FUTURE"), (-3600 * S, "BACKWARD")])
def test_the_third_agreeing_stamp_is_accepted_with_arrival_time(guard, jump, refused):
    guard.send(0)
    assert guard.send(jump, arrival=20 * MS) == (-Count[refused], 0)
    assert guard.send(jump + 20 * MS, arrival=40 * MS) == (-Count[refused], 0)
    assert guard.send(jump + 40 * MS, arrival=60 * MS) == (ACCEPTED_AFTER_JUMP, 60 * MS)
    assert guard.counts() == {"ACCEPTED": 2, refused: 2, "CLOCK_JUMP": 1}
    assert guard.of(layout.Times.suspects) == 0
    assert guard.send(jump + 60 * MS, arrival=80 * MS) == (ACCEPTED_IN_ORDER, 20 * MS)


@pytest.mark.parametrize("channel", [layout.SPEED, layout.ENABLE])
@pytest.mark.parametrize(("pause", "sent", "every"), [(40 * S, 25, 20 * MS), (8 * 3600 * S, 1, 20 * MS), (40 * S, 8, 300 * MS)])
def test_what_waited_in_a_queue_is_as_old_as_its_stamp(guard, channel, pause, sent, every):
    guard.send(0, 1.0, channel)
    for i in range(1, sent + 1):
        assert guard.send(i * every, 1.0, channel, arrival=pause + i * MS // 5) == (ACCEPTED_IN_ORDER, every)
        assert guard.of(layout.Times.last_arrival, channel) == T + i * every
    assert guard.send(pause + S, 1.0, channel) == (ACCEPTED_IN_ORDER, pause + S - sent * every)
    assert guard.counts(channel) == {"ACCEPTED": sent + 2}


@pytest.mark.parametrize("every", [20 * MS, S])
def test_stamps_that_stay_behind_are_those_of_a_set_clock(guard, every):
    guard.send(0)
    answers = [guard.send(i * every, arrival=3600 * S + i * every) for i in range(1, 1 + JUMP // every + 2)]
    assert answers[:-1] == [(ACCEPTED_IN_ORDER, every)] * (len(answers) - 1)
    assert answers[-1] == (ACCEPTED_AFTER_JUMP, 3600 * S + every)
    assert guard.of(layout.Times.last_arrival) == T + 3600 * S + len(answers) * every
    assert guard.counts() == {"ACCEPTED": len(answers) + 1, "CLOCK_JUMP": 1}
    assert guard.of(layout.Times.suspects) == 0


def test_time_never_goes_back_by_a_jump(guard):
    guard.send(0, arrival=S)
    for i in range(3):
        outcome = guard.send(3600 * S + i, arrival=i)
    assert outcome == (ACCEPTED_AFTER_JUMP, 0)


def test_suspects_that_do_not_agree_begin_anew(guard):
    guard.send(0)
    stamps = (3600 * S, 3600 * S + 1, 7200 * S, 7200 * S + 1)
    assert [guard.send(s, arrival=i + 1)[0] for i, s in enumerate(stamps)] == [-Count.FUTURE] * 4
    assert guard.of(layout.Times.suspects) == 2
    assert guard.send(7200 * S + 2, arrival=5)[0] == ACCEPTED_AFTER_JUMP


@pytest.mark.parametrize(("apart", "agrees"), [(1, True), (JUMP, True), (JUMP + 1, False), (0, False), (-1, False)])
def test_suspects_agree_where_their_stamps_go_on_with_arrival(guard, apart, agrees):
    guard.send(0)
    guard.send(3600 * S, arrival=0)
    guard.send(3600 * S + apart, arrival=0)
    assert guard.of(layout.Times.suspects) == (2 if agrees else 1)
    assert guard.of(layout.Times.suspect_stamp) == T + 3600 * S + apart


def test_suspects_whose_arrival_ran_on_alone_do_not_agree(guard):
    guard.send(0)
    guard.send(3600 * S, arrival=0)
    guard.send(3600 * S + 1, arrival=JUMP + 2)
    assert guard.of(layout.Times.suspects) == 1
    assert guard.of(layout.Times.suspect_arrival) == T + JUMP + 2
    guard.send(3600 * S + 2, arrival=2 * JUMP + 2)
    assert guard.of(layout.Times.suspects) == 2


def test_a_good_message_clears_the_suspicion(guard):
    guard.send(0)
    for i in range(2):
        guard.send(3600 * S + i, arrival=i)
    guard.send(20 * MS)
    assert guard.of(layout.Times.suspects) == 0
    assert guard.send(3600 * S + 5, arrival=30 * MS)[0] == -Count.FUTURE


def test_a_first_suspect_is_none_by_what_was_long_ago(guard):
    """Before the first the memory holds zeros, which no stamp follows."""
    guard.k.number.jumps_to_accept = 2
    memory = guard.memory
    assert admit(guard.k, memory, layout.SPEED, 10 * S, 10 * S, 8.0, 0.0)[0] == ACCEPTED_IN_ORDER
    assert admit(guard.k, memory, layout.SPEED, 10 * S + JUMP + 1, 10 * S, 8.0, 0.0)[0] == -Count.FUTURE


# Time that goes back


@pytest.mark.parametrize(
    ("back", "arrival_back", "outcome"),
    [
        (3600 * S, 3600 * S, ACCEPTED_AFTER_RESET),
        (JUMP + 1, JUMP + 1, ACCEPTED_AFTER_RESET),
        (JUMP + 1, JUMP, -Count.BACKWARD),  # arrival hardly went back
        (JUMP, JUMP + 1, -Count.LATE),
    ],
)
def test_time_is_reset_where_arrival_goes_back_too(guard, back, arrival_back, outcome):
    guard.send(0)
    assert guard.send(-back, arrival=-arrival_back) == (outcome, 0)
    assert guard.counts().get("RESET", 0) == (outcome == ACCEPTED_AFTER_RESET)


def test_a_reset_counts_on_and_is_no_jump(guard):
    guard.send(0)
    for n in (1, 2):
        guard.send(-3600 * S * n)
        assert guard.counts() == {"ACCEPTED": 1 + n, "RESET": n}
    assert guard.of(layout.Times.last_stamp) == T - 7200 * S


def test_what_is_forgotten_is_all_of_the_others_but_counters(guard):
    last_channel = CHANNELS - 1
    for channel in (layout.SPEED, layout.LOAD, layout.AMBIENT, last_channel):
        guard.send(0, 7.0, channel)
    guard.memory.tracked[:] = guard.memory.followed[:] = 1.0
    forget_others(guard.memory, layout.LOAD)
    np.testing.assert_array_equal(guard.memory.tracked, NOTHING_TRACKED)
    np.testing.assert_array_equal(guard.memory.followed, NOTHING_YET)
    assert guard.memory.values[layout.LOAD] == 7.0
    assert guard.of(layout.Times.seen, layout.LOAD) == 1
    for channel in (layout.SPEED, layout.AMBIENT, last_channel):
        assert math.isnan(guard.memory.values[channel])
        assert not guard.memory.times[channel].any()
        assert guard.counts(channel) == {"ACCEPTED": 1}
    guard.send(1, 7.0)
    forget_others(guard.memory, layout.SPEED)
    assert guard.memory.runs[layout.SPEED, layout.Run.reference] == 7.0


# Held values


def test_a_value_is_held_for_so_long(guard):
    assert math.isnan(held_value(guard.memory, layout.AMBIENT, T, 100))
    guard.send(0, -3.0, layout.AMBIENT)
    assert held_value(guard.memory, layout.AMBIENT, T + 100, 100) == -3.0
    assert math.isnan(held_value(guard.memory, layout.AMBIENT, T + 101, 100))


def test_it_is_held_from_its_arrival(guard):
    guard.send(-50 * S, -3.0, layout.AMBIENT, arrival=0)
    assert held_value(guard.memory, layout.AMBIENT, T + 100, 100) == -3.0


def test_the_speed_and_what_is_fresh_beside_it_make_the_inputs(guard):
    values = {layout.AMBIENT: -4.0, layout.ACCEL: 0.3, layout.GRADE: 0.02, layout.TORQUE: 2500.0, layout.LOAD: 240e3}
    for channel, value in values.items():
        guard.send(0, value, channel)
    guard.send(MS, 7.5)
    inputs = guard.inputs()
    assert inputs.speed == 7.5
    assert (inputs.ambient, inputs.ambient_std) == (-4.0, 0.5)
    assert (inputs.acceleration, inputs.grade, inputs.measured_torque) == (0.3, 0.02, 2500.0)
    assert inputs.reasons == 0


@pytest.mark.parametrize(
    ("channel", "name", "hold"),
    [
        (layout.ACCEL, "acceleration", MOTION_HOLD),
        (layout.GRADE, "grade", MOTION_HOLD),
        (layout.TORQUE, "measured_torque", TORQUE_HOLD),
    ],
)
def test_each_is_held_for_its_own_time(guard, channel, name, hold):
    guard.send(0, 0.5, channel)
    guard.send(hold)
    assert getattr(guard.inputs(), name) == 0.5
    guard.send(hold + 1)
    assert math.isnan(getattr(guard.inputs(), name))


def test_without_ambient_the_last_or_nominal_one_is_assumed(guard):
    assert guard.inputs(started=0.0)[2:4] == (15.0, 9.0)
    guard.send(0, -4.0, layout.AMBIENT)
    guard.send(AMBIENT_HOLD)
    assert not guard.reasons() & Reason.AMBIENT_NOMINAL
    guard.send(AMBIENT_HOLD + 1)
    inputs = guard.inputs()
    assert (inputs.ambient, inputs.ambient_std) == (-4.0, 9.0)
    assert inputs.reasons & Reason.AMBIENT_NOMINAL


# Loads


def loads(guard, now=0):
    values = np.zeros(ASSEMBLIES)
    return Reason(gather_loads(guard.k, guard.memory, T + now, values)[0]), values


def test_no_load_at_all_is_the_nominal_one(guard):
    reasons, loads_n = loads(guard)
    assert reasons == Reason.LOAD_NOMINAL
    assert loads_n.tolist() == [60e3, 61e3, 62e3, 63e3]


def test_the_total_is_shared_by_nominal_loads(guard):
    guard.send(0, 200e3, layout.LOAD)
    reasons, loads_n = loads(guard)
    assert reasons == 0
    assert loads_n == pytest.approx(200e3 * np.array(SHARES_OF_ALL))


def test_passengers_add_to_nominal_loads_until_they_are_too_old(guard):
    guard.send(1 * S, 20.0, layout.PASSENGERS)
    guard.send(2 * S)
    assert not guard.reasons() & (Reason.LOAD_NOMINAL | Reason.LOAD_HELD)
    assert guard.loads.tolist() == pytest.approx(
        [n + 14e3 * s for n, s in zip((60e3, 61e3, 62e3, 63e3), SHARES_OF_ALL, strict=True)]
    )
    guard.send(1 * S + PASSENGERS_HOLD)
    assert not guard.reasons() & Reason.LOAD_NOMINAL
    guard.send(1 * S + PASSENGERS_HOLD + 1)
    assert guard.reasons() & Reason.LOAD_NOMINAL
    assert guard.loads.tolist() == [60e3, 61e3, 62e3, 63e3]


def test_a_load_has_the_passengers_in_it(guard):
    guard.send(1 * S, 20.0, layout.PASSENGERS)
    guard.send(1 * S, 200e3, layout.LOAD)
    guard.send(2 * S)
    guard.inputs()
    assert guard.loads.sum() == pytest.approx(200e3)


@pytest.mark.parametrize("measured", list(itertools.product([False, True], repeat=AXLES + ASSEMBLIES)))
def test_loads_add_up_to_each_measured_sum(guard, measured):
    true_loads = np.array([90e3, 40e3, 20e3, 70e3])
    sums = [true_loads[:2].sum(), true_loads[2:].sum(), *true_loads]
    guard.send(0, true_loads.sum(), layout.LOAD)
    for i in np.flatnonzero(measured):
        guard.send(0, sums[i], layout.FIRST_AXLE + i)
    reasons, loads_n = loads(guard)
    sums_n = np.array([loads_n[:2].sum(), loads_n[2:].sum(), *loads_n])
    assert reasons == 0
    assert loads_n.sum() == pytest.approx(true_loads.sum())
    assert sums_n[list(measured)] == pytest.approx(np.array(sums)[list(measured)])


def test_a_sum_below_its_measured_parts_leaves_the_least_load(guard):
    guard.send(0, 100e3, layout.LOAD)
    guard.send(0, 150e3, NAMED["axle"])
    assert loads(guard)[1] == pytest.approx([75e3, 75e3, 6.2e3, 6.3e3])


def test_the_load_of_an_assembly_goes_before_that_of_its_axle(guard):
    guard.send(0, 80e3, NAMED["axle"] + 1)
    for i in range(ASSEMBLIES):
        guard.send(0, 1e3 * (i + 1), NAMED["assembly"] + i)
        _, loads_n = loads(guard)
        assert loads_n[: i + 1] == pytest.approx([1e3 * (j + 1) for j in range(i + 1)])
    reasons, _ = loads(guard)
    assert reasons == 0


def test_those_without_any_are_nominal_and_it_is_said(guard):
    guard.send(0, 80e3, NAMED["axle"] + 1)
    reasons, loads_n = loads(guard)
    assert reasons == Reason.LOAD_NOMINAL
    assert loads_n == pytest.approx([60e3, 61e3, 50e3, 30e3])


@pytest.mark.parametrize("channel", [layout.LOAD, NAMED["axle"], NAMED["assembly"]], ids=["total", "axle", "assembly"])
def test_an_old_load_is_held_with_a_reason_and_dropped_later(guard, channel):
    guard.send(0, 100e3, channel)
    if channel != layout.LOAD:
        guard.send(LOAD_HOLD, 300e3, layout.LOAD, arrival=LOAD_HOLD)  # for the others
        guard.send(LOAD_HOLD, 80e3, NAMED["axle"] + 1)
    held_from = 2 * S
    load = {layout.LOAD: 30e3, NAMED["axle"]: 50e3, NAMED["assembly"]: 100e3}[channel]
    old_reasons = Reason.LOAD_HELD | Reason.LOAD_OLD
    for age, expected in (
        (0, 0),
        (held_from, 0),
        (held_from + 1, Reason.LOAD_HELD),
        (32 * S, Reason.LOAD_HELD),
        (LOAD_HOLD, old_reasons),
    ):
        reasons, loads_n = loads(guard, age)
        assert loads_n[0] == pytest.approx(load)
        assert reasons == expected
    reasons, loads_n = loads(guard, LOAD_HOLD + 1)
    assert loads_n[0] == pytest.approx(60e3 if channel == layout.LOAD else 110e3)
    assert reasons == (Reason.LOAD_NOMINAL if channel == layout.LOAD else 0)


def test_the_loads_of_a_step_are_those_at_its_arrival(guard):
    guard.send(0, 200e3, layout.LOAD)
    guard.send(0, arrival=10 * S)
    assert guard.reasons() & Reason.LOAD_HELD
    assert guard.loads == pytest.approx(200e3 * np.array(SHARES_OF_ALL))


# Belts


def test_a_belt_temperature_is_given_once_to_whom_it_is_of(guard):
    guard.send(0)
    guard.send(0, 40.0, NAMED["belt"] + 2)
    guard.inputs()
    assert np.isnan(guard.belts[[0, 1, 3]]).all()
    assert guard.belts[2] == 40.0
    guard.inputs()
    assert np.isnan(guard.belts).all()


def test_a_common_belt_temperature_yields_to_a_belts_own(guard):
    guard.send(0)
    guard.send(0, 30.0, layout.BELT)
    guard.send(0, 40.0, NAMED["belt"])
    guard.send(0, 41.0, NAMED["belt"] + 3)
    guard.inputs()
    assert guard.belts.tolist() == [40.0, 30.0, 30.0, 41.0]
    guard.inputs()
    assert np.isnan(guard.belts).all()


@pytest.mark.parametrize("channel", [layout.BELT, NAMED["belt"]])
def test_a_belt_temperature_from_before_a_pause_is_not_used(guard, channel):
    for pause_count in (0, 1):
        time_ns = pause_count * 1000 * S
        guard.send(time_ns, 40.0, channel)
        guard.send(time_ns + BRIDGE_S * S + (MS if pause_count else -MS))
        guard.inputs()
        assert np.isnan(guard.belts[0]) == bool(pause_count)
        assert not guard.of(layout.Times.fresh, channel)


# Remarks


def test_clock_jumps_and_resets_are_reported_with_the_next_step(guard):
    guard.send(0)
    nominal = Reason.LOAD_NOMINAL | Reason.AMBIENT_NOMINAL
    assert guard.reasons() == nominal
    assert guard.reasons(outcome=ACCEPTED_AFTER_JUMP) == nominal | Reason.CLOCK_JUMPED
    assert guard.reasons(outcome=ACCEPTED_AFTER_RESET) == nominal  # whichever channel saw it: the state says so
    assert guard.reasons(started=layout.START_ANEW) == nominal | Reason.TIME_RESET
    assert guard.reasons(started=0.0) == nominal


@pytest.mark.parametrize(
    ("quantum", "started", "coarse"),
    [(0.05, 1.0, False), (0.051, 1.0, True), (0.999, 1.0, True), (1.0, 1.0, False), (0.3, 0.0, False), (0.3, -1.0, False)],
)
def test_coarse_steps_are_remarked_once_it_runs(guard, quantum, started, coarse):
    guard.send(0)
    assert bool(guard.reasons(quantum=quantum, started=started) & Reason.SPEED_QUANTISED) == coarse


@pytest.mark.parametrize("speed", [8.0, -8.0, 0.0011])
def test_a_speed_that_stays_the_same_for_long_is_stuck(guard, speed):
    guard.send(0, speed)
    guard.send(STUCK, speed)
    assert not guard.reasons() & Reason.SPEED_STUCK
    guard.send(STUCK + 1, speed)
    assert guard.reasons() & Reason.SPEED_STUCK
    guard.send(STUCK + 2, speed + 1e-6)
    assert not guard.reasons() & Reason.SPEED_STUCK
    guard.send(2 * STUCK + 2, speed + 1e-6)
    assert not guard.reasons() & Reason.SPEED_STUCK
    guard.send(2 * STUCK + 3, speed + 1e-6)
    assert guard.reasons() & Reason.SPEED_STUCK


@pytest.mark.parametrize("speed", [0.0, 0.001, -0.001])
def test_who_stands_is_not_stuck(guard, speed):
    guard.send(0, speed)
    guard.send(10 * STUCK, speed)
    assert not guard.reasons() & Reason.SPEED_STUCK


def test_a_long_pause_is_no_time_for_which_it_was_stuck(guard):
    guard.send(0)
    guard.send(BRIDGE_S * S + MS)
    assert not guard.reasons() & Reason.SPEED_STUCK


def test_coarse_steps_are_given_ten_times_as_long(guard):
    for i in range(11):
        guard.send(i * STUCK)
    assert not guard.reasons(quantum=0.3) & Reason.SPEED_STUCK
    assert guard.reasons() & Reason.SPEED_STUCK
    guard.send(10 * STUCK + 1)
    assert guard.reasons(quantum=0.3) & Reason.SPEED_STUCK


def test_a_jump_of_the_clock_is_no_time_for_which_it_was_stuck(guard):
    guard.send(0)
    for i in range(3):
        guard.send(3600 * S + i, arrival=i)
    assert not guard.reasons() & Reason.SPEED_STUCK
    assert guard.of(layout.Times.unchanged_since) == T + 3600 * S + 2


# A speed that changes too fast: 8 m/s2, plus 1 m/s


@pytest.mark.parametrize(("after", "value", "refused"), [(MS, 9.0, False), (MS, 9.1, True), (S, 16.9, False), (S, 17.1, True)])
def test_a_change_is_as_large_as_the_time_allows(guard, after, value, refused):
    guard.send(0, 8.0)
    assert guard.send(after, value) == ((-Count.IMPLAUSIBLE, 0) if refused else (ACCEPTED_IN_ORDER, after))
    assert guard.counts() == ({"ACCEPTED": 1, "IMPLAUSIBLE": 1} if refused else {"ACCEPTED": 2})
    assert guard.memory.values[layout.SPEED] == (8.0 if refused else value)


@pytest.mark.parametrize(("quantum", "refused"), [(0.5, False), (0.3, True), (1.0, True)])
def test_a_step_of_a_quantised_speed_is_no_acceleration(guard, quantum, refused):
    """A greater one than 1 m/s is no resolution."""
    guard.send(0, 8.0)
    outcome = admit(guard.k, guard.memory, layout.SPEED, T + MS, T + MS, 9.4, quantum)[0]
    assert outcome == (-Count.IMPLAUSIBLE if refused else ACCEPTED_IN_ORDER)


def test_small_changes_do_not_add_up_to_a_leap(guard):
    outcomes = [guard.send(i * 20 * MS, 8.0 + 0.5 * i)[0] for i in range(6)]
    assert outcomes[:3] == [ACCEPTED_IN_ORDER] * 3
    assert outcomes[3:] == [-Count.IMPLAUSIBLE] * 3


def test_after_one_wrong_speed_the_third_good_one_is_taken(guard):
    guard.send(0, 8.0)
    assert guard.send(20 * MS, 15.0)[0] == -Count.IMPLAUSIBLE
    assert [guard.send(i * 20 * MS, 8.0)[0] for i in (2, 3)] == [-Count.IMPLAUSIBLE] * 2
    assert guard.send(80 * MS, 8.0) == (ACCEPTED_AFTER_DOUBT, 80 * MS)
    assert guard.send(100 * MS, 8.0) == (ACCEPTED_IN_ORDER, 20 * MS)
    assert guard.counts() == {"ACCEPTED": 3, "IMPLAUSIBLE": 3}
    assert guard.reasons(outcome=ACCEPTED_AFTER_DOUBT) & Reason.SPEED_IMPLAUSIBLE
    assert not guard.reasons() & Reason.SPEED_IMPLAUSIBLE


def test_a_run_lasts_as_long_as_the_doubt_before_it(guard):
    guard.send(0, 8.0)
    for i in range(1, 6):
        guard.send(i * 100 * MS, 0.0 if i % 2 else 16.0)
    outcomes = [guard.send(600 * MS + i * 50 * MS, 8.0)[0] for i in range(14)]
    assert outcomes.index(ACCEPTED_AFTER_DOUBT) == 12  # 600 ms
    guard.send(2 * S, 16.0)
    for i in range(200):
        guard.send(2 * S + (i + 1) * 20 * MS, 0.0 if i % 2 else 16.0)
    late_outcomes = [guard.send(6020 * MS + i * 100 * MS, 8.0)[0] for i in range(22)]
    assert late_outcomes.index(ACCEPTED_AFTER_DOUBT) == 20  # never more than 2 s


def test_a_step_is_taken_once_the_vehicle_can_be_there(guard):
    guard.send(0, 8.0)
    outcomes = [guard.send(i * 100 * MS, 20.0)[0] for i in range(1, 16)]
    assert outcomes.index(ACCEPTED_AFTER_DOUBT) == 13  # after 1.4 s: 8 + 8 * 1.4 + 1 > 20
    assert guard.send(1600 * MS, 20.0)[0] == ACCEPTED_IN_ORDER
    assert guard.send(1700 * MS, 21.7)[0] == ACCEPTED_IN_ORDER


def test_stamps_in_doubt_have_an_order(guard):
    guard.send(0, 8.0)
    guard.send(100 * MS, 16.0)
    assert guard.send(100 * MS, 16.0)[0] == -Count.DUPLICATE
    assert guard.send(60 * MS, 8.0)[0] == -Count.LATE
    assert guard.send(-60 * MS, 8.0)[0] == -Count.LATE
    assert guard.send(101 * MS, 16.0)[0] == -Count.IMPLAUSIBLE
    assert guard.of(layout.Times.doubts) == 2


def test_a_reset_ends_the_doubt(guard):
    guard.send(0, 8.0)
    guard.send(20 * MS, 16.0)
    assert guard.send(-3600 * S, 16.0)[0] == ACCEPTED_AFTER_RESET
    assert guard.send(-3600 * S + 20 * MS, 16.0)[0] == ACCEPTED_IN_ORDER


@pytest.mark.parametrize("jump", [-3600 * S, 3600 * S])
def test_a_jump_ends_no_doubt(guard, jump):
    guard.send(0, 8.0)
    guard.send(20 * MS, 16.0)
    arrivals = [(i + 2) * 20 * MS for i in range(100)]
    assert min(guard.send(at_ns + jump, 16.0, arrival=at_ns)[0] for at_ns in arrivals[:40]) == -Count.IMPLAUSIBLE
    assert guard.counts()["ACCEPTED"] == 1
    assert [guard.send(at_ns + jump, 8.0, arrival=at_ns)[0] for at_ns in arrivals[40:]].count(ACCEPTED_AFTER_DOUBT) == 1


def test_other_channels_may_leap(guard):
    for channel in range(1, layout.FIRST_AXLE):
        assert guard.send(0, 0.0, channel)[0] == ACCEPTED_IN_ORDER
        assert guard.send(1, 1000.0, channel)[0] == ACCEPTED_IN_ORDER


# No feed-forward


def test_enable_holds_for_its_time(guard):
    guard.send(0)
    assert guard.inputs().fed == 1.0
    guard.k.number.enable_hold_ns = S
    assert guard.inputs().fed == 0.0
    assert guard.reasons() & (Reason.ENABLE_OLD | Reason.DISABLED) == Reason.ENABLE_OLD
    guard.send(0, 1.0, layout.ENABLE)
    guard.send(S)
    assert (guard.inputs().fed, guard.reasons() & Reason.ENABLE_OLD) == (1.0, 0)
    guard.send(S + 1)
    assert guard.inputs().fed == 0.0
    guard.send(S + 1, 0.0, layout.ENABLE)
    assert guard.inputs().fed == 0.0
    assert guard.reasons() & (Reason.ENABLE_OLD | Reason.DISABLED) == Reason.DISABLED


@pytest.mark.parametrize("wheel", [WHEELS, WHEELS + 1, CHANNELS - 1])
def test_wheels_that_disagree_stop_the_feedforward(guard, wheel):
    for start in (0, -3600 * S):  # again once the clocks went back
        for i in range(13):
            guard.send(start + i * 100 * MS, 8.0)
            guard.send(start + i * 100 * MS, 0.0, wheel)
            share = guard.inputs().fed
            assert share == (0.0 if i > 10 else 1.0)
        assert guard.reasons() & ~layout.HARMLESS & Reason.SPEED_DISAGREES  # a warning
    guard.send(start + 13 * 100 * MS, 8.0)
    guard.send(start + 13 * 100 * MS, 7.0, wheel)
    assert guard.inputs().fed == 1.0


def test_wheels_without_axles_take_only_the_vehicles_load(k):
    """The channels behind those of all vehicles are of wheel speeds then, not of loads or belts."""
    k.number.axles, k.number.first_wheel, k.number.first_belt = 0, layout.FIRST_AXLE, layout.FIRST_AXLE
    k.assembly = k.assembly[:1]
    k.assembly[0, [layout.Assembly.nominal_load, layout.Assembly.share_of_all]] = 60e3, 1.0
    memory, loads = guards.new_memory(layout.FIRST_AXLE + 1), np.zeros(1)
    memory.times[layout.FIRST_AXLE, [layout.Times.seen, layout.Times.last_arrival]] = 1, 5 * S
    memory.values[layout.FIRST_AXLE] = 7.0  # a wheel speed
    assert gather_loads(k, memory, 5 * S, loads) == (int(layout.Reason.LOAD_NOMINAL), 0.0)
    assert loads[0] == 60e3
    memory.times[layout.LOAD, [layout.Times.seen, layout.Times.last_arrival]] = 1, 5 * S
    memory.values[layout.LOAD] = 65e3
    assert gather_loads(k, memory, 5 * S, loads) == (0, 0.0)
    assert loads[0] == 65e3
