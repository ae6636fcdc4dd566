# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A torque at the same place on each pass: found where there is one, with place and size, and nowhere else."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import streets

from trackres_ros.diagnosis import read_recordings
from trackres_ros.diagnosis.empirical.finders import driven_along
from trackres_ros.diagnosis.empirical.places import SHORTEST_LAP_M, find_place
from trackres_ros.diagnosis.prepare.gate import gate

WHITE_NM, COLOURED_NM = 40.0, 40.0
LAP_M, BEGIN_M, END_M = 1870.0, 420.0, 610.0
LONG = (1350, 1350)  # samples of 1 s
autoregression = partial(streets.autoregression, lead=5000)


def spells(n, rng, on_s, off_s):
    turns = np.cumsum(rng.uniform(0.6, 1.4, 200) * np.tile([off_s, on_s], 100))
    return 400.0 * (np.searchsorted(turns, np.arange(n)) % 2)


def driven(seed, size=0.0, lap_m=LAP_M, lengths=LONG, seconds=3.0, besides=lambda n, rng: 0.0):
    """Distances, residuals, masks and loads of drives at 2 to 9 m/s with stops, with a torque at a place of a lap."""
    rng, drives = np.random.default_rng(seed), []
    for n in lengths:
        corners = np.arange(0, n + 1, 60)
        speed = np.interp(np.arange(n), corners, rng.uniform(2.0, 9.0, len(corners)))
        for integer in rng.integers(0, n, 3):
            speed[integer : integer + 20] = 0.0
        distance = np.cumsum(speed)
        place = distance % lap_m
        residual = autoregression(n, rng, seconds, COLOURED_NM) + rng.normal(0.0, WHITE_NM, n) + besides(n, rng)
        drives.append((distance, residual + size * ((place > BEGIN_M) & (place < END_M)), speed > 0.1, np.ones(n)))
    return [list(item) for item in zip(*drives, strict=True)]


NOWHERE = {
    "noise": {},
    "slow noise": {"seconds": 20.0},
    "wandering": {"besides": lambda n, rng: autoregression(n, rng, 120.0, 80.0)},
    "wandering slowly": {"besides": lambda n, rng: autoregression(n, rng, 900.0, 80.0)},
    "spells": {"besides": lambda n, rng: spells(n, rng, 70.0, 110.0)},
}


@pytest.mark.parametrize("kind", NOWHERE)
def test_what_comes_again_nowhere_has_no_place(kind):
    seeds = range(20 if kind == "noise" else 4)
    assert [seed for seed in seeds if find_place(*driven(seed, **NOWHERE[kind])) is not None] == []


@pytest.mark.parametrize(("seed", "size"), [(50, 150.0), (51, 300.0), (52, -300.0), (53, 600.0)])
def test_a_place_is_found_where_it_is_with_its_size(seed, size):
    distances, *others = driven(seed, size)
    result = find_place(distances, *others)
    assert result.is_folded
    assert result.lap_m == pytest.approx(LAP_M, rel=0.005)
    assert result.begin_m == pytest.approx(BEGIN_M, abs=25.0)
    assert result.end_m == pytest.approx(END_M, abs=25.0)
    assert result.size == pytest.approx(size, rel=0.15)
    ends = [d[-1] for d in distances]
    assert result.passes == pytest.approx(sum(end // LAP_M for end in ends), abs=2)
    for shape, distance in zip(result.shape, distances, strict=True):
        there = (distance % LAP_M > BEGIN_M) & (distance % LAP_M < END_M)
        assert np.corrcoef(shape, there)[0, 1] > 0.8


def test_it_is_known_where_it_was_not_learned():
    distances, residuals, masks, loads = driven(54, 300.0)
    fit_results = [masks[0], masks[1] & (np.arange(LONG[1]) < 600)]
    result = find_place(distances, residuals, fit_results, loads)
    later = masks[1] & ~fit_results[1]
    remainder = residuals[1] - result.size * result.shape[1]
    assert np.var(remainder[later]) < 0.6 * np.var(residuals[1][later])


def test_the_larger_the_torque_the_larger_what_is_found():
    sizes = [find_place(*driven(7, size)).size for size in (150.0, 300.0, 600.0)]
    assert sizes == sorted(sizes)


def test_where_too_little_was_driven_there_is_no_place():
    course, zero, item = np.linspace(0.0, SHORTEST_LAP_M, 200), np.zeros(200), np.ones(200)
    assert find_place([course], [zero], [item > 0.0], [item]) is None


def session(speed, way=1.0, given=frozenset({"yaw_rate"})):
    """What `driven_along` reads of a session on laps that turn to the left; the other way round with -1."""
    yaw_rate = way * 2.0 * np.pi * speed / LAP_M
    return SimpleNamespace(speed=speed, distance=5e4 + np.cumsum(np.abs(speed)), yaw_rate=yaw_rate, step=1.0, given=given)


def test_positions_fall_on_laps_the_other_way_and_in_reverse():
    forward = np.full(1000, 6.0)
    with_reversing = np.where(np.arange(1000) % 100 < 20, -3.0, 6.0)
    item, two, three, four = driven_along(
        [session(forward), session(forward, -1.0), session(with_reversing), session(-forward, way=1.0)]
    )
    assert item[-1] == pytest.approx(6.0 * 999)
    np.testing.assert_allclose(two, -item)
    assert three[-1] == pytest.approx(np.sum(with_reversing[1:]))
    np.testing.assert_allclose(four, -item)
    unknown = [session(forward, given=frozenset()), session(forward, -1.0, given=frozenset())]
    assert all(d[-1] > 0.0 for d in driven_along(unknown))


@pytest.mark.parametrize(("scale", "known_as"), [(1.03, 1.03), (0.0, 1.0), (2.0, 1.0)])
def test_an_odometer_that_agrees_with_speed_gives_the_distance(recorded, loaded, scale, known_as):
    (item, *_) = read_recordings(recorded(), None)
    speed = item.series["speed"]
    driven_m = np.cumsum(np.abs(speed.value) * np.gradient(speed.stamp_ns * 1e-9))
    odometer = replace(item, series={**item.series, "distance": replace(speed, value=scale * driven_m)})
    (session,), (as_driven,) = (gate([r], loaded.known, frozenset(), []).sessions for r in (odometer, item))
    assert np.ptp(session.distance) == pytest.approx(known_as * np.ptp(as_driven.distance), rel=0.005)


@pytest.mark.parametrize("seed", [3, 4])
def test_a_place_is_found_on_laps_that_are_driven_both_ways(seed):
    rng, drives = np.random.default_rng(seed), []
    for way, load in ((1.0, 0.8), (-1.0, 1.2), (1.0, 1.0)):
        speed = np.interp(np.arange(1200), np.arange(0, 1201, 60), rng.uniform(2.0, 9.0, 21))
        speed[600:630] = -4.0
        sample_times = way * np.cumsum(speed)
        there = (sample_times % LAP_M > BEGIN_M) & (sample_times % LAP_M < END_M)
        residual = autoregression(1200, rng, 3.0, COLOURED_NM) + rng.normal(0.0, WHITE_NM, 1200)
        drives.append((sample_times, residual + 300.0 * load * there, speed != 0.0, np.full(1200, load)))
    result = find_place(*(list(item) for item in zip(*drives, strict=True)))
    assert result.lap_m == pytest.approx(LAP_M, rel=0.003)
    assert (result.begin_m, result.end_m) == pytest.approx((BEGIN_M, END_M), abs=25.0)
    assert result.size == pytest.approx(300.0, rel=0.15)
    typical = [np.max(np.abs(shape)) for shape in result.shape]
    assert typical[1] / typical[0] == pytest.approx(1.5, rel=0.05)


@pytest.mark.parametrize("seed", [1, 2])
def test_recordings_starting_at_one_place_are_passes_of_a_route(seed):
    result = find_place(*driven(seed, 600.0, lap_m=1e9, lengths=(600,) * 6))
    assert not result.is_folded
    assert result.passes == 6
    assert (result.begin_m, result.end_m) == pytest.approx((BEGIN_M, END_M), abs=25.0)
    assert result.size == pytest.approx(600.0, rel=0.15)
