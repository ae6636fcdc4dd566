# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A slope or a torque by place: a smooth function along the streets of a route, learned from what is left on passes of them.

Between neighbouring places it is a Gaussian process, as smooth as the likelihood has it; the precision of it on the graph of
streets is sparse, so that thousands of places take a fraction of a second.

Source: Lindgren, Rue, Lindstroem (2011) for the precision on a graph, of which Ornstein and Uhlenbeck's process is the member
that never runs beyond what it saw on either side; Laird and Ware (1982) for the evidence of random effects.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from trackres_ros.diagnosis.inference.noise import MOST_LAGS, Noise, whitened, whole_past
from trackres_ros.route.matching import SPACING_M, Matched

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LENGTHS_M = (50.0, 100.0, 200.0, 400.0, 800.0, 1600.0)  # over which places are alike, that are tried
SIZES = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)  # of what is learned over the spread of the residual, that are tried
TURNS = 4  # of values and weights
AT_ONCE = 256  # columns of a solution
NEAREST_M = 0.25 * SPACING_M  # two places are taken to lie at least so far apart
FLOOR = 1e-9  # of the prior's precision, so that places without a neighbour have one


@dataclass(frozen=True, eq=False)
class Streets:
    """The graph of places.

    Attributes
    ----------
    first, second
        Neighbours, shape (pairs,).
    sign
        1 where a rise along one is a rise along the other, else -1.
    away
        Distance between them [m].
    count
        Number of places.
    """

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    sign: Array
    away: Array
    count: int

    @classmethod
    def of(cls, pairs: Mapping[tuple[int, int], float], table: Array) -> Streets:
        """Of neighbours and whether they point the same way, and of the places' table; see `route.matching`."""
        ends = np.array(list(pairs), dtype=np.int64).reshape(-1, 2)
        away = np.hypot(*(table[ends[:, 0], :2] - table[ends[:, 1], :2]).T)
        return cls(ends[:, 0], ends[:, 1], np.array(list(pairs.values()), dtype=float), np.maximum(away, NEAREST_M), len(table))

    def both_ways(self) -> Streets:
        """With two places for each: one passed the way it points, one passed the other way."""
        turned = (self.sign < 0.0).astype(np.int64)
        return Streets(
            np.concatenate([2 * self.first, 2 * self.first + 1]),
            np.concatenate([2 * self.second + turned, 2 * self.second + 1 - turned]),
            np.ones(2 * len(self.sign)),
            np.tile(self.away, 2),
            2 * self.count,
        )

    def precision(self, length_m: float, size: float) -> sparse.csc_matrix:
        """Of values at the places, which are alike over a length and of a standard deviation."""
        stiff = 1.0 / self.away
        i, j, n = self.first, self.second, self.count
        rows, columns = np.concatenate([i, j, i, j]), np.concatenate([i, j, j, i])
        laplace = sparse.coo_matrix(
            (np.concatenate([stiff, stiff, -stiff * self.sign, -stiff * self.sign]), (rows, columns)), (n, n)
        )
        mass = sparse.identity(n) * (SPACING_M / length_m**2)
        return ((mass + laplace) * (0.5 * length_m / size**2) + sparse.identity(n) * (FLOOR / size**2)).tocsc()


@dataclass(frozen=True, eq=False)
class Columns:
    """What each place's value adds to the torque of each session: sparse, of shape (samples, values), and the streets that
    the values lie along.
    """

    of: tuple[sparse.csr_matrix, ...]
    streets: Streets

    @classmethod
    def of_slope(cls, tracks: Sequence[Matched], forces: Sequence[Array], streets: Streets) -> Columns:
        """Of the sine of a slope, rising the way a place points; forces are weight times radius, along travel [Nm]."""
        return cls(tuple(_column(t, t.place, t.sign, f, streets.count) for t, f in zip(tracks, forces, strict=True)), streets)

    @classmethod
    def of_torque(cls, tracks: Sequence[Matched], against: Sequence[Array], streets: Streets) -> Columns:
        """Of a torque against travel, one each way; `against` has the sign of that at each sample."""
        both = streets.both_ways()
        place = [np.where(t.place >= 0, 2 * t.place + (t.sign < 0.0), -1) for t in tracks]
        every = zip(tracks, place, against, strict=True)
        return cls(tuple(_column(t, p, np.ones_like(t.share), a, both.count) for t, p, a in every), both)

    def expected(self, value: Array) -> list[Array]:
        """Torque of each session by the values of the places."""
        return [np.asarray(z @ value) for z in self.of]


def _column(track: Matched, place: NDArray[np.int64], sign: Array, factor: Array, count: int) -> sparse.csr_matrix:
    rows = np.flatnonzero(track.known & np.isfinite(factor))
    data = (track.share * sign)[rows] * factor[rows, np.newaxis]
    at = (np.repeat(rows, 2), place[rows].ravel())
    return sparse.coo_matrix((data.ravel(), at), (len(track.number), count)).tocsr()


@dataclass(frozen=True, eq=False)
class Learned:
    """Values by place.

    Attributes
    ----------
    value
        Of each place.
    length_m, size
        Over which places are alike, and how large values are.
    evidence
        Gain in log-likelihood over no values, less what the values cost.
    cost
        What the values, and the length and size that were tried, cost.
    noise
        Under which it was learned.
    """

    value: Array
    length_m: float
    size: float
    evidence: float
    cost: float
    noise: Noise
    _solve: SuperLU = field(repr=False)

    def std(self, of: NDArray[np.int64]) -> Array:
        """Standard deviation of the values of some places."""
        found = np.empty(len(of))
        for some in np.array_split(np.arange(len(of)), max(1, len(of) // AT_ONCE)):
            unit = np.zeros((len(self.value), len(some)))
            unit[of[some], np.arange(len(some))] = 1.0
            found[some] = self._solve.solve(unit)[of[some], np.arange(len(some))]
        return np.sqrt(np.maximum(found, 0.0))


def learn(columns: Columns, residuals: Sequence[Array], masks: Sequence[Mask], noise: Noise, typical: float) -> Learned:
    """The most likely values, and length and size with the most evidence.

    Parameters
    ----------
    residuals, masks
        Of the torque of each session [Nm], and which of its samples count.
    noise
        Of the residuals without what goes by place.
    typical
        A value that makes as much torque as the residual has.
    """
    rows = _Rows.of(columns, residuals, masks, noise)
    tried: dict[tuple[int, int], Learned] = {}

    def at(i: int, j: int) -> Learned:
        if (i, j) not in tried:
            tried[i, j] = _learned(rows, columns.streets, LENGTHS_M[i], SIZES[j] * typical)
        return tried[i, j]

    i, j = len(LENGTHS_M) // 2, len(SIZES) // 2
    while True:
        around = [(i + a, j + b) for a, b in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))]
        inside = [(a, b) for a, b in around if 0 <= a < len(LENGTHS_M) and 0 <= b < len(SIZES)]
        best = max(inside, key=lambda one: at(*one).evidence)
        if best == (i, j):
            break
        i, j = best
    choices = math.log(len(LENGTHS_M) * len(SIZES))
    found = tried[i, j]
    return replace(found, evidence=found.evidence - choices, cost=found.cost + choices)


def gained(columns: Columns, value: Array, residuals: Sequence[Array], masks: Sequence[Mask], noise: Noise) -> float:
    """Gain in log-likelihood of values that were learned elsewhere."""
    rows = _Rows.of(columns, residuals, masks, noise)
    return float((noise.log_density(rows.white - rows.columns @ value) - noise.log_density(rows.white)).sum())


@dataclass(frozen=True, eq=False)
class _Rows:
    """Whitened residuals over their standard deviation, and what the values add to them."""

    white: Array
    columns: sparse.csr_matrix
    noise: Noise

    @classmethod
    def of(cls, columns: Columns, residuals: Sequence[Array], masks: Sequence[Mask], noise: Noise) -> _Rows:
        white, parts = [], []
        for residual, mask, column in zip(residuals, masks, columns.of, strict=True):
            used = mask & np.isfinite(residual)
            rows = np.flatnonzero(whole_past(used, MOST_LAGS))
            white.append(whitened(residual, used, noise.phi)[rows] / noise.std)
            part = column[rows]
            for lag, coefficient in enumerate(noise.phi, start=1):
                part = part - coefficient * column[rows - lag]
            parts.append(part / noise.std)
        return cls(np.concatenate(white), sparse.vstack(parts).tocsr(), noise)


def _learned(rows: _Rows, streets: Streets, length_m: float, size: float) -> Learned:
    prior = streets.precision(length_m, size)
    value, noise = np.zeros(streets.count), rows.noise
    for _ in range(TURNS):
        weighted = rows.columns.multiply(noise.weights(rows.white - rows.columns @ value)[:, np.newaxis]).tocsr()
        solve = _factored((rows.columns.T @ weighted + prior).tocsc())
        value = solve.solve(weighted.T @ rows.white)
    cost = 0.5 * float(value @ (prior @ value)) + 0.5 * (_log_determinant(solve) - _log_determinant(_factored(prior)))
    gain = float((noise.log_density(rows.white - rows.columns @ value) - noise.log_density(rows.white)).sum())
    return Learned(value, length_m, size, gain - cost, cost, noise, solve)


def _factored(precision: sparse.csc_matrix) -> SuperLU:
    options = {"SymmetricMode": True}
    return splu(precision, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)


def _log_determinant(factored: SuperLU) -> float:
    return float(np.log(np.abs(factored.U.diagonal())).sum())
