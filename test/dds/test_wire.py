# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Types, hashes, quality of service and domains on the wire."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from cyclonedds.core import Policy
from cyclonedds.util import duration
from ros_messages import build

from trackres_ros.errors import InputError
from trackres_ros.node.dds.wire import (
    dds_type_name,
    domain_id,
    idl_struct,
    most_index,
    opening,
    qos,
    ros_type_name,
    type_hash,
    typestore,
)
from trackres_ros.node.transport import Quality
from trackres_ros.recording.message_types import message_fields

HASHES = {  # as ROS 2 Jazzy has installed them, share/*/msg/*.json
    "std_msgs/msg/Float64": "705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a",
    "geometry_msgs/msg/TwistStamped": "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
    "geometry_msgs/msg/WrenchStamped": "8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77",
    "sensor_msgs/msg/JointState": "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    "diagnostic_msgs/msg/DiagnosticArray": "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    "rmw_dds_common/msg/ParticipantEntitiesInfo": "91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e",
    "rosgraph_msgs/msg/Clock": "692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564",
    "control_msgs/msg/InterfaceValue": "74a12144ef6b7af67533195cb30f7f607d3301b66950208a72d280695f3e190c",
    "control_msgs/msg/DynamicInterfaceGroupValues": "0ebef56c55cdde46b4622f7e0a4dbf26fefbf0296205463e955047252b434cbc",
}


def listed_types():
    return [name for name in sorted(typestore().types) if name.split("/")[1] == "msg"]


def of_ros(name):
    """The hash of a type in the ROS 2 that is sourced, or None."""
    package, kind, short = name.split("/")
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        path = Path(prefix) / "share" / package / kind / f"{short}.json"
        if prefix and path.exists():
            hashes = json.loads(path.read_text())["type_hashes"]
            return next(found["hash_string"] for found in hashes if found["type_name"] == name)
    return None


@pytest.mark.parametrize("name", HASHES)
def test_hashes_are_those_of_ros(name):
    assert type_hash(name) == f"typehash=RIHS01_{HASHES[name]};".encode()


def test_type_hashes_equal_those_of_the_sourced_ros():
    known = {name: found for name in listed_types() if (found := of_ros(name))}
    if not known:
        pytest.skip("no ROS 2 is sourced")
    assert {name: type_hash(name).decode() for name in known} == {name: f"typehash={found};" for name, found in known.items()}


def test_a_type_name_comes_back_from_the_wire():
    for name in listed_types():
        assert ros_type_name(dds_type_name(name)) == name
    assert dds_type_name("std_msgs/msg/Float64") == "std_msgs::msg::dds_::Float64_"
    assert ros_type_name("HelloWorld") == "HelloWorld"


def filled(name):
    """A message in which no number is zero, no text and no sequence empty."""
    values = {}
    for count, (field, about) in enumerate(message_fields(typestore())[name][1], 1):
        node, inner = int(about[0]), about[1]
        kind, named = (about, node == 2) if node < 3 else (inner[0], int(inner[0][0]) == 2)
        kind = kind[1] if named else kind[1][0]
        one = filled(kind) if named else {"string": "text", "bool": True}.get(kind, count)
        many = [one] * (inner[1] if node == 3 else 2)
        values[field] = one if node < 3 else many if named or kind == "string" else np.array(many, dtype=kind)
    return build(name, **values)


@pytest.mark.parametrize("name", [*HASHES, "sensor_msgs/msg/Temperature", "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"])
def test_the_struct_has_the_bytes_of_the_message(name):
    raw = bytes(typestore().serialize_cdr(filled(name), name))
    struct = idl_struct(name)
    assert struct.deserialize(raw).serialize(use_version_2=False)[4 : len(raw)] == raw[4:]


def test_every_type_has_a_struct():
    for name in listed_types():
        assert idl_struct(name).__idl_typename__ == dds_type_name(name)


def test_quality_of_service():
    given = qos(Quality(reliable=False, depth=7, deadline_s=0.0), b"mine")
    assert given[Policy.Reliability] == Policy.Reliability.BestEffort
    assert given[Policy.History] == Policy.History.KeepLast(7)
    assert given[Policy.Durability] == Policy.Durability.Volatile
    assert given[Policy.Userdata].data == b"mine"
    assert Policy.Deadline not in given
    given = qos(Quality(reliable=True, depth=1, deadline_s=0.25, latched=True), b"")
    assert isinstance(given[Policy.Reliability], Policy.Reliability.Reliable)
    assert given[Policy.Durability] == Policy.Durability.TransientLocal
    assert given[Policy.Deadline] == Policy.Deadline(duration(seconds=0.25))


@pytest.mark.parametrize(("given", "number"), [("", 0), ("0", 0), ("42", 42), ("232", 232)])
def test_domains(monkeypatch, given, number):
    monkeypatch.setenv("ROS_DOMAIN_ID", given)
    assert domain_id() == number


@pytest.mark.parametrize("given", ["233", "-1", "1.0", "mine", "9999999999"])
def test_what_is_no_domain(monkeypatch, given):
    monkeypatch.setenv("ROS_DOMAIN_ID", given)
    with pytest.raises(InputError, match=r"ROS_DOMAIN_ID.*0 to 232"):
        domain_id()


@pytest.mark.parametrize("domain", [0, 101, 229, 232])
def test_every_participant_has_its_ports(domain):
    last_port = 7400 + 250 * domain + 11 + 2 * most_index(domain)
    assert last_port <= 65535
    assert most_index(domain) > 50


@pytest.mark.parametrize(
    ("variables", "said"),
    [
        ({}, "on all networks"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, "on all networks"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, "on this machine only"),
        ({"ROS_LOCALHOST_ONLY": "1"}, "on this machine only"),
        ({"CYCLONEDDS_URI": "<CycloneDDS/>", "ROS_LOCALHOST_ONLY": "1"}, "as set by CYCLONEDDS_URI"),
    ],
)
def test_how_far_it_reaches(monkeypatch, variables, said):
    for name in ("CYCLONEDDS_URI", "ROS_LOCALHOST_ONLY", "ROS_AUTOMATIC_DISCOVERY_RANGE"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    with opening(74) as reach:
        assert reach == said
        assert bool(os.environ.get("CYCLONEDDS_URI")) == (said != "on all networks")
    assert os.environ.get("CYCLONEDDS_URI") == variables.get("CYCLONEDDS_URI")
