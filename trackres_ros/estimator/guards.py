# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks each message before use: order, age and plausibility. The policy is docs/robustness.md.

A message is one number with its channel, its stamp and its arrival. It is accepted or refused, and increments
exactly one counter. Times are stamps; the arrival only checks whether stamps can be right. A message that waited in a queue
keeps the arrival that its stamp tells. Positions go to the route follower: each step reads slope and torque of the place from it.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np

from trackres_ros.arrays import Array, IntArray
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.columns import Assembly, Count, Motion, Reason, Run, Times, Tracked
from trackres_ros.estimator.constants import LEAST_LOAD_SHARE, Constants
from trackres_ros.estimator.motion import is_noise
from trackres_ros.estimator.plausible import (
    FRESH_LOAD_NS,
    LOAD_PER_S,
    LOAD_SLACK,
    NOTHING_TRACKED,
    integrate_speed,
    is_load,
    is_near,
    load_is_plausible,
    load_std,
    move_clock,
    seems_to_stand,
    speed_is_plausible,
    speeds_disagree,
    take_odometer,
    trust_value,
)
from trackres_ros.estimator.records import Inputs, Scratch
from trackres_ros.kernels.marks import kernel, length
from trackres_ros.route.follower import (
    FOLLOWED,
    NOTHING_YET,
    PLACE_KNOWN,
    SLOPE,
    TORQUE,
    TORQUE_STD,
    drive_on,
    forget_position,
    look_up_ground,
    take_position,
)
from trackres_ros.route.track import FARTHEST_M, flat
from trackres_ros.units import NANOSECOND

# Ground by position

TOGETHER_NS = 50_000_000  # between the stamps of latitude and longitude: a bus sends them in two messages
PLACE_UNKNOWN = int(Reason.PLACE_UNKNOWN)


@kernel
def has_route(k: Constants) -> bool:
    """Whether the surroundings have data by place."""
    return k.number.slopes_by_place or k.number.torques_by_place


@kernel
def take_new_position(k: Constants, times: IntArray, values: Array, follower: Array) -> None:
    """A latitude or a longitude was accepted: it is a position once both of about one time came. Each serves one position."""
    latitude, longitude = Times(times[layout.LATITUDE]), Times(times[layout.LONGITUDE])
    if not has_route(k) or latitude.fresh == 0 or longitude.fresh == 0:
        return
    if abs(latitude.last_stamp - longitude.last_stamp) <= TOGETHER_NS:
        latitude.fresh = longitude.fresh = 0
        position_at(k, follower, values[layout.LATITUDE], values[layout.LONGITUDE])


@kernel
def position_at(k: Constants, follower: Array, latitude: float, longitude: float) -> None:
    """It is at a position [rad]."""
    x, y = flat(k.number.route_latitude, k.number.route_longitude, latitude, longitude)
    if not length(x, y) < FARTHEST_M:
        x = y = math.nan
    take_position(follower, x, y)


@kernel
def ground_now(k: Constants, times: IntArray, follower: Array, speed: float, elapsed: int) -> tuple[float, float, float, bool]:
    """Ground at an accepted speed [m/s], given the time since the last one [ns].

    Returns
    -------
    slope, torque, torque_std, known
        Slope in the vehicle's direction, torque against travel [Nm] and its standard deviation, nan where unknown; and whether
        the position on the route is known.
    """
    if not has_route(k):
        return math.nan, math.nan, math.nan, True
    speed_times, latitude, longitude = Times(times[layout.SPEED]), Times(times[layout.LATITUDE]), Times(times[layout.LONGITUDE])
    # If half of a position was refused, the earlier half is used.
    since_position = speed_times.last_stamp - min(latitude.last_stamp, longitude.last_stamp)
    drive_on(follower, speed, min(elapsed, k.number.position_hold_ns) * NANOSECOND, since_position * NANOSECOND)
    is_old = speed_times.last_arrival - min(latitude.last_arrival, longitude.last_arrival) > k.number.position_hold_ns
    look_up_ground(k.route_cells, k.route_places, follower, is_old)
    return follower[SLOPE], follower[TORQUE], follower[TORQUE_STD], follower[PLACE_KNOWN] > 0.0


@kernel
def is_missing(k: Constants, grade: float, slope: float, torque: float) -> bool:
    """Whether the surroundings have data by place, but not for this one. A measured slope has priority over theirs."""
    no_slope = k.number.slopes_by_place and math.isnan(grade) and math.isnan(slope)
    return no_slope or (k.number.torques_by_place and math.isnan(torque))


@kernel
def place_reason(k: Constants, has_position: bool, grade: float, slope: float, torque: float) -> int:
    """The reason to report if the surroundings have no data because the place is unknown, else 0."""
    return PLACE_UNKNOWN if not has_position and is_missing(k, grade, slope, torque) else 0


@kernel
def follow_along(
    k: Constants,
    follower: Array,
    times: Array,
    speeds: Array,
    latitudes: Array,
    longitudes: Array,
    rows: Annotated[Array, (None, 4)],
) -> None:
    """Follow a drive; fill one row of `rows` per time, as `records.GroundSeries`. A missing position is nan."""
    at_s = -math.inf
    for i in range(times.shape[0]):
        if not (math.isnan(latitudes[i]) or math.isnan(longitudes[i])):
            position_at(k, follower, latitudes[i], longitudes[i])
            at_s = times[i]
        dt, hold_s = times[i] - times[max(i - 1, 0)], k.number.position_hold_ns * NANOSECOND
        drive_on(follower, speeds[i], min(dt, hold_s), times[i] - at_s)
        look_up_ground(k.route_cells, k.route_places, follower, times[i] - at_s > hold_s)
        rows[i, 0], rows[i, 1], rows[i, 2] = follower[SLOPE], follower[TORQUE], follower[TORQUE_STD]
        rows[i, 3] = follower[PLACE_KNOWN]


# Guards

ACCEPTED, NON_FINITE, OUT_OF_RANGE = int(Count.ACCEPTED), int(Count.NON_FINITE), int(Count.OUT_OF_RANGE)
DUPLICATE, LATE, FUTURE, BACKWARD = (
    int(Count.DUPLICATE),
    int(Count.LATE),
    int(Count.FUTURE),
    int(Count.BACKWARD),
)
ZERO_STAMP, GAP, CLOCK_JUMP, RESET = (
    int(Count.ZERO_STAMP),
    int(Count.GAP),
    int(Count.CLOCK_JUMP),
    int(Count.RESET),
)
IMPLAUSIBLE = int(Count.IMPLAUSIBLE)
LOAD_HELD, LOAD_NOMINAL = int(Reason.LOAD_HELD), int(Reason.LOAD_NOMINAL)
LOAD_DOUBTED, LOAD_OLD, SPEED_SLOW = int(Reason.LOAD_DOUBTED), int(Reason.LOAD_OLD), int(Reason.SPEED_SLOW)
SPEED_QUANTISED = int(Reason.SPEED_QUANTISED)
AMBIENT_NOMINAL, SPEED_STUCK = int(Reason.AMBIENT_NOMINAL), int(Reason.SPEED_STUCK)
CLOCK_JUMPED, TIME_RESET = int(Reason.CLOCK_JUMPED), int(Reason.TIME_RESET)
SPEED_IMPLAUSIBLE, SPEED_DISAGREES = int(Reason.SPEED_IMPLAUSIBLE), int(Reason.SPEED_DISAGREES)
DISABLED, ENABLE_OLD = int(Reason.DISABLED), int(Reason.ENABLE_OLD)

SEEN, LAST_ARRIVAL, FRESH = Times.seen, Times.last_arrival, Times.fresh  # of one channel among many
OLD_LOAD_NS = FRESH_LOAD_NS + int(0.5 * LOAD_SLACK / LOAD_PER_S / NANOSECOND)  # half of what it may change in the end
FIRST_PERIOD_NS = 333_333_333  # ours: a third of a second is what the age limits of 0.5 s are for
STANDING = 1e-3  # m/s: slower is no movement that could be stuck
QUANTISED = (0.05, 1.0)  # m/s: a smallest step between these is a bus's resolution, not noise
QUANTISED_PATIENCE = 10  # in a steady drive such a bus repeats one value for minutes

# Results of admit() for an accepted message; a refusal is a negative counter.
ACCEPTED_IN_ORDER, ACCEPTED_AFTER_JUMP, ACCEPTED_AFTER_RESET, ACCEPTED_AFTER_DOUBT = 0, 1, 2, 3


class Memory(NamedTuple):
    """Memory of the guards, one row per channel. All arrays are changed in place."""

    times: Annotated[IntArray, (None, layout.Times.columns)]
    values: Array  # last accepted value
    counters: Annotated[IntArray, (None, len(Count))]
    reasons: IntArray  # (reasons,) steps with each reason
    followed: Annotated[Array, (FOLLOWED,)]  # position on a route, see `route.follower`
    tracked: Annotated[Array, (layout.Tracked.columns,)]
    runs: Annotated[Array, (None, layout.Run.columns)]


def new_memory(channels: int) -> Memory:
    """Memory of a new session."""
    return Memory(
        np.zeros((channels, layout.Times.columns), dtype=np.int64),
        np.full(channels, np.nan),
        np.zeros((channels, len(Count)), dtype=np.int64),
        np.zeros(len(layout.REASON_TEXT), dtype=np.int64),
        np.array(NOTHING_YET),
        np.array(NOTHING_TRACKED),
        np.full((channels, layout.Run.columns), np.nan),
    )


@kernel
def has_jumped(k: Constants, times: Times, stamp: int, arrival: int, is_behind: bool) -> bool:
    """Whether enough messages in a row agree on a new offset between stamp and arrival; record one more.

    A queue that was left full gives many at once, with stamps behind their arrivals. So these must also go on for a while (ours).
    """
    stamp_step, arrival_step = stamp - times.suspect_stamp, arrival - times.suspect_arrival
    agrees = times.suspects > 0 and stamp_step > 0 and abs(stamp_step - arrival_step) <= k.number.clock_jump_ns
    times.suspects = min(times.suspects + 1, k.number.jumps_to_accept) if agrees else 1
    if not (agrees and is_behind):
        times.suspect_stamp, times.suspect_arrival = stamp, arrival
    return times.suspects >= k.number.jumps_to_accept and (not is_behind or arrival_step > k.number.clock_jump_ns)


@kernel
def learn_period(times: Times, elapsed: int) -> None:
    """Follow the period of a channel's messages, by at most half of it each time (ours): it is near the median of the last few.

    So a single pause is no period, and a sensor of 50 Hz counts as a slow one only after seven long pauses in a row.
    """
    if times.period == 0:
        times.period = min(elapsed, FIRST_PERIOD_NS)
    elif elapsed > times.period:
        times.period = min(elapsed, times.period + times.period // 2 + 1)
    else:
        times.period = max(elapsed, times.period - times.period // 3)


@kernel
def slow_ns(k: Constants, times: Times) -> int:
    """Age [ns] to which the last value of a channel may be used as its messages come so rarely, whatever the setting.

    With half a period for jitter, the last value holds until the next one. No pause is longer than the bound: a sensor that has
    failed is not believed for having been slow.
    """
    return min(times.period + times.period // 2, k.number.slow_input_max_age_ns)


@kernel
def longest_age(k: Constants, memory: Memory) -> float:
    """Longest age of a trusted speed [s]."""
    return max(k.number.speed_max_age, slow_ns(k, Times(memory.times[layout.SPEED])) * NANOSECOND)


@kernel
def at_sprockets(k: Constants, torque: float, speed: float) -> float:
    """A measured torque at the sprockets [Nm], of one at the motor by `Gears.at_sprockets`."""
    if not k.number.torque_at_motor:
        return torque
    power, ratio, efficiency = torque * speed, k.number.motor_ratio, k.number.motor_efficiency
    if power > 0.0:
        return torque * ratio * efficiency
    return torque * ratio / efficiency if power < 0.0 else torque * ratio


@kernel
def admit_message(
    k: Constants, memory: Memory, channel: int, stamp: int, arrival: int, value: float, quantum: float
) -> tuple[int, int]:
    """Accept or refuse one message, count it, and keep its value. `quantum` is the smallest step observed in the speed [m/s].

    Returns
    -------
    outcome, elapsed
        ACCEPTED_IN_ORDER, ACCEPTED_AFTER_JUMP, ACCEPTED_AFTER_RESET, ACCEPTED_AFTER_DOUBT, or minus the counter of the refusal;
        and the time [ns] since the channel's last message.
    """
    times, counters, run = Times(memory.times[channel]), memory.counters[channel], Run(memory.runs[channel])
    if not math.isfinite(value):
        counters[NON_FINITE] += 1
        return -NON_FINITE, 0
    if value < k.channel_limits[channel, 0] or value > k.channel_limits[channel, 1]:
        counters[OUT_OF_RANGE] += 1
        return -OUT_OF_RANGE, 0
    if stamp == 0 and arrival != 0:
        counters[ZERO_STAMP] += 1
        stamp = arrival
        if times.seen:  # by the last message's offset between stamp and arrival
            stamp += times.last_stamp - times.last_arrival
    outcome, elapsed, is_behind = ACCEPTED_IN_ORDER, 0, False
    if times.seen:
        stamp_step, arrival_step = stamp - times.last_stamp, arrival - times.last_arrival
        elapsed = stamp_step
        behind_doubt = times.doubts > 0 and stamp_step > 0 and stamp <= times.doubt_stamp
        if stamp_step == 0 or (behind_doubt and stamp == times.doubt_stamp):
            counters[DUPLICATE] += 1
            return -DUPLICATE, 0
        if behind_doubt or (stamp_step < 0 and -stamp_step <= k.number.clock_jump_ns):
            counters[LATE] += 1
            return -LATE, 0
        if stamp_step < 0 and arrival_step < -k.number.clock_jump_ns:
            counters[RESET] += 1
            outcome, elapsed = ACCEPTED_AFTER_RESET, 0
            times.disagrees_since = 0
        elif stamp_step < 0 or max(stamp_step - max(arrival_step, 0), arrival_step - stamp_step) > k.number.clock_jump_ns:
            is_behind = 0 < stamp_step < arrival_step
            if has_jumped(k, times, stamp, arrival, is_behind):
                outcome, elapsed, is_behind = ACCEPTED_AFTER_JUMP, max(arrival_step, 0), False
                if channel == layout.SPEED:
                    if not is_near(k, run, elapsed, value, quantum):  # the clock of who sends this is none to go by
                        counters[IMPLAUSIBLE] += 1
                        return -IMPLAUSIBLE, 0
                    move_clock(times, stamp_step - elapsed)
                counters[CLOCK_JUMP] += 1
            elif is_behind:
                arrival = times.last_arrival + stamp_step  # it waited: its age is that of its stamp
            else:
                refusal = FUTURE if stamp_step > 0 else BACKWARD
                counters[refusal] += 1
                return -refusal, 0
    if channel == layout.SPEED or is_load(k, channel):
        in_doubt = times.doubts > 0
        if may_change_at_will(k, memory, channel, arrival, quantum) or outcome == ACCEPTED_AFTER_RESET:
            trust_value(times, run, value)
        elif not is_plausible(k, times, run, channel, stamp, elapsed, value, quantum):
            counters[IMPLAUSIBLE] += 1
            return -IMPLAUSIBLE, 0
        elif in_doubt:
            outcome = ACCEPTED_AFTER_DOUBT
    elif channel == layout.DISTANCE:
        take_odometer(k, Tracked(memory.tracked), value, elapsed)
    if outcome == ACCEPTED_IN_ORDER and elapsed > 0:
        learn_period(times, elapsed)
    has_pause = elapsed * NANOSECOND > k.number.bridge  # the values meanwhile are unknown
    if not times.seen or has_pause or value != memory.values[channel] or outcome != ACCEPTED_IN_ORDER:
        times.unchanged_since = stamp
    times.seen, times.last_stamp, times.last_arrival = 1, stamp, arrival
    times.fresh = 1
    if not is_behind:
        times.suspects = 0
    memory.values[channel] = value
    counters[ACCEPTED] += 1
    return outcome, elapsed


@kernel
def may_change_at_will(k: Constants, memory: Memory, channel: int, time_ns: int, quantum: float) -> bool:
    """Whether a speed or load that arrives now may have any value: the first one, and a load at standstill, or after a time in
    which the last one was not used any more.
    """
    if memory.times[channel, SEEN] == 0:
        return True
    if channel == layout.SPEED:
        return False
    is_driving = not is_noise(memory.values[layout.SPEED], quantum, k.number.speed_variance, True)
    hold_ns = k.number.passengers_hold_ns if channel == layout.PASSENGERS else k.number.load_hold_ns
    return not is_driving or time_ns - memory.times[channel, LAST_ARRIVAL] > hold_ns


@kernel
def is_plausible(
    k: Constants, times: Times, run: Run, channel: int, stamp: int, elapsed: int, value: float, quantum: float
) -> bool:
    """Whether the vehicle can have changed its speed, or its load, so fast."""
    if channel == layout.SPEED:
        return speed_is_plausible(k, times, run, stamp, elapsed, value, quantum)
    return load_is_plausible(k, times, run, channel, stamp, elapsed, value)


@kernel
def forget_others(memory: Memory, kept_channel: int) -> None:
    """Forget times and values of all channels but one, as at the start; counters stay."""
    for channel in range(memory.times.shape[0]):
        if channel != kept_channel:
            memory.times[channel, :] = 0
            memory.values[channel] = math.nan
            memory.runs[channel, :] = math.nan
    forget_position(memory.followed)
    for i in range(memory.tracked.shape[0]):
        memory.tracked[i] = NOTHING_TRACKED[i]
    if kept_channel == layout.SPEED:
        trust_value(Times(memory.times[kept_channel]), Run(memory.runs[kept_channel]), memory.values[kept_channel])


@kernel
def held_value(memory: Memory, channel: int, time_ns: int, hold_ns: int) -> float:
    """The last value of a channel if it arrived within `hold_ns`, else nan."""
    if memory.times[channel, SEEN] == 0 or time_ns - memory.times[channel, LAST_ARRIVAL] > hold_ns:
        return math.nan
    return float(memory.values[channel])


@kernel
def held_motion(k: Constants, memory: Memory, channel: int, time_ns: int) -> float:
    """The last acceleration, grade, yaw rate or heading, nan where it is too old for the period in which it comes."""
    return held_value(memory, channel, time_ns, max(k.number.motion_hold_ns, slow_ns(k, Times(memory.times[channel]))))


@kernel
def ambient_now(k: Constants, memory: Memory, motion: Motion, time_ns: int) -> tuple[float, float, int]:
    """Ambient temperature [degC] at an arrival, its standard deviation [K], and the reason if it is assumed, else 0.

    It is assumed to be the last known, also before a time off; without one it is the nominal one.
    """
    ambient = held_value(memory, layout.AMBIENT, time_ns, k.number.ambient_hold_ns)
    if not math.isnan(ambient):
        return ambient, k.number.ambient_std, 0
    if memory.times[layout.AMBIENT, SEEN] != 0:
        last_ambient = float(memory.values[layout.AMBIENT])
    else:
        last_ambient = motion.air if motion.started > 0.0 or motion.started == layout.START_COLD else k.number.nominal_ambient
    return last_ambient, k.number.ambient_unknown_std, AMBIENT_NOMINAL


@kernel
def not_enabled(k: Constants, memory: Memory, time_ns: int) -> int:
    """Reason why the feed-forward is zero at an arrival [ns], else 0.

    It is not enabled, or a required enable has expired, or the vehicle may stand: even then nothing may push it.
    """
    if Times(memory.times[layout.SPEED]).doubts > 0 and seems_to_stand(k, Run(memory.runs[layout.SPEED])):
        return SPEED_IMPLAUSIBLE
    if k.number.enable_hold_ns == 0:
        return DISABLED if memory.values[layout.ENABLE] <= 0.0 else 0
    enable = held_value(memory, layout.ENABLE, time_ns, k.number.enable_hold_ns)
    if math.isnan(enable):
        return ENABLE_OLD
    return 0 if enable > 0.0 else DISABLED


@kernel
def reasons_of_load(memory: Memory, channel: int, time_ns: int) -> int:
    """Reasons to report where the last load of a channel is used."""
    age_ns, reasons = time_ns - memory.times[channel, LAST_ARRIVAL], 0
    if age_ns > FRESH_LOAD_NS:
        reasons |= LOAD_HELD
    if age_ns > OLD_LOAD_NS:
        reasons |= LOAD_OLD
    if Times(memory.times[channel]).doubts > 0:
        reasons |= LOAD_DOUBTED
    return reasons


@kernel
def unsure_load(k: Constants, memory: Memory, channel: int, time_ns: int) -> float:
    """Standard deviation of the last load of a channel [N]; of passengers their number."""
    return load_std(k, Times(memory.times[channel]), Run(memory.runs[channel]), channel, memory.values[channel], time_ns)


@kernel
def share_rest(k: Constants, memory: Memory, channel: int, axle: int, time_ns: int, loads: Array) -> tuple[int, float]:
    """Share a load [N], less those already known, among the assemblies without one; return the reasons to report, and the
    standard deviation of what is shared [N].

    It is the load of an axle, or with `axle` -1 of all. In proportion to nominal loads, and no less than a plausible load.
    """
    remainder, share = held_value(memory, channel, time_ns, k.number.load_hold_ns), 0.0
    for i in range(loads.shape[0]):
        assembly = Assembly(k.assembly[i])
        if axle < 0 or int(assembly.axle) == axle:
            if math.isnan(loads[i]):
                share += assembly.share_of_all
            else:
                remainder -= loads[i]
    if math.isnan(remainder) or share == 0.0:
        return 0, 0.0
    for i in range(loads.shape[0]):
        assembly = Assembly(k.assembly[i])
        if math.isnan(loads[i]) and (axle < 0 or int(assembly.axle) == axle):
            loads[i] = max(remainder * (assembly.share_of_all / share), LEAST_LOAD_SHARE * assembly.nominal_load)
    return reasons_of_load(memory, channel, time_ns), unsure_load(k, memory, channel, time_ns)


@kernel
def gather_loads(k: Constants, memory: Memory, time_ns: int, loads: Array) -> tuple[int, float]:
    """Load of each assembly [N] from the finest source available; fill `loads`, return the reasons to report, and the standard
    deviation of all together [N], as if all departed alike.

    A load of the assembly has priority over one of its axle, and that over the total. Without any, passengers add to the nominal
    loads. A load that is too old, or doubted, adds to the standard deviation; one that was never given is the vehicle file's.
    """
    first_assembly = layout.FIRST_AXLE + k.number.axles
    reasons, std_sum = 0, 0.0
    for i in range(loads.shape[0]):
        loads[i] = math.nan
        if k.number.axles > 0:
            loads[i] = held_value(memory, first_assembly + i, time_ns, k.number.load_hold_ns)
            if not math.isnan(loads[i]):
                reasons |= reasons_of_load(memory, first_assembly + i, time_ns)
                std_sum += unsure_load(k, memory, first_assembly + i, time_ns)
    for axle in range(k.number.axles):
        load_reasons, std = share_rest(k, memory, layout.FIRST_AXLE + axle, axle, time_ns, loads)
        reasons, std_sum = reasons | load_reasons, std_sum + std
    load_reasons, std = share_rest(k, memory, layout.LOAD, -1, time_ns, loads)
    reasons, std_sum = reasons | load_reasons, std_sum + std
    payload = held_value(memory, layout.PASSENGERS, time_ns, k.number.passengers_hold_ns) * k.number.passenger_weight
    was_known = memory.times[layout.LOAD, SEEN] != 0
    for channel in range(layout.FIRST_AXLE, k.number.first_belt):
        was_known = was_known or memory.times[channel, SEEN] != 0
    known_share = 0.0
    for i in range(loads.shape[0]):
        assembly = Assembly(k.assembly[i])
        if math.isnan(loads[i]) and not math.isnan(payload):
            loads[i] = assembly.nominal_load + payload * assembly.share_of_all
            known_share += assembly.share_of_all
        elif math.isnan(loads[i]):
            loads[i] = assembly.nominal_load
            reasons |= LOAD_NOMINAL
            if was_known:
                std_sum += LOAD_SLACK * assembly.nominal_load
    if known_share > 0.0:
        std_sum += known_share * k.number.passenger_weight * unsure_load(k, memory, layout.PASSENGERS, time_ns)
        if Times(memory.times[layout.PASSENGERS]).doubts > 0:
            reasons |= LOAD_DOUBTED
    return reasons, std_sum


@kernel
def gather_inputs(k: Constants, memory: Memory, scratch: Scratch, outcome: int, elapsed: int, motion: Motion) -> Inputs:
    """Inputs of the step at an accepted speed; loads and belt temperatures are in the scratch memory.

    `motion` holds whether any channel reset the time, and the smallest step observed in the speed.
    """
    times, odometer, belt_measured = Times(memory.times[layout.SPEED]), Tracked(memory.tracked), scratch.belt_measured
    time_ns, stamp = times.last_arrival, times.last_stamp
    speed = memory.values[layout.SPEED]
    reasons, std_sum = gather_loads(k, memory, time_ns, scratch.loads)
    if outcome == ACCEPTED_AFTER_JUMP:
        reasons |= CLOCK_JUMPED
    elif outcome == ACCEPTED_AFTER_DOUBT:
        reasons |= SPEED_IMPLAUSIBLE
    if motion.started == layout.START_ANEW:
        reasons |= TIME_RESET
    patience, quantum = 1, motion.quantum
    if motion.started > 0.0 and QUANTISED[0] < quantum < QUANTISED[1]:
        patience = QUANTISED_PATIENCE
        reasons |= SPEED_QUANTISED
    if longest_age(k, memory) > k.number.speed_max_age:
        reasons |= SPEED_SLOW
    if abs(speed) > STANDING and stamp - times.unchanged_since > k.number.stuck_ns * patience:
        reasons |= SPEED_STUCK
    ambient, ambient_std, ambient_reasons = ambient_now(k, memory, motion, time_ns)
    reasons |= ambient_reasons
    for i in range(belt_measured.shape[0]):
        belt_measured[i] = math.nan
        for channel in (layout.BELT, k.number.first_belt + i):
            age = (time_ns - memory.times[channel, LAST_ARRIVAL]) * NANOSECOND
            if memory.times[channel, FRESH] and age <= k.number.bridge:  # an older one is of the belt before a pause
                belt_measured[i] = memory.values[channel]
    memory.times[layout.BELT, FRESH] = 0
    for i in range(belt_measured.shape[0]):
        memory.times[k.number.first_belt + i, FRESH] = 0
    grade = held_motion(k, memory, layout.GRADE, time_ns)
    slope, torque, torque_std, has_position = ground_now(k, memory.times, memory.followed, speed, elapsed)
    reasons |= place_reason(k, has_position, grade, slope, torque)
    stop_reasons = not_enabled(k, memory, time_ns)
    integrate_speed(k, odometer, speed, elapsed)
    silence = (time_ns - memory.times[layout.DISTANCE, LAST_ARRIVAL]) * NANOSECOND  # the odometer
    last_speed = motion.last_speed if motion.started > 0.0 else speed
    if speeds_disagree(k, memory.times, memory.values, last_speed, speed, time_ns) or (
        odometer.apart > 0.0 and silence <= k.number.bridge
    ):
        stop_reasons |= SPEED_DISAGREES
    return Inputs(
        speed,
        scratch.loads,
        ambient,
        ambient_std,
        belt_measured,
        held_motion(k, memory, layout.ACCEL, time_ns),
        grade,
        held_motion(k, memory, layout.YAW_RATE, time_ns),
        held_motion(k, memory, layout.HEADING, time_ns),
        math.nan,  # an odometer starts at any value; the distance is integrated from the speed, as in a fit
        at_sprockets(k, held_value(memory, layout.TORQUE, time_ns, k.number.torque_hold_ns), speed),
        slope,
        torque,
        torque_std,
        reasons | stop_reasons,
        0.0 if stop_reasons else 1.0,
        std_sum,
    )
