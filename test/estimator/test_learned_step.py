# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Learned departures change the torque like a vehicle file with these values, to first order, and not at rest."""

from dataclasses import replace

import numpy as np
import pytest

from trackres_ros.effects import Active, catalogue
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.model.resistance import direction
from trackres_ros.vehicle import load, load_any, variants

BY_FILE = {
    layout.OF_LOSS: ("rubber.loss_modulus_scale",),
    layout.OF_COOLING: ("belt.film_offset", "belt.film_slope"),
    layout.OF_BEARING: ("chassis.bearing_friction",),
    layout.OF_DRAG: ("chassis.drag_coefficient",),
    layout.OF_MASS: ("chassis.rotating_mass_factor",),
}


def driven(estimator, departure=0.0, which=layout.OF_LOSS, on=1.0):
    session, time = estimator.session(), np.arange(9000) * 0.1
    session.learned[layout.Learned.on], layout.Learned(session.learned).departures[which] = on, departure
    stamps = (time * 1e9).astype(np.int64) + 10**18
    steps = session.handle_block(np.zeros(len(time), np.int16), stamps, stamps, 8.0 + 6.0 * np.sin(time / 120.0))
    return steps.rows, session


def changed(vehicle, which, departure):
    track = next(iter(vehicle.tracks))
    paths = [path if "." in path and not path.startswith("belt") else f"tracks.{track}.{path}" for path in BY_FILE[which]]
    return Estimator(variants(vehicle)({path: vehicle.parameters[path].value * (1.0 + departure) for path in paths}))


@pytest.mark.parametrize("which", BY_FILE)
@pytest.mark.parametrize("name", ["xgd24d", "agri3t"])
def test_a_learned_departure_acts_like_a_file_with_that_value(name, which):
    vehicle, departure = load(name), 0.05 if name == "xgd24d" else -0.05
    (base_rows, _), (file_rows, _) = driven(Estimator(vehicle)), driven(changed(vehicle, which, departure))
    learned, _ = driven(Estimator(vehicle), departure, which)
    drive, belt = layout.Results.drive_torque_nm, len(layout.VEHICLE_COLUMNS)
    change = np.abs(file_rows[:, drive] - base_rows[:, drive])
    assert np.abs(learned[:, drive] - file_rows[:, drive]).max() < 0.06 * change.max() + 0.5
    assert (
        np.abs(learned[:, belt] - file_rows[:, belt]).max() < 0.1 * np.abs(file_rows[:, belt] - base_rows[:, belt]).max() + 1e-6
    )


def test_parts_add_up_and_assemblies_to_the_whole(reference):
    rows, _ = driven(reference, 0.1)
    parts = rows[
        :, [layout.Results.hysteresis_nm, layout.Results.bearing_nm, layout.Results.wind_nm, layout.Results.effects_nm]
    ].sum(axis=1)
    assert parts == pytest.approx(rows[:, layout.Results.resistance_torque_nm], abs=1e-6)
    sums = rows[:, len(layout.VEHICLE_COLUMNS) + layout.OfAssembly.resistance_torque_nm :: len(layout.ASSEMBLY_COLUMNS)].sum(
        axis=1
    )
    assert sums == pytest.approx(rows[:, layout.Results.resistance_torque_nm], abs=1e-6)


def test_what_is_known_but_not_on_changes_no_bit(reference):
    base_rows, _ = driven(reference, on=0.0)
    idle_rows, _ = driven(reference, 0.3, on=0.0)
    assert np.array_equal(base_rows, idle_rows, equal_nan=True)


def test_learned_drag_moves_effects_of_wind_like_a_file_with_it():
    share = Active(catalogue()["air_drag"], {"share": 0.8})
    wind = Active(catalogue()["headwind"], {"from_ahead": 6.0, "from_left": 2.0})
    car, departure, ends = replace(load_any("bmw_i3"), effects=(share,), surroundings=(wind,)), 0.2, []
    drag_car = replace(car, values={**car.values, "drag_area": (1.0 + departure) * car.values["drag_area"]})
    for vehicle, learned in ((car, 0.0), (car, departure), (drag_car, 0.0)):
        session = Estimator(vehicle).session()
        session.learned[layout.Learned.on], layout.Learned(session.learned).departures[layout.OF_DRAG] = 1.0, learned
        for stamp in range(10**18, 10**18 + 10**9, 10**8):
            session.handle(session.channel("heading"), stamp, stamp, 0.5)
            row = session.handle(layout.SPEED, stamp, stamp, 25.0).row
        ends.append((row, layout.Learned(session.learned).sensitivities[layout.OF_DRAG]))
    (base_row, by_file), (learned_row, by_learned), (expected, _) = ends
    assert learned_row == pytest.approx(expected, rel=1e-9, nan_ok=True)
    change = (learned_row - base_row)[layout.Results.drive_torque_nm]
    assert departure * np.array([by_file, by_learned]) == pytest.approx(change, rel=1e-6)  # what the learner takes off again


def test_at_rest_nothing_that_was_learned_pushes(reference):
    session = reference.session()
    session.learned[layout.Learned.on], session.learned[layout.Learned.torque] = 1.0, 500.0
    layout.Learned(session.learned).departures[layout.OF_LOSS] = 0.5
    for i in range(100):
        estimate = session.handle(layout.SPEED, 10**18 + i * 10**8, 10**18 + i * 10**8, 0.0)
        assert estimate["feedforward_torque_nm"] == 0.0
        assert estimate.resistance_torque_nm == 0.0


def test_a_torque_that_goes_on_is_against_travel_either_way(reference):
    for speed in (5.0, -5.0):
        session = reference.session()
        start, _ = reference.step(reference.cold_start(reference.inputs(speed)), reference.inputs(speed), 0.0)
        session.begin(start)
        torque = session.handle(layout.SPEED, 10**18, 10**18, speed).resistance_torque_nm
        session = reference.session()
        session.begin(start)
        session.learned[layout.Learned.on], session.learned[layout.Learned.torque] = 1.0, 100.0
        lasting_torque = session.handle(layout.SPEED, 10**18, 10**18, speed).resistance_torque_nm
        assert lasting_torque - torque == pytest.approx(np.copysign(100.0, speed), rel=1e-6)


def test_gears_leave_a_lasting_torque_as_it_was_learned():
    torques = []
    for torque in (0.0, 100.0):
        session = Estimator(load_any("bmw_i3")).session()  # its gears lose a share
        session.learned[layout.Learned.on], session.learned[layout.Learned.torque] = 1.0, torque
        for stamp in range(10**18, 10**18 + 10**10, 10**8):
            row = session.handle(layout.SPEED, stamp, stamp, 20.0).row
        torques.append(
            row[[layout.Results.drive_torque_nm, layout.Results.resistance_torque_nm, layout.Results.feedforward_torque_nm]]
        )
    assert torques[1] - torques[0] == pytest.approx(100.0, rel=1e-6)


@pytest.mark.parametrize("which", [layout.OF_LOSS, layout.OF_BEARING])
def test_at_rest_the_learned_deviation_is_that_of_a_crawl(reference, which):
    stds = []
    for speed in (0.0, 1e-6, 0.02, -0.02):
        session = reference.session()
        learned = layout.Learned(session.learned)
        session.learned[layout.Learned.on], learned.factor[which * (layout.LEARNABLE + 1)] = 1.0, 0.5
        stds.append(session.handle(layout.SPEED, 10**18, 10**18, speed).resistance_std_nm)
        assert stds[-1] * direction(speed) == pytest.approx(np.copysign(0.5 * learned.sensitivities[which], speed), rel=1e-9)
    assert stds[0] == pytest.approx(stds[1], rel=1e-3)
    assert stds[2] == pytest.approx(stds[3], rel=1e-12)
