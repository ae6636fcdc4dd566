# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Slopes by place go to a table and come back, and a table that is none is refused with what to do."""

import numpy as np
import pytest
from streets import LATITUDE, LONGITUDE

from trackres_ros.errors import InputError
from trackres_ros.route.learned import SLOPE, RouteMap
from trackres_ros.route.table import COLUMNS, read_route, write_route
from trackres_ros.route.track import Frame


def straight(count=10, course=0.0):
    """A straight street with a slope that rises along it."""
    frame = Frame(LATITUDE, LONGITUDE)
    way = 20.0 * np.arange(count)
    latitude, longitude = frame.position(way * np.cos(course), way * np.sin(course))
    slope = 0.01 * np.arange(count, dtype=float)
    values = np.stack([slope, -slope], axis=1)
    return RouteMap(SLOPE, latitude, longitude, np.full(count, course), values, np.full((count, 2), 0.002), np.full(count, 4))


def test_what_is_written_is_read(tmp_path):
    made = straight(course=0.7)
    write_route(tmp_path / "route.csv", made)
    found = read_route(tmp_path / "route.csv")
    assert np.allclose(found.latitude, made.latitude, atol=2e-9)
    assert np.allclose(found.longitude, made.longitude, atol=2e-9)
    assert np.allclose(np.cos(found.course - made.course), 1.0, atol=1e-5)
    assert np.allclose(found.value, made.value, atol=1e-5)
    assert np.allclose(found.std, made.std, atol=1e-5)
    assert np.array_equal(found.passes, made.passes)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "nothing"),
        ("a,b,c\n1,2,3\n", "a first line"),
        (",".join(COLUMNS) + "\n", "no place"),
        (",".join(COLUMNS) + "\n47,8.5,10,0.02\n", "4 values"),
        (",".join(COLUMNS) + "\n47,8.5,10,steep,0.01,3\n", "slope"),
        (",".join(COLUMNS) + "\n47,8.5,10,nan,0.01,3\n", "slope"),
        (",".join(COLUMNS) + "\n147,8.5,10,0.02,0.01,3\n", "latitude_deg"),
        (",".join(COLUMNS) + "\n47,8.5,10,1.5,0.01,3\n", "slope"),
    ],
)
def test_what_is_no_route_is_refused(tmp_path, text, said):
    path = tmp_path / "route.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        read_route(path)


def test_the_rise_is_along_the_travel():
    route = straight()
    up, std = route.at(90.0 - 90.0, 0.0, 1.0, 0.0)
    down, _ = route.at(0.0, 0.0, -1.0, 0.0)
    assert up == pytest.approx(0.045, abs=0.006)
    assert down == pytest.approx(-up)
    assert std == pytest.approx(0.002)


@pytest.mark.parametrize("where", [(0.0, 60.0, 1.0, 0.0), (400.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0)])
def test_beside_the_route_beyond_it_and_across_it_nothing_is_known(where):
    assert np.isnan(straight().at(*where)[0])
