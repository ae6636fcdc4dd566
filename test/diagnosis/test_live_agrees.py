"""The effects as the live estimator runs them, message by message, against the series a fit simulates."""

from dataclasses import replace

import numpy as np
import pytest

from trackres_ros.diagnosis.trial import STEP_S, drives
from trackres_ros.effects import Active, catalogue
from trackres_ros.estimator import layout as at
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.vehicle import load

START_NS = 1_700_000_000_000_000_000
CHANNELS = {"load": "weight", "ambient": "ambient", "yaw_rate": "yaw_rate", "heading": "heading", "accel": "accel"}


@pytest.fixture(scope="module")
def drive(loaded):
    (session,) = drives(loaded.base, loaded.known.max_speed, 1, 8.0, np.random.default_rng(3))
    return session


def live(effects, session):
    """Rows of results of the live estimator, all channels sent with each speed."""
    estimator = Estimator(replace(load("xgd24d"), effects=tuple(effects)))
    live_session, rows = estimator.session(), []
    for i in range(len(session)):
        now = START_NS + round(i * STEP_S * 1e9)
        for channel, name in CHANNELS.items():
            live_session.handle(live_session.channel(channel), now, now, float(getattr(session, name)[i]))
        rows.append(live_session.handle(at.SPEED, now, now, float(session.speed[i])).row)
    return estimator, np.array(rows)


def simulated(base, effects, session):
    values = {q.name: q.nominal for q in base.parameters}
    drive = np.zeros(len(session))
    for _ in range(3):  # the torque that some effects look at is that of the step before
        (predicted,) = base.predict([session], values, effects, [drive])
        drive = np.concatenate(([0.0], predicted.at_sprockets[:-1]))
    return predicted


@pytest.mark.parametrize("name", [None, *(name for name, effect in catalogue().items() if effect.belongs_to != "sensor")])
def test_live_and_fitted_are_one(loaded, effects, drive, name):
    active = [] if name is None else [Active(effects[name], effects[name].values())]
    estimator, rows = live(active, drive)
    predicted = simulated(loaded.base, active, drive)
    assert np.abs(rows[:, at.OUT_DRIVE] - predicted.at_sprockets).max() < 2.0
    belt = np.mean([rows[:, estimator.column_index[f"belt_degc/{a}"]] for a in estimator.assemblies], axis=0)
    assert np.abs(belt - predicted.belt).max() < 0.1


def test_several_effects_at_once(loaded, effects, drive):
    names = ("warmup", "solar", "turning_scrub", "ground_conduction")
    active = [Active(effects[name], effects[name].values()) for name in names]
    _, rows = live(active, drive)
    assert np.abs(rows[:, at.OUT_DRIVE] - simulated(loaded.base, active, drive).at_sprockets).max() < 2.0
    assert rows[:, at.OUT_EFFECTS].max() > 150.0


def test_without_its_input_an_effect_is_left_out_and_that_is_said(effects):
    scrub = Active(effects["turning_scrub"], effects["turning_scrub"].values())
    session = Estimator(replace(load("xgd24d"), effects=(scrub,))).session()
    estimate = session.handle(at.SPEED, START_NS, START_NS, 5.0)
    assert at.Reason.EFFECT_LEFT_OUT in estimate.reasons
    assert estimate["effects_nm"] == 0.0
    session.handle(session.channel("yaw_rate"), START_NS + 1, START_NS + 1, 0.2)
    later = session.handle(at.SPEED, START_NS + 10**8, START_NS + 10**8, 5.0)
    assert at.Reason.EFFECT_LEFT_OUT not in later.reasons
    assert later["effects_nm"] > 10.0


def test_what_was_saved_goes_on_as_if_it_had_not_stopped(effects, tmp_path, drive):
    from trackres_ros.estimator import snapshot

    warm = Active(effects["warmup"], effects["warmup"].values())
    estimator = Estimator(replace(load("xgd24d"), effects=(warm,)))
    session = estimator.session()
    for i in range(600):
        session.handle(at.SPEED, START_NS + i * 10**8, START_NS + i * 10**8, 5.0)
    snapshot.save(session, tmp_path / "state", saved_at=0.0)
    resumed = snapshot.resume(estimator, tmp_path / "state")
    now = START_NS + 600 * 10**8
    np.testing.assert_array_equal(session.handle(at.SPEED, now, now, 5.0).row, resumed.handle(at.SPEED, now, now, 5.0).row)
    cold, _ = snapshot.after_time_off(estimator, tmp_path / "state", now=1e6)
    after, before = cold.handle(at.SPEED, now, now, 5.0), resumed.handle(at.SPEED, now + 10**8, now + 10**8, 5.0)
    assert after["effects_nm"] > before["effects_nm"] + 10.0  # the oil has cooled too
