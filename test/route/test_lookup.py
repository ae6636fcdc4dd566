# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Places are found by their cells as they are by looking at every one, however many lie elsewhere."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.route import lookup as layout
from trackres_ros.route.lookup import NOWHERE, PLACE_COLUMNS, learned_at, lookup_of, neighbour_places

AREA_M = 120.0


def drawn(seed, count, area_m=AREA_M):
    """Places all over an area, each with another value, a third of them unknown one way."""
    rng = np.random.default_rng(seed)
    places = np.empty((count, PLACE_COLUMNS))
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    places[:, :2] = rng.uniform(-area_m, area_m, (count, 2))
    places[:, layout.EAST], places[:, layout.NORTH], places[:, layout.NUMBER] = np.cos(angle), np.sin(angle), np.arange(count)
    places[:, layout.VALUES], places[:, layout.STDS] = rng.normal(size=(count, 2)), rng.uniform(0.1, 1.0, (count, 2))
    places[rng.random(count) < 0.3, layout.AGAINST] = np.nan
    return places


def by_hand(places, x, y, east, north):
    """Numbers of the places behind and ahead, and the share of the latter; by each place's own angle and distances."""
    nearest = {False: (math.inf, -1, 0.0), True: (math.inf, -1, 0.0)}
    for place in places:
        way = np.array([east, north])
        vector = place[:2] - (x, y)
        offset, lateral = float(vector @ way), abs(float(vector[1] * east - vector[0] * north))
        cosine = abs(float(place[[layout.EAST, layout.NORTH]] @ way))
        if cosine >= math.cos(math.pi / 4.0) and lateral <= layout.ASIDE_M and abs(offset) <= 30.0:
            distance = abs(offset) + 0.5 * lateral
            nearest[offset > 0.0] = min(nearest[offset > 0.0], (distance, int(place[layout.NUMBER]), offset))
    (_, back_place, back_offset), (_, ahead, front) = nearest[False], nearest[True]
    if back_place >= 0 and ahead >= 0:
        return back_place, ahead, back_offset / (back_offset - front)
    single, offset = (back_place, back_offset) if back_place >= 0 else (ahead, front)
    return (single, single, 0.0) if single >= 0 and abs(offset) <= 15.0 else (-1, -1, 0.0)


@given(st.integers(0, 10**6), st.floats(-AREA_M, AREA_M), st.floats(-AREA_M, AREA_M), st.floats(0.0, 6.28))
def test_the_lookup_finds_the_places_an_exhaustive_search_finds(seed, x, y, turn):
    places = drawn(seed, 60)
    cells, rows = lookup_of([places])
    back, ahead, share, _, _ = neighbour_places(cells, rows, 0, x, y, math.cos(turn), math.sin(turn))
    numbers = tuple(int(rows[i, layout.NUMBER]) if i >= 0 else -1 for i in (back, ahead))
    expected = by_hand(places, x, y, math.cos(turn), math.sin(turn))
    assert numbers == expected[:2]
    assert math.isclose(share, expected[2], abs_tol=1e-9)


@given(st.integers(0, 10**6), st.floats(-AREA_M, AREA_M), st.floats(-AREA_M, AREA_M), st.floats(0.0, 6.28))
def test_each_kind_is_found_as_if_it_were_alone(seed, x, y, turn):
    kinds = [drawn(seed, 40), drawn(seed + 1, 25)]
    joint = lookup_of(kinds)
    pose = x, y, math.cos(turn), math.sin(turn)
    for kind, places in enumerate(kinds):
        np.testing.assert_array_equal(learned_at(*joint, kind, *pose), learned_at(*lookup_of([places]), 0, *pose))


@given(st.integers(0, 10**6), st.floats(-AREA_M, AREA_M), st.floats(-AREA_M, AREA_M), st.floats(0.0, 6.28))
def test_what_is_learned_lies_between_that_of_the_places(seed, x, y, turn):
    places = drawn(seed, 60)
    value, std = learned_at(*lookup_of([places]), 0, x, y, math.cos(turn), math.sin(turn))
    assert math.isnan(value) == math.isnan(std)
    if not math.isnan(value):
        values = places[:, layout.VALUES]
        assert np.nanmin(values) <= value <= np.nanmax(values)
        assert 0.1 <= std <= 1.0


def test_nothing_is_found_far_away_nor_where_nothing_is():
    lookup = lookup_of([drawn(1, 60)])
    for x, y in ((1e5, 0.0), (1e12, -1e12), (math.nan, 0.0), (0.0, math.inf)):
        assert neighbour_places(*lookup, 0, x, y, 1.0, 0.0) == NOWHERE
    for table in (lookup_of([]), lookup_of([np.empty((0, PLACE_COLUMNS))])):
        assert neighbour_places(*table, 0, 0.0, 0.0, 1.0, 0.0) == NOWHERE
