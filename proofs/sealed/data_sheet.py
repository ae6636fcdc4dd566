# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reduces a vehicle to what a maker would print: the plain numbers of its file, nothing computed."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackres_ros.files.documents import read_yaml

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DataSheet:
    """Numbers by dotted path [SI, degC], and the temperature sweep of the rubber: T [degC], E', E'' [Pa]."""

    numbers: dict[str, float]
    wheel_positions: Array
    wraps: tuple[tuple[float, float], ...]  # radius [m] and angle [rad], in the order the loop runs
    assemblies: int
    sweep: Array  # (3, temperatures)

    def __getitem__(self, path: str) -> float:
        return self.numbers[path]


def read_data_sheet(path: Path) -> DataSheet:
    """Read a track vehicle's file with one kind of track."""
    content = read_yaml(path)
    (track,) = content["tracks"].values()
    numbers: dict[str, float] = {}
    for name, part in (("rubber", content["rubber"]), ("chassis", content["chassis"]), ("track", track)):
        _collect(name, part, numbers)
    axles = sum(axle["load"]["value"] for axle in content["chassis"]["axles"])
    numbers["weight"] = axles + len(content["assemblies"]) * numbers["track.own_weight"]
    wraps = tuple(
        (wheel["radius"]["value"] if "radius" in wheel else numbers["track.sprocket_radius"], wheel["wrap_angle"]["value"])
        for wheel in track["wrapped_wheels"]
    )
    with (path.parent / content["rubber"]["file"]).open(encoding="utf-8", newline="") as lines:
        rows = list(csv.DictReader(lines))
    columns = ("T_degC", "E_storage_MPa_10Hz", "E_loss_MPa_10Hz")
    sweep = np.array([[float(row[name]) for row in rows] for name in columns])
    sweep[1:] *= 1e6
    positions = np.array(track["road_wheels"]["positions"]["value"], dtype=float)
    return DataSheet(numbers, positions, wraps, len(content["assemblies"]), sweep)


def _collect(prefix: str, part: Any, numbers: dict[str, float]) -> None:
    for key, entry in part.items():
        if isinstance(entry, dict) and isinstance(entry.get("value"), int | float):
            numbers[f"{prefix}.{key}"] = float(entry["value"])
        elif isinstance(entry, dict):
            _collect(f"{prefix}.{key}", entry, numbers)
