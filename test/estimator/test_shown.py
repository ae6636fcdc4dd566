# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Texts of the estimator's objects."""

import doctest

import numpy as np

from trackres_ros.estimator import estimator as module
from trackres_ros.estimator.records import Steps


def test_each_says_what_it_is_in_one_line(reference):
    inputs = reference.inputs(speed=10.0, ambient=12.0)
    state, estimate = reference.step(reference.cold_start(inputs, belt_degc=31.0), inputs, 0.0)
    assert repr(reference) == (
        "<Estimator of xgd24d: assemblies front_left, front_right, rear_left, rear_right; spectral, lumped>"
    )
    assert "belts 31.0, 31.0, 31.0, 31.0 degC" in repr(state)
    assert "speed 10.00 m/s" in repr(state)
    assert f"resistance {estimate.resistance_torque_nm:.0f} +- {estimate.resistance_std_nm:.0f} Nm" in repr(estimate)
    assert estimate.status in repr(estimate)
    assert all(text in repr(estimate) for text in estimate.reason_texts())
    stamps = np.arange(5) * 500_000_000
    assert repr(Steps(stamps, stamps, np.zeros((5, 2)))) == "<Steps: 5 over 2.0 s>"
    assert repr(Steps(stamps[:0], stamps[:0], np.zeros((0, 2)))) == "<Steps: 0 over 0.0 s>"


def test_its_example_holds():
    failures, examples = doctest.testmod(module)
    assert (failures, examples) == (0, 7)
