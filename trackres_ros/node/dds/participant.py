# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One participant on the DDS wire that other machines see as a ROS 2 node, with its endpoints and its view of others."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from cyclonedds._clayer import ddspy_take, ddspy_write
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import DDSException, InstanceState, Policy, Qos, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter, Publisher
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic

from trackres_ros.errors import InputError
from trackres_ros.node.dds.wire import (
    TOPIC_PREFIX,
    domain_id,
    idl_struct,
    opening,
    qos,
    ros_type_name,
    type_hash,
    typestore,
)
from trackres_ros.node.endpoints import Quality

GRAPH_TOPIC, GRAPH_TYPE = "ros_discovery_info", "rmw_dds_common/msg/ParticipantEntitiesInfo"
GRAPH_QUALITY = Quality(reliable=True, depth=1, deadline_s=0.0, latched=True)
NODES_QUALITY = Quality(reliable=True, depth=1000, deadline_s=0.0, latched=True)  # of all participants together: it has no key
EVERY_SAMPLE = SampleState.Any | ViewState.Any | InstanceState.Any
WAITING = SampleState.NotRead | ViewState.Any | InstanceState.Any
MOST_TAKEN = 1000
ALIGNMENT = 4


@dataclass(frozen=True, slots=True)
class Publication:
    """A writer on the wire, of this or another process: topic and type by their ROS names."""

    topic: str
    type: str
    handle: int  # as in `TopicReader.connected` and `Taken`
    user_data: bytes  # from ROS 2 as of `wire.type_hash`
    gid: bytes = b""
    latched: bool = False  # keeps its last messages for those who join later: reliable and transient local

    @property
    def process(self) -> bytes:
        """What all endpoints of one participant share: the GUID's prefix (DDSI-RTPS 2.5, 9.3.1.5)."""
        return self.gid[:12]


class Taken(NamedTuple):
    """A serialised message."""

    raw: bytes
    sent_ns: int  # by its publisher's clock
    source: int  # handle of its publisher
    latched: bool  # whether it came by an endpoint that also gets what publishers keep


class Writer:
    """Publishes serialised messages on one topic."""

    def __init__(self, participant: Participant, name: str, kind: str, quality: Quality) -> None:
        topic = Topic(participant.entity, TOPIC_PREFIX + name.lstrip("/"), idl_struct(kind))
        self.entity = DataWriter(participant.publisher, topic, qos=qos(quality, type_hash(kind)))
        self._reference = self.entity._ref

    def write(self, message: bytes) -> None:
        """Publish one message; its length is a multiple of `ALIGNMENT`. Raises OSError if the middleware refuses it."""
        code = ddspy_write(self._reference, message)
        if code < 0:
            raise OSError(-code, f"DDS write failed with code {code}")

    @property
    def readers(self) -> int:
        """Number of matched readers."""
        return len(self.entity.get_matched_subscriptions())


class TopicReader:
    """Takes serialised messages of one topic."""

    def __init__(self, participant: Participant, name: str, kind: str, quality: Quality) -> None:
        topic = Topic(participant.entity, TOPIC_PREFIX + name.lstrip("/"), idl_struct(kind))
        self.entity = DataReader(participant.subscriber, topic, qos=qos(quality, type_hash(kind)))
        self.condition = ReadCondition(self.entity, WAITING)
        self._reference, self._latched = self.entity._ref, quality.latched

    @property
    def connected(self) -> list[int]:
        """The writers whose messages come: quality of service and definition of the type fit."""
        return [handle % 2**64 for handle in self.entity.get_matched_publications()]  # the binding reads them with a sign

    def take(self) -> list[Taken]:
        """Take all waiting messages in order of arrival."""
        found = ddspy_take(self._reference, EVERY_SAMPLE, MOST_TAKEN)
        if not isinstance(found, list):
            return []
        latched = self._latched
        return [Taken(raw, about.source_timestamp, about.publication_handle, latched) for raw, about in found if about.valid_data]


class Participant:
    """A node's presence on the wire.

    Raises InputError if ROS_DOMAIN_ID is not a domain, or the configuration prevents Cyclone DDS from starting.
    """

    def __init__(self, node: str, namespace: str) -> None:
        number = domain_id()
        self.node, self.namespace = node, namespace
        try:
            with opening(number) as reach:
                self.reach = f"in domain {number}, {reach}"
                self.entity = DomainParticipant(number, qos=Qos(Policy.Userdata(b"enclave=/;")))
        except DDSException as error:
            given = os.environ.get("CYCLONEDDS_URI", "")
            allowed = "a configuration and a network with which Cyclone DDS starts"
            raise InputError("environment CYCLONEDDS_URI", given, allowed, "its own messages above give the cause") from error
        self.publisher, self.subscriber = Publisher(self.entity), Subscriber(self.entity)
        graph = Topic(self.entity, GRAPH_TOPIC, idl_struct(GRAPH_TYPE))
        self._graph = DataWriter(self.publisher, graph, qos=qos(GRAPH_QUALITY, type_hash(GRAPH_TYPE)))
        self._nodes = DataReader(self.subscriber, graph, qos=qos(NODES_QUALITY, type_hash(GRAPH_TYPE)))
        self._entities: dict[bytes, Mapping[bytes, str]] = {}  # by participant: its writers, and the node of each
        self._others = BuiltinDataReader(self.entity, BuiltinTopicDcpsPublication)
        self._known: dict[int, Publication] = {}
        self._writers: list[Writer] = []
        self._readers: list[TopicReader] = []
        self._waits: WaitSet | None = None

    def writer(self, name: str, kind: str, quality: Quality) -> Writer:
        """A writer on a topic by its full name; visible to others after `announce`."""
        self._writers.append(Writer(self, name, kind, quality))
        return self._writers[-1]

    def reader(self, name: str, kind: str, quality: Quality) -> TopicReader:
        """A reader of a topic by its full name; visible to others after `announce`."""
        self._readers.append(TopicReader(self, name, kind, quality))
        if self._waits is not None:
            self._waits.attach(self._readers[-1].condition)
        return self._readers[-1]

    def announce(self) -> None:
        """Announce which endpoints belong to the node, as ROS 2 does."""
        types = typestore().types
        node = types["rmw_dds_common/msg/NodeEntitiesInfo"](
            node_namespace=self.namespace,
            node_name=self.node,
            reader_gid_seq=[_gid(reader.entity) for reader in self._readers],
            writer_gid_seq=[_gid(writer.entity) for writer in self._writers],
        )
        message = types[GRAPH_TYPE](gid=_gid(self.entity), node_entities_info_seq=[node])
        ddspy_write(self._graph._ref, serialized(message, GRAPH_TYPE))

    def waiter(self) -> Callable[[int], object]:
        """A function that waits [ns] until a message waits at any reader, or the time is over."""
        self._waits = WaitSet(self.entity)
        for reader in self._readers:
            self._waits.attach(reader.condition)
        wait: Callable[[int], object] = self._waits.wait
        return wait

    def node_of(self, publication: Publication) -> str:
        """Full name of the node that announces a writer as its own; empty if none does."""
        found = ddspy_take(self._nodes._ref, EVERY_SAMPLE, MOST_TAKEN)
        for raw, about in found if isinstance(found, list) else ():
            if about.valid_data:
                message: Any = typestore().deserialize_cdr(raw, GRAPH_TYPE)
                self._entities[bytes(message.gid.data)[:12]] = {
                    bytes(gid.data): f"{node.node_namespace.rstrip('/')}/{node.node_name}"
                    for node in message.node_entities_info_seq
                    for gid in node.writer_gid_seq
                }
        return self._entities.get(publication.process, {}).get(publication.gid, "")

    def is_own(self, publication: Publication) -> bool:
        """Whether it is a writer of this participant."""
        return publication.process == bytes(self.entity.guid.bytes[:12])

    def publications(self) -> Iterator[Publication]:
        """All present writers of ROS topics, including our own."""
        for found in self._others.take(N=MOST_TAKEN):
            handle = found.sample_info.instance_handle
            if found.sample_info.instance_state != InstanceState.Alive:
                self._known.pop(handle, None)
            elif found.topic_name.startswith(TOPIC_PREFIX):
                name, kind = "/" + found.topic_name.removeprefix(TOPIC_PREFIX), ros_type_name(found.type_name)
                user_data = getattr(found.qos[Policy.Userdata], "data", b"")
                reliable = isinstance(found.qos[Policy.Reliability], Policy.Reliability.Reliable)
                latched = reliable and found.qos[Policy.Durability] != Policy.Durability.Volatile
                self._known[handle] = Publication(name, kind, handle, user_data, found.key.bytes, latched)
        yield from self._known.values()

    def close(self) -> None:
        """Leave; others see it at once."""
        self.entity._delete(self.entity._ref)


def serialized(message: Any, kind: str) -> bytes:
    """A message as CDR, padded to whole words for the middleware."""
    raw = bytes(typestore().serialize_cdr(message, kind))
    return raw + b"\0" * (-len(raw) % ALIGNMENT)


def _gid(entity: Any) -> Any:
    return typestore().types["rmw_dds_common/msg/Gid"](data=np.frombuffer(entity.guid.bytes, dtype=np.uint8))
