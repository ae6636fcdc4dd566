# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Opens whatever the user named: bags or a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from trackres_ros.errors import InputError
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.reading import check_there
from trackres_ros.recording.unfinished import SUFFIX as UNFINISHED

if TYPE_CHECKING:
    from trackres_ros.recording.rosbag import BagSource
    from trackres_ros.recording.table import TableSource

BAG_SUFFIXES = (".mcap", ".db3", ".bag")
TABLE_SUFFIXES = (".csv", ".csv.gz", ".parquet", ".xlsx")
MOST_NAMED = 3
ALLOWED = "a rosbag2 directory, .mcap, .db3, .bag, .csv, .csv.gz, .parquet or .xlsx"


def open_source(paths: Sequence[Path], topics: Topics | None = None) -> BagSource | TableSource:
    """Return the source for what is at some paths.

    Parameters
    ----------
    paths : sequence of Path
        Bags, read one after another, or one table.
    topics : Topics, optional
        Which topic or column feeds which role; guessed by message type, or standard columns, without.

    Raises
    ------
    InputError
        Nothing there, a suffix or directory that is no recording, bags and tables mixed, or several tables.
    MissingExtraError
        The library for bags, Parquet or Excel is not installed.
    """
    if not paths:
        raise InputError("recording", "no path", ALLOWED)
    tables = [_is_table(path) for path in paths]
    if not any(tables):
        from trackres_ros.recording.rosbag import BagSource

        return BagSource(paths, topics)
    if len(paths) > 1:
        given = ", ".join(str(path) for path in paths)
        raise InputError("recordings", given, "several bags, or one table", "give tables one at a time")
    from trackres_ros.recording.table import TableSource

    return TableSource(paths[0], topics)


def _is_table(path: Path) -> bool:
    """Return whether a path is a table (True) or a bag (False), by suffix or content of the directory."""
    check_there(path)
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return False
        inside = sorted(file.name for file in path.iterdir() if file.name.lower().endswith((*BAG_SUFFIXES, *TABLE_SUFFIXES)))
        remedy = "name what is in it" if inside else "a rosbag2 directory has one; ros2 bag reindex writes it"
        more = f" and {len(inside) - MOST_NAMED} more" if len(inside) > MOST_NAMED else ""
        given = f"no metadata.yaml, but {', '.join(inside[:MOST_NAMED])}{more}" if inside else "a directory without metadata.yaml"
        raise InputError(str(path), given, ALLOWED, remedy)
    name = path.name.lower()
    if name.endswith((*BAG_SUFFIXES, UNFINISHED)):
        return False
    if name.endswith(TABLE_SUFFIXES):
        return True
    raise InputError(str(path), path.suffix or "no suffix", ALLOWED)
