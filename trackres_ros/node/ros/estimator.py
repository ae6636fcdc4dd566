# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs the node on ROS 2 to its end, as the executable `estimator` and for `trackres live`.

Signals are handled before anything else loads, which takes a second.
"""

from __future__ import annotations

import gc
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from trackres_ros.errors import InputError
from trackres_ros.node.process import REQUESTS, ServiceManager, SignalRequests

if TYPE_CHECKING:
    from trackres_ros.node.application import Application
    from trackres_ros.node.parameters import Parameters

BAD_INPUT = 2
FAULT = 1  # of the loop itself
LONGEST_WAIT_S = 0.1  # so that a signal is handled soon
MOST_FAILED = 100  # callbacks, one after the other


def main() -> None:
    """Run the node; ROS arguments give name, namespace, remappings and parameters."""
    REQUESTS.listen()
    try:
        sys.exit(_run(_executable, REQUESTS, None, None, of_command=False))
    except InputError as error:
        print(f"estimator: error: {error}", file=sys.stderr)
        sys.exit(BAD_INPUT)


def _executable() -> Any:
    from trackres_ros.node.ros.interface import files_without_effect
    from trackres_ros.node.ros.node import EstimatorNode

    node = EstimatorNode()
    for text in (*files_without_effect(node, sys.argv), *_not_of_ros(sys.argv)):
        node.log_warning(text)
    return node


def _not_of_ros(arguments: Sequence[str]) -> list[str]:
    from rclpy.utilities import remove_ros_args

    arguments_left = remove_ros_args(arguments)[1:]
    return [f"arguments without effect: {' '.join(arguments_left)}; those of ROS follow --ros-args"] if arguments_left else []


def run(
    parameters: Parameters,
    node: str,
    namespace: str,
    requests: SignalRequests,
    on_start: Callable[[Application], None] | None,  # called with each application, after a cleanup with the next one
    qos_overrides: Mapping[str, bool | int | str],
) -> int:
    """Run the node with checked parameters until a signal requests a stop; return the exit code."""

    def make() -> Any:
        from rclpy import Parameter

        from trackres_ros.node.ros.node import EstimatorNode

        overrides = [Parameter(name, value=value) for name, value in qos_overrides.items()]
        return EstimatorNode(parameters, node, namespace=namespace, parameter_overrides=overrides)

    return _run(make, requests, [], on_start, of_command=True)


def _run(
    make: Callable[[], Any],
    requests: SignalRequests,
    args: list[str] | None,
    on_start: Callable[[Application], None] | None,
    of_command: bool,
) -> int:
    try:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.lifecycle import TransitionCallbackReturn
        from rclpy.signals import SignalHandlerOptions
    except ImportError as error:
        raise InputError(
            "running on ROS 2",
            f"no Python module {error.name}",
            "a sourced ROS 2 Jazzy: source /opt/ros/jazzy/setup.bash",
            "without ROS run: trackres live --transport dds",
        ) from error
    # rclpy's own handlers would end the context before the node has saved its state and reported it.
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    node: Any = None
    fault: Exception | None = None
    try:
        node = make()
        node.configured = on_start
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        if of_command or node.get_parameter("autostart").value:
            if node.trigger_configure() != TransitionCallbackReturn.SUCCESS:
                if of_command and node.refusal:
                    raise node.refusal
                return BAD_INPUT
            node.trigger_activate()
        gc.freeze()  # loaded objects stay: scanning them would delay a message now and then
        requests.start()
        _spin(executor, node, requests)
    except InputError:
        raise
    except Exception as error:
        if node is None or node.application is None:
            raise
        fault = error
    finally:
        if node is not None:
            ServiceManager().stopping()
            if node.application:
                node.application.deactivate(fault)
            node.destroy_node()
        rclpy.try_shutdown()
    return FAULT if fault else 0


def _spin(executor: Any, node: Any, requests: SignalRequests) -> None:
    """Run until a signal requests a stop. Exceptions of callbacks leave the executor here, and end nothing else."""
    from rclpy.executors import ExternalShutdownException

    failures, service = 0, ServiceManager()
    while not requests.to_stop:
        try:
            executor.spin_once(timeout_sec=LONGEST_WAIT_S)
            failures = 0
        except ExternalShutdownException:
            return
        except Exception as error:
            failures += 1
            if node.application is None or failures >= MOST_FAILED:  # then it is the executor itself
                raise
            node.application.guard.report("a callback", error, is_essential=False)
        if node.application:
            node.application.guard("a request", node.application.carry_out, requests)
        else:  # unconfigured by request
            service.alive(0, False, time.monotonic_ns())


if __name__ == "__main__":
    main()
