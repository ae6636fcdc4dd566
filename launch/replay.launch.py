# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Replay: ros2 launch trackres_ros replay.launch.py recording:=lap.mcap vehicle:=xgd24d output:=out.mcap [topics:=t.yaml]."""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.substitutions import ExecutableInPackage


def _replay(context: LaunchContext) -> list[ExecuteProcess]:
    names = ("recording", "vehicle", "output", "topics", "surroundings")
    given = {name: LaunchConfiguration(name).perform(context) for name in names}
    options = [text for name in ("topics", "surroundings") if given[name] for text in (f"--{name}", given[name])]
    command = [ExecutableInPackage(executable="trackres", package="trackres_ros"), "replay", given["recording"]]
    return [ExecuteProcess(cmd=[*command, "--vehicle", given["vehicle"], "-o", given["output"], *options], output="screen")]


def generate_launch_description() -> LaunchDescription:
    """One process: `trackres replay` with the arguments of the launch."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("recording", description="Bag (folder, .mcap, .db3, .bag) or table (.csv, .parquet)"),
            DeclareLaunchArgument("vehicle", description="Vehicle file, or the name of a shipped one"),
            DeclareLaunchArgument("output", description="File to write: .csv, .parquet or .mcap"),
            DeclareLaunchArgument("topics", default_value="", description="Topics file; guessed by message type without"),
            DeclareLaunchArgument("surroundings", default_value="", description="File of effects of site, weather and ground"),
            OpaqueFunction(function=_replay),
        ]
    )
