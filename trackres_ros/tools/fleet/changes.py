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
SUFFER_CHANGE = (
    "bearing_friction", "loss_modulus_scale", "drag_coefficient", "film_scale", "torque_gain.error", "torque_offset.offset",
)  # fmt: skip
"""Parameters to check for a change, if the base has them."""


class TrendLine(NamedTuple):
    """A trend if it begins with one recording: the parameter's value at the last one, and its slope per day."""

    now: float
    slope: float
    # their variances and covariance
    now_var: float
    slope_var: float
    both: float
    behind: float  # the likeliest beginning [log-likelihood]


@dataclass(frozen=True, slots=True)
class VehicleChange:
    """A change of one parameter of one vehicle, fitted together with all its other changes."""

    # the changed parameter, and others that would explain it nearly as well
    parameter: str
    alike: tuple[str, ...]
    kind: str  # ``step``, or ``ramp``: a trend
    # begin of the first recording after it, and of the one with which it was first significant [s since 1970]
    since_s: float
    known_s: float
    recordings: int  # number of recordings until then
    # the value at the recording before it, and its change up to the last recording or the end, in the parameter's unit
    before: float
    size: float
    size_std: float
    relative: float  # its size over the value before; nan for a value of 0 in the vehicle file, such as an error of an instrument
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

    def until(self, count: int) -> "VehicleHistory":
        """The first so many recordings."""
        return replace(self, precision=self.precision[:count], linear=self.linear[:count], time_s=self.time_s[:count])


class Found(NamedTuple):
    """A found change: its parameter, first recording and kind, and the first recording after it."""

    parameter: int
    at: int
    kind: str
    end: int = LASTING


Candidate = tuple[int, str, int]  # first recording, kind and end of a change


def course(pooled: Pooled, vehicle: str) -> VehicleHistory:
    """Of one vehicle of the pool, without the recordings whose day is unknown: they have no place in it."""
    own = (pooled.of.vehicle == vehicle) & (pooled.of.time_s > FIRST_DAY_S)
    of, precision, linear = pooled.likelihoods(own)
    prior = np.asarray(np.linalg.inv(pooled.between + pooled.covariance))
    looked_for = tuple(of.names.index(name) for name in SUFFER_CHANGE if name in of.names)
    return VehicleHistory(precision, linear, prior, prior @ pooled.mean, of.time_s, looked_for)


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
    of: VehicleHistory, known: Sequence[Found], draws: Array | None = None, candidates: Sequence[Candidate] | None = None
) -> Array:
    """Gain of each candidate in addition to the known changes [log-likelihood], shape (draws, candidates, parameters).

    `draws`: of `VehicleHistory.linear`, shape (draws, n, p), by default this alone; `candidates`: by default all lasting changes.
    """
    draws = of.linear[np.newaxis] if draws is None else draws
    candidates = _lasting(len(of.linear)) if candidates is None else candidates
    design, whole, right = _model(of, known, draws)
    weighted = of.precision @ design
    mean = np.linalg.solve(whole, right.T).T
    left = draws - np.einsum("nij,dj->dni", weighted, mean)  # the slope of each log-likelihood at the present parameters
    looked = list(of.looked_for)
    form = np.array([shapes(of.time_s, *candidate) for candidate in candidates])  # (candidates, n)
    score = np.einsum("cn,dnq->dcq", form, left[:, :, looked], optimize=True)
    own = form**2 @ of.precision[:, looked, looked]
    cross = np.einsum("cn,nqj->cqj", form, weighted[:, looked], optimize=True)
    solved = np.linalg.solve(whole, cross.reshape(-1, cross.shape[-1]).T).T.reshape(cross.shape)
    information = np.maximum(own - np.einsum("cqj,cqj->cq", cross, solved), 1e-12)
    return np.asarray(0.5 * score**2 / information)


def _model(of: VehicleHistory, known: Sequence[Found], draws: Array) -> tuple[Array, Array, Array]:
    """Design of a vehicle with known changes, shape (n, p, parameters), its information, and right hand sides of the draws."""
    n, p = of.linear.shape
    design = np.zeros((n, p, p + len(known)))
    design[:, :, :p] = np.eye(p)
    for j, (parameter, first, kind, end) in enumerate(known):
        design[:, parameter, p + j] = shapes(of.time_s, first, kind, end)
    whole = np.einsum("nij,nik->jk", design, of.precision @ design)
    whole[:p, :p] += of.prior
    whole[p:, p:] += 1e-9 * np.eye(len(known))
    right = np.einsum("nij,dni->dj", design, draws, optimize=True)
    right[:, :p] += of.right
    return design, whole, right


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


def fit(of: VehicleHistory, known: Sequence[Found]) -> JointFit:
    """All changes and the parameters before them."""
    design, whole, right = _model(of, known, of.linear[np.newaxis])
    covariance = np.asarray(np.linalg.inv(whole))
    return JointFit(design, covariance @ right[0], covariance)


def search(of: VehicleHistory, least: float) -> list[Found]:
    """Changes that gain at least that much, each with all the others known: lasting ones alone, unless some that ended gain more.

    Each change costs what it must gain, so that one that ended replaces two lasting ones where both are about as likely. It costs
    more, as it has two times. Else two lasting ones, such as a fault and its repair in part, would be one that ended and another.
    """

    def worth(found: list[Found]) -> float:
        return fit(of, found).total - least * len(found) - UNLIKELY * sum(one.end < LASTING for one in found)

    return max((_added(of, least, (), ended) for ended in (False, True)), key=worth)


def _added(of: VehicleHistory, least: float, known: Sequence[Found], ended: bool) -> list[Found]:
    """The known changes and others, lasting ones or also some that ended. The most likely one is added first."""
    found = list(known)
    while len(found) < MOST_CHANGES and len(of.linear) >= 2 * FEWEST:
        best, gain = _likeliest(of, found)
        if ended and (passed := _passed(of, found, least)):
            past, of_past = max(passed, key=lambda one: one[1])
            best, gain = (past, of_past) if gain < max(least, of_past - UNLIKELY) else (best, gain)
        if gain < least:
            break
        found = _aligned(of, [*found, best])
    while found:  # a change may be explained by those that were found later
        gains_now = fit(of, found).gain
        if gains_now.min() >= least:
            break
        del found[int(gains_now.argmin())]
        found = _aligned(of, found)
    return found


def _likeliest(of: VehicleHistory, known: Sequence[Found]) -> tuple[Found, float]:
    """The lasting change with the largest gain in addition to the known ones, and this."""
    gain = gains(of, known)[0]
    c, q = np.unravel_index(int(gain.argmax()), gain.shape)
    return Found(of.looked_for[int(q)], *_lasting(len(of.linear))[int(c)]), float(gain[c, q])


def _passed(of: VehicleHistory, known: Sequence[Found], least: float) -> list[tuple[Found, float]]:
    """Changes that ended, with their gains. Each was found by a search until its end, so chance passes no more often."""
    passed, ends = [], np.arange(2 * FEWEST, len(of.linear) - FEWEST + 1)
    for end in map(int, ends[:: -(-len(ends) // MOST_ENDS) or 1]):
        best, gain = _likeliest(of.until(end), known)
        if gain >= least:
            of_past = gains(of, known, candidates=[(best.at, best.kind, end)])[0, 0]
            passed.append((best._replace(end=end), float(of_past[of.looked_for.index(best.parameter)])))
    return passed


def _near(of: VehicleHistory, change: Found, kinds: Sequence[str] = (STEP, RAMP)) -> list[Candidate]:
    """All lasting changes of these kinds; of a change that ended, those with another beginning or another end."""
    if change.end == LASTING:
        return [candidate for candidate in _lasting(len(of.linear)) if candidate[1] in kinds]
    begins = [(first, kind, change.end) for first, kind, _ in _lasting(change.end) if kind in kinds]
    ends = range(change.at + FEWEST_DURING[change.kind], len(of.linear) - FEWEST + 1)
    return begins + [(change.at, change.kind, end) for end in ends if end != change.end]


def _beginnings(of: VehicleHistory, found: Sequence[Found], j: int) -> tuple[list[Found], Array]:
    """Each possible beginning, or end, of one of the changes, and its gain with all the others known."""
    parameter, near = found[j].parameter, _near(of, found[j], (found[j].kind,))
    gain = gains(of, [*found[:j], *found[j + 1 :]], candidates=near)[0]
    return [Found(parameter, *one) for one in near], gain[:, of.looked_for.index(parameter)]


def _aligned(of: VehicleHistory, found: list[Found]) -> list[Found]:
    """With the likeliest beginning of each, given the others: J. Bai, Econometric Theory 13 (1997) 315."""
    for _ in range(ROUNDS):
        before = list(found)
        for j in range(len(found)):
            begin, gain = _beginnings(of, found, j)
            found[j] = begin[int(gain.argmax())]
        if found == before:
            break
    return found


class Variant(NamedTuple):
    """The changes of a vehicle with another beginning of one, which is that much less likely [log-likelihood]."""

    found: list[Found]
    fit: JointFit
    behind: float


def variants(of: VehicleHistory, found: Sequence[Found]) -> list[list[Variant]]:
    """For each change those of its beginnings that are not unlikely."""
    listed = []
    for j in range(len(found)):
        begin, gain = _beginnings(of, found, j)
        others = [
            ([*found[:j], other, *found[j + 1 :]], float(gain.max() - g))
            for other, g in zip(begin, gain, strict=True)
            if gain.max() - g < UNLIKELY
        ]
        listed.append([Variant(known, fit(of, known), behind) for known, behind in others])
    return listed


def threshold(of: VehicleHistory, rate: float) -> tuple[float, float]:
    """Threshold of the gain that chance alone exceeds, after any recording, at a rate per year [log-likelihood], and that rate:
    at most half of the draws may pass, and none with too few recordings.

    Recordings are drawn with the scatter of the pool, without a change.
    """
    rng, n = np.random.default_rng(1), min(len(of.linear), MOST_DRAWN_FOR)
    if n < 2 * FEWEST:
        return np.inf, 0.0
    precision = of.precision[:n]
    values, vectors = np.linalg.eigh(precision)
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, np.newaxis, :]
    mean = (
        np.linalg.solve(of.prior, of.right)
        + rng.standard_normal((DRAWS, len(of.right))) @ np.linalg.cholesky(np.linalg.inv(of.prior)).T
    )
    drawn = np.einsum("nij,dj->dni", precision, mean) + np.einsum(
        "nij,dnj->dni", root, rng.standard_normal((DRAWS, *of.linear[:n].shape))
    )
    highest = np.zeros(DRAWS)
    for count in range(2 * FEWEST, n + 1):
        highest = np.maximum(highest, gains(of.until(count), (), drawn[:, :count]).max(axis=(1, 2)))
    years = max((of.time_s[n - 1] - of.time_s[0]) / YEAR_S, 1e-3)
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
    of = course(pooled, vehicle)
    least, allowed = threshold(of, rate)
    found = search(of, least)
    varied = variants(of, found)
    changes = [_described(pooled, of, found, varied, j, least) for j in range(len(found))]
    return sorted(changes, key=lambda change: -change.gain), least, allowed


def _described(
    pooled: Pooled, of: VehicleHistory, found: Sequence[Found], varied: Sequence[Sequence[Variant]], j: int, least: float
) -> VehicleChange:
    names, (parameter, at, kind, end) = pooled.of.names, found[j]
    whole = fit(of, found)
    nominal, std = float(pooled.of.nominal[parameter]), float(pooled.of.std[parameter])
    without = np.delete(np.arange(len(whole.mean)), whole.design.shape[1] + j)
    before = nominal + std * float(whole.design[at, parameter, without] @ whole.mean[without])
    size, size_std = (std * x for x in size_of(whole, found, varied, j))
    best = gains(of, [*found[:j], *found[j + 1 :]], candidates=_near(of, found[j]))[0].max(axis=0)
    own = best[of.looked_for.index(parameter)]
    alike = [i for i, gain in zip(of.looked_for, best, strict=True) if i != parameter and gain > own - ALIKE]
    seen = first_seen(of, found, j, alike, least)
    return VehicleChange(
        parameter=names[parameter],
        alike=tuple(names[i] for i in alike),
        kind=kind,
        since_s=float(of.time_s[at]),
        known_s=float(of.time_s[seen]),
        recordings=seen - at + 1,
        ended_s=float(of.time_s[end]) if end < len(of.time_s) else None,
        before=before,
        size=size,
        size_std=size_std,
        relative=size / before if nominal and before else float("nan"),
        gain=float(whole.gain[j]),
        lines=lines_of(varied, parameter, nominal, std) if kind == RAMP and end == LASTING else (),
    )


def size_of(whole: JointFit, found: Sequence[Found], varied: Sequence[Sequence[Variant]], j: int) -> tuple[float, float]:
    """Size of a change up to the last recording or its end, and its standard deviation with that of each beginning and end."""
    parameter, column = found[j].parameter, whole.design.shape[1] + j

    def grown(known: Sequence[Found], joint: JointFit) -> float:
        return float(joint.design[min(known[j].end, len(joint.design)) - 1, parameter, column])

    size = grown(found, whole) * float(whole.mean[column])
    variance = grown(found, whole) ** 2 * float(whole.covariance[column, column])
    for of_one in varied:
        sizes = np.array([grown(v.found, v.fit) * v.fit.mean[column] for v in of_one])
        variance += float(np.average((sizes - size) ** 2, weights=np.exp([-v.behind for v in of_one])))
    return size, variance**0.5


def lines_of(varied: Sequence[Sequence[Variant]], parameter: int, nominal: float, std: float) -> tuple[TrendLine, ...]:
    """The trend of a parameter with each beginning that is not unlikely."""
    lines = []
    for known, whole, behind in (variant for of_one in varied for variant in of_one):
        slope = np.zeros(len(whole.mean))
        slope[-len(known) :] = [f.parameter == parameter and f.kind == RAMP for f in known]
        both = std * np.stack((whole.design[-1, parameter], slope))
        (now, rise), spread = both @ whole.mean, both @ whole.covariance @ both.T
        lines.append(TrendLine(*map(float, (nominal + now, rise, spread[0, 0], spread[1, 1], spread[0, 1], behind))))
    return tuple(sorted(lines, key=lambda line: line.behind))


def first_seen(of: VehicleHistory, found: Sequence[Found], j: int, alike: Sequence[int], least: float) -> int:
    """Recording with which a search after each one first finds a change, of its parameter or of one alike."""
    same = [f for f in found if f.parameter in (found[j].parameter, *alike)]
    for count in range(max(found[j].at + FEWEST, 2 * FEWEST), len(of.linear)):
        past = [f for f in found if f.end <= count and f != found[j]]
        for early in _added(of.until(count), least, past, ended=False):
            nearest = min(same, key=lambda f: abs(f.at - early.at))
            if early.parameter in (found[j].parameter, *alike) and nearest == found[j]:
                return count - 1
    return len(of.linear) - 1


def levels(pooled: Pooled, vehicle: str, name: str) -> tuple[Array, Array, Array]:
    """For each recording of a vehicle: time, and a parameter's value with its standard deviation, all others as pooled."""
    of, mean = course(pooled, vehicle), pooled.by_vehicle[vehicle][0]
    i = pooled.of.names.index(name)
    own = np.maximum(of.precision[:, i, i], 1e-12)
    value = mean[i] + (of.linear[:, i] - of.precision[:, i] @ mean) / own
    return of.time_s, pooled.of.nominal[i] + pooled.of.std[i] * value, pooled.of.std[i] * own**-0.5
