# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A real node feeds nothing forward by a speed that no vehicle has, and nothing that is not enabled."""

import itertools
import math

from conftest import Node

TOPICS = """
speed: {topic: speed, type: geometry_msgs/msg/TwistStamped, field: twist.linear.x}
load: {topic: load, type: std_msgs/msg/Float64, field: data}
ambient: {topic: ambient, type: sensor_msgs/msg/Temperature, field: temperature}
enable: {topic: mode, type: std_msgs/msg/UInt8, field: data, values: [1, 4]}
"""


def test_speeds_that_no_vehicle_has_are_not_fed_forward(standing):
    at_rest = lambda: standing.drive(0.3, speed=lambda: 0.0)  # noqa: E731
    standing.until(lambda: standing.torques() and standing.torques()[-1] == 0.0, "rest", meanwhile=at_rest)
    first = len(standing.torques())
    standing.drive(0.9, speed=lambda: 16.6)
    standing.noticed("SPEED_IMPLAUSIBLE", meanwhile=lambda: standing.drive(0.1, speed=lambda: 0.0))
    assert set(standing.torques()[first:]) == {0.0}
    assert int(standing.values("input speed")["implausible"]) > 20
    standing.healthy()
    turns = itertools.cycle([5.0, 16.5])
    alternate = lambda: standing.drive(0.3, speed=lambda: next(turns))  # noqa: E731
    standing.until(lambda: standing.torques()[-1] == 0.0, "no feed-forward", meanwhile=alternate)
    assert {"SPEED_IMPLAUSIBLE", "SPEED_OLD"} <= standing.last_remarks()
    standing.check_outputs()
    standing.healthy()


def test_a_mode_enables_the_feedforward(transport, tmp_path, wire):
    mode = wire.publisher("/mode", "std_msgs/msg/UInt8")
    node = Node(transport, tmp_path, wire, topics=TOPICS)
    try:
        node.started()

        def drive(value):
            if value is not None:
                mode.publish(data=value)
            node.drive(0.2)

        for value, least, notice in ((None, 0.0, "ENABLE_OLD"), (4, 2000.0, ""), (2, 0.0, "DISABLED"), (1, 2000.0, "")):

            def settled(least=least, notice=notice):
                last = (node.torques() or [math.nan])[-1]
                return (last == 0.0 if least == 0.0 else last > least) and {notice} <= {"", *node.last_remarks()}

            node.until(settled, f"mode {value}", meanwhile=lambda value=value: drive(value))
        assert node.stop() == 0
        node.check_outputs()
    finally:
        node.close()
        mode.close()
