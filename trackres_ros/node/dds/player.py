# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Plays a bag onto the wire without ROS: its messages at their log times, with a clock: its own, or one of these times."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, cast

from trackres_ros.errors import InputError
from trackres_ros.node.dds.wire import ALIGNMENT, Participant, Writer, typestore
from trackres_ros.node.transport import Quality
from trackres_ros.recording.bag_files import READABLE, is_ros1, messages, open_bag, remedy
from trackres_ros.recording.reading import read_in_steps
from trackres_ros.units import SECOND_NS

CLOCK_PERIOD_S = 0.01  # of this machine, not of the bag
QUALITY = Quality(reliable=True, depth=100, deadline_s=0.0)
CLOCK_QUALITY = Quality(reliable=True, depth=10, deadline_s=0.0)
WAIT_S = 0.05


class Player:
    """Publishes the messages of a bag of ROS 2 on their topics, at a speed relative to the recording, and a clock if it has none.

    Raises InputError if it cannot be read, or contains no message of a known type.
    """

    def __init__(self, path: Path, rate: float) -> None:
        self.rate = rate
        self._path = path
        if is_ros1(path):
            raise InputError(str(path), "a bag of ROS 1", "a bag of ROS 2", "convert it with: rosbags-convert")
        with closing(cast("Any", open_bag(path))) as reader:  # of rosbags, which this module requires
            kinds = {
                connection.topic: connection.msgtype
                for connection in reader.connections
                if connection.msgtype in typestore().types
            }
            self.left_out = sorted(
                {
                    f"{connection.topic} ({connection.msgtype})"
                    for connection in reader.connections
                    if connection.topic not in kinds
                }
            )
            has_clock = any(connection.topic == "/clock" and connection.msgcount for connection in reader.connections)
            self.duration_s = reader.duration * 1e-9
        if not kinds:
            raise InputError(str(path), f"topics {', '.join(self.left_out)}", "a topic of a common message type")
        self._participant = Participant("trackres_player", "/")
        self._writers = {topic: self._participant.writer(topic, kind, QUALITY) for topic, kind in kinds.items()}
        self._clock = None  # a second clock beside that of the bag would set the time back and forth
        if not has_clock:
            self._clock = self._participant.writer("/clock", "rosgraph_msgs/msg/Clock", CLOCK_QUALITY)
        self._participant.announce()

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics that are played."""
        return tuple(self._writers)

    def wait_for_listeners(self, topics: Sequence[str], seconds: float) -> bool:
        """Wait until somebody listens on each of these topics; false if the time is over first."""
        end = time.monotonic() + seconds
        while not all(self._writers[topic].readers for topic in topics):
            if time.monotonic() > end:
                return False
            time.sleep(WAIT_S)
        return True

    def play(self, progress: Callable[[float], None], going_on: Callable[[], bool]) -> int:
        """Publish everything in its time; how many messages. `progress` takes seconds of the bag that have passed."""
        begin, start_ns, count, shown_s, next_clock = time.monotonic(), -1, 0, 0.0, 0.0
        for writer, at_ns, raw in self._messages():
            start_ns = at_ns if start_ns < 0 else start_ns
            due_s = (at_ns - start_ns) * 1e-9 / self.rate
            while True:
                now_s = time.monotonic() - begin
                if not going_on():
                    return count
                if self._clock and now_s >= next_clock:
                    now_ns = start_ns + int(min(now_s, due_s) * self.rate * SECOND_NS)
                    self._clock.write(struct.pack("<4siI", b"\0\1\0\0", *divmod(now_ns, SECOND_NS)))
                    next_clock = now_s + CLOCK_PERIOD_S
                if now_s >= due_s:
                    break
                time.sleep(min(due_s - now_s, CLOCK_PERIOD_S))
            writer.write(raw + b"\0" * (-len(raw) % ALIGNMENT))
            count += 1
            if due_s - shown_s > WAIT_S:
                progress((due_s - shown_s) * self.rate)
                shown_s = due_s
        return count

    def close(self) -> None:
        """Leave."""
        self._participant.close()

    def _messages(self) -> Iterator[tuple[Writer, int, bytes]]:
        with closing(open_bag(self._path)) as reader:
            connections: list[Any] = [item for item in reader.connections if item.topic in self._writers]
            stream = read_in_steps(self._path, READABLE, messages(reader, connections), remedy(self._path))
            for connection, at_ns, raw in stream:
                yield self._writers[connection.topic], at_ns, bytes(raw)
