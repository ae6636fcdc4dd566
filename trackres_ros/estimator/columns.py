# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines the layout of the kernel's arrays, and the public names of its columns."""

from __future__ import annotations

from enum import IntEnum, IntFlag

from trackres_ros.recording.roles import GROUND, POSITION
from trackres_ros.vehicle import AnyVehicle

# Channels: what can arrive. Loads by axle and assembly, belt temperatures by assembly, and wheel speeds follow these.
(
    SPEED,
    LOAD,
    TORQUE,
    AMBIENT,
    BELT,
    ACCEL,
    GRADE,
    YAW_RATE,
    HEADING,
    DISTANCE,
    PASSENGERS,
    LATITUDE,
    LONGITUDE,
    ENABLE,
    ALTITUDE,
    SPECIFIC_FORCE,
) = range(16)
CHANNELS = (
    "speed", "load", "torque", "ambient", "belt", "accel", "grade", "yaw_rate", "heading", "distance", "passengers", *POSITION,
    "enable", *GROUND,
)  # fmt: skip
FIRST_AXLE = len(CHANNELS)
WHEELS = "wheel_speed"

# Constants of an assembly; those of one KIND differ in nothing but the axle and load shares. INNER_CONDUCTANCE lies between the
# mean and the surface where these are two nodes, SKIN_CONDUCTANCE between the last node and what a sensor sees, infinite where
# they are one. From CONSIDER_FACTOR on the 4 x 4 factor of its uncertainty, row by row.
(
    AXLE,
    TABLE,
    NOMINAL_LOAD,
    RADIUS,
    CAPACITY,
    SURFACE_SHARE,
    INNER_CONDUCTANCE,
    SKIN_CONDUCTANCE,
    AREA,
    FILM_OFFSET,
    FILM_SLOPE,
    FIRST_LOG_LOAD,
    STEP_LOG_LOAD,
    KIND,
    SHARE_OF_AXLE,
    SHARE_OF_ALL,
    CONSIDER_FACTOR,
) = range(17)
CONSIDER_LOSS, CONSIDER_COOLING, CONSIDER_CAPACITY, CONSIDER_RADIUS = (CONSIDER_FACTOR + 4 * row for row in range(4))
# Behind it the inverse of its first three rows and columns: how much of each cause makes a loss, a cooling or a capacity that is
# larger by its whole, and moves no other of the three.
CAUSES_OF = CONSIDER_FACTOR + 16

# What an assembly adds to the totals of a step: torques by part, heat and cooling, uncertainty by the ambient temperature and
# by noise, the arm of a force on the whole vehicle, what resists without its sign, which assembly it is computed as; from
# PART_BY on what a larger loss, cooling and capacity would add, and a belt warmer by a kelvin; from PART_CONSIDER on its four
# causes of uncertainty.
(
    PART_HYSTERESIS,
    PART_BEARING,
    PART_WIND,
    PART_GRADE,
    PART_INERTIA,
    PART_HEAT,
    PART_COOLING,
    PART_CONSIDER_AMBIENT,
    PART_NOISE,
    PART_ARM,
    PART_UNSIGNED,
    PART_TWIN,
    PART_BY,
) = range(13)
PART_CONSIDER = PART_BY + 4
PARTS = PART_CONSIDER + 4

# Columns of an assembly's belt state, [K] but the first: temperature, then what each cause of uncertainty makes of it, as a
# consider parameter of a Schmidt-Kalman filter. Uncertainty in loss, cooling, capacity and radius is one 4 x 4 factor; the
# radius moves no temperature and has no column.
TEMPERATURE, CONSIDER_1, CONSIDER_2, CONSIDER_3, CONSIDER_AMBIENT, NOISE_1, NOISE_2 = range(7)
BELT_COLUMNS = 7

# The motion state: filtered speed and acceleration, their covariance, the quantum seen, and of the last step
# speed, feed-forward and drive torque; what the feed-forward is on its way to, and whether the vehicle rolls (1) or stands (0);
# and what of the last drive torque was not the belts' or the effects'.
(
    FILTERED_SPEED,
    FILTERED_ACCEL,
    COV_SPEED,
    COV_BOTH,
    COV_ACCEL,
    QUANTUM,
    LAST_SPEED,
    FEEDFORWARD,
    LAST_DRIVE,
    STARTED,
    FEEDFORWARD_TARGET,
    ROLLS,
    LAST_OTHERS,
) = range(13)
MOTION_COLUMNS = 13
# What can be learned of a vehicle while it drives, as departures from its file: of the loss, the cooling and the heat capacity of
# its belts, the friction of its bearings, its drag, and its mass where it accelerates, each over its value there; and of the
# temperature of its belts [K].
OF_LOSS, OF_COOLING, OF_CAPACITY, OF_BELT, OF_BEARING, OF_DRAG, OF_MASS = range(7)
LEARNABLE = 7
# The memory of what was learned: whether it acts (1) or not (0), the departures, a torque against travel that goes on [Nm], the
# standard deviation of what wanders [Nm], the lower factor of the departures' covariance row by row, and of the last step how
# much driving torque each departure adds, by its whole or per kelvin [Nm].
LEARNED_ON, DEPARTURES = 0, 1
LEARNED_TORQUE, LEARNED_SLOW = DEPARTURES + LEARNABLE, DEPARTURES + LEARNABLE + 1
LEARNED_FACTOR = LEARNED_SLOW + 1
SENSITIVITIES = LEARNED_FACTOR + LEARNABLE * LEARNABLE
LEARNED_COLUMNS = SENSITIVITIES + LEARNABLE
START_ANEW = -1.0  # in STARTED: time went back, the next speed starts cold and says so

# What the guards remember of a channel; of the speed from DOUBTS on, see `plausible_speed`.
(
    SEEN,
    LAST_STAMP,
    LAST_ARRIVAL,
    SUSPECTS,
    SUSPECT_STAMP,
    SUSPECT_ARRIVAL,
    UNCHANGED_SINCE,
    FRESH,
    DOUBTS,
    DOUBT_SINCE,
    DOUBT_STAMP,
    DISAGREES_SINCE,
) = range(12)
MEMORY_COLUMNS = 12


class Count(IntEnum):
    """Counters of a channel. Each message counts in exactly one of ACCEPTED and `REFUSALS`; the others add remarks."""

    ACCEPTED = 0
    NON_FINITE = 1
    OUT_OF_RANGE = 2
    DUPLICATE = 3
    LATE = 4
    FUTURE = 5
    BACKWARD = 6
    ZERO_STAMP = 7
    GAP = 8
    CLOCK_JUMP = 9
    RESET = 10
    IMPLAUSIBLE = 11


REFUSALS = (*(Count(i) for i in range(Count.NON_FINITE, Count.BACKWARD + 1)), Count.IMPLAUSIBLE)


class Reason(IntFlag):
    """Why the status is not plainly good; several may hold."""

    NONE = 0
    LOAD_HELD = 1 << 0
    LOAD_NOMINAL = 1 << 1
    AMBIENT_NOMINAL = 1 << 2
    SPEED_STUCK = 1 << 3
    GAP_BRIDGED = 1 << 4
    GAP_UNKNOWN = 1 << 5
    CLOCK_JUMPED = 1 << 6
    TIME_RESET = 1 << 7
    BELT_UNSURE = 1 << 8
    BELT_SENSOR_DISAGREES = 1 << 9
    OUTSIDE_TABLE = 1 << 10
    FEEDFORWARD_CLAMPED = 1 << 11
    FEEDFORWARD_RATE_LIMITED = 1 << 12
    SPEED_QUANTISED = 1 << 13
    EFFECT_LEFT_OUT = 1 << 14
    SURROUNDINGS = 1 << 15
    OUTSIDE_LEARNED = 1 << 16
    OFF_ROUTE = 1 << 17
    PLACE_UNKNOWN = 1 << 18
    SPEED_IMPLAUSIBLE = 1 << 19
    SPEED_DISAGREES = 1 << 20
    DISABLED = 1 << 21
    ENABLE_OLD = 1 << 22


REASON_TEXT = {
    Reason.LOAD_HELD: "no recent load: the estimate uses the last one",
    Reason.LOAD_NOMINAL: "no load: the estimate uses the vehicle file's nominal load",
    Reason.AMBIENT_NOMINAL: "no ambient temperature: the estimate uses the vehicle file's",
    Reason.SPEED_STUCK: "the speed has not changed for a long time while moving",
    Reason.GAP_BRIDGED: "a gap in the speed was interpolated linearly",
    Reason.GAP_UNKNOWN: "a long gap in the speed: the belt temperature is between that of standing and of driving on",
    Reason.CLOCK_JUMPED: "the stamps jumped relative to arrival times: the arrival times are used",
    Reason.TIME_RESET: "time went back: the estimate was restarted",
    Reason.BELT_UNSURE: "the belt temperature is uncertain",
    Reason.BELT_SENSOR_DISAGREES: "the measured belt temperature is far from the estimate and was rejected",
    Reason.OUTSIDE_TABLE: "load or temperature is outside the range of the model or the rubber data: the torque is extrapolated",
    Reason.FEEDFORWARD_CLAMPED: "the feed-forward torque is at its limit",
    Reason.FEEDFORWARD_RATE_LIMITED: "the feed-forward torque is at its rate limit",
    Reason.SPEED_QUANTISED: "the speed is coarsely quantised: its acceleration is uncertain",
    Reason.EFFECT_LEFT_OUT: "an effect is inactive: an input is missing, or its output is not finite or implausible",
    Reason.SURROUNDINGS: "site, weather and ground come from the surroundings file, not from measurements",
    Reason.OUTSIDE_LEARNED: "a learned term is outside the range it was fitted on: it keeps its end value",
    Reason.OFF_ROUTE: "the surroundings file does not cover this place: the ground is assumed level and firm",
    Reason.PLACE_UNKNOWN: "the place on the route is unknown: the position is missing or old, or has no course yet",
    Reason.SPEED_IMPLAUSIBLE: "the speed changed faster than the vehicle can: samples were rejected until several agreed again",
    Reason.SPEED_DISAGREES: "the speed disagrees with all wheel speeds: the feed-forward fades to zero",
    Reason.DISABLED: "the feed-forward is not enabled: it fades to zero",
    Reason.ENABLE_OLD: "no recent enable message: the feed-forward fades to zero",
}
# Remarks that go with a fully usable estimate; any other reason makes it a warning.
HARMLESS = Reason.LOAD_HELD | Reason.FEEDFORWARD_RATE_LIMITED | Reason.GAP_BRIDGED | Reason.SPEED_QUANTISED | Reason.DISABLED

# Columns of one row of results for the whole vehicle; those of each assembly follow.
(
    OUT_SPEED,
    OUT_ACCEL,
    OUT_WEIGHT,
    OUT_AMBIENT,
    OUT_RESISTANCE,
    OUT_HYSTERESIS,
    OUT_BEARING,
    OUT_WIND,
    OUT_GRADE,
    OUT_INERTIA,
    OUT_EFFECTS,
    OUT_DRIVE,
    OUT_STD,
    OUT_FEEDFORWARD,
    OUT_MOTOR,
    OUT_MEASURED,
    OUT_RESIDUAL,
    OUT_HEAT,
    OUT_COOLING,
    OUT_REASONS,
) = range(20)
VEHICLE_COLUMNS = (
    "speed_mps",
    "accel_mps2",
    "weight_n",
    "ambient_degc",
    "resistance_torque_nm",
    "hysteresis_nm",
    "bearing_nm",
    "wind_nm",
    "grade_nm",
    "inertia_nm",
    "effects_nm",
    "drive_torque_nm",
    "resistance_std_nm",
    "feedforward_torque_nm",
    "motor_torque_nm",
    "measured_torque_nm",
    "residual_nm",
    "heat_w",
    "cooling_w",
    "reasons",
)
PER_BELT, PER_SURFACE, PER_STD, PER_LOAD, PER_RESISTANCE, PER_HYSTERESIS = range(6)
ASSEMBLY_COLUMNS = ("belt_degc", "surface_degc", "belt_std_k", "load_n", "resistance_torque_nm", "hysteresis_nm")


def channels(vehicle: AnyVehicle) -> tuple[str, ...]:
    """Names of all channels of a vehicle, in the order of their indices."""
    axles, assemblies = [a.name for a in vehicle.axles], [a.name for a in vehicle.assemblies]
    return (
        *CHANNELS,
        *(f"load/{name}" for name in axles),
        *(f"load/{name}" for name in assemblies),
        *(f"belt/{name}" for name in assemblies),
        WHEELS,
        *(f"{WHEELS}/{name}" for name in (*axles, *assemblies)),
    )


def columns(vehicle: AnyVehicle) -> tuple[str, ...]:
    """Names of the columns of one row of results; those of an assembly end in its name."""
    return (*VEHICLE_COLUMNS, *(f"{name}/{a.name}" for a in vehicle.assemblies for name in ASSEMBLY_COLUMNS))
