# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Decides for each step whether its measured torque is usable for learning, sums up each second, and judges coverage."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from trackres_ros.arrays import Array, Mask
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.estimator import Session
from trackres_ros.estimator.guards import held_value
from trackres_ros.units import MAD_TO_STD, SECOND_NS, STANDSTILL_MPS

# Valid seconds

Row = list[float]

SLOWEST_MPS = 1.0  # slower, friction may be static
HARDEST_MPS2 = 2.0  # a larger acceleration is too inaccurate
BRAKING_MPS2 = -0.3  # with a torque that does not drive: friction brakes may act
TURNS_M = 0.02  # 1/m: a bend of less than 50 m makes a belt slide sideways
STUCK_S = 3.0  # one torque for longer while rolling
DRIVES_SHARE = 0.3  # of the prior rolling resistance: a greater torque drives
AGAINST_SHARE = 1.0  # of the same: neither noise nor a hill of one in a hundred makes a torque so large in the other sense
OUTLIER = 5.0  # typical deviations of a sample
FOLLOWS_S = 2.0  # in which the level of samples follows
SPREAD_S = 30.0  # in which their typical deviation does
LOST_S = 3.0  # consecutive outliers only
FIRST_SPREAD = 0.05  # of the rolling resistance
LEAST_SPREAD = 0.1  # of the same: the slope of a road changes by half a percent within moments
INERTIA_DOUBT = 0.3  # of the inertia: an acceleration that is filtered from a speed lags
FOLLOWED = 1.5  # typical deviations: by no more does one sample move the level
LEAST_SHARE = 0.5  # of a second's samples that are valid: else the second is discarded
LONGEST_HOLD_NS = 10 * SECOND_NS
APART_NS = 45_000_000  # between two samples of a second: more of them do not improve its mean

SPEED_UNSURE = int(
    layout.Reason.SPEED_STUCK
    | layout.Reason.SPEED_IMPLAUSIBLE
    | layout.Reason.SPEED_DISAGREES
    | layout.Reason.GAP_UNKNOWN
    | layout.Reason.CLOCK_JUMPED
    | layout.Reason.TIME_RESET
)
UNSURE = SPEED_UNSURE | int(layout.Reason.BELT_SENSOR_DISAGREES | layout.Reason.OUTSIDE_TABLE | layout.Reason.EFFECT_LEFT_OUT)
NO_TORQUE, SLOW, HARD, BRAKES, TURNS, STUCK, AGAINST, OUTLYING, DOUBTFUL = range(9)
TEXTS = (
    "no torque is measured",
    "the vehicle stands or crawls",
    "the vehicle accelerates hard",
    "the vehicle brakes",
    "the vehicle turns",
    "the measured torque is stuck",
    "the measured torque has an impossible sign",
    "the measured torque is an outlier",
    "the estimate itself is uncertain",
)
COUNTED, TAKEN = len(TEXTS), -1
OF_SENSOR = (NO_TORQUE, STUCK, AGAINST, OUTLYING)  # fault of a measured torque, whatever the drive
LATE_S = 60.0  # for which it is remembered


@dataclass
class Second:
    """Sums over the samples of a second that count, and how many there were by why they do not."""

    number: int = -1  # seconds since 1970 by the stamps; -1 before the first
    taken: int = 0
    refused: Array = field(default_factory=lambda: np.zeros(COUNTED))
    residual: float = 0.0  # measured less the file's expectation [Nm]
    drive: float = 0.0
    resisting: float = 0.0
    speed: float = 0.0
    accel: float = 0.0
    belt_degc: float = 0.0
    weight: float = 0.0
    inertia: float = 0.0
    felt: float = 0.0  # from an IMU [m/s^2]; nan if a sample lacks it
    by: Array = field(default_factory=lambda: np.zeros(layout.LEARNABLE))

    @property
    def counts(self) -> bool:
        """Whether enough samples count."""
        return self.taken >= LEAST_SHARE * (self.taken + float(self.refused.sum())) and self.taken > 0

    @property
    def main_reason(self) -> int:
        """The most frequent reason for a discarded sample."""
        return int(np.argmax(self.refused))


@dataclass
class SampleHistory:
    """Memory between samples: their level, their typical deviation from it, and since when one torque is constant."""

    level: float = 0.0
    deviation: float = 0.0
    known: bool = False
    seen_ns: int = 0
    last_ns: int = 0
    outlying_s: float = 0.0  # time since all samples have been far from the level
    torque: float = math.nan
    since_ns: int = 0
    air: float = 0.0  # degC
    of_air: float = 0.0  # see `Session.share_of_air`


class Gate:
    """Takes steps one by one and averages the valid ones; `belts` are the columns of their temperatures in a row."""

    def __init__(self, belts: list[int], rolling_nm: float) -> None:
        self._belts = belts
        self.rolling_nm = rolling_nm
        self.restart()

    def restart(self) -> None:
        """Reset after a restart of the estimate."""
        self.second, self.samples = Second(), SampleHistory()
        self.of_late = np.zeros(COUNTED)  # share of the samples of each reason

    def next_second(self, number: int) -> None:
        """Begin another second; reasons for discarded samples, while rolling, are kept for some time."""
        refusals = self.second.refused
        total = self.second.taken + float(refusals.sum())
        if total > 0.0 and not refusals[SLOW]:
            self.of_late += (refusals / total - self.of_late) / LATE_S
        self.second = Second(number)

    def wrong_of_late(self) -> tuple[str, float]:
        """The most frequent defect of recent unusable torques, and its share."""
        cause = max(OF_SENSOR, key=lambda reason: self.of_late[reason])
        return TEXTS[cause], float(self.of_late[cause])

    def take(self, stamp_ns: int, row: Row, session: Session) -> None:
        """Add a step to the present second; of frequent steps, only some are used for the mean."""
        if 0 <= stamp_ns - self.samples.seen_ns < APART_NS:
            return
        self.samples.seen_ns = stamp_ns
        learned = session.learned
        residual = row[layout.Results.residual_nm]
        if learned[layout.Learned.on] > 0.0:  # against the file, whatever acts
            learned_torques = learned[layout.Learned.departures] * learned[layout.Learned.sensitivities]
            lasting = float(learned[layout.Learned.torque]) * math.tanh(row[layout.Results.speed_mps] / STANDSTILL_MPS)
            residual += float(learned_torques.sum()) + lasting
        reason = self._why_not(stamp_ns, row, residual, _fresh_value(session, layout.YAW_RATE))
        second = self.second
        if reason != TAKEN:
            second.refused[reason] += 1.0
            return
        second.taken += 1
        second.residual += residual
        second.drive += row[layout.Results.measured_torque_nm] - residual
        second.resisting += row[layout.Results.resistance_torque_nm]
        second.speed += row[layout.Results.speed_mps]
        second.accel += row[layout.Results.accel_mps2]
        second.weight += row[layout.Results.weight_n]
        second.inertia += row[layout.Results.inertia_nm]
        second.felt += _fresh_value(session, layout.SPECIFIC_FORCE)  # IMU acceleration along the track
        belts = 0.0
        for column in self._belts:
            belts += row[column]
        second.belt_degc += belts / max(len(self._belts), 1)
        second.by += learned[layout.Learned.sensitivities]

    def _why_not(self, stamp_ns: int, row: Row, residual: float, yaw_rate: float) -> int:
        torque, speed, accel = (
            row[layout.Results.measured_torque_nm],
            row[layout.Results.speed_mps],
            row[layout.Results.accel_mps2],
        )
        if not math.isfinite(torque):
            return NO_TORQUE
        samples = self.samples
        if torque != samples.torque or stamp_ns < samples.since_ns:
            samples.torque, samples.since_ns = torque, stamp_ns
        if abs(speed) < SLOWEST_MPS:
            return SLOW
        if stamp_ns - samples.since_ns > STUCK_S * SECOND_NS:
            return STUCK
        if int(row[layout.Results.reasons]) & UNSURE:
            return DOUBTFUL
        ahead = math.copysign(1.0, speed)
        if accel * ahead < BRAKING_MPS2 and torque * ahead <= DRIVES_SHARE * self.rolling_nm:
            return BRAKES
        if abs(accel) > HARDEST_MPS2:
            return HARD
        if math.isfinite(yaw_rate) and abs(yaw_rate) > TURNS_M * abs(speed):
            return TURNS
        limit = AGAINST_SHARE * self.rolling_nm
        expected = torque - residual
        if (torque > limit and expected < -limit) or (torque < -limit and expected > limit):
            return AGAINST
        return self._outlying(stamp_ns, residual, INERTIA_DOUBT * abs(row[layout.Results.inertia_nm]))

    def _outlying(self, stamp_ns: int, residual: float, doubt: float) -> int:
        """Whether a sample is far from recent ones, by more than a doubt [Nm]; each moves the level by a bounded amount."""
        samples = self.samples
        passed_ns = stamp_ns - samples.last_ns
        samples.last_ns = stamp_ns
        least_deviation = LEAST_SPREAD * self.rolling_nm
        if not samples.known:
            samples.known, samples.level, samples.deviation = True, residual, FIRST_SPREAD * self.rolling_nm
            return TAKEN
        if not 0 <= passed_ns <= LONGEST_HOLD_NS:  # after a pause the level is less certain
            samples.deviation = max(samples.deviation, FIRST_SPREAD * self.rolling_nm)
            passed_ns = 0
        departure = residual - samples.level
        outlying = abs(departure) > OUTLIER * samples.deviation + doubt
        seconds = passed_ns / SECOND_NS
        samples.outlying_s = samples.outlying_s + seconds if outlying else 0.0
        if samples.outlying_s > LOST_S:  # not they are far off: the level is
            samples.level, samples.deviation, samples.outlying_s = residual, FIRST_SPREAD * self.rolling_nm, 0.0
            return OUTLYING
        limit = FOLLOWED * samples.deviation
        samples.level += min(seconds / FOLLOWS_S, 0.5) * min(max(departure, -limit), limit)
        # Towards the median size: three in ten that are far off move it little.
        direction = 1.0 if MAD_TO_STD * abs(departure) > samples.deviation else -1.0
        samples.deviation = max(samples.deviation * (1.0 + direction * min(seconds / SPREAD_S, 0.1)), least_deviation)
        return OUTLYING if outlying else TAKEN


def _fresh_value(session: Session, channel: int) -> float:
    """The value of a channel of motion at the last speed; nan without one, or if it is old."""
    memory, hold_ns = session.memory, session.estimator.constants.number.motion_hold_ns
    return held_value(memory, channel, int(memory.times[layout.SPEED, layout.Times.last_arrival]), hold_ns)


# Coverage

SPEED_SHARES = (0.2, 0.4, 0.6)  # edges, of the greatest speed
MIDDLES = (0.1, 0.3, 0.5, 0.7)
BELT_DEGC = (15.0, 30.0, 45.0)
LOAD_SHARES = (0.9, 1.1)  # of the nominal weight
SHAPE = (len(SPEED_SHARES) + 1, len(BELT_DEGC) + 1, len(LOAD_SHARES) + 1)
FILLED_S = 20.0
LEAST_S = 240.0  # of compared driving, in total
LEAST_FILLED, LEAST_WITHOUT_BELTS = 4, 2  # buckets
ACCELERATES_MPS2, LEAST_ACCELERATING_S = 0.15, 60.0


class Buckets:
    """Seconds of driving that were learned from: by speed, belt temperature and load, of `SHAPE`; and accelerating, (1,)."""

    def __init__(self, greatest_speed: float, nominal_weight: float, belts: bool) -> None:
        self._least = LEAST_FILLED if belts else LEAST_WITHOUT_BELTS
        self._speeds = [share * greatest_speed for share in SPEED_SHARES]
        self.middles = greatest_speed * np.array(MIDDLES)  # of the classes of speed
        self._weights = [share * nominal_weight for share in LOAD_SHARES]
        self.seconds, self.accelerating = np.zeros(SHAPE), np.zeros(1)

    def reset(self) -> None:
        """Empty buckets."""
        self.seconds[:], self.accelerating[:] = 0.0, 0.0

    def count(self, speed: float, belt_degc: float, weight: float, accel: float) -> None:
        """A second at a speed [m/s], a mean belt temperature [degC], a weight [N] and an acceleration [m/s^2]."""
        self.seconds[_place(self._speeds, abs(speed)), _place(BELT_DEGC, belt_degc), _place(self._weights, weight)] += 1.0
        if abs(accel) >= ACCELERATES_MPS2:
            self.accelerating += 1.0

    @property
    def is_filled(self) -> Mask:
        """Buckets with enough in them, shape SHAPE."""
        return np.asarray(self.seconds >= FILLED_S)

    def has_evidence(self) -> Mask:
        """Whether each departure was excited enough, shape (LEARNABLE,)."""
        is_filled: Mask = self.is_filled
        if self.seconds.sum() < LEAST_S or is_filled.sum() < self._least:
            return np.zeros(layout.LEARNABLE, dtype=bool)
        speeds = np.asarray(is_filled.any(axis=(1, 2)))
        has_evidence = np.full(layout.LEARNABLE, bool(speeds.sum() >= 2))
        has_evidence[layout.OF_DRAG] &= bool(speeds[-2:].any())
        has_evidence[layout.OF_MASS] = self.accelerating[0] >= LEAST_ACCELERATING_S
        has_evidence[layout.OF_BELT] = False  # a state, not the vehicle's own
        return has_evidence

    @property
    def share(self) -> float:
        """Share of the required driving, 0 to 1."""
        return float(min(self.seconds.sum() / LEAST_S, self.is_filled.sum() / self._least, 1.0))


def _place(edges: tuple[float, ...] | list[float], value: float) -> int:
    return sum(value >= edge for edge in edges)
