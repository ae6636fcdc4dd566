# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Mean residuals by bins of the physical variables, with a correction for multiple tests."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import kolmogorov

from trackres_ros.diagnosis.base.base import Predicted
from trackres_ros.diagnosis.base.variables import BY_NAME, varying
from trackres_ros.diagnosis.empirical.torque import against_travel, torque_residuals
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Array

BINS = 6
FEWEST_IN_BIN = 30
FLIPPED_TOGETHER = 20
REPLICATES = 4000  # determines a probability of 0.01 to a sixth of its value
AT_ONCE = 100  # of these: a hundred hours have ten thousand pieces


@dataclass(frozen=True, slots=True)
class Bin:
    """A range of a variable, the mean residual against travel there [Nm], and the probability that noise alone reaches it in
    any bin.
    """

    variable: str
    low: float
    high: float
    mean_residual: float
    unit: str
    samples: int
    p: float


@dataclass(frozen=True, eq=False)
class RegimeMap:
    """All bins, and the probability that noise alone makes the largest of them."""

    bins: tuple[Bin, ...]
    p: float
    samples: int

    @property
    def significant(self) -> tuple[Bin, ...]:
        """Significant bins, the clearest first."""
        return tuple(sorted((b for b in self.bins if b.p < 0.05), key=lambda b: (b.p, -abs(b.mean_residual))))

    def likeliest(self, variable: str, low: float, high: float) -> float:
        """Least probability of the bins of a variable that overlap a range; 1 without any."""
        return min((b.p for b in self.bins if b.variable == variable and b.low < high and b.high > low), default=1.0)


def regime_map(fit: Fit, rng: np.random.Generator, predicted: Sequence[Predicted] | None = None) -> RegimeMap:
    """Bin the residual of a fit over every variable that varies.

    `predicted`: belt temperatures and the like that divide into bins, if not those of the fit.

    Notes
    -----
    The mean is of the plain residual against travel [Nm]. Its significance is tested on the whitened one, against the
    largest over all bins with random sign flips of whole pieces (max-T). Steps in which the vehicle turns back are left out:
    they have no direction of travel.
    """
    sessions = fit.problem.sessions
    rows = fit.white[: len(sessions)]
    turns_back = np.concatenate([np.abs(s.speed) < 0.5 * s.step * np.abs(s.accel) for s in sessions])
    valid = np.isfinite(np.concatenate(rows)) & ~turns_back
    e, plain = (np.concatenate(against_travel(sessions, of))[valid] for of in (rows, torque_residuals(fit)))
    pieces = _pieces(rows)[valid]
    members, bins = [], []
    for name, series in varying(sessions, predicted or fit.predicted).items():
        of = series[valid]
        for low, high in _edges(of):
            inside = (of >= low) & (of <= high)
            if inside.sum() >= FEWEST_IN_BIN:
                members.append(inside)
                bins.append((name, low, high, float(plain[inside].mean()), BY_NAME[name].unit, int(inside.sum())))
    if not bins:
        return RegimeMap((), 1.0, len(e))
    number = np.unique(pieces, return_inverse=True)[1]
    sums = np.array([np.bincount(number, weights=np.where(inside, e, 0.0), minlength=number.max() + 1) for inside in members])
    middle = sums - sums.mean(axis=1, keepdims=True) if sums.shape[1] > 1 else sums
    spread = np.sqrt((middle**2).sum(axis=1)) + 1e-12
    found = np.abs(sums.sum(axis=1)) / spread
    flips = (rng.choice((-1.0, 1.0), (AT_ONCE, sums.shape[1])) for _ in range(REPLICATES // AT_ONCE))
    reached = np.concatenate([np.abs(signs @ middle.T / spread).max(axis=1) for signs in flips])
    p = (1.0 + (reached[:, np.newaxis] >= found).sum(axis=0)) / (REPLICATES + 1.0)
    return RegimeMap(tuple(Bin(*of, p=float(q)) for of, q in zip(bins, p, strict=True)), float(p.min()), len(e))


def cumulative_periodogram(fit: Fit) -> float:
    """Probability that white noise deviates as far from a flat spectrum as the whitened residual (Bartlett's test).

    Each recording has its own scale, and all are cumulated together from the lowest frequency on.
    """
    rows = [white[np.isfinite(white)] for white in fit.white[: len(fit.problem.sessions)]]
    spectra = [(np.fft.rfftfreq(len(e))[1:-1], np.abs(np.fft.rfft(e)[1:-1]) ** 2) for e in rows if len(e)]  # of those fitted on
    flat = [(f, p / p.mean()) for f, p in spectra if p.sum() > 0.0]
    frequency, power = np.concatenate(flat, axis=1) if flat else np.empty((2, 0))
    cumulative = np.cumsum(power[np.argsort(frequency, kind="stable")])[:-1] / max(len(power), 1)
    count = len(cumulative)
    if not count:  # too short to show a shape
        return 1.0
    steps = np.arange(count + 1) / count
    distance = max(np.max(steps[1:] - cumulative), np.max(cumulative - steps[:-1]))
    return float(kolmogorov(distance * (math.sqrt(count) + 0.12 + 0.11 / math.sqrt(count))))  # Stephens (1970), of finite samples


def _edges(series: Array) -> list[tuple[float, float]]:
    edges = np.unique(np.quantile(series, np.linspace(0.0, 1.0, BINS + 1))).tolist()
    return list(pairwise(edges)) or [(edges[0], edges[0])]


def _pieces(rows: Sequence[Array]) -> NDArray[np.int64]:
    """Number of the piece of each row, whose sign is flipped together."""
    first, found = 0, []
    for row in rows:
        found.append(first + np.arange(len(row)) // FLIPPED_TOGETHER)
        first = int(found[-1][-1]) + 1
    return np.concatenate(found)
