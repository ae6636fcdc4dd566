# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Values that predict: on residuals that wander and lean, as those of real roads do."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from trackres_ros.diagnosis import load_base
from trackres_ros.diagnosis.inference.fitting import Problem, fit, for_tests, with_levels
from trackres_ros.diagnosis.synthetic import drives

STEP_S = 1.0
TRAINED, MINUTES = 3, 25.0  # the last of four drives is held out


@pytest.fixture(scope="module")
def road():
    return load_base("bmw_i3")


def street(seed, road, slow_nm=60.0, slow_s=120.0, quick_nm=12.0, misfit=0.06):
    """Sessions of a car on streets: slopes that no one measured, shocks that lean to one side, a powertrain that is bent."""
    rng, base = np.random.default_rng(seed), road.base
    sessions = drives(base, road.known.max_speed / 2.0, TRAINED + 1, MINUTES, rng, STEP_S)
    true = {q.name: q.nominal + 0.7 * q.std for q in base.parameters}
    results = []
    for session, prediction in zip(sessions, base.predict(sessions, true, ()), strict=True):
        n = len(session)
        keep = np.exp(-STEP_S / slow_s)
        slow = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.normal(0.0, slow_nm, n))
        leaning = rng.exponential(quick_nm, n) * (rng.random(n) < 0.5)
        inertia = base.facts.radius * session.weight / 9.81 * session.accel
        shown = prediction.torque + slow + leaning - leaning.mean() + misfit * np.maximum(inertia, 0.0)
        used = np.abs(session.speed) > road.known.slowest
        results.append(replace(session, torque=shown, used=used, torque_course=None))
    return tuple(results)


def problem_of(sessions, road):
    masks = tuple(s.used & (i < TRAINED) for i, s in enumerate(sessions))
    return Problem(road.base, sessions, masks)


def errors(found, trained):
    item = [(s.torque - p.torque)[s.used] for s, p in zip(found.problem.sessions, found.predicted, strict=True)]
    return np.concatenate(item[:TRAINED] if trained else item[TRAINED:])


@pytest.mark.long
def test_an_unbiased_refit_is_no_worse_than_file_or_robust_fit(road, robust_least_squares):
    means, ours, files, robust = [], [], [], []
    for seed in range(6):
        problem = problem_of(street(seed, road), road)
        levelled = with_levels(fit(problem))
        means.append(errors(levelled, trained=True).mean() / errors(levelled, trained=True).std())
        ours.append(np.abs(errors(levelled, trained=False)).mean())
        nominal = problem.predict(road.base.nominal, ())
        files.append(np.abs(errors(replace(levelled, predicted=tuple(nominal)), trained=False)).mean())
        robust.append(np.abs(errors(replace(levelled, predicted=tuple(robust_least_squares(problem))), trained=False)).mean())
    assert np.max(np.abs(means)) < 0.1
    assert np.mean(ours) < np.mean(files)
    assert np.mean(ours) <= 1.01 * np.mean(robust)


def test_near_a_unit_root_the_level_fit_halves_the_bias(road):
    """What the fit for tests is off by in level is what the values are not: else the two need not be kept apart."""
    leaning = [fit(problem_of(street(seed, road), road)) for seed in range(3)]
    for tested in leaning:
        assert np.abs(np.roots(np.concatenate(([1.0], -tested.noise.phi)))).max() > 0.9
    result_before = np.mean([abs(errors(tested, trained=True).mean()) for tested in leaning])
    result_after = np.mean([abs(errors(with_levels(tested), trained=True).mean()) for tested in leaning])
    assert result_after < 0.5 * result_before


def test_where_noise_is_short_both_are_one(loaded):
    rng, base = np.random.default_rng(4), loaded.base
    sessions = drives(base, loaded.known.max_speed, 2, 10.0, rng, STEP_S)
    prediction = base.predict(sessions, base.nominal, ())
    shown_text = tuple(
        replace(s, torque=p.torque + rng.normal(0.0, 20.0, len(s))) for s, p in zip(sessions, prediction, strict=True)
    )
    result = fit(Problem(base, shown_text, tuple(s.used for s in shown_text)))
    levelled = with_levels(result)
    for f in result.free:
        assert levelled.estimates[f.key] == pytest.approx(result.estimates[f.key], abs=0.3 * result.std_of(*f.key))


def test_the_noise_for_tests_is_whitened_as_far_as_it_goes(road):
    levelled = with_levels(fit(problem_of(street(1, road), road)))
    e = np.concatenate([w[np.isfinite(w)] for w in for_tests(levelled).white])
    remainder = np.concatenate([w[np.isfinite(w)] for w in levelled.white])
    assert abs(np.corrcoef(e[1:], e[:-1])[0, 1]) < 0.1 < np.corrcoef(remainder[1:], remainder[:-1])[0, 1]
