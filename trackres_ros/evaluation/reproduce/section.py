# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines the result of a part of the reproduction: figures, tables, and the paper's claims with a computed verdict each."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

HOLDS, FAILS, IN_PART, OPEN = "holds", "does not hold", "holds in part", "cannot be checked"
UNEXPLAINED = "No reason is on file for this outcome: the model or the vehicle file has changed since the reasons were written."


@dataclass(frozen=True)
class Claim:
    """A statement of the paper, the program's result on it, and reasons.

    Parameters
    ----------
    key, where, paper
        A stable name; the place in the paper; its statement.
    holds
        The outcome of the predicate by model combination, or under an empty name without combinations; empty if
        the claim cannot be checked.
    shows
        The program's result, with its numbers.
    why
        Reasons by verdict: of `HOLDS`, `FAILS` and `IN_PART` those that are understood.
    numbers
        The numbers behind the verdict, by name and unit.
    details
        The program's result for each model combination: texts by heading, then by combination.
    """

    key: str
    where: str
    paper: str
    holds: Mapping[str, bool]
    shows: str
    why: Mapping[str, str]
    numbers: Mapping[str, Any]
    details: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """`HOLDS`, `FAILS`, `IN_PART` or `OPEN`, from the predicates alone."""
        outcomes = set(self.holds.values())
        if not outcomes:
            return OPEN
        return IN_PART if len(outcomes) > 1 else HOLDS if outcomes == {True} else FAILS

    def summary(self) -> dict[str, Any]:
        """All of it, ready for JSON."""
        return {
            "key": self.key,
            "where": self.where,
            "paper": self.paper,
            "verdict": self.verdict,
            "holds": dict(self.holds),
            "shows": self.shows,
            "why": self.why.get(self.verdict, UNEXPLAINED),
            "numbers": rounded(self.numbers),
            "details": {heading: dict(texts) for heading, texts in self.details.items()},
        }


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
        return {
            "title": self.title,
            "text": list(self.text),
            "figures": [asdict(figure) for figure in self.figures],
            "claims": [claim.summary() for claim in self.claims],
            "tables": [
                {"caption": table.caption, "header": list(table.header), "rows": [list(row) for row in table.rows]}
                for table in self.tables
            ],
            "numbers": rounded(self.numbers),
        }


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
