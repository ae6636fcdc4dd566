# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sentences of unnamed terms: the variable or the timing of the torque, and possible mechanisms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from trackres_ros.diagnosis.base.patterns import FADE, ClockTerm
from trackres_ros.diagnosis.empirical.payload import Payload, Stretch
from trackres_ros.diagnosis.empirical.places import Place, Wave
from trackres_ros.diagnosis.empirical.routes import SURE_OF_KIND, Route
from trackres_ros.diagnosis.empirical.spells import Chain, DriftingLevel
from trackres_ros.diagnosis.prepare.session import Array
from trackres_ros.diagnosis.selection.candidate import FORM_ERROR
from trackres_ros.effects import learned
from trackres_ros.effects.learned import Corner, Curve, EmpiricalEffect, Latch, SidedGain
from trackres_ros.text.numbers import figures, on_scale


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

Form = Literal[
    "curve", "step", "hinge", "latch", "sided_gain", "spells", "wave", "place", "payload",
    "recordings", "drift", "clock",
]  # fmt: skip
FOLLOWED: tuple[Form, ...] = ("recordings", "drift")  # no fit has them: a live estimate follows them
FROM: Mapping[Form, str] = dict.fromkeys((*FOLLOWED, "spells"), "a live estimate that tracks it") | {
    "wave": "the torque measured before", "payload": "the torque measured before", "place": "the driven distance alone",
    "clock": "the clock or the driven distance alone",
}  # fmt: skip
"""Source of an unpredictable term on hold-out laps, thus in their error."""


@dataclass(frozen=True, eq=False)
class Described:
    """An unnamed term."""

    form: Form
    name: str  # of the effect in the fit; empty for a live disturbance
    sentence: str
    mechanisms: tuple[str, ...]  # parts to check
    size_nm: float  # torque where it acts
    variable: str = ""  # in words; empty without
    unit: str = ""  # of the variable
    gate: str = ""  # in words; empty without
    predictable: bool = False  # whether it can be fed forward, because its inputs are known at the time
    period_m: float | None = None  # length of a wave, or of the lap of a place
    memory: float | None = None  # mean duration of a spell, or time constant of a drift [s]
    stretches: tuple[Stretch, ...] = ()  # of a payload: the mass of each stretch between stops

    @property
    def held_out_from(self) -> str:
        """Source of an unpredictable term on hold-out laps; empty if the recorded channels give it."""
        return "" if self.predictable else FROM.get(self.form, "")

    def of(self, noun: str) -> Described:
        """The same of a vehicle or a machine, with the mechanisms that this may have."""
        parts = tuple(part for part in self.mechanisms if noun == "vehicle" or not isinstance(part, OfVehicle))
        return replace(self, mechanisms=parts or ANY_MACHINE)


def of_learned(effect: EmpiricalEffect, values: Mapping[str, float], noun: str) -> Described:
    """Describe an unnamed effect with the values of a fit."""
    if isinstance(effect, SidedGain):
        return _of_gain(effect, values)
    if isinstance(effect, Corner | Latch):
        return _of_threshold(effect, values, noun)
    assert isinstance(effect, Curve)
    x, y = ([values[q.name] for q in effect.parameters if q.name.startswith(of)] for of in ("x", "y"))
    follows = learned.VARIABLES[effect.variable]
    unit = "" if follows.unit == "1" else follows.unit
    begin, *others = turning_points(y)
    at = [f"{on_scale(knot, max(x) - min(x))} {unit}".rstrip() for knot in x]
    ways = ["rises" if y[i] > y[before] else "falls" for before, i in zip((begin, *others), others, strict=False)]
    to = [f"to {_signed(y[i])} at {at[i]}" for i in others]
    text = f"The extra torque {ways[0]} from {_signed(y[begin])} at {at[begin]} of {follows.text} {to[0]}"
    further = " and ".join(f"{way} {end}" for way, end in zip(ways[1:], to[1:], strict=True))
    text = f"{text}. It then {further}" if further else text
    mechanisms = MECHANISMS[effect.variable]
    return Described("curve", effect.name, text, mechanisms, max(map(abs, y)), follows.text, unit, predictable=True)


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


def _of_threshold(effect: Corner | Latch, values: Mapping[str, float], noun: str) -> Described:
    follows, level, scale = learned.VARIABLES[effect.variable], values["y1"], values["x2"] - values["x1"]
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
        form, mechanisms = "step", MECHANISMS[effect.variable]
        text = f"The {noun} needs {_more(level)} with the {follows.text} above {at('threshold')} than below"
    else:
        form, mechanisms = "hinge", MECHANISMS[effect.variable]
        side, end = ("below", "x1") if effect.kind == learned.BELOW else ("above", "x2")
        text = (
            f"With the {follows.text} {side} {at('threshold')} the {noun} needs increasingly {_more_or_less(level)}, "
            f"{_more(level)} at {at(end)}"
        )
    return Described(form, effect.name, text, mechanisms, abs(level), follows.text, follows.unit, predictable=True)


def _of_gain(effect: SidedGain, values: Mapping[str, float]) -> Described:
    gain, side, follows = values["gain"], learned.SIDES[effect.side], learned.VARIABLES[effect.variable]
    text = f"The torque {side.text} is {100.0 * abs(gain):.1f} % {'larger' if gain > 0.0 else 'smaller'} than in the model"
    size, mechanisms = abs(gain) * values["x1"], OF_GAINS[effect.side]
    return Described("sided_gain", effect.name, text, mechanisms, size, follows.text, follows.unit, side.text, True)


def of_spells(name: str, chain: Chain, level: float, count: int, lengths_s: Array, begins: str, noun: str) -> Described:
    """Describe spells of this size [Nm]: their number, the duration of each [s], and the common event at their start."""
    low, high = (figures(float(q), 2) for q in np.quantile(lengths_s if len(lengths_s) else [chain.mean_s], (0.1, 0.9)))
    text = (
        f"For {low} to {high} s at a time, the {noun} needs {_more(level)} than the model. That happens {count} times in these "
        f"recordings{begins}"
    )
    return Described("spells", name, text, OF_SPELLS, abs(level), memory=chain.mean_s)


def of_wave(name: str, wave: Wave, level: float, part: str) -> Described:
    """Describe a wave of this size [Nm], named after the part with its length per turn, if there is one."""
    of = f", which is {part}" if part else ""
    text = f"A torque of ±{figures(abs(level))} Nm repeats every {figures(wave.length_m, 4)} m{of}"
    return Described("wave", name, text, OF_WAVES, abs(level), "driven distance", period_m=wave.length_m)


def of_clock(effect: ClockTerm, level: float, noun: str) -> Described:
    """Describe a torque of this size [Nm] that follows the clock or the odometer."""
    low, high = effect.ends
    unit = "m" if effect.variable == "distance" else "s"

    def at(value: float) -> str:
        return f"{on_scale(value, high - low)} {unit}"

    since = effect.text_of_variable
    if effect.kind == FADE:
        text = f"At first the {noun} needs {_more(level)}. That fades {since} with a constant of {at(effect.threshold)}"
    elif effect.kind == learned.STEP:
        text = f"From {at(effect.threshold)} {since} on, the {noun} needs {_more(level)} than before"
    else:
        order, end = ("before", low) if effect.kind == learned.BELOW else ("after", high)
        text = (
            f"{order.capitalize()} {at(effect.threshold)} {since} the {noun} needs increasingly {_more_or_less(level)}, "
            f"{_more(level)} at {at(end)}"
        )
    return Described("clock", effect.name, text, OF_CLOCKS, abs(level), effect.variable, unit, predictable=False)


def of_place(name: str, level: float, place: Place, noun: str) -> Described:
    """Describe a torque of this size [Nm] at the same place on each pass."""
    route = f"each lap of {figures(place.lap_m, 4)} m" if place.folded else "the route of each recording"
    text = (
        f"From {figures(place.begin_m)} to {figures(place.end_m)} m after the start of {route}, the {noun} needs "
        f"{_more(level)} than the model. The recordings show it on {place.passes} passes"
    )
    lap_m = place.lap_m if place.folded else None
    return Described("place", name, text, OF_PLACES, abs(level), "place on the route", "m", period_m=lap_m)


def of_payload(name: str, level: float, payload: Payload, noun: str) -> Described:
    """Describe a mass by stretch, with a torque of this size [Nm]."""
    scale = level / payload.level
    stretches = tuple(replace(s, mass=scale * s.mass, std=scale * s.std) for s in payload.stretches)
    masses, seconds = np.array([s.mass for s in stretches]), np.array([s.end_s - s.begin_s for s in stretches])
    low, high = np.quantile(np.repeat(masses, np.maximum(1, np.round(seconds)).astype(int)), (0.05, 0.95))
    sure = float(np.median([s.std for s in stretches]))
    text = (
        f"The {noun} weighs between {_more(float(low), 'kg')} and {_more(float(high), 'kg')} than in the model. The mass "
        f"changes at stops ({len(stretches)} stretches, each with a standard deviation of about {figures(sure)} kg)"
    )
    return Described("payload", name, text, OF_PAYLOAD, abs(level), "mass", "kg", stretches=stretches)


def of_route(name: str, size: float, least: float, most: float, route: Route, noun: str) -> Described:
    """Describe a torque by place with its minimum, maximum and size [Nm], if it is not a slope."""
    tied = abs(route.slope_gain) <= SURE_OF_KIND
    text = (
        f"On {figures(0.001 * route.metres)} km of streets, the {noun} needs between {_more(least)} and {_more(most)} than the "
        f"model, by the place. The repeated streets have {route.passes} passes (median)"
    )
    if tied:
        text += ". To identify a slope, drive them in the other direction too, or with another load"
    mechanisms = OF_PLACES if tied else OF_PLACES[1:]
    return Described("place", name, text, mechanisms, size, "place on the route", "m", predictable=True)


def of_recordings(levels: Array, noun: str) -> Described:
    """Describe a different level [Nm] in each recording; nan if a recording is not compared."""
    low, high = float(np.nanmin(levels)), float(np.nanmax(levels))
    text = (
        f"From recording to recording the {noun} needs between {_more(low)} and {_more(high)} than the model. Within each "
        "recording it hardly changes"
    )
    return Described("recordings", "", text, OF_RECORDINGS, max(-low, high), "recording")


def of_drift(drifting: DriftingLevel) -> Described:
    """Describe a drifting torque."""
    text = f"The residual drifts by {figures(drifting.size)} Nm over about {figures(drifting.seconds, 2)} s"
    return Described("drift", "", text, OF_DRIFT, drifting.size, memory=drifting.seconds)


def _more(by: float, unit: str = "Nm") -> str:
    return f"{figures(abs(by))} {unit} {_more_or_less(by)}"


def _more_or_less(by: float) -> str:
    return "more" if by > 0.0 else "less"


def _signed(torque: float) -> str:
    return f"{'+' if torque > 0.0 else ''}{figures(torque)} Nm"
