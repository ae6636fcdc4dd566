# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Quality of service on ROS 2: profiles, and rclpy's `qos_overrides` of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from trackres_ros.errors import InputError
from trackres_ros.node.endpoints import Quality
from trackres_ros.node.parameters import QOS_OVERRIDES

OVERRIDES = f"{QOS_OVERRIDES}."  # parameters that rclpy declares with each topic
OVERRIDABLE = QoSOverridingOptions.with_default_policies()


@contextmanager
def overridden(node: Node, topic: str) -> Iterator[None]:
    """Report a failure to make an endpoint with an overridden profile as a bad override.

    Raises InputError naming the overrides, and what is allowed.
    """
    try:
        yield
    except Exception as error:
        prefix = f"{OVERRIDES}{node.resolve_topic_name(topic)}."
        given = {name: found.value for name, found in node._parameter_overrides.items() if name.startswith(prefix)}
        if not given:
            raise
        allowed = "history keep_last or keep_all, depth a whole number from 0, reliability reliable or best_effort"
        raise InputError(f"parameters {prefix}*", given, allowed, str(error)) from error


def profile_of(quality: Quality) -> QoSProfile:
    """Quality of service as a ROS profile."""
    reliability = ReliabilityPolicy.RELIABLE if quality.reliable else ReliabilityPolicy.BEST_EFFORT
    durability = DurabilityPolicy.TRANSIENT_LOCAL if quality.latched else DurabilityPolicy.VOLATILE
    profile = QoSProfile(depth=quality.depth, reliability=reliability, durability=durability)
    if quality.deadline_s > 0.0:
        profile.deadline = Duration(seconds=quality.deadline_s)
    return profile
