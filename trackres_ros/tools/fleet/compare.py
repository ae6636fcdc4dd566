# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compares two days, vehicles, reports or designs: differences beyond their uncertainty."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import chdtrc, ndtri

from trackres_ros.errors import InputError, nearest
from trackres_ros.files.documents import parse_json
from trackres_ros.files.own_files import read
from trackres_ros.files.resources import find_vehicle
from trackres_ros.output.style import picture
from trackres_ros.text import alike, figures, some_of, table
from trackres_ros.tools.fleet.dataset import OF_FILE, FleetDataset
from trackres_ros.tools.fleet.pooling import Array, Vehicles, pool
from trackres_ros.tools.fleet.recordings import ROWS
from trackres_ros.tools.fleet.run import present_values
from trackres_ros.tools.fleet.trends import NUMBERS, TEXTS, of_one_file, of_present_files, without_copies, without_overlaps

SURE = 0.05  # probability of any false difference by chance
REPORT, MOST_BYTES = "report.json", 1 << 26
TWO_SIDED_95 = 1.96
COLOURS = "#0072B2", "#D55E00"
ALLOWED = "a folder of trackres fleet, with :VEHICLE or @DAY if need be, one of trackres diagnose, or a vehicle file"


@dataclass(frozen=True, eq=False)
class Side:
    """One of two: values and covariance of parameters in their units."""

    title: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    value: Array
    covariance: Array
    design: bool = False  # a vehicle file
    bounds: Mapping[str, tuple[float, str]] = field(default_factory=dict)  # values and units without an interval: at a bound
    of_file: Mapping[str, float] = field(default_factory=dict)  # of factors: the values of the vehicle file that they multiply
    outdated: tuple[dict[str, str], ...] = ()  # recordings of a fleet that are not used, see `trends.of_present_files`


def compare(first: str, second: str) -> dict[str, Any]:
    """Compute the differences between two results, ready for JSON; see `trackres compare`.

    Raises InputError if one cannot be compared, or both have nothing in common.
    """
    sides = _of_one_file(side(first), side(second))
    names = [name for name in sides[0].names if name in sides[1].names]
    if not names:
        raise InputError(f"{first}, {second}", "no common parameter", "two with parameters in common")
    columns = [[s.names.index(name) for name in names] for s in sides]
    change = sides[1].value[columns[1]] - sides[0].value[columns[0]]
    parts = [s.covariance[np.ix_(i, i)] for s, i in zip(sides, columns, strict=True)]
    covariance = parts[0] + parts[1]
    if all(s.design for s in sides):  # equal values of both files have equal errors
        covariance[change == 0.0, :] = covariance[:, change == 0.0] = 0.0
    std = np.sqrt(np.diag(covariance))
    limit = -float(ndtri(0.5 * SURE / len(names)))
    rows = []
    for i, name in enumerate(names):
        (one_value, one_std), (other_value, other_std) = (
            (float(s.value[j[i]]), float(np.sqrt(s.covariance[j[i], j[i]]))) for s, j in zip(sides, columns, strict=True)
        )
        differs = bool(abs(change[i]) > limit * std[i]) if std[i] > 0.0 else bool(change[i] != 0.0)
        rows.append(
            {
                "parameter": name, "unit": sides[0].units[columns[0][i]], "one": one_value, "one_std": one_std,
                "other": other_value, "other_std": other_std,
                "difference": float(change[i]), "difference_std": float(std[i]), "differs": differs,
            }
        )  # fmt: skip
    certain = std > 0.0
    chance = 1.0
    if certain.any():
        scaled = covariance[np.ix_(certain, certain)] / np.outer(std[certain], std[certain])
        scaled_change = change[certain] / std[certain]
        chance = float(
            chdtrc(int(certain.sum()), scaled_change @ np.linalg.pinv(scaled, rcond=1e-9, hermitian=True) @ scaled_change)
        )
    return {
        "one": sides[0].title, "other": sides[1].title, "parameters": rows, "threshold_std": limit, "chance_of_all": chance,
        "not_compared": _not_compared(*sides), "outdated": [row for s in sides for row in s.outdated],
    }  # fmt: skip


def _of_one_file(first: Side, second: Side) -> tuple[Side, Side]:
    """Both sides, with the factors of the other one on the values of the file of the first, where both files are known."""
    times = {name: x / first.of_file[name] for name, x in second.of_file.items() if name in first.of_file}
    scale = np.array([times.get(name, 1.0) for name in second.names])
    bounds = {name: (times.get(name, 1.0) * x, unit) for name, (x, unit) in second.bounds.items()}
    return first, replace(
        second, value=scale * second.value, covariance=np.outer(scale, scale) * second.covariance, bounds=bounds
    )


def _not_compared(first_side: Side, second_side: Side) -> list[dict[str, Any]]:
    """Parameters that only one has, or that have no interval in one, with both values and the reason."""
    values = [
        {**{name: (float(x), unit) for name, x, unit in zip(s.names, s.value, s.units, strict=True)}, **s.bounds}
        for s in (first_side, second_side)
    ]
    rows = []
    for name in dict.fromkeys([*values[0], *values[1]]):
        if name in first_side.names and name in second_side.names:
            continue
        lacking = [side for side, entries in zip(("one", "other"), values, strict=True) if name not in entries]
        at_bound = [side for side, entries in (("one", first_side.bounds), ("other", second_side.bounds)) if name in entries]
        (first, unit), (second, of_other) = (entries.get(name, (None, "")) for entries in values)
        rows.append(
            {
                "parameter": name, "unit": unit or of_other, "one": first, "other": second,
                "why": f"not in {lacking[0]}" if lacking else f"only a bound is known in {' and in '.join(at_bound)}",
            }
        )  # fmt: skip
    return rows


def compare_text(comparison: Mapping[str, Any]) -> str:
    """The table, and its conclusion."""
    rows = []
    for q in comparison["parameters"]:
        spread = max(q["difference_std"], 1e-3 * abs(q["difference"]), 1e-12)
        reach = comparison["threshold_std"] * q["difference_std"]
        first, second, change, std = alike((q["one"], q["other"], q["difference"], reach), spread)
        unit = "" if q["unit"] == "1" else q["unit"]
        rows.append((q["parameter"], unit, first, second, change, std, "yes" if q["differs"] else "no"))
    head = ("parameter", "unit", "one", "other", "difference", "+- (95 % for all)", "differs")
    differs = [q["parameter"] for q in comparison["parameters"] if q["differs"]]
    if differs:
        end = f"Beyond its uncertainty: {', '.join(differs)}."
    elif comparison["chance_of_all"] < SURE:
        end = (
            "No parameter differs beyond its uncertainty; all together do "
            f"(chance {figures(comparison['chance_of_all'], 1)}): which of them cannot be told."
        )
    else:
        end = "None of these parameters differs beyond its uncertainty."
    lines = [f"one: {comparison['one']}", f"other: {comparison['other']}", table(rows, head), end]
    for q in comparison["not_compared"]:
        values = (f"{side} {'-' if q[side] is None else figures(q[side], 4)}" for side in ("one", "other"))
        unit = "" if q["unit"] == "1" else f" [{q['unit']}]"
        lines.append(f"Not compared: {q['parameter']}{unit}: {', '.join(values)}: {q['why']}")
    return "\n".join(lines)


def side(text: str) -> Side:
    """Result of a name: see `ALLOWED`. Raises InputError if it is none of those."""
    path, marks = Path(text), [mark.start() for mark in re.finditer("[:@]", text)]
    for end in (len(text), *reversed(marks)):
        if end and (Path(text[:end]) / ROWS).is_dir():
            return _of_fleet(Path(text[:end]), text[end:], text)
    if marks and not path.exists():
        folder, slash, name = text.rpartition("/")
        raise InputError(text, f"no results of a fleet in {folder + slash + re.split('[:@]', name)[0] or '.'}", ALLOWED)
    if (path / REPORT).is_file() or path.name == REPORT:
        return _of_report(path / REPORT if path.is_dir() else path)
    if path.is_dir():
        raise InputError(text, "a folder of something else", ALLOWED)
    try:
        return _of_design(text)
    except InputError as error:
        if error.where == "vehicle":
            raise InputError(text, "nothing of that name", ALLOWED) from None
        raise


def _of_fleet(folder: Path, suffix: str, text: str) -> Side:
    """`which`: the end of DIR:VEHICLE@DAY, with a day, month or year."""
    rows, _ = without_overlaps(without_copies(FleetDataset.existing(folder).rows([*TEXTS, *NUMBERS]))[0])
    good = [row for row in rows if row["status"] == "good"]
    names = sorted({row["vehicle"] for row in good})
    vehicle, day = suffix.removeprefix(":"), ""
    if "@" in suffix and vehicle not in names:
        vehicle, _, day = vehicle.rpartition("@")
    if vehicle and vehicle not in names:
        raise InputError(text, vehicle, f"one of {some_of(names)}", nearest(vehicle, names))
    of_vehicle = [row for row in good if vehicle in ("", row["vehicle"])]
    selection = [row for row in of_vehicle if day in ("", row["day"], row["day"][: len("2025-06")], row["day"][: len("2025")])]
    if not selection:
        days = sorted({row["day"] for row in of_vehicle})
        raise InputError(
            text,
            day or "no recording",
            f"a day, month or year from {days[0]} to {days[-1]}" if days else "a recording that is compared",
        )
    current, outdated = of_present_files(selection, present_values(folder))
    if current:
        selection = current
    else:  # all are of an older file
        selection, outdated = of_present_files(selection, {})
    urls, last = {row["url"] for row in selection}, {row["vehicle"]: row for row in selection}
    of_same_file = (row for row in good if of_one_file(row, last.get(row["vehicle"], row)))
    types = [data for data in Vehicles.by_type(of_same_file) if urls <= set(data.urls)]
    if not types:
        raise InputError(text, "vehicles of several types", "those of one", "name a vehicle: DIR:VEHICLE")
    pooled = pool(types[0])
    mask = np.array([url in urls for url in pooled.data.urls])
    chosen_data, precision, linear = pooled.likelihoods(mask)
    # The scatter of recordings is estimated from all, the parameters from those chosen alone, with the vehicle file's ranges.
    covariance = np.linalg.inv(np.eye(len(chosen_data.names)) + precision.sum(axis=0))
    mean = covariance @ linear.sum(axis=0)
    scale = np.outer(chosen_data.std, chosen_data.std)
    title = f"{text} ({len(chosen_data)} recordings{f', without {len(outdated)} of an older vehicle file' if outdated else ''})"
    value, covariance = chosen_data.nominal + chosen_data.std * mean, scale * covariance
    of_file = {name: x for row in selection for name, x in zip(chosen_data.names, row[OF_FILE] or (), strict=False) if x}
    return Side(title, chosen_data.names, chosen_data.units, value, covariance, of_file=of_file, outdated=tuple(outdated))


def _of_report(path: Path) -> Side:
    try:
        content = parse_json(read(path, MOST_BYTES))
        parameters = dict(content["base"]["refitted"])
        for effect in content["effects"]:
            parameters |= {f"{effect['name']}.{name}": q for name, q in effect["parameters"].items()}
        certain = {name for name, q in parameters.items() if q["ci95"] and None not in q["ci95"]}
        entries = [
            (name, str(q["unit"]), float(q["value"]), (q["ci95"][1] - q["ci95"][0]) / (2.0 * TWO_SIDED_95))
            for name, q in parameters.items()
            if name in certain
        ]
        bounds = {name: (float(q["value"]), str(q["unit"])) for name, q in parameters.items() if name not in certain}
        of_file = {name: float(q["of_file"]) for name, q in parameters.items() if q.get("of_file")}
        if not all(std >= 0.0 for *_, std in entries):
            raise ValueError("an interval whose end is before its beginning")
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(str(path), f"{type(error).__name__}: {error}", "report.json of trackres diagnose") from None
    return replace(_uncorrelated(str(path.parent), entries), bounds=bounds, of_file=of_file)


def _of_design(text: str) -> Side:
    from trackres_ros.diagnosis.base.loading import load_base

    path = find_vehicle(text)
    base = load_base(path).base
    entries = [(q.name, q.unit, q.nominal, q.std if np.isfinite(q.std) else 0.0) for q in base.parameters]
    of_file = {q.name: q.of_file for q in base.parameters if q.of_file is not None}
    return replace(_uncorrelated(f"{text}, as its file has it", entries), design=True, of_file=of_file)


def _uncorrelated(title: str, entries: list[tuple[str, str, float, float]]) -> Side:
    names, units, values, stds = zip(*entries, strict=True) if entries else ((), (), (), ())
    return Side(title, tuple(names), tuple(units), np.array(values), np.diag(np.array(stds) ** 2))


def draw_overlay(comparison: Mapping[str, Any], path: Path) -> Path:
    """Each parameter of both with its 95 % interval, over how sure the difference is."""
    with picture(path, 8.0, 1.4 + 0.45 * len(comparison["parameters"])) as figure:
        rows, axes = comparison["parameters"], figure.subplots()
        for row, q in enumerate(rows):
            unit = q["difference_std"] or float(np.hypot(q["one_std"], q["other_std"])) or abs(q["difference"]) or 1.0
            middle = 0.5 * (q["one"] + q["other"])
            for side, (key, colour) in enumerate(zip(("one", "other"), COLOURS, strict=True)):
                label = comparison[key] if row == 0 else None
                spread = TWO_SIDED_95 * q[f"{key}_std"] / unit
                axes.errorbar(
                    [(q[key] - middle) / unit], [row + 0.15 * (2 * side - 1)], xerr=[spread], fmt="o", color=colour, label=label
                )
        axes.set_yticks(range(len(rows)), [f"{q['parameter']}{' *' if q['differs'] else ''}" for q in rows])
        axes.invert_yaxis()
        axes.axvline(0.0, color="0.8", zorder=0)
        label = "distance from the mean of both, in standard deviations of the difference (* differs)"
        shown_names = {q["parameter"] for q in rows}
        if missing := [v["path"] for v in comparison.get("values", ()) if v["path"].rpartition(".")[2] not in shown_names]:
            label += f"\nnot drawn, but different in the files: {some_of(missing)}"
        axes.set_xlabel(label)
        figure.legend(loc="outside upper center", ncols=1)
    return path
