# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of the node as ROS 2 declares them, made from the one table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from trackres_ros.errors import InputError, nearest
from trackres_ros.node.parameters import PARAMETERS, NodeParameter, Parameters, Value, fits, known, make_parameters, section_names
from trackres_ros.node.ros.qos import OVERRIDES

SIM_TIME = "use_sim_time"  # declared by rclpy itself


def declare(node: Node, values: Parameters) -> None:
    """Declare all parameters; the command line or a parameter file overrides `values`. Raises InputError for a bad value."""
    overrides = node._parameter_overrides
    for name, parameter in PARAMETERS.items():
        value = parameter.checked(overrides[name].value) if name in overrides else values.values[name]
        if name == SIM_TIME:
            node.set_parameters([RosParameter(name, value=value)])
        else:
            node.declare_parameter(name, _on_ros(value), descriptor(parameter), ignore_override=True)


def unknown(node: Node, of_topics: bool) -> str:
    """Undeclared names in a parameter file or on the command line, with the closest ones; empty if there are none.

    With `of_topics` only overrides of a topic's quality of service, which are declared when the node is configured; else all
    others.
    """
    found = [
        f"{name} ({nearest(name, node._parameters) or 'no parameter has a similar name'})"
        for name in node._parameter_overrides
        if not node.has_parameter(name) and name.startswith(OVERRIDES) is of_topics
    ]
    return f"unknown parameters without effect: {', '.join(found)}" if found else ""


def files_without_effect(node: Node, arguments: Sequence[str]) -> list[str]:
    """A text about each parameter file in ROS arguments that has no section for a node, by the wildcards of ROS."""
    full, found = node.get_fully_qualified_name(), []
    for option, path in pairwise(arguments):
        if option != "--params-file":
            continue
        try:
            names = section_names(Path(path))
        except InputError as error:  # a pipe that ROS has already read
            found.append(str(error))
            continue
        if not any(fits(name, full) for name in names):
            given = f"parameters of {', '.join(names)}, which have no effect"
            found.append(str(InputError(path, given, f"a section for {full}", "use that name, or /** for any node")))
    return found


def descriptor(parameter: NodeParameter) -> ParameterDescriptor:
    """Description, unit, range and whether it can be changed."""
    text = parameter.meaning
    if parameter.unit and parameter.unit != "1":
        text += f" [{parameter.unit}]"
    if parameter.choices:
        text += f"; of {', '.join(parameter.choices)}"
    whole = parameter.is_number and isinstance(parameter.default, int)
    return ParameterDescriptor(
        description=text,
        additional_constraints=f"fixed while configured: {parameter.fixed_because}" if parameter.fixed_because else "",
        # `in_own_type` converts the type. For other types this package's own check names the allowed values.
        dynamic_typing=True,
        integer_range=[IntegerRange(from_value=parameter.low, to_value=parameter.high, step=1)] if whole else [],
        floating_point_range=[FloatingPointRange(from_value=parameter.low, to_value=parameter.high, step=0.0)]
        if parameter.is_number and not whole
        else [],
    )


def in_own_type(given: Iterable[RosParameter]) -> list[RosParameter]:
    """Convert values to the types of the table: 2 for a float to 2.0, true to the word on. A refused value stays as it is."""
    found = []
    for parameter in given:
        try:
            value = _on_ros(known(parameter.name).checked(parameter.value))
            found.append(RosParameter(parameter.name, value=value))
        except InputError:
            found.append(parameter)
    return found


def _on_ros(value: Value) -> Any:
    return list(value) if isinstance(value, tuple) else value


def read(node: Node) -> Parameters:
    """Checked values of all parameters. Raises InputError for a bad value."""
    return make_parameters({name: node.get_parameter(name).value for name in PARAMETERS})


def named(parameters: Iterable[RosParameter]) -> Mapping[str, Any]:
    """Names and values of those that are in the table."""
    return {parameter.name: parameter.value for parameter in parameters if parameter.name in PARAMETERS}


def verdict(check: Any, given: Mapping[str, Any]) -> SetParametersResult:
    """The answer to a request to set parameters, after a check that raises InputError."""
    try:
        check(given)
    except InputError as error:
        return SetParametersResult(successful=False, reason=str(error))
    return SetParametersResult(successful=True)


def check_values(given: Mapping[str, Any]) -> None:
    """Check values before there is anything that they would change. Raises InputError for a bad value."""
    for name, value in given.items():
        known(name).checked(value)
