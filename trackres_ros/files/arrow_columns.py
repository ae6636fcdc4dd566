# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Columns of numbers between numpy and pyarrow, by their buffers: pyarrow's own conversions import pandas where it is installed,
which takes longer than reading or writing most files.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def as_arrow(column: NDArray[Any]) -> Any:
    """A pyarrow array of a column of numbers or texts, with no value where it is nan."""
    import pyarrow as pa

    if column.dtype.kind not in "fiu":
        return pa.array(column, from_pandas=True)
    has_value = ~np.isnan(column)
    bits = None if has_value.all() else pa.py_buffer(np.packbits(has_value, bitorder="little"))
    data = pa.py_buffer(np.ascontiguousarray(column))
    return pa.Array.from_buffers(pa.from_numpy_dtype(column.dtype), len(column), [bits, data])


def as_numpy(column: Any) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """The numbers of a pyarrow array of ``float64`` or ``int64``, and whether there is one, each of shape (n,).

    A missing number is nan, or 0 in a column of ``int64``.
    """
    import pyarrow as pa

    kind, missing_value = (np.int64, 0) if pa.types.is_integer(column.type) else (np.float64, np.nan)
    if not len(column):
        return np.empty(0, kind), np.empty(0, np.bool_)
    bits, data = column.buffers()
    rows = slice(column.offset, column.offset + len(column))
    values = np.frombuffer(data, kind)[rows]
    if bits is None:
        return values, np.ones(len(values), np.bool_)
    has_value = np.unpackbits(np.frombuffer(bits, np.uint8), bitorder="little")[rows].astype(np.bool_)
    return np.where(has_value, values, missing_value), has_value
