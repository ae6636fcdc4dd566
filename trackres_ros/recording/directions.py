# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the values of a direction of travel mean: by the standards of buses, known by name, and by the names in a file."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from trackres_ros.text import words

FORWARD, REVERSE, NEUTRAL = 1.0, -1.0, 0.0
WAYS = ("forward", "reverse", "neutral")


@dataclass(frozen=True, slots=True)
class Ways:
    """Values that mean each way; without any a gear, whose sign is the way: above 0 forward, below 0 reverse, 0 neutral."""

    forward: tuple[float, ...] = ()
    reverse: tuple[float, ...] = ()
    neutral: tuple[float, ...] = ()

    def meant(self, numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        """`FORWARD`, `REVERSE` or `NEUTRAL` for each number; nan for one without a meaning, such as that of an error."""
        if not self.forward and not self.reverse:
            return np.sign(numbers)
        each = (self.forward, self.reverse, self.neutral)
        return np.select([np.isin(numbers, some) for some in each], [FORWARD, REVERSE, NEUTRAL], np.nan)


STANDARDS: Mapping[str, Ways] = MappingProxyType(
    {
        "iso_11783": Ways(forward=(1.0,), reverse=(0.0,)),  # ISO 11783-7: direction of a machine; 2 is an error, 3 no value
        "j1939": Ways(forward=(0.0,), reverse=(1.0,)),  # SAE J1939-71: direction indicator (SPN 1619), reverse switch (SPN 767)
        "gear": Ways(),  # SAE J1939-71: transmission current and selected gear (SPN 523, 524), with their offset of -125
    }
)
"""By the word for `values` in a topics file. The first two are opposite: a bus is known by the names of its signals."""
KNOWN = {
    "iso_11783": re.compile(r"\bmachine (selected )?(speed )?direction\b"),
    "j1939": re.compile(r"\bdirection indicator\b|^(veh(icle)? )?(is )?(reverse|reversing)( (flag|switch|active|engaged))?$|"
        r"\breverse direction switch\b"),
    "gear": re.compile(r"\btrans(mission)? (current|selected) gear\b|^travel direction$"),
}  # fmt: skip
"""Words in the name of a signal or column that is of a standard."""
SAYS_REVERSE = re.compile(
    r"\brevers(e|ing)\b|\bdirection (indicator|of travel)\b|\b(machine|driving|travel) direction\b|\bgear\b"
)
"""Words in the name of a column that may say when a vehicle drives backwards."""
NAMED = {"forward": r"\b(forwards?|drive)\b", "reverse": r"\b(reverse|backwards?)\b", "neutral": r"\b(neutral|park)\b"}
"""Words of the names that files give values."""


def standard_of(name: str) -> str:
    """The standard of a signal or column by its name; empty if it is none's."""
    spoken = words(name)
    return next((standard for standard, pattern in KNOWN.items() if pattern.search(spoken)), "")


def named_ways(named: Iterable[tuple[float, str]]) -> Ways | None:
    """The meaning of values by the names that a file gives them; None unless one is forward and one reverse."""
    found: dict[str, list[float]] = {way: [] for way in WAYS}
    for value, name in named:
        for way in WAYS:
            if re.search(NAMED[way], words(name)):
                found[way].append(value)
                break
    ways = Ways(*(tuple(found[way]) for way in WAYS))
    return ways if ways.forward and ways.reverse else None


def as_said(ways: Ways) -> str | dict[str, list[float]]:
    """`values` of a topics file for some ways."""
    standard = next((name for name, one in STANDARDS.items() if one == ways), "")
    return standard or {way: [float(value) for value in getattr(ways, way)] for way in WAYS if getattr(ways, way)}


def may_say_reverse(names: Iterable[str]) -> list[str]:
    """Those of some columns that may say when a vehicle drives backwards."""
    return [name for name in names if SAYS_REVERSE.search(words(name)) or standard_of(name)]
