"""Saving a session and taking it up again: versioned, keyed to the vehicle, written atomically.

Resumed in the same stream of messages a session gives the same bits as one that never stopped. Taken up after time off,
the belts have cooled and the guards start anew, as stamps and clocks may be others.
"""

from __future__ import annotations

import glob
import hashlib
import json
import math
import os
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from trackres_ros.errors import InputError
from trackres_ros.estimator import layout as at
from trackres_ros.estimator.estimator import Estimator, Session, State

FORMAT = "trackres-state"
VERSION = 3
PART = ".part"
REMEDY = "delete the file to start cold"


def key(estimator: Estimator) -> str:
    """Hash of all that a state's meaning depends on: the vehicle's values and the arrays' layout."""
    vehicle = estimator.vehicle
    values = {path: q.value for path, q in vehicle.parameters.items()}
    parts = [
        vehicle.name,
        vehicle.thermal,
        estimator.channels,
        estimator.columns,
        at.BELT_COLUMNS,
        at.MOTION_COLUMNS,
        values,
        asdict(vehicle.rubber),
        [[(active.effect.name, dict(active.values)) for active in some] for some in (vehicle.effects, vehicle.surroundings)],
    ]
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=lambda a: a.tolist()).encode()).hexdigest()[:32]


def save(session: Session, path: Path, saved_at: float) -> None:
    """Write a session. `saved_at` is the wall-clock time [s since 1970] from which the time off counts.

    Raises
    ------
    OSError
        If the file cannot be written; an older one is then left whole.
    """
    write(path, content(session, saved_at))


def content(session: Session, saved_at: float) -> str:
    """Text of a state file; see `save`."""
    return json.dumps(
        {
            "format": FORMAT,
            "version": VERSION,
            "key": key(session.estimator),
            "vehicle": session.estimator.vehicle.name,
            "saved_at": saved_at,
            "started": session.started,
            "belts": _text(session.belts),
            "motion": _text(session.motion),
            "effects": _text(session.effects),
            "values": _text(session.memory.values),
            "times": session.memory.times.tolist(),
            "counters": session.memory.counters.tolist(),
            "reasons": session.memory.reasons.tolist(),
        }
    )


def write(path: Path, text: str) -> None:
    """Write the text of a state file beside its place and move it there.

    Raises
    ------
    OSError
        If it cannot be written; an older file is then left whole.
    """
    with tempfile.NamedTemporaryFile("w", dir=path.parent, prefix=path.name, suffix=PART, delete=False, encoding="utf-8") as file:
        try:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
            Path(file.name).replace(path)
        except BaseException:
            Path(file.name).unlink(missing_ok=True)
            raise


def leftovers(path: Path) -> list[Path]:
    """Parts of a state file whose writing was cut off."""
    return list(path.parent.glob(f"{glob.escape(path.name)}*{PART}"))


def resume(estimator: Estimator, path: Path) -> Session:
    """Take a session up just where it stopped, for the same stream of messages.

    Raises
    ------
    InputError
        If the file is missing, damaged, of another version or of another vehicle; says which.
    """
    content = _read(estimator, path)
    session = estimator.session()
    session.belts[:] = _numbers(content["belts"], session.belts.shape)
    session.motion[:] = _numbers(content["motion"], session.motion.shape)
    session.effects = _numbers(content["effects"], session.effects.shape)
    session.memory.values[:] = _numbers(content["values"], session.memory.values.shape)
    session.memory.times[:] = np.array(content["times"], dtype=np.int64).reshape(session.memory.times.shape)
    session.memory.counters[:] = np.array(content["counters"], dtype=np.int64).reshape(session.memory.counters.shape)
    session.memory.reasons[:] = np.array(content["reasons"], dtype=np.int64).reshape(session.memory.reasons.shape)
    return session


def after_time_off(estimator: Estimator, path: Path, now: float, ambient: float | None = None) -> tuple[Session, float]:
    """Begin a new session with belts that have cooled since the file was written; returns it and the time off [s].

    Parameters
    ----------
    now
        Wall-clock time [s since 1970]. A clock that stands before `saved_at` counts as no time off.
    ambient
        Ambient temperature while off [degC]; by default the vehicle file's.
    """
    content = _read(estimator, path)
    session = estimator.session()
    if not content["started"]:
        return session, 0.0
    off = max(0.0, now - float(content["saved_at"]))
    state = State(
        _numbers(content["belts"], session.belts.shape),
        _numbers(content["motion"], session.motion.shape),
        _numbers(content["effects"], session.effects.shape),
    )
    ambient = estimator.vehicle.chassis.ambient if ambient is None else ambient
    session.begin(estimator.rest(state, ambient, off))
    return session, off


def _read(estimator: Estimator, path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"state file {path}", error.strerror or "an unreadable file", "a file written by this program", REMEDY
        ) from error
    except ValueError as error:
        raise InputError(f"state file {path}", "a damaged file", "a whole file written by this program", REMEDY) from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise InputError(f"state file {path}", "another kind of file", f"a file of format {FORMAT}", REMEDY)
    if content.get("version") != VERSION:
        raise InputError(f"state file {path}", f"version {content.get('version')}", f"version {VERSION}", REMEDY)
    if content.get("key") != key(estimator):
        raise InputError(
            f"state file {path}",
            f"a state of vehicle {content.get('vehicle')}, or of other values in its file",
            f"a state of this very vehicle, {estimator.vehicle.name}",
            REMEDY,
        )
    missing = {"belts", "motion", "effects", "values", "times", "counters", "reasons", "saved_at", "started"} - content.keys()
    if missing:
        raise InputError(f"state file {path}", f"no {', '.join(sorted(missing))}", "a whole file", REMEDY)
    return content


def _text(array: np.ndarray[Any, np.dtype[np.float64]]) -> list[str]:
    """Floats that come back bit by bit, nan too."""
    return [float(value).hex() for value in array.ravel()]


def _numbers(texts: list[str], shape: tuple[int, ...]) -> np.ndarray[Any, np.dtype[np.float64]]:
    try:
        values = np.array([float.fromhex(text) for text in texts]).reshape(shape)
    except (TypeError, ValueError) as error:
        raise InputError("state file", "numbers that do not fit", "a whole file", REMEDY) from error
    if math.prod(shape) and not np.isfinite(values).all() and len(shape) != 1:
        raise InputError("state file", "a temperature that is not finite", "finite temperatures", REMEDY)
    return values
