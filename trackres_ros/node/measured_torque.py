# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a measured torque tells a running node: a lasting mismatch, a disturbance of the vehicle file, learned parameters.

Mismatch and disturbance only read the estimate: neither enters an expected torque or the feed-forward.
"""

from __future__ import annotations

import math
import statistics
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple, TypeVar

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.disturbance import LARGEST_NM, STEADY_MPS, STEADY_MPS2, Belief, DisturbanceWatch
from trackres_ros.estimator.estimator import Estimator, Session
from trackres_ros.estimator.settings import setting
from trackres_ros.estimator.snapshot import LEARNED_AT
from trackres_ros.learning.columns import LearningColumns, learning_values, lines
from trackres_ros.learning.learner import OFF, ON, Learner, use_file
from trackres_ros.learning.store import continue_session, learner_content, since_learned
from trackres_ros.node.notices import Notice
from trackres_ros.node.transport import Level, Status
from trackres_ros.units import MAD_TO_STD, NANOSECOND
from trackres_ros.vehicle import Disturbance

TIME_RESET, CLOCK_JUMPED = int(at.Reason.TIME_RESET), int(at.Reason.CLOCK_JUMPED)
SETTLING_BINS = 30  # before the noise is believed
KNOWN_AFTER = 2.0  # times the holding time: earlier, slow noise such as hills cannot be distinguished from an offset
MEAN_BINS = 150  # memory of the running mean
TYPICAL_OF = 5  # bins: their median is free of a spike that lasts for two
RELATED_S = 30.0  # bins further apart have uncorrelated noise
MOST_PHI = 0.98  # nearer to 1 an offset and a random walk are one
OUTLIER = 5.0  # standard deviations: limit of a bin
LEAST_NOISE = 0.001  # of the expected torque: finer than torque transducers are (class 0.1), for a residual without noise


Compared = TypeVar("Compared", float, Array)


@dataclass(frozen=True)
class MismatchSettings:
    """Settings of the detector; the field metadata holds unit, limits and meaning of each."""

    mismatch_share: float = setting(
        0.1, "1", 0.0, 10.0, "a lasting difference up to this share of the expected torque is tolerated"
    )
    mismatch_std: float = setting(
        1.0, "1", 0.0, 10.0, "a lasting difference up to this many standard deviations of the estimate is tolerated"
    )
    mismatch_evidence: float = setting(
        6.0, "1", 3.0, 100.0, "standard errors by which the difference must exceed both; larger means fewer and later alarms"
    )
    mismatch_hold_s: float = setting(
        300.0, "s", 10.0, 86400.0, "driving time that the difference must last; choose it longer than a lap"
    )
    mismatch_bin_s: float = setting(2.0, "s", 0.1, 60.0, "time over which the residual is averaged")
    mismatch_memory_s: float = setting(600.0, "s", 30.0, 86400.0, "time constant of the residual's noise estimate")
    mismatch_min_speed_mps: float = setting(STEADY_MPS, "m/s", 0.0, 30.0, "lower speeds are not compared")
    mismatch_max_accel: float = setting(STEADY_MPS2, "m/s^2", 0.01, 15.0, "larger accelerations are not compared")

    def compares(self, speed_mps: Compared, accel_mps2: Compared) -> Any:
        """Whether measured and expected torque are compared at a speed [m/s] and an acceleration [m/s^2], numbers or arrays."""
        return (abs(speed_mps) >= self.mismatch_min_speed_mps) & (abs(accel_mps2) <= self.mismatch_max_accel)


@dataclass(frozen=True, slots=True)
class Mismatch:
    """Result of the detector."""

    parted: bool  # whether there is a mismatch
    after_s: float  # driving time compared until its beginning, estimated afterwards
    mean_nm: float  # mean difference since then, measured less expected, in the direction of travel
    share: float  # the same relative to the mean size of the expected torque
    settled: bool  # whether there were enough data to judge
    text: str  # the same in a sentence


class _Bin(NamedTuple):
    """Means over one bin [Nm]."""

    start_ns: int
    residual: float
    drive: float
    std: float


class _Noise:
    """The residual's own noise, a first-order autoregression about its running mean; outliers have reduced weight."""

    def __init__(self) -> None:
        self.is_settled = False
        self._first_values: list[float] = []
        self._recent: deque[float] = deque(maxlen=TYPICAL_OF)
        self._bins = 0
        self._mean, self._variance, self._covariance, self._deviation = 0.0, 0.0, 0.0, 0.0

    @property
    def typical(self) -> float:
        """Residual of late, free of spikes [Nm]."""
        return statistics.median(self._recent)

    @property
    def phi(self) -> float:
        """Correlation of a bin with the next."""
        correlation = self._covariance / self._variance if self._variance > 0.0 else 0.0
        correlation += (1.0 + 3.0 * correlation) / MEAN_BINS  # correction for the mean subtracted from so many bins
        return min(max(correlation, 0.0), MOST_PHI)

    def shock(self, floor: float) -> float:
        """Standard deviation of a bin's innovation, bounded below [Nm]."""
        phi = self.phi
        return max(math.sqrt(self._variance * (1.0 - phi * phi)), floor)

    def learn(self, residual: float, related: bool, share: float, floor: float) -> None:
        """Add a bin with a weight of `share`; `related` to the one before or not."""
        self._recent.append(residual)
        self._bins += 1
        if not self.is_settled:
            self._first_values.append(residual)
            if self._bins == SETTLING_BINS:
                self._settle()
            return
        bound = OUTLIER * max(math.sqrt(self._variance), floor)
        deviation = _clip(residual - self._mean, bound)
        self._mean += max(1.0 / self._bins, 1.0 / MEAN_BINS) * (self.typical - self._mean)
        share = max(1.0 / self._bins, min(share, 1.0 / SETTLING_BINS))
        self._variance += share * (deviation * deviation - self._variance)
        if related:
            self._covariance += share * (deviation * self._deviation - self._covariance)
        self._deviation = deviation

    def _settle(self) -> None:
        """Begin with median and median deviation, lest a spike at the start blinds for hours."""
        middle = statistics.median(self._first_values)
        spread = MAD_TO_STD * statistics.median(abs(value - middle) for value in self._first_values)
        deviations = [_clip(value - middle, OUTLIER * spread) for value in self._first_values]
        self._mean = middle
        self._variance = sum(d * d for d in deviations) / len(deviations)
        self._covariance = sum(a * b for a, b in pairwise(deviations)) / len(deviations)
        self._deviation = deviations[-1]
        self.is_settled, self._first_values = True, []


class _Page:
    """One-sided sum of whitened residuals less their allowance, and the totals since it was zero."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        self.sum, self.bins, self.seconds, self.residual, self.drive = 0.0, 0, 0.0, 0.0, 0.0
        self.seconds_before = 0.0

    def add(self, excess: float, seconds_before: float) -> None:
        """Add a bin; if the sum was zero, it begins at the given driving time."""
        if self.sum + excess <= 0.0:
            self.clear()
            return
        if self.bins == 0:
            self.seconds_before = seconds_before
        self.sum += excess
        self.bins += 1

    def gather(self, residual: float, drive: float, seconds: float) -> None:
        """Accumulate the difference, while there is one."""
        if self.bins:
            self.residual += residual * seconds
            self.drive += drive * seconds
            self.seconds += seconds

    def exceeds(self, evidence: float, seconds: float) -> bool:
        return self.seconds >= seconds and self.sum > evidence * math.sqrt(self.bins)


class MismatchDetector:
    """Compares estimates with a measured torque one by one, by a change detector on the whitened residual.

    Notes
    -----
    The residual r, positive in the direction of travel, is averaged over bins while the vehicle rolls steadily. Its noise is
    modelled as a first-order autoregression with coefficient phi and scale sigma, of the deviations from a running mean. That
    mean soon follows a lasting offset, so the offset does not enter the noise. Page's test (Biometrika 41, 1954, 100) sums
    the whitened residual (r - phi r_before) / sigma, less the tolerated offset's share, once for each sign. The sum of the n
    bins since it last was zero has the standard deviation sqrt(n). A mismatch is detected when the sum is `mismatch_evidence`
    (h) times as large and the offset has lasted for `mismatch_hold_s` (N bins). So a grade that recurs each lap causes none.

    False alarms: standardised sums over at least N independent terms exceed h, with either sign, less often than h^3
    exp(-h^2/2) / (2 N sqrt(2 pi)) per bin (Siegmund and Venkatraman, Annals of Statistics 23, 1995, 255, with windows no
    shorter than N). By default that is once in 100 000 h of driving with zero tolerance, and rarer with a positive one. Other
    noise, or noise that stays on one side for longer than `mismatch_hold_s`, as on long hills, alarms more often.
    """

    def __init__(self, settings: MismatchSettings) -> None:
        self.settings = settings
        self._bin_ns = int(settings.mismatch_bin_s / NANOSECOND)
        self._related_ns = max(2 * self._bin_ns, int(RELATED_S / NANOSECOND))
        self.restart()

    def restart(self) -> None:
        """Reset after a restart of the estimate."""
        self._begin_bin(0)
        self._last_bin: _Bin | None = None
        self._seconds = 0.0
        self._noise = _Noise()
        self._is_judging = False
        self._sides = {1.0: _Page(), -1.0: _Page()}
        self._back = _Page()
        self._side: float | None = None

    def take(
        self, stamp_ns: int, residual_nm: float, drive_torque_nm: float, std_nm: float, speed_mps: float, accel_mps2: float
    ) -> None:
        """Process one estimate: its time, measured less expected torque, expected torque with its standard deviation, and motion.

        The residual is without a present, known disturbance, and nan where no torque is measured.
        """
        if not self.settings.compares(speed_mps, accel_mps2):
            return
        if not (abs(residual_nm) < LARGEST_NM and abs(drive_torque_nm) < LARGEST_NM and abs(std_nm) < LARGEST_NM):
            return
        age_ns = stamp_ns - self._bin_start
        if not 0 <= age_ns < self._bin_ns:
            if -self._related_ns <= age_ns < 0:
                return  # late; from further back the clock was set back
            if self._samples:
                self._close_bin()
            self._begin_bin(stamp_ns)
        self._samples += 1
        self._residual += residual_nm if speed_mps >= 0.0 else -residual_nm  # in the direction of travel
        self._drive += abs(drive_torque_nm)
        self._std += std_nm

    @property
    def verdict(self) -> Mismatch:
        """Result so far."""
        is_settled = self._is_settled
        if self._side is None:
            text = "no lasting difference" if is_settled else "not enough driving with a measured torque yet"
            return Mismatch(False, math.nan, math.nan, math.nan, is_settled, text)
        page = self._sides[self._side]
        mean, share = page.residual / page.seconds, page.residual / max(page.drive, 1e-9)
        after_s = page.seconds_before
        span = "from the start on" if after_s == 0.0 else f"after {after_s / 60.0:.1f} min of driving"
        text = (
            f"the measured torque is {abs(mean):.0f} Nm ({100.0 * abs(share):.0f} %) "
            f"{'above' if mean > 0.0 else 'below'} the expected torque for {page.seconds / 60.0:.1f} min of driving, {span}"
        )
        return Mismatch(True, after_s, mean, share, is_settled, text)

    @property
    def _is_settled(self) -> bool:
        return self._noise.is_settled and self._seconds >= KNOWN_AFTER * self.settings.mismatch_hold_s

    def _begin_bin(self, stamp_ns: int) -> None:
        self._bin_start, self._samples = stamp_ns, 0
        self._residual, self._drive, self._std = 0.0, 0.0, 0.0

    def _close_bin(self) -> None:
        s = self.settings
        new_bin = _Bin(self._bin_start, *(total / self._samples for total in (self._residual, self._drive, self._std)))
        last_bin, seconds = self._last_bin, s.mismatch_bin_s
        if last_bin is not None and 0 < new_bin.start_ns - last_bin.start_ns <= self._related_ns:
            seconds = (new_bin.start_ns - last_bin.start_ns) * NANOSECOND
        else:  # after a long pause, or the clock was set back
            last_bin = None
        is_judging = self._noise.is_settled
        floor = max(LEAST_NOISE * new_bin.drive, 1e-9)
        self._noise.learn(new_bin.residual, last_bin is not None, seconds / s.mismatch_memory_s, floor)
        if is_judging:
            self._judge(new_bin, last_bin, seconds, floor)
        self._last_bin = new_bin
        self._seconds += seconds

    def _judge(self, new_bin: _Bin, last_bin: _Bin | None, seconds: float, floor: float) -> None:
        s = self.settings
        phi, sigma = self._noise.phi, self._noise.shock(floor)
        if last_bin is None:
            gain = math.sqrt(1.0 - phi * phi) / sigma
            white = new_bin.residual * gain
        else:
            gain = (1.0 - phi) / sigma
            white = (new_bin.residual - phi * last_bin.residual) / sigma
        allowance = max(s.mismatch_share * new_bin.drive, s.mismatch_std * new_bin.std) * gain
        # Outliers are judged by their unexpected part, after the offset within the allowance.
        white = _clip(white, OUTLIER + allowance)
        begin_s = self._seconds if self._is_judging else 0.0
        self._is_judging = True
        typical_std = self._noise.typical
        for side, page in self._sides.items():
            if side != self._side:
                page.add(side * white - allowance, begin_s)
            page.gather(typical_std, new_bin.drive, seconds)
        if self._side is None:
            sides = (side for side, page in self._sides.items() if page.exceeds(s.mismatch_evidence, s.mismatch_hold_s))
            self._side = next(sides, None) if self._is_settled else None
            return
        self._back.add(allowance - self._side * white, begin_s)
        self._back.gather(typical_std, new_bin.drive, seconds)
        if self._back.exceeds(s.mismatch_evidence, s.mismatch_hold_s):
            self._sides[self._side].clear()
            self._back.clear()
            self._side = None


def _clip(value: float, bound: float) -> float:
    return min(max(value, -bound), bound)


class Comparison:
    """Compares rows of results; `verdict` and `belief` are the results.

    Rows that the detector does not compare are not watched for disturbances either. There is no disturbance to watch for
    without one in the vehicle file, or without a measured torque.
    """

    def __init__(self, settings: MismatchSettings, disturbance: Disturbance | None) -> None:
        self._detector = MismatchDetector(settings)
        self._watch = None if disturbance is None else DisturbanceWatch(disturbance)
        self.belief = None if self._watch is None else self._watch.belief(0)
        self._set_ns = 0

    @property
    def verdict(self) -> Mismatch:
        """Whether measured and expected torque, corrected for a disturbance, differ significantly."""
        return self._detector.verdict

    def restart(self) -> None:
        """Reset after a restart of the estimate."""
        self._detector.restart()
        if self._watch is not None:
            self._watch.restart()
            self.belief = self._watch.belief(0)

    def change(self, settings: MismatchSettings) -> None:
        """Continue with other settings; the detector restarts with them."""
        if settings != self._detector.settings:
            self._detector = MismatchDetector(settings)

    def take(self, stamp_ns: int, row: Sequence[float], arrival_ns: int, set_ns: int = 0) -> str:
        """Take the results of a step, its stamp and its arrival [ns]; return a text for the log, or an empty one.

        `set_ns` is how far this machine's clock was set since the start, where stamps do not show it.
        """
        if int(row[at.Results.reasons]) & TIME_RESET:
            self.restart()
        has_jumped = bool(int(row[at.Results.reasons]) & CLOCK_JUMPED) or set_ns != self._set_ns
        self._set_ns = set_ns
        residual, speed, accel = row[at.Results.residual_nm], row[at.Results.speed_mps], row[at.Results.accel_mps2]
        last_belief, explained_torque = self.belief, 0.0
        if self._watch is not None:
            counts = self._detector.settings.compares(speed, accel)
            now_ns = stamp_ns + set_ns
            self.belief = self._watch.take(now_ns, residual if counts else math.nan, speed, now_ns - arrival_ns, has_jumped)
            explained_torque = 0.0 if self.belief.is_overdue else self.belief.torque_nm * math.copysign(1.0, speed)
        self._detector.take(
            stamp_ns,
            residual - explained_torque,
            row[at.Results.drive_torque_nm],
            row[at.Results.resistance_std_nm],
            speed,
            accel,
        )
        return _spell_change(last_belief, self.belief)

    def notices(self, command: str) -> list[Notice]:
        """Present notices; `command` explains a mismatch."""
        verdict, belief = self.verdict, self.belief
        return [
            *([Notice("MISMATCH", f"{verdict.text}; investigate with: {command}")] if verdict.parted else []),
            *([Notice("DISTURBANCE", belief.text)] if belief is not None and belief.present else []),
        ]


def _spell_change(last: Belief | None, belief: Belief | None) -> str:
    """Text that a spell begins or is over; empty if neither."""
    if last is None or belief is None or last.present is belief.present:
        return ""
    return f"{'the disturbance begins' if belief.present else 'the disturbance is over'}: {belief.text}"


class LiveLearning:
    """A learner for a node with a measured torque; without one it does nothing. Learned values are kept while it is off, and
    those of the state file without a torque.
    """

    def __init__(self, estimator: Estimator, mode: str, has_torque: bool) -> None:
        self.mode = mode
        self.learner = Learner(estimator, mode) if has_torque else None
        self._columns = None if self.learner is None else LearningColumns(self.learner)
        self._stored_values: Any = None  # plain values for the state file while nothing learns

    def go_on(self, session: Session, values: Any, now_s: float) -> str:
        """Continue with a session and the learned values of a state file at a time [s since 1970]; return a text for the log.

        They are less certain by the time since they were learned.

        Raises ValueError if they are not from a learner of this vehicle; they are then not used.
        """
        use_file(session.learned)
        if values is None:
            return ""
        if self.learner is None:
            self._stored_values = values
            return "the learned parameters are kept, but no torque is measured"
        continue_session(session, self.learner, values, since_learned(values, now_s))
        self._stored_values = values if self.mode == OFF else None
        return f"{self.learner.learned.seconds / 60.0:.0f} min of driving were used for learning"

    def wear(self, seconds: float) -> None:
        """Account for more time off [s] before the first speed; values that are only kept say when they were learned."""
        if self.learner is not None and self._stored_values is None:
            self.learner.add_wear(seconds)

    def stored(self) -> Any:
        """Plain values for the state file; None if nothing was learned."""
        return self._stored_values if self.learner is None or self._stored_values is not None else learner_content(self.learner)

    def take(self, stamp_ns: int, row: list[float], session: Session) -> None:
        """Take the results of a step."""
        if self.learner is not None and self.mode != OFF:
            parameters = session.learned.copy()
            try:
                self.learner.take(stamp_ns, row, session)
                if not np.isfinite(session.learned).all():
                    raise ArithmeticError("a learned parameter is not finite")
            except BaseException:  # learned values for the next step stay unchanged
                session.learned[:] = parameters
                raise

    def columns(self, row: list[float], session: Session) -> list[float]:
        """Values of the columns after those of an estimate."""
        return [] if self._columns is None else self._columns.row_values(row, session)

    def change(self, mode: str, session: Session) -> None:
        """Change the mode; learned values stay, and act only in mode `on`."""
        if self.learner is None or mode == self.mode:
            self.mode = mode
            return
        if mode == OFF:
            self._stored_values = {LEARNED_AT: time.time(), **learner_content(self.learner)}
        elif self._stored_values is not None:
            continue_session(session, self.learner, self._stored_values, since_learned(self._stored_values, time.time()))
            self._stored_values = None
        if OFF in (mode, self.mode):
            self.learner.restart()
        self.mode = self.learner.mode = mode
        if mode != ON:
            use_file(session.learned)

    def restart(self, session: Session) -> None:
        """Restart the estimate; values learned of the vehicle stay, and act again once the learner allows it."""
        use_file(session.learned)
        if self.learner is not None:
            self.learner.restart()

    def reset(self, session: Session) -> str:
        """Reset the learned parameters; return a text for the log."""
        use_file(session.learned)
        if self.learner is None and self._stored_values is None:
            return "no torque is measured, so there is nothing to reset"
        self._stored_values = None
        if self.learner is not None:
            self.learner.reset()
        return "the learned parameters are reset: the vehicle file is used"

    @property
    def text(self) -> str:
        """Status of learning, in a sentence; empty if learning is off."""
        if self.learner is None:
            return ""
        return OFF if self.mode == OFF else self.learner.text

    def statuses(self, node: str, vehicle: str) -> Sequence[Status]:
        """A status of each learned value, as published."""
        if self.learner is None or self.mode == OFF:
            return ()
        overall_status = (
            ("mode", self.mode),
            ("acts", str(self.learner.is_active).lower()),
            ("frozen", self.learner.freeze_reason),
            ("disturbance", self.learner.disturbance),
        )
        learned_lines = lines(self.learner, learning_values(self.learner))
        rows = [("learning", self.text, overall_status), *learned_lines]
        return [Status(Level.OK, f"{node}: {name}", message, vehicle, values) for name, message, values in rows]

    def notices(self) -> list[Notice]:
        """Present notices of the learning."""
        if self.learner is None or self.mode == OFF:
            return []
        frozen_reason, left_out = self.learner.freeze_reason, self.learner.left_out
        text = f"learning is paused: {frozen_reason}" if frozen_reason else f"learning skips samples: {left_out}"
        return [Notice("LEARNING_FROZEN", text)] if frozen_reason or left_out else []
