# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Scores answers: puts them into one form, and compares them with the case and with an oracle.

The oracle is the best possible result: the true structure is fitted to the same laps by the same optimiser.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy.stats import binomtest

from proofs.sealed.cases import NOT_IN_CATALOGUE, RIGHT_NAMES, STREET, Case, sensors_of
from proofs.sealed.diagnosing import opened
from proofs.sealed.recordings import means
from trackres_ros.arrays import Array
from trackres_ros.diagnosis.base.base import BaseParameter, Predicted, Values
from trackres_ros.diagnosis.base.track import TrackBase
from trackres_ros.diagnosis.empirical.term import FOLLOWED
from trackres_ros.diagnosis.inference.fitting import Problem, fit, with_levels
from trackres_ros.diagnosis.prepare.gate import gate
from trackres_ros.diagnosis.prepare.session import DriveSession, split_laps
from trackres_ros.diagnosis.selection.visibility import LEAST_KEPT, separability
from trackres_ros.effects import catalogue
from trackres_ros.effects.effect import Active
from trackres_ros.vehicle import Vehicle

SURE = ("named", "one_of")
DESCRIBED, CONFIRMED = "described", "confirmed"
ABOUT = ("variable", "gate", "memory")
EARLIER = "earlier"
BASELINES = ("naive", "aic", "sparse", "trees", EARLIER)
"""Regression of the residual on one effect, effects added while AIC falls, a lasso, boosted trees, and an earlier version."""


@dataclass(frozen=True)
class Description:
    """A term with a form and no name: the form, and the words for its variable, its gate and its memory."""

    form: str
    about: str


@dataclass(frozen=True)
class Answer:
    """A status as in the verdict; the classes of named effects, one for each missing effect; the described terms
    without a name; and the confirmed classes.
    """

    status: str
    classes: tuple[tuple[str, ...], ...]
    described: tuple[Description, ...] = ()
    confirmed: tuple[tuple[str, ...], ...] = ()

    @property
    def first(self) -> str:
        """The name given first; without any the status."""
        return self.classes[0][0] if self.classes else self.status

    def holds(self, true: set[str]) -> int:
        """How many classes have a true effect in them."""
        return sum(bool(true & set(members)) for members in self.classes)

    def surely_wrong(self, allowed: set[str]) -> bool:
        """Whether a name is confirmed that is neither allowed nor in a class with an allowed one."""
        return any(not allowed & set(members) for members in self.confirmed)


def of_report(report: dict[str, Any]) -> Answer:
    """The answer of a report, with its first name at the head of each class."""
    status = str(report["verdict"]["status"])
    description = tuple(
        Description(str(term["form"]), " ".join(filter(None, (words(term.get(key)) for key in ABOUT))))
        for term in report.get("described", ())
    )
    if status not in SURE:
        return Answer(status, (), description)
    overall = report["verdict"].get("grade", CONFIRMED)
    classes = [(e["name"], *(m for m in e["class"] if m != e["name"])) for e in report["effects"]]
    sure = [c for c, e in zip(classes, report["effects"], strict=True) if e.get("grade", overall) == CONFIRMED]
    return Answer(status, tuple(classes), description, tuple(sure))


def words(value: Any) -> str:
    """The words in a part of a report; for a mapping the keys with a content, and the content."""
    if isinstance(value, dict):
        return " ".join(f"{key} {words(held)}" for key, held in value.items() if held not in (None, False))
    if isinstance(value, list):
        return " ".join(words(item) for item in value)
    return value.lower() if isinstance(value, str) else ""


def error_left(report: dict[str, Any]) -> float:
    """Mean absolute error on hold-out laps with all terms of the fit, or following a drift that is not refuted [Nm].

    The `heldout` of a term of the fit is of all laps, each held out in turn, so it does not compare with that of the base.
    """
    drifts = [term for term in report.get("described", ()) if term["form"] in FOLLOWED and term["grade"] != "refuted"]
    return float(drifts[-1]["heldout"]["mae"][1] if drifts else report["heldout"]["mae"]["with_effects"])


def of_names(names: Sequence[str]) -> Answer:
    """The answer of a method that only gives names."""
    classes = tuple((name,) for name in names)
    return Answer("named" if names else "none", classes, (), classes)


LEAST_GAIN = 10.0  # in log-likelihood: 4.5 standard deviations
AS_WELL = 3.0  # a name with a gain smaller by at most this fits as well
ADDITION, LARGEST_ADDITION = "addition", 5.0  # times the true value


@dataclass(frozen=True)
class OracleAnswer:
    """Findings of an oracle in one case. Physics outside the catalogue is identifiable if its gain is clear."""

    gain: float  # in log-likelihood, of the true effects over the re-fitted base
    alike: tuple[str, ...]  # effects that look like the first true one (cosine above 0.95), or outside the catalogue fit as well
    identifiable: bool  # the gain is clear, no other effect looks alike, and the base does not absorb it
    plain_both: bool  # of two effects: each gains as much in addition to the other
    mae_base: float  # mean error on hold-out laps [Nm] without the true effects
    mae: float  # and with them


class WithAddition(TrackBase):
    """The base with an added torque known except for its size: `added` [Nm], of each session a series of at least its
    length.
    """

    def __init__(self, vehicle: Vehicle, added: Sequence[Array]) -> None:
        super().__init__(vehicle)
        self._added = added
        self.parameters += (BaseParameter(ADDITION, "1", 0.0, np.inf, -LARGEST_ADDITION, LARGEST_ADDITION),)

    def predict(self, sessions: Sequence[DriveSession], values: Values, effects: Sequence[Active]) -> list[Predicted]:
        """See `base.Base`."""
        plain = super().predict(sessions, values, effects)
        return [
            replace(p, torque=p.torque + values[ADDITION] * added[: len(p.torque)])
            for p, added in zip(plain, self._added, strict=True)
        ]


def fit_truth(folder: Path, true: Sequence[str], added: Sequence[Array] = (), rivals: Sequence[str] = ()) -> OracleAnswer:
    """Fit the true structure to the laps of a case: its effects in the catalogue, or the torque added by other physics.

    That torque is given in each second of each drive [Nm]. Of the `rivals`, those with nearly the same gain are `alike`.
    """
    _, recordings, loaded = opened(folder)
    base = loaded.base
    effects = catalogue(size=base.facts.weight * base.facts.radius)
    sessions = gate(recordings, loaded.known).sessions
    choice = split_laps(sessions)
    result_before = fit(Problem(base, sessions, tuple(choice.training_mask(s) for s in sessions)))
    held = [choice.held_out_mask(s) for s in sessions]
    measured = np.concatenate([s.torque[m] for s, m in zip(sessions, held, strict=True)])

    def error(predicted: Sequence[np.ndarray]) -> float:
        return float(np.abs(measured - np.concatenate([p[m] for p, m in zip(predicted, held, strict=True)])).mean())

    mae_base = error([p.torque for p in with_levels(result_before).predicted])
    if added:
        assert isinstance(base, TrackBase)
        by_step = [means(value, round(s.step)) for value, s in zip(added, sessions, strict=True)]
        result = fit(
            replace(result_before.problem, base=WithAddition(base.vehicle, by_step)),
            start=result_before.estimates,
            noises=result_before.noises,
        )
        gain = result.log_likelihood - result_before.log_likelihood
        mae = error([p.torque for p in with_levels(result).predicted])
        gains = {
            name: fit(result_before.problem, [effects[name]], result_before.estimates, result_before.noises).log_likelihood
            - result_before.log_likelihood
            for name in rivals
            if name in effects
        }
        alike = tuple(name for name, gained in gains.items() if gained > gain - AS_WELL)
        return OracleAnswer(gain, alike, gain > LEAST_GAIN, False, mae_base, mae)
    if not true:
        return OracleAnswer(0.0, (), False, False, mae_base, mae_base)
    wanted = [effects[name] for name in true]
    result = fit(result_before.problem, wanted, result_before.estimates, result_before.noises)
    gain = result.log_likelihood - result_before.log_likelihood
    seen = separability(effects, result_before)
    alike = seen.alike(true[0]) if true[0] in seen.names else (true[0],)
    kept = max((s.kept for s in seen.visible if s.effect.name == true[0]), default=0.0)
    plain = gain > LEAST_GAIN and len(alike) == 1 and kept >= LEAST_KEPT
    pair = len(wanted) > 1 and all(
        result.log_likelihood
        - fit(result_before.problem, [e for e in wanted if e is not value], result.estimates, result.noises).log_likelihood
        > LEAST_GAIN
        for value in wanted
    )
    return OracleAnswer(gain, alike, plain, pair, mae_base, error([p.torque for p in with_levels(result).predicted]))


Tried = TypeVar("Tried")

OURS = "diagnosis"
# Of the masses of a described payload.
DRIVING_MPS = 0.3
LEAST_KNOWN = 0.5  # of the driving: hold-out laps are not fitted
LONG_S = 300.0  # of driving
CLOSE = 0.08  # of the greatest load
NORMAL_95 = 1.96  # standard deviations
LEAST_REDUCTION = 0.01  # of the error
NO_WORSE = 1.01  # than the re-fitted base: a percent is chance
RIGHTLY_TOLD = {
    "street_slope": "slope: named grade or described by place",
    "stretch_load": "load: described as a payload",
    "street_ground": "ground: described by place",
}
COMPARABLE = {
    "grade": ("grade", "grade"), "torque_offset": ("offset", "offset"), "torque_gain": ("error", "error"),
    "delay": ("time", "time"),
    "drivetrain_drag": ("drag", "drag"), "drivetrain_efficiency": ("efficiency", "efficiency"), "solar": ("flux", "flux"),
    "rain": ("factor", "factor"), "still_air": ("share", "share"), "cornering": ("compliance", "compliance"),
    "soft_ground": ("torque", "torque"), "warmup": ("torque", "torque"), "vibration": ("speed", "speed"),
    "rotating_inertia": ("more", "factor"),
}  # fmt: skip
"""Effects of which one parameter means nearly the same in both forms: its name here, and in the catalogue."""


@dataclass(frozen=True)
class MassError:
    """Driving time between two changes of the load [s], error of the mass, relative to the greatest load, and whether its
    95 % interval covers the true one.
    """

    driving_s: float
    off: float
    covered: bool = True

    @property
    def long(self) -> bool:
        """Whether it drove so long that the mass should show."""
        return self.driving_s > LONG_S

    @property
    def close(self) -> bool:
        """Whether the mass is near the true one."""
        return self.off <= CLOSE


@dataclass(frozen=True, eq=False)
class Scored:
    """One case, the answers to it, and the oracle's result.

    `resolved` says whether after the advised manoeuvre the true effect is still named, and the effects to be separated from it
    are not; None if no manoeuvre was advised or driven.
    """

    case: Case
    report: dict[str, Any]
    known: OracleAnswer
    answers: Mapping[str, Answer]  # by method
    overlap: float  # of the first true effect that was named, in time; nan without one
    jaccard: float  # and over the range of its variable
    resolved: bool | None
    learned: Mapping[str, float]  # errors on hold-out laps, see `diagnosing.learned_errors`
    stated: bool | None = None  # whether the first description is true of the hidden physics; None without one to judge
    comparable: Mapping[str, tuple[str, float]] = field(default_factory=dict)  # an equivalent parameter, and its true value
    masses: Sequence[MassError] = ()  # of a payload that was hidden and described

    @property
    def true(self) -> set[str]:
        """Names of the hidden physics."""
        return set(self.case.hidden)

    @property
    def answer(self) -> Answer:
        """The answer of the diagnosis."""
        return self.answers[OURS]

    @property
    def rightly_described(self) -> bool:
        """Whether the verdict is a description, and its first statement is true."""
        return self.answer.status == DESCRIBED and bool(self.stated)

    @property
    def allowed(self) -> set[str]:
        """Names that are no mistake: hidden ones, equivalent ones, and those that cannot be distinguished here."""
        return self.true | {name for true in self.true for name in RIGHT_NAMES.get(true, ())} | set(self.known.alike)

    @property
    def rightly_named(self) -> bool:
        """Whether the diagnosis gives names that are no mistake, and no other."""
        return 0 < len(self.answer.classes) == self.answer.holds(self.allowed)

    @property
    def rightly_told(self) -> bool:
        """Whether physics outside the catalogue is rightly named or described."""
        return self.rightly_named or self.rightly_described

    @property
    def predictable(self) -> bool:
        """Whether it is outside the catalogue and its torque is predictable."""
        return self.case.level == "outside" and bool(self.case.program.get("predictable"))

    @property
    def reducible(self) -> bool:
        """Whether an oracle reduces the error on hold-out laps by more than `LEAST_REDUCTION` of it."""
        return self.known.mae_base - self.known.mae > LEAST_REDUCTION * self.known.mae_base

    @property
    def no_worse(self) -> bool:
        """Whether hold-out laps are not worse than with the re-fitted base."""
        return error_left(self.report) <= NO_WORSE * float(self.report["heldout"]["mae"]["refitted"])

    @property
    def removed(self) -> float:
        """Reduction of the re-fitted base's error on hold-out laps by the diagnosis, over that by an oracle."""
        return self.share_removed(self.report["heldout"]["mae"]["refitted"], error_left(self.report))

    def share_removed(self, before: float, after: float) -> float:
        """Reduction of an error on hold-out laps, over that of an oracle."""
        return float((before - after) / (self.known.mae_base - self.known.mae))

    @property
    def wrong(self) -> str:
        """Kind of mistake of the diagnosis; empty without one."""
        a = self.answer
        if not self.true:
            return "false alarm" if a.classes else "false description" if a.status == DESCRIBED else ""
        if self.case.level in NOT_IN_CATALOGUE:
            return self._wrong_outside()
        if not a.classes and self.known.identifiable:
            return "described though in the catalogue" if a.status == DESCRIBED else "not named though identifiable"
        if not a.classes:
            return ""
        if not a.holds(self.true):
            return "wrong name"
        if a.holds(self.true) < len(a.classes):
            return "right, and a wrong one beside"
        return "one of two missed" if self.case.level == "two" and a.holds(self.true) < 2 else ""

    def _wrong_outside(self) -> str:
        if self.rightly_named:
            return ""
        if self.answer.classes:
            return "a name for what is not in the catalogue"
        if self.answer.status == DESCRIBED:
            return "" if self.rightly_described else "described, and not true"
        return "" if self.answer.status == "unexplained" else "unknown not noticed"


def wilson(hits: int, of: int) -> tuple[float, float]:
    """95 % interval of a share, by Wilson's score; of no try, of all shares there are."""
    if not of:
        return 0.0, 1.0
    interval = binomtest(hits, of).proportion_ci(0.95, method="wilson")
    return float(interval.low), float(interval.high)


def shares(scored: Sequence[Scored], method: str = OURS) -> dict[str, tuple[int, int]]:
    """Hits and tries of each score, of a method's answers."""
    by = {level: [s for s in scored if s.case.level == level] for level in {s.case.level for s in scored}}

    def share(of: Sequence[Scored], hit: Callable[[Scored, Answer], bool]) -> tuple[int, int]:
        return sum(hit(s, s.answers[method]) for s in of), len(of)

    def right(s: Scored, a: Answer) -> bool:
        return bool(a.classes) and a.first in s.true

    def in_class(s: Scored, a: Answer) -> bool:
        return a.holds(s.true) > 0

    def plain(of: Sequence[Scored]) -> list[Scored]:
        return [s for s in of if s.known.identifiable]

    single, masked, compensated = (by.get(level, []) for level in ("single", "masked", "compensated"))
    two, outside, none, street = (by.get(level, []) for level in ("two", "outside", "none", "street"))
    unclear = [s for s in [*single, *masked, *compensated, *by.get("confounded", [])] if not s.known.identifiable]
    return {
        "none: false alarm": share(none, lambda _, a: bool(a.classes)),
        "none: unexplained": share(none, lambda _, a: a.status == "unexplained"),
        "single, identifiable: right name": share(plain(single), right),
        "single, all: right name": share(single, right),
        "single: truth in the reported class": share([s for s in single if s.answers[method].classes], in_class),
        "compensated, identifiable: right name": share(plain(compensated), right),
        "compensated, all: right name": share(compensated, right),
        "masked, identifiable: right name": share(plain(masked), right),
        "masked, all: right name": share(masked, right),
        "two, each identifiable: both": share([s for s in two if s.known.plain_both], lambda s, a: a.holds(s.true) >= 2),
        "two: both": share(two, lambda s, a: a.holds(s.true) >= 2),
        "two: at least one": share(two, in_class),
        "two: no false third": share(two, lambda s, a: a.holds(s.true) == len(a.classes)),
        "not identifiable: class or abstain": share(unclear, lambda s, a: not a.classes or in_class(s, a)),
        "outside: described or unexplained": share(outside, lambda _, a: a.status in (DESCRIBED, "unexplained")),
        "outside: unexplained": share(outside, lambda _, a: a.status == "unexplained"),
        "outside: confirmed wrong name": share(outside, lambda s, a: a.surely_wrong(s.allowed)),
        "outside: a name or a class of names": share(outside, lambda _, a: bool(a.classes)),
        "all: confirmed wrong name": share(scored, lambda s, a: a.surely_wrong(s.allowed)),
        "street, nothing hidden: a name or a description": share(
            [s for s in street if not s.true], lambda _, a: bool(a.classes) or a.status == DESCRIBED
        ),
        "street: confirmed wrong name": share(street, lambda s, a: a.surely_wrong(s.allowed)),
    }


def own_shares(scored: Sequence[Scored]) -> dict[str, tuple[int, int]]:
    """Hits and tries of answers that only the diagnosis gives."""
    covers, _ = comparable(scored)
    driven = [s.resolved for s in scored if s.resolved is not None]
    none, outside = ([s for s in scored if s.case.level == level] for level in ("none", "outside"))
    within = [s for s in scored if s.case.level not in ("none", *NOT_IN_CATALOGUE) and s.known.identifiable]
    return {
        "none: false description": _share(none, lambda s: s.answer.status == DESCRIBED),
        "outside, seen by the oracle: described, and the statement is true": _share(
            [s for s in outside if s.known.identifiable], lambda s: s.rightly_described
        ),
        "outside, described: the statement is true": _share(
            [s for s in outside if s.answer.status == DESCRIBED], lambda s: s.rightly_described
        ),
        "in the catalogue and identifiable: described instead of named": _share(within, lambda s: s.answer.status == DESCRIBED),
        "held-out laps: never worse than the base": _share(scored, lambda s: s.no_worse),
        **_own_of_streets([s for s in scored if s.case.level == "street"]),
        "95 % intervals cover": (sum(covers), len(covers)),
        "recommended manoeuvre resolves the tie": (sum(driven), len(driven)),
    }


def _own_of_streets(of: Sequence[Scored]) -> dict[str, tuple[int, int]]:
    seen = [s for s in of if s.true and s.known.identifiable]
    masses = [m for s in of for m in s.masses]
    close = f"street, load described: masses within {CLOSE:.0%} of the load"
    return {
        "street, seen by the oracle: rightly named or described": _share(seen, lambda s: s.rightly_told),
        **{f"street, {statement}": _share([s for s in of if kind in s.true], lambda s: s.rightly_told)
           for kind, statement in RIGHTLY_TOLD.items()},
        f"{close}, over {LONG_S:.0f} s of driving": _share([m for m in masses if m.long], lambda m: m.close),
        f"{close}, all": _share(masses, lambda m: m.close),
        "street, load described: 95 % intervals of masses cover": _share(masses, lambda m: m.covered),
        "street: held-out laps never worse than the base": _share(of, lambda s: s.no_worse),
    }  # fmt: skip


def _share(of: Sequence[Tried], hit: Callable[[Tried], bool]) -> tuple[int, int]:
    return sum(map(hit, of)), len(of)


def sizes(scored: Sequence[Scored]) -> dict[str, list[float]]:
    """Scores that are no shares, case by case; the first is reported as a median, the last as a mean."""
    return {
        "held-out error removed, of what the oracle removes (median)": [
            s.removed for s in scored if s.case.level not in NOT_IN_CATALOGUE and s.reducible
        ],
        "outside, predictable: held-out error removed, of what the oracle removes (median)": [
            s.removed for s in scored if s.predictable and s.reducible
        ],
        **_sizes_of_streets([s for s in scored if s.case.level == "street"]),
        "relative error of parameters (median)": comparable(scored)[1],
        "where, in time: overlap (median)": [s.overlap for s in scored if np.isfinite(s.overlap)],
        "where, in its regime: Jaccard (median)": [s.jaccard for s in scored if np.isfinite(s.jaccard)],
        "single: size of the class (mean)": [float(len(m)) for s in scored if s.case.level == "single" for m in s.answer.classes],
    }


def _sizes_of_streets(of: Sequence[Scored]) -> dict[str, list[float]]:
    results = {
        f"street, {kind.replace('_', ' ')}: held-out error removed, of what the oracle removes (median)": [
            s.removed for s in of if kind in s.true and s.reducible
        ]
        for kind in STREET
    }
    masses, deviation = [m for s in of for m in s.masses], "street, load described: masses off, of the load"
    results[f"{deviation}, over {LONG_S:.0f} s of driving (median)"] = [m.off for m in masses if m.long]
    results[f"{deviation}, all (median)"] = [m.off for m in masses]
    return results


def mass_errors(speed: Array, mass: Array, told: Sequence[Mapping[str, Any]], greatest: float) -> list[MassError]:
    """Errors of the masses of one recording, one for each time between two changes of the load that is described by half.

    Speed [m/s] and load in addition to the empty vehicle [kg] are those of each second. `told` are stretches of a report:
    `begin_s`, `end_s`, the `mass` in addition to the model's and its standard deviation `std` [kg]. The largest possible load
    is `greatest` [kg].
    """
    second, driving = np.arange(len(mass)), np.abs(speed) > DRIVING_MPS
    estimate, std = np.full((2, len(mass)), np.nan)
    for item in told:
        there = (second >= item["begin_s"]) & (second < item["end_s"])
        estimate[there], std[there] = item["mass"], item["std"]
    results = []
    for piece in np.split(second, np.flatnonzero(np.diff(mass)) + 1):
        drives = piece[driving[piece]]
        known = drives[np.isfinite(estimate[drives])]
        if len(drives) and len(known) >= LEAST_KNOWN * len(drives):
            deviation = abs(float(estimate[known].mean()) - float(mass[piece[0]]))
            results.append(MassError(float(len(drives)), deviation / greatest, deviation <= NORMAL_95 * float(std[known].mean())))
    return results


def comparable(scored: Sequence[Scored]) -> tuple[list[bool], list[float]]:
    """Of effects rightly named: whether the interval covers the truth, and the relative error."""
    covers, errors = [], []
    for s in scored:
        for e in s.report["effects"] if s.answer.classes else []:
            if e["name"] in s.comparable:
                name, true = s.comparable[e["name"]]
                q = e["parameters"][name]
                errors.append(abs(q["value"] / true - 1.0))
                if q["ci95"]:
                    covers.append(q["ci95"][0] <= true <= q["ci95"][1])
    return covers, errors


def true_values(case: Case) -> dict[str, tuple[str, float]]:
    """Of each hidden effect that is comparable: its parameter in the catalogue, and the true value."""
    return {name: (COMPARABLE[name][1], _true_value(case, name)) for name in case.hidden if name in COMPARABLE}


def _true_value(case: Case, name: str) -> float:
    """Of a comparable parameter; of one of the torque's sensor together with what any instrument has."""
    hidden, sensors = case.hidden[name][COMPARABLE[name][0]], sensors_of(case)
    if name == "torque_gain":
        return (1.0 + hidden) * sensors.torque_gain - 1.0
    return hidden + {"delay": sensors.torque_lag_s, "torque_offset": sensors.torque_offset_nm}.get(name, 0.0)
