# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where the torque shakes more than elsewhere: a judder while pulling away, and noise that only grows with the torque."""

from types import SimpleNamespace

import numpy as np
import pytest

from trackres_ros.diagnosis.findings.spread import find_spread
from trackres_ros.diagnosis.prepare.session import Cumulative, DriveSession

RATE_HZ, STEP_S, LEG_S, LEGS = 10.0, 1.0, 60.0, 20
MASS_KG, RADIUS_M, FASTEST_MPS = 24_000.0, 0.4, 8.0
JUDDER_HZ = 1.3


def driven(judder_nm=0.0, rate_hz=RATE_HZ, noise_share=0.01, seed=0, brakes_s=10.0, noise_nm=15.0):
    """A fit of trapezoids from stop to stop with noise that grows with the torque, and a judder while pulling away."""
    rng, at = np.random.default_rng(seed), np.arange(0.0, LEGS * LEG_S, 1.0 / rate_hz)
    in_leg = at % LEG_S
    speed = np.interp(in_leg, [5.0, 20.0, 55.0 - brakes_s, 55.0], [0.0, FASTEST_MPS, FASTEST_MPS, 0.0])
    accel = np.gradient(speed, at)
    expected = np.tanh(speed / 0.1) * 2500.0 + MASS_KG * accel * RADIUS_M
    measured = expected + (noise_nm + noise_share * np.abs(expected)) * rng.normal(size=len(at))
    pulls = (speed > 0.0) & (speed < 2.5) & (accel > 0.0)
    measured += judder_nm * pulls * np.sin(2.0 * np.pi * JUDDER_HZ * at)
    count = int(LEGS * LEG_S) - 1
    time = STEP_S * np.arange(count)
    of_step, edges = {}, np.arange(0.0, count + 1.0)
    for name, series in (("speed", speed), ("torque", measured), ("expected", expected)):
        of_step[name] = Cumulative.of(at, series).means(time, STEP_S)
    zero = np.zeros(count)
    session = DriveSession(
        "drive", STEP_S, time, of_step["speed"], np.diff(np.interp(edges, at, speed)), np.full(count, 240e3), zero, zero, zero,
        zero, zero, of_step["torque"], zero, of_step["speed"] > 0.3, (time // LEG_S).astype(np.int64),
        torque_course=Cumulative.of(at, measured),
    )  # fmt: skip
    predicted = SimpleNamespace(torque=of_step["expected"], at_sprockets=of_step["expected"])
    return SimpleNamespace(problem=SimpleNamespace(sessions=(session,)), predicted=(predicted,))


@pytest.mark.parametrize("judder_nm", [300.0, 500.0])
def test_a_judder_while_pulling_away_is_found_with_its_size(judder_nm):
    found = find_spread(driven(judder_nm))
    assert found.regime == "while it pulls away"
    assert found.size_nm == pytest.approx(judder_nm / np.sqrt(2.0), rel=0.3)
    assert found.p < 1e-3
    assert found.described.sentence.startswith("The torque oscillates by ")


@pytest.mark.parametrize("noise_share", [0.0, 0.01, 0.05])
def test_noise_that_grows_with_the_torque_is_no_judder(noise_share):
    assert all(find_spread(driven(noise_share=noise_share, seed=seed)) is None for seed in range(10))


@pytest.mark.parametrize("noise_nm", [0.0, 15.0, 60.0])
@pytest.mark.parametrize("brakes_s", [2.0, 3.0, 4.0, 7.3])
def test_sharp_braking_to_a_stop_is_no_judder(brakes_s, noise_nm):
    assert all(find_spread(driven(noise_share=0.0, noise_nm=noise_nm, brakes_s=brakes_s, seed=seed)) is None for seed in range(5))


def test_a_torque_that_was_recorded_too_slowly_shows_no_judder():
    assert find_spread(driven(500.0, rate_hz=2.0)) is None


class Drive(SimpleNamespace):
    """What is used of a `DriveSession`."""

    def __len__(self):
        return len(self.time)


@pytest.mark.parametrize("left_out", [False, True])
def test_corners_beside_steps_left_out_are_no_judder(left_out):
    """Each minute the torque falls to that of braking, along a curve that the steps of the fit do not follow."""
    rng, of_minute, lap = np.random.default_rng(2), np.arange(600.0) % 60.0, np.arange(600) // 60
    fine = np.arange(0.0, 600.0, 0.1)
    torque = 2000.0 - 6000.0 * np.interp(fine % 60.0, [0.0, 40.0, 42.0, 50.0, 52.0], [0.0, 0.0, 1.0, 1.0, 0.0])
    course = Cumulative.of(fine, torque + 600.0 * np.sin(3.0 * fine) * (torque < 2000.0) + rng.normal(0.0, 30.0, len(fine)))
    time = np.arange(600.0)
    expected = Cumulative.of(fine, torque).means(time, 1.0)
    session = Drive(
        pace=1.0, step=1.0, time=time, block=lap, torque_course=course, torque=course.means(time, 1.0),
        used=(of_minute < 41.0) | (of_minute >= 52.0) if left_out else np.full(600, True),
        speed=np.full(600, 8.0), accel=np.zeros(600), weight=np.full(600, 2e5),
    )  # fmt: skip
    predicted = SimpleNamespace(torque=expected, at_sprockets=np.where(of_minute == 40.0, -1.0, expected))
    found = find_spread(SimpleNamespace(problem=SimpleNamespace(sessions=[session]), predicted=[predicted]))
    if left_out:
        assert found is None
    else:
        assert found.regime == "while the motor brakes"
