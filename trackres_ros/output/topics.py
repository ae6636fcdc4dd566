# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Lists the topics of the estimator: one table of names, types and columns, for the bag of a replay and for live.

Signs after REP-103: rolling forward is positive rotation about y. So a resistance is a negative torque. Driving torques are
positive: the feed-forward, the total drive torque, a measured torque. A quantity has one sign on all topics, `sign_of`.
In tables, reports and the terminal a resistance is a positive number.
"""

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.estimator import columns as at
from trackres_ros.model.resistance import TORQUE_COLUMNS
from trackres_ros.vehicle import AnyVehicle

TOTALS = {"total": "resistance_torque_nm", **TORQUE_COLUMNS, "drive": "drive_torque_nm"}
"""Torques of the whole vehicle; total, grade and inertia add up to the drive torque."""
OF_ASSEMBLY = ("resistance_torque_nm", "total"), ("hysteresis_nm", "hysteresis")
RESISTING = frozenset(("resistance_torque_nm", *TORQUE_COLUMNS.values()))
DEFAULT_NODE = "trackres"
BASE_FRAME = "base_link"


@dataclass(frozen=True)
class OutputTopic:
    """One topic: its name below the node's, message type, meaning, and its numbers."""

    name: str
    type: str
    # layout of the numbers in the message: `joints` (JointState: names and efforts), `wrench` (WrenchStamped: torque about y),
    # `number` (Float64), `temperature` (Temperature: value and standard deviation), `status` (DiagnosticArray), `estimate`
    # (DynamicInterfaceGroupValues: the numbers and the level under their names, and every reason with its level)
    kind: Literal["joints", "wrench", "number", "temperature", "status", "estimate"]
    meaning: str
    columns: tuple[str, ...] = ()  # columns of a row of results, see `estimator.columns.columns`
    names: tuple[str, ...] = ()  # names of the joints, or of the interfaces of an estimate

    @property
    def shared(self) -> bool:
        """Whether other nodes publish on it too: its name is absolute."""
        return self.name.startswith("/")

    @property
    def signs(self) -> tuple[float, ...]:
        """Factor from each column to the message."""
        return tuple(sign_of(column) for column in self.columns)


PARAMETERS_TOPIC = OutputTopic(
    "parameters",
    "diagnostic_msgs/msg/DiagnosticArray",
    "status",
    "learned parameters of the vehicle and the torque's delay, once a second while a torque is measured: value, standard "
    "deviation, range, coverage, state",
)


VEHICLE_GROUP, REASONS_GROUP = "vehicle", "reasons"
LEVEL = "level"
ESTIMATE_TOPIC = OutputTopic(
    "estimate",
    "control_msgs/msg/DynamicInterfaceGroupValues",
    "estimate",
    f"feed-forward, resistance, standard deviation and status in one stamped message, groups `{VEHICLE_GROUP}` and "
    f"`{REASONS_GROUP}` (explained below)",
    ("feedforward_torque_nm", "resistance_torque_nm", "resistance_std_nm"),
    ("feedforward_torque_nm", "resistance_torque_nm", "resistance_std_nm", LEVEL),
)
"""The bag of a live node has it as published. That of a replay has one for each step, without the notices of a node."""


@cache
def reasons_of(reasons: int) -> tuple[tuple[str, int], ...]:
    """Names of the reasons of a step, most severe first, with the level of each: 0 is OK, 1 is WARN."""
    pairs = [(str(reason.name), int(not reason & at.HARMLESS)) for reason in at.REASON_TEXT if reason & reasons]
    return tuple(sorted(pairs, key=lambda pair: -pair[1]))


def sign_of(column: str) -> float:
    """Factor from a column of results, of the vehicle or of an assembly, to its topic."""
    return -1.0 if column.partition("/")[0] in RESISTING else 1.0


def output_topics(vehicle: AnyVehicle) -> tuple[OutputTopic, ...]:
    """All topics of a vehicle, most urgent first."""
    assemblies = [a.name for a in vehicle.assemblies]
    by_assembly = [(f"{column}/{name}", f"{joint}/{name}") for name in assemblies for column, joint in OF_ASSEMBLY]
    return (
        OutputTopic("feedforward_torque", "geometry_msgs/msg/WrenchStamped", "wrench",
            "torque about y that cancels the chosen parts, limited in rate and size [Nm]", ("feedforward_torque_nm",)),
        OutputTopic("feedforward_torque_nm", "std_msgs/msg/Float64", "number",
            "the same number without a stamp, for controllers that accept only a number", ("feedforward_torque_nm",)),
        ESTIMATE_TOPIC,
        OutputTopic("resistance_torque", "sensor_msgs/msg/JointState", "joints",
            "torque by part about y at the sprockets [Nm], of the vehicle and of each assembly (explained below)",
            (*TOTALS.values(), *(column for column, _ in by_assembly)), (*TOTALS, *(joint for _, joint in by_assembly))),
        *(
            OutputTopic(f"track_temperature/{name}", "sensor_msgs/msg/Temperature", "temperature",
                f"mean belt temperature of {name} [degC] and its variance [K^2]", (f"belt_degc/{name}", f"belt_std_k/{name}"))
            for name in assemblies
        ),
        OutputTopic("torque_residual", "sensor_msgs/msg/JointState", "joints",
            "measured minus expected drive torque [Nm], while a torque is measured",
            ("measured_torque_nm", "drive_torque_nm", "residual_nm"), ("measured", "expected", "residual")),
        OutputTopic("status", "diagnostic_msgs/msg/DiagnosticArray", "status",
            "level and every reason for it, at each change and once a second"),
    )  # fmt: skip


def values_of(topic: OutputTopic, rows: Array, index: dict[str, int]) -> Array:
    """Numbers of a topic's messages out of rows of results, shape (rows, numbers)."""
    values = rows[:, [index[name] for name in topic.columns]] * np.array(topic.signs)
    if topic.kind == "temperature":
        values[:, 1] **= 2
    if topic.kind == "estimate":
        reasons = rows[:, index["reasons"]].astype(np.int64)
        values = np.column_stack([values, reasons & ~int(at.HARMLESS) != 0])
    return np.asarray(values + 0.0)  # no negative zeros
