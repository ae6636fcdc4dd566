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
from waiting import Pace

SECOND_NS = 1_000_000_000


def recovers(node):
    """After what was wrong has gone the status is good again, and torque flows."""
    before = len(node.torques())
    node.healthy()
    assert len(node.torques()) > before
    assert node.torques()[-1] == pytest.approx(2900.0, rel=0.3)


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
    full = anywhere.torques()[-1]
    anywhere.noticed("SPEED_OLD")
    anywhere.until(lambda: anywhere.torques()[-1] == 0.0, "the feed-forward to fade")
    torques = anywhere.torques()
    fading = torques[-torques[::-1].index(next(t for t in reversed(torques) if t > 0.9 * full)) :]
    assert fading == sorted(fading, reverse=True)
    count = len(torques)
    anywhere.until(lambda: len(anywhere.torques()) > count + 20, "outputs going on")
    assert anywhere.level() == 3
    back = len(anywhere.torques())
    recovers(anywhere)
    rising = anywhere.torques()[back:]
    assert all(abs(b - a) < 0.7 * full for a, b in itertools.pairwise(rising))


def test_load_missing(standing):
    standing.healthy()
    standing.noticed("LOAD_HELD", meanwhile=lambda: standing.drive(0.3, load=None))
    assert standing.level() == 0
    recovers(standing)


def test_values_that_cannot_be(standing):
    standing.healthy()
    values = itertools.cycle([math.nan, math.inf, -math.inf, 1e9, -1e9])
    standing.noticed("SPEED_OLD", meanwhile=lambda: standing.drive(0.2, speed=lambda: next(values)))
    standing.noticed("REFUSED", meanwhile=lambda: standing.drive(0.2, speed=lambda: next(values)))
    counted = standing.values("input speed")
    assert int(counted["non_finite"]) > 0
    assert int(counted["out_of_range"]) > 0
    recovers(standing)


def test_load_that_cannot_be(standing):
    standing.healthy()
    standing.noticed("REFUSED", meanwhile=lambda: standing.drive(0.3, load=1e9))
    recovers(standing)


def test_stamps_that_were_never_set(standing):
    standing.healthy()
    standing.drive(1.5, stamps=lambda: 0)
    standing.until(
        lambda: int(standing.values("input speed").get("zero_stamp", 0)) > 0, "the counter", meanwhile=lambda: standing.drive(0.2)
    )
    assert standing.level() == 0
    recovers(standing)


def test_stamps_repeated(standing):
    standing.healthy()
    fixed = time.time_ns()
    standing.noticed("REFUSED", meanwhile=lambda: standing.drive(0.3, stamps=lambda: fixed))
    standing.until(lambda: int(standing.values("input speed").get("duplicate", 0)) > 0, "the counter")
    recovers(standing)


def test_single_stamps_ahead_and_behind(standing):
    standing.healthy()
    wrong = {"future": 3600.0, "backward": -3600.0, "late": -0.4}
    before = {counter: int(standing.values("input speed").get(counter, 0)) for counter in wrong}
    for _ in range(5):
        for offset_s in wrong.values():
            standing.drive(0.1)
            standing.send("speed", 8.0, time.time_ns() + int(offset_s * SECOND_NS))
    standing.until(
        lambda: all(int(standing.values("input speed").get(c, 0)) >= before[c] + 4 for c in wrong),
        "the counters",
        meanwhile=lambda: standing.drive(0.2),
    )
    recovers(standing)


def test_the_clock_of_the_stamps_jumps_and_stays(standing):
    standing.healthy()
    belt = standing.out["belt"].update()[-1].message.temperature
    ahead = lambda: time.time_ns() + 3600 * SECOND_NS  # noqa: E731
    standing.noticed("CLOCK_JUMPED", meanwhile=lambda: standing.drive(0.3, stamps=ahead))
    standing.noticed("CLOCK_OFFSET", meanwhile=lambda: standing.drive(0.3, stamps=ahead))
    assert standing.out["belt"].update()[-1].message.temperature == pytest.approx(belt, abs=1.0)
    assert standing.out["feedforward"].update()[-1].message.header.stamp.sec > time.time() + 3000
    standing.noticed("CLOCK_JUMPED", meanwhile=lambda: standing.drive(0.3))
    recovers(standing)


def test_a_trickle(standing):
    standing.healthy()
    once_a_second = Pace(1.0)
    for _ in range(3):
        standing.drive(0.05, hz=20.0)
        once_a_second.next()
    assert "SPEED_OLD" in standing.notices()
    recovers(standing)


def test_a_flood(anywhere):
    anywhere.healthy()
    anywhere.until(lambda: "accepted" in anywhere.values("input speed"), "a count", meanwhile=lambda: anywhere.drive(0.3))
    before, sent = int(anywhere.values("input speed")["accepted"]), anywhere.inputs["speed"].sent
    anywhere.drive(3.0, hz=1000.0)
    sent = anywhere.inputs["speed"].sent - sent
    taken = lambda: sum(int(anywhere.values("input speed").get(k, 0)) for k in ("accepted", "duplicate", "late"))  # noqa: E731
    anywhere.until(lambda: taken() - before >= 0.99 * sent, "the flood to be taken")
    recovers(anywhere)


def test_another_type_on_the_topic(standing):
    standing.healthy()
    other = standing.wire.publisher("/ambient", "std_msgs/msg/Float64")
    other.publish(data=1.0)
    standing.noticed("WRONG_TYPE", meanwhile=lambda: standing.drive(0.3))
    assert "std_msgs/msg/Float64" in next(s.message for s in reversed(standing.statuses()) if "sends" in s.message)
    other.close()
    recovers(standing)


def test_two_publishers_and_one_restarted(standing):
    standing.healthy()
    second = standing.wire.publisher("/speed", "geometry_msgs/msg/TwistStamped")
    standing.noticed("SEVERAL_PUBLISHERS", meanwhile=lambda: standing.drive(0.3))
    standing.inputs["speed"].close()
    standing.inputs["speed"] = second
    recovers(standing)


def test_another_definition_of_the_same_type(standing):
    standing.healthy()
    other = standing.wire.publisher(
        "/speed", "geometry_msgs/msg/TwistStamped", struct=peer.stranger("geometry_msgs/msg/TwistStamped")
    )
    for _ in range(20):
        other.publish_raw(b"\0\1\0\0" + b"\xff" * 4)
        standing.drive(0.05)
    other.close()
    recovers(standing)


def test_coarse_steps_and_one_value_for_long(node):
    n = node(stuck_s=2.0, output_rate_hz=0.0)
    steps = itertools.cycle([8, 9, 10, 9])  # km/h, as a bus sends it
    n.noticed("SPEED_QUANTISED", meanwhile=lambda: n.drive(0.5, speed=lambda: next(steps) / 3.6))
    assert n.level() == 0
    n.drive(0.5)
    n.noticed("SPEED_STUCK", meanwhile=lambda: n.drive(0.3, speed=lambda: 8.0))
    recovers(n)


def test_a_noisy_speed_at_rest_is_fed_exactly_nothing(standing):
    standing.healthy()
    noise = random.Random(4)
    rest = lambda: noise.gauss(0.0, 0.02)  # noqa: E731 - speed_std_mps
    standing.until(lambda: standing.torques()[-1] == 0.0, "rest", meanwhile=lambda: standing.drive(0.3, speed=rest))
    first = len(standing.torques())
    standing.drive(3.0, speed=rest)
    standing.drive(0.2, speed=rest)
    assert len(standing.torques()) > first + 50
    assert set(standing.torques()[first:]) == {0.0}
    assert all(heard.message.effort[0] != 0.0 for heard in standing.out["resistance"].update()[-5:])
    recovers(standing)


def test_a_stamp_that_no_message_can_carry_comes_first(node):
    n = node(namespace="/stamps")
    header = {"stamp": {"sec": 2**31 - 1, "nanosec": 10**9}, "frame_id": ""}
    for _ in range(3):
        n.inputs["speed"].publish(header=header, twist={"linear": {"x": 8.0, "y": 0.0, "z": 0.0}})
    n.until(lambda: int(n.values("input speed").get("bad_stamp", 0)) == 3, "the counter")
    count = len(n.statuses())
    n.until(lambda: len(n.statuses()) > count, "statuses going on")
    assert "INTERNAL_ERROR" not in n.notices()
    recovers(n)


def test_outputs_move_at_their_rate_over_a_pause(node):
    n = node(namespace="/pace", feedforward_rate=4000.0, feedforward_fade_s=5.0)
    n.healthy()
    n.until(lambda: n.torques()[-1] > 2000.0, "the whole torque", meanwhile=lambda: n.drive(0.3))
    for pause_s in (0.8, 2.0, 3.5):
        n.silent(pause_s)
        n.drive(0.5)
    torques = n.torques()
    # Sent at 50 Hz by the node's clock; how they are heard is the middleware's, so as many as could be between two are allowed.
    rises = [b - a for a, b in itertools.pairwise(torques)]
    assert max(rises[:20] + rises) <= 4000.0 * 0.2
    assert sum(rise > 0.0 for rise in rises) > 20
    recovers(n)
