# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Replay: ros2 launch trackres_ros replay.launch.py recording:=lap.mcap vehicle:=xgd24d output:=out.csv [...]."""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.substitutions import ExecutableInPackage

OPTIONS = {
    "topics": "Topics file; guessed by message type without",
    "surroundings": "File of effects of site, weather and ground",
    "params": "Parameter file, flat or as of the live node",
    "resume": "State file to continue from",
}


def _ended(event: ProcessExited, context: LaunchContext) -> None:
    """Let the launch end with exit code 1 after a failure, the only one it has; what else it started goes on."""
    if event.returncode:
        context.asyncio_loop.call_exception_handler({"message": f"the replay ended with exit code {event.returncode}"})


def _replay(context: LaunchContext) -> list[ExecuteProcess]:
    given = {name: LaunchConfiguration(name).perform(context) for name in ("recording", "vehicle", "output", *OPTIONS)}
    options = [text for name in OPTIONS if given[name] for text in (f"--{name}", given[name])]
    command = [ExecutableInPackage(executable="trackres", package="trackres_ros"), "replay", given["recording"]]
    command += ["--vehicle", given["vehicle"], "-o", given["output"], *options]
    return [ExecuteProcess(cmd=command, on_exit=_ended, output="screen")]


def generate_launch_description() -> LaunchDescription:
    """One process: `trackres replay` with the arguments of the launch."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("recording", description="Bag (folder, .mcap, .db3, .bag) or table (.csv, .parquet)"),
            DeclareLaunchArgument("vehicle", description="Vehicle file, or the name of a shipped one"),
            DeclareLaunchArgument("output", description="File to write: .csv, .parquet or .mcap"),
            *(DeclareLaunchArgument(name, default_value="", description=text) for name, text in OPTIONS.items()),
            OpaqueFunction(function=_replay),
        ]
    )
