# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The filter's step: laws for any gain, and the knowledge of a part given the whole."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.learning.parameters import age_estimate, conditional_mean, correct_estimate, expected_residual, spread

SIZE = 4


def covariance_of(seed):
    root = np.random.default_rng(seed).normal(size=(SIZE, SIZE))
    return root @ root.T + 0.1 * np.eye(SIZE)


@given(seed=st.integers(0, 10_000), variance=st.floats(0.01, 1e3), departure=st.floats(-1e3, 1e3), free=st.integers(0, 15))
def test_an_update_never_raises_variance_and_stays_a_covariance(seed, variance, departure, free):
    random, covariance = np.random.default_rng(seed + 1), covariance_of(seed)
    mean, sensitivities = random.normal(size=SIZE), random.normal(size=SIZE)
    mask = np.array([bool(free >> i & 1) for i in range(SIZE)])
    before_mean, old_covariance = mean.copy(), covariance.copy()
    correct_estimate(mean, covariance, sensitivities, departure, variance, mask)
    assert covariance == pytest.approx(covariance.T, abs=1e-9)
    assert np.linalg.eigvalsh(covariance).min() > -1e-9
    assert np.array_equal(mean[~mask], before_mean[~mask])
    assert covariance[np.ix_(~mask, ~mask)] == pytest.approx(old_covariance[np.ix_(~mask, ~mask)])
    if mask.all():
        assert np.linalg.eigvalsh(old_covariance - covariance).min() > -1e-9


def test_it_is_least_squares_with_a_prior():
    random, prior = np.random.default_rng(3), covariance_of(3)
    truth = random.normal(size=SIZE)
    sensitivities = random.normal(size=(50, SIZE))
    measurements = sensitivities @ truth + random.normal(0.0, 0.5, 50)
    mean, covariance = np.zeros(SIZE), prior.copy()
    for row, value in zip(sensitivities, measurements, strict=True):
        correct_estimate(mean, covariance, row, value - expected_residual(mean, row), 0.25, np.ones(SIZE, dtype=bool))
    information = np.linalg.inv(prior) + sensitivities.T @ sensitivities / 0.25
    assert covariance == pytest.approx(np.linalg.inv(information), rel=1e-6, abs=1e-9)
    assert mean == pytest.approx(np.linalg.solve(information, sensitivities.T @ measurements / 0.25), rel=1e-6)


def test_what_ages_goes_to_what_it_is_without_being_seen():
    mean, covariance = np.ones(SIZE), np.eye(SIZE)
    shares = np.full(SIZE, 0.9)
    for _ in range(500):
        age_estimate(mean, covariance, shares, np.full(SIZE, 4.0 * (1.0 - 0.81)))
    assert mean == pytest.approx(0.0, abs=1e-9)
    assert np.diag(covariance) == pytest.approx(4.0)


def test_if_only_a_sum_is_known_one_free_part_takes_all_of_it():
    mean, covariance = np.zeros(2), np.diag([4.0, 1.0])
    sensitivities = np.ones(2)
    for _ in range(200):
        correct_estimate(
            mean, covariance, sensitivities, 1.0 - expected_residual(mean, sensitivities), 0.01, np.ones(2, dtype=bool)
        )
    assert mean == pytest.approx([0.8, 0.2], abs=1e-3)
    only_first = np.array([True, False])
    assert conditional_mean(mean, covariance, only_first) == pytest.approx([1.0, 0.0], abs=1e-3)
    assert spread(covariance, sensitivities)[1] < 1e-3


def test_nothing_that_counts_moves_nothing():
    assert not conditional_mean(np.ones(SIZE), covariance_of(1), np.zeros(SIZE, dtype=bool)).any()
