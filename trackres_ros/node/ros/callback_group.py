# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The group of all callbacks of a node."""

from __future__ import annotations

from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.subscription import Subscription
from rclpy.timer import Timer


class OneAtATime(MutuallyExclusiveCallbackGroup):  # type: ignore[misc]
    """The group of all callbacks of a node: any executor runs one at a time, so messages keep the order in which they are taken.

    Sometimes the executor excludes some of them from its wait. rclpy builds its wait set again for each message, from every
    entity that may run. With dozens of services and event handlers in it that takes longer than the estimate itself.
    """

    def __init__(self) -> None:
        super().__init__()
        self.inputs: list[Any] = []  # subscriptions that feed the estimate
        self.waits_for_inputs = True  # for their messages; else the next tick collects them
        self.serves = True  # services and events; not from a message until the next tick

    def can_execute(self, entity: Any) -> bool:
        """Whether the executor waits for it, or runs it."""
        if isinstance(entity, Subscription):  # others are rclpy's own, of /clock, or only recorded
            opened = self.waits_for_inputs or entity not in self.inputs
        else:
            opened = self.serves or isinstance(entity, Timer)
        return opened and bool(super().can_execute(entity))
