# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Columns of numbers go to pyarrow and come back as they were."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from trackres_ros.files.arrow_columns import as_arrow, as_numpy

pa = pytest.importorskip("pyarrow")

COLUMNS = st.sampled_from([np.float64, np.int64]).flatmap(lambda kind: hnp.arrays(kind, st.integers(0, 40)))


@given(COLUMNS, st.integers(0, 9), st.integers(1, 3))
def test_what_goes_to_pyarrow_comes_back(column, start, stride):
    column = column[::stride]
    array = as_arrow(column)
    array.validate(full=True)
    assert array.equals(pa.array(column, from_pandas=True))
    values, there = as_numpy(array[start:])
    np.testing.assert_array_equal(values, column[start:])
    np.testing.assert_array_equal(there, ~np.isnan(column[start:]))


def test_texts_and_missing_whole_numbers():
    assert as_arrow(np.array(["a", "b"])).to_pylist() == ["a", "b"]
    values, there = as_numpy(pa.array([1, None, 3], pa.int64()))
    assert (values.tolist(), there.tolist()) == ([1, 0, 3], [True, False, True])


def test_pandas_is_not_imported():
    used = "import sys; from trackres_ros.files.arrow_columns import *; as_numpy(as_arrow(np.array([1.0, np.nan])))"
    subprocess.run([sys.executable, "-c", f"{used}; assert 'pandas' not in sys.modules"], check=True)
