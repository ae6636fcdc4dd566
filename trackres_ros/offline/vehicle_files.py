# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Lists, copies and compares vehicle files."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from trackres_ros.errors import InputError, nearest
from trackres_ros.files.file_sets import file_set
from trackres_ros.files.own_files import write
from trackres_ros.files.resources import config_dir, find_vehicle, shipped_road_vehicles, shipped_vehicles
from trackres_ros.files.yamls import read_yaml
from trackres_ros.text.numbers import figures
from trackres_ros.text.table import table
from trackres_ros.vehicle.description import FITTED
from trackres_ros.vehicle.writing.vehicle_file import copied
from trackres_ros.vehicle.writing.yaml_edit import Document

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,63}")
RUNS_ON = {"tracks": "tracks", "road_load": "wheels, without belts"}
LONGEST = 24  # of a text in a table of numbers
DIGITS = 12  # of the digest of a file


def shipped() -> list[dict[str, str]]:
    """Name, title and model of each shipped vehicle: ``tracks``, or ``road_load`` of one without belts."""
    found = []
    for model, vehicles in (("tracks", shipped_vehicles()), ("road_load", shipped_road_vehicles())):
        for name, path in vehicles.items():
            found.append({"name": name, "title": str(read_yaml(path).get("title", "")), "model": model, "file": str(path)})
    return found


def shipped_text(found: Iterable[Mapping[str, str]]) -> str:
    """The same for people."""
    rows = [(v["name"], v["title"], RUNS_ON[v["model"]]) for v in found]
    return table(rows, ("name", "description", "runs on"), numbers=False)


@file_set()
def new_vehicle(name: str, folder: Path, like: str) -> list[Path]:
    """Write a copy of a shipped vehicle under another name, with the files it needs, as a template; return all their paths.

    Raises InputError if the name is invalid, no such vehicle is shipped, or the file exists.
    """
    if not NAME.fullmatch(name):
        raise InputError("NAME", name, "a letter and at most 63 more letters, digits, _ and -")
    known = shipped_vehicles() | shipped_road_vehicles()
    if like not in known:
        raise InputError("--like", like, f"one of {', '.join(known)}", nearest(like, list(known)))
    target, source = folder / f"{name}.yaml", known[like]
    if target.exists():
        raise InputError(str(target), "a file that already exists", "another name or another folder")
    document, content = Document(source.read_text(encoding="utf-8")), read_yaml(source)
    document.set(("name",), name)
    written = [target]
    rubber = content.get("rubber", {}).get("file")
    if rubber:
        place = copied(source.parent / rubber, folder, Path(rubber))
        written.append(folder / place)
        if place != rubber:
            document.set(("rubber", "file"), place)
    try:
        write(target, (document.text() or document.plain()).encode())
    except OSError as error:
        raise InputError("-o", f"{folder}: {error.strerror or error}", "a writable folder") from error
    return written


def differences(one: str, other: str) -> list[dict[str, Any]]:
    """Differences of two vehicle files: path, unit, both values, the second over the first if both are numbers with a
    true zero, ranges, and flags if only one value is fitted: its uncertainty then is the whole one.

    Files that both name, such as that of the rubber, are compared by a digest of their content. Raises InputError if one is
    no vehicle file.
    """
    places = [find_vehicle(given) for given in (one, other)]
    contents = [read_yaml(place) for place in places]
    sides = [
        {**dict(_leaves(content)), **_digests(content, place.parent)} for content, place in zip(contents, places, strict=True)
    ]
    found = []
    for path in dict.fromkeys([*sides[0], *sides[1]]):
        quantities = [side.get(path) for side in sides]
        if quantities[0] == quantities[1]:
            continue
        values = [q.get("value") if isinstance(q, Mapping) else q for q in quantities]
        ranges, flags = ([q.get(key) if isinstance(q, Mapping) else None for q in quantities] for key in ("range", "flag"))
        units = [q["unit"] for q in quantities if isinstance(q, Mapping) and "unit" in q]
        numbers = "degC" not in units and all(isinstance(v, float | int) and not isinstance(v, bool) for v in values)
        found.append(
            {
                "path": path,
                "unit": str(units[0]) if units else "",
                "one": values[0],
                "other": values[1],
                "ratio": values[1] / values[0] if numbers and values[0] else None,
                "ranges": ranges if ranges[0] != ranges[1] else None,
                "flags": flags if flags[0] != flags[1] else None,
            }
        )
    return found


def differences_text(one: str, other: str, found: Sequence[Mapping[str, Any]]) -> str:
    """The same for people."""

    def cells(d: Mapping[str, Any]) -> tuple[str, ...]:
        ratio = "" if d["ratio"] is None else f"{100.0 * (d['ratio'] - 1.0):+.1f} %"
        spans = ["" if span is None else f"{figures(span[0])} to {figures(span[1])}" for span in d["ranges"] or (None, None)]
        fits = ["" if flag is None else f" ({flag})" for flag in d["flags"] or (None, None)]
        values = [f"{_shown(d[side])}{fit}" for side, fit in zip(("one", "other"), fits, strict=True)]
        return d["path"], d["unit"], *values, ratio, *spans

    head = ("value", "unit", one, other, "change", f"range of {one}", f"range of {other}")
    return table(map(cells, found), head, numbers=False) if found else "They have the same values."


def _shown(value: Any) -> str:
    if isinstance(value, float | int) and not isinstance(value, bool):
        return figures(value)
    text = "-" if value is None else str(value)
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def _digests(content: Mapping[str, Any], folder: Path) -> dict[str, str]:
    """Digests of the files that a vehicle file in a folder names; as in loading, a missing rubber file is the shipped one."""
    rubber, own = content.get("rubber"), content.get("effect_files")
    named = {f"effect_files.{i}": [folder / str(name)] for i, name in enumerate(own if isinstance(own, list) else [])}
    if isinstance(rubber, Mapping) and isinstance(name := rubber.get("file"), str):
        named["rubber.file"] = [folder / name, config_dir() / "rubber" / Path(name).name]
    found = {}
    for path, places in named.items():
        if (place := next(filter(Path.is_file, places), None)) is not None:
            found[f"content of {path}"] = f"sha256 {hashlib.sha256(place.read_bytes()).hexdigest()[:DIGITS]}"
    return found


def _leaves(node: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Quantities and plain values by their paths; parts of a list by their names."""
    if isinstance(node, Mapping) and "value" in node:
        # A reason does not define a vehicle, nor a flag other than F.
        yield path, {k: v for k, v in node.items() if k != "reason" and (k != "flag" or v == FITTED)}
    elif isinstance(node, Mapping):
        for key, value in node.items():
            if key != "name" or not path:
                yield from _leaves(value, f"{path}.{key}" if path else str(key))
    elif isinstance(node, list):
        for i, value in enumerate(node):
            name = value.get("name", i) if isinstance(value, Mapping) else i
            yield from _leaves(value, f"{path}.{name}")
    else:
        yield path, node
