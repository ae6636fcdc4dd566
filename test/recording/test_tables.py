# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tables: reading, refusals and texts; the bytes written; with pyarrow and without."""

from __future__ import annotations

import gzip
import itertools
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trackres_ros.errors import InputError
from trackres_ros.output import table as output_table
from trackres_ros.output.table import TableWriter, write_table
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.opening import open_source
from trackres_ros.recording.recording import Recording

try:  # a pyarrow that does not fit the installed numpy raises ImportError too
    import pyarrow as pa
    from pyarrow import parquet
except ImportError:
    pa = None
with_pyarrow = pytest.mark.skipif(pa is None, reason="no pyarrow that can be imported")


def table(folder: Path, text: str, name: str = "run.csv") -> Path:
    path = folder / name
    path.write_bytes(gzip.compress(text.encode()) if name.endswith(".gz") else text.encode())
    return path


def read(path: Path, topics: Topics | None = None, max_rows: int = 65536) -> list[tuple[Any, ...]]:
    """Return all samples: role, stamp [s], value."""
    source = open_source([path], topics)
    rows = []
    for block in source.blocks(max_rows):
        assert 0 < len(block) <= max(max_rows, len(source.roles))
        np.testing.assert_array_equal(block.stamp_ns, block.arrival_ns)
        rows += [
            (source.roles[role], stamp / 1e9, value)
            for role, stamp, value in zip(block.role, block.stamp_ns, block.value, strict=True)
        ]
    return rows


@pytest.mark.parametrize("name", ["run.csv", "run.csv.gz"])
def test_columns_units_parts_and_empty_cells(tmp_path: Path, reader: None, name: str) -> None:
    text = "time_s,speed_kmh,weight_kn/front,note,belt_degc\n0,36,1.5,x,\n0.1,,2,y,20\n\n0.2,72,,z,21\n"
    path = table(tmp_path, text, name)
    assert read(path) == [
        ("load/front", 0.0, 1500.0),
        ("speed", 0.0, 10.0),
        ("load/front", 0.1, 2000.0),
        ("belt", 0.1, 20.0),
        ("belt", 0.2, 21.0),
        ("speed", 0.2, 20.0),
    ]
    assert read(path, max_rows=2) == read(path)
    source = open_source([path])
    assert source.roles == ("load/front", "belt", "speed")
    assert "ignored columns: note" in source.notes
    assert "speed: column speed_kmh" in source.notes


def test_every_column_by_name(tmp_path: Path, reader: None) -> None:
    names = "time_s,speed_mps,weight_n,torque_nm,belt_degc,ambient_degc,grade,yaw_rate_radps,heading_rad,accel_mps2,distance_m"
    path = table(tmp_path, names + "\n" + ",".join(map(str, range(11))) + "\n")
    assert {role: value for role, _, value in read(path)} == dict(
        zip(
            ["speed", "load", "torque", "belt", "ambient", "grade", "yaw_rate", "heading", "accel", "distance"],
            map(float, range(1, 11)),
            strict=True,
        )
    )


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time_s,speed_mps\n0,1\n1,fast\n2,3\n", ["line 3", "'fast'", "a number, or an empty cell"]),
        ("time_s,speed_mps\n0,1\n1,1_0\n", ["line 3", "'1_0'"]),
        ("time_s,speed_mps\n0,1\n,2\n", ["time_s, row 2", "''", "a time in seconds"]),
        ("time_s,speed_mps\n0,1\nnan,2\n", ["time_s, row 2", "''"]),
        ("time_s,speed_mps\n1700000000000,1\n", ["time_s, row 1", "1700000000000.0", "seconds"]),
        ("time_s,speed_mps\n0,1\n1,2,3\n", ["line 3", "3 cells", "2 cells"]),
        ("time_s,speed_mps\n0,1\n1,2,5", ["line 3", "3 cells"]),
        ("time_s,speed_mps\n0,1\n1\n", ["line 3", "1 cells"]),
        ("time_s,speed_mps\n", ["no row"]),
        ("", ["empty file"]),
        ("\n1,2\n", ["columns 1, 2", "a column time_s"]),
        ("speed_mps,grade\n1,2\n", ["speed_mps, grade", "a column time_s"]),
        ("tine_s,speed_mps\n1,2\n", ["a column time_s", "time: {channel: NAME, unit: s}"]),
        ("Time of it,speed_mps\n1,2\n", ["a column time_s", "time: {channel: Time of it, unit: s}"]),
        ("time_s,Speed\n1,2\n", ["topics file: speed: {channel: Speed, unit: km/h}"]),
        ("time_s,v\n1,2\n", ["topics file: speed: {channel: v, unit: km/h}"]),
        ("time_s,w\n1,2\n", ["topics file: speed: {channel: NAME, unit: km/h}"]),
        ("time_s,grade\n1,2\n", ["time_s, grade", "speed_mps or speed_kmh", "topics file"]),
        ("time_s,speed_mps,speed_kmh\n1,2,3\n", ["speed_mps and speed_kmh", "one column for speed"]),
        ("time_s,speed_mps,speed_mps\n1,2,3\n", ["2 columns speed_mps"]),
    ],
)
def test_refused_with_the_place(tmp_path: Path, reader: None, text: str, says: list[str]) -> None:
    path = table(tmp_path, text)
    with pytest.raises(InputError) as error_info:
        read(path)
    for part in [str(path), *says]:
        assert part in str(error_info.value)
    assert "\n" not in str(error_info.value)


def test_a_bad_cell_far_down(tmp_path: Path, reader: None) -> None:
    """Behind the first blocks of a megabyte, in which pyarrow reads."""
    rows = [f"{row / 100!r},{row % 50},{'x' * 1000}" for row in range(3000)]
    rows[2500] = "25.0,broken,"
    path = table(tmp_path, "time_s,speed_mps,note\n" + "\n".join(rows) + "\n")
    with pytest.raises(InputError, match="line 2502, column speed_mps: given 'broken'"):
        read(path)
    rows[2500] = " 25.0 , 7 ,"
    path = table(tmp_path, "time_s,speed_mps,note\n" + "\n".join(rows) + "\n")
    got = read(path)
    assert len(got) == 3000
    assert got[2500] == ("speed", 25.0, 7.0)
    assert [value for _, _, value in got[:50]] == list(range(50))


def test_a_topics_file_names_other_columns(tmp_path: Path, reader: None) -> None:
    path = tmp_path / "run.csv"
    path.write_bytes("time_s;Geschwindigkeit [km/h];Öl;ambient_degc\n0;36;1;15\n".encode("latin-1"))
    topics = Topics.parse(
        {
            "speed": {"column": "Geschwindigkeit [km/h]", "scale": 1 / 3.6, "offset": 1.0},
            "load": {"topic": "/load", "type": "std_msgs/msg/Float64", "field": "data"},
        },
        "t.yaml",
    )
    assert read(path, topics) == [("ambient", 0.0, 15.0), ("speed", 0.0, 11.0)]
    assert any("Latin-1" in note for note in open_source([path], topics).notes)
    with pytest.raises(InputError, match=r"t\.yaml: speed: column: given 'Geschwindigkeit'.*did you mean"):
        open_source([path], Topics.parse({"speed": {"column": "Geschwindigkeit"}}, "t.yaml"))


def test_byte_order_mark_quotes_and_line_ends(tmp_path: Path, reader: None) -> None:
    path = tmp_path / "run.csv"
    path.write_bytes(b'\xef\xbb\xbf"time_s","speed_mps","say"\r\n"0.5","2","a, b"\r\n1e0,3,\r\n')
    assert read(path) == [("speed", 0.5, 2.0), ("speed", 1.0, 3.0)]


def test_time_that_runs_back_is_kept_and_found(tmp_path: Path, reader: None) -> None:
    path = table(tmp_path, "time_s,speed_mps\n0,1\n2,2\n1,3\n1,inf\n")
    recording = Recording.from_source(open_source([path]))
    np.testing.assert_array_equal(recording.series["speed"].value, [1.0, 2.0, 3.0, np.inf])
    assert {finding.kind for finding in recording.findings} == {"backward_stamp", "duplicate_stamp", "non_finite"}


@pytest.mark.parametrize("cut", [8, 20])
def test_a_cut_off_archive(tmp_path: Path, reader: None, cut: int) -> None:
    path = table(tmp_path, "time_s,speed_mps\n" + "".join(f"{row},{row % 7}\n" for row in range(5000)), "run.csv.gz")
    path.write_bytes(path.read_bytes()[:-cut])
    with pytest.raises(InputError, match=r"run\.csv\.gz"):
        read(path)
    path.write_bytes(b"no archive")
    with pytest.raises(InputError, match=r"run\.csv\.gz"):
        read(path)


NUMBERS = st.one_of(st.floats(allow_nan=False), st.just(float("nan")), st.floats(-1e3, 1e3).map(lambda x: round(x, 3)))


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz", pytest.param(".parquet", marks=with_pyarrow)])
@settings(max_examples=30, deadline=None)
@given(values=st.lists(st.tuples(NUMBERS, NUMBERS), min_size=1, max_size=20))
def test_what_is_written_reads_back(
    tmp_path_factory: pytest.TempPathFactory, suffix: str, values: list[tuple[float, float]]
) -> None:
    path = tmp_path_factory.mktemp("t") / f"run{suffix}"
    speed, load = np.array(values).T
    columns = {"time_s": np.arange(len(speed)) / 3.0, "speed_mps": speed, "weight_n": load}
    write_table(path, columns)
    first = path.read_bytes()
    with TableWriter(path, list(columns)) as writer:
        writer.write(np.stack(list(columns.values()), axis=1))
    assert path.read_bytes() == first
    got = read(path)
    for role, column in (("speed", speed), ("load", load)):
        here = [(time, value) for name, time, value in got if name == role]
        given_rows = ~np.isnan(column)
        np.testing.assert_array_equal([value for _, value in here], column[given_rows])
        np.testing.assert_allclose([time for time, _ in here], columns["time_s"][given_rows], atol=6e-10)


@with_pyarrow
def test_parquet_estimates_keep_seven_digits_and_exact_times(tmp_path: Path) -> None:
    time, torque = 1.7e9 + np.arange(50) / 3.0, np.geomspace(1e-3, 1e6, 50) * np.pi
    stamp = np.arange(50) + 1_700_000_000_123_456_789
    columns = {"time_s": time, "stamp_ns": stamp, "torque_nm": torque, "belt_degc": np.full(50, np.nan)}
    write_table(tmp_path / "run.parquet", columns, estimates=True)
    got = parquet.read_table(tmp_path / "run.parquet")
    np.testing.assert_array_equal(got["time_s"].to_numpy(), time)
    np.testing.assert_array_equal(got["stamp_ns"].to_numpy(), stamp)
    np.testing.assert_allclose(got["torque_nm"].to_numpy(), torque, rtol=6e-8)
    assert got["torque_nm"].type == pa.float32()
    assert got["belt_degc"].null_count == 50


@with_pyarrow
@given(st.lists(st.integers(0, 25), max_size=8), st.booleans())
def test_row_groups_are_full_whatever_the_blocks(
    tmp_path_factory: pytest.TempPathFactory, blocks: list[int], estimates: bool
) -> None:
    path, rows = tmp_path_factory.mktemp("t") / "run.parquet", sum(blocks)
    number = np.arange(rows)
    texts = np.array(["", "bright", "äöü"])[number % 3]
    columns = {"time_s": number / 3.0, "n": number, "ok": number % 2 > 0, "x": np.where(number % 5, number / 7.0, np.nan)}
    columns["text"] = texts
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(output_table, "GROUP_ROWS", 10)
        write_table(path, columns, estimates)
        total = path.read_bytes()
        with TableWriter(path, list(columns), estimates) as writer:
            for start, end in itertools.pairwise(np.cumsum([0, *blocks])):
                block = {name: column[start:end].copy() for name, column in columns.items()}
                writer.write_columns(list(block.values()))
                for column in block.values():
                    column[:] = column[:1]  # what was given is the caller's again
    if blocks:
        assert path.read_bytes() == total
    metadata = parquet.read_metadata(path)
    sizes = [metadata.row_group(group).num_rows for group in range(metadata.num_row_groups)]
    assert sizes == ([10] * (rows // 10) + [rows % 10] * (rows % 10 > 0) or [0])
    if not rows:
        return
    got = parquet.read_table(path)
    for name, column in columns.items():
        exact = not estimates or name != "x"
        assert got[name].null_count == np.isnan(column).sum() if name == "x" else not got[name].null_count
        expectation = column if exact else column.astype(np.float32)
        np.testing.assert_array_equal(got[name].to_numpy(), expectation)


def test_the_text_of_a_table(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    write_table(
        path,
        {
            "time_s": np.array([0.0, 0.1]),
            "n": np.array([1, 2]),
            "ok": np.array([True, False]),
            'why, "so"': np.array(["a,b", 'say "x"']),
            "x": np.array([np.nan, 1e22]),
        },
    )
    assert path.read_text() == 'time_s,n,ok,"why, ""so""",x\n0.0,1,1,"a,b",\n0.1,2,0,"say ""x""",1e+22\n'


def test_columns_of_equal_bytes_keep_their_kinds(tmp_path: Path) -> None:
    total, path = np.array([0, 1 << 62]), tmp_path / "out.csv"
    write_table(path, {"time_s": total.view(float), "n": total, "x": total.view(float)})
    assert path.read_text() == f"time_s,n,x\n0.0,0,0.0\n2.0,{1 << 62},2.0\n"


def test_nothing_is_left_or_lost_when_writing_fails(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    path.write_text("old")
    with pytest.raises(IndexError), TableWriter(path, ["time_s"]) as writer:
        writer.write(np.zeros(3))
    assert [file.name for file in tmp_path.iterdir()] == ["out.csv"]
    assert path.read_text() == "old"
    with TableWriter(path, ["time_s"]):
        pass
    assert path.read_text() == "time_s\n"


def test_columns_of_two_lengths_are_no_table(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="one length"):
        write_table(tmp_path / "out.csv", {"a": np.zeros(1), "b": np.zeros(2)})


@with_pyarrow
def test_parquet_of_other_types(tmp_path: Path) -> None:
    path = tmp_path / "run.parquet"
    parquet.write_table(pa.table({"time_s": [0, 1], "speed_mps": pa.array([1.5, None], pa.float32())}), path)
    assert read(path) == [("speed", 0.0, 1.5)]
    parquet.write_table(pa.table({"time_s": [0.0], "speed_mps": ["fast"]}), path)
    with pytest.raises(InputError, match=r"speed_mps: given 'string'.*a column of numbers"):
        read(path)
    for name, topics in (("time", None), ("t", Topics.parse({"time": {"column": "t"}}, "t.yaml"))):
        parquet.write_table(pa.table({name: ["2026-11-23"], "speed_mps": [1.0]}), path)
        allowed = "numbers or timestamps" if topics else "timestamps"
        with pytest.raises(InputError, match=rf"{name}: given 'string'; allowed: a column of {allowed}"):
            read(path, topics)
    path.write_bytes(b"PAR1 no")
    with pytest.raises(InputError, match="Parquet that is readable to its end"):
        read(path)


@with_pyarrow
@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**50) | st.integers(2**53, 4 * 10**18), st.sampled_from(["int64", "uint64"]))
def test_nanoseconds_of_parquet_are_exact(tmp_path_factory: pytest.TempPathFactory, start: int, kind: str) -> None:
    stamps, path = [start, start + 1], tmp_path_factory.mktemp("t") / "run.parquet"
    total = pa.array(stamps, getattr(pa, kind)())
    parquet.write_table(pa.table({"t": total, "speed_mps": total}), path)
    (block,) = open_source([path], Topics.parse({"time": {"column": "t", "scale": 1e-9}}, "t.yaml")).blocks()
    assert block.stamp_ns.tolist() == stamps
    assert block.value.tolist() == list(map(float, stamps))


@with_pyarrow
def test_times_of_parquet_too_late_are_refused_with_their_row(tmp_path: Path) -> None:
    for kind, late in ((pa.timestamp("us"), 10**16), (pa.timestamp("s"), 10**10), (pa.uint64(), 2**63)):
        stamps = pa.array([0, late], kind)
        parquet.write_table(pa.table({"t": stamps, "speed_mps": [1.0, 2.0]}), tmp_path / "run.parquet")
        with pytest.raises(InputError, match=r"t, row 2 below the header.*a time in seconds"):
            read(tmp_path / "run.parquet", Topics.parse({"time": {"column": "t"}}, "t.yaml"))


@with_pyarrow
@pytest.mark.parametrize(
    ("column", "wanted"),
    [
        (lambda: pa.nulls(2), []),
        (lambda: pa.array([True, None]), [1.0]),
        (lambda: pa.array([Decimal("1.25"), None], pa.decimal128(5, 2)), [1.25]),
        (lambda: pa.array([2**53 + 1, None]), [2.0**53]),
    ],
)
def test_a_column_of_parquet_reads_like_its_cells_in_csv(tmp_path: Path, column: Any, wanted: list[float]) -> None:
    path = tmp_path / "run.parquet"
    parquet.write_table(pa.table({"time_s": [0, 1], "speed_mps": [1, 1], "brake_on": column()}), path)
    assert [value for role, _, value in read(path) if role == "brake"] == wanted


def test_a_folder_of_tables_names_them(tmp_path: Path) -> None:
    for number in range(5):
        (tmp_path / f"drive_{number}.csv.gz").touch()
    with pytest.raises(
        InputError, match=r"drive_0.csv.gz, drive_1.csv.gz, drive_2.csv.gz and 2 more.*give the path of the recording in it"
    ):
        open_source([tmp_path])
