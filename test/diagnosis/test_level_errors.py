# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Means over blocks, left out in turn: what a candidate gains there is what brute force gives."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t as student
from worlds import NOISE_NM, driven, fit_with, machine, moving_means, named, scored

from trackres_ros.diagnosis.selection.level_errors import Amplitudes, Levels, log_likelihood
from trackres_ros.diagnosis.selection.visibility import base_columns

STEP_NM = 100.0
COUNT = 3


def step(session, _):
    return STEP_NM * (session.time % 300.0 > 180.0)


@pytest.fixture(scope="module")
def stepped():
    """A fit of a base to three drives with a step in each."""
    return driven(adds=step, count=COUNT)


@pytest.fixture(scope="module")
def explained(stepped):
    """The same drives with an effect in the fit, whose priors are no unit of its scale."""
    return fit_with(stepped, named()["torque_gain"])


@pytest.fixture(scope="module")
def own(stepped):
    return base_columns(stepped)


@pytest.fixture(scope="module")
def levels(stepped, own):
    return Levels(stepped, own, scored(stepped))


def as_candidate(levels, found, of, low=-math.inf, high=math.inf):
    rows = np.concatenate([of(s, i) * np.sign(s.speed) for i, s in enumerate(found.problem.sessions)])
    return Amplitudes(levels.means(rows[:, np.newaxis]), np.array([low]), np.array([high]))


def by_force(found, own, extra):
    """Gain of a column by fits without each fold, from the samples: ridge and Huber's weights, one fold after another."""
    blocks = moving_means(found, np.concatenate(found.residuals), 15.0, scored(found))
    y = np.array(list(blocks.values()))
    unit = 1.4826 * np.median(np.abs(y))
    x = np.array(list(moving_means(found, own, 15.0, scored(found)).values()))
    z = np.array(list(moving_means(found, extra, 15.0, scored(found)).values()))
    pieces = sorted({(i, block // 10) for i, block in blocks})
    piece = np.array([pieces.index((i, block // 10)) % 5 for i, block in blocks])
    recording = np.array([i for i, _ in blocks])

    def log_density(columns, stds, means, fold):
        error = np.empty(len(y))
        for left_out in np.unique(fold):
            place, weight = fold == left_out, (fold != left_out).astype(float)
            for _ in range(3):
                rows = np.sqrt(weight)[:, np.newaxis] * columns / unit
                total = np.concatenate((rows, np.diag(1.0 / stds)))
                right = np.concatenate((np.sqrt(weight) * y / unit, means / stds))
                values = np.linalg.lstsq(total, right, rcond=None)[0]
                rest = y / unit - columns @ values / unit
                weight = (fold != left_out) / np.maximum(1.0, np.abs(rest) / 1.5)
            error[place] = rest[place]
        scale = np.abs(error).mean()
        return student.logpdf(error / scale, 4.0).sum() - len(y) * math.log(scale)

    stds = np.array([f.std for f in found.free])
    means = np.array([f.nominal for f in found.free]) - found.point
    gains = []
    for fold in (piece, recording):
        result_before = log_density(x, stds, means, fold)
        result_after = log_density(np.column_stack([x, z]), np.append(stds, 5.0), np.append(means, 0.0), fold)
        gains.append(result_after - result_before)
    return float(np.mean(gains))


@pytest.mark.parametrize("of", [step, lambda s, _: 50.0 * np.cos(s.time / 40.0), lambda s, i: np.full(len(s), 80.0 * (i == 1))])
def test_a_gain_is_that_of_fits_without_each_fold(stepped, explained, of):
    for result in (stepped, explained):
        own, known = base_columns(result), scored(result)
        extra = np.concatenate([of(s, i) * np.sign(s.speed) for i, s in enumerate(result.problem.sessions)])
        levels = Levels(result, own, known)
        expectation = by_force(result, own, extra)
        assert levels.gain(as_candidate(levels, result, of)) == pytest.approx(expectation, rel=1e-3, abs=1e-3)


def test_what_was_hidden_gains_most_and_with_its_size(stepped, levels):
    true = as_candidate(levels, stepped, step)
    assert levels.gain(true) > 50.0
    assert levels.start(true)[0] == pytest.approx(1.0, abs=0.1)
    for shift in (60.0, 120.0, 180.0):
        other = as_candidate(levels, stepped, lambda s, i, by=shift: step(replace(s, time=s.time + by), i))
        assert levels.gain(other) < 0.5 * levels.gain(true)


def test_what_the_base_explains_already_gains_nothing(stepped, own, levels):
    for i, f in enumerate(stepped.free):
        column = levels.means(own[:, [i]]) * min(f.std, f.scale)
        assert levels.gain(Amplitudes(column, np.array([-np.inf]), np.array([np.inf]))) < 3.0  # its prior loosens a little
        assert np.linalg.norm(levels.beyond(column)) < 0.9 * np.linalg.norm(column)


def test_each_amplitude_beyond_the_first_costs_one(stepped, levels):
    item = as_candidate(levels, stepped, step)
    none = np.zeros_like(item.columns)
    ends = np.array([-np.inf, -np.inf]), np.array([np.inf, np.inf])
    assert levels.gain(Amplitudes(np.column_stack([item.columns, none]), *ends)) == pytest.approx(levels.gain(item) - 1.0)


def test_an_amplitude_stays_within_its_bounds(stepped, levels):
    free, half, wrong = (as_candidate(levels, stepped, step, *ends) for ends in ((-9.0, 9.0), (-9.0, 0.5), (-9.0, 0.0)))
    assert levels.start(half)[0] == 0.5
    assert levels.start(wrong)[0] == 0.0
    assert levels.gain(wrong) == pytest.approx(0.0, abs=1e-9)
    assert 10.0 < levels.gain(half) < levels.gain(free)


def test_no_fold_sees_its_own_blocks(stepped, own):
    for folds in ("_pieces", "_recordings"):
        levels = Levels(stepped, own, scored(stepped))
        candidate = as_candidate(levels, stepped, step)
        result_before = levels._solve(candidate, ~getattr(levels, folds))[0]
        for number, fold in enumerate(getattr(levels, folds)):
            levels.residual = np.where(fold, levels.residual + 7.0, levels.residual)
            result_after = levels._solve(candidate, ~getattr(levels, folds))[0]
            np.testing.assert_allclose(result_after[number], result_before[number])
            others = np.arange(len(result_after)) != number
            assert np.all(np.abs(result_after - result_before)[others].max(axis=1) > 1e-3)
            levels.residual = np.where(fold, levels.residual - 7.0, levels.residual)


def test_every_block_is_left_out_once_each_way(levels):
    for folds in (levels._pieces, levels._recordings):
        np.testing.assert_array_equal(folds.sum(axis=0), 1)
    assert len(levels._recordings) == COUNT
    assert all(np.isfinite(error).all() for error in levels.base_errors)


@pytest.mark.parametrize(("laps", "left_out"), [(2, 0), (4, 2)])
def test_the_only_piece_of_a_drive_is_not_left_out(laps, left_out):
    """Without it there would be nothing to fit; of two pieces, each is predicted by the other."""
    result = driven(of=machine(), laps=laps, count=1)
    levels = Levels(result, base_columns(result), scored(result))
    assert len(levels._pieces) == left_out
    assert np.isfinite(levels.base_errors.pieces).all() == (left_out > 0)


def test_the_fall_of_a_column_is_that_of_the_errors_without_it(stepped, levels):
    adds = np.concatenate([step(s, 0) * np.sign(s.speed) for s in stepped.problem.sessions])
    result_before, result_after = (np.abs(levels.errors(c).pieces).mean() for c in (None, as_candidate(levels, stepped, step)))
    assert levels.falls(adds) == pytest.approx(1.0 - result_after / result_before)
    assert levels.falls(adds) > 0.2
    assert levels.falls(np.zeros_like(adds)) == pytest.approx(0.0, abs=1e-9)


def test_with_two_recordings_only_pieces_are_left_out():
    result = driven(adds=step)
    levels = Levels(result, base_columns(result), scored(result))
    assert np.isfinite(levels.base_errors.pieces).all()
    assert np.isnan(levels.base_errors.recordings).all()
    assert levels.gain(as_candidate(levels, result, step)) > 10.0


def test_blocks_hold_the_used_samples_alone(stepped, own):
    """Held-out laps count too; what is not used changes nothing."""
    rows = np.random.default_rng(2).normal(size=len(own))
    known = scored(stepped)
    levels = Levels(stepped, own, known)
    expectation = moving_means(stepped, rows, 15.0, known)
    unit = np.median(np.abs(list(moving_means(stepped, np.concatenate(stepped.residuals), 15.0, known).values()))) * 1.4826
    np.testing.assert_allclose(levels.means(rows), np.array(list(expectation.values())) / unit, rtol=1e-3)
    spoilt = np.where(np.concatenate(known), rows, np.nan)
    np.testing.assert_array_equal(levels.means(spoilt), levels.means(rows))


def test_belts_of_another_scatter_have_their_own_unit():
    """A measured belt temperature weighs as it scatters, whatever it scatters; the torque's unit is its own."""
    quiet, loud = (driven(adds=step, belt_noise=kelvin) for kelvin in (0.5, 5.0))
    for result in (quiet, loud):
        levels = Levels(result, base_columns(result), scored(result))
        of_belts = ~levels.of_torque
        assert 10 < of_belts.sum() < levels.blocks - 10
        for item in (of_belts, levels.of_torque):
            assert 1.4826 * np.median(np.abs(levels.residual[item])) == pytest.approx(1.0, rel=1e-3)
        assert np.ptp(levels._unit[levels.of_torque]) == np.ptp(levels._unit[of_belts]) == 0.0
        assert not as_candidate(levels, result, step).columns[of_belts].any()
        assert levels.scatter_nm == levels._unit[levels.of_torque][0]
    small, large = (Levels(f, base_columns(f), scored(f))._unit[-1] for f in (quiet, loud))
    assert large > 3.0 * small
    assert large < NOISE_NM


def test_a_change_along_a_term_has_its_size_and_its_deviation(stepped, levels):
    """A term that grows by a tenth for each standard deviation of another variable, and one that does not."""
    sessions = stepped.problem.sessions
    adds = np.concatenate([step(s, 0) * np.sign(s.speed) for s in sessions])
    over = np.concatenate([np.sin(s.time / 23.0) for s in sessions])
    changed, std = levels.change_of(adds, adds * over, 60.0)
    assert abs(changed) < 3.0 * std
    assert std < 0.1
    grown = Levels(stepped, base_columns(stepped), scored(stepped))
    grown.residual = grown.residual + 0.3 * grown.means(adds * over)
    assert grown.change_of(adds, adds * over, 60.0)[0] == pytest.approx(changed + 0.3, abs=0.05)


def by_least_squares(x, y, stds, means, weight=1.0):
    """Values of columns with priors, by the rows that these add; blocks of some weights."""
    root = np.sqrt(np.broadcast_to(weight, len(y)))
    rows = np.concatenate((root[:, np.newaxis] * x, np.diag(1.0 / stds)))
    return np.linalg.lstsq(rows, np.concatenate((root * y, means / stds)), rcond=None)[0]


def test_a_change_and_its_deviation_are_those_by_force(explained):
    """Values by least squares with Huber's weights; the deviation is that of sums over clusters, further blocks cut off."""
    levels, own = Levels(explained, base_columns(explained), scored(explained)), base_columns(explained)
    sessions = explained.problem.sessions
    levels.residual = levels.residual + np.where(np.arange(levels.blocks) % 17 == 5, 6.0, 0.0)
    adds = np.concatenate([step(s, 0) * np.sign(s.speed) for s in sessions])
    more = adds * np.concatenate([np.sin(s.time / 23.0) for s in sessions])
    x = np.column_stack([levels.means(own), levels.means(adds), levels.means(more)])
    stds = np.array([*(f.std for f in explained.free), 1e9, 1e9])
    means = np.array([*(f.nominal - value for f, value in zip(explained.free, explained.point, strict=True)), 0.0, 0.0])
    weight = np.ones(levels.blocks)
    for _ in range(3):
        values = by_least_squares(x, levels.residual, stds, means, weight)
        weight = 1.0 / np.maximum(1.0, np.abs(levels.residual - x @ values) / 1.5)
    remainder = np.clip(levels.residual - x @ values, -4.0, 4.0)
    unit = np.minimum(stds, 1e3)
    inverse = np.linalg.inv((x.T @ x + np.diag(stds**-2.0)) * np.outer(unit, unit)) * np.outer(unit, unit)
    together = {}
    for place, recording, row, error in zip(levels.time, levels.recording, x, remainder, strict=True):
        together[recording, place // 60.0] = together.get((recording, place // 60.0), 0.0) + row * error
    deviation = inverse @ np.array(list(together.values())).T
    assert len(together) < levels.blocks / 3.0
    assert np.abs(remainder).max() == 4.0
    assert levels.change_of(adds, more, 60.0) == pytest.approx((values[-1], np.sqrt((deviation[-1] ** 2).sum())), rel=1e-3)


def test_beyond_the_base_is_what_its_priors_leave(explained):
    levels = Levels(explained, base_columns(explained), scored(explained))
    own, stds = levels.means(base_columns(explained)), np.array([f.std for f in explained.free])
    columns = np.random.default_rng(7).normal(size=(levels.blocks, 2)) + 0.1 * own[:, :2] * stds[:2]
    for column, remainder in zip(columns.T, levels.beyond(columns).T, strict=True):
        expectation = column - own @ by_least_squares(own, column, stds, np.zeros(len(stds)))
        np.testing.assert_allclose(remainder, expectation, rtol=1e-5, atol=1e-6)


def test_blocks_of_a_quick_machine_are_as_much_shorter(stepped, own, levels):
    """Steps of a quarter of a second make blocks of as many samples, and pieces of as many blocks."""
    quicker = [replace(s, step=0.25 * s.step, time=0.25 * s.time) for s in stepped.problem.sessions]
    quick = Levels(replace(stepped, problem=replace(stepped.problem, sessions=tuple(quicker))), own, scored(stepped))
    np.testing.assert_array_equal(quick.time, 0.25 * levels.time)
    np.testing.assert_array_equal(quick.residual, levels.residual)
    np.testing.assert_array_equal(quick.base_errors.pieces, levels.base_errors.pieces)


def test_no_columns_have_no_block_means(levels, own):
    assert levels.means(np.empty((len(own), 0))).shape == (levels.blocks, 0)


def test_a_log_likelihood_falls_as_errors_grow():
    errors = np.random.default_rng(3).normal(size=200)
    for factor in (2.0, 10.0):
        assert log_likelihood(errors) - log_likelihood(factor * errors) == pytest.approx(200 * math.log(factor))
    assert log_likelihood(errors) == pytest.approx(
        float(student.logpdf(errors / np.abs(errors).mean(), 4.0).sum() - 200 * math.log(np.abs(errors).mean()))
        - 200 * float(student.logpdf(0.0, 4.0))
    )
