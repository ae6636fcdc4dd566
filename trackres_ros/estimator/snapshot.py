# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Saves a session and resumes it: versioned, keyed to the vehicle, written atomically.

Resumed in the same stream of messages, a session gives the same bits as an uninterrupted one. After time switched off, the
belts have cooled. The guards restart, as stamps and clocks may differ.
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
from numpy.typing import NDArray

from trackres_ros import checks
from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator, Session
from trackres_ros.estimator.plausible_state import check_effects, check_learned, check_memory, check_state
from trackres_ros.estimator.records import LONGEST_STEP_S
from trackres_ros.files import own_files
from trackres_ros.files.documents import parse_json

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
        {one.name: getattr(vehicle, one.name) for one in fields(vehicle) if one.name not in NOT_IN_KEY},
        estimator.channels,
        estimator.columns,
        at.BELT_COLUMNS,
        at.Motion.columns,
        at.Learned.columns,
        values,
        [[(active.effect.name, dict(active.values)) for active in some] for some in (vehicle.effects, vehicle.surroundings)],
        hashlib.sha256(estimator.constants.route_places.tobytes()).hexdigest(),
    ]
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=_plain).encode()).hexdigest()[:32]


def _plain(part: Any) -> Any:
    if is_dataclass(part) and not isinstance(part, type):
        return asdict(part)
    return dict(part) if isinstance(part, Mapping) else part.tolist()


def state_file(path: str | PathLike[str], where: str) -> Path:
    """The path, if a state can be saved there.

    Raises InputError for no such folder, or something in its place that is not a state file; `where` names the argument.
    """
    file = checks.path(path, where)
    if not file.parent.is_dir() or (file.exists() and not file.is_file()):
        raise InputError(where, str(file), "a file in a folder that exists")
    try:
        if file.exists() and is_other_kind(file):
            raise InputError(where, f"{file}, which is another kind of file", "a new file, or a state file to replace")
    except OSError as error:
        raise InputError(where, f"{file}: {error.strerror}", "a new file, or a state file to replace") from error
    return file


def is_other_kind(file: Path) -> bool:
    """Whether a file is none that a state may replace. A damaged state is one, and so is what a power cut leaves: nothing, or
    zeros.

    Raises OSError if it cannot be read.
    """
    with file.open("rb") as now:
        return _is_other_head(now.read(len(HEAD)))


def _is_other_head(head: bytes) -> bool:
    return head not in (HEAD, bytes(len(head)))


def place_aside(path: Path, of_key: str) -> Path:
    """Where a state file that was not used is kept, by the key of its vehicle: beside it, and one for each key."""
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
    _take(session, path)
    return session


def after_time_off(estimator: Estimator, path: Path, now: float, ambient: float | None = None) -> tuple[Session, float]:
    """Begin a new session with belts that have cooled since the file was written; return it and the time since then [s].

    Parameters
    ----------
    now
        Wall-clock time [s since 1970]. A clock before `saved_at` means no time off; the returned time is negative.
    ambient
        Ambient temperature while off [degC]; by default the last known, else the vehicle file's.

    Raises
    ------
    InputError
        As `resume`.
    """
    before = estimator.session()
    saved_at = _take(before, path)
    since = now - saved_at
    return rested(before, since, ambient), since


def rested(before: Session, seconds: float, ambient: float | None = None) -> Session:
    """A new session with the belts of another, cooled for some time [s] as in `after_time_off`; of a reset one, the air."""
    estimator, session = before.estimator, before.estimator.session()
    if before.started:
        session.begin(estimator.rest(before.state, ambient, min(max(0.0, seconds), LONGEST_OFF)))
    elif before.has_past:
        motion, air = at.Motion(session.motion), at.Motion(before.motion).air
        motion.started, motion.air = at.START_COLD, air if ambient is None else ambient
    return session


def _arrays(session: Session) -> dict[str, NDArray[Any]]:
    memory = session.memory
    carried = session.belts, session.motion, session.effects, session.learned
    floats = memory.values, memory.followed, memory.tracked, memory.runs
    return dict(zip((*FLOATS, *INTEGERS), (*carried, *floats, memory.times, memory.counters, memory.reasons), strict=True))


def _take(session: Session, path: Path) -> float:
    """Fill a new session from a state file; returns when it was saved [s since 1970]."""
    where = f"state file {path}"
    content = _read(session.estimator, path)
    try:
        for name, array in _arrays(session).items():
            given = content[name]
            if not isinstance(given, list) or len(given) != array.size:
                raise ValueError(f"{name} of another length")
            numbers = [read_float(one) for one in given] if name in FLOATS else [_integer(one) for one in given]
            array[:] = np.array(numbers, dtype=array.dtype).reshape(array.shape)
        saved_at = read_time(content["saved_at"], "saved_at")
        if content["started"] is not session.started:
            raise ValueError("started does not fit the motion")
        check_state(session.estimator, session.belts, session.motion)
        check_effects(session.effects)
        check_learned(session.estimator, session.learned)
        check_memory(session.memory, session.estimator.constants.channel_limits)
    except KeyError as error:
        raise InputError(where, f"no {error.args[0]}", "a complete file written by this program", REMEDY) from error
    except (TypeError, ValueError, OverflowError) as error:
        given = f"inconsistent numbers: {str(error)[:80]}"
        raise InputError(where, given, "the state of a vehicle in this program's format", REMEDY) from error
    return saved_at


def read_time(given: object, name: str) -> float:
    """A time of saving or learning [s since 1970]. Raises ValueError if it is none."""
    if isinstance(given, bool) or not isinstance(given, int | float) or not abs(given) <= FARTHEST_SAVED_AT:
        raise ValueError(f"{name} is no time")
    return float(given)


def read_float(given: str) -> float:
    """A number, bit by bit. Raises TypeError or ValueError if it is not as this program writes it."""
    value = float.fromhex(given)
    if value.hex() != given:  # more than is written can be read: "abc" is 2748
        raise ValueError("a number in another notation than this program's")
    return value


def _integer(given: Any) -> int:
    if isinstance(given, bool) or not isinstance(given, int):
        raise TypeError("a count or time that is not a whole number")
    return given


def _is_intact(data: bytes) -> bool:
    found = SEAL.search(data)
    return found is not None and hashlib.sha256(data[: found.start()]).hexdigest().encode() == found.group(1)


def _read(estimator: Estimator, path: Path) -> dict[str, Any]:
    """Read a state file: nothing of it is used unless its seal is intact."""
    where, whole = f"state file {path}", "a complete file written by this program"
    try:
        data = own_files.read(path, LARGEST)
    except OSError as error:
        raise InputError(where, error.strerror or str(error), "a file written by this program") from error
    if _is_other_head(data[: len(HEAD)]):
        raise InputError(where, "another kind of file", f"a file of format {FORMAT}", REMEDY)
    try:
        content: dict[str, Any] = parse_json(data)
    except ValueError as error:
        raise InputError(where, "a damaged file", whole, REMEDY) from error
    version = content.get("version")
    if version != VERSION:
        given = f"version {version}" if isinstance(version, int) and 0 <= version < 1000 else "no version"
        raise InputError(where, given, f"version {VERSION}", REMEDY)
    if not _is_intact(data):
        raise InputError(where, "a damaged file: its checksum does not match", whole, REMEDY)
    if content.get("key") != key(estimator):
        raise InputError(
            where,
            f"a state of vehicle {str(content.get('vehicle'))[:80]}, or with other values in its file",
            f"a state of this vehicle, {estimator.vehicle.name}",
            REMEDY,
        )
    return content
