# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sentences of a term without a name: the variable or the timing of the torque, and possible mechanisms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from trackres_ros.diagnosis.base.patterns import FADE, ClockTerm, ResidualPattern
from trackres_ros.diagnosis.empirical.payload import Payload
from trackres_ros.diagnosis.empirical.places import Place, Wave
from trackres_ros.diagnosis.empirical.spells import Chain, DriftingLevel
from trackres_ros.diagnosis.empirical.term import SURE_OF_KIND, Form, Route, Term
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Array
from trackres_ros.diagnosis.selection.visibility import FORM_ERROR
from trackres_ros.effects import learned
from trackres_ros.effects.learned import Corner, Curve, Latch, SidedGain
from trackres_ros.text import figures, on_scale


class VehicleMechanism(str):
    """A mechanism that only a vehicle has."""

    __slots__ = ()


ANY_MACHINE = ("a part that rubs, binds or slips under these conditions",)
MECHANISMS: Mapping[int, tuple[str, ...]] = {
    learned.SPEED: (VehicleMechanism("a resonance of belt, wheels or drive train"), "a fan or pump driven by the motion"),
    learned.ACCELERATION: ("play in the drive train", "an inertia that the model lacks"),
    learned.LOAD: (
        VehicleMechanism("a part that touches when the springs are compressed"),
        VehicleMechanism("soft ground"),
    ),
    learned.AMBIENT: ("grease or oil that thickens in the cold",),
    learned.TURN: (VehicleMechanism("a part that touches on one side in turns"), VehicleMechanism("a steering brake")),
    learned.TURNING: (VehicleMechanism("a part that touches in turns"), VehicleMechanism("sheared ground")),
    learned.CURVATURE: (VehicleMechanism("a part that touches in turns"), VehicleMechanism("sheared ground")),
    learned.DRIVING_TORQUE: (
        "play in the drive train, taken up as the torque changes its sign",
        "a gear or coupling that binds under load",
    ),
    learned.BELT: (
        "a fan or pump that is switched by temperature",
        VehicleMechanism("rubber or grease with a stronger temperature dependence than in the file"),
    ),
}
LATCH_MECHANISMS: Mapping[int, tuple[str, ...]] = {
    learned.SPEED: ("a gearbox that shifts up and down at different speeds", "a pump or fan that is switched by speed"),
    learned.LOAD: (VehicleMechanism("a part that touches and sticks when the springs are compressed"),),
    learned.BELT: ("a fan, pump or valve with a thermostat",),
}
GAIN_MECHANISMS: Mapping[int, tuple[str, ...]] = {
    learned.DRIVES: (
        "a torque sensor with another gain for one sign",
        VehicleMechanism("gears with a larger loss when driving"),
    ),
    learned.BRAKES: (
        "a torque sensor with another gain for one sign",
        "a friction brake that acts while the motor brakes",
    ),
    learned.NEGATIVE: ("a torque sensor or inverter with another gain for negative torques",),
}
SPELL_MECHANISMS = (
    "a pump, fan or compressor that switches on and off",
    "a brake that stays applied for a while",
    "another consumer on the same drive",
)
WAVE_MECHANISMS = ("a stiff or damaged place in a belt", "an out-of-round wheel or a worn bearing")
CLOCK_MECHANISMS = ("a temperature or pressure that is not recorded", "a part that settles or wears as the drive goes on")
PLACE_MECHANISMS = tuple(
    map(VehicleMechanism, ("a slope", "soft or rough ground", "a bend, if neither heading nor yaw rate is recorded"))
)
PAYLOAD_MECHANISMS = (VehicleMechanism("boarding passengers or loaded goods"), "a tank or a hopper that fills and empties")
RECORDING_MECHANISMS = (
    VehicleMechanism("a load, ground or wind that differs from the recorded one"),
    "a torque sensor whose zero is reset",
)
DRIFT_MECHANISMS = ("a torque sensor with a drifting zero", VehicleMechanism("an unrecorded slope, wind or ground"))


def describe_form(term: Term, noun: str) -> Term:
    """Describe an unnamed effect over a variable, by its values."""
    effect, values = term.effect, term.values
    if isinstance(effect, SidedGain):
        return _describe_gain(term, effect)
    if isinstance(effect, Corner | Latch):
        return _describe_threshold(term, effect, noun)
    assert isinstance(effect, Curve)
    x, y = ([values[q.name] for q in effect.parameters if q.name.startswith(axis)] for axis in ("x", "y"))
    variable = learned.VARIABLES[effect.variable]
    unit = "" if variable.unit == "1" else variable.unit
    begin, *other_points = turning_points(y)
    knots = [f"{on_scale(knot, max(x) - min(x))} {unit}".rstrip() for knot in x]
    ways = [
        "rises" if y[i] > y[previous_point] else "falls"
        for previous_point, i in zip((begin, *other_points), other_points, strict=False)
    ]
    ends = [f"to {_signed_text(y[i])} at {knots[i]}" for i in other_points]
    first_sentence = f"The extra torque {ways[0]} from {_signed_text(y[begin])} at {knots[begin]} of {variable.text} {ends[0]}"
    rest_text = " and ".join(f"{way} {end}" for way, end in zip(ways[1:], ends[1:], strict=True))
    return replace(
        term,
        form="curve",
        sentences=(first_sentence, f"It then {rest_text}") if rest_text else (first_sentence,),
        mechanisms=MECHANISMS[effect.variable],
        size_nm=max(map(abs, y)),
        variable=variable.text,
        unit=unit,
        predictable=True,
    )


def turning_points(heights: Sequence[float]) -> list[int]:
    """Knots at which a curve turns, and its ends, rising; without swings smaller than the error of a form."""
    least_swing, points = FORM_ERROR * (max(heights) - min(heights)), list(range(len(heights)))

    def swing(place: int) -> float:
        height_before, height_after = (heights[points[place]] - heights[points[place + way]] for way in (-1, 1))
        return min(abs(height_before), abs(height_after)) if height_before * height_after > 0.0 else 0.0

    while len(points) > 2:
        smallest_index = min(range(1, len(points) - 1), key=swing)
        if swing(smallest_index) > least_swing:
            break
        del points[smallest_index]
    return points


def _describe_threshold(term: Term, effect: Corner | Latch, noun: str) -> Term:
    values, variable = term.values, learned.VARIABLES[effect.variable]
    level, scale, mechanisms = values["y1"], values["x2"] - values["x1"], MECHANISMS.get(effect.variable, ())
    form: Form

    def text_at(name: str) -> str:
        return f"{on_scale(values[name], scale)} {variable.unit}"

    if isinstance(effect, Latch):
        form, mechanisms = "latch", LATCH_MECHANISMS[effect.variable]
        text = (
            f"The {noun} needs {_more_text(level)} from when the {variable.text} rises above {text_at('on')} until it falls "
            f"below {text_at('off')}"
        )
    elif effect.kind == learned.STEP:
        form = "step"
        text = f"The {noun} needs {_more_text(level)} with the {variable.text} above {text_at('threshold')} than below"
    else:
        form, (side, end) = "hinge", ("below", "x1") if effect.kind == learned.BELOW else ("above", "x2")
        text = (
            f"With the {variable.text} {side} {text_at('threshold')} the {noun} needs increasingly "
            f"{_more_or_less(level)}, {_more_text(level)} at {text_at(end)}"
        )
    return replace(
        term,
        form=form,
        sentences=(text,),
        mechanisms=mechanisms,
        size_nm=abs(level),
        variable=variable.text,
        unit=variable.unit,
        predictable=True,
    )


def _describe_gain(term: Term, effect: SidedGain) -> Term:
    gain, side, variable = term.values["gain"], learned.SIDES[effect.side], learned.VARIABLES[effect.variable]
    text = f"The torque {side.text} is {100.0 * abs(gain):.1f} % {'larger' if gain > 0.0 else 'smaller'} than in the model"
    return replace(
        term,
        form="sided_gain",
        sentences=(text,),
        mechanisms=GAIN_MECHANISMS[effect.side],
        size_nm=abs(gain) * term.values["x1"],
        variable=variable.text,
        unit=variable.unit,
        gate=side.text,
        predictable=True,
    )


def describe_spells(term: Term, chain: Chain, level: float, lengths_s: Array, begin_text: str, noun: str) -> Term:
    """Describe spells of this size [Nm]: their number, the duration of each [s], and the common event at their start."""
    low, high = (figures(float(q), 2) for q in np.quantile(lengths_s if len(lengths_s) else [chain.mean_s], (0.1, 0.9)))
    first_sentence = f"For {low} to {high} s at a time, the {noun} needs {_more_text(level)} than the model"
    second = f"That happens {len(lengths_s)} times in these recordings{begin_text}"
    sentences = (first_sentence, second)
    return replace(term, form="spells", sentences=sentences, mechanisms=SPELL_MECHANISMS, size_nm=abs(level), memory=chain.mean_s)


def describe_wave(term: Term, wave: Wave, level: float, part: str) -> Term:
    """Describe a wave of this size [Nm], named after the part with its length per turn, if there is one."""
    suffix = f", which is {part}" if part else ""
    text = f"A torque of ±{figures(abs(level))} Nm repeats every {figures(wave.length_m, 4)} m{suffix}"
    return replace(
        term,
        form="wave",
        sentences=(text,),
        mechanisms=WAVE_MECHANISMS,
        size_nm=abs(level),
        variable="driven distance",
        period_m=wave.length_m,
    )


def describe_clock(term: Term, effect: ClockTerm, level: float, noun: str) -> Term:
    """Describe a torque of this size [Nm] that follows the clock or the odometer."""
    low, high = effect.ends
    unit = "m" if effect.variable == "distance" else "s"

    def text_at(value: float) -> str:
        return f"{on_scale(value, high - low)} {unit}"

    clock_text = effect.text_of_variable
    sentences: tuple[str, ...]
    if effect.kind == FADE:
        fade_text = f"That fades {clock_text} with a constant of {text_at(effect.threshold)}"
        sentences = (f"At first the {noun} needs {_more_text(level)}", fade_text)
    elif effect.kind == learned.STEP:
        sentences = (f"From {text_at(effect.threshold)} {clock_text} on, the {noun} needs {_more_text(level)} than before",)
    else:
        order, end = ("before", low) if effect.kind == learned.BELOW else ("after", high)
        text = (
            f"{order.capitalize()} {text_at(effect.threshold)} {clock_text} the {noun} needs increasingly "
            f"{_more_or_less(level)}, {_more_text(level)} at {text_at(end)}"
        )
        sentences = (text,)
    size = abs(level)
    return replace(
        term, form="clock", sentences=sentences, mechanisms=CLOCK_MECHANISMS, size_nm=size, variable=effect.variable, unit=unit
    )


def describe_place(term: Term, level: float, place: Place, noun: str) -> Term:
    """Describe a torque of this size [Nm] at the same place on each pass."""
    route = f"each lap of {figures(place.lap_m, 4)} m" if place.is_folded else "the route of each recording"
    range_text = f"From {figures(place.begin_m)} to {figures(place.end_m)} m after the start of {route}"
    first_sentence = f"{range_text}, the {noun} needs {_more_text(level)} than the model"
    return replace(
        term,
        form="place",
        sentences=(first_sentence, f"The recordings show it on {place.passes} passes"),
        mechanisms=PLACE_MECHANISMS,
        size_nm=abs(level),
        variable="place on the route",
        unit="m",
        period_m=place.lap_m if place.is_folded else None,
    )


def describe_payload(term: Term, level: float, payload: Payload, noun: str) -> Term:
    """Describe a mass by stretch, with a torque of this size [Nm], and scale the masses to it."""
    scale = level / payload.level
    stretches = tuple(replace(s, mass=scale * s.mass, std=scale * s.std) for s in payload.stretches)
    masses, seconds = np.array([s.mass for s in stretches]), np.array([s.end_s - s.begin_s for s in stretches])
    low, high = np.quantile(np.repeat(masses, np.maximum(1, np.round(seconds)).astype(int)), (0.05, 0.95))
    typical_std = float(np.median([s.std for s in stretches]))
    first_sentence = (
        f"The {noun} weighs between {_more_text(float(low), 'kg')} and {_more_text(float(high), 'kg')} than in the model"
    )
    detail = f"{len(stretches)} stretches, each with a standard deviation of about {figures(typical_std)} kg"
    return replace(
        term,
        form="payload",
        sentences=(first_sentence, f"The mass changes at stops ({detail})"),
        mechanisms=PAYLOAD_MECHANISMS,
        size_nm=abs(level),
        variable="mass",
        unit="kg",
        pattern=replace(payload, stretches=stretches),
    )


def describe_route(term: Term, size: float, lower_end: float, upper_end: float, route: Route, noun: str) -> Term:
    """Describe a torque by place with its minimum, maximum and size [Nm], if it is not a slope."""
    is_tied = abs(route.slope_gain) <= SURE_OF_KIND
    streets = f"On {figures(0.001 * route.metres)} km of streets"
    sentences = (
        f"{streets}, the {noun} needs between {_more_text(lower_end)} and {_more_text(upper_end)} than the model, by the place",
        f"The repeated streets have {route.passes} passes (median)",
        *(("To identify a slope, drive them in the other direction too, or with another load",) if is_tied else ()),
    )
    return replace(
        term,
        form="place",
        sentences=sentences,
        mechanisms=PLACE_MECHANISMS if is_tied else PLACE_MECHANISMS[1:],
        size_nm=size,
        variable="place on the route",
        unit="m",
        predictable=True,
    )


def recordings_term(final_fit: Fit, levels: Array) -> Term:
    """A different level [Nm] in each recording, as a live estimate follows it; nan if a recording is not compared."""
    low, high, noun = float(np.nanmin(levels)), float(np.nanmax(levels)), final_fit.problem.base.noun
    first_sentence = (
        f"From recording to recording the {noun} needs between {_more_text(low)} and {_more_text(high)} than the model"
    )
    return replace(
        _live_term("recordings", final_fit),
        sentences=(first_sentence, "Within each recording it hardly changes"),
        mechanisms=RECORDING_MECHANISMS,
        size_nm=max(-low, high),
        variable="recording",
    )


def drift_term(final_fit: Fit, drift: DriftingLevel) -> Term:
    """A drifting torque, as a live estimate follows it."""
    text = f"The residual drifts by {figures(drift.size)} Nm over about {figures(drift.seconds, 2)} s"
    term, size = _live_term("drift", final_fit), drift.size
    return replace(term, sentences=(text,), mechanisms=DRIFT_MECHANISMS, size_nm=size, memory=drift.seconds)


def _live_term(form: Form, final_fit: Fit) -> Term:
    return Term(ResidualPattern(form, "a torque that a live estimate follows", (), 1.0), final_fit, form=form)


def possible_in(term: Term, noun: str) -> Term:
    """The term with the mechanisms that a vehicle, or another machine, may have."""
    parts = tuple(part for part in term.mechanisms if noun == "vehicle" or not isinstance(part, VehicleMechanism))
    return replace(term, mechanisms=parts or ANY_MACHINE)


def _more_text(difference: float, unit: str = "Nm") -> str:
    return f"{figures(abs(difference))} {unit} {_more_or_less(difference)}"


def _more_or_less(difference: float) -> str:
    return "more" if difference > 0.0 else "less"


def _signed_text(torque: float) -> str:
    return f"{'+' if torque > 0.0 else ''}{figures(torque)} Nm"
