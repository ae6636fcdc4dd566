# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A mass by stretch between stops: found as it is and as sure as is said, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse
from scipy.signal import lfilter

from trackres_ros.diagnosis import load_base
from trackres_ros.diagnosis.empirical.finders import PAYLOAD, describe, find_terms, residuals_without
from trackres_ros.diagnosis.empirical.payload import (
    STOP_S,
    JointValues,
    find_payload,
    halves,
    mass_of,
    stretch_numbers,
    torque_per_kilogram,
)
from trackres_ros.diagnosis.inference.fitting import Problem, fit
from trackres_ros.diagnosis.selection.locate import torque_residuals
from trackres_ros.diagnosis.synthetic import drives
from trackres_ros.effects import catalogue
from trackres_ros.files.resources import config_dir
from trackres_ros.units import GRAVITY, STANDSTILL_MPS

STRETCH_S, STILL_S = 90, 15
MINUTES, FITTED_S = 20.0, 940.0
NOISE_NM, NOISE_PHI = 40.0, 0.5
SLOPE = 0.01
LOADED_KG = 300.0


@pytest.fixture(scope="module")
def car():
    return load_base(config_dir() / "bmw_i3.yaml").base


@pytest.fixture(scope="module")
def track():
    return load_base("xgd24d").base


def fitted(base, loaded_kg, seed=1, mean_kg=0.0, gain=1.0, later_kg=0.0):
    """A fit to drives that stop every minute and a half, with another mass after each stop, more by so much on the laps that are
    not fitted, and a sensor with a gain; and the masses.
    """
    rng, sessions, masses = np.random.default_rng(seed), [], []
    for drive in drives(base, 30.0, 2, MINUTES, rng, step=1.0):
        phase = drive.time % STRETCH_S
        speed = np.clip(np.minimum(phase / 20.0, (STRETCH_S - STILL_S - phase) / 20.0), 0.0, 1.0)
        speed = 10.0 * speed * (1.0 + 0.2 * np.sin(drive.time / 300.0))
        number = (drive.time // STRETCH_S).astype(int)
        mass = rng.normal(mean_kg, loaded_kg, number.max() + 1)
        mass += np.where(np.arange(len(mass)) * STRETCH_S >= FITTED_S, later_kg, 0.0)
        weight = base.facts.weight + GRAVITY * mass[number]
        course = {"speed": speed, "accel": np.gradient(speed), "grade": np.zeros(len(drive)), "weight": weight}
        sessions.append(replace(drive, **course, given=frozenset({"grade", "load"})))
        masses.append(mass)
    torques = [p.torque for p in base.predict(sessions, base.nominal, ())]
    shown = []
    for session, torque in zip(sessions, torques, strict=True):
        noise = lfilter([1.0], [1.0, -NOISE_PHI], rng.normal(0.0, NOISE_NM, len(torque)))
        is_moving = np.abs(session.speed) > 0.5
        of_file = np.full(len(torque), base.facts.weight)
        shown.append(replace(session, torque=gain * torque + noise, weight=of_file, given=frozenset({"grade"}), used=is_moving))
    problem = Problem(base, tuple(shown), tuple(s.used & (s.time < FITTED_S) for s in shown))
    return fit(problem), masses


def looked_for(found):
    return next((t for t in find_terms(found, None, (), None, waves=False) if t.name == PAYLOAD), None)


@pytest.fixture(scope="module")
def carried(car):
    """A fit to drives with loads, their masses, and the term that is found."""
    result, masses = fitted(car, 250.0)
    return result, masses, looked_for(result)


def check_masses(stretches, masses):
    """Errors are as large as the std says; the mean is the model's own mass."""
    true = np.concatenate([m[: int(FITTED_S // STRETCH_S) + 1] for m in masses])
    mass, std = (np.array([getattr(s, name) for s in stretches]) for name in ("mass", "std"))
    deviation = (mass - mass.mean()) - (true - true.mean())
    assert np.sqrt(np.mean((deviation / std) ** 2)) < 1.5
    assert np.sqrt(np.mean(deviation**2)) < 0.4 * true.std()


def test_masses_are_found_as_sure_as_is_said(car, carried):
    other, other_masses = fitted(car, 250.0, seed=2)
    for masses, term in (carried[1:], (other_masses, looked_for(other))):
        statement = describe(term, term.fit)
        check_masses(statement.pattern.stretches, masses)
        assert "kg less and" in statement.sentence


def test_masses_do_not_depend_on_where_the_last_fit_ended(carried):
    result = carried[0]
    point = result.point + [0.01 * (f.key[0] == "torque_gain") for f in result.free]
    moved = replace(result, point=point, predicted=result.problem.predict(*result.model_at(point)))
    mean, moved_mean = (np.mean([s.mass for s in find_payload(f, torque_residuals(f)).stretches]) for f in (result, moved))
    assert moved_mean == pytest.approx(mean, abs=0.001 * mass_of(result))


@pytest.mark.parametrize("seed", range(2))
def test_a_vehicle_that_weighs_the_same_has_no_payload(car, seed):
    assert looked_for(fitted(car, 0.0, seed)[0]) is None


def test_nothing_is_looked_for_where_loads_are_recorded(carried):
    result = carried[0]
    sessions = tuple(replace(s, given=s.given | {"load"}) for s in result.problem.sessions)
    result = replace(result, problem=replace(result.problem, sessions=sessions))
    assert find_payload(result, [np.zeros(len(s)) for s in result.problem.sessions]) is None


def test_earlier_payload_measurements_improve_unfitted_laps(carried):
    result, _, term = carried
    with_term, problem = term.fit, result.problem
    without = residuals_without(with_term, PAYLOAD)
    later = [s.used & ~m for s, m in zip(problem.sessions, problem.masks, strict=True)]
    adds = with_term.contribution(PAYLOAD)
    result_before, result_after = (
        np.mean(np.abs(np.concatenate([r[m] for r, m in zip(item, later, strict=True)])))
        for item in (without, [r - x for r, x in zip(without, adds, strict=True)])
    )
    assert result_after < 0.95 * result_before


def test_the_other_half_of_a_stretch_forecasts_its_mass(carried):
    result = carried[0]
    session, mask = result.problem.sessions[0], result.problem.masks[0]
    number = stretch_numbers(session)
    early = mask & (number == 3) & (halves(number, mask) == 0)
    residuals = torque_residuals(result)
    heavier = [residuals[0] + early * torque_per_kilogram(result, mass_of(result))[0] * LOADED_KG, *residuals[1:]]
    result_before, result_after = (find_payload(result, r) for r in (residuals, heavier))
    fit_result, forecast = (np.abs(result_after.level * y[0] - result_before.level * x[0]) for x, y in
                        ((result_before.shape, result_after.shape), (result_before.ahead, result_after.ahead)))  # fmt: skip
    later = mask & (number == 3) & ~early
    assert forecast[early].mean() < 0.2 * fit_result[early].mean()
    assert forecast[later].mean() > fit_result[later].mean()


def test_a_vehicle_that_stands_is_not_pushed(carried):
    term = carried[2]
    for session, shape in zip(term.fit.problem.sessions, term.pattern.shape, strict=True):
        assert not shape[np.abs(session.speed) < STANDSTILL_MPS].any()


def test_mass_errors_match_their_std_with_learned_slopes(car, carried):
    result, masses, _ = carried
    problem, rng = result.problem, np.random.default_rng(1)
    radius, places = car.facts.radius, STRETCH_S
    slope = rng.normal(0.0, SLOPE, places)
    places_here = [(s.time % STRETCH_S).astype(int) for s in problem.sessions]  # it speeds up at the same places, loaded or not
    columns = tuple(
        sparse.csr_matrix((s.weight * radius, (np.arange(len(s)), place)), (len(s), places))
        for s, place in zip(problem.sessions, places_here, strict=True)
    )
    remainders = [s.torque - p.torque + z @ slope for s, p, z in zip(problem.sessions, result.predicted, columns, strict=True)]
    count, total = np.zeros(places), np.zeros(places)
    for residual, place, mask, session in zip(remainders, places_here, problem.masks, problem.sessions, strict=True):
        np.add.at(total, place[mask], residual[mask] / (session.weight[mask] * radius))
        np.add.at(count, place[mask], 1.0)
    adds = tuple(z @ (total / np.maximum(count, 1.0)) for z in columns)
    slopes = JointValues(adds, columns, (sparse.identity(places) / SLOPE**2).tocsc(), np.zeros(places))
    payload = find_payload(result, [r - x for r, x in zip(remainders, adds, strict=True)], slopes)
    check_masses(payload.stretches, masses)


@pytest.fixture(scope="module")
def chosen(explained):
    """What explains a fit, of what a load may be taken for."""

    def choose(found):
        facts = found.problem.base.facts
        total = catalogue(None, facts.weight * facts.radius)
        return explained(found, {name: total[name] for name in ("torque_gain", "rotating_inertia")}).chosen

    return choose


def test_loads_with_a_mean_offset_are_payload_not_torque_scale(track, chosen):
    result, masses = fitted(track, 900.0, mean_kg=1800.0)
    item = chosen(result)
    assert item.explanation.key == {PAYLOAD}
    statement = describe(item.explanation.terms[PAYLOAD], item.final)
    true = np.concatenate([m[: int(FITTED_S // STRETCH_S) + 1] for m in masses])
    mass = np.array([s.mass for s in statement.pattern.stretches])
    assert mass.mean() == pytest.approx(true.mean(), rel=0.25)
    assert np.corrcoef(mass, true)[0, 1] > 0.8


def test_a_torque_of_another_scale_is_named_and_no_payload(track, chosen):
    (term,) = chosen(fitted(track, 0.0, gain=1.06)[0]).explanation.terms.values()
    assert "torque_gain" in term.members
    assert PAYLOAD not in term.members


def test_a_term_that_laps_refute_yields_to_a_confirmed_payload(track, chosen):
    item = chosen(fitted(track, 900.0, mean_kg=1800.0, later_kg=-3600.0)[0])
    assert item.explanation.key == {PAYLOAD}
    assert item.explanation.terms[PAYLOAD].confirmed


def test_a_stop_ends_its_stretch_and_a_short_stop_begins_none(car):
    session = drives(car, 30.0, 1, 2.0, np.random.default_rng(1), step=1.0)[0]
    speed = np.full(len(session), 5.0)
    speed[:7], speed[30 : 30 + int(STOP_S) - 1], speed[60:70] = 0.0, 0.0, 0.0
    numbers = stretch_numbers(replace(session, speed=speed))
    assert (numbers[:70] == 0).all()
    assert (numbers[70:] == 1).all()
