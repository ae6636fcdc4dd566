"""Where a residual is not zero: signed means by bin of what drives the physics, corrected for having looked in so many places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.base import Predicted
from trackres_ros.diagnosis.fitting import Fit
from trackres_ros.diagnosis.session import Session

Array = NDArray[np.float64]

BINS = 6
FEWEST_IN_BIN = 30
FLIPPED_TOGETHER = 20
REPLICATES = 4000  # a probability of a hundredth is then known to a sixth of it
UNITS = {
    "speed": "m/s",
    "acceleration": "m/s^2",
    "load": "N",
    "belt temperature": "degC",
    "ambient temperature": "degC",
    "yaw rate": "rad/s",
    "yaw rate to the left": "rad/s",
    "heading": "rad",
    "time since start": "s",
}


@dataclass(frozen=True, slots=True)
class Bin:
    """A range of a variable, the mean residual there [Nm], and the probability that noise alone reaches it anywhere."""

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
        """Bins that stand out, the clearest first."""
        return tuple(sorted((b for b in self.bins if b.p < 0.05), key=lambda b: (b.p, -abs(b.mean_residual))))

    def likeliest(self, variable: str, low: float, high: float) -> float:
        """Least probability of the bins of a variable that reach into a range; 1 where none does."""
        return min((b.p for b in self.bins if b.variable == variable and b.low < high and b.high > low), default=1.0)


def regime_map(fit: Fit, rng: np.random.Generator, replicates: int = REPLICATES) -> RegimeMap:
    """Look at the residual of a fit by bins of every variable that varies.

    Notes
    -----
    The mean residual [Nm] is that of the plain residual; whether it counts is decided on the whitened one, against the
    largest over all bins when the signs of whole pieces are flipped at random (max-T).
    """
    labels, values = _variables(fit.problem.sessions, fit.predicted)
    rows = [w for w, g in zip(fit.white, fit.problem.segments, strict=True) if g.kind == "torque"]
    residuals = [r for r, g in zip(fit.residuals, fit.problem.segments, strict=True) if g.kind == "torque"]
    valid = np.isfinite(np.concatenate(rows))
    e, plain = np.concatenate(rows)[valid], np.concatenate(residuals)[valid]
    pieces = _pieces(rows)[valid]
    members, bins = [], []
    for name, series in zip(labels, values, strict=True):
        of = series[valid]
        for low, high in _edges(of):
            inside = (of >= low) & (of <= high)
            if inside.sum() >= FEWEST_IN_BIN:
                members.append(inside)
                bins.append((name, low, high, float(plain[inside].mean()), int(inside.sum())))
    if not bins:
        return RegimeMap((), 1.0, len(e))
    number = np.unique(pieces, return_inverse=True)[1]
    sums = np.array([np.bincount(number, weights=np.where(inside, e, 0.0), minlength=number.max() + 1) for inside in members])
    middle = sums - sums.mean(axis=1, keepdims=True) if sums.shape[1] > 1 else sums
    spread = np.sqrt((middle**2).sum(axis=1)) + 1e-12
    found = np.abs(sums.sum(axis=1)) / spread
    signs = rng.choice((-1.0, 1.0), (replicates, sums.shape[1]))
    reached = np.abs(signs @ middle.T / spread).max(axis=1)
    p = (1.0 + (reached[:, np.newaxis] >= found).sum(axis=0)) / (replicates + 1.0)
    return RegimeMap(
        tuple(Bin(n, lo, hi, mean, UNITS[n], count, float(q)) for (n, lo, hi, mean, count), q in zip(bins, p, strict=True)),
        float(p.min()),
        len(e),
    )


def cumulative_periodogram(fit: Fit) -> float:
    """Probability that white noise strays as far from a flat spectrum as the whitened residual (Bartlett's test)."""
    from scipy.stats import kstest

    power = []
    for white, segment in zip(fit.white, fit.problem.segments, strict=True):
        if segment.kind != "torque":
            continue
        e = np.nan_to_num(white)
        power.append(np.abs(np.fft.rfft(e)[1:-1]) ** 2)
    cumulative = np.cumsum(np.concatenate([p / p.sum() for p in power if p.sum() > 0])) / max(1, len(power))
    return float(kstest(cumulative[:-1], "uniform").pvalue)


def _variables(sessions: Sequence[Session], predicted: Sequence[Predicted]) -> tuple[list[str], list[Array]]:
    def all_of(name: str) -> Array:
        return np.concatenate([getattr(s, name) for s in sessions])

    found = {
        "speed": all_of("speed"),
        "acceleration": np.concatenate([s.accel_around for s in sessions]),
        "load": all_of("weight"),
        "belt temperature": np.concatenate([p.belt for p in predicted]),
        "ambient temperature": all_of("ambient"),
        "yaw rate": np.abs(all_of("yaw_rate")),
        "yaw rate to the left": all_of("yaw_rate"),
        "heading": np.angle(np.exp(1j * all_of("heading"))),
        "time since start": all_of("time"),
    }
    varies = {name: v for name, v in found.items() if np.isfinite(v).all() and np.ptp(v) > 1e-9 * max(1.0, np.abs(v).max())}
    return list(varies), list(varies.values())


def _edges(series: Array) -> list[tuple[float, float]]:
    edges = np.unique(np.quantile(series, np.linspace(0.0, 1.0, BINS + 1)))
    if len(edges) == 1:
        return [(float(edges[0]), float(edges[0]))]
    return [(float(a), float(b)) for a, b in pairwise(edges)]


def _pieces(rows: Sequence[Array]) -> NDArray[np.int64]:
    """Number of the piece whose sign is flipped as one, of each row."""
    first, found = 0, []
    for row in rows:
        found.append(first + np.arange(len(row)) // FLIPPED_TOGETHER)
        first = int(found[-1][-1]) + 1
    return np.concatenate(found)
