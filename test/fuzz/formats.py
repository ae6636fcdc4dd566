# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Small files of every kind, their content, and how a damaged copy is read and classified."""

from __future__ import annotations

import atexit
import contextlib
import gzip
import random
import re
import shutil
import struct
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from drive_files import DBC, KINDS, Drive, topics_of
from mutator import mutations

from trackres_ros.errors import InputError
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.opening import open_source
from trackres_ros.recording.reading import OWN_FAULT
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.text_table import NO_VALUE

ROWS, LOAD_EVERY = 60, 3
START_NS, STEP_NS = 1_700_000_000 * 10**9, 20_000_000
SPEED, LOAD = "geometry_msgs/msg/TwistStamped", "std_msgs/msg/Float64"
TOPICS = Topics.parse(
    {
        "speed": {"topic": "/vehicle/speed", "type": SPEED, "field": "twist.linear.x"},
        "load": {"topic": "/vehicle/load", "type": LOAD, "field": "data"},
    },
    "topics.yaml",
)
EXPECTED = Counter({"speed": ROWS, "load": ROWS // LOAD_EVERY})
METADATA_SHARE = 0.2  # of the mutations of a folder that hit its metadata.yaml
LOSSES = ("missing", "unusable", "unknown_topic", "other_bus", "unlisted", "malformed", "absent", "quoted", "cut", "comment")
MOST_OF_A_LINE = 8000
LINES = {
    ".log": {
        "speed": rb"^\(\d+\.\d+\) \w+ 100#[0-9A-F]{16} [RT]$",
        "load": rb"^\(\d+\.\d+\) \w+ 100#[0-9A-F]{4}01[0-9A-F]{10} [RT]$",
        "ambient": rb"^\(\d+\.\d+\) \w+ 0CFEF517#F{6}(?!FF)[0-9A-F]{10} [RT]$",
        "torque": rb"^\(\d+\.\d+\) \w+ 1CEB(FF|21)17#03[0-9A-F]{14} [RT]$",
    },
    ".asc": {
        "speed": rb"^ *\d+\.\d+ 1  100 +Rx   d 8( [0-9A-F]{2}){8}$",
        "load": rb"^ *\d+\.\d+ 1  100 +Rx   d 8( [0-9A-F]{2}){2} 01( [0-9A-F]{2}){5}$",
        "ambient": rb"^ *\d+\.\d+ 1  CFEF517x +Rx   d 8( FF){3} (?!FF)[0-9A-F]{2}( [0-9A-F]{2}){4}$",
        "torque": rb"^ *\d+\.\d+ 1  1CEB(FF|21)17x +Rx   d 8 03( [0-9A-F]{2}){7}$",
    },
    ".vbo": {
        role: rb"^\d{6}\.\d\d" + b" [^ ]+" * place + rb" [-+\d.]+" + b" [^ ]+" * (3 - place) + b"$"
        for place, role in enumerate(("speed", "load", "ambient", "torque"))
    },
    ".lvm": {
        role: rb"^\d+,\d+" + b"\t[^\t]*" * place + rb"\t[-+]?\d[\d,]*" + b"\t[^\t]*" * (3 - place) + b"(\t.*)?$"
        for place, role in enumerate(("speed", "load", "ambient", "torque"))
    },
}
"""Whole lines of a log of frames that hold a sample."""


@dataclass(frozen=True)
class Format:
    """A kind of file: how a small one is written, and where."""

    name: str
    write: Callable[[Path], None]
    file: str  # the name of the file or folder that is read
    topics: Topics | None = None
    expected: Counter[str] = field(default_factory=lambda: EXPECTED)


def _store(version: str) -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores[version])


def _traffic(store: Any, serialise: Callable[[Any, str], Any]) -> Iterator[tuple[str, str, int, bytes]]:
    """Yield topic, type, log time and message."""
    types = store.types
    vector = types["geometry_msgs/msg/Vector3"]
    for row in range(ROWS):
        at_ns = START_NS + row * STEP_NS
        stamp = types["builtin_interfaces/msg/Time"](*divmod(at_ns, 10**9))
        first = [row] if "seq" in types["std_msgs/msg/Header"].__annotations__ else []
        header = types["std_msgs/msg/Header"](*first, stamp, "base")
        twist = types["geometry_msgs/msg/Twist"](vector(5.0 + row / 10, 0.0, 0.0), vector(0.0, 0.0, 0.0))
        yield "/vehicle/speed", SPEED, at_ns, bytes(serialise(types[SPEED](header, twist), SPEED))
        if row % LOAD_EVERY == 0:
            yield "/vehicle/load", LOAD, at_ns + 1, bytes(serialise(types[LOAD](2e5 + row), LOAD))
        if row % 5 == 0:
            text = "std_msgs/msg/String"
            yield "/chatter", text, at_ns + 2, bytes(serialise(types[text]("x" * row), text))


def _mcap(**options: Any) -> Callable[[Path], None]:
    """Write with the reference implementation of the format."""

    def write(folder: Path) -> None:
        from mcap.writer import CompressionType, Writer

        store = _store("LATEST")
        compression = CompressionType[options.get("compression", "none").upper()]
        with (folder / "run.mcap").open("wb") as file:
            writer = Writer(file, chunk_size=2048, compression=compression, use_chunking=options.get("chunked", True))
            writer.start("ros2", "fuzz")
            channels: dict[str, int] = {}
            for topic, msgtype, at_ns, raw in _traffic(store, store.serialize_cdr):
                if topic not in channels:
                    text = store.generate_msgdef(msgtype, ros_version=2)[0]
                    schema = writer.register_schema(msgtype, "ros2msg", text.encode())
                    channels[topic] = writer.register_channel(topic, "cdr", schema)
                writer.add_message(channels[topic], at_ns, raw, at_ns)
            writer.finish()

    return write


def _own_mcap(folder: Path) -> None:
    """Write with our own writer."""
    from trackres_ros.output.mcap import BagWriter

    with BagWriter(folder / "run.mcap") as writer:
        topics: dict[str, Any] = {}
        for topic, msgtype, at_ns, raw in _traffic(writer.typestore, writer.typestore.serialize_cdr):
            if topic not in topics:
                topics[topic] = writer.topic(topic, msgtype)
            writer.write(topics[topic], writer.typestore.deserialize_cdr(raw, msgtype), at_ns, at_ns)


def _fill(writer: Any, store: Any, serialise: Callable[[Any, str], Any]) -> None:
    """Write with the library rosbags."""
    with writer:
        connections: dict[str, Any] = {}
        for topic, msgtype, at_ns, raw in _traffic(store, serialise):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=store)
            writer.write(connections[topic], at_ns, raw)


def _rosbag2(storage: str, compression: str = "") -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

        store = _store("LATEST")
        writer = Writer(folder / "run", version=9, storage_plugin=StoragePlugin[storage])
        if compression:
            writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
        _fill(writer, store, store.serialize_cdr)

    return write


def _db3(folder: Path) -> None:
    _rosbag2("SQLITE3")(folder)
    (folder / "run" / "run.db3").rename(folder / "run.db3")
    shutil.rmtree(folder / "run")


def _ros1(compression: str) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        from rosbags.rosbag1 import Writer

        store = _store("ROS1_NOETIC")
        writer = Writer(folder / "run.bag")
        if compression != "NONE":
            writer.set_compression(Writer.CompressionFormat[compression])
        writer.chunk_threshold = 2048
        _fill(writer, store, store.serialize_ros1)

    return write


def _table(suffix: str) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        from trackres_ros.output.table import write_table

        row = np.arange(ROWS)
        load = np.where(row % LOAD_EVERY == 0, 2e5 + row, np.nan)
        note = np.array([f"lap {number}" for number in row])
        write_table(folder / f"run{suffix}", {"time_s": row / 50, "speed_mps": 5.0 + row / 10, "weight_n": load, "note": note})

    return write


def _clock(row: int) -> datetime:
    return datetime(2026, 11, 23, 10) + timedelta(milliseconds=20 * row)


def _german(folder: Path) -> None:
    """Semicolons, decimal commas, day first, CRLF, a byte order mark."""
    lines = ["timestamp;speed_mps;weight_n;note"]
    for row in range(ROWS):
        load = f"{2e5 + row:.1f}" if row % LOAD_EVERY == 0 else ""
        numbers = f"{5.0 + row / 10:.2f};{load}".replace(".", ",")
        lines.append(f"{_clock(row):%d.%m.%Y %H:%M:%S,%f};{numbers};lap {row}")
    (folder / "run.csv").write_bytes(b"\xef\xbb\xbf" + "\r\n".join([*lines, ""]).encode())


def _american(folder: Path) -> None:
    """Tabs, month first, which the whole column has to show, CR, numbers in quotes with commas between thousands."""
    lines = ["timestamp\tspeed_mps\tweight_n\tnote"]
    for row in range(ROWS):
        load = f'"{2e5 + row:,.1f}"' if row % LOAD_EVERY == 0 else ""
        lines.append(f"{_clock(row):%m/%d/%Y %H:%M:%S.%f}\t{5.0 + row / 10}\t{load}\tlap {row}")
    (folder / "run.csv").write_bytes("\r".join([*lines, ""]).encode())


def _excel(folder: Path) -> None:
    from openpyxl import Workbook

    book = Workbook()
    book.active.append(["a drive"])
    sheet = book.create_sheet("drive")
    sheet.append(["timestamp", "speed_mps", "weight_n", "note"])
    for row in range(ROWS):
        load = f"{2e5 + row:.1f}".replace(".", ",") if row % LOAD_EVERY == 0 else None
        sheet.append([_clock(row), 5.0 + row / 10, load, f"lap {row}"])
    book.save(folder / "run.xlsx")


def _of_drive(kind: str) -> Format:
    """One of the formats in which tests write the same drive."""
    name, writer = KINDS[kind]
    topics = Topics.parse(topics_of(kind), "topics.yaml", DBC_FOLDER)
    drive = Drive(ROWS / 50)
    return Format(
        kind,
        lambda folder: writer(drive, folder / name),
        name,
        topics,
        Counter({"speed": 60, "load": 12, "ambient": 2, "torque": 6}),
    )


DBC_FOLDER = Path(tempfile.mkdtemp(prefix="trackres_fuzz_"))
(DBC_FOLDER / "bus.dbc").write_text(DBC)
atexit.register(shutil.rmtree, DBC_FOLDER, ignore_errors=True)

FORMATS = {one.name: one for one in (
    Format("mcap, not chunked", _mcap(chunked=False), "run.mcap", TOPICS),
    Format("mcap", _mcap(), "run.mcap", TOPICS),
    Format("mcap zstd", _mcap(compression="zstd"), "run.mcap", TOPICS),
    Format("mcap lz4", _mcap(compression="lz4"), "run.mcap", TOPICS),
    Format("mcap, our own", _own_mcap, "run.mcap", TOPICS),
    Format("mcap zstd, folder", _rosbag2("MCAP", "STORAGE"), "run", TOPICS),
    Format("sqlite3", _db3, "run.db3", TOPICS),
    Format("sqlite3, folder", _rosbag2("SQLITE3"), "run", TOPICS),
    Format("sqlite3 zstd by file", _rosbag2("SQLITE3", "FILE"), "run", TOPICS),
    Format("sqlite3 zstd by message", _rosbag2("SQLITE3", "MESSAGE"), "run", TOPICS),
    Format("ROS 1", _ros1("NONE"), "run.bag", TOPICS),
    Format("ROS 1 bz2", _ros1("BZ2"), "run.bag", TOPICS),
    Format("ROS 1 lz4", _ros1("LZ4"), "run.bag", TOPICS),
    Format("csv", _table(".csv"), "run.csv"),
    Format("csv.gz", _table(".csv.gz"), "run.csv.gz"),
    Format("csv, German", _german, "run.csv"),
    Format("csv, American", _american, "run.csv"),
    Format("xlsx", _excel, "run.xlsx"),
    Format("parquet", _table(".parquet"), "run.parquet"),
    *map(_of_drive, ("MF4", "MF4 of a bus", "BLF", "ASC", "candump", "MATLAB 5", "MATLAB 7.3")),
    *map(_of_drive, ("ULog", "VBOX", "LabVIEW")),
)}  # fmt: skip


@dataclass(frozen=True)
class Damaged:
    """One mutation: the path to read, and which file of it was changed."""

    path: Path
    changed: Path
    data: bytes
    form: Format


def damaged(form: Format, folder: Path, count: int, seed: int, start: int = 0) -> Iterator[Damaged]:
    """Write the mutations `start` and following of a small file of a format, one after another at the same place."""
    form.write(folder)
    path = folder / form.file
    files = sorted(path.iterdir(), key=lambda one: one.name == "metadata.yaml") if path.is_dir() else [path]
    originals = [file.read_bytes() for file in files]
    copies = [mutations(original, count, seed) for original in originals]
    for number in range(count):
        copy = [next(each) for each in copies]
        if number < start:
            continue
        hit = len(files) - 1 if random.Random(f"{seed} {number}").random() < METADATA_SHARE else 0
        for place, file in enumerate(files):
            file.write_bytes(copy[place] if place == hit else originals[place])
        yield Damaged(path, files[hit], copy[hit], form)


def outcome_of(one: Damaged) -> dict[str, Any]:
    """Read a damaged file as the commands do, and say what became of it."""
    try:
        source = open_source([one.path], one.form.topics)
        recording = Recording.from_source(source)
        recording.aligned()
        recording.report()
    except InputError as error:
        return _outcome_of_refusal(error)
    except Exception as error:
        return {"outcome": "traceback", "text": f"{type(error).__name__}: {error}"}
    read = Counter({role: len(series) for role, series in recording.series.items()})
    expected = _expected(one)
    short = expected - read
    lost = short.total() if source.zero_is_unset else max(short.values(), default=0)  # a row of a table is several samples
    reported = sum(finding.count for finding in recording.findings if finding.kind in LOSSES)
    words = any(finding.kind == "structure" for finding in recording.findings)
    whole = one.form.expected is not EXPECTED
    words |= not whole and any(note.startswith("ignored columns") and note != "ignored columns: note" for note in recording.notes)
    remarks = [finding.kind for finding in recording.findings]
    outcome = "lost" if lost > reported and not words else "remarks" if remarks else "alike"
    return {"outcome": outcome, "text": f"{dict(read)} of {dict(expected)}; {reported} reported; {remarks}; {recording.notes}"}


def _outcome_of_refusal(error: InputError) -> dict[str, Any]:
    text = str(error)
    if OWN_FAULT in text or not text.isprintable() or len(text) > MOST_OF_A_LINE:
        return {"outcome": "traceback", "text": text}
    return {"outcome": "refused", "text": text}


def _messages_of_ulog(data: bytes) -> Counter[str]:
    """The messages that are there: the format has no counts and no checksums."""
    found: Counter[str] = Counter()
    roles, place = ("speed", "load", "ambient", "torque"), 16
    while place + 5 <= len(data):
        length, kind, number = struct.unpack_from("<HBH", data, place)
        if kind == ord("D") and length == 21 and number < len(roles):
            found[roles[number]] += 1
        place += 3 + length
    return found


def _expected(one: Damaged) -> Counter[str]:
    """Return the samples that are in a file: of a table in text those of its lines, else those of the whole file."""
    if one.path.suffix in LINES:
        return Counter(
            {
                role: sum(bool(re.search(line, text)) for text in one.data.splitlines())
                for role, line in LINES[one.path.suffix].items()
            }
        )
    if one.path.suffix == ".ulg":
        return _messages_of_ulog(one.data)
    if ".csv" not in one.path.name:
        return one.form.expected
    data = one.data
    if one.path.suffix == ".gz":
        try:
            data = gzip.decompress(data)
        except Exception:
            return EXPECTED
    header, *lines = [line for line in data.replace(b"\r", b"\n").split(b"\n") if line]
    separator = max((b",", b";", b"\t"), key=header.count)
    names = [name.strip() for name in header.removeprefix(b"\xef\xbb\xbf").split(separator)]
    found: Counter[str] = Counter()
    for role, column in (("speed", b"speed_mps"), ("load", b"weight_n")):
        with contextlib.suppress(ValueError):
            place = names.index(column)
            cells = [line.split(separator) for line in lines]
            found[role] = sum(len(cell) > place and cell[place].strip().decode("latin-1") not in NO_VALUE for cell in cells)
    return found
