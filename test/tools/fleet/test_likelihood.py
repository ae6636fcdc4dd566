# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Likelihood of one recording about its vehicle, whatever the day's weather."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from proofs.fleet import FASTEST_MPS
from proofs.sealed.belt import read_data_sheet
from proofs.sealed.drives import drive
from proofs.sealed.truth import Build, Sensors, record, simulate_truth
from trackres_ros import read
from trackres_ros.diagnosis.base.loading import load_base
from trackres_ros.files.resources import find_vehicle
from trackres_ros.tools.fleet.likelihood import evidence, marginal
from trackres_ros.tools.fleet.sample import VEHICLE

ROUNDING = 1e-12


@given(st.integers(1, 5), st.integers(0, 3), st.integers(0, 2**31))
def test_what_others_are_is_integrated_out(kept, others, seed):
    """As the covariance of all of them has it, the others' prior in it."""
    rng = np.random.default_rng(seed)
    slopes = rng.normal(size=(20, kept + others))
    precision, linear = slopes.T @ slopes, rng.normal(size=kept + others)
    own = rng.permutation(kept + others) < kept
    left, moved = marginal(precision, linear, own)
    covariance = np.linalg.inv(precision + np.diag(~own).astype(float))
    assert np.linalg.inv(left) == pytest.approx(covariance[np.ix_(own, own)])
    assert np.linalg.solve(left, moved) == pytest.approx((covariance @ linear)[own])
    surer = left - precision[np.ix_(own, own)]
    assert np.linalg.eigvalsh(surer).max() < ROUNDING * np.linalg.norm(precision)


@pytest.fixture(scope="module")
def days(tmp_path_factory):
    """What two recordings of one drive say, of a day without wind and of a windy one; and one without headings."""
    folder, sheet = tmp_path_factory.mktemp("days"), find_vehicle(VEHICLE)
    numbers = read_data_sheet(sheet)
    one = drive(12.0, numbers["weight"], 15.0, FASTEST_MPS, np.random.default_rng(5))
    found = []
    for name, wind in (("calm", 0.0), ("windy", 5.0)):
        (run,) = simulate_truth(sheet, Build(), {"headwind": {"wind": wind, "towards": 0.7}}, [one])
        path = folder / f"{name}.csv"
        record(path, one, run, Sensors(belt_measured=False), numbers["track.sprocket_radius"], 1.75e9, np.random.default_rng(6))
        found.append(path)
    loaded = load_base(VEHICLE)
    return [
        evidence(read(path).without(hide), loaded)
        for path, hide in ((found[0], ()), (found[1], ()), (found[1], ("heading", "yaw_rate")))
    ]


def test_a_windy_day_says_the_same_of_the_vehicle(days):
    calm, windy, unseen = days
    assert calm.names == windy.names == unseen.names
    own = [calm.names.index(name) for name in ("drag_coefficient", "bearing_friction", "film_scale", "capacity_scale")]
    off, blind = (np.linalg.norm((one.point - calm.point)[own] / calm.std[own]) for one in (windy, unseen))
    assert off < 0.6 * blind
    assert windy.residual_std < unseen.residual_std


def test_a_recording_never_says_less_than_nothing(days):
    """Without information on a parameter the precision is zero, up to the rounding of the largest."""
    _, windy, _ = days
    directions = np.linalg.eigvalsh(windy.precision)
    assert directions.min() > -ROUNDING * directions.max()
    assert windy.precision.shape == (len(windy.names),) * 2
