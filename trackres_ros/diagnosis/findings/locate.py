# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Step 3: locates a mismatch: when an effect acts, and the shares of sensors, belt temperature and model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trackres_ros.diagnosis.base.base import Predicted
from trackres_ros.diagnosis.base.variables import BY_NAME, varying
from trackres_ros.diagnosis.empirical.closest import CLEARLY, FOLLOWS_LEAST, evenly_filled
from trackres_ros.diagnosis.empirical.torque import against_travel, torque_residuals
from trackres_ros.diagnosis.findings.residual_bins import Bin, RegimeMap
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Array, DriveSession, Mask
from trackres_ros.text import figures, on_scale
from trackres_ros.units import GRAVITY

ACTING_SHARE = 0.5  # of its 95th percentile
BOTH_WAYS_SHARE = 0.25  # of the larger side: an effect with more than this on the other side changes its sign
JOINED_S, SHORTEST_S = 10.0, 5.0
MOSTLY = 0.5  # of the variance
SLOW_S = 30.0
SMOOTHED_S = 20.0  # for the residual over time in plots
BROKEN_S = 2.0  # a longer time without a compared sample breaks the line
MOST_SPANS = 60
NEAR_END = 0.1  # of its whole range: a range that ends nearer to an end of that reaches it
TIED = 1.02  # of the share: a variable that explains less more than another explains as much
BINS = 12
LATER = 2.0  # times the error on the fitted laps: a larger one on the hold-out laps needs a separate cause
LATER_SHARE = 0.015  # of the torque: least additional error


@dataclass(frozen=True, slots=True)
class Span:
    """A time in a recording [s]."""

    recording: str
    begin: float
    end: float


@dataclass(frozen=True, slots=True)
class ThermalCheck:
    """Measured less simulated belt temperature [K]: mean and mean size; in words too."""

    mean_k: float
    mean_abs_k: float
    text: str


def spans(sessions: tuple[DriveSession, ...], series: list[Array]) -> list[Span]:
    """Times when a series is large: at least `ACTING_SHARE` of its 95th percentile."""
    used = np.concatenate([np.abs(x[s.used]) for x, s in zip(series, sessions, strict=True)])
    if not len(used) or not used.max() > 0.0:
        return []
    limit = ACTING_SHARE * float(np.percentile(used, 95.0))
    found: list[Span] = []
    for session, x in zip(sessions, series, strict=True):
        acting = (np.abs(x) >= limit) & session.used
        for begin, end in session.stretches(acting):
            last = found[-1] if found and found[-1].recording == session.name else None
            if last and begin - last.end <= JOINED_S * session.pace:
                found[-1] = replace(last, end=end)
            else:
                found.append(Span(session.name, begin, end))
    lasting = [s for s in found if s.end - s.begin >= SHORTEST_S * sessions[0].pace]
    longest = sorted(lasting, key=lambda s: s.begin - s.end)[:MOST_SPANS]
    return [s for s in lasting if s in longest]


@dataclass(frozen=True, slots=True)
class Location:
    """Location and size of an effect."""

    variable: str  # the one that explains the effect best
    unit: str
    low: float  # of its range where the effect is large
    high: float
    least: float  # of its range anywhere
    most: float
    smallest: float  # mean of the effect's torque over bins of the variable [Nm]
    largest: float
    follows: float  # share of the effect's mean square that the variable explains
    mean: float = 0.0  # of the effect's torque within the range [Nm]
    rms: float = 0.0  # of it, root mean square over all [Nm]
    alike: tuple[str, ...] = ()  # other variables that explain it as well in these drives

    @property
    def text(self) -> str:
        """The range in words; empty if it is everywhere, or if the sign changes over the range."""
        whole = self.most - self.least
        from_start, to_end = self.low <= self.least, self.high >= self.most
        if (from_start and to_end) or self.both_ways:
            return ""
        low, high = (on_scale(edge, whole) for edge in (self.low, self.high))
        if to_end:
            return f"above {low} {self.unit} of {self.variable}"
        if from_start:
            return f"below {high} {self.unit} of {self.variable}"
        return f"from {low} to {high} {self.unit} of {self.variable}"

    @property
    def both_ways(self) -> bool:
        """Whether the effect increases the torque in one part of the range and reduces it in another."""
        return min(self.largest, -self.smallest) >= BOTH_WAYS_SHARE * max(self.largest, -self.smallest)

    def size(self, noun: str) -> str:
        """The effect's own torque, in words. The residual of a base that absorbed a part of it is smaller."""
        if self.follows < FOLLOWS_LEAST:
            size = f"with a root mean square of {in_nm(self.rms)} Nm"
            return f"the {noun} needs sometimes more and sometimes less than the model, {size}"
        if self.both_ways:
            between = f"from {in_nm(-self.smallest)} Nm less to {in_nm(self.largest)} Nm more"
            return f"the {noun} needs {between} than the model, depending on the {self.variable}"
        return f"the {noun} needs about {in_nm(abs(self.mean))} Nm {'more' if self.mean > 0.0 else 'less'} than the model"


def in_nm(torque: float) -> str:
    """A torque in whole Nm, or with significant figures below 1 Nm, as for a small machine."""
    return f"{torque:.0f}" if torque >= 0.5 else figures(torque, 2)


def within(variable: str, low: float, high: float, session: DriveSession, predicted: Predicted) -> Mask:
    """The compared steps of a session within a range of a variable."""
    series = BY_NAME[variable].of(session, predicted)
    return np.asarray(session.used & (series >= low) & (series <= high))


def locate(found: Fit, adds: Sequence[Array]) -> Location:
    """The variable whose bins explain most of a series, and their range where the series is large."""
    sessions = found.problem.sessions
    used = np.concatenate([s.used for s in sessions])
    series = np.concatenate(adds)[used]
    square = float(np.mean(series**2))
    best, result = -1.0, Location("speed", "m/s", -np.inf, np.inf, -np.inf, np.inf, 0.0, 0.0, 0.0)
    shares: dict[str, float] = {}
    # Time-like variables follow every single change in a drive, so they must explain clearly more.
    for name, everywhere in sorted(varying(sessions, found.predicted).items(), key=lambda item: BY_NAME[item[0]].as_clock):
        x = everywhere[used]
        if np.ptp(x) == 0.0:
            continue
        edges, place = evenly_filled(x, BINS)
        count = np.maximum(np.bincount(place), 1)
        means = np.bincount(place, weights=series) / count
        explained = float(np.var(means[place]))
        shares[name] = explained
        if explained > best * (CLEARLY if BY_NAME[name].as_clock else TIED) + 1e-9:
            best = explained
            size = np.bincount(place, weights=np.abs(series)) / count
            large = np.flatnonzero(size >= ACTING_SHARE * size.max())
            low, high, near = edges[large[0]], edges[min(large[-1] + 1, len(edges) - 1)], NEAR_END * np.ptp(edges)
            low, high = edges[0] if low - edges[0] < near else low, edges[-1] if edges[-1] - high < near else high
            result = Location(
                name, BY_NAME[name].unit, float(low), float(high), float(edges[0]), float(edges[-1]),
                min(0.0, float(means.min())), max(0.0, float(means.max())),
                float(np.mean(means[place] ** 2)) / max(square, 1e-300),
                float(np.mean(series[(x >= low) & (x <= high)])), math.sqrt(square),
            )  # fmt: skip
    as_clock = BY_NAME[result.variable].as_clock
    alike = (name for name, x in shares.items() if name != result.variable and BY_NAME[name].as_clock == as_clock)
    return replace(result, alike=tuple(name for name in alike if TIED * shares[name] >= best))


def smoothed(session: DriveSession, residual: Array, seconds: float = SMOOTHED_S) -> Array:
    """Moving averages of a residual over some seconds of a drive, see `settings.pace`; nan in gaps."""

    def summed(values: Array, over_s: float) -> Array:
        window = np.ones(min(max(1, int(over_s * session.pace / session.step)), len(values)))
        return np.convolve(values, window, mode="same")

    weight = summed(session.used.astype(float), seconds)
    mean = summed(np.where(session.used, residual, 0.0), seconds) / np.maximum(weight, 1.0)
    return np.where(summed(session.used.astype(float), BROKEN_S) > 0.5, mean, np.nan)


def rms_over_time(means: Sequence[Array]) -> tuple[list[float], float]:
    """Root mean square of a `smoothed` residual, of each session and of all their time [Nm]."""
    *sizes, of_all = (float(np.sqrt(np.nanmean(r**2))) if np.isfinite(r).any() else 0.0 for r in (*means, np.concatenate(means)))
    return sizes, of_all


@dataclass(frozen=True, slots=True)
class SlowResidual:
    """Root mean square of the torque residual in means over `SLOW_S` of a drive [Nm]; its share of the torque, the
    equivalent slope, nan where it was measured or nothing rolls, the averaging time here [s], and the recorded channel that
    comes closest, in a sentence.
    """

    size: float
    share: float
    slope: float
    seconds: float = SLOW_S
    closest: str = ""


def slow_residual(found: Fit) -> SlowResidual:
    """Residual torque that lasts longer than noise."""
    means, torques, problem = [], [], found.problem
    for session, mask, residual in zip(problem.sessions, problem.masks, torque_residuals(found), strict=True):
        slow_s = SLOW_S * session.pace
        number = (session.time // slow_s).astype(int)
        count = np.bincount(number[mask])
        sums = np.bincount(number[mask], weights=residual[mask])
        full = count * session.step > 0.5 * slow_s
        means.append(sums[full] / count[full])
        torques.append(session.torque[mask])
    size = float(np.sqrt(np.mean(np.concatenate(means) ** 2))) if sum(map(len, means)) else 0.0
    torque = float(np.sqrt(np.mean(np.concatenate(torques) ** 2)))
    base = problem.base
    measured = all("grade" in s.given for s in problem.sessions) or not base.rolls
    slope = float("nan") if measured else size / (base.facts.weight * base.facts.radius)
    return SlowResidual(size, size / max(torque, 1e-12), slope, SLOW_S * problem.sessions[0].pace)


def is_like_slope(found: Fit) -> bool:
    """Whether an unrecorded slope may be the residual: most of its variation lasts longer than noise."""
    slow = slow_residual(found)
    every = np.concatenate([r[m] for r, m in zip(torque_residuals(found), found.problem.masks, strict=True)])
    offset = float(np.nanmean(every))
    return math.isfinite(slow.slope) and slow.size**2 - offset**2 > MOSTLY * float(np.nanvar(every))


def only_later(refitted: Fit, unused: float) -> tuple[float, float] | None:
    """Mean absolute errors on the fitted and the `unused` hold-out laps [Nm], if the latter is much larger; else None."""
    torques = [s.torque for s in refitted.problem.sessions]
    error, torque = (
        float(np.nanmean(np.abs(np.concatenate([x[m] for x, m in zip(of, refitted.problem.masks, strict=True)]))))
        for of in (torque_residuals(refitted), torques)
    )
    return (error, unused) if unused > max(LATER * error, error + LATER_SHARE * torque) else None


def regime_of(refitted: Fit, final: Fit, at_base: RegimeMap, where: Location) -> tuple[Bin, ...]:
    """Residual of the base against travel where an effect of the `final` fit acts, and its other significant bins."""
    sessions, limits = refitted.problem.sessions, (where.variable, where.low, where.high)
    inside = [within(*limits, s, p) for s, p in zip(sessions, final.predicted, strict=True)]
    residual = np.concatenate(against_travel(sessions, torque_residuals(refitted)))[np.concatenate(inside)]
    mean = float(residual.mean()) if len(residual) else 0.0
    here = Bin(*limits, mean, where.unit, len(residual), at_base.likeliest(*limits))
    return (here, *(b for b in at_base.significant if b.variable != where.variable))


def thermal_check(found: Fit) -> ThermalCheck | None:
    """Compare measured and simulated belt temperature; None without a measured one."""
    of_belts = [r[g.mask] for r, g in zip(found.residuals, found.problem.segments, strict=True) if g.kind == "belt"]
    differences = np.concatenate([np.empty(0), *of_belts])
    if not len(differences):
        return None
    mean, size = float(differences.mean()), float(np.abs(differences).mean())
    side = "above" if mean > 0 else "below"
    offset = f"the measured belt temperature is {abs(mean):.1f} K {side} the simulated one on average"
    text = f"{offset}, with a mean error of {size:.1f} K"
    return ThermalCheck(mean, size, text)


@dataclass(frozen=True, slots=True)
class ResidualSources:
    """Root mean squares over steps of a session's length [Nm]."""

    total: float
    torque_sensor: float | None  # sample-to-sample noise of the torque; None where unknown
    speed_sensor: float | None  # inertia times the error of the smoothed acceleration; None where unknown
    model: float  # upper bound: the rest, which includes slow errors of sensors
    step: float = 1.0  # s

    @property
    def text(self) -> str:
        """Summary in words."""

        def size(value: float | None) -> str:
            return "an unknown part" if value is None else f"{figures(value)} Nm"

        return (
            f"The residual is {figures(self.total)} Nm in steps of {self.step:g} s. The torque sensor's noise contributes "
            f"{size(self.torque_sensor)}, the speed sensor {size(self.speed_sensor)} (inertia times the error of the smoothed "
            f"acceleration). The model contributes at most {size(self.model)}: the rest, including slow errors of the sensors"
        )


def residual_sources(fit: Fit) -> ResidualSources:
    """Split the torque residual by source; squares add up."""
    base, squares, torque, speed = fit.problem.base, 0.0, 0.0, 0.0
    sessions, masks = fit.problem.sessions, fit.problem.masks
    count = sum(int(mask.sum()) for mask in masks)
    for session, mask, residual in zip(sessions, masks, torque_residuals(fit), strict=True):
        squares += float((residual[mask] ** 2).sum()) / count
        inertia = base.facts.radius * base.rotating_mass_factor * session.weight[mask] / GRAVITY
        torque += session.torque_noise**2 * int(mask.sum()) / count
        speed += float(((inertia * session.accel_noise) ** 2).sum()) / count
    used = [s for s, mask in zip(sessions, masks, strict=True) if mask.any()]
    of_torque = float(np.sqrt(torque)) if all(s.torque_noise > 0.0 for s in used) else None
    of_speed = float(np.sqrt(speed)) if all(s.accel_noise > 0.0 for s in used) else None
    model = float(np.sqrt(max(squares - torque - speed, 0.0)))
    return ResidualSources(float(np.sqrt(squares)), of_torque, of_speed, model, sessions[0].step)
