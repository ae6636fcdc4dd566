# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""ROS 2 topics on the DDS wire: names, types, type hashes and quality of service as the middlewares of ROS 2 have them.

Names and types after the ROS 2 design "Topic and Service name mapping to DDS"; the type hash after REP-2016. Only numbers and
bytes pass through here: messages are serialised and deserialised elsewhere.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any

from cyclonedds.core import Policy, Qos
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl import types as idl
from cyclonedds.util import duration
from rosbags.typesys import Stores, get_typestore

from trackres_ros.errors import InputError
from trackres_ros.node.endpoints import Quality
from trackres_ros.recording.message_types import add_control_msgs, message_fields

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


@cache
def typestore() -> Typestore:
    """All common message types of ROS 2 Jazzy, and the ros2_control types that the node publishes.

    rosidl hashes a `char` of a .msg file as uint8, rosbags as char. So it becomes uint8 here, which is the same on the wire.
    """
    store = add_control_msgs(get_typestore(Stores.ROS2_JAZZY))
    fields: Any = message_fields(store)
    for name, (constants, described) in list(fields.items()):
        fields[name] = (constants, [(field, _without_char(kind)) for field, kind in described])
    return store


def _without_char(kind: Any) -> Any:
    if kind[1] == ("char", 0):
        return (kind[0], ("uint8", 0))
    return (kind[0], (_without_char(kind[1][0]), kind[1][1])) if int(kind[0]) > 2 else kind


def known_type(name: str, where: str) -> str:
    """The message type, if known. Raises InputError if unknown."""
    if name not in typestore().types:
        raise InputError(
            f"{where}: type",
            name,
            "a type of common_interfaces, the only ones known without ROS",
            "run the node on ROS 2, which accepts every installed type",
        )
    return name


def dds_type_name(name: str) -> str:
    """Name of a message type on the wire: std_msgs/msg/Float64 is std_msgs::msg::dds_::Float64_."""
    package, kind, short = name.split("/")
    return f"{package}::{kind}::dds_::{short}_"


def ros_type_name(name: str) -> str:
    """The reverse of `dds_type_name`; returns other names unchanged."""
    package, _, rest = name.partition("::msg::dds_::")
    return f"{package}/msg/{rest.removesuffix('_')}" if rest else name


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
    of: Any = idl  # generic at run time only
    node, inner = int(kind[0]), kind[1]
    if node == 1:  # a number or a string
        name, bound = inner
        if name == "string":
            return of.bounded_str[bound] if bound else str
        return OTHERWISE.get(name) or getattr(idl, name)
    if node == 2:  # another message
        return idl_struct(inner)
    element, bound = inner
    if node == 3:
        return of.array[_idl_field(element), bound]
    return of.sequence[_idl_field(element), bound] if bound else of.sequence[_idl_field(element)]


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
    given = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not given.isdecimal() or int(given) > MOST_DOMAIN:
        raise InputError("environment ROS_DOMAIN_ID", given, f"a whole number from 0 to {MOST_DOMAIN}")
    return int(given)


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
