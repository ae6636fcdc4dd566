# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Small drives in which something is hidden: a base fitted to their laps, and what searches and judges its residual."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
from scipy.signal import lfilter

from trackres_ros.diagnosis import load_base
from trackres_ros.diagnosis.base.base import Base
from trackres_ros.diagnosis.base.own import OwnBase, OwnModel
from trackres_ros.diagnosis.base.patterns import ResidualPattern
from trackres_ros.diagnosis.empirical.term import term_of_fit
from trackres_ros.diagnosis.inference.fitting import Fit, Problem, fit, with_levels
from trackres_ros.diagnosis.inference.noise import SHORT_ROOT
from trackres_ros.diagnosis.search.choice import Choice
from trackres_ros.diagnosis.search.cross_validation import CrossValidation
from trackres_ros.diagnosis.search.explanations import Explanation, Search
from trackres_ros.diagnosis.selection.as_used import AsUsed
from trackres_ros.diagnosis.selection.held_out import HeldOutLaps
from trackres_ros.diagnosis.synthetic import drives
from trackres_ros.effects import catalogue
from trackres_ros.effects.effect import Effect
from trackres_ros.effects.learned import EmpiricalEffect, sized_effect

LAP_S, LAPS = 75.0, 8  # of each drive
HELD_OUT_EVERY = 4  # so many laps of a drive leave one that is not fitted
NOISE_NM, NOISE_PHI = 20.0, 0.4
MOST_SPEED_MPS = 15.0
MASS_KG = 6000.0  # of the machine, on a wheel of 1 m

Series = Callable  # of a session and its number: a torque against travel [Nm], or a value, of shape (n,)


@cache
def base():
    """A track vehicle, the base of these drives where none is given."""
    return load_base("xgd24d").base


@cache
def machine():
    """A base that is simulated in no time: a function of the speed and the acceleration."""

    def torque(inputs, p):
        speed = np.abs(inputs.speed)
        return np.sign(inputs.speed) * (p["rolling"] + p["air"] * speed**2) + MASS_KG * inputs.accel

    parameters = {"rolling": (1500.0, 1450.0, 1550.0, "Nm"), "air": (6.0, 5.8, 6.2, "Nm/(m/s)^2")}
    return OwnBase(OwnModel("machine", torque, parameters, MOST_SPEED_MPS, MASS_KG))


@cache
def named() -> dict[str, Effect]:
    """The effects of the catalogue by name, of the size of this vehicle."""
    facts = base().facts
    return catalogue(None, facts.weight * facts.radius)


def driven(
    gain: float | Series = 1.0, adds: Series | None = None, held_out_gain: float | None = None, laps: int = LAPS, count: int = 2,
    phi: float = NOISE_PHI, changed: Callable | None = None, belt_noise: float | None = None, shows: Sequence = (),
    of: Base | None = None,
) -> Fit:  # fmt: skip
    """The base fitted to laps of drives with a torque of another scale and more torque; the last laps of each are held out.

    Parameters
    ----------
    gain
        Of the torque, or a series of it; `held_out_gain` is that of the held-out laps.
    phi
        Of the noise, whose innovations have the same scatter for each.
    changed
        A session from that of a drive, before anything is simulated.
    belt_noise
        Of measured belt temperatures [K]; by default none are measured.
    shows
        Effects that act, with their values.
    of
        The base.
    """
    vehicle, rng = of or base(), np.random.default_rng(1)
    sessions = drives(vehicle, MOST_SPEED_MPS, count, laps * LAP_S / 60.0, rng, step=1.0)
    sessions = [s if changed is None else changed(s) for s in sessions]
    prediction = vehicle.predict(sessions, vehicle.nominal, shows)
    shown, masks = [], []
    for i, (session, bare) in enumerate(zip(sessions, prediction, strict=True)):
        lap = (session.time // LAP_S).astype(np.int64)
        fit_result = lap < laps - laps // HELD_OUT_EVERY
        scale = gain(session, i) if callable(gain) else gain
        scale = np.where(fit_result, scale, scale if held_out_gain is None else held_out_gain)
        noise = lfilter([1.0], [1.0, -phi], rng.normal(0.0, NOISE_NM, len(session)))
        more = 0.0 if adds is None else adds(session, i) * np.sign(session.speed)
        moves = np.abs(session.speed) > 0.5
        torque = scale * (bare.torque + more) + noise
        shown.append(replace(session, torque=torque, block=lap + i * laps, used=moves))
        if belt_noise is not None:
            belt = bare.belt + rng.normal(0.0, belt_noise, len(session))
            shown[-1] = replace(shown[-1], belt=belt, given=session.given | {"belt"})
        masks.append(moves & fit_result)
    return with_levels(fit(Problem(vehicle, tuple(shown), tuple(masks))))


def scored(found: Fit) -> list:
    """The samples of each session that are compared: of laps that are fitted and held out."""
    return [s.used for s in found.problem.sessions]


def held_out(found: Fit) -> list:
    """The held-out samples of each session."""
    return [s.used & ~m for s, m in zip(found.problem.sessions, found.problem.masks, strict=True)]


def fit_with(found: Fit, *effects: Effect) -> Fit:
    """A fit with effects, with values that predict."""
    return fit(found.problem, effects, found.estimates, found.noises, largest_root=SHORT_ROOT)


def form(effect: EmpiricalEffect) -> EmpiricalEffect:
    """A form of the size of this vehicle."""
    facts = base().facts
    return sized_effect(effect, facts.weight * facts.radius)


def series(found: Fit, of: Series, ahead: float | None = None, name: str = "series") -> ResidualPattern:
    """A term that follows the clock, of a torque against travel over that of 1 Nm; known `ahead` by such a share."""
    problem = found.problem
    facts = problem.base.facts
    shape = [of(s, i) * np.sign(s.speed) for i, s in enumerate(problem.sessions)]
    known = shape if ahead is None else [ahead * x for x in shape]
    shape = [np.where(m, x, a) for m, x, a in zip(problem.masks, shape, known, strict=True)]
    return ResidualPattern(name, "of a test", shape, facts.weight * facts.radius, known)


def validation_of(found: Fit) -> CrossValidation:
    """The laps left out of a fit."""
    return CrossValidation(found, held_out(found), np.random.default_rng(1))


def judging(found: Fit, effects: Mapping[str, Effect]) -> SimpleNamespace:
    """What searches and judges explanations of a base's residual by `effects` and forms."""
    sessions, rng = found.problem.sessions, np.random.default_rng(1)
    laps = HeldOutLaps(sessions, held_out(found), rng)
    use = AsUsed(found.problem.base, sessions, sessions, laps)
    validation = validation_of(found)
    search = Search(found, effects, None, (), validation, lambda _: None)
    choice = Choice(search, search.base_explanation.fit, laps, use)
    return SimpleNamespace(search=search, choice=choice, validation=validation, laps=laps, use=use, refitted=found)


def explained(of: SimpleNamespace, *effects: Effect) -> Explanation:
    """The explanation by effects, each added to the ones before, with its fit settled."""
    search, last = of.search, of.search.base_explanation
    for i, effect in enumerate(effects, start=1):
        result = fit_with(of.refitted, *effects[:i])
        search._add(last, term_of_fit(last.fit, result, effect))
        last = search.polish(search.known[last.key | {effect.name}])
    return last


def graded(of: SimpleNamespace, *effects: Effect) -> tuple:
    """The grade of each of these terms together, and whether all of it is confirmed."""
    result = explained(of, *effects)
    return {name: of.choice.grade_term(result, name) for name in result.terms}, of.choice._is_confirmed(result)


def moving_means(found: Fit, rows: np.ndarray, seconds: float, used: Sequence) -> dict:
    """Means of rows of the torque segments by recording and block of so many seconds, with the share of a block that is used."""
    means, begin = {}, 0
    for i, (session, mask) in enumerate(zip(found.problem.sessions, used, strict=True)):
        own = rows[begin : begin + len(session)]
        begin += len(session)
        for block in sorted(set((session.time // seconds).astype(int).tolist())):
            is_inside = session.time // seconds == block
            known = own[is_inside & mask]
            if len(known) and len(known) >= 0.5 * is_inside.sum():
                means[i, block] = known.mean(axis=0)
    return means
