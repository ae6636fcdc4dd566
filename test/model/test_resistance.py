# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Equations (32) to (36): each part of the torque with its unit and sign."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.model import resistance as r
from trackres_ros.units import GRAVITY

KMH = 3.6
G, R1, F_BEARING, C_D, AREA, RHO = 272e3, 0.36, 0.0075, 0.8, 7.5, 1.225  # the reference vehicle

speeds = st.floats(-30.0, 30.0)
weights = st.floats(1e3, 1e6)


@given(speed=speeds)
def test_direction_is_the_sign_of_the_speed_but_smooth(speed):
    assert r.direction(-speed) == -r.direction(speed)
    assert abs(r.direction(speed)) <= 1.0
    if abs(speed) > 8 * r.STANDSTILL_MPS:
        assert r.direction(speed) == pytest.approx(1.0 if speed > 0 else -1.0, abs=1e-6)
    assert abs(r.direction(speed + 1e-6) - r.direction(speed)) <= 1.0001e-6 / r.STANDSTILL_MPS


@given(speed=speeds, weight=weights, friction=st.floats(0.0, 0.1))
def test_bearing_friction_opposes_travel_and_scales_with_weight(speed, weight, friction):
    force = r.bearing_force(speed, weight, friction)
    assert force * speed >= 0.0
    assert abs(force) <= friction * weight
    assert r.bearing_force(-speed, weight, friction) == -force
    assert r.bearing_force(speed, 2 * weight, friction) == pytest.approx(2 * force)


@given(speed=speeds, area=st.floats(0.0, 20.0), density=st.floats(0.5, 1.5))
def test_drag_resists_travel_and_goes_with_the_square(speed, area, density):
    force = r.wind_force(speed, area, density)
    assert force * speed >= 0.0
    assert r.wind_force(-speed, area, density) == -force
    assert r.wind_force(2 * speed, area, density) == pytest.approx(4 * force)


@given(acceleration=st.floats(-5.0, 5.0), weight=weights, factor=st.floats(1.0, 2.0))
def test_inertia_is_mass_times_acceleration(acceleration, weight, factor):
    assert r.inertia_force(acceleration, weight, factor) == pytest.approx(factor * weight / 9.80665 * acceleration)


@given(grade=st.floats(-1.0, 1.0), weight=weights)
def test_a_grade_lifts_by_its_sine(grade, weight):
    force = r.grade_force(grade, weight)
    sine, cosine = force / weight, (1.0 - (force / weight) ** 2) ** 0.5
    assert sine / cosine == pytest.approx(grade, abs=1e-12)


@given(limit=st.floats(1e-12, 1e-3))
def test_nothing_jumps_at_standstill(limit):
    for part in (
        lambda v: r.bearing_force(v, G, F_BEARING),
        lambda v: r.wind_force(v, C_D * AREA, RHO),
        lambda v: G * r.direction(v),
    ):
        assert part(0.0) == 0.0
        assert abs(part(limit) - part(-limit)) <= 2.0 * limit * G / r.STANDSTILL_MPS


def scaled(formula, **units):
    """Result of a formula in mm over that in m; `units` are (value, power of length)."""
    return formula(**{name: value * 1000.0**power for name, (value, power) in units.items()}) / formula(
        **{name: value for name, (value, _) in units.items()}
    )


def test_equation_34_as_printed_is_not_a_torque():
    """In mm a torque is a thousand times what it is in m; f G / R1 is a thousandth. M = f G R1."""
    units = {"f": (F_BEARING, 0), "g": (G, 0), "r1": (R1, 1)}
    assert scaled(lambda f, g, r1: f * g / r1, **units) == pytest.approx(1e-3)
    assert scaled(lambda f, g, r1: f * g * r1, **units) == pytest.approx(1e3)
    torque, paper_value = r.bearing_force(10.0, G, F_BEARING) * R1, F_BEARING * G / R1
    assert torque == pytest.approx(734.4)
    assert paper_value / torque == pytest.approx(1 / R1**2)


@given(speed_kmh=st.floats(1.0, 60.0))
def test_equation_35_as_printed_is_a_power_over_a_radius(speed_kmh):
    """C A v^2/21.15 with v in km/h is the drag in N; times v/3600 it is a power in kW, so 76140 = 21.15 x 3600."""
    drag = C_D * AREA * speed_kmh**2 / 21.15
    force = r.wind_force(speed_kmh / KMH, C_D * AREA, RHO)
    assert force == pytest.approx(drag, rel=1e-3)
    assert pytest.approx(21.15 * 3600) == 76140
    power_kw = C_D * AREA * speed_kmh**3 / 76140
    assert power_kw == pytest.approx(force * speed_kmh / KMH / 1000, rel=1e-3)
    paper_value = C_D * AREA * speed_kmh**2 / (76140 * R1)
    assert force * R1 / paper_value == pytest.approx(3600 * R1**2, rel=1e-3)


@given(acceleration=st.floats(0.01, 3.0))
def test_printed_equation_36_lacks_gravity_and_divides_by_radius(acceleration):
    """G dv/dt / R1 with G a weight is off by g and by the square of the radius, whatever the rotating masses."""
    paper_value = G * acceleration / R1
    torque = r.inertia_force(acceleration, G, 1.0) * R1
    assert paper_value / torque == pytest.approx(GRAVITY / R1**2)


def test_parts_of_the_reference_vehicle_at_50_kmh():
    """Each against a sum by hand: 0.0075 x 272 kN, 1/2 x 1.225 x 0.8 x 7.5 x v^2, 1.1 x 272 kN/g x 0.2."""
    speed = 50 / KMH
    assert r.bearing_force(speed, G, F_BEARING) == pytest.approx(2040.0)
    assert r.wind_force(speed, C_D * AREA, RHO) == pytest.approx(3.675 * 192.901, rel=1e-5)
    assert r.inertia_force(0.2, G, 1.1) == pytest.approx(6102.0, rel=1e-4)
