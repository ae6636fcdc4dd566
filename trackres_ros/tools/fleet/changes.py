# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds changes of a vehicle's parameter: steps and trends.

Each recording is compared with the estimate from all recordings of the vehicle and from its type. A change is reported if it
raises the likelihood more than chance does. The rate of false alarms is given, however often one looks. A change that once
did so stays in the list after a repair, with its end.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from trackres_ros.tools.fleet.pooling import Array, Pooled
from trackres_ros.tools.fleet.task import FIRST_DAY_S

STEP, RAMP = "step", "ramp"
FALSE_ALARMS = 0.2  # per vehicle and year, one in 60 vehicle-months: rate of false alarms
DRAWS = 400
MOST_DRAWN_FOR = 120  # recordings of a vehicle in a draw of chance; more have the same thresholds
MOST_ENDS = 120  # of changes that ended, evenly over the recordings; the likeliest one is then refined
FEWEST = 2  # recordings on either side of a change
FEWEST_DURING = {STEP: FEWEST, RAMP: 5}  # recordings from its beginning to its end, or to the last
MOST_CHANGES = 3
LASTING = 1 << 62  # the end of a change that has none
UNLIKELY = 4.0  # in log-likelihood: a beginning, or a lasting change instead of one that ended, that is not considered
ROUNDS = 5  # of fitting the beginnings of several changes in turn
ALIKE = 2.0  # in log-likelihood: parameters that would explain it as well
TWO_SIDED_95 = 1.96
YEAR_S, DAY_S = 365.25 * 86400.0, 86400.0
TORQUE_GAIN, TORQUE_OFFSET = "torque_gain.error", "torque_offset.offset"
SUFFER_CHANGE = (
    "bearing_friction", "loss_modulus_scale", "drag_coefficient", "film_scale", TORQUE_GAIN, TORQUE_OFFSET,
)  # fmt: skip
"""Parameters to check for a change, if the base has them. More of each means more measured torque."""


class TrendLine(NamedTuple):
    """A trend if it begins with one recording: the parameter's value at the last one, and its slope per day."""

    value: float
    slope: float
    # their variances and covariance
    value_var: float
    slope_var: float
    covariance: float
    deficit: float  # the likeliest beginning [log-likelihood]


@dataclass(frozen=True, slots=True)
class VehicleChange:
    """A change of one parameter of one vehicle, fitted together with all its other changes."""

    # the changed parameter, and others that would explain it nearly as well
    parameter: str
    rivals: tuple[str, ...]
    kind: str  # ``step``, or ``ramp``: a trend
    # begin of the first recording after it, and of the one with which it was first significant [s since 1970]
    since_s: float
    known_s: float
    recordings: int  # number of recordings until then
    # the value at the recording before it, and its change up to the last recording or the end, in the parameter's unit
    level: float
    size: float
    size_std: float
    gain: float  # in log-likelihood, with all the other changes known
    lines: tuple[TrendLine, ...] = ()  # of a lasting ramp: with each plausible beginning, the likeliest first
    ended_s: float | None = None  # begin of the first recording with the value from before again; None if it lasts


@dataclass(frozen=True, eq=False)
class VehicleHistory:
    """Recordings of one vehicle in the order of time, with their likelihoods, see `Pooled`."""

    # reduced by the scatter of recordings, and without the dependence on the air
    precision: Array
    linear: Array
    # prior of the vehicle from its type: precision and precision times mean
    prior: Array
    right: Array
    time_s: Array  # begin of each
    looked_for: tuple[int, ...]  # indices of the parameters to check for a change

    def head(self, count: int) -> "VehicleHistory":
        """The first so many recordings."""
        return replace(self, precision=self.precision[:count], linear=self.linear[:count], time_s=self.time_s[:count])


class Event(NamedTuple):
    """A found change: its parameter, first recording and kind, and the first recording after it."""

    parameter: int
    begin: int
    kind: str
    end: int = LASTING


Candidate = tuple[int, str, int]  # first recording, kind and end of a change


def course(pooled: Pooled, vehicle: str) -> VehicleHistory:
    """Of one vehicle of the pool, without the recordings whose day is unknown: they have no place in it."""
    rows = (pooled.data.vehicle == vehicle) & (pooled.data.time_s > FIRST_DAY_S)
    data, precision, linear = pooled.likelihoods(rows)
    prior = np.asarray(np.linalg.inv(pooled.vehicle_scatter + pooled.covariance))
    looked_for = tuple(data.names.index(name) for name in SUFFER_CHANGE if name in data.names)
    return VehicleHistory(precision, linear, prior, prior @ pooled.mean, data.time_s, looked_for)


def shapes(time_s: Array, first: int, kind: str, end: int = LASTING) -> Array:
    """Shape of a change over the recordings, from one on until its end: 1, or days since the one before it."""
    number = np.arange(len(time_s))
    during = (number >= first) & (number < end)
    if kind == STEP:
        return during.astype(float)
    return np.where(during, (time_s - time_s[min(max(first, 1), len(time_s)) - 1]) / DAY_S, 0.0)


def _lasting(n: int) -> list[Candidate]:
    begins = ((STEP, FEWEST), (RAMP, 1))
    return [(first, kind, LASTING) for kind, begin in begins for first in range(begin, n - FEWEST_DURING[kind] + 1)]


def gains(
    history: VehicleHistory, events: Sequence[Event], draws: Array | None = None, candidates: Sequence[Candidate] | None = None
) -> Array:
    """Gain of each candidate in addition to the known changes [log-likelihood], shape (draws, candidates, parameters).

    `draws`: of `VehicleHistory.linear`, shape (draws, n, p), by default this alone; `candidates`: by default all lasting changes.
    """
    draws = history.linear[np.newaxis] if draws is None else draws
    candidates = _lasting(len(history.linear)) if candidates is None else candidates
    design, total_information, right = _model(history, events, draws)
    weighted = history.precision @ design
    mean = np.linalg.solve(total_information, right.T).T
    residual = draws - np.einsum("nij,dj->dni", weighted, mean)  # the slope of each log-likelihood at the present parameters
    looked = list(history.looked_for)
    form = np.array([shapes(history.time_s, *candidate) for candidate in candidates])  # (candidates, n)
    score = np.einsum("cn,dnq->dcq", form, residual[:, :, looked], optimize=True)
    curvature = form**2 @ history.precision[:, looked, looked]
    cross = np.einsum("cn,nqj->cqj", form, weighted[:, looked], optimize=True)
    solved = np.linalg.solve(total_information, cross.reshape(-1, cross.shape[-1]).T).T.reshape(cross.shape)
    information = np.maximum(curvature - np.einsum("cqj,cqj->cq", cross, solved), 1e-12)
    return np.asarray(0.5 * score**2 / information)


def _model(history: VehicleHistory, events: Sequence[Event], draws: Array) -> tuple[Array, Array, Array]:
    """Design of a vehicle with known changes, shape (n, p, parameters), its information, and right hand sides of the draws."""
    n, p = history.linear.shape
    design = np.zeros((n, p, p + len(events)))
    design[:, :, :p] = np.eye(p)
    for j, (parameter, first, kind, end) in enumerate(events):
        design[:, parameter, p + j] = shapes(history.time_s, first, kind, end)
    information = np.einsum("nij,nik->jk", design, history.precision @ design)
    information[:p, :p] += history.prior
    information[p:, p:] += 1e-9 * np.eye(len(events))
    right = np.einsum("nij,dni->dj", design, draws, optimize=True)
    right[:, :p] += history.right
    return design, information, right


@dataclass(frozen=True, eq=False)
class JointFit:
    """Parameters of a vehicle before its changes and, last, the changes, all fitted together."""

    design: Array  # parameters at each recording, shape (n, p, parameters)
    mean: Array
    covariance: Array

    @property
    def gain(self) -> Array:
        """Of each change, with all the others known, in log-likelihood."""
        p = self.design.shape[1]
        return np.asarray(0.5 * self.mean[p:] ** 2 / np.diag(self.covariance)[p:])

    @property
    def total(self) -> float:
        """Of all changes together, in log-likelihood."""
        p = self.design.shape[1]
        return float(0.5 * self.mean[p:] @ np.linalg.solve(self.covariance[p:, p:], self.mean[p:]))


def fit(history: VehicleHistory, events: Sequence[Event]) -> JointFit:
    """All changes and the parameters before them."""
    design, information, right = _model(history, events, history.linear[np.newaxis])
    covariance = np.asarray(np.linalg.inv(information))
    return JointFit(design, covariance @ right[0], covariance)


def search(history: VehicleHistory, threshold_gain: float) -> list[Event]:
    """Changes that gain at least that much, each with all the others known: lasting ones alone, unless some that ended gain more.

    Each change costs what it must gain, so that one that ended replaces two lasting ones where both are about as likely. It costs
    more, as it has two times. Else two lasting ones, such as a fault and its repair in part, would be one that ended and another.
    """

    def worth(events: list[Event]) -> float:
        return fit(history, events).total - threshold_gain * len(events) - UNLIKELY * sum(event.end < LASTING for event in events)

    return max((_with_events(history, threshold_gain, (), endings) for endings in (False, True)), key=worth)


def _with_events(history: VehicleHistory, threshold_gain: float, events: Sequence[Event], ended: bool) -> list[Event]:
    """The known changes and others, lasting ones or also some that ended. The most likely one is added first."""
    results = list(events)
    while len(results) < MOST_CHANGES and len(history.linear) >= 2 * FEWEST:
        best, gain = _likeliest(history, results)
        if ended and (past_events := _past_events(history, results, threshold_gain)):
            event, past_gain = max(past_events, key=lambda pair: pair[1])
            best, gain = (event, past_gain) if gain < max(threshold_gain, past_gain - UNLIKELY) else (best, gain)
        if gain < threshold_gain:
            break
        results = _align(history, [*results, best])
    while results:  # a change may be explained by those that were found later
        gains_now = fit(history, results).gain
        if gains_now.min() >= threshold_gain:
            break
        del results[int(gains_now.argmin())]
        results = _align(history, results)
    return results


def _likeliest(history: VehicleHistory, events: Sequence[Event]) -> tuple[Event, float]:
    """The lasting change with the largest gain in addition to the known ones, and this."""
    gain = gains(history, events)[0]
    c, q = np.unravel_index(int(gain.argmax()), gain.shape)
    return Event(history.looked_for[int(q)], *_lasting(len(history.linear))[int(c)]), float(gain[c, q])


def _past_events(history: VehicleHistory, events: Sequence[Event], threshold_gain: float) -> list[tuple[Event, float]]:
    """Changes that ended, with their gains. Each was found by a search until its end, so chance passes no more often."""
    past_events, ends = [], np.arange(2 * FEWEST, len(history.linear) - FEWEST + 1)
    for end in map(int, ends[:: -(-len(ends) // MOST_ENDS) or 1]):
        best, gain = _likeliest(history.head(end), events)
        if gain >= threshold_gain:
            past_gains = gains(history, events, candidates=[(best.begin, best.kind, end)])[0, 0]
            past_events.append((best._replace(end=end), float(past_gains[history.looked_for.index(best.parameter)])))
    return past_events


def _neighbours(history: VehicleHistory, change: Event, kinds: Sequence[str] = (STEP, RAMP)) -> list[Candidate]:
    """All lasting changes of these kinds; of a change that ended, those with another beginning or another end."""
    if change.end == LASTING:
        return [candidate for candidate in _lasting(len(history.linear)) if candidate[1] in kinds]
    begins = [(first, kind, change.end) for first, kind, _ in _lasting(change.end) if kind in kinds]
    ends = range(change.begin + FEWEST_DURING[change.kind], len(history.linear) - FEWEST + 1)
    return begins + [(change.begin, change.kind, end) for end in ends if end != change.end]


def _beginnings(history: VehicleHistory, events: Sequence[Event], j: int) -> tuple[list[Event], Array]:
    """Each possible beginning, or end, of one of the changes, and its gain with all the others known."""
    parameter, neighbours = events[j].parameter, _neighbours(history, events[j], (events[j].kind,))
    gain = gains(history, [*events[:j], *events[j + 1 :]], candidates=neighbours)[0]
    return [Event(parameter, *candidate) for candidate in neighbours], gain[:, history.looked_for.index(parameter)]


def _align(history: VehicleHistory, events: list[Event]) -> list[Event]:
    """With the likeliest beginning of each, given the others: J. Bai, Econometric Theory 13 (1997) 315."""
    for _ in range(ROUNDS):
        last = list(events)
        for j in range(len(events)):
            begin, gain = _beginnings(history, events, j)
            events[j] = begin[int(gain.argmax())]
        if events == last:
            break
    return events


class Variant(NamedTuple):
    """The changes of a vehicle with another beginning of one, which is that much less likely [log-likelihood]."""

    events: list[Event]
    fit: JointFit
    deficit: float


def variants(history: VehicleHistory, events: Sequence[Event]) -> list[list[Variant]]:
    """For each change those of its beginnings that are not unlikely."""
    groups = []
    for j in range(len(events)):
        begin, gain = _beginnings(history, events, j)
        alternatives = [
            ([*events[:j], event, *events[j + 1 :]], float(gain.max() - g))
            for event, g in zip(begin, gain, strict=True)
            if gain.max() - g < UNLIKELY
        ]
        groups.append([Variant(members, fit(history, members), deficit) for members, deficit in alternatives])
    return groups


def threshold(history: VehicleHistory, rate: float) -> tuple[float, float]:
    """Threshold of the gain that chance alone exceeds, after any recording, at a rate per year [log-likelihood], and that rate:
    at most half of the draws may pass, and none with too few recordings.

    Recordings are drawn with the scatter of the pool, without a change.
    """
    rng, n = np.random.default_rng(1), min(len(history.linear), MOST_DRAWN_FOR)
    if n < 2 * FEWEST:
        return np.inf, 0.0
    precision = history.precision[:n]
    values, vectors = np.linalg.eigh(precision)
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, np.newaxis, :]
    mean = (
        np.linalg.solve(history.prior, history.right)
        + rng.standard_normal((DRAWS, len(history.right))) @ np.linalg.cholesky(np.linalg.inv(history.prior)).T
    )
    samples = np.einsum("nij,dj->dni", precision, mean) + np.einsum(
        "nij,dnj->dni", root, rng.standard_normal((DRAWS, *history.linear[:n].shape))
    )
    highest = np.zeros(DRAWS)
    for count in range(2 * FEWEST, n + 1):
        highest = np.maximum(highest, gains(history.head(count), (), samples[:, :count]).max(axis=(1, 2)))
    years = max((history.time_s[n - 1] - history.time_s[0]) / YEAR_S, 1e-3)
    share = min(0.5, rate * years)  # of draws that may pass
    return exceeded(highest, share), share / years


def exceeded(highest: Array, share: float) -> float:
    """Quantile of the largest values for a share above it, by a fitted Gumbel distribution. It covers shares too small for the
    number of draws.
    """
    scale = float(np.std(highest)) * np.sqrt(6.0) / np.pi
    by_gumbel = float(np.mean(highest)) - 0.5772156649 * scale - scale * float(np.log(-np.log1p(-share)))
    return float(max(by_gumbel, np.quantile(highest, 1.0 - share)))


def vehicle_changes(pooled: Pooled, vehicle: str, rate: float = FALSE_ALARMS) -> tuple[list[VehicleChange], float, float]:
    """Changes of a vehicle, by significance; the threshold of the gain and its rate of false alarms, see `threshold`."""
    history = course(pooled, vehicle)
    threshold_gain, allowed = threshold(history, rate)
    events = search(history, threshold_gain)
    groups = variants(history, events)
    changes = [_vehicle_change(pooled, history, events, groups, j, threshold_gain) for j in range(len(events))]
    return sorted(changes, key=lambda change: -change.gain), threshold_gain, allowed


def _vehicle_change(
    pooled: Pooled,
    history: VehicleHistory,
    events: Sequence[Event],
    groups: Sequence[Sequence[Variant]],
    j: int,
    threshold_gain: float,
) -> VehicleChange:
    names, (parameter, begin, kind, end) = pooled.data.names, events[j]
    joint = fit(history, events)
    nominal, std = float(pooled.data.nominal[parameter]), float(pooled.data.std[parameter])
    others = np.delete(np.arange(len(joint.mean)), joint.design.shape[1] + j)
    level = nominal + std * float(joint.design[begin, parameter, others] @ joint.mean[others])
    size, size_std = (std * x for x in size_of(joint, events, groups, j))
    best = gains(history, [*events[:j], *events[j + 1 :]], candidates=_neighbours(history, events[j]))[0].max(axis=0)
    best_gain = best[history.looked_for.index(parameter)]
    rivals = [i for i, gain in zip(history.looked_for, best, strict=True) if i != parameter and gain > best_gain - ALIKE]
    known_at = first_detection(history, events, j, rivals, threshold_gain)
    return VehicleChange(
        parameter=names[parameter],
        rivals=tuple(names[i] for i in rivals),
        kind=kind,
        since_s=float(history.time_s[begin]),
        known_s=float(history.time_s[known_at]),
        recordings=known_at - begin + 1,
        ended_s=float(history.time_s[end]) if end < len(history.time_s) else None,
        level=level,
        size=size,
        size_std=size_std,
        gain=float(joint.gain[j]),
        lines=lines_of(groups, parameter, nominal, std) if kind == RAMP and end == LASTING else (),
    )


def size_of(best: JointFit, events: Sequence[Event], groups: Sequence[Sequence[Variant]], j: int) -> tuple[float, float]:
    """Size of a change up to the last recording or its end, and its standard deviation with that of each beginning and end."""
    parameter, column = events[j].parameter, best.design.shape[1] + j

    def grown(members: Sequence[Event], joint: JointFit) -> float:
        return float(joint.design[min(members[j].end, len(joint.design)) - 1, parameter, column])

    size = grown(events, best) * float(best.mean[column])
    variance = grown(events, best) ** 2 * float(best.covariance[column, column])
    for group in groups:
        sizes = np.array([grown(v.events, v.fit) * v.fit.mean[column] for v in group])
        variance += float(np.average((sizes - size) ** 2, weights=np.exp([-v.deficit for v in group])))
    return size, variance**0.5


def lines_of(groups: Sequence[Sequence[Variant]], parameter: int, nominal: float, std: float) -> tuple[TrendLine, ...]:
    """The trend of a parameter with each beginning that is not unlikely."""
    lines = []
    for events, joint, deficit in (variant for group in groups for variant in group):
        slope = np.zeros(len(joint.mean))
        slope[-len(events) :] = [f.parameter == parameter and f.kind == RAMP for f in events]
        rows = std * np.stack((joint.design[-1, parameter], slope))
        (value, rise), spread = rows @ joint.mean, rows @ joint.covariance @ rows.T
        lines.append(TrendLine(*map(float, (nominal + value, rise, spread[0, 0], spread[1, 1], spread[0, 1], deficit))))
    return tuple(sorted(lines, key=lambda line: line.deficit))


def first_detection(
    history: VehicleHistory, events: Sequence[Event], j: int, rivals: Sequence[int], threshold_gain: float
) -> int:
    """Recording with which a search after each one first finds a change, of its parameter or of one alike."""
    relatives = [f for f in events if f.parameter in (events[j].parameter, *rivals)]
    for count in range(max(events[j].begin + FEWEST, 2 * FEWEST), len(history.linear)):
        past_events = [f for f in events if f.end <= count and f != events[j]]
        for event in _with_events(history.head(count), threshold_gain, past_events, ended=False):
            nearest = min(relatives, key=lambda f: abs(f.begin - event.begin))
            if event.parameter in (events[j].parameter, *rivals) and nearest == events[j]:
                return count - 1
    return len(history.linear) - 1


def levels(pooled: Pooled, vehicle: str, name: str) -> tuple[Array, Array, Array]:
    """For each recording of a vehicle: time, and a parameter's value with its standard deviation, all others as pooled."""
    history, mean = course(pooled, vehicle), pooled.by_vehicle[vehicle][0]
    i = pooled.data.names.index(name)
    information = np.maximum(history.precision[:, i, i], 1e-12)
    value = mean[i] + (history.linear[:, i] - history.precision[:, i] @ mean) / information
    return history.time_s, pooled.data.nominal[i] + pooled.data.std[i] * value, pooled.data.std[i] * information**-0.5
