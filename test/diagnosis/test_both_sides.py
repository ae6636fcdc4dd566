# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A replay with the acceleration from both sides has the error of the diagnosis, and the live filter follows the data's noise."""

import copy
from dataclasses import replace

import numpy as np
import pytest

import trackres_ros as tr
from trackres_ros.diagnosis import load_base, read_recordings
from trackres_ros.diagnosis.prepare.gate import RECORDED_ACCELERATION, gate, with_acceleration
from trackres_ros.diagnosis.prepare.resample import smoothed_motion

RATE_HZ = 20.0


def singer(noise, std, time, rng, seconds=900.0):
    """Times [s], true accelerations [m/s^2], and speeds [m/s] with noise, of Singer's model that a driver keeps near 7 m/s."""
    sample_times = np.arange(0.0, seconds, 1.0 / RATE_HZ)
    keep = np.exp(-1.0 / RATE_HZ / time)
    own, accel, speed = 0.0, np.zeros(len(sample_times)), np.full(len(sample_times), 7.0)
    for i, kick in enumerate(rng.normal(0.0, std * np.sqrt(1.0 - keep**2), len(sample_times) - 1), start=1):
        own = keep * own + kick
        accel[i] = own - 0.2 * (speed[i - 1] - 7.0)
        speed[i] = speed[i - 1] + accel[i] / RATE_HZ
    return sample_times, accel, speed + rng.normal(0.0, noise, len(sample_times))


def table(folder, at, speed, **more):
    path = folder / "drive.csv"
    columns = {"time_s": at, "speed_mps": speed, **more}
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")
    return path


@pytest.fixture(scope="module")
def drive(recorded, tmp_path_factory):
    """A recording with turning scrub, without its acceleration."""
    head, *rows = (line.split(",") for line in recorded("turning_scrub")[1].read_text().splitlines())
    accel = head.index("accel_mps2")
    path = tmp_path_factory.mktemp("both") / "drive.csv"
    path.write_text("\n".join(",".join(row[:accel] + row[accel + 1 :]) for row in (head, *rows)) + "\n")
    return path


@pytest.fixture(scope="module")
def session(drive, loaded):
    (session,) = gate(read_recordings([drive], None), loaded.known).sessions
    return session


@pytest.fixture(scope="module")
def report(scrub_result, session, tmp_path_factory):
    """A report of recordings without an acceleration."""
    result = copy.copy(scrub_result[0])
    d = result.diagnosis
    sessions = [replace(item, live_filter=session.live_filter, computed=frozenset(["accel"])) for item in d.gated.sessions]
    result.diagnosis = replace(d, gated=replace(d.gated, sessions=sessions))
    assert "--params estimator.yaml" in repr(result)
    return result.report(tmp_path_factory.mktemp("report") / "report", page=False)


def test_a_replay_reproduces_the_errors_of_a_diagnosis(drive, session, report):
    base = load_base(report / "vehicle.yaml").base
    (prediction,) = base.predict([session], base.nominal, ())
    expectation = np.abs(session.torque - prediction.torque)[session.used].mean()
    result = tr.replay(drive, report / "vehicle.yaml", both_sides=True).as_dict()["comparison"]
    assert result["step_s"] == session.step
    assert result["steps"] == session.used.sum()
    assert result["mean_error_nm"] == pytest.approx(expectation, rel=0.03)


def test_both_sides_and_fitted_settings_lower_the_error(drive, report):
    ways = {"both": {"both_sides": True}, "fitted": {"params": report / "estimator.yaml"}, "assumed": {}}
    results = {name: tr.replay(drive, report / "vehicle.yaml", **way) for name, way in ways.items()}
    error = {name: np.nanmean(np.abs(result["residual_nm"])) for name, result in results.items()}
    assert error["both"] < error["fitted"] < error["assumed"]


@pytest.mark.parametrize(("noise", "std", "time"), [(0.003, 0.2, 2.0), (0.03, 0.6, 3.0), (0.01, 1.0, 1.0)])
def test_the_live_filter_has_the_noise_and_jerk_of_the_speeds(noise, std, time):
    place, _, shown = singer(noise, std, time, np.random.default_rng(5))
    live = smoothed_motion(place, shown, place, 1.0, 0.3).live
    assert live.speed_std_mps == pytest.approx(noise, rel=0.3)
    jerk, of_live = std**2 / time, live.acceleration_std**2 / live.acceleration_time_s
    assert of_live == pytest.approx(jerk, rel=0.5)


def test_the_acceleration_is_that_of_the_motion(tmp_path, xgd24d):
    place, accel, shown = singer(0.01, 0.5, 3.0, np.random.default_rng(7))
    path = table(tmp_path, place, shown)
    of_both, of_past = (tr.replay(path, xgd24d, both_sides=pair)["accel_mps2"] for pair in (True, False))
    pair, past = (np.sqrt(np.mean((result - accel)[200:-200] ** 2)) for result in (of_both, of_past))
    assert pair < 0.75 * past


def test_other_messages_keep_their_order_and_number(tmp_path):
    place, _, shown = singer(0.01, 0.5, 3.0, np.random.default_rng(9), seconds=60.0)
    shown[7] = np.nan
    recording = tr.read(table(tmp_path, place, shown, ambient_degc=np.full(len(place), 12.0)))
    wider = with_acceleration(recording, load_base("xgd24d").known)
    (result_before,), (result_after,) = recording.blocks(10**6), wider.blocks(10**6)
    others = result_after.role < len(recording.roles)
    for name in ("role", "stamp_ns", "arrival_ns", "value"):
        np.testing.assert_array_equal(getattr(result_after, name)[others], getattr(result_before, name))
    of_speed = wider.roles.index("speed")
    assert (result_after.role[np.flatnonzero(~others) + 1] == of_speed).all()


def test_a_recorded_acceleration_is_kept_with_a_note(tmp_path, xgd24d):
    place, accel, shown = singer(0.01, 0.5, 3.0, np.random.default_rng(11), seconds=60.0)
    result = tr.replay(table(tmp_path, place, shown, accel_mps2=accel), xgd24d, both_sides=True)
    assert RECORDED_ACCELERATION in result.notes
    np.testing.assert_allclose(result["accel_mps2"], accel, atol=1e-6)


def test_a_role_without_a_sample_is_no_recorded_acceleration(tmp_path):
    place, _, shown = singer(0.01, 0.5, 3.0, np.random.default_rng(11), seconds=60.0)
    empty = table(tmp_path, place, shown, accel_mps2=np.full(len(place), np.nan))
    result = with_acceleration(tr.read(empty), load_base("xgd24d").known)
    assert np.isfinite(result.series["accel"].value).sum() > 0.9 * len(place)
    assert RECORDED_ACCELERATION not in result.notes


def test_without_a_torque_it_says_why_no_error_is_compared(tmp_path, xgd24d):
    place, _, shown = singer(0.01, 0.5, 3.0, np.random.default_rng(13), seconds=200.0)
    result = tr.replay(table(tmp_path, place, shown), xgd24d, both_sides=True)
    assert "comparison" not in result.as_dict()
    assert any("no error as a diagnosis has it" in note and "torque" in note for note in result.notes)


def test_one_speed_has_no_acceleration(tmp_path, xgd24d):
    with pytest.raises(tr.InputError, match="1 usable speed"):
        tr.replay(table(tmp_path, np.array([0.0]), np.array([3.0])), xgd24d, both_sides=True)
