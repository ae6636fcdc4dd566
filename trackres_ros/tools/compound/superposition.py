# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Least squares of a law of the shift: isotherms of all frequencies are to lie on one master curve.

The splines of the master curve are eliminated for each shift (variable projection: Golub and Pereyra, SIAM J. Numer. Anal. 10
(1973) 413), so that the least squares are over one to four numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.special import stdtrit

from trackres_ros.tools.compound.master import Smooth, chosen_penalty, smooth
from trackres_ros.tools.compound.reading import Array, Sweep
from trackres_ros.tools.compound.shift import Shift
from trackres_ros.units import ZERO_DEGC_K

SURE = 0.95
FIRST_PENALTY, FIRST_SCALE = np.array([0.3, 0.3]), np.array([0.02, 0.04])
ROUNDS, MOST_STEPS = 2, 60
ISOTHERM_K = 2.5  # rows nearer than that may share an error: their temperature, their clamping
UNDERSMOOTHED = 0.1  # of the penalty of the master curve: bends of the curve that are smoothed away are laid to the shift
STEEPEST_POWER = 4.0  # of absolute temperature: limits of a vertical shift


@dataclass(frozen=True, slots=True)
class Value:
    """A fitted value with its 95 % interval."""

    value: float
    low: float
    high: float

    def joined(self, other: Value) -> Value:
        """With an interval that includes another one."""
        return Value(self.value, min(self.low, other.low), max(self.high, other.high))


@dataclass(frozen=True, eq=False)
class Law:
    """A law of the shift as a function of numbers to be fitted."""

    name: str
    shift: Callable[[Array], Shift]
    low: Array
    high: Array
    starts: tuple[Array, ...]
    power: Callable[[Array], float] = lambda _: 0.0
    """Of absolute temperature, in the vertical shift of both moduli."""

    def smooth(self, sweep: Sweep, theta: Array, at: float, penalty: Array) -> Smooth:
        """The splines for some numbers."""
        return smooth(self.levelled(sweep, theta), self.shift(theta), at, penalty)

    def levelled(self, sweep: Sweep, theta: Array) -> Sweep:
        """The sweep without its part proportional to a power of absolute temperature."""
        power = self.power(theta)
        if power == 0.0:
            return sweep
        factor = ((sweep.temp_degc + ZERO_DEGC_K) / ZERO_DEGC_K) ** -power
        return replace(sweep, storage=sweep.storage * factor, loss=sweep.loss * factor)


@dataclass(frozen=True, eq=False)
class FittedShift:
    """A law as fitted: its numbers, -2 ln likelihood with their penalty, and rms of both moduli.

    Their covariances are those of independent errors, of errors common to an isotherm, and of both; the widest is used.
    """

    law: Law
    theta: Array
    covariances: tuple[Array, Array, Array]
    dof: float
    bic: float
    rms: tuple[float, float]

    @property
    def shift(self) -> Shift:
        """The shift of these numbers."""
        return self.law.shift(self.theta)

    def value(self, of: Callable[[Array], float], limits: tuple[float, float] = (-np.inf, np.inf)) -> Value:
        """A function of the numbers, with its interval by the delta method."""
        centre = of(self.theta)
        step = 1e-4 * np.maximum(np.sqrt(np.diag(self.covariances[0])), 1e-6)
        slope = np.array([(of(self.theta + s) - of(self.theta - s)) / (2.0 * s.sum()) for s in np.diag(step)])
        wide = float(stdtrit(self.dof, 0.5 + 0.5 * SURE)) * float(np.sqrt(max(slope @ c @ slope for c in self.covariances)))
        return Value(centre, max(centre - wide, min(limits[0], centre)), min(centre + wide, max(limits[1], centre)))


def fitted(sweep: Sweep, law: Law, at: float) -> FittedShift:
    """Least squares of one law from the best of its starts."""
    inner = [np.clip(start, law.low + 1e-6, law.high - 1e-6) for start in law.starts]

    def residuals(theta: Array, penalty: Array, scale: Array) -> Array:
        return np.asarray((law.smooth(sweep, theta, at, penalty).penalised / scale).ravel(order="F"))

    def solved(theta: Array, penalty: Array, scale: Array) -> OptimizeResult:
        return least_squares(
            residuals,
            theta,
            bounds=(law.low, law.high),
            x_scale=np.maximum(np.abs(theta), 0.1),
            args=(penalty, scale),
            max_nfev=MOST_STEPS,
        )

    penalty, scale = FIRST_PENALTY, FIRST_SCALE
    theta = min(inner, key=lambda start: float((residuals(start, penalty, scale) ** 2).sum()))
    for _ in range(ROUNDS):
        theta = solved(theta, penalty, scale).x
        penalty = UNDERSMOOTHED * chosen_penalty(law.levelled(sweep, theta), law.shift(theta), at)
        scale = np.maximum(np.sqrt((law.smooth(sweep, theta, at, penalty).residuals ** 2).mean(axis=0)), 1e-6)
    found = solved(theta, penalty, scale)
    last = law.smooth(sweep, found.x, at, penalty).residuals
    scores = len(last) * np.log((last**2).mean(axis=0)).sum()
    independent = np.linalg.pinv(found.jac.T @ found.jac) * float((last / scale).ravel() @ (last / scale).ravel())
    independent /= max(last.size - len(found.x), 1)
    shared, groups = _jackknife(sweep, law, at, found.x, penalty, scale)
    wider = np.sqrt(np.maximum(np.diag(shared) / np.maximum(np.diag(independent), 1e-300), 1.0))
    dof = float(max(groups - len(found.x), 2))
    bic = float(scores + len(found.x) * np.log(last.size))
    storage, loss = np.sqrt((last**2).mean(axis=0))
    covariances = independent, shared, independent * np.outer(wider, wider)
    return FittedShift(law, found.x, covariances, dof, bic, (float(storage), float(loss)))


def _jackknife(sweep: Sweep, law: Law, at: float, theta: Array, penalty: Array, scale: Array) -> tuple[Array, int]:
    """Covariance of the numbers, and of how many isotherms: each is left out once.

    Rows of one isotherm may share an error (of temperature, of clamping), which the splines follow where isotherms lie apart;
    leaving them out whole shows what that does to the shift (Efron, The Jackknife, the Bootstrap and Other Resampling Plans,
    1982, ch. 3). One Gauss-Newton step from the fit to all is taken for the fit to the others.
    """
    isotherm = np.unique(np.round(sweep.temp_degc / ISOTHERM_K), return_inverse=True)[1].ravel()
    groups = int(isotherm.max()) + 1
    moved = np.zeros((groups, len(theta)))
    step = 1e-4 * np.maximum(np.abs(theta), 1.0)
    for group in range(groups):
        others = sweep.some(isotherm != group)

        def left(numbers: Array, others: Sweep = others) -> Array:
            return np.asarray((law.smooth(others, numbers, at, penalty).penalised / scale).ravel(order="F"))

        now = left(theta)
        inwards = np.where(theta + step < law.high, step, -step)
        slopes = np.column_stack([(left(theta + s) - now) / s.sum() for s in np.diag(inwards)])
        moved[group] = np.linalg.lstsq(slopes, -now, rcond=None)[0]
    return (groups - 1) / groups * (moved - moved.mean(axis=0)).T @ (moved - moved.mean(axis=0)), groups


def with_power(found: FittedShift) -> Law:
    """The law of a fit with a vertical shift by a power of absolute temperature."""
    law = found.law
    return Law(
        law.name,
        lambda theta: law.shift(theta[:-1]),
        np.append(law.low, -STEEPEST_POWER),
        np.append(law.high, STEEPEST_POWER),
        (np.append(found.theta, 0.0),),
        lambda theta: float(theta[-1]),
    )
