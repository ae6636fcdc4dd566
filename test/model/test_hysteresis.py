# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Equations (27) to (29): heat per metre of travel, by closed forms, by the work of the stress, and against each other."""

import math
from copy import copy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.model import contact, hysteresis
from trackres_ros.model.belt import (
    Profile,
    along_belt,
    bending_moment_of_height,
    build_loop,
    indentation_amplitudes,
    through_thickness,
)
from trackres_ros.model.hysteresis import HARMONICS, METHODS, RainflowCount, Spectral
from trackres_ros.model.loss_table import HARMONICS_EACH, TABLE_HARMONICS, log_speeds
from trackres_ros.model.rubber import RubberModel, thinned_numbers
from trackres_ros.model.track import load_range
from trackres_ros.vehicle import load
from trackres_ros.vehicle.belt_bulk import wrapped_radius

FLAT_STORAGE, FLAT_LOSS = 20e6, 2e6  # of the rubber without dispersion
FLAT_DYNAMIC = math.hypot(FLAT_STORAGE, FLAT_LOSS)
# Loss of one wheel over (E''/E) F^(4/3) H^(1/3) / (E^(1/3) L_w^(1/3) R_w^(2/3)), by counting and exactly.
K_RAINFLOW = math.pi / 16.0 * 1.5 ** (4.0 / 3.0)
K_EXACT = K_RAINFLOW * 16.0 / math.pi**2

temperatures = st.floats(-50.0, 120.0)
both_methods = pytest.mark.parametrize("method", list(METHODS))


def single_wheel(track):
    """The same track on one road wheel: an isolated pulse through the thickness."""
    return replace(track, beams=0, road_wheels=replace(track.road_wheels, positions=(0.675,)))


def bending_by_hand(track, loss_modulus):
    """F_bend with kappa = 1: (pi/4) E'' W [(H-h0)^3 + h0^3]/3 times the sum of squared curvatures."""
    belt = track.belt
    section = ((belt.thickness - belt.cord_height) ** 3 + belt.cord_height**3) / 3.0
    curvatures = sum(wrapped_radius(w.radius, w.wrap_angle, belt) ** -2 for w in track.wrapped_wheels)
    return math.pi / 4.0 * loss_modulus * belt.width * section * curvatures


def indentation_by_hand(track, load):
    """F_ind of one wheel for small contacts, without its factor k."""
    wheels = track.road_wheels
    return (
        FLAT_LOSS
        / FLAT_DYNAMIC
        * load ** (4 / 3)
        * track.belt.thickness ** (1 / 3)
        / (FLAT_DYNAMIC * wheels.contact_length * wheels.radius**2) ** (1 / 3)
    )


def test_the_factors_quoted_for_one_wheel():
    assert round(K_RAINFLOW, 3) == 0.337
    assert round(K_EXACT, 3) == 0.547


@given(load=st.floats(2000.0, 20000.0), speed=st.floats(0.1, 20.0), belt_degc=temperatures)
def test_rainflow_is_16_over_pi_squared_low_on_an_isolated_pulse(triangular, flat_rubber, load, speed, belt_degc):
    track = single_wheel(triangular)
    counted_loss, exact_loss = (
        method(track, flat_rubber).loss_force(speed, belt_degc, load).indentation for method in (RainflowCount, Spectral)
    )
    assert float(exact_loss / counted_loss) == pytest.approx(16.0 / math.pi**2, rel=0.004)


@given(load=st.floats(2000.0, 8000.0))
def test_indentation_in_closed_form(triangular, flat_rubber, load):
    track = single_wheel(triangular)
    for method, k in ((RainflowCount, K_RAINFLOW), (Spectral, K_EXACT)):
        loss = float(method(track, flat_rubber).loss_force(5.0, 20.0, load).indentation)
        assert loss == pytest.approx(k * indentation_by_hand(track, load), rel=0.01)


@given(radius=st.floats(0.1, 0.5), cord=st.floats(0.005, 0.03), loss=st.floats(0.1, 5.0), speed=st.floats(0.1, 20.0))
def test_counted_bending_in_closed_form(triangular, flat_rubber, radius, cord, loss, speed):
    wheels = tuple(replace(w, radius=radius if w.kind != "sprocket" else w.radius) for w in triangular.wrapped_wheels)
    track = replace(triangular, wrapped_wheels=wheels, belt=replace(triangular.belt, cord_height=cord, loop_length=7.0))
    rubber = RubberModel(replace(flat_rubber.rubber, loss_modulus_scale=loss))
    counted_loss = float(RainflowCount(track, rubber).loss_force(speed, 20.0, 68e3).bending)
    assert counted_loss == pytest.approx(bending_by_hand(track, loss * FLAT_LOSS), rel=1e-8)


def test_counting_is_low_by_about_three_on_a_bending_plateau(triangular, flat_rubber):
    exact_loss = float(Spectral(triangular, flat_rubber).loss_force(5.0, 20.0, 68e3).bending)
    assert 2.5 < exact_loss / bending_by_hand(triangular, FLAT_LOSS) < 4.0


def test_spectral_loss_of_a_sine(triangular, compound, monkeypatch):
    """Equation (28): a strain amplitude e at m cycles a loop loses pi m e^2 E''(m v/L) in a loop and unit volume."""
    rubber, length, cycles, amplitude, speed, belt_degc = RubberModel(compound), triangular.belt.loop_length, 7, 3.0, 4.0, 25.0
    positions = np.arange(2000) / 2000 * length
    sine = Profile(positions, amplitude * np.sin(2 * np.pi * cycles * positions / length + 0.4), length)
    monkeypatch.setattr(hysteresis, "build_loop", lambda track: replace(build_loop(track), curvature=sine))
    loss = float(Spectral(triangular, rubber).loss_force(speed, belt_degc, 68e3).bending)
    per_volume = math.pi * cycles * amplitude**2 * float(rubber.loss_modulus(cycles * speed / length, belt_degc))
    assert loss == pytest.approx(triangular.belt.width * bending_moment_of_height(triangular.belt, 2) * per_volume, rel=1e-4)


def test_a_counted_sine_loses_a_quarter_of_printed_equation_29(triangular, flat_rubber, monkeypatch):
    """Equation (29) has the range where (28) has the amplitude; with the amplitude, counting a sine is exact."""
    length, cycles, amplitude = triangular.belt.loop_length, 5, 2.0
    positions = np.arange(2000) / 2000 * length
    sine = Profile(positions, amplitude * np.sin(2 * np.pi * cycles * positions / length), length)
    monkeypatch.setattr(hysteresis, "build_loop", lambda track: replace(build_loop(track), curvature=sine))
    counted_loss, exact_loss = (
        float(method(triangular, flat_rubber).loss_force(5.0, 20.0, 68e3).bending) for method in (RainflowCount, Spectral)
    )
    assert counted_loss == pytest.approx(exact_loss, rel=1e-3)
    section = triangular.belt.width * bending_moment_of_height(triangular.belt, 2)
    paper_loss = math.pi * cycles * (2 * amplitude) ** 2 * FLAT_LOSS * section  # with the integral over the section it leaves out
    assert paper_loss / counted_loss == pytest.approx(4.0, rel=1e-3)


class Maxwell(RubberModel):
    """A spring and a dashpot in series, with the moduli of a compound as contacts need them."""

    MODULUS, RELAXATION_S = 5e6, 0.02

    def loss_modulus(self, frequency, belt_degc):
        x = 2.0 * np.pi * np.asarray(frequency) * self.RELAXATION_S
        return self.MODULUS * x / (1.0 + x * x) + 0.0 * np.asarray(belt_degc)


def maxwell_work(profile, speed):
    """Work [J/m^3] absorbed by a Maxwell element in one steady loop, segment by segment in closed form."""
    tau, modulus = Maxwell.RELAXATION_S, Maxwell.MODULUS
    times = np.diff(np.append(profile.position, profile.position[0] + profile.length)) / speed
    rates = np.diff(np.append(profile.value, profile.value[0])) / times

    def once_round(stress):
        work = 0.0
        for t, rate in zip(times, rates, strict=True):
            end_stress = modulus * rate * tau
            work += rate * (end_stress * t + (stress - end_stress) * tau * -math.expm1(-t / tau))
            stress = end_stress + (stress - end_stress) * math.exp(-t / tau)
        return stress, work

    at_zero, at_one = once_round(0.0)[0], once_round(1.0)[0]
    return once_round(at_zero / (1.0 - (at_one - at_zero)))[1]


@pytest.mark.parametrize("speed", [0.5, 3.0, 15.0])
def test_spectral_loss_is_the_work_of_the_stress(track, compound, speed):
    """No frequency domain: integrate stress over strain round the loop, for a material whose stress is known in closed form."""
    rubber = Maxwell(compound)
    work = maxwell_work(build_loop(track).curvature, speed) * track.belt.width * bending_moment_of_height(track.belt, 2)
    assert float(Spectral(track, rubber).loss_force(speed, 20.0, 30e3).bending) == pytest.approx(work, rel=1e-4)


def work_along(model, speed, torque):
    """Loss per metre of travel [N] by bending and drive of a `Maxwell` belt: the work of its stress, over the thickness."""
    belt, strain = model.track.belt, float(model.drive_strain(speed, 20.0, torque))
    corners = np.unique(np.concatenate([model.loop.curvature.position, model.loop.drive.position]))
    nodes, weights = np.polynomial.legendre.leggauss(3)
    work = 0.0
    for node, weight in zip(nodes, weights, strict=True):
        at_height = along_belt(model.loop, belt.thickness * (node + 1) / 2, corners, 0.0, strain)
        work += belt.width * belt.thickness / 2 * weight * maxwell_work(Profile(corners, at_height, belt.loop_length), speed)
    return work


@pytest.mark.parametrize("torque", [1e5, 2e6])
def test_spectral_loss_of_bending_and_drive_is_the_stress_work(track, compound, torque):
    """Equations (21) and (24): the stress of both strains at once; the torques are such that the drive counts."""
    model, speed = Spectral(track, Maxwell(compound)), 3.0
    pull_loss, push_loss = (model.loss_force(speed, 20.0, 30e3, sign * torque) for sign in (1, -1))
    work = [work_along(model, speed, sign * torque) for sign in (1, -1)]
    assert [float(loss.bending + loss.drive) for loss in (pull_loss, push_loss)] == pytest.approx(work, rel=1e-4)
    # what changes its sign with the torque is the product with bending; a track that is its own mirror image has none
    coupling, exact_coupling = float(pull_loss.drive - push_loss.drive) / 2, (work[0] - work[1]) / 2
    assert coupling == pytest.approx(exact_coupling, rel=1e-3, abs=1e-7 * work[0])
    if track.name == "low":
        assert abs(coupling) > 1e-4 * work[0]


def test_the_pulse_to_fourth_order_is_as_good_as_the_circle(vehicle, track):
    """Against harmonics of the circular arc itself, at the deepest contact the tables cover."""
    model = Spectral(track, RubberModel(vehicle.rubber))
    half = float(model.contacts(1.0, 120.0, load_range(vehicle, track.name).high).half_length[0])
    radius, length, n = track.road_wheels.radius, track.belt.loop_length, model.harmonics
    nodes, weights = np.polynomial.legendre.leggauss(500)
    strain = contact.indentation(nodes * half, half, radius) / track.belt.thickness
    circle = 2.0 / length * half * np.cos(2 * np.pi / length * np.outer(n, nodes * half)) @ (weights * strain)
    parabola = indentation_amplitudes(half, radius, track.belt.thickness, length, n)
    assert float((n * parabola**2).sum() / (n * circle**2).sum()) == pytest.approx(1.0, abs=1e-3)


def test_twice_the_harmonics_change_loss_by_under_a_thousandth(vehicle, track):
    random, points, rubber = np.random.default_rng(1), 80, RubberModel(vehicle.rubber)
    loads = load_range(vehicle, track.name)
    point = (
        random.uniform(0.01, vehicle.chassis.max_speed, points),
        random.uniform(-60.0, 120.0, points),
        random.uniform(loads.low, loads.high, points),
    )
    loss, double_loss = (Spectral(track, rubber, count).loss_force(*point) for count in (HARMONICS, 2 * HARMONICS))
    assert np.abs(double_loss.total / loss.total - 1.0).max() < 1e-3
    assert np.abs(double_loss.bending / loss.bending - 1.0).max() < 1e-3


def test_a_thinned_table_method_has_the_loss_of_all_harmonics(vehicle, track):
    random, rubber, loads = np.random.default_rng(2), RubberModel(vehicle.rubber), load_range(vehicle, track.name)
    speed = 10.0 ** (random.uniform(*log_speeds(rubber), 100) - rubber.log_shift(20.0))
    point, nodes = (speed, 20.0, random.uniform(loads.low, loads.high, 100)), thinned_numbers(TABLE_HARMONICS, HARMONICS_EACH)
    thin_loss, full_loss = (Spectral(track, rubber, TABLE_HARMONICS, harmonics).loss_force(*point) for harmonics in (nodes, None))
    assert len(nodes) < TABLE_HARMONICS / 5
    assert np.abs(thin_loss.total / full_loss.total - 1.0).max() < 2e-5


def test_pulses_of_unequal_wheels_add_by_their_phases(triangular, compound):
    """The transform of the strain of all wheels at once, of which no two carry the same."""
    beam = replace(triangular.beams, split=0.4, own_weight_split=0.4)
    beam = replace(beam, front=replace(beam.front, split=0.45), rear=replace(beam.rear, split=0.7))
    track, rubber, speed, load_n = replace(triangular, beams=beam), RubberModel(compound), 5.0, 60e3
    model, positions = Spectral(track, rubber, 512), np.arange(1 << 15) / (1 << 15) * triangular.belt.loop_length
    half = model.contacts(speed, 20.0, load_n).half_length
    assert len(set(np.round(half, 6))) == len(half)
    amplitudes = 2.0 * np.abs(np.fft.rfft(through_thickness(model.loop, half, positions)))[1:513] / len(positions)
    n = model.harmonics
    loss = np.pi * n * amplitudes**2 @ rubber.loss_modulus(n * speed / track.belt.loop_length, 20.0)
    section = track.road_wheels.contact_length * track.belt.thickness * compound.layer_stiffening
    assert float(model.loss_force(speed, 20.0, load_n).indentation) == pytest.approx(section * loss, rel=2e-3)


@cache
def shipped(name, method, seen=None):
    """Loss of a shipped vehicle, or of its mirror image, by a method; of few harmonics, as laws hold with any number."""
    vehicle = load(name)
    track = next(iter(vehicle.tracks.values()))
    given_track, rubber = seen(track) if seen else track, RubberModel(vehicle.rubber)
    return Spectral(given_track, rubber, 512) if method == "spectral" else METHODS[method](given_track, rubber)


@both_methods
@given(data=st.data(), belt_degc=temperatures, speed=st.floats(0.0, 1.0))
def test_the_loss_rises_with_load(vehicle, method, data, belt_degc, speed):
    loads = load_range(vehicle, next(iter(vehicle.tracks)))
    low = data.draw(st.floats(loads.low, 0.98 * loads.high))
    high = data.draw(st.floats(1.01 * low, loads.high))
    point = speed * vehicle.chassis.max_speed, belt_degc
    light_loss, heavy_loss = shipped(vehicle.name, method).loss_force(*point, np.array([low, high])).total
    assert light_loss < heavy_loss


@both_methods
@given(scale=st.floats(0.5, 1.9), belt_degc=temperatures, speed=st.floats(0.0, 16.0))
def test_the_loss_rises_with_the_loss_modulus(xgd24d, method, scale, belt_degc, speed):
    """As long as the loss factor is under the square root of 3: beyond it the contact shrinks faster than the loss grows."""
    model, losses = shipped("xgd24d", method), []
    for s in (scale, 1.05 * scale):
        scaled = copy(model)
        scaled.rubber = RubberModel(replace(xgd24d.rubber, loss_modulus_scale=s))
        losses.append(float(scaled.loss_force(speed, belt_degc, 68e3).total))
    assert losses[0] < losses[1]


@both_methods
@given(speed=st.floats(0.01, 16.0), belt_degc=temperatures, share=st.floats(-0.2, 0.2))
def test_reverse_is_the_mirror_image_of_forward(vehicle, mirrored, method, speed, belt_degc, share):
    """Which way the vehicle travels does not matter; a torque does by its sense, as tight and slack run change over."""
    model, from_behind = shipped(vehicle.name, method), shipped(vehicle.name, method, mirrored)
    weight = load_range(vehicle, model.track.name).nominal
    torque = share * weight * model.track.sprocket_radius
    ahead, reverse = (model.loss_force(v, belt_degc, weight, torque) for v in (speed, -speed))
    assert [float(part) for part in ahead] == [float(part) for part in reverse]
    mirror_image = from_behind.loss_force(speed, belt_degc, weight, -torque)
    assert float(mirror_image.total) == pytest.approx(float(ahead.total), rel=1e-8)
    assert float(mirror_image.drive) == pytest.approx(float(ahead.drive), rel=1e-6, abs=1e-8 * float(ahead.total))


@both_methods
def test_the_loss_per_metre_has_a_limit_at_rest(vehicle, method):
    """F_h stays finite, so the heat F_h v is zero at rest, and M = F_h R1 is never 0/0 as equation (33) is."""
    loads = load_range(vehicle, next(iter(vehicle.tracks)))
    losses = shipped(vehicle.name, method).loss_force(np.array([0.0, 1e-9, 1e-8]), 20.0, loads.nominal).total
    assert np.isfinite(losses).all()
    assert (losses > 0.0).all()
    assert losses == pytest.approx(np.full(3, losses[0]), rel=1e-6)


@both_methods
def test_a_vectorised_call_is_its_points(vehicle, method):
    model, random = shipped(vehicle.name, method), np.random.default_rng(2)
    loads = load_range(vehicle, model.track.name)
    speed, belt_degc = random.uniform(0.0, vehicle.chassis.max_speed, (5, 1)), random.uniform(-40.0, 100.0, (1, 7))
    weight, torque = random.uniform(loads.low, loads.high, (5, 7)), random.uniform(-100.0, 100.0, (5, 7))
    losses = model.loss_force(speed, belt_degc, weight, torque)
    assert losses.total.shape == (5, 7)
    for i in np.ndindex(5, 7):
        point = model.loss_force(speed[i[0], 0], belt_degc[0, i[1]], weight[i], torque[i])
        assert [float(part) for part in point] == pytest.approx([float(part[i]) for part in losses], rel=1e-8, abs=1e-9)


@both_methods
def test_a_sprocket_at_any_place_of_the_loop(triangular, compound, method):
    """First or last of the wrapped wheels too, where its arc begins or ends with the ground run."""
    for shift in range(3):
        wheels = triangular.wrapped_wheels[shift:] + triangular.wrapped_wheels[:shift]
        loss = METHODS[method](replace(triangular, wrapped_wheels=wheels), RubberModel(compound)).loss_force(
            5.0, 20.0, 68e3, 1000.0
        )
        assert abs(float(loss.drive)) < 0.005 * float(loss.total)


def test_a_counted_cycle_lasts_as_long_as_its_passage(triangular, compound):
    """The contact 2a, so f = v/(2a); or the wrap of a wheel with half the length it takes up its curvature on either side."""
    count = RainflowCount(triangular, RubberModel(compound))
    half = np.array([0.02, 0.021, 0.022, 0.023])
    pulses = count.indentation_cycles(half)
    assert sorted({round(c.passage, 9) for c in pulses}) == pytest.approx([0.04, 0.042, 0.044, 0.046])
    assert sum(c.cycle.number for c in pulses) == 4.0
    bends = count.along_cycles(triangular.belt.thickness, 0.0)
    arcs = {
        round(w.wrap_angle * (w.radius + triangular.belt.cord_height) + triangular.belt.curvature_length, 9)
        for w in triangular.wrapped_wheels
    }
    assert sorted({round(c.passage, 9) for c in bends}) == pytest.approx(sorted(arcs))


def test_drive_torque_strains_the_belt_by_force_over_stiffness(triangular, compound):
    model = Spectral(triangular, RubberModel(compound))
    strain = float(model.drive_strain(5.0, 20.0, 720.0))
    modulus = float(model.rubber.dynamic_modulus(5.0 / 4.8, 20.0))
    assert strain == pytest.approx(720.0 / 0.36 / (1.2e11 * 0.0006 + modulus * (0.635 * 0.035 - 0.0006)))
    assert strain < 5e-5


def test_the_layer_stiffening_acts_on_both_moduli_of_the_layer(triangular, flat_rubber):
    """Twice as stiff a layer loses what a material with twice both moduli loses, and bends as before."""
    stiff_rubber = RubberModel(replace(flat_rubber.rubber, layer_stiffening=2.0))
    double_rubber = RubberModel(
        replace(flat_rubber.rubber, storage_pa=2 * flat_rubber.rubber.storage_pa, loss_pa=2 * flat_rubber.rubber.loss_pa)
    )
    for method in METHODS.values():
        layer, material = (method(triangular, rubber).loss_force(5.0, 20.0, 68e3) for rubber in (stiff_rubber, double_rubber))
        assert float(layer.indentation) == pytest.approx(float(material.indentation), rel=1e-9)
        assert float(layer.bending) == pytest.approx(float(material.bending) / 2, rel=1e-9)
