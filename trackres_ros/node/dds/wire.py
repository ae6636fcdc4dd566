# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""ROS 2 topics on the DDS wire as the middlewares of ROS 2 have them: names, types, presence and messages in bytes.

Names and types after the ROS 2 design "Topic and Service name mapping to DDS"; the type hash after REP-2016. Others see a
participant as a node of ROS 2.
"""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from cyclonedds._clayer import ddspy_take, ddspy_write
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import DDSException, InstanceState, Policy, Qos, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl import types as idl
from cyclonedds.pub import DataWriter, Publisher
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from rosbags.typesys import Stores, get_typestore

from trackres_ros.errors import InputError
from trackres_ros.node.transport import UNUSABLE, InputTopic, Quality, Reasons, Status, stamp_ns
from trackres_ros.output import bag
from trackres_ros.output.topics import ESTIMATE_TOPIC, OutputTopic
from trackres_ros.recording.bindings import FIX, NO_FIX
from trackres_ros.recording.cdr import FieldReader, MalformedError, Template, layout_of
from trackres_ros.recording.message_types import add_control_msgs, definitions, message_fields
from trackres_ros.units import SECOND_NS

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

TOPIC_PREFIX = "rt/"
MOST_DOMAIN = 232
OTHERWISE = {"bool": bool, "byte": idl.uint8, "char": idl.uint8, "octet": idl.uint8}
"""Numbers with another name in the binding of Cyclone, or of another type on the wire."""
LOOPBACK = """<CycloneDDS><Domain>
<General><AllowMulticast>false</AllowMulticast><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>{most}</MaxAutoParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
MOST_INDEX = 119
MOST_PORT = 65535
GRAPH_TOPIC, GRAPH_TYPE = "ros_discovery_info", "rmw_dds_common/msg/ParticipantEntitiesInfo"
GRAPH_QUALITY = Quality(reliable=True, depth=1, deadline_s=0.0, latched=True)
NODES_QUALITY = Quality(reliable=True, depth=1000, deadline_s=0.0, latched=True)  # of all participants together: it has no key
EVERY_SAMPLE = SampleState.Any | ViewState.Any | InstanceState.Any
WAITING = SampleState.NotRead | ViewState.Any | InstanceState.Any
MOST_TAKEN = 1000
ALIGNMENT = 4
CLOCK_BYTES = 12
CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "i8": "q", "u8": "Q", "f4": "f", "f8": "d"}
Fill = Callable[[int, Sequence[float], Reasons], bytes]
STRUCTS = {order + kind: struct.Struct(order + code) for order in "<>" for kind, code in CODES.items()}


@cache
def typestore() -> Typestore:
    """All common message types of ROS 2 Jazzy, and the ros2_control types that the node publishes.

    rosidl hashes a `char` of a .msg file as uint8, rosbags as char. So it becomes uint8 here, which is the same on the wire.
    """
    store = add_control_msgs(get_typestore(Stores.ROS2_JAZZY))
    fields: Any = message_fields(store)
    for name, (constants, members) in list(fields.items()):
        fields[name] = (constants, [(field, _without_char(kind)) for field, kind in members])
    return store


def _without_char(kind: Any) -> Any:
    if kind[1] == ("char", 0):
        return (kind[0], ("uint8", 0))
    return (kind[0], (_without_char(kind[1][0]), kind[1][1])) if int(kind[0]) > 2 else kind


def known_type(name: str, place: str) -> str:
    """The message type, if known. Raises InputError if unknown."""
    if name not in typestore().types:
        raise InputError(
            f"{place}: type",
            name,
            "a type of common_interfaces, the only ones known without ROS",
            "run the node on ROS 2, which accepts every installed type",
        )
    return name


def dds_type_name(name: str) -> str:
    """Name of a message type on the wire: std_msgs/msg/Float64 is std_msgs::msg::dds_::Float64_."""
    package, kind, short_name = name.split("/")
    return f"{package}::{kind}::dds_::{short_name}_"


def ros_type_name(name: str) -> str:
    """The reverse of `dds_type_name`; returns other names unchanged."""
    package, _, name_part = name.partition("::msg::dds_::")
    return f"{package}/msg/{name_part.removesuffix('_')}" if name_part else name


@cache
def type_hash(name: str) -> bytes:
    """USER_DATA of an endpoint: the hash of its type."""
    return f"typehash={typestore().hash_rihs01(name)};".encode()


@cache
def idl_struct(name: str) -> Any:
    """The message type for Cyclone's Python binding."""
    fields: Any = message_fields(typestore())[name][1]
    return make_idl_struct(
        name.replace("/", "__"), dds_type_name(name), {f"{field}_": _idl_field(kind) for field, kind in fields}
    )


def _idl_field(kind: Any) -> Any:
    types: Any = idl  # generic at run time only
    node, inner_kind = int(kind[0]), kind[1]
    if node == 1:  # a number or a string
        name, bound = inner_kind
        if name == "string":
            return types.bounded_str[bound] if bound else str
        return OTHERWISE.get(name) or getattr(idl, name)
    if node == 2:  # another message
        return idl_struct(inner_kind)
    element, bound = inner_kind
    if node == 3:
        return types.array[_idl_field(element), bound]
    return types.sequence[_idl_field(element), bound] if bound else types.sequence[_idl_field(element)]


def qos(quality: Quality, user_data: bytes) -> Any:
    """Quality of service of an endpoint."""
    policies = [
        Policy.Reliability.Reliable(duration(seconds=0.1)) if quality.reliable else Policy.Reliability.BestEffort,
        Policy.History.KeepLast(quality.depth),
        Policy.Durability.TransientLocal if quality.latched else Policy.Durability.Volatile,
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.WriterDataLifecycle(autodispose=False),
        Policy.Userdata(user_data),
    ]
    if quality.deadline_s > 0.0:
        policies.append(Policy.Deadline(duration(seconds=quality.deadline_s)))
    if quality.latched:  # of a writer: what it keeps
        policies.append(Policy.DurabilityService(duration(seconds=0), Policy.History.KeepLast(quality.depth), -1, -1, -1))
    return Qos(*policies)


def domain_id() -> int:
    """Domain from ROS_DOMAIN_ID, 0 by default. Raises InputError if it is no domain."""
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not text.isdecimal() or int(text) > MOST_DOMAIN:
        raise InputError("environment ROS_DOMAIN_ID", text, f"a whole number from 0 to {MOST_DOMAIN}")
    return int(text)


def most_index(domain: int) -> int:
    """The highest index that a participant of a domain may have: the ports of the last domains end before `MOST_INDEX`.

    Participant i listens on ports 7410 + 250 domain + 2 i and the next (DDSI-RTPS 2.5, 9.6.2.3).
    """
    return min(MOST_INDEX, (MOST_PORT - 7411 - 250 * domain) // 2)


@contextmanager
def opening(number: int) -> Iterator[str]:
    """For as long as a participant is made: the way in which its domain reaches others, as text.

    CYCLONEDDS_URI has priority, then ROS_LOCALHOST_ONLY and ROS_AUTOMATIC_DISCOVERY_RANGE as in ROS 2. A domain that its first
    participant opens is configured by the environment, and closes with the last one. One that is opened before, by `Domain`,
    sometimes never closes: then the process does not end.
    """
    if os.environ.get("CYCLONEDDS_URI"):
        yield "as set by CYCLONEDDS_URI"
    elif os.environ.get("ROS_LOCALHOST_ONLY") == "1" or os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE") == "LOCALHOST":
        os.environ["CYCLONEDDS_URI"] = LOOPBACK.format(most=most_index(number))
        try:
            yield "on this machine only"
        finally:
            del os.environ["CYCLONEDDS_URI"]
    else:
        yield "on all networks"


@dataclass(frozen=True, slots=True)
class Publication:
    """A writer on the wire, of this or another process: topic and type by their ROS names."""

    topic: str
    type: str
    handle: int  # as in `TopicReader.connections` and `Taken`
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
    def connections(self) -> list[int]:
        """The writers whose messages come: quality of service and definition of the type fit."""
        return [handle % 2**64 for handle in self.entity.get_matched_publications()]  # the binding reads them with a sign

    def take(self) -> list[Taken]:
        """Take all waiting messages in order of arrival."""
        samples = ddspy_take(self._reference, EVERY_SAMPLE, MOST_TAKEN)
        if not isinstance(samples, list):
            return []
        latched = self._latched
        return [Taken(raw, info.source_timestamp, info.publication_handle, latched) for raw, info in samples if info.valid_data]


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
            uri = os.environ.get("CYCLONEDDS_URI", "")
            allowed = "a configuration and a network with which Cyclone DDS starts"
            raise InputError("environment CYCLONEDDS_URI", uri, allowed, "its own messages above give the cause") from error
        self.publisher, self.subscriber = Publisher(self.entity), Subscriber(self.entity)
        graph = Topic(self.entity, GRAPH_TOPIC, idl_struct(GRAPH_TYPE))
        self._graph = DataWriter(self.publisher, graph, qos=qos(GRAPH_QUALITY, type_hash(GRAPH_TYPE)))
        self._nodes = DataReader(self.subscriber, graph, qos=qos(NODES_QUALITY, type_hash(GRAPH_TYPE)))
        self._entities: dict[bytes, Mapping[bytes, str]] = {}  # by participant: its writers, and the node of each
        self._publications = BuiltinDataReader(self.entity, BuiltinTopicDcpsPublication)
        self._publication_by_handle: dict[int, Publication] = {}
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
        samples = ddspy_take(self._nodes._ref, EVERY_SAMPLE, MOST_TAKEN)
        for raw, info in samples if isinstance(samples, list) else ():
            if info.valid_data:
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
        for sample in self._publications.take(N=MOST_TAKEN):
            handle = sample.sample_info.instance_handle
            if sample.sample_info.instance_state != InstanceState.Alive:
                self._publication_by_handle.pop(handle, None)
            elif sample.topic_name.startswith(TOPIC_PREFIX):
                name, kind = "/" + sample.topic_name.removeprefix(TOPIC_PREFIX), ros_type_name(sample.type_name)
                user_data = getattr(sample.qos[Policy.Userdata], "data", b"")
                is_reliable = isinstance(sample.qos[Policy.Reliability], Policy.Reliability.Reliable)
                latched = is_reliable and sample.qos[Policy.Durability] != Policy.Durability.Volatile
                self._publication_by_handle[handle] = Publication(name, kind, handle, user_data, sample.key.bytes, latched)
        yield from self._publication_by_handle.values()

    def close(self) -> None:
        """Leave; others see it at once."""
        self.entity._delete(self.entity._ref)


def serialized(message: Any, kind: str) -> bytes:
    """A message as CDR, padded to whole words for the middleware."""
    raw = bytes(typestore().serialize_cdr(message, kind))
    return raw + b"\0" * (-len(raw) % ALIGNMENT)


def _gid(entity: Any) -> Any:
    return typestore().types["rmw_dds_common/msg/Gid"](data=np.frombuffer(entity.guid.bytes, dtype=np.uint8))


class PreparedMessage:
    """A message of one output topic: only stamp and numbers are written into its bytes each time."""

    def __init__(self, topic: OutputTopic, message: object, numbers: Sequence[str]) -> None:
        types = definitions(message_fields(typestore()), topic.type)
        template = Template(serialized(message, topic.type), types, topic.type, numbers)
        self._bytes = bytearray(template.raw)
        places = [spot[0] for spot in template.layout.spots if spot]
        self._numbers, self._stamp = places[: len(numbers)], places[len(numbers) :]

    def fill(self, stamp: int, values: Sequence[float]) -> bytes:
        """The message with a stamp [ns] and its numbers."""
        if self._stamp:
            seconds, nanoseconds = divmod(stamp, SECOND_NS)
            struct.pack_into("<i", self._bytes, self._stamp[0], seconds)
            struct.pack_into("<I", self._bytes, self._stamp[1], nanoseconds)
        for offset, value in zip(self._numbers, values, strict=True):
            struct.pack_into("<d", self._bytes, offset, value)
        return bytes(self._bytes)


def prepare_message(topic: OutputTopic, frame_id: str) -> Fill:
    """A function that makes the message from a stamp [ns], the numbers of a topic and the reasons of an estimate."""
    if topic is ESTIMATE_TOPIC:
        return DdsEstimate(frame_id).fill
    message = PreparedMessage(topic, bag.template_message(topic, typestore(), frame_id), bag.number_fields(topic))
    return lambda stamp, values, _reasons: message.fill(stamp, values)


class DdsEstimate:
    """The message of `topics.ESTIMATE_TOPIC`, prepared again when the reasons change."""

    def __init__(self, frame_id: str) -> None:
        self._frame_id = frame_id
        self._reasons: Reasons | None = None

    def fill(self, stamp: int, values: Sequence[float], reasons: Reasons) -> bytes:
        """The message with a stamp [ns], its numbers and the present reasons."""
        if reasons != self._reasons:
            self._message, self._reasons = self._prepare(reasons), reasons
        return self._message.fill(stamp, values)

    def _prepare(self, reasons: Reasons) -> PreparedMessage:
        message = bag.estimate_message(typestore(), self._frame_id, reasons)
        return PreparedMessage(ESTIMATE_TOPIC, message, bag.number_fields(ESTIMATE_TOPIC))


def diagnostic_array(stamp: int, statuses: Sequence[Status], frame_id: str) -> bytes:
    """A DiagnosticArray."""
    rows = ((int(status.level), status.name, status.message, status.hardware_id, status.values) for status in statuses)
    return serialized(bag.diagnostic_array(typestore(), rows, frame_id, stamp), bag.DIAGNOSTICS)


class CdrInput:
    """Reads stamp and numbers of the messages of one input topic.

    Messages of a topic mostly have the same layout, so field positions are reused from message to message. Raises
    InputError for an unknown type, or a field path that does not lead to a number.
    """

    def __init__(self, topic: InputTopic, origin: str) -> None:
        place = f"{origin}: {topic.role_names}"
        self._type = known_type(topic.type, place)
        bindings = [reading.binding for reading in topic.readings]
        self._scales = [(binding.scale, binding.offset) for binding in bindings]
        self._has_fix = bool(bindings[0].fix)
        fields = [*(binding.field for binding in bindings), *([FIX] if self._has_fix else [])]
        types = definitions(message_fields(typestore()), self._type)
        self._fields = FieldReader(types, self._type, fields, where=f"{place}: field")
        self._has_stamp = len(self._fields.paths) > len(fields)
        self._constants: tuple[tuple[slice, bytes], ...] = ()
        self._length = -1
        self._places: list[tuple[int, struct.Struct] | str] = []

    def read(self, raw: bytes) -> tuple[int | None, list[float | str]]:
        """Stamp [ns], None where the type has none; and the scaled number of each binding, the reason where the message lacks
        it, nan of a receiver without a fix. Raises MalformedError if the bytes are no message of the type.
        """
        if len(raw) != self._length or any(raw[span] != content for span, content in self._constants):
            self._learn(raw)
        numbers: list[Any] = [
            place if isinstance(place, str) else place[1].unpack_from(raw, place[0])[0] for place in self._places
        ]
        stamp = None
        if self._has_stamp:
            nanoseconds, seconds = numbers.pop(), numbers.pop()
            stamp = stamp_ns(int(seconds), int(nanoseconds))
        if self._has_fix and numbers.pop() == NO_FIX:
            numbers = [math.nan] * len(numbers)
        return stamp, [
            number if isinstance(number, str) else scale * number + offset
            for number, (scale, offset) in zip(numbers, self._scales, strict=True)
        ]

    def _learn(self, raw: bytes) -> None:
        layout = layout_of(raw, self._fields.types, self._type, self._fields.paths)
        self._length = layout.length
        self._constants = tuple((slice(start, start + len(content)), content) for start, content in layout.constants)
        self._places = [
            (spot[0], STRUCTS[spot[1]]) if spot else layout.lacks.get(slot, "") for slot, spot in enumerate(layout.spots)
        ]


def clock_ns(raw: bytes) -> int:
    """Time [ns] in a rosgraph_msgs/msg/Clock. Raises MalformedError if the bytes are too few, or contain no valid time."""
    if len(raw) < CLOCK_BYTES:
        raise MalformedError("too short")
    seconds, nanoseconds = struct.unpack_from("<iI" if raw[1] else ">iI", raw, 4)
    stamp = stamp_ns(int(seconds), int(nanoseconds))
    if stamp == UNUSABLE:
        raise MalformedError("no time")
    return stamp
