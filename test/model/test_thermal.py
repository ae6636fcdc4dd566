# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Equations (26), (30) and (31): the belt's temperature as the estimator carries it, by both networks."""

import math
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_bvp, solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq

from trackres_ros.estimator.columns import Belt
from trackres_ros.estimator.drives import ramp_and_hold, simulate
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.model.loss_table import loss_table
from trackres_ros.model.thermal import (
    film_coefficient,
    phi_1,
    phi_2,
    phi_matrix,
    surface_temperature,
    thermal_network,
)
from trackres_ros.model.track import track_model, vehicle_constants, with_methods
from trackres_ros.vehicle import load

NETWORKS = ("lumped", "core_surface")
both_networks = pytest.mark.parametrize("thermal", NETWORKS)
few = settings(max_examples=15)
ambients = st.floats(-25.0, 45.0)
FULL_SPEED = 50 / 3.6


@cache
def estimator(thermal, name="xgd24d", hysteresis="spectral"):
    return Estimator(with_methods(load(name), hysteresis, thermal))


@cache
def model_of(vehicle):
    return track_model(vehicle, vehicle.assemblies[0].track)


def network_of(model_estimator):
    return model_of(model_estimator.vehicle).network


def stored_heat(model_estimator, start, end):
    """Heat [J] that the belts took up between two states."""
    return float((end.belts - start.belts)[:, 0, Belt.temperature].sum() * network_of(model_estimator).capacity)


def conductances(network, speed):
    """Matrix [1/s], ambient's column [1/s] and heat's column [K/J] of the network's linear equation."""
    cooling = network.area * film_coefficient(speed, network.film_offset, network.film_slope)
    if not network.two_nodes:
        c = network.capacity
        return np.array([[-cooling / c]]), np.array([cooling / c]), np.array([1 / c])
    share = network.surface_share
    core, skin = (1.0 - share) * network.capacity, share * network.capacity
    inner = (1.0 - share) ** 2 * network.inner_conductance  # between core and surface: to the mean it is more
    nodes = np.array([[-inner / core, inner / core], [inner / skin, -(inner + cooling) / skin]])
    to_state = np.array([[1.0 - share, share], [0.0, 1.0]])  # mean and surface, from core and surface
    return (
        to_state @ nodes @ np.linalg.inv(to_state),
        to_state @ np.array([0.0, cooling / skin]),
        to_state @ np.array([1.0, 1.0]) / network.capacity,
    )


@both_networks
@few
@given(
    legs=st.lists(st.tuples(st.floats(1.0, 200.0), st.floats(-8.0, 16.0)), min_size=1, max_size=6),
    ambient=ambients,
    start=st.floats(-25.0, 90.0),
    dt=st.sampled_from([0.01, 0.1, 0.7, 5.0]),
)
def test_energy_balance_closes(thermal, legs, ambient, start, dt):
    """Heat in less heat out is heat stored: to 1e-6 of the heat that went through, at any step."""
    model_estimator = estimator(thermal)
    corners = np.cumsum([0.0, *(duration for duration, _ in legs)])
    time = np.arange(0.0, corners[-1] + dt, dt)
    speed = np.interp(time, corners, [0.0, *(v for _, v in legs)])
    inputs = model_estimator.inputs(0.0, ambient=ambient)
    start_state = model_estimator.cold_start(inputs, belt_degc=start)
    end, rows = model_estimator.run(start_state, time, speed, model_estimator.vehicle.weight, ambient)
    flows = (
        rows[1:, [model_estimator.column_index["heat_w"], model_estimator.column_index["cooling_w"]]]
        * np.diff(time)[:, np.newaxis]
    )
    assert abs(flows[:, 0].sum() - flows[:, 1].sum() - stored_heat(model_estimator, start_state, end)) <= 1e-6 * (
        np.abs(flows).sum() + 1.0
    )


def steady_state(model_estimator, speed, weight, ambient, drive_torque):
    """Solve F(T) v = U A (T - Ta) on the exact loss: temperatures of mean and surface."""
    model = model_of(model_estimator.vehicle)
    network, load_n = model.network, weight / len(model_estimator.assemblies)
    cooling = network.area * film_coefficient(speed, network.film_offset, network.film_slope)
    to_air = 1.0 / (1.0 / cooling + 1.0 / network.inner_conductance) if network.two_nodes else cooling

    def excess(belt_degc):
        return float(
            model.loss.loss_force(speed, belt_degc, load_n, drive_torque / len(model_estimator.assemblies)).total
        ) * speed - to_air * (belt_degc - ambient)

    mean = float(brentq(excess, ambient, 200.0))
    return np.array([mean, ambient + to_air * (mean - ambient) / cooling][: 2 if network.two_nodes else 1])


@both_networks
@few
@given(speed=st.floats(1.0, 16.0), weight=st.floats(2e5, 3.5e5), ambient=ambients)
def test_heating_ends_in_the_balance_of_heat_and_cooling(thermal, speed, weight, ambient):
    model_estimator = estimator(thermal)
    time = np.arange(0.0, 40000.0, 2.0)
    end, rows = model_estimator.run(
        model_estimator.cold_start(model_estimator.inputs(speed, weight, ambient)),
        time,
        np.full_like(time, speed),
        weight,
        ambient,
        0.0,
    )
    belt = rows[:, model_estimator.column_index["belt_degc/front_left"]]
    balance = steady_state(model_estimator, speed, weight, ambient, rows[-1, model_estimator.column_index["drive_torque_nm"]])
    for node, balance_degc in enumerate(balance):
        end_degc = end.belts[0, node, Belt.temperature]
        assert end_degc - ambient == pytest.approx(balance_degc - ambient, rel=0.003)  # of the table
    assert (np.diff(belt) >= -1e-9).all()  # from ambient up to balance, never past it
    assert belt[0] == ambient
    heat, cooling = (rows[-1, model_estimator.column_index[name]] for name in ("heat_w", "cooling_w"))
    assert heat == pytest.approx(cooling, rel=1e-4)


@both_networks
@given(start=st.floats(-30.0, 120.0), ambient=ambients, log_dt=st.floats(-3.0, 5.7))
def test_at_rest_the_belt_cools_exponentially_over_any_step(thermal, start, ambient, log_dt):
    model_estimator, dt = estimator(thermal), 10.0**log_dt
    state = model_estimator.cold_start(model_estimator.inputs(0.0, ambient=ambient), belt_degc=start)
    matrix, _, _ = conductances(network_of(model_estimator), 0.0)
    rates, modes = np.linalg.eig(matrix)  # an older `expm` overflows on the longest steps
    expected = ambient + modes * np.exp(rates * dt) @ np.linalg.solve(modes, np.full(len(matrix), start - ambient))
    for end in (
        model_estimator.step(state, model_estimator.inputs(0.0, ambient=ambient), dt)[0],
        model_estimator.rest(state, ambient, dt),
    ):
        for node, value in enumerate(expected):
            assert end.belts[:, node, Belt.temperature] == pytest.approx(np.full(4, value), abs=1e-8)


@both_networks
@few
@given(log_first=st.floats(0.0, 5.5), log_second=st.floats(0.0, 5.5), ambient=ambients)
def test_a_rest_in_two_parts_is_the_whole_rest(thermal, log_first, log_second, ambient):
    """Temperatures and all their departures, after belts that a drive has warmed."""
    model_estimator, first_s, second_s = estimator(thermal), 10.0**log_first, 10.0**log_second
    inputs = model_estimator.inputs(12.0, ambient=ambient)
    warm, _ = model_estimator.run(
        model_estimator.cold_start(inputs),
        np.arange(0.0, 1200.0, 1.0),
        np.full(1200, 12.0),
        model_estimator.vehicle.weight,
        ambient,
        0.0,
    )
    single, parts = (
        model_estimator.rest(warm, ambient, first_s + second_s),
        model_estimator.rest(model_estimator.rest(warm, ambient, first_s), ambient, second_s),
    )
    assert parts.belts == pytest.approx(single.belts, rel=1e-6, abs=1e-6)


@both_networks
@pytest.mark.parametrize("hysteresis", ["spectral", "rainflow"])
@few
@given(first=ambients, second=ambients, speed=st.floats(2.0, 16.0), weight=st.floats(2e5, 3.5e5))
def test_no_crossover_between_ambients(thermal, hysteresis, first, second, speed, weight):
    """From belts at the ambient temperature: where it is warmer the belt is hotter and the torque lower, at all times."""
    low_degc, high_degc = sorted((first, second))
    drive = ramp_and_hold(speed, 0.0, 3000.0, 1.0)
    model_estimator = estimator(thermal, hysteresis=hysteresis)
    cold_rows, warm_rows = (simulate(model_estimator, drive, weight, ambient) for ambient in (low_degc, high_degc))
    assert (warm_rows["belt_degc"] >= cold_rows["belt_degc"]).all()
    assert (warm_rows["resistance_torque_nm"] <= cold_rows["resistance_torque_nm"] * (1 + 1e-9)).all()
    if high_degc - low_degc > 0.1:
        assert (warm_rows["belt_degc"] > cold_rows["belt_degc"]).all()
        assert (warm_rows["resistance_torque_nm"] < cold_rows["resistance_torque_nm"]).all()
        difference = warm_rows["belt_degc"][-1] - cold_rows["belt_degc"][-1]
        assert 0.0 < difference < high_degc - low_degc  # dT*/dTa = 1/(1 + s): differences shrink, and do not vanish


@both_networks
@few
@given(first=st.floats(2e5, 3.5e5), second=st.floats(2e5, 3.5e5), speed=st.floats(2.0, 16.0), ambient=ambients)
def test_torque_rises_with_load_at_all_times(thermal, first, second, speed, ambient):
    low, high = sorted((first, second))
    drive = ramp_and_hold(speed, 50.0, 3000.0, 1.0)
    light_rows, heavy_rows = (simulate(estimator(thermal), drive, weight, ambient) for weight in (low, high))
    assert (heavy_rows["resistance_torque_nm"] >= light_rows["resistance_torque_nm"]).all()
    assert (heavy_rows["belt_degc"] >= light_rows["belt_degc"]).all()
    if high - low > 100.0:
        assert (heavy_rows["resistance_torque_nm"][1:] > light_rows["resistance_torque_nm"][1:]).all()


@both_networks
@pytest.mark.parametrize("dt", [0.01, 0.1, 0.5])
def test_steps_against_an_ode_solver_on_the_same_table(thermal, dt):
    """A drive with a ramp, a hold and a stop: the temperature of a stiff solver at tight tolerances."""
    model_estimator = estimator(thermal)
    model, table = model_of(model_estimator.vehicle), loss_table(model_estimator.vehicle, "triangular")
    corners, speeds = [0.0, 50.0, 400.0, 430.0, 600.0], [0.0, FULL_SPEED, FULL_SPEED, 0.0, 0.0]

    def rates(t, nodes):
        speed = float(np.interp(t, corners, speeds))
        matrix, by_ambient, by_heat = conductances(model.network, speed)
        x = math.log10(max(speed, 1e-6)) + float(model.rubber.log_shift(nodes[0]))
        return matrix @ nodes + by_ambient * 15.0 + by_heat * float(table.loss_at(x, 68e3)) * speed

    time = np.arange(0.0, 600.0 + dt / 2, dt)
    start = model_estimator.cold_start(model_estimator.inputs(0.0, ambient=15.0))
    end, _ = model_estimator.run(start, time, np.interp(time, corners, speeds), 272e3, 15.0)
    nodes = np.full(2 if model.network.two_nodes else 1, 15.0)
    for leg in pairwise(corners):
        nodes = solve_ivp(rates, leg, nodes, method="LSODA", rtol=1e-8, atol=1e-8, max_step=5.0).y[:, -1]
    assert end.belts[0, : len(nodes), Belt.temperature] == pytest.approx(nodes, abs=2e-3)
    assert nodes[0] > 30.0


@given(z=st.floats(-1e4, 2.0))
def test_phi_functions_of_a_number(z):
    block = expm(np.array([[z, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]))
    assert phi_1(z) == pytest.approx(block[0, 1], rel=1e-9)
    assert phi_2(z) == pytest.approx(block[0, 2], rel=1e-9)


@given(core=st.floats(1e-9, 50.0), skin=st.floats(1e-9, 50.0), out=st.floats(0.0, 50.0), heat=st.floats(-20.0, 0.5))
def test_phi_functions_of_a_matrix(core, skin, out, heat):
    z = np.array([[heat - core, core], [skin, -skin - out]])
    check_phi(z)


@given(terms=st.tuples(*[st.floats(-0.5, 0.5)] * 4))
def test_phi_functions_of_a_small_matrix_of_any_kind(terms):
    """Complex eigenvalues and equal ones among them."""
    check_phi(np.array(terms).reshape(2, 2))


def check_phi(z):
    block = np.zeros((6, 6))
    block[:2, :2], block[:2, 2:4], block[2:4, 4:] = z, np.eye(2), np.eye(2)
    expected = expm(block)
    for order in (1, 2):
        result = np.array(phi_matrix(*z.ravel(), float(order))).reshape(2, 2)
        assert result == pytest.approx(expected[:2, 2 * order : 2 * order + 2], rel=1e-7, abs=1e-9)


def test_the_inner_conductance_is_that_of_a_slab_heated_evenly(vehicle):
    """Steady conduction in half the thickness: the heat through both faces over the mean temperature above them."""
    belt, rubber = next(iter(vehicle.tracks.values())).belt, vehicle.rubber
    network, half, heating = thermal_network("core_surface", belt, rubber), belt.thickness / 2, 1e5
    profile = solve_bvp(
        lambda x, y: np.vstack([y[1], np.full_like(x, -heating / rubber.conductivity)]),
        lambda middle, face: np.array([middle[1], face[0]]),
        np.linspace(0.0, half, 20),
        np.zeros((2, 20)),
    )
    mean, _ = quad(lambda x: float(profile.sol(x)[0]) / half, 0.0, half)
    through_faces = heating * half * network.area
    assert network.inner_conductance == pytest.approx(through_faces / mean, rel=1e-6)


def test_equation_31_is_in_metres_per_second(xgd24d):
    """62 W/m^2/K at 50 km/h agrees with correlations for plates and tyres; with v in km/h it would be 109."""
    network = thermal_network("lumped", xgd24d.tracks["triangular"].belt, xgd24d.rubber)
    assert film_coefficient(FULL_SPEED, network.film_offset, network.film_slope) == pytest.approx(62.4, abs=0.1)
    track = replace(xgd24d.tracks["triangular"], belt=replace(xgd24d.tracks["triangular"].belt, film_speed_unit="km/h"))
    in_kmh = replace(xgd24d, tracks={"triangular": track})
    network, facts = thermal_network("lumped", track.belt, xgd24d.rubber), vehicle_constants(in_kmh)
    film = film_coefficient(FULL_SPEED, network.film_offset, network.film_slope)
    assert film == pytest.approx(109.1, abs=0.1)
    assert facts.cooling + FULL_SPEED * facts.cooling_by_speed == pytest.approx(film * network.area)  # what effects know of it
    assert film_coefficient(-FULL_SPEED, 44.39, 1.295) == film_coefficient(FULL_SPEED, 44.39, 1.295)


def test_what_effects_know_of_unlike_tracks_are_means(xgd24d):
    """No value is that of the first kind, and the torques of the tensions add up."""
    track = xgd24d.tracks["triangular"]
    belt = replace(track.belt, width=0.8 * track.belt.width, pretension=2e4, film_offset=90.0, film_slope=4.0)
    wheels = replace(track.road_wheels, ground_run=2.0 * track.road_wheels.ground_run)
    tracks = {"triangular": track, "other": replace(track, sprocket_radius=0.45, road_wheels=wheels, belt=belt)}
    assemblies = [replace(a, track="other" if a.axle == "rear" else "triangular") for a in xgd24d.assemblies]
    mixture, reversal = (replace(xgd24d, tracks=tracks, assemblies=tuple(order)) for order in (assemblies, assemblies[::-1]))
    facts = vehicle_constants(mixture)
    assert facts == pytest.approx(vehicle_constants(reversal))
    torques = [tracks[a.track].belt.pretension * tracks[a.track].sprocket_radius for a in assemblies]
    assert facts.assemblies * facts.radius * facts.tension == pytest.approx(sum(torques))


def test_the_mean_is_not_the_surface(xgd24d):
    """Equation (30) takes the mean: at 50 km/h the Biot number of half the belt is about 4, and the skin is much cooler."""
    belt, rubber = xgd24d.tracks["triangular"].belt, xgd24d.rubber
    network = thermal_network("lumped", belt, rubber)
    film = film_coefficient(FULL_SPEED, network.film_offset, network.film_slope)
    assert 3.0 < film * belt.thickness / 2 / rubber.conductivity < 6.0
    surface = surface_temperature(70.0, 15.0, film, network.area, network.inner_conductance)
    assert network.inner_conductance * (70.0 - surface) == pytest.approx(film * network.area * (surface - 15.0))
    assert surface < 50.0


@pytest.mark.parametrize("speed", [0.0, FULL_SPEED])
def test_two_nodes_hold_as_much_heat_as_one(xgd24d, speed):
    belt, rubber = xgd24d.tracks["triangular"].belt, xgd24d.rubber
    one_node, two_node = (thermal_network(name, belt, rubber) for name in NETWORKS)
    assert two_node.capacity == one_node.capacity
    assert (
        conductances(one_node, speed)[0][0, 0] < np.linalg.eigvals(conductances(two_node, speed)[0]).max() < 0.0
    )  # and give it off slower


@both_networks
def test_equation_26_as_printed_has_a_belt_in_balance_at_ambient(thermal):
    """T = (Q_gen - Q_dis)/(m c) + T0 with the powers of (30): once they are equal the belt would be cold. C dT/dt = P - P_dis."""
    model_estimator = estimator(thermal)
    time = np.arange(0.0, 20000.0, 2.0)
    _, rows = model_estimator.run(
        model_estimator.cold_start(model_estimator.inputs(FULL_SPEED)), time, np.full_like(time, FULL_SPEED), 272e3, 15.0, 0.0
    )
    network, end_values = network_of(model_estimator), {name: rows[-1, i] for name, i in model_estimator.column_index.items()}
    capacity = len(model_estimator.assemblies) * network.capacity
    assert (end_values["heat_w"] - end_values["cooling_w"]) / capacity + 15.0 == pytest.approx(15.0, abs=1e-3)
    assert end_values["belt_degc/front_left"] > 50.0
