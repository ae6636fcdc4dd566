# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What ROS 2 sees of the node: its messages, its parameters, and quality of service with rclpy's overrides."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rosidl_runtime_py.utilities import get_message
from std_msgs.msg import Header

from trackres_ros.errors import InputError, nearest
from trackres_ros.node.parameters import (
    PARAMETERS,
    QOS_OVERRIDES,
    NodeParameter,
    Parameters,
    Value,
    fits_node,
    make_parameters,
    node_parameter,
    section_names,
)
from trackres_ros.node.transport import InputTopic, Quality, Reasons, Status
from trackres_ros.output.topics import ESTIMATE_TOPIC, REASONS_GROUP, VEHICLE_GROUP, OutputTopic
from trackres_ros.recording.message_types import check_field, installed_fields, with_nested
from trackres_ros.units import SECOND_NS

OVERRIDES = f"{QOS_OVERRIDES}."  # parameters that rclpy declares with each topic
OVERRIDABLE = QoSOverridingOptions.with_default_policies()
SIM_TIME = "use_sim_time"  # declared by rclpy itself
Fill = Callable[[int, Sequence[float], Reasons], Any]


@contextmanager
def override_errors(node: Node, topic: str) -> Iterator[None]:
    """Report a failure to make an endpoint with an overridden profile as a bad override.

    Raises InputError naming the overrides, and what is allowed.
    """
    try:
        yield
    except Exception as error:
        prefix = f"{OVERRIDES}{node.resolve_topic_name(topic)}."
        values = {name: parameter.value for name, parameter in node._parameter_overrides.items() if name.startswith(prefix)}
        if not values:
            raise
        allowed = "history keep_last or keep_all, depth a whole number from 0, reliability reliable or best_effort"
        raise InputError(f"parameters {prefix}*", values, allowed, str(error)) from error


def profile_of(quality: Quality) -> QoSProfile:
    """Quality of service as a ROS profile."""
    reliability = ReliabilityPolicy.RELIABLE if quality.reliable else ReliabilityPolicy.BEST_EFFORT
    durability = DurabilityPolicy.TRANSIENT_LOCAL if quality.latched else DurabilityPolicy.VOLATILE
    profile = QoSProfile(depth=quality.depth, reliability=reliability, durability=durability)
    if quality.deadline_s > 0.0:
        profile.deadline = Duration(seconds=quality.deadline_s)
    return profile


def prepare_message(topic: OutputTopic, frame_id: str) -> Fill:
    """A function that makes the message from a stamp [ns], the numbers of a topic and the reasons of an estimate. It reuses one
    message.

    Raises InputError or an error of a library if the type of an estimate is not installed, or differs.
    """
    if topic is ESTIMATE_TOPIC:
        return RosEstimate(frame_id).fill
    message = get_message(topic.type)()
    if topic.kind == "joints":
        message.name = list(topic.names)
    if topic.kind != "number":
        message.header.frame_id = frame_id
    set_numbers = {"number": _number, "joints": _joints, "wrench": _wrench, "temperature": _temperature}[topic.kind]

    def fill(stamp_ns: int, values: Sequence[float], _reasons: Reasons) -> Any:
        if topic.kind != "number":
            _set_stamp(message, stamp_ns)
        set_numbers(message, values)
        return message

    return fill


def _set_stamp(message: Any, stamp_ns: int) -> None:
    stamp = message.header.stamp
    stamp.sec, stamp.nanosec = divmod(stamp_ns, SECOND_NS)


def _number(message: Any, values: Sequence[float]) -> None:
    message.data = values[0]


def _joints(message: Any, values: Sequence[float]) -> None:
    message.effort = array("d", values)


def _wrench(message: Any, values: Sequence[float]) -> None:
    message.wrench.torque.y = values[0]


def _temperature(message: Any, values: Sequence[float]) -> None:
    message.temperature, message.variance = values


class RosEstimate:
    """The message of `topics.ESTIMATE_TOPIC`, reused; its reasons are filled in only when they change."""

    def __init__(self, frame_id: str) -> None:
        self._message = installed_type(ESTIMATE_TOPIC.type, f"topic ~/{ESTIMATE_TOPIC.name}")()
        self._message.header.frame_id = frame_id
        self._message.interface_groups = [VEHICLE_GROUP, REASONS_GROUP]
        group = get_message("control_msgs/msg/InterfaceValue")
        self._vehicle, self._remarked = group(interface_names=list(ESTIMATE_TOPIC.names)), group()
        self._message.interface_values = [self._vehicle, self._remarked]
        self._reasons: Reasons = ()

    def fill(self, stamp_ns: int, values: Sequence[float], reasons: Reasons) -> Any:
        """The message with a stamp [ns], its numbers and the present reasons."""
        _set_stamp(self._message, stamp_ns)
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
                level=bytes([status.level]),
                name=status.name,
                message=status.message,
                hardware_id=status.hardware_id,
                values=[KeyValue(key=key, value=value) for key, value in status.values],
            )
            for status in statuses
        ],
    )


def input_type(topic: InputTopic, origin: str) -> Any:
    """Message class of an input, with its field paths checked.

    Raises InputError for a type that is not installed, or a field path that does not lead to a number.
    """
    place = f"{origin}: {topic.role_names}"
    message = installed_type(topic.type, place)
    types = with_nested(topic.type, installed_fields)
    for reading in topic.readings:
        check_field(types, topic.type, reading.binding.field, f"{place}: field")
    return message


def installed_type(name: str, place: str) -> Any:
    """The class of a message type. Raises InputError if it is not installed."""
    try:
        return get_message(name)
    except (AttributeError, ImportError, ValueError):
        package = name.split("/")[0].replace("_", "-")
        raise InputError(
            f"{place}: type", name, "an installed message type", f"install it: sudo apt install ros-jazzy-{package}"
        ) from None


def type_text(msgtype: str) -> str | None:
    """The definition of a message type with all nested types, as stored in a bag; None if it is not installed."""
    texts: dict[str, str] = {}
    names = [msgtype]
    while names:
        name = names.pop(0)
        if name in texts:
            continue
        package, kind, short_name = name.split("/")
        try:
            path = Path(get_package_share_directory(package)) / kind / f"{short_name}.msg"
            texts[name] = path.read_text(encoding="utf-8")
            names += [field.type for field in installed_fields(name) if "/" in field.type]
        except (LookupError, OSError, AttributeError, ImportError, ValueError):
            return None
    first_text, *nested_texts = texts
    parts = [f"MSG: {name.replace('/msg/', '/')}\n{texts[name]}" for name in nested_texts]
    return f"\n{'=' * 80}\n".join([texts[first_text], *parts])


def declare_parameters(node: Node, values: Parameters) -> None:
    """Declare all parameters; the command line or a parameter file overrides `values`. Raises InputError for a bad value."""
    overrides = node._parameter_overrides
    for name, parameter in PARAMETERS.items():
        value = parameter.check(overrides[name].value) if name in overrides else values.values[name]
        if name == SIM_TIME:
            node.set_parameters([RosParameter(name, value=value)])
        else:
            node.declare_parameter(name, _on_ros(value), descriptor(parameter), ignore_override=True)


def unknown_parameters(node: Node, of_topics: bool) -> str:
    """Undeclared names in a parameter file or on the command line, with the closest ones; empty if there are none.

    With `of_topics` only overrides of a topic's quality of service, which are declared when the node is configured; else all
    others.
    """
    unknown_names = [
        f"{name} ({nearest(name, node._parameters) or 'no parameter has a similar name'})"
        for name in node._parameter_overrides
        if not node.has_parameter(name) and name.startswith(OVERRIDES) is of_topics
    ]
    return f"unknown parameters without effect: {', '.join(unknown_names)}" if unknown_names else ""


def files_without_effect(node: Node, arguments: Sequence[str]) -> list[str]:
    """A text about each parameter file in ROS arguments that has no section for a node, by the wildcards of ROS."""
    full_name, texts = node.get_fully_qualified_name(), []
    for option, path in pairwise(arguments):
        if option != "--params-file":
            continue
        try:
            names = section_names(Path(path))
        except InputError as error:  # a pipe that ROS has already read
            texts.append(str(error))
            continue
        if not any(fits_node(name, full_name) for name in names):
            content = f"parameters of {', '.join(names)}, which have no effect"
            texts.append(str(InputError(path, content, f"a section for {full_name}", "use that name, or /** for any node")))
    return texts


def descriptor(parameter: NodeParameter) -> ParameterDescriptor:
    """Description, unit, range and whether it can be changed."""
    text = parameter.meaning
    if parameter.unit and parameter.unit != "1":
        text += f" [{parameter.unit}]"
    if parameter.choices:
        text += f"; of {', '.join(parameter.choices)}"
    is_whole = parameter.is_number and isinstance(parameter.default, int)
    return ParameterDescriptor(
        description=text,
        additional_constraints=f"fixed while configured: {parameter.fixed_because}" if parameter.fixed_because else "",
        # `own_types` converts the type. For other types this package's own check names the allowed values.
        dynamic_typing=True,
        integer_range=[IntegerRange(from_value=parameter.low, to_value=parameter.high, step=1)] if is_whole else [],
        floating_point_range=[FloatingPointRange(from_value=parameter.low, to_value=parameter.high, step=0.0)]
        if parameter.is_number and not is_whole
        else [],
    )


def own_types(parameters: Iterable[RosParameter]) -> list[RosParameter]:
    """Convert values to the types of the table: 2 for a float to 2.0, true to the word on. A refused value stays as it is."""
    typed = []
    for parameter in parameters:
        try:
            value = _on_ros(node_parameter(parameter.name).check(parameter.value))
            typed.append(RosParameter(parameter.name, value=value))
        except InputError:
            typed.append(parameter)
    return typed


def _on_ros(value: Value) -> Any:
    return list(value) if isinstance(value, tuple) else value


def read_parameters(node: Node) -> Parameters:
    """Checked values of all parameters. Raises InputError for a bad value."""
    return make_parameters({name: node.get_parameter(name).value for name in PARAMETERS})


def known_values(parameters: Iterable[RosParameter]) -> Mapping[str, Any]:
    """Names and values of those that are in the table."""
    return {parameter.name: parameter.value for parameter in parameters if parameter.name in PARAMETERS}


def check_result(check: Any, values: Mapping[str, Any]) -> SetParametersResult:
    """The answer to a request to set parameters, after a check that raises InputError."""
    try:
        check(values)
    except InputError as error:
        return SetParametersResult(successful=False, reason=str(error))
    return SetParametersResult(successful=True)


def check_values(values: Mapping[str, Any]) -> None:
    """Check values before there is anything that they would change. Raises InputError for a bad value."""
    for name, value in values.items():
        node_parameter(name).check(value)
