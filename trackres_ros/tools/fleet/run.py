# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs a fleet analysis: each new recording becomes a row. One run at a time has a folder, and leaves its limits there."""

import fcntl
import json
import os
import socket
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

from trackres_ros.checks import one_of
from trackres_ros.errors import InputError
from trackres_ros.files.documents import parse_json
from trackres_ros.files.own_files import read, write
from trackres_ros.recording.roles import ROLES, base_role
from trackres_ros.tools.engine import LOCAL, dashboard, engine, failure_text, run_pieces
from trackres_ros.tools.fleet.dataset import CachedRow, FleetDataset
from trackres_ros.tools.fleet.recordings import LOCK, FoundRecording, find_recordings
from trackres_ros.tools.fleet.task import AGAIN, BROKEN, NO_VEHICLE, SAME, Task, analyse, broken_row
from trackres_ros.tools.fleet.vehicles import HIGHEST_LIMIT, Fleet

MOST_READ = 200
COMPARED = "speed", "torque"  # without them a recording cannot be used
LIMITS, MOST_LIMITS_BYTES = "fleet.json", 1 << 24
UNKNOWN = "unknown"  # instead of a digest without a vehicle


@dataclass(slots=True)
class RunCounts:
    """Results of a run; each recording that was found is kept, good or broken."""

    urls: set[str] = field(default_factory=set)
    kept: int = 0  # usable and unchanged
    good: int = 0
    broken: int = 0  # whether its row is new or not
    reason: str = ""  # of the first broken one

    @property
    def found(self) -> int:
        """How many recordings were found."""
        return len(self.urls)


def run(
    recordings: Sequence[str],
    fleet: Fleet,
    dataset: FleetDataset,
    address: str = LOCAL,
    workers: int | None = None,
    hide: tuple[str, ...] = (),
    on_begin: Callable[[int], Callable[[float], None]] = lambda _: lambda _: None,
    on_dashboard: Callable[[str], None] = lambda _: None,
) -> RunCounts:
    """Make a row for each recording that is new or has changed. Raises InputError without any recording, or engine.

    `recordings`: paths, folders, globs and URLs; `address`, `workers`: see `engine.engine`; `hide`: roles that are not read;
    `on_begin`: takes the number of tasks, and returns a function to call after each; `on_dashboard`: takes the address of the
    engine's own page, if it has one.
    """
    for channel in hide:
        one_of(base_role(channel), "--hide", [role for role in ROLES if role not in COMPARED])
    dataset.prepare()
    this_run = _Run(recordings, fleet, dataset, hide)
    counts, new = this_run.counts, this_run.tasks()
    first = next(new, None)
    if first is not None:
        advance = on_begin(this_run.how_many())
        with engine(address, workers) as client:
            if page := dashboard(client):
                on_dashboard(page)
            for row in rows(run_pieces(client, analyse, chain([first], new))):
                this_run.put(row)
                advance(1)
    this_run.mark_copies()
    if not counts.found:
        raise InputError("recordings", ", ".join(recordings), "paths, folders, globs or URLs of recordings")
    if not counts.kept + counts.good:
        raise InputError("recordings", f"{counts.broken} that cannot be used", "one at least that can", counts.reason)
    return counts


class _Run:
    """Tasks of one run, and their results."""

    def __init__(self, recordings: Sequence[str], fleet: Fleet, dataset: FleetDataset, hide: tuple[str, ...]) -> None:
        self._recordings, self._fleet, self._dataset, self._hide = recordings, fleet, dataset, hide
        self._index, self.counts = dataset.index(), RunCounts()
        prefix = f"{dataset.folder.resolve()}/"
        for url, cached in list(self._index.items()):
            # A place that could not be read may be readable now; earlier versions took results for recordings.
            if not cached.stamp or url.startswith(prefix):
                self._index.pop(url).file.unlink(missing_ok=True)

    def tasks(self) -> Iterator[Task]:
        """New and changed recordings; rows of those without a known vehicle are written at once."""
        for recording in find_recordings(self._recordings):
            self.counts.urls.add(recording.url)
            task = _task(recording, self._fleet, self._hide)
            inputs = task.inputs if isinstance(task, Task) else UNKNOWN
            cached = self._index.get(recording.url)
            if cached is not None and _is_kept(cached, recording, inputs):
                if cached.is_broken:
                    self._unusable(self._dataset.row(cached)["reason"])
                else:
                    self.counts.kept += 1
            elif isinstance(task, Task):
                yield task if cached is None or cached.inputs != inputs else replace(task, content=cached.content)
            else:
                self.put(broken_row(recording, NO_VEHICLE, UNKNOWN, task))

    def how_many(self) -> int:
        """Number of tasks, to estimate the remaining time."""
        count = 0
        for recording in find_recordings(self._recordings):
            task = _task(recording, self._fleet, self._hide)
            count += isinstance(task, Task) and not _is_kept(self._index.get(recording.url), recording, task.inputs)
        return count

    def put(self, row: dict[str, Any]) -> None:
        """Write a row into the dataset and count it."""
        cached = self._index.get(row["url"])
        is_same = row["status"] == SAME
        if is_same and cached is not None:
            row = {**self._dataset.row(cached), "stamp": row["stamp"]}
        self._index[row["url"]] = CachedRow.from_row(self._dataset.put(row, cached.file if cached else None), row)
        if row["status"] == BROKEN:
            self._unusable(row["reason"])
        elif is_same:
            self.counts.kept += 1
        else:
            self.counts.good += 1

    def _unusable(self, reason: str) -> None:
        self.counts.broken += 1
        self.counts.reason = self.counts.reason or reason

    def mark_copies(self) -> None:
        """Of recordings with equal content one counts, whatever its name and vehicle: the rows of the others name it.

        A broken one that is found stays broken: many have the same content, such as none.
        """
        by_content: dict[str, list[str]] = {}
        for url, row in self._index.items():
            by_content.setdefault(row.content or url, []).append(url)
        for urls in by_content.values():
            first, *copies = sorted(urls, key=self._rank)
            for url, copy_of in ((first, ""), *((copy, first) for copy in copies)):
                row = self._index[url]
                copy_of = "" if row.is_broken and url in self.counts.urls else copy_of
                if row.copy_of != copy_of:
                    self._dataset.put({**self._dataset.row(row), "copy_of": copy_of}, row.file)

    def _rank(self, url: str) -> tuple[object, ...]:
        """Order of recordings with equal content: found and usable, found, then the one that counted, or was written last."""
        row = self._index[url]
        if url in self.counts.urls:
            return 0, row.is_broken, url
        return 1, bool(row.copy_of), -row.file.stat().st_mtime_ns, url


def rows(results: Iterable[tuple[Task, Any]]) -> Iterator[dict[str, Any]]:
    """Rows from the engine's results."""
    for task, result in results:
        if isinstance(result, BaseException):
            yield broken_row(
                FoundRecording(task.url, task.stamp), task.vehicle.name, AGAIN, f"{task.url}: {failure_text(result)}"
            )
        else:
            yield result


def _task(recording: FoundRecording, fleet: Fleet, hide: tuple[str, ...]) -> Task | str:
    if recording.problem:
        return f"{recording.url}: {recording.problem}"
    try:
        return Task(recording.url, recording.stamp, fleet.vehicle_of(recording.url), hide)
    except InputError as error:
        return str(error)


def _is_kept(cached: CachedRow | None, recording: FoundRecording, inputs: str) -> bool:
    return cached is not None and (cached.stamp, cached.inputs) == (recording.stamp, inputs)


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder. The system frees it when the process ends, however it ends.

    Raises InputError if another run holds it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOCK).open("a+", encoding="utf-8", errors="replace") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.seek(0)
            problem = f"{folder}, in use by another run ({lock.read(MOST_READ).strip() or 'of unknown number'})"
            raise InputError("--output", problem, "a folder that no other run uses", "wait until it ends") from None
        except OSError:  # a file system without locks
            yield
            return
        with suppress(OSError):  # a full disk: the owner is only for the message
            lock.truncate(0)
            lock.write(f"process {os.getpid()} on {socket.gethostname()}\n")
            lock.flush()
        yield


def check_limits(fleet: Fleet) -> None:
    """Raise InputError if a limit is of no parameter of its vehicle."""
    from trackres_ros.diagnosis.base.loading import load_base
    from trackres_ros.tools.fleet.likelihood import parameters_of

    names: dict[Path, tuple[str, ...]] = {}
    for vehicle in fleet.vehicles.values():
        for name in vehicle.limits:
            if vehicle.file not in names:
                names[vehicle.file] = parameters_of(load_base(vehicle.file).base)
            one_of(name, f"limits of {vehicle.name}", names[vehicle.file])


def keep_limits(folder: Path, fleet: Fleet) -> None:
    """Write the limits of a fleet, and the digests of the present values of its files, by vehicle."""
    limits = {name: dict(vehicle.limits) for name, vehicle in fleet.vehicles.items() if vehicle.limits}
    values = {name: vehicle.values for name, vehicle in fleet.vehicles.items()}
    write(folder / LIMITS, (json.dumps({"limits": limits, "values": values}, indent=2) + "\n").encode())


def present_values(folder: Path) -> dict[str, str]:
    """Digests of the values of the vehicle files in the last run, by vehicle; empty where an earlier version ran."""
    try:
        content = parse_json(read(folder / LIMITS, MOST_LIMITS_BYTES))["values"]
        return {name: str(values) for name, values in content.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def limits_of(folder: Path, limits: Mapping[str, float]) -> dict[str | None, dict[str, float]]:
    """Limits of the last run by vehicle, and the given ones, which are those of all vehicles, by None; see `trends.trends`."""
    try:
        content = parse_json(read(folder / LIMITS, MOST_LIMITS_BYTES))["limits"]
        # Version 0.1.0 wrote a number by parameter for all vehicles, instead of a mapping by vehicle.
        common = _usable({name: values for name, values in content.items() if not isinstance(values, dict)})
        by_vehicle: dict[str | None, dict[str, float]] = {
            name: _usable(values) for name, values in content.items() if isinstance(values, dict)
        }
        return {**by_vehicle, None: {**common, **limits}}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {None: dict(limits)}


def _usable(limits: Mapping[str, Any]) -> dict[str, float]:
    return {str(name): float(limit) for name, limit in limits.items() if 0.0 <= float(limit) <= HIGHEST_LIMIT}
