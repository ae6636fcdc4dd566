# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The middleware to compare with: a message to another process and back, by Cyclone DDS on the loopback interface.

The message is a std_msgs/Float64 by its DDS type. Both sides wait in a listener, and the echo writes back in it: no queue,
no executor, no node on top, so the round trip is the shortest that a program in Python sees.
Needs the PyPI package `cyclonedds`; `python benchmarks/dds_echo.py DOMAIN` is the other process.
"""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from cyclonedds.core import Listener, Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

DOMAIN = 187  # of the benchmark alone
CONFIGURATION = """<CycloneDDS><Domain>
<General><AllowMulticast>false</AllowMulticast>
<Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
QUALITY = Qos(
    Policy.Reliability.Reliable(duration(seconds=1)),
    Policy.History.KeepLast(10),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)
ANSWER_S = 2.0  # a message not back by then is lost
DISCOVERY_S = 20.0


@dataclass
class Float64(IdlStruct, typename="std_msgs::msg::dds_::Float64_"):
    """The message."""

    data: float64


class _Taken(Listener):
    """Calls a function with each message that arrives."""

    def __init__(self, call: Any) -> None:
        super().__init__()
        self._call = call

    def on_data_available(self, reader: Any) -> None:
        for message in reader.take(10):
            self._call(message)


class End:
    """One side: a writer on one topic and a reader on the other."""

    def __init__(self, domain: int, out: str, back: str, call: Any) -> None:
        self._domain = Domain(domain, CONFIGURATION)
        self._participant = DomainParticipant(domain)
        self.writer = DataWriter(self._participant, Topic(self._participant, out, Float64), qos=QUALITY)
        self._listener = _Taken(call)
        topic = Topic(self._participant, back, Float64)
        self._reader = DataReader(self._participant, topic, qos=QUALITY, listener=self._listener)


class Echo:
    """Starts the other process and sends it messages; ends it when the `with` block ends."""

    def __init__(self, domain: int = DOMAIN) -> None:
        self._back = threading.Event()
        self._end = End(domain, "rt/benchmark/out", "rt/benchmark/back", lambda _: self._back.set())
        self._other = subprocess.Popen([sys.executable, __file__, str(domain)], stdin=subprocess.PIPE)

    def __enter__(self) -> Self:
        until = time.monotonic() + DISCOVERY_S
        while time.monotonic() < until:
            self._back.clear()
            self._end.writer.write(Float64(data=0.0))
            if self._back.wait(0.1):
                time.sleep(0.5)  # answers to earlier ones
                return self
        self._stop()
        raise RuntimeError(f"the other process did not answer within {DISCOVERY_S:g} s")

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._stop()

    def _stop(self) -> None:
        assert self._other.stdin is not None
        self._other.stdin.close()  # it reads until then
        self._other.wait(10.0)

    def round_trip(self, value: float) -> float:
        """Time of one message to the other process and back [s].

        Raises
        ------
        RuntimeError
            If it is lost.
        """
        self._back.clear()
        begin = time.perf_counter()
        self._end.writer.write(Float64(data=value))
        if not self._back.wait(ANSWER_S):
            raise RuntimeError(f"no answer within {ANSWER_S:g} s")
        return time.perf_counter() - begin


def main() -> None:
    """Be the other process: answer until standard input ends."""
    ready = threading.Event()
    sides: list[End] = []

    def answer(message: Float64) -> None:
        ready.wait()
        sides[0].writer.write(message)

    sides.append(End(int(sys.argv[1]), "rt/benchmark/back", "rt/benchmark/out", answer))
    ready.set()
    sys.stdin.read()


if __name__ == "__main__":
    main()
