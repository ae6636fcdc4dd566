# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Processes one recording on a worker of the engine: inspects it, replays it, and compares it with its vehicle."""

import hashlib
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from trackres_ros.errors import InputError, MissingExtraError, one_line
from trackres_ros.model.resistance import RESISTANCE_PARTS
from trackres_ros.tools.fleet.recordings import FoundRecording
from trackres_ros.tools.fleet.vehicles import FleetVehicle, digest
from trackres_ros.version import __version__

ROW_VERSION = 5  # raised with any change of a row's content or computation: older rows are computed again
GOOD, BROKEN, SAME = "good", "broken", "same"
AGAIN = "again"  # instead of a digest of a row's inputs: a failure may not repeat
NO_VEHICLE = NO_DAY = "none"
FIRST_DAY_S = 365.0 * 86400.0  # a clock that shows less begins at 0: its day is unknown
END_OF_DAYS_S = 253402300800.0  # the year 10000, which dates do not reach
ENERGIES = ("resistance", *RESISTANCE_PARTS, "drive")
MEGA = 1e-6


@dataclass(frozen=True, slots=True)
class Task:
    """Task of one recording; `content` is the digest of the content of a valid row."""

    url: str
    stamp: str
    vehicle: FleetVehicle
    hide: tuple[str, ...] = ()
    content: str = ""

    @property
    def inputs(self) -> str:
        """Digest of all but the recording: vehicle and topics files, settings and version."""
        parts = (self.vehicle.name, self.vehicle.sha, self.vehicle.topics_sha, *sorted(self.hide), __version__, str(ROW_VERSION))
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def broken_row(recording: FoundRecording, vehicle: str, inputs: str, reason: str) -> dict[str, Any]:
    """The row of a recording that cannot be used."""
    row = {"url": recording.url, "stamp": recording.stamp, "vehicle": vehicle, "day": NO_DAY, "inputs": inputs}
    return {**row, "status": BROKEN, "reason": one_line(reason)}


def analyse(task: Task) -> dict[str, Any]:
    """The row of one recording: a broken one is a row with its reason."""
    began = time.perf_counter()
    row = broken_row(FoundRecording(task.url, task.stamp), task.vehicle.name, AGAIN, "")
    place = task.url
    try:
        check_unchanged(task.vehicle)
        row["inputs"] = task.inputs
        with local_copies((task.url,)) as (path,):
            place = str(path)
            row |= {"content": _content(path)}
            if row["content"] == task.content:
                return {**row, "status": SAME}
            row |= _good_row(path, task, row)
            row["notes"] = [note.replace(place, task.url) for note in row["notes"]]
    except InputError as error:
        row |= {"reason": str(error).replace(place, task.url), "inputs": AGAIN if may_pass(error) else row["inputs"]}
    except (OSError, MemoryError, ImportError) as error:
        cause = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
        row |= {"reason": one_line(f"{task.url}: {cause}"), "inputs": AGAIN}
    except Exception as error:  # no recording may end a run; its error is in its row
        row["reason"] = one_line(f"{type(error).__name__}: {error} (a bug: please report it, with the file)")
    return {**row, "took_s": time.perf_counter() - began}


def check_unchanged(vehicle: FleetVehicle) -> None:
    """Raise InputError if its vehicle or topics file has changed since the run began, or cannot be read."""
    for kind, file, sha in (("vehicle", vehicle.file, vehicle.sha), ("topics", vehicle.topics, vehicle.topics_sha)):
        if file is not None and digest(file) != sha:
            problem = f"a {kind} file that was modified during the run"
            raise InputError(str(file), problem, f"an unmodified {kind} file", "run again")


def may_pass(error: BaseException | None) -> bool:
    """Whether the machine is at fault instead of the recording: a missing library or file, too little memory."""
    while error is not None:
        of_system = isinstance(error, OSError) and error.errno is not None  # those of libraries for damaged files have none
        if of_system or isinstance(error, (MissingExtraError, ImportError, MemoryError)):
            return True
        error = error.__cause__
    return False


def _good_row(path: Path, task: Task, row: dict[str, Any]) -> dict[str, Any]:
    import trackres_ros as tr
    from trackres_ros.tools.fleet.likelihood import evidence

    recording = tr.read(path, topics=task.vehicle.topics)
    start_s = recording.start_ns * 1e-9
    times = recording.time_s("speed")
    findings = [one_line(f"{f.role}: {f.text}" if f.role else f.text) for f in recording.findings]
    row |= {"start_s": start_s, "day": _day(start_s), "duration_s": float(times[-1]) if len(times) else 0.0, "findings": findings}
    fleet_vehicle, recording = task.vehicle, recording.without(task.hide)
    base_file, vehicle = _vehicle(fleet_vehicle.file, fleet_vehicle.sha)
    row |= {"vehicle_values": fleet_vehicle.values, **_replayed(recording, vehicle)}
    likelihood = asdict(evidence(recording, base_file.with_topics(recording.topics)))
    upper = np.triu_indices(len(likelihood["names"]))
    for name in ("covariance", "precision"):
        likelihood[name] = likelihood[name][upper]
    plain = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in likelihood.items()}
    return {**plain, "status": GOOD}


@lru_cache(maxsize=4)
def _vehicle(file: Path, _sha: str) -> tuple[Any, Any]:
    """The base model of a vehicle, and the vehicle itself; a worker reuses them for all recordings."""
    import trackres_ros as tr
    from trackres_ros.diagnosis.base.loading import load_base

    return load_base(file), tr.load_vehicle(file)


def _replayed(recording: Any, vehicle: Any) -> dict[str, Any]:
    """Distance, energies and, if there are belts, the warmest temperature, as from the live node."""
    import trackres_ros as tr
    from trackres_ros.estimator.energy import energy_j, steps_of

    result = tr.replay(recording, vehicle)
    step = steps_of(result.time_s, result.estimator.settings.bridge_s)
    energies = {f"{part}_mj": MEGA * energy_j(vehicle, step, result, _column(part)) for part in ENERGIES}
    belts = [float(np.nanmax(result[name])) for name in result.columns if name.startswith("belt_degc/")]
    return {
        "distance_m": result.as_dict()["drive"]["distance_m"],
        "messages": result.messages,
        **({"warmest_degc": max(belts)} if belts else {}),
        **energies,
    }


def _column(part: str) -> str:
    return {"resistance": "resistance_torque_nm", "drive": "drive_torque_nm"}.get(part, f"{part}_nm")


def _day(start_s: float) -> str:
    """The day it began [UTC]; `NO_DAY` without a valid clock."""
    return datetime.fromtimestamp(start_s, UTC).strftime("%Y-%m-%d") if FIRST_DAY_S < start_s < END_OF_DAYS_S else NO_DAY


@contextmanager
def local_copies(urls: Sequence[str]) -> Iterator[list[Path]]:
    """Recordings as local paths; remote ones are fetched, and removed afterwards."""
    with tempfile.TemporaryDirectory(prefix="trackres-") as folder:
        paths = []
        for i, url in enumerate(urls):
            if "://" not in url:
                paths.append(Path(url))
                continue
            from fsspec.core import url_to_fs

            system, path = url_to_fs(url)
            local = Path(folder) / str(i) / PurePosixPath(path).name
            local.parent.mkdir()
            system.get(path, str(local), recursive=system.isdir(path))
            paths.append(local)
        yield paths


def _content(path: Path) -> str:
    """Digest of a recording's content, independent of its name."""
    digest_sum = hashlib.sha256()
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        if file.is_file():
            with file.open("rb") as stream:
                hashlib.file_digest(stream, lambda: digest_sum)
    return digest_sum.hexdigest()
