# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Machines that are no vehicles, through `tr.diagnose`: what their models lack is found, or told, and nothing crashes."""

import numpy as np
import pytest

import trackres_ros as tr
from trackres_ros.diagnosis.empirical import finders
from trackres_ros.diagnosis.inference.failures import attempt, failures
from trackres_ros.diagnosis.inference.noise import solved


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


def test_a_pump_that_only_turns_forward_is_diagnosed(tmp_path):
    found = tr.diagnose(*pump_runs(tmp_path), quick=True)
    (lacks,) = found.effects  # forward only, three names are one
    assert lacks.graded.grade == "confirmed"
    assert {"coulomb_friction", "torque_offset"} <= set(lacks.step.members)
    assert not any("failed" in warning for warning in found.warnings)


def test_a_finder_that_fails_is_a_note_and_ends_nothing(tmp_path, monkeypatch):
    def singular(*_):
        return np.linalg.solve(np.zeros((2, 2)), np.zeros(2))

    for finder in ("find_place", "find_wave", "find_change", "find_chain", "find_payload", "by_recording"):
        monkeypatch.setattr(finders, finder, singular)
    found = tr.diagnose(*pump_runs(tmp_path), quick=True)
    assert len(found.effects) == 1
    assert sum("LinAlgError" in warning for warning in found.warnings) >= 5


def test_an_error_is_raised_where_nobody_reads_notes():
    with failures() as found:
        assert attempt("a wave", lambda: 1 // 0) is None
        assert attempt("a place", lambda: 3) == 3
    (note,) = found
    assert "a wave" in note
    with pytest.raises(ZeroDivisionError):
        attempt("a wave", lambda: 1 // 0)


def test_equations_that_determine_nothing_have_a_solution():
    assert not solved(np.zeros((3, 3)), np.zeros(3), 1e-9).any()
