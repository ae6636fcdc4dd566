# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Belt temperatures over a restart: kept, cooled, and refused with the reason where the file is of no use."""

import json
import os
import re
import resource
import shutil

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trackres_ros.errors import InputError
from trackres_ros.estimator.snapshot import seal
from trackres_ros.files.resources import cache_dir
from trackres_ros.node.state_keeper import state_name, state_path
from trackres_ros.node.transport import Level


@pytest.fixture(scope="module")
def warm_file(standing_desk, tmp_path_factory):
    """A state file of belts after ten minutes, and their temperature."""
    path = tmp_path_factory.mktemp("warm") / "state.json"
    d = standing_desk(state_file=str(path))
    d.drive(600.0, speed=15.0, dt=0.2)
    assert "saved" in d.save()
    return path, d.app.overview().values["belt_degc/front_left"]


@pytest.fixture
def warm(warm_file, tmp_path):
    """The same, for this test alone."""
    return shutil.copy(warm_file[0], tmp_path / "state.json"), warm_file[1]


def first_belt(d):
    d.drive(0.04)
    return d.app.overview().values["belt_degc/front_left"]


def shifted(path, seconds):
    content = json.loads(path.read_text())
    content["saved_at"] -= seconds
    path.write_bytes(seal(content))


def test_belts_come_back_and_have_cooled_over_the_time_off(desk, warm):
    path, belt = warm
    at_once = first_belt(desk(state_file=str(path)))
    shifted(path, 1800.0)
    later = first_belt(desk(state_file=str(path)))
    shifted(path, 1e6)
    at_last = first_belt(desk(state_file=str(path)))
    assert at_once == pytest.approx(belt, abs=0.5)
    assert belt - 1.0 > later > 15.5
    assert at_last == pytest.approx(15.0, abs=0.1)


def test_after_a_restart_while_driving_nothing_accelerates(desk, warm):
    d = desk(state_file=str(warm[0]))
    rows = []
    for _ in range(50):
        d.drive(0.02)
        rows.append(d.app.overview().values)
    assert all(row["accel_mps2"] == row["inertia_nm"] == 0.0 for row in rows)
    assert max(row["feedforward_torque_nm"] for row in rows) < 1.01 * rows[-1]["resistance_torque_nm"]


def test_belts_that_wait_for_a_speed_cool_meanwhile(desk, warm, monkeypatch):
    path, belt = warm
    wall_clock_s = [1e9]
    content = json.loads(path.read_text())
    path.write_bytes(seal({**content, "saved_at": wall_clock_s[0]}))
    monkeypatch.setattr("time.time", lambda: wall_clock_s[0])
    d = desk(state_file=str(path))
    wall_clock_s[0] += 3600.0
    d.forward(31.0)
    d.save()
    wall_clock_s[0] += 3600.0
    waited = first_belt(d)
    assert waited < belt - 3.0
    path.write_bytes(seal({**content, "saved_at": wall_clock_s[0] - 7200.0}))
    assert waited == pytest.approx(first_belt(desk(state_file=str(path))), abs=1e-6)  # as if switched off all the time


@pytest.mark.parametrize("wrong_s", [-1e9, -86400.0, 0.0])
def test_a_clock_set_before_the_first_speed_tells_the_time_off(desk, warm, monkeypatch, wrong_s):
    path, _ = warm
    wall_clock_s = [1e9]
    kept = seal({**json.loads(path.read_text()), "saved_at": wall_clock_s[0] - 600.0})
    path.write_bytes(kept)
    monkeypatch.setattr("time.time", lambda: wall_clock_s[0])
    result_before = desk(state_file=str(path))
    right = first_belt(result_before)
    result_before.app.close()
    path.write_bytes(kept)
    wall_clock_s[0] += wrong_s
    d = desk(state_file=str(path))
    d.forward(31.0)
    d.save()
    wall_clock_s[0] -= wrong_s
    assert first_belt(d) == pytest.approx(right, abs=1e-6)


SPOILT = {
    "damaged": lambda path: path.write_bytes(path.read_bytes()[:100] + os.urandom(200)),
    "version 99": lambda path: path.write_bytes(seal({**json.loads(path.read_text()), "version": 99})),
    "vehicle": lambda path: path.write_bytes(seal({**json.loads(path.read_text()), "key": "x"})),
    "saved_at": lambda path: path.write_bytes(seal({**json.loads(path.read_text()), "saved_at": "abc"})),
    "another kind": lambda path: path.write_bytes(os.urandom(300)),
    "a folder": lambda path: (path.unlink(), path.mkdir()),
    "a named pipe": lambda path: (path.unlink(), os.mkfifo(path)),
    "a device": lambda path: (path.unlink(), path.symlink_to("/dev/zero")),
}


@pytest.mark.parametrize("said", SPOILT)
def test_a_file_of_no_use_is_a_cold_start_that_says_why(desk, warm, said):
    path, _ = warm
    SPOILT[said](path)
    d = desk(state_file=str(path))
    assert first_belt(d) == pytest.approx(15.0, abs=0.05)
    notice = next(notice for notice in d.app.notices() if notice.name == "STATE_NOT_USED")
    assert said in notice.text
    assert str(path) in notice.text
    assert "or none" not in notice.text  # what a command is given


@pytest.mark.parametrize("content", [b"name: my truck", b"[1, 2]", b'{"format": 3}', b"time_s,speed_mps"])
def test_a_file_of_another_kind_is_never_replaced(desk, tmp_path, content):
    (tmp_path / "mine").write_bytes(content)
    d = desk(state_file=str(tmp_path / "mine"))
    d.drive(40.0, dt=0.1)
    assert "STATE_NOT_SAVED" in d.names()
    d.app.close()
    assert (tmp_path / "mine").read_bytes() == content


@pytest.mark.parametrize("left", [lambda data: b"", lambda data: bytes(len(data)), lambda data: data[:200]])
def test_what_a_power_cut_leaves_of_a_state_is_replaced(desk, warm, left):
    path, _ = warm
    path.write_bytes(left(path.read_bytes()))
    result_before, d = path.read_bytes(), desk(state_file=str(path))
    d.forward(40.0)
    assert "no speed yet" in d.app.close()
    assert path.read_bytes() == result_before
    d = desk(state_file=str(path))
    d.drive(1.0, dt=0.1)
    assert "saved" in d.app.close()
    assert first_belt(desk(state_file=str(path))) == pytest.approx(15.0, abs=0.5)


def test_a_start_after_a_reset_at_rest_is_in_the_last_known_air(desk, tmp_path):
    d = desk(state_file=str(tmp_path / "state.json"))
    d.drive(60.0, dt=0.1, ambient=-20.0)
    d.forward(2.0)
    d.app.reset()
    assert "saved" in d.app.close()
    for _ in range(2):  # the first without a speed
        d = desk(state_file=str(tmp_path / "state.json"))
        assert "cold start in the last known air" in d.app.began_with
        assert "restored" not in d.app.began_with
        assert "saved" in d.app.close()
    assert first_belt(d) == pytest.approx(-20.0, abs=0.05)


def test_the_reason_of_a_cold_start_is_given_once(desk, warm):
    path, _ = warm
    path.write_text("")
    d = desk(state_file=str(path))
    d.drive(12.0)
    d.forward(2.0)
    assert "damaged" in d.app.began_with  # the transport logs it
    warnings = [text for level, text in d.logged if level is not Level.OK]
    assert len(warnings) > 1
    assert not any("damaged" in text for _, text in d.logged)
    last = {
        s.name.rpartition(": ")[2]: s for s in next(result for name, result in reversed(d.statuses) if name == "/diagnostics")
    }
    assert "damaged" not in last["estimate"].message
    assert "damaged" in last["state"].message
    assert "STATE_NOT_USED" in dict(last["estimate"].values)["remarks"]


def test_a_state_of_another_vehicle_is_kept_and_used_again(desk, warm):
    path, belt = warm
    result_before = path.read_bytes()
    d = desk(state_file=str(path), vehicle="agri3t")
    assert "xgd24d" in d.app.began_with
    d.forward(40.0)  # without a speed
    assert "no speed yet" in d.app.close()
    assert {file.read_bytes() for file in path.parent.iterdir()} == {result_before}
    for _ in range(2):
        d = desk(state_file=str(path), vehicle="agri3t")
        d.drive(0.04, speed=2.0)
        assert "saved" in d.app.close()
        kept = [file for file in path.parent.iterdir() if file.read_bytes() == result_before]
        assert len(kept) == 1
        assert kept[0] != path
    others = path.read_bytes()
    path.write_bytes(others.replace(b"0x1.", b"0x2.", 1))
    damaged = desk(state_file=str(path))
    assert "damaged" in damaged.app.began_with  # and a copy that may be old does not stand in for it
    assert "STATE_NOT_USED" in damaged.names()
    damaged.app.close()
    path.write_bytes(others)
    back = desk(state_file=str(path))
    assert str(kept[0]) in back.app.began_with
    assert "STATE_NOT_USED" not in back.names()
    assert first_belt(back) == pytest.approx(belt, abs=10.0)  # it cools while this runs
    back.app.close()
    assert str(path) in desk(state_file=str(path)).app.began_with
    assert len(list(path.parent.glob("state*"))) == 2  # the one in use, and that of the other vehicle
    assert not kept[0].exists()


REFUSED = {
    "version": lambda content: {**content, "version": 99},
    "values": lambda content: {**content, "key": "../x"},
    "learned": lambda content: {**content, "learning": {"learned": {}}},
}


@pytest.mark.parametrize("what", REFUSED)
def test_no_intact_state_is_lost_whatever_is_refused(desk, warm, topics, what):
    path, _ = warm
    path.write_bytes(seal(REFUSED[what](json.loads(path.read_text()))))
    result_before = path.read_bytes()
    d = desk(state_file=str(path), topics=topics)
    d.forward(40.0)
    with pytest.raises(InputError, match="no speed yet"):
        d.save()
    d.drive(0.04)
    assert path.read_bytes() == result_before
    notice = next(notice for notice in d.app.notices() if notice.name == "STATE_NOT_USED")
    d.save()
    (kept,) = (file for file in path.parent.glob("state*") if file != path)
    assert kept.read_bytes() == result_before != path.read_bytes()
    assert str(kept) in notice.text


def test_an_unwritable_state_folder_is_reported_and_not_fatal(desk, tmp_path):
    (tmp_path / "file").write_text("in the way")
    d = desk(state_file=str(tmp_path / "file" / "state.json"), save_period_s=1.0)
    d.drive(2.5)
    with pytest.raises(InputError, match=r"state\.json"):
        d.save()
    assert "STATE_NOT_SAVED" in d.names()
    count = len(d.published)
    d.drive(0.5)
    assert len(d.published) > count


def test_a_disk_that_takes_no_more_leaves_the_old_file_whole(desk, warm):
    path, _ = warm
    result_before = path.read_text()
    d = desk(state_file=str(path))
    d.drive(1.0)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))  # less than a state file
    try:
        with pytest.raises(InputError, match="too large"):
            d.save()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_text() == result_before
    assert {file.name for file in path.parent.iterdir()} == {"state.json", ".state.json.lock"}
    assert "STATE_NOT_SAVED" in d.names()
    d.save()
    assert "STATE_NOT_SAVED" not in d.names()
    d.forward(20.0)
    assert d.app.overview().saved_s_ago == pytest.approx(20.0)


def test_parts_of_a_saving_that_was_killed_are_cleared_away(desk, warm):
    path, _ = warm
    part = path.with_name(f"{path.name}abc.part")
    part.write_text("{")
    d = desk(state_file=str(path))
    assert not part.exists()
    assert "belts restored from" in d.app.began_with


ODD_NAMES = ["../../etc/x", "/etc/passwd", "a/b", "a_b", "a b", ".", "..", "", "a\nb", "a\0b", "x" * 500]
NAMES = st.text(max_size=60) | st.sampled_from(ODD_NAMES)


@settings(max_examples=40)
@given(st.tuples(NAMES, NAMES, NAMES), st.tuples(NAMES, NAMES, NAMES))
def test_each_node_and_vehicle_has_its_own_plain_state_file_name(one, other):
    for node, namespace, vehicle in (one, other):
        name = state_name(node, namespace, vehicle)
        assert re.fullmatch(r"[A-Za-z0-9_]*-[0-9a-f]{12}\.json", name)
        assert len(name) < 200
    levels = [tuple(filter(None, namespace.split("/"))) for _, namespace, _ in (one, other)]
    alike = (levels[0], one[0], one[2]) == (levels[1], other[0], other[2])
    assert (state_name(*one) == state_name(*other)) is alike


def test_in_simulated_time_or_by_request_no_state_is_kept():
    assert state_path("auto", True, "trackres", "/", "xgd24d") == (None, "")
    assert state_path("none", False, "trackres", "/", "xgd24d") == (None, "")


def test_a_vehicle_named_like_a_path_has_its_state_in_the_folder(desk, monkeypatch, tmp_path, repository):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    text = (repository / "config" / "xgd24d.yaml").read_text()
    vehicle = tmp_path / "mine.yaml"
    vehicle.write_text(re.sub(r"(?m)^name:.*$", "name: ../../../x", text).replace("rubber/", f"{repository}/config/rubber/"))
    d = desk(vehicle=str(vehicle), state_file="auto")
    d.drive(0.1)
    d.save()
    assert [path.parent for path in tmp_path.rglob("*.json")] == [tmp_path / "state" / "trackres"]


def test_without_a_home_it_runs_and_says_that_no_state_is_kept(desk, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache_dir().parent))
    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.delenv("XDG_STATE_HOME", raising=False)
    monkeypatch.setattr("pathlib.Path.home", lambda: (_ for _ in ()).throw(RuntimeError("no home")))
    d = desk(state_file="auto")
    d.drive(0.5)
    assert d.published
    assert "home" in d.app.began_with
    assert "STATE_NOT_SAVED" in d.names()
    assert d.app.close() == "no state is saved"
