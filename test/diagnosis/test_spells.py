# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Spells: two levels are found if there are two, and distinguished from a drifting level and from noise."""

import math
from dataclasses import replace

import numpy as np
import pytest

from trackres_ros.diagnosis.empirical.finders import BETWEEN, SURE, beginnings, by_recording, expected_there
from trackres_ros.diagnosis.empirical.spells import (
    Blocks,
    Chain,
    blocks,
    find_chain,
    find_drifting_level,
    is_spells,
    spell_probability,
)
from trackres_ros.estimator.disturbance import BLOCK_S

COUNT = 25  # samples of a block
NOISE_NM = 50.0  # of a sample
LEVEL_NM, COMES, GOES = 60.0, 0.03, 0.06  # 83 s at a time, a third of the time
SEEDS = range(4)


def made(mean, pieces=4):
    n = len(mean)
    first = np.arange(n) % (n // pieces) == 0
    index = np.arange(n)
    return Blocks(mean, np.full(n, float(COUNT)), first, np.zeros(n, dtype=np.int64), COUNT * index, COUNT * (index + 1))


def white(n, rng):
    return rng.normal(0.0, NOISE_NM / math.sqrt(COUNT), n)


def two_levels(n, rng):
    there = np.zeros(n, dtype=bool)
    for i in range(1, n):
        there[i] = rng.random() > GOES if there[i - 1] else rng.random() < COMES
    return LEVEL_NM * there + white(n, rng), there


def drifting(n, rng, size=40.0, seconds=60.0):
    keep, level = math.exp(-BLOCK_S / seconds), np.empty(n)
    level[0] = rng.normal(0.0, size)
    for i in range(1, n):
        level[i] = keep * level[i - 1] + rng.normal(0.0, size * math.sqrt(1.0 - keep**2))
    return level + white(n, rng)


def likelier(b):
    """Log-likelihood ratio of two levels and a drifting one; and the chain."""
    chain, _, likelihood = find_chain(b)
    return likelihood - find_drifting_level(b)[1], chain


@pytest.mark.parametrize("seed", SEEDS)
def test_two_levels_are_found_with_their_size_length_and_share(seed):
    n = 1600
    mean, truth = two_levels(n, np.random.default_rng(seed))
    gain, chain = likelier(made(mean))
    assert gain > SURE
    if chain.level < chain.rest:  # which of the two is the rest is for the caller to say
        chain = Chain(chain.rest, chain.level, chain.go_rate, chain.come_rate, chain.noise)
    assert is_spells(chain)
    per_block = NOISE_NM / math.sqrt(COUNT)
    error = per_block * math.sqrt(1.0 / truth.sum() + 1.0 / (~truth).sum())
    assert chain.level - chain.rest == pytest.approx(LEVEL_NM, abs=4.0 * error)
    assert chain.noise == pytest.approx(NOISE_NM, rel=4.0 / math.sqrt(2.0 * n))
    spells = np.sum(np.diff(truth.astype(int)) == 1)
    assert chain.share == pytest.approx(truth.mean(), abs=0.1)
    assert math.log(chain.mean_s / (BLOCK_S / GOES)) == pytest.approx(0.0, abs=4.0 / math.sqrt(spells))
    there = spell_probability(made(mean), chain)
    assert np.mean((there > 0.5) == truth) > 0.98


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("draw", [drifting, white], ids=["drifting", "white"])
def test_a_drift_and_noise_are_no_two_levels(draw, seed):
    gain, chain = likelier(made(draw(1200, np.random.default_rng(seed))))
    assert gain < SURE or not is_spells(chain)


def test_a_drifting_level_is_found_with_its_size_and_time():
    level, _ = find_drifting_level(made(drifting(4000, np.random.default_rng(1))))
    assert level.size == pytest.approx(40.0, rel=0.15)
    assert level.seconds == pytest.approx(60.0, rel=0.3)
    assert level.noise == pytest.approx(NOISE_NM, rel=0.1)


CHAIN = Chain(LEVEL_NM, 0.0, COMES, GOES, NOISE_NM)


@pytest.mark.parametrize("at", [0, 7, 100, 150, 399])
def test_what_is_expected_hangs_on_the_past_alone(at):
    b = made(two_levels(400, np.random.default_rng(2))[0])
    changed = b.mean.copy()
    changed[at] += 30.0 if changed[at] < 0.5 * LEVEL_NM else -30.0
    result_before, result_after = (expected_there(item, CHAIN) for item in (b, replace(b, mean=changed)))
    np.testing.assert_array_equal(result_before[: at + 1], result_after[: at + 1])
    if at + 1 < len(changed) and not b.first[at + 1]:
        assert result_before[at + 1] != result_after[at + 1]
    rest = np.flatnonzero(b.first & (np.arange(len(changed)) > at))
    if len(rest):  # a piece restarts
        np.testing.assert_array_equal(result_before[rest[0] :], result_after[rest[0] :])


def test_what_is_expected_is_right_as_often_as_it_says():
    mean, truth = two_levels(8000, np.random.default_rng(3))
    expectation = expected_there(made(mean), CHAIN)
    assert np.all((expectation > 0.0) & (expectation < 1.0))
    for low, high in ((0.0, 0.1), (0.9, 1.0)):
        some = (expectation >= low) & (expectation <= high)
        assert truth[some].mean() == pytest.approx(expectation[some].mean(), abs=4.0 * math.sqrt(0.05 / some.sum()))


def test_blocks_are_means_of_what_may_be_compared():
    residual = np.arange(100.0)
    residual[60] = np.nan
    mask = np.ones(100, dtype=bool)
    mask[25:49] = False  # all but one of a block
    b = blocks([residual, residual[:30]], [mask, mask[:30]], 0.2)
    assert b.session.tolist() == [0, 0, 0, 1]
    assert b.begin.tolist() == [0, 50, 75, 0]
    assert b.end.tolist() == [25, 75, 100, 25]
    assert b.first.tolist() == [True, False, False, True]
    assert b.count.tolist() == [25.0, 24.0, 25.0, 25.0]
    assert b.mean.tolist() == pytest.approx([12.0, np.nanmean(residual[50:75]), 87.0, 12.0])


def test_a_spell_goes_on_over_a_stop_and_ends_with_its_recording():
    rng, n = np.random.default_rng(5), 60 * COUNT
    time = np.arange(n)
    there = ((time > 10 * COUNT) & (time < 30 * COUNT)) | (time > 50 * COUNT)
    residual = 3.0 * LEVEL_NM * there + rng.normal(0.0, NOISE_NM, n)
    moves = (time < 18 * COUNT) | (time > 24 * COUNT)  # it stops within the first spell
    b = blocks([residual, residual], [moves, moves], BLOCK_S / COUNT)
    on = spell_probability(b, Chain(3.0 * LEVEL_NM, 0.0, COMES, GOES, NOISE_NM))
    begins, ends = np.flatnonzero(beginnings(b, on)), np.flatnonzero(beginnings(b, on, backwards=True))
    assert b.session[begins].tolist() == b.session[ends].tolist() == [0, 0, 1, 1]
    assert b.end[ends[0]] - b.begin[begins[0]] == pytest.approx(20 * COUNT, abs=COUNT)


def test_recording_levels_are_separated_from_drift_within_them():
    rng = np.random.default_rng(8)
    true = np.array([-150.0, 40.0, 300.0])
    steady = [level + rng.normal(0.0, 60.0, 900) for level in true]
    masks = [np.ones(900, dtype=bool)] * 3
    levels, size, share = by_recording(blocks(steady, masks, 1.0))
    assert levels == pytest.approx(true, abs=10.0)
    assert size == pytest.approx(true.std(), rel=0.05)
    assert share > 0.95
    time = np.arange(900)
    waves = [300.0 * np.sin(time / 80.0 + phase) + rng.normal(0.0, 60.0, 900) for phase in (0.0, 2.0, 4.0)]
    assert by_recording(blocks(waves, masks, 1.0))[2] < 0.5 * BETWEEN
    assert by_recording(blocks([rng.normal(0.0, 60.0, 900)], masks[:1], 1.0))[1] == pytest.approx(0.0, abs=1e-9)
