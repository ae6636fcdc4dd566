# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Topics of the node and their quality of service, and the interface that its middlewares `ros` and `dds` implement."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

from trackres_ros.estimator.columns import CHANNELS, WHEELS
from trackres_ros.output.topics import ESTIMATE_TOPIC, PARAMETERS_TOPIC, OutputTopic, output_topics
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.combining import DIRECTION, Reading, readings_of
from trackres_ros.recording.roles import GROUND, POSITION, base_role
from trackres_ros.units import SECOND_NS
from trackres_ros.vehicle import AnyVehicle

DIAGNOSTICS = OutputTopic(
    "/diagnostics",
    "diagnostic_msgs/msg/DiagnosticArray",
    "status",
    "once a second: the estimate, each input, the comparison with a measured torque, the disturbance, the state file",
)
STANDING = frozenset({"load", "ambient", "passengers"})
"""Roles of states that change rarely. A speed or an enable is never latched: that it keeps coming is what makes it valid."""
NAMELESS = "a publisher without a node name"
TORQUES = ("feedforward_torque", "feedforward_torque_nm", ESTIMATE_TOPIC.name)
"""Outputs that a controller may add to its own torque: one publisher each."""
DISCOVERY_NS = 1_000_000_000  # assumed: a participant has found the others by then; one found later withdraws both torques


@dataclass(frozen=True, slots=True)
class Quality:
    """Quality of service of an endpoint; history is keep-last. A deadline of 0 s is none."""

    reliable: bool
    depth: int
    deadline_s: float
    latched: bool = False  # transient local, else volatile


@dataclass(frozen=True, slots=True)
class InputTopic:
    """One topic to subscribe to, and what is read from its messages."""

    name: str  # from the topics file: absolute, or relative to the node's namespace
    type: str  # ``package/msg/Name``
    readings: tuple[Reading, ...]

    @property
    def valued(self) -> tuple[str, ...]:
        """The roles that a field has a value of, each once."""
        return tuple(dict.fromkeys(reading.role for reading in self.readings if not reading.is_valid))

    @property
    def role_names(self) -> str:
        """For messages: each role once."""
        return ", ".join(dict.fromkeys(reading.role for reading in self.readings))

    @property
    def stands(self) -> bool:
        """Whether its last message stands until the next one, so that it may be published once and latched."""
        return all(base_role(reading.role) in STANDING for reading in self.readings)


def input_topics(topics: Topics, on_route: bool = False, channels: Collection[str] = CHANNELS) -> tuple[InputTopic, ...]:
    """All topics to subscribe to, those that feed a speed last. Roles that the estimate does not need have none.

    A position is needed only to follow a route, and signs of the ground only with a measured torque to learn from. Wheel speeds
    are needed only for the axles and assemblies in `channels`. Where messages wait on several topics, a transport passes them on
    in this order: inputs of a step come before its speed.
    """
    roles = [
        role
        for role in topics
        if (role in channels if base_role(role) == WHEELS else base_role(role) in (*CHANNELS, DIRECTION))
        and (on_route or role not in POSITION)
        and ("torque" in topics or role not in GROUND)
    ]
    return tuple(sorted(_by_topic(topics, roles), key=lambda topic: "speed" in topic.valued))


def without_effect(topics: Topics, channels: Collection[str], belts: bool) -> list[str]:
    """Roles of a belt or a wheel that a vehicle with these channels, with belts or without, does not have."""
    return [
        role
        for role in topics
        if (base_role(role) == WHEELS and role not in channels) or (base_role(role) == "belt" and not belts)
    ]


def other_topics(topics: Topics, inputs: Sequence[InputTopic]) -> tuple[InputTopic, ...]:
    """Topics of a topics file that the estimate does not need, but a replay or diagnosis of the recording may."""
    names = {topic.name for topic in inputs}
    roles = [role for role in topics if topics[role].of_topics]
    return tuple(topic for topic in _by_topic(topics, roles) if topic.name not in names)


def _by_topic(topics: Topics, roles: Sequence[str]) -> list[InputTopic]:
    by_name: dict[tuple[str, str], list[Reading]] = {}
    for reading in readings_of(sorted(roles, key=lambda role: role == "speed"), topics.bindings):
        by_name.setdefault((reading.binding.topic, reading.binding.type), []).append(reading)
    return [InputTopic(name, kind, tuple(readings)) for (name, kind), readings in by_name.items()]


def live_topics(vehicle: AnyVehicle, topics: Topics) -> tuple[OutputTopic, ...]:
    """All topics to publish, most urgent first; the residual and learned values only with a measured torque."""
    has_torque = "torque" in topics
    outputs = (topic for topic in output_topics(vehicle) if topic.name != "torque_residual" or has_torque)
    parameter_topics = (PARAMETERS_TOPIC,) if has_torque else ()
    return (*outputs, *parameter_topics, DIAGNOSTICS)


def full_name(name: str, node: str, namespace: str) -> str:
    """Name of an output topic or a service of a node: absolute names stay, others are below the node's own."""
    return name if name.startswith("/") else f"{namespace.rstrip('/')}/{node}/{name}"


def input_name(name: str, namespace: str) -> str:
    """Name of an input topic: absolute names stay, others are in the node's namespace."""
    return name if name.startswith("/") else f"{namespace.rstrip('/')}/{name}"


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
    source: int = 0  # as in `inputs.Sent`; 0 where the middleware does not tell publishers apart
    latched: bool = False  # keeps its last messages for those who join later: transient local and reliable

    @property
    def name(self) -> str:
        """For messages."""
        return self.node or NAMELESS

    @property
    def is_misread(self) -> bool:
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

    def record(self, other_inputs: Sequence[InputTopic]) -> Sequence[str | None]:
        """Pass the bytes of every message too: of an input with its values, of other topics to `Inputs.keep`.

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
