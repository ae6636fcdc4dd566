# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Makes the records of an MCAP file, for the writer of bags and the reader of unfinished ones."""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
"""Head of a record: its kind, and the length of the rest."""
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06, 0x07, 0x08
ATTACHMENT, STATISTICS, METADATA, SUMMARY_OFFSET, DATA_END = 0x09, 0x0B, 0x0C, 0x0E, 0x0F


Whole = NDArray[np.integer[Any]]


@dataclass(frozen=True, slots=True)
class Chunk:
    """A chunk in its place, with the index of messages behind it; times in ns, the rest in bytes."""

    first_ns: int
    last_ns: int
    at: int
    length: int
    offsets: bytes
    index_length: int
    compression: str
    packed: int
    unpacked: int

    def record(self) -> bytes:
        """The record by which a player finds it."""
        where = struct.pack("<QQQQ", self.first_ns, self.last_ns, self.at, self.length) + sized(self.offsets)
        sizes = struct.pack("<Q", self.index_length) + text(self.compression) + struct.pack("<QQ", self.packed, self.unpacked)
        return record(CHUNK_INDEX, where + sizes)


def record(kind: int, content: bytes) -> bytes:
    """One record."""
    return HEAD.pack(kind, len(content)) + content


def sized(content: bytes) -> bytes:
    """Bytes behind their length."""
    return struct.pack("<I", len(content)) + content


def text(content: str) -> bytes:
    """A text behind its length."""
    return sized(content.encode())


def message_indices(channel: Whole, log_ns: Whole, offset: Whole, at: int) -> tuple[bytes, bytes]:
    """The message indices of a chunk at an offset of the file, and the offset by channel."""
    indices, offsets = b"", b""
    for number in np.unique(channel):
        rows = np.flatnonzero(channel == number)
        pairs = np.stack((log_ns[rows], offset[rows]), axis=1).astype("<u8").tobytes()
        offsets += struct.pack("<HQ", number, at + len(indices))
        indices += record(MESSAGE_INDEX, struct.pack("<H", number) + sized(pairs))
    return indices, offsets


def ending(
    at: int, schemas: Sequence[bytes], channels: Sequence[bytes], chunks: Sequence[Chunk], counts: Mapping[int, int]
) -> bytes:
    """The summary at an offset of the file: topics, chunks, counts of messages by channel."""
    messages = sum(counts.values())
    first = min((chunk.first_ns for chunk in chunks), default=0)
    last = max((chunk.last_ns for chunk in chunks), default=0)
    statistics = struct.pack("<QHIIIIQQ", messages, len(schemas), len(channels), 0, 0, len(chunks), first, last)
    by_channel = sized(b"".join(struct.pack("<HQ", *count) for count in counts.items()))
    groups = {
        SCHEMA: b"".join(schemas),
        CHANNEL: b"".join(channels),
        CHUNK_INDEX: b"".join(chunk.record() for chunk in chunks),
        STATISTICS: record(STATISTICS, statistics + by_channel),
    }
    found = record(DATA_END, struct.pack("<I", 0))
    start, offsets = at + len(found), b""
    for kind, records in groups.items():
        if records:
            offsets += record(SUMMARY_OFFSET, struct.pack("<BQQ", kind, at + len(found), len(records)))
            found += records
    return found + offsets + record(FOOTER, struct.pack("<QQI", start, at + len(found), 0)) + MAGIC


def ending_without_summary() -> bytes:
    """The end of a file without an index, whose messages are found by reading all of it."""
    return record(DATA_END, struct.pack("<I", 0)) + record(FOOTER, struct.pack("<QQI", 0, 0, 0)) + MAGIC
