# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Equations (5), (6), (12) to (21): the belt as a rope, and how a wheel bends it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import quad

from trackres_ros.model import belt as b
from trackres_ros.model.belt import along_belt, build_loop
from trackres_ros.model.hysteresis import RainflowCount
from trackres_ros.model.track import steady_tension, track_model
from trackres_ros.vehicle.belt_bulk import arc_length, heat_capacity, mass_per_length

masses = st.floats(0.5, 200.0)  # kg/m
half_spans = st.floats(0.05, 5.0)  # m
stiffnesses = st.floats(1e6, 1e9)  # N
sag_shares = st.floats(0.01, 0.9)  # of the half span


def stretch_share(mass, half_span, stiffness):
    return mass * b.GRAVITY * half_span / (2.0 * stiffness)


@given(mass=masses, half_span=half_spans, stiffness=stiffnesses, share=sag_shares)
def test_equation_15_solves_equation_14(mass, half_span, stiffness, share):
    assume(stretch_share(mass, half_span, stiffness) < 0.5 * share)
    sag = share * half_span
    tension = b.least_tension_for_sag(sag, mass, half_span, stiffness)
    assert float(b.catenary_sag(tension, mass, half_span, stiffness)) == pytest.approx(sag, rel=1e-9)


def printed_15(section, modulus, tooth_height, l, q, g):  # noqa: E741
    a_e = section * modulus
    return (
        g
        * q
        * (a_e**2 * tooth_height**2 - 4 * a_e**2 * l**2 - 2 * a_e * g * tooth_height * l**2 * q + g**2 * l**4 * q**2)
        / (4 * a_e**2 * tooth_height - 4 * a_e * g * l**2 * q)
    )


@given(mass=masses, half_span=half_spans, stiffness=stiffnesses, share=sag_shares)
def test_equation_15_as_printed_pushes_the_belt(mass, half_span, stiffness, share):
    assume(stretch_share(mass, half_span, stiffness) < 0.5 * share)
    sag = share * half_span
    paper_tension = printed_15(0.02, stiffness / 0.02, 2.0 * sag, half_span, mass, b.GRAVITY)
    assert paper_tension < 0.0
    assert -paper_tension == pytest.approx(b.least_tension_for_sag(sag, mass, half_span, stiffness), rel=1e-6)


def printed_14(tension, mass, half_span, stiffness, gravity, tooth_height):
    root = math.sqrt(1.0 + (mass * gravity * half_span / tension) ** 2) - 1.0
    return mass * gravity * half_span**2 / (2 * stiffness) * tension / (mass * gravity) * root * tooth_height / 2


def test_equation_14_as_printed_is_not_a_length():
    """In mm every length must be a thousand times the number it is in m."""
    per_metre = (15000.0, 25.0, 0.45, 7e7)
    metres = printed_14(*per_metre, b.GRAVITY, 0.08)
    millimetres = printed_14(15000.0e3, 25.0e-3, 450.0, 7e7 * 1e3, b.GRAVITY * 1e3, 80.0)
    assert millimetres / metres == pytest.approx(1e9)  # a volume: the plus and the <= between the factors are lost
    sag = float(b.catenary_sag(*per_metre))
    assert sag / 1e-3 == pytest.approx(sag * 1e3)
    assert metres < 1e-3 * sag


@given(mass=masses, half_span=half_spans, stiffness=stiffnesses, tension=st.floats(100.0, 1e5))
def test_sag_follows_from_the_balance_of_forces(mass, half_span, stiffness, tension):
    """Equations (12) and (13): walk along the rope, its slope is carried weight over F, each piece stretched by its tension."""

    def rise(s):
        slope = mass * b.GRAVITY * s / tension
        secant = math.sqrt(1.0 + slope * slope)
        return slope / secant * (1.0 + tension * secant / stiffness)

    height, _ = quad(rise, 0.0, half_span, epsrel=1e-11)
    assert float(b.catenary_sag(tension, mass, half_span, stiffness)) == pytest.approx(height, rel=1e-8)


@given(first=st.floats(10.0, 1e6), second=st.floats(10.0, 1e6))
def test_more_tension_less_sag(first, second):
    low, high = sorted((first, second))
    assume(high > low * (1 + 1e-6))
    sags = b.catenary_sag(np.array([low, high]), 25.0, 0.45, 7e7)
    assert sags[0] > sags[1]


def test_a_belt_that_stretches_past_its_sag_is_refused():
    with pytest.raises(ValueError, match="no tension holds it"):
        b.least_tension_for_sag(0.001, 100.0, 5.0, 1e4)


@given(pretension=st.floats(0.0, 1e5))
def test_the_tension_is_the_greater_of_spring_and_sag(triangular, xgd24d, pretension):
    belt, modulus = replace(triangular.belt, pretension=pretension), 12e6
    least_tension = b.least_tension_for_sag(
        belt.tooth_height / 2, mass_per_length(belt, xgd24d.rubber), belt.sag_half_span, float(b.axial_stiffness(belt, modulus))
    )
    assert b.belt_tension(belt, xgd24d.rubber, modulus) == pytest.approx(max(pretension, least_tension), rel=1e-6)


def test_a_real_pretension_is_well_above_what_the_sag_needs(vehicle, track):
    assert steady_tension(track_model(vehicle, track.name), 20.0) == track.belt.pretension
    slack = replace(track.belt, pretension=0.0)
    assert b.belt_tension(slack, vehicle.rubber, 12e6) < 0.2 * track.belt.pretension


@given(modulus=st.floats(1e5, 1e10))
def test_equations_5_and_6_add_cords_and_rubber(triangular, modulus):
    belt = triangular.belt
    section = belt.width * belt.thickness
    by_hand = 1.2e11 * 0.0006 + modulus * (0.635 * 0.035 - 0.0006)
    assert float(b.axial_stiffness(belt, modulus)) == pytest.approx(by_hand, rel=1e-12)
    mean_modulus = float(b.axial_stiffness(belt, modulus)) / section  # (6)
    assert min(modulus, belt.cord_modulus) <= mean_modulus <= max(modulus, belt.cord_modulus)


def test_the_printed_cord_modulus_changes_the_loss_by_little(xgd24d, triangular):
    """12 GPa instead of 120 GPa: the belt is a tenth as stiff, yet drive and steady tension hardly lose anything."""
    losses = []
    for modulus in (1.2e10, 1.2e11):
        track = replace(triangular, belt=replace(triangular.belt, cord_modulus=modulus))
        vehicle = replace(xgd24d, tracks={"triangular": track})
        losses.append(float(track_model(vehicle, "triangular").loss.loss_force(10.0, 30.0, 68e3, 700.0).total))
    assert losses[0] == pytest.approx(losses[1], rel=1e-4)
    assert losses[0] != losses[1]


@given(steady=st.floats(0.0, 0.01), height=st.floats(0.0, 0.035))
def test_a_steady_tension_dissipates_nothing(triangular, xgd24d, steady, height):
    """Equations (16) to (18): it moves the means of the cycles, not their ranges, and no harmonic but the constant."""
    count = RainflowCount(triangular, track_model(xgd24d, "triangular").rubber)
    free_cycles, tension_cycles = count.along_cycles(height, 1e-4), count.along_cycles(height, 1e-4, steady)
    assert [c.cycle.range for c in tension_cycles] == pytest.approx([c.cycle.range for c in free_cycles], abs=3e-12)
    assert [c.cycle.mean for c in tension_cycles] == pytest.approx([c.cycle.mean + steady for c in free_cycles], abs=3e-12)
    positions = np.arange(4096) / 4096 * triangular.belt.loop_length
    loop = build_loop(triangular)
    harmonics = [np.fft.rfft(along_belt(loop, height, positions, tension, 1e-4))[1:] for tension in (0.0, steady)]
    assert np.abs(harmonics[1] - harmonics[0]).max() < 1e-11


@pytest.mark.parametrize("method", ["spectral", "rainflow"])
def test_the_loss_by_tension_is_zero_whatever_the_pretension(xgd24d, triangular, method):
    losses = []
    for pretension in (0.0, 15e3, 25e3):
        track = replace(triangular, belt=replace(triangular.belt, pretension=pretension))
        model = track_model(replace(xgd24d, tracks={"triangular": track}, hysteresis=method), "triangular")
        loss = model.loss.loss_force(10.0, 30.0, 68e3, 700.0)
        assert float(loss.tension) == 0.0
        losses.append(float(loss.total))
    assert losses == [losses[0]] * 3


@given(radius=st.floats(0.02, 1.0), wrap=st.floats(0.1, 6.0), height=st.floats(0.0, 0.035))
def test_equations_19_and_20(triangular, radius, wrap, height):
    """A layer's arc over that of the cord: the strain is its distance from the cord times the curvature."""
    h0 = triangular.belt.cord_height
    stretch = wrap * (radius + height) - wrap * (radius + h0)
    strain = stretch / (wrap * (radius + h0))
    assert arc_length(radius, wrap, triangular.belt) == pytest.approx(wrap * (radius + h0))
    assert (height - h0) * b.signed_curvature(radius, wrap, triangular.belt) == pytest.approx(strain, abs=1e-12)


def test_a_wheel_on_the_outer_face_bends_backwards(agri3t):
    belt = agri3t.tracks["low"].belt
    assert b.signed_curvature(0.06, -0.2, belt) == pytest.approx(-1.0 / (0.06 + belt.thickness - belt.cord_height))
    assert b.signed_curvature(0.06, 0.2, belt) == pytest.approx(1.0 / (0.06 + belt.cord_height))


def test_equation_21_bending_stress_is_zero_at_the_cord(triangular):
    """Rubber above the cord is pulled and below it pushed; E (h - h0) kappa, its square integrated in closed form."""
    belt = triangular.belt
    for order in range(4):
        integral, _ = quad(lambda h, n=order: (h - belt.cord_height) ** n, 0.0, belt.thickness)
        assert b.bending_moment_of_height(belt, order) == pytest.approx(integral, rel=1e-10)
    second_moment = ((belt.thickness - belt.cord_height) ** 3 + belt.cord_height**3) / 3.0
    assert b.bending_moment_of_height(belt, 2) == pytest.approx(second_moment)


def test_mass_and_heat_capacity_of_the_reference_belt(xgd24d, triangular):
    """q is a mass per length, and C = L_R (rho A_r c_p + rho_s A_w c_s)."""
    rubber_section = 0.635 * 0.035 - 0.0006 + 0.004
    assert mass_per_length(triangular.belt, xgd24d.rubber) == pytest.approx(1000 * rubber_section + 7850 * 0.0006)
    assert heat_capacity(triangular.belt, xgd24d.rubber) == pytest.approx(4.8 * (1.5e6 * rubber_section + 7850 * 0.0006 * 470))
    assert b.cooled_area(triangular.belt) == pytest.approx(0.75 * 2 * (0.635 + 0.035) * 4.8)
