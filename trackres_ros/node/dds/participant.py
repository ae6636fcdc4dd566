# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One participant on the DDS wire that other machines see as a ROS 2 node, with its endpoints and its view of others."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

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
GRAPH_QUALITY = Quality(reliable=True, depth=1, deadline_s=0.0)
EVERY_SAMPLE = SampleState.Any | ViewState.Any | InstanceState.Any
WAITING = SampleState.NotRead | ViewState.Any | InstanceState.Any
MOST_TAKEN = 1000
ALIGNMENT = 4


@dataclass(frozen=True, slots=True)
class Publication:
    """A writer on the wire, of this or another process: topic and type by their ROS names."""

    topic: str
    type: str
    handle: int  # as in `TopicReader.connected`
    user_data: bytes  # from ROS 2 as of `wire.type_hash`


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
        self._reference = self.entity._ref

    @property
    def connected(self) -> list[int]:
        """The writers whose messages come: quality of service and definition of the type fit."""
        return [handle % 2**64 for handle in self.entity.get_matched_publications()]  # the binding reads them with a sign

    def take(self) -> list[tuple[bytes, int]]:
        """Take all waiting messages in order of arrival, each with its sending time [ns]."""
        found = ddspy_take(self._reference, EVERY_SAMPLE, MOST_TAKEN)
        return [(raw, about.source_timestamp) for raw, about in found if about.valid_data] if isinstance(found, list) else []


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
        self._graph = DataWriter(self.publisher, graph, qos=qos(GRAPH_QUALITY, type_hash(GRAPH_TYPE), transient=True))
        self._others = BuiltinDataReader(self.entity, BuiltinTopicDcpsPublication)
        self._known: dict[int, Publication] = {}
        self._writers: list[Writer] = []
        self._readers: list[TopicReader] = []

    def writer(self, name: str, kind: str, quality: Quality) -> Writer:
        """A writer on a topic by its full name; visible to others after `announce`."""
        self._writers.append(Writer(self, name, kind, quality))
        return self._writers[-1]

    def reader(self, name: str, kind: str, quality: Quality) -> TopicReader:
        """A reader of a topic by its full name; visible to others after `announce`."""
        self._readers.append(TopicReader(self, name, kind, quality))
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
        waits = WaitSet(self.entity)
        for reader in self._readers:
            waits.attach(reader.condition)
        wait: Callable[[int], object] = waits.wait
        return wait

    def publications(self) -> Iterator[Publication]:
        """All present writers of ROS topics, including our own."""
        for found in self._others.take(N=MOST_TAKEN):
            handle = found.sample_info.instance_handle
            if found.sample_info.instance_state != InstanceState.Alive:
                self._known.pop(handle, None)
            elif found.topic_name.startswith(TOPIC_PREFIX):
                name, kind = "/" + found.topic_name.removeprefix(TOPIC_PREFIX), ros_type_name(found.type_name)
                self._known[handle] = Publication(name, kind, handle, getattr(found.qos[Policy.Userdata], "data", b""))
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
