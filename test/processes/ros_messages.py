# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Messages for tests, and bags of them, made with the libraries of their formats: nothing of the package under test."""

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
for name, text in (  # as control_msgs of Jazzy has them
    ("InterfaceValue", "string[] interface_names\nfloat64[] values\n"),
    ("DynamicInterfaceGroupValues", "std_msgs/Header header\nstring[] interface_groups\nInterfaceValue[] interface_values\n"),
):
    STORE.register(get_types_from_msg(text, f"control_msgs/msg/{name}"))


def fields_of(store):
    """Fields of all message types, under the name of this version of rosbags."""
    return getattr(store, "fielddefs", None) or store.FIELDDEFS


FIELDS = fields_of(STORE)


def build(kind, store=STORE, **given):
    """A message with zeros, empty texts and arrays but for what is given, nested messages as dicts."""
    values = {}
    for name, about in fields_of(store)[kind][1]:
        node, inner = int(about[0]), about[1]
        value = given.get(name)
        if node == 2 and (value is None or isinstance(value, dict)):
            values[name] = build(inner, store, **(value or {}))
        elif value is not None:
            values[name] = value
        elif node == 1:
            values[name] = {"string": "", "bool": False}.get(inner[0], 0)
        else:
            element, count = inner[0], inner[1] if node == 3 else 0
            values[name] = np.zeros(count, element[1][0]) if int(element[0]) == 1 and element[1][0] != "string" else []
    return store.types[kind](**values)


def stamped(ns, frame="base_link"):
    """Header with a stamp [ns]."""
    return {"stamp": {"sec": int(ns // 10**9), "nanosec": int(ns % 10**9)}, "frame_id": frame}


def twist(speed):
    """A twist forward."""
    return {"linear": {"x": speed}}


def fill(writer, rows, store=STORE):
    """Write topic, type, log time and bytes of each message with a writer of rosbags; without bytes the topic alone."""
    with writer:
        topics = {}
        for topic, kind, log_ns, raw in rows:
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=store)
            if raw:
                writer.write(topics[topic], log_ns, raw)


def write_speeds(path, kind, rows, text="", compression="NONE", **options):
    """Write log times and bytes of messages on /speed with the reference implementation of MCAP; `text` defines their type."""
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType[compression], **options)
        writer.start("ros2", "somebody")
        schema = writer.register_schema(kind, "ros2msg", (text or STORE.generate_msgdef(kind, ros_version=2)[0]).encode())
        channel = writer.register_channel("/speed", "cdr", schema)
        for log_ns, raw in rows:
            writer.add_message(channel, log_ns, raw, log_ns)
        writer.finish()
    return path
