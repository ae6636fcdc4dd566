# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Waves in driven distance: found where there is one, nowhere else, and named after the part that goes round in its length."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.diagnosis.empirical.places import MOST_PARTS, SAME_LENGTH, find_wave, part_of
from trackres_ros.diagnosis.inference.noise import Noise

STEP_S = 0.2
NOISE_NM, SIZE_NM, LENGTH_M = 50.0, 30.0, 4.7
PARTS = {"belt": 4.7, "road wheel": 1.1}


class Drive(SimpleNamespace):
    """A session as the search sees it."""

    def __len__(self):
        return len(self.speed)


def left_by(speeds, torques):
    """What a fit that leaves so much is to the search: noise that is white, everywhere driven."""
    noise = Noise(np.zeros(1), NOISE_NM, 100.0)
    segments = [SimpleNamespace(kind="torque", session=i, mask=np.ones(len(t), dtype=bool)) for i, t in enumerate(torques)]
    sessions = [Drive(speed=s, step=STEP_S) for s in speeds]
    white = [t / NOISE_NM for t in torques]
    return SimpleNamespace(problem=SimpleNamespace(segments=segments, sessions=sessions), white=white, noise=noise)


def driven(seed, size, minutes=15.0):
    """A drive at 1 to 8 m/s and the mean torque of each step of a wave in it."""
    rng = np.random.default_rng(seed)
    n = round(60.0 * minutes / STEP_S)
    corners = np.arange(0, n + 1, 200)
    speed = np.interp(np.arange(n), corners, rng.uniform(1.0, 8.0, len(corners)))
    edges = np.concatenate(([0.0], np.cumsum(speed) * STEP_S))
    turns = 2.0 * np.pi * edges / LENGTH_M
    wave = size * np.diff(np.sin(turns + 1.0)) / np.diff(turns)
    return speed, wave + rng.normal(0.0, NOISE_NM, n), wave


def test_a_wave_is_found_with_its_length_and_named_after_a_belt():
    drives = [driven(seed, SIZE_NM) for seed in (1, 2)]
    result = find_wave(left_by([d[0] for d in drives], [d[1] for d in drives]))
    assert result.length_m == pytest.approx(LENGTH_M, rel=1e-3)
    assert result.size == pytest.approx(SIZE_NM, rel=0.15)
    assert part_of(result.length_m, PARTS) == "one turn of the belt"
    for shape, (_, _, wave) in zip(result.shape, drives, strict=True):
        assert np.corrcoef(shape, wave)[0, 1] > 0.9


@pytest.mark.parametrize("seed", range(2))
def test_noise_has_no_wave(seed):
    speed, torque, _ = driven(seed, 0.0)
    assert find_wave(left_by([speed], [torque])) is None


def test_where_too_little_was_driven_there_is_no_wave():
    assert find_wave(left_by([np.full(30, 4.0)], [np.zeros(30)])) is None


@given(st.floats(1.0, 30.0), st.integers(2, MOST_PARTS), st.floats(-0.99, 0.99))
def test_a_length_matches_a_turn_its_multiples_or_its_fractions(once, times, off):
    near = 1.0 + SAME_LENGTH * off * 0.95
    assert part_of(once * near, {"belt": once}) == "one turn of the belt"
    assert part_of(times * once * near, {"belt": once}) == f"{times} turns of the belt"
    assert part_of(once * near / times, {"belt": once}) == f"1/{times} of a turn of the belt"


@given(st.floats(1.0, 30.0), st.floats(1.15, 1.4))
def test_a_length_between_is_of_no_part(once, factor):
    assert part_of(factor * once, {"belt": once}) == ""
    assert part_of(once * factor, {}) == ""


def test_the_first_of_several_parts_is_told():
    assert part_of(4.7, {"belt": 4.7, "wheel": 4.7}) == "one turn of the belt"
    assert part_of(2.2, PARTS) == "2 turns of the road wheel"
