# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A mass that differs from one stretch between stops to the next: people get on and off, bulk is loaded and tipped.

Each stretch has a mass of its own beside the model's, with a prior about none, and stretches that follow one another are alike
(an autoregression of the first order; random effects, Laird and Ware 1982). Its torque is told from others by what a mass does:
it takes more to speed up and gives it back, rolls harder and climbs harder.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.inference.noise import Noise, estimate_noise, whitened
from trackres_ros.diagnosis.prepare.session import Session
from trackres_ros.units import GRAVITY, STANDSTILL_MPS

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

STOP_S = 5.0  # a shorter stop changes no load
FEWEST_STRETCHES = 6
SIZES = tuple(np.geomspace(0.003, 0.3, 9))  # standard deviation of what is loaded, over the vehicle's mass
ALIKE = (0.0, 0.5, 0.8, 0.95)  # correlation of the mass of a stretch with that of the one before
TURNS = 3  # of masses and noise
SURE = 10.0  # in log-likelihood: of a mass by stretch over a torque by stretch
MORE = 0.01  # of the weight, for the derivative


@dataclass(frozen=True, slots=True)
class Stretch:
    """Driving between two stops, and the mass beside the model's [kg] with its standard deviation."""

    recording: str
    begin_s: float
    end_s: float
    mass: float
    std: float


@dataclass(frozen=True, eq=False)
class Payload:
    """A mass by stretch.

    Attributes
    ----------
    stretches
        Those with something that is fitted.
    level
        Root mean square of its torque on the laps fitted [Nm].
    shape
        Its torque over `level` at each sample of each session: on laps fitted by all of them, elsewhere by what was measured
        before.
    cost
        Of the masses, in log-likelihood.
    """

    stretches: tuple[Stretch, ...]
    level: float
    shape: tuple[Array, ...]
    cost: float


@dataclass(frozen=True, eq=False)
class _Whitened:
    """Normal equations of the masses of one session, of whitened samples that are fitted."""

    normal: Array  # (stretches, stretches)
    right: Array  # (stretches,)

    def solved(self, std: float, alike: float) -> tuple[float, float, Array, Array]:
        """Log-evidence, what of it the masses cost, and the masses with their standard deviations [kg]."""
        count = len(self.right)
        prior = std**2 * alike ** np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
        grown = np.eye(count) + prior @ self.normal
        covariance = np.linalg.solve(grown, prior)
        masses = covariance @ self.right
        cost = 0.5 * float(np.linalg.slogdet(grown)[1])
        return 0.5 * float(self.right @ masses) - cost, cost, masses, np.sqrt(np.diag(covariance))


@dataclass(frozen=True, eq=False)
class _Solution:
    """Masses of the stretches of each session with their standard deviations [kg], given how much is loaded [kg] and how alike
    stretches are; as likely as `evidence` says, of which they `cost` some.
    """

    std: float
    alike: float
    evidence: float
    cost: float
    masses: list[tuple[Array, Array]]

    @classmethod
    def of(cls, parts: Sequence[_Whitened], std: float, alike: float) -> _Solution:
        solved = [part.solved(std, alike) for part in parts]
        evidence, cost = (math.fsum(s[i] for s in solved) for i in (0, 1))
        return cls(std, alike, evidence, cost, [(s[2], s[3]) for s in solved])


def find_payload(current: Fit, residuals: Sequence[Array]) -> Payload | None:
    """The mass of each stretch; None where loads or passengers are recorded, or where there are too few stretches.

    Parameters
    ----------
    residuals
        Of the torque of each session [Nm].
    """
    sessions, masks = current.problem.sessions, current.problem.masks
    if any({"load", "passengers"} & s.given for s in sessions):
        return None
    numbers = [stretch_numbers(s) for s in sessions]
    counts = [int(n.max()) + 1 for n in numbers]
    if sum(counts) < FEWEST_STRETCHES:
        return None
    mass = current.base_values.get("mass", current.problem.base.facts.weight / GRAVITY)
    per_kg = torque_of_a_kilogram(current, mass)
    typical = float(np.sqrt(np.mean(np.concatenate([m[use] for m, use in zip(per_kg, masks, strict=True)]) ** 2)))
    against = [typical * np.sign(s.speed) for s in sessions]
    (best, noise), (of_level, _) = (_most_likely(by, numbers, counts, residuals, current, mass) for by in (per_kg, against))
    if best.evidence < of_level.evidence + SURE:
        return None  # whatever it is that differs, it is not told by what a mass does
    torques, stretches = [], list[Stretch]()
    for i, (session, number, by_mass, residual, (masses, stds)) in enumerate(
        zip(sessions, numbers, per_kg, residuals, best.masses, strict=True)
    ):
        smoothed = by_mass * masses[number]
        live = by_mass * followed(by_mass, residual, number, session.used, noise, best)
        torques.append(np.where(masks[i], smoothed, np.where(session.used, live, 0.0)))
        stretches += [
            Stretch(session.name, *_span(session, number == k), float(masses[k]), float(stds[k]))
            for k in np.unique(number[masks[i]]).tolist()
        ]
    acting = np.concatenate([t[m] for t, m in zip(torques, masks, strict=True)])
    level = float(np.sqrt(np.mean(acting**2)))
    if not level > 0.0:
        return None
    cost = best.cost + math.log(len(SIZES) * len(ALIKE))
    return Payload(tuple(stretches), level, tuple(t / level for t in torques), cost)


def _most_likely(
    by: Sequence[Array], numbers: Sequence[Indices], counts: Sequence[int], residuals: Sequence[Array], current: Fit, mass: float
) -> tuple[_Solution, Noise]:
    """Sizes of a series by stretch that explain residuals best, and the noise beside them."""
    masks = current.problem.masks
    columns = [x[:, np.newaxis] * (n[:, np.newaxis] == np.arange(c)) for x, n, c in zip(by, numbers, counts, strict=True)]
    left, noise = list(residuals), current.noise
    for _ in range(TURNS):  # unless it is left out, noise is as large as the payload and counts the more it is loaded the less
        parts = [_whitened(*of, noise) for of in zip(columns, residuals, left, masks, strict=True)]
        tried = (_Solution.of(parts, size * mass, alike) for size in SIZES for alike in ALIKE)
        best = max(tried, key=lambda one: one.evidence)
        left = [r - x @ m for r, x, (m, _) in zip(residuals, columns, best.masses, strict=True)]
        noise = estimate_noise(left, masks)
    return best, noise


def stretch_numbers(session: Session) -> Indices:
    """Number of the stretch of each sample; a stop belongs to the stretch before it."""
    still = np.concatenate(([False], np.abs(np.nan_to_num(session.speed)) < STANDSTILL_MPS, [False])).astype(int)
    begins, ends = np.flatnonzero(np.diff(still) > 0), np.flatnonzero(np.diff(still) < 0)
    long = ((ends - begins) * session.step >= STOP_S) & (begins > 0) & (ends < len(session))
    next_one = np.zeros(len(session), dtype=np.int64)
    next_one[ends[long]] = 1
    return np.cumsum(next_one)


def torque_of_a_kilogram(current: Fit, mass: float) -> list[Array]:
    """What a kilogram more takes, of each session [Nm]; it does not rotate, as the model's mass does in part."""
    problem, facts = current.problem, current.problem.base.facts
    expected = []
    for more in (0.0, MORE):
        weight = (1.0 + more) * mass * GRAVITY
        loaded = [replace(s, weight=np.full(len(s), weight), given=s.given | {"load"}) for s in problem.sessions]
        expected.append([p.torque for p in problem.base.predict(loaded, *current.model_at(current.point))])
    rotating = current.base_values.get("rotating_mass_factor", problem.base.rotating_mass_factor) - 1.0
    return [
        np.where(np.abs(s.speed) > STANDSTILL_MPS, (with_more - without) / (MORE * mass) - rotating * s.accel * facts.radius, 0.0)
        for s, without, with_more in zip(problem.sessions, *expected, strict=True)
    ]


def followed(by_mass: Array, residual: Array, number: Indices, used: Mask, noise: Noise, like: _Solution) -> Array:
    """The mass at each sample by what was measured before it, as one who watches live knows it: a Kalman filter [kg].

    Parameters
    ----------
    by_mass, residual, number, used
        Torque of a kilogram, residual of the torque [Nm], stretch of each sample of a session, and where it may be compared.
    noise
        Of the residual without the payload.
    like
        How much is loaded, and how alike stretches are.
    """
    white = whitened(np.column_stack([by_mass, residual]), used, noise.phi) / noise.std
    begins = np.diff(number, prepend=-1) > 0
    known = np.empty(len(number))
    mean, variance = 0.0, like.std**2
    for t, ((slope, shown), first) in enumerate(zip(white.tolist(), begins.tolist(), strict=True)):
        if first and t:
            mean = like.alike * mean
            variance = like.alike**2 * variance + (1.0 - like.alike**2) * like.std**2
        known[t] = mean
        if math.isnan(shown):
            continue
        off, by_payload = shown - slope * mean, slope**2 * variance
        weight = float(noise.weights(np.array(off / math.sqrt(1.0 + by_payload))))
        gain = variance * slope / (by_payload + 1.0 / weight)
        mean, variance = mean + gain * off, variance * (1.0 - gain * slope)
    return known


def _whitened(columns: Array, residual: Array, left: Array, mask: Mask, noise: Noise) -> _Whitened:
    white = whitened(np.column_stack([columns, residual, left]), mask, noise.phi) / noise.std
    white = white[np.isfinite(white[:, -1])]
    weighted = white[:, :-2].T * noise.weights(white[:, -1])
    return _Whitened(weighted @ white[:, :-2], weighted @ white[:, -2])


def _span(session: Session, there: NDArray[np.bool_]) -> tuple[float, float]:
    rows = np.flatnonzero(there)
    return float(session.time[rows[0]]), float(session.time[rows[-1]] + session.step)
