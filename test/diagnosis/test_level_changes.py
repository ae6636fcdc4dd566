# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A change of level for good: found where there is one, with its time and size, and nowhere else."""

import numpy as np
import pytest
from streets import autoregression

from trackres_ros.diagnosis.empirical.candidates import FEWEST_SESSIONS
from trackres_ros.diagnosis.empirical.level_changes import LevelChange, find_change, piece_s, sharpened
from trackres_ros.diagnosis.empirical.spells import blocks

WHITE_NM, COLOURED_NM = 40.0, 40.0
MINUTE = 60  # samples
LONG, SHORT = (1350, 1350), (600,) * 7


def noise(lengths, rng, seconds=3.0):
    return [autoregression(n, rng, seconds, COLOURED_NM) + rng.normal(0.0, WHITE_NM, n) for n in lengths]


def found_in(residuals):
    masks = [np.ones(len(r), dtype=bool) for r in residuals]
    seconds = piece_s(float(sum(map(len, residuals))))
    change = find_change(blocks(residuals, masks, 1.0, seconds), 1.0)
    return change and sharpened(change, residuals[change.session], masks[change.session], round(seconds))


def two_levels(rng, on_s, off_s, lengths=LONG):
    found = []
    for residual in noise(lengths, rng):
        turns = np.cumsum(rng.uniform(0.6, 1.4, 200) * np.tile([off_s, on_s], 100))
        found.append(residual + 400.0 * (np.searchsorted(turns, np.arange(len(residual))) % 2))
    return found


NOWHERE = {
    "noise": lambda rng: noise(LONG, rng),
    "slow noise": lambda rng: noise(LONG, rng, 20.0),
    "wandering": lambda rng: [r + autoregression(len(r), rng, 120.0, 80.0) for r in noise(LONG, rng)],
    "wandering slowly": lambda rng: [r + autoregression(len(r), rng, 900.0, 80.0) for r in noise(LONG, rng)],
    "spells": lambda rng: two_levels(rng, 70.0, 110.0),
    "a ramp": lambda rng: [r + np.linspace(-200.0, 200.0, len(r)) for r in noise((2700,), rng)],
    "three that differ": lambda rng: [r + rng.normal(0.0, 150.0) for r in noise((900,) * 3, rng)],
    "seven that differ": lambda rng: [r + rng.normal(0.0, 150.0) for r in noise(SHORT, rng)],
    "once for ten minutes": lambda rng: [r + 300.0 * ((t := np.arange(len(r))) > 700) * (t < 1300) for r in noise((2700,), rng)],
}


@pytest.mark.parametrize("kind", NOWHERE)
def test_what_does_not_change_for_good_has_no_change(kind):
    seeds = range(20 if kind == "noise" else 4)
    assert [seed for seed in seeds if found_in(NOWHERE[kind](np.random.default_rng(seed))) is not None] == []


@pytest.mark.parametrize("seed", range(3))
def test_a_change_is_found_with_its_time_and_size(seed):
    rng = np.random.default_rng(seed)
    residuals, at, size = noise(LONG, rng), int(rng.integers(200, 1100)), float(rng.choice([-1.0, 1.0]) * 120.0)
    residuals[1][at:] += size
    found = found_in(residuals)
    assert found.session == 1
    assert found.row == pytest.approx(at, abs=MINUTE)
    assert found.size == pytest.approx(size, rel=0.15)


def test_the_larger_the_change_the_larger_what_is_found():
    sizes = []
    for size in (100.0, 200.0, 400.0, 800.0):
        (residual,) = noise((2700,), np.random.default_rng(7))
        residual[1500:] += size
        sizes.append(found_in([residual]).size)
    assert sizes == sorted(sizes)


@pytest.mark.parametrize(("count", "is_found"), [(3, False), (FEWEST_SESSIONS + 2, True)])
def test_between_recordings_a_change_needs_many_of_them(count, is_found):
    rng = np.random.default_rng(3)
    residuals = [r + 300.0 * (i >= count // 2) for i, r in enumerate(noise((600,) * count, rng))]
    found = found_in(residuals)
    assert (found is not None) == is_found
    if found:
        assert (found.session, found.row) == (count // 2, 0)


def test_too_close_to_the_end_nothing_is_said():
    (residual,) = noise((2700,), np.random.default_rng(1))
    residual[2600:] += 500.0
    assert found_in([residual]) is None


def test_a_change_stays_to_the_end():
    shape = LevelChange(1, 3, 100.0, 0.0).shape([2, 5, 2])
    assert [x.tolist() for x in shape] == [[0.0, 0.0], [0.0, 0.0, 0.0, 1.0, 1.0], [1.0, 1.0]]
