# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes a vehicle file with the learned parameters; uncertain or worse ones keep the file's values."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from trackres_ros.estimator import columns as at
from trackres_ros.learning.correction import told_std
from trackres_ros.learning.filter import known_of_others
from trackres_ros.learning.learner import Learner
from trackres_ros.learning.parameters import VEHICLES_OWN
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


def write_learned(learner: Learner, vehicle: AnyVehicle, path: Path) -> list[Path]:
    """Write a vehicle file with the learned parameters; return it and the files copied for it."""
    counts = [state for state in VEHICLES_OWN if learner.acts and learner.counted[state]]
    minutes = learner.learned.seconds / 60.0
    comment = f"Written by trackres replay --save-vehicle, learned from {minutes:.0f} min of driving"
    stds = _stds(learner, counts)
    applied = learner.learned.applied.tolist()

    def with_learned(text: str) -> str:
        document = Document(text)
        for state in counts:
            _set(document, vehicle, state, applied[state], stds[state])
        return (document.text() or f"# {comment}\n{document.plain()}") if counts else text

    changes = FileChanges(None, (), {}, by="trackres replay", amend=with_learned)
    if isinstance(vehicle, RoadVehicle):
        return write_road_vehicle(vehicle, path, changes, comment)
    return write_track_vehicle(vehicle, path, changes, comment)


def _stds(learner: Learner, counts: list[int]) -> dict[int, float]:
    """Standard deviations of accepted parameters, given the file's values for all others."""
    learned = np.zeros(at.LEARNABLE, dtype=bool)
    learned[counts] = True
    covariance = known_of_others(learner.learned.covariance[: at.LEARNABLE, : at.LEARNABLE], learned)
    return {state: told_std(state, float(covariance[state, state])) for state in counts}


def _set(document: Document, vehicle: AnyVehicle, state: int, departure: float, std: float) -> None:
    """Put a departure into the values of the file that it is of."""
    places = _of_wheels() if isinstance(vehicle, RoadVehicle) else _of_tracks(vehicle)
    paths, factor = places[state]
    for path in paths:
        old = vehicle.parameters[path]
        assert isinstance(old.value, float)
        section, _, name = path.rpartition(".")
        limit = {"rubber": RUBBER, "chassis": CHASSIS, SECTION: ROAD_LOAD}.get(section, BELT)[name]
        value, low, high = (
            min(max(old.value * (1.0 + factor * x), limit.low), limit.high)
            for x in (departure, departure - REACH_STD * std, departure + REACH_STD * std)
        )
        before = f"{REASON}; before it {old.value:g} ({old.flag}): {old.reason}"
        reason = old.reason if old.reason.startswith(REASON) else before
        new = {"value": _figures(value), "range": [_figures(low), _figures(high)], "flag": FITTED, "reason": reason}
        for key, given in new.items():
            document.set((*path.split("."), key), given)


Places = Mapping[int, tuple[tuple[str, ...], float]]
"""Values of the file behind each departure, and their change for a departure of 1."""


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
