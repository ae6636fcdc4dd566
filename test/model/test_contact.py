# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Equations (7) to (11): a rigid wheel on a Winkler layer."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad, simpson

from trackres_ros.model import contact
from trackres_ros.model.rubber import RubberModel
from trackres_ros.model.track import load_range, track_model

R, LENGTH, H = 0.13, 0.40, 0.035  # the reference road wheel and belt
FIGURE_6_MODULUS = 40e6

shares = st.floats(1e-6, contact.LARGEST_HALF_LENGTH)  # of the wheel radius
moduli = st.floats(1e5, 1e10)
lengths = st.floats(0.005, 2.0)


@given(share=shares, modulus=moduli, radius=lengths, length=lengths, thickness=lengths)
def test_the_half_length_carries_the_force(share, modulus, radius, length, thickness):
    force = contact.contact_force(share * radius, modulus, radius, length, thickness)
    a = contact.half_length_for_force(force, modulus, radius, length, thickness)
    assert float(contact.contact_force(a, modulus, radius, length, thickness)) == pytest.approx(float(force), rel=1e-9)
    assert float(a) == pytest.approx(share * radius, rel=1e-8)


@given(share=st.floats(1e-3, 0.98), modulus=moduli)
def test_the_closed_form_is_equation_10(share, modulus):
    a = share * R
    integral, _ = quad(lambda x: modulus * float(contact.indentation(x, a, R)) / H * LENGTH, -a, a, epsrel=1e-11)
    assert float(contact.contact_force(a, modulus, R, LENGTH, H)) == pytest.approx(integral, rel=1e-8)


@given(share=st.floats(1e-7, 0.3))
def test_the_force_goes_as_the_cube_of_small_half_lengths(share):
    a = share * R
    cubic = FIGURE_6_MODULUS * LENGTH * 2.0 * a**3 / (3.0 * R * H)
    ratio = float(contact.contact_force(a, FIGURE_6_MODULUS, R, LENGTH, H)) / cubic
    assert 1.0 + 0.3 * share**2 - 1e-8 <= ratio <= 1.0 + 0.4 * share**2 + 1e-8


@given(first=shares, second=shares)
def test_force_and_half_length_rise_together(first, second):
    low, high = sorted((first, second))
    forces = contact.contact_force(np.array([low, high]) * R, FIGURE_6_MODULUS, R, LENGTH, H)
    half_lengths = contact.half_length_for_force(forces, FIGURE_6_MODULUS, R, LENGTH, H)
    if high > low * (1 + 1e-9):
        assert forces[0] < forces[1]
        assert half_lengths[0] < half_lengths[1]


def test_an_excessive_load_gives_the_largest_contact():
    assert float(contact.half_length_for_force(1e12, 1e6, R, LENGTH, H)) == contact.LARGEST_HALF_LENGTH * R


def test_no_load_has_no_contact():
    assert float(contact.half_length_for_force(0.0, 1e7, R, LENGTH, H)) == 0.0


@given(share=st.floats(1e-6, 0.95), x=st.floats(-0.2, 0.2))
def test_equation_8(share, x):
    a = share * R
    depth = float(contact.indentation(x, a, R))
    expected = np.sqrt(R**2 - x**2) - np.sqrt(R**2 - a**2) if abs(x) < a else 0.0
    assert depth == pytest.approx(expected, abs=1e-15)
    assert depth / H <= float(contact.largest_strain(a, R, H)) + 1e-15
    assert float(contact.largest_strain(a, R, H)) == pytest.approx(float(contact.indentation(0.0, a, R)) / H)


def test_pressure_is_modulus_times_strain():
    """Equations (7) and (9): stiffness of the layer k = E/H, and the pressure adds up to the load."""
    force, modulus = 3000.0, FIGURE_6_MODULUS
    a = float(contact.half_length_for_force(force, modulus, R, LENGTH, H))
    x = np.linspace(-a, a, 20001)
    pressure = modulus / H * contact.indentation(x, a, R)
    assert pressure.max() == pytest.approx(modulus * float(contact.largest_strain(a, R, H)))
    assert simpson(pressure, x=x) * LENGTH == pytest.approx(force, rel=1e-6)


def search_as_printed(force, modulus):
    """Figure 5 and equation (11): the first j with a = j R / 1000 whose force is within 1 % of the load, None if none is."""
    for j in range(1, 1000):
        if abs(float(contact.contact_force(j * R / 1000, modulus, R, LENGTH, H)) - force) < 0.01 * force:
            return j
    return None


@given(j=st.integers(5, 100), between=st.floats(0.45, 0.55))
def test_the_search_of_equation_11_steps_over_the_load(j, between):
    a = (j + between) * R / 1000
    force = float(contact.contact_force(a, FIGURE_6_MODULUS, R, LENGTH, H))
    assert search_as_printed(force, FIGURE_6_MODULUS) is None
    assert float(contact.half_length_for_force(force, FIGURE_6_MODULUS, R, LENGTH, H)) == pytest.approx(a, rel=1e-9)


@given(share=st.floats(0.152, 0.95))
def test_the_search_of_equation_11_ends_above_j_150(share):
    place = search_as_printed(float(contact.contact_force(share * R, FIGURE_6_MODULUS, R, LENGTH, H)), FIGURE_6_MODULUS)
    assert place is not None
    assert place == pytest.approx(1000 * share, abs=3.0 + 0.004 * 1000 * share)


def test_the_search_of_equation_11_does_not_end_within_figure_6():
    """Wheel loads 1 to 5 kN on 40 MPa, the figure's own: at 3 kN no step is within 1 %."""
    places = [search_as_printed(load, FIGURE_6_MODULUS) for load in (1e3, 2e3, 3e3, 4e3, 5e3)]
    exact_places = contact.half_length_for_force(np.array([1e3, 2e3, 3e3, 4e3, 5e3]), FIGURE_6_MODULUS, R, LENGTH, H) / R * 1000
    assert places[2] is None
    assert [abs(j - place) < 1.0 for j, place in zip(places, exact_places, strict=True) if j is not None] == [True] * 4
    assert (np.diff(exact_places) > 0).all()  # the figure's trend: contact length and strain grow with the load


@given(data=st.data())
def test_half_length_frequency_and_modulus_fit_each_other(vehicle, data):
    name, track = next(iter(vehicle.tracks.items()))
    loads, wheels, thickness = load_range(vehicle, name), track.road_wheels, track.belt.thickness
    force = data.draw(st.floats(loads.low, loads.high)) / len(wheels.positions)
    speed = data.draw(st.floats(0.001, vehicle.chassis.max_speed))
    belt_degc = data.draw(st.floats(-70.0, 120.0))
    rubber = RubberModel(vehicle.rubber)
    a, frequency, modulus = contact.solve_contact(
        force, speed, lambda f: rubber.dynamic_modulus(f, belt_degc), wheels.radius, wheels.contact_length, thickness
    )
    assert float(frequency) == pytest.approx(speed / (2.0 * float(a)), rel=1e-9)
    assert float(modulus) == pytest.approx(float(rubber.dynamic_modulus(frequency, belt_degc)), rel=1e-6)
    assert float(contact.contact_force(a, modulus, wheels.radius, wheels.contact_length, thickness)) == pytest.approx(
        force, rel=1e-9
    )


def test_wheels_under_more_load_have_longer_contacts(xgd24d):
    contacts = track_model(xgd24d, "triangular").loss.contacts(10.0, 30.0, np.array([40e3, 68e3, 100e3]))
    assert contacts.half_length.shape == (3, 4)
    assert (np.diff(contacts.half_length, axis=0) > 0).all()
    assert (np.diff(contacts.largest_strain, axis=0) > 0).all()
    assert (np.diff(contacts.frequency, axis=0) < 0).all()
