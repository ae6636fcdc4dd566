# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Whose messages move the torque: one source of the speed, one publisher of the torque, latched inputs, an odd clock."""

import itertools
import json
import signal
import time

import peer
import pytest
from conftest import DOMAIN, FLOAT, TEMPERATURE, TWIST, WRENCH, Node
from ros_messages import stamped, twist
from waiting import Pace

AHEAD_NS = 100_000_000
COLD_DEGC, HEAVY_N = -20.0, 400e3
LIGHTER_N = 350e3  # as near to it as a load is believed at once while driving


@pytest.fixture
def other():
    """Another participant, as of another machine."""
    made = peer.Wire(DOMAIN)
    yield made
    made.close()


def until_fed(node, speed=8.0):
    """Drive until the torque is fed forward."""
    fed = lambda: (node.torques() or [0.0])[-1] > 1000.0  # noqa: E731
    node.until(fed, "a feed-forward", meanwhile=lambda: node.drive(0.2, speed=speed))


def both(node, second, true_mps, false_mps, seconds=0.2):
    """The true speed at 50 Hz, and another one at 20 Hz whose clock is ahead."""
    pace = Pace(100.0)
    for step in range(int(100 * seconds)):
        if step % 2 == 0:
            node.send("speed", true_mps)
        if step % 5 == 0:
            second.publish(header=stamped(time.time_ns() + AHEAD_NS), twist=twist(false_mps))
        pace.next()


@pytest.mark.parametrize("true_first", [True, False])
def test_of_two_speeds_that_disagree_none_is_fed_and_both_named(node, other, true_first):
    n = node()
    true, false = n.inputs["speed"], other.publisher("/alone/speed", TWIST)
    n.wire.announce("true_driver", true)
    other.announce("simulator", false)
    n.until(lambda: false.matched, "the other one to connect")
    if true_first:
        n.drive(1.0, speed=lambda: 0.0)
    else:
        n.inputs["speed"] = false
        until_fed(n)
        n.inputs["speed"] = true
    n.until(
        lambda: "TWO_SPEEDS" in n.last_remarks() and n.torques()[-1] == 0.0,
        "no feed-forward",
        meanwhile=lambda: both(n, false, 0.0, 8.0),
    )
    first = len(n.torques())
    both(n, false, 0.0, 8.0, seconds=3.0)
    assert set(n.torques()[first:]) == {0.0}
    status = n.status()
    assert int(status.level) == 3
    assert all(word in status.message for word in ("/true_driver", "/simulator", "0.00 m/s", "8.00 m/s", "/alone/speed"))
    if true_first:
        assert set(n.torques()) <= {0.0}
    false.close()
    until_fed(n)
    n.until(lambda: n.level() < 3, "a usable torque", meanwhile=lambda: n.drive(0.2))


def test_a_second_speed_that_agrees_silences_nobody(node, other):
    n = node()
    until_fed(n)
    second = other.publisher("/alone/speed", TWIST)
    n.until(lambda: second.matched, "the other one to connect")
    n.noticed("SEVERAL_PUBLISHERS", meanwhile=lambda: both(n, second, 8.0, 8.0))
    first = len(n.torques())
    both(n, second, 8.0, 8.0, seconds=3.0)
    assert min(n.torques()[first:]) > 1000.0
    assert "TWO_SPEEDS" not in n.notices()
    if n.transport == "dds":  # which tells them apart
        assert "late" not in n.values("input speed")
        assert int(n.values("input speed")["unused"]) > 20


def weight(node):
    """Weight of the last step [N], by the diagnostics."""
    return float(node.values("estimate").get("weight_n", "nan"))


def ambient(node):
    return float(node.values("estimate").get("ambient_degc", "nan"))


def latched(wire):
    """A load and an ambient temperature, each published once."""
    made = wire.publisher("/alone/load", FLOAT, latched=True), wire.publisher("/alone/ambient", TEMPERATURE, latched=True)
    made[0].publish(data=HEAVY_N)
    made[1].publish(header=stamped(time.time_ns()), temperature=COLD_DEGC)
    return made


def driving(node):
    return lambda: node.drive(0.2, load=None, ambient=None)


@pytest.mark.parametrize("first", ["publisher", "node"])
def test_a_latched_input_arrives_and_stands_while_its_source_is(node, other, first):
    if first == "publisher":
        sources = latched(other)
        n = node(load_hold_s=4.0)
    else:
        n = node(load_hold_s=4.0)
        n.drive(0.5, load=None, ambient=None)
        sources = latched(other)
    arrived = lambda: weight(n) == pytest.approx(HEAVY_N) and ambient(n) == COLD_DEGC  # noqa: E731
    n.until(arrived, "what was latched", meanwhile=driving(n))
    n.until(lambda: "LOAD_NOMINAL" not in n.last_remarks(), "the next status", meanwhile=driving(n))
    since = len(n.statuses())
    n.drive(7.0, load=None, ambient=None)
    assert not {"LOAD_NOMINAL", "AMBIENT_NOMINAL", "REFUSED", "NOT_LATCHED"} & n.notices(since)
    assert weight(n) == pytest.approx(HEAVY_N)
    n.send("load", LIGHTER_N)  # of the other publisher, volatile
    n.until(lambda: weight(n) == pytest.approx(LIGHTER_N), "the volatile load", meanwhile=driving(n))
    sources[0].publish(data=HEAVY_N)
    n.until(lambda: weight(n) == pytest.approx(HEAVY_N), "the latched load", meanwhile=driving(n))
    sources[0].close()
    n.noticed("LOAD_NOMINAL", meanwhile=driving(n))


def test_a_publisher_that_keeps_nothing_is_named_where_data_lack(node):
    n = node()
    n.wire.announce("scales", n.inputs["load"])
    n.noticed("NOT_LATCHED", meanwhile=driving(n))
    said = next(s.message for s in reversed(n.statuses()) if "keeps nothing" in s.message)
    assert "load: nothing came from /scales on /alone/load" in said
    n.until(lambda: "NOT_LATCHED" not in n.last_remarks(), "the remark to go", meanwhile=lambda: n.drive(0.2))


def test_a_second_estimator_of_a_name_waits_for_the_first(node, transport, tmp_path, wire):
    first = node()
    until_fed(first)
    (tmp_path / "second").mkdir()
    second = Node(transport, tmp_path / "second", wire, namespace="/alone")
    try:
        waits = lambda: "another publisher of the feed-forward: /alone/trackres" in second.log  # noqa: E731
        second.until(waits, "it to wait", meanwhile=lambda: first.drive(0.2), working=True)
        since, statuses = len(first.torques()), len(first.statuses())
        first.drive(3.0)
        assert first.out["feedforward"].matched == 1
        assert min(first.torques()[since:]) > 1000.0
        assert "TORQUE_CONTESTED" not in first.notices(statuses)
        first.stop(signal.SIGKILL)
        since, begun = len(second.torques()), time.monotonic()
        takes_over = lambda: max(second.torques()[since:], default=0.0) > 1000.0  # noqa: E731
        second.until(takes_over, "it to begin", meanwhile=lambda: second.drive(0.2))
        assert time.monotonic() - begun > 2.0, "the lease of the killed one"
        second.check_outputs()
    finally:
        second.close()


def test_another_publisher_of_the_torque_takes_it_to_zero(node, other):
    n = node()
    until_fed(n)
    rival = other.publisher(f"{n.base}/feedforward_torque", WRENCH)
    other.announce("simulator", rival)
    at_zero = lambda: n.torques()[-1] == 0.0 and "TORQUE_CONTESTED" in n.last_remarks()  # noqa: E731
    n.until(at_zero, "no feed-forward", meanwhile=lambda: n.drive(0.2))
    first = len(n.torques())
    n.drive(1.0)
    assert set(n.torques()[first:]) == {0.0}
    assert n.level() == 3
    assert f"/simulator on {n.base}/feedforward_torque" in n.status().message
    rival.close()
    until_fed(n)


class OddClock:
    """A simulated clock at 50 Hz with a speed, which may leap."""

    def __init__(self, node):
        self.node, self.now_ns = node, 1_700_000_000 * 10**9
        self.clock = node.wire.publisher("/clock", "rosgraph_msgs/msg/Clock")
        node.until(lambda: self.clock.matched, "the clock to connect")
        node.sees_its_publishers(self.tick)

    def tick(self):
        seconds, nanoseconds = divmod(self.now_ns, 10**9)
        self.clock.publish(clock={"sec": seconds, "nanosec": nanoseconds})

    def drive(self, seconds):
        pace = Pace(50.0)
        for step in range(int(50 * seconds)):
            self.now_ns += 20_000_000
            self.tick()
            if step % 5 == 0:
                self.node.send("load", 272e3)
            self.node.send("speed", 8.0 + 0.01 * (step % 7), self.now_ns)
            pace.next()


def test_a_leap_of_the_simulated_clock_moves_no_torque_faster(node):
    rate_nm_per_s, late_s = 500.0, 1.0  # the machine may be busy
    n = node(use_sim_time=True, feedforward_rate=rate_nm_per_s)
    clock = OddClock(n)
    n.until(lambda: (n.torques() or [0.0])[-1] > 2000.0, "a feed-forward", meanwhile=lambda: clock.drive(0.2))
    first = len(n.torques()) - 1
    clock.now_ns += 3600 * 10**9
    clock.drive(3.0)
    moves = [abs(b - a) for a, b in itertools.pairwise(n.torques()[first:])]
    assert max(moves) < rate_nm_per_s * late_s


def test_a_clock_before_zero_is_none_and_feeds_nothing(node):
    n = node(use_sim_time=True)
    clock = OddClock(n)
    n.until(lambda: (n.torques() or [0.0])[-1] > 1000.0, "a feed-forward", meanwhile=lambda: clock.drive(0.2))
    good_ns, clock.now_ns = clock.now_ns, -100 * 10**9
    gone = lambda: n.torques()[-1] == 0.0 and "NO_CLOCK" in n.last_remarks()  # noqa: E731
    n.until(gone, "no feed-forward", meanwhile=lambda: clock.drive(0.2))
    assert "a time before 0 is none" in n.status().message
    first = len(n.torques())
    clock.drive(2.0)
    assert set(n.torques()[first:]) <= {0.0}
    assert n.level() == 3
    clock.now_ns = good_ns
    back = lambda: n.torques()[-1] > 1000.0 and n.level() < 3  # noqa: E731
    n.until(back, "the torque", meanwhile=lambda: clock.drive(0.2))


def test_of_two_nodes_with_one_state_file_one_writes_it(node, transport, tmp_path, wire):
    state = tmp_path / "state.json"
    first = node(state_file=str(state), save_period_s=1.0)
    first.until(state.exists, "the state", meanwhile=lambda: first.drive(0.2))
    (tmp_path / "second").mkdir()
    second = Node(transport, tmp_path / "second", wire, namespace="/beside", state_file=str(state), save_period_s=1.0).started()
    try:
        second.noticed("STATE_SHARED", meanwhile=lambda: (first.drive(0.2), second.drive(0.2)))
        assert f"process {first.process.pid} on " in second.status().message
        assert "STATE_SHARED" not in first.notices()
        assert "STATE_NOT_SAVED" not in first.notices()
        first.stop(signal.SIGKILL)
        second.until(lambda: "STATE_SHARED" not in second.last_remarks(), "its turn", meanwhile=lambda: second.drive(0.2))
        assert json.loads(state.read_text())["vehicle"] == "xgd24d"
    finally:
        second.close()
