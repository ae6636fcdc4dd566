# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sentences of a verdict. Each is one thought, with the numbers that the page shows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from trackres_ros.diagnosis.base.base import Base, BaseParameter
from trackres_ros.diagnosis.base.instrument import PRIOR_STDS
from trackres_ros.diagnosis.empirical.term import Term
from trackres_ros.diagnosis.prepare.session import SensorFinding
from trackres_ros.diagnosis.selection.held_out import REFUTED, SMALL_SHARE, HeldOut
from trackres_ros.diagnosis.selection.locate import Bin, SlowResidual, in_nm
from trackres_ros.effects.effect import Active
from trackres_ros.text import figures, from_to

MOST_CERTAIN = 20.0  # in log-likelihood: upper limit of a stated certainty
LEAST_SHARE = 0.05  # of the probability: less likely options are not listed
MOST_LISTED = 5
LEFT_OUT = "laps left out in turn"  # the held-out laps, and each fold of the fitted laps: see `search.cross_validation`
NOT_CONFIRMED = f"{LEFT_OUT} do not confirm it"
LEAST_AHEAD = 1.0  # in log-evidence: a rival with a smaller disadvantage fits as well
MOST_WORDS = 25  # of a sentence
NONE_OF_THESE = "none of these"
NO_NAME = "No effect of the catalogue explains this"

FORMS = {
    "spells": "an intermittent torque",
    "clock": "a torque that follows the clock",
    "wave": "a periodic torque over distance",
    "place": "a torque at a place",
    "payload": "a payload",
    "recordings": "a different level in each recording",
}

Possible = tuple[tuple[str, float | None], ...]


def join_sentences(sentences: Sequence[str]) -> str:
    """Sentences one after the other, with a capital unless a name comes first; empty ones are dropped."""
    return " ".join(f"{(capitalise(s) if s.startswith(('a ', 'an ')) else s).rstrip('.')}." for s in sentences if s)


def capitalise(text: str) -> str:
    """A text with a capital first letter."""
    return f"{text[:1].upper()}{text[1:]}"


def is_small(t: Term) -> bool:
    """Whether a term reduces the mean hold-out error by less than `SMALL_SHARE`."""
    i = t.improvement
    return i.before - i.after < SMALL_SHARE * i.before


def confirmed_terms(
    terms: Sequence[Term], held_out: HeldOut, possible_effects: Possible, sensors: Sequence[SensorFinding]
) -> list[str]:
    """Sentences of the confirmed terms: the large ones, their common improvement, then the small ones.

    A rival among the `possible_effects` has its probability there.
    """
    large_terms = [t for t in terms if not is_small(t)]
    small_terms = [t for t in terms if is_small(t)]
    error_text = mean_error(held_out.mae["refitted"], held_out.mae["with_effects"])
    sources = [taken_from(t) for t in terms]
    if not large_terms:
        lines = (line for t in small_terms for line in _term_sentences(t, possible_effects, sensors))
        return ["The missing physics is small", error_text, *sources, *lines]
    gains = [(t, t.improvement.before - t.improvement.after) for t in small_terms]
    return [
        *(line for t in large_terms for line in _term_sentences(t, possible_effects, sensors)),
        error_text,
        *sources,
        *(f"{short_text(t)} is confirmed but small: {figures(max(g, 0.0), 2)} Nm less error on {LEFT_OUT}" for t, g in gains),
    ]


def taken_from(t: Term) -> str:
    """Source of an unpredictable term in the error on hold-out laps; empty for a predictable one."""
    source = t.held_out_from
    return f"The feed-forward leaves out {short_text(t)}; this error includes it, taken from {source}" if source else ""


def _term_sentences(t: Term, possible_effects: Possible, sensors: Sequence[SensorFinding]) -> list[str]:
    """Sentences of one term: place and size, cause, values."""
    if not t.is_named:
        name_text = f"{capitalise(t.instead)} would explain it too, but {LEFT_OUT} do not decide for it" if t.instead else NO_NAME
        return [t.sentence, inseparable(t.variable, t.alike), name_text, look_for(t.mechanisms)]
    members = t.members
    if len(members) > 1:
        names_by_weight = sorted(members, key=lambda name: -t.weights[name])
        options = alternatives_text([f"{name} ({_percent(t.weights[name])})" for name in names_by_weight])
        sensor = "The torque cannot tell them apart, but a second sensor is for"
        sensor_effects = [f"{sensor} {s.effect}" for s in sensors if s.effect in members]
        return [seen(t), f"The cause is {options}", *(sensor_effects or ["These recordings cannot tell them apart"])]
    values = f"Its values with 95 % intervals: {t.values_text}" if t.values else ""
    location = t.location
    has_variable = location is not None and location.variable in f"{t.place} {t.seen}"
    similar_text = inseparable(location.variable, location.alike) if location is not None and has_variable else ""
    return [seen(t), similar_text, f"The cause is {t.name}", capitalise(t.effect.text), values, _rival(t, possible_effects)]


def inseparable(variable: str, similar_variables: Sequence[str]) -> str:
    """Sentence on variables that a term may follow as well as its own; empty without any."""
    return (
        f"These recordings cannot separate {', '.join((variable, *similar_variables[:-1]))} and {similar_variables[-1]}"
        if variable and similar_variables
        else ""
    )


def seen(t: Term) -> str:
    """Location and size of the difference in the measured torque."""
    return capitalise(f"{t.place}, {t.seen}" if t.place else t.seen)


def describe_difference(t: Term) -> str:
    """The difference that a term explains, without naming it."""
    if t.is_named:
        return seen(t)
    suffix = f" {t.gate}" if t.gate else f", depending on the {t.variable}" if t.variable else " at times"
    return f"The measured torque differs from the model by about {figures(t.size_nm, 2)} Nm{suffix}"


def look_for(mechanisms: Sequence[str]) -> str:
    """Mechanisms to check in the vehicle, within one sentence; the page lists all."""
    text = f"Look for {mechanisms[0]}"
    for mechanism in mechanisms[1:]:
        if len(f"{text} or {mechanism}".split()) <= MOST_WORDS:
            text = f"{text}, or {mechanism}"
    return text


def alternatives_text(options: Sequence[str]) -> str:
    """Options in a sentence: ``a``, ``a or b``, ``a, b or c``."""
    return f"{', '.join(options[:-1])} or {options[-1]}" if len(options) > 1 else options[0]


def short_text(t: Term) -> str:
    """A term in a few words."""
    if t.is_named:
        return alternatives_text(list(t.members)) if len(t.members) > 1 else t.name
    qualifiers = " ".join(filter(None, (f"of the {t.variable}" if t.variable and t.form not in FORMS else "", t.gate)))
    return f"{form_words(t)} {qualifiers}".strip()


def form_words(t: Term) -> str:
    """The form of an unnamed term, as a noun with its article."""
    form = str(t.form)
    return FORMS.get(form, f"a {form.replace('_', ' ')}")


def mean_error(error_before: float, error_after: float) -> str:
    """The change of the mean error on hold-out laps."""
    text_before, text_after = figures(error_before), figures(error_after)
    way = (
        f"stays at {text_after}"
        if text_before == text_after
        else f"{'falls' if error_after < error_before else 'rises'} from {text_before} to {text_after}"
    )
    return f"The mean error on hold-out laps {way} Nm"


def assumed_sensor(instrument: Sequence[Active], held_out: HeldOut, fit: str) -> str:
    """The errors that the last `fit` assumes of the torque sensor, those beyond the usual or all, and its error without them."""
    if held_out.without_sensor is None:
        return ""
    sensor_values = [
        (a.effect.name.removeprefix("torque_"), q, a.values[q.name]) for a in instrument for q in a.effect.parameters
    ]
    unusual_values = [entry for entry in sensor_values if abs(entry[2]) > PRIOR_STDS * entry[1].start] or sensor_values
    sizes = []
    for name, q, x in unusual_values:
        size = f"{figures(100.0 * x)} %" if q.unit == "1" else f"{figures(x)} {q.unit}"
        sizes.append(f"{name} {size}{', the most it assumes' if abs(x) >= q.high else ''}")
    text_before, text_after = figures(held_out.without_sensor), figures(held_out.mae["with_effects"])
    return (
        f"An assumed torque sensor error ({', '.join(sizes)}) lowers the mean error {fit} from {text_before} to {text_after} Nm"
    )


def list_possible(unsure_terms: Sequence[Term], confirmed_terms: Sequence[Term], shares: Mapping[str, float]) -> Possible:
    """Possible unconfirmed causes, with probabilities, the most likely first and `NONE_OF_THESE` last.

    Without probabilities over whole explanations, those within each suspected class are given, and none for a single name.
    """
    if shares:
        names_confirmed = {m for t in confirmed_terms for m in (t.members if t.is_named else (t.name,))}
        names = sorted((n for n in shares if n not in names_confirmed and n != NONE_OF_THESE), key=lambda n: -shares[n])
        names_listed = [n for n in names if shares[n] >= LEAST_SHARE][:MOST_LISTED]
        if not names_listed:
            return ()
        return tuple((n, shares[n]) for n in (*names_listed, *([NONE_OF_THESE] if NONE_OF_THESE in shares else [])))
    causes: dict[str, float | None] = {}
    for t in unsure_terms:
        if t.is_named and len(t.members) > 1:
            causes.update((name, t.weights[name]) for name in t.members)
        else:
            causes[short_text(t)] = None
    return tuple(causes.items())[:MOST_LISTED]


def may_be(possible_effects: Possible, is_addition: bool = False) -> str:
    """The list of possible causes, in a sentence."""
    options = [name if share is None else f"{name} ({_percent(share)})" for name, share in possible_effects]
    return f"It may {'also ' if is_addition else ''}be: {', '.join(options)}" if options else ""


def doubts(unsure_terms: Sequence[Term]) -> list[str]:
    """Reasons why terms are only suspected; those that hardly change the error are told together."""
    small_terms = [t for t in unsure_terms if not (t.fault or t.improvement.less_likely) and _hardly_gains(t)]
    if len(small_terms) < 2:
        small_terms = []
    sentences = []
    if small_terms:
        most_text = figures(max(abs(t.improvement.before - t.improvement.after) for t in small_terms), 1)
        names = alternatives_text([t.name for t in small_terms[:MOST_LISTED]])
        sentences.append(f"{capitalise(LEFT_OUT)} do not confirm {names}: their mean error changes by {most_text} Nm at most")
    for t in (t for t in unsure_terms if t not in small_terms):
        i = t.improvement
        gain = f"gain {figures(i.low, 2)} to {figures(i.high, 2)} Nm, 95 %"
        error = f"from {figures(i.before)} to {figures(i.after)} Nm"
        denial = f"{capitalise(LEFT_OUT)} do not confirm {t.name}: their mean error"
        if t.fault:
            sentences.append(f"{t.name} {t.fault}")
        elif i.less_likely:
            sentences.append(f"{denial} falls {error}, but their likelihood falls too")
        else:
            sentences.append(f"{denial} goes {error} ({gain})")
    return list(dict.fromkeys(sentences))


def _hardly_gains(t: Term) -> bool:
    i = t.improvement
    return abs(i.before - i.after) < SMALL_SHARE * i.before


def rejected_sentences(terms: Sequence[Term]) -> list[str]:
    """Terms rejected or not confirmed on laps left out in turn, and terms that displace a value of the file."""
    return [
        *(
            f"{capitalise(LEFT_OUT)} reject {t.name}: it raises their mean error from {figures(t.improvement.before)} to "
            f"{figures(t.improvement.after)} Nm"
            for t in terms
            if t.grade == REFUTED and not t.displaces
        ),
        *(f"The diagnosis drops {t.name}: it {t.fault}" for t in terms if t.displaces),
        *doubts([t for t in terms if t.grade != REFUTED]),
    ]


def moved_text(q: BaseParameter, value: float) -> str:
    """A parameter of the base with its old and new value."""
    unit = "" if q.unit == "1" else f" {q.unit}"
    return f"{q.name} {figures(q.nominal, 4)} -> {figures(value, 4)}{unit}"


def file_is_off(far_values: Sequence[tuple[BaseParameter, float]], base: Base, by_load: str) -> list[str]:
    """Sentences for a vehicle file of another vehicle: the values that a re-fit moves far out of their ranges.

    They begin with the load where a suspected term `by_load` follows it, and it is what separates the recordings.
    """
    load = [f"The recordings differ in their load, and a torque that follows it would explain them ({by_load})"]
    load_sentence = "As other things may differ between them too, record different loads under the same conditions"
    return [
        *([*load, load_sentence] if by_load else []),
        f"The {base.file} does not fit this {base.noun}",
        "Only values far outside its ranges reproduce the recordings",
        *(
            f"The {q.name} would be {figures(value)}, but the file allows {q.by_file[0]:g} to {q.by_file[1]:g}"
            for q, value in far_values[:MOST_LISTED]
        ),
        "Check the values that are not re-fitted: the rubber file, the dimensions of belt and wheels, and the unit of the load"
        if base.rolls
        else "",
    ]


def _rival(t: Term, possible_effects: Possible) -> str:
    """The next best candidate, and its relative probability; empty if it is `possible_effects` with another one."""
    other_candidates = [c for c in t.rivals.candidates if c.name not in t.members] if t.rivals is not None else []
    if not other_candidates:
        return ""
    next_best = max(other_candidates, key=lambda c: c.level)
    if next_best.name in dict(possible_effects):
        return ""
    if t.level - next_best.level < LEAST_AHEAD:
        if not next_best.is_name:
            return f"{capitalise(next_best.name)} fits as well, but is a form: it bends to the data"
        rank_text = f"predicts {LEFT_OUT} significantly worse" if next_best.name in t.worse else ""
        return f"{capitalise(next_best.name)} fits as well, but {rank_text or why_not(next_best)}"
    return f"The next best explanation, {next_best.name}, is {likelier_text(t, next_best)} times less likely"


def why_not(candidate: Term) -> str:
    """Why a candidate that fits is not confirmed, as a clause."""
    return f"it {candidate.fault}" if candidate.fault else NOT_CONFIRMED


def likelier_text(term: Term, rival: Term) -> str:
    """Likelihood ratio of two terms on the laps left out, as text."""
    times = math.exp(min(term.level - rival.level, MOST_CERTAIN))
    return f"{times:.0f}" if times < 1000.0 else "over a thousand"


def range_of(b: Bin) -> str:
    """The range of a bin."""
    return f"{b.variable} {from_to(b.low, b.high)} {b.unit}"


def largest_of(bins: Sequence[Bin]) -> Bin:
    """The bin with the largest mean residual."""
    return max(bins, key=lambda b: abs(b.mean_residual))


def unexplained(bins: Sequence[Bin], noun: str) -> str:
    """Location and size of the largest difference between measured torque and model."""
    largest_bin = largest_of(bins)
    way = "more" if largest_bin.mean_residual > 0 else "less"
    return f"At {range_of(largest_bin)} the {noun} needs {in_nm(abs(largest_bin.mean_residual))} Nm {way} than the model"


def slow(s: SlowResidual) -> list[str]:
    """Size of the slow residual."""
    return [
        f"Averaged over {s.seconds:g} s, the measured torque differs from the model by {figures(s.size, 2)} Nm, "
        f"{_percent(s.share)} of the torque",
        s.closest,
        "" if math.isnan(s.slope) else f"An unrecorded slope of {100.0 * s.slope:.1f} % would do the same",
    ]


def only_later(fitted_error: float, unused_error: float) -> list[str]:
    """Sentence for hold-out laps that differ more from the model than the fitted laps."""
    return [
        f"The hold-out laps differ from the re-fitted model by {figures(unused_error)} Nm, "
        f"the fitted laps by {figures(fitted_error)} Nm",
        "Something changed between them, or the hold-out laps cover other driving conditions",
    ]


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"
