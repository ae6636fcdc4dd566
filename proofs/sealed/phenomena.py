# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws physics outside of any catalogue, as programs: where it acts, its variable, when, and its memory.

The parts are drawn independently, so a run has unforeseen combinations. Half of the programs are of the kinds in `KINDS`
instead: slow physics, with a memory that no drawn program has. At the end stands the hidden physics of a town. No code of the
effects or of the described terms is used here, as a test checks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from proofs.sealed.belt import DataSheet
from proofs.sealed.drives import SealedDrive
from trackres_ros.arrays import Array

CREEP_MPS = 0.04  # over it friction changes its sign


@dataclass(frozen=True, eq=False)
class Journey:
    """A drive as input of phenomena; `driven` is the vehicle's distance before it [m]."""

    sheet: DataSheet
    drive: SealedDrive
    driven: float

    @property
    def step(self) -> float:
        """Time between samples [s]."""
        return self.drive.step

    @property
    def speed(self) -> Array:
        """Speed [m/s], negative backwards."""
        return self.drive.speed

    @property
    def travel(self) -> Array:
        """Size of the speed [m/s]."""
        return np.abs(self.drive.speed)

    @property
    def direction(self) -> Array:
        """Sign of the speed, which changes smoothly."""
        return self.drive.speed / np.sqrt(self.drive.speed**2 + CREEP_MPS**2)

    @property
    def curvature(self) -> Array:
        """Curvature of the path without its sign [1/m]."""
        return np.abs(self.drive.yaw_rate) / np.maximum(self.travel, 0.3)

    @property
    def load(self) -> Array:
        """Weight over the nominal one."""
        return self.drive.weight / self.sheet["weight"]

    @property
    def distance(self) -> Array:
        """Distance driven so far, earlier drives included [m]."""
        return self.driven + np.cumsum(self.travel) * self.step

    def climbing(self, rise: float | Array) -> Array:
        """Torque of a slope [rise over run] at the sprockets [Nm]."""
        return np.asarray(self.drive.weight * self.sheet["track.sprocket_radius"] * np.sin(np.arctan(rise)))

    def lagged(self, target: Array, seconds: float, start: float) -> Array:
        """A series as something follows it that takes its time."""
        output, time_now, rate = np.empty(len(target)), start, 1.0 - np.exp(-self.step / seconds)
        for i, aim in enumerate(target):
            output[i] = time_now
            time_now += (aim - time_now) * rate
        return output


Adds = Callable[[Journey, Mapping[str, float], Array], Array]
"""Torque that a phenomenon adds [Nm], by the drive, the values of its parameters, and the torque without it."""


STANDING_MPS = 0.1
LONG_STOP_S = 20.0  # standing so long, the brake is set
WINDING_S = 450.0  # time constant of a winding's temperature
HOTTEST = 2.0  # over the warmth at rated torque: there a motor's control limits the torque


@dataclass(frozen=True)
class Kind:
    """A kind of slow physics: its words, its entry point, the variables that it follows, and how they give its strength."""

    words: str
    entry: str  # of `ENTRIES`
    variables: tuple[str, ...]
    ranges: tuple[tuple[float, float], ...]  # of its draws
    strength: Callable[..., Array]  # by the drive, the torque without it [Nm] and the draws; between -`HOTTEST` and 1


def _seal(at: Journey, _: Array, log_m: float) -> Array:
    return np.asarray(np.exp(-at.distance / np.exp(log_m)))


def _parking_brake(at: Journey, _: Array, log_s: float) -> Array:
    """Full after a long stop; its linings wear free while driving, and a short stop changes nothing."""
    keep = np.exp(-at.step / np.exp(log_s))
    output, time_now, stood = np.empty(len(at.travel)), 0.0, 0.0
    for i, stands in enumerate((at.travel < STANDING_MPS).tolist()):
        stood = stood + at.step if stands else 0.0
        time_now = 1.0 if stood > LONG_STOP_S else time_now if stands else time_now * keep
        output[i] = time_now
    return output


def _winding(at: Journey, torque: Array, rated: float) -> Array:
    return -np.minimum(at.lagged((torque / rated) ** 2, WINDING_S, 0.0), HOTTEST)


KINDS: dict[str, Kind] = {
    "seal": Kind("a seal whose drag fades with the distance run", "torque", ("distance",), ((7.6, 9.2),), _seal),
    "parking brake": Kind(
        f"a parking brake that drags after stops longer than {LONG_STOP_S:.0f} s", "torque", ("time since a stop",),
        ((3.0, 5.0),), _parking_brake,
    ),
    "winding": Kind(
        "a motor torque whose gain falls as the winding warms", "gain", ("driving torque",), ((3000.0, 6000.0),), _winding
    ),
}  # fmt: skip
"""Draws: of a seal the logarithm of 2 to 10 km, of a brake that of 20 to 150 s of driving, of a motor its rated torque [Nm]."""


PROGRAM = "program"  # its name among the hidden phenomena; parameters: seed, and size once it is known
STANDING_MPS, BRAKING_MPS2, BEND_PER_M = 0.1, -0.35, 0.02  # what resets a memory
UNEVEN, UNEVEN_S = 0.05, 20.0  # how much a size varies, and within what time
GATED, REMEMBERS = 0.4, 0.6  # shares of the programs
TURNS = (*KINDS, *(None for _ in KINDS))  # kind of a program by its seed, in turn; None: its parts are drawn
SPREAD = 4.0  # a variable is seen up to so many of its ranges away


@dataclass(frozen=True)
class Entry:
    """Entry point of a program: its words, its torque at a size of 1, and the largest physical size."""

    words: str
    unit: float
    largest: float


ENTRIES = {
    "torque": Entry("torque", 300.0, 6.0),  # Nm
    "gain": Entry("gain on the torque", 0.08, 4.0),
    "loss": Entry("loss modulus", 0.25, 3.0),
    "heat": Entry("heat into the belt", 400.0, 6.0),  # W/m^2
    "cooling": Entry("cooling of the belt", 0.6, 3.0),  # of its logarithm
    "sensor": Entry("torque sensor", 200.0, 6.0),  # Nm
}


@dataclass(frozen=True, eq=False)
class Seen:
    """Possible variables of a program in one drive; belt temperature [degC] and torque [Nm] are those without it."""

    at: Journey
    belt: Array
    torque: Array


@dataclass(frozen=True)
class DrawnVariable:
    """A variable: its usual range, its unit, and how it follows from a drive."""

    low: float
    high: float
    unit: str
    of: Callable[[Seen], Array]


VARIABLES: dict[str, DrawnVariable] = {
    "speed": DrawnVariable(0.0, 14.0, "m/s", lambda s: s.at.travel),
    "acceleration": DrawnVariable(-0.5, 0.5, "m/s^2", lambda s: np.asarray(s.at.drive.accel * s.at.direction)),
    "load": DrawnVariable(0.75, 1.3, "of the nominal load", lambda s: s.at.load),
    "belt temperature": DrawnVariable(12.0, 50.0, "degC", lambda s: s.belt),
    "ambient temperature": DrawnVariable(3.0, 27.0, "degC", lambda s: s.at.drive.ambient),
    "yaw rate": DrawnVariable(0.0, 0.12, "rad/s", lambda s: np.asarray(np.abs(s.at.drive.yaw_rate))),
    "yaw rate to the left": DrawnVariable(-0.1, 0.1, "rad/s", lambda s: s.at.drive.yaw_rate),
    "driving torque": DrawnVariable(-2000.0, 8000.0, "Nm", lambda s: s.torque),
    "distance": DrawnVariable(0.0, 20_000.0, "m", lambda s: s.at.distance),
    "time since start": DrawnVariable(0.0, 900.0, "s", lambda s: np.asarray(np.arange(len(s.belt)) * s.at.step)),
}


def _scaled(name: str, seen: Seen) -> Array:
    """A variable over its usual range: 0 to 1."""
    v = VARIABLES[name]
    return np.clip((v.of(seen) - v.low) / (v.high - v.low), -SPREAD, SPREAD)


def _kinked(u: Array, *drawn: float) -> Array:
    gaps, rises = np.split(np.array(drawn), 2)
    return np.asarray(np.interp(u, np.cumsum(gaps) / gaps.sum(), np.cumsum(rises**2) / (rises**2).sum()))


FUNCTIONS: dict[str, tuple[tuple[tuple[float, float], ...], Callable[..., Array]]] = {
    "power": (((0.4, 3.0),), lambda u, p: np.sign(u) * np.minimum(np.abs(u), 1.5) ** p),
    "saturating curve": (((2.0, 8.0), (0.1, 0.6)), lambda u, steep, at: np.tanh(steep * (u - at))),
    "bump": (((0.15, 0.8), (0.08, 0.25)), lambda u, at, width: np.exp(-0.5 * ((u - at) / width) ** 2)),
    "wide bump": (((0.15, 0.8), (0.08, 0.25)), lambda u, at, width: 1.0 / (1.0 + ((u - at) / width) ** 2)),
    "sine": (((0.7, 3.0), (0.0, 2.0)), lambda u, waves, turn: np.sin(np.pi * (2.0 * waves * u + turn))),
    "step": (((0.2, 0.75), (1e-3, 0.03)), lambda u, at, soft: 0.5 + 0.5 * np.tanh((u - at) / soft)),
    "kinked curve": (((0.02, 1.0),) * 10, _kinked),
}
"""Functions of a scaled variable, between about -1 and 1: ranges of the draws, and the function."""


def _lag(x: Array, at: Journey, _: np.random.Generator, log_s: float) -> Array:
    return at.lagged(x, float(np.exp(log_s)), float(x[0]))


def _integrator(x: Array, at: Journey, _: np.random.Generator, reset: float, by_way: float, log_s: float) -> Array:
    gone = (at.travel < STANDING_MPS, at.drive.accel * at.direction < BRAKING_MPS2, at.curvature > BEND_PER_M)[int(reset)]
    rate = x * (at.travel / 5.0 if by_way < 0.5 else 1.0) * at.step / np.exp(log_s)
    output, time_now = np.empty(len(x)), 0.0
    for i, (more, lost) in enumerate(zip(rate.tolist(), gone.tolist(), strict=True)):
        time_now = time_now * (1.0 - at.step / 1.5) if lost else min(max(time_now + more, -1.0), 1.0)
        output[i] = time_now
    return output


def _latch(x: Array, at: Journey, _: np.random.Generator, on: float, width: float) -> Array:
    output, time_now = np.empty(len(x)), 0.0
    for i, level in enumerate(x.tolist()):
        time_now = 1.0 if level > on else 0.0 if level < on - width else time_now
        output[i] = time_now
    return at.lagged(output, 1.5, 0.0)


def _chatter(x: Array, at: Journey, rng: np.random.Generator, on_s: float, off_s: float) -> Array:
    output, i = np.zeros(len(x)), int(rng.exponential(off_s) / at.step)
    while i < len(x):
        held = int(rng.exponential(on_s) / at.step) + 1
        output[i : i + held] = 1.0
        i += held + int(rng.exponential(off_s) / at.step) + 1
    return x * at.lagged(output, 0.5, 0.0)


def _counter(x: Array, _at: Journey, _: np.random.Generator, level: float, scale: float) -> Array:
    count = np.cumsum(np.diff((x > level).astype(int), prepend=0) == 1)
    return np.asarray(x * (1.0 - np.exp(-count / scale)))


RESETS = ("a stop", "braking", "a bend")
MEMORIES: dict[str, tuple[str, tuple[tuple[float, float], ...], Callable[..., Array]]] = {
    "lag": ("with a lag", ((1.4, 5.3),), _lag),
    "integrator": ("added up until ", ((0.0, 3.0), (0.0, 1.0), (3.7, 5.5)), _integrator),
    "latch": ("latched", ((0.4, 0.7), (0.15, 0.35)), _latch),
    "chatter": ("at random times", ((2.0, 60.0), (5.0, 120.0)), _chatter),
    "counter": ("growing each time", ((0.2, 0.6), (3.0, 15.0)), _counter),
}
"""Memories: words, ranges of the draws, and the transformation of a series in a drive with its own chance."""


@dataclass(frozen=True, eq=False)
class Program:
    """Randomly drawn hidden physics."""

    entry: str  # of `ENTRIES`
    parts: tuple[tuple[str, str, Array], ...]  # variables, functions and their draws: one or two, which are multiplied
    gate: tuple[str, float, float, float] | None  # variable, threshold of its scaled value, side, softness; None: always acts
    memory: tuple[str, Array] | None  # one of `MEMORIES` and its draws
    words: str  # description, for people
    seed: int
    kind: tuple[str, Array] | None = None  # one of `KINDS` and its draws, instead of parts, gate and memory

    @property
    def description(self) -> dict[str, Any]:
        """Description for a score."""
        return {
            "words": self.words,
            "entry": self.entry,
            "kind": self.kind and self.kind[0],
            "variables": [name for name, _, _ in self.parts] if self.kind is None else list(KINDS[self.kind[0]].variables),
            "functions": [kind for _, kind, _ in self.parts],
            "gate": self.gate and self.gate[0],
            "memory": self.memory and self.memory[0],
            "predictable": self.memory is None or self.memory[0] != "chatter",
        }

    def series(self, seen: Seen) -> Array:
        """How strong it is over a drive, between about -1 and 1; a kind may have another range."""
        x = np.ones(len(seen.belt)) if self.kind is None else KINDS[self.kind[0]].strength(seen.at, seen.torque, *self.kind[1])
        for name, kind, drawing in self.parts:
            x = x * FUNCTIONS[kind][1](_scaled(name, seen), *drawing)
        if self.gate is not None:
            name, threshold, side, soft = self.gate
            x = x * (0.5 + 0.5 * np.tanh(side * (_scaled(name, seen) - threshold) / soft))
        rng = np.random.default_rng([self.seed, int(seen.at.driven)])
        if self.memory is not None:
            kind, drawing = self.memory
            x = MEMORIES[kind][2](x, seen.at, rng, *drawing)
        shocks = rng.normal(0.0, UNEVEN * np.sqrt(2.0 * UNEVEN_S / seen.at.step), len(x))
        return np.asarray(x * (1.0 + seen.at.lagged(shocks, UNEVEN_S, 0.0)))


def draw_program(seed: int) -> Program:
    """The program of a seed."""
    g = np.random.default_rng([seed, *PROGRAM.encode()])
    turn = TURNS[seed % len(TURNS)]
    if turn is not None:
        known = KINDS[turn]
        return Program(known.entry, (), None, None, known.words, seed, (turn, g.uniform(*np.transpose(known.ranges))))
    entry = str(g.choice(list(ENTRIES), p=(0.4, 0.12, 0.12, 0.1, 0.1, 0.16)))
    names = [str(name) for name in g.permutation(list(VARIABLES))]
    count = 2 if g.random() < 0.35 else 1
    kinds = [str(kind) for kind in g.choice(list(FUNCTIONS), count)]
    parts = [(name, kind, g.uniform(*np.transpose(FUNCTIONS[kind][0]))) for name, kind in zip(names, kinds, strict=False)]
    text_here = " times ".join(f"a {kind} over {name}" for name, kind, _ in parts)
    words, gate, memory = f"{ENTRIES[entry].words}: {text_here}", None, None
    if g.random() < GATED:
        name, threshold, side = names[count], float(g.uniform(0.3, 0.65)), float(g.choice((-1.0, 1.0)))
        gate = (name, threshold, side, float(g.choice((1e-3, 0.04))))
        v = VARIABLES[name]
        place = float(np.format_float_positional(v.low + threshold * (v.high - v.low), 2, fractional=False))
        words += f", only {'above' if side > 0.0 else 'below'} {place:g} {v.unit} of {name}"
    if g.random() < REMEMBERS:
        kind = str(g.choice(list(MEMORIES)))
        text, ranges, _ = MEMORIES[kind]
        memory = (kind, g.uniform(*np.transpose(ranges)))
        words += f", {text}{RESETS[int(memory[1][0])] if kind == 'integrator' else ''}"
    return Program(entry, tuple(parts), gate, memory, words, seed)


def acting(hidden: Mapping[str, Mapping[str, float]], seen: Seen) -> dict[str, Array]:
    """Result of a hidden program, at its entry point and in that entry's unit."""
    program = draw_program(int(hidden[PROGRAM]["seed"]))
    return {program.entry: ENTRIES[program.entry].unit * hidden[PROGRAM].get("size", 1.0) * program.series(seen)}


LOAD = "stretch_load"
STAYS = 0.5  # share of the people who stay on at a stop


def loaded(drive: SealedDrive, p: Mapping[str, float], driven: float) -> SealedDrive:
    """The same drive with a load between one stop and the next, up to a `share` of its weight.

    People get on and off a few at a time; `bulk` is either present or not.
    """
    assert drive.street is not None
    rng = np.random.default_rng([int(p["seed"]), int(driven)])
    count = int(drive.street.stretch.max()) + 1
    load = rng.uniform(0.0, 1.0, count)
    if p["bulk"]:
        full = np.arange(count) % 2 == rng.integers(2)
        load = np.where(full, 0.8 + 0.2 * load, 0.05 * load)
    else:
        for k in range(1, count):
            load[k] = STAYS * load[k - 1] + (1.0 - STAYS) * load[k]
    return replace(drive, weight=drive.weight * (1.0 + p["share"] * load[drive.street.stretch]))


def _slope(at: Journey, _p: Mapping[str, float], _: Array) -> Array:
    """The slope of a street that was not surveyed: its steepness is that of the town."""
    assert at.drive.street is not None
    return at.climbing(at.drive.street.slope)


def _ground(at: Journey, p: Mapping[str, float], _: Array) -> Array:
    """Soft or rough ground on some streets, which takes the same either way; each pass runs on another line."""
    assert at.drive.street is not None
    rng = np.random.default_rng([int(p["seed"]), int(at.driven)])
    line = 1.0 + at.lagged(rng.normal(0.0, 0.1 * np.sqrt(2.0 * 40.0 / at.step), len(at.speed)), 40.0, 0.0)
    return p["torque"] * at.drive.street.softness * line * at.load * at.direction


TOWN_PHENOMENA: dict[str, Adds] = {"street_slope": _slope, "street_ground": _ground}
"""Additional torques; `LOAD` is in the weight."""
