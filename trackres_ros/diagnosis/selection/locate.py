# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Step 3: locates a mismatch: by regime, in time, and by the variable that an effect or a residual follows.

Mean residuals by bins of the physical variables are corrected for multiple tests. Lasting changes of a residual's level show
another ground, a new load or a failed part. A torque of a lap is predicted by the means of the other laps in cells of equal
samples, of one recorded channel or of two: so the channel that comes closest is known, and how much of the torque it explains.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import kolmogorov

from trackres_ros.diagnosis.base.base import Predicted
from trackres_ros.diagnosis.base.variables import BY_NAME, varying_series
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Array, DriveSession, Mask
from trackres_ros.text import figures, on_scale
from trackres_ros.units import GRAVITY


def torque_residuals(fit: Fit) -> list[Array]:
    """Measured less expected torque of each session [Nm]."""
    return [s.torque - p.torque for s, p in zip(fit.problem.sessions, fit.predicted, strict=True)]


def against_travel(sessions: Sequence[DriveSession], torques: Sequence[Array]) -> list[Array]:
    """A torque as a resistance: positive against travel in both directions."""
    return [x * np.sign(s.speed) for s, x in zip(sessions, torques, strict=True)]


REGIME_BINS = 6
FEWEST_IN_BIN = 30
FLIPPED_TOGETHER = 20
REPLICATES = 4000  # determines a probability of 0.01 to a sixth of its value
AT_ONCE = 100  # of these: a hundred hours have ten thousand pieces


@dataclass(frozen=True, slots=True)
class Bin:
    """A range of a variable, the mean residual against travel there [Nm], and the probability that noise alone reaches it in
    any bin.
    """

    variable: str
    low: float
    high: float
    mean_residual: float
    unit: str
    samples: int
    p: float


@dataclass(frozen=True, eq=False)
class RegimeMap:
    """All bins, and the probability that noise alone makes the largest of them."""

    bins: tuple[Bin, ...]
    p: float
    samples: int

    @property
    def significant(self) -> tuple[Bin, ...]:
        """Significant bins, the clearest first."""
        return tuple(sorted((b for b in self.bins if b.p < 0.05), key=lambda b: (b.p, -abs(b.mean_residual))))

    def likeliest(self, variable: str, low: float, high: float) -> float:
        """Least probability of the bins of a variable that overlap a range; 1 without any."""
        return min((b.p for b in self.bins if b.variable == variable and b.low < high and b.high > low), default=1.0)


def regime_map(fit: Fit, rng: np.random.Generator, predictions: Sequence[Predicted] | None = None) -> RegimeMap:
    """Bin the residual of a fit over every variable that varies.

    `predictions`: belt temperatures and the like that divide into bins, if not those of the fit.

    Notes
    -----
    The mean is of the plain residual against travel [Nm]. Its significance is tested on the whitened one, against the
    largest over all bins with random sign flips of whole pieces (max-T). Steps in which the vehicle turns back are left out:
    they have no direction of travel.
    """
    sessions = fit.problem.sessions
    rows = fit.white[: len(sessions)]
    turns_back = np.concatenate([np.abs(s.speed) < 0.5 * s.step * np.abs(s.accel) for s in sessions])
    is_valid = np.isfinite(np.concatenate(rows)) & ~turns_back
    e, plain_residual = (np.concatenate(against_travel(sessions, values))[is_valid] for values in (rows, torque_residuals(fit)))
    pieces = _pieces(rows)[is_valid]
    members, bins = [], []
    for name, series in varying_series(sessions, predictions or fit.predicted).items():
        values = series[is_valid]
        for low, high in _edges(values):
            is_inside = (values >= low) & (values <= high)
            if is_inside.sum() >= FEWEST_IN_BIN:
                members.append(is_inside)
                bins.append((name, low, high, float(plain_residual[is_inside].mean()), BY_NAME[name].unit, int(is_inside.sum())))
    if not bins:
        return RegimeMap((), 1.0, len(e))
    number = np.unique(pieces, return_inverse=True)[1]
    sums = np.array(
        [np.bincount(number, weights=np.where(is_inside, e, 0.0), minlength=number.max() + 1) for is_inside in members]
    )
    middle = sums - sums.mean(axis=1, keepdims=True) if sums.shape[1] > 1 else sums
    spread = np.sqrt((middle**2).sum(axis=1)) + 1e-12
    statistics = np.abs(sums.sum(axis=1)) / spread
    flips = (rng.choice((-1.0, 1.0), (AT_ONCE, sums.shape[1])) for _ in range(REPLICATES // AT_ONCE))
    largest_scores = np.concatenate([np.abs(signs @ middle.T / spread).max(axis=1) for signs in flips])
    p = (1.0 + (largest_scores[:, np.newaxis] >= statistics).sum(axis=0)) / (REPLICATES + 1.0)
    return RegimeMap(tuple(Bin(*values, p=float(q)) for values, q in zip(bins, p, strict=True)), float(p.min()), len(e))


def cumulative_periodogram(fit: Fit) -> float:
    """Probability that white noise deviates as far from a flat spectrum as the whitened residual (Bartlett's test).

    Each recording has its own scale, and all are cumulated together from the lowest frequency on.
    """
    rows = [white[np.isfinite(white)] for white in fit.white[: len(fit.problem.sessions)]]
    spectra = [(np.fft.rfftfreq(len(e))[1:-1], np.abs(np.fft.rfft(e)[1:-1]) ** 2) for e in rows if len(e)]  # of those fitted on
    flat_spectra = [(f, p / p.mean()) for f, p in spectra if p.sum() > 0.0]
    frequency, power = np.concatenate(flat_spectra, axis=1) if flat_spectra else np.empty((2, 0))
    power_sums = np.cumsum(power[np.argsort(frequency, kind="stable")])[:-1] / max(len(power), 1)
    count = len(power_sums)
    if not count:  # too short to show a shape
        return 1.0
    steps = np.arange(count + 1) / count
    distance = max(np.max(steps[1:] - power_sums), np.max(power_sums - steps[:-1]))
    return float(kolmogorov(distance * (math.sqrt(count) + 0.12 + 0.11 / math.sqrt(count))))  # Stephens (1970), of finite samples


def _edges(series: Array) -> list[tuple[float, float]]:
    edges = np.unique(np.quantile(series, np.linspace(0.0, 1.0, REGIME_BINS + 1))).tolist()
    return list(pairwise(edges)) or [(edges[0], edges[0])]


def _pieces(rows: Sequence[Array]) -> NDArray[np.int64]:
    """Number of the piece of each row, whose sign is flipped together."""
    begin, pieces = 0, []
    for row in rows:
        pieces.append(begin + np.arange(len(row)) // FLIPPED_TOGETHER)
        begin = int(pieces[-1][-1]) + 1
    return np.concatenate(pieces)


PIECE_S, MOST_PIECES = 30.0, 400  # the search time grows with their number squared; longer recordings have longer pieces
SHORTEST_PIECES = 4
COST_OF_A_CHANGE = 3.0  # times the logarithm of the number of pieces: for position, size, and the possible positions


@dataclass(frozen=True, slots=True)
class Change:
    """A time in a recording [s], and the mean residuals of the segments before and after it [Nm]."""

    recording: str
    time: float
    before: float
    after: float


def changes(fit: Fit) -> list[Change]:
    """Change points of the torque residual in each recording, by means of the whitened one over the std of such a mean."""
    points = []
    sessions, masks = fit.problem.sessions, fit.problem.masks
    series = fit.white[: len(sessions)], torque_residuals(fit)
    for session, mask, white, residual in zip(sessions, masks, *series, strict=True):
        is_valid = np.isfinite(white)
        shortest_s = PIECE_S * session.pace
        length = shortest_s * max(1, -(-int(session.time[-1] // shortest_s + 1) // MOST_PIECES))
        piece = (session.time // length).astype(int)
        count = np.bincount(piece[is_valid], minlength=piece[-1] + 1)
        is_filled = count > 0
        if is_filled.sum() < 2 * SHORTEST_PIECES:
            continue
        influence = white[is_valid] * fit.noise.weights(white[is_valid])
        level = np.bincount(piece[is_valid], weights=influence, minlength=len(count))[is_filled] / np.sqrt(count[is_filled])
        penalty = COST_OF_A_CHANGE * math.log(len(level))
        starts = np.flatnonzero(is_filled)
        edges = [0.0, *(length * starts[start_index] for start_index in segments(level, penalty)), np.inf]
        means = [float(residual[mask & (session.time >= a) & (session.time < b)].mean()) for a, b in pairwise(edges)]
        points += [Change(session.name, float(t), *levels) for t, levels in zip(edges[1:-1], pairwise(means), strict=True)]
    return points


def segments(level: Array, penalty: float) -> list[int]:
    """First index of each segment after the first one, of the split into constant segments with the least squares.

    A segment has at least `SHORTEST_PIECES` levels and costs `penalty` more. Exact, by dynamic programming (Jackson et al., IEEE
    Signal Processing Letters 12 (2005) 105, "An algorithm for optimal partitioning of data on an interval").
    """
    sums, squares = (np.concatenate(([0.0], np.cumsum(level**power))) for power in (1, 2))
    cost, first_rows = np.full(len(sums), np.inf), np.zeros(len(sums), int)
    cost[0] = 0.0
    for end in range(SHORTEST_PIECES, len(sums)):
        begin = np.arange(end - SHORTEST_PIECES + 1)
        total = cost[begin] + squares[end] - squares[begin] - (sums[end] - sums[begin]) ** 2 / (end - begin) + penalty
        first_rows[end] = int(total.argmin())
        cost[end] = total[first_rows[end]]
    starts = [int(first_rows[-1])]
    while starts[-1]:
        starts.append(int(first_rows[starts[-1]]))
    return starts[-2::-1]


FOLLOWS_LEAST = 0.3  # of the mean square: a smaller share means that a torque follows no variable
CLEARLY = 1.25  # times the share of a simpler or better known variable: needed to attribute a torque to another
CELLS, CELLS_OF_PAIR = 12, 4  # of a channel, alone and with another


def closest_channel(fit: Fit, torques: Sequence[Array]) -> str:
    """Sentence on the recorded channel, or the two, that explain most of a torque of each session; nan where unknown."""
    sessions, torque = fit.problem.sessions, np.concatenate(torques)
    used_steps = np.concatenate([s.used for s in sessions]) & np.isfinite(torque)
    _, laps = np.unique(np.concatenate([s.block for s in sessions])[used_steps], return_inverse=True)
    series_by_name = {name: x for name, x in varying_series(sessions, fit.predicted).items() if not BY_NAME[name].as_clock}
    series_by_name["driving torque"] = np.concatenate(
        [p.at_sprockets * s.ahead for p, s in zip(fit.predicted, sessions, strict=True)]
    )
    if all("grade" in s.given for s in sessions):
        series_by_name["slope"] = np.concatenate([s.grade for s in sessions])
    channels = {
        name: x[used_steps] for name, x in series_by_name.items() if np.isfinite(x[used_steps]).all() and used_steps.any()
    }
    if not channels:
        return "No channel is known throughout"
    cells_by_name = {name: _cells(x, CELLS_OF_PAIR) for name, x in channels.items()}
    shares: dict[tuple[str, ...], float] = {}
    for name, x in channels.items():
        shares[(name,)] = _explained_share(torque[used_steps], _cells(x, CELLS), laps)
    for a, b in combinations(channels, 2):
        shares[a, b] = _explained_share(torque[used_steps], CELLS_OF_PAIR * cells_by_name[a] + cells_by_name[b], laps)
    best_names = max(shares, key=lambda names: shares[names] / (CLEARLY if len(names) > 1 else 1.0))
    name, share = " with ".join(best_names), f"{100.0 * shares[best_names]:.0f} %"
    if shares[best_names] < FOLLOWS_LEAST:
        return f"It follows no recorded or simulated channel: the best, {name}, explains {share} of it"
    return f"Of the recorded and simulated channels, {name} comes closest: it explains {share} of it"


def evenly_filled(x: Array, bins: int) -> tuple[Array, NDArray[np.int64]]:
    """Edges of at most `bins` equally filled bins, and the bin of each sample."""
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, bins + 1)))
    return edges, np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))


def _cells(x: Array, bins: int) -> NDArray[np.int64]:
    return evenly_filled(x, bins)[1]


def _explained_share(torque: Array, cells: NDArray[np.int64], laps: NDArray[np.int64]) -> float:
    """Share of the variance of a torque that the means of its cells over the other laps explain, at least zero."""
    number, width = int(laps.max()) + 1, int(cells.max()) + 1
    cell = laps * width + cells
    size = number * width
    count, total = (np.bincount(cell, w, size).reshape(number, width) for w in (None, torque))
    other_counts, sums = (x.sum(axis=0) - x if number > 1 else x for x in (count, total))
    means = np.where(other_counts > 0.0, sums / np.maximum(other_counts, 1.0), torque.mean()).ravel()
    variance = float(np.var(torque))
    return max(0.0, 1.0 - float(np.mean((torque - means[cell]) ** 2)) / variance) if variance > 0.0 else 0.0


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
    used_values = np.concatenate([np.abs(x[s.used]) for x, s in zip(series, sessions, strict=True)])
    if not len(used_values) or not used_values.max() > 0.0:
        return []
    limit = ACTING_SHARE * float(np.percentile(used_values, 95.0))
    periods: list[Span] = []
    for session, x in zip(sessions, series, strict=True):
        is_acting = (np.abs(x) >= limit) & session.used
        for begin, end in session.stretches(is_acting):
            last = periods[-1] if periods and periods[-1].recording == session.name else None
            if last and begin - last.end <= JOINED_S * session.pace:
                periods[-1] = replace(last, end=end)
            else:
                periods.append(Span(session.name, begin, end))
    long_periods = [s for s in periods if s.end - s.begin >= SHORTEST_S * sessions[0].pace]
    longest_periods = sorted(long_periods, key=lambda s: s.begin - s.end)[:MOST_SPANS]
    return [s for s in long_periods if s in longest_periods]


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
        full_range = self.most - self.least
        from_start, to_end = self.low <= self.least, self.high >= self.most
        if (from_start and to_end) or self.both_ways:
            return ""
        low, high = (on_scale(edge, full_range) for edge in (self.low, self.high))
        if to_end:
            return f"above {low} {self.unit} of {self.variable}"
        if from_start:
            return f"below {high} {self.unit} of {self.variable}"
        return f"from {low} to {high} {self.unit} of {self.variable}"

    @property
    def tightest_m(self) -> float | None:
        """Radius of the widest curve in which an effect acts that needs a curvature, as its text has it [m]; else None."""
        above = self.low > self.least and self.high >= self.most and not self.both_ways
        edge = float(on_scale(self.low, self.most - self.least)) if above and self.variable == "curvature" else 0.0
        return 1.0 / edge if edge > 0.0 else None

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
            range_text = f"from {in_nm(-self.smallest)} Nm less to {in_nm(self.largest)} Nm more"
            return f"the {noun} needs {range_text} than the model, depending on the {self.variable}"
        return f"the {noun} needs about {in_nm(abs(self.mean))} Nm {'more' if self.mean > 0.0 else 'less'} than the model"


def in_nm(torque: float) -> str:
    """A torque in whole Nm, or with significant figures below 1 Nm, as for a small machine."""
    return f"{torque:.0f}" if torque >= 0.5 else figures(torque, 2)


def steps_within(variable: str, low: float, high: float, session: DriveSession, prediction: Predicted) -> Mask:
    """The compared steps of a session within a range of a variable."""
    series = BY_NAME[variable].of(session, prediction)
    return np.asarray(session.used & (series >= low) & (series <= high))


def locate(fit: Fit, adds: Sequence[Array]) -> Location:
    """The variable whose bins explain most of a series, and their range where the series is large."""
    sessions = fit.problem.sessions
    used_steps = np.concatenate([s.used for s in sessions])
    series = np.concatenate(adds)[used_steps]
    square = float(np.mean(series**2))
    best_share, result = -1.0, Location("speed", "m/s", -np.inf, np.inf, -np.inf, np.inf, 0.0, 0.0, 0.0)
    shares: dict[str, float] = {}
    # Time-like variables follow every single change in a drive, so they must explain clearly more.
    for name, values in sorted(varying_series(sessions, fit.predicted).items(), key=lambda item: BY_NAME[item[0]].as_clock):
        x = values[used_steps]
        if np.ptp(x) == 0.0:
            continue
        edges, place = evenly_filled(x, BINS)
        count = np.maximum(np.bincount(place), 1)
        means = np.bincount(place, weights=series) / count
        explained_variance = float(np.var(means[place]))
        shares[name] = explained_variance
        if explained_variance > best_share * (CLEARLY if BY_NAME[name].as_clock else TIED) + 1e-9:
            best_share = explained_variance
            size = np.bincount(place, weights=np.abs(series)) / count
            large_bins = np.flatnonzero(size >= ACTING_SHARE * size.max())
            low, high, end_margin = edges[large_bins[0]], edges[min(large_bins[-1] + 1, len(edges) - 1)], NEAR_END * np.ptp(edges)
            low, high = edges[0] if low - edges[0] < end_margin else low, edges[-1] if edges[-1] - high < end_margin else high
            result = Location(
                name, BY_NAME[name].unit, float(low), float(high), float(edges[0]), float(edges[-1]),
                min(0.0, float(means.min())), max(0.0, float(means.max())),
                float(np.mean(means[place] ** 2)) / max(square, 1e-300),
                float(np.mean(series[(x >= low) & (x <= high)])), math.sqrt(square),
            )  # fmt: skip
    as_clock = BY_NAME[result.variable].as_clock
    similar_names = (name for name, x in shares.items() if name != result.variable and BY_NAME[name].as_clock == as_clock)
    return replace(result, alike=tuple(name for name in similar_names if TIED * shares[name] >= best_share))


def smooth_residual(session: DriveSession, residual: Array, seconds: float = SMOOTHED_S) -> Array:
    """Moving averages of a residual over some seconds of a drive, see `session.pace`; nan in gaps."""

    def summed(values: Array, over_s: float) -> Array:
        window = np.ones(min(max(1, int(over_s * session.pace / session.step)), len(values)))
        return np.convolve(values, window, mode="same")

    weight = summed(session.used.astype(float), seconds)
    mean = summed(np.where(session.used, residual, 0.0), seconds) / np.maximum(weight, 1.0)
    return np.where(summed(session.used.astype(float), BROKEN_S) > 0.5, mean, np.nan)


def rms_over_time(means: Sequence[Array]) -> tuple[list[float], float]:
    """Root mean square of a `smoothed` residual, of each session and of all their time [Nm]."""
    *sizes, total = (float(np.sqrt(np.nanmean(r**2))) if np.isfinite(r).any() else 0.0 for r in (*means, np.concatenate(means)))
    return sizes, total


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


def slow_residual(fit: Fit) -> SlowResidual:
    """Residual torque that lasts longer than noise."""
    means, torques, problem = [], [], fit.problem
    for session, mask, residual in zip(problem.sessions, problem.masks, torque_residuals(fit), strict=True):
        slow_s = SLOW_S * session.pace
        number = (session.time // slow_s).astype(int)
        count = np.bincount(number[mask])
        sums = np.bincount(number[mask], weights=residual[mask])
        is_full = count * session.step > 0.5 * slow_s
        means.append(sums[is_full] / count[is_full])
        torques.append(session.torque[mask])
    size = float(np.sqrt(np.mean(np.concatenate(means) ** 2))) if sum(map(len, means)) else 0.0
    torque = float(np.sqrt(np.mean(np.concatenate(torques) ** 2)))
    base = problem.base
    measured = all("grade" in s.given for s in problem.sessions) or not base.rolls
    slope = float("nan") if measured else size / (base.facts.weight * base.facts.radius)
    return SlowResidual(size, size / max(torque, 1e-12), slope, SLOW_S * problem.sessions[0].pace)


def is_like_slope(fit: Fit) -> bool:
    """Whether an unrecorded slope may be the residual: most of its variation lasts longer than noise."""
    summary = slow_residual(fit)
    residual = np.concatenate([r[m] for r, m in zip(torque_residuals(fit), fit.problem.masks, strict=True)])
    offset = float(np.nanmean(residual))
    return math.isfinite(summary.slope) and summary.size**2 - offset**2 > MOSTLY * float(np.nanvar(residual))


def only_later(base_fit: Fit, unused_error: float) -> tuple[float, float] | None:
    """Mean absolute errors on the fitted and the hold-out laps [Nm], if the latter, `unused_error`, is much larger; else None."""
    torques = [s.torque for s in base_fit.problem.sessions]
    error, torque = (
        float(np.nanmean(np.abs(np.concatenate([x[m] for x, m in zip(series, base_fit.problem.masks, strict=True)]))))
        for series in (torque_residuals(base_fit), torques)
    )
    return (error, unused_error) if unused_error > max(LATER * error, error + LATER_SHARE * torque) else None


def regime_of(base_fit: Fit, final_fit: Fit, at_base: RegimeMap, location: Location) -> tuple[Bin, ...]:
    """Residual of the base against travel where an effect of `final_fit` acts, and its other significant bins."""
    sessions, limits = base_fit.problem.sessions, (location.variable, location.low, location.high)
    masks_inside = [steps_within(*limits, s, p) for s, p in zip(sessions, final_fit.predicted, strict=True)]
    residual = np.concatenate(against_travel(sessions, torque_residuals(base_fit)))[np.concatenate(masks_inside)]
    mean = float(residual.mean()) if len(residual) else 0.0
    local_bin = Bin(*limits, mean, location.unit, len(residual), at_base.likeliest(*limits))
    return (local_bin, *(b for b in at_base.significant if b.variable != location.variable))


def thermal_check(fit: Fit) -> ThermalCheck | None:
    """Compare measured and simulated belt temperature; None without a measured one."""
    belt_residuals = [r[g.mask] for r, g in zip(fit.residuals, fit.problem.segments, strict=True) if g.kind == "belt"]
    differences = np.concatenate([np.empty(0), *belt_residuals])
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
    used_sessions = [s for s, mask in zip(sessions, masks, strict=True) if mask.any()]
    of_torque = float(np.sqrt(torque)) if all(s.torque_noise > 0.0 for s in used_sessions) else None
    of_speed = float(np.sqrt(speed)) if all(s.accel_noise > 0.0 for s in used_sessions) else None
    model = float(np.sqrt(max(squares - torque - speed, 0.0)))
    return ResidualSources(float(np.sqrt(squares)), of_torque, of_speed, model, sessions[0].step)
