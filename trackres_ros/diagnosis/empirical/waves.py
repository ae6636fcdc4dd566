# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds a torque that repeats with distance, caused by a rotating part of a belt or a wheel.

Source: Lomb (1976) and Scargle (1982), over distance instead of time, on residuals whitened as in the fit. The step means
of a short wave are smaller by the sinc of step over wavelength, which is exact here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebval
from numpy.typing import NDArray
from scipy.special import gammainccinv

from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.inference.noise import whitened
from trackres_ros.diagnosis.prepare.session import Array, DriveSession

SHORTEST_M, LONGEST_M = 3.0, 400.0
PIECE_M = 4000.0  # with a constant phase: the integrated distance slips
FEWEST_SAMPLES = 60  # of a piece
FINER = 3.0  # steps of the grid within the resolution of a piece
CHANCE = 0.002  # probability that noise alone reaches it anywhere in the grid
REMEMBERED_M = 1000.0  # averaging length of a followed phase
SAME_LENGTH = 0.03  # relative: slip and wear of a rotating part
NEARLY_LARGEST = 12  # of the grid, fitted exactly
AT_ONCE = 64
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
    valid: NDArray[np.bool_]


def find_wave(found: Fit) -> Wave | None:
    """The wave with the largest gain in the residual of a fit; None if not significant."""
    pieces = _pieces(found)
    if not pieces:
        return None
    longest = max(float(p.edges[-1] - p.edges[0]) for p in pieces)
    waves = np.arange(1.0 / LONGEST_M, 1.0 / SHORTEST_M, 1.0 / (FINER * longest))  # per metre
    gains = np.sum([_gains(found, p, waves) for p in pieces], axis=0)
    scale = max(1.0, float(np.median(gains)) / float(gammainccinv(len(pieces), 0.5)))
    per_metre, gain = max(
        (
            (float(waves[i]), sum(_fitted(found, p, float(waves[i]))[1] for p in pieces))
            for i in np.argsort(gains)[-NEARLY_LARGEST:]
        ),
        key=lambda one: one[1],
    )
    return None if gain / scale < float(gammainccinv(len(pieces), CHANCE / len(waves))) else _wave(found, pieces, per_metre)


def part_of(length_m: float, parts: Mapping[str, float]) -> str:
    """Part with this length per turn, or per a few turns [m]; empty without one."""
    for name, once in parts.items():
        for times in range(1, MOST_PARTS + 1):
            if abs(times * once / length_m - 1.0) < SAME_LENGTH:
                return f"one turn of the {name}" if times == 1 else f"{times} turns of the {name}"
            if times > 1 and abs(once / times / length_m - 1.0) < SAME_LENGTH:
                return f"1/{times} of a turn of the {name}"
    return ""


def _pieces(found: Fit) -> list[_Piece]:
    pieces = []
    for i, (session, white) in enumerate(zip(found.problem.sessions, found.white, strict=False)):
        edges = np.concatenate(([0.0], np.cumsum(np.abs(np.nan_to_num(session.speed))) * session.step))
        number = (edges[:-1] // PIECE_M).astype(int)
        for n in np.unique(number):
            at = np.flatnonzero(number == n)
            rows = slice(int(at[0]), int(at[-1]) + 1)
            valid = np.isfinite(white[rows])
            if valid.sum() >= FEWEST_SAMPLES:
                pieces.append(_Piece(i, rows, edges[rows.start : rows.stop + 1], white[rows], valid))
    return pieces


def _mean_wave(edges: Array, per_metre: float) -> NDArray[np.complex128]:
    """Mean over each step of a wave of size 1."""
    turns = 2.0 * math.pi * per_metre * edges
    far, near = np.diff(turns), np.exp(0.5j * (turns[1:] + turns[:-1]))
    return np.asarray(near * np.sinc(far / (2.0 * math.pi)))


def _fitted(found: Fit, piece: _Piece, per_metre: float) -> tuple[complex, float]:
    """Complex size of the wave in a piece [Nm], and the gain in log-likelihood."""
    noise, wave, e = found.noise, _mean_wave(piece.edges, per_metre), piece.white[piece.valid]
    everywhere = np.ones(len(wave), dtype=bool)
    parts = [np.nan_to_num(whitened(part, everywhere, noise.phi) / noise.std) for part in (wave.real, -wave.imag)]
    design, weight = np.stack(parts, axis=1)[piece.valid], noise.weights(e)
    normal = (design * weight[:, np.newaxis]).T @ design + 1e-9 * np.eye(2)
    right = design.T @ (weight * e)
    solved = np.linalg.solve(normal, right)
    return complex(solved[0], solved[1]), 0.5 * float(right @ solved)


def _gains(found: Fit, piece: _Piece, waves: Array) -> Array:
    """Gains of many waves, for a steady speed over the lags of the whitening; `_fitted` is exact."""
    noise = found.noise
    weighted = np.where(piece.valid, noise.weights(np.nan_to_num(piece.white)) * np.nan_to_num(piece.white), 0.0) / noise.std
    adjoint = weighted.copy()  # of the whitening
    for lag, coefficient in enumerate(noise.phi, start=1):
        adjoint[:-lag] -= coefficient * weighted[lag:]
    middle, far = 0.5 * (piece.edges[1:] + piece.edges[:-1]), np.diff(piece.edges)
    rows = np.flatnonzero((far > 0.0) | (adjoint != 0.0))
    middle, far, adjoint, valid = middle[rows], far[rows], adjoint[rows], piece.valid[rows]
    finer = (waves[1] - waves[0]) * np.arange(AT_ONCE)[:, np.newaxis]  # the same from the first wave of each block
    turned, half_turned = np.exp(2j * math.pi * finer * middle), np.exp(1j * math.pi * finer * far)
    found_gains = []
    for first in waves[::AT_ONCE]:
        half = half_turned * np.exp(1j * math.pi * first * far)
        angle = math.pi * (first + finer) * far
        size = np.divide(half.imag, angle, out=np.ones_like(angle), where=angle > 0.0)
        like = (turned * size) @ (np.exp(2j * math.pi * first * middle) * adjoint)
        norm = 0.5 * (_passed(noise.phi, half.real) * size**2) @ valid / noise.std**2
        found_gains.append(0.5 * np.abs(like) ** 2 / np.maximum(norm, 1e-9))
    return np.concatenate(found_gains)[: len(waves)]


def _passed(phi: Array, cosine: Array) -> Array:
    """Share of a wave's power after whitening, |1 - phi_1 z - ...|^2, from the cosine of half the angle of z."""
    filtered = np.concatenate(([1.0], -phi))
    series = np.correlate(filtered, filtered, "full")[len(phi) :]
    return np.asarray(chebval(2.0 * cosine**2 - 1.0, np.append(series[0], 2.0 * series[1:])))


def _wave(found: Fit, pieces: list[_Piece], per_metre: float) -> Wave:
    sizes = [_fitted(found, piece, per_metre)[0] for piece in pieces]
    shape = [np.zeros(len(s)) for s in found.problem.sessions]
    for piece, size in zip(pieces, sizes, strict=True):
        wave = _mean_wave(piece.edges, per_metre)
        turned = np.exp(1j * np.angle(size)) * wave
        shape[piece.session][piece.rows] = turned.real
    weights = [piece.valid.sum() for piece in pieces]
    return Wave(1.0 / per_metre, float(np.average(np.abs(sizes), weights=weights)), len(pieces), tuple(shape))


def followed(wave: Wave, residuals: Sequence[Array], sessions: Sequence[DriveSession]) -> list[Array]:
    """The wave at each sample over its size, with phase and size from earlier samples: an exponential mean."""
    found = []
    for residual, session in zip(residuals, sessions, strict=True):
        metres = np.abs(np.nan_to_num(session.speed)) * session.step
        turned = _mean_wave(np.concatenate(([0.0], np.cumsum(metres))), 1.0 / wave.length_m)
        shown = np.where(session.used & np.isfinite(residual), residual, 0.0) / wave.size
        keeps = np.exp(-metres / REMEMBERED_M)
        like, weight, known = 0.0j, FEWEST_SAMPLES / 4.0, np.zeros(len(session))
        for t, (x, w, keep, used) in enumerate(
            zip(shown.tolist(), turned.tolist(), keeps.tolist(), session.used.tolist(), strict=True)
        ):
            known[t] = (like.conjugate() * w).real / weight if used else 0.0
            like = keep * like + 2.0 * x * w
            weight = keep * (weight - FEWEST_SAMPLES / 4.0) + abs(w) ** 2 * used + FEWEST_SAMPLES / 4.0
        found.append(known)
    return found
