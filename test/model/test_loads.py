# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Equation (1): road-wheel loads sum to the weight and balance moments, for any tree of beams."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.model.contact import beam_shares, hinge_position, wheel_loads
from trackres_ros.vehicle import Beam

split = st.floats(0.0, 1.0)
loads_n = st.floats(1.0, 1e6)


@st.composite
def trees(draw, first=0, count=None):
    """A random tree of beams over road wheels first, first + 1, ..."""
    count = draw(st.integers(1, 9)) if count is None else count
    if count == 1:
        return first
    front = draw(st.integers(1, count - 1))
    return Beam(draw(split), draw(trees(first, front)), draw(trees(first + front, count - front)), own_weight_split=draw(split))


@st.composite
def geometries(draw):
    tree = draw(trees())
    count = 1 if isinstance(tree, int) else len(list(tree.wheels()))
    gaps = draw(st.lists(st.floats(0.05, 1.0), min_size=count, max_size=count))
    return tree, tuple(np.cumsum(gaps))


def with_tree(track, tree, positions):
    return replace(track, beams=tree, road_wheels=replace(track.road_wheels, positions=positions))


def lever(end, positions, own_weight):
    """Where a load has to act on a beam so that both ends carry their share: by the lever rule, beam by beam."""
    if not isinstance(end, Beam):
        return positions[end]
    front, rear_arm = (lever(e, positions, own_weight) for e in (end.front, end.rear))
    return front + (end.own_weight_split if own_weight else end.split) * (rear_arm - front)


@given(geometry=geometries(), load=loads_n, own=st.floats(1.0, 1e5))
def test_wheel_loads_sum_to_the_weight(triangular, geometry, load, own):
    loads = wheel_loads(replace(with_tree(triangular, *geometry), own_weight=own), load)
    assert (loads >= 0.0).all()
    assert loads.sum() == pytest.approx(load, rel=1e-12)


@given(geometry=geometries(), load=loads_n, own=st.floats(1.0, 1e5))
def test_moments_balance_about_the_hinges(triangular, geometry, load, own):
    tree, positions = geometry
    track = replace(with_tree(triangular, tree, positions), own_weight=own)
    hinges = [lever(tree, positions, own_weight) for own_weight in (False, True)]
    assert [hinge_position(track), hinge_position(track, own_weight=True)] == pytest.approx(hinges, rel=1e-12)
    own_part = min(own, load)
    moment = (load - own_part) * hinges[0] + own_part * hinges[1]
    assert wheel_loads(track, load) @ np.array(positions) == pytest.approx(moment, rel=1e-12)


def two_stages(first_stage, beta_1, beta_2, g0, g1):
    """Equation (1) with a given first-stage matrix: loads of the four road wheels."""
    second_stage = np.array([[1 - beta_1, 0], [beta_1, 0], [0, 1 - beta_2], [0, beta_2]])
    return second_stage @ first_stage @ np.array([g0, g1])


@given(a1=split, a2=split, b1=split, b2=split, g0=loads_n, g1=loads_n)
def test_equation_1_corrected_is_what_the_beams_do(triangular, a1, a2, b1, b2, g0, g1):
    matrix = np.array([[1 - a1, 1 - a2], [a1, a2]])
    tree = Beam(a1, Beam(b1, 0, 1), Beam(b2, 2, 3), own_weight_split=a2)
    track = replace(triangular, beams=tree, own_weight=g1)
    assert wheel_loads(track, g0 + g1) == pytest.approx(two_stages(matrix, b1, b2, g0, g1), rel=1e-9, abs=1e-6)


@given(a1=split, a2=split, b1=split, b2=split, g0=loads_n, g1=loads_n)
def test_equation_1_as_printed_loses_or_gains_weight(a1, a2, b1, b2, g0, g1):
    paper_matrix = np.array([[1 - a1, 1 - a2], [a2, a1]])
    excess = two_stages(paper_matrix, b1, b2, g0, g1).sum() - (g0 + g1)
    assert excess == pytest.approx((a2 - a1) * (g0 - g1), abs=1e-8 * (g0 + g1))


def test_printed_equation_1_is_off_by_a_fifth_between_splits(xgd24d):
    g0, g1 = xgd24d.axles[0].load / 2, xgd24d.tracks["triangular"].own_weight
    paper_loads = two_stages(np.array([[0.6, 0.4], [0.6, 0.4]]), 0.5, 0.5, g0, g1)
    assert paper_loads.sum() - (g0 + g1) == pytest.approx(0.2 * (g0 - g1))


def test_shipped_vehicles_load_their_road_wheels_evenly(vehicle):
    for name, load in zip((a.track for a in vehicle.assemblies), vehicle.nominal_loads(), strict=True):
        loads = wheel_loads(vehicle.tracks[name], load)
        assert loads == pytest.approx(np.full(len(loads), load / len(loads)))


def test_a_load_below_the_own_weight_is_all_own_weight(triangular):
    track = replace(triangular, beams=Beam(0.5, Beam(0.5, 0, 1), Beam(0.5, 2, 3), own_weight_split=0.2))
    assert wheel_loads(track, 6000.0) == pytest.approx(6000.0 * beam_shares(track, own_weight=True))


def test_loads_of_any_shape(triangular):
    loads = np.array([[40e3, 50e3, 60e3], [70e3, 80e3, 90e3]])
    wheel_loads_n = wheel_loads(triangular, loads)
    assert wheel_loads_n.shape == (2, 3, 4)
    assert wheel_loads_n[1, 2] == pytest.approx(wheel_loads(triangular, 90e3))
