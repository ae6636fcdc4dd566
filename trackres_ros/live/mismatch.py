"""Have measured and expected torque parted? A change detector on the whitened residual, a few operations a message.

The residual r is averaged over bins while the vehicle rolls steadily. Its noise is taken for a first-order autoregression; its
coefficient phi and scale sigma are those of the deviations from a running mean, which soon follows a lasting offset, so that this
is not taken for noise. The whitened residual (r - phi r_before) / sigma, less what a tolerated offset would make of it, is summed
as in Page's test (Biometrika 41, 1954, 100), once for each sign. The sum of the n bins since it last was zero has the standard
deviation sqrt(n): the two have parted when it is `mismatch_evidence` times as large and the offset has lasted for
`mismatch_hold_s`, so that a grade that comes round each lap is none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

NANOSECOND = 1e-9
SETTLING_BINS = 30  # before the noise is believed
KNOWN_AFTER = 2.0  # times the holding time: sooner slow noise, as of hills, cannot be told from an offset
MEAN_BINS = 150  # memory of the running mean
MOST_PHI = 0.98  # nearer to 1 an offset and a random walk are one
OUTLIER = 5.0  # standard deviations: beyond, a bin counts as this far
LEAST_NOISE = 0.01  # of the tolerance: what a noiseless residual is given


def _setting(default: float, unit: str, low: float, high: float, meaning: str) -> Any:
    return field(default=default, metadata={"unit": unit, "low": low, "high": high, "meaning": meaning})


@dataclass(frozen=True)
class MismatchSettings:
    """Settings of the detector; the field metadata holds unit, limits and meaning of each."""

    mismatch_share: float = _setting(
        0.1, "1", 0.0, 10.0, "a lasting difference up to this share of the expected torque is tolerated"
    )
    mismatch_std: float = _setting(
        1.0, "1", 0.0, 10.0, "a lasting difference up to so many standard deviations of the estimate is tolerated"
    )
    mismatch_evidence: float = _setting(
        6.0, "1", 3.0, 100.0, "standard errors by which it must exceed both; more means fewer false alarms, and later"
    )
    mismatch_hold_s: float = _setting(
        300.0, "s", 10.0, 86400.0, "driving time it must last; longer than what comes round with each lap"
    )
    mismatch_bin_s: float = _setting(2.0, "s", 0.1, 60.0, "time over which the residual is averaged")
    mismatch_memory_s: float = _setting(600.0, "s", 30.0, 86400.0, "memory of the noise of the residual")
    mismatch_min_speed_mps: float = _setting(1.0, "m/s", 0.0, 30.0, "slower is not compared")
    mismatch_max_accel: float = _setting(0.3, "m/s^2", 0.01, 15.0, "a larger acceleration is not compared")


@dataclass(frozen=True, slots=True)
class Mismatch:
    """What the detector found.

    Attributes
    ----------
    parted
        Whether measured and expected torque have parted.
    since_ns
        Stamp at which they did, as far as can be told afterwards [ns].
    after_s
        Driving time compared until then [s].
    mean_nm, share
        Mean difference since then, measured less expected [Nm], and over the mean size of the expected torque.
    settled
        Whether there has been enough to judge.
    text
        The same in a sentence.
    """

    parted: bool
    since_ns: int | None
    after_s: float
    mean_nm: float
    share: float
    settled: bool
    text: str


class _Page:
    """One-sided sum of whitened residuals less their allowance, and what has passed since it was zero."""

    def __init__(self) -> None:
        self.clear(None, 0)

    def clear(self, stamp_ns: int | None, bins_before: int) -> None:
        self.sum, self.bins, self.residual, self.drive = 0.0, 0, 0.0, 0.0
        self.since_ns, self.bins_before = stamp_ns, bins_before

    def add(self, excess: float, residual: float, drive: float, stamp_ns: int, bins_before: int) -> None:
        if self.sum + excess <= 0.0:
            self.clear(None, 0)
            return
        if self.bins == 0:
            self.since_ns, self.bins_before = stamp_ns, bins_before
        self.sum += excess
        self.bins += 1
        self.residual += residual
        self.drive += drive

    def exceeds(self, evidence: float, bins: float) -> bool:
        return self.bins >= bins and self.sum > evidence * math.sqrt(self.bins)


class MismatchDetector:
    """Takes estimates with a measured torque one by one; `verdict` is what it makes of them."""

    def __init__(self, settings: MismatchSettings) -> None:
        self.settings = settings
        self._bin_ns = int(settings.mismatch_bin_s / NANOSECOND)
        self._hold_bins = settings.mismatch_hold_s / settings.mismatch_bin_s
        self.restart()

    def restart(self) -> None:
        """Forget everything: the estimate was started anew."""
        self._begin_bin(0)
        self._bins, self._first_ns = 0, 0
        self._before: tuple[int, float, float] | None = None  # stamp, residual, deviation
        self._mean, self._variance, self._covariance = 0.0, 0.0, 0.0
        self._sides = {1.0: _Page(), -1.0: _Page()}
        self._back = _Page()
        self._side: float | None = None

    def take(
        self, stamp_ns: int, residual_nm: float, drive_torque_nm: float, std_nm: float, speed_mps: float, accel_mps2: float
    ) -> None:
        """Take one estimate.

        Parameters
        ----------
        stamp_ns
            Its time [ns].
        residual_nm
            Measured less expected torque [Nm]; nan where none is measured.
        drive_torque_nm, std_nm
            Expected torque and its standard deviation [Nm].
        speed_mps, accel_mps2
            Speed [m/s] and acceleration [m/s^2].
        """
        s = self.settings
        if abs(speed_mps) < s.mismatch_min_speed_mps or abs(accel_mps2) > s.mismatch_max_accel:
            return
        if not (math.isfinite(residual_nm) and math.isfinite(drive_torque_nm) and math.isfinite(std_nm)):
            return
        if not 0 <= stamp_ns - self._bin_start < self._bin_ns:
            if self._samples:
                self._close_bin()
            self._begin_bin(stamp_ns)
        self._samples += 1
        self._residual += residual_nm
        self._drive += abs(drive_torque_nm)
        self._std += std_nm

    @property
    def verdict(self) -> Mismatch:
        """What has been found so far."""
        s = self.settings
        settled = self._bins > SETTLING_BINS
        if self._side is None:
            text = "no lasting difference" if settled else "too little driving with a measured torque to judge yet"
            return Mismatch(False, None, math.nan, math.nan, math.nan, settled, text)
        page = self._sides[self._side]
        mean, share = page.residual / page.bins, page.residual / max(page.drive, 1e-9)
        after_s, lasted_s = page.bins_before * s.mismatch_bin_s, page.bins * s.mismatch_bin_s
        when = "from the start on" if page.bins_before == 0 else f"after {after_s / 60.0:.1f} min of driving"
        text = (
            f"the measured torque is {abs(mean):.0f} Nm ({100.0 * abs(share):.0f} %) "
            f"{'above' if mean > 0.0 else 'below'} the expected one for {lasted_s / 60.0:.1f} min of driving, {when}"
        )
        return Mismatch(True, page.since_ns, after_s, mean, share, settled, text)

    def _begin_bin(self, stamp_ns: int) -> None:
        self._bin_start, self._samples = stamp_ns, 0
        self._residual, self._drive, self._std = 0.0, 0.0, 0.0

    def _close_bin(self) -> None:
        residual, drive, std = (total / self._samples for total in (self._residual, self._drive, self._std))
        before = self._before
        if before is not None and not 0 < self._bin_start - before[0] <= 2 * self._bin_ns:
            before = None
        if self._bins == 0:
            self._first_ns, self._mean = self._bin_start, residual
        deviation = self._learn(residual, None if before is None else before[2])
        if self._bins >= SETTLING_BINS:
            self._judge(residual, None if before is None else before[1], drive, std)
        self._before = (self._bin_start, residual, deviation)
        self._bins += 1

    def _learn(self, residual: float, deviation_before: float | None) -> float:
        """Take a bin into the mean, the variance and the covariance of neighbours; its deviation from the mean so far."""
        deviation = residual - self._mean
        if self._bins >= SETTLING_BINS:
            bound = OUTLIER * math.sqrt(self._variance)
            deviation = min(max(deviation, -bound), bound)
        self._mean += max(1.0 / (self._bins + 1), 1.0 / MEAN_BINS) * (residual - self._mean)
        share = max(1.0 / (self._bins + 1), self.settings.mismatch_bin_s / self.settings.mismatch_memory_s)
        self._variance += share * (deviation * deviation - self._variance)
        if deviation_before is not None:
            self._covariance += share * (deviation * deviation_before - self._covariance)
        return deviation

    def _judge(self, residual: float, before: float | None, drive: float, std: float) -> None:
        s = self.settings
        tolerance = max(s.mismatch_share * drive, s.mismatch_std * std)
        correlation = self._covariance / self._variance if self._variance > 0.0 else 0.0
        correlation += (1.0 + 3.0 * correlation) / MEAN_BINS  # what taking off the mean of so many has cost it
        phi = min(max(correlation, 0.0), MOST_PHI)
        sigma = max(math.sqrt(self._variance * (1.0 - phi * phi)), LEAST_NOISE * tolerance, 1e-9)
        if before is None:
            gain = math.sqrt(1.0 - phi * phi) / sigma
            white = residual * gain
        else:
            gain = (1.0 - phi) / sigma
            white = (residual - phi * before) / sigma
        allowance = tolerance * gain
        # An outlier counts as one as far as it is unexpected, after the offset that the allowance lets pass.
        bound = OUTLIER + allowance
        white = min(max(white, -bound), bound)
        stamp_ns, bins_before = (self._first_ns, 0) if self._bins == SETTLING_BINS else (self._bin_start, self._bins)
        for side, page in self._sides.items():
            if side == self._side:
                self._go_on(page, side * white, allowance, residual, drive)
            else:
                page.add(side * white - allowance, residual, drive, stamp_ns, bins_before)
                known = self._bins >= KNOWN_AFTER * self._hold_bins
                if self._side is None and known and page.exceeds(s.mismatch_evidence, self._hold_bins):
                    self._side = side
                    self._back.clear(None, 0)

    def _go_on(self, page: _Page, white: float, allowance: float, residual: float, drive: float) -> None:
        """While parted: gather what the difference is, and the evidence that it has gone."""
        page.bins += 1
        page.residual += residual
        page.drive += drive
        self._back.add(allowance - white, residual, drive, self._bin_start, self._bins)
        if self._back.exceeds(self.settings.mismatch_evidence, self._hold_bins):
            page.clear(None, 0)
            self._side = None
