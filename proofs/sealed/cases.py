# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws the concealed physics of each case: levels, sizes, builds of the vehicle, all from one seed.

A hidden program is scaled to the drawn detectability, within physical limits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from proofs.sealed.drives import SealedDrive
from proofs.sealed.phenomena import ENTRIES, PROGRAM, TURNS, draw_program
from proofs.sealed.truth import Build, Sensors, drawn_sensors, simulate_truth
from trackres_ros.arrays import Array

Values = dict[str, float]
Draw = Callable[[np.random.Generator, float], Values]

LEVELS = {
    "none": 60, "single": 60, "masked": 40, "compensated": 40, "two": 40, "confounded": 24, "outside": 48,
    "street": 40,
}  # fmt: skip
QUICK = {"none": 14, "single": 14, "masked": 9, "compensated": 9, "two": 9, "confounded": 6, "outside": 12, "street": 8}
NOT_IN_CATALOGUE = ("outside", "street")  # levels
RECORDED = "recorded"
SOURCES = ("course", "trapezoids", "town", RECORDED)  # of drives; the last only where speeds of real vehicles are given
LOADS = (1.0, 0.8, 1.25)  # of the three drives, over the nominal one
MASKED_SIZE = (0.2, 0.4)  # of a clear one
# In towns: share of the cases that are recorded once in a second, and the error of positions and altitudes [m].
SLOW_SHARE, SLOW_S = 1.0 / 3.0, 1.0
POSITION_M, ALTITUDE_M = (3.0, 8.0), (2.0, 5.0)


@dataclass(frozen=True)
class Case:
    """One case."""

    name: str  # uninformative
    level: str
    hidden: dict[str, Values]  # phenomena and the values of their parameters, see `truth`
    build: dict[str, float]  # differences of the vehicle from its data sheet, see `truth.Build`
    lumped: bool  # the vehicle file has no core temperature of the belt
    compensated: bool  # the vehicle file was fitted to other drives of the same vehicle beforehand
    dull: bool  # little excitation: one load, no bends, hardly a change of speed, no belt temperature
    belt_measured: bool
    seed: int  # of drives and sensors
    source: str = "course"  # of its drives, of `SOURCES`; a dull case and a case in a town have their own
    program: dict[str, Any] = field(default_factory=dict)  # see `phenomena.Program.description`; empty without

    @property
    def title(self) -> str:
        """Hidden physics, as text."""
        return str(self.program.get("words") or " and ".join(self.hidden) or "nothing")


def _pm(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.choice((-1.0, 1.0)) * rng.uniform(low, high))


def _turn(rng: np.random.Generator) -> float:
    return float(rng.uniform(0.0, 2.0 * np.pi))


def _seed(rng: np.random.Generator) -> float:
    return float(rng.integers(1_000_000))


CATALOGUE: dict[str, Draw] = {
    "grade": lambda g, s: {"grade": s * _pm(g, 0.004, 0.015)},
    "grade_profile": lambda g, s: {"rise": s * g.uniform(0.005, 0.015), "towards": _turn(g)},
    "turning_scrub": lambda g, s: {"friction": s * g.uniform(0.35, 0.9)},
    "cornering": lambda g, s: {"compliance": s * g.uniform(1.0e-6, 2.2e-6)},
    "rotating_inertia": lambda g, s: {"more": s * g.uniform(0.05, 0.15)},
    "drivetrain_efficiency": lambda g, s: {"efficiency": 1.0 - s * g.uniform(0.06, 0.15)},
    "drivetrain_drag": lambda g, s: {"drag": s * g.uniform(150.0, 350.0)},
    "viscous_bearing": lambda g, s: {
        "coefficient": s * g.uniform(50.0, 130.0), "rise": g.uniform(1.0, 3.0), "seconds": g.uniform(600.0, 1500.0),
        "activation": g.uniform(3000.0, 5000.0),
    },
    "stribeck": lambda g, s: {
        "constant": s * g.uniform(60.0, 150.0), "breakaway": s * g.uniform(200.0, 380.0), "speed": g.uniform(0.6, 2.5),
    },
    "headwind": lambda g, s: {"wind": s * g.uniform(5.0, 11.0), "towards": _turn(g)},
    "payne": lambda g, s: {"height": s * g.uniform(0.2, 0.5), "power": g.uniform(0.3, 0.7)},
    "mullins": lambda g, s: {"excess": s * g.uniform(0.12, 0.25), "distance": g.uniform(1500.0, 6000.0)},
    "frequency": lambda g, s: {"per_e": s * g.uniform(0.06, 0.15)},
    "compound_temperature": lambda g, s: {"activation": s * _pm(g, 700.0, 1600.0)},
    "core_surface": lambda _g, _s: {},
    "convection": lambda g, s: {"offset": 1.0 + s * g.uniform(0.6, 1.4), "slope": 1.0 + s * g.uniform(0.6, 1.4)},
    "ground_conduction": lambda g, s: {"conductance": s * g.uniform(70.0, 200.0)},
    "still_air": lambda g, s: {"share": s * g.uniform(0.6, 0.85)},
    "solar": lambda g, s: {"flux": s * g.uniform(400.0, 900.0)},
    "rain": lambda g, s: {"factor": 1.0 + s * g.uniform(1.0, 4.0)},
    "tension_torque": lambda g, s: {"share": s * g.uniform(0.12, 0.3)},
    "lug_friction": lambda g, s: {"of_tension": s * g.uniform(0.006, 0.016), "of_torque": s * g.uniform(0.015, 0.04)},
    "roadwheel_tyres": lambda g, s: {
        "torque": s * g.uniform(250.0, 700.0), "rise": g.uniform(0.8, 2.5), "seconds": g.uniform(500.0, 2000.0),
        "activation": g.uniform(1000.0, 2200.0),
    },
    "soft_ground": lambda g, s: {"torque": s * g.uniform(1000.0, 4000.0), "power": g.uniform(1.8, 2.6)},
    "vibration": lambda g, s: {
        "torque": s * g.uniform(200.0, 450.0), "speed": g.uniform(3.0, 11.0), "width": g.uniform(0.6, 1.5),
    },
    "warmup": lambda g, s: {"torque": s * g.uniform(250.0, 700.0), "seconds": g.uniform(150.0, 700.0)},
    "torque_offset": lambda g, s: {"offset": s * _pm(g, 120.0, 300.0)},
    "torque_gain": lambda g, s: {"error": s * _pm(g, 0.03, 0.06)},
    "delay": lambda g, s: {"time": s * g.uniform(0.15, 0.5)},
}  # fmt: skip
"""Draws of the truth's parameters by effect, at a size of 1: clear. Parameters that the base re-fits itself are excluded."""

D_PRIME = (40.0, 200.0)  # of a hidden program after a re-fit of the base
OUTSIDE: dict[str, Draw] = {
    PROGRAM: lambda g, _s: {"seed": _seed(g), "d_prime": float(np.exp(g.uniform(*np.log(D_PRIME))))},
}
"""Physics outside of any catalogue: see `programs`."""

STREET: dict[str, Draw] = {
    "street_slope": lambda g, _s: {"steepest": g.uniform(0.015, 0.03)},
    "stretch_load": lambda g, _s: {"share": g.uniform(0.1, 0.2), "bulk": float(g.random() < 0.5), "seed": _seed(g)},
    "street_ground": lambda g, _s: {"torque": g.uniform(300.0, 900.0), "seed": _seed(g)},
}  # fmt: skip
"""Hidden physics in a town, drawn as often as none; the functions are in `phenomena`."""


RIGHT_FORMS = {"street_slope": "place", "stretch_load": "payload", "street_ground": "place"}
"""Of each phenomenon of a town the form that describes it. For a program the hidden torque decides, see `own.is_true`."""
RIGHT_NAMES: dict[str, tuple[str, ...]] = {"street_slope": ("grade",)}
"""Equivalent names of a right form: a slope by place is a grade."""


def draw_cases(counts: Mapping[str, int], seed: int, sources: Sequence[str] = SOURCES[:-1]) -> list[Case]:
    """All cases of a run, in random order."""
    rng = np.random.default_rng(seed)
    cases = [_case(level, i, rng, sources) for level, count in counts.items() for i in range(count)]
    rng.shuffle(cases)
    return cases


def _case(level: str, i: int, rng: np.random.Generator, sources: Sequence[str]) -> Case:
    names, size = list(CATALOGUE), 1.0
    if level == "masked":
        size = float(rng.uniform(*MASKED_SIZE))
        names.remove("core_surface")  # it has no size
    library = {"outside": OUTSIDE, "street": STREET}.get(level, CATALOGUE)
    if level == "none" or (level == "street" and i % (1 + len(STREET)) == 0):
        choices: list[str] = []
    elif level == "street":
        choices = [list(STREET)[i % (1 + len(STREET)) - 1]]
    elif level == "outside":
        choices = [PROGRAM]
    else:
        choices = [str(name) for name in rng.choice(names, 2 if level == "two" else 1, replace=False)]
    hidden = {name: {key: float(x) for key, x in library[name](rng, size).items()} for name in choices}
    source = str(rng.choice(list(sources)))
    if level == "outside":
        hidden[PROGRAM]["seed"] = _in_turn(hidden[PROGRAM]["seed"], i // 2)
        source = _half_recorded(source, i, rng, sources)
    deviation = rng.normal(1.0, 0.05, 5)
    if level == "none" and i % 2:  # re-fittable parameters that are plainly off
        deviation = rng.normal(1.0, (0.10, 0.20, 0.12, 0.18, 0.12))
    build = dict(
        zip(("loss", "bearing", "drag", "film", "capacity"), (float(x) for x in np.clip(deviation, 0.5, 1.6)), strict=True)
    )
    return Case(
        f"{rng.integers(16**8):08x}",
        level,
        hidden,
        build,
        "core_surface" in hidden,
        level == "compensated",
        level == "confounded",
        bool(rng.random() < 0.6) and level != "confounded",
        int(rng.integers(2**31)),
        source,
        draw_program(int(hidden[PROGRAM]["seed"])).description if PROGRAM in hidden else {},
    )


def _in_turn(seed: float, turn: int) -> float:
    """The nearest lower seed of a program whose kind has its turn."""
    return seed - seed % len(TURNS) + turn % len(TURNS)


def _half_recorded(source: str, i: int, rng: np.random.Generator, sources: Sequence[str]) -> str:
    """Of two cases the first has recorded speeds, where these are given, and the other has not."""
    if RECORDED not in sources:
        return source
    return str(rng.choice([name for name in sources if name != RECORDED])) if i % 2 else RECORDED


def draws(case: Case, what: str) -> np.random.Generator:
    """A generator of its own for each thing that is drawn, so that each can be drawn again by itself."""
    return np.random.default_rng([case.seed, *what.encode()])


def sensors_of(case: Case) -> Sensors:
    """The instruments of a case; in a town those of a road vehicle."""
    rng = draws(case, "sensors")
    sensors = drawn_sensors(rng, case.belt_measured)
    if case.level != "street":
        return sensors
    return replace(
        sensors,
        load_measured=streets_of(case).load_measured,
        every_s=SLOW_S if rng.random() < SLOW_SHARE else 0.0,
        position_m=float(rng.uniform(*POSITION_M)),
        altitude_m=float(rng.uniform(*ALTITUDE_M)),
    )


@dataclass(frozen=True)
class TownDrives:
    """Known properties of the drives of a case in a town."""

    steepest: float  # surveyed slope, which is recorded; 0 of a level town and of one with a hidden slope
    shares: tuple[float, float, float]  # weight of each drive, over the nominal one, without differences by stretch
    load: Values | None  # differences of recorded loads by stretch
    load_measured: bool  # it is recorded


def streets_of(case: Case) -> TownDrives:
    """Of the towns without a hidden slope half are level, half were surveyed. A load that is not hidden is recorded and
    differs by stretch, is recorded and differs by drive, or is the vehicle file's and not recorded, equally often.
    """
    rng = draws(case, "streets")
    surveyed, kind = rng.random() < 0.5, int(rng.integers(3))
    slope, load = (STREET[name](rng, 1.0) for name in ("street_slope", "stretch_load"))
    steepest = slope["steepest"] if surveyed and "street_slope" not in case.hidden else 0.0
    if "stretch_load" in case.hidden or kind == 0:
        return TownDrives(steepest, (1.0, 1.0, 1.0), None, False)
    if kind == 1:
        return TownDrives(steepest, LOADS, None, True)
    return TownDrives(steepest, (1.0, 1.0, 1.0), {key: float(x) for key, x in load.items()}, True)


ROAD_NM, ROAD_S, WHITE_NM = 50.0, 6.0, 15.0  # a torque's noise over a second: a road that no one measured, and white
CHANGE = 0.03  # of each value of the build, to find the part absorbed by a re-fit
ROUNDS, TRIES, TRIES_OF_KIND = 3, 20, 5
LEAST = 20.0  # of d'


def sized(case: Case, sheet: Path, drives: Sequence[SealedDrive]) -> Case:
    """The case with the size of its program and its detectability; an undetectable program is replaced by another, if possible
    of its kind.
    """
    if PROGRAM not in case.hidden:
        return case
    build, wanted = Build(**case.build), case.hidden[PROGRAM]["d_prime"]
    plain = whitened([run.shown for run in simulate_truth(sheet, build, {}, drives)], drives)
    others = [replace(build, **{name: (1.0 + CHANGE) * value}) for name, value in case.build.items()]
    base = [
        whitened([run.shown for run in simulate_truth(sheet, other_item, {}, drives)], drives) - plain for other_item in others
    ]
    taken = np.linalg.qr(np.column_stack([*base, plain]))[0]

    def seen(seed: float, size: float) -> float:
        runs = simulate_truth(sheet, build, {PROGRAM: {"seed": seed, "size": size}}, drives)
        added = whitened([run.added[PROGRAM] for run in runs], drives)
        return float(np.linalg.norm(added - taken @ (taken.T @ added)))

    # Drives without a long stop show no parking brake, whatever its size: then the next kind has its turn.
    others_of_kind = len(TURNS) * np.arange(TRIES_OF_KIND)
    for seed in case.hidden[PROGRAM]["seed"] + np.append(others_of_kind, np.arange(1, TRIES)):
        program, size = draw_program(int(seed)), 1.0
        for _ in range(ROUNDS):
            most = ENTRIES[program.entry].largest
            size = float(np.clip(size * wanted / max(seen(float(seed), size), 1e-6), 1e-3, most))
        d_prime = seen(float(seed), size)
        if d_prime >= LEAST:
            break
    hidden = {PROGRAM: {"seed": float(seed), "size": size, "d_prime": d_prime}}
    return replace(case, hidden=hidden, program=program.description)


def whitened(series: Sequence[Array], drives: Sequence[SealedDrive]) -> Array:
    """Torques over seconds, over the noise in them that cannot be known from the second before."""
    keep, parts = np.exp(-1.0 / ROAD_S), list[Array]()
    for torque, value in zip(series, drives, strict=True):
        n = round(1.0 / value.step)
        second = torque[: len(torque) // n * n].reshape(-1, n).mean(axis=1)
        parts.append(second - keep * np.append(0.0, second[:-1]))
    return np.asarray(np.concatenate(parts) / np.hypot(ROAD_NM * np.sqrt(1.0 - keep**2), WHITE_NM * np.sqrt(1.0 + keep**2)))
