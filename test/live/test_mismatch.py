"""Have measured and expected torque parted: found where it is so, not where it is not, whatever the noise."""

import math

import numpy as np
import pytest

from trackres_ros.estimator.estimator import Estimator
from trackres_ros.live.mismatch import MismatchDetector, MismatchSettings
from trackres_ros.vehicle import load

START_NS = 10**18
DRIVE_NM, STD_NM, NOISE_NM = 3000.0, 300.0, 300.0  # tolerated are 300 Nm


def noise(hours, phi=0.0, size=NOISE_NM, seed=0, dt=1.0):
    """Stationary residual [Nm] whose neighbours a second apart correlate by phi."""
    random = np.random.default_rng(seed)
    count, step = int(hours * 3600 / dt), phi**dt
    shocks = random.normal(0.0, size * math.sqrt(1.0 - step * step), count)
    series, now = np.empty(count), random.normal(0.0, size)
    for i, shock in enumerate(shocks):
        series[i] = now
        now = step * now + shock
    return series


def watch(residual, dt=1.0, settings=None, speed=8.0, accel=0.0, detector=None, start_s=0.0):
    """Feed a series; the detector and the times [s] at which it changed its mind."""
    detector = detector or MismatchDetector(settings or MismatchSettings())
    turned, parted = [], detector.verdict.parted
    for i, value in enumerate(residual.tolist()):
        time_s = start_s + i * dt
        detector.take(START_NS + round(time_s * 1e9), value, DRIVE_NM, STD_NM, speed, accel)
        if detector.verdict.parted is not parted:
            parted = not parted
            turned.append(time_s)
    return detector, turned


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9, 0.97])
@pytest.mark.parametrize("size", [30.0, 300.0, 1500.0])
def test_noise_alone_is_no_mismatch(phi, size):
    for seed in range(3):
        detector, turned = watch(noise(8.0, phi, size, seed))
        assert not turned
        assert detector.verdict.settled
        assert detector.verdict.text == "no lasting difference"


def test_hills_that_nobody_measured_seldom_raise_it():
    alarms = [watch(noise(8.0, 0.99, 1500.0, seed))[1] for seed in range(8)]  # half the torque, over minutes
    assert sum(map(bool, alarms)) <= 1


def test_with_nothing_tolerated_noise_alone_is_still_none():
    settings = MismatchSettings(mismatch_share=0.0, mismatch_std=0.0)
    assert not any(watch(noise(8.0, 0.5, seed=seed), settings=settings)[1] for seed in range(6))


@pytest.mark.parametrize("bias", [100.0, 200.0, 270.0, -270.0])
def test_an_offset_within_the_tolerance_is_none(bias):
    assert not any(watch(noise(4.0, 0.5, seed=seed) + bias)[1] for seed in range(3))


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9])
@pytest.mark.parametrize("bias", [600.0, -600.0, 1500.0])
def test_a_lasting_offset_is_found_with_its_time_size_and_sign(phi, bias):
    residual = noise(3.0, phi, seed=5)
    residual[1800:] += bias
    detector, turned = watch(residual)
    verdict = detector.verdict
    assert verdict.parted
    assert turned[0] >= 1800 + 300 - 4
    assert (verdict.since_ns - START_NS) * 1e-9 == pytest.approx(1800.0, abs=90.0)
    assert verdict.after_s == pytest.approx(1800.0, abs=90.0)
    assert verdict.mean_nm == pytest.approx(bias, rel=0.15)
    assert verdict.share == pytest.approx(bias / DRIVE_NM, rel=0.15)
    assert ("above" if bias > 0 else "below") in verdict.text


def test_a_larger_offset_is_found_sooner():
    found = []
    for bias in (450.0, 550.0, 700.0, 1200.0):
        residual = noise(6.0, 0.9, seed=2)
        residual[1800:] += bias
        found.append(watch(residual)[1][0])
    assert found == sorted(found, reverse=True)
    assert found[-1] < found[0]


def test_an_offset_from_the_start_is_said_to_be_from_the_start():
    verdict = watch(noise(1.0) + 800.0)[0].verdict
    assert verdict.after_s == 0.0
    assert "from the start on" in verdict.text


def test_what_comes_round_each_lap_is_none():
    time_s = np.arange(4 * 3600.0)
    lap = 700.0 * np.sin(2 * np.pi * time_s / 226.0)  # 1 % up and down the paper's circle at 10 km/h
    assert not any(watch(noise(4.0, 0.5, 100.0, seed) + lap)[1] for seed in range(3))


def test_when_the_offset_goes_the_mismatch_ends_and_does_not_take_as_long_as_it_lasted():
    residual = noise(8.0, 0.5, seed=7)
    residual[1800 : 1800 + 4 * 3600] += 900.0
    _, turned = watch(residual)
    assert len(turned) == 2
    assert turned[1] - (1800 + 4 * 3600) < 1800.0


def test_signs_are_alike():
    residual = noise(2.0, 0.5, seed=9)
    residual[1800:] += 700.0
    up, down = watch(residual), watch(-residual)
    assert up[1] == down[1]
    assert up[0].verdict.mean_nm == -down[0].verdict.mean_nm


def test_the_rate_of_messages_does_not_matter():
    residual = noise(1.5, 0.5, seed=4)
    residual[900:] += 700.0
    slow = watch(residual)[1]
    fast = watch(np.repeat(residual, 20), dt=0.05)[1]
    assert fast[0] == pytest.approx(slow[0], abs=5.0)


@pytest.mark.parametrize(("speed", "accel"), [(0.0, 0.0), (0.5, 0.0), (8.0, 2.0), (8.0, -2.0)])
def test_standing_and_hard_acceleration_are_not_compared(speed, accel):
    detector, turned = watch(noise(1.0) + 5000.0, speed=speed, accel=accel)
    assert not turned
    assert not detector.verdict.settled
    assert "too little" in detector.verdict.text


def test_spikes_do_not_raise_it():
    residual = noise(6.0, 0.5, seed=3)
    residual[np.random.default_rng(1).random(len(residual)) < 0.01] += 50000.0
    assert not watch(residual)[1]


@pytest.mark.parametrize("value", [0.0, 1e9, -1e12, 1e-12])
def test_any_constant_residual_stays_finite(value):
    detector, _ = watch(np.full(2000, value))
    verdict = detector.verdict
    assert verdict.parted == (abs(value) > 300.0)
    assert all(math.isfinite(x) for x in (verdict.mean_nm, verdict.share) if verdict.parted)


def test_what_is_not_finite_or_goes_back_in_time_is_left_out():
    detector, _ = watch(noise(0.5))
    before = detector.verdict
    for value in (math.nan, math.inf, -math.inf):
        detector.take(START_NS + 10**13, value, DRIVE_NM, STD_NM, 8.0, 0.0)
        detector.take(START_NS + 10**13, 0.0, value, STD_NM, 8.0, 0.0)
    assert detector.verdict == before
    watch(noise(0.5), detector=detector, start_s=-10000.0)
    assert not detector.verdict.parted


def test_restart_forgets():
    detector, _ = watch(noise(1.0) + 900.0)
    assert detector.verdict.parted
    detector.restart()
    assert not detector.verdict.parted
    assert not detector.verdict.settled


@pytest.mark.parametrize(("factor", "parted"), [(1.0, False), (1.5, True), (0.5, True)])
def test_a_vehicle_that_loses_more_than_its_file_says_is_found(factor, parted):
    estimator = Estimator(load("xgd24d"))
    random = np.random.default_rng(8)
    time_s = np.arange(0.0, 3600.0, 0.5)
    speed = 8.0 + 2.0 * np.sin(2 * np.pi * time_s / 400.0)
    state = estimator.cold_start(estimator.inputs(8.0, ambient=15.0))
    rows = estimator.run(state, time_s, speed, estimator.vehicle.weight, 15.0)[1]
    at = estimator.column_index
    drive, loss = rows[:, at["drive_torque_nm"]], rows[:, at["hysteresis_nm"]]
    measured = drive + (factor - 1.0) * loss + random.normal(0.0, 150.0, len(time_s))
    detector = MismatchDetector(MismatchSettings())
    for i, t in enumerate(time_s):
        row = rows[i]
        detector.take(
            START_NS + round(t * 1e9),
            measured[i] - drive[i],
            drive[i],
            row[at["resistance_std_nm"]],
            row[at["speed_mps"]],
            row[at["accel_mps2"]],
        )
    assert detector.verdict.parted is parted
    if parted:
        assert (detector.verdict.mean_nm > 0) == (factor > 1.0)
