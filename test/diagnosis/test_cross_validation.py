# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The laps and recordings left out that score explanations: how sure a gain is, and on how many occasions."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.signal import lfilter
from worlds import NOISE_NM, driven, fit_with, machine, named, series, validation_of

from trackres_ros.diagnosis.base.own import OwnBase
from trackres_ros.diagnosis.inference.fitting import fit
from trackres_ros.diagnosis.inference.noise import SHORT_ROOT
from trackres_ros.diagnosis.search.cross_validation import FOLDS, correlation_length
from trackres_ros.diagnosis.selection.visibility import base_columns

GAIN, FAR_GAIN, LEVEL_NM = 1.1, 1.3, 200.0
NORMAL_975 = 1.96  # standard deviations of a two-sided 95 % interval


@pytest.fixture(scope="module")
def scaled():
    """The base alone and with the hidden effect, and the laps left out of them."""
    plain = driven(GAIN, of=machine())
    return plain, fit_with(plain, named()["torque_gain"]), validation_of(plain)


@pytest.fixture(scope="module")
def scores(scaled):
    plain, true, validation = scaled
    return validation.score(plain), validation.score(true)


def test_a_model_scored_against_itself_gains_nothing(scaled, scores):
    plain, _, validation = scaled
    item, same = scores[0], validation.score(plain)
    improvement = validation.improvement(item, same)
    assert validation.gain(item, same) == validation.least_gain(item, same) == 0.0
    assert (improvement.before - improvement.after, improvement.low, improvement.high) == (0.0, 0.0, 0.0)
    assert not improvement.confirmed
    np.testing.assert_allclose(validation.shares([item, same]), [0.5, 0.5])


def test_a_true_effect_surely_gains_and_its_removal_does_not(scaled, scores):
    _, _, validation = scaled
    result_before, result_after = scores
    assert 0.0 < validation.least_gain(result_before, result_after) < validation.gain(result_before, result_after)
    assert validation.least_gain(result_after, result_before) < 0.0
    assert validation.improvement(result_before, result_after).confirmed
    assert not validation.improvement(result_after, result_before).confirmed
    assert validation.shares([result_before, result_after])[1] > 0.99


def test_what_is_expected_of_a_fold_is_that_of_a_fit_without_it(scaled, scores):
    """One Newton step, against fits of the other laps."""
    _, true, validation = scaled
    score, problem = scores[1], true.problem
    total, fold_of = validation._samples([p.torque for p in true.predicted]), validation._samples(validation._fold)
    for fold in range(FOLDS):
        masks = tuple(m & (value != fold) for m, value in zip(problem.masks, validation._fold, strict=True))
        effects = [a.effect for a in true.effects]
        refit = fit(replace(problem, masks=masks), effects, true.estimates, true.noises, largest_root=SHORT_ROOT)
        is_part = fold_of == fold
        moved = validation._samples([p.torque for p in refit.predicted])[is_part] - total[is_part]
        deviation = score.expected[is_part] - total[is_part] - moved
        assert np.sqrt(np.mean(deviation**2)) < 0.3 * np.sqrt(np.mean(moved**2)) + 0.01 * NOISE_NM
    held_out = fold_of < 0
    np.testing.assert_allclose(score.expected[held_out], total[held_out])


def without(found, left_out):
    """Torques expected without rows: least squares of the others within the bounds, with the weights and priors of the fit."""
    free, columns, root = found.free, base_columns(found), np.sqrt(found.weights)
    low, high, nominal, std = (np.array([getattr(f, name) for f in free]) for name in ("low", "high", "nominal", "std"))
    white = np.concatenate(found.problem.white(found.problem.split(columns), found.noises))
    rows = np.isfinite(root) & ~left_out
    x = np.concatenate(((white * root[:, np.newaxis])[rows], np.diag(1.0 / std)))
    y = np.concatenate(((np.concatenate(found.white) * root)[rows], (nominal - found.point) / std))
    step = lsq_linear(x * std, y, ((low - found.point) / std, (high - found.point) / std), method="bvls", tol=1e-12).x
    return [p.torque + c @ (std * step) for p, c in zip(found.predicted, found.problem.split(columns), strict=True)]


@pytest.mark.parametrize("gain", [1.0, GAIN, FAR_GAIN])
def test_a_step_without_laps_is_least_squares_in_the_bounds(gain):
    """Of a base that the drive pulls within its range, to its edge, and beyond; and so without each recording."""
    result = driven(gain, of=machine(), count=3)
    validation = validation_of(result)
    of_laps, recording = validation.rows(result.problem)
    score, fold_of = validation.score(result), validation._samples(validation._fold)
    expectation = validation._samples([p.torque for p in result.predicted])
    for fold in range(FOLDS):
        is_part = fold_of == fold
        expectation[is_part] = validation._samples(without(result, of_laps == fold))[is_part]
    np.testing.assert_allclose(score.expected, expectation, rtol=1e-5)
    unseen = validation._samples([without(result, recording == i)[i] for i in range(3)])
    assert score.unseen == pytest.approx(np.abs(validation.measured - unseen).mean(), rel=1e-5)


def test_a_series_is_known_to_a_fold_by_its_forecast():
    """And to held-out laps as it is."""

    def comes_and_goes(session, _):
        return LEVEL_NM * np.sign(np.sin(session.time / 6.0))

    plain = driven(of=machine(), adds=comes_and_goes)
    validation, term = validation_of(plain), series(plain, comes_and_goes, 1.0)
    result, half = fit_with(plain, term), copy.copy(term)
    half.ahead = tuple(0.5 * x for x in term.ahead)
    with_half = replace(result, effects=tuple(replace(active, effect=half) for active in result.effects))
    total, less = (validation.score(item).expected for item in (result, with_half))
    adds = validation._samples(result.contribution(term.name))
    assert np.abs(adds).max() > 0.9 * LEVEL_NM
    fit_result = validation._samples(validation._fold) >= 0
    np.testing.assert_allclose(
        (total - less)[fit_result], 0.5 * adds[fit_result], atol=0.01 * LEVEL_NM
    )  # the sensor's delay smooths it
    np.testing.assert_array_equal(total[~fit_result], less[~fit_result])


def test_a_series_of_zeros_changes_nothing():
    plain = driven(of=machine())
    nothing = fit_with(plain, series(plain, lambda s, _: np.zeros(len(s)), 1.0))
    result, expectation = (validation_of(plain).score(item).expected for item in (nothing, fit_with(plain)))
    np.testing.assert_allclose(result, expectation, atol=0.1 * NOISE_NM)


def test_every_fitted_sample_is_of_one_fold_and_no_other_is(scaled):
    plain, _, validation = scaled
    for session, mask, fold in zip(plain.problem.sessions, plain.problem.masks, validation._fold, strict=True):
        assert (fold[mask] >= 0).all()
        assert (fold[~mask] == -1).all()
        of_lap = {int(b): set(fold[mask & (session.block == b)].tolist()) for b in np.unique(session.block[mask])}
        assert all(len(item) == 1 for item in of_lap.values())
        assert set().union(*of_lap.values()) == set(range(4))
    assert len(validation.measured) == sum(int(s.used.sum()) for s in plain.problem.sessions)


def test_measured_belts_are_never_left_out():
    """A fold is laps of torque; the belt temperatures of these laps stay in the fit."""
    result = driven(belt_noise=0.5)
    of_laps, recording = validation_of(result).rows(result.problem)
    begin = 0
    for segment in result.problem.segments:
        rows = slice(begin, begin + len(segment.measured))
        assert (recording[rows] == segment.session).all()
        assert set(of_laps[rows][segment.mask].tolist()) == ({-1} if segment.kind == "belt" else set(range(FOLDS)))
        begin = rows.stop
    assert {g.kind for g in result.problem.segments} == {"torque", "belt"}


def test_a_score_sums_what_is_left_of_each_piece(scaled, scores):
    _, _, validation = scaled
    score = scores[0]
    remainder, count = validation.measured - score.expected, validation._count
    pieces = validation._pieces
    for number in range(len(count)):
        item = remainder[pieces == number]
        assert score.error[number] == pytest.approx(np.abs(item).sum())
        assert score.square[number] == pytest.approx((item**2).sum())
        assert score.level[number] == pytest.approx(item.mean())
    assert validation.by_recording(score.error).sum() == pytest.approx(np.abs(remainder).sum())
    sessions = validation._samples([np.full(len(m), i) for i, m in enumerate(validation.scored)])
    np.testing.assert_allclose(validation.by_recording(score.error), [np.abs(remainder[sessions == i]).sum() for i in (0, 1)])


def test_known_derivatives_make_the_same_score(scaled, scores):
    plain, _, validation = scaled
    repetition = validation.score(plain, base_columns(plain))
    np.testing.assert_array_equal(repetition.density, scores[0].density)


def test_what_only_fitted_laps_show_has_no_held_out_gain():
    """A torque that comes and goes evenly and that nobody knows ahead; where it is known, it surely gains."""

    def comes_and_goes(session, _):
        return LEVEL_NM * np.sign(np.sin(session.time / 6.0))

    plain = driven(of=machine(), adds=comes_and_goes)
    validation = validation_of(plain)
    result_before = validation.score(plain)
    fits = [fit_with(plain, series(plain, comes_and_goes, forecast)) for forecast in (0.0, 1.0)]
    unknown, known = (validation.score(item) for item in fits)
    assert fits[0].log_likelihood > plain.log_likelihood + 100.0
    assert validation.least_gain(result_before, known) > 100.0
    assert validation.least_gain(result_before, unknown) <= 0.0
    assert validation.gain(result_before, unknown) < 0.02 * validation.gain(result_before, known)
    assert not validation.improvement(result_before, unknown).confirmed


def test_unseen_recordings_are_predicted_by_fits_without_them():
    """That is what decides whether a difference between recordings is known ahead; with two, none is left out."""
    plain = driven(lambda s, i: 1.0 + 0.01 * i, count=3, of=machine())
    validation, problem = validation_of(plain), plain.problem
    error = []
    for left_out in range(3):
        masks = tuple(m if i != left_out else np.zeros_like(m) for i, m in enumerate(problem.masks))
        refit = fit(replace(problem, masks=masks), (), plain.estimates, plain.noises, rounds=1, largest_root=SHORT_ROOT)
        session = problem.sessions[left_out]
        error.append(np.abs(session.torque - refit.predicted[left_out].torque)[session.used])
    expectation, result = np.concatenate(error).mean(), validation.score(plain)
    assert result.unseen == pytest.approx(expectation, rel=0.1)
    assert result.unseen > 1.1 * result.error.sum() / validation._count.sum()  # laps of the same recording tell more
    two = driven(GAIN, of=machine())
    assert np.isnan(validation_of(two).score(two).unseen)


def of_pieces(validation, score, **given):
    """A score with other values of its pieces."""
    count = len(validation._count)
    totals = {name: np.broadcast_to(x, count).astype(float) for name, x in given.items()}
    return replace(score, **totals, occasion=np.arange(count))


def test_a_bound_is_that_of_ninety_five_percent(scaled, scores):
    """Of the sum over laps that are drawn anew: about two standard deviations below it."""
    _, _, validation = scaled
    count = len(validation._count)
    gains = np.random.default_rng(4).normal(3.0, 5.0, count)
    result_before = of_pieces(validation, scores[0], density=0.0, error=0.0)
    result_after = replace(result_before, density=gains, error=-gains * validation._count)
    std = gains.std() * np.sqrt(count)
    assert validation.gain(result_before, result_after) == pytest.approx(gains.sum())
    assert validation.least_gain(result_before, result_after) == pytest.approx(gains.sum() - NORMAL_975 * std, abs=0.15 * std)
    improvement = validation.improvement(result_before, result_after)
    of_mean = gains.std() / np.sqrt(count)
    assert improvement.low == pytest.approx(gains.mean() - NORMAL_975 * of_mean, abs=0.2 * of_mean)
    assert improvement.high == pytest.approx(gains.mean() + NORMAL_975 * of_mean, abs=0.2 * of_mean)


@pytest.mark.parametrize(("deviations", "confirmed"), [(1.4, False), (2.6, True)])
def test_what_is_likely_but_not_sure_is_not_confirmed(scaled, scores, deviations, confirmed):
    """A gain of 1.4 standard deviations is right in 92 of 100 cases: that is too few."""
    _, _, validation = scaled
    count = len(validation._count)
    noise = np.tile([-1.0, 1.0], count // 2 + 1)[:count]
    gains = noise - noise.mean() + deviations / np.sqrt(count)
    result_before = of_pieces(validation, scores[0], density=0.0, error=1000.0)
    result_after = replace(result_before, density=gains, error=result_before.error - gains)
    assert validation.improvement(result_before, result_after).confirmed == confirmed


@pytest.mark.parametrize(("occasions", "sure"), [(1, False), (4, False), (5, True)])
def test_fewer_than_five_occasions_are_no_evidence(scaled, scores, occasions, sure):
    """However much each of them gains: a slow rise in each of two drives makes four."""
    _, _, validation = scaled
    count = len(validation._count)
    result_before = replace(of_pieces(validation, scores[0], density=0.0, error=1e4), occasion=np.arange(count) % occasions)
    result_after = replace(result_before, density=np.full(count, 50.0), error=np.full(count, 5e3))
    assert (validation.least_gain(result_before, result_after) > 0.0) == sure
    assert validation.improvement(result_before, result_after).confirmed == sure


def test_pieces_of_one_slow_error_are_one_occasion(scaled):
    _, _, validation = scaled
    quick, slow = (driven(of=machine(), adds=item) for item in (None, lambda s, _: LEVEL_NM * np.sin(s.time / 100.0)))
    of_quick, of_slow = (validation_of(f).score(f).occasion for f in (quick, slow))
    assert len(np.unique(of_quick)) == len(of_quick)
    assert 2 < len(np.unique(of_slow)) < 0.7 * len(of_slow)
    for number in np.unique(of_slow):
        assert len(set(validation._session[of_slow == number])) == 1
    assert (np.diff(of_slow) >= 0).all()  # neighbours, in the order of time


def test_a_quick_machine_has_occasions_as_much_shorter():
    """Steps of a quarter of a second: as many samples and pieces make one occasion."""
    for item in (None, lambda s, _: LEVEL_NM * np.sin(s.time / 100.0)):
        result = driven(of=machine(), adds=item)
        quicker = tuple(replace(s, step=0.25 * s.step, time=0.25 * s.time) for s in result.problem.sessions)
        quick = replace(result, problem=replace(result.problem, sessions=quicker))
        usual, other = (validation_of(f).score(f, base_columns(result)) for f in (result, quick))
        np.testing.assert_array_equal(other.occasion, usual.occasion)
        np.testing.assert_array_equal(other.density, usual.density)


def test_a_constant_error_makes_no_pieces_alike():
    result = driven(of=machine(), adds=lambda s, _: np.full(len(s), 5.0 * LEVEL_NM))
    score = validation_of(result).score(result)
    assert score.level.mean() > LEVEL_NM
    assert len(np.unique(score.occasion)) > 0.9 * len(score.occasion)


def test_a_correlation_length_is_that_of_an_autoregression():
    shocks = np.random.default_rng(5).normal(size=40_000)
    for phi in (0.0, 0.5, 0.9):
        x = lfilter([1.0], [1.0, -phi], shocks)
        assert correlation_length([x[:20_000], x[20_000:]]) == pytest.approx((1.0 + phi) / (1.0 - phi), rel=0.15, abs=0.1)
    assert correlation_length([np.zeros(10)]) == 1.0
    # Of a constant n long, the autocorrelation falls from 1 to 0 over n samples.
    assert correlation_length([np.ones(50)]) == pytest.approx(50.0)


@pytest.mark.parametrize(("share", "falls"), [(0.96, False), (0.94, True)])
def test_levels_fall_from_a_twentieth_on(scaled, scores, share, falls):
    _, _, validation = scaled
    assert validation.level_falls(scores[0], replace(scores[0], level=share * scores[0].level)) == falls


def test_levels_weigh_by_their_samples(scaled, scores):
    validation = copy.copy(scaled[2])
    validation._count = np.array([90, 10])
    result_before = replace(scores[0], level=np.array([1.0, -1.0]))
    for level, falls in (([0.9, -1.3], True), ([1.1, 0.1], False)):
        assert validation.level_falls(result_before, replace(result_before, level=np.array(level))) == falls


def test_shares_of_laps_drawn_anew_add_up_to_one(scaled, scores):
    _, _, validation = scaled
    count = len(validation._count)
    even = np.tile([-3.0, 3.0], count // 2 + 1)[:count]
    some = [of_pieces(validation, scores[0], density=x) for x in (0.0, even - even.mean(), -1.0)]
    shares = validation.shares(some)
    assert shares.sum() == pytest.approx(1.0)
    assert 0.3 < shares[1] < 0.7
    assert shares[2] < 0.01


def test_beyond_a_base_nothing_of_its_parameters_is_left(scaled):
    plain, true, validation = scaled
    rest = validation.beyond(plain)
    lengths = [len(s) for s in plain.problem.sessions]
    for column in base_columns(plain).T:
        own = np.split(column[: sum(lengths)], np.cumsum(lengths)[:-1])
        assert np.linalg.norm(rest(own)) < 1e-6 * np.linalg.norm(column) + 1e-9
    adds = true.contribution("torque_gain")
    assert 0.0 < np.linalg.norm(rest(adds)) < np.linalg.norm(validation._samples(adds))


def test_a_parameter_without_influence_takes_nothing_away():
    """Its column is zero, and no direction of what lies beyond a base."""
    model = machine().model
    with_idle = OwnBase(replace(model, parameters=model.parameters | {"idle": (1.0, 0.5, 1.5, "1")}))
    result, same = driven(GAIN, of=machine()), driven(GAIN, of=with_idle)
    assert np.linalg.matrix_rank(base_columns(same)) == len(result.free) == len(same.free) - 1
    added = [np.sin(s.time / 31.0) for s in result.problem.sessions]
    rests = [validation_of(item).beyond(item)(added) for item in (result, same)]
    np.testing.assert_allclose(*rests, atol=1e-3)
