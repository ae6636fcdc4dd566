# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Saves a session and resumes it: versioned, keyed to the vehicle, written atomically.

Resumed in the same stream of messages, a session gives the same bits as an uninterrupted one. After time switched off, the
belts have cooled. The guards restart, as stamps and clocks may differ.

The seal shows that a file is unchanged; checks of ranges show that its content is a valid state. Both are needed, so that no
restored number moves a vehicle unless a drive could have produced it.
"""

from __future__ import annotations

import glob
import hashlib
import json
import os
import re
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trackres_ros import checks
from trackres_ros.arrays import Array
from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.estimator import Estimator, Session
from trackres_ros.estimator.guards import Memory
from trackres_ros.estimator.plausible import NOTHING_TRACKED
from trackres_ros.estimator.records import FARTHEST_NS, LONGEST_STEP_S
from trackres_ros.files import own_files
from trackres_ros.files.documents import parse_json
from trackres_ros.route.follower import NOTHING_YET

# Ranges of a stored state

BELT_DEGC = (-100.0, 400.0)  # wider than any rubber lives through
MOST_DEPARTURE = 10.0  # relative to the file's value
LARGEST_DEPARTURE = 1000.0  # K, of a standard deviation of any cause
SPEED_REACH = 3.0  # of the greatest speed: the filter may overshoot, and effects scale the speed
LARGEST_ACCEL = 1e4  # m/s^2, by a filter on stamps that differ by a few microseconds
LARGEST_COVARIANCE = 1e6
ROUNDING = 1e-9
NO_QUANTUM = 1e9  # as `kernel.start` begins
TORQUE_REACH = 1e4  # of weight times sprocket radius: inertia by the acceleration above
STARTED = (layout.START_ANEW, layout.START_COLD, 0.0, layout.RESTS, 1.0)
MOST_SUSPECTS = 1000
FARTHEST_FOLLOWED = 1e9  # metres, Nm, and seconds
LONGEST_TURN = 1e10  # s: times are at most so far apart
LONGEST_AGE = 60.0  # s: the settings allow no more
LARGEST_EFFECT = 1e12  # distance [m], time constant [s], or the state of an effect in any unit


def check_state(estimator: Estimator, belts: Array, motion: Array) -> None:
    """Raise ValueError for belts or a motion that no drive can produce."""
    _check_range("belt temperatures", belts[:, :, layout.Belt.temperature], *BELT_DEGC)
    _check_range("departures of belt temperatures", belts[:, :, layout.FIRST_DEPARTURE :], -LARGEST_DEPARTURE, LARGEST_DEPARTURE)
    speed = SPEED_REACH * estimator.vehicle.chassis.max_speed
    k = estimator.constants.assembly
    torque = TORQUE_REACH * float(k[:, layout.Assembly.nominal_load] @ k[:, layout.Assembly.radius])
    motion_row = layout.Motion(motion)
    for name, value, low, high in (
        ("filtered speed", motion_row.filtered_speed, -speed, speed),
        ("last speed", motion_row.last_speed, -speed, speed),
        ("acceleration", motion_row.filtered_accel, -LARGEST_ACCEL, LARGEST_ACCEL),
        ("covariance of the speed", motion_row.cov_speed, -ROUNDING, LARGEST_COVARIANCE),
        ("covariance of speed and acceleration", motion_row.cov_both, -LARGEST_COVARIANCE, LARGEST_COVARIANCE),
        ("covariance of the acceleration", motion_row.cov_accel, -ROUNDING, LARGEST_COVARIANCE),
        ("smallest step of the speed", motion_row.quantum, 0.0, NO_QUANTUM),
        ("feed-forward", motion_row.feedforward, -torque, torque),
        ("target of the feed-forward", motion_row.feedforward_target, -torque, torque),
        ("mark of rolling", motion_row.rolls, 0.0, 1.0),
        ("drive torque", motion_row.last_drive, -torque, torque),
        ("drive torque but for belts and effects", motion_row.last_others, -torque, torque),
        ("turn of the feed-forward", motion_row.update_age, 0.0, LONGEST_TURN),
        ("mark of no feed-forward", motion_row.to_zero, 0.0, 1.0),
        ("air", motion_row.air, *BELT_DEGC),
        ("standard deviation of the air", motion_row.air_std, 0.0, LARGEST_DEPARTURE),
        ("longest age of the speed", motion_row.longest_age, 0.0, LONGEST_AGE),
    ):
        _check_range(name, value, low, high)
    if motion_row.started not in STARTED:
        raise ValueError("started is none of its values")


def check_effects(memory: Array) -> None:
    """Raise ValueError for an impossible memory of effects; nan is an effect that has not acted yet."""
    _check_range("memory of effects", memory[~np.isnan(memory)], -LARGEST_EFFECT, LARGEST_EFFECT)


def check_learned(estimator: Estimator, learned: Array) -> None:
    """Raise ValueError for impossible learned values."""
    k = estimator.constants.assembly
    torque = TORQUE_REACH * float(k[:, layout.Assembly.nominal_load] @ k[:, layout.Assembly.radius])
    departures = learned[layout.Learned.departures]
    _check_range("mark of what acts", learned[layout.Learned.on], 0.0, 1.0)
    _check_range("departures", np.delete(departures, layout.OF_BELT), -1.0, MOST_DEPARTURE)
    _check_range("departure of the belts", departures[layout.OF_BELT], -LARGEST_DEPARTURE, LARGEST_DEPARTURE)
    _check_range("torques that were learned", learned[layout.Learned.torque : layout.Learned.factor.start], -torque, torque)
    _check_range("covariance of what was learned", learned[layout.Learned.factor], -LARGEST_DEPARTURE, LARGEST_DEPARTURE)
    _check_range("sensitivities", learned[layout.Learned.sensitivities], -torque, torque)


def check_memory(memory: Memory, limits: Array) -> None:
    """Raise ValueError for a memory of the guards that no stream of messages can produce."""
    is_known = ~np.isnan(memory.values)
    if ((memory.values < limits[:, 0]) | (memory.values > limits[:, 1]))[is_known].any():
        raise ValueError("last values outside of the plausible range of their channels")
    _check_range("times", memory.times, -FARTHEST_NS, FARTHEST_NS)
    _check_range("marks of channels", memory.times[:, [layout.Times.seen, layout.Times.fresh]], 0, 1)
    _check_range("suspects", memory.times[:, layout.Times.suspects], 0, MOST_SUSPECTS)
    if (is_known != (memory.times[:, layout.Times.seen] == 1)).any():
        raise ValueError("channels with a time and no value, or the other way round")
    _check_range("doubts", memory.times[:, layout.Times.doubts], 0, FARTHEST_NS)
    _check_range("periods", memory.times[:, layout.Times.period], 0, FARTHEST_NS)
    _check_range("references", memory.runs[~np.isnan(memory.runs)], -FARTHEST_FOLLOWED, FARTHEST_FOLLOWED)
    for name, values, at_first in (
        ("comparison with the odometer", memory.tracked, NOTHING_TRACKED),
        ("place on a route", memory.followed, NOTHING_YET),
    ):
        is_number = ~np.isnan(values)
        _check_range(name, values[is_number], -FARTHEST_FOLLOWED, FARTHEST_FOLLOWED)
        if not is_number[~np.isnan(at_first)].all():
            raise ValueError(f"{name}: no number where there is always one")
    _check_range("counters", memory.counters, 0, FARTHEST_NS)
    _check_range("counts of reasons", memory.reasons, 0, FARTHEST_NS)


def _check_range(name: str, raw: ArrayLike, low: float, high: float) -> None:
    values: NDArray[Any] = np.asarray(raw)
    if not ((values >= low) & (values <= high)).all():  # nan is not either
        raise ValueError(f"{name} outside of {low:g} to {high:g}")


# State files

FORMAT = "trackres-state"
VERSION = 15
HEAD = json.dumps({"format": FORMAT}).encode()[:-1]  # first bytes of each state file
REMEDY = "give a state of this vehicle, or none"
LARGEST = 4 << 20  # bytes; a vehicle with four assemblies has 10 thousand
FARTHEST_SAVED_AT = 1e10  # s: the year 2286, and as far before 1970
LONGEST_OFF = LONGEST_STEP_S  # a longer time tells no more
SEAL = re.compile(rb', "sha256": "([0-9a-f]{64})"\}\Z')

# Session arrays in a state file, in the order of `_arrays`.
FLOATS = ("belts", "motion", "effects", "learned", "values", "followed", "tracked", "runs")
INTEGERS = ("times", "counters", "reasons")
# Of a vehicle: no part of what a state means, or in the key in another form.
NOT_IN_KEY = {
    "title", "source", "rubber_source", "surroundings_source", "disturbance", "friction_brakes",
    "parameters", "effects", "surroundings", "route",
}  # fmt: skip
LEARNING = "learning"  # learned values, in their own format
LEARNED_AT = "at"  # among them: the time until which they were learned [s since 1970]


def key(estimator: Estimator) -> str:
    """Hash of everything that defines a state's meaning: version, all of the vehicle that the model reads, the arrays' layout."""
    vehicle = estimator.vehicle
    values = {path: q.value for path, q in vehicle.parameters.items()}
    parts = [
        VERSION,
        {entry.name: getattr(vehicle, entry.name) for entry in fields(vehicle) if entry.name not in NOT_IN_KEY},
        estimator.channels,
        estimator.columns,
        layout.BELT_COLUMNS,
        layout.Motion.columns,
        layout.Learned.columns,
        values,
        [[(effect.effect.name, dict(effect.values)) for effect in group] for group in (vehicle.effects, vehicle.surroundings)],
        hashlib.sha256(estimator.constants.route_places.tobytes()).hexdigest(),
    ]
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=_plain).encode()).hexdigest()[:32]


def _plain(part: Any) -> Any:
    if is_dataclass(part) and not isinstance(part, type):
        return asdict(part)
    return dict(part) if isinstance(part, Mapping) else part.tolist()


def state_file(path: str | PathLike[str], argument: str) -> Path:
    """The path, if a state can be saved there.

    Raises InputError for no such folder, or something in its place that is not a state file; `argument` names the argument.
    """
    file = checks.path(path, argument)
    if not file.parent.is_dir() or (file.exists() and not file.is_file()):
        raise InputError(argument, str(file), "a file in a folder that exists")
    try:
        if file.exists() and is_other_kind(file):
            raise InputError(argument, f"{file}, which is another kind of file", "a new file, or a state file to replace")
    except OSError as error:
        raise InputError(argument, f"{file}: {error.strerror}", "a new file, or a state file to replace") from error
    return file


def is_other_kind(file: Path) -> bool:
    """Whether a file is none that a state may replace. A damaged state is one, and so is what a power cut leaves: nothing, or
    zeros.

    Raises OSError if it cannot be read.
    """
    with file.open("rb") as stream:
        return _is_other_head(stream.read(len(HEAD)))


def _is_other_head(head: bytes) -> bool:
    return head not in (HEAD, bytes(len(head)))


def place_aside(path: Path, of_key: str) -> Path:
    """Path of the copy of an unused state file: next to it, one for each key of a vehicle."""
    return path.with_name(f"{path.stem}.unused-{''.join(filter(str.isalnum, of_key))[:8]}{path.suffix}")


def aside_of(path: Path) -> Path | None:
    """Place to keep a state file that was not used; None if it is damaged, or no file."""
    try:
        data = own_files.read(path, LARGEST)
        return place_aside(path, str(parse_json(data)["key"])) if _is_intact(data) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def set_aside(path: Path, place: Path) -> None:
    """Copy a state file, so that it can be replaced. Raises OSError; the file is then unchanged."""
    own_files.write(place, own_files.read(path, LARGEST))


def save(session: Session, path: Path, saved_at: float, learning: Mapping[str, Any] | None = None) -> None:
    """Write a session, and plain values with it. Time off begins at the wall-clock time `saved_at` [s since 1970]; values that
    were read from a state file keep the time of their learning.

    Raises
    ------
    OSError
        If the file cannot be written; an older one is then unchanged.
    """
    own_files.write(path, content(session, saved_at, learning))


def content(session: Session, saved_at: float, learning: Mapping[str, Any] | None = None) -> bytes:
    """Content of a state file, sealed; see `save`."""
    arrays = _arrays(session)
    return seal(
        {
            "format": FORMAT,
            "version": VERSION,
            "key": key(session.estimator),
            "vehicle": session.estimator.vehicle.name,
            "saved_at": saved_at,
            "started": session.started,
            **{name: [float(value).hex() for value in arrays[name].ravel()] for name in FLOATS},  # bit by bit, nan too
            **{name: arrays[name].ravel().tolist() for name in INTEGERS},
            **({} if learning is None else {LEARNING: {LEARNED_AT: saved_at, **learning}}),
        }
    )


def seal(content: dict[str, Any]) -> bytes:
    """The content as JSON, ending in a digest of the rest."""
    body = json.dumps({name: value for name, value in content.items() if name != "sha256"})[:-1].encode()
    return body + f', "sha256": "{hashlib.sha256(body).hexdigest()}"}}'.encode()


def read_learning(estimator: Estimator, path: Path) -> Any:
    """Plain values saved with a session; None without any.

    Raises
    ------
    InputError
        As `resume`.
    """
    return _read(estimator, path).get(LEARNING)


def leftovers(path: Path) -> list[Path]:
    """Partial state files of interrupted writes."""
    path = Path(os.path.realpath(path))
    return list(path.parent.glob(f"{glob.escape(path.name)}*{own_files.PART}"))


def resume(estimator: Estimator, path: Path) -> Session:
    """Resume a session exactly where it stopped, for the same stream of messages.

    Raises
    ------
    InputError
        If the file is missing, damaged, of another version or of another vehicle; the message says which.
    """
    session = estimator.session()
    _read_state(session, path)
    return session


def after_time_off(estimator: Estimator, path: Path, wall_s: float, ambient: float | None = None) -> tuple[Session, float]:
    """Begin a new session with belts that have cooled since the file was written; return it and the time since then [s].

    Parameters
    ----------
    wall_s
        Wall-clock time [s since 1970]. A clock before `saved_at` means no time off; the returned time is negative.
    ambient
        Ambient temperature while off [degC]; by default the last known, else the vehicle file's.

    Raises
    ------
    InputError
        As `resume`.
    """
    session = estimator.session()
    saved_at = _read_state(session, path)
    off_s = wall_s - saved_at
    return rest_session(session, off_s, ambient), off_s


def rest_session(old: Session, seconds: float, ambient: float | None = None) -> Session:
    """A new session with the belts of another, cooled for some time [s] as in `after_time_off`; of a reset one, the air."""
    estimator, session = old.estimator, old.estimator.session()
    if old.started:
        session.begin(estimator.rest(old.state, ambient, min(max(0.0, seconds), LONGEST_OFF)))
    elif old.has_past:
        motion, air = layout.Motion(session.motion), layout.Motion(old.motion).air
        motion.started, motion.air = layout.START_COLD, air if ambient is None else ambient
    return session


def _arrays(session: Session) -> dict[str, NDArray[Any]]:
    memory = session.memory
    arrays = session.belts, session.motion, session.effects, session.learned
    floats = memory.values, memory.followed, memory.tracked, memory.runs
    return dict(zip((*FLOATS, *INTEGERS), (*arrays, *floats, memory.times, memory.counters, memory.reasons), strict=True))


def _read_state(session: Session, path: Path) -> float:
    """Fill a new session from a state file; returns when it was saved [s since 1970]."""
    place = f"state file {path}"
    content = _read(session.estimator, path)
    try:
        for name, array in _arrays(session).items():
            hex_values = content[name]
            if not isinstance(hex_values, list) or len(hex_values) != array.size:
                raise ValueError(f"{name} of another length")
            numbers = [read_float(text) for text in hex_values] if name in FLOATS else [_integer(text) for text in hex_values]
            array[:] = np.array(numbers, dtype=array.dtype).reshape(array.shape)
        saved_at = read_time(content["saved_at"], "saved_at")
        if content["started"] is not session.started:
            raise ValueError("started does not fit the motion")
        check_state(session.estimator, session.belts, session.motion)
        check_effects(session.effects)
        check_learned(session.estimator, session.learned)
        check_memory(session.memory, session.estimator.constants.channel_limits)
    except KeyError as error:
        raise InputError(place, f"no {error.args[0]}", "a complete file written by this program", REMEDY) from error
    except (TypeError, ValueError, OverflowError) as error:
        hex_values = f"inconsistent numbers: {str(error)[:80]}"
        raise InputError(place, hex_values, "the state of a vehicle in this program's format", REMEDY) from error
    return saved_at


def read_time(value: object, name: str) -> float:
    """A time of saving or learning [s since 1970]. Raises ValueError if it is none."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= FARTHEST_SAVED_AT:
        raise ValueError(f"{name} is no time")
    return float(value)


def read_float(text: str) -> float:
    """A number, bit by bit. Raises TypeError or ValueError if it is not as this program writes it."""
    value = float.fromhex(text)
    if value.hex() != text:  # more than is written can be read: "abc" is 2748
        raise ValueError("a number in another notation than this program's")
    return value


def _integer(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError("a count or time that is not a whole number")
    return value


def _is_intact(data: bytes) -> bool:
    match = SEAL.search(data)
    return match is not None and hashlib.sha256(data[: match.start()]).hexdigest().encode() == match.group(1)


def _read(estimator: Estimator, path: Path) -> dict[str, Any]:
    """Read a state file: nothing of it is used unless its seal is intact."""
    place, complete = f"state file {path}", "a complete file written by this program"
    try:
        data = own_files.read(path, LARGEST)
    except OSError as error:
        raise InputError(place, error.strerror or str(error), "a file written by this program") from error
    if _is_other_head(data[: len(HEAD)]):
        raise InputError(place, "another kind of file", f"a file of format {FORMAT}", REMEDY)
    try:
        content: dict[str, Any] = parse_json(data)
    except ValueError as error:
        raise InputError(place, "a damaged file", complete, REMEDY) from error
    version = content.get("version")
    if version != VERSION:
        found_version = f"version {version}" if isinstance(version, int) and 0 <= version < 1000 else "no version"
        raise InputError(place, found_version, f"version {VERSION}", REMEDY)
    if not _is_intact(data):
        raise InputError(place, "a damaged file: its checksum does not match", complete, REMEDY)
    if content.get("key") != key(estimator):
        raise InputError(
            place,
            f"a state of vehicle {str(content.get('vehicle'))[:80]}, or with other values in its file",
            f"a state of this vehicle, {estimator.vehicle.name}",
            REMEDY,
        )
    return content
