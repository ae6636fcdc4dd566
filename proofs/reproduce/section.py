# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines the result of a part of the reproduction: figures, tables, and the paper's claims with a computed verdict each."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trackres_ros.files.own_files import write

HOLDS, FAILS, IN_PART, OPEN = "holds", "does not hold", "holds in part", "cannot be checked"
INK = "#404040"
UNEXPLAINED = "No reason is on file for this outcome: the model or the vehicle file has changed since the reasons were written."


@dataclass(frozen=True)
class Claim:
    """A statement of the paper, the program's result on it, and reasons.

    `holds` is the outcome of the predicate by model combination, or under an empty name without combinations; it is empty if the
    claim cannot be checked.
    """

    key: str  # a stable name
    where: str  # the place in the paper
    paper: str  # its statement
    holds: Mapping[str, bool]
    shows: str  # the program's result, with its numbers
    why: Mapping[str, str]  # reasons by verdict: of `HOLDS`, `FAILS` and `IN_PART` those that are understood
    numbers: Mapping[str, Any]  # behind the verdict, by name and unit
    details: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  # results by heading, then by combination

    @property
    def verdict(self) -> str:
        """`HOLDS`, `FAILS`, `IN_PART` or `OPEN`, from the predicates alone."""
        outcomes = set(self.holds.values())
        if not outcomes:
            return OPEN
        return IN_PART if len(outcomes) > 1 else HOLDS if outcomes == {True} else FAILS

    def summary(self) -> dict[str, Any]:
        """All of it, ready for JSON."""
        found: dict[str, Any] = rounded(asdict(self))
        return found | {"verdict": self.verdict, "why": self.why.get(self.verdict, UNEXPLAINED)}


@dataclass(frozen=True)
class Figure:
    """A picture with its data: file names in the output folder, and its caption."""

    png: str
    csv: str
    caption: str


@dataclass(frozen=True)
class Table:
    """Rows of text below a header."""

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Section:
    """One heading of the page."""

    title: str
    text: Sequence[str]
    figures: Sequence[Figure]
    claims: Sequence[Claim] = ()
    tables: Sequence[Table] = ()
    numbers: Mapping[str, Any] = field(default_factory=dict)

    def summary(self) -> dict[str, Any]:
        """All of it, ready for JSON."""
        found: dict[str, Any] = rounded(asdict(self))
        return found | {"claims": [claim.summary() for claim in self.claims]}


def write_csv(path: Path, columns: Mapping[str, ArrayLike]) -> None:
    """Columns of one length, numbers with six significant digits, nan as an empty cell; names end in the unit."""

    def cell(value: float | str) -> str:
        return value if isinstance(value, str) else "" if math.isnan(value) else f"{value:.6g}"

    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(cell, row)) for row in rows)]
    write(path, ("\n".join(lines) + "\n").encode())


def rounded(value: Any) -> Any:
    """Numbers of a nested mapping or sequence to six significant digits, ready for JSON."""
    if isinstance(value, Mapping):
        return {str(key): rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(item) for item in value]
    if value is None or isinstance(value, str | bool | int):
        return value
    return float(f"{float(value):.6g}")


def percent(share: float, digits: int = 1) -> str:
    """A share as text in percent."""
    return f"{100.0 * share:.{digits}f} %"


def span(values: Iterable[float], digits: int = 0, unit: str = "") -> str:
    """The least and the greatest of some values as text, `3 to 5 Nm`; one of them where both read alike."""
    values = list(values)
    low, high = f"{min(values):.{digits}f}", f"{max(values):.{digits}f}"
    return (low if low == high else f"{low} to {high}") + unit


def percents(shares: Iterable[float], digits: int = 1) -> str:
    """The least and the greatest of some shares in percent, `3 to 5 %`."""
    return span((100.0 * share for share in shares), digits, " %")


def listed(items: Sequence[str]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    return items[0] if len(items) == 1 else ", ".join(items[:-1]) + f" and {items[-1]}"
