# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Deceptive recordings: each ends in one line and exit code 2, or is read with the losses counted."""

from __future__ import annotations

import bz2
import gzip
import os
import socket
import sqlite3
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from trackres_ros.errors import InputError
from trackres_ros.output.table import write_table
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.opening import open_source
from trackres_ros.recording.reading import OWN_FAULT, reading
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.samples import SampleBlock
from trackres_ros.tasks import replay_run
from trackres_ros.tasks.replay_run import KeptSource

pytest.importorskip("rosbags")
pytest.importorskip("mcap")

from ros_messages import STORE, build, fill, stamped, twist, write_speeds
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

TWIST = "geometry_msgs/msg/TwistStamped"
FLOATS, NUMBER = "std_msgs/msg/Float64MultiArray", "std_msgs/msg/Float64"
START = 1_700_000_000 * 10**9
CSV = b"time_s,speed_mps\n0,1\n1,2\n"
TOPICS = Topics.parse({"speed": {"topic": "/speed", "type": TWIST, "field": "twist.linear.x"}})


@pytest.fixture
def refused(tmp_path, refused):
    """What `trackres replay` says about a recording that it refuses: one printable line, exit code 2."""

    def says(recording: Path) -> str:
        text = refused("replay", recording, "--vehicle", "xgd24d", "-o", tmp_path / "out.csv")
        assert text[:-1].isprintable()
        assert not (tmp_path / "out.csv").exists()
        return text

    return says


def speeds(path: Path, topics: Topics | None = TOPICS) -> Recording:
    return Recording.from_source(open_source([path], topics))


def found(recording: Recording) -> dict[str, int]:
    return {finding.kind: finding.count for finding in recording.findings}


# --- files

CONTENTS = {
    "an MCAP bag": b"\x89MCAP0\r\n", "an SQLite bag": b"SQLite format 3\0", "a ROS 1 bag": b"#ROSBAG V2.0\n",
    "a Parquet table": b"PAR1....PAR1", "a gzip archive": gzip.compress(CSV), "a zstd archive": b"\x28\xb5\x2f\xfd",
    "a bzip2 archive": bz2.compress(CSV), "a zip archive or an Excel workbook": b"PK\x03\x04", "an empty file": b"",
    "binary data": b"ab\0cd",
}  # fmt: skip
OWN = {".mcap": "an MCAP bag", ".db3": "an SQLite bag", ".bag": "a ROS 1 bag", ".parquet": "a Parquet table"}
OWN[".csv.gz"] = "a gzip archive"


@pytest.mark.parametrize("suffix", [".csv", *OWN])
@pytest.mark.parametrize("content", CONTENTS)
def test_the_content_is_what_the_suffix_says(tmp_path, refused, suffix, content):
    path = tmp_path / f"run{suffix}"
    path.write_bytes(CONTENTS[content])
    if OWN.get(suffix) != content:
        text = refused(path)
        assert f"{path}: given '{content}'" in text
        assert f"{OWN.get(suffix, 'text')}, according to its suffix" in text
    elif suffix != ".csv.gz":  # the others hold their first bytes only
        assert str(path) in refused(path)


@pytest.mark.parametrize("suffix", [".csv", *OWN])
def test_only_regular_files_are_opened(tmp_path, refused, suffix):
    made = {
        "a named pipe": lambda path: os.mkfifo(path),
        "a device": lambda path: path.symlink_to("/dev/zero"),
        "a link to itself": lambda path: path.symlink_to(path),
        "which does not exist": lambda path: path.symlink_to(tmp_path / "gone"),
        "no such file or folder": lambda path: None,
    }
    for number, (says, make) in enumerate(made.items()):
        path = tmp_path / f"{number}{suffix}"
        make(path)
        assert says in refused(path)
        folder = tmp_path / f"folder{number}{suffix}"
        folder.mkdir()
        (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {}")
        make(folder / "run.db3")
        if says != "no such file or folder":
            assert says in refused(folder)


def test_a_socket_is_refused(tmp_path, refused, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with socket.socket(socket.AF_UNIX) as item:
        item.bind("s.csv")
        assert "a socket" in refused(Path("s.csv"))


def test_names_that_no_terminal_takes(tmp_path, refused, good):
    """A name that is not UTF-8 and holds a line end: in refusals, in reading, and in writing."""
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/a\n\xff.csv"))
    path.write_bytes(b"time_s\n0\n")
    assert "a\\n\\udcff.csv" in refused(path)
    columns = "time_s,speed_mps,odd\x07\u2028name"
    path.write_text(f"{columns}\n" + "".join(f"{row / 10},{row % 5 + 1},0\n" for row in range(100)))
    output = Path(os.fsdecode(os.fsencode(tmp_path) + b"/out\n\xfe.csv"))
    text = good("replay", path, "--vehicle", "xgd24d", "-o", output)
    assert all(line.isprintable() for line in text.split("\n"))
    assert "odd\\x07\\u2028name" in text
    assert "out\\n\\udcfe.csv" in text
    assert output.exists()


@pytest.mark.parametrize("suffix", [".csv", *OWN])
@settings(max_examples=25, deadline=None)
@given(head=st.sampled_from([b"", *CONTENTS.values(), CSV]), rest=st.binary(max_size=300))
def test_any_bytes_are_read_or_refused_in_one_line(tmp_path_factory, suffix, head, rest):
    path = tmp_path_factory.mktemp("any") / f"run{suffix}"
    path.write_bytes(head + rest)
    text = refusal(path)
    assert text.isprintable()
    assert OWN_FAULT not in text


def refusal(path: Path) -> str:
    """Refusal of a table or bag; empty if it is read."""
    try:
        speeds(path, None).report()
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (MemoryError(), "content that takes more than 768 MB of memory, and 32 times the size of the file"),
        (RecursionError("maximum depth"), "nested too deeply"),
        (OSError(5, "Input/output error"), "given 'Input/output error'"),
        (EOFError("cut"), "EOFError: cut"),
        (UnicodeDecodeError("utf-8", b"\xff", 0, 1, "bad\nbyte"), "UnicodeDecodeError"),
    ],
)
def test_what_any_library_raises_is_one_line_with_its_cause(error, says):
    with pytest.raises(InputError) as error_info, reading(Path("run.csv"), "a table"):
        raise error
    assert says in str(error_info.value)
    assert str(error_info.value).startswith("run.csv: given")
    assert str(error_info.value).isprintable()
    assert error_info.value.__cause__ is error


def test_a_fault_of_our_own_is_said_to_be_one(tmp_path, monkeypatch):
    path = tmp_path / "run.csv"
    path.write_bytes(CSV)
    monkeypatch.setattr("trackres_ros.recording.channel_source.torque_columns", lambda *_: 1 // 0)
    with pytest.raises(ZeroDivisionError):  # outside of reading a fault is unchanged
        open_source([path])
    monkeypatch.setattr("trackres_ros.recording.text_table.header_of", lambda *_: "none")
    with pytest.raises(InputError, match=r"AttributeError: .* at text_table\.py:\d+") as error_info:
        open_source([path])
    assert OWN_FAULT in str(error_info.value)


# --- tables


def test_50_000_columns(tmp_path, refused):
    path = tmp_path / "run.csv"
    names = ",".join(f"c{number}" for number in range(50_000))
    path.write_text(f"{names},time_s,speed_mps\n" + "0," * 50_000 + "0,3\n")
    recording = speeds(path, None)
    assert recording.series["speed"].value.tolist() == [3.0]
    assert "and 49980 more" in recording.notes[-1]
    path.write_text(f"{names}\n")
    assert "and 49980 more" in refused(path)


def test_every_damage_of_an_archive_is_said(tmp_path):
    path = tmp_path / "run.csv.gz"
    total = gzip.compress(b"time_s,speed_mps\n" + b"".join(b"%d,%d\n" % (row, row * row % 97) for row in range(2000)))
    for place in range(0, len(total), 37):
        path.write_bytes(total[:place] + bytes([total[place] ^ 0x55]) + total[place + 1 :])
        text = refusal(path)
        assert OWN_FAULT not in text
        assert str(path) in text or len(speeds(path, None).series["speed"]) == 2000


@pytest.mark.parametrize(
    ("text", "rows", "kind", "count"),
    [
        ('time_s,speed_mps,note\n0,1,"a\n1,2,b\n2,3,c\n', 1, "quoted", 2),
        ('time_s,speed_mps,note\n0,1,"a\n1,2,b"\n2,3,c\n', 2, "quoted", 1),
        ('time_s,speed_mps,note\n0,1,"a"\n\n1,2,b\n', 2, "", 0),
        ("time_s,speed_mps\n0,1\n1,2", 2, "cut", 1),
        ("time_s,speed_mps,note\n0,1,a\n1,2", 1, "cut", 1),
        ('time_s,speed_mps,note\n0,1,"a"\n1,', 1, "cut", 1),
        ("time_s,speed_mps\n0,1\n1,-", 1, "cut", 1),
        ("speed_mps,time_s\n1,0\n2,", 1, "cut", 1),
        ("speed_mps;timestamp\n1,5;23.11.2026 10:00:00\n2,5;23.11.20", 1, "cut", 1),
        ("time_s;speed_mps\n0;1.000,5\n1;1.00", 1, "cut", 1),
    ],
)
def test_lines_that_are_no_rows_are_counted(tmp_path, reader, text, rows, kind, count):
    path = tmp_path / "run.csv"
    path.write_text(text)
    recording = speeds(path, None)
    assert len(recording.series["speed"]) == rows
    assert found(recording) == ({kind: count} if kind else {})


def test_parquet_in_bounded_memory_and_damage_in_it(tmp_path):
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    peaks = []
    for rows in (200_000, 2_000_000):
        path = tmp_path / f"{rows}.parquet"
        time_s = np.arange(rows) / 100
        table = pa.table({"time_s": time_s, "speed_mps": np.sin(time_s), "note": np.zeros(rows)})
        parquet.write_table(table, path, row_group_size=rows, compression="none")
        del table
        pool, result_before = pa.proxy_memory_pool(pa.default_memory_pool()), pa.default_memory_pool()
        pa.set_memory_pool(pool)
        try:
            assert sum(map(len, open_source([path]).blocks())) == rows
        finally:
            pa.set_memory_pool(result_before)
        peaks.append(pool.max_memory())
    assert peaks[1] < 1.5 * peaks[0]
    path = tmp_path / "run.parquet"
    write_table(path, {"time_s": np.arange(1000.0), "speed_mps": np.sin(np.arange(1000.0))})
    data = bytearray(path.read_bytes())
    data[5000] ^= 1
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"could not verify page integrity|checksum|CRC"):
        speeds(path, None)


# --- bags


def folder_bag(path: Path, storage: str = "SQLITE3", compression: str = "", count: int = 20) -> Path:
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage])
    if compression:
        writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    fill(writer, (("/speed", TWIST, START + row, raw) for row, raw in enumerate(messages(count))))
    return path


def put(path: Path, column: str, value: object, row: int) -> None:
    """Replace what a database holds of one message."""
    with closing(sqlite3.connect(path)) as database, database:
        database.execute(f"UPDATE messages SET {column} = ? WHERE id = ?", (value, row))


def messages(count: int) -> list[bytes]:
    speeds = (build(TWIST, header=stamped(START, ""), twist=twist(float(row))) for row in range(count))
    return [bytes(STORE.serialize_cdr(message, TWIST)) for message in speeds]


def test_log_times_beyond_the_clock_are_counted(tmp_path):
    times = [START, 2**63, START + 1, 2**64 - 1, START + 2, 2**62]
    recording = speeds(write_speeds(tmp_path / "run.mcap", TWIST, zip(times, messages(6), strict=True)))
    assert recording.series["speed"].value.tolist() == [0.0, 2.0, 4.0]
    assert found(recording)["unusable"] == 3


def test_rows_of_a_database_of_any_type_are_counted(tmp_path):
    path = folder_bag(tmp_path / "bag") / "bag.db3"
    with closing(sqlite3.connect(path)) as database:
        loose = "CREATE TABLE loose AS SELECT * FROM messages; DROP TABLE messages; ALTER TABLE loose RENAME TO messages"
        database.executescript(loose)
    for row, (column, value) in enumerate([
        ("timestamp", None), ("timestamp", "soon"), ("timestamp", 1.5), ("timestamp", -1), ("timestamp", 2**63 - 1),
        ("timestamp", b"12345678"), ("data", None), ("data", "text"), ("data", 5), ("topic_id", 77), ("topic_id", None),
        ("topic_id", "one"),
    ]):  # fmt: skip
        put(path, column, value, row + 1)
    for bag in (path, path.parent):
        recording = speeds(bag)
        assert recording.series["speed"].value.tolist() == [float(row) for row in range(12, 20)]
        assert {"unusable": 9, "unknown_topic": 3}.items() <= found(recording).items()
        assert any("3 messages of topics that the bag does not describe" in line for line in recording.report())


@pytest.mark.parametrize("column", ["name", "type"])
def test_a_topic_without_a_name_or_a_type_is_refused(tmp_path, refused, column):
    path = folder_bag(tmp_path / "bag") / "bag.db3"
    with closing(sqlite3.connect(path)) as database, database:
        database.executescript(
            "CREATE TABLE loose AS SELECT * FROM topics; DROP TABLE topics; ALTER TABLE loose RENAME TO topics"
        )
        database.execute(f"UPDATE topics SET {column} = NULL")
    assert str(path) in refused(path)


ARRAY = f"{{}}\nfloat64 speed\n{'=' * 80}\nMSG: my_msgs/E\n{{}}\n"


@pytest.mark.parametrize(
    ("first", "element"),
    [
        ("my_msgs/E[999999999] many", "uint8 a"),
        ("my_msgs/E[999999999] many", "string a"),
        ("my_msgs/E[9999] many", "uint8[99999] a"),
        ("float64[999999999] many", "uint8 a"),
        ("my_msgs/E one", "my_msgs/E again"),
    ],
)
def test_definitions_of_arrays_without_end(tmp_path, first, element):
    text, row = ARRAY.format(first, element), (START, b"\0\1\0\0" + bytes(64))
    path = write_speeds(tmp_path / "run.mcap", "my_msgs/msg/Mine", [row], text)
    topics = Topics.parse({"speed": {"topic": "/speed", "type": "my_msgs/msg/Mine", "field": "speed"}})
    if "again" in element:
        with pytest.raises(InputError, match=rf"{path}: given 'nested too deeply'"):
            speeds(path, topics)
    else:
        assert found(speeds(path, topics))["malformed"] == 1


def test_a_folder_called_like_a_bag_of_ros_1(tmp_path):
    assert len(speeds(folder_bag(tmp_path / "run.bag")).series["speed"]) == 20


@pytest.mark.parametrize("counts", [(3,), (0,), (3, 200)])
def test_an_element_beyond_the_end_of_an_array(tmp_path, refused, counts):
    raws = [STORE.serialize_cdr(build(FLOATS, data=np.ones(count)), FLOATS) for count in counts]
    rows = (("/speed", FLOATS, START + row, raws[row % len(raws)]) for row in range(10))
    fill(Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP), rows)
    topics = Topics.parse({"speed": {"topic": "/speed", "type": FLOATS, "field": "data[99]"}}, "topics.yaml")
    only = f"the array data has {'only 3 elements' if counts[0] else 'no elements'}"
    if len(counts) == 1:
        with pytest.raises(InputError, match=rf"topics\.yaml: speed: field: given 'data\[99\], {only}'"):
            speeds(tmp_path / "bag", topics)
    else:
        recording = speeds(tmp_path / "bag", topics)
        assert len(recording.series["speed"]) == 5
        assert any(f"5 messages do not have data[99]: {only}" in line for line in recording.report())


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a: &a [*a]\nb: [*a, *a]\n", "bag"),
        ("a: " + "[" * 100_000, "bag"),
        ("rosbag2_bagfile_information: 5", "bag"),
        ("a: [", "ReaderError"),
        ("\xff: \x00", "ReaderError"),
    ],
)
def test_metadata_that_no_recorder_writes(tmp_path, refused, text, says):
    path = folder_bag(tmp_path / "bag")
    (path / "metadata.yaml").write_text(text)
    assert says in refused(path)


@pytest.mark.parametrize("count", [-1, 2**63, 10**400, "many", None, 1.5, [1], True])
def test_counts_of_any_kind(tmp_path, count):
    path = folder_bag(tmp_path / "bag") / "metadata.yaml"
    content = yaml.safe_load(path.read_text())
    content["rosbag2_bagfile_information"]["topics_with_message_count"][0]["message_count"] = count
    path.write_text(yaml.safe_dump(content))
    recording = speeds(path.parent)
    assert len(recording.series["speed"]) == 20
    assert ("structure" in found(recording)) is (count is not True)


def test_what_is_too_long_to_be_looked_at_is_said_and_not_kept(tmp_path, monkeypatch):
    path = tmp_path / "run.csv"
    path.write_text("time_s,speed_mps\n" + "".join(f"{row},1\n" for row in range(30_000)))
    for most, dropped in ((30_000, False), (29_999, True)):
        monkeypatch.setattr(replay_run, "MOST_KEPT", most)
        source = KeptSource(open_source([path]), keep=True)
        assert sum(map(len, source.blocks())) == 30_000
        assert any(finding.kind == "too_long" for finding in source.all_findings()) is dropped
        assert any(finding.kind == "stuck" for finding in source.all_findings()) is not dropped


def test_the_search_for_defects_joins_one_role_at_a_time(peak_of):
    roles, rows = ("load", "torque", "ambient", "speed"), 50_000
    of_role, stamp = np.tile(np.arange(4, dtype=np.int16), rows), np.repeat(np.arange(rows) * 10_000_000, 4)
    value = np.where((stamp // 10**9 % 100 < 80) | (of_role == 2), 5.0, np.arange(4 * rows))  # at times stuck
    kept = [
        SampleBlock(*(entry[item : item + 20_000] for entry in (of_role, stamp, stamp, value)))
        for item in range(0, 4 * rows, 20_000)
    ]
    long = SimpleNamespace(
        name="run", roles=roles, notes=(), findings=(), torque_candidates=(), zero_is_unset=False, blocks=lambda *_: iter(kept)
    )
    source = KeptSource(long, keep=True)
    assert sum(map(len, source.blocks())) == 4 * rows
    result, peak = peak_of(source.all_findings)
    assert result == Recording.from_source(long).findings
    assert {entry.role for entry in result if entry.kind == "stuck"} == {"torque", "speed"}
    assert peak < 1.5 * (of_role.nbytes + 2 * stamp.nbytes + value.nbytes), peak
