# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Parses which value of a vehicle file to vary, and over which values."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from trackres_ros.errors import InputError, nearest
from trackres_ros.text import figures
from trackres_ros.vehicle import Vehicle

USUAL_COUNT, MOST_COUNT = 9, 1000
POINTS, MOST_VALUES = 5, 25  # of an option with several numbers
LOADS = (".load", ".own_weight")  # ends of paths
NAMED = "axles", "tracks", "wrapped_wheels"  # parts of a path that are followed by the name of one of several
DEGREES = "degC"
AIR, AIR_DEGC = "chassis.ambient", (-60.0, 60.0)  # path, and limits of an option
ALLOWED = (
    "PATH=A:B:N, PATH=A:B or PATH=A,B,C with finite numbers, or with changes as +20%, and N from 2 to 1000; or PATH alone for "
    "the file's range"
)


@dataclass(frozen=True, slots=True)
class Variation:
    """Values of a vehicle file that change together, by their paths; their unit; and the value of each, point by point."""

    paths: tuple[str, ...]
    unit: str
    values: tuple[tuple[float, ...], ...]  # (paths, points)

    @property
    def points(self) -> list[dict[str, float]]:
        """Values of each point by path."""
        return [dict(zip(self.paths, point, strict=True)) for point in zip(*self.values, strict=True)]


def scalars(vehicle: Vehicle) -> list[str]:
    """Paths of all single values of a vehicle."""
    return [path for path, quantity in vehicle.parameters.items() if isinstance(quantity.value, float)]


def full_paths(vehicle: Vehicle, text: str) -> tuple[str, ...]:
    """The paths of an abbreviation: a full path, or enough of its words in their order, as belt.thickness.

    A value of several axles, tracks or wheels means all of them, as axles.load. Raises InputError if there is none, or several
    that are not the same of several parts.
    """
    scalar_paths = scalars(vehicle)
    if text in scalar_paths:
        return (text,)
    words = [_stem(word) for word in re.split(r"[._]", text) if word]
    paths = [path for path in scalar_paths if words and _in_order(words, [_stem(word) for word in re.split(r"[._]", path)])]
    if paths and len({_part(path) for path in paths}) == 1:
        return tuple(paths)
    if paths:
        raise InputError("--vary", text, f"one of {', '.join(paths)}")
    names = [short(path, scalar_paths) for path in scalar_paths]
    guess = nearest(text, scalar_paths) or nearest(text, names)
    allowed = f"a single number of {vehicle.name} by its path or its last words: {', '.join(names)}"
    raise InputError("--vary", text, allowed, guess)


def _part(path: str) -> tuple[str, ...]:
    """A path without the names of axles, tracks and wheels."""
    words = path.split(".")
    return tuple("" if parent in NAMED else word for parent, word in zip(["", *words], words, strict=False))


def _stem(word: str) -> str:
    return word.lower().removesuffix("s")


def _in_order(words: Sequence[str], path_words: Sequence[str]) -> bool:
    remaining = iter(path_words)
    return all(any(word == candidate for candidate in remaining) for word in words)


def variation(vehicle: Vehicle, text: str) -> Variation:
    """Parse `PATH=A:B:N`, `PATH=A:B`, `PATH=A,B,C` and `PATH`; the last takes the range of the file.

    A number with a percent sign is a change of the file's value: `PATH=-20%:+20%:5`, `PATH=+20%`. A single change is compared
    with the file's value. Raises InputError if it is none of these.
    """
    name, equals, values = text.partition("=")
    paths = full_paths(vehicle, name.strip())
    quantities = [vehicle.parameters[path] for path in paths]
    unit = quantities[0].unit
    if not equals:
        return Variation(paths, unit, tuple(_even_values(q.low, q.high, USUAL_COUNT) for q in quantities))
    changes, relative = _numbers(values, text)
    if not relative:
        return Variation(paths, unit, (changes,) * len(paths))
    if unit == DEGREES:
        raise InputError("--vary", text, f"values in {DEGREES}", f"a percentage of {DEGREES} is meaningless")
    if len(changes) == 1:
        changes = (0.0, *changes)
    file_values = [q.value for q in quantities if isinstance(q.value, float)]
    return Variation(
        paths,
        unit,
        tuple(tuple(float(f"{file_value * (1.0 + 0.01 * change):.10g}") for change in changes) for file_value in file_values),
    )


def _numbers(values: str, text: str) -> tuple[tuple[float, ...], bool]:
    """The numbers, and whether they are changes [%]."""
    try:
        parts = re.split("[:,]", values)
        ends = parts[:2] if ":" in values else parts
        relative = all(part.strip().endswith("%") for part in ends)
        numbers = [float(part.strip().removesuffix("%") if relative else part) for part in ends]
        if not all(map(math.isfinite, numbers)) or (":" in values and "," in values):
            raise ValueError
        if ":" not in values:
            return tuple(numbers), relative
        low, high = numbers
        (count,) = map(int, parts[2:] or [str(USUAL_COUNT)])
        if not 2 <= count <= MOST_COUNT:
            raise ValueError
        return _even_values(low, high, count), relative
    except ValueError:
        raise InputError("--vary", text, ALLOWED) from None


def _even_values(low: float, high: float, count: int) -> tuple[float, ...]:
    return tuple(float(f"{low + i * (high - low) / (count - 1):.10g}") for i in range(count))


def short(path: str, paths: Sequence[str] = ()) -> str:
    """The last two words of a path, or more if these are ambiguous."""
    parts = path.split(".")
    for count in range(2, len(parts)):
        name = ".".join(parts[-count:])
        if not any(rival != path and rival.endswith(name) for rival in paths):
            return name
    return path


def numbers(option: str, text: str, limits: tuple[float, float]) -> tuple[float, ...]:
    """The numbers of `A`, `A:B`, `A:B:N` and `A,B,C`; `A:B` is five, evenly spaced.

    Raises InputError on anything else, or beyond the limits.
    """
    low, high = limits
    try:
        if ":" in text:
            begin, end, *count_text = text.split(":")
            (count,) = map(int, count_text or [str(POINTS)])
            first, last = float(begin), float(end)
            if not (2 <= count <= MOST_VALUES and first < last):
                raise ValueError
            values = [round(first + i * (last - first) / (count - 1), 4) for i in range(count)]
        else:
            values = [float(item) for item in text.split(",")]
        if not (
            values and len(values) <= MOST_VALUES and all(low <= x <= high for x in values) and len(set(values)) == len(values)
        ):
            raise ValueError
    except ValueError:
        allowed = f"A, A:B with A < B, A:B:N or A,B,C, at most {MOST_VALUES} numbers from {figures(low)} to {figures(high)}"
        raise InputError(option, text, allowed) from None
    return tuple(values)
