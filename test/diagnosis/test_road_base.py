# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The road load: what is re-fitted, and what stays where the file has it."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
import yaml
from csv_tables import written

from trackres_ros.diagnosis import load_base, read_recordings
from trackres_ros.diagnosis.base.road_load import FITTED
from trackres_ros.diagnosis.inference.fitting import Problem, fit
from trackres_ros.diagnosis.preparation import checked_sessions
from trackres_ros.diagnosis.prepare.gate import gate
from trackres_ros.diagnosis.synthetic import drives, write_recordings
from trackres_ros.errors import InputError
from trackres_ros.files.resources import config_dir
from trackres_ros.vehicle.writing.changes import FileChanges


def car(folder, **changes):
    """The base of the car with other ranges."""
    content = yaml.safe_load((config_dir() / "bmw_i3.yaml").read_text())
    for name, change in changes.items():
        content["road_load"][name].update(change)
    path = folder / "car.yaml"
    path.write_text(yaml.safe_dump(content))
    return load_base(path).base


def fitted(base, given=frozenset({"grade"}), **true):
    """A fit to drives over hills of a car with other values than its file's."""
    rng = np.random.default_rng(1)
    made = []
    for session in drives(base, 30.0, 2, 10.0, rng, step=1.0):
        grade = 0.04 * np.sin(session.distance / 300.0) * ("grade" in given)
        made.append(replace(session, grade=grade, given=given, weight=np.full(len(session), 1.1 * base.facts.weight)))
    values = base.nominal | true
    torques = [p.torque + rng.normal(0.0, 3.0, len(p.torque)) for p in base.predict(made, values, ())]
    sessions = tuple(replace(s, torque=t) for s, t in zip(made, torques, strict=True))
    return fit(Problem(base, sessions, tuple(np.abs(s.speed) > 0.5 for s in sessions)))


def test_the_mass_is_found_if_the_torque_scale_is_known(tmp_path):
    base = car(tmp_path, torque_scale={"range": [1.0, 1.0]})
    assert "torque_scale" not in {q.name for q in base.parameters}
    result = fitted(base, mass=1500.0)
    assert result.base_values["mass"] == pytest.approx(1500.0, rel=0.02)
    assert result.std_of("", "mass") < 0.5 * next(q.std for q in base.parameters if q.name == "mass")


def test_the_scale_is_found_where_the_mass_is_known(tmp_path):
    base = car(tmp_path, mass={"range": [1400.0, 1400.0]}, drag_area={"range": [0.69, 0.69]}, efficiency={"range": [0.97, 0.97]})
    result = fitted(base, frozenset({"grade", "load"}), torque_scale=0.93)
    assert result.base_values["torque_scale"] == pytest.approx(0.93, rel=0.01)
    assert "mass" not in result.base_values


def test_the_torque_of_simulated_drives_has_their_load(tmp_path):
    base = car(tmp_path)
    light, heavy = (replace(s, accel=0.0 * s.accel) for s in drives(base, 30.0, 3, 1.0, np.random.default_rng(1))[1:])
    torques = [base.predict([replace(light, weight=s.weight)], base.nominal, ())[0].torque for s in (light, heavy)]
    assert (torques[1] >= torques[0]).all()
    assert torques[1].mean() > 1.02 * torques[0].mean()


def test_simulated_drives_record_the_torque_that_a_sensor_shows(tmp_path):
    base = car(tmp_path, torque_scale={"value": 0.5, "range": [0.5, 0.5]})
    drive = drives(base, 30.0, 1, 5.0, np.random.default_rng(1))
    (path,) = write_recordings(base, tmp_path, drive, (), np.random.default_rng(2))
    shown, expectation = read_recordings([path], None)[0].series["torque"].value, base.predict(drive, base.nominal, ())[0].torque
    assert np.abs(shown).mean() == pytest.approx(0.5 * np.abs(expectation).mean(), rel=0.1)


def prepared_drive(base, folder, scale):
    """A drive of the car as prepared by its file, and the expected torque; the sensor shows `scale` times the true one."""
    drive = drives(base, 30.0, 1, 5.0, np.random.default_rng(1))
    torque = scale * base.predict(drive, base.nominal, ())[0].torque
    columns = {"time_s": drive[0].time, "speed_mps": drive[0].speed, "accel_mps2": drive[0].accel, "torque_nm": torque}
    recordings = read_recordings([written(folder / "drive.csv", columns, "%.18e")], None)
    return checked_sessions(recordings, load_base(folder / "car.yaml"))[:2]


@pytest.mark.parametrize("shown", [1 / 30.0, 1 / 3.0, 3.0, 30.0])
def test_a_torque_is_refused_only_beyond_the_range_of_its_scale(tmp_path, shown):
    for widest in (1.1, 50.0):
        base = car(tmp_path, torque_scale={"value": 0.5, "range": [0.5 / widest, 0.5 * widest]})
        with pytest.raises(InputError, match="times the expected torque") if widest < 2.0 else nullcontext():
            prepared_drive(base, tmp_path, 0.5 * shown)


def test_torques_are_at_the_wheels_whatever_the_sensor_shows(tmp_path):
    """Of a motor current at a gear too; and a scale that is re-fitted shows in the written file as in the fit."""
    seen = []
    for scale in (1.0, 0.05):
        base = car(tmp_path, mass={"range": [1400.0, 1400.0]}, torque_scale={"value": scale, "range": [0.9 * scale, 1.1 * scale]})
        gate_result, expectation = prepared_drive(base, tmp_path, scale)
        values = base.nominal | {"torque_scale": 1.05 * scale}
        time_now = base.as_written(values)
        fit_nm, file_nm = (
            content.predict(gate_result.sessions, place, ())[0].torque
            for content, place in ((base, values), (time_now, time_now.nominal))
        )
        assert file_nm == pytest.approx(fit_nm, rel=1e-5)
        seen.append((gate_result.sessions[0].torque, expectation[0], fit_nm))
    for value, other in zip(*seen, strict=True):
        assert value == pytest.approx(other, rel=1e-6)


def test_mass_and_torque_scale_are_not_refitted_if_both_are_open(tmp_path):
    assert {q.name for q in car(tmp_path).parameters} == set(FITTED) - {"mass", "torque_scale"}


def test_a_zero_width_range_fixes_its_value_in_the_written_file(tmp_path):
    base = car(tmp_path, mass={"range": [1400.0, 1400.0]}, torque_delay={"range": [0.1, 0.1]})
    assert {q.name for q in base.parameters} == set(FITTED) - {"mass", "torque_delay"}
    result = fitted(base, rolling_coefficient=0.015)
    base.write(tmp_path / "written.yaml", FileChanges(result.base_values, (), {}), "for a test")
    repetition = load_base(tmp_path / "written.yaml").base.vehicle.values
    assert repetition["mass"] == 1400.0
    assert repetition["rolling_coefficient"] == pytest.approx(0.015, rel=0.05)


def test_a_gain_is_no_effect_beside_a_scale_that_is_re_fitted(tmp_path):
    assert "torque_gain" in car(tmp_path, mass={"range": [1400.0, 1400.0]}).includes
    assert "torque_gain" not in car(tmp_path).includes


@pytest.mark.parametrize(("rate_hz", "step"), [(100.0, 1.0), (10.0, 1.0), (5.0, 1.0), (2.0, 3.0), (1.0, 5.0)])
def test_the_mass_is_found_however_slowly_samples_come(rate_hz, step, tmp_path):
    """What happens between two samples hides a part of the inertia, unless a step has several of them."""
    base = car(tmp_path, torque_scale={"range": [1.0, 1.0]}, rotating_mass_factor={"range": [1.05, 1.05]})
    rng = np.random.default_rng(3)
    sample_times = np.arange(0.0, 1200.0, 0.01)
    pushes = sum(
        rng.uniform(0.1, 0.5) * np.sin(2.0 * np.pi * sample_times / s + rng.uniform(0.0, 6.0))
        for s in (1.7, 2.9, 5.3, 17.0, 41.0)
    )
    speed = 12.0 + np.cumsum(pushes) * 0.01
    v = base.vehicle.values
    force = v["mass"] * (1.05 * pushes + 9.80665 * (v["rolling_coefficient"] + v["rolling_rise"] * speed))
    force += 0.5 * v["air_density"] * v["drag_area"] * speed**2
    torque = force * v["wheel_radius"] / v["efficiency"] ** np.sign(force) + rng.normal(0.0, 5.0, len(sample_times))
    columns = {"time_s": sample_times, "speed_mps": speed, "torque_nm": torque}
    path = written(tmp_path / "drive.csv", {name: x[:: round(100.0 / rate_hz)] for name, x in columns.items()}, "%.18e")
    gate_result = gate(read_recordings([path], None), replace(load_base(tmp_path / "car.yaml").known, friction_brakes=False))
    assert gate_result.sessions[0].step == step
    result = fit(Problem(base, gate_result.sessions, tuple(s.used for s in gate_result.sessions)))
    assert result.base_values["mass"] == pytest.approx(1400.0, rel=0.04)
