# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Counts the messages that a bag declares in any of its counts: those that were not read are lost."""

import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from trackres_ros.errors import shown
from trackres_ros.recording.mcap_format import CHUNK, DATA_END, FOOTER, HEAD, HEADER, MAGIC, MESSAGE_INDEX
from trackres_ros.recording.unfinished import UnfinishedBag

ROWS = "SELECT topic_id, count(*) FROM messages NOT INDEXED GROUP BY topic_id"
DATA, SUMMARY = {0x03, 0x04, 0x05, CHUNK, MESSAGE_INDEX, 0x09, 0x0C, DATA_END}, {FOOTER, 0x03, 0x04, 0x08, 0x0A, 0x0B, 0x0D, 0x0E}
"""Kinds of records before and behind the end of the data."""
FOOTER_BYTES = 20
MOST_HEAD_BYTES = 2**16
MOST_MESSAGES = 2**48
"""No disk holds as many; larger counts are ignored."""
INDEX_DATA = 4
"""Kind of the record of ROS 1 that counts the messages of one connection in the chunk before it."""


@dataclass(slots=True)
class MessageCounts:
    """The numbers of messages that a bag states."""

    by_topic: Counter[str] = field(default_factory=Counter)  # messages by topic
    unknown: int = 0  # messages of a topic that the bag does not describe
    remarks: list[str] = field(default_factory=list)  # faults of the counts themselves

    def add(self, names: dict[Any, str], counts: dict[Any, int]) -> None:
        """Add counts by identity of a connection."""
        for number, count in counts.items():
            if number in names:
                self.by_topic[names[number]] += self.checked(count)
            else:
                self.unknown += self.checked(count)

    def checked(self, count: object) -> int:
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
            names = {one.id: one.topic for one in storage.connections}
            if getattr(storage, "dbconn", None) is not None:
                counts.add(names, dict(storage.dbconn.execute(ROWS)))
            else:
                indexed: Counter[int] = Counter()
                for chunk in storage.chunks:
                    indexed.update(chunk.channel_count)
                stated = Counter(storage.statistics.channel_message_counts) if storage.statistics else Counter[int]()
                counts.add(names, stated | indexed)
                counts.remarks += _look_at_mcap(storage)
    by_topic: Counter[str] = Counter()
    for one in reader.connections:
        by_topic[one.topic] += counts.checked(one.msgcount)
    counts.by_topic |= by_topic
    counts.unknown = max(counts.unknown, counts.checked(reader.message_count) - counts.by_topic.total())
    return counts


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
        at, kind, chunks, allowed = len(MAGIC), 0, 0, {HEADER}
        while at < size and kind != FOOTER:
            file.seek(at)
            before, (kind, length) = kind, HEAD.unpack(file.read(HEAD.size).ljust(HEAD.size))
            if kind not in allowed or (kind == MESSAGE_INDEX and before not in (CHUNK, MESSAGE_INDEX)):
                break
            allowed = SUMMARY if kind == DATA_END or allowed is SUMMARY else DATA
            chunks += kind == CHUNK
            at += HEAD.size + length
        if at != size:
            yield f"records are not contiguous at byte {at}: later messages may be lost"
        elif chunks != len(storage.chunks):
            yield f"the index names {len(storage.chunks)} of {chunks} chunks: messages may be lost"
        file.seek(size - FOOTER_BYTES)
        if not any(file.read(8)):
            yield "the file has no summary: messages lost before it was closed cannot be detected"


def _count_ros1(reader: Any, path: Path, counts: MessageCounts) -> None:
    """Add the larger of the counts in the index and in the chunks themselves, connection by connection."""
    names = {one.id: one.topic for one in reader.connections}
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
        head = file.read(length) if length < MOST_HEAD_BYTES else b""
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
    at = 0
    while at + 4 <= len(head):
        length = int.from_bytes(head[at : at + 4], "little")
        name, _, value = head[at + 4 : at + 4 + length].partition(b"=")
        fields[name] = value
        at += 4 + length
    return fields
