"""Replay: ros2 launch trackres_ros replay.launch.py recording:=lap.mcap vehicle:=xgd24d output:=out.mcap [topics:=t.yaml]."""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.substitutions import ExecutableInPackage


def _replay(context: LaunchContext) -> list[ExecuteProcess]:
    given = {name: LaunchConfiguration(name).perform(context) for name in ("recording", "vehicle", "output", "topics")}
    topics = ["--topics", given["topics"]] if given["topics"] else []
    command = [ExecutableInPackage(executable="trackres", package="trackres_ros"), "replay", given["recording"]]
    return [ExecuteProcess(cmd=[*command, "--vehicle", given["vehicle"], "-o", given["output"], *topics], output="screen")]


def generate_launch_description() -> LaunchDescription:
    """One process: `trackres replay` with the arguments of the launch."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("recording", description="Bag (folder, .mcap, .db3, .bag) or table (.csv, .parquet)"),
            DeclareLaunchArgument("vehicle", description="Vehicle file, or the name of a shipped one"),
            DeclareLaunchArgument("output", description="File to write: .csv, .parquet or .mcap"),
            DeclareLaunchArgument("topics", default_value="", description="Topics file; guessed by message type without"),
            OpaqueFunction(function=_replay),
        ]
    )
