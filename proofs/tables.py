# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Results of proofs as tables, a row a measurement: CSV in the folder of a run and in docs/trust/, and text on a terminal."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from trackres_ros.files.file_sets import file_set
from trackres_ros.files.own_files import write
from trackres_ros.text import table

Rows = Sequence[Mapping[str, str]]
Tables = Mapping[str, Rows]
"""Rows by the name of the file, without its ending. The rows of a table have the same columns."""

FOLDER = "tables"  # of a run
TRUTH = "truth"  # column of tables that several proofs write
WIDEST = 60  # of a cell on a terminal


def number(value: float, places: int) -> str:
    """A number with so many decimals, empty for nan."""
    return f"{value:.{places}f}" if np.isfinite(value) else ""


def write_tables(folder: Path, tables: Tables) -> None:
    """Write each table as CSV, all or none; a table without rows is left out."""
    folder.mkdir(parents=True, exist_ok=True)
    with file_set():
        for name, rows in tables.items():
            if rows:
                text = io.StringIO()
                writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
                writer.writeheader()
                writer.writerows(rows)
                write(folder / f"{name}.csv", text.getvalue().encode())


def read_table(path: Path) -> list[dict[str, str]]:
    """The rows of a table."""
    with path.open(encoding="utf-8", newline="") as lines:
        return list(csv.DictReader(lines))


def shown(tables: Tables) -> str:
    """The tables as text; of a longer cell its beginning."""

    def cell(text: str) -> str:
        return text if len(text) <= WIDEST else f"{text[: WIDEST - 4]} ..."

    blocks = (
        f"{name}\n" + table([[cell(text) for text in row.values()] for row in rows], list(rows[0]), indent=2, numbers=False)
        for name, rows in tables.items()
        if rows
    )
    return "\n\n".join(blocks)
