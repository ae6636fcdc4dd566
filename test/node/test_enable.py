# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The live node stops feeding forward where it is not enabled, or the speed is not the vehicle's, and says so at once."""

from types import SimpleNamespace

import numpy as np
import pytest

import trackres_ros as tr
from trackres_ros.errors import InputError
from trackres_ros.node.transport import Level, Peer
from trackres_ros.recording.bindings import Topics

SPEED = "speed: {topic: speed, type: geometry_msgs/msg/TwistStamped, field: twist.linear.x%s}\n"
BOOL = "enable: {topic: enable, type: std_msgs/msg/Bool, field: data%s}\n"
MODE = "enable: {topic: mode, type: std_msgs/msg/UInt8, field: data, values: [1, 4]}\n"


def enable(made, value):
    made.app.messages.receive(made.index("enable"), SimpleNamespace(data=value))


def fed(made):
    return made.last("feedforward_torque_nm")[1][0]


def drive(made, seconds, value=None, speed=8.0):
    for i in range(round(seconds / 0.02)):
        made.forward(0.02)
        if value is not None and i % 5 == 0:
            enable(made, value)
        made.send("speed", speed + 0.01 * (i % 3))


def test_at_a_slow_rate_a_disabled_torque_is_gone_in_time(desk):
    made = desk(SPEED % "" + BOOL % "", output_rate_hz=0.2, output_deadline_s=0.0)
    drive(made, 10.1, True)
    assert fed(made) > 3000.0
    drive(made, 1.1, False)
    assert fed(made) == 0.0


@pytest.mark.parametrize(("line", "on", "off"), [(BOOL % "", True, False), (MODE, 4, 0), (MODE, 1, 2)])
def test_enable_takes_the_feedforward_to_zero_and_back(desk, line, on, off):
    made = desk(SPEED % "" + line)
    drive(made, 1.0)
    assert fed(made) == 0.0
    assert "ENABLE_OLD" in made.names()
    drive(made, 2.1, on)
    assert fed(made) > 3000.0
    assert not made.names() & {"ENABLE_OLD", "DISABLED"}
    drive(made, 1.0, off)
    assert fed(made) == 0.0
    assert "DISABLED" in made.names()
    assert made.last("resistance_torque")[1][0] < -3000.0
    level = {notice.name: notice.level for notice in made.app.notices()}
    assert level["DISABLED"] == Level.OK
    drive(made, 1.0, on)
    assert fed(made) > 3000.0
    values = [values[0] for topic, _, values in made.published if topic == "feedforward_torque_nm"]
    assert max(abs(np.diff(values))) <= 20000.0 * 0.021


def test_a_disable_acts_between_two_speeds_that_come_slowly(desk):
    made = desk(SPEED % ", max_age_s: 5.0" + BOOL % ", max_age_s: 5.0", output_rate_hz=50.0)
    for _ in range(4):
        enable(made, True)
        made.forward(1.0)
        made.send("speed", 8.0)
    enable(made, True)
    made.forward(0.5)
    assert fed(made) > 3000.0
    enable(made, False)
    made.forward(0.4)
    assert fed(made) == 0.0
    assert "DISABLED" in made.names()
    enable(made, True)
    made.forward(0.4)
    assert fed(made) > 3000.0


def test_an_enable_that_stops_coming_is_said_between_two_speeds(desk):
    made = desk(SPEED % ", max_age_s: 5.0" + BOOL % "", output_rate_hz=50.0)
    enable(made, True)
    made.send("speed", 8.0)
    made.forward(0.4)
    assert fed(made) > 3000.0
    made.forward(0.5)
    assert fed(made) == 0.0
    assert "ENABLE_OLD" in made.names()


def test_an_enable_that_has_not_come_yet_is_no_warning(desk):
    made = desk(SPEED % "" + BOOL % "")
    made.forward(3.0)
    assert {level for level, _ in made.logged} == {Level.OK}
    made.forward(4.0)
    assert made.logged[-1][0] > Level.OK
    assert "no recent enable" in made.logged[-1][1]


def test_what_is_wrong_is_logged_while_an_input_is_awaited(desk):
    made = desk(SPEED % "" + BOOL % "")
    made.found_peers = {input.name: (Peer("another/msg/Type", True),) for input in made.app.inputs}
    made.forward(2.0)
    level, text = made.logged[-1]
    assert level is Level.WARN
    assert "instead of" in text
    assert "no speed yet" not in text


def test_a_replay_with_enable_gives_the_numbers_of_live(desk, tmp_path):
    made = desk(SPEED % "" + BOOL % "")
    rows, lines = [], ["time_s,enable,speed_mps"]
    made.app.on_estimate = lambda row, stamp, arrival: rows.append(row)
    for i in range(300):
        made.forward(0.02)
        wanted, speed = 50 <= i < 200, float(8.0 + 0.5 * np.sin(i / 20.0))
        if i < 250:
            enable(made, wanted)
        made.send("speed", speed)
        lines.append(f"{0.02 * i:.2f},{int(wanted) if i < 250 else ''},{speed!r}")
    (tmp_path / "drive.csv").write_text("\n".join(lines) + "\n")
    replay_result = tr.replay(tmp_path / "drive.csv", "xgd24d")
    live = np.array([row[: len(replay_result.estimator.columns)] for row in rows])
    for i, name in enumerate(replay_result.estimator.columns):
        np.testing.assert_allclose(replay_result[name], live[:, i], rtol=1e-6, atol=1e-9, err_msg=name)
    assert replay_result["feedforward_torque_nm"][150] > 3000.0
    assert replay_result["feedforward_torque_nm"][[0, 249, 299]].tolist() == [0.0] * 3
    assert {item["reason"] for item in replay_result.as_dict()["reasons"]} >= {"disabled", "enable_old"}
    named = tr.replay(tmp_path / "drive.csv", "xgd24d", topics={"enable": {"column": "enable"}})
    np.testing.assert_array_equal(named["feedforward_torque_nm"], replay_result["feedforward_torque_nm"])


def test_a_mode_in_a_table_is_read_by_its_values(tmp_path):
    lines = ["time_s,speed_mps,mode", *(f"{0.02 * i:.2f},8.0,{4 if i < 50 else 3}" for i in range(100))]
    (tmp_path / "drive.csv").write_text("\n".join(lines) + "\n")
    topics = Topics.parse({"enable": {"column": "mode", "values": [1, 4]}})
    replay_result = tr.replay(tmp_path / "drive.csv", "xgd24d", topics=topics)
    assert replay_result["feedforward_torque_nm"][49] > 3000.0
    assert replay_result["feedforward_torque_nm"][99] == 0.0


@pytest.mark.parametrize("values", [[], 4, ["auto"], [float("nan")]])
def test_values_of_a_mode_are_numbers(values):
    with pytest.raises(InputError, match="values"):
        Topics.parse({"enable": {"topic": "mode", "type": "std_msgs/msg/UInt8", "field": "data", "values": values}})
