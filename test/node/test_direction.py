# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Live, a direction gives a speed its sign and a validity drops it; a slow speed and a doubted load are said in words."""

from types import SimpleNamespace

import pytest

SPEED = "speed: {topic: speed, type: geometry_msgs/msg/TwistStamped, field: twist.linear.x%s}\n"
GEAR = "direction: {topic: gear, type: std_msgs/msg/UInt8, field: data, values: {forward: [1, 2], reverse: 9, neutral: 0}}\n"
VALID = ", valid: {topic: good, type: std_msgs/msg/Bool, field: data}"
LOAD = "load: {topic: load, type: std_msgs/msg/Float64, field: data}\n"


def fed(made):
    return made.last("feedforward_torque_nm")[1][0]


def drive(made, seconds, gear=None, good=None, speed=8.0):
    for i in range(round(seconds / 0.02)):
        made.forward(0.02)
        for index, given_values in enumerate(made.app.inputs):
            value = {"gear": gear, "good": good}.get(given_values.name)
            if value is not None and i % 5 == 0:
                made.app.messages.receive(index, SimpleNamespace(data=value))
        made.send("speed", speed)


def refused(made):
    return next((notice.text for notice in made.app.notices() if notice.name == "REFUSED"), "")


@pytest.mark.parametrize(("gear", "sign"), [(1, 1.0), (2, 1.0), (9, -1.0)])
def test_a_gear_gives_the_torque_its_sign(desk, gear, sign):
    made = desk(SPEED % "" + GEAR)
    drive(made, 2.0, gear)
    assert sign * fed(made) > 2000.0
    assert made.last("estimate")[1][0] * sign > 0.0 or sign * fed(made) > 0.0
    result_before = fed(made)
    drive(made, 1.0, 0)  # neutral: it rolls on as it did
    assert fed(made) == pytest.approx(result_before, rel=0.01)


def test_without_a_direction_nothing_is_fed_and_it_is_said(desk):
    made = desk(SPEED % "" + GEAR)
    drive(made, 2.5)
    assert not made.published
    assert "without_direction" in refused(made)
    drive(made, 2.0, 9)
    assert fed(made) < -2000.0
    drive(made, 2.0 + 2.0)  # the gear is silent
    assert fed(made) == 0.0
    assert "without_direction" in refused(made)
    drive(made, 1.0, 77)  # a value without a meaning
    assert fed(made) == 0.0


def test_a_speed_that_is_not_valid_is_not_used(desk):
    made = desk(SPEED % VALID)
    drive(made, 2.0, good=True)
    assert fed(made) > 2000.0
    drive(made, 2.5, good=False)
    assert fed(made) == 0.0
    assert "invalid" in refused(made)


def test_a_speed_of_1_hz_is_held_and_said_and_a_dead_one_fades(desk):
    made = desk(SPEED % "", output_rate_hz=50.0)
    for _ in range(20):
        made.forward(1.0)
        made.send("speed", 8.0)
    made.published.clear()
    for _ in range(5):
        made.forward(1.0)
        made.send("speed", 8.0)
    torques = [values[0] for name, _, values in made.published if name == "feedforward_torque_nm"]
    assert len(torques) > 200
    assert min(torques) > 0.97 * max(torques) > 2000.0
    text = next(notice.text for notice in made.app.notices() if notice.name == "SPEED_SLOW")
    assert "your speed comes at 1 Hz; it is trusted for 1.5 s" in text
    made.forward(1.6)
    assert "SPEED_OLD" in made.names()
    made.forward(1.0)
    assert fed(made) == 0.0


def test_a_doubted_load_is_named_at_once(desk):
    made = desk(SPEED % "" + LOAD)
    made.drive(3.0, load=250e3)
    result_before = fed(made)
    made.drive(0.2, load=450e3)
    assert "LOAD_DOUBTED" in made.names()
    made.drive(3.0)
    assert "LOAD_DOUBTED" in made.names()
    assert fed(made) == pytest.approx(result_before, rel=0.01)
