# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One step of a belt with one and with two nodes against the matrix exponential of the equations in `model.thermal`."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm

from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.belt import Heat, advance_lumped, advance_two_nodes

CAPACITY, SHARE, CONDUCTANCE, NOISE, AMBIENT_STD = 7e4, 0.3, 650.0, 0.05, 2.5  # J/K, of the capacity, W/K, K/s^0.5, K
HEAT = Heat(power=9e3, power_slope=-90.0, cooling=210.0, surroundings=12.0)
CONSIDERED = {
    "consider_loss": (0.08, 0.03, -0.02),
    "consider_cooling": (0.01, 0.11, 0.04),
    "consider_capacity": (-0.03, 0.02, 0.07),
}
STEPS = (1e-3, 0.5, 90.0)  # s


@pytest.fixture
def constants():
    assembly = layout.Assembly(np.full(layout.Assembly.columns, np.nan))
    assembly.capacity, assembly.surface_share, assembly.inner_conductance = CAPACITY, SHARE, CONDUCTANCE
    for name, values in CONSIDERED.items():
        getattr(assembly, name)[:3] = values
    return SimpleNamespace(own=assembly, number=SimpleNamespace(with_uncertainty=True, process_noise=NOISE))


@pytest.fixture
def belt():
    return np.array([[41.0, 0.9, -0.4, 0.3, 1.1, 0.6, 0.2], [33.0, 0.5, -0.2, 0.1, 0.8, 0.4, 0.3]])


def solved(matrix, rate, start, dt):
    """z and its integral after dt of z' = matrix z + rate."""
    n = len(rate)
    block = np.zeros((2 * n + 1, 2 * n + 1))
    block[:n, :n], block[:n, -1], block[n : 2 * n, :n] = matrix, rate, np.eye(n)
    states = expm(block * dt) @ np.concatenate([start, np.zeros(n), [1.0]])
    return states[:n], states[n : 2 * n]


def walked(matrix, dt):
    """Integral of e^{matrix t} 1 1' e^{matrix' t} over dt, by Van Loan's block exponential."""
    n = len(matrix)
    block = expm(np.block([[-matrix, np.ones((n, n))], [np.zeros((n, n)), matrix.T]]) * dt)
    return block[n:, n:].T @ block[:n, n:]


def lumped(belt):
    """Jacobian of a belt with one node: change per second of each node due to heat and air, per unit."""
    gain, loss = HEAT.power / CAPACITY, HEAT.cooling * (belt[0, 0] - HEAT.surroundings) / CAPACITY
    return np.array([[(HEAT.power_slope - HEAT.cooling) / CAPACITY]]), np.array([gain]), np.array([loss]), np.zeros(1)


def two_nodes(belt):
    """The same with two, and what flows between them."""
    core, skin = belt[:, 0]
    exchange = (1.0 - SHARE) * CONDUCTANCE / (SHARE * CAPACITY)
    slope, air = HEAT.power_slope / CAPACITY, HEAT.cooling / CAPACITY * np.array([1.0, 1.0 / SHARE])
    matrix = np.array([[slope, -air[0]], [slope + exchange, -exchange - air[1]]])
    flow = np.array([0.0, exchange * (core - skin)])
    return matrix, np.full(2, HEAT.power / CAPACITY), air * (skin - HEAT.surroundings), flow


MODELS = {"lumped": (advance_lumped, lumped, 1), "two nodes": (advance_two_nodes, two_nodes, 2)}


@pytest.mark.parametrize("dt", STEPS)
@pytest.mark.parametrize("name", MODELS)
def test_temperatures_and_heat_are_those_of_the_linear_model(name, dt, constants, belt):
    advance, model, nodes = MODELS[name]
    matrix, gain, loss, flow = model(belt)
    nodes_degc, integral = solved(matrix, gain - loss + flow, np.zeros(nodes), dt)
    old_belt = belt.copy()
    heat_in, heat_out = advance(constants, constants.own, belt, HEAT, AMBIENT_STD, dt)
    assert belt[:nodes, 0] - old_belt[:nodes, 0] == pytest.approx(nodes_degc, rel=1e-8)
    assert heat_in == pytest.approx(HEAT.power * dt + HEAT.power_slope * integral[0], rel=1e-10)
    surface_degc = old_belt[nodes - 1, 0]
    assert heat_out == pytest.approx(HEAT.cooling * ((surface_degc - HEAT.surroundings) * dt + integral[-1]), rel=1e-10)
    assert heat_in - heat_out == pytest.approx(CAPACITY * nodes_degc[0], rel=1e-8)


@pytest.mark.parametrize("dt", STEPS)
@pytest.mark.parametrize("name", MODELS)
def test_departures_follow_their_causes_through_the_same_model(name, dt, constants, belt):
    advance, model, nodes = MODELS[name]
    matrix, gain, loss, flow = model(belt)
    old_belt, rates, zeros = belt.copy(), gain - loss + flow, np.zeros((nodes, nodes))
    advance(constants, constants.own, belt, HEAT, AMBIENT_STD, dt)
    gain_slope, loss_slope = zeros.copy(), zeros.copy()  # derivatives of gained and lost
    air = HEAT.cooling / CAPACITY / np.array([1.0, SHARE][:nodes])
    gain_slope[:, 0], loss_slope[:, -1] = HEAT.power_slope / CAPACITY, air
    for cause in range(3):
        of_loss, of_cooling, of_capacity = (CONSIDERED[row][cause] for row in CONSIDERED)
        forcing = gain * of_loss - loss * of_cooling - rates * of_capacity
        by_temperature = gain_slope * of_loss - loss_slope * of_cooling - matrix * of_capacity
        joint_matrix, column = np.block([[matrix, zeros], [by_temperature, matrix]]), layout.FIRST_DEPARTURE + cause
        start = np.concatenate([np.zeros(nodes), old_belt[:nodes, column]])
        expected = solved(joint_matrix, np.concatenate([rates, forcing]), start, dt)[0][nodes:]
        assert belt[:nodes, column] == pytest.approx(expected, rel=1e-8), cause
    by_air = air * AMBIENT_STD
    expected = solved(matrix, by_air, old_belt[:nodes, layout.Belt.consider_ambient], dt)[0]
    assert belt[:nodes, layout.Belt.consider_ambient] == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("dt", STEPS)
@pytest.mark.parametrize("name", MODELS)
def test_noise_goes_through_the_model_like_all_departures(name, dt, constants, belt):
    advance, model, nodes = MODELS[name]
    columns = (layout.Belt.noise_1, layout.Belt.noise_2)[:nodes]  # one node has one source of noise
    propagated_departures = np.array(
        [solved(model(belt)[0], np.zeros(nodes), belt[:nodes, column], dt)[0] for column in columns]
    ).T
    advance(constants, constants.own, belt, HEAT, AMBIENT_STD, dt)
    departures = belt[:nodes][:, list(columns)]
    noise = NOISE**2 * walked(model(belt)[0], dt)
    assert departures @ departures.T == pytest.approx(propagated_departures @ propagated_departures.T + noise, rel=1e-8)


@pytest.mark.parametrize("name", MODELS)
def test_noise_is_the_same_however_a_time_is_cut_and_bounded(name, constants, belt):
    advance, _, nodes = MODELS[name]

    def covariance(dt, steps):
        belt_copy = belt.copy()
        for _ in range(steps):
            advance(constants, constants.own, belt_copy, HEAT, AMBIENT_STD, dt)
        noise = belt_copy[:nodes, [layout.Belt.noise_1, layout.Belt.noise_2]]
        return noise @ noise.T

    assert covariance(900.0, 1) == pytest.approx(covariance(3.0, 300), rel=1e-9)
    assert covariance(1e9, 1) == pytest.approx(covariance(1e5, 1), rel=1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_without_uncertainty_only_temperatures_move_and_equally(name, constants, belt):
    advance, _, nodes = MODELS[name]
    expected_belt, old_belt = belt.copy(), belt.copy()
    advance(constants, constants.own, expected_belt, HEAT, AMBIENT_STD, 0.5)
    constants.number.with_uncertainty = False
    heat = advance(constants, constants.own, belt, HEAT, AMBIENT_STD, 0.5)
    assert all(map(math.isnan, heat))
    assert (belt[:, 0] == expected_belt[:, 0]).all()
    assert (belt[:, 1:] == old_belt[:, 1:]).all()
    assert (belt[nodes:] == old_belt[nodes:]).all()
