# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The second simulator, by its own laws."""

import numpy as np
import pytest

from proofs.sealed.belt import LAYERS, LOG_SPEEDS, belt_loss, fit_material, native, roll
from proofs.sealed.cases import CATALOGUE, LEVELS, draw_cases
from proofs.sealed.drives import drive
from proofs.sealed.recordings import write_vehicle
from proofs.sealed.truth import Build, Sensors, record, simulate_truth
from trackres_ros.diagnosis import load_base, read_recordings
from trackres_ros.diagnosis.empirical.term import MODEL_ERROR
from trackres_ros.diagnosis.inference.fitting import Problem, fit
from trackres_ros.diagnosis.prepare.gate import gate
from trackres_ros.diagnosis.selection.locate import slow_residual
from trackres_ros.files.resources import find_vehicle

SHEET = find_vehicle("xgd24d")


@pytest.fixture(scope="module")
def material(sheet):
    return fit_material(sheet)


@pytest.fixture(scope="module")
def tables(sheet, material):
    return belt_loss(sheet, material)


@pytest.fixture(scope="module")
def drives(sheet):
    return [drive(4.0, 0.8 * sheet["weight"], 15.0, 14.0, np.random.default_rng(2))]


def test_the_material_is_that_of_the_sheet(sheet, material):
    degc, storage, loss = sheet.sweep
    omega = 2.0 * np.pi * sheet["rubber.sweep_frequency"] * 10.0 ** material.log_shift(degc)
    np.testing.assert_allclose(material.loss(omega), loss, rtol=0.05)
    np.testing.assert_allclose(material.size(omega), np.hypot(storage, loss), rtol=0.25)


def test_loss_grows_with_load_and_falls_when_hot(tables):
    assert (np.diff(tables.indentation, axis=0) > 0.0).all()
    middle = (LOG_SPEEDS > -1.0) & (LOG_SPEEDS < 5.0)  # of the rubbery range: colder and faster are further right
    assert (np.diff(tables.bending[middle]) > 0.0).all()


@pytest.fixture
def rolled(tables, material):
    """Rolls at 8 m/s, by the kernel in C or in plain Python: loss [N], mean and final temperatures of the layers [degC]."""

    def roll_by(kernel, n, step, capacity):
        series = {
            name: np.full(n, value) for name, value in (("speed", 8.0), ("row", 3.0), ("air", 20.0), ("one", 1.0), ("none", 0.0))
        }
        force, mean, layers = np.empty(n), np.empty(n), np.full(LAYERS, 20.0)
        kernel(
            step, series["speed"], series["row"], series["air"], series["one"], series["none"], series["none"], series["none"],
            float(LOG_SPEEDS[0]), float(LOG_SPEEDS[1] - LOG_SPEEDS[0]), tables.indentation, tables.bending,
            np.full(LAYERS, 1.0 / LAYERS),
            np.array([material.glass_transition, material.c1, material.c2, 50.0, 40.0]), 0.0, capacity, 6.0, 300.0,
            layers, np.empty(LAYERS), force, mean,
        )  # fmt: skip
        return force, mean, layers

    return roll_by


def test_heat_is_neither_made_nor_lost(rolled):
    step, capacity = 0.1, 2.0e5
    force, _, layers = rolled(native(roll), 4000, step, capacity)
    assert layers.mean() - 20.0 == pytest.approx(float((force * 8.0).sum()) * step / capacity, rel=1e-9)
    assert (np.diff(force) <= 1e-9).all()  # the warm belt loses less


def test_the_belts_kernel_gives_the_same_bits_in_c(rolled):
    for in_c, in_python in zip(rolled(native(roll), 300, 0.1, 2.0e5), rolled(roll, 300, 0.1, 2.0e5), strict=True):
        assert np.array_equal(in_c, in_python)


def test_each_phenomenon_changes_the_torque_on_its_own(drives):
    plain = simulate_truth(SHEET, Build(), {}, drives)[0]
    assert plain.added == {}
    rng = np.random.default_rng(0)
    for name, draw in CATALOGUE.items():
        if name == "core_surface":  # it is in the truth always; the vehicle file is what lacks it
            continue
        run = simulate_truth(SHEET, Build(), {name: draw(rng, 1.0)}, drives)[0]
        change = run.shown - plain.shown
        assert np.isfinite(change).all(), name
        assert np.abs(change).max() > 0.01, name


def test_the_base_refits_to_a_truth_without_effects(sheet, tmp_path):
    """Two nodes replace fifteen conducting layers, a loss table another one: the torque differs by one percent."""
    vehicle = write_vehicle(tmp_path / "vehicle.yaml", lumped=False)
    rng = np.random.default_rng(1)
    made = [
        drive(12.0, share * sheet["weight"], air, 16.7, rng)
        for share, air in zip((1.0, 0.8, 1.25), (5.0, 15.0, 25.0), strict=True)
    ]
    good = Sensors(
        torque_nm=1.0, torque_share=0.001, torque_step_nm=0.1, road=0.0, speed_mps=1e-4, speed_step_mps=1e-4, dropouts=0.0
    )
    paths = [tmp_path / f"drive_{i}.csv" for i in range(len(made))]
    for i, (path, value, run) in enumerate(zip(paths, made, simulate_truth(SHEET, Build(), {}, made), strict=True)):
        record(path, value, run, good, sheet["track.sprocket_radius"], 1.7e9 + 1e6 * i, rng)
    loaded = load_base(vehicle)
    sessions = gate(read_recordings(paths, None), loaded.known).sessions
    result = fit(Problem(loaded.base, sessions, tuple(s.used for s in sessions)))
    remainder = np.concatenate([s.torque - p.torque for s, p in zip(sessions, result.predicted, strict=True)])
    used = np.concatenate([s.used for s in sessions])
    assert np.abs(remainder[used]).mean() < 0.01 * np.abs(np.concatenate([s.torque for s in sessions])[used]).mean()
    assert slow_residual(result).share < 1.5 * MODEL_ERROR
    values = result.base_values
    assert values["conductivity"] == pytest.approx(Build().conductivity, rel=0.15)
    assert values["capacity_scale"] == pytest.approx(1.0, abs=0.15)
    assert values["loss_modulus_scale"] == pytest.approx(1.0, abs=0.15)


def test_a_seed_gives_the_same_cases_and_their_names_say_nothing():
    cases = draw_cases({"none": 4, "single": 4, "outside": 3}, 5)
    assert cases == draw_cases({"none": 4, "single": 4, "outside": 3}, 5)
    assert cases != draw_cases({"none": 4, "single": 4, "outside": 3}, 6)
    assert [c.level for c in cases] != sorted(c.level for c in cases)
    for case in cases:
        assert len(case.name) == 8
        assert int(case.name, 16) >= 0
    assert sum(LEVELS.values()) == 352
