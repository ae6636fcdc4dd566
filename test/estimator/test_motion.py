# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Acceleration from speed: quiet on a quantised bus, quick enough on a clean one."""

import itertools

import numpy as np
import pytest

from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.motion import advance_motion, start_motion
from trackres_ros.estimator.settings import Settings

KMH = 1 / 3.6


def filtered(speed, dt):
    settings, motion, accelerations = Settings(), layout.Motion(np.zeros(layout.Motion.columns)), [0.0]
    motion.quantum = 1e9
    start_motion(motion, speed[0], settings.speed_std_mps**2, settings.acceleration_std**2)
    for old_speed, new_speed in itertools.pairwise(speed):
        advance_motion(
            motion,
            new_speed,
            old_speed,
            dt,
            settings.speed_std_mps**2,
            settings.acceleration_std**2,
            settings.acceleration_time_s,
        )
        accelerations.append(motion.filtered_accel)
    return np.array(accelerations)


@pytest.mark.parametrize("rate", [10, 50, 100])
def test_quantised_to_1_kmh(rate):
    dt = 1 / rate
    time = np.arange(0, 120, dt)
    acceleration = np.where((time > 10) & (time < 60), 0.28, 0.0) - np.where((time > 80) & (time < 90), 1.0, 0.0)
    speed = np.cumsum(acceleration) * dt + np.random.default_rng(0).normal(0, 0.02, len(time))
    bus = np.round(speed / KMH) * KMH
    estimate = filtered(bus, dt)
    gradient = np.gradient(bus, dt)
    rms = np.sqrt(np.mean((estimate - acceleration) ** 2))
    assert rms < 0.12
    assert rms < 0.25 * np.sqrt(np.mean((gradient - acceleration) ** 2))
    is_steady = (time > 67) & (time < 78)
    assert np.abs(estimate[is_steady]).max() < 0.05
    is_climb = (time > 20) & (time < 58)
    assert estimate[is_climb].mean() == pytest.approx(0.28, abs=0.03)


def test_clean_speed_is_followed_within_half_a_second():
    dt = 0.02
    time = np.arange(0, 20, dt)
    speed = np.where(time > 5, 0.5 * (time - 5), 0.0) + 5
    estimate = filtered(speed, dt)
    assert estimate[np.searchsorted(time, 5.5)] == pytest.approx(0.5, abs=0.12)
    assert estimate[-1] == pytest.approx(0.5, abs=0.02)
