# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Learning over a recording: the numbers of the live session, to the bit and twice, and a vehicle file that starts from them."""

import copy
import csv
import json
import re

import numpy as np
import pytest

import trackres_ros as tr
from trackres_ros.estimator import columns as layout
from trackres_ros.learning.store import write_learned

MINUTES = 18.0


@pytest.fixture(scope="module")
def recording(reference, tmp_path_factory):
    """A drive of a vehicle whose belts lose a fifth more than its file says."""
    path = tmp_path_factory.mktemp("drive") / "drive.csv"
    session, random = reference.session(), np.random.default_rng(4)
    session.learned[layout.Learned.on], layout.Learned(session.learned).departures[layout.OF_LOSS] = 1.0, 0.2
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["time_s", "speed_mps", "torque_nm"])
        for i in range(round(MINUTES * 600)):
            stamp, speed = 10**18 + i * 10**8, 8.0 + 6.0 * np.sin(i / 600.0)
            torque = session.handle(layout.SPEED, stamp, stamp, speed)["drive_torque_nm"]
            table.writerow([f"{i / 10:.1f}", f"{speed:.6f}", f"{torque + random.normal(0.0, 30.0):.3f}"])
    return path


@pytest.fixture(scope="module")
def on(recording):
    return tr.replay(recording, "xgd24d", learning="on")


@pytest.fixture(scope="module")
def watched(recording):
    return tr.replay(recording, "xgd24d", learning="watch", save_vehicle=recording.with_name("learned.yaml"))


def test_twice_the_same_bytes(halves, tmp_path):
    for name in ("a", "b"):
        tr.replay(halves[0], "xgd24d", learning="on", output=tmp_path / f"{name}.csv")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


@pytest.fixture(scope="module")
def halves(recording):
    """The second half of the drive, and the state after the first one with learned values that act."""
    lines = recording.read_text().splitlines(keepends=True)
    half = len(lines) // 2
    first_path, second_path, state = (recording.with_name(name) for name in ("first.csv", "second.csv", "state.json"))
    first_path.write_text("".join(lines[:half]))
    second_path.write_text("".join([lines[0], *lines[half:]]))
    tr.replay(first_path, "xgd24d", learning="on", save_state=state)
    return second_path, state


def test_stopped_and_resumed_it_learns_what_it_would_have(on, halves):
    second_path, state = halves
    replay = tr.replay(second_path, "xgd24d", learning="on", resume=state)
    for column in ("resistance_torque_nm", "learned_loss_modulus_scale", "learned_loss_modulus_scale_std"):
        assert np.array_equal(replay[column], on[column][-len(replay[column]) :]), column


def test_resumed_a_hundred_days_later_it_is_less_sure(halves, tmp_path):
    second_path, state = halves
    head, *lines = second_path.read_text().splitlines()[:301]
    stds = []
    for days in (0.0, 100.0):
        path = tmp_path / f"after_{days:g}.csv"
        rows = [line.split(",", 1) for line in lines]
        path.write_text("\n".join([head, *(f"{float(time) + days * 86400.0:.1f},{columns}" for time, columns in rows)]))
        learner = tr.replay(path, "xgd24d", learning="watch", resume=state).learner
        stds.append(np.sqrt(np.diag(learner.learned.covariance)[[layout.OF_BEARING, layout.OF_DRAG]]))
    prior_stds = np.sqrt(np.diag(learner.prior.covariance)[[layout.OF_BEARING, layout.OF_DRAG]])
    assert stds[1] - stds[0] == pytest.approx(np.minimum(0.5 * prior_stds * 100.0 / 365.0, prior_stds - stds[0]), rel=0.3)


def test_a_run_without_learning_stops_no_ageing(halves, tmp_path):
    """Fifty days, such a run, and fifty days, or a hundred at once."""
    second_path, state = halves
    head, *lines = second_path.read_text().splitlines()[:301]
    start_s = float(lines[0].split(",", 1)[0])
    rows = [line.split(",", 1) for line in lines]
    middle_state = tmp_path / "between.json"
    stds = []
    for days, start_state in ((50.0, state), (50.0, middle_state), (100.0, state)):
        path, learning = tmp_path / "short.csv", "off" if start_state is state and days == 50.0 else "watch"
        of_row = (f"{float(time) - start_s:.1f},{columns},{days * 86400.0:g}" for time, columns in rows)
        path.write_text("\n".join([f"{head},stood_s", *of_row]))
        replay = tr.replay(
            path, "xgd24d", learning=learning, resume=start_state, save_state=middle_state if learning == "off" else None
        )
        stds += [replay.learner.learned.covariance[layout.OF_DRAG, layout.OF_DRAG] ** 0.5] if replay.learner else []
    assert stds[0] == pytest.approx(stds[1], rel=0.01)


def test_resumed_no_learned_value_acts_in_another_mode_than_on(recording, on, halves):
    second_path, state = halves
    off_replay, watch_replay = (tr.replay(second_path, "xgd24d", learning=mode, resume=state) for mode in ("off", "watch"))
    control = tr.replay(recording, "xgd24d")
    tail = slice(-len(off_replay["time_s"]), None)
    assert (on["resistance_torque_nm"][tail] > 1.05 * control["resistance_torque_nm"][tail]).mean() > 0.9
    for column in set(off_replay.columns) - {"time_s"}:
        assert np.array_equal(off_replay[column], watch_replay[column], equal_nan=True), column
        start = 50 if column == "feedforward_torque_nm" else 0  # it goes on from where it was
        # The belts' uncertainty still has a trace of the torque that acted before.
        assert np.allclose(off_replay[column][start:], control[column][tail][start:], rtol=1e-7, atol=1e-9, equal_nan=True), (
            column
        )


def test_a_replay_without_learning_keeps_what_was_learned(halves, tmp_path):
    second_path, state = halves
    tr.replay(second_path, "xgd24d", resume=state, save_state=tmp_path / "state.json")
    old_content, new_content = (json.loads(path.read_text()) for path in (state, tmp_path / "state.json"))
    assert old_content["learning"] == new_content["learning"]


def test_watching_leaves_every_column_of_the_estimate_as_it_is(recording, watched):
    off_replay = tr.replay(recording, "xgd24d")
    for column in off_replay.columns:
        assert np.array_equal(off_replay[column], watched[column], equal_nan=True), column
    assert watched["learned_resistance_torque_nm"][-1] > 1.05 * off_replay["resistance_torque_nm"][-1]


def test_the_vehicle_file_it_leaves_starts_from_what_was_learned(recording, watched):
    replay = tr.replay(recording, recording.with_name("learned.yaml"))
    tail = slice(-600, None)  # with values learned by then, over the whole distance
    assert replay["resistance_torque_nm"][tail] == pytest.approx(watched["learned_resistance_torque_nm"][tail], rel=0.02)
    assert replay["resistance_std_nm"][-1] < 0.6 * watched["resistance_std_nm"][-1]


def test_the_vehicle_file_has_what_is_printed_even_if_that_lags(watched, tmp_path):
    learner, old_vehicle = copy.deepcopy(watched.learner), tr.load_vehicle("xgd24d")
    learner.learned.applied[:] = 0.0
    file = write_learned(learner, old_vehicle, tmp_path / "v.yaml")
    new_vehicle, output = tr.load_vehicle(tmp_path / "v.yaml"), str(watched).splitlines()
    assert learner.has_evidence[layout.OF_LOSS]
    assert file.changed["rubber.loss_modulus_scale"][1] == pytest.approx(1.2, abs=0.02)
    for path, (old_value, new_value) in file.changed.items():
        assert (old_vehicle.parameters[path].value, new_vehicle.parameters[path].value) == (old_value, new_value)
        assert any(line.startswith(f"  {path} ") and " -> " in line for line in output)
    for path, value in file.kept.items():
        assert old_vehicle.parameters[path].value == new_vehicle.parameters[path].value == value
        assert any(line.startswith(f"  {path} ") and "as before" in line for line in output)
    assert file.kept
    assert not set(file.kept) & set(file.changed)


def test_no_unlearned_vehicle_file_is_there_first(recording, watched, tmp_path, monkeypatch):
    contents = []
    monkeypatch.setattr("os.fsync", lambda _: contents.extend(path.read_bytes() for path in tmp_path.glob("v.yaml*")))
    write_learned(watched.learner, tr.load_vehicle("xgd24d"), tmp_path / "v.yaml")
    assert set(contents) == {(tmp_path / "v.yaml").read_bytes()} == {recording.with_name("learned.yaml").read_bytes()}


def test_without_anything_learned_no_file_is_written_with_why(recording, tmp_path, good):
    lines = recording.read_text().splitlines(keepends=True)
    (tmp_path / "short.csv").write_text("".join(lines[:600]))
    command = ["replay", tmp_path / "short.csv", "--vehicle", "xgd24d", "--learning", "watch"]
    rows_path, vehicle_path = tmp_path / "out.csv", tmp_path / "same.yaml"
    output = good(*command, "--save-vehicle", vehicle_path, "-o", rows_path)
    assert re.search(f"(?m)^Not written: {re.escape(str(vehicle_path))}: learning: .* of the required driving is done$", output)
    assert str(vehicle_path) not in output.splitlines()[-1]
    result = json.loads(good(*command, "--save-vehicle", vehicle_path, "-o", rows_path, "--json"))
    assert str(vehicle_path) not in result["written"]
    assert result["learning"]["vehicle_file"]["changed"] == {}
    assert not vehicle_path.exists()


def test_the_command_says_what_was_learned_and_draws_it(recording, tmp_path, good, trackres):
    pytest.importorskip("matplotlib")
    summary = json.loads(
        good("replay", recording, "--vehicle", "xgd24d", "--learning", "watch", "-o", tmp_path / "out.csv", "--json")
    )
    names = [entry["name"] for entry in summary["learning"]["parameters"]]
    assert names[:2] == ["loss_modulus_scale", "bearing_friction"]
    assert (tmp_path / "out.png").stat().st_size > 10_000
    answer = trackres("replay", recording, "--vehicle", "xgd24d", "--learning", "fast", "-o", tmp_path / "x.csv")
    assert answer.returncode == 2
    assert "off, watch, on" in answer.stderr
    answer = trackres("replay", recording, "--vehicle", "xgd24d", "--save-vehicle", tmp_path / "v.yaml", "-o", tmp_path / "x.csv")
    assert answer.returncode == 2
    assert "with learning watch or on" in answer.stderr


def test_a_delay_is_told_and_gone_once_the_topics_file_has_it(tmp_path, reference):
    """0.25 s of delay on a drive that now and then changes its speed."""
    random, speed, accel, torques = np.random.default_rng(5), 8.0, 0.0, []
    session, targets = reference.session(), np.repeat(random.uniform(4.0, 14.0, 60), 400)
    with (tmp_path / "drive.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["time_s", "speed_mps", "torque_nm"])
        inertia = reference.vehicle.chassis.rotating_mass_factor * 272e3 / 9.80665 * 0.3575
        for i, aim in enumerate(targets[:12_000].tolist()):
            accel += (min(max((aim - speed) / 1.5, -0.6), 0.5) - accel) * 0.05 / 0.6
            speed += accel * 0.05
            stamp = 10**18 + i * 50_000_000
            estimate = session.handle(layout.SPEED, stamp, stamp, speed)
            torques.append(estimate["drive_torque_nm"] - estimate["inertia_nm"] + inertia * accel + random.normal(0.0, 40.0))
            table.writerow([f"{i / 20:.2f}", f"{round(speed / 0.03) * 0.03:.2f}", f"{torques[max(i - 5, 0)]:.1f}"])
    topics = tmp_path / "topics.yaml"
    topics.write_text("speed: {column: speed_mps}\ntorque: {column: torque_nm, delay_s: 0.25}\n")
    base_replay = tr.replay(tmp_path / "drive.csv", "xgd24d", learning="watch")
    fixed_replay = tr.replay(tmp_path / "drive.csv", "xgd24d", learning="watch", topics=topics)
    for result, delay in ((base_replay, 0.25), (fixed_replay, 0.0)):
        assert result["learned_torque_delay_s"][-1] == pytest.approx(delay, abs=0.03)
        assert result["learned_torque_delay_std_s"][-1] < 0.01
        assert result["learned_torque_delay_state"][-1] == 1.0
    assert "delay of the measured torque" in str(base_replay)
