# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of the node as ROS 2 declares them, made from the one table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from trackres_ros.errors import InputError
from trackres_ros.node.parameters import PARAMETERS, Parameter, Parameters, known, make_parameters

SIM_TIME = "use_sim_time"  # declared by rclpy itself
AUTOSTART = "autostart"


def declare(node: Node, values: Parameters) -> None:
    """Declare all parameters; what the command line or a parameter file gives overrides `values`."""
    for name, parameter in PARAMETERS.items():
        if name != SIM_TIME:
            default = values.values[name]
            node.declare_parameter(name, list(default) if isinstance(default, tuple) else default, descriptor(parameter))
    text = "configure and activate at the start; else wait for a lifecycle manager"
    node.declare_parameter(AUTOSTART, True, ParameterDescriptor(description=text, read_only=True))


def descriptor(parameter: Parameter) -> ParameterDescriptor:
    """Description, unit, range and what can be changed when."""
    text = parameter.meaning
    if parameter.unit and parameter.unit != "1":
        text += f" [{parameter.unit}]"
    if parameter.choices:
        text += f"; of {', '.join(parameter.choices)}"
    number = isinstance(parameter.default, float)
    return ParameterDescriptor(
        description=text,
        additional_constraints=f"fixed while configured: {parameter.fixed_because}" if parameter.fixed_because else "",
        # A whole number given for a floating-point one is taken too; the check is this package's own.
        dynamic_typing=number or isinstance(parameter.default, tuple),
        floating_point_range=[FloatingPointRange(from_value=parameter.low, to_value=parameter.high, step=0.0)] if number else [],
    )


def read(node: Node) -> Parameters:
    """Checked values of all parameters.

    Raises
    ------
    InputError
        For a bad value.
    """
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
    """Check values before there is anything that they would change.

    Raises
    ------
    InputError
        For a bad value.
    """
    for name, value in given.items():
        known(name).checked(value)
