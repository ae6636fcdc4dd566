# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes the pages: the fleet at a glance, and one for each vehicle with its recordings and diagnoses."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

from trackres_ros.files.own_files import write
from trackres_ros.fleet.dataset import LOAD_RECORDED, FleetDataset
from trackres_ros.fleet.page.drawing import drawn
from trackres_ros.fleet.periods import verdicts
from trackres_ros.fleet.trends import change_sentence, sentences
from trackres_ros.text.numbers import figures
from trackres_ros.text.templates import templates

INDEX, VEHICLES = "index.html", "vehicles"
COLOURS = 6  # of mismatch, from none to the fleet's worst
SHOWN = (
    "url",
    "vehicle",
    "day",
    "status",
    "reason",
    "duration_s",
    "distance_m",
    "mismatch",
    "held_out_file",
    "held_out_refit",
    "mean_ambient",
    "findings",
    LOAD_RECORDED,
)


def write_pages(folder: Path, found: Mapping[str, Any], dataset: FleetDataset) -> Path:
    """Write index.html and vehicles/NAME.html.

    Raises MissingExtraError without jinja2.

    Returns
    -------
    Path
        Of the first page.
    """
    environment = templates("trackres_ros.fleet.page", "the pages of a fleet", "fleet", figures=figures, percent=percent)
    style = environment.get_template("style.css").render()
    told = verdicts(folder)
    names = sorted({*found["vehicles"], *found["months"]})
    pages = {name: f"{VEHICLES}/{quote(name, safe='')}.html" for name in names}
    months = sorted({month for of in found["months"].values() for month in of})
    cells = [cell["mismatch"] for of in found["months"].values() for cell in of.values()]
    worst = max((mismatch for mismatch in cells if mismatch is not None), default=0.0)
    rows: dict[str, list[dict[str, Any]]] = {}
    for row in dataset.rows(list(SHOWN)):
        rows.setdefault(row["vehicle"], []).append(row)
    text = environment.get_template("index.html").render(
        style=style, found=found, months=months, pages=pages, lines=sentences(found), told=told, quote=quote,
        shade=lambda mismatch: shade(mismatch, worst), worst=worst, colours=COLOURS,
    )  # fmt: skip
    (folder / VEHICLES).mkdir(exist_ok=True)
    for name in names:
        vehicle = found["vehicles"].get(name)
        type_ = next((t for t in found["types"] if name in t["vehicles"]), None)
        units = {key: q["unit"] for key, q in type_["parameters"].items()} if type_ else {}
        pictures = [
            (key, drawn(levels, key, units.get(key, ""), [c for c in vehicle["changes"] if c["parameter"] == key]))
            for key, levels in (vehicle["levels"] if vehicle else {}).items()
        ]
        page = environment.get_template("vehicle.html").render(
            style=style, name=name, vehicle=vehicle, of_type=type_, pictures=pictures, told=told.get(quote(name, safe=""), {}),
            rows=sorted(rows.get(name, ()), key=lambda row: (row["day"], row["url"])),
            changes=[change_sentence(name, c) for c in (vehicle["changes"] if vehicle else ())],
        )  # fmt: skip
        write(folder / pages[name], page.encode())
    write(folder / INDEX, text.encode())
    return folder / INDEX


def shade(mismatch: float | None, worst: float) -> str:
    """Class of the colour of a mismatch, `s0` for the least; that of a month without recorded loads is `unloaded`."""
    if mismatch is None:
        return "unloaded"
    return f"s{min(COLOURS - 1, int(COLOURS * mismatch / worst)) if worst > 0.0 else 0}"


def percent(share: float | None) -> str:
    """A share as people write it."""
    return "-" if share is None or share != share else f"{100.0 * share:.1f} %"
