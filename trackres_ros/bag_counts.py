"""How many messages a bag says it holds, by all the counts that are in it: what is read less was lost."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

ROWS = "SELECT topic_id, count(*) FROM messages NOT INDEXED GROUP BY topic_id"
FOOTER = struct.Struct("<QQI")
MAGIC = b"\x89MCAP0\r\n"
MOST_HEAD_BYTES = 2**16
INDEX_DATA = 4
"""Kind of the record of ROS 1 that counts the messages of one connection in the chunk before it."""


@dataclass(slots=True)
class Counts:
    """What a bag says it holds.

    Attributes
    ----------
    by_topic : Counter
        Messages by topic.
    unknown : int
        Messages of a topic that the bag does not describe.
    remarks : list of str
        What is wrong with the counts themselves.
    """

    by_topic: Counter[str] = field(default_factory=Counter)
    unknown: int = 0
    remarks: list[str] = field(default_factory=list)

    def add(self, names: dict[Any, str], counts: dict[Any, int]) -> None:
        """Add counts by identity of a connection."""
        for number, count in counts.items():
            if number in names:
                self.by_topic[names[number]] += count
            else:
                self.unknown += count


def counts_of(reader: Any, path: Path) -> Counts:
    """Return the counts of a bag that is open.

    Parameters
    ----------
    reader : rosbags reader
        Of ROS 1 or 2.
    path : Path
        The bag.
    """
    counts = Counts()
    if hasattr(reader, "chunk_infos"):
        _count_ros1(reader, path, counts)
    else:
        for storage in storages_of(reader):
            names = {one.id: one.topic for one in storage.connections}
            if getattr(storage, "dbconn", None) is not None:
                counts.add(names, dict(storage.dbconn.execute(ROWS)))
            else:
                _count_mcap(storage, names, counts)
                if _without_summary(storage):
                    counts.remarks.append("the file has no summary: messages that were lost before it was closed do not show")
    for topic, count in _by_topic(reader).items():
        counts.by_topic[topic] = max(counts.by_topic[topic], count)
    counts.unknown = max(counts.unknown, reader.message_count - counts.by_topic.total())
    return counts


def storages_of(reader: Any) -> Sequence[Any]:
    """Return the files of a rosbag2 as rosbags has them open; none of a ROS 1 bag."""
    if not hasattr(reader, "storage"):
        return ()
    return getattr(reader.storage, "storages", (reader.storage,))


def _by_topic(reader: Any) -> Counter[str]:
    said: Counter[str] = Counter()
    for one in reader.connections:
        said[one.topic] += one.msgcount
    return said


def _count_mcap(storage: Any, names: dict[Any, str], counts: Counts) -> None:
    """Add the larger of what the statistics and the index say, channel by channel."""
    indexed: Counter[int] = Counter()
    for chunk in storage.chunks:
        indexed.update(chunk.channel_count)
    said = Counter(storage.statistics.channel_message_counts) if storage.statistics else Counter[int]()
    counts.add(names, said | indexed)


def _without_summary(storage: Any) -> bool:
    """Whether the footer of an MCAP file names no summary, so that the counts are of what a scan met."""
    storage.bio.seek(-FOOTER.size - len(MAGIC), 2)
    return bool(FOOTER.unpack(storage.bio.read(FOOTER.size))[0] == 0)


def _count_ros1(reader: Any, path: Path, counts: Counts) -> None:
    """Add the larger of what the index, and what the chunks themselves say, connection by connection."""
    names = {one.id: one.topic for one in reader.connections}
    indexed: Counter[int] = Counter()
    for info in reader.chunk_infos:
        indexed.update(info.connection_counts)
    beside: Counter[int] = Counter()
    with path.open("rb") as file:
        for head in _records(file, counts):
            if head.get(b"op") == bytes([INDEX_DATA]) and len(head.get(b"conn", b"")) == len(head.get(b"count", b"")) == 4:
                beside[int.from_bytes(head[b"conn"], "little")] += int.from_bytes(head[b"count"], "little")
    counts.add(names, beside | indexed)


def _records(file: BinaryIO, counts: Counts) -> Iterator[dict[bytes, bytes]]:
    """Yield the heads of the records of a ROS 1 bag, as far as one follows on the other."""
    size = file.seek(0, 2)
    file.seek(0)
    file.readline(64)
    while (start := file.tell()) < size:
        length = _length(file, size)
        head = file.read(length) if length < MOST_HEAD_BYTES else b""
        file.seek(_length(file, size), 1)
        if file.tell() > size or not head:
            counts.remarks.append(f"records do not follow on one another at byte {start}: messages behind it may be lost")
            return
        yield _fields(head)


def _length(file: BinaryIO, size: int) -> int:
    raw = file.read(4)
    return int(struct.unpack("<I", raw)[0]) if len(raw) == 4 else size


def _fields(head: bytes) -> dict[bytes, bytes]:
    fields = {}
    at = 0
    while at + 4 <= len(head):
        length = int.from_bytes(head[at : at + 4], "little")
        name, _, value = head[at + 4 : at + 4 + length].partition(b"=")
        fields[name] = value
        at += 4 + length
    return fields
