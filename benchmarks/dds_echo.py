# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The bare echo of the live node: a process that answers each speed with a torque of the same stamp, by Cyclone DDS.

`dds_echo.py` answers in the middleware's own listener with prepared bytes: no queue and nothing on top of it.
`dds_echo.py RATE_HZ` answers the newest speed at a rate, as the node does by default.
"""

from __future__ import annotations

import sys
import time
from typing import Any

from cyclonedds._clayer import ddspy_take
from cyclonedds.core import Listener
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from trackres_ros.node.dds.wire import EVERY_SAMPLE, Participant, idl_struct, qos, serialized, typestore
from trackres_ros.node.transport import Quality

SPEED, TORQUE = "/vehicle/speed", "/trackres/feedforward_torque"
TWIST, WRENCH = "geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/WrenchStamped"
STAMP = slice(4, 12)  # in the bytes of either message


def prepared() -> bytearray:
    """The bytes of a torque."""
    types = typestore().types
    header = types["std_msgs/msg/Header"](stamp=types["builtin_interfaces/msg/Time"](sec=0, nanosec=0), frame_id="")
    zero = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    wrench = types["geometry_msgs/msg/Wrench"](force=zero, torque=zero)
    return bytearray(serialized(types[WRENCH](header=header, wrench=wrench), WRENCH))


class Answering(Listener):
    """Answers each speed, or without `at_once` keeps its stamp for `answer`."""

    def __init__(self, writer: Any, at_once: bool) -> None:
        super().__init__()
        self._writer, self._at_once, self._raw, self._any = writer, at_once, prepared(), False

    def on_data_available(self, reader: Any) -> None:
        """Called by the middleware."""
        for message, _ in ddspy_take(reader._ref, EVERY_SAMPLE, 100):
            self._raw[STAMP] = message[STAMP]
            self._any = True
            if self._at_once:
                self._writer.write(bytes(self._raw))

    def answer(self) -> None:
        """Answer the newest speed, if there was one."""
        if self._any:
            self._writer.write(bytes(self._raw))


def main() -> None:
    """Answer until interrupted."""
    rate_hz = float(sys.argv[1]) if len(sys.argv) > 1 else 0.0
    participant = Participant("echo", "/")
    listener = Answering(participant.writer(TORQUE, WRENCH, Quality(True, 10, 0.0)), rate_hz == 0.0)
    topic = Topic(participant.entity, f"rt{SPEED}", idl_struct(TWIST))
    reader = DataReader(participant.subscriber, topic, qos=qos(Quality(False, 100, 0.0), b""), listener=listener)
    due = time.monotonic()
    while reader:
        if rate_hz == 0.0:
            time.sleep(60.0)
            continue
        due = max(due + 1.0 / rate_hz, time.monotonic())
        time.sleep(max(0.0, due - time.monotonic()))
        listener.answer()


if __name__ == "__main__":
    main()
