# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Lays out tables of plain text, by rich: the same on every terminal and in a file, each row one whole line."""

import io
from collections.abc import Iterable, Sequence

WIDER_THAN_ANY = 10_000  # columns of a terminal: no row is folded or cut


def table(rows: Iterable[Sequence[str]], head: Sequence[str] = (), indent: int = 0, numbers: bool = True) -> str:
    """Rows of cells in columns.

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
