# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines the interface between the application and a middleware; the transports `ros` and `dds` implement it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Protocol

from trackres_ros.units import SECOND_NS

if TYPE_CHECKING:
    from trackres_ros.node.endpoints import InputTopic

# Range of a stamp: builtin_interfaces/msg/Time has int32 seconds and less than 1e9 nanoseconds.
FIRST_NS, LAST_NS = -(2**31) * SECOND_NS, 2**31 * SECOND_NS - 1
UNUSABLE = LAST_NS + 1
"""Marks an invalid stamp; no message can carry it."""


class Level(IntEnum):
    """Level of a status, as in diagnostic_msgs/msg/DiagnosticStatus; the larger outweighs the smaller."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True, slots=True)
class Status:
    """One diagnostic_msgs/msg/DiagnosticStatus."""

    level: Level
    name: str
    message: str
    hardware_id: str
    values: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True)
class Peer:
    """A publisher on one of our input topics, by its announcement."""

    type: str  # ``package/msg/Name``
    compatible: bool  # whether it fits the input; otherwise it never connects
    defines_alike: bool = True  # False if it announces another definition of the type than ours
    node: str = ""  # full name of its node; empty where the graph does not know it
    source: int = 0  # as in `MessageHandler.receive`; 0 where the middleware does not tell publishers apart
    latched: bool = False  # keeps its last messages for those who join later: transient local and reliable

    @property
    def name(self) -> str:
        """For messages."""
        return self.node or "a publisher without a node name"

    @property
    def misread(self) -> bool:
        """Whether its messages arrive and would be read by another definition."""
        return self.compatible and not self.defines_alike


Reasons = tuple[tuple[str, Level], ...]
"""Names of all present notices, each once, most severe first, with the level of each."""


KeepMessage = Callable[[int, bytes, int], None]
"""Takes a message to be recorded: which of the topics of `Application.record`, its bytes as CDR, its time of arrival [ns]."""


class Transport(Protocol):
    """Interface of a middleware for the application. All calls come from the thread that calls the application.

    Inputs and outputs are given by their index in `Application.inputs` and `Application.outputs`.
    """

    def now_ns(self) -> int:
        """The node's time [ns since 1970]: the machine's, or the simulated one; 0 while there is no simulated one yet."""

    def publish(self, output: int, stamp_ns: int, values: Sequence[float], reasons: Reasons) -> None:
        """Publish a message of numbers: those of `OutputTopic.columns` in their order, in units of the message.

        The message of `topics.ESTIMATE_TOPIC` has the numbers of its names, and all reasons; the others have no reasons.
        """

    def publish_status(self, output: int, stamp_ns: int, statuses: Sequence[Status]) -> None:
        """Publish a DiagnosticArray."""

    def peers(self, index: int) -> Sequence[Peer]:
        """The publishers that are there now on the topic of an input, whatever their type and quality of service."""

    def latch(self, index: int) -> None:
        """From now on receive also what the publishers of an input keep for those who join later, marked as latched."""

    def rivals(self) -> Sequence[str] | None:
        """Names of the nodes of other publishers on our topics with the feed-forward.

        None while a publisher that is there may not have been discovered yet.
        """

    def open_outputs(self) -> None:
        """Open the topics below the node's own name; others see it as a publisher of the feed-forward from then on."""

    def record(self, others: Sequence[InputTopic]) -> Sequence[str | None]:
        """Pass the bytes of every message too: of an input with its values, of other topics to `MessageHandler.keep`.

        Returns the texts that define the types of all inputs and of the other topics; None for an unknown type.
        """

    def topic_name(self, name: str) -> str:
        """The full name of an input topic on the wire, remapped where that is possible."""

    def log(self, level: Level, text: str) -> None:
        """Write to the log."""


def stamp_ns(seconds: int, nanoseconds: int) -> int:
    """A stamp [ns] from its two numbers, `UNUSABLE` if they are invalid."""
    stamp = seconds * SECOND_NS + nanoseconds
    return stamp if 0 <= nanoseconds < SECOND_NS and is_usable(stamp) else UNUSABLE


def is_usable(stamp: int) -> bool:
    """Whether a message can carry it [ns]."""
    return FIRST_NS <= stamp <= LAST_NS


def nearest_usable(stamp: int) -> int:
    """The nearest stamp [ns] that a message can carry."""
    return min(max(stamp, FIRST_NS), LAST_NS)
