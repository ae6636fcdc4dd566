# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A measured belt temperature corrects the state, as far as the two variances say."""

from dataclasses import replace

import numpy as np
import pytest

from trackres_ros.estimator.columns import Reason
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.settings import Settings
from trackres_ros.vehicle import load

SPEED = 30 / 3.6


def warm(estimator, measured=None):
    inputs = estimator.inputs(SPEED, ambient=15.0)
    state = estimator.cold_start(inputs)
    state, before = estimator.step(state, inputs, 0.1)
    if measured is None:
        return before, before
    belts = np.full(len(estimator.assemblies), np.nan)
    belts[1] = measured
    state, after = estimator.step(state, estimator.inputs(SPEED, ambient=15.0, belt_measured=belts), 1e-6)
    return before, after


def test_correction_is_weighted_by_the_variances(reference):
    before, after = warm(reference, 35.0)
    std = before.belt_std_k()[1]
    gain = std**2 / (std**2 + reference.settings.belt_measured_std_k**2)
    assert after.belt_degc()[1] == pytest.approx(before.belt_degc()[1] + gain * (35.0 - before.belt_degc()[1]), rel=1e-3)
    assert after.belt_std_k()[1] == pytest.approx(std * (1 - gain) ** 0.5, rel=1e-3)
    assert after.belt_degc()[0] == pytest.approx(before.belt_degc()[0], abs=1e-3)


def test_many_measurements_pull_a_wrong_start_to_the_truth(reference):
    truth_state = reference.cold_start(reference.inputs(SPEED, ambient=15.0), belt_degc=45.0)
    inputs = reference.inputs(SPEED, ambient=15.0)
    state = reference.cold_start(inputs)
    random = np.random.default_rng(3)
    for _ in range(120):
        truth_state, truth = reference.step(truth_state, inputs, 1.0)
        measured_degc = truth.belt_degc() + random.normal(0, 3.0, 4)
        state, estimate = reference.step(state, reference.inputs(SPEED, ambient=15.0, belt_measured=measured_degc), 1.0)
    error = estimate.belt_degc() - truth.belt_degc()
    assert np.abs(error).max() < 2.0
    assert np.abs(error).max() < 4 * estimate.belt_std_k().max()


def test_a_surface_sensor_is_not_taken_for_the_mean():
    vehicle = load("xgd24d")
    surface = Estimator(vehicle, Settings(belt_sensor="surface", belt_measured_std_k=0.5))
    inputs = surface.inputs(SPEED, ambient=15.0)
    state, estimate = surface.step(surface.cold_start(inputs, belt_degc=60.0, belt_std_k=5.0), inputs, 0.1)
    surface_degc = estimate["surface_degc/front_left"]
    assert 15.0 < surface_degc < 45.0 < estimate.belt_degc()[0]
    state, estimate_2 = surface.step(state, surface.inputs(SPEED, ambient=15.0, belt_measured=np.full(4, surface_degc)), 1e-6)
    assert estimate_2.belt_degc()[0] == pytest.approx(estimate.belt_degc()[0], abs=0.05)


@pytest.mark.parametrize("sensor", ["mean", "surface"])
def test_two_nodes_are_corrected_together(sensor):
    vehicle = replace(load("xgd24d"), thermal="core_surface")
    estimator = Estimator(vehicle, Settings(belt_sensor=sensor, belt_measured_std_k=1.0))
    inputs = estimator.inputs(SPEED, ambient=15.0)
    state = estimator.cold_start(inputs)
    for _ in range(120):
        state, estimate = estimator.step(state, inputs, 1.0)
    sensor_degc = estimate.belt_degc() if sensor == "mean" else np.full(4, estimate["surface_degc/front_left"])
    _, estimate_2 = estimator.step(state, estimator.inputs(SPEED, ambient=15.0, belt_measured=sensor_degc + 10.0), 1e-6)
    assert estimate_2.belt_degc()[0] > estimate.belt_degc()[0] + 2.0
    assert estimate_2["surface_degc/front_left"] > estimate["surface_degc/front_left"] + 2.0
    assert (estimate_2.belt_std_k() < estimate.belt_std_k()).all()


def test_a_sensor_far_off_is_left_out_and_reported(reference):
    before, after = warm(reference, 150.0)
    assert after.reasons & Reason.BELT_SENSOR_DISAGREES
    assert after.belt_degc()[1] == pytest.approx(before.belt_degc()[1], abs=1e-3)
