# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes a vehicle file with the learned parameters; uncertain or worse ones keep the file's values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trackres_ros.estimator import columns as at
from trackres_ros.learning.correction import accepted, told_std
from trackres_ros.learning.filter import known_of_others
from trackres_ros.learning.learner import Learner
from trackres_ros.vehicle import AnyVehicle, RoadVehicle, Vehicle
from trackres_ros.vehicle.reading import FITTED
from trackres_ros.vehicle.road import SECTION
from trackres_ros.vehicle.schema import BELT, CHASSIS, ROAD_LOAD, RUBBER
from trackres_ros.vehicle.writing.changes import FileChanges
from trackres_ros.vehicle.writing.vehicle_file import rubber_share, write_road_vehicle, write_track_vehicle
from trackres_ros.vehicle.writing.yaml_edit import Document

REACH_STD = 2.0  # ranges are read as +-2 standard deviations
FIGURES = 6
REASON = "learned by trackres while driving"


@dataclass(frozen=True)
class LearnedFile:
    """What a vehicle file got: values of the file by their paths in it."""

    path: Path
    changed: Mapping[str, tuple[float, float]]  # value before, and the one written
    kept: Mapping[str, float]  # not known well enough
    why_not: str = ""  # reason why no file was written; empty if it was


def write_learned(learner: Learner, vehicle: AnyVehicle, path: Path) -> LearnedFile:
    """Write a vehicle file with the learned parameters, unless none is accepted.

    It has the values that were learned. Those acting follow them at a limited rate, so they may be half-way.
    """
    counts = [state for state in learner.own if learner.acts and learner.counted[state]]
    places = _of_wheels() if isinstance(vehicle, RoadVehicle) else _of_tracks(vehicle)
    kept = {name: _value(vehicle, name) for state in learner.own if state not in counts for name in places[state][0]}
    if not counts:
        fits = "the learned parameters fit no better than the vehicle file"
        return LearnedFile(path, {}, kept, fits if learner.counted.any() else learner.text)
    minutes = learner.learned.seconds / 60.0
    comment = f"Written by trackres replay --save-vehicle, learned from {minutes:.0f} min of driving"
    stds = _stds(learner, counts)
    found = accepted(learner.learned, learner.prior, learner.counted).tolist()
    changed: dict[str, tuple[float, float]] = {}

    def with_learned(text: str) -> str:
        document = Document(text)
        for state in counts:
            changed.update(_set(document, vehicle, places[state], found[state], stds[state]))
        return document.text() or f"# {comment}\n{document.plain()}"

    changes = FileChanges(None, (), {}, amend=with_learned)
    if isinstance(vehicle, RoadVehicle):
        write_road_vehicle(vehicle, path, changes, comment)
    else:
        write_track_vehicle(vehicle, path, changes, comment)
    return LearnedFile(path, changed, kept)


def _value(vehicle: AnyVehicle, path: str) -> float:
    value = vehicle.parameters[path].value
    assert isinstance(value, float)
    return value


def _stds(learner: Learner, counts: list[int]) -> dict[int, float]:
    """Standard deviations of accepted parameters, given the file's values for all others."""
    learned = np.zeros(at.LEARNABLE, dtype=bool)
    learned[counts] = True
    covariance = known_of_others(learner.learned.covariance[: at.LEARNABLE, : at.LEARNABLE], learned)
    return {state: told_std(state, float(covariance[state, state])) for state in counts}


def _set(document: Document, vehicle: AnyVehicle, place: Place, departure: float, std: float) -> dict[str, tuple[float, float]]:
    """Put a departure into the values of the file that it is of; these before and after, by path."""
    paths, factor = place
    changed = {}
    for path in paths:
        old, before_it = vehicle.parameters[path], _value(vehicle, path)
        section, _, name = path.rpartition(".")
        limit = {"rubber": RUBBER, "chassis": CHASSIS, SECTION: ROAD_LOAD}.get(section, BELT)[name]
        value, low, high = (
            min(max(before_it * (1.0 + factor * x), limit.low), limit.high)
            for x in (departure, departure - REACH_STD * std, departure + REACH_STD * std)
        )
        before = f"{REASON}; before it {before_it:g} ({old.flag}): {old.reason}"
        reason = old.reason if old.reason.startswith(REASON) else before
        new = {"value": _figures(value), "range": [_figures(low), _figures(high)], "flag": FITTED, "reason": reason}
        for key, given in new.items():
            document.set((*path.split("."), key), given)
        changed[path] = before_it, _figures(value)
    return changed


Place = tuple[tuple[str, ...], float]
"""Values of the file behind a departure, and their change for a departure of 1."""
Places = Mapping[int, Place]


def _of_tracks(vehicle: Vehicle) -> Places:
    share = rubber_share(vehicle)  # of a belt's heat: cords hold the rest
    of_track = [f"tracks.{name}.belt.{film}" for name in vehicle.tracks for film in ("film_offset", "film_slope")]
    return {
        at.OF_LOSS: (("rubber.loss_modulus_scale",), 1.0),
        at.OF_CAPACITY: (("rubber.heat_capacity",), 1.0 / share),
        at.OF_COOLING: (tuple(of_track), 1.0),
        at.OF_BEARING: (("chassis.bearing_friction",), 1.0),
        at.OF_DRAG: (("chassis.drag_coefficient",), 1.0),
        at.OF_MASS: (("chassis.rotating_mass_factor",), 1.0),
    }


def _of_wheels() -> Places:
    return {
        at.OF_BEARING: ((f"{SECTION}.rolling_coefficient", f"{SECTION}.rolling_rise"), 1.0),
        at.OF_DRAG: ((f"{SECTION}.drag_area",), 1.0),
        at.OF_MASS: ((f"{SECTION}.rotating_mass_factor",), 1.0),
    }


def _figures(value: float) -> float:
    return float(f"{value:.{FIGURES}g}")
