# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes numbers for people: no more figures than matter, plain below a million, and no zero with a sign."""

import math
from collections.abc import Sequence
from itertools import pairwise

PLAIN_BELOW = 1e6
PLAIN_FROM = 1e-4
MOST_FIGURES = 6
MISSING = "-"


def figures(value: float | None, count: int = 3) -> str:
    """A number with at most so many figures: ``1650``, ``0.565``, ``0``; a dash for nan."""
    if value is None or math.isnan(value):
        return MISSING
    text = f"{value:.{count}g}"
    rounded = float(text)
    if rounded == 0.0:
        return "0"
    return f"{rounded:.0f}" if "e+" in text and abs(value) < PLAIN_BELOW else text


def decimals(value: float | None, places: int = 0, signed: bool = False) -> str:
    """A number with so many decimals, with a sign even if positive on request; a zero has none."""
    if value is None or math.isnan(value):
        return MISSING
    text = f"{value:{'+' if signed else ''}.{places}f}"
    return f"{0.0:.{places}f}" if float(text) == 0.0 else text


def on_scale(value: float, span: float) -> str:
    """A number with the resolution relevant on a scale of a `span`: of 1.9e-7 on a scale from -1 to 1 that is ``0``."""
    if not (math.isfinite(value) and math.isfinite(span) and span > 0.0):
        return figures(value)
    step = 10.0 ** (_exponent(span) - 2)
    return figures(round(value / step) * step, MOST_FIGURES)


def alike(values: Sequence[float | None], difference: float, count: int = 2) -> list[str]:
    """Numbers to one and the same step, so that a `difference` of them shows with `count` figures.

    A value and the ends of its interval, or the edges of bins, are then written alike: ``0.30``, ``0.24``, ``0.36``.
    """
    size = max((abs(v) for v in values if v is not None and math.isfinite(v)), default=0.0)
    if not (math.isfinite(difference) and difference > 0.0 and size > 0.0):
        return [figures(v) for v in values]
    places = min(count - 1 - _exponent(difference), MOST_FIGURES - 1 - _exponent(size))
    if not PLAIN_FROM <= size < PLAIN_BELOW:
        return [figures(v, max(1, places + 1 + _exponent(size))) for v in values]
    return [
        MISSING if v is None or math.isnan(v) else decimals(round(v, places) if math.isfinite(v) else v, max(0, places))
        for v in values
    ]


def from_to(low: float, high: float) -> str:
    """A range, such as that of a bin: ``4 to 199``."""
    return " to ".join(on_scale(end, high - low) for end in (low, high))


def number_of(count: int, one: str, more: str = "") -> str:
    """A count and what it counts: ``1 gap``, ``2 gaps``; `more`: the plural, if it is not made by an s."""
    return f"{count} {one if count == 1 else more or one + 's'}"


def some_of(names: Sequence[str], most: int = 8) -> str:
    """Names in a row, of many the first few and how many more."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def rising(values: Sequence[float]) -> list[str]:
    """Rising numbers, such as the edges of bins: each with the figures that tell it from its neighbours, at most four."""
    apart = [0.0, *(b - a for a, b in pairwise(values)), 0.0]
    nearest = [min((distance for distance in pair if distance > 0.0), default=0.0) for pair in pairwise(apart)]
    return [figures(round(v, 1 - _exponent(distance)) if distance else v, 4) for v, distance in zip(values, nearest, strict=True)]


def _exponent(value: float) -> int:
    return math.floor(math.log10(value))
