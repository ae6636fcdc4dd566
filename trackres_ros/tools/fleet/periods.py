# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Diagnoses each vehicle by month, on a few representative recordings, with the engine of the analysis."""

import hashlib
import tempfile
import warnings
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from trackres_ros.errors import InputError, one_line
from trackres_ros.files.documents import parse_json
from trackres_ros.files.file_sets import file_set, settle
from trackres_ros.files.own_files import read, remove, write
from trackres_ros.tools.engine import engine, failure_text, run_pieces
from trackres_ros.tools.fleet.dataset import FleetDataset
from trackres_ros.tools.fleet.recordings import is_there
from trackres_ros.tools.fleet.task import NO_DAY, check_unchanged, local_copies, may_pass
from trackres_ros.tools.fleet.trends import without_copies, without_overlaps
from trackres_ros.tools.fleet.vehicles import Fleet, FleetVehicle

DIAGNOSES, INPUTS, REASON, REPORT = "diagnosis", "inputs.txt", "reason.txt", "report.json"
MOST_BYTES = 1 << 26  # of a report
RECORDINGS = 4  # of a period that are diagnosed: three are fitted, one is held out; evenly over it
Bar = Callable[[str, float | None], AbstractContextManager[Callable[[float], None]]]


@dataclass(frozen=True, slots=True)
class Period:
    """A diagnosis to do: all recordings of one vehicle and month, and a digest of all inputs."""

    vehicle: FleetVehicle
    month: str
    urls: tuple[str, ...]
    hide: tuple[str, ...]
    inputs: str

    @property
    def place(self) -> str:
        """Folder of the result below that of the diagnoses."""
        return f"{quote(self.vehicle.name, safe='')}/{self.month}"


def refuse_replaced(folder: Path, fleet: Fleet) -> None:
    """Raise InputError if a vehicle file is that of a diagnosis in this folder: the run would replace it."""
    ours = (folder / DIAGNOSES).resolve()
    for vehicle in fleet.vehicles.values():
        if vehicle.file.is_relative_to(ours):
            allowed = f"a file outside of {folder / DIAGNOSES}, whose reports a run replaces"
            raise InputError(f"file of {vehicle.name}", str(vehicle.file), allowed, "copy its folder to another place")


def diagnose_periods(
    dataset: FleetDataset, fleet: Fleet, urls: Container[str], address: str, workers: int | None, hide: tuple[str, ...], bar: Bar
) -> list[str]:
    """Make missing or outdated diagnoses; an impossible one has a reason instead of a report.

    `urls`: the recordings that this run found. Returns a sentence for each report that could not be made anew, and stays.
    """
    new = [period for period in periods(dataset, fleet, urls, hide) if not _is_kept(dataset.folder, period)]
    if not new:
        return []
    messages = []
    with bar("diagnoses", len(new)) as advance, engine(address, workers) as client:
        for period, result in run_pieces(client, diagnose_period, new):
            place = dataset.folder / DIAGNOSES / period.place
            if isinstance(result, BaseException) and (place / REPORT).is_file():
                messages.append(f"{place}: the report is still the earlier one ({failure_text(result)})")
            elif isinstance(result, BaseException):  # no fault of the recordings: it is tried again the next time
                _put(dataset.folder, replace(period, inputs=""), {REASON: one_line(failure_text(result)).encode()})
            else:
                _put(dataset.folder, period, result)
            advance(1)
    return messages


def periods(dataset: FleetDataset, fleet: Fleet, urls: Container[str], hide: tuple[str, ...]) -> list[Period]:
    """Vehicles and months of the recordings that this run found; where none is left the report stays as it is."""
    columns = ["url", "vehicle", "day", "status", "start_s", "duration_s", "content", "copy_of", "inputs"]
    rows, _ = without_overlaps(without_copies(dataset.rows(columns))[0])
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        if row["status"] == "good" and row["day"] != NO_DAY and row["vehicle"] in fleet.vehicles:
            groups.setdefault((row["vehicle"], row["day"][:7]), []).append(row)
    result = []
    for (name, month), group in sorted(groups.items()):
        if any(row["url"] in urls for row in group):
            # Of all rows: a deleted recording still has its row, so that its month is not diagnosed again without it.
            digest = hashlib.sha256("\0".join(f"{row['content']} {row['inputs']}" for row in group).encode()).hexdigest()
            result.append(Period(fleet.vehicles[name], month, tuple(row["url"] for row in group), hide, digest))
    return result


def _sample(urls: Sequence[str]) -> list[str]:
    """Some recordings, evenly over those that are still there. Raises OSError without any."""
    while urls:
        sample = [urls[i] for i in np.unique(np.linspace(0, len(urls) - 1, RECORDINGS).round().astype(int))]
        missing = [url for url in sample if not is_there(url)]
        if not missing:
            return sample
        urls = [url for url in urls if url not in missing]
    raise FileNotFoundError("all recordings of this month are gone")


def diagnose_period(period: Period) -> dict[str, bytes]:
    """The files of a report by their places in its folder, or the reason for none.

    Raises any exception that is no fault of the recordings.
    """
    import trackres_ros as tr

    vehicle = period.vehicle
    check_unchanged(vehicle)
    with tempfile.TemporaryDirectory(prefix="trackres-") as folder, local_copies(_sample(period.urls)) as paths:
        try:
            result = tr.diagnose(paths, vehicle.file, topics=vehicle.topics, hide=period.hide, quick=True)
        except InputError as error:
            if may_pass(error):
                raise
            return {REASON: str(error).encode()}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a page that cannot be drawn: the command checked earlier
            result.report(Path(folder) / "report")
        report = Path(folder) / "report"
        return {path.relative_to(report).as_posix(): path.read_bytes() for path in report.rglob("*") if path.is_file()}


def verdicts(folder: Path, rows: Iterable[Mapping[str, Any]]) -> dict[str, dict[str, dict[str, str]]]:
    """By vehicle and month: status, sentence, and the page relative to the folder of the fleet.

    `rows`: without copies. A report of recordings that are another vehicle's now is not shown; deleted ones keep their rows.
    """
    result: dict[str, dict[str, dict[str, str]]] = {}
    present = {(quote(row["vehicle"], safe=""), (row["day"] or "")[: len("2025-06")]) for row in rows}
    for inputs in sorted((folder / DIAGNOSES).glob(f"*/*/{INPUTS}")):
        place = inputs.parent
        if (place.parent.name, place.name) not in present:
            continue
        report = place / REPORT
        if report.is_file():
            page = place / "report.html"
            verdict = {**_verdict(report), "page": page.relative_to(folder).as_posix() if page.is_file() else ""}
        else:
            verdict = {"status": "refused", "text": (place / REASON).read_text(encoding="utf-8", errors="replace"), "page": ""}
        result.setdefault(place.parent.name, {})[place.name] = verdict
    return result


def _verdict(report: Path) -> dict[str, str]:
    try:
        verdict = parse_json(read(report, MOST_BYTES))["verdict"]
        return {"status": str(verdict["status"]), "text": str(verdict["sentence"])}
    except (OSError, ValueError, KeyError, TypeError) as error:
        text = f"{report} is damaged ({type(error).__name__}: {error}); delete {report.parent} to diagnose it again"
        return {"status": "refused", "text": text}


def _is_kept(folder: Path, period: Period) -> bool:
    file = folder / DIAGNOSES / period.place / INPUTS
    return file.is_file() and file.read_bytes() == period.inputs.encode()


def _put(folder: Path, period: Period, files: Mapping[str, bytes]) -> None:
    """Write the files of a report in place of all that are there."""
    place = folder / DIAGNOSES / period.place
    new = {place / name: content for name, content in {**files, INPUTS: period.inputs.encode()}.items()}
    settle(place)
    with file_set():
        for path, content in new.items():
            write(path, content)
        for path in place.rglob("*"):
            if path not in new and not path.is_dir():
                remove(path)
