# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The slope under a vehicle by its positions: live and in replay as if it had been recorded, and none beside the route."""

import numpy as np
import pytest
from streets import LATITUDE, LONGITUDE, autoregression

import trackres_ros as tr
from trackres_ros.estimator.columns import Reason
from trackres_ros.route.follower import EVERY_S, Follower
from trackres_ros.route.learned import SLOPE, RouteMap
from trackres_ros.route.table import write_route
from trackres_ros.route.track import Frame
from trackres_ros.units import SECOND_NS

STREET_M = 1000.0


def slope_at(way):
    return 0.04 * np.sin(2.0 * np.pi * way / 500.0)


@pytest.fixture(scope="module")
def route():
    """A street to the east."""
    way = np.arange(0.0, STREET_M + 1.0, 20.0)
    latitude, longitude = Frame(LATITUDE, LONGITUDE).position(way, np.zeros_like(way))
    slope = slope_at(way)
    values, spread = np.stack([slope, -slope], axis=1), np.full((len(way), 2), 0.002)
    return RouteMap(SLOPE, latitude, longitude, np.zeros_like(way), values, spread, np.full(len(way), 5))


def followed(route, way, speed, aside=0.0, scatter_m=0.0, hidden=(), step_s=1.0):
    """Slopes at each second of a drive, the last that was told."""
    rng, follower = np.random.default_rng(1), Follower(route)
    n = len(way)
    x, y = (autoregression(n, rng, 30.0, scatter_m) + at for at in (way, np.full(n, aside)))
    latitude, longitude = Frame(LATITUDE, LONGITUDE).position(x, y)
    found = []
    for i in range(n):
        stamp = int((i + 1) * step_s * SECOND_NS)
        if i not in hidden:
            follower.position(stamp, latitude[i], longitude[i])
        told = follower.speed(stamp, float(speed[i]))
        found.append(found[-1] if told is None else told)
    return np.array(found)


def test_the_slope_is_that_of_the_place_either_way(route):
    way = np.arange(50.0, 950.0, 8.0)
    there = followed(route, way, np.full(len(way), 8.0))
    back = followed(route, way[::-1], np.full(len(way), 8.0))[::-1]
    assert np.abs(there - slope_at(way))[3:-3].max() < 0.004
    assert np.abs(back + slope_at(way))[3:-3].max() < 0.004


def test_scatter_of_positions_leaves_it_usable(route):
    way = np.arange(50.0, 950.0, 8.0)
    found = followed(route, way, np.full(len(way), 8.0), scatter_m=6.0)
    known = np.isfinite(found)
    assert known.mean() > 0.9
    assert np.abs(found - slope_at(way))[known].mean() < 0.008


def test_backing_down_a_slope_it_still_points_up(route):
    way = np.concatenate([np.arange(50.0, 130.0, 5.0), np.full(5, 125.0), np.arange(125.0, 70.0, -3.0)])
    speed = np.concatenate([np.full(16, 5.0), np.zeros(5), np.full(len(way) - 21, -3.0)])
    found = followed(route, way, speed)
    assert np.abs(found - slope_at(way))[25:].max() < 0.01


def test_standing_it_keeps_its_slope_whatever_positions_scatter(route):
    way = np.concatenate([np.arange(50.0, 130.0, 8.0), np.full(600, 122.0)])
    speed = np.concatenate([np.full(10, 8.0), np.zeros(600)])
    found = followed(route, way, speed, scatter_m=8.0)[12:]
    known = np.isfinite(found)
    assert known.mean() > 0.95
    assert (found[known] > 0.02).all()


def test_a_short_gap_is_bridged_and_a_long_one_is_not(route):
    way = np.arange(50.0, 950.0, 8.0)
    found = followed(route, way, np.full(len(way), 8.0), hidden=(*range(20, 26), *range(50, 90)))
    assert np.abs(found - slope_at(way))[20:26].max() < 0.006
    assert np.isnan(found[66:90]).all()


@pytest.mark.parametrize("aside", [60.0, -200.0])
def test_beside_the_street_nothing_is_told(route, aside):
    way = np.arange(50.0, 950.0, 8.0)
    assert np.isnan(followed(route, way, np.full(len(way), 8.0), aside=aside)).all()


def test_it_tells_no_more_often_than_is_useful(route):
    follower = Follower(route)
    told = [follower.speed(int(i * 0.01 * SECOND_NS), 5.0) for i in range(1, 501)]
    assert sum(x is not None for x in told) <= 5.0 / EVERY_S + 1


@pytest.fixture(scope="module")
def replays(route, tmp_path_factory):
    """Replays of one drive: with its slope recorded, with its position on the route, and with neither; none beyond 700 m."""
    folder = tmp_path_factory.mktemp("replays")
    write_route(folder / "route.csv", route)
    (folder / "surroundings.yaml").write_text("schema: 1\nvehicle: xgd24d\nroute: route.csv\neffects: {}\n")
    speed = np.concatenate([np.linspace(0.0, 8.0, 20), np.full(60, 8.0), np.linspace(8.0, 0.0, 20), np.zeros(60)])
    way = np.cumsum(speed)
    time = 1.76e9 + np.arange(len(way))
    latitude, longitude = np.degrees(Frame(LATITUDE, LONGITUDE).position(way, np.where(way > 500.0, 400.0, 0.0)))
    columns = {
        "grade": [slope_at(way)],
        "latitude_deg,longitude_deg": [latitude, longitude],
        "ambient_degc": [np.full(len(way), 15.0)],
    }
    found = {}
    for name, series in columns.items():
        path = folder / f"{name[:5]}.csv"
        header = f"time_s,speed_mps,{name}"
        np.savetxt(path, np.column_stack([time, speed, *series]), delimiter=",", header=header, comments="", fmt="%.8f")
        vehicle = tr.load_vehicle("xgd24d", surroundings=folder / "surroundings.yaml")
        found[name[:5]] = tr.replay(tr.read(path), vehicle).to_pandas()
    return way, found


def test_a_replay_has_the_slope_of_the_route_as_if_it_had_been_recorded(replays):
    way, found = replays
    on = (way > 60.0) & (way < 480.0)
    recorded, by_place = (found[name]["grade_nm"].to_numpy() for name in ("grade", "latit"))
    assert np.abs(recorded[on]).max() > 1000.0
    assert np.abs(by_place - recorded)[on].mean() < 0.1 * np.abs(recorded[on]).mean()


def test_beside_the_route_the_ground_counts_as_level_and_the_status_says_so(replays):
    way, found = replays
    table = found["latit"]
    off = way > 620.0
    assert (table["grade_nm"].to_numpy()[off] == 0.0).all()
    reasons = table["reasons"].to_numpy().astype(int)
    assert (reasons[off] & Reason.OFF_ROUTE).all()
    assert not (reasons[(way > 60.0) & (way < 480.0)] & Reason.OFF_ROUTE).any()
    assert not (found["grade"]["reasons"].to_numpy().astype(int) & Reason.OFF_ROUTE).any()
    assert (found["ambie"]["reasons"].to_numpy().astype(int) & Reason.OFF_ROUTE).all()
