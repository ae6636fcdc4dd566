# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A term of a fit, from the search to the page: what acts, its evidence and grade, its values and place, and its sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from trackres_ros.diagnosis.base.patterns import ByPlace, ResidualPattern, SlopeByPlace
from trackres_ros.diagnosis.empirical.by_place import PlaceColumns, PlaceValues
from trackres_ros.diagnosis.empirical.payload import JointValues, Payload
from trackres_ros.diagnosis.empirical.places import Place, Wave
from trackres_ros.diagnosis.empirical.spells import Chain
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Array
from trackres_ros.diagnosis.selection.as_used import ON_BOUND, at_implausible_bounds
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, REFUTED, SUSPECTED, Improvement
from trackres_ros.diagnosis.selection.locate import Bin, Location, Span
from trackres_ros.diagnosis.selection.visibility import Separability
from trackres_ros.effects import learned
from trackres_ros.effects.effect import Active, Effect
from trackres_ros.effects.learned import EmpiricalEffect
from trackres_ros.route.learned import RouteMap
from trackres_ros.text import alike, figures
from trackres_ros.vehicle.writing.changes import Interval

LEAST_SHARE = 0.005  # of the torque, root mean square: a smaller effect hardly matters
MODEL_ERROR = 0.004  # of the torque, root mean square and slow: error of a re-fitted base without missing physics
LITTLE = 0.1  # of the mean error: the largest improvement by an effect that replaces a base value
SURE_OF_KIND = 5.0  # in log-likelihood: of a slope over a torque
ONLY_BETWEEN = "differs only between these"  # begins the fault of a term that other differences between recordings may explain
NAME, FORM, CLOCK = range(3)  # in the order of preference

Form = Literal[
    "curve",
    "step",
    "hinge",
    "latch",
    "sided_gain",
    "spells",
    "wave",
    "place",
    "payload",
    "recordings",
    "drift",
    "clock",
]
FOLLOWED: tuple[Form, ...] = ("recordings", "drift")  # no fit has them: a live estimate follows them
FROM: Mapping[Form, str] = dict.fromkeys((*FOLLOWED, "spells"), "a live estimate that tracks it") | {
    "wave": "the torque measured before",
    "payload": "the torque measured before",
    "place": "the driven distance alone",
    "clock": "the clock or the driven distance alone",
}
"""Source of an unpredictable term on hold-out laps, thus in their error."""


@dataclass(frozen=True, eq=False)
class Route:
    """A slope or a torque by place. A torque has no value for the other direction of travel."""

    slope_gain: float  # in log-likelihood, of a slope over a torque
    metres: float  # of fitted streets
    again_m: float  # of those passed at least twice
    passes: int  # of a place, median of those passed at least twice
    course: tuple[Array, ...]  # matched distance at each sample [m], in the order of the first drive; nan off all places
    places: PlaceColumns
    values: PlaceValues


Pattern = Chain | Wave | Place | Payload | Route
UNJUDGED = Improvement(math.nan, math.nan, math.nan, math.nan)


@dataclass(frozen=True, eq=False, repr=False)
class Term:
    """A term of a fit: an effect of the catalogue, a form over a variable, or a torque of clock or place.

    Each stage adds its results: the search the gain, the laps left out grade and class, the last fit values, location and text.
    The effect of a drift, which is in no fit, has no series.

    Base parameters that it displaces are on a bound far from the file's value with the term, but not without it, although the
    hold-out error hardly improves. The term replaces a part of the base, as a sensor offset replaces rolling resistance.
    """

    effect: Effect
    fit: Fit  # with the term, as it was added
    gain: float = math.nan  # in log-likelihood over the fit without
    evidence: float = math.nan  # gain less the cost of its parameters, and of the places or times it was chosen from
    share: float = math.nan  # of the torque, root mean square
    kept: float = 1.0  # see `visibility.Proposal`, as `d_prime`
    d_prime: float = math.nan
    level: float = math.nan  # level score over the fit without; nan where no laps have judged it
    pattern: Pattern | None = None  # properties outside the fit, of a term by clock or place

    improvement: Improvement = UNJUDGED  # of the model with it over the one without, each fitted separately
    faults: tuple[str, ...] = ()  # why it is at best suspected, in words after its name
    on_bounds: tuple[str, ...] = ()  # parameters on a bound other than the value without effect
    displaces: tuple[str, ...] = ()
    rivals: Round | None = None  # the round of the search without it
    members: tuple[str, ...] = ()  # its class: the term, and the rivals of its kind that it does not surely beat
    weights: Mapping[str, float] = field(default_factory=dict)  # probability of each
    stability: float = 0.0  # share of resampled laps won by the class
    worse: tuple[str, ...] = ()  # rivals that predict the laps left out significantly worse

    values: Mapping[str, float] = field(default_factory=dict)  # of its parameters
    intervals: Mapping[str, Interval] = field(default_factory=dict)  # 95 %, of its parameters
    adds: Sequence[Array] = ()  # predicted torque of each session [Nm]
    spans: Sequence[Span] = ()  # times at which a named one acts most
    location: Location | None = None  # main variable of a named one, and the range of that
    place: str = ""  # when a named one acts, in words; empty if always
    seen: str = ""  # its torque there, in words
    regime: Sequence[Bin] = ()  # residual of the base there

    form: Form | None = None  # of one without a name, as all below
    sentences: tuple[str, ...] = ()
    mechanisms: tuple[str, ...] = ()  # parts to check
    size_nm: float = 0.0  # torque where it acts
    variable: str = ""  # in words; empty without
    unit: str = ""  # of the variable
    gate: str = ""  # in words; empty without
    predictable: bool = False  # whether it can be fed forward, because its inputs are known at the time
    period_m: float | None = None  # length of a wave, or of the lap of a place
    memory: float | None = None  # mean duration of a spell, or time constant of a drift [s]

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.effect.name

    @property
    def kind(self) -> int:
        """`NAME` of the catalogue, `FORM` over a variable or a place, or `CLOCK`: known from time or earlier torques."""
        if isinstance(self.effect, ResidualPattern):
            return FORM if self.is_by_place else CLOCK
        return FORM if isinstance(self.effect, EmpiricalEffect) else NAME

    @property
    def is_name(self) -> bool:
        """Whether it is in the catalogue."""
        return self.kind == NAME

    @property
    def is_named(self) -> bool:
        """Whether it has a name: it is in the catalogue, or certainly a slope by place."""
        return self.is_name or self.is_slope

    @property
    def is_by_place(self) -> bool:
        """Whether it was learned for each place of a route."""
        return isinstance(self.effect, ByPlace)

    @property
    def is_slope(self) -> bool:
        """Whether it is significantly a slope by place."""
        return isinstance(self.effect, SlopeByPlace)

    @property
    def matters(self) -> bool:
        """Whether its torque is large enough for a name."""
        return self.share >= LEAST_SHARE

    @property
    def bic_gain(self) -> float:
        """Twice the gain, less the cost of its parameters by the Bayesian information criterion."""
        samples = sum(int(mask.sum()) for mask in self.fit.problem.masks)
        return 2.0 * self.gain - math.log(samples) * sum(q.fitted for q in self.effect.parameters)

    def graded_as(self, graded_term: Term) -> Term:
        """The same with the grade of another one."""
        grade = {name: getattr(graded_term, name) for name in ("improvement", "faults", "on_bounds", "displaces")}
        return replace(self, **grade)

    @property
    def grade(self) -> str:
        """`confirmed`, `suspected` or `refuted`."""
        if self.displaces or self.improvement.grade == REFUTED:
            return REFUTED
        return SUSPECTED if self.faults or self.on_bounds else self.improvement.grade

    @property
    def fault(self) -> str:
        """Why it is not confirmed whatever these laps show, in words after its name; empty if only they decide."""
        if self.displaces:
            return f"pushes {', '.join(self.displaces)} to the end of its range"
        if self.improvement.grade != CONFIRMED:
            return ""
        if self.on_bounds:
            return f"is at the limit of its plausible range ({', '.join(self.on_bounds)})"
        return self.faults[0] if self.faults else ""

    @property
    def confirmed(self) -> bool:
        """Whether it is confirmed."""
        return self.grade == CONFIRMED

    @property
    def instead(self) -> str:
        """The catalogue's name that would gain most in its place, if more than half as much; empty without one."""
        return "" if self.rivals is None else self.rivals.best_name(max(self.rivals.cost, 0.5 * self.level))

    @property
    def alike(self) -> tuple[str, ...]:
        """The variables of other forms that laps left out do not separate from a form over another one."""
        if not isinstance(self.effect, EmpiricalEffect) or self.rivals is None:
            return ()
        effects = [c.effect for c in self.rivals.candidates if c.name in self.members]
        codes = dict.fromkeys(e.variable for e in effects if isinstance(e, EmpiricalEffect))
        return tuple(learned.VARIABLES[code].text for code in codes if code != self.effect.variable)

    @property
    def values_text(self) -> str:
        """Its values with their intervals and units."""
        units = {q.name: "" if q.unit == "1" else f" {q.unit}" for q in self.effect.parameters}
        return ", ".join(f"{name} {with_interval(v, self.intervals.get(name))}{units[name]}" for name, v in self.values.items())

    @property
    def sentence(self) -> str:
        """Description of one without a name."""
        return ". ".join(self.sentences)

    @property
    def held_out_from(self) -> str:
        """Source of an unpredictable term on hold-out laps; empty if the recorded channels give it."""
        return "" if self.predictable or self.form is None else FROM.get(self.form, "")

    def learned(self, final_fit: Fit) -> RouteMap:
        """Learned map of one by place, scaled by the values of a final fit."""
        assert isinstance(self.effect, ByPlace)
        return self.effect.learned(active_of(final_fit, self.name).numbers[0])

    def joint_values(self, current: Fit) -> JointValues:
        """Torque of one by place in a fit, and its prior."""
        assert isinstance(self.pattern, Route)
        values, places = self.pattern.values, self.pattern.places
        prior = places.streets.precision(values.length_m, values.size)
        return JointValues(tuple(current.contribution(self.name)), places.torques, prior, np.zeros(prior.shape[0]))

    def __repr__(self) -> str:
        return f"<{self.name}: {self.values_text or self.sentence}; {self.grade}>"


@dataclass(frozen=True, eq=False)
class Round:
    """One round of the search: the terms that were added to a fit, one at a time."""

    before: Fit  # the initial fit
    separability: Separability
    candidates: tuple[Term, ...]  # the fitted ones, the best level score first
    cost: float = 0.0  # logarithm of the number of terms that they were chosen from

    def best_name(self, least_gain: float) -> str:
        """The name of the catalogue that gains most, and more than this level score; empty without one."""
        names = [c for c in self.candidates if c.is_name and c.matters and c.level > least_gain]
        return max(names, key=lambda c: c.level).name if names else ""

    @property
    def hint(self) -> str:
        """The best name that gains more than the best of as many would by chance; empty without one."""
        return self.best_name(self.cost)


def active_of(fit: Fit, name: str) -> Active:
    """An effect of a fit, with its values."""
    return next(a for a in fit.effects if a.effect.name == name)


def by_improvement(terms: Sequence[Term]) -> list[Term]:
    """Sort terms: confirmed ones first, then by their reduction of the hold-out error."""
    return sorted(terms, key=lambda t: (not t.confirmed, t.improvement.after - t.improvement.before))


def with_interval(value: float, interval: Interval | None) -> str:
    """A value and its 95 % interval."""
    if interval is None:
        return figures(value)
    if interval.bound_only:
        return f"between {figures(interval.low)} and {figures(interval.high)}"
    text, low, high = alike((value, interval.low, interval.high), interval.high - interval.low)
    return f"{text} [{low}, {high}]"


# Gain and grade


def term_of_fit(
    current: Fit, fit: Fit, effect: Effect, cost: float = 0.0, visible_share: float = 1.0, d_prime: float = math.nan
) -> Term:
    """A term, with the gain of a fit with it over the one without."""
    evidence, torque_share = fit.log_evidence - current.log_evidence - cost, share(fit, effect.name)
    return Term(effect, fit, fit.log_likelihood - current.log_likelihood, evidence, torque_share, visible_share, d_prime)


def share(fit: Fit, name: str) -> float:
    """Root mean square of a term's torque over that of the torque."""
    return rms(fit.contribution(name), fit) / max(rms([s.torque for s in fit.problem.sessions], fit), 1e-12)


def spurious_gain(current: Fit) -> float:
    """Log-likelihood that a term of the clock can gain from the model's own error.

    That error does not average out: the longer a recording and the smaller its noise, the more it looks like physics.
    """
    torque = rms([s.torque for s in current.problem.sessions], current)
    samples = sum(int(mask.sum()) for mask in current.problem.masks)
    return 0.5 * samples * (MODEL_ERROR * torque * current.noise.dc_gain / current.noise.std) ** 2


def rms(series: Sequence[Array], fit: Fit) -> float:
    """Root mean square over the used samples."""
    used_values = np.concatenate([x[m] for x, m in zip(series, fit.problem.masks, strict=True)])
    return float(np.sqrt(np.mean(used_values[np.isfinite(used_values)] ** 2)))


def on_bounds(active: Active) -> tuple[str, ...]:
    """Parameters of an effect on a bound other than the value without effect."""
    return tuple(
        q.name
        for q in active.effect.parameters
        for bound in (q.low, q.high)
        if q.fitted and bound != q.off and abs(active.values[q.name] - bound) <= ON_BOUND * (q.high - q.low)
    )


def displaced_parameters(improvement: Improvement, final_fit: Fit, fit_without: Fit) -> tuple[str, ...]:
    """Base parameters that a weak effect replaces, see `Term.displaces`."""
    if improvement.before - improvement.after >= LITTLE * improvement.before:
        return ()
    return tuple(sorted(set(at_implausible_bounds(final_fit)) - set(at_implausible_bounds(fit_without))))
