# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines the layout of the kernel's arrays, and the public names of its columns."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum, IntFlag

from trackres_ros.errors import InputError
from trackres_ros.kernels.rows import Real, Reals, Row, Whole
from trackres_ros.recording.roles import GROUND, POSITION, base_role
from trackres_ros.vehicle import AnyVehicle

# Channels of messages. Loads by axle and assembly, belt temperatures by assembly, and wheel speeds follow these.
(
    SPEED, LOAD, TORQUE, AMBIENT, BELT, ACCEL, GRADE, YAW_RATE, HEADING, DISTANCE, PASSENGERS, LATITUDE, LONGITUDE, ENABLE,
    ALTITUDE, SPECIFIC_FORCE,
) = range(16)  # fmt: skip
CHANNELS = (
    "speed", "load", "torque", "ambient", "belt", "accel", "grade", "yaw_rate", "heading", "distance", "passengers", *POSITION,
    "enable", *GROUND,
)  # fmt: skip
FIRST_AXLE = len(CHANNELS)
WHEELS = "wheel_speed"


class Assembly(Row):
    """Constants of an assembly, with the symbols of docs/model.md; those of one `kind` differ only in axle and load shares."""

    axle = Real()
    table = Real()  # of the loss
    nominal_load = Real()  # N
    radius = Real()  # R_1 [m]
    capacity = Real()  # C [J/K]
    surface_share = Real()  # xi
    inner_conductance = Real()  # K [W/K], between the mean and the surface of two nodes
    skin_conductance = Real()  # W/K, between the last node and the sensor; infinite where they coincide
    area = Real()  # A_h [m^2]
    film_offset = Real()  # U_0 [W/m^2/K]
    film_slope = Real()  # U_1 [W/m^2/K per m/s]
    first_log_load = Real()  # of the table
    step_log_load = Real()
    kind = Real()
    share_of_all = Real()
    # Rows of the factor Lambda of the covariance of ln F_h, ln U A_h, ln C and ln R_1.
    consider_loss = Reals(4)
    consider_cooling = Reals(4)
    consider_capacity = Reals(4)
    consider_radius = Reals(4)
    # Inverse of Lambda's first three rows and columns: the causes that make up a relative departure of the loss, the cooling or
    # the capacity, with the other two unchanged.
    causes_of = Reals(9)


CONSIDER_FACTOR, CAUSES_OF = Assembly.consider_loss.start, Assembly.causes_of.start


class Part(Row):
    """Contribution of an assembly to the totals of a step."""

    hysteresis = Real()  # Nm
    bearing = Real()
    wind = Real()
    grade = Real()
    inertia = Real()
    heat = Real()  # W
    cooling = Real()
    consider_ambient = Real()  # Nm, by the uncertainty of the ambient temperature
    noise = Real()  # Nm^2, variance due to the random part of the temperature
    arm = Real()  # m, arm of a force on the whole vehicle
    unsigned = Real()  # Nm, resistance without its sign
    equal = Real()  # index of the first assembly with the same numbers
    torque_by = Reals(4)  # Nm per relative departure of loss, cooling and capacity, and per kelvin of belt temperature
    belt_change = Reals(3)  # K of the belt, per the first three
    consider = Reals(4)  # Nm, by each of the four causes of uncertainty


PARTS = Part.columns


class Belt(Row):
    """State of one node of a belt: its temperature, and the departures d_c [K] by cause of uncertainty, the consider parameters
    of a Schmidt-Kalman filter. Three of the four causes have one: the radius affects no temperature.
    """

    temperature = Real()  # T [degC]
    consider = Reals(3)
    consider_ambient = Real()
    noise_1 = Real()  # random part, a lower factor
    noise_2 = Real()


BELT_COLUMNS, TEMPERATURE, FIRST_DEPARTURE = Belt.columns, Belt.temperature, Belt.consider.start


class Motion(Row):
    """The motion state."""

    filtered_speed = Real()  # m/s
    filtered_accel = Real()  # m/s^2
    cov_speed = Real()  # of the two, as of the next two
    cov_both = Real()
    cov_accel = Real()
    quantum = Real()  # m/s, smallest step observed in the speed
    last_speed = Real()  # m/s; "last" values are those of the last step
    feedforward = Real()  # Nm, of the last step, or of its last turn since then, see `feedforward`
    last_drive = Real()  # Nm
    started = Real()  # 0 before the first speed, 1 after it; RESTS, START_ANEW, START_COLD
    feedforward_target = Real()  # Nm, which the feed-forward is on its way to
    rolls = Real()  # 1, or 0 at standstill
    last_others = Real()  # Nm, last drive torque without belts and effects
    update_age = Real()  # s, age of the speed at that turn; the change of this time is in the value
    to_zero = Real()  # 1 while the feed-forward is on its way to zero instead of its target, else 0
    air = Real()  # degC, of the last step, measured or assumed
    air_std = Real()  # K, of the air that is assumed: that of `Belt.consider_ambient`; 0 while it is measured
    longest_age = Real()  # s, of a trusted speed where it comes so rarely that the setting is too short; else 0


# What can be learned of a vehicle while it drives, as departures from its file: of the loss, the cooling and the heat capacity of
# its belts, the friction of its bearings, its drag, and its mass where it accelerates, each over its value there; and of the
# temperature of its belts [K].
OF_LOSS, OF_COOLING, OF_CAPACITY, OF_BELT, OF_BEARING, OF_DRAG, OF_MASS = range(7)
LEARNABLE = 7


class Learned(Row):
    """Memory of the learning."""

    on = Real()  # whether it acts (1) or not (0)
    departures = Reals(LEARNABLE)  # from the file
    torque = Real()  # Nm against travel, persistent
    slow = Real()  # Nm, standard deviation of the slow disturbance
    factor = Reals(LEARNABLE * LEARNABLE)  # lower one of the departures' covariance, row by row
    sensitivities = Reals(LEARNABLE)  # Nm of driving torque in the last step, per relative departure or per kelvin


RESTS = 0.5  # in Motion.started: belts are known, the next speed begins the motion
START_ANEW = -1.0  # and: time went back, the next speed starts cold and reports it
START_COLD = -0.5  # and: the next speed starts cold, in the air that is known


class Times(Row):
    """Memory of the guards for one channel; times in ns. The doubts are those of a speed or a load, see `plausible`."""

    seen = Whole()  # whether a message was accepted yet
    last_stamp = Whole()
    last_arrival = Whole()
    suspects = Whole()  # messages of a clock that may have jumped
    suspect_stamp = Whole()
    suspect_arrival = Whole()
    unchanged_since = Whole()
    fresh = Whole()  # whether the last value was used yet (0) or not (1)
    doubts = Whole()  # values of the run in doubt
    doubt_since = Whole()
    doubt_stamp = Whole()
    disagrees_since = Whole()  # of the speed, see `plausible`
    period = Whole()  # in which messages come, see `guards.learn_period`; 0 before two of them


class Run(Row):
    """Memory of a channel's changes, see `plausible`; in its unit."""

    reference = Real()  # of the accepted values
    doubted = Real()  # of the values in doubt


class Tracked(Row):
    """Memory for the comparison with the odometer, see `plausible`."""

    began = Real()  # m, odometer at the start of a comparison
    last = Real()  # m, its last value
    way = Real()  # m by the speed since the comparison began, unsigned
    net = Real()  # m, the same with its sign
    step = Real()  # m, the largest step of the odometer
    apart = Real()  # whether the last comparison disagreed
    change = Real()  # m, the last change of the odometer


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
    """Reasons why the status is not plainly good, each with its text; several may apply."""

    text: str

    def __new__(cls, value: int, text: str = "") -> Reason:
        """A reason with its text."""
        reason = int.__new__(cls, value)
        reason._value_, reason.text = value, text
        return reason

    NONE = 0
    LOAD_HELD = 1 << 0, "no recent load: the estimate uses the last one"
    LOAD_NOMINAL = 1 << 1, "no load: the estimate uses the vehicle file's nominal load"
    AMBIENT_NOMINAL = 1 << 2, "no ambient temperature: the estimate uses the last known, or else the vehicle file's"
    SPEED_STUCK = 1 << 3, "the speed has not changed for a long time while moving"
    GAP_BRIDGED = 1 << 4, "a gap in the speed was interpolated linearly"
    GAP_UNKNOWN = 1 << 5, "a long gap in the speed: the belt temperature is between that of standing and of driving on"
    CLOCK_JUMPED = 1 << 6, "the stamps jumped relative to arrival times: the arrival times are used"
    TIME_RESET = 1 << 7, "time went back: the estimate was restarted"
    BELT_UNSURE = 1 << 8, "the belt temperature is uncertain"
    BELT_SENSOR_DISAGREES = 1 << 9, "the measured belt temperature is far from the estimate and was rejected"
    OUTSIDE_TABLE = (
        1 << 10,
        "load or temperature is outside the range of the model or the rubber data: the torque is extrapolated",
    )
    FEEDFORWARD_CLAMPED = 1 << 11, "the feed-forward torque is at its limit"
    FEEDFORWARD_RATE_LIMITED = 1 << 12, "the feed-forward torque is at its rate limit"
    SPEED_QUANTISED = 1 << 13, "the speed is coarsely quantised: its acceleration is uncertain"
    EFFECT_LEFT_OUT = 1 << 14, "an effect is inactive: an input is missing, or its output is not finite or implausible"
    SURROUNDINGS = 1 << 15, "site, weather and ground come from the surroundings file, not from measurements"
    OUTSIDE_LEARNED = 1 << 16, "a learned term is outside the range it was fitted on: it keeps its end value"
    OFF_ROUTE = 1 << 17, "the surroundings file does not cover this place: the ground is assumed level and firm"
    PLACE_UNKNOWN = 1 << 18, "the place on the route is unknown: the position is missing or old, or has no course yet"
    SPEED_IMPLAUSIBLE = 1 << 19, "the speed changed faster than the vehicle can: samples were rejected until several agreed again"
    SPEED_DISAGREES = 1 << 20, "the speed disagrees with all wheel speeds, or with the odometer: the feed-forward fades to zero"
    DISABLED = 1 << 21, "the feed-forward is not enabled: it fades to zero"
    ENABLE_OLD = 1 << 22, "no recent enable message: the feed-forward fades to zero"
    LOAD_DOUBTED = 1 << 23, "a load jumped while driving: the estimate uses the one before until the new one has lasted"
    LOAD_OLD = 1 << 24, "the last load is old: the uncertainty of the torque has grown"
    SPEED_SLOW = 1 << 25, "the speed comes rarely: it is trusted for longer than a frequent one"


REASON_TEXT = {reason: reason.text for reason in Reason if reason}
# Remarks that go with a fully usable estimate; any other reason makes it a warning.
HARMLESS = Reason.LOAD_HELD | Reason.FEEDFORWARD_RATE_LIMITED | Reason.GAP_BRIDGED | Reason.SPEED_QUANTISED | Reason.DISABLED


class Results(Row):
    """One row of results for the whole vehicle; those of each assembly follow. Names include units."""

    speed_mps = Real()
    accel_mps2 = Real()
    weight_n = Real()
    ambient_degc = Real()
    resistance_torque_nm = Real()
    hysteresis_nm = Real()
    bearing_nm = Real()
    wind_nm = Real()
    grade_nm = Real()
    inertia_nm = Real()
    effects_nm = Real()
    drive_torque_nm = Real()
    resistance_std_nm = Real()
    feedforward_torque_nm = Real()
    motor_torque_nm = Real()
    measured_torque_nm = Real()
    residual_nm = Real()
    heat_w = Real()
    cooling_w = Real()
    reasons = Real()


class OfAssembly(Row):
    """Results for one assembly."""

    belt_degc = Real()
    surface_degc = Real()
    belt_std_k = Real()
    load_n = Real()
    resistance_torque_nm = Real()
    hysteresis_nm = Real()


VEHICLE_COLUMNS, ASSEMBLY_COLUMNS = Results.names, OfAssembly.names


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


def not_of_vehicle(role: str, channels: Sequence[str]) -> InputError:
    """The error for a role of an axle or assembly that is no channel of a vehicle."""
    alternatives = ", ".join(name for name in channels if base_role(name) == base_role(role))
    remedy = "torque: {sum: [...]} adds the torques of assemblies" if base_role(role) == "torque" else ""
    return InputError(f"role {role}", role, f"for this vehicle {alternatives}", remedy)


def columns(vehicle: AnyVehicle) -> tuple[str, ...]:
    """Names of the columns of one row of results; those of an assembly end in its name."""
    return (*VEHICLE_COLUMNS, *(f"{name}/{a.name}" for a in vehicle.assemblies for name in ASSEMBLY_COLUMNS))
