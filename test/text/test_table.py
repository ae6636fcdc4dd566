# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tables of plain text: the same whoever reads them, each row a whole line."""

import pytest

from trackres_ros.text import table


@pytest.mark.parametrize("variables", [{}, {"COLUMNS": "20", "FORCE_COLOR": "1"}, {"TERM": "dumb"}])
def test_rows_are_whole_lines_on_any_terminal(monkeypatch, variables):
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    long = "a" * 300
    assert table([("1", "2000", "[b]x"), ("10", "2.3", long)], ("", "time\ns", "text"), indent=2).splitlines() == [
        "      time",
        f"         s  {'text':>300}",
        f"   1  2000  {'[b]x':>300}",
        f"  10   2.3  {long}",
    ]


def test_texts_stand_to_the_left_and_a_head_may_be_missing():
    assert table([("wheel loads", "2000, 23 N"), ("hinge", "2 m")], numbers=False).splitlines() == [
        "wheel loads  2000, 23 N",
        "hinge        2 m",
    ]
