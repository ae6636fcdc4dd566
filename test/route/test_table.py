# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Slopes and torques by place go to a table and come back, and a table that is none is refused with what to do."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from streets import LATITUDE, LONGITUDE

import trackres_ros as tr
from trackres_ros.errors import InputError
from trackres_ros.route.learned import SLOPE, TORQUE, RouteMap, of_kind
from trackres_ros.route.table import HEADERS, MOST_IN_A_CELL, read_route, write_route
from trackres_ros.route.track import Frame

HERE = Frame(LATITUDE, LONGITUDE)
OF_SLOPE, OF_TORQUE, OF_BOTH = (",".join(header) + "\n" for header in HEADERS)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("routes")


def straight(count=10, course=0.0, kind=SLOPE, first=0, frame=HERE):
    """A straight street with a slope that rises along it, or a torque that is another each way."""
    way = 20.0 * np.arange(first, first + count)
    latitude, longitude = frame.position(way * np.cos(course), way * np.sin(course))
    slope = 0.01 * np.arange(count, dtype=float)
    values = np.stack([slope, -slope], axis=1) if kind == SLOPE else np.stack([1e4 * slope, 100.0 + 1e4 * slope], axis=1)
    std = np.full((count, 2), 0.002 if kind == SLOPE else 50.0)
    return RouteMap(kind, latitude, longitude, np.full(count, course), values, std, np.full(count, 4))


def same(actual, expected):
    orders = np.lexsort([actual.latitude, actual.longitude]), np.lexsort([expected.latitude, expected.longitude])
    size = 1.0 if expected.kind == SLOPE else 1e4
    for name, tolerance in (("latitude", 2e-9), ("longitude", 2e-9), ("value", 1e-5 * size), ("std", 1e-5 * size), ("passes", 0)):
        left, right = (getattr(route, name)[rows] for route, rows in zip((actual, expected), orders, strict=True))
        np.testing.assert_allclose(left, right, rtol=0.0, atol=tolerance, equal_nan=True, err_msg=name)
    assert np.allclose(np.cos(actual.course - expected.course), 1.0, atol=1e-5)


@pytest.mark.parametrize("kinds", [(SLOPE,), (TORQUE,), (SLOPE, TORQUE)])
def test_what_is_written_is_read(tmp_path, kinds):
    expected_maps = [straight(course=0.7, kind=kind) for kind in kinds]
    write_route(tmp_path / "route.csv", expected_maps)
    maps = read_route(tmp_path / "route.csv")
    assert [actual.kind for actual in maps] == list(kinds)
    for actual, expected in zip(maps, expected_maps, strict=True):
        same(actual, expected)
    assert len((tmp_path / "route.csv").read_text().splitlines()) == 11  # a place of both is one row


@settings(max_examples=15)
@given(st.floats(-180.0, 180.0) | st.floats(179.999, 180.0) | st.floats(-180.0, -179.999))
def test_a_route_has_the_same_places_at_any_longitude(folder, longitude):
    at_zero, route = (straight(frame=Frame(0.0, longitude_0)) for longitude_0 in (0.0, math.radians(longitude)))
    write_route(folder / "route.csv", [route])
    (actual,) = read_route(folder / "route.csv")
    for route_map in (route, actual):
        assert np.allclose(route_map.table(route_map.frame), at_zero.table(at_zero.frame), atol=0.02)


def test_slopes_and_one_way_torques_survive_writing_and_reading(tmp_path):
    slopes, torques = straight(), straight(kind=TORQUE, first=6)
    one_way = torques.value.copy()
    one_way[:4, 1] = np.nan
    torques = replace(torques, value=one_way, std=np.where(np.isnan(one_way), np.nan, torques.std))
    write_route(tmp_path / "route.csv", [slopes, torques])
    maps = read_route(tmp_path / "route.csv")
    same(of_kind(maps, SLOPE), slopes)
    same(of_kind(maps, TORQUE), torques)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "nothing"),
        ("a,b,c\n1,2,3\n", "a first line"),
        (OF_SLOPE, "no place"),
        (OF_SLOPE + "47,8.5,10,0.02\n", "4 values"),
        (OF_SLOPE + "47,8.5,10,steep,0.01,3\n", "slope"),
        (OF_SLOPE + "47,8.5,10,nan,0.01,3\n", "slope"),
        (OF_SLOPE + "47,8.5,10,0.02,,3\n", "both, or neither"),
        (OF_SLOPE + "47,8.5,10,,,3\n", "no learned value"),
        (OF_SLOPE + "47,8.5,,0.02,0.01,3\n", "course_deg"),
        (OF_SLOPE + "147,8.5,10,0.02,0.01,3\n", "latitude_deg"),
        (OF_SLOPE + "47,8.5,10,1.5,0.01,3\n", "slope"),
        (OF_TORQUE + "47,8.5,10,100,-5,100,5,3\n", "torque_std_nm"),
        (OF_TORQUE + "47,8.5,10,,,1e9,5,3\n", "torque_back_nm"),
        (OF_BOTH + "47,8.5,10,0.02,0.01,100,5,100,,3\n", "both, or neither"),
        (OF_SLOPE + "47,8.5,10,0.02,0.01,3\n48.5,8.5,10,0.02,0.01,3\n49,8.5,10,0.02,0.01,3\n", "one region"),
        (OF_SLOPE + "47,8.5,10,0.02,0.01,3\n" * (MOST_IN_A_CELL + 1), "within 50 m"),
    ],
)
def test_what_is_no_route_is_refused(tmp_path, text, said):
    path = tmp_path / "route.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        read_route(path)


def test_a_torque_impossible_for_this_vehicle_is_refused(tmp_path):
    torques = straight(kind=TORQUE)
    write_route(tmp_path / "route.csv", [torques.times(100.0)])
    (tmp_path / "surroundings.yaml").write_text("schema: 1\nvehicle: xgd24d\nroute: route.csv\neffects: {}\n")
    with pytest.raises(InputError, match="of this vehicle"):
        tr.load_vehicle("xgd24d", surroundings=tmp_path / "surroundings.yaml")
