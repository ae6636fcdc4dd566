# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the controller sees when something is wrong: on both transports, a node process and an independent participant.

Each scenario has its entry in docs/robustness.md. In all of them no output is ever out of bounds or not a number (the fixture
checks all there were), outputs or statuses go on, the status gives the reason, and it is good again when the cause is gone.
"""

import itertools
import math
import random
import time

import peer
import pytest
from conftest import DEFAULT_TOPICS
from waiting import Pace

SECOND_NS = 1_000_000_000
TOPICS = DEFAULT_TOPICS + "enable: {topic: mode, type: std_msgs/msg/UInt8, field: data, values: [1, 4]}\n"


def recovers(node):
    """After what was wrong has gone the status is good again, and torque flows."""
    before = len(node.torques())
    node.healthy()
    flows = lambda: len(node.torques()) > before and node.torques()[-1] == pytest.approx(2900.0, rel=0.3)  # noqa: E731
    node.until(flows, "the torque", meanwhile=lambda: node.drive(0.3))


def test_from_the_start_without_a_speed(standing):
    if standing.torques():
        pytest.skip("the node has had a speed")
    standing.noticed("NO_SPEED")
    assert standing.level() == 3
    count = len(standing.statuses())
    standing.until(lambda: len(standing.statuses()) >= count + 2, "statuses going on")
    assert not standing.torques()
    recovers(standing)


def test_speed_stops_and_comes_back(anywhere):
    anywhere.healthy()
    full, since = anywhere.torques()[-1], len(anywhere.torques()) - 1
    anywhere.noticed("SPEED_OLD")
    anywhere.until(lambda: anywhere.torques()[-1] == 0.0, "the feed-forward to fade")
    torques = anywhere.torques()
    fading = torques[torques.index(max(torques[since:]), since) :]
    assert fading == sorted(fading, reverse=True)
    count = len(torques)
    anywhere.until(lambda: len(anywhere.torques()) > count + 20, "outputs going on")
    assert anywhere.level() == 3
    back = len(anywhere.torques())
    recovers(anywhere)
    rising = anywhere.torques()[back:]
    assert all(abs(b - a) < 0.7 * full for a, b in itertools.pairwise(rising))


def test_a_flood(anywhere):
    anywhere.healthy()
    anywhere.until(lambda: "accepted" in anywhere.values("input speed"), "a count", meanwhile=lambda: anywhere.drive(0.3))
    counters = ("accepted", "duplicate", "late", "dropped")  # dropped: where others keep the node from its processor
    total = lambda: sum(counted(anywhere, key) for key in counters)  # noqa: E731
    before, sent = total(), anywhere.inputs["speed"].sent
    anywhere.drive(1.5, hz=1000.0)
    sent = anywhere.inputs["speed"].sent - sent
    anywhere.until(lambda: total() - before >= 0.99 * sent, "each message of the flood in a counter")
    recovers(anywhere)


@pytest.fixture
def well(standing):
    """The standing node in good health, which it is in again after whatever a test does."""
    yield standing.healthy()
    recovers(standing)


def counted(node, name, role="speed"):
    """How often an input was counted under a name."""
    return int(node.values(f"input {role}").get(name, 0))


def test_load_missing(well):
    well.noticed("LOAD_HELD", meanwhile=lambda: well.drive(0.3, load=None))
    assert well.level() == 0


def test_values_that_cannot_be(well):
    well.noticed("REFUSED", meanwhile=lambda: well.drive(0.3, load=1e9))
    values = itertools.cycle([math.nan, math.inf, -math.inf, 1e9, -1e9])
    well.noticed("SPEED_OLD", meanwhile=lambda: well.drive(0.2, speed=lambda: next(values)))
    well.noticed("REFUSED", meanwhile=lambda: well.drive(0.2, speed=lambda: next(values)))
    assert counted(well, "non_finite") > 0
    assert counted(well, "out_of_range") > 0


def test_stamps_that_were_never_set(well):
    well.drive(1.0, stamps=lambda: 0)
    well.until(lambda: counted(well, "zero_stamp") > 0, "the counter", meanwhile=lambda: well.drive(0.2))
    assert well.level() == 0


def test_stamps_repeated(well):
    fixed = time.time_ns()
    well.noticed("REFUSED", meanwhile=lambda: well.drive(0.3, stamps=lambda: fixed))
    well.until(lambda: counted(well, "duplicate") > 0, "the counter")


def test_single_stamps_ahead_behind_and_beyond_all_messages(well):
    wrong = {"future": 3600.0, "backward": -3600.0, "late": -0.4}
    before = {counter: counted(well, counter) for counter in wrong}
    beyond = {"stamp": {"sec": 2**31 - 1, "nanosec": 10**9}, "frame_id": ""}
    for _ in range(5):
        for offset_s in wrong.values():
            well.drive(0.1)
            well.send("speed", 8.0, time.time_ns() + int(offset_s * SECOND_NS))
        well.inputs["speed"].publish(header=beyond, twist={"linear": {"x": 8.0, "y": 0.0, "z": 0.0}})
    well.until(
        lambda: all(counted(well, c) >= before[c] + 4 for c in wrong) and counted(well, "bad_stamp") == 5,
        "the counters",
        meanwhile=lambda: well.drive(0.2),
    )
    assert "INTERNAL_ERROR" not in well.notices()


def test_the_clock_of_the_stamps_jumps_and_stays(well):
    belt = well.out["belt"].update()[-1].message.temperature
    ahead = lambda: time.time_ns() + 3600 * SECOND_NS  # noqa: E731
    well.noticed("CLOCK_JUMPED", meanwhile=lambda: well.drive(0.3, stamps=ahead))
    well.noticed("CLOCK_OFFSET", meanwhile=lambda: well.drive(0.3, stamps=ahead))
    assert well.out["belt"].update()[-1].message.temperature == pytest.approx(belt, abs=1.0)
    assert well.out["feedforward"].update()[-1].message.header.stamp.sec > time.time() + 3000
    well.noticed("CLOCK_JUMPED", meanwhile=lambda: well.drive(0.3))


def test_a_trickle(well):
    once_a_second = Pace(1.0)
    for _ in range(3):
        well.drive(0.05, hz=20.0)
        once_a_second.next()
    assert "SPEED_OLD" in well.notices()


def test_another_type_on_the_topic(well):
    other = well.wire.publisher("/ambient", "std_msgs/msg/Float64")
    other.publish(data=1.0)
    well.noticed("WRONG_TYPE", meanwhile=lambda: well.drive(0.3))
    assert "std_msgs/msg/Float64" in next(s.message for s in reversed(well.statuses()) if "sends" in s.message)
    other.close()


def test_two_publishers_and_one_restarted(well):
    second = well.wire.publisher("/speed", "geometry_msgs/msg/TwistStamped")
    well.noticed("SEVERAL_PUBLISHERS", meanwhile=lambda: well.drive(0.3))
    well.inputs["speed"].close()
    well.inputs["speed"] = second


def test_another_definition_of_the_same_type(well):
    kind = "geometry_msgs/msg/TwistStamped"
    stranger = well.wire.publisher("/speed", kind, struct=peer.stranger(kind))  # a transport may not connect it
    for _ in range(20):
        stranger.publish_raw(b"\0\1\0\0" + b"\xff" * 4)
        well.drive(0.05)
    announced = well.wire.publisher("/speed", kind, struct=peer.struct_of(kind))
    well.noticed("WRONG_TYPE", meanwhile=lambda: well.drive(0.3))
    well.until(lambda: well.torques()[-1] == 0.0, "no feed-forward", meanwhile=lambda: well.drive(0.3))
    stranger.close()
    announced.close()


def test_a_noisy_speed_at_rest_is_fed_exactly_nothing(well):
    noise = random.Random(4)
    rest = lambda: noise.gauss(0.0, 0.02)  # noqa: E731 - speed_std_mps
    well.until(lambda: well.torques()[-1] == 0.0, "rest", meanwhile=lambda: well.drive(0.3, speed=rest))
    first = len(well.torques())
    well.until(lambda: len(well.torques()) > first + 50, "outputs at rest", meanwhile=lambda: well.drive(0.3, speed=rest))
    assert set(well.torques()[first:]) == {0.0}
    assert all(heard.message.effort[0] != 0.0 for heard in well.out["resistance"].update()[-5:])


def test_speeds_that_no_vehicle_has_are_not_fed_forward(well):
    at_rest = lambda: well.drive(0.3, speed=lambda: 0.0)  # noqa: E731
    stands = lambda: well.out["resistance"].update()[-1].message.effort[0] == 0.0  # noqa: E731 - to the node too
    well.until(lambda: stands() and well.torques()[-1] == 0.0, "rest", meanwhile=at_rest)
    first = len(well.torques())
    well.drive(0.9, speed=lambda: 16.6)
    well.noticed("SPEED_IMPLAUSIBLE", meanwhile=lambda: well.drive(0.1, speed=lambda: 0.0))
    assert set(well.torques()[first:]) == {0.0}
    assert counted(well, "implausible") > 20
    well.healthy()
    turns = itertools.cycle([5.0, 16.5])
    alternate = lambda: well.drive(0.3, speed=lambda: next(turns))  # noqa: E731
    well.until(lambda: well.torques()[-1] == 0.0, "no feed-forward", meanwhile=alternate)
    assert {"SPEED_IMPLAUSIBLE", "SPEED_OLD"} <= well.last_remarks()


def test_a_mode_enables_the_feedforward(node):
    n = node(topics=TOPICS)
    mode = n.wire.publisher("/alone/mode", "std_msgs/msg/UInt8")
    for value, least, notice in ((None, 0.0, "ENABLE_OLD"), (4, 2000.0, ""), (2, 0.0, "DISABLED"), (1, 2000.0, "")):

        def drive(value=value):
            if value is not None:
                mode.publish(data=value)
            n.drive(0.2)

        def settled(least=least, notice=notice):
            last = (n.torques() or [math.nan])[-1]
            return (last == 0.0 if least == 0.0 else last > least) and {notice} <= {"", *n.last_remarks()}

        n.until(settled, f"mode {value}", meanwhile=drive)
