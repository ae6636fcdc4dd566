# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Slopes from a recorded altitude: with a correct uncertainty, and none from a useless altitude."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from trackres_ros.diagnosis.prepare.session import DriveSession
from trackres_ros.diagnosis.prepare.speed_smoothing import error_by_revisits, torque_errors, with_slope
from trackres_ros.units import EARTH_M, GRAVITY

MASS, RADIUS, SPEED, LAP_M, HOURS = 19000.0, 0.47, 10.0, 24000.0, 4
CLIMB_M, TURNS = 60.0, 2  # heights of the loop, and how often it goes up and down


def loop(error_m=0.0, error_s=100.0, smooth=False, position=True, seed=1):
    """Rounds of one hilly loop, with a slowly varying error of the altitude, and the drive torque."""
    rng, n = np.random.default_rng(seed), HOURS * 3600
    time = np.arange(n, dtype=float)
    accel = 0.4 * np.sin(2.0 * np.pi * time / 30.0)
    speed = SPEED + np.cumsum(accel)
    distance = np.cumsum(speed)
    angle = 2.0 * np.pi * distance / LAP_M
    height = CLIMB_M * np.sin(TURNS * angle)
    slope = CLIMB_M * TURNS * 2.0 * np.pi / LAP_M * np.cos(TURNS * angle)
    keep = np.exp(-1.0 / error_s)
    error = lfilter([1.0], [1.0, -keep], rng.normal(size=n))
    if smooth:  # as a receiver's own filter makes it: it does not scatter
        error = lfilter([1.0], [1.0, -keep], error)
    error *= error_m / np.std(error)
    torque = RADIUS * (MASS * (1.05 * accel + GRAVITY * (0.008 + slope)) + 3.5 * speed**2) + rng.normal(0.0, 200.0, n)
    radius = LAP_M / (2.0 * np.pi) / EARTH_M
    nan, weight = np.full(n, np.nan), np.full(n, MASS * GRAVITY)
    known = frozenset({"altitude", "position"} if position else {"altitude"})
    location = {"latitude": radius * np.sin(angle), "longitude": radius * np.cos(angle)} if position else {}
    made = DriveSession(
        "loop", 1.0, time, speed, accel, weight, nan, 0.0 * time, nan, nan, distance, torque, nan, time >= 0.0,
        (time // 600).astype(np.int64), given=known, altitude=height + error, **location,
    )  # fmt: skip
    return made, slope


def off(found, slope):
    return float(np.std((found.grade - slope)[found.used]))


def test_an_exact_altitude_gives_the_slope_of_the_road():
    session, slope = loop()
    result, text = with_slope(session)
    assert "grade" in result.given & result.computed
    assert off(result, slope) < 0.1 * np.std(slope)
    assert "gives a slope over 200 m" in text


def test_where_nothing_may_be_compared_no_slope_is_made():
    session, _ = loop()
    unused = replace(session, used=np.zeros(len(session), dtype=bool))
    assert with_slope(unused) == (unused, "")


@pytest.mark.parametrize("error_m", [2.0, 5.0])
def test_a_lasting_altitude_error_is_found_by_revisiting_places(error_m):
    session, slope = loop(error_m)
    error, places = error_by_revisits(session)
    assert error == pytest.approx(error_m, rel=0.3)
    assert places > 1000
    result, text = with_slope(session)
    assert "grade" in result.given
    assert off(result, slope) < 1.5 * result.grade_std + 0.3 * np.std(slope)
    assert off(result, slope) < 0.7 * np.std(slope)
    without, with_it, surely = torque_errors(result)
    assert surely
    assert with_it < 0.9 * without
    assert "m between passes" in text


def test_an_altitude_that_is_mostly_error_gives_no_slope():
    session, _ = loop(60.0)
    result, text = with_slope(session)
    assert result is session
    assert "no usable slope" in text


def test_slopes_that_the_torque_does_not_show_are_not_used():
    session, _ = loop(60.0, smooth=True, position=False)
    result, text = with_slope(session)
    assert result is session
    assert "no usable slope" in text
    assert "the torque error is" in text


def test_a_recorded_slope_goes_before_one_of_the_altitude():
    session, _ = loop()
    with_grade = replace(session, given=session.given | {"grade"})
    assert with_slope(with_grade) == (with_grade, "")
    without = replace(session, given=frozenset())
    assert with_slope(without) == (without, "")
