# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The live node: ros2 launch trackres_ros trackres.launch.py vehicle:=xgd24d [topics:=t.yaml] [params_file:=p.yaml] [...].

An argument that is given overrides the parameter file; one that is not given leaves the file's value, or the node's default.
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode

TEXTS = {
    "vehicle": "Vehicle file, or the name of a shipped one; may stand in the parameter file instead",
    "surroundings": "File of effects of site, weather and ground that hold here and now",
    "topics": "Topics file: which topic feeds which role; config/topics/default.yaml without",
}
SWITCHES = {
    "use_sim_time": "Take the time from /clock: true or false",
    "autostart": "Configure and activate at the start: true, or false to wait for a lifecycle manager",
}
OTHERS = {
    "params_file": ("", "Parameter file; config/trackres.yaml lists all parameters"),
    "name": ("trackres", "Name of the node"),
    "namespace": ("", "Namespace of the node"),
    "respawn": ("false", "Start the node again should it end: true or false"),
    "log_level": ("info", "Level of the log"),
}
ARGUMENTS = {**{name: ("", text) for name, text in {**TEXTS, **SWITCHES}.items()}, **OTHERS}


def _switch(name: str, given: str) -> bool:
    if given.lower() not in ("true", "false"):
        raise ValueError(f"launch argument {name}: given {given!r}; allowed: true or false")
    return given.lower() == "true"


def _files(given: str) -> list[str]:
    if given and not Path(given).is_file():  # launch would leave it out with a warning: the node would run with its defaults
        raise ValueError(f"launch argument params_file: given {given!r}; allowed: an existing file")
    return [given] if given else []


def _ended(event: ProcessExited, context: LaunchContext) -> None:
    """Let the launch end with exit code 1 after a failure, the only one it has; what else it started goes on."""
    if event.returncode:
        context.asyncio_loop.call_exception_handler({"message": f"the node ended with exit code {event.returncode}"})


def _node(context: LaunchContext) -> list[LifecycleNode]:
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    explicit = {name: given[name] for name in TEXTS if given[name]}
    respawn = _switch("respawn", given["respawn"])
    explicit |= {name: _switch(name, given[name]) for name in SWITCHES if given[name]}
    return [
        LifecycleNode(
            package="trackres_ros",
            executable="estimator",
            name=given["name"],
            namespace=given["namespace"],
            parameters=[*_files(given["params_file"]), *([explicit] if explicit else [])],
            arguments=["--ros-args", "--log-level", given["log_level"]],
            respawn=respawn,
            respawn_delay=1.0,
            on_exit=None if respawn else _ended,
            output="screen",
        )
    ]


def generate_launch_description() -> LaunchDescription:
    """One lifecycle node, which by default configures and activates itself."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text) for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_node)])
