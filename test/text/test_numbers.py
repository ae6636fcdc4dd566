# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Laws of every number that people are shown."""

import math
import re
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.text import alike, decimals, figures, number_of, rising

NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
BELOW_A_MILLION = st.floats(-999_499.0, 999_499.0)
PACKAGE = Path(__file__).resolve().parents[2] / "trackres_ros"
FEW_FIGURES = re.compile(r":[-+ #0-9,]*\.[1-5]g\}")


def count_of(text):
    """Figures of a number in a text."""
    digits = re.sub(r"e.*", "", text).lstrip("-+")
    kept = digits.replace(".", "").lstrip("0")
    return len(kept if "." in digits else kept.rstrip("0"))


@given(NUMBERS, st.integers(1, 6))
def test_no_more_figures_than_asked_and_as_near_as_they_allow(value, count):
    text = figures(value, count)
    assert count_of(text) <= count
    assert float(text) == float(f"{value:.{count}g}")


@given(st.lists(BELOW_A_MILLION, min_size=2, max_size=8, unique=True).map(sorted))
def test_neighbours_among_rising_numbers_differ_in_few_figures(values):
    texts = rising(values)
    assert all(count_of(text) <= 4 for text in texts)
    for (a, one), (b, other) in pairwise(zip(values, texts, strict=True)):
        assert one != other or b - a < 2e-3 * max(abs(a), abs(b))


@given(BELOW_A_MILLION, st.integers(1, 6), st.integers(0, 6))
def test_below_a_million_no_power_of_ten_is_shown(value, count, places):
    for text in (figures(value, count), decimals(value, places), *alike([value], abs(value) / 10.0)):
        assert "e+" not in text


@given(NUMBERS, st.integers(1, 6), st.integers(0, 6), st.booleans())
def test_a_zero_has_no_sign(value, count, places, signed):
    for text in (figures(value, count), decimals(value, places, signed), *alike([value, 1.0], 1.0)):
        assert not re.fullmatch(r"[-+]0(\.0*)?", text)


@given(st.floats(-1e7, 1e7), st.floats(1e-6, 1e6), st.integers(2, 3))
def test_an_interval_is_told_apart_and_its_value_stands_in_it(low, width, count):
    value, high = low + 0.3 * width, low + width
    shown = [float(text) for text in alike([value, low, high], high - low, count)]
    assert shown[1] <= shown[0] <= shown[2]
    for text, given_value in zip(shown, (value, low, high), strict=True):
        assert text == pytest.approx(given_value, abs=max(0.06 * width, 1e-5 * max(abs(low), abs(high))))


def test_what_is_not_there_is_a_dash():
    assert [figures(None), figures(math.nan), decimals(None), decimals(math.nan)] == ["-"] * 4
    assert alike([None, math.nan, 2.0], 1.0) == ["-", "-", "2.0"]


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        (figures(1650.4), "1650"),
        (figures(0.56483), "0.565"),
        (figures(-1e-9, 2), "-1e-09"),
        (figures(2.1e8), "2.1e+08"),
        (decimals(-0.2), "0"),
        (decimals(0.2, signed=True), "0"),
        (decimals(66.2, signed=True), "+66"),
    ],
)
def test_examples(text, shown):
    assert text == shown


def room(path):
    """The first two folders of a module; texts of the diagnosis keep their own figures."""
    return path.relative_to(PACKAGE).parts[:-1][:2]


REASONING = [
    ("diagnosis",), *(("diagnosis", part) for part in ("prepare", "base", "inference", "selection", "findings", "writing")),
]  # fmt: skip


def test_nothing_else_writes_few_figures_by_hand():
    """`:.3g` says 1.65e+03 for 1650 and -0 for a zero; rounding that is no text is a number at once."""
    by_hand = [
        f"{path.relative_to(PACKAGE)}:{number}"
        for path in sorted(PACKAGE.rglob("*.py"))
        if path.name != "numbers.py" and room(path) not in REASONING
        for number, line in enumerate(path.read_text().splitlines(), start=1)
        if FEW_FIGURES.search(line) and "float(f" not in line
    ]
    assert by_hand == []


@given(st.integers(0, 9))
def test_only_one_thing_is_in_the_singular(count):
    assert number_of(count, "gap") == ("1 gap" if count == 1 else f"{count} gaps")
    assert number_of(count, "value is", "values are") == ("1 value is" if count == 1 else f"{count} values are")
