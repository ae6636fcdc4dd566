# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A term of a fit, from the search to the page: what acts, its evidence and grade, its values and place, and its sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from trackres_ros.diagnosis.base.patterns import FADE, ByPlace, ClockTerm, ResidualPattern, SlopeByPlace
from trackres_ros.diagnosis.empirical.by_place import PlaceColumns, PlaceValues
from trackres_ros.diagnosis.empirical.payload import JointValues, Payload
from trackres_ros.diagnosis.empirical.places import Place, Wave
from trackres_ros.diagnosis.empirical.spells import Chain, DriftingLevel
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Array
from trackres_ros.diagnosis.selection.as_used import ON_BOUND, at_implausible_bounds
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, REFUTED, SUSPECTED, Improvement
from trackres_ros.diagnosis.selection.locate import Bin, Location, Span
from trackres_ros.diagnosis.selection.visibility import FORM_ERROR, Separability
from trackres_ros.effects import learned
from trackres_ros.effects.effect import Active, Effect
from trackres_ros.effects.learned import Corner, Curve, EmpiricalEffect, Latch, SidedGain
from trackres_ros.route.learned import RouteMap
from trackres_ros.text.numbers import alike, figures, on_scale
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
    kept: float = 1.0  # see `visibility.EffectSensitivity`, as `d_prime`
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

    def graded_as(self, other: Term) -> Term:
        """The same with the grade of another one."""
        grade = {name: getattr(other, name) for name in ("improvement", "faults", "on_bounds", "displaces")}
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

    def learned(self, final: Fit) -> RouteMap:
        """Learned map of one by place, scaled by the values of a final fit."""
        assert isinstance(self.effect, ByPlace)
        return self.effect.learned(active_of(final, self.name).numbers[0])

    def joint_values(self, current: Fit) -> JointValues:
        """Torque of one by place in a fit, and its prior."""
        assert isinstance(self.pattern, Route)
        values, places = self.pattern.values, self.pattern.places
        prior = places.streets.precision(values.length_m, values.size)
        return JointValues(tuple(current.contribution(self.name)), places.of, prior, np.zeros(prior.shape[0]))

    def __repr__(self) -> str:
        return f"<{self.name}: {self.values_text or self.sentence}; {self.grade}>"


@dataclass(frozen=True, eq=False)
class Round:
    """One round of the search: the terms that were added to a fit, one at a time."""

    before: Fit  # the initial fit
    separability: Separability
    candidates: tuple[Term, ...]  # the fitted ones, the best level score first
    cost: float = 0.0  # logarithm of the number of terms that they were chosen from

    def best_name(self, least: float) -> str:
        """The name of the catalogue that gains most, and more than this level score; empty without one."""
        beyond = [c for c in self.candidates if c.is_name and c.matters and c.level > least]
        return max(beyond, key=lambda c: c.level).name if beyond else ""

    @property
    def hint(self) -> str:
        """The best name that gains more than the best of as many would by chance; empty without one."""
        return self.best_name(self.cost)


def active_of(found: Fit, name: str) -> Active:
    """An effect of a fit, with its values."""
    return next(a for a in found.effects if a.effect.name == name)


def by_improvement(terms: Sequence[Term]) -> list[Term]:
    """Sort terms: confirmed ones first, then by their reduction of the hold-out error."""
    return sorted(terms, key=lambda t: (not t.confirmed, t.improvement.after - t.improvement.before))


def with_interval(value: float, interval: Interval | None) -> str:
    """A value and its 95 % interval."""
    if interval is None:
        return figures(value)
    if interval.bound_only:
        return f"between {figures(interval.low)} and {figures(interval.high)}"
    shown, low, high = alike((value, interval.low, interval.high), interval.high - interval.low)
    return f"{shown} [{low}, {high}]"


# Gain and grade


def compared(current: Fit, found: Fit, effect: Effect, cost: float = 0.0, kept: float = 1.0, d_prime: float = math.nan) -> Term:
    """A term, with the gain of a fit with it over the one without."""
    evidence, added = found.log_evidence - current.log_evidence - cost, share(found, effect.name)
    return Term(effect, found, found.log_likelihood - current.log_likelihood, evidence, added, kept, d_prime)


def share(found: Fit, name: str) -> float:
    """Root mean square of a term's torque over that of the torque."""
    return rms(found.contribution(name), found) / max(rms([s.torque for s in found.problem.sessions], found), 1e-12)


def spurious_gain(current: Fit) -> float:
    """Log-likelihood that a term of the clock can gain from the model's own error.

    That error does not average out: the longer a recording and the smaller its noise, the more it looks like physics.
    """
    torque = rms([s.torque for s in current.problem.sessions], current)
    samples = sum(int(mask.sum()) for mask in current.problem.masks)
    return 0.5 * samples * (MODEL_ERROR * torque * current.noise.dc_gain / current.noise.std) ** 2


def rms(series: Sequence[Array], found: Fit) -> float:
    """Root mean square over the used samples."""
    used = np.concatenate([x[m] for x, m in zip(series, found.problem.masks, strict=True)])
    return float(np.sqrt(np.mean(used[np.isfinite(used)] ** 2)))


def on_bounds(active: Active) -> tuple[str, ...]:
    """Parameters of an effect on a bound other than the value without effect."""
    return tuple(
        q.name
        for q in active.effect.parameters
        for bound in (q.low, q.high)
        if q.fitted and bound != q.off and abs(active.values[q.name] - bound) <= ON_BOUND * (q.high - q.low)
    )


def displaced(improvement: Improvement, final: Fit, without: Fit) -> tuple[str, ...]:
    """Base parameters that a weak effect replaces, see `Term.displaces`."""
    if improvement.before - improvement.after >= LITTLE * improvement.before:
        return ()
    return tuple(sorted(set(at_implausible_bounds(final)) - set(at_implausible_bounds(without))))


# Sentences of a term without a name


class OfVehicle(str):
    """A mechanism that only a vehicle has."""

    __slots__ = ()


ANY_MACHINE = ("a part that rubs, binds or slips under these conditions",)
MECHANISMS: Mapping[int, tuple[str, ...]] = {
    learned.SPEED: (OfVehicle("a resonance of belt, wheels or drive train"), "a fan or pump driven by the motion"),
    learned.ACCELERATION: ("play in the drive train", "an inertia that the model lacks"),
    learned.LOAD: (OfVehicle("a part that touches when the springs are compressed"), OfVehicle("soft ground")),
    learned.AMBIENT: ("grease or oil that thickens in the cold",),
    learned.TURN: (OfVehicle("a part that touches on one side in turns"), OfVehicle("a steering brake")),
    learned.TURNING: (OfVehicle("a part that touches in turns"), OfVehicle("sheared ground")),
    learned.CURVATURE: (OfVehicle("a part that touches in turns"), OfVehicle("sheared ground")),
    learned.DRIVING_TORQUE: (
        "play in the drive train, taken up as the torque changes its sign",
        "a gear or coupling that binds under load",
    ),
    learned.BELT: (
        "a fan or pump that is switched by temperature",
        OfVehicle("rubber or grease with a stronger temperature dependence than in the file"),
    ),
}
OF_LATCHES: Mapping[int, tuple[str, ...]] = {
    learned.SPEED: ("a gearbox that shifts up and down at different speeds", "a pump or fan that is switched by speed"),
    learned.LOAD: (OfVehicle("a part that touches and sticks when the springs are compressed"),),
    learned.BELT: ("a fan, pump or valve with a thermostat",),
}
OF_GAINS: Mapping[int, tuple[str, ...]] = {
    learned.DRIVES: ("a torque sensor with another gain for one sign", OfVehicle("gears with a larger loss when driving")),
    learned.BRAKES: ("a torque sensor with another gain for one sign", "a friction brake that acts while the motor brakes"),
    learned.NEGATIVE: ("a torque sensor or inverter with another gain for negative torques",),
}
OF_SPELLS = (
    "a pump, fan or compressor that switches on and off",
    "a brake that stays applied for a while",
    "another consumer on the same drive",
)
OF_WAVES = ("a stiff or damaged place in a belt", "an out-of-round wheel or a worn bearing")
OF_CLOCKS = ("a temperature or pressure that is not recorded", "a part that settles or wears as the drive goes on")
OF_PLACES = tuple(map(OfVehicle, ("a slope", "soft or rough ground", "a bend, if neither heading nor yaw rate is recorded")))
OF_PAYLOAD = (OfVehicle("boarding passengers or loaded goods"), "a tank or a hopper that fills and empties")
OF_RECORDINGS = (OfVehicle("a load, ground or wind that differs from the recorded one"), "a torque sensor whose zero is reset")
OF_DRIFT = ("a torque sensor with a drifting zero", OfVehicle("an unrecorded slope, wind or ground"))


def of_learned(term: Term, noun: str) -> Term:
    """Describe an unnamed effect over a variable, by its values."""
    effect, values = term.effect, term.values
    if isinstance(effect, SidedGain):
        return _of_gain(term, effect)
    if isinstance(effect, Corner | Latch):
        return _of_threshold(term, effect, noun)
    assert isinstance(effect, Curve)
    x, y = ([values[q.name] for q in effect.parameters if q.name.startswith(axis)] for axis in ("x", "y"))
    follows = learned.VARIABLES[effect.variable]
    unit = "" if follows.unit == "1" else follows.unit
    begin, *others = turning_points(y)
    knots = [f"{on_scale(knot, max(x) - min(x))} {unit}".rstrip() for knot in x]
    ways = ["rises" if y[i] > y[before] else "falls" for before, i in zip((begin, *others), others, strict=False)]
    ends = [f"to {_signed(y[i])} at {knots[i]}" for i in others]
    first = f"The extra torque {ways[0]} from {_signed(y[begin])} at {knots[begin]} of {follows.text} {ends[0]}"
    further = " and ".join(f"{way} {end}" for way, end in zip(ways[1:], ends[1:], strict=True))
    return replace(
        term,
        form="curve",
        sentences=(first, f"It then {further}") if further else (first,),
        mechanisms=MECHANISMS[effect.variable],
        size_nm=max(map(abs, y)),
        variable=follows.text,
        unit=unit,
        predictable=True,
    )


def turning_points(heights: Sequence[float]) -> list[int]:
    """Knots at which a curve turns, and its ends, rising; without swings smaller than the error of a form."""
    least, found = FORM_ERROR * (max(heights) - min(heights)), list(range(len(heights)))

    def swing(place: int) -> float:
        back, on = (heights[found[place]] - heights[found[place + way]] for way in (-1, 1))
        return min(abs(back), abs(on)) if back * on > 0.0 else 0.0

    while len(found) > 2:
        smallest = min(range(1, len(found) - 1), key=swing)
        if swing(smallest) > least:
            break
        del found[smallest]
    return found


def _of_threshold(term: Term, effect: Corner | Latch, noun: str) -> Term:
    values, follows = term.values, learned.VARIABLES[effect.variable]
    level, scale, mechanisms = values["y1"], values["x2"] - values["x1"], MECHANISMS.get(effect.variable, ())
    form: Form

    def at(name: str) -> str:
        return f"{on_scale(values[name], scale)} {follows.unit}"

    if isinstance(effect, Latch):
        form, mechanisms = "latch", OF_LATCHES[effect.variable]
        text = (
            f"The {noun} needs {_more(level)} from when the {follows.text} rises above {at('on')} until it falls below "
            f"{at('off')}"
        )
    elif effect.kind == learned.STEP:
        form = "step"
        text = f"The {noun} needs {_more(level)} with the {follows.text} above {at('threshold')} than below"
    else:
        form, (side, end) = "hinge", ("below", "x1") if effect.kind == learned.BELOW else ("above", "x2")
        text = (
            f"With the {follows.text} {side} {at('threshold')} the {noun} needs increasingly {_more_or_less(level)}, "
            f"{_more(level)} at {at(end)}"
        )
    return replace(
        term,
        form=form,
        sentences=(text,),
        mechanisms=mechanisms,
        size_nm=abs(level),
        variable=follows.text,
        unit=follows.unit,
        predictable=True,
    )


def _of_gain(term: Term, effect: SidedGain) -> Term:
    gain, side, follows = term.values["gain"], learned.SIDES[effect.side], learned.VARIABLES[effect.variable]
    text = f"The torque {side.text} is {100.0 * abs(gain):.1f} % {'larger' if gain > 0.0 else 'smaller'} than in the model"
    return replace(
        term,
        form="sided_gain",
        sentences=(text,),
        mechanisms=OF_GAINS[effect.side],
        size_nm=abs(gain) * term.values["x1"],
        variable=follows.text,
        unit=follows.unit,
        gate=side.text,
        predictable=True,
    )


def of_spells(term: Term, chain: Chain, level: float, lengths_s: Array, begins: str, noun: str) -> Term:
    """Describe spells of this size [Nm]: their number, the duration of each [s], and the common event at their start."""
    low, high = (figures(float(q), 2) for q in np.quantile(lengths_s if len(lengths_s) else [chain.mean_s], (0.1, 0.9)))
    first = f"For {low} to {high} s at a time, the {noun} needs {_more(level)} than the model"
    second = f"That happens {len(lengths_s)} times in these recordings{begins}"
    sentences = (first, second)
    return replace(term, form="spells", sentences=sentences, mechanisms=OF_SPELLS, size_nm=abs(level), memory=chain.mean_s)


def of_wave(term: Term, wave: Wave, level: float, part: str) -> Term:
    """Describe a wave of this size [Nm], named after the part with its length per turn, if there is one."""
    which = f", which is {part}" if part else ""
    text = f"A torque of ±{figures(abs(level))} Nm repeats every {figures(wave.length_m, 4)} m{which}"
    return replace(
        term,
        form="wave",
        sentences=(text,),
        mechanisms=OF_WAVES,
        size_nm=abs(level),
        variable="driven distance",
        period_m=wave.length_m,
    )


def of_clock(term: Term, effect: ClockTerm, level: float, noun: str) -> Term:
    """Describe a torque of this size [Nm] that follows the clock or the odometer."""
    low, high = effect.ends
    unit = "m" if effect.variable == "distance" else "s"

    def at(value: float) -> str:
        return f"{on_scale(value, high - low)} {unit}"

    since = effect.text_of_variable
    sentences: tuple[str, ...]
    if effect.kind == FADE:
        fading = f"That fades {since} with a constant of {at(effect.threshold)}"
        sentences = (f"At first the {noun} needs {_more(level)}", fading)
    elif effect.kind == learned.STEP:
        sentences = (f"From {at(effect.threshold)} {since} on, the {noun} needs {_more(level)} than before",)
    else:
        order, end = ("before", low) if effect.kind == learned.BELOW else ("after", high)
        text = (
            f"{order.capitalize()} {at(effect.threshold)} {since} the {noun} needs increasingly {_more_or_less(level)}, "
            f"{_more(level)} at {at(end)}"
        )
        sentences = (text,)
    size = abs(level)
    return replace(
        term, form="clock", sentences=sentences, mechanisms=OF_CLOCKS, size_nm=size, variable=effect.variable, unit=unit
    )


def of_place(term: Term, level: float, place: Place, noun: str) -> Term:
    """Describe a torque of this size [Nm] at the same place on each pass."""
    route = f"each lap of {figures(place.lap_m, 4)} m" if place.folded else "the route of each recording"
    between = f"From {figures(place.begin_m)} to {figures(place.end_m)} m after the start of {route}"
    first = f"{between}, the {noun} needs {_more(level)} than the model"
    return replace(
        term,
        form="place",
        sentences=(first, f"The recordings show it on {place.passes} passes"),
        mechanisms=OF_PLACES,
        size_nm=abs(level),
        variable="place on the route",
        unit="m",
        period_m=place.lap_m if place.folded else None,
    )


def of_payload(term: Term, level: float, payload: Payload, noun: str) -> Term:
    """Describe a mass by stretch, with a torque of this size [Nm], and scale the masses to it."""
    scale = level / payload.level
    stretches = tuple(replace(s, mass=scale * s.mass, std=scale * s.std) for s in payload.stretches)
    masses, seconds = np.array([s.mass for s in stretches]), np.array([s.end_s - s.begin_s for s in stretches])
    low, high = np.quantile(np.repeat(masses, np.maximum(1, np.round(seconds)).astype(int)), (0.05, 0.95))
    sure = float(np.median([s.std for s in stretches]))
    first = f"The {noun} weighs between {_more(float(low), 'kg')} and {_more(float(high), 'kg')} than in the model"
    each = f"{len(stretches)} stretches, each with a standard deviation of about {figures(sure)} kg"
    return replace(
        term,
        form="payload",
        sentences=(first, f"The mass changes at stops ({each})"),
        mechanisms=OF_PAYLOAD,
        size_nm=abs(level),
        variable="mass",
        unit="kg",
        pattern=replace(payload, stretches=stretches),
    )


def of_route(term: Term, size: float, least: float, most: float, route: Route, noun: str) -> Term:
    """Describe a torque by place with its minimum, maximum and size [Nm], if it is not a slope."""
    tied = abs(route.slope_gain) <= SURE_OF_KIND
    streets = f"On {figures(0.001 * route.metres)} km of streets"
    sentences = (
        f"{streets}, the {noun} needs between {_more(least)} and {_more(most)} than the model, by the place",
        f"The repeated streets have {route.passes} passes (median)",
        *(("To identify a slope, drive them in the other direction too, or with another load",) if tied else ()),
    )
    return replace(
        term,
        form="place",
        sentences=sentences,
        mechanisms=OF_PLACES if tied else OF_PLACES[1:],
        size_nm=size,
        variable="place on the route",
        unit="m",
        predictable=True,
    )


def of_recordings(final: Fit, levels: Array) -> Term:
    """A different level [Nm] in each recording, as a live estimate follows it; nan if a recording is not compared."""
    low, high, noun = float(np.nanmin(levels)), float(np.nanmax(levels)), final.problem.base.noun
    first = f"From recording to recording the {noun} needs between {_more(low)} and {_more(high)} than the model"
    return replace(
        _followed("recordings", final),
        sentences=(first, "Within each recording it hardly changes"),
        mechanisms=OF_RECORDINGS,
        size_nm=max(-low, high),
        variable="recording",
    )


def of_drift(final: Fit, drifting: DriftingLevel) -> Term:
    """A drifting torque, as a live estimate follows it."""
    text = f"The residual drifts by {figures(drifting.size)} Nm over about {figures(drifting.seconds, 2)} s"
    followed, size = _followed("drift", final), drifting.size
    return replace(followed, sentences=(text,), mechanisms=OF_DRIFT, size_nm=size, memory=drifting.seconds)


def _followed(form: Form, final: Fit) -> Term:
    return Term(ResidualPattern(form, "a torque that a live estimate follows", (), 1.0), final, form=form)


def possible_in(term: Term, noun: str) -> Term:
    """The same of a vehicle or a machine, with the mechanisms that this may have."""
    parts = tuple(part for part in term.mechanisms if noun == "vehicle" or not isinstance(part, OfVehicle))
    return replace(term, mechanisms=parts or ANY_MACHINE)


def _more(by: float, unit: str = "Nm") -> str:
    return f"{figures(abs(by))} {unit} {_more_or_less(by)}"


def _more_or_less(by: float) -> str:
    return "more" if by > 0.0 else "less"


def _signed(torque: float) -> str:
    return f"{'+' if torque > 0.0 else ''}{figures(torque)} Nm"
