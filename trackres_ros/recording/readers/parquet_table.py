# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads Parquet tables in blocks."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackres_ros.errors import InputError
from trackres_ros.files.arrow_columns import as_numpy
from trackres_ros.recording.channel_file import (
    CHUNK_ROWS,
    SEEN_CELLS,
    Channel,
    ChannelRows,
    ChosenChannel,
    TableFile,
    check_dates,
    time_note,
)
from trackres_ros.recording.opening import FileKind
from trackres_ros.recording.samples import Finding
from trackres_ros.recording.text_times import NO_ZONE
from trackres_ros.units import NANOSECOND

BUFFER_BYTES = 2**20
"""Read at once of a column; without it, and with buffering ahead, pyarrow holds a whole row group: possibly the whole file."""
TICKS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
"""Of timestamps [s]: those that do not fit in 64 bits as nanoseconds are refused as seconds, with their row."""


class ParquetTable(TableFile):
    """A Parquet file; see `ChannelFile`."""

    def __init__(self, path: Path, name: str) -> None:
        self.name, self._path = name, path
        with self._file() as file:
            self.channels = [Channel(name) for name in file.schema_arrow.names]

    def _file(self) -> Any:
        """Open the file with pyarrow, which has no type annotations."""
        from pyarrow import parquet

        return parquet.ParquetFile(self._path, buffer_size=BUFFER_BYTES, pre_buffer=False, page_checksum_verification=True)

    def is_number(self, place: int) -> bool:
        """Whether a column is one of numbers."""
        with self._file() as file:
            return _is_number(file.schema_arrow.field(place).type)

    def first_cells(self, place: int) -> Sequence[Any]:
        """The first cells of a column with a value."""
        import pyarrow as pa

        with self._file() as file:
            kind = file.schema_arrow.field(place).type
            if not (_is_number(kind) or pa.types.is_timestamp(kind)):
                return ()
            batch = next(
                file.iter_batches(batch_size=SEEN_CELLS, columns=[file.schema_arrow.names[place]], use_threads=False), None
            )
        if batch is None:
            return ()
        cells = batch.column(0).drop_null()
        return list((cells.cast(pa.timestamp("us"), safe=False) if pa.types.is_timestamp(kind) else cells).to_pylist())

    def settle(self, time: ChosenChannel | None, channels: Sequence[ChosenChannel]) -> None:
        """Choose the columns to read; their types give the notation."""
        import pyarrow as pa

        assert time is not None
        with self._file() as file:
            schema = file.schema_arrow
        self._read = [schema.names[place] for place in (time.place, *(column.place for column in channels))]
        kinds = [schema.field(column.place).type for column in (time, *channels)]
        self._dates = pa.types.is_timestamp(kinds[0])
        for name, kind in list(zip(self._read, kinds, strict=True))[self._dates :]:
            if not (_is_number(kind) or pa.types.is_boolean(kind) or pa.types.is_null(kind)):
                allowed = f"a column of {'timestamps' if time.dates_only else 'numbers or timestamps'}"
                raise InputError(f"{self.name}: {name}", str(kind), allowed if name == time.name else "a column of numbers")
        check_dates(time, self.name, self._dates)
        self._scale = time.binding.scale
        if self._dates:
            self.notes = (time_note(time.name, f"timestamps {'with a time zone' if kinds[0].tz else NO_ZONE}"),)

    def streams(self) -> Sequence[Iterator[ChannelRows]]:
        """The rows of the file."""
        return [self._rows()]

    def _rows(self) -> Iterator[ChannelRows]:
        """Read the file."""
        with self._file() as file:
            count, empty_counts = 0, np.zeros(len(self._read), np.int64)
            for batch in file.iter_batches(batch_size=CHUNK_ROWS, columns=self._read, use_threads=False):
                rows = _rows_of(batch, self._read, self._scale)
                count += len(rows.time)
                empty_counts += [np.count_nonzero(~rows.has_time), *np.count_nonzero(~rows.has_value, axis=0)]
                yield rows
            self.findings = tuple(_look_at_counts(file.metadata, self._read, count, empty_counts))


def _is_number(kind: Any) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_decimal(kind))


def _rows_of(batch: Any, names: Sequence[str], scale: float) -> ChannelRows:
    """Rows of an Arrow batch, time first."""
    import pyarrow as pa

    first_column, *other_columns = (batch.column(name) for name in names)
    cells, has_value = zip(*(as_numpy(column.cast(pa.float64(), safe=False)) for column in other_columns), strict=True)
    return ChannelRows(*_times(first_column, scale), np.stack(cells, axis=1), np.stack(has_value, axis=1))


def _times(column: Any, scale: float) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Times as `ChannelRows` has them, and which are given; whole nanoseconds stay exact where float64 would round them."""
    import pyarrow as pa

    dates = pa.types.is_timestamp(column.type)
    with suppress(pa.ArrowInvalid):
        return as_numpy(column.cast(pa.timestamp("ns", "UTC")).cast(pa.int64()) if dates else column.cast(pa.float64()))
    with suppress(pa.ArrowInvalid):
        if scale == NANOSECOND and pa.types.is_integer(column.type):
            return as_numpy(column.cast(pa.int64()))
    times, has_value = as_numpy((column.cast(pa.int64()) if dates else column).cast(pa.float64(), safe=False))
    return (times * TICKS_S[column.type.unit] if dates else times), has_value


def _look_at_counts(metadata: Any, names: Sequence[str], rows: int, empty_counts: NDArray[np.int64]) -> Iterator[Finding]:
    """Compare the read content of a Parquet file with the file's own statement."""
    groups = [metadata.row_group(number) for number in range(metadata.num_row_groups)]
    stated_rows = max(metadata.num_rows, sum(group.num_rows for group in groups))
    if stated_rows > rows:
        yield Finding("", "missing", stated_rows - rows, float("nan"), f"{stated_rows - rows} rows fewer than the file declares")
    places = {metadata.schema.column(place).path: place for place in range(metadata.num_columns)}
    for name, empty_count in zip(names, empty_counts.tolist(), strict=True):
        # Only of chunks that were read: pyarrow ends the process for a damaged description of another one.
        counts = [group.column(places[name]).statistics for group in groups if group.num_rows]
        if all(count is not None and count.has_null_count for count in counts):
            nan_count = empty_count - sum(count.null_count for count in counts)
            if nan_count > 0:
                text = f"{nan_count} cells of {name} are empty although the file declares values"
                yield Finding("", "missing", nan_count, float("nan"), text)


KINDS = (
    FileKind("Parquet", (".parquet",), lambda path, name, _: [ParquetTable(path, name)], (("pyarrow", "parquet"),), checked=True),
)
