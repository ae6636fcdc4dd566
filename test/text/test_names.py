# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Names of files that people are shown."""

from pathlib import PurePath

from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.text import told_apart

PATHS = st.lists(st.sampled_from(["a", "b", "drive.csv"]), min_size=1, max_size=4).map("/".join)


@given(st.lists(PATHS, min_size=1, max_size=6))
def test_a_shown_name_is_the_shortest_that_no_other_file_has(paths):
    shown = dict(zip(paths, told_apart(paths), strict=True))
    assert len(set(shown.values())) == len(shown)
    for path, name in shown.items():
        assert PurePath(path).parts[-len(PurePath(name).parts) :] == PurePath(name).parts
        _, _, shorter = name.partition("/")
        assert not shorter or any(f"/{other}".endswith(f"/{shorter}") for other in shown if other != path)
