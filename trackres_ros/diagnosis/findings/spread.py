# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds regimes with larger torque oscillations: a judder has no mean, so no term of the fit shows it.

The measured torque is compared with the fit within its steps, by means over a fifth of a second. Second
differences of that residual show oscillations faster than a step, and a median over three steps removes corners of the torque.
The course of the fit within a step is interpolated, so no oscillation may exceed that of the measured torque itself.
Sensor noise grows with the torque, so the oscillation in a regime is compared with that elsewhere at the same torque. Each lap
gives one ratio; a t test over laps decides.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.special import stdtr

from trackres_ros.diagnosis.empirical.terms import Described, Form
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Array, DriveSession, Mask
from trackres_ros.diagnosis.prepare.speed_smoothing import SECOND_DIFFERENCE
from trackres_ros.text.numbers import figures
from trackres_ros.units import MAD_TO_STD

FORM: Form = "spread"
WITHIN = 5  # parts of a step: shows periods between two parts and two steps
OVER = 3  # steps of the median
PULLS_MPS, PULLS_MPS2, SPEEDS_UP_MPS2 = 2.5, 0.1, 0.3  # assumed
FEWEST_STEPS, FEWEST_LAPS = 3, 5
LEAST_RATIO = 2.0  # to that elsewhere: a smaller one may be rough ground
SURELY_RATIO = 1.4  # ratio for the test over laps
MOST_P = 0.001  # over all regimes together
LEAST_SHARE = 0.02  # of the torque's root mean square
MECHANISMS = ("a clutch, belt or brake that slips and sticks", "an oscillating controller", "play in the drive train")
BINS = 12  # of the torque, for the noise as a function of it


@dataclass(frozen=True, slots=True)
class Spread:
    """A regime with larger torque oscillations than elsewhere."""

    regime: str  # in words, such as "while it pulls away"
    size_nm: float  # standard deviation of oscillations faster than a step there
    ratio: float  # to that elsewhere at the same torque, as a geometric mean over laps
    p: float  # probability of exceeding `SURELY_RATIO` by chance, times the number of tested regimes
    laps: int  # in the test

    @property
    def described(self) -> Described:
        """As an unnamed term without a prediction."""
        text = (
            f"The torque oscillates by {figures(self.size_nm)} Nm {self.regime}, {figures(self.ratio, 2)} times as much as "
            f"elsewhere at the same torque. These are standard deviations over {self.laps} laps, of oscillations faster than 1 s"
        )
        return Described(FORM, "", text, MECHANISMS, self.size_nm, gate=self.regime)


def find_spread(fit: Fit) -> Spread | None:
    """The regime with the largest significant oscillation; None without one, for a torque recorded too slowly, or for
    machines quicker than a vehicle, because the regimes are a vehicle's.
    """
    if any(s.pace < 1.0 for s in fit.problem.sessions):
        return None
    sessions = fit.problem.sessions
    shaking = [x for s, p in zip(sessions, fit.predicted, strict=True) if (x := oscillation_of(s, p.torque)) is not None]
    if len(shaking) < len(sessions):
        return None
    size = np.concatenate(shaking)
    used = np.concatenate([_whole(s) for s in sessions]) & np.isfinite(size)
    block = np.concatenate([s.block for s in sessions])[used]
    torque = float(np.sqrt(np.mean(np.concatenate([s.torque[s.used] for s in sessions]) ** 2)))
    drive = np.concatenate([p.at_sprockets for p in fit.predicted])[used]
    regimes = [(text, inside[used]) for text, inside in _regimes(fit)]
    compared = (_compared(text, size[used], drive, inside, block, len(regimes)) for text, inside in regimes)
    found = [x for x in compared if x is not None]
    sure = [x for x in found if x.ratio > LEAST_RATIO and x.p < MOST_P and x.size_nm > LEAST_SHARE * torque]
    return max(sure, key=lambda x: x.ratio, default=None)


def oscillation_of(session: DriveSession, expected: Array) -> Array | None:
    """Standard deviation of oscillations faster than a step, at each step [Nm], shape (n,); None for too sparse samples."""
    from scipy.interpolate import CubicSpline  # takes a while to load

    course, step = session.torque_course, session.step
    part = step / WITHIN
    if course is None or len(course.at) < 2 or len(expected) < OVER:
        return None
    if float(np.median(np.diff(course.at))) > part + 1e-9:
        return None
    begins = (session.time[:, np.newaxis] + part * np.arange(WITHIN)).ravel()
    edges = np.append(session.time, session.time[-1] + step)
    driven = CubicSpline(edges, np.concatenate(([0.0], np.cumsum(np.nan_to_num(expected) * step))))
    measured = course.means(begins, part)
    left = measured - (driven(begins + part) - driven(begins)) / part
    # The spline swings for some steps next to a corner of the torque. The measured torque bends only at the corner.
    return np.minimum(_bends(left, len(session)), _bends(measured, len(session)))


def _bends(torque: Array, steps: int) -> Array:
    """Typical second difference around each step, as a standard deviation of the parts [Nm]; nan at the ends."""
    bends = np.abs(np.diff(torque, 2, prepend=torque[0], append=torque[-1])).reshape(steps, WITHIN)
    around = np.concatenate([np.roll(bends, by, axis=0) for by in range(-(OVER // 2), OVER // 2 + 1)], axis=1)
    found = MAD_TO_STD * np.median(around, axis=1) / math.sqrt(SECOND_DIFFERENCE)
    found[: OVER // 2] = found[steps - OVER // 2 :] = np.nan
    return np.asarray(found)


def _whole(session: DriveSession) -> Mask:
    """Used steps whose median has no step with the friction brakes: a corner of the torque there would count as oscillation."""
    known = session.used | (np.abs(session.speed) < PULLS_MPS)  # a step is also left out near standstill
    beside = [np.roll(known, by) for by in range(-(OVER // 2), OVER // 2 + 1)]
    return np.asarray(session.used & np.all(beside, axis=0))


def _regimes(fit: Fit) -> Iterator[tuple[str, Mask]]:
    """Regimes in words, and the mask of each."""
    sessions = fit.problem.sessions
    speed, accel, weight = (np.concatenate([getattr(s, name) for s in sessions]) for name in ("speed", "accel", "weight"))
    drive = np.concatenate([p.at_sprockets for p in fit.predicted]) * np.sign(speed)
    fast, accel = np.abs(speed), accel * np.sign(speed)
    yield "while it pulls away", (fast < PULLS_MPS) & (accel > PULLS_MPS2)
    yield "while it comes to a stop", (fast < PULLS_MPS) & (accel < -PULLS_MPS2)
    yield "while it speeds up", (fast >= PULLS_MPS) & (accel > SPEEDS_UP_MPS2)
    yield "while it slows down", (fast >= PULLS_MPS) & (accel < -SPEEDS_UP_MPS2)
    yield "while the motor brakes", drive < 0.0
    low, high = (float(x) for x in np.quantile(fast[np.concatenate([s.used for s in sessions])], (1.0 / 3.0, 2.0 / 3.0)))
    yield f"below {figures(low, 2)} m/s", fast < low
    yield f"from {figures(low, 2)} to {figures(high, 2)} m/s", (fast >= low) & (fast < high)
    yield f"above {figures(high, 2)} m/s", fast >= high
    middle = 0.5 * float(weight.min() + weight.max())
    if np.ptp(weight) > 0.05 * middle:
        yield f"with a load above {figures(middle, 2)} N", weight > middle
        yield f"with a load below {figures(middle, 2)} N", weight < middle


def _typical(size: Array, drive: Array, elsewhere: Mask) -> Array:
    """Oscillation elsewhere as a function of the torque: the root of a constant and a share of the torque, both squared [Nm]."""
    square = drive**2
    number = np.searchsorted(np.quantile(square[elsewhere], np.linspace(0.0, 1.0, BINS + 1)[1:-1]), square[elsewhere])
    bins = np.unique(number)
    at, seen = (np.array([np.median(x[elsewhere][number == i]) for i in bins]) for x in (square, size))
    scale = max(float(at.max()), 1e-12)
    columns = np.column_stack([np.ones(len(at)), at / scale]) / np.maximum(seen, 1e-9)[:, np.newaxis] ** 2
    (constant, share), _ = nnls(columns, np.ones(len(at)))
    return np.asarray(np.sqrt(np.maximum(constant + share * square / scale, 1e-12)))


def _compared(text: str, size: Array, drive: Array, inside: Mask, block: NDArray[np.int64], tried: int) -> Spread | None:
    """Oscillation in a regime against that elsewhere in the same laps; or in other laps, if no lap has both."""
    if min(inside.sum(), (~inside).sum()) < BINS * FEWEST_STEPS:
        return None
    typical = _typical(size, drive, ~inside)
    there, elsewhere = (_medians(size / typical, of, block) for of in (inside, ~inside))
    both = sorted(there.keys() & elsewhere.keys())
    if len(both) >= FEWEST_LAPS:
        ratios = np.log([there[lap] / elsewhere[lap] for lap in both])
        mean, std, degrees = float(ratios.mean()), float(ratios.std(ddof=1)) / math.sqrt(len(both)), len(both) - 1.0
    elif not both and min(len(there), len(elsewhere)) >= FEWEST_LAPS:
        a, b = np.log(list(there.values())), np.log(list(elsewhere.values()))
        mean, degrees = float(a.mean() - b.mean()), min(len(a), len(b)) - 1.0
        std = math.hypot(a.std(ddof=1) / math.sqrt(len(a)), b.std(ddof=1) / math.sqrt(len(b)))
    else:
        return None
    p = float(stdtr(degrees, (math.log(SURELY_RATIO) - mean) / max(std, 1e-9))) * tried
    laps = len(both) or len(there) + len(elsewhere)
    size_nm = float(np.median(size[inside]))
    return Spread(text, size_nm, math.exp(mean), min(1.0, p), laps)


def _medians(size: Array, inside: Mask, block: NDArray[np.int64]) -> dict[int, float]:
    """Median of the oscillation by lap, of laps with enough steps."""
    found = {int(lap): size[inside & (block == lap)] for lap in np.unique(block[inside])}
    return {lap: max(float(np.median(x)), 1e-9) for lap, x in found.items() if len(x) >= FEWEST_STEPS}
