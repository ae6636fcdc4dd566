# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Drives are matched to themselves: the same places again, whichever way, and none where positions say nothing."""

import numpy as np
import pytest
from streets import LAP_M, LATITUDE, LONGITUDE, drive, place_at

from trackres_ros.route.lookup import SPACING_M
from trackres_ros.route.matching import match_tracks, neighbour_pairs, places_of
from trackres_ros.route.track import LONGEST_GAP_M, Frame, track_of


def matched_drive(lap_drive):
    track = track_of(lap_drive.distance, lap_drive.x, lap_drive.y)
    places = places_of([track])
    match = match_tracks(places, [track])[0]
    return places, match, match.select(track.nearest_index(lap_drive.distance))


def test_metres_and_positions_are_each_others_inverse():
    frame = Frame(LATITUDE, LONGITUDE)
    x, y = np.array([0.0, 2500.0, -800.0]), np.array([0.0, -1200.0, 3000.0])
    assert np.allclose(frame.metres(*frame.position(x, y)), (x, y), atol=1e-6)


def test_metres_go_on_over_the_date_line_and_end_far_away():
    frame = Frame(0.1, np.pi - 1e-5)
    x, _ = frame.metres(np.array([0.1, 0.1]), np.array([-np.pi + 1e-5, 0.0]))
    assert x[0] == pytest.approx(2e-5 * np.cos(0.1) * 6371008.8)
    assert np.isnan(x[1])


@pytest.mark.parametrize("seed", range(4))
def test_passes_in_both_directions_share_their_places(seed):
    lap_drive = drive(seed, (1, 1, -1, 1, -1))
    places, _, match = matched_drive(lap_drive)
    assert len(places) < 1.4 * LAP_M / SPACING_M
    assert match.is_known.mean() > 0.98
    nearest = np.take_along_axis(match.place, (match.share[:, 1:] > 0.5).astype(int), axis=1)[:, 0]
    points = places.table[nearest[match.is_known], :2]
    distances = np.hypot(*(points.T - np.array(place_at(lap_drive.way[match.is_known]))))
    assert np.quantile(distances, 0.95) < SPACING_M + 15.0
    signs = match.sign[lap_drive.direction > 0.0, 0]
    assert (signs[match.is_known[lap_drive.direction > 0.0]] > 0.0).mean() > 0.98
    assert (match.sign[match.is_known & (lap_drive.direction < 0.0), 0] < 0.0).mean() > 0.98


def test_passes_are_counted():
    lap_drive = drive(5, (1, 1, 1, -1))
    _, _, match = matched_drive(lap_drive)
    numbers = match.number[match.is_known & (lap_drive.distance > 3.2 * LAP_M)]
    assert np.median(numbers) == 3
    assert match.number[match.is_known & (lap_drive.distance < 0.8 * LAP_M)].max() == 0


def test_a_tunnel_has_no_places_and_a_short_gap_is_bridged():
    lap_drive = drive(6, (1, 1), hidden=((500.0, 500.0 + 0.5 * LONGEST_GAP_M), (900.0, 1200.0)))
    _, _, match = matched_drive(lap_drive)
    tunnel = (lap_drive.way > 930.0) & (lap_drive.way < 1170.0)
    assert not match.is_known[tunnel].any()
    assert match.is_known[(lap_drive.way > 500.0) & (lap_drive.way < 550.0)].all()


def test_streets_that_cross_have_places_of_their_own():
    way = np.arange(0.0, 600.0, 5.0)
    level = np.zeros_like(way)
    tracks = [track_of(way, way - 300.0, level), track_of(way, level, way - 300.0)]
    places = places_of(tracks)
    assert len(places) == len(places_of(tracks[:1])) + len(places_of(tracks[1:]))
    pairs = neighbour_pairs(match_tracks(places, tracks))
    half = len(places_of(tracks[:1]))
    assert not any(a < half <= b for a, b in pairs)


def test_neighbours_say_whether_they_point_the_same_way():
    way = np.arange(0.0, 400.0, 5.0)
    level = np.zeros_like(way)
    one_way, the_other = track_of(way, way, level), track_of(way, 760.0 - way, level)
    places = places_of([one_way, the_other])
    pairs = neighbour_pairs(match_tracks(places, [one_way, the_other, track_of(2.0 * way, 2.0 * way, np.zeros_like(way))]))
    east = places.table[:, 2]
    assert all(sign == east[a] * east[b] for (a, b), sign in pairs.items())
    assert min(pairs.values()) == -1.0


def test_standing_still_is_no_pass_and_no_direction():
    distance = np.concatenate([np.arange(0.0, 300.0, 5.0), np.full(600, 295.0)])
    x = np.minimum(np.concatenate([np.arange(0.0, 300.0, 5.0), 295.0 + np.random.default_rng(1).normal(0.0, 5.0, 600)]), 330.0)
    track = track_of(distance, x, np.zeros_like(x))
    places = places_of([track])
    assert match_tracks(places, [track])[0].number.max() == 0
    assert len(track) < 40


@pytest.mark.parametrize("known", [0, 1])
def test_without_positions_nothing_is_known(known):
    x = np.full(50, np.nan)
    x[:known] = 3.0
    track = track_of(np.arange(50.0), x, x)
    assert not track.is_known.any()
    assert len(places_of([track])) == 0
