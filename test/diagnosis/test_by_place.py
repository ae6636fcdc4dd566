# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A slope by place is learned from passes, with its uncertainty, and distinguished from a torque by its sign and by the load."""

from dataclasses import replace

import numpy as np
import pytest
from streets import LAP_M, autoregression, drive, slope_at

from trackres_ros.diagnosis.empirical.by_place import BaseColumns, PlaceColumns, StreetGraph, gains, learn
from trackres_ros.diagnosis.inference.noise import estimate_noise
from trackres_ros.route.matching import Matched, match_tracks, neighbour_pairs, places_of
from trackres_ros.route.track import track_of

WEIGHT_RADIUS_NM = 60_000.0


def made(seed, rounds, size=1.0, loads=(1.0,)):
    """A drive matched to itself, the torque of its slopes and noise, and the slope's effect on it."""
    item, rng = drive(seed, rounds), np.random.default_rng(seed + 100)
    track = track_of(item.distance, item.x, item.y)
    places = places_of([track])
    total = match_tracks(places, [track])
    streets = StreetGraph.of(neighbour_pairs(total), places.table, total)
    place = total[0].select(track.nearest_index(item.distance))
    load = np.array(loads)[np.arange(len(item.speed)) * len(loads) // len(item.speed)]
    force = WEIGHT_RADIUS_NM * load
    rise = slope_at(item.way) * item.direction * size
    residual = force * rise / np.hypot(1.0, rise) + autoregression(len(load), rng, 3.0, 300.0) + rng.normal(0.0, 300.0, len(load))
    slope = PlaceColumns.of_slope([place], [force], streets)
    torque = PlaceColumns.of_torque([place], [np.ones_like(force)], streets)
    return item, place, residual, item.speed > 0.5, slope, torque


def noise_of(residual, mask):
    return estimate_noise([residual], [mask], 0.7)


@pytest.mark.parametrize("seed", range(3))
def test_learned_slopes_hold_on_passes_that_were_not_used(seed):
    item, place, residual, mask, slope, _ = made(seed, (1, -1, 1, 1, -1))
    fit_result = mask & (place.number < 4)
    noise = noise_of(residual - WEIGHT_RADIUS_NM * slope_at(item.way) * item.direction, mask)
    result = learn(slope, [residual], [fit_result], noise, 0.03)
    assert result.evidence > 100.0
    others = mask & (place.number == 4)
    remainder = residual - slope.expected(result)[0]
    assert np.abs(remainder[others]).mean() < 0.5 * np.abs(residual[others]).mean()
    assert gains(slope, result.value[:, np.newaxis], [residual], [others], noise)[0] > 100.0
    seen = np.unique(place.place[fit_result & place.is_known])
    true = np.array([np.median((slope_at(item.way) * item.direction * place.sign[:, 0])[place.place[:, 0] == p]) for p in seen])
    deviation = (result.value[seen] - true) / result.std(seen)
    known = np.isfinite(deviation)
    assert np.mean(np.abs(deviation[known]) < 3.0) > 0.9


def test_where_nothing_is_by_place_there_is_no_evidence_of_it():
    for seed in range(4):
        _, _, residual, mask, slope, torque = made(seed, (1, 1, -1), size=0.0)
        noise = noise_of(residual, mask)
        assert learn(slope, [residual], [mask], noise, 0.01).evidence <= 5.0
        assert learn(torque, [residual], [mask], noise, 500.0).evidence <= 5.0


def slope_over_torque(residual, mask, slope, torque, typical_nm=1800.0):
    """How much more evidence there is of a slope than of a torque."""
    noise = noise_of(residual, mask)
    of_slope, of_torque = (
        learn(c, [residual], [mask], noise, typical).evidence for c, typical in ((slope, 0.03), (torque, typical_nm))
    )
    return of_slope - of_torque


def test_two_way_streets_tell_a_slope_from_a_torque():
    assert slope_over_torque(*made(1, (1, -1, 1, -1))[2:]) > 20.0


def test_two_way_streets_tell_a_torque_from_a_slope():
    item, _, _, *rest = made(2, (1, -1, 1, -1))
    residual = 2500.0 * np.maximum(slope_at(item.way) / 0.05, 0.0) + np.random.default_rng(9).normal(0.0, 400.0, len(item.way))
    assert slope_over_torque(residual, *rest) < -20.0


def test_a_slope_is_told_from_a_torque_by_loads_that_differ():
    assert slope_over_torque(*made(3, (1, 1, 1, 1), loads=(0.7, 1.4, 0.8, 1.3))[2:]) > 3.0


def test_one_way_and_one_load_tell_nothing():
    assert slope_over_torque(*made(4, (1, 1, 1))[2:], 0.03 * WEIGHT_RADIUS_NM) == pytest.approx(0.0, abs=0.5)


def test_places_that_were_not_driven_are_as_unsure_as_before():
    item, place, residual, mask, slope, _ = made(5, (1, -1, 1, -1))
    fit_result = mask & (item.way < 400.0)
    result = learn(slope, [residual], [fit_result], noise_of(residual, mask), 0.03)
    far = np.unique(place.place[(item.way > 1200.0) & place.is_known])
    near = np.unique(place.place[(item.way > 100.0) & (item.way < 300.0) & place.is_known])
    assert np.median(result.std(far)) > 0.5 * result.size
    assert np.median(result.std(near)) < 0.4 * result.size
    assert np.abs(result.value[far]).max() < result.size


def test_without_samples_no_value_by_place_is_learned():
    _, _, residual, mask, slope, _ = made(5, (1, 1))
    result = learn(slope, [residual], [mask], noise_of(residual, mask), 0.03)
    assert not result.relearned(slope, [residual], [np.zeros_like(mask)]).any()


def along_with_rolling(off, fitted=0.0, closes=True):
    """Slopes of a hill driven round one way: the values, and the errors and standard deviations at the driven places.

    The rolling coefficient differs from the file's by `off` standard deviations; a fit before has found `fitted` of them.
    """
    item, place, residual, mask, slope, _ = made(6, (1, 1, 1), size=0.0)
    true, rolling = 0.03 * np.sin(2.0 * np.pi * item.way / LAP_M), np.full((len(mask), 1), 0.004 * WEIGHT_RADIUS_NM)
    if not closes:
        slope = replace(slope, streets=replace(slope.streets, closed_loops=slope.streets.closed_loops[:0]))
    shown = residual + WEIGHT_RADIUS_NM * true + (off - fitted) * rolling[:, 0]
    result = learn(slope, [shown], [mask], noise_of(residual, mask), 0.03, BaseColumns([rolling], np.array([fitted])))
    seen = np.unique(place.place[mask & place.is_known])
    true = np.array([np.median((true * place.sign[:, 0])[place.place[:, 0] == p]) for p in seen])
    known = np.isfinite(true)
    return result.value, (result.value[seen] - true)[known], result.std(seen)[known]


def test_one_way_round_a_loop_slopes_have_no_mean():
    for deviation in (-1.5, 1.5):
        _, error, std = along_with_rolling(deviation)
        assert abs(error.mean()) < 0.001
        assert np.sqrt(np.mean((error / std) ** 2)) < 2.0


def test_one_way_on_an_open_road_the_std_has_the_mean():
    _, error, std = along_with_rolling(1.0, closes=False)
    assert error.mean() > 0.002
    assert np.sqrt(np.mean((error / std) ** 2)) < 2.0


def test_slopes_do_not_depend_on_the_last_fitted_base():
    for closes in (True, False):
        here, there = (along_with_rolling(0.5, fit_result, closes)[0] for fit_result in (0.0, 2.0))
        np.testing.assert_allclose(there, here, atol=1e-4)


def test_a_street_driven_both_ways_closes_no_loop_of_its_own():
    place = np.concatenate([np.arange(60), np.arange(60)[::-1]])
    sign = np.repeat([1.0, -1.0], 60)
    item = Matched(np.stack([place, place], axis=1), np.tile([1.0, 0.0], (120, 1)), np.stack([sign, sign], axis=1), place, place)
    assert StreetGraph.of(neighbour_pairs([item]), np.zeros((60, 4)), [item]).closed_loops.shape == (0, 60)
