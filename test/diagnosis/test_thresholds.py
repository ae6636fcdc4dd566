# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Steps, hinges, latches and gains for one sign: offered where they are, with their thresholds, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest

from trackres_ros.diagnosis import read_recordings
from trackres_ros.diagnosis.base.patterns import FADE
from trackres_ros.diagnosis.empirical.forms import (
    CLOCKS,
    LONG_STOP_S,
    candidates,
    clock_forms,
    latched_states,
    scanned_forms,
    shapes,
    time_since_long_stop,
)
from trackres_ros.diagnosis.inference.fitting import Problem, fit
from trackres_ros.diagnosis.preparation import checked_sessions
from trackres_ros.diagnosis.selection.level_errors import Levels
from trackres_ros.diagnosis.selection.visibility import base_columns
from trackres_ros.effects.learned import ABOVE, BELT, SPEED, STEP, Latch, latch_state

LEVEL_NM = 400.0


@pytest.fixture(scope="module")
def fitted(recorded, loaded):
    """A fit of recordings with nothing hidden."""
    gate_result, _, _ = checked_sessions(read_recordings(recorded(), None), loaded, (), ())
    return fit(Problem(loaded.base, gate_result.sessions, tuple(s.used for s in gate_result.sessions)))


def test_time_lost_by_a_corrected_clock_is_excluded(recorded, loaded):
    recordings = read_recordings(recorded(), None)
    torque = recordings[0].series["torque"]
    late = replace(torque, stamp_ns=torque.stamp_ns + 6_000_000_000)
    recordings[0] = replace(recordings[0], series={**recordings[0].series, "torque": late})
    gate_result, _, result_before = checked_sessions(recordings, loaded)
    lost = sum((s.used.sum() - t.used.sum()) * s.step for s, t in zip(result_before, gate_result.sessions, strict=True))
    assert gate_result.exclusions["torque lost by the correction of its clock"] == round(lost) > 0
    assert any("corrected" in note for note in gate_result.notes)


def with_torque(fitted, shapes):
    """The fit after a torque of these shapes is added to the measured one, and its block means."""
    sessions = tuple(
        replace(s, torque=s.torque + LEVEL_NM * shape * np.sign(s.speed), torque_course=None)
        for s, shape in zip(fitted.problem.sessions, shapes, strict=True)
    )
    result = fit(replace(fitted.problem, sessions=sessions), (), fitted.estimates)
    return result, Levels(result, base_columns(result), [s.used for s in sessions])


def scanned(fitted, code, x, shapes):
    """The forms of one variable that a scan finds, the one that explains the block means best first."""
    result, levels = with_torque(fitted, shapes)
    return best_first(scanned_forms(result, levels, {code: x}), levels)


def best_first(forms, levels):
    rest = levels.beyond(levels.residual)

    def left(rows):
        z = levels.beyond(levels.means(rows))
        return float(((rest - z * (z @ rest) / (z @ z)) ** 2).sum())

    return [form for form, rows in sorted(forms, key=lambda found: left(found[1]))]


def test_a_scan_finds_the_thresholds_of_what_is_there(fitted):
    speed = [np.abs(s.speed) for s in fitted.problem.sessions]
    belt = [p.belt for p in fitted.predicted]
    warm = float(np.median(np.concatenate(belt)))
    high = float(np.quantile(np.concatenate(belt), 0.98))
    (step, *_) = scanned(fitted, SPEED, speed, [1.0 * (x > 5.0) for x in speed])
    assert (step.kind, step.values()["threshold"]) == (STEP, pytest.approx(5.0, abs=0.1))
    (hinge, *_) = scanned(fitted, BELT, belt, [np.clip((x - warm) / (high - warm), 0.0, 1.0) for x in belt])
    assert (hinge.kind, hinge.values()["threshold"]) == (ABOVE, pytest.approx(warm, abs=0.15 * np.ptp(np.concatenate(belt))))
    states = [latched_states(x, np.array([3.0]), np.array([7.0]))[:, 0] for x in speed]
    (latch, *_) = scanned(fitted, SPEED, speed, states)
    assert isinstance(latch, Latch)
    deviation, on = (np.array([latch.values()[name]]) for name in ("off", "on"))
    # Thresholds between the same two samples of every passage are the same latch.
    agree = np.concatenate([latched_states(x, deviation, on)[:, 0] == state for x, state in zip(speed, states, strict=True)])
    assert agree.mean() > 0.99


@pytest.mark.parametrize(
    ("variable", "kind", "at"),
    [
        ("time since start", STEP, 260.0),
        ("time since start", ABOVE, 200.0),
        ("distance", FADE, 500.0),
        ("distance", STEP, 1000.0),
    ],
)
def test_a_torque_of_the_clock_is_found_with_its_threshold(fitted, variable, kind, at):
    x = [CLOCKS[variable](s) for s in fitted.problem.sessions]
    low, high = (float(q) for q in np.quantile(np.concatenate(x), (0.02, 0.98)))
    columns = [c[:, 0] for c in shapes(kind, x, (low, high), np.array([at]))]
    result, levels = with_torque(fitted, columns)
    (first, *_) = best_first(clock_forms(result, levels), levels)
    assert (first.variable, first.kind) == (variable, kind)
    assert first.threshold == pytest.approx(at, abs=0.15 * (high - low))


def test_only_a_long_stop_begins_the_time_since_it(fitted):
    session = fitted.problem.sessions[0]
    speed, time = np.full(len(session), 5.0), session.time
    for begin_s, length_s in ((100.0, 0.5 * LONG_STOP_S), (200.0, 2.0 * LONG_STOP_S)):
        speed[(time >= begin_s) & (time < begin_s + length_s)] = 0.0
    since = time_since_long_stop(replace(session, speed=speed))
    end_s = 200.0 + 2.0 * LONG_STOP_S
    running = (time > end_s + 1.0) & (time < end_s + 100.0)
    np.testing.assert_allclose(since[running], time[running] - end_s, atol=2.0 * session.step)
    np.testing.assert_allclose(since[time < 190.0], time[time < 190.0], atol=2.0 * session.step)


def test_a_negative_torque_is_its_own_side_only_in_reverse(fitted):
    back = tuple(replace(s, speed=-s.speed) for s in fitted.problem.sessions)
    for sessions, extra in ((fitted.problem.sessions, set()), (back, {"gain_while_negative"})):  # forwards it brakes
        names = {form.name for form in candidates(replace(fitted, problem=replace(fitted.problem, sessions=sessions))).values()}
        assert {n for n in names if n.startswith("gain_while")} == {"gain_while_driving", "gain_while_braking"} | extra


def test_latched_states_are_those_of_the_effect():
    rng, deviation, on = np.random.default_rng(3), np.array([2.0, 4.0]), np.array([6.0, 4.5])
    x = np.cumsum(rng.normal(0.0, 1.0, 400)) % 9.0
    states = latched_states(x, deviation, on)
    for i in range(2):
        was = 0.0
        for value, state in zip(x, states[:, i], strict=True):
            was = latch_state(value, was, deviation[i], on[i])
            assert was == state
