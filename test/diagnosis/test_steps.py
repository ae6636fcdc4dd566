# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The steps of the diagnosis by themselves: laws first."""

from dataclasses import fields, replace
from itertools import chain, combinations, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.diagnosis import read_recordings
from trackres_ros.diagnosis.findings.next_drives import menu
from trackres_ros.diagnosis.inference.fitting import BELT_EVERY, Problem, fit
from trackres_ros.diagnosis.inference.noise import Noise, autoregression, estimate_noise, whitened
from trackres_ros.diagnosis.prepare.checks import SHORTEST_S
from trackres_ros.diagnosis.prepare.gate import SHORTEST_MOVING_S, gate
from trackres_ros.diagnosis.prepare.sampling import TEMPERATURE_HOLD_S, held_while_sent, hold_value, middles
from trackres_ros.diagnosis.prepare.session import FEWEST_FITTED, MOST_LAGS, SLOWEST_MPS, STEP_S, Cumulative, split_laps
from trackres_ros.diagnosis.prepare.torque_checks import aligned_clock
from trackres_ros.diagnosis.selection import locate
from trackres_ros.diagnosis.selection.as_used import NORMAL_95, intervals
from trackres_ros.diagnosis.selection.locate import SHORTEST_PIECES, changes, segments
from trackres_ros.diagnosis.selection.visibility import FORM_ERROR, separability
from trackres_ros.diagnosis.synthetic import drives
from trackres_ros.effects import Active
from trackres_ros.errors import InputError


@pytest.fixture(scope="module")
def gated(recorded, loaded):
    return gate(read_recordings(recorded(), None), loaded.known)


@pytest.fixture(scope="module")
def problem(gated, loaded):
    masks = tuple(s.used for s in gated.sessions)
    return Problem(loaded.base, gated.sessions, masks)


@pytest.mark.parametrize("phi", [(), (0.8,), (1.2, -0.3), (1.8, -1.1, 0.2, 0.05)])
def test_whitening_gives_the_shocks_back(phi):
    shocks, phi = np.random.default_rng(2).normal(size=2000), np.array(phi)
    white = whitened(autoregression(shocks, phi), np.ones(2000, dtype=bool), phi)
    np.testing.assert_allclose(white[MOST_LAGS:], shocks[MOST_LAGS:], atol=1e-12)


@pytest.mark.parametrize("phi", [(), (0.8,), (0.5, 0.3)])
def test_noise_is_recognised_and_whitening_makes_it_white(phi):
    rng = np.random.default_rng(5)
    series = autoregression(rng.normal(size=4000), np.array(phi))
    mask = rng.random(4000) > 0.01
    noise = estimate_noise([series], [mask])
    assert noise.std == pytest.approx(1.0, rel=0.05)
    assert noise.dc_gain == pytest.approx(1.0 - sum(phi), abs=0.08)
    e = whitened(series, mask, noise.phi)
    e = e[np.isfinite(e)]
    assert abs(np.corrcoef(e[1:], e[:-1])[0, 1]) < 0.05


def test_an_outlier_does_not_move_the_noise():
    series = autoregression(np.random.default_rng(1).normal(size=3000), np.array([0.6]))
    spoilt = series.copy()
    spoilt[::500] += 300.0
    mask = np.ones(3000, dtype=bool)
    clean, dirty = estimate_noise([series], [mask]), estimate_noise([spoilt], [mask])
    assert dirty.phi[0] == pytest.approx(clean.phi[0], abs=0.1)


@pytest.mark.parametrize(("degrees", "low", "high"), [(3.0, 2.0, 5.0), (200.0, 10.0, 100.0)])
def test_tails_are_as_heavy_as_the_data_say(degrees, low, high):
    rng = np.random.default_rng(8)
    e = rng.standard_t(degrees, 6000)
    series = autoregression(5.0 * e, np.array([0.7]))
    noise = estimate_noise([series], [np.ones(6000, dtype=bool)])
    assert low <= noise.degrees <= high
    assert noise.scale == pytest.approx(5.0, rel=0.1)
    white = whitened(series, np.ones(6000, dtype=bool), noise.phi)
    white = white[np.isfinite(white)] / noise.std
    # The weights are those with which the squares fall as the log-density does.
    h = 1e-4
    slope = (noise.log_density(white + h) - noise.log_density(white - h)) / (2.0 * h)
    np.testing.assert_allclose(slope, -noise.weights(white) * white, atol=1e-5)


def test_a_parameter_more_never_makes_a_fit_less_likely(problem, effects):
    result_before = fit(problem)
    for name in ("torque_offset", "stribeck", "headwind"):
        result_after = fit(problem, [effects[name]], result_before.estimates, result_before.noises)
        assert result_after.log_likelihood > result_before.log_likelihood - 0.5  # to within the search's own tolerance


def test_whitening_never_reaches_over_a_gap():
    mask = np.ones(20, dtype=bool)
    mask[9] = False
    e = whitened(np.arange(20.0), mask, np.array([0.5, 0.1]))
    unknown = [*range(MOST_LAGS), *range(9, 10 + MOST_LAGS)]
    assert np.flatnonzero(np.isnan(e)).tolist() == unknown
    assert Noise(np.array([0.5, 0.1]), 1.0, 60.0).dc_gain == pytest.approx(0.4)


def test_means_of_a_course_keep_its_integral():
    rng = np.random.default_rng(2)
    sample_times = np.sort(rng.uniform(0.0, 50.0, 300))
    course = Cumulative.of(sample_times, rng.normal(size=300))
    begin_s = np.arange(5.0, 45.0)
    total = np.interp(45.0, course.times, course.integral) - np.interp(5.0, course.times, course.integral)
    assert course.means(begin_s, 1.0).sum() == pytest.approx(total)


@pytest.mark.parametrize("spacing_s", [0.2, 5.0, 30.0, "by change"])
def test_a_temperature_is_held_while_sent_else_unknown(spacing_s):
    rng, edges = np.random.default_rng(3), np.arange(0.0, 1801.0)
    sample_times = np.cumsum(rng.uniform(5.0, 40.0, 400)) if spacing_s == "by change" else np.arange(0.0, 1800.0, spacing_s)
    sample_times = sample_times[sample_times < 1800.0]

    value = 20.0 + 0.01 * sample_times
    np.testing.assert_array_equal(held_while_sent(sample_times, value, edges), hold_value(sample_times, value, edges, np.nan))
    for first_s, last_s in ((0.0, 500.0), (700.0, 1200.0), (1300.0, 1800.0)):
        silent = (sample_times >= first_s) & (sample_times < last_s)
        known = np.isfinite(held_while_sent(sample_times[~silent], value[~silent], edges))
        is_inside = (middles(edges) > first_s + TEMPERATURE_HOLD_S[1] + 40.0) & (
            middles(edges) < last_s - TEMPERATURE_HOLD_S[1] - 40.0
        )
        sent_message = (middles(edges) < first_s) | (middles(edges) > last_s + 40.0)
        assert is_inside.any()
        assert not known[is_inside].any()
        assert known[sent_message].all()


def test_the_gate_loses_no_sample_without_saying_so(gated):
    samples = sum(len(s) for s in gated.sessions)
    assert sum(int(s.used.sum()) for s in gated.sessions) + sum(gated.exclusions.values()) == samples
    assert all(s.step == STEP_S for s in gated.sessions)


def test_acceleration_over_a_step_is_the_change_of_speed(recorded, loaded):
    (recording, *_) = read_recordings(recorded(), None)
    without = gate([recording], loaded.known, hide=["accel"]).sessions[0]
    given_values = gate([recording], loaded.known).sessions[0]
    assert "accel" not in without.given
    assert np.abs(without.accel - given_values.accel)[5:-5].max() < 0.08  # the noise of the speed, and no more


def test_blocks_count_through_and_the_split_takes_all(gated):
    blocks = np.concatenate([s.block for s in gated.sessions])
    assert np.all(np.diff(blocks) >= 0)
    choice = split_laps(gated.sessions)
    assert sorted((*choice.training, *choice.held_out)) == sorted(set(blocks.tolist()))
    by_name = split_laps(gated.sessions, ["drive_2"])
    assert set(by_name.held_out) == set(gated.sessions[1].block.tolist())
    longer = [replace(s, name=name) for s, name in zip(gated.sessions, ("test_r1.csv", "r1.csv", "r10.csv"), strict=False)]
    second = longer[1].block.tolist()
    assert {split_laps(longer, [name]).held_out for name in ("r1", "r1.csv")} == {tuple(sorted(set(second)))}
    assert split_laps(longer, ["r1.csv: 1"]).held_out == (min(second),)
    for wrong in ("nothing", 0, 10_000):
        with pytest.raises(InputError, match="holdout"):
            split_laps(gated.sessions, [wrong] if isinstance(wrong, str) else wrong)
    with pytest.raises(InputError, match=r"or laps by name, such as '.*: \d+'"):
        split_laps([*gated.sessions, *gated.sessions], 1 + 2 * len(gated.sessions))


@pytest.mark.parametrize("parked", range(0, 15, 3))
def test_held_out_laps_are_compared_if_a_drive_ends_parked(gated, parked):
    laps = np.unique(np.concatenate([s.block for s in gated.sessions]))
    sessions = [replace(s, used=s.used & (s.block < len(laps) - parked)) for s in gated.sessions]
    choice, usual = split_laps(sessions), split_laps(gated.sessions)
    assert (*choice.training, *choice.held_out) == tuple(laps.tolist())
    assert any(choice.held_out_mask(s).any() for s in sessions)
    if parked < len(usual.held_out):
        assert (choice.training, choice.held_out, choice.text) == (usual.training, usual.held_out, usual.text)
    else:
        assert len(choice.held_out) == parked + max(1, round(0.25 * (len(laps) - parked)))
        assert f"before {parked} without a comparable torque" in choice.text


@pytest.mark.parametrize("piece", [1, MOST_LAGS, MOST_LAGS + 1])
def test_laps_to_fit_on_have_rows_or_are_refused(gated, piece):
    sessions = [replace(s, used=s.used & (np.arange(len(s)) % 7 < piece)) for s in gated.sessions]
    if piece > MOST_LAGS:
        choice = split_laps(sessions)
        assert estimate_noise([s.torque for s in sessions], [choice.training_mask(s) for s in sessions]).std > 0.0
    else:
        with pytest.raises(InputError, match="without a gap"):
            split_laps(sessions)


def test_a_torque_in_pieces_too_short_for_a_fit_is_refused(recorded, loaded):
    (recording, *_) = read_recordings(recorded(), None)
    torque = recording.series["torque"]
    of_cycle = (torque.stamp_ns - recording.start_ns) % 6_000_000_000
    gappy = replace(torque, value=np.where(of_cycle < 3_200_000_000, torque.value, np.nan))
    with pytest.raises(InputError, match="too many gaps"):
        gate([replace(recording, series={**recording.series, "torque": gappy})], loaded.known)


@pytest.mark.parametrize("steps", [1, 8, 29, 30, 31, 61])
def test_a_clock_is_corrected_in_sessions_of_any_length(gated, steps):
    (session, *_) = gated.sessions
    arrays = {f.name: getattr(session, f.name) for f in fields(session)}
    short = replace(session, **{name: x[:steps] for name, x in arrays.items() if isinstance(x, np.ndarray)})
    result, note = aligned_clock(short, short.torque)
    assert (len(result.torque), len(result.used), note) == (steps, steps, "")


@pytest.mark.parametrize("share", [0.7, 1.0])
def test_a_clock_is_corrected_only_if_both_halves_agree(gated, share):
    session = replace(gated.sessions[0], used=np.ones(len(gated.sessions[0]), dtype=bool))
    late = 8.0 * (session.time < share * session.time[-1] + 1.0)  # part of a drive is late by chance: on a hill
    quick = np.random.default_rng(1).normal(0.0, 0.2, len(session))
    _, note = aligned_clock(replace(session, torque=np.cos((session.time - late) / 20.0) + quick), np.cos(session.time / 20.0))
    assert ("by +8 s" in note) == bool(note) == (share == 1.0)


@pytest.mark.parametrize("rows", [0, 1, FEWEST_FITTED - 1, FEWEST_FITTED])
def test_belt_temperatures_are_fitted_if_they_have_rows(problem, rows):
    item, other = problem.sessions
    known = np.arange(len(item)) < BELT_EVERY * (MOST_LAGS + rows)
    sessions = replace(item, belt=np.where(known, item.belt, np.nan)), replace(other, belt=np.nan * other.belt)
    few = replace(problem, sessions=sessions)
    residuals = [g.measured - 20.0 for g in few.segments]
    assert ("belt" in few.noises(residuals)) == (rows >= FEWEST_FITTED)


def test_a_fit_finds_the_parameters_that_made_the_data(loaded):
    base = loaded.base
    sessions = drives(base, loaded.known.max_speed, 2, 10.0, np.random.default_rng(4))
    true = {q.name: q.nominal + (0.5 if np.isfinite(q.std) else 0.0) * q.std for q in base.parameters}
    rng = np.random.default_rng(5)
    shown = [p.torque + rng.normal(0.0, 1.0, len(p.torque)) for p in base.predict(sessions, true, ())]
    measured = tuple(replace(s, torque=t) for s, t in zip(sessions, shown, strict=True))
    result = fit(Problem(base, measured, tuple(s.used for s in measured)))
    for name, value in true.items():
        assert result.base_values[name] == pytest.approx(value, abs=max(4.0 * result.std_of("", name), 1e-6))


def test_temperature_is_carried_over_a_gap_and_forgotten_without(loaded):
    base = loaded.base
    item, two = drives(base, loaded.known.max_speed, 2, 10.0, np.random.default_rng(4))
    two = replace(two, ambient=item.ambient)
    values = base.nominal
    first, soaked = base.predict([item, two], values, ())
    _, straight_on = base.predict([item, replace(two, gap=1.0)], values, ())
    _, next_day = base.predict([item, replace(two, gap=86400.0)], values, ())
    assert soaked.belt[0] == pytest.approx(item.ambient[0])
    assert straight_on.belt[0] == pytest.approx(first.belt[-1], abs=0.3)
    assert next_day.belt[0] == pytest.approx(item.ambient[0], abs=0.1)


def test_effects_that_the_base_absorbs_are_not_visible(problem, effects):
    seen = separability(effects, fit(problem))
    hidden = {n.name: n.why for n in seen.not_visible}
    assert "speed_scale" in hidden  # it hides in the coefficients
    assert {"turning_scrub", "warmup", "rotating_inertia"} <= set(seen.names)
    assert seen.cosines == pytest.approx(seen.cosines.T)
    assert np.diag(seen.cosines) == pytest.approx(np.ones(len(seen.names)))


def test_sensitivities_are_those_of_the_model(problem, effects):
    result = fit(problem)
    (inertia,) = [s for s in separability(effects, result).visible if s.effect.name == "rotating_inertia"]
    with_it = result.problem.predict(
        result.base_values, [*result.instrument, Active(effects["rotating_inertia"], {"factor": 0.1})]
    )
    change = np.concatenate([p.torque for p in with_it]) - np.concatenate([p.torque for p in result.predicted])
    rows = len(change)
    assert inertia.columns[:rows, 0] * 0.1 == pytest.approx(change, abs=1e-6 * np.abs(change).max())


def test_an_interval_knows_that_the_function_is_not_nature(problem, effects):
    result = fit(problem, [effects["turning_scrub"]])
    friction = result.estimates["turning_scrub", "friction"]
    bounds = intervals(result)["turning_scrub", "friction"]
    assert bounds.high - friction >= NORMAL_95 * FORM_ERROR * abs(friction)


@pytest.mark.parametrize(("step_nm", "most"), [(0.0, 400), (150.0, 400), (150.0, 12)])
def test_a_change_of_level_is_found_where_it_is(recorded, loaded, step_nm, most, monkeypatch):
    monkeypatch.setattr(locate, "MOST_PIECES", most)
    gate_result = gate(read_recordings(recorded(count=1), None), loaded.known)
    (session,) = gate_result.sessions
    changed = replace(session, torque=session.torque + np.where(session.time > 0.5 * session.time[-1], step_nm, 0.0))
    fit_result = fit(Problem(loaded.base, gate_result.sessions, (session.used,)))
    still = replace(fit_result, problem=replace(fit_result.problem, sessions=(changed,)))
    result = changes(still)
    if step_nm:
        nearest = min(result, key=lambda c: abs(c.time - 0.5 * session.time[-1]))
        assert abs(nearest.time - 0.5 * session.time[-1]) <= 60.0
        assert nearest.after - nearest.before == pytest.approx(step_nm, abs=30.0)
    else:
        assert not result


@given(st.lists(st.floats(-5.0, 5.0), min_size=8, max_size=20), st.floats(0.0, 20.0))
def test_no_split_into_segments_costs_less(level, penalty):
    level, n = np.array(level), len(level)

    def cost(firsts):
        return sum(penalty + (b - a) * level[a:b].var() for a, b in pairwise((0, *firsts, n)))

    result = cost(segments(level, penalty))
    places = range(SHORTEST_PIECES, n - SHORTEST_PIECES + 1)
    for firsts in chain.from_iterable(combinations(places, count) for count in range(n // SHORTEST_PIECES)):
        if all(b - a >= SHORTEST_PIECES for a, b in pairwise(firsts)):
            assert result <= cost(firsts) + 1e-6


def test_every_menu_manoeuvre_is_long_enough_to_diagnose(problem):
    for name, drive in menu(problem.base.facts.weight, 14.0).items():
        made = drive(problem.sessions[0])
        assert len(made) * made.step >= SHORTEST_S, name
        assert (np.abs(made.speed) > SLOWEST_MPS).sum() * made.step >= SHORTEST_MOVING_S, name
