# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Road load as coefficients, out of vehicle files and into them."""

import json

import numpy as np
import pytest

import trackres_ros as tr
from trackres_ros.tools.design.road_load import coefficients_of, forces, request_of, road_load, values_for, with_values
from trackres_ros.vehicle import load_any


def asked(vehicle, **options):
    return request_of(vehicle, **{"speed_kmh": None, "ambient_degc": None, "weight_kn": None, "belt_degc": None, **options})


@pytest.mark.parametrize("weight", [None, 15.0])
def test_a_car_on_tyres_is_exactly_its_coefficients(weight):
    """The gears add their share of each."""
    car = load_any("bmw_i3")
    found, v = road_load(asked(car, weight_kn=weight)), car.values
    newton = car.weight if weight is None else 1e3 * weight
    rolling = v["rolling_coefficient"] * newton, v["rolling_rise"] * newton
    expected = np.array([*rolling, 0.5 * v["air_density"] * v["drag_area"]]) / v["efficiency"]
    assert found.coefficients == pytest.approx(expected)
    assert abs(found.largest_error[0]) < 1e-6


@pytest.mark.parametrize("options", [{}, {"ambient_degc": -20.0}, {"belt_degc": 20.0}, {"weight_kn": 200.0}])
def test_coefficients_of_tracks_fit_within_two_percent(options):
    found = road_load(asked(load_any("xgd24d"), **options))
    assert np.abs(found.reference / found.force - 1.0).max() < 0.02
    error, speed = found.largest_error
    assert error == np.interp(speed, found.request.speeds, found.reference - found.force)


def test_the_force_is_that_of_explain():
    vehicle = load_any("agri3t")  # both tracks alike
    found = road_load(asked(vehicle, speed_kmh="3,5,7,9", belt_degc=20.0, ambient_degc=5.0, weight_kn=25.0))
    for v, force in zip(found.request.speeds, found.force, strict=True):
        point = tr.explain("agri3t", speed_kmh=3.6 * v, belt_degc=20.0, ambient_degc=5.0, weight_kn=25.0)
        assert force * 0.5 * sum(vehicle.sprocket_radii) == pytest.approx(point["torque_nm"]["resistance"])


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("bmw_i3", {"road_load.rolling_coefficient": 0.009, "road_load.drag_area": 0.8}),
        ("agri3t", {"rubber.loss_modulus_scale": 1.1, "chassis.bearing_friction": 0.014}),
    ],
)
def test_coefficients_of_a_vehicle_give_its_force_back(name, changes):
    """From the values of another one."""
    vehicle = load_any(name)
    request, hidden = asked(vehicle, belt_degc=None if name == "bmw_i3" else 20.0), with_values(vehicle)(changes)
    truth = forces(request, hidden)
    given = np.polynomial.polynomial.polyfit(request.speeds, truth, 2)
    again = forces(request, with_values(vehicle)(values_for(request, given)))
    before = np.abs(forces(request, vehicle) / truth - 1.0).max()
    assert np.abs(again / truth - 1.0).max() < 0.005 < 0.02 < before


def test_the_command_writes_a_vehicle_with_given_coefficients(good, tmp_path):
    file = tmp_path / "rolled.yaml"
    words = "road-load", "bmw_i3", "--coefficients", "140,0.6,0.03", "--per-kmh"
    saved = json.loads(good(*words, "--save-vehicle", file, "--json"))
    assert saved["reference"] == "coefficients"
    assert abs(saved["largest_error_n"]) > 20.0 > 0.01 > abs(saved["saved"]["largest_error_n"])
    assert saved["at_an_end_of_its_range"] == []
    car = road_load(asked(load_any(file)))
    assert car.coefficients == pytest.approx([140.0, 0.6 * 3.6, 0.03 * 3.6**2], rel=1e-4)
    assert "0.03  N/(km/h)^2" in good("road-load", file)


def test_values_out_of_reach_stop_at_the_ends_of_their_ranges(good, tmp_path):
    shown = good("road-load", "bmw_i3", "--coefficients", "900,0,0.4", "--save-vehicle", tmp_path / "heavy.yaml")
    assert "at an end of its range: road_load.rolling_coefficient" in shown
    assert "Largest difference from the given coefficients" in shown.partition("With the values of the new file")[2]


def test_coefficients_per_kmh_are_the_same_force():
    a, b, c = coefficients_of("120,0.5,0.03", True)
    assert a + b * 10.0 + c * 100.0 == pytest.approx(120.0 + 0.5 * 36.0 + 0.03 * 36.0**2)


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("xgd24d", "--coefficients", "1,2"), "three numbers A,B,C"),
        (("xgd24d", "--coefficients", "1,nan,2"), "three numbers A,B,C"),
        (("xgd24d", "--speed-kmh", "5,10,20"), "at least 4"),
        (("bmw_i3", "--belt-degc", "20"), "which has no belts"),
        (("xgd24d", "--weight-kn", "1"), "kN for a vehicle of"),
        (("xgd24d", "--save-vehicle", "new.yaml"), "only with --coefficients"),
        (("xgd24d", "--speed-kmh", "5:200"), "--speed-kmh"),
    ],
)
def test_a_road_load_that_cannot_be_is_refused(tmp_path, refused, words, part):
    assert part in refused("road-load", *words, cwd=tmp_path)
