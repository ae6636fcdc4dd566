# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tables are read with pyarrow and without it."""

import sys
import tracemalloc

import pytest


@pytest.fixture(scope="session")
def peak_of():
    """`peak_of(call)`: what it returns, and the most memory that it allocated at a time [bytes]."""

    def measured(call):
        tracemalloc.start()
        try:
            return call(), tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    return measured


@pytest.fixture(params=["pyarrow", "plain"])
def reader(request, monkeypatch):
    """With pyarrow, if one that fits the installed numpy can be imported; and without it."""
    if request.param == "pyarrow":
        pytest.importorskip("pyarrow", exc_type=ImportError)
        return
    for name in ["pyarrow", *(name for name in sys.modules if name.partition(".")[0] == "pyarrow")]:
        monkeypatch.setitem(sys.modules, name, None)
