# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes tables as MDF 4: one group of channels with their units, and the time as its master."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from trackres_ros.output.column_units import unit_of

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


class MdfTable(AbstractContextManager["MdfTable"]):
    """An MDF file written block by block; blocks are kept in a temporary file of asammdf.

    `path`: final file; asammdf requires the suffix .mf4; `names`: of the columns; the first is the time [s].
    """

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        from asammdf import MDF

        self._path, self._names = path, names
        self._mdf = MDF(version="4.10")
        self._mdf.header.start_time = EPOCH
        self._begun = False

    def write(self, columns: Sequence[NDArray[Any]]) -> None:
        """Write some rows, the time first."""
        from asammdf import Signal

        arrays = [column if column.dtype.kind in "fiu" else np.asarray(column, np.bytes_) for column in columns]
        if self._begun:
            self._mdf.extend(0, [(array, None) for array in arrays])
            return
        if "stamp_ns" in self._names and len(arrays[0]):
            self._mdf.header.start_time = EPOCH + timedelta(microseconds=int(columns[self._names.index("stamp_ns")][0]) // 1000)
        signals = [Signal(a, arrays[0], name=n, unit=unit_of(n)) for n, a in zip(self._names[1:], arrays[1:], strict=True)]
        self._mdf.append(signals, acq_name="trackres", comment="written by trackres", common_timebase=True)
        self._begun = True

    def __enter__(self) -> Self:
        """Begin."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Save the blocks, compressed; nothing after an exception."""
        try:
            if kind is None:
                if not self._begun:
                    self.write([np.empty(0)] * len(self._names))
                self._mdf.save(self._path, overwrite=True, compression=2)
        finally:
            self._mdf.close()
