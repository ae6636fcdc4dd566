# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Unrecorded friction brakes: torques of motor braking alone are compared, assisted ones are not."""

from dataclasses import replace

import numpy as np
import pytest
from csv_tables import written

from trackres_ros.diagnosis import load_base, read_recordings
from trackres_ros.diagnosis.prepare.gate import gate
from trackres_ros.diagnosis.prepare.resample import motor_brakes_alone
from trackres_ros.diagnosis.synthetic import drives

NOISE_NM = 6.0


@pytest.fixture(scope="module")
def loaded():
    return load_base("bmw_i3")


def found(loaded, motor, seed=1):
    """The torque down to which a motor brakes alone that takes a share of the torques of drives; `motor` says which."""
    rng = np.random.default_rng(seed)
    sessions = drives(loaded.base, 30.0, 3, 15.0, rng, step=1.0)
    torques = [p.torque for p in loaded.base.predict(sessions, loaded.base.nominal, ())]
    shown_texts = [
        replace(s, torque=motor(t, rng) + rng.normal(0.0, NOISE_NM, len(t))) for s, t in zip(sessions, torques, strict=True)
    ]
    return motor_brakes_alone(shown_texts, [np.abs(s.speed) > 0.5 for s in shown_texts]), min(t.min() for t in torques)


@pytest.mark.parametrize("most", [50.0, 80.0])
def test_a_motor_at_its_limit_is_told_from_one_that_brakes_alone(loaded, most):
    alone, _ = found(loaded, lambda torque, _: np.maximum(torque, -most))
    assert -most - 2.0 * NOISE_NM < alone < -0.5 * most


def test_without_friction_brakes_the_motor_does_all_braking(loaded):
    alone, least = found(loaded, lambda torque, _: torque)
    assert alone < 0.9 * least


def test_brakes_that_always_take_half_leave_nothing_to_compare(loaded):
    alone, least = found(loaded, lambda torque, _: np.where(torque < 0.0, 0.5 * torque, torque))
    assert alone > 0.35 * least


def test_brakes_used_at_random_at_any_torque_leave_no_comparison(loaded):
    def now_and_then(torque, rng):
        return np.where((torque < 0.0) & (rng.random(len(torque)) < 0.4), 0.0, torque)

    alone, least = found(loaded, now_and_then)
    assert alone > 0.2 * least


def test_too_little_driving_tells_nothing(loaded):
    rng = np.random.default_rng(1)
    (session,) = drives(loaded.base, 30.0, 1, 4.0, rng, step=1.0)
    session = replace(session, torque=rng.normal(0.0, 100.0, len(session)))
    assert motor_brakes_alone([session], [np.abs(session.speed) > 0.5]) == 0.0


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("brakes", [True, False])
def test_the_gate_says_down_to_where_it_compares(loaded, tmp_path, brakes, way):
    rng = np.random.default_rng(2)
    (session,) = drives(loaded.base, 30.0, 1, 30.0, rng, step=1.0)
    torque = loaded.base.predict([session], loaded.base.nominal, ())[0].torque
    shown = np.maximum(torque, -80.0) + rng.normal(0.0, NOISE_NM, len(torque))
    sample_times = np.arange(5 * len(session)) / 5.0  # so often that steps are of a second
    speed = np.interp(sample_times, session.time + 0.5, session.speed)
    columns = {"time_s": sample_times, "speed_mps": way * speed, "torque_nm": way * np.repeat(shown, 5)}
    path = written(tmp_path / "drive.csv", columns)
    gate_result = gate(read_recordings([path], None), replace(loaded.known, friction_brakes=brakes))
    assert any("the motor brakes alone" in note for note in gate_result.notes) == brakes
    (session,) = gate_result.sessions
    compared = way * session.torque[session.used & (np.abs(session.speed) > 1.0)]
    assert (compared < -20.0).sum() > 50
    if brakes:
        assert (compared > -80.0 - 2.0 * NOISE_NM).all()


@pytest.mark.parametrize("recorded", [True, False])
@pytest.mark.parametrize("friction", [True, False])
def test_a_drive_in_reverse_is_gated_as_one_forward(loaded, tmp_path, friction, recorded):
    rng = np.random.default_rng(4)
    speed = np.tile(np.r_[np.zeros(50), np.linspace(0.0, 12.0, 100), np.full(300, 12.0), np.linspace(12.0, 0.0, 50)], 20)
    columns = {"time_s": 0.1 * np.arange(len(speed)), "speed_mps": speed, "torque_nm": rng.normal(50.0, 100.0, len(speed))}
    if recorded:
        columns["brake_on"] = np.gradient(speed) < 0.0
    results = []
    for way in (1.0, -1.0):
        turned = {**columns, "speed_mps": way * speed + 0.0, "torque_nm": way * columns["torque_nm"]}
        path = written(tmp_path / "drive.csv", turned, "%.18e")
        results.append(gate(read_recordings([path], None), replace(loaded.known, friction_brakes=friction)))
    forward, reverse = results
    np.testing.assert_array_equal(reverse.sessions[0].used, forward.sessions[0].used)
    assert (reverse.exclusions, reverse.notes) == (forward.exclusions, forward.notes)
