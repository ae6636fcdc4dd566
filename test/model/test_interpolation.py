# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Values joined by cubics: exact where they should be, and where scipy says the same."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator

from trackres_ros.model.rubber import MonotoneCubic, cubic_weights, thinned_numbers

steps = st.lists(st.floats(0.1, 10.0), min_size=4, max_size=12)
heights = st.lists(st.sampled_from([-2.0, -0.3, 0.0, 0.0, 0.5, 4.0]), min_size=12, max_size=12)


@given(steps=steps, roots=st.tuples(*[st.floats(0.0, 60.0)] * 3))
def test_a_cubic_through_any_nodes_is_itself(steps, roots):
    nodes = np.cumsum(steps)
    points = np.linspace(nodes[0], nodes[-1], 31)
    expected, values = (np.prod([x - root for root in roots], axis=0) for x in (points, nodes))
    assert cubic_weights(nodes, points) @ values == pytest.approx(expected, rel=1e-8, abs=1e-7)


def test_at_a_node_the_value_is_that_of_the_node():
    nodes = np.array([0.0, 1.0, 3.0, 4.0, 9.0])
    assert cubic_weights(nodes, nodes) == pytest.approx(np.eye(5), abs=1e-14)


@given(count=st.integers(4, 5000), each=st.integers(2, 100))
def test_thinned_numbers_are_dense_as_their_logarithm(count, each):
    numbers = thinned_numbers(count, each)
    assert (numbers[0], numbers[-1]) == (1, count)
    assert np.array_equal(numbers, np.unique(np.round(numbers)))
    assert (np.diff(numbers) <= np.maximum(1.0, numbers[:-1] / each)).all()
    assert len(numbers) <= 2 * each * (1.0 + np.log(count))


@given(steps=steps, heights=heights)
def test_a_monotone_cubic_is_that_of_scipy(steps, heights):
    nodes = np.cumsum(steps)
    values = np.array(heights[: len(nodes)])
    points = np.linspace(nodes[0], nodes[-1], 101)
    assert MonotoneCubic(nodes, values)(points) == pytest.approx(PchipInterpolator(nodes, values)(points), rel=1e-9, abs=1e-9)
