# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The laps and recordings left out that score explanations: how sure a gain is, and on how many occasions."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from worlds import NOISE_NM, driven, fit_with, machine, named, series, validation_of

from trackres_ros.diagnosis.inference.fitting import fit
from trackres_ros.diagnosis.inference.noise import SHORT_ROOT
from trackres_ros.diagnosis.search.cross_validation import FOLDS, correlation_length
from trackres_ros.diagnosis.selection.visibility import base_columns

GAIN, LEVEL_NM = 1.1, 200.0
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
    one, same = scores[0], validation.score(plain)
    improvement = validation.improvement(one, same)
    assert validation.gain(one, same) == validation.least_gain(one, same) == 0.0
    assert (improvement.before - improvement.after, improvement.low, improvement.high) == (0.0, 0.0, 0.0)
    assert not improvement.confirmed
    np.testing.assert_allclose(validation.shares([one, same]), [0.5, 0.5])


def test_a_true_effect_surely_gains_and_its_removal_does_not(scaled, scores):
    _, _, validation = scaled
    before, after = scores
    assert 0.0 < validation.least_gain(before, after) < validation.gain(before, after)
    assert validation.least_gain(after, before) < 0.0
    assert validation.improvement(before, after).confirmed
    assert not validation.improvement(after, before).confirmed
    assert validation.shares([before, after])[1] > 0.99


def test_what_is_expected_of_a_fold_is_that_of_a_fit_without_it(scaled, scores):
    """One Newton step, against fits of the other laps."""
    _, true, validation = scaled
    score, problem = scores[1], true.problem
    whole, fold_of = validation._of([p.torque for p in true.predicted]), validation._of(validation._fold)
    for fold in range(FOLDS):
        masks = tuple(m & (of != fold) for m, of in zip(problem.masks, validation._fold, strict=True))
        effects = [a.effect for a in true.effects]
        refit = fit(replace(problem, masks=masks), effects, true.at, true.noises, largest_root=SHORT_ROOT)
        at = fold_of == fold
        moved = validation._of([p.torque for p in refit.predicted])[at] - whole[at]
        off = score.expected[at] - whole[at] - moved
        assert np.sqrt(np.mean(off**2)) < 0.3 * np.sqrt(np.mean(moved**2)) + 0.01 * NOISE_NM
    held_out = fold_of < 0
    np.testing.assert_allclose(score.expected[held_out], whole[held_out])


def test_every_fitted_sample_is_of_one_fold_and_no_other_is(scaled):
    plain, _, validation = scaled
    for session, mask, fold in zip(plain.problem.sessions, plain.problem.masks, validation._fold, strict=True):
        assert (fold[mask] >= 0).all()
        assert (fold[~mask] == -1).all()
        of_lap = {int(b): set(fold[mask & (session.block == b)].tolist()) for b in np.unique(session.block[mask])}
        assert all(len(of) == 1 for of in of_lap.values())
        assert set().union(*of_lap.values()) == set(range(4))
    assert len(validation.measured) == sum(int(s.used.sum()) for s in plain.problem.sessions)


def test_a_score_sums_what_is_left_of_each_piece(scaled, scores):
    _, _, validation = scaled
    score = scores[0]
    left, count = validation.measured - score.expected, validation._count
    pieces = validation._pieces
    for number in range(len(count)):
        of = left[pieces == number]
        assert score.error[number] == pytest.approx(np.abs(of).sum())
        assert score.square[number] == pytest.approx((of**2).sum())
        assert score.level[number] == pytest.approx(of.mean())
    assert validation.by_recording(score.error).sum() == pytest.approx(np.abs(left).sum())
    sessions = validation._of([np.full(len(m), i) for i, m in enumerate(validation.scored)])
    np.testing.assert_allclose(validation.by_recording(score.error), [np.abs(left[sessions == i]).sum() for i in (0, 1)])


def test_known_derivatives_make_the_same_score(scaled, scores):
    plain, _, validation = scaled
    again = validation.score(plain, base_columns(plain))
    np.testing.assert_array_equal(again.density, scores[0].density)


def test_what_only_fitted_laps_show_has_no_held_out_gain():
    """A torque that comes and goes evenly and that nobody knows ahead; where it is known, it surely gains."""

    def comes_and_goes(session, _):
        return LEVEL_NM * np.sign(np.sin(session.time / 6.0))

    plain = driven(of=machine(), adds=comes_and_goes)
    validation = validation_of(plain)
    before = validation.score(plain)
    fits = [fit_with(plain, series(plain, comes_and_goes, ahead)) for ahead in (0.0, 1.0)]
    unknown, known = (validation.score(one) for one in fits)
    assert fits[0].log_likelihood > plain.log_likelihood + 100.0
    assert validation.least_gain(before, known) > 100.0
    assert validation.least_gain(before, unknown) <= 0.0
    assert validation.gain(before, unknown) < 0.02 * validation.gain(before, known)
    assert not validation.improvement(before, unknown).confirmed


def test_unseen_recordings_are_predicted_by_fits_without_them():
    """That is what decides whether a difference between recordings is known ahead; with two, none is left out."""
    plain = driven(lambda s, i: 1.0 + 0.01 * i, count=3, of=machine())
    validation, problem = validation_of(plain), plain.problem
    error = []
    for left_out in range(3):
        masks = tuple(m if i != left_out else np.zeros_like(m) for i, m in enumerate(problem.masks))
        refit = fit(replace(problem, masks=masks), (), plain.at, plain.noises, rounds=1, largest_root=SHORT_ROOT)
        session = problem.sessions[left_out]
        error.append(np.abs(session.torque - refit.predicted[left_out].torque)[session.used])
    expected, found = np.concatenate(error).mean(), validation.score(plain)
    assert found.unseen == pytest.approx(expected, rel=0.1)
    assert found.unseen > 1.1 * found.error.sum() / validation._count.sum()  # laps of the same recording tell more
    two = driven(GAIN, of=machine())
    assert np.isnan(validation_of(two).score(two).unseen)


def of_pieces(validation, score, **given):
    """A score with other values of its pieces."""
    count = len(validation._count)
    whole = {name: np.broadcast_to(x, count).astype(float) for name, x in given.items()}
    return replace(score, **whole, occasion=np.arange(count))


def test_a_bound_is_that_of_ninety_five_percent(scaled, scores):
    """Of the sum over laps that are drawn anew: about two standard deviations below it."""
    _, _, validation = scaled
    count = len(validation._count)
    gains = np.random.default_rng(4).normal(3.0, 5.0, count)
    before = of_pieces(validation, scores[0], density=0.0, error=0.0)
    after = replace(before, density=gains, error=-gains * validation._count)
    std = gains.std() * np.sqrt(count)
    assert validation.gain(before, after) == pytest.approx(gains.sum())
    assert validation.least_gain(before, after) == pytest.approx(gains.sum() - NORMAL_975 * std, abs=0.15 * std)
    improvement = validation.improvement(before, after)
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
    before = of_pieces(validation, scores[0], density=0.0, error=1000.0)
    after = replace(before, density=gains, error=before.error - gains)
    assert validation.improvement(before, after).confirmed == confirmed


@pytest.mark.parametrize(("occasions", "sure"), [(1, False), (4, False), (5, True)])
def test_fewer_than_five_occasions_are_no_evidence(scaled, scores, occasions, sure):
    """However much each of them gains: a slow rise in each of two drives makes four."""
    _, _, validation = scaled
    count = len(validation._count)
    before = replace(of_pieces(validation, scores[0], density=0.0, error=1e4), occasion=np.arange(count) % occasions)
    after = replace(before, density=np.full(count, 50.0), error=np.full(count, 5e3))
    assert (validation.least_gain(before, after) > 0.0) == sure
    assert validation.improvement(before, after).confirmed == sure


def test_pieces_of_one_slow_error_are_one_occasion(scaled):
    _, _, validation = scaled
    quick, slow = (driven(of=machine(), adds=of) for of in (None, lambda s, _: LEVEL_NM * np.sin(s.time / 100.0)))
    of_quick, of_slow = (validation_of(f).score(f).occasion for f in (quick, slow))
    assert len(np.unique(of_quick)) == len(of_quick)
    assert 2 < len(np.unique(of_slow)) < 0.7 * len(of_slow)
    for number in np.unique(of_slow):
        assert len(set(validation._session[of_slow == number])) == 1
    assert (np.diff(of_slow) >= 0).all()  # neighbours, in the order of time


def test_a_correlation_length_is_that_of_an_autoregression():
    shocks = np.random.default_rng(5).normal(size=40_000)
    for phi in (0.0, 0.5, 0.9):
        x = lfilter([1.0], [1.0, -phi], shocks)
        assert correlation_length([x[:20_000], x[20_000:]]) == pytest.approx((1.0 + phi) / (1.0 - phi), rel=0.15, abs=0.1)
    assert correlation_length([np.zeros(10)]) == 1.0


@pytest.mark.parametrize(("share", "falls"), [(0.96, False), (0.94, True)])
def test_levels_fall_from_a_twentieth_on(scaled, scores, share, falls):
    _, _, validation = scaled
    assert validation.level_falls(scores[0], replace(scores[0], level=share * scores[0].level)) == falls


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
    assert 0.0 < np.linalg.norm(rest(adds)) < np.linalg.norm(validation._of(adds))
