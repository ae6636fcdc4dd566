# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Converts the learning state to plain values of a state file and back, bit by bit, and refuses impossible values.

Also writes a vehicle file with the learned parameters; uncertain or worse ones keep the file's values.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trackres_ros.errors import InputError
from trackres_ros.estimator.estimator import Session
from trackres_ros.estimator.snapshot import FARTHEST_SAVED_AT, LEARNED_AT, REMEDY, read_float, read_time
from trackres_ros.learning.delay import EARLIEST_S, LATEST_S
from trackres_ros.learning.learner import ON, Learner, target_departures, use_file
from trackres_ros.learning.parameters import REACH_STD, VEHICLES_OWN, Learnable, limits_of
from trackres_ros.vehicle import AnyVehicle, RoadVehicle
from trackres_ros.vehicle.description import FITTED
from trackres_ros.vehicle.writing.changes import FileChanges
from trackres_ros.vehicle.writing.vehicle_file import write_road_vehicle, write_track_vehicle
from trackres_ros.vehicle.writing.yaml_edit import Document

# State file

LARGEST = 1e15  # for any number: a step between torques of -1 and 1 MNm adds 4e12 Nm^2; times in ns are stored as integers
FARTHEST = 1 << 62
NOT_YET = {"last_left": "nan", "felt": "nan", "torque": "nan", "step_s": "inf", "slow": "nan", "white": "nan"}  # unseen
REACH = 1.0 + 1e-9  # of the bounds: rounding


def learner_content(learner: Learner) -> dict[str, Any]:
    """Full memory of a learner, ready for JSON."""
    return {name: _plain(part) for name, part in _parts(learner).items()}


def take_content(learner: Learner, content: object) -> None:
    """Fill a new learner from the result of `stored`.

    Raises
    ------
    ValueError
        If it is not from a learner of this vehicle; the learner is then new.
    """
    try:
        if not isinstance(content, Mapping):
            raise TypeError("no mapping")
        for name, part in _parts(learner).items():
            _fill(part, content[name])
        _check(learner)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        learner.reset()
        raise ValueError(f"learned parameters: {str(error)[:80]}") from error


def since_learned(content: object, wall_s: float) -> float:
    """Time [s] since the values of a state file were learned, at a time [s since 1970]; 0 for a clock that went back.

    Raises
    ------
    ValueError
        If they do not say when.
    """
    learned_at = content.get(LEARNED_AT) if isinstance(content, Mapping) else None
    return max(0.0, wall_s - read_time(learned_at, "learned parameters: the time of learning"))


def since_saved(path: Path, content: Any, end_s: float, start_s: float, off_s: float | None) -> tuple[Any, float | None]:
    """Learned values of a state file as of a recording with another clock, and the time since they were learned [s].

    That is None in the same stream if the run before learned. Else it includes all runs since the last one that learned.

    Parameters
    ----------
    end_s, start_s
        End of the state and beginning of the recording, each by its own clock [s since 1970].
    off_s
        Time off between them [s]; None in the same stream.

    Raises
    ------
    InputError
        If the values do not say when they were learned.
    """
    if content is None:
        return None, off_s
    try:
        age_s = since_learned(content, end_s)
    except ValueError as error:
        raise InputError(f"state file {path}", str(error), "learned parameters saved by this program", REMEDY) from error
    if off_s is None and not age_s:
        return content, None
    age_s += max(start_s - end_s, 0.0) if off_s is None else off_s
    return {**content, LEARNED_AT: max(start_s - age_s, -FARTHEST_SAVED_AT)}, age_s


def continue_session(session: Session, learner: Learner | None, content: object, off_s: float | None = None) -> None:
    """Continue with what a state file holds: a session, and the learned values saved with it, or None.

    They act at once only in mode `on` and in the same stream of messages; after some time off [s] they are less certain, and act
    once the learner allows it.

    Raises
    ------
    ValueError
        As `take`.
    """
    if learner is None or learner.mode != ON or content is None or off_s is not None:
        use_file(session.learned)
    if learner is None or content is None:
        return
    take_content(learner, content)
    if off_s is not None:
        learner.age_values(off_s)


def continue_from(path: Path, session: Session, learner: Learner | None, content: object, off_s: float | None = None) -> None:
    """As `continue_session`, from a state file that is named.

    Raises
    ------
    InputError
        If the learned values are not from a learner of this vehicle.
    """
    try:
        continue_session(session, learner, content, off_s)
    except ValueError as error:
        raise InputError(f"state file {path}", str(error), "learned parameters saved by this program", REMEDY) from error


def _parts(learner: Learner) -> dict[str, Any]:
    buckets = learner.buckets
    return {
        "learned": learner.learned,
        "second": learner.gate.second,
        "samples": learner.gate.samples,
        "delay": learner.delay.kept,
        "buckets": {"seconds": buckets.seconds, "accelerating": buckets.accelerating},
    }


def _plain(part: Any) -> Any:
    if dataclasses.is_dataclass(part):
        return {item.name: _plain(getattr(part, item.name)) for item in dataclasses.fields(part)}
    if isinstance(part, Mapping):
        return {name: _plain(inner) for name, inner in part.items()}
    if isinstance(part, np.ndarray):
        return [float(value).hex() for value in part.ravel()]
    return part if isinstance(part, bool | int) else float(part).hex()


def _fill(part: Any, content: Any) -> None:
    """Fill arrays in place and the fields of dataclasses, each by a value of its own kind."""
    is_mapping = isinstance(part, Mapping)
    names = list(part) if is_mapping else [item.name for item in dataclasses.fields(part)]
    if not isinstance(content, Mapping) or set(content) != set(names):
        raise TypeError("other entries than expected")
    for name in names:
        target, value = part[name] if is_mapping else getattr(part, name), content[name]
        if isinstance(target, np.ndarray):
            if not isinstance(value, list) or len(value) != target.size:
                raise TypeError(f"{name} of another length")
            target[...] = np.array([_number(number, name) for number in value]).reshape(target.shape)
        elif dataclasses.is_dataclass(target):
            _fill(target, value)
        elif isinstance(target, bool | int):
            if type(value) is not type(target) or not -FARTHEST <= value <= FARTHEST:
                raise TypeError(f"{name} is of another kind")
            setattr(part, name, value)
        else:
            setattr(part, name, _number(value, name))


def _number(text: str, name: str) -> float:
    value = read_float(text)
    if not (abs(value) <= LARGEST or repr(value) == NOT_YET.get(name)):
        raise ValueError(f"a number {text[:20]}")
    return value


def _check(learner: Learner) -> None:
    """Raise ValueError for an impossible learning state."""
    s, prior = learner.learned, learner.prior
    for covariance in (s.covariance, s.recent_covariance, s.before_covariance):
        if np.linalg.eigvalsh(0.5 * (covariance + covariance.T)).min() < -1e-9 * np.abs(covariance).max():
            raise ValueError("an invalid covariance")
    for departures in (s.mean, s.recent_mean, s.before_mean, s.aim, s.applied):
        for state in VEHICLES_OWN:
            if not prior.low[state] * REACH <= departures[state] <= prior.high[state] * REACH:
                raise ValueError("a departure outside of the vehicle file's ranges")
        np.clip(departures, prior.low[: len(departures)], prior.high[: len(departures)], out=departures)
    sizes = [s.seconds, s.rolling, s.noise, s.disagrees, s.lasting_s, s.step_s, s.disturbed_s, learner.gate.samples.deviation]
    sizes += [s.wandering.variance, s.contest.variance, s.fresh.variance]
    sizes += [s.ground.altitude_variance, s.ground.drift, s.ground.felt_variance, s.ground.slope_variance]
    if not all(size >= 0.0 for size in sizes) or s.past.slow < 0.0 or s.past.white < 0.0:
        raise ValueError("an invalid size")
    delays = learner.delay.kept
    if delays.count < 0 or delays.fresh < 0 or not (delays.variances >= 0.0).all():
        raise ValueError("invalid delays")
    if not ((delays.delays >= EARLIEST_S) & (delays.delays <= LATEST_S)).all():
        raise ValueError("a delay outside the searched range")
    if not ((learner.buckets.seconds >= 0.0).all() and (learner.buckets.accelerating >= 0.0).all()):
        raise ValueError("invalid seconds")


# Vehicle file

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
    is_at_bound, has_evidence = learner.is_at_bound.any(), learner.has_evidence
    counts = [state for state in learner.own if learner.is_active and has_evidence[state] and not is_at_bound]
    of_file = {learnable.state: learnable for learnable in learner.learnables}
    old_values = {name: _value(vehicle, name) for state in learner.own if state not in counts for name in of_file[state].paths}
    if not counts:
        fits = "the learned parameters fit no better than the vehicle file"
        return LearnedFile(path, (), {}, old_values, fits if has_evidence.any() and not is_at_bound else learner.text)
    minutes = learner.learned.seconds / 60.0
    comment = f"Written by trackres replay --save-vehicle, learned from {minutes:.0f} min of driving"
    stds = learner.stds(learner.learned.covariance, counts).tolist()
    departures = target_departures(learner.learned, learner.prior, learner.has_evidence).tolist()
    file_values: dict[str, tuple[float, float]] = {}

    def with_learned(text: str) -> str:
        document = Document(text)
        for state in counts:
            file_values.update(_set_learnable(document, vehicle, of_file[state], departures[state], stds[state]))
        return document.text() or f"# {comment}\n{document.plain()}"

    changes = FileChanges(None, (), {}, command="trackres replay", amend=with_learned)
    if isinstance(vehicle, RoadVehicle):
        paths = write_road_vehicle(vehicle, path, changes, comment)
    else:
        paths = write_track_vehicle(vehicle, path, changes, comment)
    return LearnedFile(path, tuple(paths), file_values, old_values)


def _value(vehicle: AnyVehicle, path: str) -> float:
    value = vehicle.parameters[path].value
    assert isinstance(value, float)
    return value


def _set_learnable(
    document: Document, vehicle: AnyVehicle, learnable: Learnable, departure: float, std: float
) -> dict[str, tuple[float, float]]:
    """Put a departure into the values of the file that it is of; these before and after, by path.

    The first is learned. Others only scale with it, so their own relative ranges stay, if they are wider.
    """
    by_path = {}
    for path in learnable.paths:
        quantity, old_value, limit = vehicle.parameters[path], _value(vehicle, path), limits_of(path)
        if old_value == 0.0:  # scaled it stays 0, and is as uncertain as before
            continue
        scale, reach = 1.0 + learnable.factor * departure, learnable.factor * REACH_STD * std
        ends = [old_value * (scale - reach), old_value * (scale + reach)]
        if path != learnable.paths[0]:
            ends += [quantity.low * scale, quantity.high * scale]
        value, *span = (min(max(x, limit.low), limit.high) for x in (old_value * scale, min(ends), max(ends)))
        origin = f"{REASON}; before it {old_value:g} ({quantity.flag}): {quantity.reason}"
        reason = quantity.reason if quantity.reason.startswith(REASON) else origin
        entries = {"value": _figures(value), "range": [*map(_figures, span)], "flag": FITTED, "reason": reason}
        for key, content in entries.items():
            document.set((*path.split("."), key), content)
        by_path[path] = old_value, _figures(value)
    return by_path


def _figures(value: float) -> float:
    return float(f"{value:.{FIGURES}g}")
