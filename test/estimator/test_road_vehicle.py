# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A vehicle without belts runs in the same step: its torque is the road load, and a standing one is not pushed."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.effects import Active, catalogue
from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.units import GRAVITY, STANDSTILL_MPS
from trackres_ros.vehicle import RoadVehicle, load, load_any, with_surroundings

START_NS = 1_700_000_000_000_000_000
BUS = load_any("ztbus_hess19")
ESTIMATOR = Estimator(BUS)


def at_once(estimator, **known):
    inputs = estimator.inputs(**known)
    return estimator.step(estimator.cold_start(inputs), inputs, 0.0)[1]


def driven(estimator, speeds, **channels):
    """Steps ten times a second, each channel sent a moment before each speed."""
    session, estimates = estimator.session(), []
    for i, speed in enumerate(speeds):
        time_ns = START_NS + i * 10**8
        for name, value in channels.items():
            session.handle(session.channel(name), time_ns, time_ns, float(value))
        estimates.append(session.handle(layout.SPEED, time_ns, time_ns, float(speed)))
    return session, estimates


@given(
    st.floats(-19.0, 19.0), st.floats(1e5, 3e5), st.floats(-2.0, 2.0), st.floats(-0.1, 0.1)
)  # fmt: skip
def test_the_torque_is_the_road_load_in_closed_form(speed, weight, accel, grade):
    v = BUS.values
    sign = math.tanh(speed / STANDSTILL_MPS)
    rolling = (v["rolling_coefficient"] + v["rolling_rise"] * abs(speed)) * weight * sign
    wind = 0.5 * v["air_density"] * v["drag_area"] * speed * abs(speed)
    inertia = v["rotating_mass_factor"] * weight / GRAVITY * accel + weight * math.sin(math.atan(grade))
    torque = v["wheel_radius"] * (rolling + wind + inertia)
    power = torque * sign / (1e-3 * BUS.weight * v["wheel_radius"])
    estimate = at_once(ESTIMATOR, speed=speed, weight=weight, acceleration=accel, grade=grade)
    assert estimate["drive_torque_nm"] == pytest.approx(torque * v["efficiency"] ** -math.tanh(power), rel=1e-9, abs=1e-6)
    assert estimate["bearing_nm"] == pytest.approx(v["wheel_radius"] * rolling, rel=1e-9, abs=1e-9)
    assert estimate["hysteresis_nm"] == 0.0


@pytest.mark.parametrize("name", ["bmw_i3", "husky", "ztbus_hess19"])
def test_it_has_no_column_of_a_belt(name):
    estimator = Estimator(load_any(name))
    inputs = estimator.inputs(speed=1.0)
    assert not [column for column in estimator.columns if "/" in column]
    for item in (estimator.cold_start(inputs), at_once(estimator, speed=1.0)):
        assert "belt" not in repr(item)


@pytest.mark.parametrize("shown", ["warmup", "stribeck", "roadwheel_tyres"])
def test_feedforward_is_zero_at_standstill(shown):
    effect = catalogue(size=BUS.size, on_tyres=True)[shown]
    estimator = Estimator(replace(BUS, effects=(Active(effect, effect.values()),)))
    _, estimates = driven(estimator, [*np.linspace(0.0, 8.0, 50), *np.linspace(8.0, 0.0, 50), *np.zeros(100)], accel=0.0)
    assert max(estimate.feedforward_torque_nm for estimate in estimates) > 100.0
    assert estimates[-1].feedforward_torque_nm == 0.0
    assert estimates[-1].resistance_torque_nm == pytest.approx(0.0, abs=1e-9)


def test_tyres_that_warm_up_lose_less_on_the_way():
    warmup = catalogue(size=BUS.size, on_tyres=True)["warmup"]
    estimator = Estimator(replace(BUS, effects=(Active(warmup, {**warmup.values(), "time_constant": 60.0}),)))
    _, estimates = driven(estimator, np.full(3000, 10.0), accel=0.0)
    assert estimates[0]["effects_nm"] > estimates[-1]["effects_nm"] + 0.5 * warmup.values()["torque"]


def test_passengers_add_to_the_mass_and_a_load_replaces_it():
    _, estimates = driven(ESTIMATOR, [5.0], passengers=10)
    assert estimates[0]["weight_n"] == pytest.approx(BUS.weight + 10 * ESTIMATOR.settings.passenger_kg * GRAVITY)
    _, estimates = driven(ESTIMATOR, [5.0], load=2.5e5)
    assert estimates[0]["weight_n"] == 2.5e5


def test_a_measured_torque_is_divided_by_its_scale():
    double_scale = replace(BUS, values={**BUS.values, "torque_scale": 2.0})
    rows = [driven(Estimator(vehicle), [5.0, 5.0], torque=1000.0)[1][-1] for vehicle in (BUS, double_scale)]
    assert (rows[0]["measured_torque_nm"], rows[1]["measured_torque_nm"]) == (1000.0, 500.0)
    assert rows[1]["residual_nm"] == rows[1]["measured_torque_nm"] - rows[1]["drive_torque_nm"]


@pytest.mark.parametrize("part", ["rolling_coefficient", "rolling_rise", "drag_area", "wheel_radius", "efficiency"])
def test_a_wider_range_in_the_file_is_a_less_sure_torque(part):
    q = BUS.parameters[f"road_load.{part}"]
    parameters = {**BUS.parameters, f"road_load.{part}": replace(q, low=q.low - 0.5 * (q.high - q.low), high=q.high)}
    narrow, broad = (at_once(Estimator(v), speed=12.0) for v in (BUS, replace(BUS, parameters=parameters)))
    assert broad.resistance_std_nm > narrow.resistance_std_nm > 0.0
    assert broad.resistance_torque_nm == narrow.resistance_torque_nm


@pytest.mark.parametrize("learns", [False, True])
@pytest.mark.parametrize("part", ["rolling_coefficient", "drag_area"])
def test_a_value_of_0_is_as_uncertain_as_its_range(part, learns):
    path, width = f"road_load.{part}", BUS.values[part]

    def std(value, high):
        q = replace(BUS.parameters[path], value=value, low=0.0, high=high)
        estimator = Estimator(replace(BUS, values={**BUS.values, part: value}, parameters={**BUS.parameters, path: q}))
        inputs = estimator.inputs(speed=12.0, acceleration=0.0)
        state = estimator.cold_start(inputs)
        layout.Learned(state.learned).on = float(learns)  # each departure is known to be 0
        return estimator.step(state, inputs, 0.0)[1].resistance_std_nm

    force = {"rolling_coefficient": BUS.weight, "drag_area": 0.5 * BUS.values["air_density"] * 12.0**2}[part]
    of_range = BUS.values["wheel_radius"] * force * width / 4.0 / BUS.values["efficiency"]
    assert std(0.0, width) ** 2 - std(0.0, 0.0) ** 2 == pytest.approx(of_range**2, rel=0.01)
    if not learns:
        assert std(0.0, width) == pytest.approx(std(1e-9, width), rel=1e-6)


@pytest.mark.parametrize("name", ["bmw_i3", "husky", "ztbus_hess19"])
def test_the_standard_deviation_is_the_change_by_all_ranges(name):
    vehicle, step = load_any(name), 0.1
    speeds, squares = np.array([0.4, 0.7, 1.0]) * vehicle.chassis.max_speed, np.zeros(3)
    for part in ("rolling_coefficient", "rolling_rise", "drag_area", "air_density", "wheel_radius", "efficiency"):
        torques = []
        for sign in (1, -1):
            value = vehicle.values[part] + sign * step * vehicle.parameters[f"road_load.{part}"].standard_deviation
            estimator = Estimator(replace(vehicle, values={**vehicle.values, part: value}))
            torques.append([at_once(estimator, speed=v, acceleration=0.0).resistance_torque_nm for v in speeds])
        squares += ((np.array(torques[0]) - torques[1]) / (2 * step)) ** 2
    estimator_0 = Estimator(vehicle)
    stds = [at_once(estimator_0, speed=v, acceleration=0.0).resistance_std_nm for v in speeds]
    assert stds == pytest.approx(np.sqrt(squares), rel=0.01)


def test_a_wheel_speed_is_a_witness_and_no_load():
    _, estimates = driven(ESTIMATOR, np.full(40, 5.0), wheel_speed=0.0)
    assert layout.Reason.SPEED_DISAGREES in estimates[-1].reasons
    assert estimates[-1]["weight_n"] == pytest.approx(BUS.weight)
    assert estimates[-1].feedforward_torque_nm == 0.0


def test_its_surroundings_are_those_made_for_it(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text("schema: 1\nvehicle: ztbus_hess19\neffects: {grade: {grade: 0.02}}\n")
    site_vehicle = with_surroundings(BUS, path)
    assert isinstance(site_vehicle, RoadVehicle)
    extra = at_once(Estimator(site_vehicle), speed=10.0)["effects_nm"] - at_once(ESTIMATOR, speed=10.0)["effects_nm"]
    assert extra == pytest.approx(0.02 * BUS.size, rel=0.06)
    with pytest.raises(InputError, match="ztbus_hess19"):
        with_surroundings(load_any("bmw_i3"), path)


def test_what_needs_belts_says_so():
    with pytest.raises(InputError, match="which has no belts"):
        load("bmw_i3")
