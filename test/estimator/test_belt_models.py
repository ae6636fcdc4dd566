# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One step of a belt with one and with two nodes against the matrix exponential of the equations in `model.thermal`."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm

from trackres_ros.estimator import columns as at
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
    own = at.Assembly(np.full(at.Assembly.columns, np.nan))
    own.capacity, own.surface_share, own.inner_conductance = CAPACITY, SHARE, CONDUCTANCE
    for name, values in CONSIDERED.items():
        getattr(own, name)[:3] = values
    return SimpleNamespace(own=own, number=SimpleNamespace(with_uncertainty=True, process_noise=NOISE))


@pytest.fixture
def belt():
    return np.array([[41.0, 0.9, -0.4, 0.3, 1.1, 0.6, 0.2], [33.0, 0.5, -0.2, 0.1, 0.8, 0.4, 0.3]])


def solved(matrix, rate, start, dt):
    """z and its integral after dt of z' = matrix z + rate."""
    n = len(rate)
    whole = np.zeros((2 * n + 1, 2 * n + 1))
    whole[:n, :n], whole[:n, -1], whole[n : 2 * n, :n] = matrix, rate, np.eye(n)
    found = expm(whole * dt) @ np.concatenate([start, np.zeros(n), [1.0]])
    return found[:n], found[n : 2 * n]


def walked(matrix, dt):
    """Integral of e^{matrix t} 1 1' e^{matrix' t} over dt, by Van Loan's block exponential."""
    n = len(matrix)
    found = expm(np.block([[-matrix, np.ones((n, n))], [np.zeros((n, n)), matrix.T]]) * dt)
    return found[n:, n:].T @ found[:n, n:]


def lumped(belt):
    """Jacobian of a belt with one node: change per second of each node due to heat and air, per unit."""
    gained, lost = HEAT.power / CAPACITY, HEAT.cooling * (belt[0, 0] - HEAT.surroundings) / CAPACITY
    return np.array([[(HEAT.power_slope - HEAT.cooling) / CAPACITY]]), np.array([gained]), np.array([lost]), np.zeros(1)


def two_nodes(belt):
    """The same with two, and what flows between them."""
    core, skin = belt[:, 0]
    between = (1.0 - SHARE) * CONDUCTANCE / (SHARE * CAPACITY)
    slope, air = HEAT.power_slope / CAPACITY, HEAT.cooling / CAPACITY * np.array([1.0, 1.0 / SHARE])
    matrix = np.array([[slope, -air[0]], [slope + between, -between - air[1]]])
    flow = np.array([0.0, between * (core - skin)])
    return matrix, np.full(2, HEAT.power / CAPACITY), air * (skin - HEAT.surroundings), flow


MODELS = {"lumped": (advance_lumped, lumped, 1), "two nodes": (advance_two_nodes, two_nodes, 2)}


@pytest.mark.parametrize("dt", STEPS)
@pytest.mark.parametrize("name", MODELS)
def test_temperatures_and_heat_are_those_of_the_linear_model(name, dt, constants, belt):
    advance, model, nodes = MODELS[name]
    matrix, gained, lost, flow = model(belt)
    moved, integral = solved(matrix, gained - lost + flow, np.zeros(nodes), dt)
    before = belt.copy()
    heat_in, heat_out = advance(constants, constants.own, belt, HEAT, AMBIENT_STD, dt)
    assert belt[:nodes, 0] - before[:nodes, 0] == pytest.approx(moved, rel=1e-8)
    assert heat_in == pytest.approx(HEAT.power * dt + HEAT.power_slope * integral[0], rel=1e-10)
    outer = before[nodes - 1, 0]
    assert heat_out == pytest.approx(HEAT.cooling * ((outer - HEAT.surroundings) * dt + integral[-1]), rel=1e-10)
    assert heat_in - heat_out == pytest.approx(CAPACITY * moved[0], rel=1e-8)


@pytest.mark.parametrize("dt", STEPS)
@pytest.mark.parametrize("name", MODELS)
def test_departures_follow_their_causes_through_the_same_model(name, dt, constants, belt):
    advance, model, nodes = MODELS[name]
    matrix, gained, lost, flow = model(belt)
    before, moves, none = belt.copy(), gained - lost + flow, np.zeros((nodes, nodes))
    advance(constants, constants.own, belt, HEAT, AMBIENT_STD, dt)
    gains, loses = none.copy(), none.copy()  # derivatives of gained and lost
    air = HEAT.cooling / CAPACITY / np.array([1.0, SHARE][:nodes])
    gains[:, 0], loses[:, -1] = HEAT.power_slope / CAPACITY, air
    for cause in range(3):
        of_loss, of_cooling, of_capacity = (CONSIDERED[row][cause] for row in CONSIDERED)
        forced = gained * of_loss - lost * of_cooling - moves * of_capacity
        by_temperature = gains * of_loss - loses * of_cooling - matrix * of_capacity
        both, column = np.block([[matrix, none], [by_temperature, matrix]]), at.FIRST_DEPARTURE + cause
        start = np.concatenate([np.zeros(nodes), before[:nodes, column]])
        expected = solved(both, np.concatenate([moves, forced]), start, dt)[0][nodes:]
        assert belt[:nodes, column] == pytest.approx(expected, rel=1e-8), cause
    by_air = air * AMBIENT_STD
    expected = solved(matrix, by_air, before[:nodes, at.Belt.consider_ambient], dt)[0]
    assert belt[:nodes, at.Belt.consider_ambient] == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("dt", STEPS)
@pytest.mark.parametrize("name", MODELS)
def test_noise_goes_through_the_model_like_all_departures(name, dt, constants, belt):
    advance, model, nodes = MODELS[name]
    columns = (at.Belt.noise_1, at.Belt.noise_2)[:nodes]  # one node has one source of noise
    carried = np.array([solved(model(belt)[0], np.zeros(nodes), belt[:nodes, column], dt)[0] for column in columns]).T
    advance(constants, constants.own, belt, HEAT, AMBIENT_STD, dt)
    after = belt[:nodes][:, list(columns)]
    added = NOISE**2 * walked(model(belt)[0], dt)
    assert after @ after.T == pytest.approx(carried @ carried.T + added, rel=1e-8)


@pytest.mark.parametrize("name", MODELS)
def test_noise_is_the_same_however_a_time_is_cut_and_bounded(name, constants, belt):
    advance, _, nodes = MODELS[name]

    def covariance(dt, steps):
        after = belt.copy()
        for _ in range(steps):
            advance(constants, constants.own, after, HEAT, AMBIENT_STD, dt)
        noise = after[:nodes, [at.Belt.noise_1, at.Belt.noise_2]]
        return noise @ noise.T

    assert covariance(900.0, 1) == pytest.approx(covariance(3.0, 300), rel=1e-9)
    assert covariance(1e9, 1) == pytest.approx(covariance(1e5, 1), rel=1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_without_uncertainty_only_temperatures_move_and_equally(name, constants, belt):
    advance, _, nodes = MODELS[name]
    wanted, before = belt.copy(), belt.copy()
    advance(constants, constants.own, wanted, HEAT, AMBIENT_STD, 0.5)
    constants.number.with_uncertainty = False
    heat = advance(constants, constants.own, belt, HEAT, AMBIENT_STD, 0.5)
    assert all(map(math.isnan, heat))
    assert (belt[:, 0] == wanted[:, 0]).all()
    assert (belt[:, 1:] == before[:, 1:]).all()
    assert (belt[nodes:] == before[nodes:]).all()
