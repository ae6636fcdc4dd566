# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The one group of all callbacks of a node."""

from __future__ import annotations

from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.subscription import Subscription
from rclpy.timer import Timer


class OneAtATime(MutuallyExclusiveCallbackGroup):  # type: ignore[misc]
    """The group of all callbacks of a node: in any executor one runs at a time, in the order in which messages are taken.

    Some wait while a door is closed. rclpy builds its wait set anew for each message, out of every entity that may run: with
    dozens of services and event handlers in it that takes longer than the estimate itself.

    Attributes
    ----------
    inputs
        Topics that feed the estimate.
    waits_for_inputs
        Whether each of their messages is answered as it comes; else the next tick collects them.
    serves
        Whether services and events are served: not while messages pass, until the next tick.
    """

    def __init__(self) -> None:
        super().__init__()
        self.inputs: list[Any] = []
        self.waits_for_inputs = self.serves = True

    def can_execute(self, entity: Any) -> bool:
        """Whether the executor is to wait for it, or run it."""
        if isinstance(entity, Subscription):  # any other is rclpy's own, of /clock, or one that is only recorded
            opened = self.waits_for_inputs or entity not in self.inputs
        else:
            opened = self.serves or isinstance(entity, Timer)
        return opened and bool(super().can_execute(entity))
