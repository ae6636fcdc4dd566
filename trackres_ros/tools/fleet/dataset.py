# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The results of a fleet: a Parquet dataset with a row for each recording, partitioned by vehicle and day.

Each row is a separate file, put in place complete and in one step, so an interruption leaves no partial row.
Its name is a digest of the recording's place and of all inputs of the row.
"""

from __future__ import annotations

import hashlib
import io
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from trackres_ros.errors import InputError, MissingExtraError, one_line
from trackres_ros.files.own_files import PART, write
from trackres_ros.tools.fleet.recordings import ROWS
from trackres_ros.tools.fleet.task import END_OF_DAYS_S, ENERGIES, GOOD, NO_DAY

if TYPE_CHECKING:
    import pyarrow as pa

SUFFIX = ".parquet"
TEXTS = ("url", "stamp", "inputs", "content", "copy_of", "vehicle_values", "status", "reason")
NUMBERS = (
    "start_s", "duration_s", "distance_m", "warmest_degc", *(f"{part}_mj" for part in ENERGIES), "compared_s", "residual_mean",
    "residual_std", "mismatch", "held_out_file", "held_out_refit", "mean_torque", "mean_speed", "mean_weight", "mean_ambient",
    "took_s",
)  # fmt: skip
FINITE = (
    "start_s", "duration_s", "mismatch", "mean_torque", "mean_speed", "mean_weight", "mean_ambient", "compared_s",
    "residual_mean", "residual_std",
)  # fmt: skip
LOAD_RECORDED = "load_recorded"  # without a load the weight of the vehicle file is assumed
LISTS_OF_TEXT = ("names", "units", "findings", "notes")
LISTS_OF_NUMBERS = ("nominal", "std", "point", "covariance", "precision", "linear")
OF_FILE = "of_file"  # see `likelihood.Evidence`; None in rows of earlier versions
OF_PATH = ("vehicle", "day")
BATCH = 4096  # rows that are read at a time


@dataclass(frozen=True, slots=True)
class CachedRow:
    """Record of a row, to decide whether it is up to date."""

    file: Path
    stamp: str
    inputs: str
    content: str
    copy_of: str  # the recording of equal content that counts instead; empty if this one counts
    is_broken: bool

    @classmethod
    def from_row(cls, file: Path, row: Mapping[str, Any]) -> CachedRow:
        """That of a row in a file."""
        content, copy_of = (row.get(name) or "" for name in ("content", "copy_of"))
        return cls(file, row["stamp"], row["inputs"], content, copy_of, row["status"] != GOOD)


class FleetDataset:
    """The rows in a folder."""

    def __init__(self, folder: Path) -> None:
        try:
            import pyarrow  # noqa: F401
        except ImportError:
            raise MissingExtraError("trackres fleet", "pyarrow", "fleet") from None
        self.folder = folder

    @classmethod
    def existing(cls, folder: Path) -> FleetDataset:
        """That of an earlier run. Raises InputError if there is none."""
        if not (folder / ROWS).is_dir():
            raise InputError(str(folder), "no results of a fleet", "the folder that trackres fleet -o wrote")
        return cls(folder)

    def prepare(self) -> None:
        """Make the folder; remove partial files of a killed run."""
        rows = self.folder / ROWS
        rows.mkdir(parents=True, exist_ok=True)
        for leftover in rows.rglob(f"*{PART}"):
            leftover.unlink(missing_ok=True)

    def index(self) -> dict[str, CachedRow]:
        """Present rows, by the recording's URL. A run killed between writing a row and removing the old one leaves two:
        the older is removed.
        """
        rows_by_url: dict[str, CachedRow] = {}
        for file in sorted(self._files(), key=lambda path: path.stat().st_mtime_ns):
            row = self._row_in(file)
            if row is None:
                file.unlink(missing_ok=True)
                continue
            older = rows_by_url.get(row["url"])
            if older is not None:
                older.file.unlink(missing_ok=True)
            rows_by_url[row["url"]] = CachedRow.from_row(file, row)
        return rows_by_url

    def put(self, row: Mapping[str, Any], replaces: Path | None) -> Path:
        """Write a row in the place of an older one."""
        import pyarrow as pa
        from pyarrow import parquet

        place = self.folder / ROWS / f"vehicle={quote(row['vehicle'], safe='')}" / f"day={row.get('day', NO_DAY)}"
        place.mkdir(parents=True, exist_ok=True)
        hangs_on = f"{row['stamp']}\0{row.get('content', '')}\0{row['inputs']}"
        path = place / f"{_short(row['url'])}-{_short(hangs_on)}{SUFFIX}"
        table = pa.Table.from_pylist([{name: row.get(name) for name in _schema().names}], schema=_schema())
        buffer = io.BytesIO()
        parquet.write_table(table, buffer, compression="zstd")
        write(path, buffer.getvalue())
        if replaces is not None and replaces != path:
            replaces.unlink(missing_ok=True)
        return path

    def row(self, cached: CachedRow) -> dict[str, Any]:
        """One complete row."""
        row = self._row_in(cached.file)
        if row is None:
            raise InputError(str(cached.file), "a damaged row", "one that trackres fleet wrote", "run trackres fleet again")
        return row

    def _row_in(self, file: Path) -> dict[str, Any] | None:
        """The row of a file; None where the file is damaged."""
        try:
            rows = self._table([file])
        except _unreadable():
            return None
        return rows[0] if len(rows) == 1 and not unsound(rows[0]) else None

    def rows(self, columns: Sequence[str] | None = None) -> list[dict[str, Any]]:
        """All rows, with `vehicle` and `day`."""
        files = sorted(self._files())
        return [row for first in range(0, len(files), BATCH) for row in self._read(files[first : first + BATCH], columns)]

    def _read(self, files: Sequence[Path], columns: Sequence[str] | None = None) -> list[dict[str, Any]]:
        """Rows of files. A damaged file or row is skipped with a warning."""
        try:
            rows = self._table(files, columns)
        except _unreadable() as error:
            if len(files) > 1:
                return [row for file in files for row in self._read([file], columns)]
            return _left_out(str(files[0]), str(error))
        return [row for row in rows if not (reason := unsound(row)) or _left_out(row["__filename"], reason)]

    def _table(self, files: Sequence[Path], columns: Sequence[str] | None = None) -> list[dict[str, Any]]:
        import pyarrow as pa
        from pyarrow import dataset

        of_path = pa.schema([(name, pa.string()) for name in OF_PATH])
        rows = dataset.dataset(
            [str(path) for path in files],
            schema=pa.unify_schemas([_schema(), of_path]),
            format="parquet",
            partitioning=dataset.partitioning(of_path, flavor="hive"),
            partition_base_dir=str(self.folder / ROWS),
        )
        entries = rows.to_table(columns=[*(rows.schema.names if columns is None else columns), "__filename"]).to_pylist()
        return [dict(row) for row in entries]

    def _files(self) -> Iterator[Path]:
        return (self.folder / ROWS).glob(f"vehicle=*/day=*/*{SUFFIX}")


def unsound(row: Mapping[str, Any]) -> str:
    """Defect of a row, in the columns that were read; empty without one."""
    for name in ("url", "status", *OF_PATH):
        if name in row and not isinstance(row[name], str):
            return f"it has no {name}"
    if row.get("status") != GOOD:
        return ""
    if not all(math.isfinite(row[name] if row[name] is not None else math.nan) for name in FINITE if name in row):
        return "a number is missing"
    if not 0.0 <= row.get("start_s", 0.0) < END_OF_DAYS_S:
        return f"it began at {row['start_s']:g} s"
    if "names" not in row:
        return ""
    count = len(row["names"] or ())
    upper = count * (count + 1) // 2
    for name in (name for name in ("names", "units", *LISTS_OF_NUMBERS) if name in row):
        values = row[name] or ()
        if not count or len(values) != (upper if name in ("covariance", "precision") else count) or None in values:
            return f"{name} is not as long as it has to be"
        if name in LISTS_OF_NUMBERS and not all(map(math.isfinite, values)):
            return f"{name} is not finite"
    return ""


def _left_out(file: str, reason: str) -> list[dict[str, Any]]:
    warnings.warn(f"{file} is damaged ({one_line(reason)}) and skipped; trackres fleet rewrites it", stacklevel=2)
    return []


def _unreadable() -> tuple[type[Exception], ...]:
    from pyarrow import ArrowException

    return ArrowException, OSError, UnicodeDecodeError


def _schema() -> pa.Schema:
    import pyarrow as pa

    return pa.schema(
        [(name, pa.string()) for name in TEXTS]
        + [("messages", pa.int64()), (LOAD_RECORDED, pa.bool_())]
        + [(name, pa.float64()) for name in NUMBERS]
        + [(name, pa.list_(pa.string())) for name in LISTS_OF_TEXT]
        + [(name, pa.list_(pa.float64())) for name in (*LISTS_OF_NUMBERS, OF_FILE)]
    )


def _short(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]
