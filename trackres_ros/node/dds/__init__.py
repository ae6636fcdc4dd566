# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The transport on Cyclone DDS for machines without ROS 2: the same topics and presence as those of a ROS 2 node."""

from trackres_ros.errors import MissingExtraError

try:
    import cyclonedds._clayer  # noqa: F401
    import rosbags.typesys  # noqa: F401
except ImportError as error:
    package = (error.name or "cyclonedds").partition(".")[0]
    wheels = "there are wheels for Python 3.10 to 3.13 on x86-64 Linux" if package == "cyclonedds" else ""
    raise MissingExtraError("running without ROS 2", package, "dds", wheels) from error
