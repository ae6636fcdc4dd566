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
from trackres_ros.tools.design.drives import driven, left_out, read_cycle
from trackres_ros.tools.design.steady import ALONE, OUTCOMES, Array, remarks_on, steady
from trackres_ros.tools.design.values import Varied, short
from trackres_ros.tools.engine import LOCAL, results
from trackres_ros.units import KMH_PER_MPS
from trackres_ros.vehicle import load

AIR, OF_WEIGHT = "chassis.ambient", (".load", ".own_weight")
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
    varied: tuple[Varied, ...]
    speed: float
    ambient: float
    cycle: str | None = None
    own_air: bool = False

    @property
    def points(self) -> list[dict[str, float]]:
        """Values of each point by path."""
        every = itertools.product(*(one.points for one in self.varied))
        return [{path: value for part in point for path, value in part.items()} for point in every]

    @property
    def paths(self) -> list[str]:
        """Paths of all varied values."""
        return [path for one in self.varied for path in one.paths]

    @property
    def state(self) -> str:
        """Speed and air of the steady states, in words."""
        air = "as varied" if AIR in self.paths else f"{self.ambient:g} degC"
        return f"steady at {KMH_PER_MPS * self.speed:g} km/h, air {air}"


@dataclass(frozen=True, eq=False)
class Swept:
    """Results of a sweep."""

    asked: SweepRequest
    columns: dict[str, Array]  # by name, shape (points,): the values by path, outcomes, `BEYOND`; nan for an impossible vehicle
    refused: dict[int, str]  # the reason, by the number of the point
    effects_left_out: tuple[str, ...] = ()  # of the steady states, with the values of the file
    # on belts outside the rubber data and loads outside the table, by the number of the point
    remarks: Mapping[int, list[str]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # on the drive: unused content of a recording, an effect that it leaves out

    @property
    def outcomes(self) -> list[str]:
        """Names of the outcomes."""
        return [name for name in (*OUTCOMES, DRIVE) if name in self.columns]

    def text(self, most: int = 60) -> str:
        """The table; of a long one its first rows."""
        paths = self.asked.paths
        head = [f"{short(path, paths)}\n{one.unit}" for one in self.asked.varied for path in one.paths]
        head += [*(HEADS[name] for name in self.outcomes), *([""] if self.remarks else [])]
        count = len(self.columns[paths[0]])
        rows = [
            [
                *(figures(self.columns[p][i], 5) for p in paths),
                *(decimals(self.columns[o][i], PLACES[o]) for o in self.outcomes),
                *(["!" if i in self.remarks else ""] if self.remarks else []),
            ]
            for i in range(min(count, most))
        ]
        lines = [table(rows, head)]
        if count > most:
            lines.append(f"and {count - most} more")
        for number, why in self.refused.items():
            lines.append(f"skipped: {self._at(number)}: {why}")
        if self.remarks:
            number, texts = next(iter(self.remarks.items()))
            lines.append(f"  ! points with remarks: {len(self.remarks)} of {count}; the first, {self._at(number)}:")
            lines += [f"  ! {text}" for text in texts]
        caption = "cold: belts at air temperature, warm: belts at their steady temperature; effects that warm up are warm in both"
        lines.append(f"S{self.asked.state[1:]}; {caption}")
        if self.asked.cycle is not None:
            lines.append("drive: air and load as recorded, where they are and are neither varied nor given")
        lines += [f"drive: {note}" for note in self.notes]
        if self.effects_left_out:
            lines.append(f"{', '.join(self.effects_left_out)}: {INACTIVE}")
        return "\n".join(lines)

    def _at(self, number: int) -> str:
        paths = self.asked.paths
        return ", ".join(f"{short(p, paths)} {figures(self.columns[p][number], 5)}" for p in paths)

    def as_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        plain = {name: [None if np.isnan(x) else float(x) for x in values] for name, values in self.columns.items()}
        return {
            "vehicle": self.asked.file, "speed_mps": self.asked.speed,
            "ambient_degc": None if AIR in self.asked.paths else self.asked.ambient,
            "columns": plain, "refused": {str(number): why for number, why in self.refused.items()},
            "effects_left_out": list(self.effects_left_out),
            "remarks": {str(number): texts for number, texts in self.remarks.items()}, "notes": list(self.notes),
        }  # fmt: skip


def sweep(
    asked: SweepRequest, address: str = LOCAL, workers: int | None = None, advance: Callable[[float], None] = lambda _: None
) -> Swept:
    """Compute all points, on the fleet's engine if there are many.

    `asked`: inputs of the sweep; `address`, `workers`: see `engine.engine`; `advance`: called after each point. Raises InputError
    if there are too many points, or none is a possible vehicle.
    """
    points, twice = asked.points, [path for path in asked.paths if asked.paths.count(path) > 1]
    if twice:
        raise InputError("--vary", f"{twice[0]} twice", "each value once")
    if AIR in asked.paths and not asked.own_air:
        raise InputError("--vary", AIR, "another value", "leave out --ambient-degc, which takes its place")
    if len(points) > MOST_POINTS:
        raise InputError("--vary", f"{len(points)} points", f"at most {MOST_POINTS} in all")
    of_each = partial(point, replace(asked, file=str(find_vehicle(asked.file)), varied=()))
    inactive = left_out_at(load(asked.file), asked.speed, asked.ambient)
    found: list[Outcomes | str] = [""] * len(points)
    few = asked.cycle is None and len(points) <= ALONE
    for (number, _), result in results(of_each, list(enumerate(points)), address, workers, few):
        found[number] = result
        advance(1)
    names = [*OUTCOMES, *([DRIVE] if asked.cycle is not None else [])]
    refused = {number: result for number, result in enumerate(found) if isinstance(result, str)}
    if len(refused) == len(found):
        raise InputError("--vary", f"{len(found)} points", "at least one possible vehicle", next(iter(refused.values())))
    names.append(BEYOND)
    rows = np.array([[np.nan] * len(names) if isinstance(one, str) else (*one.values, float(bool(one.remarks))) for one in found])
    columns = {path: np.array([values[path] for values in points]) for path in asked.paths}
    usable = {number: one for number, one in enumerate(found) if not isinstance(one, str)}
    remarks = {number: one.remarks for number, one in usable.items() if one.remarks}
    notes = tuple(dict.fromkeys(note for one in usable.values() for note in one.notes))
    return Swept(asked, {**columns, **dict(zip(names, rows.T, strict=True))}, refused, tuple(inactive), remarks, notes)


def point(asked: SweepRequest, numbered: tuple[int, dict[str, float]]) -> Outcomes | str:
    """Outcomes of one point, a number and values, or why a vehicle cannot be so."""
    _, values = numbered
    try:
        vehicle = load(asked.file, values)
        air = vehicle.chassis.ambient if asked.own_air else asked.ambient
        found = steady(vehicle, asked.speed, air)
        remarks = remarks_on(vehicle, asked.speed, air, [found])
        if asked.cycle is None:
            return Outcomes(found.outcomes, remarks, [])
        cycle, estimator = read_cycle(asked.cycle, vehicle.chassis.max_speed), Estimator(vehicle)
        weight = vehicle.weight if any(path.endswith(OF_WEIGHT) for path in values) else None
        total, columns = driven(estimator, cycle, weight, None if asked.own_air and AIR not in values else air)
        notes = [*cycle.notes, *left_out(columns)]
        return Outcomes((*found.outcomes, total["kwh_per_km"]), [*remarks, *beyond(vehicle, columns)], notes)
    except InputError as error:
        return one_line(str(error))


def draw(found: Swept, path: Path) -> Path:
    """Outcomes over the first value, a line for each of the others'; of two with many values a map of the warm resistance."""
    from trackres_ros.output.style import TITLE_LETTERS, legend_beside, picture, shortened

    first, *others = found.asked.varied
    paths = found.asked.paths
    shape = tuple(len(one.points) for one in found.asked.varied)
    orders = [np.argsort(one.values[0]) for one in found.asked.varied]  # values may be listed in any order
    rising = [np.array(one.values[0])[order] for one, order in zip(found.asked.varied, orders, strict=True)]
    label = _label(first, paths)
    state = f": {found.asked.state}"
    title = shortened(found.asked.file, TITLE_LETTERS - len(state)) + state
    if len(others) == 1 and min(shape) > MOST_LINES:
        with picture(path, 7.5, 5.0) as figure:
            axes = figure.subplots()
            grid = found.columns["warm_nm"].reshape(shape)[np.ix_(*orders)]
            shades = axes.pcolormesh(rising[1], rising[0], grid, shading="nearest", cmap="viridis")
            axes.set(xlabel=_label(others[0], paths), ylabel=label, title=title)
            figure.colorbar(shades, ax=axes, label="warm resistance [Nm]")
        return path
    shown = [("cold_nm", "cold resistance [Nm]"), ("warm_nm", "warm resistance [Nm]"), ("belt_degc", "belt [degC]")]
    shown.append((DRIVE, "drive [kWh/km]") if DRIVE in found.columns else ("kwh_per_km", "warm [kWh/km]"))
    every = list(itertools.product(*(one.values[0] for one in others)))
    with picture(path, 9.0, 6.0) as figure:
        grid = figure.subplots(2, 2)
        for axes, (name, outcome) in zip(grid.flat, shown, strict=True):
            lines = found.columns[name].reshape(shape[0], -1)[orders[0]]
            for place, of in enumerate(every[:MOST_LINES]):
                named = ",\n".join(_value(o, v, paths) for o, v in zip(others, of, strict=True))
                axes.plot(rising[0], lines[:, place], marker="." if shape[0] <= MANY else "", label=named or None)
            axes.locator_params(axis="x", nbins=MOST_TICKS)
            axes.set(xlabel=label, ylabel=outcome)
        figure.suptitle(title, x=0.01, ha="left", fontsize=10)
        if others:
            more = len(every) - MOST_LINES
            legend_beside(grid[0, 1], f"(and {more} more)" if more > 0 else None)
    return path


def _value(one: Varied, value: float, paths: Sequence[str]) -> str:
    return f"{short(one.paths[0], paths)} {figures(value, 4)} {one.unit if one.unit != '1' else ''}".rstrip()


def _label(one: Varied, paths: Sequence[str]) -> str:
    """Quantity of an axis: the first of values that change together."""
    others = f" (with {len(one.paths) - 1} more)" if len(one.paths) > 1 else ""
    return f"{short(one.paths[0], paths)}{others} [{one.unit}]"
