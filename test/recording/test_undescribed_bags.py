# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags that lack a type, its definition, a file in their metadata, or an encoding that is read."""

from __future__ import annotations

import shutil
import sqlite3
import struct
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import pytest

import trackres_ros as tr
from trackres_ros.errors import InputError
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.opening import open_source
from trackres_ros.recording.recording import Recording

pytest.importorskip("mcap")
pytest.importorskip("rosbags")

from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

FLOAT, MINE = "std_msgs/msg/Float64", "my_msgs/msg/State"
LINE = {"topic": "/speed", "type": FLOAT, "field": "data"}
START_NS, STEP_NS = 1_700_000_000 * 10**9, 10**8
CDR, XCDR2 = b"\0\1\0\0", b"\0\7\0\0"
STORE = get_typestore(Stores.LATEST)


def write(path: Path, raws: Sequence[bytes], schema: tuple[str, str, str] | None = None, topic: str = "/speed") -> Path:
    """An MCAP file of one topic; `schema`: name, encoding and text, or None for a channel without one."""
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2", library="a logger")
        number = writer.register_schema(schema[0], schema[1], schema[2].encode()) if schema else 0
        channel = writer.register_channel(topic, "cdr", number)
        for row, raw in enumerate(raws):
            writer.add_message(channel, START_NS + row * STEP_NS, raw, START_NS + row * STEP_NS)
        writer.finish()
    return path


def floats(count: int = 50, head: bytes = CDR) -> list[bytes]:
    return [head + struct.pack("<d", row / 10) for row in range(count)]


def folder_of(path: Path, storage: str = "mcap", compression: str = "", count: int = 50) -> Path:
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    if compression:
        writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with writer:
        topic = writer.add_connection("/speed", FLOAT, typestore=STORE)
        for row in range(count):
            writer.write(topic, START_NS + row * STEP_NS, STORE.serialize_cdr(STORE.types[FLOAT](row / 10), FLOAT))
    return path


def speeds(path: Path, **line: str) -> tuple[list[float], Recording]:
    recording = Recording.from_source(open_source([path], Topics.parse({"speed": {**LINE, **line}}, "topics.yaml")))
    return recording.series["speed"].value.tolist(), recording


def database_without(path: Path, kind: str) -> Path:
    """A database whose topic has the type `kind`, without definitions, as recorders before Iron write it."""
    file = folder_of(path, "sqlite3") / f"{path.name}.db3"
    with closing(sqlite3.connect(file)) as database, database:
        database.execute("UPDATE topics SET type = ?", (kind,))
        database.execute("DELETE FROM message_definitions")
    return file


@pytest.mark.parametrize("kind", ["", MINE])
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_topic_without_a_definition_is_read_as_given(tmp_path: Path, storage: str, kind: str) -> None:
    if storage == "mcap":
        path = write(tmp_path / "run.mcap", floats(), (kind, "", "") if kind else None)
    else:
        path = database_without(tmp_path / "bag", kind)
    values, recording = speeds(path)
    assert values == [row / 10 for row in range(50)]
    assert any(note.startswith(f"/speed: {FLOAT}, as the topics file says") for note in recording.notes)
    with pytest.raises(InputError, match=rf"/speed \({kind or 'no type'}\).*give it in a topics file: speed: "):
        open_source([path])


def test_a_type_is_taken_from_another_topic_of_the_bag(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", floats())
    write(tmp_path / "b.mcap", floats(3), (MINE, "ros2msg", "float64 speed\n"), topic="/other")
    topics = Topics.parse({"speed": {**LINE, "type": MINE, "field": "speed"}}, "topics.yaml")
    recording = Recording.from_source(open_source([tmp_path / "a.mcap", tmp_path / "b.mcap"], topics))
    assert recording.series["speed"].value.tolist() == [row / 10 for row in range(50)]


def test_a_defined_topic_keeps_its_type(tmp_path: Path) -> None:
    path = write(tmp_path / "run.mcap", floats(), (MINE, "ros2msg", "float64 speed\n"))
    with pytest.raises(InputError, match=f"speed: type: given '{FLOAT}'; allowed: {MINE}, as /speed has in the bag"):
        speeds(path)


def test_a_given_type_that_nothing_defines_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "run.mcap", floats())
    with pytest.raises(InputError, match=f"{MINE}.*the bag does not define it"):
        speeds(path, type=MINE)


WIDE_TEXTS = {
    "ros2msg": "wstring NAME='x = 1'\nwstring note\nwstring<=9 short \"a # b\"\nwstring[] notes\n"
    "wstring<=5[<=3] few\nfloat64 speed\n",
    "ros2idl": "module my_msgs { module msg { struct State { wstring note; wstring<9> brief; sequence<wstring> notes; "
    "sequence<wstring<5>, 3> few; double speed; }; }; };",
}


@pytest.mark.parametrize("unit", [2, 4])
@pytest.mark.parametrize("encoding", WIDE_TEXTS)
def test_a_type_with_wide_texts_is_read(tmp_path: Path, encoding: str, unit: int) -> None:
    def text(content: str) -> bytes:
        units = content.encode("utf-16-le" if unit == 2 else "utf-32-le")
        return struct.pack("<I", len(content)) + units + b"\0" * (-len(units) % 4)

    def message(speed: float) -> bytes:
        body = text("Größe") + text("N") + struct.pack("<I", 2) + text("links") + text("") + struct.pack("<I", 1) + text("auf")
        return CDR + body + b"\0" * (-len(body) % 8) + struct.pack("<d", speed)

    definition = WIDE_TEXTS[encoding]
    if encoding == "ros2idl":
        definition = f"{'=' * 80}\nIDL: {MINE}\n{definition}\n"
    path = write(tmp_path / "run.mcap", [message(row / 10) for row in range(50)], (MINE, encoding, definition))
    values, recording = speeds(path, type=MINE, field="speed")
    assert values == [row / 10 for row in range(50)]
    assert recording.findings == ()
    with pytest.raises(InputError, match="a number, not wstring"):
        speeds(path, type=MINE, field="note")


@pytest.mark.parametrize("compression", ["", "file"])
def test_a_file_that_the_metadata_lacks_is_named(tmp_path: Path, compression: str) -> None:
    """It is read where it is named after the folder, and not twice."""
    path = folder_of(tmp_path / "bag", compression=compression)
    assert speeds(path)[1].findings == ()
    listed = next(file for file in path.iterdir() if file.name != "metadata.yaml")
    later = path / listed.name.replace("bag", "bag_1")
    shutil.copy(listed, later)
    values, recording = speeds(path)
    assert len(values) == 50
    (finding,) = recording.findings
    assert later.name in finding.text
    assert "name it after the folder" in finding.text
    if not compression:
        both = tr.read([path, later], topics={"speed": LINE})
        assert len(both.series["speed"]) == 100
        assert not any(later.name in finding.text for finding in both.findings)


def test_speeds_in_xcdr2_are_refused_by_that_name(tmp_path: Path) -> None:
    path = write(tmp_path / "run.mcap", floats(head=XCDR2), (FLOAT, "ros2msg", "float64 data\n"))
    with pytest.raises(InputError, match=r"50 messages in the representation XCDR2 \(PLAIN_CDR2\).*have their writer use XCDR1"):
        speeds(path)


def test_one_message_in_another_representation_is_a_finding(tmp_path: Path) -> None:
    raws = floats()
    raws[7] = XCDR2 + raws[7][4:]
    _, recording = speeds(write(tmp_path / "run.mcap", raws, (FLOAT, "ros2msg", "float64 data\n")))
    texts = {finding.kind: finding.text for finding in recording.findings}
    assert "XCDR2" in texts["malformed"]
    assert "XCDR1" in texts["malformed"]
