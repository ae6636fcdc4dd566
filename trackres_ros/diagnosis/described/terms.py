# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Terms without a name, as they are said: what a torque follows or how it comes and goes, and what to look at for it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.described.level_changes import LevelChange
from trackres_ros.diagnosis.described.payload import Payload, Stretch
from trackres_ros.diagnosis.described.places import Place
from trackres_ros.diagnosis.described.routes import TOLD, Route
from trackres_ros.diagnosis.described.spells import Chain, Wander
from trackres_ros.diagnosis.described.waves import Wave
from trackres_ros.diagnosis.prepare.session import Session
from trackres_ros.effects.learned import (
    ACCELERATING,
    ACCELERATION,
    ALWAYS,
    AMBIENT,
    BRAKING,
    BY_BRAKING,
    BY_DISTANCE,
    BY_TIME,
    CURVATURE,
    DRIVING_TORQUE,
    GATES,
    HEAVY,
    LEFT,
    LIGHT,
    LOAD,
    OPEN,
    RIGHT,
    SPEED,
    TURN,
    TURNING,
    VARIABLES,
    BuildUp,
    Curve,
    Learned,
)
from trackres_ros.estimator.disturbance import BLOCK_S
from trackres_ros.text.numbers import figures, on_scale

Array = NDArray[np.float64]

MECHANISMS: Mapping[int, tuple[str, ...]] = {
    SPEED: ("a resonance of belt, wheels or drive train", "a fan or pump that turns along"),
    ACCELERATION: ("play in the drive train", "an inertia that is not in the vehicle file"),
    LOAD: ("something that touches when springs are compressed", "ground that yields"),
    AMBIENT: ("grease or oil that stiffens in the cold",),
    TURN: ("something that touches on one side when it turns", "a brake that steers"),
    TURNING: ("something that touches when it turns", "ground that is sheared"),
    CURVATURE: ("something that touches when it turns", "ground that is sheared"),
    DRIVING_TORQUE: (
        "play in the drive train, taken up as the torque changes its sign",
        "a gear or coupling that binds under load",
    ),
}
OF_GATES: Mapping[int, tuple[str, ...]] = {
    LEFT: ("something that touches in left turns only: a guide, a mudguard, a hose", "the guides of the right belt"),
    RIGHT: ("something that touches in right turns only: a guide, a mudguard, a hose", "the guides of the left belt"),
    HEAVY: ("something that touches when springs are compressed", "a bearing that binds under load"),
    LIGHT: ("a part that swings when it is not held down by the load", "belt tension without load"),
    BRAKING: ("a brake that works along", "a machine that is driven by the wheels"),
    ACCELERATING: ("a coupling that slips", "a machine that draws on the same drive"),
}
OF_BUILD_UPS: Mapping[int, tuple[str, ...]] = {
    BY_DISTANCE: ("mud or snow that is carried along until it drops off", "a belt that walks out of line until it is let go"),
    BY_TIME: ("a pressure or temperature that rises as long as it drives", "a brake that is released too little and heats up"),
    BY_BRAKING: ("a brake that drags after it was used",),
}
OF_SPELLS = (
    "a pump, fan or compressor that cuts in and out",
    "a brake that stays on for a while",
    "another consumer on the same drive",
)
OF_WAVES = ("a stiff or damaged place in a belt", "a wheel that is out of round or a bearing that is worn")
OF_LEVEL_CHANGES = (
    "a part that was changed",
    "a brake that was not released",
    "a bearing that failed",
    "a zero of the torque sensor that was set anew",
)
OF_PLACES = ("a slope", "soft or rough ground", "a bend, where neither heading nor yaw rate is recorded")
OF_PAYLOAD = ("people or goods that get on and off", "a tank or a hopper that fills and empties")
OF_DRIFT = ("a zero of the torque sensor that drifts", "a slope, a wind or a ground that is not recorded")


@dataclass(frozen=True, eq=False)
class Described:
    """A term without a name.

    Attributes
    ----------
    form
        `curve`, `gated_curve`, `build_up`, `spells`, `wave`, `place`, `payload`, `level_change` or `drift`.
    name
        Of the effect in the fit; empty for what is only watched for.
    variable, gate
        What it follows and where it acts, in words; empty without.
    period_m
        Of a wave, or length of the lap in which a place comes again [m]; None for what is none.
    memory
        Scale of a build-up in its own unit, or the average length of a spell [s]; None without.
    sentence, mechanisms
        In plain words, and what to look at.
    size_nm
        How large it is where it acts [Nm].
    predictable
        Whether it can be fed forward: it follows what is known at the time.
    unit
        Of the variable.
    stretches
        Of a payload: the mass of each stretch between stops.
    """

    form: str
    name: str
    variable: str
    gate: str
    period_m: float | None
    memory: float | None
    sentence: str
    mechanisms: tuple[str, ...]
    size_nm: float
    predictable: bool
    unit: str = ""
    stretches: tuple[Stretch, ...] = ()


def of_learned(effect: Learned, values: Mapping[str, float]) -> Described:
    """A curve or a build-up with the values of a fit."""
    if isinstance(effect, BuildUp):
        return _of_build_up(effect, values)
    assert isinstance(effect, Curve)
    x, y = ([values[q.name] for q in effect.parameters if q.name.startswith(of)] for of in ("x", "y"))
    follows, opens = VARIABLES[effect.variable], GATES[effect.gate]
    largest = max(y, key=abs)
    where = f" {opens.text}" if effect.gate != OPEN else ""
    if effect.variable == ALWAYS:
        text = f"It takes {_more(largest)}{where}"
    elif len(y) == 1:
        text = f"It takes {_more(largest)}{where}, whatever the {follows.text}"
    else:
        low, high = min(range(len(y)), key=y.__getitem__), max(range(len(y)), key=y.__getitem__)
        unit = "" if follows.unit == "1" else f" {follows.unit}"
        at = [on_scale(one, max(x) - min(x)) for one in x]
        text = (
            f"It takes {figures(y[high] - y[low])} Nm more with the {follows.text} at {at[high]}{unit} than at "
            f"{at[low]}{unit}{where} (from {figures(y[low])} to {figures(y[high])} Nm)"
        )
    looked = OF_GATES.get(effect.gate, ()) + (() if effect.variable == ALWAYS else MECHANISMS[effect.variable][:1])
    return Described(
        "curve" if effect.gate == OPEN else "gated_curve", effect.name, follows.text, opens.text, None, None, text,
        looked or MECHANISMS[effect.variable], max(map(abs, y)), True, "" if follows.unit == "1" else follows.unit,
    )  # fmt: skip


def _of_build_up(effect: BuildUp, values: Mapping[str, float]) -> Described:
    level, scale = values["y1"], values["scale"]
    if effect.by == BY_BRAKING:
        text = f"It takes {_more(level)} after it has slowed down, which goes within about {figures(scale)} s"
    else:
        unit, since = ("m", "distance") if effect.by == BY_DISTANCE else ("s", "time")
        text = (
            f"{_more(level)[0].upper()}{_more(level)[1:]} builds up over about {figures(scale)} {unit} and is gone after a stop"
        )
        return Described(
            "build_up", effect.name, f"{since} since a stop", "", None, scale, text, OF_BUILD_UPS[effect.by], abs(level), True
        )
    return Described("build_up", effect.name, "braking", "", None, scale, text, OF_BUILD_UPS[effect.by], abs(level), True)


def of_spells(name: str, chain: Chain, level: float, count: int, lengths_s: Array, begins: str) -> Described:
    """Spells of a size [Nm]: how many there were, how long each was [s], and what their beginnings have in common."""
    low, high = (figures(float(q), 2) for q in np.quantile(lengths_s if len(lengths_s) else [BLOCK_S / chain.goes], (0.1, 0.9)))
    text = f"For {low} to {high} s at a time it takes {_more(level)}, {count} times in these recordings{begins}"
    return Described(
        "spells", name, "", "", None, BLOCK_S / chain.goes, f"{text}; it follows nothing that is recorded", OF_SPELLS,
        abs(level), False,
    )  # fmt: skip


def of_wave(name: str, wave: Wave, level: float, part: str) -> Described:
    """A wave of a size [Nm], named after the part that goes round in its length, if one does."""
    of = f", {part}" if part else ""
    text = f"A torque of {figures(abs(level))} Nm to either side comes again every {figures(wave.length_m, 4)} m{of}"
    return Described("wave", name, "driven distance", "", wave.length_m, None, text, OF_WAVES, abs(level), False)


def of_place(name: str, level: float, place: Place) -> Described:
    """A torque of a size [Nm] at the same place on each pass."""
    route = f"of each lap of {figures(place.lap_m, 4)} m" if place.folded else "of the route of each recording"
    text = (
        f"At the same place {route}, from {figures(place.begin_m)} to {figures(place.end_m)} m after its start, it takes "
        f"{_more(level)}; seen on {place.passes} passes"
    )
    lap_m = place.lap_m if place.folded else None
    return Described(
        "place", name, "place on the route", "", lap_m, None, text, OF_PLACES, abs(level), False, unit="m"
    )  # fmt: skip


def of_payload(name: str, level: float, payload: Payload) -> Described:
    """A mass by stretch, whose torque is of a size [Nm]."""
    scale = level / payload.level
    stretches = tuple(replace(s, mass=scale * s.mass, std=scale * s.std) for s in payload.stretches)
    masses, seconds = np.array([s.mass for s in stretches]), np.array([s.end_s - s.begin_s for s in stretches])
    low, high = np.quantile(np.repeat(masses, np.maximum(1, np.round(seconds)).astype(int)), (0.05, 0.95))
    sure = float(np.median([s.std for s in stretches]))
    text = (
        f"The vehicle weighs from {_more(float(low), 'kg')} to {_more(float(high), 'kg')} than the model has, another "
        f"mass after each stop ({len(stretches)} stretches, each known to about {figures(sure)} kg)"
    )
    return Described("payload", name, "mass", "", None, None, text, OF_PAYLOAD, abs(level), False, "kg", stretches)


def of_route(name: str, size: float, least: float, most: float, route: Route) -> Described:
    """What goes by place, from a least to a most torque [Nm] and of a size, where it is not told for a slope."""
    tied = abs(route.apart) <= TOLD
    text = (
        f"At the same places of {figures(0.001 * route.metres)} km of streets it takes from {_more(least)} to {_more(most)} on "
        f"each pass, {route.passes} of most that were passed again"
    )
    if tied:
        text += "; passing them the other way too, or with another load, would tell whether that is a slope"
    mechanisms = OF_PLACES if tied else OF_PLACES[1:]
    return Described("place", name, "place on the route", "", None, None, text, mechanisms, size, True, unit="m")


def of_level_change(name: str, level: float, sessions: Sequence[Session], change: LevelChange) -> Described:
    """A level that changed for good by so much [Nm]."""
    text = (
        f"Since {_when(sessions, change)} it takes {_more(level)}, to the end of the recordings; a diagnosis of the recordings "
        "since then alone can write that into a vehicle file"
    )
    return Described(
        "level_change", name, "", "", None, None, text, OF_LEVEL_CHANGES, abs(level), False
    )  # fmt: skip


def _when(sessions: Sequence[Session], change: LevelChange) -> str:
    """When a level changed: the time of day and the day where clocks say it, and the place in its recording."""
    session, first = sessions[change.session], sessions[0]
    seconds = float(session.time[change.row])
    recording = Path(session.name).name
    where = f"{figures(seconds / 60.0)} min into {recording}" if change.row else f"the beginning of {recording}"
    if math.isnan(session.start_s):
        return where
    at = datetime.fromtimestamp(session.start_s + seconds, UTC)
    day = "" if math.isnan(first.start_s) else f", day {(at.date() - datetime.fromtimestamp(first.start_s, UTC).date()).days + 1}"
    return f"{at:%H:%M} UTC on {at:%Y-%m-%d} ({where}{day})"


def of_drift(wander: Wander) -> Described:
    """A torque that wanders."""
    text = (
        f"It wanders by {figures(wander.size)} Nm over about {figures(wander.seconds, 2)} s, and follows nothing that is recorded"
    )
    return Described("drift", "", "", "", None, wander.seconds, text, OF_DRIFT, wander.size, False)


def _more(by: float, unit: str = "Nm") -> str:
    return f"{figures(abs(by))} {unit} {'more' if by > 0.0 else 'less'}"
