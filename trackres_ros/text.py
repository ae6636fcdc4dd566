# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Values come in; readable numbers, names and tables go out, as text or HTML.

Numbers have no more figures than matter, are plain below a million, and a zero has no sign. Pieces of HTML are for notebooks:
without colours, so that they are readable on light and on dark.
"""

from __future__ import annotations

import io
import math
import re
import unicodedata
from collections.abc import Callable, Iterable, Sequence
from html import escape
from itertools import pairwise
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from trackres_ros.errors import MissingExtraError

if TYPE_CHECKING:
    from jinja2 import Environment

PLAIN_BELOW = 1e6
PLAIN_FROM = 1e-4
MOST_FIGURES = 6
MISSING = "-"
WIDER_THAN_ANY = 10_000  # columns of a terminal: no row of a table is folded or cut
STYLE = "border-left: 3px solid #0072B2; padding: .1em .9em; margin: .2em 0; line-height: 1.45"
NUMBERS = re.compile(r"[-+.\d]*( to [-+.\d]+)?")
CELL = "padding: .12em .7em; text-align: {}; font-variant-numeric: tabular-nums; white-space: nowrap"


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


def some_of(names: Sequence[str], limit: int = 8) -> str:
    """Names in a row, of many the first few and how many more."""
    return ", ".join(names[:limit]) + (f" and {len(names) - limit} more" if len(names) > limit else "")


def rising(values: Sequence[float]) -> list[str]:
    """Rising numbers, such as the edges of bins: each with the figures that tell it from its neighbours, at most four."""
    distances = [0.0, *(b - a for a, b in pairwise(values)), 0.0]
    nearest = [min((distance for distance in pair if distance > 0.0), default=0.0) for pair in pairwise(distances)]
    return [figures(round(v, 1 - _exponent(distance)) if distance else v, 4) for v, distance in zip(values, nearest, strict=True)]


def _exponent(value: float) -> int:
    return math.floor(math.log10(value))


def told_apart(paths: Sequence[str]) -> list[str]:
    """Name of each file, with the folders before it that tell it from the others."""
    all_parts = [PurePath(path).parts for path in paths]
    distinct = set(all_parts)

    def shortest(parts: tuple[str, ...]) -> str:
        lengths = (n for n in range(1, len(parts)) if sum(path_parts[-n:] == parts[-n:] for path_parts in distinct) == 1)
        return str(PurePath(*parts[-next(lengths, len(parts)) :]))

    return [shortest(parts) for parts in all_parts]


def words(topic: str) -> str:
    """Return the words of a name, lower case with spaces, without accents: of ``/vehicleSpeed_kmh`` "vehicle speed kmh"."""
    plain_text = "".join(char for char in unicodedata.normalize("NFD", topic) if not unicodedata.combining(char))
    spaced = re.sub(r"([a-z0-9])([A-Z])", r"\1 \2", plain_text).casefold()
    return " ".join(re.split(r"[^a-z0-9]+", spaced))


def table(rows: Iterable[Sequence[str]], head: Sequence[str] = (), indent: int = 0, numbers: bool = True) -> str:
    """Rows of cells in columns of plain text, by rich: the same on every terminal and in a file, each row one whole line.

    `head`: heading of each column, with a unit on a second line; omitted if empty; `indent`: spaces before each line; `numbers`:
    whether the columns hold numbers, which are right-aligned.
    """
    from rich.console import Console
    from rich.padding import Padding
    from rich.table import Table
    from rich.text import Text

    body = [[Text(cell) for cell in row] for row in rows]
    laid_out = Table(box=None, show_header=bool(head), pad_edge=False, padding=(0, 2, 0, 0))
    for name in head or [""] * max(map(len, body), default=0):
        laid_out.add_column(Text(name), justify="right" if numbers else "left")
    for row in body:
        laid_out.add_row(*row)
    text = io.StringIO()
    console = Console(file=text, width=WIDER_THAN_ANY, color_system=None, force_terminal=False, legacy_windows=False)
    console.print(Padding(laid_out, (0, 0, 0, indent), expand=False))
    return "\n".join(line.rstrip() for line in text.getvalue().splitlines())


def panel(title: str, *parts: str) -> str:
    """A heading and its content; empty parts are left out."""
    return f'<div style="{STYLE}"><p style="margin: .3em 0"><b>{escape(title)}</b></p>{"".join(parts)}</div>'


def paragraph(text: str) -> str:
    """A sentence."""
    return f'<p style="margin: .4em 0; max-width: 60em">{escape(text)}</p>' if text else ""


def html_table(head: Sequence[str], rows: Iterable[Sequence[str]], units: Sequence[str] = ()) -> str:
    """A table, with columns of numbers to the right; empty without a row."""
    body = [list(map(str, row)) for row in rows]
    if not body:
        return ""
    right = [all(NUMBERS.fullmatch(row[i]) for row in body) for i in range(len(head))]
    align = [CELL.format("right" if of_number else "left") for of_number in right]

    def line(cells: Sequence[str], kind: str) -> str:
        cells_html = (f'<{kind} style="{style}">{escape(cell)}</{kind}>' for cell, style in zip(cells, align, strict=True))
        return f"<tr>{''.join(cells_html)}</tr>"

    heads = line(head, "th") + (line(units, "td") if units else "")
    lines = "".join(line(row, "td") for row in body)
    return f'<table style="margin: .4em 0"><thead>{heads}</thead><tbody>{lines}</tbody></table>'


def listed(title: str, lines: Sequence[str], folded: bool = False) -> str:
    """Lines under a title, which opens and closes; empty without a line."""
    if not lines:
        return ""
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    state = "" if folded else " open"
    return f'<details{state}><summary>{escape(title)} ({len(lines)})</summary><ul style="margin: .2em 0">{items}</ul></details>'


def templates(package: str, page: str, extra: str, **filters: Callable[..., Any]) -> Environment:
    """The templates of pages in the folder of a package: inserted values are escaped, and a missing value is an error.

    `page`, `extra`: page that needs them, and the extra that installs jinja2; `filters`: by name. Raises MissingExtraError
    without jinja2.
    """
    try:
        from jinja2 import Environment, PackageLoader, StrictUndefined
    except ImportError:
        raise MissingExtraError(page, "jinja2", extra) from None
    environment = Environment(loader=PackageLoader(package, "."), autoescape=True, undefined=StrictUndefined)
    environment.filters.update(filters)
    return environment
