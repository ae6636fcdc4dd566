# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every file that the program makes for itself and reads again, damaged: it is read, or one line says why not."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyarrow")

from fleet_rows import REPORT, row
from mutator import mutations
from user_files import OTHERS

from trackres_ros.errors import InputError
from trackres_ros.files.documents import parse_json
from trackres_ros.tools.fleet.compare import compare, compare_text
from trackres_ros.tools.fleet.dataset import FleetDataset
from trackres_ros.tools.fleet.periods import DIAGNOSES, INPUTS, verdicts
from trackres_ros.tools.fleet.run import limits_of
from trackres_ros.tools.fleet.trends import sentences, trends

MUTATIONS = int(os.environ.get("OWN_MUTATIONS", "40"))  # more of them by hand
DAMAGED = [b"", b"\0" * 100, b"[" * 100_000, b"{" * 100_000, b"null", b"1e999", b"9" * 5000, b"PAR1PAR1", b"\xff\xfe\x00"]


@pytest.fixture
def results(tmp_path):
    """The folder of a fleet with six rows, limits and a report."""
    dataset = FleetDataset(tmp_path / "results")
    for number in range(6):
        dataset.put(row(number), None)
    kept = {"limits": {"truck-01": {"bearing_friction": 0.012}}, "values": {"truck-02": "v"}}
    (tmp_path / "results" / "fleet.json").write_text(json.dumps(kept))
    period = tmp_path / "results" / DIAGNOSES / "truck-01" / "2026-03"
    period.mkdir(parents=True)
    (period / INPUTS).write_text("x")
    (period / "report.json").write_text(json.dumps(REPORT))
    return tmp_path / "results"


def of_rows(folder: Path) -> object:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a damaged row is skipped with a warning
        found = trends(FleetDataset.existing(folder), limits_of(folder, {}))
    json.dumps(found, allow_nan=False)
    return sentences(found)


def of_report(folder: Path) -> object:
    report = folder / DIAGNOSES / "truck-01" / "2026-03"
    found = compare(str(report), str(report))
    json.dumps(found, allow_nan=False)
    return compare_text(found), verdicts(folder, [row(0)])


KINDS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "row": ("rows/*/*/*.parquet", of_rows),
    "limits": ("fleet.json", of_rows),
    "report": (f"{DIAGNOSES}/*/*/report.json", of_report),
}


def taken(read: Callable[[Path], object], folder: Path) -> str:
    try:
        read(folder)
    except InputError as refused:
        return "refused" if str(refused).isprintable() else str(refused)
    return "read"


def spoil(results: Path, kind: str, count: int) -> set[str]:
    """Read a kind of file as it is damaged in so many ways."""
    pattern, read = KINDS[kind]
    file = sorted(results.glob(pattern))[0]
    right = file.read_bytes()
    assert taken(read, results) == "read"
    outcomes = set()
    for damaged in [*DAMAGED, *mutations(right, count, seed=1)]:
        file.write_bytes(damaged)
        outcomes.add(taken(read, results))
    return outcomes


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_file_of_ours_ends_in_one_line(results, kind):
    assert spoil(results, kind, MUTATIONS) <= {"read", "refused"}


@pytest.mark.parametrize("kind", OTHERS)
def test_a_damaged_file_of_the_user_ends_in_one_line(tmp_path, kind):
    read, right = OTHERS[kind]
    path = tmp_path / "given.csv"
    outcomes = []
    for damaged in [right.encode(), *DAMAGED, *mutations(right.encode(), 5 * MUTATIONS, seed=2)]:
        path.write_bytes(damaged)
        outcomes.append(taken(read, path))
    assert outcomes[0] == "read"
    assert set(outcomes) == {"read", "refused"}


@pytest.mark.parametrize(
    "changed",
    [{"start_s": np.nan}, {"start_s": np.inf}, {"start_s": 1e18}, {"start_s": -1.0}, {"start_s": None}, {"names": ["one"]},
     {"names": None}, {"precision": [1.0]}, {"linear": [np.nan, 0.0]}, {"mismatch": np.inf}, {"url": None}],
    ids=str,
)  # fmt: skip
def test_a_row_with_a_wrong_value_is_left_out_and_named(results, trackres, changed):
    dataset = FleetDataset(results)
    bad = dataset.put({**row(9), **{k: v for k, v in changed.items() if k != "url"}}, None)
    if "url" in changed:
        import pyarrow.parquet as parquet

        table = parquet.read_table(bad, partitioning=None)
        parquet.write_table(table.set_column(0, "url", [[None]]), bad)
    for words in (("trend", results), ("compare", results, results)):
        done = trackres(*words)
        assert done.returncode == 0
        assert str(bad) in done.stderr
        assert "skipped; trackres fleet rewrites it" in done.stderr
    assert "6 of 6 recordings" in trackres("trend", results).stdout
    assert bad not in {kept.file for kept in dataset.index().values()}
    assert not bad.exists()


def test_json_holds_finite_numbers_of_bounded_size():
    assert parse_json(b'{"a": [1, 2.5, -3e2, null, true]}') == {"a": [1, 2.5, -300.0, None, True]}
    for text in [*DAMAGED[2:4], b"NaN", b"-Infinity", b"1e999", b"9" * 400, b"\xff"]:
        with pytest.raises(ValueError, match=r"\S"):
            parse_json(text)
