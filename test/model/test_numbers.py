# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Whole drives against an independent prototype of the same model: torque within 3 %, belt temperature within 2 K.

Whole-vehicle torque without inertia [Nm] and mean belt temperature [degC]; the reference vehicle, film coefficient in m/s.
"""

from functools import cache

import pytest

from trackres_ros.estimator.drives import ramp_and_hold, simulate
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.model.track import with_methods
from trackres_ros.vehicle import load

TORQUE, TEMPERATURE_K = 0.03, 2.0
TIMES_S = (50, 250, 600, 1000, 2500)
BY_SPEED = {  # km/h: (Nm, degC) at TIMES_S, from rest in 50 s, 272 kN, 15 degC
    10: [(3003, 15), (2925, 19), (2840, 23), (2786, 27), (2722, 31)],
    30: [(3265, 17), (3023, 27), (2837, 39), (2747, 47), (2665, 54)],
    50: [(3505, 18), (3138, 35), (2910, 53), (2813, 62), (2741, 70)],
}
BY_WEIGHT = {200: (2196, 59), 250: (2573, 67), 300: (2960, 75), 350: (3352, 83)}  # kN: at 2500 s of 50 km/h
BY_AMBIENT = {-15: (7143, 3784, 3181), 0: (4662, 3558, 3063), 15: (3877, 3355, 2959), 30: (3505, 3186, 2867)}  # at 0, 250, 2500 s
BY_COUNT = {10: (2025, 1940), 50: (2395, 2121)}  # km/h: Nm at 60 and 2500 s, by rainflow


@cache
def series(speed_kmh, ramp_s, weight_kn=272, ambient_degc=15, method="spectral"):
    estimator = Estimator(with_methods(load("xgd24d"), hysteresis=method, thermal="lumped"))
    return simulate(estimator, ramp_and_hold(speed_kmh / 3.6, ramp_s, 2500.0, 0.1), weight_kn * 1e3, ambient_degc)


def at(columns, time_s):
    row = int(round(time_s / 0.1))
    assert columns["time_s"][row] == pytest.approx(time_s)
    return float(columns["resistance_torque_nm"][row]), float(columns["belt_degc"][row])


@pytest.mark.parametrize(("speed_kmh", "index"), [(v, i) for v in BY_SPEED for i in range(len(TIMES_S))])
def test_torque_and_temperature_by_speed(speed_kmh, index):
    torque, belt_degc = at(series(speed_kmh, 50.0), TIMES_S[index])
    expected_nm, expected_degc = BY_SPEED[speed_kmh][index]
    assert torque == pytest.approx(expected_nm, rel=TORQUE)
    assert belt_degc == pytest.approx(expected_degc, abs=TEMPERATURE_K)


@pytest.mark.parametrize("weight_kn", BY_WEIGHT)
def test_torque_and_temperature_by_weight(weight_kn):
    torque, belt_degc = at(series(50, 50.0, weight_kn), 2500.0)
    assert torque == pytest.approx(BY_WEIGHT[weight_kn][0], rel=TORQUE)
    assert belt_degc == pytest.approx(BY_WEIGHT[weight_kn][1], abs=TEMPERATURE_K)


@pytest.mark.parametrize("ambient_degc", BY_AMBIENT)
def test_torque_by_ambient(ambient_degc):
    torques = [at(series(50, 0.0, 300, ambient_degc), time)[0] for time in (0.0, 250.0, 2500.0)]
    assert torques == pytest.approx(BY_AMBIENT[ambient_degc], rel=TORQUE)


@pytest.mark.parametrize("speed_kmh", BY_COUNT)
def test_torque_by_rainflow(speed_kmh):
    torques = [at(series(speed_kmh, 50.0, method="rainflow"), time)[0] for time in (60.0, 2500.0)]
    assert torques == pytest.approx(BY_COUNT[speed_kmh], rel=TORQUE)
