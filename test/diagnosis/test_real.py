# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What it says of real recordings, where they are present: nothing that is plainly wrong."""

import json
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

import trackres_ros as tr
from proofs.field.trials import BUT_WHEELS, SHOWS_TURNING, car, robot
from trackres_ros.diagnosis.base.loading import load_base
from trackres_ros.diagnosis.inference.fitting import Problem, fit, with_levels
from trackres_ros.diagnosis.preparation import checked_sessions
from trackres_ros.diagnosis.prepare.gate import gate
from trackres_ros.diagnosis.prepare.session import split_laps
from trackres_ros.errors import InputError
from trackres_ros.files.resources import config_dir

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "real"

BUS = DATA / "ztbus" / "B183_2021-10-05_13-53-20.csv.gz"

needs_bus = pytest.mark.skipif(not BUS.is_file(), reason="no recording of the bus on this machine")
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason="no real recordings on this machine")


@pytest.fixture
def report_of(run):
    def diagnosed(vehicle, out, *given):
        process = run((), out, *given, vehicle=vehicle)
        if process.exception and not isinstance(process.exception, SystemExit):
            raise process.exception
        return json.loads((out / "report.json").read_text())

    return diagnosed


def test_a_robot_off_the_ground_neither_rolls_nor_turns(report_of, tmp_path):
    result = report_of("husky", tmp_path / "out", robot(DATA, "husky_avide2", tmp_path))
    assert {"turning_scrub", "cornering", "soft_ground", "grade"}.isdisjoint(n for e in result["effects"] for n in e["class"])


def test_a_robot_on_wet_grass_shows_scrub_with_a_known_yaw_rate(report_of, tmp_path):
    path = robot(DATA, "husky_wetgrass", tmp_path)
    result = report_of("husky", tmp_path / "known", path)
    (effect,) = result["effects"]
    assert effect["class"] == ["turning_scrub"]
    assert 0.2 < effect["parameters"]["friction"]["value"] < 1.2
    assert result["heldout"]["mae"]["with_effects"] < 0.6 * result["heldout"]["mae"]["refitted"]
    nothing_turns = [word for channel in SHOWS_TURNING for word in ("--hide", channel)]
    assert not any(
        "turning_scrub" in e["class"] for e in report_of("husky", tmp_path / "hidden", path, *nothing_turns)["effects"]
    )
    by_wheels = report_of("husky", tmp_path / "wheels", path, *(word for channel in BUT_WHEELS for word in ("--hide", channel)))
    assert [e["name"] for e in by_wheels["effects"]] == ["turning_scrub"]


@pytest.fixture(scope="module")
def winter(run, tmp_path_factory):
    """The report on three trips of the car in winter; docs/trust.md is of all."""
    folder = tmp_path_factory.mktemp("winter")
    paths = [car(DATA, name, folder) for name in ("TripB18", "TripB21", "TripB24")]
    assert run(paths, folder / "out", "--hide", "ambient", vehicle="bmw_i3").exit_code == 0
    return json.loads((folder / "out" / "report.json").read_text())


def test_in_winter_nothing_is_named_but_what_warms_up(winter):
    for effect in winter["effects"]:
        assert {"roadwheel_tyres", "warmup", "viscous_bearing"} & set(effect["class"])
    assert winter["heldout"]["mae"]["with_effects"] <= winter["heldout"]["mae"]["refitted"]


def test_the_car_is_refitted_to_values_of_a_car(winter):
    refitted = {name: q["value"] for name, q in winter["base"]["refitted"].items()}
    assert 1.0 < refitted["rotating_mass_factor"] < 1.25
    assert 0.3 < refitted["drag_area"] < 0.9
    assert winter["heldout"]["r2"]["refitted"] > 0.85
    assert sum("it had stood for" in note for note in winter["notes"]) == 3  # after drives that are not among these
    assert any("may brake" in x["reason"] and x["samples"] > 100 for x in winter["rejected"])


@pytest.fixture(scope="module")
def bus():
    """The trolley bus, read with its topics file, and its vehicle file."""
    recording = tr.read(BUS, topics=config_dir() / "topics" / "ztbus.yaml")
    return recording, load_base("ztbus_hess19").with_topics(recording.topics)


@needs_bus
def test_bus_notes_cover_altitude_brakes_passengers_and_wheels(bus):
    recording, loaded = bus
    result = gate([recording], loaded.known)
    text = " ".join(result.notes)
    for part in ("no usable slope", "brakes on in", "passengers of 70 kg", "wheels that turn faster than front_"):
        assert part in text
    (session,) = result.sessions
    assert "grade" not in session.given
    assert np.isfinite(session.latitude).mean() > 0.9
    assert 20.0 * 70.0 * 9.8 < session.payload.max() < 120.0 * 70.0 * 9.8
    left_out = result.exclusions
    assert left_out["brakes on"] < 0.25 * session.used.sum() * session.step
    assert (session.torque[session.used] < 0.0).mean() > 0.2  # what its motors brake is compared


@needs_bus
def test_of_wheels_that_are_hidden_nothing_is_said(bus):
    recording, loaded = bus
    assert "wheel" not in " ".join(gate([recording], loaded.known, ["wheel_speed"]).notes)


@needs_bus
def test_a_refitted_bus_is_no_worse_than_its_file_or_robust_fit(bus, robust_least_squares):
    recording, loaded = bus
    gate_result, nominal, _ = checked_sessions([recording], loaded)
    choice = split_laps(gate_result.sessions)
    (session,) = gate_result.sessions
    problem = Problem(loaded.base, gate_result.sessions, (choice.training_mask(session),))
    held = choice.held_out_mask(session)
    refitted = with_levels(fit(problem)).predicted[0].torque
    models = {"file": nominal[0], "refitted": refitted, "robust": robust_least_squares(problem)[0].torque}
    error = {name: float(np.abs(session.torque - torque)[held].mean()) for name, torque in models.items()}
    assert error["refitted"] < error["file"]
    assert error["refitted"] < 1.02 * error["robust"]


def test_a_bag_without_a_torque_has_nothing_to_diagnose(report_of, tmp_path):
    bag = DATA / "rosbag_gps_vehicle" / "bag"
    with pytest.raises(InputError, match="torque"):
        report_of("xgd24d", tmp_path / "out", bag)


@needs_bus
def test_three_short_rollings_out_of_a_bus_tell_nothing():
    result = tr.coastdown(BUS, "ztbus_hess19", topics=config_dir() / "topics" / "ztbus.yaml")
    assert len(result.coastdown.runs.stretches) == 3
    assert not any(p.determined for p in result.coastdown.parameters)
    assert not result.better


RIDES = DATA / "bicycle"
needs_rides = pytest.mark.skipif(not RIDES.is_dir(), reason="no rides of a bicycle on this machine")


@needs_rides
@pytest.mark.parametrize("hidden", [(), ("altitude",)])
@pytest.mark.parametrize("ride", ["ride_a", "ride_b", "ride_c"])
def test_a_ride_over_hills_is_not_refused(ride, hidden):
    passed, *_ = checked_sessions([tr.read(RIDES / f"{ride}.csv.gz")], load_base(RIDES / "bicycle.yaml"), hidden)
    assert passed.sessions
    assert "scale: -1.0" not in " ".join(passed.notes)  # uphill it is slower, with more torque: its energy has the sign


@needs_rides
def test_a_ride_past_no_place_twice_ends_in_no_crash():
    with suppress(InputError):  # a model without rider and wind may explain too little for a conclusion
        result = tr.diagnose(RIDES / "ride_b.csv.gz", RIDES / "bicycle.yaml", quick=True)
        assert not any("failed" in warning for warning in result.warnings)


@needs_rides
def test_a_ride_without_its_altitude_has_an_unrecorded_slope():
    result = tr.diagnose(RIDES / "ride_a.csv.gz", RIDES / "bicycle.yaml", hide=["altitude"], quick=True)
    assert not any("failed" in warning or "scale: -1.0" in warning for warning in result.warnings)
    assert "slope" in result.sentence
