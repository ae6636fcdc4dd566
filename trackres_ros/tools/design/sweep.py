# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Varies values of a vehicle: effects on resistance, temperature and energy."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trackres_ros.errors import InputError, one_line
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.files.resources import find_vehicle
from trackres_ros.model.coverage import beyond
from trackres_ros.model.operating_point import INACTIVE, left_out_at
from trackres_ros.text import decimals, figures, table
from trackres_ros.tools.design.drives import left_out, read_cycle, run_cycle
from trackres_ros.tools.design.steady import ALONE, OUTCOMES, Array, remarks_on, steady
from trackres_ros.tools.design.values import AIR, LOADS, Variation, short
from trackres_ros.tools.engine import LOCAL, results
from trackres_ros.units import KMH_PER_MPS
from trackres_ros.vehicle import load

MOST_POINTS = 100_000
MOST_TICKS = 5  # of the first value: more would touch
MOST_LINES, MANY = 8, 40  # lines of a picture, and points of one that are no longer marked
DRIVE = "drive_kwh_per_km"
BEYOND = "beyond_data"  # 1 for a point with remarks
HEADS = {
    "cold_nm": "cold\nNm",
    "warm_nm": "warm\nNm",
    "belt_degc": "belt\ndegC",
    "kwh_per_km": "warm\nkWh/km",
    DRIVE: "drive\nkWh/km",
}
PLACES = {"cold_nm": 0, "warm_nm": 0, "belt_degc": 1, "kwh_per_km": 3, DRIVE: 3}


class Outcomes(NamedTuple):
    """Outcomes of a point by the names of the sweep, and what is said of the vehicle and of its drive."""

    values: tuple[float, ...]
    remarks: list[str]
    notes: list[str]


@dataclass(frozen=True, slots=True)
class SweepRequest:
    """Inputs of a sweep: vehicle file, values by path, speed [m/s], air [degC], and a drive for `drives.read_cycle`.

    `own_air`: the air is that of each vehicle's file. On a drive it is the recorded one, unless it is varied, like the load.
    """

    file: str
    variations: tuple[Variation, ...]
    speed: float
    ambient: float
    cycle: str | None = None
    own_air: bool = False

    @property
    def points(self) -> list[dict[str, float]]:
        """Values of each point by path."""
        combinations = itertools.product(*(variation.points for variation in self.variations))
        return [{path: value for part in point for path, value in part.items()} for point in combinations]

    @property
    def paths(self) -> list[str]:
        """Paths of all varied values."""
        return [path for variation in self.variations for path in variation.paths]

    @property
    def state(self) -> str:
        """Speed and air of the steady states, in words."""
        air = "as varied" if AIR in self.paths else f"{self.ambient:g} degC"
        return f"steady at {KMH_PER_MPS * self.speed:g} km/h, air {air}"


@dataclass(frozen=True, eq=False)
class SweepResult:
    """Results of a sweep."""

    request: SweepRequest
    columns: dict[str, Array]  # by name, shape (points,): the values by path, outcomes, `BEYOND`; nan for an impossible vehicle
    failures: dict[int, str]  # the reason, by the number of the point
    effects_left_out: tuple[str, ...] = ()  # of the steady states, with the values of the file
    # on belts outside the rubber data and loads outside the table, by the number of the point
    remarks: Mapping[int, list[str]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # on the drive: unused content of a recording, an effect that it leaves out

    @property
    def outcomes(self) -> list[str]:
        """Names of the outcomes."""
        return [name for name in (*OUTCOMES, DRIVE) if name in self.columns]

    def text(self, limit: int = 60) -> str:
        """The table; of a long one its first rows."""
        paths = self.request.paths
        head = [f"{short(path, paths)}\n{variation.unit}" for variation in self.request.variations for path in variation.paths]
        head += [*(HEADS[name] for name in self.outcomes), *([""] if self.remarks else [])]
        count = len(self.columns[paths[0]])
        rows = [
            [
                *(figures(self.columns[p][i], 5) for p in paths),
                *(decimals(self.columns[o][i], PLACES[o]) for o in self.outcomes),
                *(["!" if i in self.remarks else ""] if self.remarks else []),
            ]
            for i in range(min(count, limit))
        ]
        lines = [table(rows, head)]
        if count > limit:
            lines.append(f"and {count - limit} more")
        for number, reason in self.failures.items():
            lines.append(f"skipped: {self._point_text(number)}: {reason}")
        if self.remarks:
            number, texts = next(iter(self.remarks.items()))
            lines.append(f"  ! points with remarks: {len(self.remarks)} of {count}; the first, {self._point_text(number)}:")
            lines += [f"  ! {text}" for text in texts]
        caption = "cold: belts at air temperature, warm: belts at their steady temperature; effects that warm up are warm in both"
        lines.append(f"S{self.request.state[1:]}; {caption}")
        if self.request.cycle is not None:
            lines.append("drive: air and load as recorded, where they are and are neither varied nor given")
        lines += [f"drive: {note}" for note in self.notes]
        if self.effects_left_out:
            lines.append(f"{', '.join(self.effects_left_out)}: {INACTIVE}")
        return "\n".join(lines)

    def _point_text(self, number: int) -> str:
        paths = self.request.paths
        return ", ".join(f"{short(p, paths)} {figures(self.columns[p][number], 5)}" for p in paths)

    def as_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        plain = {name: [None if np.isnan(x) else float(x) for x in values] for name, values in self.columns.items()}
        return {
            "vehicle": self.request.file, "speed_mps": self.request.speed,
            "ambient_degc": None if AIR in self.request.paths else self.request.ambient,
            "columns": plain, "refused": {str(number): reason for number, reason in self.failures.items()},
            "effects_left_out": list(self.effects_left_out),
            "remarks": {str(number): texts for number, texts in self.remarks.items()}, "notes": list(self.notes),
        }  # fmt: skip


def sweep(
    request: SweepRequest, address: str = LOCAL, workers: int | None = None, advance: Callable[[float], None] = lambda _: None
) -> SweepResult:
    """Compute all points, on the fleet's engine if there are many.

    `request`: inputs of the sweep; `address`, `workers`: see `engine.engine`; `advance`: called after each point.
    Raises InputError if there are too many points, or none is a possible vehicle.
    """
    points, repeated = request.points, [path for path in request.paths if request.paths.count(path) > 1]
    if repeated:
        raise InputError("--vary", f"{repeated[0]} twice", "each value once")
    if AIR in request.paths and not request.own_air:
        raise InputError("--vary", AIR, "another value", "leave out --ambient-degc, which takes its place")
    if len(points) > MOST_POINTS:
        raise InputError("--vary", f"{len(points)} points", f"at most {MOST_POINTS} in all")
    of_each = partial(point, replace(request, file=str(find_vehicle(request.file)), variations=()))
    inactive = left_out_at(load(request.file), request.speed, request.ambient)
    outcomes: list[Outcomes | str] = [""] * len(points)
    few = request.cycle is None and len(points) <= ALONE
    for (number, _), result in results(of_each, list(enumerate(points)), address, workers, few):
        outcomes[number] = result
        advance(1)
    names = [*OUTCOMES, *([DRIVE] if request.cycle is not None else [])]
    failures = {number: result for number, result in enumerate(outcomes) if isinstance(result, str)}
    if len(failures) == len(outcomes):
        raise InputError("--vary", f"{len(outcomes)} points", "at least one possible vehicle", next(iter(failures.values())))
    names.append(BEYOND)
    rows = np.array(
        [
            [np.nan] * len(names) if isinstance(outcome, str) else (*outcome.values, float(bool(outcome.remarks)))
            for outcome in outcomes
        ]
    )
    columns = {path: np.array([values[path] for values in points]) for path in request.paths}
    usable = {number: outcome for number, outcome in enumerate(outcomes) if not isinstance(outcome, str)}
    remarks = {number: outcome.remarks for number, outcome in usable.items() if outcome.remarks}
    notes = tuple(dict.fromkeys(note for outcome in usable.values() for note in outcome.notes))
    return SweepResult(request, {**columns, **dict(zip(names, rows.T, strict=True))}, failures, tuple(inactive), remarks, notes)


def point(request: SweepRequest, numbered: tuple[int, dict[str, float]]) -> Outcomes | str:
    """Outcomes of one point, a number and values, or why a vehicle cannot be so."""
    _, values = numbered
    try:
        vehicle = load(request.file, values)
        air = vehicle.chassis.ambient if request.own_air else request.ambient
        state = steady(vehicle, request.speed, air)
        remarks = remarks_on(vehicle, request.speed, air, [state])
        if request.cycle is None:
            return Outcomes(state.outcomes, remarks, [])
        cycle, estimator = read_cycle(request.cycle, vehicle.chassis.max_speed), Estimator(vehicle)
        weight = vehicle.weight if any(path.endswith(LOADS) for path in values) else None
        total, columns = run_cycle(estimator, cycle, weight, None if request.own_air and AIR not in values else air)
        notes = [*cycle.notes, *left_out(columns)]
        return Outcomes((*state.outcomes, total["kwh_per_km"]), [*remarks, *beyond(vehicle, columns)], notes)
    except InputError as error:
        return one_line(str(error))


def draw(result: SweepResult, path: Path) -> Path:
    """Outcomes over the first value, a line for each of the others'; of two with many values a map of the warm resistance."""
    from trackres_ros.output.style import TITLE_LETTERS, legend_beside, picture, shorten

    first, *rest = result.request.variations
    paths = result.request.paths
    shape = tuple(len(variation.points) for variation in result.request.variations)
    orders = [np.argsort(variation.values[0]) for variation in result.request.variations]  # values may be listed in any order
    rising = [np.array(variation.values[0])[order] for variation, order in zip(result.request.variations, orders, strict=True)]
    label = _label(first, paths)
    state = f": {result.request.state}"
    title = shorten(result.request.file, TITLE_LETTERS - len(state)) + state
    if len(rest) == 1 and min(shape) > MOST_LINES:
        with picture(path, 7.5, 5.0) as figure:
            axes = figure.subplots()
            grid = result.columns["warm_nm"].reshape(shape)[np.ix_(*orders)]
            shades = axes.pcolormesh(rising[1], rising[0], grid, shading="nearest", cmap="viridis")
            axes.set(xlabel=_label(rest[0], paths), ylabel=label, title=title)
            figure.colorbar(shades, ax=axes, label="warm resistance [Nm]")
        return path
    panels = [("cold_nm", "cold resistance [Nm]"), ("warm_nm", "warm resistance [Nm]"), ("belt_degc", "belt [degC]")]
    panels.append((DRIVE, "drive [kWh/km]") if DRIVE in result.columns else ("kwh_per_km", "warm [kWh/km]"))
    combinations = list(itertools.product(*(variation.values[0] for variation in rest)))
    with picture(path, 9.0, 6.0) as figure:
        grid = figure.subplots(2, 2)
        for axes, (name, outcome) in zip(grid.flat, panels, strict=True):
            lines = result.columns[name].reshape(shape[0], -1)[orders[0]]
            for place, combination in enumerate(combinations[:MOST_LINES]):
                label_text = ",\n".join(_value(o, v, paths) for o, v in zip(rest, combination, strict=True))
                axes.plot(rising[0], lines[:, place], marker="." if shape[0] <= MANY else "", label=label_text or None)
            axes.locator_params(axis="x", nbins=MOST_TICKS)
            axes.set(xlabel=label, ylabel=outcome)
        figure.suptitle(title, x=0.01, ha="left", fontsize=10)
        if rest:
            extra = len(combinations) - MOST_LINES
            legend_beside(grid[0, 1], f"(and {extra} more)" if extra > 0 else None)
    return path


def _value(variation: Variation, value: float, paths: Sequence[str]) -> str:
    return f"{short(variation.paths[0], paths)} {figures(value, 4)} {variation.unit if variation.unit != '1' else ''}".rstrip()


def _label(variation: Variation, paths: Sequence[str]) -> str:
    """Quantity of an axis: the first of values that change together."""
    partners = f" (with {len(variation.paths) - 1} more)" if len(variation.paths) > 1 else ""
    return f"{short(variation.paths[0], paths)}{partners} [{variation.unit}]"
