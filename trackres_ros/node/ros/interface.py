# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Messages of ROS 2: outputs prepared once and filled in place, inputs checked against their installed types."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rosidl_runtime_py.utilities import get_message
from std_msgs.msg import Header

from trackres_ros.errors import InputError
from trackres_ros.node.endpoints import InputTopic
from trackres_ros.node.transport import Reasons, Status
from trackres_ros.output.topics import ESTIMATE_TOPIC, REASONS_GROUP, VEHICLE_GROUP, OutputTopic
from trackres_ros.recording.message_types import check_field, installed_fields, with_nested
from trackres_ros.units import SECOND_NS

Fill = Callable[[int, Sequence[float], Reasons], Any]


def prepared(topic: OutputTopic, frame_id: str) -> Fill:
    """A function that makes the message from a stamp [ns], the numbers of a topic and the reasons of an estimate. It reuses one
    message.

    Raises InputError or an error of a library if the type of an estimate is not installed, or differs.
    """
    if topic is ESTIMATE_TOPIC:
        return RosEstimate(frame_id).filled
    message = get_message(topic.type)()
    if topic.kind == "number":

        def number(_stamp_ns: int, values: Sequence[float], _reasons: Reasons) -> Any:
            message.data = values[0]
            return message

        return number
    message.header.frame_id = frame_id
    stamp = message.header.stamp

    def stamped(stamp_ns: int) -> None:
        stamp.sec, stamp.nanosec = divmod(stamp_ns, SECOND_NS)

    def joints(stamp_ns: int, values: Sequence[float], _reasons: Reasons) -> Any:
        stamped(stamp_ns)
        message.effort = array("d", values)
        return message

    def wrench(stamp_ns: int, values: Sequence[float], _reasons: Reasons) -> Any:
        stamped(stamp_ns)
        message.wrench.torque.y = values[0]
        return message

    def temperature(stamp_ns: int, values: Sequence[float], _reasons: Reasons) -> Any:
        stamped(stamp_ns)
        message.temperature, message.variance = values
        return message

    if topic.kind == "joints":
        message.name = list(topic.names)
    return {"joints": joints, "wrench": wrench, "temperature": temperature}[topic.kind]


class RosEstimate:
    """The message of `topics.ESTIMATE_TOPIC`, reused; its reasons are filled only when they change."""

    def __init__(self, frame_id: str) -> None:
        self._message = installed_type(ESTIMATE_TOPIC.type, f"topic ~/{ESTIMATE_TOPIC.name}")()
        self._message.header.frame_id = frame_id
        self._message.interface_groups = [VEHICLE_GROUP, REASONS_GROUP]
        group = get_message("control_msgs/msg/InterfaceValue")
        self._vehicle, self._remarked = group(interface_names=list(ESTIMATE_TOPIC.names)), group()
        self._message.interface_values = [self._vehicle, self._remarked]
        self._reasons: Reasons = ()

    def filled(self, stamp_ns: int, values: Sequence[float], reasons: Reasons) -> Any:
        """The message with a stamp [ns], its numbers and the present reasons."""
        stamp = self._message.header.stamp
        stamp.sec, stamp.nanosec = divmod(stamp_ns, SECOND_NS)
        self._vehicle.values = array("d", values)
        if reasons != self._reasons:
            self._remarked.interface_names = [name for name, _ in reasons]
            self._remarked.values = array("d", [float(level) for _, level in reasons])
            self._reasons = reasons
        return self._message


def diagnostic_array(stamp_ns: int, statuses: Sequence[Status], frame_id: str) -> DiagnosticArray:
    """A DiagnosticArray."""
    seconds, nanoseconds = divmod(stamp_ns, SECOND_NS)
    return DiagnosticArray(
        header=Header(stamp=Time(sec=seconds, nanosec=nanoseconds), frame_id=frame_id),
        status=[
            DiagnosticStatus(
                level=bytes([given.level]),
                name=given.name,
                message=given.message,
                hardware_id=given.hardware_id,
                values=[KeyValue(key=key, value=value) for key, value in given.values],
            )
            for given in statuses
        ],
    )


def input_type(given: InputTopic, origin: str) -> Any:
    """Message class of an input, with its field paths checked.

    Raises InputError for a type that is not installed, or a field path that does not lead to a number.
    """
    where = f"{origin}: {given.role_names}"
    message = installed_type(given.type, where)
    types = with_nested(given.type, installed_fields)
    for binding in given.bindings:
        check_field(types, given.type, binding.field, f"{where}: field")
    return message


def installed_type(name: str, where: str) -> Any:
    """The class of a message type. Raises InputError if it is not installed."""
    try:
        return get_message(name)
    except (AttributeError, ImportError, ValueError):
        package = name.split("/")[0].replace("_", "-")
        raise InputError(
            f"{where}: type", name, "an installed message type", f"install it: sudo apt install ros-jazzy-{package}"
        ) from None


def type_text(msgtype: str) -> str | None:
    """The definition of a message type with all nested types, as stored in a bag; None if it is not installed."""
    found: dict[str, str] = {}
    wanted = [msgtype]
    while wanted:
        name = wanted.pop(0)
        if name in found:
            continue
        package, kind, short = name.split("/")
        try:
            path = Path(get_package_share_directory(package)) / kind / f"{short}.msg"
            found[name] = path.read_text(encoding="utf-8")
            wanted += [field.type for field in installed_fields(name) if "/" in field.type]
        except (LookupError, OSError, AttributeError, ImportError, ValueError):
            return None
    first, *others = found
    parts = [f"MSG: {name.replace('/msg/', '/')}\n{found[name]}" for name in others]
    return f"\n{'=' * 80}\n".join([found[first], *parts])
