# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The section `disturbance` of a vehicle file: accepted or refused, and part of no estimate."""

import pytest

from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.snapshot import key
from trackres_ros.vehicle import Drift, Spells, load

VALUES = {
    "spells": {"level": 300.0, "rest": -50.0, "mean_there": 80.0, "mean_away": 160.0, "noise": 60.0},
    "drift": {"size": 150.0, "time_constant": 300.0, "noise": 40.0},
}
UNITS = {"mean_there": "s", "mean_away": "s", "time_constant": "s"}


def section(form, **changed):
    """The section of a form, with values changed."""
    content = {"form": form}
    for name, value in {**VALUES[form], **changed}.items():
        span = sorted((0.9 * value, 1.1 * value))
        content[name] = {"value": value, "unit": UNITS.get(name, "Nm"), "flag": "F", "range": span, "reason": "found"}
    return content


@pytest.mark.parametrize(
    ("form", "expected"), [("spells", Spells(300.0, -50.0, 80.0, 160.0, 60.0)), ("drift", Drift(150.0, 300.0, 40.0))]
)
def test_it_is_read_as_it_is_said(loaded, content, form, expected):
    assert loaded({**content, "disturbance": section(form)}).disturbance == expected
    assert loaded(content).disturbance is None


@pytest.mark.parametrize(
    ("given", "where"),
    [
        (None, "disturbance"),
        ([], "disturbance"),
        ({}, "disturbance"),
        ({**section("spells"), "form": "waves"}, "disturbance.form"),
        ({**section("spells"), "form": 3}, "disturbance.form"),
        ({**section("spells"), "size": section("drift")["size"]}, "disturbance.size"),
        ({name: value for name, value in section("spells").items() if name != "noise"}, "disturbance.noise"),
        ({**section("drift"), "size": 150.0}, "disturbance.size"),
        (section("drift", size=float("nan")), "disturbance.size"),
        (section("drift", size=2e6), "disturbance.size"),
        (section("drift", noise=0.0), "disturbance.noise"),
        (section("spells", mean_there=5.0), "disturbance.mean_there"),
        (section("spells", level=-50.0), "disturbance.level"),
    ],
)
def test_what_is_not_right_is_refused_with_its_key(refusal, content, given, where):
    assert f"given.yaml: {where}" in refusal({**content, "disturbance": given}).where


def test_no_estimate_and_no_kept_state_depends_on_it(loaded, content):
    bare_vehicle, vehicle = load("xgd24d"), loaded({**content, "disturbance": section("spells")})
    assert vehicle.disturbance is not None
    assert dict(vehicle.parameters) == dict(bare_vehicle.parameters)
    assert key(Estimator(vehicle)) == key(Estimator(bare_vehicle))
