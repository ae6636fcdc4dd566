# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A slope from the altitude: that of the road, none at standstill, and none steeper than roads."""

import numpy as np
import pytest

from trackres_ros.recording.slopes import STEEPEST, slopes


def hills(seconds=1800):
    """Time, speed with stops, the way, and altitude and slope of the road there."""
    time = np.arange(0.0, seconds, 0.5)
    speed = 12.0 * (np.sin(time / 60.0) > -0.7)
    way = np.cumsum(speed) * 0.5
    return time, speed, way, 500.0 + 20.0 * np.sin(way / 900.0), 20.0 / 900.0 * np.cos(way / 900.0)


@pytest.mark.parametrize(("noise", "step", "off"), [(0.0, 0.0, 0.002), (0.0, 1.0, 0.006), (1.0, 0.0, 0.008)])
def test_a_slope_is_that_of_the_road(noise, step, off):
    time, speed, _, altitude, slope = hills()
    shown = altitude + np.random.default_rng(2).normal(0.0, noise, len(time))
    result = slopes(time, speed, np.round(shown / step) * step if step else shown).value
    assert np.isfinite(result).all()
    assert np.sqrt(np.mean((result - slope)[100:-100] ** 2)) < off


def test_altitude_drift_at_standstill_is_no_slope():
    time, speed, _, altitude, slope = hills()
    settling = altitude + 80.0 * np.maximum(0.0, 1.0 - time / 400.0)  # as a receiver that still settles
    result = slopes(time, speed, settling).value
    assert np.isnan(result).any()
    known = np.isfinite(result)
    assert np.sqrt(np.mean((result - slope)[known] ** 2)) < 0.01
    assert known[time > 700.0].mean() > 0.9
    still = slopes(time, 0.0 * speed, settling).value
    assert np.isnan(still).all()


def test_no_slope_is_steeper_than_roads_are():
    time, speed, way, _, _ = hills()
    result = slopes(time, speed, 0.01 * way + np.where(way > way[-1] / 2, 300.0, 0.0)).value
    assert np.nanmax(np.abs(result)) <= STEEPEST
    assert np.isnan(result).any()


def test_in_reverse_the_slope_is_that_the_way_the_vehicle_points():
    time, speed, _, altitude, slope = hills()
    forward, reverse = (slopes(time, way * speed, altitude).value for way in (1.0, -1.0))
    np.testing.assert_allclose(reverse[speed > 0.0], -forward[speed > 0.0])
    twice = np.arange(0.0, 2.0 * len(time)) * 0.5
    there = slopes(twice, np.append(speed, -speed[::-1]), np.append(altitude, altitude[::-1])).value  # and back in reverse
    np.testing.assert_allclose(there, np.append(slope, slope[::-1]), atol=0.002)
    assert np.isnan(slopes(time, 5.0 * np.sign(np.sin(time)), altitude).value).all()  # to and fro
