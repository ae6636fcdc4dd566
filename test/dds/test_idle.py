# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""When the node's loop waits, and for what: the clock moves only in a wait and while a message is processed."""

import time
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ros_messages import STORE
from waiting import wait_for

from trackres_ros.node import inputs
from trackres_ros.node.dds import node as dds_node
from trackres_ros.node.dds.node import DdsNode
from trackres_ros.node.dds.wire import Participant
from trackres_ros.node.inputs import Inbox
from trackres_ros.node.parameters import make_parameters
from trackres_ros.node.transport import Quality

FLOAT = "std_msgs/msg/Float64"
QUALITY = Quality(reliable=True, depth=100, deadline_s=0.0)
MS, NEVER_NS = 1_000_000, 10**12


class Loop:
    """A node with a clock of its own, and messages that are there at each fetch."""

    def __init__(self, rate_hz, fetched=(), work_ns=0):
        self.now_ns, self.turns, self.ticks, self.waits = 0, 0, 0, []
        self._fetched, self._work_ns, self.taken, self.handed = iter(fetched), work_ns, [], []
        given = {"vehicle": "xgd24d", "state_file": "none", "output_rate_hz": rate_hz, "output_deadline_s": 0.0}
        self.node = DdsNode(make_parameters(given), "n", "/")
        self.node._participant.waiter = lambda: self._wait
        self.node.application.tick = self._tick
        self.node._inbox = Inbox([self._take], self._hand, lambda: (0, 0), lambda _: None, 1000)

    def run(self, until):
        requests = SimpleNamespace(start=lambda: None, pending=self._turn, to_stop=False)
        clock = SimpleNamespace(monotonic_ns=lambda: self.now_ns, time_ns=time.time_ns, time=time.time)
        self._ends = lambda: setattr(requests, "to_stop", until(self))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(dds_node, "time", clock)
            patch.setattr(inputs, "time", clock)
            try:
                self.node.spin(requests)
            finally:
                self.node.close()
        return self

    def _turn(self):
        self.turns += 1
        self._ends()
        return ()

    def _wait(self, left_ns):
        self.waits.append((left_ns, len(self.taken) - len(self.handed)))
        self.now_ns += left_ns

    def _tick(self):
        self.ticks += 1

    def _take(self):
        new = [len(self.taken) + i for i in range(next(self._fetched, 0))]
        self.taken += new
        return new

    def _hand(self, _index, message, _arrived):
        self.handed.append(message)
        self.now_ns += self._work_ns


@pytest.mark.parametrize("rate_hz", [0.0, 0.5, 50.0])
def test_an_idle_node_wakes_for_its_ticks_alone(wire, rate_hz):
    loop = Loop(rate_hz).run(lambda loop: loop.ticks == 20)
    assert loop.turns == loop.ticks
    period_ns = int(loop.node.application.period_s * 1e9)
    assert [left for left, _ in loop.waits] == [period_ns] * (loop.ticks - 1)
    assert period_ns <= 100 * MS  # a signal is heeded after that


def test_it_waits_only_with_every_message_handed_on(wire):
    @settings(max_examples=20)
    @given(fetched=st.lists(st.integers(0, 4), max_size=20), work_ns=st.sampled_from([0, MS, 3 * MS, 150 * MS]))
    def law(fetched, work_ns):
        loop = Loop(50.0, fetched, work_ns).run(lambda loop: len(loop.waits) >= len(fetched) + 2)
        assert loop.handed == loop.taken == list(range(sum(fetched)))
        assert all(held == 0 and left > 0 for left, held in loop.waits)

    law()


def test_a_wait_ends_with_a_message_for_any_reader(wire):
    mine, topics = Participant("listener", "/"), ("/early", "/late")
    try:
        readers = [mine.reader(topics[0], FLOAT, QUALITY)]
        wait = mine.waiter()
        readers.append(mine.reader(topics[1], FLOAT, QUALITY))
        publishers = [wire.publisher(topic, FLOAT) for topic in topics]
        assert wait_for(lambda: all(publisher.matched for publisher in publishers))
        for number, (publisher, reader) in enumerate(zip(publishers, readers, strict=True)):
            assert wait(1) == 0  # nothing is there: it is over with its time
            publisher.publish(data=float(number))
            assert [wait(NEVER_NS), wait(NEVER_NS)] == [1, 1]  # until it is taken
            assert [STORE.deserialize_cdr(one.raw, FLOAT).data for one in reader.take()] == [number]
        wire.close()  # a publisher that leaves is no message, but has to be taken too
        for reader in readers:
            assert wait(NEVER_NS)
            while not reader.condition.triggered:
                wait(MS)
            assert reader.take() == []
        assert wait(1) == 0
    finally:
        mine.close()
