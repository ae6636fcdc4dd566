# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Opens a rosbag2 with the libraries of ROS 2, if the library rosbags is not installed.

The opened bag has the attributes of a rosbags reader that `trackres_ros.recording.rosbag` uses. ROS 2 reads the messages.
Counts, limits and the structure of a file are read here, since its readers neither limit unpacking nor report losses.
"""

import sqlite3
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePath
from types import SimpleNamespace
from typing import Any
from urllib.parse import quote

import yaml

from trackres_ros.recording.mcap_index import McapIndex
from trackres_ros.recording.unfinished import UnfinishedBag, is_unfinished
from trackres_ros.recording.unpacking import MAX_MESSAGE_BYTES, TooLargeError, check_free, check_zstd, unpack_file

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
        """Read topics, counts and index. Raises RosError, TooLargeError if it cannot be read, or would fill the memory."""
        names: dict[int, str] = {}
        if self.kind == "mcap":
            index = McapIndex(self.place)
            self.chunks, self.statistics, names = index.chunks, index.statistics, index.topics
        else:
            self.dbconn = sqlite3.connect(f"file:{quote(bytes(self.place.absolute()))}?immutable=1", uri=True)
            names = dict(self.dbconn.execute("SELECT id, name FROM topics"))
            (most,) = self.dbconn.execute("SELECT max(length(data)) FROM messages").fetchone()
            if most and most > MAX_MESSAGE_BYTES:
                raise TooLargeError(f"a message of {most} bytes; at most {MAX_MESSAGE_BYTES} are read")
        reader = _opened(self)
        numbers = {name: number for number, name in names.items()}
        with _said():
            texts = {one.topic_type: one.encoded_message_definition for one in reader.get_all_message_definitions()}
            for info in reader.get_metadata().topics_with_message_count:
                topic = info.topic_metadata
                number = numbers.get(topic.name, topic.id)
                one = RosTopic(number, topic.name, topic.type, texts.get(topic.type, ""), info.message_count)
                self.connections.append(one)
        self.connections.sort(key=lambda one: one.id)

    def messages(self, ones: Sequence[RosTopic]) -> Iterator[tuple[RosTopic, int, bytes]]:
        """Return topic, log time [ns] and content of the messages of some topics, in the order of log times.

        Raises RosError if the file breaks off or is damaged.
        """
        import rosbag2_py

        topics = {one.topic: one for one in ones}
        reader = _opened(self)
        with _said():
            reader.set_filter(rosbag2_py.StorageFilter(topics=sorted(topics)))
        while True:
            with _said():
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
        _quiet()
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
            check_free(path.stat().st_size, path, "{} GB to be copied")
            place = self._folder() / "finished.mcap"
            bag.write(place)
            file = RosFile(bag, place, "mcap")
        elif path.suffix in STORAGES:
            file = RosFile(path, path, STORAGES[path.suffix])
        else:
            raise RosError(f"a file of the suffix {path.suffix or '(none)'}; {' and '.join(STORAGES)} are read")
        self._add(file)
        self.connections = list(file.connections)
        self.message_count = sum(one.msgcount for one in file.connections)

    def _open_folder(self, path: Path) -> None:
        try:
            known = yaml.load((path / "metadata.yaml").read_text(encoding="utf-8"), getattr(yaml, "CSafeLoader", yaml.SafeLoader))
            known = known["rosbag2_bagfile_information"]
            if known["version"] > LAST_VERSION:
                raise RosError(f"metadata.yaml of version {known['version']}; those up to {LAST_VERSION} are read")
            files = [path / PurePath(name).name for name in known["relative_file_paths"]]
            kind, mode = known["storage_identifier"], str(known.get("compression_mode") or "").lower()
            self.message_count = known["message_count"]
            stated = [(one["topic_metadata"], one["message_count"]) for one in known["topics_with_message_count"]]
            self.connections = [RosTopic(at + 1, one["name"], one["type"], "", n) for at, (one, n) in enumerate(stated)]
            strange = {str(one["serialization_format"]) for one, _ in stated} - {"cdr"}
        except FileNotFoundError as error:
            raise RosError(f"no {PurePath(error.filename).name}") from None
        except (KeyError, TypeError, ValueError, AttributeError, yaml.YAMLError) as error:
            raise RosError(f"metadata.yaml: {type(error).__name__}: {error}") from error
        if kind not in STORAGES.values() or strange:
            raise RosError(f"storage {kind}, messages as {', '.join(strange) or 'cdr'}; mcap and sqlite3 with cdr are read")
        if lacking := [file.name for file in files if not file.exists()]:
            raise RosError(f"files are missing: {', '.join(lacking)}")
        self.compression_mode = "" if mode == "none" else mode
        if self.compression_mode:
            if known.get("compression_format") != "zstd":
                raise RosError(f"compression {known.get('compression_format')}; zstd is read")
            check_zstd()
        for file in files:
            place = self._unpacked(file) if self.compression_mode == "file" else file
            self._add(RosFile(place, place, kind))
        texts = {one.msgtype: one.msgdef for file in reversed(self.storage.storages) for one in file.connections if one.msgdef}
        self.connections = [replace(one, msgdef=texts.get(one.msgtype, "")) for one in self.connections]

    def _add(self, file: RosFile) -> None:
        self._stack.callback(file.close)
        file.open()
        self.storage.storages.append(file)

    def _folder(self) -> Path:
        return Path(self._stack.enter_context(tempfile.TemporaryDirectory()))

    def _unpacked(self, file: Path) -> Path:
        place = self._folder() / file.stem
        unpack_file(file, place)
        return place

    def close(self) -> None:
        """Close its files and remove their copies."""
        self._stack.close()


@contextmanager
def _said() -> Iterator[None]:
    """Name exceptions of rosbag2 as such: they are Python's own, and look like faults of this program."""
    try:
        yield
    except Exception as error:
        raise RosError(f"rosbag2: {error}") from error


def _opened(file: RosFile) -> Any:
    import rosbag2_py

    reader = rosbag2_py.SequentialReader()
    with _said():
        options = rosbag2_py.StorageOptions(uri=str(file.place), storage_id=file.kind)
        reader.open(options, rosbag2_py.ConverterOptions("", ""))
    return reader


def _quiet() -> None:
    """Keep rosbag2 from printing the files it opens."""
    from rclpy.logging import LoggingSeverity, set_logger_level

    for name in ("rosbag2_storage", "rosbag2_cpp", "rosbag2_storage_mcap"):
        set_logger_level(name, LoggingSeverity.FATAL)
