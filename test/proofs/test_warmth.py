# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How cold drives began: alone, and together with one time constant of cooling at rest."""

from dataclasses import replace

import numpy as np
import pytest

from proofs.field.page import Starts, pool, start_states
from trackres_ros.diagnosis import load_base
from trackres_ros.diagnosis.inference.fitting import Problem, fit, with_levels
from trackres_ros.diagnosis.synthetic import drives
from trackres_ros.effects import Active
from trackres_ros.effects.vehicle.warmup import WarmUp

STOOD_S = np.geomspace(30.0, 2e5, 16)


def made(tau, std, seed):
    rng = np.random.default_rng(seed)
    return Starts(-np.expm1(-STOOD_S / tau) + rng.normal(0.0, std, len(STOOD_S)), np.full(len(STOOD_S), std), STOOD_S)


@pytest.mark.parametrize("tau", [600.0, 7200.0])
def test_one_time_constant_is_found_where_start_states_show_it(tau):
    result = pool(made(tau, 0.1, 1), np.random.default_rng(2))
    assert result.low_s < tau < result.high_s
    assert result.settled
    assert result.rank_together > 0.7
    assert result.chance < 0.01
    assert result.reached > 0.9


def test_start_states_that_show_nothing_are_said_to():
    rng = np.random.default_rng(3)
    result = pool(Starts(rng.normal(0.5, 0.8, 16), np.full(16, 0.8), STOOD_S), rng)
    assert result.chance > 0.1
    assert not result.settled
    assert result.reached < 0.5


def test_pooled_states_are_surer_and_nearer_to_the_truth():
    starts = made(3600.0, 0.4, 4)
    result, true = pool(starts, np.random.default_rng(5)), -np.expm1(-STOOD_S / 3600.0)
    assert np.all(result.std <= starts.alone_std)
    assert np.abs(result.state - true).mean() < 0.6 * np.abs(starts.alone - true).mean()


def test_cold_and_warm_starts_of_simulated_drives_are_told_apart():
    base, rng = load_base("bmw_i3").base, np.random.default_rng(6)
    effect = WarmUp().for_size(base.facts.weight * base.facts.radius, True)
    gaps = [np.inf, 10.0, 1e5, 10.0]
    sessions = [replace(s, gap=gap) for s, gap in zip(drives(base, 25.0, 4, 25.0, rng, step=1.0), gaps, strict=True)]
    values = base.nominal
    true = [Active(effect, {"torque": 60.0, "time_constant": 200.0, "cooling": 5000.0})]
    torques = [p.torque + rng.normal(0.0, 10.0, len(p.torque)) for p in base.predict(sessions, values, true)]
    used = [np.abs(s.speed) > 0.5 for s in sessions]
    sessions = [replace(s, torque=t, used=u) for s, t, u in zip(sessions, torques, used, strict=True)]
    fit_result = with_levels(fit(Problem(base, tuple(sessions), tuple(used)), [effect], rounds=2))
    states = start_states(fit_result, gaps)
    np.testing.assert_allclose(states.alone, [1.0, 0.0, 1.0, 0.0], atol=0.2)
    assert (states.alone_std < 0.2).all()
