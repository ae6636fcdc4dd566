# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Mismatch of measured and expected torque: found if present, else not, for any noise."""

import dataclasses
import math
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from trackres_ros.files.dataclass_reader import limits_of
from trackres_ros.node.measured_torque import KNOWN_AFTER, MismatchDetector, MismatchSettings

START_NS = 10**18
DRIVE_NM, STD_NM, NOISE_NM = 3000.0, 300.0, 300.0  # tolerated are 300 Nm
NOTHING_TOLERATED = MismatchSettings(mismatch_share=0.0, mismatch_std=0.0)


def noise(hours, phi=0.0, size=NOISE_NM, seed=0, dt=1.0):
    """Stationary residual [Nm] whose neighbours a second apart correlate by phi."""
    random = np.random.default_rng(seed)
    count, step = int(hours * 3600 / dt), phi**dt
    shocks = random.normal(0.0, size * math.sqrt(1.0 - step * step), count)
    return lfilter([1.0], [1.0, -step], np.append(random.normal(0.0, size), shocks[:-1]))


def watch(residual, dt=1.0, settings=None, speed=8.0, accel=0.0, detector=None, start_s=0.0):
    """Feed a series; the detector and the times [s] at which it changed its mind."""
    detector = detector or MismatchDetector(settings or MismatchSettings())
    turned, parted = [], detector.verdict.parted
    for i, (value, speed_mps) in enumerate(zip(residual.tolist(), np.broadcast_to(speed, residual.shape).tolist(), strict=True)):
        time_s = start_s + i * dt
        detector.take(START_NS + round(time_s * 1e9), value, DRIVE_NM, STD_NM, speed_mps, accel)
        if detector.verdict.parted is not parted:
            parted = not parted
            turned.append(time_s)
    return detector, turned


@pytest.mark.parametrize(
    ("phi", "size", "dt", "settings"),
    [
        *((phi, size, 1, MismatchSettings()) for phi, size in ((0.0, 30.0), (0.97, 300.0), (0.97, 1500.0))),
        *((phi, 300.0, dt, NOTHING_TOLERATED) for phi, dt in ((0.5, 1), (0.99, 10))),
    ],
)
def test_noise_alone_is_no_mismatch(phi, size, dt, settings):
    for seed in range(3):
        detector, turned = watch(noise(5.0, phi, size, seed)[::dt], dt=dt, settings=settings)
        assert not turned
        assert detector.verdict.settled
        assert detector.verdict.text == "no lasting difference"


@pytest.mark.parametrize(("speed", "torque", "factor"), [(3.0, 5.0, 27.0), (3.0, -5.0, 30.0 / 0.9), (-3.0, -5.0, 27.0)])
def test_a_live_torque_at_the_motor_is_one_at_the_sprockets(desk, topics, speed, torque, factor):
    d = desk(Path(topics).read_text().replace("torque.y}", "torque.y, at: motor}"), vehicle="agri3t")
    d.drive(2.0, speed=speed, torque=torque)
    _, (measured, expected, residual) = d.last("torque_residual")
    assert measured == pytest.approx(factor * torque)  # of its gears: a ratio of 30, an efficiency of 0.9
    assert residual == pytest.approx(measured - expected)


def test_hills_that_nobody_measured_seldom_raise_it():
    alarms = [watch(noise(6.0, 0.99, 1500.0, seed))[1] for seed in range(5)]  # half the torque, over minutes
    assert sum(map(bool, alarms)) <= 1


@pytest.mark.parametrize("phi", [0.0, 0.8])
def test_false_alarms_are_rarer_than_the_bound_of_the_evidence(phi):
    evidence, hold_s, hours = 2.5, 60.0, 15.0  # so little that there are some to count
    settings = dataclasses.replace(NOTHING_TOLERATED, mismatch_evidence=evidence, mismatch_hold_s=hold_s)
    bins, bin_s = hold_s / settings.mismatch_bin_s, settings.mismatch_bin_s
    a_bin = evidence**3 * math.exp(-(evidence**2) / 2.0) / (2.0 * bins * math.sqrt(2.0 * math.pi))
    alarms = len(watch(noise(hours, phi, seed=1), settings=settings)[1][::2])
    assert 0 < alarms < a_bin * hours * 3600.0 / bin_s


def test_it_says_so_while_it_cannot_know():
    settings = MismatchSettings()
    known_s = KNOWN_AFTER * settings.mismatch_hold_s
    early, turned = watch(noise(known_s / 3600.0 - 0.01) + 5000.0)
    assert not turned
    assert not early.verdict.settled
    assert "not enough driving" in early.verdict.text
    known = watch(noise(known_s / 3600.0 + 0.01) + 5000.0)[0]
    assert known.verdict.parted
    assert known.verdict.after_s == 0.0
    assert "from the start on" in known.verdict.text
    known.restart()
    assert not known.verdict.parted
    assert not known.verdict.settled


@pytest.mark.parametrize("bias", [270.0, -270.0])
def test_an_offset_within_the_tolerance_is_none(bias):
    assert not any(watch(noise(4.0, 0.5, seed=seed) + bias)[1] for seed in range(2))


@pytest.mark.parametrize(("phi", "bias"), [(0.0, 600.0), (0.5, -600.0), (0.9, 600.0), (0.9, -1500.0)])
def test_a_lasting_offset_is_found_with_its_time_size_and_sign(phi, bias):
    residual = noise(3.0, phi, seed=5)
    residual[1800:] += bias
    detector, turned = watch(residual)
    verdict = detector.verdict
    assert verdict.parted
    assert turned[0] >= 1800 + 300 - 4
    assert verdict.after_s == pytest.approx(1800.0, abs=90.0)
    assert verdict.mean_nm == pytest.approx(bias, rel=0.15)
    assert verdict.share == pytest.approx(bias / DRIVE_NM, rel=0.15)
    assert ("above" if bias > 0 else "below") in verdict.text


def test_a_larger_offset_is_found_sooner():
    results = []
    for bias in (500.0, 700.0, 1500.0, 5000.0, 1e6):
        residual = noise(2.0, 0.9, seed=2)
        residual[1800:] += bias
        results.append(watch(residual)[1][0])
    assert results == sorted(results, reverse=True)
    assert results[-1] < results[0]


def test_what_comes_round_each_lap_is_none():
    time_s = np.arange(3 * 3600.0)
    lap = 700.0 * np.sin(2 * np.pi * time_s / 226.0)  # 1 % up and down the paper's circle at 10 km/h
    assert not any(watch(noise(3.0, 0.5, 100.0, seed) + lap)[1] for seed in range(2))


def test_a_mismatch_ends_within_30_minutes_of_the_offset_ending():
    residual = noise(4.0, 0.5, seed=7)
    residual[1800 : 1800 + 2 * 3600] += 900.0
    _, turned = watch(residual)
    assert len(turned) == 2
    assert turned[1] - (1800 + 2 * 3600) < 1800.0


def test_signs_and_directions_of_travel_are_alike():
    residual = noise(2.0, 0.5, seed=9)
    residual[1800:] += 700.0
    for forecast in (-1.0, np.where(np.arange(len(residual)) // 60 % 2, -1.0, 1.0)):
        assert watch(residual * forecast, speed=8.0 * forecast)[0].verdict == watch(residual)[0].verdict
    up, down = watch(residual), watch(-residual)
    assert up[1] == down[1]
    assert up[0].verdict.mean_nm == -down[0].verdict.mean_nm


def test_the_rate_of_messages_does_not_matter():
    residual = noise(0.8, 0.5, seed=4)
    residual[900:] += 700.0
    slow = watch(residual)[1]
    fast = watch(np.repeat(residual, 20), dt=0.05)[1]
    assert fast[0] == pytest.approx(slow[0], abs=5.0)


@pytest.mark.parametrize(("speed", "accel"), [(0.0, 0.0), (0.5, 0.0), (8.0, 2.0), (8.0, -2.0)])
def test_standing_and_hard_acceleration_are_not_compared(speed, accel):
    detector, turned = watch(noise(1.0) + 5000.0, speed=speed, accel=accel)
    assert not turned
    assert not detector.verdict.settled
    assert "not enough driving" in detector.verdict.text


@pytest.mark.parametrize("spike", [5e4, 1e150])
def test_spikes_neither_hide_an_offset_nor_change_its_size(spike):
    residual = noise(2.0, 0.5, seed=3)
    residual[3600:] += 700.0
    plain, result = watch(residual)
    residual[np.random.default_rng(1).random(len(residual)) < 0.005] += spike
    residual[0] = spike
    spiked, found_spiked = watch(residual)
    assert found_spiked[0] == pytest.approx(result[0], abs=120.0)
    assert spiked.verdict.mean_nm == pytest.approx(plain.verdict.mean_nm, rel=0.03)


@pytest.mark.parametrize("dt", [0.05, 1.5, 7.0])
def test_minutes_are_those_that_passed_at_any_rate(dt):
    residual = noise(1.5, size=100.0, dt=dt)
    residual[int(2700 / dt) :] += 2000.0
    verdict = watch(residual, dt=dt)[0].verdict
    assert verdict.after_s == pytest.approx(2700.0, abs=20.0)
    lasted_min = float(re.search(r"for ([\d.]+) min", verdict.text)[1])
    assert lasted_min == pytest.approx(45.0, abs=0.4)


def test_a_late_message_adds_no_time():
    residual, plain, late = noise(1.0) + 900.0, MismatchDetector(MismatchSettings()), MismatchDetector(MismatchSettings())
    for i, value in enumerate(residual.tolist()):
        for detector, delays in ((plain, (0,)), (late, (0, 5))):
            for delay in delays:
                detector.take(START_NS + (i - delay) * 10**9, value, DRIVE_NM, STD_NM, 8.0, 0.0)
    assert late.verdict == plain.verdict


def test_a_memory_shorter_than_a_bin_is_none_to_fall_over():
    settings = MismatchSettings(mismatch_bin_s=60.0, mismatch_memory_s=30.0)
    residual = noise(20.0, dt=60.0)
    residual[600:] += 900.0
    assert watch(residual, dt=60.0, settings=settings)[0].verdict.mean_nm == pytest.approx(900.0, rel=0.1)


LIMITS = [[limits.low, getattr(MismatchSettings, name), limits.high] for name, limits in limits_of(MismatchSettings).items()]
SIZES = [0.0, 300.0, 1e9, 1e300, math.inf]


@pytest.mark.parametrize("seed", range(6))
def test_any_allowed_settings_and_any_numbers_do_no_harm(seed):
    random = np.random.default_rng(seed)
    detector = MismatchDetector(MismatchSettings(*(float(random.choice(limits)) for limits in LIMITS)))
    stamp = 0
    for _ in range(4000):
        stamp += int(random.choice([0, 10**6, 10**9, 10**11, -(10**11)], p=[0.1, 0.2, 0.6, 0.06, 0.04]))
        residual, drive, std = random.normal(0.0, 1.0, 3) * random.choice(SIZES, 3, p=[0.1, 0.7, 0.1, 0.05, 0.05])
        speed, accel = random.choice([0.0, 5.0, 40.0, math.nan]), random.normal(0.0, 0.2)
        detector.take(stamp, residual, drive, abs(std), speed, accel)
    verdict = detector.verdict
    assert verdict.parted == math.isfinite(verdict.mean_nm) == math.isfinite(verdict.share) == math.isfinite(verdict.after_s)


@pytest.mark.parametrize("value", [0.0, 1e9, -1e12, 1e-12])
def test_any_constant_residual_stays_finite(value):
    detector, _ = watch(np.full(2000, value))
    verdict = detector.verdict
    assert verdict.parted == (abs(value) > 300.0)
    assert all(math.isfinite(x) for x in (verdict.mean_nm, verdict.share) if verdict.parted)


def test_what_is_not_finite_or_goes_back_in_time_is_left_out():
    detector, _ = watch(noise(0.5))
    result_before = detector.verdict
    for value in (math.nan, math.inf, -math.inf):
        detector.take(START_NS + 10**13, value, DRIVE_NM, STD_NM, 8.0, 0.0)
        detector.take(START_NS + 10**13, 0.0, value, STD_NM, 8.0, 0.0)
    assert detector.verdict == result_before
    watch(noise(0.5), detector=detector, start_s=-10000.0)
    assert not detector.verdict.parted


@pytest.fixture(scope="module")
def hour(reference):
    """Times [s] of a drive, and what the estimate gives along it."""
    time_s = np.arange(0.0, 3600.0, 1.0)
    speed = 8.0 + 2.0 * np.sin(2 * np.pi * time_s / 400.0)
    state = reference.cold_start(reference.inputs(8.0, ambient=15.0))
    rows, place = reference.run(state, time_s, speed, reference.vehicle.weight, 15.0)[1], reference.column_index
    names = "hysteresis_nm", "bearing_nm", "drive_torque_nm", "resistance_std_nm", "speed_mps", "accel_mps2"
    return time_s, [rows[:, place[name]] for name in names]


WELL_KNOWN = MismatchSettings(mismatch_share=0.02, mismatch_std=0.0)


@pytest.mark.parametrize(
    ("loss", "bearing", "settings", "parted"),
    [
        (1.0, 1.0, MismatchSettings(), False),
        (1.0, 1.0, WELL_KNOWN, False),
        (1.25, 1.0, MismatchSettings(), False),  # the vehicle file itself leaves as much open
        (1.5, 1.0, MismatchSettings(), True),
        (0.5, 1.0, MismatchSettings(), True),
        (1.25, 1.0, WELL_KNOWN, True),
        (1.0, 1.15, WELL_KNOWN, True),
        (1.0, 0.85, WELL_KNOWN, True),
    ],
)
def test_a_resistance_different_from_the_vehicle_file_is_found(hour, loss, bearing, settings, parted):
    time_s, (hysteresis, bearings, *rows) = hour
    more = (loss - 1.0) * hysteresis + (bearing - 1.0) * bearings
    residual = more + np.random.default_rng(8).normal(0.0, 150.0, len(time_s))
    detector = MismatchDetector(settings)
    for stamp_s, *row in zip(time_s, residual, *rows, strict=True):
        detector.take(START_NS + round(stamp_s * 1e9), *row)
    assert detector.verdict.parted is parted
    if parted:
        assert detector.verdict.mean_nm == pytest.approx(more.mean(), rel=0.1)
