# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What every torque sensor does a little is fitted along and is no finding; what is more than that is found as before."""

from dataclasses import replace

import numpy as np
import pytest

from trackres_ros.diagnosis import DiagnosisOptions, diagnose, read_recordings
from trackres_ros.diagnosis.base.instrument import MOST_DELAY_S, MOST_GAIN, MOST_OFFSET_NM, instrument
from trackres_ros.diagnosis.inference import fitting
from trackres_ros.diagnosis.inference.fitting import Problem, fit
from trackres_ros.diagnosis.synthetic import drives, write_recordings
from trackres_ros.effects import Active
from trackres_ros.effects.effect import REFERENCE_NM

SMALL = {"delay": 0.05, "torque_gain": 0.005, "torque_offset": 20.0}
LARGE = {"delay": 0.3, "torque_offset": 300.0, "torque_gain": 0.05}


def sensors(effects, values):
    return [Active(effects[name], {effects[name].parameters[0].name: value}) for name, value in values.items()]


@pytest.fixture(scope="module")
def problem_with(loaded, effects):
    """Drives as a base with effects would show them, with little noise."""

    def make(values):
        base, rng = loaded.base, np.random.default_rng(6)
        sessions = drives(base, loaded.known.max_speed, 2, 8.0, np.random.default_rng(4), step=1.0)
        shown = base.predict(sessions, base.nominal, sensors(effects, values))
        measured = [replace(s, torque=p.torque + rng.normal(0.0, 5.0, len(s))) for s, p in zip(sessions, shown, strict=True)]
        return Problem(base, tuple(measured), tuple(s.used for s in measured))

    return make


def test_an_instrument_stays_within_its_bounds(loaded, problem_with):
    size = loaded.base.facts.weight * loaded.base.facts.radius / REFERENCE_NM
    most = {"delay": MOST_DELAY_S, "torque_gain": MOST_GAIN, "torque_offset": MOST_OFFSET_NM * size}
    for effect in instrument(loaded.base):
        (q,) = effect.parameters
        assert (-q.low, q.high) == (most[effect.name], most[effect.name])
    result = fit(problem_with({"torque_offset": 300.0, "torque_gain": 0.05}))
    assert {a.effect.name for a in result.instrument} == set(most)
    for active in result.instrument:
        (value,) = active.values.values()
        assert abs(value) <= most[active.effect.name]


def test_what_is_of_an_instruments_size_is_found_as_that(problem_with):
    result = fit(problem_with(SMALL))
    assert result.effects == ()
    assert result.effect_names == ()
    values = {a.effect.name: next(iter(a.values.values())) for a in result.instrument}
    for name, value in SMALL.items():
        (parameter,) = (q.name for a in result.instrument if a.effect.name == name for q in a.effect.parameters)
        assert values[name] == pytest.approx(value, abs=max(4.0 * result.std_of(name, parameter), 0.1 * value))
    assert result.acting == result.instrument
    by_file = [p.torque for p in result.problem.predict(result.base_values, ())]
    shifted = np.concatenate([p.torque for p in result.predicted]) - np.concatenate(by_file)
    assert np.abs(shifted).max() > 10.0


def test_a_fit_ends_where_a_closer_one_ends(problem_with, effects, monkeypatch):
    problem, stribeck, rng = problem_with({}), effects["stribeck"], np.random.default_rng(7)
    lacking = Active(stribeck, {q.name: q.start for q in stribeck.parameters})
    shown = problem.predict(problem.base.nominal | {"bearing_friction": 0.006}, [lacking])
    torques = [p.torque + 15.0 * rng.standard_t(3.0, len(p.torque)) for p in shown]
    sessions = tuple(replace(s, torque=t) for s, t in zip(problem.sessions, torques, strict=True))
    result = fit(replace(problem, sessions=sessions), [stribeck])
    monkeypatch.setattr(fitting, "CLOSE", 1e-4 * fitting.CLOSE)
    monkeypatch.setattr(fitting, "NEARBY", 0.01 * fitting.NEARBY)
    closer = fit(result.problem, [stribeck], result.estimates, result.noises)
    assert closer.log_likelihood - result.log_likelihood < 0.05


@pytest.mark.parametrize("name", LARGE)
def test_a_sensor_effect_replaces_the_instruments_own_term(name, problem_with, effects):
    result = fit(problem_with({name: LARGE[name]}), [effects[name]])
    assert name not in {a.effect.name for a in result.instrument}
    assert len(result.instrument) == len(instrument(result.problem.base)) - 1
    keys = [f.key for f in result.free]
    assert len(set(keys)) == len(keys)
    (value,) = result.effects[0].values.values()
    assert value == pytest.approx(LARGE[name], rel=0.1)


@pytest.fixture
def diagnosed_with(loaded, effects, tmp_path):
    """A diagnosis of recordings by a sensor with such errors."""

    def it(values):
        rng = np.random.default_rng(7)
        sessions = drives(loaded.base, loaded.known.max_speed, 2, 10.0, rng)
        paths = write_recordings(loaded.base, tmp_path, sessions, sensors(effects, values), rng)
        return diagnose(read_recordings(paths, None), loaded, DiagnosisOptions(quick=True))

    return it


@pytest.mark.long
def test_what_is_of_an_instruments_size_is_no_finding(diagnosed_with):
    result = diagnosed_with(SMALL)
    assert result.found == ()
    assert result.verdict.status == "none"
    assert not any(result.verdict.sentence.startswith(name) for name in SMALL)
    assert not any(a.effect.belongs_to == "sensor" for a in result.kept.effects)


@pytest.mark.long
@pytest.mark.parametrize("name", ["delay", "torque_offset"])  # a gain of 1.06 is named in test_payload.py
def test_what_no_instrument_does_is_named(name, diagnosed_with):
    result = diagnosed_with({name: LARGE[name]})
    (first,) = result.found
    assert name in first.members  # a constant may be one of several here
    if first.name == name:
        assert name not in {a.effect.name for a in result.final.instrument}
        (value,) = first.values.values()
        (within,) = first.intervals.values()
        assert within.low <= LARGE[name] <= within.high, (value, within)
