# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Steps, hinges, latches and gains for one sign: offered where they are, with their thresholds, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest

from trackres_ros.diagnosis import read_recordings
from trackres_ros.diagnosis.empirical.candidates import candidates, shows
from trackres_ros.diagnosis.empirical.thresholds import found_by_scan, latched_states
from trackres_ros.diagnosis.inference.fitting import Problem, fit
from trackres_ros.diagnosis.stages.prepare import prepared
from trackres_ros.effects.learned import ABOVE, AMBIENT, BELT, SPEED, STEP, Corner, Latch, latched

LEVEL_NM = 400.0


@pytest.fixture(scope="module")
def fitted(recorded, loaded):
    """A fit of recordings with nothing hidden."""
    gated, _, _ = prepared(read_recordings(recorded(), None), loaded, (), ())
    return fit(Problem(loaded.base, gated.sessions, tuple(s.used for s in gated.sessions)))


def test_time_lost_by_a_corrected_clock_is_excluded(recorded, loaded):
    recordings = read_recordings(recorded(), None)
    torque = recordings[0].series["torque"]
    late = replace(torque, stamp_ns=torque.stamp_ns + 6_000_000_000)
    recordings[0] = replace(recordings[0], series={**recordings[0].series, "torque": late})
    gated, _, before = prepared(recordings, loaded)
    lost = sum((s.used.sum() - t.used.sum()) * s.step for s, t in zip(before, gated.sessions, strict=True))
    assert gated.excluded["torque lost by the correction of its clock"] == round(lost) > 0
    assert any("corrected" in note for note in gated.notes)


def scanned(fitted, code, x, shapes):
    """Result of a scan of one variable after a torque of a shape is added to the measured one."""
    sessions = tuple(
        replace(s, torque=s.torque + LEVEL_NM * shape * np.sign(s.speed))
        for s, shape in zip(fitted.problem.sessions, shapes, strict=True)
    )
    return found_by_scan(replace(fitted, problem=replace(fitted.problem, sessions=sessions)), {code: x})


def test_a_scan_finds_the_thresholds_of_what_is_there(fitted):
    speed = [np.abs(s.speed) for s in fitted.problem.sessions]
    belt = [p.belt for p in fitted.predicted]
    warm = float(np.median(np.concatenate(belt)))
    high = float(np.quantile(np.concatenate(belt), 0.98))
    by_kind = {
        STEP: scanned(fitted, SPEED, speed, [1.0 * (x > 5.0) for x in speed]),
        ABOVE: scanned(fitted, BELT, belt, [np.clip((x - warm) / (high - warm), 0.0, 1.0) for x in belt]),
        "latch": scanned(fitted, SPEED, speed, [latched_states(x, np.array([3.0]), np.array([7.0]))[:, 0] for x in speed]),
    }
    (step,) = [f for f in by_kind[STEP] if isinstance(f, Corner) and f.kind == STEP]
    assert step.values()["threshold"] == pytest.approx(5.0, abs=0.1)
    assert not any(isinstance(f, Latch) for f in by_kind[STEP])
    (hinge,) = [f for f in by_kind[ABOVE] if isinstance(f, Corner) and f.kind == ABOVE]
    assert hinge.values()["threshold"] == pytest.approx(warm, abs=0.15 * np.ptp(np.concatenate(belt)))
    (latch,) = [f for f in by_kind["latch"] if isinstance(f, Latch)]
    assert (latch.values()["off"], latch.values()["on"]) == pytest.approx((3.0, 7.0), abs=0.3)


def test_where_nothing_is_hidden_a_scan_offers_few_forms(fitted):
    names = [form.name for form in candidates(fitted).values()]
    assert sum(name.startswith(("step", "hinge", "latch")) for name in names) <= 4
    assert "curve_of_belt_temperature" in names


def test_a_negative_torque_is_its_own_side_only_in_reverse(fitted):
    back = tuple(replace(s, speed=-s.speed) for s in fitted.problem.sessions)
    for sessions, extra in ((fitted.problem.sessions, set()), (back, {"gain_while_negative"})):  # forwards it brakes
        names = {form.name for form in candidates(replace(fitted, problem=replace(fitted.problem, sessions=sessions))).values()}
        assert {n for n in names if n.startswith("gain_while")} == {"gain_while_driving", "gain_while_braking"} | extra


@pytest.mark.parametrize(("within_k", "shown"), [(0.5, False), (10.0, True)])
def test_weather_that_differs_by_recording_alone_is_no_variable(fitted, within_k, shown):
    sessions = tuple(
        replace(s, ambient=10.0 * i + within_k * np.linspace(-1.0, 1.0, len(s))) for i, s in enumerate(fitted.problem.sessions)
    )
    assert shows(AMBIENT, replace(fitted, problem=replace(fitted.problem, sessions=sessions))) == shown


def test_latched_states_are_those_of_the_effect():
    rng, off, on = np.random.default_rng(3), np.array([2.0, 4.0]), np.array([6.0, 4.5])
    x = np.cumsum(rng.normal(0.0, 1.0, 400)) % 9.0
    states = latched_states(x, off, on)
    for i in range(2):
        was = 0.0
        for value, state in zip(x, states[:, i], strict=True):
            was = latched(value, was, off[i], on[i])
            assert was == state
