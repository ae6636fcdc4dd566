# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes a vehicle file with the learned parameters; uncertain or worse ones keep the file's values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from trackres_ros.learning.correction import accepted
from trackres_ros.learning.learner import Learner
from trackres_ros.learning.parameters import REACH_STD, Learnable, limits_of
from trackres_ros.vehicle import AnyVehicle, RoadVehicle
from trackres_ros.vehicle.description import FITTED
from trackres_ros.vehicle.writing.changes import FileChanges
from trackres_ros.vehicle.writing.vehicle_file import write_road_vehicle, write_track_vehicle
from trackres_ros.vehicle.writing.yaml_edit import Document

FIGURES = 6
REASON = "learned by trackres while driving"


@dataclass(frozen=True)
class LearnedFile:
    """What a vehicle file got: values of the file by their paths in it."""

    path: Path
    written: tuple[Path, ...]  # it and the files copied for it
    changed: Mapping[str, tuple[float, float]]  # value before, and the one written
    kept: Mapping[str, float]  # not known well enough
    why_not: str = ""  # reason why no file was written; empty if it was


def write_learned(learner: Learner, vehicle: AnyVehicle, path: Path) -> LearnedFile:
    """Write a vehicle file with the learned parameters, unless none is accepted.

    It has the values that were learned. Those acting follow them at a limited rate, so they may be half-way.
    """
    held, counted = learner.held.any(), learner.counted
    counts = [state for state in learner.own if learner.acts and counted[state] and not held]
    of_file = {one.state: one for one in learner.learnables}
    kept = {name: _value(vehicle, name) for state in learner.own if state not in counts for name in of_file[state].paths}
    if not counts:
        fits = "the learned parameters fit no better than the vehicle file"
        return LearnedFile(path, (), {}, kept, fits if counted.any() and not held else learner.text)
    minutes = learner.learned.seconds / 60.0
    comment = f"Written by trackres replay --save-vehicle, learned from {minutes:.0f} min of driving"
    stds = learner.stds(learner.learned.covariance, counts).tolist()
    found = accepted(learner.learned, learner.prior, learner.counted).tolist()
    changed: dict[str, tuple[float, float]] = {}

    def with_learned(text: str) -> str:
        document = Document(text)
        for state in counts:
            changed.update(_set(document, vehicle, of_file[state], found[state], stds[state]))
        return document.text() or f"# {comment}\n{document.plain()}"

    changes = FileChanges(None, (), {}, by="trackres replay", amend=with_learned)
    if isinstance(vehicle, RoadVehicle):
        written = write_road_vehicle(vehicle, path, changes, comment)
    else:
        written = write_track_vehicle(vehicle, path, changes, comment)
    return LearnedFile(path, tuple(written), changed, kept)


def _value(vehicle: AnyVehicle, path: str) -> float:
    value = vehicle.parameters[path].value
    assert isinstance(value, float)
    return value


def _set(document: Document, vehicle: AnyVehicle, one: Learnable, departure: float, std: float) -> dict[str, tuple[float, float]]:
    """Put a departure into the values of the file that it is of; these before and after, by path.

    The first is learned. Others only scale with it, so their own relative ranges stay, if they are wider.
    """
    changed = {}
    for path in one.paths:
        old, before_it, limit = vehicle.parameters[path], _value(vehicle, path), limits_of(path)
        if before_it == 0.0:  # scaled it stays 0, and is as uncertain as before
            continue
        scale, reach = 1.0 + one.factor * departure, one.factor * REACH_STD * std
        ends = [before_it * (scale - reach), before_it * (scale + reach)]
        if path != one.paths[0]:
            ends += [old.low * scale, old.high * scale]
        value, *span = (min(max(x, limit.low), limit.high) for x in (before_it * scale, min(ends), max(ends)))
        before = f"{REASON}; before it {before_it:g} ({old.flag}): {old.reason}"
        reason = old.reason if old.reason.startswith(REASON) else before
        new = {"value": _figures(value), "range": [*map(_figures, span)], "flag": FITTED, "reason": reason}
        for key, given in new.items():
            document.set((*path.split("."), key), given)
        changed[path] = before_it, _figures(value)
    return changed


def _figures(value: float) -> float:
    return float(f"{value:.{FIGURES}g}")
