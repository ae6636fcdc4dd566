# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A slope or a torque by place: a smooth function along the streets of a route, learned from the residual on repeated passes.

The prior is a Gaussian process over neighbouring places, with its smoothness from the likelihood. Its precision on the
graph of streets is sparse, so thousands of places take a fraction of a second.

Source: Lindgren, Rue, Lindstroem (2011) for the precision on a graph, here of the Ornstein-Uhlenbeck process, which
never extrapolates beyond its neighbours' values; Laird and Ware (1982) for the evidence of random effects.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from trackres_ros.diagnosis.inference.noise import Noise, autoregression
from trackres_ros.diagnosis.prepare.session import Array, Mask, whole_past
from trackres_ros.route.lookup import SPACING_M
from trackres_ros.route.matching import Matched
from trackres_ros.route.track import STEP_M

LENGTHS_M = (50.0, 100.0, 200.0, 400.0, 800.0, 1600.0)  # candidate correlation lengths
SIZES = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)  # candidate sizes of the values, relative to the residual's spread
TURNS = 6  # of values and weights
AT_ONCE = 256  # columns solved together
PROBES = 16  # for a trace (Hutchinson, 1990)
LEAST_LEFT = 0.1  # least share of the samples left as degrees of freedom
LONGEST_RESPONSE = 1000  # samples, after which the response to a shock is negligible
NEAREST_M = 0.25 * SPACING_M  # least distance between two places
FLOOR = 1e-9  # of the prior's precision, for places without a neighbour
LEAST_LOOP_M = 500.0  # a shorter one says little about a mean slope
CLOSED_M = 1.0  # standard deviation of the rise round a loop: its ends may lie 25 m aside of each other
SAME_LOOP = 0.5  # share of common places


@dataclass(frozen=True, eq=False)
class StreetGraph:
    """Neighbouring places, arrays of shape (pairs,)."""

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    sign: Array  # 1 where a rise along one is a rise along the other, else -1
    distances: Array  # distance between them [m]
    count: int  # of places
    closed_loops: sparse.csr_matrix  # (loops, places): times slopes, the rise round each closed loop [m], which is zero

    @classmethod
    def of(cls, pairs: Mapping[tuple[int, int], float], table: Array, tracks: Sequence[Matched]) -> StreetGraph:
        """From neighbours and whether they point the same way, and the places' table, see `route.matching`; and tracks that may
        go round closed loops.
        """
        ends = np.array(list(pairs), dtype=np.int64).reshape(-1, 2)
        distances = np.hypot(*(table[ends[:, 0], :2] - table[ends[:, 1], :2]).T)
        sign, distances = np.array(list(pairs.values()), dtype=float), np.maximum(distances, NEAREST_M)
        return cls(ends[:, 0], ends[:, 1], sign, distances, len(table), _closed_loops(tracks, len(table)))

    def both_ways(self) -> StreetGraph:
        """Graph with two nodes per place, one for each direction of passing."""
        is_reversed = (self.sign < 0.0).astype(np.int64)
        return StreetGraph(
            np.concatenate([2 * self.first, 2 * self.first + 1]),
            np.concatenate([2 * self.second + is_reversed, 2 * self.second + 1 - is_reversed]),
            np.ones(2 * len(self.sign)),
            np.tile(self.distances, 2),
            2 * self.count,
            sparse.csr_matrix((0, 2 * self.count)),  # a torque has a mean
        )

    def precision(self, length_m: float, size: float) -> sparse.csc_matrix:
        """Prior precision of the values, for a correlation length and a standard deviation."""
        stiffness = 1.0 / self.distances
        i, j, n = self.first, self.second, self.count
        rows, columns = np.concatenate([i, j, i, j]), np.concatenate([i, j, j, i])
        laplace = sparse.coo_matrix(
            (np.concatenate([stiffness, stiffness, -stiffness * self.sign, -stiffness * self.sign]), (rows, columns)), (n, n)
        )
        mass = sparse.identity(n) * (SPACING_M / length_m**2)
        return ((mass + laplace) * (0.5 * length_m / size**2) + sparse.identity(n) * (FLOOR / size**2)).tocsc()


def _closed_loops(tracks: Sequence[Matched], count: int) -> sparse.csr_matrix:
    """Loops that a track goes round without a gap, back to a place in the same direction; each loop once."""
    rows, known_loops = [], list[set[int]]()
    for track in tracks:
        nearest_places = np.arange(len(track.number)), np.argmax(track.share, axis=1)
        first_steps = dict[tuple[int, float], int]()
        for i, node in enumerate(zip(track.place[nearest_places].tolist(), track.sign[nearest_places].tolist(), strict=True)):
            if node[0] < 0:
                first_steps.clear()
                continue
            begin = first_steps.setdefault(node, i)
            if (i - begin) * STEP_M < LEAST_LOOP_M:
                continue
            first_steps = {node: i}
            place, rise = track.place[begin:i], STEP_M * (track.share * track.sign)[begin:i]
            loop = set(place.ravel().tolist())
            if all(len(loop & known_loop) < SAME_LOOP * len(loop | known_loop) for known_loop in known_loops):
                known_loops.append(loop)
                rows.append(np.bincount(place.ravel(), rise.ravel(), count))
    return sparse.csr_matrix(np.reshape(rows, (len(rows), count)))


@dataclass(frozen=True, eq=False)
class PlaceColumns:
    """Torque of each session per value of each place, shape (samples, values), and the graph of the values."""

    torques: tuple[sparse.csr_matrix, ...]
    streets: StreetGraph

    @classmethod
    def of_slope(cls, tracks: Sequence[Matched], forces: Sequence[Array], streets: StreetGraph) -> PlaceColumns:
        """For the sine of a slope, rising in a place's direction; forces are the torque per sine along travel [Nm]. A track has
        the same number of points in each sample of a session.
        """
        return cls(tuple(_column(t, t.place, t.sign, f, streets.count) for t, f in zip(tracks, forces, strict=True)), streets)

    @classmethod
    def of_torque(cls, tracks: Sequence[Matched], resistances: Sequence[Array], streets: StreetGraph) -> PlaceColumns:
        """For a torque against travel, one per direction; `resistances` is what a sensor shows of it at each sample."""
        graph = streets.both_ways()
        place = [np.where(t.place >= 0, 2 * t.place + (t.sign < 0.0), -1) for t in tracks]
        rows = zip(tracks, place, resistances, strict=True)
        return cls(tuple(_column(t, p, np.ones_like(t.share), a, graph.count) for t, p, a in rows), graph)

    def expected(self, place_values: PlaceValues) -> list[Array]:
        """Torque of each session from the values of the places."""
        return [np.asarray(z @ place_values.value) for z in self.torques]


def _column(track: Matched, place: NDArray[np.int64], sign: Array, factor: Array, count: int) -> sparse.csr_matrix:
    """Means over the points within each sample; zero if any of them is at no place."""
    points = len(track.number) // len(factor)
    is_known = np.repeat(track.is_known.reshape(-1, points).all(axis=1), points)
    sample = np.repeat(np.arange(len(factor)), points)
    rows = np.flatnonzero(is_known)
    data = (track.share * sign)[rows] * factor[sample[rows], np.newaxis] / points
    indices = (np.repeat(sample[rows], 2), place[rows].ravel())
    return sparse.coo_matrix((data.ravel(), indices), (len(factor), count)).tocsr()


@dataclass(frozen=True, eq=False)
class PlaceValues:
    """Values by place."""

    value: Array
    length_m: float  # correlation length
    size: float  # standard deviation of the values
    evidence: float  # gain in log-likelihood over no values, less `cost`
    cost: float  # of the values, and of the tried lengths and sizes
    noise: Noise  # assumed for the fit
    shrinks: float  # residual over noise, because so many values are fitted
    _solve: SuperLU = field(repr=False)

    def relearned(self, columns: PlaceColumns, residuals: Sequence[Array], masks: Sequence[Mask]) -> Array:
        """Values from other samples, with this length, size and noise, and a fixed base."""
        rows = WhitenedRows.of(columns.torques, residuals, masks, self.noise)
        return _place_values(rows, columns.streets, np.empty(0), self.length_m, self.size).value

    def std(self, places: NDArray[np.int64]) -> Array:
        """Standard deviation of the values of some places."""
        variances = np.empty(len(places))
        for indices in np.array_split(np.arange(len(places)), max(1, len(places) // AT_ONCE)):
            unit = np.zeros((self._solve.shape[0], len(indices)))
            unit[places[indices], np.arange(len(indices))] = 1.0
            variances[indices] = self._solve.solve(unit)[places[indices], np.arange(len(indices))]
        return np.sqrt(np.maximum(variances, 0.0))

    def std_of_mean(self, places: NDArray[np.int64]) -> float:
        """Standard deviation of the mean of the values of some places."""
        share = np.bincount(places, minlength=self._solve.shape[0]) / len(places)
        return math.sqrt(max(float(share @ self._solve.solve(share)), 0.0))


@dataclass(frozen=True, eq=False)
class BaseColumns:
    """Parameters to fit along with the values of places."""

    torques: Sequence[Array]  # torque of each session for one standard deviation of each, shape (samples, parameters)
    off: Array  # (parameters,), their values in the residuals less those of the vehicle file, in standard deviations


def learn(
    columns: PlaceColumns,
    residuals: Sequence[Array],
    masks: Sequence[Mask],
    noise: Noise,
    typical_size: float,
    base: BaseColumns | None = None,
) -> PlaceValues:
    """Most likely values, with the length and size of the most evidence.

    Parameters
    ----------
    residuals, masks
        Torque residual of each session [Nm], and its used samples.
    noise
        Of the residuals without terms by place.
    typical_size
        A value with a torque as large as the residual.
    base
        Parameters to fit along. Their prior is about the values of the file, whatever the last fit found: a mean slope on
        one-way streets is the same column as a resistance, so both would walk away from turn to turn.
    """
    base_offset, columns_with_base = np.empty(0), list(columns.torques)
    if base is not None:
        base_offset, columns_with_base = (
            base.off,
            [sparse.hstack([z, sparse.csr_matrix(b)]).tocsr() for z, b in zip(columns_with_base, base.torques, strict=True)],
        )
    rows = WhitenedRows.of(columns_with_base, residuals, masks, noise)
    values: dict[tuple[int, int], PlaceValues] = {}

    def values_at(i: int, j: int) -> PlaceValues:
        if (i, j) not in values:
            values[i, j] = _place_values(rows, columns.streets, base_offset, LENGTHS_M[i], SIZES[j] * typical_size)
        return values[i, j]

    i, j = len(LENGTHS_M) // 2, len(SIZES) // 2
    while True:
        neighbours = [(i + a, j + b) for a, b in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))]
        pairs_inside = [(a, b) for a, b in neighbours if 0 <= a < len(LENGTHS_M) and 0 <= b < len(SIZES)]
        best_pair = max(pairs_inside, key=lambda pair: values_at(*pair).evidence)
        if best_pair == (i, j):
            break
        i, j = best_pair
    choices = math.log(len(LENGTHS_M) * len(SIZES))
    best_values, (gain, cost) = values[i, j], _base_gain(rows, base_offset)
    return replace(best_values, evidence=best_values.evidence - (gain - cost) - choices, cost=best_values.cost - cost + choices)


def gains(columns: PlaceColumns, values: Array, residuals: Sequence[Array], masks: Sequence[Mask], noise: Noise) -> Array:
    """Gain in log-likelihood by values learned elsewhere, each a column; shape (columns,)."""
    rows = WhitenedRows.of(columns.torques, residuals, masks, noise)
    remainder = rows.white[:, np.newaxis] - rows.columns @ values
    return np.asarray((noise.log_density(remainder) - noise.log_density(rows.white)[:, np.newaxis]).sum(axis=0))


@dataclass(frozen=True, eq=False)
class WhitenedRows:
    """Whitened residuals over their standard deviation, and their columns. The first of a stretch, without a known
    past, is used by itself: braking leaves short stretches of some seconds on a street.
    """

    white: Array
    columns: sparse.csr_matrix
    noise: Noise

    @classmethod
    def of(
        cls, columns: Sequence[sparse.csr_matrix], residuals: Sequence[Array], masks: Sequence[Mask], noise: Noise
    ) -> WhitenedRows:
        """From the used residual of each session, and its columns."""
        white, parts, lags = [], [], len(noise.phi)
        stationary = noise.std * _growth(noise.phi)
        for residual, mask, column in zip(residuals, masks, columns, strict=True):
            used_steps = mask & np.isfinite(residual)
            rows, begin_rows = (
                np.flatnonzero(whole_past(used_steps, lags)),
                np.flatnonzero(used_steps & ~np.concatenate(([False], used_steps[:-1]))),
            )
            remainder, part = residual[rows], column[rows]
            for lag, coefficient in enumerate(noise.phi, start=1):
                remainder, part = remainder - coefficient * residual[rows - lag], part - coefficient * column[rows - lag]
            begin_rows = begin_rows if lags else begin_rows[:0]
            white += [remainder / noise.std, residual[begin_rows] / stationary]
            parts += [part / noise.std, column[begin_rows] / stationary]
        return cls(np.concatenate(white), sparse.vstack(parts).tocsr(), noise)


def _growth(phi: Array) -> float:
    """Standard deviation of an autoregression over that of its innovations."""
    response = autoregression(np.eye(1, LONGEST_RESPONSE)[0], phi)
    return float(np.sqrt(np.sum(response**2)))


def _base_gain(rows: WhitenedRows, base_offset: Array) -> tuple[float, float]:
    """Gain in log-likelihood of the base columns without terms by place, and its cost."""
    columns, noise, weight = (
        rows.columns[:, rows.columns.shape[1] - len(base_offset) :].toarray(),
        rows.noise,
        np.ones(len(rows.white)),
    )
    for _ in range(TURNS):
        normal = (columns.T * weight) @ columns + np.eye(len(base_offset))
        value = np.linalg.solve(normal, (columns.T * weight) @ rows.white - base_offset)
        weight = noise.weights(rows.white - columns @ value)
    gain = float((noise.log_density(rows.white - columns @ value) - noise.log_density(rows.white)).sum())
    distance = value + base_offset
    return gain, 0.5 * float(distance @ distance) + 0.5 * float(np.linalg.slogdet(normal)[1])


def _place_values(rows: WhitenedRows, streets: StreetGraph, base_offset: Array, length_m: float, size: float) -> PlaceValues:
    """Values with this prior. Loops close where the base is free: else a wrong base has a mean slope as its only way out."""
    closed_loops = streets.closed_loops if len(base_offset) else streets.closed_loops[:0]
    loops, count = closed_loops.shape[0], len(base_offset)
    prior = sparse.block_diag([streets.precision(length_m, size), sparse.identity(count)])
    closed_loops = sparse.hstack([closed_loops, sparse.csr_matrix((loops, count))])
    # Multipliers of the loops keep the matrix sparse; its inverse and its quadratic form are those without them.
    prior = sparse.bmat([[prior, closed_loops.T], [closed_loops, -(CLOSED_M**2) * sparse.identity(loops)]]).tocsc()
    columns = sparse.hstack([rows.columns, sparse.csr_matrix((len(rows.white), loops))]).tocsr()
    shift = np.concatenate([np.zeros(streets.count), base_offset, np.zeros(loops)])
    noise, weight = rows.noise, np.ones(len(rows.white))  # without values, steep places would look like outliers
    for _ in range(TURNS):
        weighted_columns = columns.multiply(weight[:, np.newaxis]).tocsr()
        solve = _factorise((columns.T @ weighted_columns + prior).tocsc())
        value = solve.solve(weighted_columns.T @ rows.white - shift)
        weight = noise.weights(rows.white - columns @ value)
    distance = value + shift
    cost = 0.5 * float(distance @ (prior @ distance)) + 0.5 * (_log_determinant(solve) - _log_determinant(_factorise(prior)))
    gain = float((noise.log_density(rows.white - columns @ value) - noise.log_density(rows.white)).sum())
    probes = np.random.default_rng(0).choice((-1.0, 1.0), (len(value), PROBES))
    determined_count = float(
        np.mean((probes * solve.solve(columns.T @ (weighted_columns @ probes))).sum(axis=0))
    )  # values set by the data
    shrinkage = math.sqrt(
        max(1.0 - determined_count / max(len(rows.white), 1), LEAST_LEFT)
    )  # without samples no value is set by any
    return PlaceValues(value[: streets.count], length_m, size, gain - cost, cost, noise, shrinkage, solve)


def _factorise(precision: sparse.csc_matrix) -> SuperLU:
    return splu(precision, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def _log_determinant(factored: SuperLU) -> float:
    return float(np.log(np.abs(factored.U.diagonal())).sum())
