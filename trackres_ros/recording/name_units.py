# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds the unit that the name of a channel or topic carries: ``Speed (OBD)(km/h)``, ``weight_t``."""

import math
import re
from collections.abc import Iterator, Sequence

from trackres_ros.recording.bindings import TIME, inside_unit
from trackres_ros.recording.roles import UNIT_WORDS, UNITS, conversion, is_quantity
from trackres_ros.text import words

IN_BRACKETS = re.compile(r"[\[({]([^\[\](){}]+)[\])}]")
"""In a name: ``Geschw [km/h]``, ``Torque(Nm)``."""
SHARES = ("%", "‰")
"""Units of a share; other ones that are no quantity may be anything, such as (1)."""
OF_ONE_LETTER = "mnt"
"""Units of one letter that a name may end with; others may be anything, such as a front axle."""


def unit_in(role: str, name: str, derivative: bool = False) -> str | None:
    """The unit that a name carries; empty without one, None if it has brackets with that of another quantity, or ends with it."""
    si_unit = inside_unit(role, derivative)
    bracketed_text = bracketed_unit(name)
    if bracketed_text:
        factor = conversion(bracketed_text, si_unit)
        return next((unit for unit, known_factor in UNITS[si_unit].items() if known_factor == factor), None)
    for text, ends in _texts(words(name).split()):
        if text in UNIT_WORDS and role != TIME:
            continue
        of_text = "m/s" if (role, text) == ("speed", "ms") else text  # a speed is not in milliseconds
        factor = conversion(of_text, si_unit)
        if factor and (len(text) > 1 or (ends and (text in OF_ONE_LETTER or role == TIME))):
            return next(unit for unit, known_factor in UNITS[si_unit].items() if known_factor == factor)
        if ends and len(text) > 1 and any(conversion(text, other_unit) for other_unit in UNITS):
            return None
    return ""


def bracketed_unit(name: str) -> str:
    """The last text in brackets that is a unit: ``km/h`` of ``Speed (OBD)(km/h)``; empty without one."""
    texts = (text.strip() for text in reversed(IN_BRACKETS.findall(name)))
    return next((text for text in texts if is_quantity(text) or text in SHARES), "")


def _texts(word_list: Sequence[str]) -> Iterator[tuple[str, bool]]:
    """Texts of one to three words that may be a unit, and whether they end the name; the last and longest come first."""
    for end in range(len(word_list), 0, -1):
        for count in (3, 2, 1):
            joined_words = word_list[max(end - count, 0) : end]
            yield from ((mark.join(joined_words), end == len(word_list)) for mark in ("", "/"))


def is_same(first: tuple[float, float], second: tuple[float, float]) -> bool:
    """Whether two conversions are the same, but for rounded numbers in a file."""
    return all(math.isclose(one, other, rel_tol=1e-6) for one, other in zip(first, second, strict=True))
