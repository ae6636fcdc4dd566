# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Places are found by their cells as they are by looking at every one, however many lie elsewhere."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.route import lookup as of
from trackres_ros.route.lookup import NOWHERE, PLACE_COLUMNS, learned_at, lookup_of, neighbour_places

AREA_M = 120.0


def drawn(seed, count, area_m=AREA_M):
    """Places all over an area, each with another value, a third of them unknown one way."""
    rng = np.random.default_rng(seed)
    places = np.empty((count, PLACE_COLUMNS))
    turn = rng.uniform(0.0, 2.0 * np.pi, count)
    places[:, :2] = rng.uniform(-area_m, area_m, (count, 2))
    places[:, of.EAST], places[:, of.NORTH], places[:, of.NUMBER] = np.cos(turn), np.sin(turn), np.arange(count)
    places[:, of.VALUES], places[:, of.STDS] = rng.normal(size=(count, 2)), rng.uniform(0.1, 1.0, (count, 2))
    places[rng.random(count) < 0.3, of.AGAINST] = np.nan
    return places


def by_hand(places, x, y, east, north):
    """Numbers of the places behind and ahead, and the share of the latter; by each place's own angle and distances."""
    best = {False: (math.inf, -1, 0.0), True: (math.inf, -1, 0.0)}
    for place in places:
        way = np.array([east, north])
        to = place[:2] - (x, y)
        along, aside = float(to @ way), abs(float(to[1] * east - to[0] * north))
        alike = abs(float(place[[of.EAST, of.NORTH]] @ way))
        if alike >= math.cos(math.pi / 4.0) and aside <= of.ASIDE_M and abs(along) <= 30.0:
            far = abs(along) + 0.5 * aside
            best[along > 0.0] = min(best[along > 0.0], (far, int(place[of.NUMBER]), along))
    (_, behind, back), (_, ahead, front) = best[False], best[True]
    if behind >= 0 and ahead >= 0:
        return behind, ahead, back / (back - front)
    only, along = (behind, back) if behind >= 0 else (ahead, front)
    return (only, only, 0.0) if only >= 0 and abs(along) <= 15.0 else (-1, -1, 0.0)


@given(st.integers(0, 10**6), st.floats(-AREA_M, AREA_M), st.floats(-AREA_M, AREA_M), st.floats(0.0, 6.28))
def test_the_lookup_finds_the_places_an_exhaustive_search_finds(seed, x, y, turn):
    places = drawn(seed, 60)
    cells, rows = lookup_of([places])
    behind, ahead, share, _, _ = neighbour_places(cells, rows, 0, x, y, math.cos(turn), math.sin(turn))
    found = tuple(int(rows[i, of.NUMBER]) if i >= 0 else -1 for i in (behind, ahead))
    wanted = by_hand(places, x, y, math.cos(turn), math.sin(turn))
    assert found == wanted[:2]
    assert math.isclose(share, wanted[2], abs_tol=1e-9)


@given(st.integers(0, 10**6), st.floats(-AREA_M, AREA_M), st.floats(-AREA_M, AREA_M), st.floats(0.0, 6.28))
def test_each_kind_is_found_as_if_it_were_alone(seed, x, y, turn):
    kinds = [drawn(seed, 40), drawn(seed + 1, 25)]
    together = lookup_of(kinds)
    where = x, y, math.cos(turn), math.sin(turn)
    for kind, places in enumerate(kinds):
        np.testing.assert_array_equal(learned_at(*together, kind, *where), learned_at(*lookup_of([places]), 0, *where))


@given(st.integers(0, 10**6), st.floats(-AREA_M, AREA_M), st.floats(-AREA_M, AREA_M), st.floats(0.0, 6.28))
def test_what_is_learned_lies_between_that_of_the_places(seed, x, y, turn):
    places = drawn(seed, 60)
    value, std = learned_at(*lookup_of([places]), 0, x, y, math.cos(turn), math.sin(turn))
    assert math.isnan(value) == math.isnan(std)
    if not math.isnan(value):
        known = places[:, of.VALUES]
        assert np.nanmin(known) <= value <= np.nanmax(known)
        assert 0.1 <= std <= 1.0


def test_nothing_is_found_far_away_nor_where_nothing_is():
    lookup = lookup_of([drawn(1, 60)])
    for x, y in ((1e5, 0.0), (1e12, -1e12), (math.nan, 0.0), (0.0, math.inf)):
        assert neighbour_places(*lookup, 0, x, y, 1.0, 0.0) == NOWHERE
    for empty in (lookup_of([]), lookup_of([np.empty((0, PLACE_COLUMNS))])):
        assert neighbour_places(*empty, 0, 0.0, 0.0, 1.0, 0.0) == NOWHERE
