# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines input and output topics of the live node with their quality of service: one table for both transports."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from trackres_ros.estimator.columns import CHANNELS, WHEELS
from trackres_ros.node.parameters import Parameters
from trackres_ros.output.topics import ESTIMATE_TOPIC, PARAMETERS_TOPIC, OutputTopic, output_topics
from trackres_ros.recording.bindings import TopicBinding, Topics
from trackres_ros.recording.combining import DIRECTION, Reading, readings_of
from trackres_ros.recording.roles import GROUND, POSITION, base_role
from trackres_ros.vehicle import AnyVehicle

DIAGNOSTICS = OutputTopic(
    "/diagnostics",
    "diagnostic_msgs/msg/DiagnosticArray",
    "status",
    "once a second: the estimate, each input, the comparison with a measured torque, the disturbance, the state file",
)
STANDING = frozenset({"load", "ambient", "passengers"})
"""Roles of states that change rarely. A speed or an enable is never latched: that it keeps coming is what makes it valid."""
TORQUES = ("feedforward_torque", "feedforward_torque_nm", ESTIMATE_TOPIC.name)
"""Outputs that a controller may add to its own torque: one publisher each."""
DISCOVERY_NS = 1_000_000_000  # assumed: a participant has found the others by then; one found later withdraws both torques
WIRE_DEPTH = 5000  # enough for a few seconds' delay of this process at 1 kHz: a middleware drops messages silently


@dataclass(frozen=True, slots=True)
class Quality:
    """Quality of service of an endpoint; history is keep-last. A deadline of 0 s is none."""

    reliable: bool
    depth: int
    deadline_s: float
    latched: bool = False  # transient local, else volatile


@dataclass(frozen=True, slots=True)
class InputTopic:
    """One topic to subscribe to, and the roles it feeds."""

    name: str  # from the topics file: absolute, or relative to the node's namespace
    type: str  # ``package/msg/Name``
    roles: tuple[str, ...]
    bindings: tuple[TopicBinding, ...]  # the field for each role
    parts: tuple[int | None, ...]  # for a role that is a sum, the field's place among its parts; else None
    validities: frozenset[int] = frozenset()  # places of fields that only say whether the role's other field counts

    @property
    def valued(self) -> tuple[str, ...]:
        """The roles that a field has a value of, each once."""
        return tuple(dict.fromkeys(role for place, role in enumerate(self.roles) if place not in self.validities))

    @property
    def role_names(self) -> str:
        """For messages: each role once."""
        return ", ".join(dict.fromkeys(self.roles))

    @property
    def stands(self) -> bool:
        """Whether its last message stands until the next one, so that it may be published once and latched."""
        return all(base_role(role) in STANDING for role in self.roles)


def input_topics(topics: Topics, on_route: bool = False, channels: Collection[str] = CHANNELS) -> tuple[InputTopic, ...]:
    """All topics to subscribe to, those that feed a speed last. Roles that the estimate does not need have none.

    A position is needed only to follow a route, and signs of the ground only with a measured torque to learn from. Wheel speeds
    are needed only for the axles and assemblies in `channels`. Where messages wait on several topics, a transport passes them on
    in this order: inputs of a step come before its speed.
    """
    needed = [
        role
        for role in topics
        if (role in channels if base_role(role) == WHEELS else base_role(role) in (*CHANNELS, DIRECTION))
        and (on_route or role not in POSITION)
        and ("torque" in topics or role not in GROUND)
    ]
    return tuple(sorted(_by_topic(topics, needed), key=lambda given: "speed" in given.valued))


def without_effect(topics: Topics, channels: Collection[str], belts: bool) -> list[str]:
    """Roles of a belt or a wheel that a vehicle with these channels, with belts or without, does not have."""
    return [
        role
        for role in topics
        if (base_role(role) == WHEELS and role not in channels) or (base_role(role) == "belt" and not belts)
    ]


def other_topics(topics: Topics, inputs: Sequence[InputTopic]) -> tuple[InputTopic, ...]:
    """Topics of a topics file that the estimate does not need, but a replay or diagnosis of the recording may."""
    needed = {given.name for given in inputs}
    others = [role for role in topics if topics[role].of_topics]
    return tuple(given for given in _by_topic(topics, others) if given.name not in needed)


def _by_topic(topics: Topics, roles: Sequence[str]) -> list[InputTopic]:
    by_name: dict[tuple[str, str], list[Reading]] = {}
    for reading in readings_of(sorted(roles, key=lambda role: role == "speed"), topics.bindings):
        by_name.setdefault((reading.binding.topic, reading.binding.type), []).append(reading)
    return [
        InputTopic(
            name,
            kind,
            tuple(one.role for one in fed),
            tuple(one.binding for one in fed),
            tuple(one.part for one in fed),
            frozenset(place for place, one in enumerate(fed) if one.is_valid),
        )
        for (name, kind), fed in by_name.items()
    ]


def live_topics(vehicle: AnyVehicle, topics: Topics) -> tuple[OutputTopic, ...]:
    """All topics to publish, most urgent first; the residual and learned values only with a measured torque."""
    measured = "torque" in topics
    given = (topic for topic in output_topics(vehicle) if topic.name != "torque_residual" or measured)
    learned = (PARAMETERS_TOPIC,) if measured else ()
    return (*given, *learned, DIAGNOSTICS)


def input_quality(parameters: Parameters) -> Quality:
    """Quality of service of every input; `input_depth` limits the queue in this process, which counts dropped messages."""
    return Quality(
        parameters.text("input_reliability") == "reliable",
        max(parameters.count("input_depth"), WIRE_DEPTH),
        parameters.number("input_deadline_s"),
    )


def latched_quality(parameters: Parameters) -> Quality:
    """Quality of service of the second endpoint of an input, for what its publishers keep: these are reliable."""
    return Quality(True, input_quality(parameters).depth, 0.0, latched=True)


def output_quality(parameters: Parameters, topic: OutputTopic) -> Quality:
    """Quality of service of an output; a deadline only on those that come at a steady rate."""
    steady = topic.kind != "status" and topic.name != "torque_residual"
    return Quality(
        parameters.text("output_reliability") == "reliable",
        parameters.count("output_depth"),
        parameters.number("output_deadline_s") if steady else 0.0,
    )


def full_name(name: str, node: str, namespace: str) -> str:
    """Name of an output topic or a service of a node: absolute names stay, others are below the node's own."""
    return name if name.startswith("/") else f"{namespace.rstrip('/')}/{node}/{name}"


def input_name(name: str, namespace: str) -> str:
    """Name of an input topic: absolute names stay, others are in the node's namespace."""
    return name if name.startswith("/") else f"{namespace.rstrip('/')}/{name}"
