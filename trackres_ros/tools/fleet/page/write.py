# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes the pages: the fleet at a glance, and one for each vehicle with its recordings and diagnoses."""

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from trackres_ros.files.file_sets import file_set
from trackres_ros.files.own_files import remove, write
from trackres_ros.text import alike, decimals, figures, templates
from trackres_ros.tools.fleet.dataset import LOAD_RECORDED, FleetDataset
from trackres_ros.tools.fleet.periods import verdicts
from trackres_ros.tools.fleet.task import NO_DAY, NO_VEHICLE
from trackres_ros.tools.fleet.trends import amount, change_sentence, day_of, ranked, sentences, strength, without_copies

INDEX, VEHICLES = "index.html", "vehicles"
EDGES = 5.0, 10.0, 20.0  # between the colours of changes [%]; fixed, so that pages of two days are comparable
WIDTH, HEIGHT = 720.0, 220.0
LEFT, RIGHT, TOP, BOTTOM = 105.0, 12.0, 12.0, 28.0
TICKS = 4
SHOWN = (
    "url", "vehicle", "day", "status", "reason", "duration_s", "distance_m", "mismatch", "held_out_file", "held_out_refit",
    "mean_ambient", "findings", "copy_of", LOAD_RECORDED,
)  # fmt: skip


@file_set()
def write_pages(folder: Path, trends: Mapping[str, Any], dataset: FleetDataset) -> Path:
    """Write index.html and vehicles/NAME.html alone, and remove pages of others; return the first path.

    Raises MissingExtraError without jinja2.
    """
    environment = templates(
        "trackres_ros.tools.fleet.page", "the pages of a fleet", "fleet", figures=figures, decimals=decimals, percent=percent
    )
    style = environment.get_template("style.css").render()
    all_rows, _ = without_copies(dataset.rows(list(SHOWN)))
    diagnosed = verdicts(folder, all_rows)
    rows: dict[str, list[Mapping[str, Any]]] = {}
    for row in all_rows:
        rows.setdefault(row["vehicle"], []).append(row)
    order = ranked(trends["vehicles"])
    names = [*order, *sorted(rows.keys() - {NO_VEHICLE, *order})]
    pages = {name: f"{VEHICLES}/{quote(name, safe='')}.html" for name in names}
    months = sorted({month for months_of in trends["months"].values() for month in months_of})
    text = environment.get_template("index.html").render(
        style=style, found=trends, months=months, pages=pages, lines=sentences(trends),
        shade=shade, signed=signed, undated=NO_DAY, steps=range(1, len(EDGES) + 2),
        ranges=[*(f"to {edge:g} %" for edge in EDGES), f"above {EDGES[-1]:g} %"],
    )  # fmt: skip
    for page_file in {*(folder / VEHICLES).glob("*.html")} - {folder / page for page in pages.values()}:
        remove(page_file)
    for name in names:
        vehicle = trends["vehicles"].get(name)
        type_ = next((t for t in trends["types"] if name in t["vehicles"]), None)
        units = {key: q["unit"] for key, q in type_["parameters"].items()} if type_ else {}
        pictures = [
            (key, svg_plot(levels, key, units.get(key, ""), [c for c in vehicle["changes"] if c["parameter"] == key]))
            for key, levels in (vehicle["levels"] if vehicle else {}).items()
        ]
        page = environment.get_template("vehicle.html").render(
            style=style, name=name, vehicle=vehicle, of_type=type_, pictures=pictures,
            diagnosed=diagnosed.get(quote(name, safe=""), {}),
            rows=sorted(rows.get(name, ()), key=lambda row: (row["day"], row["url"])),
            changes=[change_sentence(name, c) for c in (vehicle["changes"] if vehicle else ())],
        )  # fmt: skip
        write(folder / pages[name], page.encode())
    write(folder / INDEX, text.encode())
    return folder / INDEX


def shade(change: Mapping[str, Any] | None) -> str:
    """Classes of a change: direction and colour, and `unsure` if another cause would explain it as well; `same` without one."""
    if change is None:
        return "same"
    step = 1 + bisect_left(EDGES, strength(change))
    return f"{'more' if change['size'] > 0.0 else 'less'}{step}{' unsure' if change['alike'] else ''}"


def signed(change: Mapping[str, Any]) -> str:
    """Size of a change with its sign and unit."""
    size, unit = amount(change)
    return f"{'+' if size > 0.0 else '-'}{figures(abs(size), 2)} {unit}".rstrip()


def percent(share: float | None) -> str:
    """A share as people write it."""
    return "-" if share is None or share != share else f"{100.0 * share:.1f} %"


def svg_plot(levels: Sequence[Sequence[float]], name: str, unit: str, changes: Sequence[Mapping[str, Any]]) -> str:
    """Values with their standard deviations over time, and the beginnings and ends of changes.

    `levels`: times [s since 1970], values and standard deviations; `changes`: of this parameter.
    """
    time, value, std = (np.array(series) for series in levels)
    if not len(time):
        return ""
    low, high = _range(value, std)
    begin, end = float(time.min()), float(max(time.max(), time.min() + 86400.0))

    def x(position: float) -> float:
        return LEFT + (WIDTH - LEFT - RIGHT) * (position - begin) / (end - begin)

    def y(position: float) -> float:
        return TOP + (HEIGHT - TOP - BOTTOM) * (high - min(max(position, low), high)) / (high - low)

    parts = []
    ticks = np.linspace(low, high, TICKS)
    for position, text in zip(ticks, alike([float(t) for t in ticks], (high - low) / TICKS), strict=True):
        parts.append(f'<line class="grid" x1="{LEFT:g}" x2="{WIDTH - RIGHT:g}" y1="{y(position):.1f}" y2="{y(position):.1f}"/>')
        parts.append(f'<text x="{LEFT - 6:g}" y="{y(position) + 4:.1f}" text-anchor="end">{text}</text>')
    for position, anchor in ((begin, "start"), (0.5 * (begin + end), "middle"), (end, "end")):
        parts.append(f'<text x="{x(position):.1f}" y="{HEIGHT - 8:g}" text-anchor="{anchor}">{day_of(position)}</text>')
    for t, v, s in zip(time, value, std, strict=True):
        title = f"{day_of(t)}: {figures(v, 4)} +- {figures(s, 2)} {unit if unit != '1' else ''}"
        parts.append(f'<line class="bar" x1="{x(t):.1f}" x2="{x(t):.1f}" y1="{y(v - s):.1f}" y2="{y(v + s):.1f}"/>')
        parts.append(f'<circle cx="{x(t):.1f}" cy="{y(v):.1f}" r="3"><title>{escape(title.strip())}</title></circle>')
    for change_s in (position for c in changes for position in (c["since_s"], c["ended_s"]) if position is not None):
        position = x(max(change_s, begin))
        parts.append(f'<line class="change" x1="{position:.1f}" x2="{position:.1f}" y1="{TOP:g}" y2="{HEIGHT - BOTTOM:g}"/>')
    label = f"{name} over time, from {day_of(begin)} to {day_of(end)}: {figures(float(value[0]))} to {figures(float(value[-1]))}"
    return f'<svg viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" aria-label="{escape(label)}">{"".join(parts)}</svg>'


def _range(value: np.ndarray, std: np.ndarray) -> tuple[float, float]:
    """Range of the axis: all values except outliers."""
    low, high = (float(np.quantile(ends, q)) for ends, q in ((value - std, 0.02), (value + std, 0.98)))
    margin = 0.15 * max(high - low, 1e-9 + 0.02 * abs(high))
    return low - margin, high + margin
