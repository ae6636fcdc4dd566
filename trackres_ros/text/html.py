# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Makes small pieces of HTML for notebooks: without colours, so that they are readable on light and on dark."""

import re
from collections.abc import Iterable, Sequence
from html import escape

STYLE = "border-left: 3px solid #0072B2; padding: .1em .9em; margin: .2em 0; line-height: 1.45"
NUMBERS = re.compile(r"[-+.\d]*( to [-+.\d]+)?")
CELL = "padding: .12em .7em; text-align: {}; font-variant-numeric: tabular-nums; white-space: nowrap"


def panel(title: str, *parts: str) -> str:
    """A heading and its content; empty parts are left out."""
    return f'<div style="{STYLE}"><p style="margin: .3em 0"><b>{escape(title)}</b></p>{"".join(parts)}</div>'


def paragraph(text: str) -> str:
    """A sentence."""
    return f'<p style="margin: .4em 0; max-width: 60em">{escape(text)}</p>' if text else ""


def table(head: Sequence[str], rows: Iterable[Sequence[str]], units: Sequence[str] = ()) -> str:
    """A table, with columns of numbers to the right; empty without a row."""
    body = [list(map(str, row)) for row in rows]
    if not body:
        return ""
    right = [all(NUMBERS.fullmatch(row[i]) for row in body) for i in range(len(head))]
    align = [CELL.format("right" if of_number else "left") for of_number in right]

    def line(cells: Sequence[str], kind: str) -> str:
        shown = (f'<{kind} style="{style}">{escape(cell)}</{kind}>' for cell, style in zip(cells, align, strict=True))
        return f"<tr>{''.join(shown)}</tr>"

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
