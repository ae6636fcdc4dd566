# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes a vehicle file with the learned parameters; uncertain or worse ones keep the file's values."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trackres_ros.estimator import columns as at
from trackres_ros.learning.correction import told_std
from trackres_ros.learning.filter import known_of_others
from trackres_ros.learning.learner import Learner
from trackres_ros.learning.parameters import REACH_STD, VEHICLES_OWN, limits_of, places
from trackres_ros.vehicle import AnyVehicle, RoadVehicle
from trackres_ros.vehicle.reading import FITTED
from trackres_ros.vehicle.writing.changes import FileChanges
from trackres_ros.vehicle.writing.vehicle_file import write_road_vehicle, write_track_vehicle
from trackres_ros.vehicle.writing.yaml_edit import Document

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
    paths, factor = places(vehicle)[state]
    for path in paths:
        old, limit = vehicle.parameters[path], limits_of(path)
        assert isinstance(old.value, float)
        if old.value == 0.0:  # scaled it stays 0, and is as uncertain as before
            continue
        value, *span = (
            min(max(old.value * (1.0 + factor * x), limit.low), limit.high)
            for x in (departure, departure - REACH_STD * std, departure + REACH_STD * std)
        )
        before = f"{REASON}; before it {old.value:g} ({old.flag}): {old.reason}"
        reason = old.reason if old.reason.startswith(REASON) else before
        new = {"value": _figures(value), "range": sorted(map(_figures, span)), "flag": FITTED, "reason": reason}
        for key, given in new.items():
            document.set((*path.split("."), key), given)


def _figures(value: float) -> float:
    return float(f"{value:.{FIGURES}g}")
