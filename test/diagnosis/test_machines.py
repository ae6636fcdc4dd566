# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Machines that are no vehicles, through `tr.diagnose`: what their models lack is found, or told, and nothing crashes."""

import json
import re
from functools import cache

import numpy as np
import pytest

import trackres_ros as tr
from trackres_ros.diagnosis import load_base, read_recordings
from trackres_ros.diagnosis.empirical import finders
from trackres_ros.diagnosis.inference.failures import attempt, failures
from trackres_ros.diagnosis.inference.noise import solve_normal
from trackres_ros.diagnosis.preparation import checked_sessions


def shaft(inputs, p):
    return p["inertia"] * inputs.accel + p["drag"] * inputs.speed


def lift(inputs, p):
    return p["inertia"] * inputs.accel + p["lift"] * inputs.speed * np.abs(inputs.speed)


def machine(torque=shaft, *, speed, torque_nm, **parameters):
    return tr.OwnModel("machine", torque, parameters, max_speed=speed, max_torque=torque_nm)


def written(path, time, speed, torque):
    columns = np.column_stack([time, speed, torque])
    np.savetxt(path, columns, delimiter=",", header="time_s,speed_mps,torque_nm", comments="")
    return path


def swept(time, speed, *periods):
    """A smooth speed that turns to and fro with these periods [s], and its acceleration."""
    turns = [2.0 * np.pi / period for period in periods]
    size = speed / len(turns)
    return sum(size * np.sin(w * time + w) for w in turns), sum(size * w * np.cos(w * time + w) for w in turns)


def pump_runs(folder):
    """A pump that only turns forward, with 1 Nm of friction; and its model without that."""
    rng = np.random.default_rng(1)
    time = np.arange(0.0, 600.0, 0.1)
    speed = np.interp(time, np.arange(0.0, 610.0, 10.0), rng.uniform(40.0, 300.0, 61))
    torque = 0.01 * np.gradient(speed, time) + 2e-4 * speed**2 + 1.0 + rng.normal(0.0, 0.05, len(time))
    model = machine(lift, speed=300.0, torque_nm=30.0, inertia=(0.01, 0.005, 0.02, "kg m^2"), lift=(2e-4, 1e-4, 3e-4, "Nm s^2"))
    return written(folder / "pump.csv", time, speed, torque), model


def test_a_pump_that_only_turns_forward_is_diagnosed(diagnosed):
    result = diagnosed("pump_runs")
    (lacks,) = result.effects  # forward only, three names are one
    assert lacks.grade == "confirmed"
    assert {"coulomb_friction", "torque_offset"} <= set(lacks.members)
    assert not any("failed" in warning for warning in result.warnings)


def test_a_finder_that_fails_is_a_note_and_ends_nothing(tmp_path, monkeypatch):
    def singular(*_):
        return np.linalg.solve(np.zeros((2, 2)), np.zeros(2))

    for finder in ("find_place", "find_wave", "find_chain", "find_payload", "by_recording"):
        monkeypatch.setattr(finders, finder, singular)
    result = tr.diagnose(*pump_runs(tmp_path), quick=True)
    assert len(result.effects) == 1
    assert sum("LinAlgError" in warning for warning in result.warnings) >= 4


def test_an_error_is_raised_where_nobody_reads_notes():
    with failures() as result:
        assert attempt("a wave", lambda: 1 // 0) is None
        assert attempt("a place", lambda: 3) == 3
    (note,) = result
    assert "a wave" in note
    with pytest.raises(ZeroDivisionError):
        attempt("a wave", lambda: 1 // 0)


def test_equations_that_determine_nothing_have_a_solution():
    assert not solve_normal(np.zeros((3, 3)), np.zeros(3), 1e-9).any()


def rough_motor(folder):
    """An exact recording of a motor whose Coulomb friction is far larger than what its model has; and the model."""
    time = np.arange(0.0, 40.0, 0.01)
    speed, accel = swept(time, 200.0, 20.0, 9.0)
    torque = 2e-4 * accel + 1e-5 * speed + 0.2 * np.sign(speed)
    inertia, drag = (2e-4, 1e-4, 3e-4, "kg m^2"), (1e-5, 0.0, 4e-5, "Nm s")
    return written(folder / "motor.csv", time, speed, torque), machine(speed=200.0, torque_nm=1.0, inertia=inertia, drag=drag)


def servo_runs(folder):
    """Eight runs of 20 s of a servo with friction; and its model without that."""
    rng = np.random.default_rng(2)
    time, runs = np.arange(0.0, 20.0, 0.02), []
    for number in range(8):
        speed, accel = swept(time, 100.0, 4.0 + number, 2.6)
        torque = 0.02 * accel + 0.01 * speed + 0.3 * np.sign(speed) + rng.normal(0.0, 0.02, len(time))
        runs.append(written(folder / f"run_{number}.csv", time, speed, torque))
    inertia, drag = (0.02, 0.01, 0.03, "kg m^2"), (0.01, 0.0, 0.02, "Nm s")
    return runs, machine(speed=100.0, torque_nm=4.0, inertia=inertia, drag=drag)


def gated(recordings, model):
    """The sessions that pass all checks, without the search."""
    paths = recordings if isinstance(recordings, list) else [recordings]
    return checked_sessions(read_recordings(paths, None), load_base(model))[0]


def test_friction_beside_a_small_inertia_is_no_wrong_unit(tmp_path):
    passed = gated(*rough_motor(tmp_path))
    assert not any("times the expected" in note or "clock differs" in note for note in passed.notes)


def test_short_runs_of_a_machine_count_together(tmp_path):
    passed = gated(*servo_runs(tmp_path))
    assert len(passed.sessions) == 8
    assert not passed.warnings


@pytest.mark.parametrize(("scale", "said"), [(-1.0, "scale: -1.0"), (1e3, "scale: 0.001"), (1e-3, "scale: 1000.0")])
def test_a_wrong_sign_or_unit_of_a_machine_is_refused(tmp_path, scale, said):
    runs, model = servo_runs(tmp_path)
    for run in runs:
        time, speed, torque = np.loadtxt(run, delimiter=",", skiprows=1).T
        written(run, time, speed, scale * torque)
    with pytest.raises(tr.InputError) as error_info:
        gated(runs, model)
    assert said in str(error_info.value)
    assert not any(word in str(error_info.value) for word in ("sprocket", "wheel", "gear", "vehicle", "driving"))


def cogging_motor(folder):
    """A motor with dry friction and seven cogs a turn, which turns to and fro; and its model without both."""
    rng = np.random.default_rng(4)
    time = np.arange(0.0, 60.0, 0.005)
    speed, accel = swept(time, 30.0, 11.0, 4.3, 2.7)
    cogging = 0.03 * np.sin(7.0 * np.cumsum(speed) * 0.005)
    torque = 2e-3 * accel + 1e-3 * speed + 0.05 * np.sign(speed) + cogging + rng.normal(0.0, 0.005, len(time))
    inertia, drag = (2e-3, 1e-3, 3e-3, "kg m^2"), (1e-3, 0.0, 3e-3, "Nm s")
    return written(folder / "dc.csv", time, speed, torque), machine(speed=30.0, torque_nm=0.4, inertia=inertia, drag=drag)


def servo_joint(folder):
    """A joint with 0.25 Nm of dry friction, and its model without that."""
    rng = np.random.default_rng(6)
    time = np.arange(0.0, 45.0, 0.005)
    speed, accel = swept(time, 6.0, 5.0, 1.9, 1.1)
    torque = 0.02 * accel + 0.03 * speed + 0.25 * np.sign(speed) + rng.normal(0.0, 0.02, len(time))
    inertia, drag = (0.02, 0.01, 0.03, "kg m^2"), (0.03, 0.0, 0.06, "Nm s")
    return written(folder / "joint.csv", time, speed, torque), machine(speed=6.0, torque_nm=2.0, inertia=inertia, drag=drag)


def hovering(inputs, p):
    return p["mass"] * inputs.accel + p["rotors"] * inputs.speed


def quadrotor_flight(folder):
    """A quadrotor flown to and fro, with a drag of its body; and its model with the drag of its rotors only."""
    rng = np.random.default_rng(5)
    time = np.arange(0.0, 120.0, 0.02)
    speed = np.interp(time, np.arange(0.0, 123.0, 3.0), rng.uniform(-12.0, 12.0, 41))
    drag = 0.25 * speed + 0.06 * speed * np.abs(speed)
    force = 1.4 * np.gradient(speed, time) + drag + rng.normal(0.0, 0.1, len(time))
    mass, rotors = (1.4, 1.2, 1.6, "kg"), (0.25, 0.1, 0.5, "N s/m")
    model = machine(hovering, speed=12.0, torque_nm=20.0, mass=mass, rotors=rotors)
    return written(folder / "flight.csv", time, speed, force), model


FRICTION = {"rough_motor": 0.2, "cogging_motor": 0.05, "servo_joint": 0.25, "servo_runs": 0.3}
MADE = {made.__name__: made for made in (rough_motor, cogging_motor, servo_joint, servo_runs, quadrotor_flight, pump_runs)}


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory):
    """The diagnosis of a machine by its name, made once."""
    return cache(lambda name: tr.diagnose(*MADE[name](tmp_path_factory.mktemp(name)), quick=True))


@pytest.mark.parametrize("name", FRICTION)
def test_dry_friction_of_a_machine_is_confirmed(diagnosed, name):
    result = diagnosed(name)
    (friction,) = result.effects
    assert (friction.name, friction.grade) == ("coulomb_friction", "confirmed")
    assert friction.values["friction"] == pytest.approx(FRICTION[name], rel=0.1)
    assert not any(word in warning for warning in result.warnings for word in ("times the", "failed", "clock"))


def test_a_motor_without_a_delay_is_given_none(diagnosed):
    result = diagnosed("cogging_motor")
    assert "delay" not in result.sentence
    assert "delay" not in {name for effect in result.effects for name in effect.members}


def test_drag_of_a_quadrotor_is_a_curve_of_its_speed(diagnosed):
    result = diagnosed("quadrotor_flight")
    assert result.status == "described"
    assert any(term.variable == "speed" and term.grade == "confirmed" for term in result.described)
    mae = result.diagnosis.held_out.mae
    assert mae["with_effects"] < 0.3 * mae["refitted"]


OF_VEHICLES = ("vehicle", "sprocket", "film", "wheel", "belt", "mud", "tyre", "spring", "road", "passenger")


@pytest.mark.parametrize("name", MADE)
def test_texts_on_a_machine_have_no_words_of_vehicles(diagnosed, name, tmp_path):
    result = diagnosed(name)
    result.report(tmp_path, page=False)
    report = json.loads((tmp_path / "report.json").read_text())
    texts = [result.sentence, *result.warnings, *(term["sentence"] for term in report["described"])]
    texts += [part for term in report["described"] for part in term["mechanisms"]]
    texts += [text for item in report["effects"] for text in (item["text"], item["acts"]["size"])]
    texts += [item["why"] for item in report["not_visible"]]
    assert not report["advice"]  # manoeuvres for drivers
    assert not [(word, text) for text in texts for word in OF_VEHICLES if re.search(rf"\b{word}", text.lower())]
