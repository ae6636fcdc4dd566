# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tables are read with pyarrow and without it."""

import sys

import pytest


@pytest.fixture(params=["pyarrow", "plain"])
def reader(request, monkeypatch):
    """With pyarrow, if one that fits the installed numpy can be imported; and without it."""
    if request.param == "pyarrow":
        pytest.importorskip("pyarrow", exc_type=ImportError)
        return
    for name in ["pyarrow", *(name for name in sys.modules if name.partition(".")[0] == "pyarrow")]:
        monkeypatch.setitem(sys.modules, name, None)
