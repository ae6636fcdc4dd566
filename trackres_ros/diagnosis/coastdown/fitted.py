# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fits a base model to coast-downs: the decelerating forces equal the loss of momentum per time.

Only the speed is measured, so all results scale with the mass including rotating parts. These are fixed, and their
uncertainty widens every interval.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import stdtrit

from trackres_ros.diagnosis.base.base import Base
from trackres_ros.diagnosis.base.instrument import instrument
from trackres_ros.diagnosis.base.loading import LoadedBase
from trackres_ros.diagnosis.base.road_load import RoadBase
from trackres_ros.diagnosis.base.track import TrackBase
from trackres_ros.diagnosis.coastdown.stretches import Rollouts, rollouts
from trackres_ros.diagnosis.inference.blas_threads import one_blas_thread
from trackres_ros.diagnosis.inference.fitting import Fit, Problem, fit
from trackres_ros.diagnosis.inference.noise import SHORT_ROOT
from trackres_ros.diagnosis.prepare.refuse import check_speed
from trackres_ros.diagnosis.prepare.resample import step_for
from trackres_ros.diagnosis.prepare.session import MOST_LAGS, Array, whole_past
from trackres_ros.diagnosis.selection.held_out import HeldOutLaps, Improvement
from trackres_ros.diagnosis.selection.intervals import NORMAL_95, intervals, lap_std
from trackres_ros.errors import InputError
from trackres_ros.progress import counted
from trackres_ros.recording.recording import Recording
from trackres_ros.text.numbers import figures
from trackres_ros.units import GRAVITY
from trackres_ros.vehicle.writing.changes import FileChanges, Interval

SCALES = ("mass", "rotating_mass_factor", "torque_scale", "efficiency", "torque_delay")
"""A coast-down does not determine these, nor the parameters of a torque sensor."""
FORCES = ("loss_modulus_scale", "bearing_friction", "drag_coefficient", "rolling_coefficient", "rolling_rise", "drag_area")
"""Parameters proportional to a force, which scale with the mass."""
SAMPLES_A_STEP = 1  # the deceleration hardly changes within a step
FEWEST_GROUPS = 3  # of coast-downs, for a scatter
FEWEST_ROWS = 20  # including history, for the noise and the values
MOST_FOLDS = 6
WHITE = 0.01  # bound on the roots of the noise of a smoothed speed: practically white, see docs/coastdown.md
UNDETERMINED = 0.7  # of the prior standard deviation: a parameter with a larger posterior one is not determined
TOGETHER = 0.9  # of two errors above which only a combination is determined


@dataclass(frozen=True, slots=True)
class FittedValue:
    """Parameter of a coast-down fit."""

    name: str
    unit: str
    before: float  # of the vehicle file
    before_std: float  # infinite for an unknown value
    value: float
    interval: Interval  # including the uncertainty of the mass
    determined: bool  # whether the coast-downs determine it; else the value of the file stays
    with_others: tuple[str, ...]  # parameters that are not identifiable separately from it
    by_file: tuple[float, float]  # range in the vehicle file

    @property
    def beyond(self) -> bool:
        """Whether the coast-downs contradict the range of the vehicle file: the whole interval is outside."""
        return self.determined and not (self.interval.low <= self.by_file[1] and self.by_file[0] <= self.interval.high)


@dataclass(frozen=True, eq=False)
class Coastdown:
    """Results of a fit to coast-downs."""

    loaded: LoadedBase
    rolled: Rollouts
    nominal: tuple[Array, ...]  # torque of each session with the vehicle file [Nm]; the true torque while coasting is zero
    fitted: tuple[Array, ...]  # and with the fitted values [Nm]
    parameters: tuple[FittedValue, ...]  # fitted, and undetermined ones, which stay
    mass_std: float  # relative standard deviation of mass and rotating masses, in all intervals
    improvement: Improvement | None  # of the hold-out error over coast-downs; None for too few to know their scatter

    @property
    def better(self) -> bool:
        """Whether the values improve the hold-out coast-downs significantly, none contradicts the range of the file, and a
        vehicle file may hold them.
        """
        if any(p.beyond for p in self.parameters):
            return False
        better = self.improvement is not None and self.improvement.after < self.improvement.before and self.improvement.low > 0.0
        return better and not self.refused

    @cached_property
    def refused(self) -> str:
        """Why no command would accept a vehicle file with the values; empty if all would."""
        try:
            self.loaded.base.as_written(self.kept.values or {})
        except InputError as error:
            return f"{error.given}; allowed: {error.allowed}"
        return ""

    @property
    def kept(self) -> FileChanges:
        """Changes that may be written."""
        values = {p.name: p.value for p in self.parameters}
        spans = {("", p.name): p.interval for p in self.parameters if p.determined}
        determined = ", ".join(p.name for p in self.parameters if p.determined) or "none"
        return FileChanges(
            values, (), spans, f"found in {len(self.rolled.stretches)} coast-downs: {determined}", by="trackres coastdown"
        )


@one_blas_thread()
def coastdown(recordings: Sequence[Recording], loaded: LoadedBase, seed: int = 1) -> Coastdown:
    """Estimate resistance parameters; an `InputError` without coast-downs or free parameters. `seed` is that of the bootstrap."""
    base = _with_free(loaded.base, [q.name for q in loaded.base.parameters if q.name not in SCALES])
    if not base.parameters:
        given = "a vehicle file with a zero-width range on every value that a coast-down could determine"
        raise InputError("vehicle", given, "ranges for its values", "widen the ranges of uncertain values")
    step = step_for(recordings, SAMPLES_A_STEP)
    rolled = rollouts(list(recordings), loaded.known, base.facts.radius, step, loaded.route)
    for session in rolled.sessions:
        check_speed(session, loaded.known.max_speed)
    if not rolled.stretches:
        counts = "; ".join(f"{count} {reason}" for reason, count in rolled.rejected.items())
        why = counts or "it nowhere slows down for several seconds"
        raise InputError(
            ", ".join(r.name for r in recordings),
            f"no coast-down ({why})",
            "at least one coast-down of 10 s or more, without torque and brakes",
            "; ".join((*rolled.remedies, "let the vehicle coast down from its maximum speed, in both directions")),
        )
    rows = sum(int(whole_past(s.used, MOST_LAGS).sum()) for s in rolled.sessions)
    if rows < FEWEST_ROWS:
        seconds = sum(float(s.used.sum()) * s.step for s in rolled.sessions)
        raise InputError(
            ", ".join(r.name for r in recordings),
            f"{len(rolled.stretches)} coast-downs, {figures(seconds, 3)} s in all, in steps of {figures(step, 3)} s",
            f"{FEWEST_ROWS} steps or more, without the first {MOST_LAGS} of each",
            "record more coast-downs, from a higher speed, or with a higher sample rate",
        )
    problem = Problem(base, rolled.sessions, tuple(s.used for s in rolled.sessions))
    all_free = _fit(problem)
    scatter = _scatter(all_free, rolled)
    determined = [f.key[1] for f in all_free.free if max(all_free.std_of(*f.key), scatter.get(f.key, 0.0)) < UNDETERMINED * f.std]
    problem = replace(problem, base=_with_free(base, determined))
    found = _fit(problem, all_free.at) if determined else None
    mass_std = _mass_std(loaded.base, rolled)
    parameters = _parameters(base, all_free, found, scatter, mass_std)
    outside = [p for p in parameters if not p.by_file[0] <= p.value <= p.by_file[1]]
    if found is not None and outside and not any(p.beyond for p in outside):
        base = base.inside_ranges(())
        problem = replace(problem, base=_with_free(base, determined))
        found = _fit(problem, found.at)
        parameters = _parameters(base, all_free, found, scatter, mass_std)
    nominal = tuple(p.torque for p in problem.predict(base.nominal, ()))
    rng = np.random.default_rng(seed)
    return Coastdown(
        loaded,
        rolled,
        nominal,
        nominal if found is None else tuple(p.torque for p in found.predicted),
        parameters,
        mass_std,
        _improvement(problem, rolled, nominal, rng) if determined and scatter else None,
    )


def _fit(problem: Problem, start: Mapping[tuple[str, str], float] | None = None) -> Fit:
    """The fit, in which a constant force weighs no less than the changes within a few seconds.

    The errors of a smoothed speed are alike from second to second, and cancel over longer times. A whitening with such roots
    weighs what the smoother makes of a release, which is alike in all coast-downs.
    """
    smoothed = any(session.accel_noise > 0.0 for session in problem.sessions)
    return fit(problem, start=start, largest_root=WHITE if smoothed else SHORT_ROOT)


def _with_free(base: Base, names: Collection[str]) -> Base:
    """The base with these parameters free, and without errors of a torque sensor."""
    found = copy.copy(base)
    found.parameters = tuple(q for q in base.parameters if q.name in names)
    found.fixed = {**base.fixed, **{q.name: q.nominal for q in base.parameters if q.name not in names}}
    found.includes = (*base.includes, *(effect.name for effect in instrument(base)))
    return found


def _mass_std(base: Base, rolled: Rollouts) -> float:
    """Relative standard deviation of the effective mass, as far as the file gives it."""
    assert isinstance(base, TrackBase | RoadBase)
    known = base.vehicle.parameters
    names = ["chassis.rotating_mass_factor" if isinstance(base, TrackBase) else "road_load.rotating_mass_factor"]
    if isinstance(base, RoadBase) and not all("load" in s.given for s in rolled.sessions):
        names.append("road_load.mass")
    return float(np.sqrt(sum((known[n].standard_deviation / float(np.mean(known[n].value))) ** 2 for n in names)))


def _scatter(all_free: Fit, rolled: Rollouts) -> dict[tuple[str, str], float]:
    """Standard deviations from leaving out coast-downs, thus with unmeasured slopes and winds, wider for few of them.

    Empty for fewer than `FEWEST_GROUPS`: an unmeasured slope of one of two then looks like another resistance.
    """
    together = _together(rolled, FEWEST_GROUPS)
    groups = math.ceil(len(rolled.stretches) / together)
    wider = float(stdtrit(groups - 1, 0.975)) / NORMAL_95 if groups > 1 else 1.0
    return {key: wider * std for key, std in lap_std(all_free, together).items()}


def _together(rolled: Rollouts, fewest: int) -> int:
    """Number of consecutive coast-downs left out at once: without a known slope two, of both directions, if there are enough."""
    known = all("grade" in s.given for s in rolled.sessions)
    return 1 if known or len(rolled.stretches) < 2 * fewest else 2


def _parameters(
    base: Base, all_free: Fit, found: Fit | None, scatter: Mapping[tuple[str, str], float], mass_std: float
) -> tuple[FittedValue, ...]:
    spans = intervals(all_free)
    std = np.sqrt(np.diag(all_free.covariance))
    correlation = all_free.covariance / np.outer(std, std)
    values = {} if found is None else found.at
    listed = []
    for i, (q, f) in enumerate(zip(base.parameters, all_free.free, strict=True)):
        determined, at, span = f.key in values, all_free.at[f.key], spans[f.key]
        value = values.get(f.key, q.nominal)
        of_mass = NORMAL_95 * mass_std * abs(value) if q.name in FORCES else 0.0
        by_rollings = NORMAL_95 * scatter.get(f.key, 0.0)
        below, above = (np.hypot(max(reach, by_rollings), of_mass) for reach in (at - span.low, span.high - at))
        span = Interval(max(q.low, value - float(below)), min(q.high, value + float(above)), span.bound_only)
        others = [g.key[1] for j, g in enumerate(all_free.free) if j != i and abs(correlation[i, j]) > TOGETHER]
        listed.append(FittedValue(q.name, q.unit, q.nominal, q.std, value, span, determined, tuple(others), q.by_file))
    return tuple(listed)


def _improvement(problem: Problem, rolled: Rollouts, nominal: Sequence[Array], rng: np.random.Generator) -> Improvement | None:
    """Cross-validated improvement of the error: each part of the coast-downs by a fit to the others."""
    together = _together(rolled, 2)
    parts = math.ceil(len(rolled.stretches) / together)
    if parts < 2:
        return None
    expected = [np.array(x) for x in nominal]
    folds = min(parts, MOST_FOLDS)
    for fold in counted(range(folds), "what is not fitted", folds):
        held = [(s.block // together % folds == fold) & s.used for s in rolled.sessions]
        others = replace(problem, masks=tuple(s.used & ~h for s, h in zip(rolled.sessions, held, strict=True)))
        found = _fit(others)
        for series, of, mask in zip(expected, found.predicted, held, strict=True):
            series[mask] = of.torque[mask]
    masks = [s.used for s in rolled.sessions]
    return HeldOutLaps(rolled.sessions, masks, rng).improvement(nominal, expected)


@dataclass(frozen=True, eq=False)
class Rollout:
    """Speeds of one coast-down; series of shape (n,)."""

    name: str  # of the recording
    time: Array  # since the start of the recording [s]
    measured: Array  # speed [m/s]
    by_file: Array  # speed with the vehicle file, from the first measured one on [m/s]
    by_found: Array  # and with the fitted values [m/s]
    over_file: Array  # excess resistance torque [Nm]
    over_found: Array


def rollouts_of(found: Coastdown) -> list[Rollout]:
    """All coast-downs of a result, in order."""
    base, listed = found.loaded.base, []
    for stretch in found.rolled.stretches:
        session, at = found.rolled.sessions[stretch.session], slice(stretch.begin, stretch.end)
        sense = np.sign(session.speed[at])
        per_acceleration = session.weight[at] / GRAVITY * base.rotating_mass_factor * base.facts.radius
        over = [sense * (torque[stretch.session][at] - session.torque[at]) for torque in (found.nominal, found.fitted)]
        # Excess torque of a model adds deceleration; the effect of the changed speed is neglected.
        behind = [np.concatenate(([0.0], np.cumsum(x / per_acceleration)[:-1])) * session.step for x in over]
        measured = np.abs(session.speed[at])
        listed.append(Rollout(session.name, session.time[at], measured, *(measured - b for b in behind), *over))
    return listed
