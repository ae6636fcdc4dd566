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

    def joined(self, other_value: Value) -> Value:
        """With an interval that includes another one."""
        return Value(self.value, min(self.low, other_value.low), max(self.high, other_value.high))


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

    def smooth(self, sweep: Sweep, theta: Array, frequency: float, penalty: Array) -> Smooth:
        """The splines for some numbers."""
        return smooth(self.levelled(sweep, theta), self.shift(theta), frequency, penalty)

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

    def value(self, value_function: Callable[[Array], float], limits: tuple[float, float] = (-np.inf, np.inf)) -> Value:
        """A function of the numbers, with its interval by the delta method."""
        centre = value_function(self.theta)
        step = 1e-4 * np.maximum(np.sqrt(np.diag(self.covariances[0])), 1e-6)
        slope = np.array(
            [(value_function(self.theta + s) - value_function(self.theta - s)) / (2.0 * s.sum()) for s in np.diag(step)]
        )
        half_width = float(stdtrit(self.dof, 0.5 + 0.5 * SURE)) * float(np.sqrt(max(slope @ c @ slope for c in self.covariances)))
        return Value(centre, max(centre - half_width, min(limits[0], centre)), min(centre + half_width, max(limits[1], centre)))


def fitted(sweep: Sweep, law: Law, frequency: float) -> FittedShift:
    """Least squares of one law from the best of its starts."""
    inner_starts = [np.clip(start, law.low + 1e-6, law.high - 1e-6) for start in law.starts]

    def residuals(theta: Array, penalty: Array, scale: Array) -> Array:
        return np.asarray((law.smooth(sweep, theta, frequency, penalty).penalised / scale).ravel(order="F"))

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
    theta = min(inner_starts, key=lambda start: float((residuals(start, penalty, scale) ** 2).sum()))
    for _ in range(ROUNDS):
        theta = solved(theta, penalty, scale).x
        penalty = UNDERSMOOTHED * chosen_penalty(law.levelled(sweep, theta), law.shift(theta), frequency)
        scale = np.maximum(np.sqrt((law.smooth(sweep, theta, frequency, penalty).residuals ** 2).mean(axis=0)), 1e-6)
    solution = solved(theta, penalty, scale)
    last = law.smooth(sweep, solution.x, frequency, penalty).residuals
    scores = len(last) * np.log((last**2).mean(axis=0)).sum()
    covariance_alone = np.linalg.pinv(solution.jac.T @ solution.jac) * float((last / scale).ravel() @ (last / scale).ravel())
    covariance_alone /= max(last.size - len(solution.x), 1)
    covariance_of_groups, groups = _jackknife(sweep, law, frequency, solution.x, penalty, scale)
    widening = np.sqrt(np.maximum(np.diag(covariance_of_groups) / np.maximum(np.diag(covariance_alone), 1e-300), 1.0))
    dof = float(max(groups - len(solution.x), 2))
    bic = float(scores + len(solution.x) * np.log(last.size))
    storage, loss = np.sqrt((last**2).mean(axis=0))
    covariances = covariance_alone, covariance_of_groups, covariance_alone * np.outer(widening, widening)
    return FittedShift(law, solution.x, covariances, dof, bic, (float(storage), float(loss)))


def _jackknife(sweep: Sweep, law: Law, frequency: float, theta: Array, penalty: Array, scale: Array) -> tuple[Array, int]:
    """Covariance of the numbers, and of how many isotherms: each is left out once.

    Rows of one isotherm may share an error (of temperature, of clamping), which the splines follow where isotherms lie apart;
    leaving them out whole shows what that does to the shift (Efron, The Jackknife, the Bootstrap and Other Resampling Plans,
    1982, ch. 3). One Gauss-Newton step from the fit to all is taken for the fit to the others.
    """
    isotherm = np.unique(np.round(sweep.temp_degc / ISOTHERM_K), return_inverse=True)[1].ravel()
    groups = int(isotherm.max()) + 1
    theta_moved = np.zeros((groups, len(theta)))
    step = 1e-4 * np.maximum(np.abs(theta), 1.0)
    for group in range(groups):
        other_rows = sweep.some(isotherm != group)

        def residual_of(numbers: Array, other_rows: Sweep = other_rows) -> Array:
            return np.asarray((law.smooth(other_rows, numbers, frequency, penalty).penalised / scale).ravel(order="F"))

        residual_now = residual_of(theta)
        inwards = np.where(theta + step < law.high, step, -step)
        slopes = np.column_stack([(residual_of(theta + s) - residual_now) / s.sum() for s in np.diag(inwards)])
        theta_moved[group] = np.linalg.lstsq(slopes, -residual_now, rcond=None)[0]
    return (groups - 1) / groups * (theta_moved - theta_moved.mean(axis=0)).T @ (theta_moved - theta_moved.mean(axis=0)), groups


def with_power(shift_fit: FittedShift) -> Law:
    """The law of a fit with a vertical shift by a power of absolute temperature."""
    law = shift_fit.law
    return Law(
        law.name,
        lambda theta: law.shift(theta[:-1]),
        np.append(law.low, -STEEPEST_POWER),
        np.append(law.high, STEEPEST_POWER),
        (np.append(shift_fit.theta, 0.0),),
        lambda theta: float(theta[-1]),
    )
