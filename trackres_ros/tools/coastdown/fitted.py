# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fits a base model to coast-downs: the decelerating forces equal the loss of momentum per time.

Only the speed is measured. So the mass and the rotating parts are fixed, and their uncertainty widens the interval of each value
as far as the value depends on them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.special import stdtrit

from trackres_ros.diagnosis.base.base import Base
from trackres_ros.diagnosis.base.loading import LoadedBase
from trackres_ros.diagnosis.base.road_load import RoadBase
from trackres_ros.diagnosis.base.track import TrackBase
from trackres_ros.diagnosis.inference.failures import one_blas_thread
from trackres_ros.diagnosis.inference.fitting import Fit, Problem, fit, valid_rows
from trackres_ros.diagnosis.inference.noise import SHORT_ROOT
from trackres_ros.diagnosis.prepare.checks import check_speed
from trackres_ros.diagnosis.prepare.resample import step_for
from trackres_ros.diagnosis.prepare.session import MOST_LAGS, Array, whole_past
from trackres_ros.diagnosis.selection.as_used import NORMAL_95, intervals, lap_std
from trackres_ros.diagnosis.selection.held_out import HeldOutLaps, Improvement
from trackres_ros.diagnosis.selection.visibility import base_columns
from trackres_ros.errors import InputError
from trackres_ros.estimator.constants import relative_std, relative_weight_std
from trackres_ros.progress import counted
from trackres_ros.recording.recording import Recording, with_stamps
from trackres_ros.text import figures
from trackres_ros.tools.coastdown.coasting import CoastingBase
from trackres_ros.tools.coastdown.stretches import Rollouts, rollouts
from trackres_ros.units import GRAVITY
from trackres_ros.vehicle.writing.changes import FileChanges, Interval

FIXED = ("mass", "rotating_mass_factor", "torque_scale", "efficiency", "torque_delay", "torque_offset")
"""A coast-down does not determine these: the masses, the gears, and the torque sensor."""
SAMPLES_A_STEP = 1  # the deceleration hardly changes within a step
FEWEST_GROUPS = 3  # of coast-downs, for a scatter
NORMAL_DEGREES = 1e6  # of Student's law: no residual is an outlier
FEWEST_ROWS = 20  # including history, for the noise and the values
MOST_FOLDS = 6
SETTLED_MPS, MOST_PASSES = 1e-3, 100  # of the integrated speed
WHITE = 0.01  # bound on the roots of the noise of a smoothed speed: practically white, see docs/coastdown.md
UNDETERMINED = 0.7  # of the prior standard deviation: a parameter with a larger posterior one is not determined
TOGETHER = 0.9  # of two errors above which only a combination is determined


@dataclass(frozen=True, slots=True)
class FittedValue:
    """Parameter of a coast-down fit."""

    name: str
    unit: str
    file_value: float  # of the vehicle file
    file_std: float  # infinite for an unknown value
    value: float
    interval: Interval  # including the uncertainty of the mass
    determined: bool  # whether the coast-downs determine it; else the value of the file stays
    with_others: tuple[str, ...]  # parameters that are not identifiable separately from it
    by_file: tuple[float, float]  # range in the vehicle file

    @property
    def is_outside(self) -> bool:
        """Whether the coast-downs contradict the range of the vehicle file: the whole interval is outside."""
        return self.determined and not (self.interval.low <= self.by_file[1] and self.by_file[0] <= self.interval.high)


@dataclass(frozen=True, eq=False)
class Coastdown:
    """Results of a fit to coast-downs."""

    base_file: LoadedBase
    runs: Rollouts
    base: Base  # while coasting
    values: Mapping[str, float]  # of its parameters, without unrecorded slopes
    parameters: tuple[FittedValue, ...]  # fitted, and undetermined ones, which stay
    mass_std: float  # relative standard deviation of mass and rotating masses, in all intervals
    improvement: Improvement | None  # of the hold-out error over coast-downs; None for too few to know their scatter

    @property
    def better(self) -> bool:
        """Whether the values improve the hold-out coast-downs significantly, none contradicts the range of the file, and a
        vehicle file may hold them.
        """
        if any(p.is_outside for p in self.parameters):
            return False
        is_better = (
            self.improvement is not None and self.improvement.after < self.improvement.before and self.improvement.low > 0.0
        )
        return is_better and not self.refusal

    @cached_property
    def refusal(self) -> str:
        """Why no command would accept a vehicle file with the values; empty if all would."""
        try:
            self.base_file.base.as_written(self.changes.values or {})
        except InputError as error:
            return f"{error.given}; allowed: {error.allowed}"
        return ""

    @property
    def changes(self) -> FileChanges:
        """Changes that may be written."""
        spans = {("", p.name): p.interval for p in self.parameters if p.determined}
        names_determined = ", ".join(p.name for p in self.parameters if p.determined) or "none"
        return FileChanges(
            self.values, (), spans, f"found in {self.runs.count} coast-downs: {names_determined}", command="trackres coastdown"
        )


@one_blas_thread()
def coastdown(recordings: Sequence[Recording], base_file: LoadedBase, seed: int = 1) -> Coastdown:
    """Estimate resistance parameters; an `InputError` without coast-downs or free parameters. `seed` is that of the bootstrap."""
    names = [q.name for q in base_file.base.parameters if q.name not in FIXED]
    if not names:
        problem_text = "a vehicle file with a zero-width range on every value that a coast-down could determine"
        raise InputError("vehicle", problem_text, "ranges for its values", "widen the ranges of uncertain values")
    recordings = [with_stamps(recording) for recording in recordings]
    step = step_for(recordings, SAMPLES_A_STEP)
    runs = rollouts(recordings, base_file, step)
    for session in runs.sessions:
        check_speed(session, base_file.known)
    if not runs.stretches:
        counts = "; ".join(f"{count} {reason}" for reason, count in runs.rejections.items())
        reasons = counts or "it nowhere slows down for several seconds"
        raise InputError(
            ", ".join(r.name for r in recordings),
            f"no coast-down ({reasons})",
            "at least one coast-down of 10 s or more, without torque and brakes",
            "; ".join((*runs.remedies, "let the vehicle coast down from its maximum speed, in both directions")),
        )
    rows = sum(int(whole_past(s.used, MOST_LAGS).sum()) for s in runs.sessions)
    if rows < FEWEST_ROWS:
        seconds = sum(float(s.used.sum()) * s.step for s in runs.sessions)
        raise InputError(
            ", ".join(r.name for r in recordings),
            f"{runs.count} coast-downs, {figures(seconds, 3)} s in all, in steps of {figures(step, 3)} s",
            f"{FEWEST_ROWS} steps or more, without the first {MOST_LAGS} of each",
            "record more coast-downs, from a higher speed, or with a higher sample rate",
        )
    unpaired_count = 0 if _slopes_known(runs) else runs.count
    base = CoastingBase(base_file.base, names, unpaired_count)
    problem = Problem(base, runs.sessions, tuple(s.used for s in runs.sessions))
    all_free = _fit(problem)
    scatter = _scatter(all_free, runs)
    stds = {name: max(all_free.std_of("", name), scatter.get(("", name), 0.0)) for name in names}
    names_determined = [q.name for q in base.parameters if q.name in names and stds[q.name] < UNDETERMINED * q.std]
    problem = replace(problem, base=CoastingBase(base_file.base, names_determined, unpaired_count))
    fit = _fit(problem, all_free.estimates) if names_determined else None
    masses = _mass_stds(base_file.base, runs)
    parameters = _parameters(base, all_free, fit, scatter, masses)
    outliers = [p for p in parameters if not p.by_file[0] <= p.value <= p.by_file[1]]
    if fit is not None and outliers and not any(p.is_outside for p in outliers):
        narrow_base = base_file.base.inside_ranges(())
        base = CoastingBase(narrow_base, names, unpaired_count)
        problem = replace(problem, base=CoastingBase(narrow_base, names_determined, unpaired_count))
        fit = _fit(problem, fit.estimates)
        parameters = _parameters(base, all_free, fit, scatter, masses)
    rng = np.random.default_rng(seed)
    return Coastdown(
        base_file,
        runs,
        problem.base,
        {p.name: p.value for p in parameters},
        parameters,
        math.hypot(*masses),
        _improvement(problem, runs, rng) if names_determined and scatter else None,
    )


def _fit(problem: Problem, start: Mapping[tuple[str, str], float] | None = None) -> Fit:
    """The fit, in which a constant force weighs no less than the changes within a few seconds.

    The errors of a smoothed speed are alike from second to second, and cancel over longer times. A whitening with such roots
    weighs what the smoother makes of a release, which is alike in all coast-downs.
    """
    has_smooth_speed = any(session.accel_noise > 0.0 for session in problem.sessions)
    return fit(problem, start=start, largest_root=WHITE if has_smooth_speed else SHORT_ROOT)


def _mass_stds(base: Base, runs: Rollouts) -> tuple[float, float]:
    """Relative standard deviations of the weight, zero where every session has its load, and of the rotating masses' factor."""
    assert isinstance(base, TrackBase | RoadBase)
    section = "chassis" if isinstance(base, TrackBase) else "road_load"
    has_loads = all("load" in session.given for session in runs.sessions)
    weight = 0.0 if has_loads else relative_weight_std(base.vehicle)
    return weight, relative_std(base.vehicle, f"{section}.rotating_mass_factor")


def _by_masses(fit: Fit, masses: tuple[float, float]) -> dict[tuple[str, str], float]:
    """Standard deviations of fitted values due to those of weight and rotating masses, see `_mass_stds`; to first order."""
    problem, (weight, rotating_mass) = fit.problem, masses
    heavier_sessions = [
        s if "load" in s.given else replace(s, weight=(1.0 + weight) * s.weight, given=s.given | {"load"})
        for s in problem.sessions
    ]
    slower_sessions = [replace(s, accel=(1.0 + rotating_mass) * s.accel) for s in problem.sessions]
    residuals = [
        problem.residuals(problem.base.predict(sessions, fit.base_values, ())) for sessions in (heavier_sessions, slower_sessions)
    ]
    columns = np.column_stack(
        [
            base_columns(fit),
            *(np.concatenate(fit.residuals) - np.concatenate(shifted_residuals) for shifted_residuals in residuals),
        ]
    )
    white = valid_rows(problem.white(problem.split(columns), fit.noises))
    shifts = fit.covariance @ white[:, :-2].T @ white[:, -2:]
    return {f.key: float(np.hypot(*shift)) for f, shift in zip(fit.free, shifts, strict=True)}


def _scatter(all_free: Fit, runs: Rollouts) -> dict[tuple[str, str], float]:
    """Standard deviations from leaving out coast-downs, thus with unmeasured slopes and winds, wider for few of them.

    Empty for fewer than `FEWEST_GROUPS`: an unmeasured slope of one of two then looks like another resistance. Of few pairs the
    scatter is not known. So with few coast-downs it is that of single ones and of the slopes.
    """
    group_size = _group_size(runs, FEWEST_GROUPS)
    groups = runs.count // group_size
    widening = float(stdtrit(groups - 1, 0.975)) / NORMAL_95 if groups > 1 else 1.0
    by_slopes = lap_std(_slopes_alone(all_free)) if group_size == 1 else {}
    return {key: widening * math.hypot(std, by_slopes.get(key, 0.0)) for key, std in lap_std(all_free, group_size).items()}


def _slopes_alone(fit: Fit) -> Fit:
    """The fit on level ground, with nothing but its slopes as residuals, none of them an outlier."""
    base = fit.problem.base
    assert isinstance(base, CoastingBase)
    problem = replace(fit.problem, base=base.level)
    count = len(problem.base.parameters)
    level = problem.predict(fit.base_values, ())
    predictions = [
        replace(p, torque=s.torque + p.torque - f.torque) for s, p, f in zip(problem.sessions, level, fit.predicted, strict=True)
    ]
    noises = {kind: replace(noise, degrees=NORMAL_DEGREES) for kind, noise in fit.noises.items()}
    return replace(
        fit, problem=problem, free=fit.free[:count], point=fit.point[:count], noises=noises, predicted=tuple(predictions)
    )


def _group_size(runs: Rollouts, least_count: int) -> int:
    """Number of consecutive coast-downs left out at once: without a known slope two, of both directions, if there are enough."""
    return 1 if _slopes_known(runs) or runs.count < 2 * least_count else 2


def _slopes_known(runs: Rollouts) -> bool:
    return all("grade" in s.given for s in runs.sessions)


def _parameters(
    base: CoastingBase, all_free: Fit, fit: Fit | None, scatter: Mapping[tuple[str, str], float], masses: tuple[float, float]
) -> tuple[FittedValue, ...]:
    spans = intervals(all_free)
    std = np.sqrt(np.diag(all_free.covariance))
    correlation = all_free.covariance / np.outer(std, std)
    values = {} if fit is None else fit.estimates
    by_masses = _by_masses(all_free, masses) | ({} if fit is None else _by_masses(fit, masses))
    count = len(base.parameters) - len(base.slopes)
    fitted_values = []
    for i, (q, f) in enumerate(zip(base.parameters[:count], all_free.free[:count], strict=True)):
        is_determined, value_free, span = f.key in values, all_free.estimates[f.key], spans[f.key]
        value = values.get(f.key, q.nominal)
        of_mass, by_rollings = NORMAL_95 * by_masses[f.key], NORMAL_95 * scatter.get(f.key, 0.0)
        reach_down, reach_up = (
            np.hypot(max(reach, by_rollings), of_mass) for reach in (value_free - span.low, span.high - value_free)
        )
        span = Interval(max(q.low, value - float(reach_down)), min(q.high, value + float(reach_up)), span.bound_only)
        partners = [g.key[1] for j, g in enumerate(all_free.free[:count]) if j != i and abs(correlation[i, j]) > TOGETHER]
        fitted_values.append(
            FittedValue(q.name, q.unit, q.nominal, q.std, value, span, is_determined, tuple(partners), q.by_file)
        )
    return tuple(fitted_values)


def _improvement(problem: Problem, runs: Rollouts, rng: np.random.Generator) -> Improvement | None:
    """Cross-validated improvement of the error: each part of the coast-downs by a fit to the others; a slope is no error."""
    group_size = _group_size(runs, 2)
    parts = math.ceil(runs.count / group_size)
    if parts < 2:
        return None
    assert isinstance(problem.base, CoastingBase)
    level = problem.base.level
    nominal = [p.torque for p in level.predict(runs.sessions, {}, ())]
    torque_series = [np.array(x) for x in nominal]
    folds = min(parts, MOST_FOLDS)
    for fold in counted(range(folds), "what is not fitted", folds):
        holdouts = [(s.block // group_size % folds == fold) & s.used for s in runs.sessions]
        training = replace(problem, masks=tuple(s.used & ~h for s, h in zip(runs.sessions, holdouts, strict=True)))
        fit = _fit(training)
        for series, prediction, mask in zip(
            torque_series, level.predict(runs.sessions, fit.base_values, ()), holdouts, strict=True
        ):
            series[mask] = prediction.torque[mask]
    masks = [s.used for s in runs.sessions]
    error_before, error_after = (problem.base.on_slopes(runs.sessions, x) for x in (nominal, torque_series))
    return HeldOutLaps(runs.sessions, masks, rng).improvement(error_before, error_after)


@dataclass(frozen=True, eq=False)
class Rollout:
    """Speeds of one coast-down; series of shape (n,)."""

    name: str  # of the recording
    time: Array  # since the start of the recording [s]
    speed: Array  # speed [m/s]
    by_file: Array  # speed with the vehicle file, from the first measured one on [m/s]
    by_found: Array  # and with the fitted values [m/s]
    over_file: Array  # excess resistance torque [Nm]
    over_found: Array


def rollouts_of(result: Coastdown) -> list[Rollout]:
    """All coast-downs of a result, in order."""
    speeds = [np.abs(session.speed) for session in result.runs.sessions]
    over_file, over_found = (_excess(result, values, speeds) for values in ({}, result.values))
    by_file, by_found = (_integrated(result, values, speeds) for values in ({}, result.values))
    curves = []
    for stretch in result.runs.stretches:
        session, span = result.runs.sessions[stretch.session], slice(stretch.begin, stretch.end)
        series = (kind[stretch.session][span] for kind in (speeds, by_file, by_found, over_file, over_found))
        curves.append(Rollout(session.name, session.time[span], *series))
    return curves


def _excess(result: Coastdown, values: Mapping[str, float], speeds: Sequence[Array]) -> list[Array]:
    """Torque against travel by which a model exceeds the measured deceleration [Nm], at other speeds [m/s], of each session."""
    senses = [np.sign(session.speed) for session in result.runs.sessions]
    sessions = [replace(s, speed=sense * v) for s, sense, v in zip(result.runs.sessions, senses, speeds, strict=True)]
    predictions = result.base.predict(sessions, values, ())
    return [sense * (p.torque - s.torque) for sense, p, s in zip(senses, predictions, sessions, strict=True)]


def _integrated(result: Coastdown, values: Mapping[str, float], starts: Sequence[Array]) -> list[Array]:
    """Speeds of a model from the first measured one of each coast-down on, to standstill [m/s].

    Each pass integrates the deceleration at the speeds of the pass before (Picard). Their error is after n passes
    (L t)^n / n!, with the derivative L of the deceleration by the speed.
    """
    speeds = [np.array(start) for start in starts]
    radius, factor = result.base.facts.radius, result.base.rotating_mass_factor
    for _ in range(MOST_PASSES):
        change = 0.0
        excess = _excess(result, values, speeds)
        for stretch in result.runs.stretches:
            session, span = result.runs.sessions[stretch.session], slice(stretch.begin, stretch.end)
            slows = excess[stretch.session][span] * GRAVITY / (session.weight[span] * factor * radius)
            accel = np.sign(session.speed[span]) * session.accel[span] - slows
            series = speeds[stretch.session]
            speed = series[stretch.begin] + cumulative_trapezoid(accel, dx=session.step, initial=0.0)
            speed[np.maximum.accumulate(speed <= 0.0)] = 0.0
            change = max(change, float(np.abs(speed - series[span]).max()))
            series[span] = speed
        if change < SETTLED_MPS:
            break
    return speeds
