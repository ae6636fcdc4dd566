# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Estimates the acceleration from a speed, which may be quantised: many buses send it in steps of up to 1 km/h.

A Kalman filter estimates speed and acceleration, with an acceleration that decays to zero (Singer's model). A quantised
speed only bounds the true one to half a step. While the prediction is within these bounds, it is not corrected, so a
staircase of repeated values does not become a staircase of accelerations.

R. A. Singer, Estimating optimal tracking filter performance for manned maneuvering targets, IEEE Trans. Aerosp. Electron.
Syst. AES-6 (1970) 473-483.
"""

from __future__ import annotations

import math

from trackres_ros.estimator.columns import Motion
from trackres_ros.kernels.marks import kernel

LARGEST_QUANTUM = 1.0  # m/s: a greater smallest step is not a quantum
SAME_VALUE = 1e-6  # m/s: rounding of a scaled bus value
# Standard deviations of the speed's noise, added to half a quantum: at rest one sample in 5e8 is more than six off, at 50 Hz
# one in four months. Half of it applies once the vehicle rolls, so that a crawl does not switch on and off.
ROLLS_FROM, ROLLS_UNTIL = 6.0, 3.0


@kernel
def start_motion(motion: Motion, speed: float, speed_variance: float, acceleration_variance: float) -> None:
    """Begin the filter at a first speed [m/s]."""
    motion.filtered_speed, motion.filtered_accel = speed, 0.0
    motion.cov_speed, motion.cov_both, motion.cov_accel = speed_variance, 0.0, acceleration_variance
    motion.started = 1.0


@kernel
def known_quantum(motion: Motion) -> float:
    """Step of a quantised speed [m/s]; 0 for a continuous one."""
    return motion.quantum if motion.quantum < LARGEST_QUANTUM else 0.0


@kernel
def is_noise(speed: float, quantum: float, speed_variance: float, has_rolled: bool) -> bool:
    """Whether a speed [m/s] may be the sensor's noise at rest, or is none; `quantum`: smallest step observed [m/s]."""
    noise = ROLLS_UNTIL if has_rolled else ROLLS_FROM
    return not abs(speed) > noise * math.sqrt(speed_variance) + 0.5 * (quantum if quantum < LARGEST_QUANTUM else 0.0)


@kernel
def rolling_state(motion: Motion, speed: float, speed_variance: float) -> float:
    """1 while the speed [m/s] exceeds its sensor's noise at rest, else 0: |v| > n std + quantum/2 (ours)."""
    return 0.0 if is_noise(speed, motion.quantum, speed_variance, motion.rolls > 0.0) else 1.0


@kernel
def advance_motion(
    motion: Motion, speed: float, last_speed: float, dt: float, speed_variance: float, acceleration_variance: float, time: float
) -> None:
    """Process a speed [m/s] after dt [s] > 0, with a correlation `time` of the acceleration [s]; change `motion`.

    Notes
    -----
    Singer [7]: with k = exp(-dt/time) and r = time (1 - k), speed and acceleration are predicted by v + r a and k a, and their
    covariance P by F P F' + Q. The gain is the Kalman filter's. Ours: quantum^2/12 adds to the noise, and the innovation is its
    excess over half a quantum.
    """
    step = abs(speed - last_speed)
    if SAME_VALUE < step < motion.quantum:
        motion.quantum = step
    k = math.exp(-dt / time)
    r = time * (1.0 - k)
    v, a = motion.filtered_speed + r * motion.filtered_accel, k * motion.filtered_accel
    q = acceleration_variance * (1.0 - k * k)
    p11 = motion.cov_speed + 2.0 * r * motion.cov_both + r * r * motion.cov_accel + q * dt * dt / 3.0
    p12 = k * (motion.cov_both + r * motion.cov_accel) + q * dt / 2.0
    p22 = k * k * motion.cov_accel + q
    half = 0.5 * known_quantum(motion)
    innovation = math.copysign(max(abs(speed - v) - half, 0.0), speed - v)
    variance = p11 + speed_variance + half * half / 3.0
    gain_v, gain_a = p11 / variance, p12 / variance
    motion.filtered_speed, motion.filtered_accel = v + gain_v * innovation, a + gain_a * innovation
    motion.cov_speed, motion.cov_both, motion.cov_accel = p11 - gain_v * p11, p12 - gain_v * p12, p22 - gain_a * p12
