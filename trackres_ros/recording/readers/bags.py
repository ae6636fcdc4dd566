# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Registers bags: rosbag2 and ROS 1."""

from trackres_ros.recording.file_kind import BagKind
from trackres_ros.recording.rosbag import BagSource
from trackres_ros.recording.unfinished import SUFFIX as UNFINISHED

KINDS = (BagKind((".mcap", ".db3", ".bag", UNFINISHED), BagSource),)
