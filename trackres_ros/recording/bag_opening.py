# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Opens a bag and yields its messages, with the installed library, and refuses files that would fill memory or disk."""

from __future__ import annotations

import itertools
import os
import shlex
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import quote

import yaml

from trackres_ros.errors import InputError, MissingExtraError
from trackres_ros.recording.bag_counts import storages_of
from trackres_ros.recording.mcap_format import HEAD, MAGIC, text
from trackres_ros.recording.reading import check_file, check_there, reading
from trackres_ros.recording.ros_bag import RosBag, RosTopic
from trackres_ros.recording.unfinished import UnfinishedBag, is_unfinished
from trackres_ros.recording.unpacking import (
    MAX_CHUNK_BYTES,
    MAX_MESSAGE_BYTES,
    TooLargeError,
    check_space,
    set_ceilings,
    unpack_message,
)

if TYPE_CHECKING:
    from rosbags.interfaces import Connection as RosbagsConnection
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    Connection = RosbagsConnection | RosTopic
    Reader = Reader1 | Reader2 | RosBag

READABLE = "a bag that is readable to its end"
REMEDIES = {".mcap": "try: mcap recover", ".bag": "try: rosbag reindex"}
PROFILE = text("ros2")
"""As the header of an MCAP file begins."""
MAX_METADATA_BYTES, MAX_METADATA_DEPTH = 2**24, 50
"""Limits of a bag's metadata.yaml; ten hours in files of a minute fill a hundredth of it, and the deepest value has 8 above
it.
"""
SQLITE_LIMIT_LENGTH = 0
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
    opened = _opener(path)
    check_there(path)
    if path.is_dir():
        _check_folder(path)
    else:
        _check_journal(path)
        check_file(path)
    with reading(path, READABLE, remedy(path)):
        reader = opened(path)
        try:
            for storage in storages_of(reader):
                _check_storage(storage)
        except BaseException:
            reader.close()
            raise
    return reader


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
        set_ceilings()
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
    for beside in (place.with_name(place.name + end) for end in JOURNALS):
        if not beside.is_file():
            continue
        with reading(beside, "a readable file"), beside.open("rb") as file:
            head = file.read(8)
        if any(head):  # a journal without content is empty, or begins with zeros
            remedy = f'stop the recorder, then run: sqlite3 {shlex.quote(str(path))} "pragma journal_mode=delete"'
            raise InputError(str(path), f"a database with uncompleted changes in {beside.name}", "one that was closed", remedy)


def _check_profile(path: Path) -> None:
    """Refuse an MCAP file of another profile than that of ROS 2, or of none: rosbags reads no other."""
    begin = len(MAGIC) + HEAD.size
    with path.open("rb") as file:
        head = file.read(begin + len(PROFILE))
    if head.startswith(MAGIC) and len(head) == begin + len(PROFILE) and head[begin:] != PROFILE:
        given = "an MCAP file of another profile, or of none"
        raise InputError(str(path), given, "one of the profile ros2", "record it with ros2 bag, or convert it to a table")


def _check_folder(path: Path) -> None:
    """Refuse a rosbag2 folder with more, or other, files than recorders write."""
    for inside in sorted(path.iterdir()):
        check_there(inside)
        _check_journal(inside)
        if inside.suffix == ".zstd":
            check_space(inside)
    metadata = path / "metadata.yaml"
    if not metadata.is_file():
        return
    if metadata.stat().st_size > MAX_METADATA_BYTES:
        raise InputError(str(metadata), f"{metadata.stat().st_size} bytes", f"at most {MAX_METADATA_BYTES}")
    depth = 0
    with reading(metadata, "YAML as ros2 bag writes it", "try: ros2 bag reindex"):
        for event in yaml.parse(metadata.read_text(encoding="utf-8"), getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if isinstance(event, yaml.AliasEvent) or depth > MAX_METADATA_DEPTH:
                given = "an alias" if depth <= MAX_METADATA_DEPTH else f"more than {MAX_METADATA_DEPTH} values in one another"
                raise InputError(str(metadata), given, "YAML as ros2 bag writes it", "try: ros2 bag reindex")


def _check_storage(storage: Any) -> None:
    """Refuse content that would exhaust the memory."""
    database = getattr(storage, "dbconn", None)
    if database is not None:
        limit = getattr(database, "limit", None) or database.setlimit
        limit(SQLITE_LIMIT_LENGTH, MAX_MESSAGE_BYTES)
    together, most = 0, 0
    spans = [(one.message_start_time, one.message_end_time, one.uncompressed_size) for one in getattr(storage, "chunks", ())]
    ends = [(end, 1, -size) for _, end, size in spans]
    for _, _, size in sorted([(start, 0, size) for start, _, size in spans] + ends):
        together += size
        most = max(most, together)
    if most > MAX_CHUNK_BYTES:
        raise TooLargeError(f"chunks of the same span of time that unpack to {most} bytes; at most {MAX_CHUNK_BYTES} are read")


def messages(reader: Any, wanted: Sequence[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
    """Return the messages of a bag, file after file; those that are packed one by one are unpacked here, up to a ceiling."""
    kinds = {(one.topic, one.msgtype) for one in wanted}
    files = [(file, [one for one in file.connections if (one.topic, one.msgtype) in kinds]) for file in storages_of(reader)]
    parts: list[tuple[Any, Sequence[Connection]]] = [*files] if files else [(reader, wanted)]
    found = itertools.chain.from_iterable(part.messages(ones) for part, ones in parts if ones)
    return _unpacked(found) if getattr(reader, "compression_mode", None) == "message" else found


def _unpacked(packed: Iterator[tuple[Connection, int, bytes]]) -> Iterator[tuple[Connection, int, bytes]]:
    for connection, stamp, raw in packed:
        try:
            yield connection, stamp, unpack_message(raw)
        except TooLargeError as error:
            raise TooLargeError(f"a message of {connection.topic}: {error}") from None
        except Exception:
            yield connection, stamp, b""  # data that cannot be unpacked are counted as malformed
