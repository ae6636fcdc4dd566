# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One operating point by parts: complete, and the parts add up."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trackres_ros.effects import Active, Effect, Parameter, Terms
from trackres_ros.effects.stepping import MOST_TORQUE
from trackres_ros.estimator.columns import Reason
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.kernel import INTERPRETED
from trackres_ros.model.operating_point import explain, explain_road, left_out_at
from trackres_ros.model.resistance import direction
from trackres_ros.model.track import with_methods
from trackres_ros.route.learned import SLOPE, RouteMap
from trackres_ros.vehicle import Vehicle, load, load_any

FULL_SPEED = 50 / 3.6
PARTS = ("indentation", "bending", "tension", "drive")
few = settings(max_examples=6)
speeds = st.floats(-16.0, 16.0)
temperatures = st.floats(-40.0, 110.0)
weights = st.floats(1.5e5, 4e5)


def test_what_a_point_consists_of(vehicle):
    point = explain(vehicle, 3.0, 20.0)
    assert set(point) >= {"wheel_loads_n", "contact", "tension_n", "loss_force_n", "torque_nm", "heat_w", "cooling_w", "rainflow"}
    assert set(point["loss_force_n"]) == {*PARTS, "total"}
    assert set(point["torque_nm"]) == {"hysteresis", "bearing", "wind", "effects", "inertia", "resistance"}
    wheels = len(vehicle.track_of(vehicle.assemblies[0]).road_wheels.positions)
    assert [len(loads) for loads in point["wheel_loads_n"]] == [wheels] * len(vehicle.assemblies)
    assert len(point["contact"]) == wheels
    for contact in point["contact"]:
        assert set(contact) == {"half_length_m", "max_strain", "frequency_hz", "modulus_mpa"}
    for strain_range, mean, count, component in point["rainflow"]:
        assert component in ("through", "along")
        assert count in (0.5, 1.0)
        assert strain_range > 0.0
        assert math.isfinite(mean)


def test_a_point_survives_json(vehicle):
    point = explain(vehicle, 3.0, 20.0)
    assert json.loads(json.dumps(point, allow_nan=False)) == point


@pytest.mark.parametrize("method", ["spectral", "rainflow"])
@few
@given(speed=speeds, belt_degc=temperatures, weight=weights)
def test_parts_add_up(xgd24d, method, speed, belt_degc, weight):
    """Wheel loads to the weight, causes to the loss, parts to the torque of equation (32), losses times speed to the heat."""
    vehicle = with_methods(xgd24d, hysteresis=method)
    point = explain(vehicle, speed, belt_degc, 15.0, weight)
    assert sum(map(sum, point["wheel_loads_n"])) == pytest.approx(weight)
    for loss in [point["loss_force_n"], *point["loss_force_by_assembly_n"]]:
        assert sum(loss[part] for part in PARTS) == pytest.approx(loss["total"])
    torque = point["torque_nm"]
    assert torque["hysteresis"] + torque["bearing"] + torque["wind"] == pytest.approx(torque["resistance"])
    assert torque["inertia"] == 0.0  # a steady state
    assert point["heat_w"] == pytest.approx(sum(loss["total"] for loss in point["loss_force_by_assembly_n"]) * abs(speed))
    assert point["cooling_w"] * (belt_degc - 15.0) >= 0.0
    omega = speed / xgd24d.tracks["triangular"].sprocket_radius  # equation (33); near standstill the torque fades out
    assert torque["hysteresis"] * omega == pytest.approx(point["heat_w"] * abs(direction(speed)), rel=1e-6, abs=1e-9)


@few
@given(speed=st.floats(0.0, 16.0), belt_degc=temperatures)
def test_reverse_turns_the_torque_and_keeps_the_heat(xgd24d, speed, belt_degc):
    ahead, reverse = (explain(xgd24d, v, belt_degc) for v in (speed, -speed))
    assert reverse["heat_w"] == pytest.approx(ahead["heat_w"], rel=1e-6)
    for part, torque in ahead["torque_nm"].items():
        assert -reverse["torque_nm"][part] == pytest.approx(torque, rel=1e-6, abs=1e-9)


def test_standing_there_is_neither_heat_nor_torque(vehicle):
    point = explain(vehicle, 0.0, 40.0)
    assert point["heat_w"] == 0.0
    assert set(point["torque_nm"].values()) == {0.0}
    assert point["loss_force_n"]["total"] > 0.0  # per metre: finite, though nothing moves
    assert point["cooling_w"] > 0.0


@pytest.mark.parametrize("method", ["spectral", "rainflow"])
@pytest.mark.parametrize("name", ["xgd24d", "agri3t"])
def test_the_exact_point_is_what_the_estimator_shows(name, method):
    """Within the error of its table: torque by part, heat and cooling of a belt at 40 degC."""
    vehicle = with_methods(load(name), hysteresis=method)
    speed, estimator = 0.8 * vehicle.chassis.max_speed, Estimator(vehicle)
    inputs = estimator.inputs(speed, ambient=15.0, acceleration=0.0)
    state = estimator.cold_start(inputs, belt_degc=40.0)
    for _ in range(5):
        state, estimate = estimator.step(state, inputs, 1e-6)
    point = explain(vehicle, speed, 40.0, 15.0)
    for part, torque in point["torque_nm"].items():
        assert estimate[f"{part}_torque_nm" if part == "resistance" else f"{part}_nm"] == pytest.approx(torque, rel=0.003)
    assert estimate["heat_w"] == pytest.approx(point["heat_w"], rel=0.003)
    assert estimate["cooling_w"] == pytest.approx(point["cooling_w"], rel=1e-6)


def test_contacts_carry_their_wheel_loads(xgd24d):
    """By hand from the numbers shown: F = 2 E L a^3/(3 R H) within the terms of higher order."""
    point, track = explain(xgd24d, FULL_SPEED, 15.0), xgd24d.tracks["triangular"]
    for load_n, contact in zip(point["wheel_loads_n"][0], point["contact"], strict=True):
        a, modulus = contact["half_length_m"], contact["modulus_mpa"] * 1e6
        cubic = modulus * track.road_wheels.contact_length * 2 * a**3 / (3 * track.road_wheels.radius * track.belt.thickness)
        assert load_n == pytest.approx(cubic, rel=0.5 * (a / track.road_wheels.radius) ** 2)
        assert contact["frequency_hz"] == pytest.approx(FULL_SPEED / (2 * a))
        assert contact["max_strain"] == pytest.approx(a**2 / (2 * track.road_wheels.radius * track.belt.thickness), rel=0.02)


def test_the_rainflow_matrix_of_the_reference_point(xgd24d):
    """Equation (25): four contacts, and three wraps that bend the outer face by (H - h0)/(R + h0), about the steady strain."""
    point, track = explain(xgd24d, FULL_SPEED, 15.0), xgd24d.tracks["triangular"]
    cycles_through = [row for row in point["rainflow"] if row[3] == "through"]
    assert sum(row[2] for row in cycles_through) == 4.0
    assert {round(row[0], 9) for row in cycles_through} == {round(contact["max_strain"], 9) for contact in point["contact"]}
    cycles_along = [row for row in point["rainflow"] if row[3] == "along" and row[0] > 1e-3]
    face = track.belt.thickness - track.belt.cord_height
    expected = sorted(face / (w.radius + track.belt.cord_height) for w in track.wrapped_wheels)
    assert sum(row[2] for row in cycles_along) == 3.0
    ranges = np.repeat([row[0] for row in cycles_along], [round(2 * row[2]) for row in cycles_along])
    assert sorted(ranges) == pytest.approx(np.repeat(expected, 2), rel=0.01)  # the drive adds its little
    steady_strain = point["tension_n"] / (track.belt.cord_modulus * track.belt.cord_section)
    assert min(row[1] - row[0] / 2 for row in cycles_along) == pytest.approx(steady_strain, rel=0.5)


class Odd(Effect):
    """A torque for a wrong answer, or for none."""

    name, acts_on, belongs_to, text = "odd", "torque", "vehicle", "an effect of a user's own"
    parameters = (Parameter("size", "1", -1e9, 1e9, 1.0, "torque over that of the limit", off=0.0),)

    def terms(self, at, p):
        largest_torque = MOST_TORQUE * at.facts.weight * at.facts.radius
        return Terms(torque=largest_torque / p.size) if p.size < 1e3 else Terms(heat=p.size)


@pytest.mark.parametrize("name", ["agri3t", "bmw_i3"])
@pytest.mark.parametrize(("size", "acts"), [(1.01, True), (0.99, False), (0.0, False), (math.nan, False), (1e6, False)])
def test_a_point_leaves_out_what_the_step_refuses(name, size, acts):
    bare_vehicle = load_any(name)
    vehicle = replace(bare_vehicle, effects=(Active(Odd(), {"size": size}),))

    def point(subject):
        return explain(subject, 2.0, 20.0) if isinstance(subject, Vehicle) else explain_road(subject, 2.0)

    content = point(vehicle)
    assert content["effects_left_out"] == ([] if acts else ["odd"])
    assert left_out_at(vehicle, 2.0, 20.0) == content["effects_left_out"]
    assert (content["torque_nm"] == point(bare_vehicle)["torque_nm"]) == (not acts)
    estimator = Estimator(vehicle, entries=INTERPRETED)
    inputs = estimator.inputs(2.0)
    reasons = estimator.step(estimator.cold_start(inputs), inputs, 0.1)[1].reasons
    assert bool(reasons & Reason.EFFECT_LEFT_OUT) == (not acts)


@pytest.mark.parametrize("name", ["agri3t", "bmw_i3"])
def test_a_point_has_no_place_and_leaves_out_the_route(name):
    zeros = np.zeros(1)
    vehicle = replace(
        load_any(name), route=(RouteMap(SLOPE, zeros, zeros, zeros, np.zeros((1, 2)), np.ones((1, 2)), np.ones(1, int)),)
    )
    content = explain(vehicle, 2.0, 20.0) if isinstance(vehicle, Vehicle) else explain_road(vehicle, 2.0)
    assert content["effects_left_out"] == left_out_at(vehicle, 2.0, 20.0) == ["route"]
