# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Follows the slope of the ground from an altitude or an IMU, in parallel to the vehicle's parameters.

The slope is a state that decays with distance, and the height is its integral over the distance. An altimeter shows that
height with a slowly varying error. Without either both stay zero, and hills are part of the short disturbances.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trackres_ros.arrays import Array, Mask
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.estimator import Session
from trackres_ros.learning.parameters import HEIGHT, SLOPE, STATES, TILT, correct_estimate, spread
from trackres_ros.units import GRAVITY, SECOND_NS

SLOPE_STD, REACH_M = 0.02, 200.0  # assumed: prior of roads, and their correlation length
LEAST_SLOPE_STD, SLOPE_MEMORY_M = 0.003, 10e3
ALTITUDE_STD_M = 3.0  # of single samples, at first
LEAST_ALTITUDE_STD_M = 0.3
DRIFT = 0.05  # m^2/s: variance that the error of an altitude gains; 7 m in a quarter of an hour
DRIFT_MEMORY_S = 120.0  # for which an altitude that ran away while standing is trusted less
MEMORY = 60.0  # samples
STANDS_M = 0.05  # in a second
TILT_STD = 0.03  # of an IMU against the vehicle's axis, and its bias
FELT_STD, LEAST_FELT_STD = 0.02, 0.003  # of a slope by an IMU over a second: springs, bumps
FELT_TO_MPS2 = 0.5  # a larger acceleration is too inaccurate, and pitches the vehicle
LONGEST_STEP_NS = 10 * SECOND_NS
OUTLIER = 4.0


@dataclass
class Ground:
    """Memory of altitude and IMU; the slope itself is in the filter."""

    way_m: float = 0.0  # distance since the last second
    rise_m: float = 0.0  # rise of the ground over it, as known to the step
    known_slope: float = 0.0  # that rise over the distance, of the last second
    step_ns: int = 0
    altitude_ns: int = 0  # time of the last altitude
    stood_ns: int = 0  # start of a standstill, or the last altitude in motion
    stood_m: float = 0.0  # that altitude
    zero_m: float = 0.0  # the altitude at which the filter's height is 0
    has_altitude: bool = False  # whether an altitude is used
    has_force: bool = False  # whether an IMU is
    altitude_variance: float = ALTITUDE_STD_M**2
    drift: float = DRIFT
    felt_variance: float = FELT_STD**2
    slope_variance: float = SLOPE_STD**2  # of this ground

    def restart(self) -> None:
        """Begin another drive: its starting height is unknown; the tilt of an IMU is kept."""
        self.way_m = self.rise_m = 0.0
        self.step_ns = self.stood_ns = 0
        self.forget_height()

    def forget_height(self) -> None:
        """Restart at the next altitude, as the rise since the last one is unknown."""
        self.has_altitude = False

    def drive(self, stamp_ns: int, speed: float, slope: float) -> None:
        """Process a step at a speed [m/s], on ground with a slope known to the step."""
        passed_ns = stamp_ns - self.step_ns
        self.step_ns = stamp_ns
        if 0 < passed_ns <= LONGEST_STEP_NS:
            way = speed * passed_ns / SECOND_NS
            self.way_m += way
            self.rise_m += slope * way
        elif passed_ns > 0:
            self.forget_height()

    def close(self, mean: Array, covariance: Array, session: Session, freedom: Mask) -> None:
        """Finish a second: predict the rise from the slope, and update by a new altitude; changes both."""
        way, rise, (self.way_m, self.rise_m) = self.way_m, self.rise_m, (0.0, 0.0)
        self.known_slope = rise / way if way else 0.0
        stamp = int(session.memory.times[layout.ALTITUDE, layout.Times.last_stamp])
        is_new = bool(session.memory.times[layout.ALTITUDE, layout.Times.seen]) and stamp != self.altitude_ns
        if self.has_altitude or self.has_force:
            # Expected total, given the present estimate (the step of an EM algorithm).
            slope_square = float(mean[SLOPE] ** 2 + covariance[SLOPE, SLOPE])
            self.slope_variance += min(abs(way) / SLOPE_MEMORY_M, 1.0) * (
                max(slope_square, LEAST_SLOPE_STD**2) - self.slope_variance
            )
            self._drive_on(mean, covariance, way, rise)
            self.drift = DRIFT + (self.drift - DRIFT) * math.exp(-1.0 / DRIFT_MEMORY_S)
        elif covariance[SLOPE, SLOPE] > 0.0:  # no longer observable
            _begin(mean, covariance, SLOPE, 0.0)
        if not is_new:
            return
        altitude = float(session.memory.values[layout.ALTITUDE])
        if not self.has_altitude or stamp - self.altitude_ns > DRIFT_MEMORY_S * SECOND_NS:
            _begin(mean, covariance, HEIGHT, self.altitude_variance)
            if not self.has_altitude and not self.has_force:
                _begin(mean, covariance, SLOPE, self.slope_variance)
            self.zero_m, self.has_altitude = altitude, True
        else:
            if abs(way) < STANDS_M:  # changes of the altitude at standstill are not the ground's
                climb = abs(altitude - self.stood_m) - 2.0 * math.sqrt(self.altitude_variance)
                self.drift = max(self.drift, max(climb, 0.0) ** 2 * SECOND_NS / (stamp - self.stood_ns))
            self.altitude_variance = _take_measurement(
                mean, covariance, (HEIGHT,), altitude - self.zero_m, self.altitude_variance, LEAST_ALTITUDE_STD_M, freedom
            )
        self.altitude_ns = stamp
        if abs(way) >= STANDS_M or self.stood_ns == 0:
            self.stood_ns, self.stood_m = stamp, altitude

    def take_force(self, mean: Array, covariance: Array, specific_force: float, accel: float, freedom: Mask) -> None:
        """Mean IMU acceleration of the finished second [m/s^2]; changes both."""
        if not math.isfinite(specific_force) or abs(accel) > FELT_TO_MPS2:
            return
        if not self.has_force:
            _begin(mean, covariance, TILT, TILT_STD**2)
            if not self.has_altitude:
                _begin(mean, covariance, SLOPE, self.slope_variance)
            self.has_force = True
        slope = (specific_force - accel) / GRAVITY - self.known_slope
        self.felt_variance = _take_measurement(
            mean, covariance, (SLOPE, TILT), slope, self.felt_variance, LEAST_FELT_STD, freedom
        )

    def _drive_on(self, mean: Array, covariance: Array, way: float, rise: float) -> None:
        """Predict the rise of the ground along a distance [m] by its slope; then change the slope."""
        mean[HEIGHT] += way * mean[SLOPE] + rise
        covariance[HEIGHT, :] += way * covariance[SLOPE, :]
        covariance[:, HEIGHT] += way * covariance[:, SLOPE]
        covariance[HEIGHT, HEIGHT] += self.drift if self.has_altitude else 0.0
        share = math.exp(-abs(way) / REACH_M)
        mean[SLOPE] *= share
        covariance[SLOPE, :] *= share
        covariance[:, SLOPE] *= share
        covariance[SLOPE, SLOPE] += self.slope_variance * (1.0 - share * share)


def _begin(mean: Array, covariance: Array, state: int, variance: float) -> None:
    """Reset a state to zero mean with a variance."""
    mean[state] = 0.0
    covariance[state, :] = covariance[:, state] = 0.0
    covariance[state, state] = variance


def _take_measurement(
    mean: Array, covariance: Array, states: tuple[int, ...], value: float, variance: float, least_std: float, freedom: Mask
) -> float:
    """Update by a measurement of a sum of states; return the new noise variance of such measurements."""
    sensitivities = np.zeros(STATES)
    sensitivities[list(states)] = 1.0
    departure = value - float(mean[list(states)].sum())
    _, state_variance = spread(covariance, sensitivities)
    noise_square = min(max(departure * departure - state_variance, 0.0), OUTLIER * OUTLIER * variance)
    correct_estimate(
        mean,
        covariance,
        sensitivities,
        departure,
        max(variance, departure * departure / (OUTLIER * OUTLIER) - state_variance),
        freedom,
    )
    return max(variance + (noise_square - variance) / MEMORY, least_std**2)
