# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Messages of ROS 2: outputs prepared once and filled in place, inputs checked against their installed types."""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Sequence
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rosidl_runtime_py.utilities import get_message
from std_msgs.msg import Header

from trackres_ros.errors import InputError
from trackres_ros.node.edge import Status
from trackres_ros.node.endpoints import InputTopic
from trackres_ros.output.topics import OutputTopic
from trackres_ros.recording.message_types import NUMBERS, Definitions, Field, check_field
from trackres_ros.units import SECOND_NS

ALIASES = {"boolean": "bool", "double": "float64", "float": "float32", "octet": "byte"}
FIELD_TYPE = re.compile(r"(?:sequence<(?P<element>[^,>]+)(?:,\s*\d+)?>|(?P<plain>[^\[\]<>]+(?:<\d+>)?)(?:\[(?P<count>\d+)\])?)")

Fill = Callable[[int, Sequence[float]], Any]


def prepared(topic: OutputTopic, frame_id: str) -> Fill:
    """A function that takes a stamp [ns] and the numbers of a topic, and gives the message; always the same one, filled anew."""
    message = get_message(topic.type)()
    if topic.kind == "number":

        def number(_stamp_ns: int, values: Sequence[float]) -> Any:
            message.data = values[0]
            return message

        return number
    message.header.frame_id = frame_id
    stamp = message.header.stamp

    def stamped(stamp_ns: int) -> None:
        stamp.sec, stamp.nanosec = divmod(stamp_ns, SECOND_NS)

    def joints(stamp_ns: int, values: Sequence[float]) -> Any:
        stamped(stamp_ns)
        message.effort = array("d", values)
        return message

    def wrench(stamp_ns: int, values: Sequence[float]) -> Any:
        stamped(stamp_ns)
        message.wrench.torque.y = values[0]
        return message

    def temperature(stamp_ns: int, values: Sequence[float]) -> Any:
        stamped(stamp_ns)
        message.temperature, message.variance = values
        return message

    if topic.kind == "joints":
        message.name = list(topic.names)
    return {"joints": joints, "wrench": wrench, "temperature": temperature}[topic.kind]


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

    Raises
    ------
    InputError
        For a type that is not installed, or a field path that does not lead to a number.
    """
    where = f"{origin}: {', '.join(given.roles)}"
    try:
        message = get_message(given.type)
    except (AttributeError, ImportError, ValueError):
        package = given.type.split("/")[0].replace("_", "-")
        raise InputError(
            f"{where}: type", given.type, "an installed message type", f"install it: sudo apt install ros-jazzy-{package}"
        ) from None
    types = definitions(given.type)
    for binding in given.bindings:
        check_field(types, given.type, binding.field, f"{where}: field")
    return message


def definitions(msgtype: str) -> Definitions:
    """Fields of a message type and of all it contains, from the installed types."""
    found: dict[str, tuple[Field, ...]] = {}
    wanted = [msgtype]
    while wanted:
        name = wanted.pop()
        if name not in found:
            found[name] = tuple(_field(field, kind) for field, kind in get_message(name).get_fields_and_field_types().items())
            wanted += [field.type for field in found[name] if "/" in field.type]
    return found


def _field(name: str, described: str) -> Field:
    """A field as `get_fields_and_field_types` describes it: ``double``, ``string<10>``, ``pkg/Name[3]``, ``sequence<double>``."""
    match = FIELD_TYPE.fullmatch(described)
    if match is None:
        return Field(name, described, "one", 1)
    element, plain, count = match["element"], match["plain"], match["count"]
    kind = (element or plain).split("<")[0].strip()
    kind = ALIASES.get(kind, kind)
    if kind not in NUMBERS and "/" in kind:
        package, short = kind.split("/")
        kind = f"{package}/msg/{short}"
    if element:
        return Field(name, kind, "sequence", 0)
    return Field(name, kind, "array", int(count)) if count else Field(name, kind, "one", 1)
