# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres play`: plays a bag over DDS, without ROS."""

import signal
import threading
from pathlib import Path

import click

from trackres_ros.errors import InputError
from trackres_ros.tasks import options
from trackres_ros.tasks.terminal import emit, progress

LISTENERS_WITHIN_S = 30.0


@click.command("play")
@click.argument("recording", type=options.PATH)
@click.option("--rate", type=options.Number(0.01, 1000.0), default=1.0, help="Speed of playback relative to the recording.")
@click.option("--wait-for", multiple=True, metavar="TOPIC", help="Start once this topic has a subscriber; may be repeated.")
@options.json
def play_command(recording: Path, rate: float, wait_for: tuple[str, ...], as_json: bool) -> None:
    """Play a ROS 2 bag with its /clock, or one of its log times, to a live node. With ROS, use `ros2 bag play --clock`.

    \b
    trackres live --transport dds --vehicle xgd24d --topics sample -p use_sim_time:=true
    trackres play lap.mcap --rate 20 --wait-for /vehicle/speed
    """
    from trackres_ros.node.dds.player import Player

    player = Player(recording, rate)
    stop = threading.Event()
    signal.signal(signal.SIGINT, lambda *_: stop.set())
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    try:
        absent_topics = [topic for topic in wait_for if topic not in player.topics]
        if absent_topics:
            raise InputError("--wait-for", absent_topics[0], f"a topic that is played: {', '.join(player.topics)}")
        for topic in player.left_out:
            click.echo(f"trackres: not played, because its type is unknown without ROS: {topic}", err=True)
        if not player.wait_for_listeners(wait_for, LISTENERS_WITHIN_S):
            raise InputError("--wait-for", ", ".join(wait_for), f"a node that listens within {LISTENERS_WITHIN_S:g} s")
        with progress("playing", player.duration_s) as advance:
            count = player.play(advance, lambda: not stop.is_set())
        result = {
            "recording": str(recording),
            "messages": count,
            "topics": list(player.topics),
            "left_out": player.left_out,
            "to_the_end": not stop.is_set(),
        }
        emit(result, as_json, lambda: f"{count} messages played")
    finally:
        player.close()
