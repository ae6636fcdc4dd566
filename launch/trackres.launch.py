# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The live node: ros2 launch trackres_ros trackres.launch.py vehicle:=xgd24d [topics:=t.yaml] [params_file:=p.yaml] [...]."""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode

ARGUMENTS = {
    "vehicle": (None, "Vehicle file, or the name of a shipped one"),
    "surroundings": ("", "File of effects of site, weather and ground that hold here and now"),
    "topics": ("", "Topics file: which topic feeds which role; config/topics/default.yaml without"),
    "params_file": ("", "Parameter file; config/trackres.yaml lists all parameters"),
    "name": ("trackres", "Name of the node"),
    "namespace": ("", "Namespace of the node"),
    "use_sim_time": ("false", "Take the time from /clock"),
    "autostart": ("true", "Configure and activate at the start; else wait for a lifecycle manager"),
    "respawn": ("false", "Start the node again should it end"),
    "log_level": ("info", "Level of the log"),
}


def _node(context: LaunchContext) -> list[LifecycleNode]:
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    single = {name: given[name] for name in ("vehicle", "surroundings", "topics") if given[name]}
    flags = {name: given[name].lower() == "true" for name in ("use_sim_time", "autostart")}
    files = [given["params_file"]] if given["params_file"] else []
    return [
        LifecycleNode(
            package="trackres_ros",
            executable="estimator",
            name=given["name"],
            namespace=given["namespace"],
            parameters=[*files, single, flags],
            arguments=["--ros-args", "--log-level", given["log_level"]],
            respawn=given["respawn"].lower() == "true",
            respawn_delay=1.0,
            output="screen",
        )
    ]


def generate_launch_description() -> LaunchDescription:
    """One lifecycle node, which by default configures and activates itself."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text) for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_node)])
