# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A node that learns: by default it watches, reports learned values, keeps them over a restart, and changes nothing."""

import json
import math
import re
import shutil

import pytest

from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as at
from trackres_ros.node.notices import KINDS


def drive(d, seconds, share=1.1, more=0.0):
    """Drive slower and faster in turn, with a torque so many times the file's expectation."""
    for i in range(round(seconds / 0.2)):
        speed = 8.0 + 4.0 * math.sin(i / 150.0)
        expectation = d.app.overview().values.get("drive_torque_nm", 3000.0)
        moved = d.app.session.learned
        if moved[at.Learned.on] > 0.0:
            expectation -= float((moved[at.Learned.departures] * moved[at.Learned.sensitivities]).sum())
        d.drive(0.2, speed=speed, dt=0.2, torque=share * expectation + more + (i % 11 - 5.0))


def learned_topic(d):
    """The last statuses on ~/parameters, by their last word."""
    d.forward(1.1)
    last = next(statuses for name, statuses in reversed(d.statuses) if name == "parameters")
    return {status.name.rpartition(" ")[2]: status for status in last}


def test_by_default_it_watches_and_says_what_it_learns(desk, topics):
    d = desk(topics=topics)
    drive(d, 120.0)
    result = learned_topic(d)
    assert set(result) >= {"learning", "loss_modulus_scale", "bearing_friction", "drag_coefficient", "torque_gain", "disturbance"}
    values = dict(result["loss_modulus_scale"].values)
    assert float(values["low"]) < float(values["value"]) < float(values["high"])
    assert float(values["value"]) > 1.0
    assert values["state"] in ("learning", "learned", "frozen")
    assert d.app.session.learned[at.Learned.on] == 0.0
    assert "learning" in d.app.overview().learning
    delay = dict(result["torque_delay"].values)
    assert (delay["unit"], delay["state"], delay["acts"]) == ("s", "learning", "false")


@pytest.fixture(scope="module")
def learned_file(standing_desk, topics, tmp_path_factory):
    """A state file with values learned for a minute, and the seconds of it that were usable."""
    path = tmp_path_factory.mktemp("learned") / "state.json"
    d = standing_desk(topics=topics, state_file=str(path))
    drive(d, 60.0)
    d.app.session.learned[[at.Learned.on, at.Learned.torque]] = 1.0, 65.0  # as in mode on
    d.save()
    return path, d.app.learning.learner.learned.seconds


@pytest.fixture
def state(learned_file, tmp_path):
    """The same file, for this test alone."""
    return shutil.copy(learned_file[0], tmp_path / "state.json")


def test_it_survives_a_restart_and_a_reset_forgets_it(desk, topics, state, learned_file):
    repetition = desk(topics=topics, state_file=str(state))
    assert repetition.app.learning.learner.learned.seconds == learned_file[1] > 30.0
    assert "used for learning" in repetition.app.began_with
    assert "are reset" in repetition.app.reset_learning()
    assert repetition.app.learning.learner.learned.seconds == 0.0


def test_without_a_torque_what_was_learned_is_kept_until_a_reset(desk, topics, state):
    learned_values = json.loads(state.read_text())["learning"]
    without = desk(state_file=str(state))
    assert "kept" in without.app.began_with
    assert not without.app.session.learned[: at.Learned.sensitivities.start].any()
    assert without.app.learning.learner is None
    assert "parameters" not in [topic.name for topic in without.app.outputs]
    assert without.app.overview().learning == ""
    for _ in range(2):
        without.drive(2.0)
        without.save()
        assert json.loads(state.read_text())["learning"] == learned_values
    assert "are reset" in without.app.reset_learning()
    assert "nothing to reset" in without.app.reset_learning()
    without.save()
    assert "learning" not in json.loads(state.read_text())
    assert desk(topics=topics, state_file=str(state)).app.learning.learner.learned.seconds == 0.0


@pytest.mark.parametrize("between", ["no torque", "off", "off, then on", "no speed"])
def test_time_without_learning_wears_whatever_runs_are_between(desk, topics, state, monkeypatch, between):
    result_before, given_values = state.read_bytes(), {"topics": topics, "state_file": str(state)}
    wall_clock_s = [json.loads(result_before)["saved_at"]]
    monkeypatch.setattr("time.time", lambda: wall_clock_s[0])
    wall_clock_s[0] += 86400.0 * 100.0
    if between == "no speed":  # and a clock that is set after the start
        wall_clock_s[0] -= 1e9
        d = desk(**given_values)
        wall_clock_s[0] += 1e9
        d.drive(0.1)
        wall_clock_s[0] += 86400.0 * 50.0
    else:
        d = desk(**(given_values if between != "no torque" else {"state_file": str(state)}), learning="off")
        d.drive(2.0)
    if between == "off, then on":
        wall_clock_s[0] += 86400.0 * 50.0
        d.app.change({"learning": "on"})
        d.drive(0.1)
    d.save()
    kept = json.loads(state.read_text())["learning"]
    assert (kept == json.loads(result_before)["learning"]) is (between in ("no torque", "off"))
    wall_clock_s[0] += 86400.0 * 100.0
    worn = desk(**given_values).app.learning.learner.learned.covariance
    state.write_bytes(result_before)
    assert worn == pytest.approx(desk(**given_values).app.learning.learner.learned.covariance, rel=1e-9)


def test_it_can_be_turned_off_and_on_while_it_runs(desk, topics):
    d = desk(topics=topics, learning="off")
    drive(d, 10.0)
    assert d.app.learning.learner.learned.seconds == 0.0
    assert d.app.overview().learning == "off"
    d.app.change({"learning": "on"})
    drive(d, 20.0)
    assert d.app.learning.learner.mode == "on"
    assert d.app.learning.learner.learned.seconds > 5.0
    d.app.change({"learning": "watch"})
    assert not d.app.session.learned[: at.Learned.sensitivities.start].any()
    d.app.learning.learner.learned.fresh.better = True
    for mode in ("watch", "off"):
        d.app.change({"learning": mode})
        row = list(d.app.overview().values.values())
        assert d.app.learning.columns(row, d.app.session)[2] == (mode != "off")  # whether learned values act, or would
    with pytest.raises(InputError, match="off, watch, on"):
        d.app.change({"learning": "fast"})


@pytest.mark.parametrize("by_service", [True, False])
def test_learned_values_stop_acting_where_the_estimate_restarts(desk, topics, by_service):
    d = desk(topics=topics, learning="on", use_sim_time=True)
    d.drive(1.0)
    acting = d.app.session.learned[: at.Learned.sensitivities.start]
    acting[at.Learned.on], acting[at.Learned.torque] = 1.0, 65.0
    if by_service:
        d.app.reset()
    else:
        d.time_s = -20.0
    d.drive(0.1)
    assert not acting.any()


@pytest.mark.parametrize(
    ("torque", "why"),
    [
        (lambda i: 3000.0 + (6000.0 if i % 3 == 0 and i > 50 else i % 11), "disagree with the others"),
        (lambda _: 2662.0, "the measured torque is stuck in"),
    ],
)
def test_what_is_wrong_with_the_torque_sensor_is_said(desk, topics, torque, why):
    d = desk(topics=topics)
    for i in range(600):
        d.drive(0.2, speed=8.0, dt=0.2, torque=torque(i))
    assert [why in notice.text for notice in d.app.notices() if notice.name == "LEARNING_FROZEN"] == [True]
    assert KINDS["LEARNING_FROZEN"].meaning


def test_it_is_compiled_while_it_learns_and_goes_on(desk, topics):
    d = desk(topics=topics)
    drive(d, 20.0)
    result_before = d.app.learning.learner.learned.seconds
    d.app.change({"ambient_std_k": 3.0})  # another estimator, as after a change over to compiled code
    drive(d, 20.0)
    assert d.app.learning.learner.learned.seconds > result_before + 10.0


@pytest.mark.parametrize(("more", "kind"), [(300.0, ", of the kind seen before (spells)"), (700.0, "")])
def test_a_disturbance_is_reported_with_its_kind_if_known(desk, topics, disturbed, more, kind):
    d = desk(topics=topics, vehicle=disturbed(300.0))
    drive(d, 300.0, 1.0)
    assert dict(learned_topic(d)["learning"].values)["disturbance"] == ""
    drive(d, 90.0, 1.0, more)
    head = learned_topic(d)["learning"]
    text = dict(head.values)["disturbance"] or dict(head.values)["frozen"]
    result = re.match(r"a disturbance of \+(\d+) Nm for (\d+) s(, of the kind seen before \(spells\))?", text)
    assert float(result[1]) == pytest.approx(more, rel=0.3)
    assert int(result[2]) < 100
    assert (result[3] or "") == kind
    assert result[0] in head.message
    assert {status.level for status in learned_topic(d).values()} == {KINDS["LEARNING_FROZEN"].level}
