# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""An independent participant on the wire: plain Cyclone DDS and rosbags, nothing of the package under test."""

import fcntl
import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import pytest
from cyclonedds._clayer import ddspy_take, ddspy_write
from cyclonedds.core import InstanceState, Policy, Qos, SampleState, ViewState
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct, make_idl_struct, types
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from ros_messages import FIELDS, STORE, build
from waiting import PATIENCE_S

LOOPBACK = (
    "<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast><Interfaces>"
    '<NetworkInterface name="lo" multicast="false"/></Interfaces></General><Discovery><ParticipantIndex>auto</ParticipantIndex>'
    '<MaxAutoParticipantIndex>60</MaxAutoParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain>'
    "</CycloneDDS>"
)
PLAIN = {"byte": types.uint8, "char": types.uint8, "bool": bool}
ANY = SampleState.Any | ViewState.Any | InstanceState.Any
LAST_DOMAIN = 232
_structs, _taken = {}, {}


def domain_of_worker(first):
    """A domain for tests that run beside others, of this run or of another one on this machine: `first`, or one further on.

    It is this process' until it ends.
    """
    if first not in _taken:
        for domain in range(first, LAST_DOMAIN, 10):
            try:
                lock = os.open(Path(tempfile.gettempdir()) / f"trackres-test-domain-{domain}", os.O_RDWR | os.O_CREAT)
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:  # another's
                continue
            _taken[first] = (domain, lock)
            break
    return _taken[first][0]


def struct_of(kind):
    """Cyclone's type of a message."""
    if kind not in _structs:
        package, _, name = kind.split("/")
        fields = {f"{field}_": _field(about) for field, about in FIELDS[kind][1]}
        _structs[kind] = make_idl_struct(kind.replace("/", "_"), f"{package}::msg::dds_::{name}_", fields)
    return _structs[kind]


def stranger(kind):
    """A type of the same name with other content."""
    package, _, name = kind.split("/")
    return make_idl_struct("stranger", f"{package}::msg::dds_::{name}_", {"number_": types.uint32})


def _field(about):
    node, inner = int(about[0]), about[1]
    if node == 1:
        return str if inner[0] == "string" else PLAIN.get(inner[0]) or getattr(types, inner[0])
    if node == 2:
        return struct_of(inner)
    return types.array[_field(inner[0]), inner[1]] if node == 3 else types.sequence[_field(inner[0])]


def _qos(reliable, depth, deadline_s, latched=False):
    policies = [
        Policy.Reliability.Reliable(duration(seconds=1)) if reliable else Policy.Reliability.BestEffort,
        Policy.History.KeepLast(depth),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    ]
    policies += [Policy.Deadline(duration(seconds=deadline_s))] if deadline_s else []
    return Qos(*policies, *([Policy.Durability.TransientLocal] if latched else []))


@dataclass
class Gid(IdlStruct, typename="rmw_dds_common::msg::dds_::Gid_"):
    data_: types.array[types.uint8, 16]


@dataclass
class NodeEntities(IdlStruct, typename="rmw_dds_common::msg::dds_::NodeEntitiesInfo_"):
    node_namespace_: types.bounded_str[256]
    node_name_: types.bounded_str[256]
    reader_gid_seq_: types.sequence[Gid]
    writer_gid_seq_: types.sequence[Gid]


@dataclass
class ParticipantEntities(IdlStruct, typename="rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"):
    gid_: Gid
    node_entities_info_seq_: types.sequence[NodeEntities]


def graph_topic(wire):
    """The topic on which nodes announce their endpoints."""
    return Topic(wire.participant, "ros_discovery_info", ParticipantEntities)


@dataclass
class Heard:
    """A message that came, and when [s of a steady clock]."""

    at_s: float
    message: object


class Subscription:
    """Keeps all messages of a topic."""

    def __init__(self, wire, topic, kind, reliable, depth, deadline_s):
        self.kind, self.heard = kind, []
        self._reader = DataReader(
            wire.participant, Topic(wire.participant, f"rt{topic}", struct_of(kind)), qos=_qos(reliable, depth, deadline_s)
        )

    def update(self):
        """Take what has come; all there is so far."""
        found = ddspy_take(self._reader._ref, ANY, 10000)
        now = time.monotonic()
        for raw, about in found if isinstance(found, list) else ():
            if about.valid_data:
                self.heard.append(Heard(now, STORE.deserialize_cdr(raw, self.kind)))
        return self.heard

    @property
    def matched(self):
        """Publishers connected."""
        return len(self._reader.get_matched_publications())


class Publisher:
    """Publishes messages of a topic, or bytes that are none."""

    def __init__(self, wire, topic, kind, reliable, depth, struct, latched, deadline_s):
        self.kind = kind
        self.sent = 0
        topic = Topic(wire.participant, f"rt{topic}", struct or struct_of(kind))
        another_hash = Qos(Policy.Userdata(b"typehash=RIHS01_" + b"63" * 32 + b";")) if struct else Qos()
        self._writer = DataWriter(wire.participant, topic, qos=_qos(reliable, depth, deadline_s, latched) + another_hash)

    def publish(self, **fields):
        """Publish a message with these fields."""
        raw = bytes(STORE.serialize_cdr(build(self.kind, **fields), self.kind))
        self.publish_raw(raw + b"\0" * (-len(raw) % 4))

    def publish_raw(self, raw):
        """Publish bytes as they are."""
        code = ddspy_write(self._writer._ref, raw)
        assert code >= 0, code
        self.sent += 1

    @property
    def matched(self):
        """Subscribers connected."""
        return len(self._writer.get_matched_subscriptions())

    def delivered(self):
        """Wait until all that was sent has come to all who listen reliably."""
        assert self._writer.wait_for_acks(duration(seconds=PATIENCE_S)), "what was sent is not acknowledged"

    def close(self):
        """Leave the topic."""
        self._writer._delete(self._writer._ref)


class Wire:
    """One participant of a domain, on the loopback interface."""

    def __init__(self, domain):
        with pytest.MonkeyPatch.context() as changed:  # a `Domain` sometimes never closes
            changed.setenv("CYCLONEDDS_URI", LOOPBACK)
            self.participant = DomainParticipant(domain)

    def subscribe(self, topic, kind, reliable=True, depth=10000, deadline_s=0.0):
        """A subscription by full topic name."""
        return Subscription(self, topic, kind, reliable, depth, deadline_s)

    def publisher(self, topic, kind, reliable=True, depth=1000, struct=None, latched=False, deadline_s=0.0):
        """A publisher by full topic name; what is latched comes to those too who join later."""
        return Publisher(self, topic, kind, reliable, depth, struct, latched, deadline_s)

    def announce(self, node, *publishers):
        """Announce publishers as those of a node of the root namespace, as ROS 2 does."""
        quality = _qos(reliable=True, depth=1, deadline_s=0.0, latched=True)
        self._graph = DataWriter(self.participant, graph_topic(self), qos=quality)
        keys = [Gid(list(publisher._writer.guid.bytes)) for publisher in publishers]
        self._graph.write(ParticipantEntities(Gid(list(self.participant.guid.bytes)), [NodeEntities("/", node, [], keys)]))

    def close(self):
        """Leave."""
        self.participant._delete(self.participant._ref)
