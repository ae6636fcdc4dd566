# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What launch_testing runs: the node as it is launched, what it publishes while it runs, and how it ends.

`launch_test test/processes/launched.py` in a sourced workspace; test_ros.py runs it in one of its own.
"""

import time
import unittest
from pathlib import Path

import launch_testing
import rclpy
from ament_index_python.packages import get_package_share_directory
from geometry_msgs.msg import TwistStamped
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_testing.actions import ReadyToTest
from launch_testing.asserts import assertExitCodes
from sensor_msgs.msg import JointState

DEADLINE_S = 240.0  # the first start of a machine compiles
EVERY_S = 0.02
SPEED_MPS = 8.0


def generate_test_description():
    """The launch file with a vehicle, as a user starts it."""
    launch_file = Path(get_package_share_directory("trackres_ros")) / "launch" / "trackres.launch.py"
    node = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(launch_file)), launch_arguments={"vehicle": "xgd24d"}.items()
    )
    return LaunchDescription([node, ReadyToTest()])


class WhileItRuns(unittest.TestCase):
    """The node on the wire."""

    @classmethod
    def setUpClass(cls):
        rclpy.init()
        cls.node = rclpy.create_node("driver")

    @classmethod
    def tearDownClass(cls):
        cls.node.destroy_node()
        rclpy.shutdown()

    def test_it_answers_a_speed_with_a_resistance(self):
        estimates = []
        self.node.create_subscription(JointState, "/trackres/resistance_torque", estimates.append, 10)
        speeds = self.node.create_publisher(TwistStamped, "/speed", 10)
        end = time.monotonic() + DEADLINE_S
        while not estimates and time.monotonic() < end:
            message = TwistStamped()
            message.header.stamp = self.node.get_clock().now().to_msg()
            message.twist.linear.x = SPEED_MPS
            speeds.publish(message)
            rclpy.spin_once(self.node, timeout_sec=EVERY_S)
        assert estimates, "no estimate was published"
        assert estimates[-1].effort[0] < -1000.0


@launch_testing.post_shutdown_test()
class Afterwards(unittest.TestCase):
    """The processes that were launched."""

    def test_all_ended_as_asked(self, proc_info):
        assertExitCodes(proc_info)
