# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The strain a piece of belt sees round the loop: periodic, continuous, closed, and its harmonics exact."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from trackres_ros.model import belt as sh
from trackres_ros.model import contact
from trackres_ros.vehicle import WrappedWheel
from trackres_ros.vehicle.loading import CLOSED_LOOP_TOLERANCE_RAD

HARMONICS = np.arange(1.0, 65.0)
SAMPLES = 1 << 16


@st.composite
def tracks(draw, base, fewest=1):
    """The base track with up to four wheels wrapped by random angles, over random lengths of curvature."""
    count = draw(st.integers(fewest, 4))
    wheels = tuple(
        WrappedWheel(f"w{i}", "sprocket" if i == 0 else "guide", draw(st.floats(0.2, 1.2)), radius=draw(st.floats(0.05, 0.4)))
        for i in range(count)
    )
    belt = replace(base.belt, curvature_length=draw(st.floats(0.005, 0.3)))
    return replace(base, wrapped_wheels=wheels, belt=belt)


def sampled(values):
    """Amplitudes A_n of one loop sampled evenly, for HARMONICS."""
    return 2.0 / len(values) * np.fft.fft(values)[1 : len(HARMONICS) + 1]


@given(data=st.data(), s=st.floats(-20.0, 20.0))
def test_profiles_are_periodic_and_continuous(triangular, data, s):
    loop = sh.build_loop(data.draw(tracks(triangular)))
    for profile in (loop.curvature, loop.drive):
        assert profile.values_at(s) == pytest.approx(profile.values_at(s + loop.length), abs=1e-9)
        steps = np.diff(np.append(profile.position, profile.position[0] + loop.length))
        assert steps.min() > 0.0  # no two values at one place: no jump
        steepest = np.abs(np.diff(np.append(profile.value, profile.value[0])) / steps).max()
        assert abs(profile.values_at(s + 1e-4) - profile.values_at(s)) <= 1e-4 * steepest * (1 + 1e-6) + 1e-9


@given(data=st.data())
def test_curvature_adds_up_to_the_wrap_angles(triangular, data):
    track = data.draw(tracks(triangular))
    curvature = sh.build_loop(track).curvature
    position = np.append(curvature.position, curvature.position[0] + curvature.length)
    value = np.append(curvature.value, curvature.value[0])
    angle = float(np.sum(np.diff(position) * (value[1:] + value[:-1]) / 2))
    assert angle == pytest.approx(sum(w.wrap_angle for w in track.wrapped_wheels), rel=1e-7)


def test_the_shipped_loops_close(track):
    loop = sh.build_loop(track)
    corners = [*loop.curvature.position, loop.curvature.position[0] + loop.length]
    angle, _ = quad(lambda s: float(loop.curvature.values_at(s)), corners[0], corners[-1], points=corners[1:-1], limit=200)
    assert angle == pytest.approx(2.0 * math.pi, abs=CLOSED_LOOP_TOLERANCE_RAD)
    assert loop.arcs[-1][1] == pytest.approx(loop.length)  # the last wheel hands the belt to the ground run


def test_the_belt_is_curved_on_wheels_and_straight_between_them(triangular):
    loop = sh.build_loop(triangular)
    for (start, end, curvature), wheel in zip(loop.arcs, triangular.wrapped_wheels, strict=True):
        assert curvature == pytest.approx(1.0 / (wheel.radius + triangular.belt.cord_height))
        assert float(loop.curvature.values_at((start + end) / 2)) == pytest.approx(curvature)
        assert float(loop.curvature.values_at((start + 2 * end) / 3)) == pytest.approx(curvature)
        assert float(loop.curvature.values_at(start)) == pytest.approx(curvature / 2)  # taken up half before, half on the wheel
    on_ground = loop.curvature.values_at(np.linspace(0.05, 1.3, 200))
    assert np.abs(on_ground).max() < 1e-12  # road wheels in the middle of the ground run do not bend it


@given(data=st.data())
def test_amplitudes_are_those_of_the_sampled_profile(triangular, data):
    loop = sh.build_loop(data.draw(tracks(triangular)))
    positions = np.arange(SAMPLES) / SAMPLES * loop.length
    for profile in (loop.curvature, loop.drive):
        amplitudes = profile.amplitudes(HARMONICS)
        assert np.abs(sampled(profile.values_at(positions)) - amplitudes).max() <= 1e-5 * np.abs(amplitudes).max()


@given(share=st.floats(0.01, 0.5))
def test_indentation_amplitudes_are_the_integral_over_contact(triangular, share):
    """A_n = (2/L) times the integral of strain(x) cos(2 pi n x/L)."""
    radius, thickness, length = triangular.road_wheels.radius, triangular.belt.thickness, triangular.belt.loop_length
    a = share * radius
    amplitudes = sh.indentation_amplitudes(a, radius, thickness, length, np.arange(1.0, 301.0))
    for n in (1, 10, 30, 64, 65, 100, 300):
        integral, _ = quad(
            lambda x: float(contact.indentation(x, a, radius)) / thickness, 0.0, a, weight="cos", wvar=2 * math.pi * n / length
        )
        assert amplitudes[n - 1] == pytest.approx(4.0 / length * integral, abs=(1e-6 + 0.04 * share**4) * amplitudes[0])


def test_amplitudes_of_the_whole_strain_through_the_thickness(track):
    """The wheels' pulses with their phases, against a transform of the strain at 65536 places."""
    loop = sh.build_loop(track)
    half = 0.2 * track.road_wheels.radius
    positions = np.arange(SAMPLES) / SAMPLES * loop.length
    count = len(loop.wheel_positions)
    phases = np.exp(-2j * np.pi / loop.length * np.outer(HARMONICS, loop.wheel_positions)).sum(axis=1)
    pulse = sh.indentation_amplitudes(half, track.road_wheels.radius, track.belt.thickness, loop.length, HARMONICS)
    strain = sh.through_thickness(loop, np.full(count, half), positions)
    assert np.abs(sampled(strain) - pulse * phases).max() <= 1e-4 * np.abs(pulse[0] * count)
    assert strain.max() == pytest.approx(
        float(contact.largest_strain(half, track.road_wheels.radius, track.belt.thickness)), rel=1e-3
    )


@given(z=st.floats(1e-6, 60.0))
def test_pulse_transforms_are_their_integrals(z):
    parabola, quartic = sh.pulse_transforms(np.array([z]), np.sin([z]), np.cos([z]))
    for transform, order in ((parabola, 2), (quartic, 4)):
        integral, _ = quad(lambda u, k=order: 1.0 - u**k, 0.0, 1.0, weight="cos", wvar=z)
        assert float(transform[0]) == pytest.approx(2.0 * integral, abs=2e-10)


def test_pulse_transforms_meet_where_the_series_ends():
    either_side = np.array([sh.SERIES_BELOW * (1 - 1e-12), sh.SERIES_BELOW])
    for transform in sh.pulse_transforms(either_side, np.sin(either_side), np.cos(either_side)):
        assert transform[0] == pytest.approx(transform[1], rel=1e-10)


@given(data=st.data())
def test_reverse_is_the_mirror_image(triangular, mirrored, data):
    """Laying out the mirrored track gives the mirrored profiles; tension hands over to slack and back."""
    track = data.draw(tracks(triangular, fewest=2))
    base_loop, mirror_loop = sh.build_loop(track), sh.build_loop(mirrored(track))
    s = np.linspace(0.0, base_loop.length, 501)
    run = track.road_wheels.ground_run
    assert mirror_loop.curvature.values_at(run - s) == pytest.approx(base_loop.curvature.values_at(s), abs=1e-6)
    assert 1.0 - mirror_loop.drive.values_at(run - s) == pytest.approx(base_loop.drive.values_at(s), abs=1e-6)
    half = np.linspace(0.01, 0.02, len(base_loop.wheel_positions))
    assert sh.through_thickness(mirror_loop, half[::-1], run - s) == pytest.approx(
        sh.through_thickness(base_loop, half, s), abs=1e-9
    )
    for mirror_profile, base_profile in ((mirror_loop.curvature, base_loop.curvature), (mirror_loop.drive, base_loop.drive)):
        assert np.abs(mirror_profile.amplitudes(HARMONICS)) == pytest.approx(np.abs(base_profile.amplitudes(HARMONICS)), abs=1e-9)


def test_drive_tension_grows_on_the_ground_and_ends_on_sprocket(triangular):
    """Equations (22) and (23): each of n teeth takes M_D/(n R_D); over the wrap the steps add up to the whole drive force."""
    loop = sh.build_loop(triangular)
    start, end, _ = loop.arcs[1]
    assert loop.drive.values_at([0.0, triangular.road_wheels.ground_run, start, end]) == pytest.approx([0.0, 1.0, 1.0, 0.0])
    teeth = 7
    steps = np.cumsum(np.full(teeth, 1.0 / teeth))
    middles = start + (end - start) * (np.arange(teeth) + 0.5) / teeth
    assert 1.0 - loop.drive.values_at(middles) == pytest.approx(steps - 0.5 / teeth)


@given(height=st.floats(0.0, 0.035), steady=st.floats(0.0, 0.01), drive=st.floats(-1e-3, 1e-3), s=st.floats(0.0, 4.8))
def test_strains_along_the_belt_add_up(triangular, height, steady, drive, s):
    loop = sh.build_loop(triangular)
    parts = [sh.along_belt(loop, height, s, *strains) for strains in ((0.0, 0.0), (steady, 0.0), (0.0, drive))]
    total = sh.along_belt(loop, height, s, steady, drive)
    assert float(total) == pytest.approx(float(parts[1] + parts[2] - parts[0]), abs=1e-15)
    at_cord = sh.along_belt(loop, triangular.belt.cord_height, s, 0.0, 0.0)
    assert float(at_cord) == 0.0
