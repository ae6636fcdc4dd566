# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rainflow count, equation (25): the standard's example, an independent package, and laws for any loop."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.model.hysteresis import count_cycles, count_loop, turning_points

package = pytest.importorskip("rainflow")

series = st.lists(st.integers(-50, 50).map(float), min_size=3, max_size=60)
real_series = st.lists(st.integers(-(10**6), 10**6).map(lambda i: i / 7e5), min_size=3, max_size=60)
ASTM_SERIES = [-2.0, 1.0, -3.0, 5.0, -1.0, 3.0, -4.0, 4.0, -2.0]


def varies(values):
    return len(set(values)) > 1


def test_the_example_of_astm_e1049():
    """E1049-85 (2017), figure 6: ranges and counts of the rainflow count."""
    counts = Counter()
    for cycle in count_cycles(ASTM_SERIES):
        counts[cycle.range] += cycle.number
    assert counts == {3.0: 0.5, 4.0: 1.5, 6.0: 0.5, 8.0: 1.0, 9.0: 0.5}


def test_the_cycles_of_the_standard_in_the_order_they_close():
    cycles = [(ASTM_SERIES[c.start], ASTM_SERIES[c.end], c.number) for c in count_cycles(ASTM_SERIES)]
    assert cycles == [
        (-2.0, 1.0, 0.5),
        (1.0, -3.0, 0.5),
        (-1.0, 3.0, 1.0),
        (-3.0, 5.0, 0.5),
        (5.0, -4.0, 0.5),
        (-4.0, 4.0, 0.5),
        (4.0, -2.0, 0.5),
    ]


def rows(cycles):
    return sorted((c[0], c[1], c[2]) for c in cycles)


@given(values=series | real_series)
def test_equal_to_the_package_rainflow(values):
    if varies(values):
        assert np.array(rows(count_cycles(values))) == pytest.approx(np.array(rows(package.extract_cycles(values))))


@given(values=series)
def test_a_loop_leaves_no_cycle_open(values):
    """Halves come in pairs of the same range, so that all is whole; and the whole way up and down is counted, once."""
    cycles = count_loop(values)
    halves = Counter(c.range for c in cycles if c.number == 0.5)
    assert all(number % 2 == 0 for number in halves.values())
    way = sum(abs(b - a) for a, b in zip(values, values[1:] + values[:1], strict=True))
    assert sum(2.0 * c.number * c.range for c in cycles) == pytest.approx(way)


@given(values=series, turn=st.integers(0, 60))
def test_a_loop_counts_the_same_wherever_it_begins(values, turn):
    rotation = values[turn % len(values) :] + values[: turn % len(values)]

    def full_cycles(loop):
        counts = Counter()
        for c in count_loop(loop):
            counts[c.range, c.mean] += c.number
        return dict(counts)

    assert full_cycles(rotation) == full_cycles(values)


@given(values=series)
def test_the_largest_cycle_spans_the_series_and_indices_match(values):
    cycles = count_loop(values)
    if varies(values):
        assert max(c.range for c in cycles) == max(values) - min(values)
    for c in cycles:
        assert c.range == abs(values[c.start] - values[c.end])
        assert c.mean == (values[c.start] + values[c.end]) / 2


@given(values=series)
def test_only_turning_points_count(values):
    points = turning_points(values)
    assert rows(count_cycles([values[i] for i in points])) == rows(count_cycles(values))
    steps = np.diff([values[i] for i in points])
    assert (steps[1:] * steps[:-1] < 0).all()


@pytest.mark.parametrize("values", [[], [1.0], [2.0, 2.0, 2.0]])
def test_what_never_turns_has_no_cycles(values):
    assert count_cycles(values) == []
    assert count_loop(values) == []
