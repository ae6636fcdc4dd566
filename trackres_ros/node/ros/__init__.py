# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The transport on ROS 2: messages in, messages out; the only place that imports rclpy."""
