# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads the index at the end of an MCAP file: its chunks, topics, and how many messages it counts."""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from trackres_ros.recording.mcap_format import CHANNEL, CHUNK, CHUNK_INDEX, FOOTER, HEAD, MAGIC, STATISTICS, SUMMARY_OFFSET
from trackres_ros.recording.unpacking import MAX_CHUNK_BYTES, TooLargeError

FOOTER_BYTES = HEAD.size + 20 + len(MAGIC)
INDEX_ENTRY_BYTES = 16
"""A log time and an offset, for each message of a channel in a chunk; before them a head, the channel and their length."""
INDEX_HEAD_BYTES = HEAD.size + 6
MAX_INDEX_BYTES = 2**28


class McapError(Exception):
    """It is no MCAP file, or its index is damaged."""


@dataclass(frozen=True, slots=True)
class IndexedChunk:
    """A chunk as the index describes it: times [ns], unpacked size [bytes], and number of messages by channel."""

    message_start_time: int
    message_end_time: int
    uncompressed_size: int
    channel_count: dict[int, int]


@dataclass(frozen=True, slots=True)
class Statistics:
    """Number of messages by channel, as the file states it."""

    channel_message_counts: dict[int, int]


class McapIndex:
    """The index of a file; a file without one has no chunks here.

    `path`: a file with its end. Raises McapError if it cannot be read; TooLargeError if a chunk states an unpacked size above the
    ceiling.
    """

    def __init__(self, path: Path) -> None:
        self.chunks: list[IndexedChunk] = []
        self.topics: dict[int, str] = {}  # name of the topic of each channel
        self.statistics: Statistics | None = None
        with path.open("rb") as file:
            size = file.seek(0, 2)
            file.seek(max(0, size - FOOTER_BYTES))
            end = file.read()
            if len(end) != FOOTER_BYTES or not end.endswith(MAGIC) or HEAD.unpack_from(end) != (FOOTER, 20):
                raise McapError("no valid end of an MCAP file")
            (start,) = struct.unpack_from("<Q", end, HEAD.size)
            if start and not len(MAGIC) <= start <= size - FOOTER_BYTES:
                raise McapError("an index outside the file")
            if start and size - start > MAX_INDEX_BYTES:
                raise TooLargeError(f"an index of {size - start} bytes; at most {MAX_INDEX_BYTES} are read")
            _check_chunks(file, start or size - FOOTER_BYTES)
            if start:
                file.seek(start)
                try:
                    self._read(file.read(size - start - FOOTER_BYTES))
                except (struct.error, UnicodeDecodeError) as error:
                    raise McapError(f"a truncated index: {error}") from error

    def _read(self, data: bytes) -> None:
        at = 0
        while at < len(data):
            kind, length = HEAD.unpack_from(data, at)
            content = data[at + HEAD.size : at + HEAD.size + length]
            at += HEAD.size + length
            if kind == CHANNEL:
                number, _, size = struct.unpack_from("<HHI", content)
                self.topics[number] = content[8 : 8 + size].decode()
            elif kind == CHUNK_INDEX:
                self.chunks.append(_chunk(content))
            elif kind == STATISTICS:
                (size,) = struct.unpack_from("<I", content, 42)
                counts = struct.iter_unpack("<HQ", content[46 : 46 + size // 10 * 10])
                self.statistics = Statistics(dict(counts))
            elif kind == SUMMARY_OFFSET:
                return


def _chunk(content: bytes) -> IndexedChunk:
    first, last, at, length, size = struct.unpack_from("<QQQQI", content)
    where = sorted((offset, channel) for channel, offset in struct.iter_unpack("<HQ", content[36 : 36 + size // 10 * 10]))
    index, name = struct.unpack_from("<QI", content, 36 + size)
    _, unpacked = struct.unpack_from("<QQ", content, 48 + size + name)
    ends = [*(offset for offset, _ in where[1:]), at + length + index]
    spans = zip(where, ends, strict=False)
    counts = {channel: (end - offset - INDEX_HEAD_BYTES) // INDEX_ENTRY_BYTES for (offset, channel), end in spans}
    return IndexedChunk(first, last, unpacked, {channel: count for channel, count in counts.items() if count})


def _check_chunks(file: BinaryIO, end: int) -> None:
    """Refuse chunks that would fill the memory, as far as records follow on one another: a few bytes may request all of it."""
    at = len(MAGIC)
    while at + HEAD.size <= end:
        file.seek(at)
        kind, length = HEAD.unpack(file.read(HEAD.size))
        if kind == CHUNK and length < 24:
            raise McapError(f"a chunk of {length} bytes")
        if kind == CHUNK:
            file.seek(at + HEAD.size + 16)
            (unpacked,) = struct.unpack("<Q", file.read(8))
            if max(unpacked, length) > MAX_CHUNK_BYTES:
                raise TooLargeError(f"a chunk of {max(unpacked, length)} bytes; at most {MAX_CHUNK_BYTES} are read")
        at += HEAD.size + length
