# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes the bags that the benchmarks read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from measuring import START_NS
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from trackres_ros.recording.cdr import Template
from trackres_ros.recording.message_types import definitions

LOAD_EVERY = 10
TOPICS = """\
speed: {topic: /vehicle/speed, type: geometry_msgs/msg/TwistStamped, field: twist.linear.x}
load: {topic: /vehicle/load, type: geometry_msgs/msg/WrenchStamped, field: wrench.force.z}
"""
STORE = get_typestore(Stores.LATEST)


def write_bag(path: Path, storage: StoragePlugin, messages: int, rate_hz: float) -> None:
    """Write speed at a rate and load at a tenth of it, with the library's own writer."""
    types = STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "base_link")
    vector = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    stamp_ns = START_NS + round(1e9 / rate_hz) * np.arange(messages)
    speed = 10.0 + np.sin(np.arange(messages) / 500.0) + np.random.default_rng(1).normal(0.0, 0.01, messages)
    rows = {}
    for name, inner, field, value in (
        ("TwistStamped", "Twist", "twist.linear.x", speed),
        ("WrenchStamped", "Wrench", "wrench.force.z", 272e3 + 100.0 * speed),
    ):
        msgtype = f"geometry_msgs/msg/{name}"
        message = types[msgtype](header, types[f"geometry_msgs/msg/{inner}"](vector, vector))
        raw = bytes(STORE.serialize_cdr(message, msgtype))
        rows[name] = np.empty((messages, len(raw)), np.uint8)
        template = Template(raw, definitions(STORE.fielddefs, msgtype), msgtype, [field])
        template.fill(rows[name], 0, stamp_ns, value[:, None])
    with Writer(path, version=9, storage_plugin=storage) as writer:
        twist = writer.add_connection("/vehicle/speed", "geometry_msgs/msg/TwistStamped", typestore=STORE)
        wrench = writer.add_connection("/vehicle/load", "geometry_msgs/msg/WrenchStamped", typestore=STORE)
        for row, log_ns in enumerate((stamp_ns + 2_000_000).tolist()):
            writer.write(twist, log_ns, rows["TwistStamped"][row].tobytes())
            if row % LOAD_EVERY == 0:
                writer.write(wrench, log_ns, rows["WrenchStamped"][row].tobytes())
