# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Saved and taken up again."""

import json
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import trackres_ros as tr
from trackres_ros.errors import InputError
from trackres_ros.estimator import snapshot
from trackres_ros.estimator.columns import Belt
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.plausible import NOTHING_TRACKED
from trackres_ros.route.follower import NOTHING_YET
from trackres_ros.vehicle import load_any

START = 1_700_000_000_000_000_000
MS = 1_000_000


def messages(n):
    random = np.random.default_rng(2)
    stamp = START + np.arange(n, dtype=np.int64) * 20 * MS
    return np.zeros(n, dtype=np.int16), stamp, stamp, 8 + random.normal(0, 0.1, n)


def driven(estimator, count):
    session = estimator.session()
    session.handle_block(*messages(count))
    return session


@pytest.fixture
def state(reference, tmp_path):
    """A state file of the reference vehicle."""
    path = tmp_path / "state.json"
    snapshot.save(driven(reference, 100), path, saved_at=1.0)
    return path


@pytest.mark.parametrize("name", ["xgd24d", "ztbus_hess19"])
def test_resumed_is_bit_equal_to_never_stopped(name, tmp_path):
    block, estimator = messages(3000), Estimator(load_any(name))
    full_run, first_session = estimator.session().handle_block(*block), estimator.session()
    first_part = first_session.handle_block(*(part[:1234] for part in block))
    snapshot.save(first_session, tmp_path / "state.json", saved_at=1.0)
    second_part = snapshot.resume(estimator, tmp_path / "state.json").handle_block(*(part[1234:] for part in block))
    assert np.array_equal(full_run.rows, np.concatenate([first_part.rows, second_part.rows]), equal_nan=True)


def test_a_resumed_replay_reports_its_own_messages_alone(tmp_path):
    lines = [f"{t},{60.0 if t % 3 else 5.0}" for t in range(90)]
    for name, rows in (("bad", lines), ("good", [f"{t},5.0" for t in range(90, 120)])):
        (tmp_path / f"{name}.csv").write_text("\n".join(["time_s,speed_mps", *rows]))
    first_summary = tr.replay(tmp_path / "bad.csv", "xgd24d", save_state=tmp_path / "state.json").as_dict()
    second_summary = tr.replay(tmp_path / "good.csv", "xgd24d", resume=tmp_path / "state.json").as_dict()
    assert first_summary["remarks"]
    assert sum(first_summary["counters"]["speed"].values()) >= first_summary["messages"] == 90
    assert second_summary["counters"]["speed"]["accepted"] == second_summary["messages"] == 30
    assert not second_summary["remarks"]
    assert max(reason["steps"] for reason in second_summary["reasons"]) == second_summary["steps"] == 30


@pytest.mark.parametrize(("stood", "off_s"), [("", 0.0), ("0", 0.0), ("1800", 1800.0)])
def test_times_that_begin_anew_are_after_the_recorded_time_off(reference, tmp_path, stood, off_s):
    state = tmp_path / "state.json"
    rows = [f"{0.5 * i},8,15,{stood}" for i in range(2000)]
    for name, part in (("first", rows), ("second", rows[:9]), ("on", [f"9{rows[-1]}"])):
        (tmp_path / f"{name}.csv").write_text("\n".join(["time_s,speed_mps,ambient_degc,stood_s", *part]))
    tr.replay(tmp_path / "first.csv", "xgd24d", save_state=state)
    replay = tr.replay(tmp_path / "second.csv", "xgd24d", resume=state)
    session, _ = snapshot.after_time_off(reference, state, wall_s=999.5 + off_s)
    assert replay["belt_degc/front_left"][0] == session.belts[0, 0, Belt.temperature] > 17.0
    assert not replay.as_dict()["remarks"]
    assert f"after {off_s:g} s off" in replay.notes[-1]
    assert "s off" not in str(tr.replay(tmp_path / "on.csv", "xgd24d", resume=state).notes)


def test_time_off_cools_the_belt(reference, tmp_path):
    session = driven(reference, 60_000)
    warm = session.belts[0, 0, 0]
    snapshot.save(session, tmp_path / "state.json", saved_at=1000.0)
    soon_session, off_s = snapshot.after_time_off(reference, tmp_path / "state.json", wall_s=1600.0, ambient=0.0)
    late_session, _ = snapshot.after_time_off(reference, tmp_path / "state.json", wall_s=1000.0 + 86400, ambient=0.0)
    assert off_s == 600.0
    assert 0.0 < soon_session.belts[0, 0, 0] < warm
    assert late_session.belts[0, 0, 0] == pytest.approx(0.0, abs=0.01)
    estimate = soon_session.handle(0, START, START, 8.0)
    assert estimate.belt_degc()[0] == pytest.approx(soon_session.belts[0, 0, 0], abs=1e-9)


def test_a_clock_that_went_back_counts_as_no_time_off(reference, tmp_path):
    session = driven(reference, 2000)
    snapshot.save(session, tmp_path / "state.json", saved_at=1000.0)
    new_session, off_s = snapshot.after_time_off(reference, tmp_path / "state.json", wall_s=10.0)
    assert off_s == -990.0
    assert new_session.belts[0, 0, 0] == pytest.approx(session.belts[0, 0, 0], abs=1e-9)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda data: b"", "damaged"),
        (lambda data: bytes(300), "damaged"),
        (lambda data: snapshot.HEAD, "damaged"),
        (lambda data: data[: len(data) // 2], "damaged"),
        (lambda data: b"[1, 2]", "another kind"),
        (lambda data: b"time_s,speed_mps\n0.0,5.0\n", "another kind"),
        (lambda data: b"\x89MCAP0\r\n", "another kind"),
        (lambda data: b'{"format": "trackres-report"}', "another kind"),
        (lambda data: b"x" * (snapshot.LARGEST + 1), "a file of this kind"),
        (lambda data: data.replace(b'"version": %d' % snapshot.VERSION, b'"version": 99'), "version 99"),
        (lambda data: data.replace(b'"version": %d' % snapshot.VERSION, b'"version": 5'), "version 5"),
        (lambda data: data.replace(b'"belts"', b'"bolts"'), "checksum"),
        (lambda data: data.replace(b"0x1.", b"oops", 1), "checksum"),
        (lambda data: data + b" ", "checksum"),
        (lambda data: b"[" * 100_000, "another kind"),
        (lambda data: snapshot.HEAD + b', "a": ' + b"[" * 100_000, "damaged"),
        (lambda data: snapshot.HEAD + b', "a": ' + b'{"a":' * 100_000, "damaged"),
        (lambda data: snapshot.HEAD + b', "a": ' + b"9" * 5000 + b"}", "damaged"),
    ],
)
def test_a_file_that_is_not_right_says_why_and_stays(reference, state, damage, said):
    state.write_bytes(damage(state.read_bytes()))
    with pytest.raises(InputError, match=said) as refusal:
        snapshot.resume(reference, state)
    assert "delete" not in str(refusal.value)
    with pytest.raises(InputError, match=said):
        snapshot.after_time_off(reference, state, wall_s=2.0)


def test_a_state_of_another_vehicle_is_refused(carrier, state):
    with pytest.raises(InputError, match="xgd24d"):
        snapshot.resume(carrier, state)


@pytest.mark.parametrize(
    ("part", "other", "is_another"),
    [
        ("hysteresis: spectral", "hysteresis: rainflow", True),
        ("thermal: lumped", "thermal: core_surface", True),
        ("film_speed_unit: m/s", "film_speed_unit: km/h", True),
        ("name: front_right, axle: front", "name: front_right, axle: rear", True),
        ("front: 1, rear: 2", "front: 2, rear: 1", True),
        ("sweep_frequency: {value: 10.0", "sweep_frequency: {value: 10.5", True),
        ("title: 24 t", "title: 25 t", False),
        ("the paper's DMA test frequency", "of the paper", False),
    ],
)
def test_a_state_is_of_all_of_a_vehicle_file_that_acts(reference, tmp_path, repository, part, other, is_another):
    text = (repository / "config" / "xgd24d.yaml").read_text()
    assert text.count(part) == 1
    new_text = text.replace(part, other).replace("[10.0, 10.0]", "[10.0, 10.5]")
    (tmp_path / "edited.yaml").write_text(new_text.replace("rubber/", f"{repository}/config/rubber/"))
    assert (snapshot.key(Estimator(load_any(tmp_path / "edited.yaml"))) != snapshot.key(reference)) is is_another


@pytest.fixture(scope="module")
def saved(reference):
    """A state file of a drive, as bytes."""
    return snapshot.content(driven(reference, 500), 1.0)


def taken(estimator, path, data):
    """Result of a file: the content of the session, or None if refused; nothing else may happen."""
    path.write_bytes(data)
    try:
        return snapshot.content(snapshot.resume(estimator, path), 1.0)
    except InputError as error:
        refusal = str(error)
    assert str(path) in refusal
    assert "\n" not in refusal
    return None


def mutated(data, random):
    """One to three bytes changed, cut out, doubled or put in, or the file cut."""
    content = bytearray(data)
    for _ in range(random.integers(1, 4)):
        place, length = int(random.integers(0, len(content))), int(random.integers(1, 30))
        kind = random.integers(0, 5)
        if kind == 0:
            content[place] = int(random.integers(0, 256))
        elif kind == 1:
            del content[place : place + length]
        elif kind == 2:
            content[place:place] = content[place : place + length]
        elif kind == 3:
            content[place:place] = random.bytes(length)
        else:
            del content[place + 1 :]
    return bytes(content)


@pytest.mark.parametrize("seed", range(3))
def test_a_mutated_file_is_refused_or_gives_the_same_state(reference, saved, tmp_path, seed):
    random = np.random.default_rng(seed)
    for _ in range(100):
        data = mutated(saved, random)
        assert taken(reference, tmp_path / "state.json", data) in (None, saved if data == saved else None)


def test_states_of_two_versions_have_two_keys(reference, monkeypatch):
    old_key = snapshot.key(reference)
    monkeypatch.setattr(snapshot, "VERSION", snapshot.VERSION + 1)
    assert snapshot.key(reference) != old_key


WRONG = [math.nan, math.inf, -1e300, 1e300, -(1 << 70), 1 << 70, "abc", None, True, [], {}, [[]], "0x1p+1000", "nan", "-0x1p+900"]


@settings(max_examples=150)
@given(
    name=st.sampled_from([*snapshot.FLOATS, *snapshot.INTEGERS, "saved_at", "started"]),
    place=st.integers(0, 10_000),
    wrong=st.sampled_from(WRONG),
)
@example(name="saved_at", place=0, wrong="abc")
def test_an_impossible_number_is_refused_despite_a_valid_seal(reference, saved, name, place, wrong):
    content = json.loads(saved)
    if isinstance(content[name], list):
        index = place % len(content[name])
        at_first = {"followed": NOTHING_YET, "tracked": NOTHING_TRACKED}.get(name)
        may_be_nan = name in ("effects", "values", "runs") or (at_first is not None and math.isnan(at_first[index]))
        if content[name][index] == wrong or (may_be_nan and wrong == "nan"):
            return
        content[name][index] = wrong
    else:
        content[name] = wrong
        if name == "started" and wrong is True:
            return
    with tempfile.TemporaryDirectory() as folder:
        assert taken(reference, Path(folder) / "state.json", snapshot.seal(content)) is None


@pytest.mark.parametrize("name", [*snapshot.FLOATS, *snapshot.INTEGERS])
@pytest.mark.parametrize("change", [lambda a: a[:-1], lambda a: [*a, a[-1]], lambda a: [a], lambda a: "abc", lambda a: []])
def test_arrays_of_another_length_are_refused(reference, saved, tmp_path, name, change):
    content = json.loads(saved)
    content[name] = change(content[name])
    assert taken(reference, tmp_path / "state.json", snapshot.seal(content)) is None


@pytest.mark.parametrize("missing", [*snapshot.FLOATS, *snapshot.INTEGERS, "format", "version", "key", "saved_at", "started"])
def test_a_part_that_is_missing_is_refused(reference, saved, tmp_path, missing):
    content = json.loads(saved)
    del content[missing]
    assert taken(reference, tmp_path / "state.json", snapshot.seal(content)) is None


@settings(max_examples=60)
@given(
    speeds=st.lists(st.floats(-25.0, 25.0), min_size=1, max_size=40),
    steps=st.lists(st.sampled_from([1, 1000, MS, 20 * MS, 900 * MS, 10_000 * MS, 100_000 * MS]), min_size=40, max_size=40),
)
def test_any_state_that_was_saved_is_taken_up(reference, tmp_path_factory, speeds, steps):
    stamp = START + np.cumsum(np.array(steps[: len(speeds)], dtype=np.int64))
    session = reference.session()
    session.handle_block(np.zeros(len(speeds), dtype=np.int16), stamp, stamp, np.array(speeds))
    data = snapshot.content(session, 1.0)
    assert taken(reference, tmp_path_factory.getbasetemp() / "any.json", data) == data


def test_what_is_not_a_file_is_named_at_once_and_never_replaced(reference, tmp_path):
    pipe, folder, link = tmp_path / "pipe", tmp_path / "folder", tmp_path / "link"
    os.mkfifo(pipe)
    folder.mkdir()
    link.symlink_to(link)
    device = Path("/dev/zero")
    for path, said in ((pipe, "named pipe"), (folder, "folder"), (device, "device"), (link, "symbolic")):
        with pytest.raises(InputError, match=said):
            snapshot.resume(reference, path)
    session = reference.session()
    for path in (pipe, folder, device):
        with pytest.raises(OSError, match="a "):
            snapshot.save(session, path, 1.0)
    assert pipe.is_fifo()
    assert device.is_char_device()


def test_a_huge_file_is_not_read(reference, tmp_path):
    path = tmp_path / "state.json"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(InputError, match="a file of this kind"):
        snapshot.resume(reference, path)


@pytest.mark.long
def test_the_cli_refuses_each_file_in_one_line_without_waiting(tmp_path, trackres):
    drive = tmp_path / "drive.csv"
    drive.write_text("time_s,speed_mps\n" + "".join(f"{i * 0.1:.1f},5.0\n" for i in range(50)))
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "deep").write_text("[" * 100_000)
    (tmp_path / "bytes").write_bytes(b"\xff\xfe{}")
    base = ["replay", str(drive), "--vehicle", "xgd24d", "-o", str(tmp_path / "o.csv"), "--resume"]
    for name in ("pipe", "deep", "bytes", "missing"):
        if name == "pipe":  # a process of its own, as it might wait for a writer
            command = [sys.executable, "-m", "trackres_ros", *base, str(tmp_path / name)]
            process = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        else:
            process = trackres(*base, tmp_path / name)
        assert process.returncode == 2, process.stderr
        assert process.stderr.count("\n") == 1
        assert name in process.stderr


def test_a_missing_file_is_named(reference, tmp_path):
    with pytest.raises(InputError, match=r"nothing\.json"):
        snapshot.resume(reference, tmp_path / "nothing.json")


def test_a_save_that_fails_leaves_the_old_file_whole(reference, state, monkeypatch):
    old_content = state.read_bytes()

    def raise_full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", raise_full)
    with pytest.raises(OSError, match="No space"):
        snapshot.save(driven(reference, 200), state, saved_at=2.0)
    assert state.read_bytes() == old_content
    assert [p.name for p in state.parent.iterdir()] == ["state.json"]
    assert json.loads(old_content)["saved_at"] == 1.0
