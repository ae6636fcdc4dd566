# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Opens bags with the installed library, yields their messages, and counts those that a bag declares."""

from __future__ import annotations

import itertools
import os
import shlex
import shutil
import sqlite3
import struct
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path, PurePath
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple
from urllib.parse import quote

import yaml

from trackres_ros.errors import InputError, MissingExtraError, shown
from trackres_ros.recording.mcap import (
    CHUNK,
    DATA_END,
    FOOTER,
    HEAD,
    HEADER,
    MAGIC,
    MESSAGE_INDEX,
    McapIndex,
    UnfinishedBag,
    is_unfinished,
    text,
    unpack_zstd,
    zstd,
)
from trackres_ros.recording.reading import check_file, check_there, reading

if TYPE_CHECKING:
    from rosbags.interfaces import Connection as RosbagsConnection
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2


ROWS = "SELECT topic_id, count(*) FROM messages NOT INDEXED GROUP BY topic_id"
DATA, SUMMARY = {0x03, 0x04, 0x05, CHUNK, MESSAGE_INDEX, 0x09, 0x0C, DATA_END}, {FOOTER, 0x03, 0x04, 0x08, 0x0A, 0x0B, 0x0D, 0x0E}
"""Kinds of records before and behind the end of the data."""
FOOTER_BYTES = 20
MOST_MESSAGES = 2**48
"""No disk holds as many; larger counts are ignored."""
INDEX_DATA = 4
"""Kind of the record of ROS 1 that counts the messages of one connection in the chunk before it."""


@dataclass(slots=True)
class MessageCounts:
    """The numbers of messages that a bag states."""

    by_topic: Counter[str] = field(default_factory=Counter)  # messages by topic
    unknown_count: int = 0  # messages of a topic that the bag does not describe
    remarks: list[str] = field(default_factory=list)  # faults of the counts themselves

    def add(self, names: dict[Any, str], counts: dict[Any, int]) -> None:
        """Add counts by identity of a connection."""
        for number, count in counts.items():
            if number in names:
                self.by_topic[names[number]] += self.check_count(count)
            else:
                self.unknown_count += self.check_count(count)

    def check_count(self, count: object) -> int:
        """Return a valid count; an invalid one adds a remark."""
        if isinstance(count, int) and 0 <= count <= MOST_MESSAGES:
            return count
        self.remarks.append(f"it counts {shown(count)} messages: the losses cannot be determined")
        return 0


def counts_of(reader: Any, path: Path) -> MessageCounts:
    """Return the counts of a bag that is open. `reader`: of ROS 1 or 2; `path`: the bag."""
    counts = MessageCounts()
    if hasattr(reader, "chunk_infos"):
        _count_ros1(reader, path, counts)
    else:
        for storage in storages_of(reader):
            names = {connection.id: connection.topic for connection in storage.connections}
            if getattr(storage, "dbconn", None) is not None:
                counts.add(names, dict(storage.dbconn.execute(ROWS)))
            else:
                indexed: Counter[int] = Counter()
                for chunk in storage.chunks:
                    indexed.update(chunk.channel_count)
                counts_stated = Counter(storage.statistics.channel_message_counts) if storage.statistics else Counter[int]()
                counts.add(names, counts_stated | indexed)
                counts.remarks += _look_at_mcap(storage)
    by_topic: Counter[str] = Counter()
    for connection in reader.connections:
        by_topic[connection.topic] += counts.check_count(connection.msgcount)
    counts.by_topic |= by_topic
    counts.unknown_count = max(counts.unknown_count, counts.check_count(reader.message_count) - counts.by_topic.total())
    return counts


def unlisted_files(reader: Any, path: Path, paths: Collection[Path]) -> Iterator[str]:
    """Report recordings in the folder of a bag that its metadata.yaml does not list.

    They may be the end of the drive, or a copy of a listed one. So they are named and not read. `paths`: what is read anyway.
    """
    listed_names = {PurePath(str(storage.path)).name for storage in storages_of(reader)}
    listed_names |= {other.name for other in paths if other.parent.resolve() == path.resolve()}
    for file in sorted(path.iterdir()) if path.is_dir() else ():
        name = file.name.removesuffix(".zstd")
        if PurePath(name).suffix in STORAGES and not {name, file.name} & listed_names:
            yield (
                f"{file.name} is in the folder, and metadata.yaml does not list it: it is not read; if it is part of the drive, "
                f"name it after the folder, or run: ros2 bag reindex {shlex.quote(str(path))}"
            )


def storages_of(reader: Any) -> Sequence[Any]:
    """Return the files of a rosbag2 as opened by rosbags; none of a ROS 1 bag."""
    if not hasattr(reader, "storage"):
        return ()
    return getattr(reader.storage, "storages", (reader.storage,))


def _look_at_mcap(storage: Any) -> Iterator[str]:
    """Report gaps between the records of an MCAP file, and messages missing in its index."""
    if isinstance(storage.path, UnfinishedBag):
        yield storage.path.remark
        return
    with storage.path.open("rb") as file:
        size = file.seek(0, 2) - len(MAGIC)
        offset, kind, chunks, allowed = len(MAGIC), 0, 0, {HEADER}
        while offset < size and kind != FOOTER:
            file.seek(offset)
            previous_kind, (kind, length) = kind, HEAD.unpack(file.read(HEAD.size).ljust(HEAD.size))
            if kind not in allowed or (kind == MESSAGE_INDEX and previous_kind not in (CHUNK, MESSAGE_INDEX)):
                break
            allowed = SUMMARY if kind == DATA_END or allowed is SUMMARY else DATA
            chunks += kind == CHUNK
            offset += HEAD.size + length
        if offset != size:
            yield f"records are not contiguous at byte {offset}: later messages may be lost"
        elif chunks != len(storage.chunks):
            yield f"the index names {len(storage.chunks)} of {chunks} chunks: messages may be lost"
        file.seek(size - FOOTER_BYTES)
        if not any(file.read(8)):
            yield "the file has no summary: messages lost before it was closed cannot be detected"


def _count_ros1(reader: Any, path: Path, counts: MessageCounts) -> None:
    """Add the larger of the counts in the index and in the chunks themselves, connection by connection."""
    names = {connection.id: connection.topic for connection in reader.connections}
    indexed: Counter[int] = Counter()
    for info in reader.chunk_infos:
        indexed.update(info.connection_counts)
    in_chunks: Counter[int] = Counter()
    with path.open("rb") as file:
        for head in _records(file, counts):
            if head.get(b"op") == bytes([INDEX_DATA]) and len(head.get(b"conn", b"")) == len(head.get(b"count", b"")) == 4:
                in_chunks[int.from_bytes(head[b"conn"], "little")] += int.from_bytes(head[b"count"], "little")
    counts.add(names, in_chunks | indexed)


def _records(file: BinaryIO, counts: MessageCounts) -> Iterator[dict[bytes, bytes]]:
    """Yield the heads of the records of a ROS 1 bag, as far as one follows on the other."""
    size = file.seek(0, 2)
    file.seek(0)
    file.readline(64)
    while (start := file.tell()) < size:
        length = _length(file, size)
        head = file.read(length) if length < size else b""
        file.seek(_length(file, size), 1)
        if file.tell() > size or not head:
            counts.remarks.append(f"records are not contiguous at byte {start}: later messages may be lost")
            return
        yield _fields(head)


def _length(file: BinaryIO, size: int) -> int:
    raw = file.read(4)
    return int(struct.unpack("<I", raw)[0]) if len(raw) == 4 else size


def _fields(head: bytes) -> dict[bytes, bytes]:
    fields = {}
    offset = 0
    while offset + 4 <= len(head):
        length = int.from_bytes(head[offset : offset + 4], "little")
        name, _, value = head[offset + 4 : offset + 4 + length].partition(b"=")
        fields[name] = value
        offset += 4 + length
    return fields


STORAGES = {".mcap": "mcap", ".db3": "sqlite3"}
LAST_VERSION = 9
"""Of metadata.yaml, as of Lyrical."""


class RosError(Exception):
    """Exceptions of the ROS 2 libraries for a bag, and for faults of its metadata."""


@dataclass(frozen=True, slots=True)
class RosTopic:
    """A topic of a bag: its number in the file, name, type, the definition in the bag, and its count of messages."""

    id: int
    topic: str
    msgtype: str
    msgdef: str
    msgcount: int


@dataclass(slots=True)
class RosFile:
    """One file of a bag."""

    path: Path | UnfinishedBag
    place: Path  # file to read: its finished or unpacked copy, if there is one
    kind: str  # ``mcap`` or ``sqlite3``
    connections: list[RosTopic] = field(default_factory=list)
    # of an MCAP file, from its index
    chunks: Sequence[Any] = ()
    statistics: Any = None
    dbconn: sqlite3.Connection | None = None  # of a database, to count its rows

    def open(self) -> None:
        """Read topics, counts and index. Raises RosError if it cannot be read."""
        names: dict[int, str] = {}
        if self.kind == "mcap":
            index = McapIndex(self.place)
            self.chunks, self.statistics, names = index.chunks, index.statistics, index.topics
        else:
            self.dbconn = sqlite3.connect(f"file:{quote(bytes(self.place.absolute()))}?immutable=1", uri=True)
            names = dict(self.dbconn.execute("SELECT id, name FROM topics"))
        reader = _open_storage(self)
        numbers = {name: number for number, name in names.items()}
        with _log_details():
            texts = {
                topic_info.topic_type: topic_info.encoded_message_definition
                for topic_info in reader.get_all_message_definitions()
            }
            for info in reader.get_metadata().topics_with_message_count:
                topic = info.topic_metadata
                number = numbers.get(topic.name, topic.id)
                topic_info = RosTopic(number, topic.name, topic.type, texts.get(topic.type, ""), info.message_count)
                self.connections.append(topic_info)
        self.connections.sort(key=lambda topic_info: topic_info.id)

    def messages(self, wanted_topics: Sequence[RosTopic]) -> Iterator[tuple[RosTopic, int, bytes]]:
        """Return topic, log time [ns] and content of the messages of some topics, in the order of log times.

        Raises RosError if the file breaks off or is damaged.
        """
        import rosbag2_py

        topics = {one.topic: one for one in wanted_topics}
        reader = _open_storage(self)
        with _log_details():
            reader.set_filter(rosbag2_py.StorageFilter(topics=sorted(topics)))
        while True:
            with _log_details():
                if not reader.has_next():
                    return
                name, raw, stamp = reader.read_next()[:3]
            yield topics[name], stamp, raw

    def close(self) -> None:
        """Close it."""
        if self.dbconn is not None:
            self.dbconn.close()


class RosBag:
    """A rosbag2, opened with the libraries of ROS 2.

    `path`: a folder with a metadata.yaml, or one file, MCAP or database. Raises MissingExtraError if it is packed, and no library
    that unpacks zstd is installed.
    """

    def __init__(self, path: Path) -> None:
        _silence_log()
        self.connections: list[RosTopic] = []
        self.message_count = 0
        self.compression_mode = ""
        self.storage = SimpleNamespace(storages=list[RosFile]())
        self._stack = ExitStack()
        try:
            if path.is_dir():
                self._open_folder(path)
            else:
                self._open_file(path)
        except BaseException:
            self.close()
            raise

    def _open_file(self, path: Path) -> None:
        if is_unfinished(path):
            bag = UnfinishedBag(path)
            place = self._folder() / "finished.mcap"
            bag.write(place)
            file = RosFile(bag, place, "mcap")
        elif path.suffix in STORAGES:
            file = RosFile(path, path, STORAGES[path.suffix])
        else:
            raise RosError(f"a file of the suffix {path.suffix or '(none)'}; {' and '.join(STORAGES)} are read")
        self._add(file)
        self.connections = list(file.connections)
        self.message_count = sum(connection.msgcount for connection in file.connections)

    def _open_folder(self, path: Path) -> None:
        try:
            information = yaml.load(
                (path / "metadata.yaml").read_text(encoding="utf-8"), getattr(yaml, "CSafeLoader", yaml.SafeLoader)
            )
            information = information["rosbag2_bagfile_information"]
            if information["version"] > LAST_VERSION:
                raise RosError(f"metadata.yaml of version {information['version']}; those up to {LAST_VERSION} are read")
            files = [path / PurePath(name).name for name in information["relative_file_paths"]]
            kind, mode = information["storage_identifier"], str(information.get("compression_mode") or "").lower()
            self.message_count = information["message_count"]
            topic_counts = [
                (entry["topic_metadata"], entry["message_count"]) for entry in information["topics_with_message_count"]
            ]
            self.connections = [
                RosTopic(index + 1, entry["name"], entry["type"], "", n) for index, (entry, n) in enumerate(topic_counts)
            ]
            foreign_formats = {str(entry["serialization_format"]) for entry, _ in topic_counts} - {"cdr"}
        except FileNotFoundError as error:
            raise RosError(f"no {PurePath(error.filename).name}") from None
        except (KeyError, TypeError, ValueError, AttributeError, yaml.YAMLError) as error:
            raise RosError(f"metadata.yaml: {type(error).__name__}: {error}") from error
        if kind not in STORAGES.values() or foreign_formats:
            raise RosError(
                f"storage {kind}, messages as {', '.join(foreign_formats) or 'cdr'}; mcap and sqlite3 with cdr are read"
            )
        if absent_files := [file.name for file in files if not file.exists()]:
            raise RosError(f"files are missing: {', '.join(absent_files)}")
        self.compression_mode = "" if mode == "none" else mode
        if self.compression_mode:
            if information.get("compression_format") != "zstd":
                raise RosError(f"compression {information.get('compression_format')}; zstd is read")
            zstd()
        for file in files:
            place = self._unpack(file) if self.compression_mode == "file" else file
            self._add(RosFile(place, place, kind))
        texts = {
            entry.msgtype: entry.msgdef for file in reversed(self.storage.storages) for entry in file.connections if entry.msgdef
        }
        self.connections = [replace(entry, msgdef=texts.get(entry.msgtype, "")) for entry in self.connections]

    def _add(self, file: RosFile) -> None:
        self._stack.callback(file.close)
        file.open()
        self.storage.storages.append(file)

    def _folder(self) -> Path:
        return Path(self._stack.enter_context(tempfile.TemporaryDirectory()))

    def _unpack(self, file: Path) -> Path:
        place = self._folder() / file.stem
        with zstd().open(file, "rb") as packed_file, place.open("wb") as output:
            shutil.copyfileobj(packed_file, output)
        return place

    def close(self) -> None:
        """Close its files and remove their copies."""
        self._stack.close()


@contextmanager
def _log_details() -> Iterator[None]:
    """Name exceptions of rosbag2 as such: they are Python's own, and look like faults of this program."""
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:
        raise RosError(f"rosbag2: {error}") from error


def _open_storage(file: RosFile) -> Any:
    import rosbag2_py

    reader = rosbag2_py.SequentialReader()
    with _log_details():
        options = rosbag2_py.StorageOptions(uri=str(file.place), storage_id=file.kind)
        reader.open(options, rosbag2_py.ConverterOptions("", ""))
    return reader


def _silence_log() -> None:
    """Keep rosbag2 from printing the files it opens."""
    from rclpy.logging import LoggingSeverity, set_logger_level

    for name in ("rosbag2_storage", "rosbag2_cpp", "rosbag2_storage_mcap"):
        set_logger_level(name, LoggingSeverity.FATAL)


if TYPE_CHECKING:
    Connection = RosbagsConnection | RosTopic
    Reader = Reader1 | Reader2 | RosBag

READABLE = "a bag that is readable to its end"
REMEDIES = {".mcap": "try: mcap recover", ".bag": "try: rosbag reindex"}
PROFILE = text("ros2")
"""As the header of an MCAP file begins."""
JOURNALS = "-wal", "-journal"
"""Ends of the names of files with changes that a database lacks, or has in part."""


class _Place(NamedTuple):
    """Where a message of a ROS 1 bag is; places sort in the order of the log."""

    time: int
    chunk_pos: int
    offset: int


def is_ros1(path: Path) -> bool:
    """Whether a path is a bag of ROS 1: a file; a folder of such a name is a rosbag2."""
    return path.suffix == ".bag" and not path.is_dir()


def remedy(path: Path) -> str:
    """Remedy for an unreadable bag."""
    return "try: ros2 bag reindex" if path.is_dir() else REMEDIES.get(path.suffix, "try: ros2 bag reindex")


def open_bag(path: Path) -> Reader:
    """Open one bag for reading; the caller closes it.

    Uses rosbags if that is installed, else the libraries of ROS 2, which do not read bags of ROS 1. Raises InputError if it is no
    bag, or requires more memory or space than available; MissingExtraError if rosbags is not installed, nor another library that
    reads the bag.
    """
    open_reader = _opener(path)
    check_there(path)
    if path.is_dir():
        _check_folder(path)
    else:
        _check_journal(path)
        check_file(path)
    with reading(path, READABLE, remedy(path)):
        reader = open_reader(path)
        if all(isinstance(text, str) for connection in reader.connections for text in (connection.topic, connection.msgtype)):
            return reader
        reader.close()  # a database has any values
        raise InputError(str(path), "a topic without a name or a type", READABLE, remedy(path))


def _opener(path: Path) -> Callable[[Path], Reader]:
    """Return the opener of the installed library."""
    try:
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2
    except ImportError:
        if is_ros1(path) or not find_spec("rosbag2_py"):
            raise MissingExtraError("reading bags", "rosbags", "bags") from None
        return RosBag

    def opened(path: Path) -> Reader:
        _quote_databases()
        if path.is_file():
            _check_profile(path)
        place: Any = UnfinishedBag(path) if path.is_file() and is_unfinished(path) else path
        reader: Reader1 | Reader2 = Reader1(path) if is_ros1(path) else Reader2(place)
        reader.open()
        for places in getattr(reader, "indexes", {}).values():  # rosbags compares the times alone: those at once came by topic
            places[:] = sorted(map(_Place._make, places))
        return reader

    return opened


def _quote_databases() -> None:
    """Let rosbags open databases by any path: it puts the path as it is into a URI, where #, ? and % have a meaning."""
    from rosbags.rosbag2 import reader
    from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

    class QuotingReader(Sqlite3Reader):
        def open(self) -> None:
            path, self.path = self.path, Path(quote(os.fsencode(str(self.path))))
            try:
                super().open()
            finally:
                self.path = path

    tables: Any = reader.DirectoryReader.STORAGE_PLUGINS, reader.Reader.STORAGE_PLUGINS
    tables[0]["sqlite3"] = tables[1][".db3"] = QuotingReader


def _check_journal(path: Path) -> None:
    """Refuse a database that its recorder has not closed: the file beside it, which completes it, is not read."""
    place = path.resolve()
    for journal in (place.with_name(place.name + end) for end in JOURNALS):
        if not journal.is_file():
            continue
        with reading(journal, "a readable file"), journal.open("rb") as file:
            head = file.read(8)
        if any(head):  # a journal without content is empty, or begins with zeros
            remedy = f'stop the recorder, then run: sqlite3 {shlex.quote(str(path))} "pragma journal_mode=delete"'
            raise InputError(str(path), f"a database with uncompleted changes in {journal.name}", "one that was closed", remedy)


def _check_profile(path: Path) -> None:
    """Refuse an MCAP file of another profile than that of ROS 2, or of none: rosbags reads no other."""
    begin = len(MAGIC) + HEAD.size
    with path.open("rb") as file:
        head = file.read(begin + len(PROFILE))
    if head.startswith(MAGIC) and len(head) == begin + len(PROFILE) and head[begin:] != PROFILE:
        given = "an MCAP file of another profile, or of none"
        raise InputError(str(path), given, "one of the profile ros2", "record it with ros2 bag, or convert it to a table")


def _check_folder(path: Path) -> None:
    """Refuse a rosbag2 folder with other files than recorders write."""
    for file in sorted(path.iterdir()):
        check_there(file)
        _check_journal(file)


def messages(reader: Any, connections: Sequence[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
    """Return the messages of a bag, file after file; those that are packed one by one are unpacked here."""
    kinds = {(connection.topic, connection.msgtype) for connection in connections}
    files = [
        (file, [connection for connection in file.connections if (connection.topic, connection.msgtype) in kinds])
        for file in storages_of(reader)
    ]
    parts: list[tuple[Any, Sequence[Connection]]] = [*files] if files else [(reader, connections)]
    streams = itertools.chain.from_iterable(part.messages(selection) for part, selection in parts if selection)
    return _unpack_all(streams) if getattr(reader, "compression_mode", None) == "message" else streams


def _unpack_all(packed_messages: Iterator[tuple[Connection, int, bytes]]) -> Iterator[tuple[Connection, int, bytes]]:
    for connection, stamp, raw in packed_messages:
        try:
            yield connection, stamp, unpack_zstd(raw)
        except MemoryError:
            raise
        except Exception:
            yield connection, stamp, b""  # data that cannot be unpacked are counted as malformed
