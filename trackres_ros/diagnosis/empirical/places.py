# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds a torque that repeats with distance, or at the same place of a route on each pass.

A rotating part of a belt or a wheel repeats with distance. Source: Lomb (1976) and Scargle (1982), over distance instead of
time, on residuals whitened as in the fit. The step means of a short wave are smaller by the sinc of step over wavelength, which
is exact here.

A slope, soft ground or a bend is at a place. The driven distance is folded with many lap lengths. Each place of the lap has its
own mean with a zero-mean prior (random effects; Laird and Ware 1982). So the evidence of a length includes the cost of its
places. A result must hold on passes not used for learning.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebval
from numpy.typing import NDArray
from scipy.special import gammainccinv

from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.inference.noise import SHORT_ROOT, Noise, estimate_noise, whitened
from trackres_ros.diagnosis.prepare.session import MOST_LAGS, Array, DriveSession, Mask, whole_past

SHORTEST_M, LONGEST_M = 3.0, 400.0
PIECE_M = 4000.0  # with a constant phase: the integrated distance slips
FEWEST_SAMPLES = 60  # of a piece
WAVE_STEPS = 3.0  # steps of the grid within the resolution of a piece
CHANCE = 0.002  # probability that noise alone reaches it anywhere in the grid
REMEMBERED_M = 1000.0  # averaging length of a followed phase
SAME_LENGTH = 0.03  # relative: slip and wear of a rotating part
NEARLY_LARGEST = 12  # of the grid, fitted exactly
WAVES_AT_ONCE = 64
MOST_PARTS = 4  # turns of a short part in one wave


@dataclass(frozen=True, eq=False)
class Wave:
    """A wave in driven distance: its length [m], size [Nm], number of fitted phases, and its course, about 1 at its crests."""

    length_m: float
    size: float
    phases: int
    shape: tuple[Array, ...]


@dataclass(frozen=True, eq=False)
class _Piece:
    """A stretch of a session: its rows, the distance at the edges of each step [m], and the whitened residual."""

    session: int
    rows: slice
    edges: Array
    white: Array
    is_valid: NDArray[np.bool_]


def find_wave(fit: Fit) -> Wave | None:
    """The wave with the largest gain in the residual of a fit; None if not significant."""
    pieces = _pieces(fit)
    if not pieces:
        return None
    longest_m = max(float(p.edges[-1] - p.edges[0]) for p in pieces)
    waves = np.arange(1.0 / LONGEST_M, 1.0 / SHORTEST_M, 1.0 / (WAVE_STEPS * longest_m))  # per metre
    gains = np.sum([_gains(fit, p, waves) for p in pieces], axis=0)
    scale = max(1.0, float(np.median(gains)) / float(gammainccinv(len(pieces), 0.5)))
    per_metre, gain = max(
        (
            (float(waves[i]), sum(_fit_wave(fit, p, float(waves[i]))[1] for p in pieces))
            for i in np.argsort(gains)[-NEARLY_LARGEST:]
        ),
        key=lambda pair: pair[1],
    )
    return None if gain / scale < float(gammainccinv(len(pieces), CHANCE / len(waves))) else _wave(fit, pieces, per_metre)


def part_of(length_m: float, parts: Mapping[str, float]) -> str:
    """Part with this length per turn, or per a few turns [m]; empty without one."""
    for name, turn_m in parts.items():
        for times in range(1, MOST_PARTS + 1):
            if abs(times * turn_m / length_m - 1.0) < SAME_LENGTH:
                return f"one turn of the {name}" if times == 1 else f"{times} turns of the {name}"
            if times > 1 and abs(turn_m / times / length_m - 1.0) < SAME_LENGTH:
                return f"1/{times} of a turn of the {name}"
    return ""


def _pieces(fit: Fit) -> list[_Piece]:
    pieces = []
    for i, (session, white) in enumerate(zip(fit.problem.sessions, fit.white, strict=False)):
        edges = np.concatenate(([0.0], np.cumsum(np.abs(np.nan_to_num(session.speed))) * session.step))
        number = (edges[:-1] // PIECE_M).astype(int)
        for n in np.unique(number):
            indices = np.flatnonzero(number == n)
            rows = slice(int(indices[0]), int(indices[-1]) + 1)
            is_valid = np.isfinite(white[rows])
            if is_valid.sum() >= FEWEST_SAMPLES:
                pieces.append(_Piece(i, rows, edges[rows.start : rows.stop + 1], white[rows], is_valid))
    return pieces


def _mean_wave(edges: Array, per_metre: float) -> NDArray[np.complex128]:
    """Mean over each step of a wave of size 1."""
    turns = 2.0 * math.pi * per_metre * edges
    angles, middles = np.diff(turns), np.exp(0.5j * (turns[1:] + turns[:-1]))
    return np.asarray(middles * np.sinc(angles / (2.0 * math.pi)))


def _fit_wave(fit: Fit, piece: _Piece, per_metre: float) -> tuple[complex, float]:
    """Complex size of the wave in a piece [Nm], and the gain in log-likelihood."""
    noise, wave, e = fit.noise, _mean_wave(piece.edges, per_metre), piece.white[piece.is_valid]
    mask = np.ones(len(wave), dtype=bool)
    parts = [np.nan_to_num(whitened(part, mask, noise.phi) / noise.std) for part in (wave.real, -wave.imag)]
    design, weight = np.stack(parts, axis=1)[piece.is_valid], noise.weights(e)
    normal = (design * weight[:, np.newaxis]).T @ design + 1e-9 * np.eye(2)
    right_side = design.T @ (weight * e)
    size = np.linalg.solve(normal, right_side)
    return complex(size[0], size[1]), 0.5 * float(right_side @ size)


def _gains(fit: Fit, piece: _Piece, waves: Array) -> Array:
    """Gains of many waves, for a steady speed over the lags of the whitening; `_fitted` is exact."""
    noise = fit.noise
    weighted_residual = (
        np.where(piece.is_valid, noise.weights(np.nan_to_num(piece.white)) * np.nan_to_num(piece.white), 0.0) / noise.std
    )
    adjoint = weighted_residual.copy()  # of the whitening
    for lag, coefficient in enumerate(noise.phi, start=1):
        adjoint[:-lag] -= coefficient * weighted_residual[lag:]
    middle, lengths = 0.5 * (piece.edges[1:] + piece.edges[:-1]), np.diff(piece.edges)
    rows = np.flatnonzero((lengths > 0.0) | (adjoint != 0.0))
    middle, lengths, adjoint, is_valid = middle[rows], lengths[rows], adjoint[rows], piece.is_valid[rows]
    offsets = (waves[1] - waves[0]) * np.arange(WAVES_AT_ONCE)[:, np.newaxis]  # the same from the first wave of each block
    rotations, half_rotations = np.exp(2j * math.pi * offsets * middle), np.exp(1j * math.pi * offsets * lengths)
    gains = []
    for first_wave in waves[::WAVES_AT_ONCE]:
        half_rotation = half_rotations * np.exp(1j * math.pi * first_wave * lengths)
        angle = math.pi * (first_wave + offsets) * lengths
        size = np.divide(half_rotation.imag, angle, out=np.ones_like(angle), where=angle > 0.0)
        projections = (rotations * size) @ (np.exp(2j * math.pi * first_wave * middle) * adjoint)
        norm = 0.5 * (_power_share(noise.phi, half_rotation.real) * size**2) @ is_valid / noise.std**2
        gains.append(0.5 * np.abs(projections) ** 2 / np.maximum(norm, 1e-9))
    return np.concatenate(gains)[: len(waves)]


def _power_share(phi: Array, cosine: Array) -> Array:
    """Share of a wave's power after whitening, |1 - phi_1 z - ...|^2, from the cosine of half the angle of z."""
    filtered = np.concatenate(([1.0], -phi))
    series = np.correlate(filtered, filtered, "full")[len(phi) :]
    return np.asarray(chebval(2.0 * cosine**2 - 1.0, np.append(series[0], 2.0 * series[1:])))


def _wave(fit: Fit, pieces: list[_Piece], per_metre: float) -> Wave:
    sizes = [_fit_wave(fit, piece, per_metre)[0] for piece in pieces]
    shape = [np.zeros(len(s)) for s in fit.problem.sessions]
    for piece, size in zip(pieces, sizes, strict=True):
        wave = _mean_wave(piece.edges, per_metre)
        course = np.exp(1j * np.angle(size)) * wave
        shape[piece.session][piece.rows] = course.real
    weights = [piece.is_valid.sum() for piece in pieces]
    return Wave(1.0 / per_metre, float(np.average(np.abs(sizes), weights=weights)), len(pieces), tuple(shape))


def wave_forecast(wave: Wave, residuals: Sequence[Array], sessions: Sequence[DriveSession]) -> list[Array]:
    """The wave at each sample over its size, with phase and size from earlier samples: an exponential mean."""
    forecasts = []
    for residual, session in zip(residuals, sessions, strict=True):
        metres = np.abs(np.nan_to_num(session.speed)) * session.step
        waves = _mean_wave(np.concatenate(([0.0], np.cumsum(metres))), 1.0 / wave.length_m)
        ratios = np.where(session.used & np.isfinite(residual), residual, 0.0) / wave.size
        decay = np.exp(-metres / REMEMBERED_M)
        correlation, weight, forecast = 0.0j, FEWEST_SAMPLES / 4.0, np.zeros(len(session))
        for t, (x, w, keep, is_used) in enumerate(
            zip(ratios.tolist(), waves.tolist(), decay.tolist(), session.used.tolist(), strict=True)
        ):
            forecast[t] = (correlation.conjugate() * w).real / weight if is_used else 0.0
            correlation = keep * correlation + 2.0 * x * w
            weight = keep * (weight - FEWEST_SAMPLES / 4.0) + abs(w) ** 2 * is_used + FEWEST_SAMPLES / 4.0
        forecasts.append(forecast)
    return forecasts


Indices = NDArray[np.int64]

SHORTEST_LAP_M = LONGEST_M  # a shorter period is a wave
BIN_M = 25.0
WIDTHS = (1, 2, 4)  # bins of a place
FEWEST_PASSES = 3
FEWEST_BINS = 60  # least number for a search
PRIORS = (1.0, 4.0, 16.0)  # variance of a place's torque over that of its mean
MOST_WORSE = 0.25  # of the passes: allowed share that the others' mean does not improve
WHOLE = 0.5  # of a lap: a shorter pass is ignored
SIZES = tuple(np.geomspace(0.03, 10.0, 12))  # of a place's torque over the residual's standard deviation
FEWEST_PLACES = 4
SURE = 10.0  # in log-likelihood, beyond the cost of the tried lengths
FURTHEST = 3.0  # standard deviations
EDGES_M, MOST_MOVED = (12.5, 2.5), 6  # search steps for the edges of the range, and their number
HALF = 0.5  # of the largest torque: limit of the range
AT_ONCE = 200_000  # stretches or places of lap lengths, which fit into the cache of a processor
SOME = 8  # one length in so many shows the gain by chance
FINER, MOST_OFF = 0.0005, 8  # search steps for the length, and their number


@dataclass(frozen=True, eq=False)
class Place:
    """A torque by the place in a lap. Each recording is one pass of the same route where it is not `folded`."""

    lap_m: float  # by the odometer; of the longest recording where not `folded`
    size: float  # mean additional torque in its range, relative to the rest of the lap [Nm]
    begin_m: float  # of its range, from the start of a lap
    end_m: float  # beyond the end of the lap if it crosses that
    passes: int  # on the fitted laps
    is_folded: bool  # whether a recording has consecutive laps
    cost: float  # of length and places, in log-likelihood
    course: tuple[Array, ...]  # place in the lap at each sample of each session [m]
    shape: tuple[Array, ...]  # torque there, with mean 1 in its range


@dataclass(frozen=True, eq=False)
class _Bins:
    """Stretches of `BIN_M` of all sessions, with compared samples; arrays of shape (n,)."""

    positions: Array  # middle of each from the start of its session [m], negative as in `finders.driven_along`
    session: Indices
    white: Array  # mean residual, whitened over distance, limited to `FURTHEST`


@dataclass(frozen=True, eq=False)
class _Rows:
    """Samples of all sessions: distances and loads as in `find_place`, and the whitened measurements."""

    distances: Sequence[Array]
    loads: Sequence[Array]
    masks: Sequence[Mask]
    noise: Noise
    white: Array
    weight: Array
    spread: float

    @classmethod
    def of(
        cls, distances: Sequence[Array], residuals: Sequence[Array], remainder: Sequence[Array], masks: Sequence[Mask],
        loads: Sequence[Array],
    ) -> _Rows:  # fmt: skip
        """Whiten the residuals, with the noise of the `remainder`."""
        noise = estimate_noise(remainder, masks, SHORT_ROOT)
        white, remainder_white = (
            np.concatenate([whitened(x, m, noise.phi) / noise.std for x, m in zip(series, masks, strict=True)])
            for series in (residuals, remainder)
        )
        spread = float(np.std(np.concatenate([r[m] for r, m in zip(residuals, masks, strict=True)])))
        return cls(distances, loads, masks, noise, white, noise.weights(remainder_white), spread)

    def columns(self, shapes: Sequence[Array]) -> Array:
        """Shapes of each session, scaled with the load, whitened; shape (n, shapes)."""
        load_columns = (x * load[:, np.newaxis] for x, load in zip(shapes, self.loads, strict=True))
        return np.concatenate(
            [whitened(x, m, self.noise.phi) / self.noise.std for x, m in zip(load_columns, self.masks, strict=True)]
        )

    def gains(self, shapes: Sequence[Array]) -> tuple[Array, Array]:
        """Gain in log-likelihood of each shape in addition to a mean, and its torque [Nm]."""
        is_valid = np.isfinite(self.white)
        weight = self.weight[is_valid]
        y, x = self.white[is_valid] - np.average(self.white[is_valid], weights=weight), self.columns(shapes)[is_valid]
        x = x - np.average(x, axis=0, weights=weight)
        projection, own_weight = x.T @ (weight * y), np.maximum((x**2).T @ weight, (self.noise.dc_gain / self.noise.std) ** 2)
        return 0.5 * projection**2 / own_weight, projection / own_weight


@dataclass(frozen=True, slots=True)
class _Folding:
    """A lap length, the bins of a place, and the variance of a whitened place, with their log-`evidence`."""

    evidence: float
    lap_m: float
    width: int
    prior: float

    def places(self, positions: Array) -> tuple[Indices, int]:
        """The place in the lap of each stretch, and the number of places."""
        count = max(1, round(self.lap_m / (BIN_M * self.width)))
        return np.minimum((positions % self.lap_m / self.lap_m * count).astype(np.int64), count - 1), count


def find_place(
    distances: Sequence[Array], residuals: Sequence[Array], masks: Sequence[Mask], loads: Sequence[Array]
) -> Place | None:
    """Find a residual that repeats at the same place; None if none is significant.

    Parameters
    ----------
    distances
        From the start of each session along its route [m], see `finders.driven_along`.
    residuals, masks
        Against travel [Nm], and its compared samples.
    loads
        Weight over its mean, or any other series: the torque at a place scales with it.

    Notes
    -----
    An unknown place looks like a random walk, under which no place matters; under a noise
    bounded away from one, any drift looks like places. So there are two searches: the noise for the second excludes the
    place of the first.
    """
    means, masks_known = _means(distances, residuals, masks)
    if sum(int(whole_past(k, MOST_LAGS).sum()) for k in masks_known) < FEWEST_BINS:  # a jump over bins leaves none in a row
        return None
    longest_m, directions = max(float(np.abs(d).max()) for d in distances), [_direction(d) for d in distances]
    laps = _laps(longest_m, len(distances))
    first_bins = _whitened(means, masks_known, directions, estimate_noise(means, masks_known, SHORT_ROOT))
    first_folding = _best_folding(first_bins, laps, first_bins)
    remainder = [m - x for m, x in zip(means, _expected_torques(means, masks_known, directions, first_folding), strict=True)]
    noise = estimate_noise(remainder, masks_known)
    bins = _whitened(means, masks_known, directions, noise)
    best_folding = _best_folding(bins, laps, _whitened(remainder, masks_known, directions, noise))
    search_cost = math.log(len(laps) * len(WIDTHS) * len(PRIORS))
    if best_folding.evidence < search_cost + SURE or not _shows_on_others(bins, best_folding):
        return None
    place_torques = _expected_torques(means, masks_known, directions, best_folding)
    remainder = [r - x[_bins_of(d)] for r, d, x in zip(residuals, distances, place_torques, strict=True)]
    is_folded, rows = best_folding.lap_m < longest_m, _Rows.of(distances, residuals, remainder, masks, loads)
    place = _place(best_folding.lap_m, is_folded, search_cost, rows)
    if not is_folded:
        return place
    lengths = (place.lap_m * (1.0 + FINER * np.arange(-MOST_OFF, MOST_OFF + 1))).tolist()
    lap_m = max(lengths, key=lambda lap: _best_edges(place.begin_m, place.end_m, EDGES_M[0], lap, rows)[3])
    return _place(lap_m, is_folded, search_cost, rows)


def _bins_of(distance: Array) -> Indices:
    """Number of the stretch of each sample, from the start of its session."""
    return np.asarray(np.maximum(_direction(distance) * distance, 0.0) // BIN_M, dtype=np.int64)


def _direction(distance: Array) -> float:
    """1, or -1 for laps in the other direction."""
    return -1.0 if distance[-1] < 0.0 else 1.0


def _middles(means: Array) -> Array:
    return np.asarray((np.arange(len(means)) + 0.5) * BIN_M, dtype=np.float64)


def _best_folding(bins: _Bins, laps: Array, remainder: _Bins) -> _Folding:
    """The most likely folding; the `remainder` shows the gain by chance for a noise that is not quite white."""
    foldings = []
    for width in WIDTHS:
        chance_gains = [
            square.sum(axis=1) / (passes > 0.0).sum(axis=1) for square, passes in _squares(remainder, laps[::SOME], width)
        ]
        scale, first_index = max(1.0, float(np.median(np.concatenate(chance_gains)))), 0
        for square, passes in _squares(bins, laps, width):
            places = (passes > 0.0).sum(axis=1, keepdims=True)
            # Places use up degrees of freedom.
            square /= scale / np.maximum(1.0 - places / len(bins.positions), 1.0 / FEWEST_PASSES)
            typical_passes = passes.sum(axis=1, keepdims=True) / places
            for prior in PRIORS:
                growth = prior * passes / typical_passes
                evidence = 0.5 * (square * growth / (1.0 + growth) - np.log1p(growth)).sum(axis=1)
                i = int(np.argmax(evidence))
                foldings.append(
                    _Folding(float(evidence[i]), float(laps[first_index + i]), width, prior / float(typical_passes[i, 0]))
                )
            first_index += len(square)
    return max(foldings, key=lambda folding: folding.evidence)


def _expected_torques(
    means: Sequence[Array], masks_known: Sequence[Mask], directions: Sequence[float], folding: _Folding
) -> list[Array]:
    """Mean of each place over its passes, at each bin."""
    places = [folding.places(way * _middles(m)) for m, way in zip(means, directions, strict=True)]
    count = places[0][1]
    total, passes = (
        np.sum(
            [np.bincount(p[k], weights=x[k], minlength=count) for (p, _), x, k in zip(places, series, masks_known, strict=True)],
            axis=0,
        )
        for series in (means, [np.ones(len(m)) for m in means])
    )
    profile = total / np.maximum(passes, 1.0)
    return [np.asarray(profile[p]) for p, _ in places]


def _laps(longest_m: float, sessions: int) -> Array:
    """Lap lengths so close that places shift by half a bin at most. Beyond the longest recording each is one pass."""
    log_shortest = math.log(SHORTEST_LAP_M)
    log_longest = math.log(max(longest_m / FEWEST_PASSES, SHORTEST_LAP_M))
    lap_lengths = np.exp(np.arange(log_shortest, log_longest, 0.5 * BIN_M / longest_m))
    return np.append(lap_lengths, longest_m + BIN_M) if sessions >= FEWEST_PASSES or not len(lap_lengths) else lap_lengths


def _means(distances: Sequence[Array], residuals: Sequence[Array], masks: Sequence[Mask]) -> tuple[list[Array], list[Mask]]:
    """Mean residual of each stretch of each session, less the overall mean, and whether it is known."""
    means, masks_known = [], []
    for distance, residual, mask in zip(distances, residuals, masks, strict=True):
        place, used_steps = _bins_of(distance), mask & np.isfinite(residual)
        count = np.bincount(place[used_steps], minlength=place.max() + 1)
        means.append(
            np.bincount(place[used_steps], weights=residual[used_steps], minlength=place.max() + 1) / np.maximum(count, 1)
        )
        masks_known.append(count > 0)
    mean = float(np.concatenate(means)[np.concatenate(masks_known)].mean())
    return [np.where(k, m - mean, 0.0) for m, k in zip(means, masks_known, strict=True)], masks_known


def _whitened(means: Sequence[Array], masks_known: Sequence[Mask], directions: Sequence[float], noise: Noise) -> _Bins:
    white = np.concatenate([whitened(m, k, noise.phi) / noise.std for m, k in zip(means, masks_known, strict=True)])
    positions = np.concatenate([way * _middles(m) for m, way in zip(means, directions, strict=True)])
    session = np.repeat(np.arange(len(means)), [len(m) for m in means])
    is_valid = np.isfinite(white)
    return _Bins(positions[is_valid], session[is_valid], np.clip(white[is_valid], -FURTHEST, FURTHEST))


def _squares(bins: _Bins, laps: Array, width: int) -> Iterator[tuple[Array, Array]]:
    """Squared sum over passes at each place, divided by their number, and that number; shape (lengths, places), of a part of the
    lap lengths at once.
    """
    place_count = round(float(laps.max()) / (BIN_M * width)) + 1
    for lengths in np.array_split(laps, math.ceil(len(laps) * max(len(bins.positions), place_count) / AT_ONCE)):
        lap = lengths[:, np.newaxis]
        count = np.maximum(1.0, np.round(lap / (BIN_M * width)))
        turns = bins.positions / lap
        turns -= np.floor(turns)  # ten times faster than a remainder
        place = np.minimum(turns * count, count - 0.5).astype(np.int64)
        place = (place + place_count * np.arange(len(lengths))[:, np.newaxis]).ravel()
        total = np.bincount(place, weights=np.tile(bins.white, len(lengths)), minlength=place_count * len(lengths))
        passes = np.bincount(place, minlength=place_count * len(lengths))
        yield (
            (total**2 / np.maximum(passes, 1)).reshape(len(lengths), place_count),
            passes.reshape(len(lengths), place_count).astype(float),
        )


def _shows_on_others(bins: _Bins, folding: _Folding) -> bool:
    """Whether nearly each pass follows the mean of the others."""
    place, count = folding.places(bins.positions)
    number, prior = (bins.positions // folding.lap_m).astype(np.int64), folding.prior
    _, pass_of_bin = np.unique(np.stack([bins.session, number]), axis=1, return_inverse=True)
    pass_of_bin = pass_of_bin.ravel()
    total, passes = np.bincount(place, weights=bins.white, minlength=count), np.bincount(place, minlength=count)
    is_better = []
    for k in range(pass_of_bin.max() + 1):
        places, values = place[pass_of_bin == k], bins.white[pass_of_bin == k]
        if len(np.unique(places)) < WHOLE * count:
            continue
        other_sums = total - np.bincount(places, weights=values, minlength=count), passes - np.bincount(places, minlength=count)
        prediction = (prior * other_sums[0] / (1.0 + prior * other_sums[1]))[places]
        is_better.append(float((prediction * (2.0 * values - prediction)).sum()) > 0.0)
    return len(is_better) >= FEWEST_PASSES and bool(np.mean(is_better) >= 1.0 - MOST_WORSE)


def _place(lap_m: float, is_folded: bool, search_cost: float, rows: _Rows) -> Place:
    """The torque by the place in a lap of a given length."""
    distances, masks = rows.distances, rows.masks
    course = tuple(d % lap_m for d in distances)
    profiles = []
    for width in WIDTHS:
        count = max(FEWEST_PLACES, round(lap_m / (BIN_M * width)))
        design = [_place_weights(c / lap_m * count, count) for c in course]
        profiles.append((*_most_likely_profile(rows.columns(design), rows), design))
    evidence, cost, profile, design = max(profiles, key=lambda entry: entry[0])
    profile, count = profile - np.median(profile), len(profile)
    first_bin, last = _peak_range(profile)
    begin, end = first_bin / count * lap_m, (last + 1) / count * lap_m
    for edge_m in EDGES_M:
        begin, end, size, gain = _best_edges(begin, end, edge_m, lap_m, rows)
    middle = 0.5 * (begin + end)
    masks_inside = [np.abs((d - middle + 0.5 * lap_m) % lap_m - 0.5 * lap_m) < 0.5 * (end - begin) for d in distances]
    passes = sum(
        len(np.unique((d[m & t] - middle + 0.5 * lap_m) // lap_m)) for d, m, t in zip(distances, masks, masks_inside, strict=True)
    )
    edges = 2.0 * len(EDGES_M) * math.log(2.0 * MOST_MOVED + 1.0)
    if gain - edges > evidence:  # constant within, and zero elsewhere
        cost, shape = edges, tuple(load * ((c - begin) % lap_m < end - begin) for c, load in zip(course, rows.loads, strict=True))
    else:
        scale = profile @ np.concatenate([x[m & t] for x, m, t in zip(design, masks, masks_inside, strict=True)]).mean(axis=0)
        shape = tuple(load * (x @ profile) / scale for x, load in zip(design, rows.loads, strict=True))
    return Place(lap_m, size, begin, end, passes, is_folded, cost + search_cost, course, shape)


def _best_edges(begin: float, end: float, edge_m: float, lap_m: float, rows: _Rows) -> tuple[float, float, float, float]:
    """Nearby edges with the largest gain for a constant torque between them; that torque [Nm], and its gain."""
    best_edges = (-math.inf, begin, end, 0.0)
    edge_moves = np.arange(-MOST_MOVED, MOST_MOVED + 1) * edge_m
    for moved_begin in begin + edge_moves:
        ends = end + edge_moves
        ends = ends[(ends - moved_begin >= BIN_M) & (ends - moved_begin < lap_m - BIN_M)]
        if not len(ends):
            continue
        gains, sizes = rows.gains([((d - moved_begin) % lap_m)[:, np.newaxis] < ends - moved_begin for d in rows.distances])
        i = int(np.argmax(gains))
        if gains[i] > best_edges[0]:
            best_edges = (float(gains[i]), float(moved_begin), float(ends[i]), float(sizes[i]))
    gain, begin, end, size = best_edges
    turns = math.floor(begin / lap_m)
    return begin - turns * lap_m, end - turns * lap_m, size, gain


def _most_likely_profile(columns: Array, rows: _Rows) -> tuple[float, float, Array]:
    """Log-evidence, its cost for the places, and the torque at each, for the most likely size of places."""
    is_valid, spread = np.isfinite(rows.white), rows.spread
    mean = np.full(is_valid.sum(), rows.noise.dc_gain / rows.noise.std)  # the base's
    x, y, weight = np.column_stack([columns[is_valid], mean]), rows.white[is_valid], rows.weight[is_valid]
    normal, right_side = (x.T * weight) @ x, (x.T * weight) @ y
    solutions = []
    for size in SIZES:
        std = np.append(np.full(x.shape[1] - 1, size * spread), spread)
        torques: Array = np.linalg.solve(normal + np.diag(std**-2.0), right_side)
        occam = 0.5 * float(np.linalg.slogdet(np.eye(len(std)) + normal * np.outer(std, std))[1])
        solutions.append((0.5 * float(right_side @ torques) - occam, occam, torques[:-1]))
    return max(solutions, key=lambda solution: solution[0])


def _place_weights(positions: Array, count: int) -> Array:
    """Weights of places with their middles at 0.5, 1.5, ..., cyclic after `count`; shape (n, count)."""
    lower_places = np.floor(positions - 0.5)
    share = positions - 0.5 - lower_places
    design, rows = np.zeros((len(positions), count)), np.arange(len(positions))
    np.add.at(design, (rows, lower_places.astype(int) % count), 1.0 - share)
    np.add.at(design, (rows, (lower_places.astype(int) + 1) % count), share)
    return design


def _peak_range(profile: Array) -> tuple[int, int]:
    """First and last place around the largest torque with at least half of it; the last may lie beyond the end."""
    count, top = len(profile), int(np.argmax(np.abs(profile)))
    is_large = profile / profile[top] >= HALF
    begin = end = top
    while end - begin < count - 1 and is_large[(end + 1) % count]:
        end += 1
    while end - begin < count - 1 and is_large[(begin - 1) % count]:
        begin -= 1
    return begin % count, end + begin % count - begin
