# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Step 3: locates a mismatch: when an effect acts, and whether torque or temperature causes it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.base.variables import BY_NAME, varying
from trackres_ros.diagnosis.findings.residual_bins import Bin, RegimeMap
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import DriveSession
from trackres_ros.text.numbers import figures, on_scale

Array = NDArray[np.float64]

ACTING_SHARE = 0.5  # of its 95th percentile
BOTH_WAYS_SHARE = 0.25  # of the larger side: an effect with more than this on the other side changes its sign
FOLLOWS_LEAST = 0.3  # of the mean square: a smaller share means that the effect follows no variable
JOINED_S, SHORTEST_S = 10.0, 5.0
STRAY_S = 30.0
SMOOTHED_S = 20.0  # for the residual over time in plots
BROKEN_S = 2.0  # a longer time without a compared sample breaks the line
MOST_SPANS = 60
CLOCK_BY = 1.25  # times any other variable's share: needed to attribute an effect to time or distance
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
    """Measured less simulated belt temperature [K]: mean, mean size; and mean torque residual explained by that alone [Nm]."""

    mean_k: float
    mean_abs_k: float
    text: str


def seen_where_it_acts(sessions: Sequence[DriveSession], adds: Sequence[Array], residuals: Sequence[Array]) -> float:
    """Mean residual in the direction of a term [Nm], where the term exceeds `ACTING_SHARE` of its 95th percentile."""
    used = np.concatenate([s.used for s in sessions])
    term, residual = np.concatenate(adds)[used], np.concatenate(residuals)[used]
    acting = np.abs(term) >= ACTING_SHARE * np.percentile(np.abs(term), 95.0)
    return float(np.mean((residual * np.sign(term))[acting])) if acting.any() else 0.0


def spans(sessions: tuple[DriveSession, ...], series: list[Array]) -> list[Span]:
    """Times when a series is large: at least `ACTING_SHARE` of its 95th percentile."""
    used = np.concatenate([np.abs(x[s.used]) for x, s in zip(series, sessions, strict=True)])
    if not len(used) or not used.max() > 0.0:
        return []
    limit = ACTING_SHARE * float(np.percentile(used, 95.0))
    found: list[Span] = []
    for session, x in zip(sessions, series, strict=True):
        acting = (np.abs(x) >= limit) & session.used
        begins = session.time[np.flatnonzero(np.diff(acting.astype(int), prepend=0) == 1)]
        ends = session.time[np.flatnonzero(np.diff(acting.astype(int), append=0) == -1)] + session.step
        for begin, end in zip(begins, ends, strict=True):
            last = found[-1] if found and found[-1].recording == session.name else None
            if last and begin - last.end <= JOINED_S * session.pace:
                found[-1] = replace(last, end=float(end))
            else:
                found.append(Span(session.name, float(begin), float(end)))
    lasting = [s for s in found if s.end - s.begin >= SHORTEST_S * sessions[0].pace]
    longest = sorted(lasting, key=lambda s: s.begin - s.end)[:MOST_SPANS]
    return [s for s in lasting if s in longest]


def evenly_filled(x: Array, bins: int) -> tuple[Array, NDArray[np.int64]]:
    """Edges of at most `bins` equally filled bins, and the bin of each sample."""
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, bins + 1)))
    return edges, np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))


@dataclass(frozen=True, slots=True)
class Acts:
    """Location and size of an effect.

    Attributes
    ----------
    variable, unit
        The variable that explains the effect best.
    low, high
        Its range where the effect is large.
    least, most
        Its range anywhere.
    smallest, largest
        Least and greatest mean of the effect's torque, over bins of the variable [Nm].
    follows
        Share of the effect's mean square that the variable explains.
    """

    variable: str
    unit: str
    low: float
    high: float
    least: float
    most: float
    smallest: float
    largest: float
    follows: float

    @property
    def text(self) -> str:
        """The range in words; empty if it is everywhere, or if the sign changes over the range."""
        whole = self.most - self.least
        from_start, to_end = self.low - self.least < 0.1 * whole, self.most - self.high < 0.1 * whole
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

    def residual(self, here: Bin, at_base: RegimeMap, swings: float) -> str:
        """Residual of the re-fitted base where the effect acts, in words and with the numbers of the plots.

        Parameters
        ----------
        here
            The mean residual over the range of the variable in which the effect acts.
        at_base
            The residual by bins of each variable.
        swings
            Root mean square of the residual over time, see `swings_of` [Nm].
        """
        if self.follows < FOLLOWS_LEAST:
            size = f"with a root mean square of {in_nm(swings)} Nm"
            return f"the vehicle needs sometimes more and sometimes less torque than the re-fitted model, {size}"
        means = [b.mean_residual for b in at_base.bins if b.variable == self.variable]
        if self.both_ways and means and min(means) < 0.0 < max(means):
            low, high = -min(means), max(means)
            between = f"from {in_nm(low)} Nm less to {in_nm(high)} Nm more"
            return f"the vehicle needs {between} than the re-fitted model, depending on the {self.variable}"
        way = "more" if here.mean_residual > 0.0 else "less"
        return f"the vehicle needs about {in_nm(abs(here.mean_residual))} Nm {way} than the re-fitted model"


def in_nm(torque: float) -> str:
    """A torque in whole Nm, or with significant figures below 1 Nm, as for a small machine."""
    return f"{torque:.0f}" if torque >= 0.5 else figures(torque, 2)


def against_travel(sessions: Sequence[DriveSession], adds: Sequence[Array]) -> list[Array]:
    """A torque as a resistance: positive against travel in both directions."""
    return [x * np.sign(s.speed) for s, x in zip(sessions, adds, strict=True)]


def acts(found: Fit, adds: Sequence[Array]) -> Acts:
    """The variable whose bins explain most of a series, and their range where the series is large."""
    sessions = found.problem.sessions
    used = np.concatenate([s.used for s in sessions])
    series = np.concatenate(adds)[used]
    square = float(np.mean(series**2))
    best, result = -1.0, Acts("speed", "m/s", -np.inf, np.inf, -np.inf, np.inf, 0.0, 0.0, 0.0)
    # Time-like variables follow every single change in a drive, so they must explain clearly more.
    for name, everywhere in sorted(varying(sessions, found.predicted).items(), key=lambda item: BY_NAME[item[0]].as_clock):
        x = everywhere[used]
        if np.ptp(x) == 0.0:
            continue
        edges, place = evenly_filled(x, BINS)
        count = np.maximum(np.bincount(place), 1)
        means = np.bincount(place, weights=series) / count
        explained = float(np.var(means[place]))
        if explained > best * (CLOCK_BY if BY_NAME[name].as_clock else 1.02) + 1e-9:
            best = explained
            size = np.bincount(place, weights=np.abs(series)) / count
            large = np.flatnonzero(size >= ACTING_SHARE * size.max())
            high = edges[min(large[-1] + 1, len(edges) - 1)]
            result = Acts(
                name, BY_NAME[name].unit, float(edges[large[0]]), float(high), float(edges[0]), float(edges[-1]),
                min(0.0, float(means.min())), max(0.0, float(means.max())),
                float(np.mean(means[place] ** 2)) / max(square, 1e-300),
            )  # fmt: skip
    return result


def smoothed(session: DriveSession, residual: Array, seconds: float = SMOOTHED_S) -> Array:
    """Moving averages of a residual over some seconds of a drive, see `settings.pace`; nan in gaps."""

    def summed(values: Array, over_s: float) -> Array:
        window = np.ones(min(max(1, int(over_s * session.pace / session.step)), len(values)))
        return np.convolve(values, window, mode="same")

    weight = summed(session.used.astype(float), seconds)
    mean = summed(np.where(session.used, residual, 0.0), seconds) / np.maximum(weight, 1.0)
    return np.where(summed(session.used.astype(float), BROKEN_S) > 0.5, mean, np.nan)


def swings_of(means: Sequence[Array]) -> tuple[list[float], float]:
    """Root mean square of a `smoothed` residual, of each session and of all [Nm]."""
    sizes = [float(np.sqrt(np.nanmean(r**2))) if np.isfinite(r).any() else 0.0 for r in means]
    return sizes, float(np.sqrt(np.mean(np.square(sizes))))


@dataclass(frozen=True, slots=True)
class SlowResidual:
    """Root mean square of the torque residual in means over `STRAY_S` of a drive [Nm]; its share of the torque, the
    equivalent slope, nan where it was measured or nothing rolls, and the averaging time here [s].
    """

    size: float
    share: float
    slope: float
    seconds: float = STRAY_S


def slow_residual(found: Fit) -> SlowResidual:
    """Residual torque that lasts longer than noise."""
    means, torques = [], []
    for segment, residual in zip(found.problem.segments, found.residuals, strict=True):
        if segment.kind != "torque":
            continue
        session = found.problem.sessions[segment.session]
        stray_s = STRAY_S * session.pace
        number = (session.time // stray_s).astype(int)
        count = np.bincount(number[segment.mask])
        sums = np.bincount(number[segment.mask], weights=residual[segment.mask])
        full = count * session.step > 0.5 * stray_s
        means.append(sums[full] / count[full])
        torques.append(session.torque[segment.mask])
    size = float(np.sqrt(np.mean(np.concatenate(means) ** 2))) if sum(map(len, means)) else 0.0
    torque = float(np.sqrt(np.mean(np.concatenate(torques) ** 2)))
    base = found.problem.base
    measured = all("grade" in s.given for s in found.problem.sessions) or not base.rolls
    slope = float("nan") if measured else size / (base.facts.weight * base.facts.radius)
    return SlowResidual(size, size / max(torque, 1e-12), slope, STRAY_S * found.problem.sessions[0].pace)


def only_later(refitted: Fit, unused: float) -> tuple[float, float] | None:
    """Mean absolute errors on the fitted and the hold-out laps [Nm], if the latter is much larger; else None.

    Parameters
    ----------
    unused
        Mean absolute error on the hold-out laps [Nm].
    """
    of_torque = [(r, g) for r, g in zip(refitted.residuals, refitted.problem.segments, strict=True) if g.kind == "torque"]
    error = float(np.nanmean(np.abs(np.concatenate([r[g.mask] for r, g in of_torque]))))
    torque = float(np.nanmean(np.abs(np.concatenate([g.measured[g.mask] for _, g in of_torque]))))
    return (error, unused) if unused > max(LATER * error, error + LATER_SHARE * torque) else None


def regime_of(refitted: Fit, at_base: RegimeMap, where: Acts, resists: bool = False) -> tuple[Bin, ...]:
    """Residual of the base where an effect acts, against travel if it `resists`, and its other significant bins."""
    of = BY_NAME[where.variable].of
    inside, residuals = [], []
    for segment, residual in zip(refitted.problem.segments, refitted.residuals, strict=True):
        if segment.kind == "torque":
            session = refitted.problem.sessions[segment.session]
            x = of(session, refitted.predicted[segment.session])
            inside.append((x >= where.low) & (x <= where.high) & segment.mask)
            residuals.append(residual * np.sign(session.speed) if resists else residual)
    within = np.concatenate(residuals)[np.concatenate(inside)]
    p = at_base.likeliest(where.variable, where.low, where.high)
    mean = float(within.mean()) if len(within) else 0.0
    here = Bin(where.variable, where.low, where.high, mean, where.unit, len(within), p)
    return (here, *(b for b in at_base.significant if b.variable != where.variable))


def thermal_check(found: Fit) -> ThermalCheck | None:
    """Compare measured and simulated belt temperature; None without a measured one."""
    differences = [
        r[g.mask] for r, g in zip(found.residuals, found.problem.segments, strict=True) if g.kind == "belt" and g.mask.any()
    ]
    if not differences:
        return None
    d = np.concatenate(differences)
    mean, size = float(d.mean()), float(np.abs(d).mean())
    side = "above" if mean > 0 else "below"
    return ThermalCheck(
        mean,
        size,
        f"the measured belt temperature is {abs(mean):.1f} K {side} the simulated one on average, with a mean error of "
        f"{size:.1f} K",
    )
