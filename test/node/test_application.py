# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The application without a middleware: its outputs and statuses for given inputs."""

import inspect
import itertools
import math
import shlex
import time

import numpy as np
import pytest

from trackres_ros.errors import InputError
from trackres_ros.estimator.columns import SPEED, Count
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.node import inputs
from trackres_ros.node.application import Application
from trackres_ros.node.inputs import Sent
from trackres_ros.node.transport import Level, Peer
from trackres_ros.output.topics import output_topics, values_of
from trackres_ros.vehicle import load

START_NS, SECOND_NS = 1_700_000_000_000_000_000, 1_000_000_000
TWIST = "geometry_msgs/msg/TwistStamped"
TORQUE = "torque: {topic: torque, type: geometry_msgs/msg/WrenchStamped, field: wrench.torque.y}\n"


def all_there(d):
    d.found_peers = {input.name: (Peer(input.type, True),) for input in d.app.inputs}


def test_what_leaves_is_what_an_offline_session_gives(desk):
    d = desk()
    d.found_peers = {input.name: (Peer(input.type, True),) for input in d.app.inputs}
    d.drive(3.0, ambient=20.0, load=250e3)
    estimator = Estimator(load("xgd24d"))
    session = estimator.session()
    for step in range(1, 151):
        time_now = START_NS + round(step * 0.02 * 1e9)
        session.handle(session.channel("ambient"), time_now, time_now, 20.0)
        session.handle(session.channel("load"), time_now, time_now, 250e3)
        estimate = session.handle(session.channel("speed"), time_now, time_now, 8.0)
    for topic in output_topics(estimator.vehicle):
        expectation = values_of(topic, estimate.row[np.newaxis], estimator.column_index)[0]
        if topic.kind != "status" and np.isfinite(expectation).all():
            stamp, values = d.last(topic.name)
            assert stamp == time_now
            np.testing.assert_allclose(values, expectation, rtol=1e-12)
    assert d.all_finite()


def test_nothing_but_a_status_leaves_before_the_first_speed(desk, topics):
    d = desk(topics=topics)
    d.forward(3.0)
    assert not d.published
    _, statuses = d.statuses[-1]
    assert statuses[0].level is Level.STALE
    assert "no speed yet" in statuses[0].message
    assert {name for name, _ in d.statuses} == {"status", "parameters", "/diagnostics"}
    d.drive(1.0)
    assert d.all_finite()  # nor a residual before the first torque


@pytest.mark.parametrize("rate", [1.0, 33.0, 50.0])
def test_any_rate_is_kept_and_repeats_the_last_state_and_stamp(desk, rate):
    d = desk(output_rate_hz=rate, output_deadline_s=0.0)
    d.drive(10.0, dt=0.1)
    stamps = [stamp for name, stamp, _ in d.published if name == "feedforward_torque"]
    assert len(stamps) == pytest.approx(10.0 * rate, rel=0.05, abs=1.5)
    assert len(set(stamps)) == pytest.approx(min(10.0 * rate, 100), abs=1.5)


@pytest.mark.parametrize("speed_hz", [12.0, 20.0, 50.0])
def test_at_rate_zero_each_speed_gives_one_output(desk, speed_hz):
    d = desk()
    d.drive(4.0, dt=1.0 / speed_hz)
    assert len([1 for name, _, _ in d.published if name == "feedforward_torque"]) == round(4.0 * speed_hz)


@pytest.mark.parametrize("rate", [0.2, 1.0, 7.0])
def test_at_a_slow_rate_an_old_speed_takes_the_torque_in_time(desk, rate):
    d = desk(output_rate_hz=rate, output_deadline_s=0.0)
    d.drive(10.1)
    assert d.last("feedforward_torque_nm")[1][0] > 3000.0
    d.forward(1.6)  # to trust the speed, to fade, and one output
    assert d.last("feedforward_torque_nm")[1][0] == 0.0


def test_a_new_output_rate_holds_at_once(desk):
    d = desk(output_rate_hz=0.1, output_deadline_s=0.0)
    d.drive(1.0)
    d.app.change({"output_rate_hz": 50.0})
    result_before = len(d.published)
    d.drive(0.1)
    assert len(d.published) > result_before


@pytest.mark.parametrize("rate", [0.0, 50.0])
def test_without_speed_feedforward_fades_and_other_outputs_hold(desk, rate):
    d = desk(output_rate_hz=rate)
    d.drive(2.0)
    d.forward(0.1)
    stamp, (full,) = d.last("feedforward_torque")
    result_before = d.last("resistance_torque")
    d.forward(0.35)
    assert d.last("feedforward_torque") == (stamp, [full])
    assert "SPEED_OLD" not in d.names()
    d.forward(0.55)
    faded = d.last("feedforward_torque_nm")[1][0]
    assert 0.3 * full < faded < 0.7 * full
    assert "SPEED_OLD" in d.names()
    assert d.app.overview().level is Level.STALE
    d.forward(1.0)
    assert d.last("feedforward_torque") == (stamp, [0.0])
    assert d.last("resistance_torque") == result_before
    assert d.all_finite()


@pytest.mark.parametrize("given", [{}, {"load": 250e3}, {"ambient": 12.0}, {"load": 250e3, "ambient": 12.0}])
def test_the_status_reports_loss_and_return_of_speed_at_once(desk, given):
    d, level = desk(), Level.OK if len(given) == 2 else Level.WARN  # a nominal load or ambient is a warning
    all_there(d)
    d.drive(2.0, **given)
    assert d.statuses[-1][1][0].level is level
    d.forward(0.65)
    assert d.statuses[-1][1][0].level is Level.STALE
    d.drive(0.15, **given)
    assert d.statuses[-1][1][0].level is level


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e9])
def test_values_that_cannot_be_are_refused_and_said(desk, value):
    d = desk()
    d.drive(2.0)
    torque = d.last("resistance_torque")[1][0]
    d.drive(0.02, speed=16.0)  # too early: it is in doubt
    assert d.statuses[-1][1][0].level is Level.WARN
    assert "SPEED_IMPLAUSIBLE" in dict(d.statuses[-1][1][0].values)["remarks"]
    d.drive(0.4, speed=value)
    d.forward(1.0)
    assert d.last("resistance_torque")[1][0] == pytest.approx(torque, rel=0.01)
    assert {"REFUSED", "SPEED_OLD"} <= d.names()
    assert "no accepted speed for " in "; ".join(notice.text for notice in d.app.notices())  # some came
    assert d.all_finite()


def test_coarse_steps_and_one_value_for_long_are_remarked(desk):
    d = desk(stuck_s=2.0)
    for i in range(50):
        d.drive(0.04, speed=[28, 29, 30, 29][i % 4] / 3.6, load=250e3, ambient=15.0)  # as a bus sends it
    assert {notice.name: notice.level for notice in d.app.notices()}["SPEED_QUANTISED"] is Level.OK
    for i in range(100):  # known to have fine steps, it is stuck sooner
        d.drive(0.02, speed=8.0 + 0.01 * (i % 7), load=250e3, ambient=15.0)
    d.drive(2.5, speed=8.0)
    assert "SPEED_STUCK" in d.names()


def test_peers_are_remarked(desk):
    d = desk()
    d.drive(1.5)
    assert "NO_PUBLISHER" in d.names()
    d.found_peers = {
        "speed": (Peer(TWIST, True), Peer(TWIST, True)),
        "load": (Peer("std_msgs/msg/Float32", False),),
        "ambient": (Peer("sensor_msgs/msg/Temperature", False),),
    }
    d.drive(1.5)
    assert {"SEVERAL_PUBLISHERS", "WRONG_TYPE"} <= d.names()
    assert [notice.text.split(":")[0] for notice in d.app.notices() if notice.name == "INCOMPATIBLE_QOS"] == ["ambient"]
    d.found_peers = {"speed": (Peer(TWIST, True), Peer(TWIST, True, defines_alike=False))}
    d.drive(2.5)
    assert {"WRONG_TYPE", "SPEED_OLD"} <= d.names()
    d.found_peers = {"speed": (Peer(TWIST, True), Peer(TWIST, False, defines_alike=False))}  # none of its messages arrives
    d.drive(2.5)
    assert "INCOMPATIBLE_QOS" in d.names()
    assert not {"WRONG_TYPE", "SPEED_OLD"} & d.names()
    all_there(d)
    d.drive(3.0, load=270e3, ambient=10.0)
    assert not d.names()


def test_a_fault_just_after_the_start_is_a_warning_at_once(desk):
    d = desk()
    d.found_peers = {"speed": (Peer("std_msgs/msg/Float32", True),)}
    d.drive(1.2)
    assert [text for level, text in d.logged if level is Level.WARN and "std_msgs/msg/Float32" in text]


def test_a_healthy_start_logs_no_warning(desk):
    d = desk()
    d.forward(0.4)  # publishers are found, then their messages come, the ambient last
    all_there(d)
    d.drive(1.0)
    d.drive(0.6, load=270e3)
    d.drive(8.0, load=270e3, ambient=10.0)
    assert d.logged, "what it waits for is logged"
    assert {level for level, _ in d.logged} == {Level.OK}
    assert d.logged[0][1].startswith("waiting for inputs: no speed yet; ")
    assert "no warnings" in d.logged[-1][1]


def test_an_input_that_stays_away_is_a_warning(desk):
    d = desk()
    d.drive(4.5)
    assert {level for level, _ in d.logged} == {Level.OK}
    d.drive(2.0)
    level, text = d.logged[-1]
    assert level is Level.WARN
    assert "nobody publishes std_msgs/msg/Float64 on /load" in text
    assert len([text for level, text in d.logged if level is Level.WARN]) == 1
    assert d.statuses[0][1][0].level is Level.STALE  # the status says it from the first second on


def test_topics_are_shown_under_their_remapped_names(desk):
    d = desk(remapped={"speed": "/car/odometry/speed", "load": "/scale"})
    d.found_peers = {"speed": (Peer(TWIST, True), Peer(TWIST, True))}
    d.drive(7.0, ambient=10.0)
    shown = {
        dict(s.values)["topic"] for name, result in d.statuses for s in result if name == "/diagnostics" and "input" in s.name
    }
    assert shown == {"/car/odometry/speed", "/scale", "/ambient"}
    logged = "; ".join(text for _, text in d.logged)
    assert "speed: 2 publishers on /car/odometry/speed" in logged
    assert "on /scale" in logged
    d.app.messages.count_drop(0)
    d.app.close()
    assert f"{d.topic_name(d.app.inputs[0].name)} dropped 1" in d.logged[-1][1]


def test_parameters_change_without_losing_the_temperature(desk):
    d = desk()
    d.drive(60.0, dt=0.1)
    belt = d.last("track_temperature/front_left")[1][0]
    assert belt > 15.2
    d.app.change({"feedforward_parts": ["bearing"], "output_rate_hz": 20})
    assert d.app.period_s == pytest.approx(0.05)
    d.drive(2.0)
    assert d.last("track_temperature/front_left")[1][0] == pytest.approx(belt, abs=0.2)
    row = d.app.overview().values
    assert row["feedforward_torque_nm"] == pytest.approx(row["bearing_nm"])


def test_a_reset_while_driving_keeps_inputs_and_feedforward(desk):
    d = desk()
    d.drive(60.0, dt=0.1, ambient=28.0, load=180e3)
    assert d.last("track_temperature/front_left")[1][0] > 28.2
    cold, count = desk(), len(d.published)
    cold.drive(1.0, ambient=28.0, load=180e3)
    assert "restarts" in d.app.reset()
    d.drive(0.4)
    torques = [values[0] for name, _, values in d.published[count:] if name == "feedforward_torque_nm"]
    assert d.last("track_temperature/front_left")[1][0] == pytest.approx(28.0, abs=0.02)
    assert torques == pytest.approx([cold.last("feedforward_torque_nm")[1][0]] * 20, rel=2e-3)
    assert not {"LOAD_NOMINAL", "AMBIENT_NOMINAL"} & d.names()


def test_a_reset_in_a_pause_of_the_speed_starts_cold_after_it(desk):
    d = desk()
    d.drive(60.0, dt=0.1, ambient=28.0)
    d.forward(100.0)
    d.app.reset()
    d.drive(0.1)
    assert d.last("track_temperature/front_left")[1][0] == pytest.approx(28.0, abs=0.01)
    assert not {"GAP_UNKNOWN", "AMBIENT_NOMINAL"} & d.names()


@pytest.mark.parametrize("stamp", ["header", "log", "never set"])
def test_a_clock_that_is_set_keeps_the_temperature_and_is_said(desk, stamp):
    speed = f"{{topic: speed, type: {TWIST}, field: twist.linear.x, stamp: {'log' if stamp == 'log' else 'header'}}}"
    d = desk(f"speed: {speed}\nload: {{topic: load, type: std_msgs/msg/Float64, field: data}}\n{TORQUE}")

    def drive(steps, dt):
        for _ in range(steps):
            d.forward(dt)
            d.send("load", 250e3)
            if stamp != "log":
                d.send("torque", 3000.0)
            d.send("speed", 15.0, stamp_s=-START_NS / SECOND_NS if stamp == "never set" else None)

    drive(300, 0.2)
    belt = d.last("track_temperature/front_left")[1][0]
    d.clock_offset_s = 3600.0
    drive(50, 0.02)
    assert d.last("track_temperature/front_left")[1][0] == pytest.approx(belt, abs=0.2)
    texts = {name for topic, s in d.statuses if topic == "status" for name in dict(s[0].values)["remarks"].split()}
    assert ("CLOCK_JUMPED" in texts) == (stamp != "log")
    assert d.last("feedforward_torque")[0] == pytest.approx(d.now_ns(), abs=1000)
    assert [(name, count) for name, count, _ in d.app.session.counts() if name == "load"] == [("load", Count.ACCEPTED)]
    if stamp == "header":  # from now on without
        for _ in range(3):
            d.forward(0.02)
            d.send("torque", 3000.0)
            d.send("speed", 15.0, stamp_s=-START_NS / SECOND_NS)
        assert d.last("feedforward_torque")[0] == pytest.approx(d.now_ns(), abs=1000)


def test_belts_cool_while_the_machine_is_suspended(desk, monkeypatch):
    d, ahead_s = desk(), {time.CLOCK_MONOTONIC: 0.0, time.CLOCK_BOOTTIME: 0.0}
    monkeypatch.setattr("time.clock_gettime_ns", lambda clock: int((d.steady_s + ahead_s[clock]) * SECOND_NS))
    d.app.clock.steady_ns = inspect.signature(Application).parameters["steady_ns"].default
    d.drive(300.0, speed=15.0, dt=0.4)
    d.drive(10.0, speed=0.0, dt=0.1)
    warm = d.last("track_temperature/front_left")[1][0]
    d.clock_offset_s = ahead_s[time.CLOCK_BOOTTIME] = 36000.0
    d.drive(1.0, speed=0.0)
    assert d.last("track_temperature/front_left")[1][0] < 15.0 + 0.1 * (warm - 15.0)
    assert "CLOCK_JUMPED" not in d.names()


@pytest.mark.parametrize(("rate", "pause_s"), [(0.0, 40.0), (50.0, 40.0), (50.0, 150.0)])
def test_speeds_that_waited_while_the_node_was_stopped_are_old(desk, rate, pause_s):
    d = desk()
    d.drive(300.0, dt=0.3)
    d.app.change({"output_rate_hz": rate})
    d.drive(0.5)
    warm, began_s = d.last("track_temperature/front_left")[1][0], d.time_s
    d.time_s, d.steady_s, sent_message = d.time_s + pause_s, d.steady_s + pause_s, len(d.published)
    for i in range(1, 26):
        d.send("speed", 8.0, stamp_s=began_s + 0.02 * i)
    assert d.names() & {"SPEED_OLD", "CLOCK_OFFSET"} == {"SPEED_OLD"}
    assert d.app._watch.accepted_ns[SPEED] < (d.steady_s - 0.9 * pause_s) * SECOND_NS
    assert d.app._state_at < time.time() - 0.9 * pause_s
    d.forward(0.5)
    d.drive(2.0, speed=0.0)
    assert "SPEED_OLD" not in d.names()
    assert {values[0] for name, _, values in d.published[sent_message:] if name == "feedforward_torque_nm"} == {0.0}
    assert not d.app.session.memory.counters[:, Count.IMPLAUSIBLE].any()
    assert d.last("track_temperature/front_left")[1][0] < warm - 0.003 * pause_s


def test_stamps_of_another_clock_are_remarked(desk):
    d = desk()
    for _ in range(100):
        d.forward(0.02)
        d.send("speed", 8.0, stamp_s=d.time_s - 100.0)
    assert "CLOCK_OFFSET" in d.names()
    assert any("100.0 s behind" in notice.text for notice in d.app.notices())


def test_simulated_time_that_goes_back_starts_anew(desk):
    d = desk(use_sim_time=True)
    d.drive(120.0, dt=0.3)
    d.app.messages.receive_values(d.index("ambient"), d.now_ns(), [35.0], origin=Sent(1))  # waits for a speed, and is of before
    d.time_s = 0.0
    d.app.time_went_back(4 * SECOND_NS)
    d.drive(0.1)
    assert d.last("track_temperature/front_left")[1][0] == pytest.approx(15.0, abs=0.01)
    assert "TIME_RESET" in d.names()
    d.drive(5.0, dt=0.1)
    assert d.app.overview().values["ambient_degc"] == 15.0
    assert ("ambient", Count.ACCEPTED, 1) in list(d.app.session.counts())


def test_feedforward_keeps_the_time_of_a_fast_simulated_clock(desk):
    d = desk(use_sim_time=True, feedforward_rate=1000.0, output_rate_hz=50.0)
    d.simulated_in_a_second = 10.0
    d.drive(0.6)
    assert d.last("feedforward_torque_nm")[1][0] > 3000.0
    d.simulated_in_a_second = 0.0
    d.forward(2.0)
    assert [input.too_old for input in d.app.overview().inputs if input.role == "speed"] == [True]


def test_a_leap_of_the_simulated_clock_is_no_time_to_move_in(desk):
    d = desk(use_sim_time=True, output_rate_hz=50.0)
    d.drive(2.0)
    result_before = len(d.published)
    d.time_s += 3600.0
    d.drive(2.0)
    torques = [values[0] for name, _, values in d.published[result_before - 20 :] if name == "feedforward_torque_nm"]
    assert min(torques) < 0.9 * torques[0]  # the speed was an hour old
    steps = [abs(b - a) for a, b in itertools.pairwise(torques)]
    assert max(steps) <= 20000.0 * 0.02 * (1.0 + 1e-6)  # feedforward_rate


@pytest.mark.parametrize(("changed_s", "anew"), [(10.0, False), (1.0, True)])
def test_a_changed_clock_jump_holds_for_the_simulated_clock(desk, changed_s, anew):
    d = desk(use_sim_time=True, clock_jump_s=5.0)
    d.drive(1.0)
    d.app.change({"clock_jump_s": changed_s})
    d.app.time_went_back(3 * SECOND_NS)
    assert any("time went back" in text for _, text in d.logged) == anew


@pytest.mark.parametrize(("jitter", "period"), [(0.0, 1.2), (0.05, 1.0), (0.0, 0.02)])
def test_what_holds_of_a_slow_speed_is_shown_between_its_steps(desk, jitter, period):
    d = desk(f"speed: {{topic: speed, type: {TWIST}, field: twist.linear.x, max_age_s: 3.0}}\n", output_rate_hz=10.0)
    for step in range(round(20.0 / period)):
        d.forward(period + (jitter if step % 2 else -jitter))
        d.send("speed", 8.0)
    assert all("LOAD_NOMINAL" in reasons for reasons in d.reasons)
    shown = [{entry.name: entry.level for entry in entries} for topic, entries in d.statuses if topic == "/diagnostics"]
    assert {levels["trackres: input speed"] for levels in shown[3:]} == {Level.OK}


def test_a_change_of_settings_builds_no_table_again(desk):
    d = desk()
    table = d.app.estimator.constants.loss
    d.app.change({"speed_std_mps": 0.05})
    assert d.app.estimator.constants.loss is table


def test_all_unstamped_messages_between_sim_clock_ticks_count(desk):
    d = desk("speed: {topic: speed, type: std_msgs/msg/Float64, field: data}\n", use_sim_time=True)
    for step in range(40):
        d.time_s += 0.1 if step % 4 == 0 else 0.0
        d.app.messages.receive(0, type("Float64", (), {"data": 8.0}))
    assert {name: number for _, name, number in d.app.session.counts()} == {Count.ACCEPTED: 40}


def test_what_cannot_be_decoded_is_counted_as_no_number(desk):
    d = desk()
    d.app.messages.receive_values(d.index("load"), None, None)
    assert [(name, count) for name, count, _ in d.app.session.counts()] == [("load", Count.NON_FINITE)]


def test_what_comes_before_the_simulated_clock_waits_for_it(desk):
    d = desk(use_sim_time=True)
    now_ns = d.now_ns
    d.now_ns = lambda: 0
    d.send("load", 250e3)
    d.send("speed", 8.0, stamp_s=0.0)
    assert not d.published
    d.now_ns = now_ns
    d.send("speed", 8.0, stamp_s=0.02)
    row = d.app.overview().values
    assert row["weight_n"] == pytest.approx(250e3)
    assert sum(number for name, _, number in d.app.session.counts() if name == "speed") == 2


def test_before_the_clock_the_newest_messages_of_an_input_wait(desk, monkeypatch):
    monkeypatch.setattr(inputs, "MOST_BEFORE_CLOCK", 5)
    d = desk(use_sim_time=True)
    now_ns, d.now_ns = d.now_ns, lambda: 0
    d.send("load", 250e3)
    for i in range(8):
        d.send("speed", 8.0, stamp_s=0.02 * i)
    d.now_ns = now_ns
    d.send("speed", 8.0, stamp_s=0.02 * 8)
    assert d.app.overview().values["weight_n"] == pytest.approx(250e3)
    assert ("speed", Count.ACCEPTED, 6) in list(d.app.session.counts())
    assert sorted(d.app.messages.reader.drop_counts) == [0, 0, 3]


def test_only_inputs_sent_before_a_speed_are_used_with_it(desk):
    d = desk()
    d.drive(1.0, load=250e3)
    d.app.messages.receive_values(d.index("load"), None, [300e3], origin=Sent(2000))
    d.app.messages.receive_values(d.index("speed"), d.now_ns() + 1, [8.0], origin=Sent(1000))
    assert d.app.overview().values["weight_n"] == pytest.approx(250e3)
    d.app.messages.receive_values(d.index("speed"), d.now_ns() + 2, [8.0], origin=Sent(3000))
    assert d.app.overview().values["weight_n"] == pytest.approx(300e3)


def test_what_waits_for_a_speed_is_counted_when_the_node_ends(desk):
    d = desk()
    d.drive(1.0)
    result_before = sum(number for name, _, number in d.app.session.counts() if name == "load")
    d.app.messages.receive_values(d.index("load"), None, [300e3], origin=Sent(d.now_ns()))
    d.app.close()
    assert sum(number for name, _, number in d.app.session.counts() if name == "load") == result_before + 1


@pytest.mark.parametrize("odd", [None, "resistance_torque_nm", "resistance_std_nm", "feedforward_torque_nm"])
def test_a_fault_inside_is_said_and_does_not_silence_the_outputs(desk, monkeypatch, odd):
    """An exception, or an estimate that is not finite; the log has it once."""
    d = desk()
    d.drive(1.0)
    feed = d.app.session.feed

    def faulty(*message):
        estimate = feed(*message)
        if odd is None:
            raise ZeroDivisionError
        estimate.row[d.app.estimator.column_index[odd]] = math.nan
        return estimate

    monkeypatch.setattr(d.app.session, "feed", faulty)
    d.drive(0.3)
    assert "INTERNAL_ERROR" in d.names()
    assert d.app.overview().level is Level.ERROR
    assert [level for level, text in d.logged if "because of a bug" in text] == [Level.ERROR]
    count = len(d.published)
    d.forward(0.5)
    assert len(d.published) > count
    assert d.all_finite()


def test_a_deactivated_node_keeps_the_temperature_and_is_silent(desk):
    d = desk()
    d.drive(60.0, dt=0.1)
    d.app.deactivate()
    count, belt = len(d.published), d.app.overview().values["belt_degc/front_left"]
    d.drive(60.0, dt=0.1)
    assert len(d.published) == count
    assert d.app.overview().values["belt_degc/front_left"] > belt


@pytest.mark.parametrize("nm_per_s", [2e4, 2000.0])
@pytest.mark.parametrize("ended_by", ["deactivate", "close", "fault"])
def test_publishing_ends_at_zero_and_begins_there_again(desk, ended_by, nm_per_s):
    d = desk(feedforward_rate=nm_per_s, speed_max_age_s=5.0)
    d.drive(4.0, load=250e3, ambient=12.0)
    full, count = d.last("feedforward_torque_nm")[1][0], len(d.published)
    assert full > 3000.0
    began_s, limit = d.steady_s, d.app.estimator.constants.number.feedforward_limit  # the fade takes 1 s
    d.app.change({"feedforward_share": 1e-3})  # nor does it take longer from above a limit that was just lowered
    {"deactivate": d.app.deactivate, "close": d.app.close, "fault": lambda: d.app.deactivate(OSError("gone"))}[ended_by]()
    assert d.steady_s - began_s <= min(1.0, full / nm_per_s) + 2.0 * d.app.period_s
    torques = [values[0] for name, _, values in d.published[count:] if name == "feedforward_torque_nm"]
    assert torques[-1] == 0.0
    assert max(-np.diff([full, *torques])) <= (nm_per_s + 2.0 * limit) * d.app.period_s
    text = [result[0] for name, result in d.statuses if name == "status"][-1]
    assert text.level is (Level.ERROR if ended_by == "fault" else Level.STALE)
    assert dict(text.values)["remarks"].split()[0] == ("INTERNAL_ERROR" if ended_by == "fault" else "INACTIVE")
    count, statuses = len(d.published), len(d.statuses)
    d.drive(6.0, load=250e3, ambient=12.0)
    assert (len(d.published), len(d.statuses)) == (count, statuses)
    d.app.change({"feedforward_share": 0.1})
    d.app.activate()
    d.drive(4.0, load=250e3, ambient=12.0)
    torques = [values[0] for name, _, values in d.published[count:] if name == "feedforward_torque_nm"]
    assert max(np.diff([0.0, *torques])) <= nm_per_s * 0.021
    assert torques[-1] == pytest.approx(full, rel=0.01)
    assert not {"INACTIVE", "INTERNAL_ERROR"} & d.names()
    d.app.change({"feedforward_share": 1e-3})
    d.app.deactivate()
    d.app.activate()
    d.forward(0.1)
    assert d.last("feedforward_torque_nm")[1][0] <= 0.1 * nm_per_s


def test_surroundings_that_are_assumed_are_said_and_warned_of(desk, tmp_path):
    file = tmp_path / "it's here.yaml"
    file.write_text("schema: 1\nvehicle: xgd24d\neffects:\n  grade: {grade: 0.02}\n")
    plain, d = desk(), desk(surroundings=str(file))
    for item in (plain, d):
        item.drive(2.0, load=272e3, ambient=15.0)
    assert d.names() - plain.names() == {"SURROUNDINGS"}
    assert next(notice.level for notice in d.app.notices() if notice.name == "SURROUNDINGS") is Level.WARN
    assert str(file) in shlex.split(d.app.parameters.diagnose_command())
    fed, expectation = ([item.last(name)[1][0] for item in (plain, d)] for name in ("feedforward_torque", "resistance_torque"))
    assert fed[0] == pytest.approx(fed[1], rel=1e-3)
    assert expectation[0] != pytest.approx(expectation[1], rel=0.1)
    with pytest.raises(InputError, match="configured"):
        d.app.change({"surroundings": ""})


def test_a_belt_beyond_the_rubber_data_is_warned_of(desk, tmp_path, repository):
    (tmp_path / "rubber").mkdir()
    header, *rows = (repository / "config" / "rubber" / "nr_sbr_10hz.csv").read_text().splitlines()
    kept = [row for row in rows if float(row.split(",")[0]) <= 10.0]
    (tmp_path / "rubber" / "nr_sbr_10hz.csv").write_text("\n".join([header, *kept]))
    (tmp_path / "mine.yaml").write_text((repository / "config" / "xgd24d.yaml").read_text())
    made = desk(vehicle=str(tmp_path / "mine.yaml"))
    made.drive(0.1)
    made.forward(0.1)
    assert "OUTSIDE_TABLE" in made.reasons[-1]
    status = next(result[0] for topic, result in reversed(made.statuses) if topic == "status")
    assert status.level == Level.WARN
    assert "the torque is extrapolated" in status.message


@pytest.mark.parametrize(("vehicle", "idle"), [("xgd24d", "wheel_speed/tail"), ("husky", "belt, wheel_speed/tail")])
def test_roles_that_a_vehicle_has_no_place_for_are_said(desk, vehicle, idle):
    lines = (
        "speed: {topic: v, type: std_msgs/msg/Float64, field: data}\n"
        "belt: {topic: b, type: std_msgs/msg/Float64, field: data}\n"
        "wheel_speed/tail: {topic: w, type: std_msgs/msg/Float64, field: data}\n"
    )
    d = desk(lines, vehicle=vehicle)
    assert f"no belt or wheel for {idle} of the topics file" in d.app.began_with
    assert "topics file" not in desk(vehicle=vehicle).app.began_with
