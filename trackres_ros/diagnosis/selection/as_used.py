# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Decides which results to write: each file is judged on the hold-out laps the way it is used.

A controller runs vehicle.yaml alone, without surroundings and without sensor errors, from a first start without a saved state. So
vehicle.yaml alone is compared with its original, each drive from a cold belt by itself, with the torque that was measured. The
surroundings and the sensor lines are compared together with the written vehicle.yaml.

Written values have intervals (step 7): by profile likelihood, widened by the scatter over laps and by the error of the
functional form.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from trackres_ros.diagnosis.base.base import Base, BaseParameter, RangedValue, Values
from trackres_ros.diagnosis.base.patterns import WATCHED, ByPlace
from trackres_ros.diagnosis.inference.fitting import Fit, Free, fit, free_parameters, with_levels
from trackres_ros.diagnosis.inference.noise import SHORT_ROOT
from trackres_ros.diagnosis.prepare.session import Array, DriveSession
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, HeldOutLaps
from trackres_ros.diagnosis.selection.visibility import FORM_ERROR, base_columns
from trackres_ros.effects.effect import Active
from trackres_ros.errors import InputError
from trackres_ros.progress import counted
from trackres_ros.text import figures
from trackres_ros.vehicle.writing.changes import FileChanges, Interval

ON_BOUND = 1e-3  # of the span between the bounds
MOVED = 1.5  # standard deviations of the file's own range
FAR = 5.0  # such standard deviations
DROP = 0.5 * float(chdtri(1, 0.05))  # half of the 95 % quantile of chi-squared
NORMAL_95 = 1.96
MOST_TRIES = 8
GROWTH = 2.0


def at_implausible_bounds(result: Fit) -> tuple[str, ...]:
    """Base parameters on a bound, more than `MOVED` standard deviations from the vehicle file's value."""
    return tuple(
        q.name for q, value in moved_parameters(result) if min(value - q.low, q.high - value) <= ON_BOUND * (q.high - q.low)
    )


def moved_parameters(result: Fit) -> list[tuple[BaseParameter, float]]:
    """Base parameters that moved by more than `MOVED` standard deviations of their range, furthest first."""
    values = [(q, result.base_values[q.name]) for q in result.problem.base.parameters if np.isfinite(q.std)]
    shifts = [(q, value) for q, value in values if abs(value - q.nominal) > MOVED * q.std]
    return sorted(shifts, key=lambda pair: -abs(pair[1] - pair[0].nominal) / pair[0].std)


def far_from_file(result: Fit) -> list[tuple[BaseParameter, float]]:
    """Several base parameters `FAR` outside their range, or as far as is plausible: they compensate another error of the file."""
    names_on_bounds = at_implausible_bounds(result)
    shifts = [
        (q, value)
        for q, value in moved_parameters(result)
        if abs(value - q.nominal) > FAR * q.std or (q.name in names_on_bounds and q.outside(value))
    ]
    return shifts if len(shifts) > 1 else []


def intervals(result: Fit) -> dict[tuple[str, str], Interval]:
    """Intervals of all parameters of a fit by `fitting.with_levels`: the base's from the curvature, those of effects from their
    profile; both from laps and sessions where wider. A value at the end of its range is only bounded. One fixed at a
    typical value may lie anywhere within its bounds.

    The size of an effect also depends on its function, which is accurate to `FORM_ERROR`.
    """
    session_of_row = np.concatenate([np.full(len(g.measured), g.session) for g in result.problem.segments])
    laps, sessions = lap_std(result), _jackknife_std(result, session_of_row)  # unmodelled conditions differ between sessions
    by_laps = {key: max(std, sessions.get(key, 0.0)) for key, std in laps.items()}
    off_values = {(a.effect.name, q.name): q.off for a in result.effects for q in a.effect.parameters if q.off is not None}

    def interval(f: Free) -> Interval:
        if f.key not in result.estimates:
            return Interval(f.low, f.high, True)
        value = result.estimates[f.key]
        std = max(by_laps.get(f.key, 0.0), result.std_of(*f.key))
        if not f.key[0]:
            at_end = min(value - f.low, f.high - value) <= ON_BOUND * (f.high - f.low)
            return Interval(max(f.low, value - NORMAL_95 * std), min(f.high, value + NORMAL_95 * std), at_end)
        low, low_open = _edge(result, f.key, -1.0, f.low)
        high, high_open = _edge(result, f.key, 1.0, f.high)
        lap = NORMAL_95 * by_laps.get(f.key, 0.0)
        form = NORMAL_95 * FORM_ERROR * abs(value - off_values.get(f.key, value))
        distance_below, distance_above = (float(np.hypot(max(reach, lap), form)) for reach in (value - low, high - value))
        return Interval(max(f.low, value - distance_below), min(f.high, value + distance_above), low_open or high_open)

    parameters = free_parameters(result.problem.base, [a.effect for a in result.effects])
    return {f.key: interval(f) for f in counted(parameters, "intervals", len(parameters))}


def lap_std(result: Fit, count: int = 1) -> dict[tuple[str, str], float]:
    """Standard deviations from leaving out one lap at a time, or `count` consecutive ones, to first order."""
    return _jackknife_std(result, np.concatenate([g.block for g in result.problem.segments]) // count)


def _jackknife_std(result: Fit, blocks: NDArray[np.int64]) -> dict[tuple[str, str], float]:
    """Standard deviations from leaving out one block of rows at a time."""
    scale = np.array([f.scale for f in result.free])
    prior = np.array([f.scale / f.std for f in result.free])
    columns = result.problem.white(result.problem.split(base_columns(result) * scale), result.noises)
    x, e = np.concatenate(columns), np.concatenate(result.white)
    is_valid = np.isfinite(e) & np.isfinite(x).all(axis=1)
    x, e, blocks = x[is_valid], (e * result.weights)[is_valid], blocks[is_valid]
    inverse = np.linalg.pinv(x.T @ x + np.diag(prior**2), rcond=1e-13)
    shifts = np.array([inverse @ (x[blocks == b].T @ e[blocks == b]) for b in np.unique(blocks)])
    count = len(shifts)
    if count < 3:
        return {}
    std = np.sqrt(count / (count - 1) * ((shifts - shifts.mean(axis=0)) ** 2).sum(axis=0)) * scale
    return {f.key: float(s) for f, s in zip(result.free, std, strict=True)}


def _edge(result: Fit, key: tuple[str, str], side: float, bound: float) -> tuple[float, bool]:
    """Point where the profile has fallen by `DROP`, or the bound with True if it does not."""
    optimum, effects = result.estimates[key], [a.effect for a in result.effects]
    reach = abs(bound - optimum)
    if reach <= 1e-6 * max(abs(bound), abs(optimum), 1e-12):
        return bound, True
    step = min(max(NORMAL_95 * result.std_of(*key), 1e-4 * reach), reach)
    inner_point, outer_point = (0.0, 0.0), None
    for _ in range(MOST_TRIES):
        fixed_values = {key: optimum + side * step}
        profile_fit = fit(
            result.problem, effects, result.estimates, result.noises, rounds=1, fixed_values=fixed_values, largest_root=SHORT_ROOT
        )
        decrease = result.log_likelihood - profile_fit.log_likelihood
        if decrease >= DROP:
            outer_point = (step, decrease)
            break
        inner_point = (step, max(decrease, 0.0))
        if step >= reach * (1.0 - 1e-9):
            return bound, True
        step = min(reach, GROWTH * step)
    if outer_point is None:
        return bound, True
    # Between them the square root of the fall is nearly linear.
    a, b = np.sqrt(inner_point[1]), np.sqrt(outer_point[1])
    share = (np.sqrt(DROP) - a) / (b - a) if b > a else 1.0
    return optimum + side * float(inner_point[0] + share * (outer_point[0] - inner_point[0])), False


Bounds = Mapping[tuple[str, str], Interval]

ROUNDING = 1e-5  # of a value that is written with few figures
SHOWN = 4  # figures

VEHICLE, SURROUNDINGS, SENSOR = "vehicle", "surroundings", "sensor"


def of_kind(effects: Sequence[Active], *kinds: str) -> tuple[Active, ...]:
    """Effects of the given kinds; no file holds a term of the clock."""
    return tuple(a for a in effects if a.effect.belongs_to in kinds and a.effect.acts_on != WATCHED)


class AsUsed:
    """Hold-out errors of files, each as it is used: in the given surroundings, and alone, as it was `recorded`."""

    def __init__(
        self, base: Base, sessions: Sequence[DriveSession], recorded_sessions: Sequence[DriveSession], laps: HeldOutLaps
    ) -> None:
        self._sessions = tuple(sessions)
        self._base_around = base, tuple(replace(s, first_drive=True) for s in sessions)
        self._base_alone = self._base_around
        pairs = list(zip(self._base_around[1], recorded_sessions, strict=True))
        if base.alone is not base or any(s.given != r.given or s.torque_by_place is not r.torque_by_place for s, r in pairs):
            sessions_alone = (replace(s, grade=r.grade, given=r.given, torque_by_place=r.torque_by_place) for s, r in pairs)
            self._base_alone = base.alone, tuple(sessions_alone)
        self.base, self._laps = base, laps
        self.distance = sum(float(np.abs(np.nan_to_num(s.speed)).sum()) * s.step for s in sessions)
        self._read = dict[tuple[bool, tuple[float, ...]], Base]()

    def written(self, effects: Sequence[Active]) -> tuple[Active, ...]:
        """Effects for a file that is first used after the recordings. Faded ones are left out: a belt has run in by then.

        A fit counts the distance from the first recording, a replay and a live node from their own first start.
        """
        return tuple(a for a in (active.after(self.distance) for active in effects) if not a.does_nothing)

    def recorded(self, values: Values | None, effects: Sequence[Active]) -> list[Array]:
        """Sensed torque of each session [Nm], one after the other, from a file with other values, or with its own."""
        base = self._base_with(values, is_alone=False)
        return [p.torque for p in base.predict(self._sessions, base.nominal, effects)]

    def expected(self, values: Values | None, effects: Sequence[Active], is_alone: bool) -> list[Array]:
        """Sensed torque of each session [Nm] from the written file, with each drive by itself."""
        base = self._base_with(values, is_alone)
        _, sessions = self._base_alone if is_alone else self._base_around
        return [p.torque for p in base.predict(sessions, base.nominal, self.written(effects))]

    def outside(self, values: Values | None) -> dict[str, RangedValue]:
        """Values of the written file outside the range of the present file, with that range, by their place in the file."""
        original, written_values = (self._base_with(file_values, is_alone=True).quantities for file_values in (None, values))
        quantities = {name: quantity._replace(value=written_values[name].value) for name, quantity in original.items()}
        return {
            name: q
            for name, q in quantities.items()
            if not q.low - ROUNDING * abs(q.low) <= q.value <= q.high + ROUNDING * abs(q.high)
        }

    def _base_with(self, values: Values | None, is_alone: bool) -> Base:
        base, _ = self._base_alone if is_alone else self._base_around
        if values is None:
            return base
        key = is_alone and self._base_alone is not self._base_around, tuple(values.values())
        if key not in self._read:
            self._read[key] = base.as_written(values)
        return self._read[key]

    def error(self, values: Values | None, effects: Sequence[Active] = (), is_alone: bool = False) -> float:
        """Mean absolute error on hold-out laps [Nm]."""
        return float(np.abs(self._laps.measured - self._laps.samples(self.expected(values, effects, is_alone))).mean())

    def surely_better(self, fit_after: Fit, fit_before: Fit) -> bool:
        """Whether the error of one fit is significantly smaller, without surroundings."""
        base, sessions = self._base_alone
        written_effects = (self.written(of_kind(f.effects, VEHICLE, SENSOR)) for f in (fit_before, fit_after))
        results = (
            base.predict(sessions, f.base_values, effects)
            for f, effects in zip((fit_before, fit_after), written_effects, strict=True)
        )
        return self._laps.improvement(*([p.torque for p in predictions] for predictions in results)).grade == CONFIRMED


def inside_ranges(result: Fit, use: AsUsed, fixed_values: Mapping[tuple[str, str], float] | None = None) -> Fit:
    """A fit with base values inside the ranges of the vehicle file, except values confirmed outside on hold-out laps.

    The alternative to a value outside is the end of its range with a re-fit of the others, and parameters `fixed_values` at a
    value. It is confirmed if vehicle.yaml alone is significantly better with it, and it is not as far outside as is plausible:
    then it is no estimate. Further fits of the same problem keep to these ranges.
    """
    names = {q.name for q in result.problem.base.parameters}
    limited_names, confirmed_names = set[str](), set[str]()
    while True:
        parameters_outside = [q for q in _parameters_outside(result) if q.name not in confirmed_names]
        if not parameters_outside:
            break
        name = parameters_outside[0].name
        limited_fit = with_levels(_limited_fit(result, names - limited_names - {name}), (), fixed_values)
        if name not in at_implausible_bounds(result) and use.surely_better(result, limited_fit):
            confirmed_names.add(name)
        else:
            result = limited_fit
            limited_names.add(name)
    return _limited_fit(result, confirmed_names)


def _parameters_outside(result: Fit) -> list[BaseParameter]:
    """Parameters of the base outside the ranges of the vehicle file, furthest first."""
    base, values = result.problem.base, result.base_values
    parameters = [q for q in base.parameters if q.outside(values[q.name])]
    return sorted(parameters, key=lambda q: -abs(values[q.name] - q.nominal) / q.std)


def _limited_fit(result: Fit, free_names: Collection[str]) -> Fit:
    """The same values for a base limited to the ranges of the vehicle file, except the parameters in `free_names`."""
    base = result.problem.base.inside_ranges(free_names)
    bounds = {("", q.name): (q.low, q.high) for q in base.parameters}
    limits = ((f, *bounds.get(f.key, (f.low, f.high))) for f in result.free)
    return replace(
        result,
        problem=replace(result.problem, base=base),
        free=tuple(replace(f, low=low, high=high) for f, low, high in limits),
    )


@dataclass(frozen=True, eq=False)
class _Option:
    """Possible content of the files; `fitted` is the fit of the base values, None for the file's own."""

    fit_of_base: Fit | None
    effects: tuple[Active, ...]

    @property
    def values(self) -> Values | None:
        return None if self.fit_of_base is None else self.fit_of_base.base_values

    @property
    def text(self) -> str:
        base = "the file's own values" if self.fit_of_base is None else "the re-fitted values"
        return " and ".join([base, *([", ".join(a.effect.name for a in self.effects)] if self.effects else [])])


def choose_written(
    believed_names: Collection[str],
    confirmed_names: Collection[str],
    final_fit: Fit,
    base_fit: Fit,
    use: AsUsed,
    bounds: Bounds,
    passing: Collection[str] = (),
) -> FileChanges:
    """Changes to write: the first of `_options` that is no worse in use than the vehicle file.

    `believed_names` are the names of the effects that may be written, `confirmed_names` those confirmed on hold-out laps.
    Confirmed sensor effects correct the torque for judging vehicle.yaml. `final_fit` has all found effects, with the intervals
    `bounds`, and `base_fit` none. A re-fit without `passing` terms, confirmed spells, would average what is with and without
    them. So values are fitted together with them. No file has these terms, so they are not in any error.
    """
    written_effects = tuple(a for a in final_fit.effects if a.effect.name in believed_names and a.effect.acts_on != WATCHED)
    if any(a.effect.name in passing for a in final_fit.effects):
        base_fit = _with_refitted_base((), final_fit, use)
    note = ""
    for option in _options(written_effects, final_fit, base_fit, use):
        objection = _objection(option, confirmed_names, use)
        if not objection:
            return _file_changes(option, final_fit, confirmed_names, use, bounds, note)
        note = note or f"; not {option.text}, as {objection}"
    return _file_changes(_Option(None, ()), final_fit, confirmed_names, use, bounds, note)


def _options(written_effects: tuple[Active, ...], final_fit: Fit, base_fit: Fit, use: AsUsed) -> Iterator[_Option]:
    """Possible changes, best first: the found effects with fitted values; the same with the file's own values; the
    vehicle's effects alone; a re-fit without effects. Effects keep their parameters of `final_fit`, as in the report.
    """
    if written_effects:
        yield _Option(_with_refitted_base(written_effects, final_fit, use), written_effects)
        yield _Option(None, written_effects)
    of_vehicle = of_kind(written_effects, VEHICLE)
    if of_vehicle and len(of_vehicle) < len(written_effects):
        yield _Option(_with_refitted_base(of_vehicle, final_fit, use), of_vehicle)
    yield _Option(base_fit, ())


def _with_refitted_base(written_effects: Sequence[Active], final_fit: Fit, use: AsUsed) -> Fit:
    """Re-fit of the base with some effects at their final parameters."""
    names = {a.effect.name for a in written_effects}
    names_left = [a.effect.name for a in final_fit.effects if a.effect.name not in names and a.effect.acts_on != WATCHED]
    if not names_left:
        return final_fit
    fixed_values = {(a.effect.name, q.name): a.values[q.name] for a in written_effects for q in a.effect.parameters if q.fitted}
    return inside_ranges(with_levels(final_fit, names_left, fixed_values), use, fixed_values)


def _objection(option: _Option, confirmed_names: Collection[str], use: AsUsed) -> str:
    """Reason for not writing an option; empty if it may be written."""
    values, effects = option.values, option.effects
    try:
        error_alone, error_before = _errors_alone(option, confirmed_names, use)
    except InputError as error:  # a fit may be infeasible elsewhere: a belt that burns at its greatest speed
        return f"no command would accept that file: {error.given}; allowed: {error.allowed}"
    if error_alone > error_before:
        text = f"the mean error of vehicle.yaml alone would be {figures(error_alone)} Nm"
        return f"{text}, {figures(error_before)} Nm with the old file"
    error_together = use.error(values, effects)
    for kind, file in ((SURROUNDINGS, "surroundings.yaml"), (SENSOR, "the topics file")):
        group = of_kind(effects, kind)
        error_without = use.error(values, [a for a in effects if a not in group]) if group else error_together
        if error_together > error_without:
            return f"with {file} the mean error would be {figures(error_together)} Nm, {figures(error_without)} Nm without"
    nominal = use.error(None)
    if error_together > nominal:
        return f"the mean error would be {figures(error_together)} Nm, {figures(nominal)} Nm with the old file"
    return ""


def _errors_alone(option: _Option, confirmed_names: Collection[str], use: AsUsed) -> tuple[float, float]:
    """Errors of vehicle.yaml alone and of its original against the torque with confirmed sensor corrections [Nm]."""
    sensors = _sensor_corrections(option, confirmed_names)
    error = use.error(option.values, [*of_kind(option.effects, VEHICLE), *sensors], is_alone=True)
    return error, use.error(None, sensors, is_alone=True)


def _sensor_corrections(option: _Option, confirmed_names: Collection[str]) -> list[Active]:
    return [a for a in of_kind(option.effects, SENSOR) if a.effect.name in confirmed_names]


def _file_changes(
    option: _Option, final_fit: Fit, confirmed_names: Collection[str], use: AsUsed, bounds: Bounds, note: str
) -> FileChanges:
    """An option with its intervals and a text."""
    effects = use.written(option.effects)
    ranges = {
        key: interval for active in option.effects for key, interval in _later_intervals(active, bounds, use.distance).items()
    }
    if option.fit_of_base is not None:
        base_intervals = bounds if option.fit_of_base is final_fit else intervals(option.fit_of_base)
        ranges |= {key: interval for key, interval in base_intervals.items() if not key[0]}
    error_alone, error_before = _errors_alone(option, confirmed_names, use)
    error = f"the mean error on hold-out laps is {figures(error_alone)} Nm with vehicle.yaml alone"
    error += f", {figures(error_before)} Nm with the old file" if option.fit_of_base is not None or option.effects else ""
    error += ", compared with the torque that the topics file corrects" if _sensor_corrections(option, confirmed_names) else ""
    if of_kind(option.effects, SURROUNDINGS):
        error += f", {figures(use.error(option.values, option.effects))} Nm with surroundings.yaml"
    names = {a.effect.name for a in option.effects}
    doubtful_names = [a.effect.name for a in final_fit.effects if a.effect.acts_on != WATCHED and a.effect.name not in names]
    omissions = f"; not written: {', '.join(doubtful_names)}" if doubtful_names else ""
    return FileChanges(
        None if option.values is None else dict(option.values),
        tuple(a for a in effects if not isinstance(a.effect, ByPlace)),
        ranges,
        f"written: {option.text}; {error}{_change_notes(option, effects, use)}{omissions}{note}",
        route=tuple(a.effect.learned(a.numbers[0]) for a in effects if isinstance(a.effect, ByPlace)),
    )


def _later_intervals(active: Active, bounds: Bounds, distance: float) -> dict[tuple[str, str], Interval]:
    """Intervals of the parameters of an effect after this distance [m], see `Effect.values_after`."""

    def later_value(q: str, value: float) -> float:
        return active.effect.values_after({**active.values, q: value}, distance)[q]

    own_bounds = {(name, q): interval for (name, q), interval in bounds.items() if name == active.effect.name}
    return {
        key: replace(interval, low=later_value(key[1], interval.low), high=later_value(key[1], interval.high))
        for key, interval in own_bounds.items()
    }


def _change_notes(option: _Option, written_effects: Sequence[Active], use: AsUsed) -> str:
    """Text on values outside their range, and on effects whose values differ between file and report."""
    text, written_values, km = "", {a.effect.name: a.values for a in written_effects}, figures(use.distance / 1000.0)
    for place, q in use.outside(option.values).items():
        value, low, high = (figures(x, SHOWN) for x in q[1:])
        unit = "" if q.unit == "1" else f" {q.unit}"
        text += f"; {place} is {value}{unit}, outside its range from {low} to {high}{unit}: hold-out laps confirm it"
    for active in option.effects:
        name = active.effect.name
        if name not in written_values:
            text += f"; vehicle.yaml is without {name}, which has faded over the {km} km of the recordings"
        elif written_values[name] != active.values:
            text += f"; {name} is written as it is after the {km} km of the recordings"
    return text
