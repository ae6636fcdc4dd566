# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Makes and reads the records of an MCAP file: its index, and a file that was not finished, such as after a kill."""

import io
import os
import shutil
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from trackres_ros.errors import InputError, MissingExtraError

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
    offset: int
    length: int
    offsets: bytes
    index_length: int
    compression: str
    packed_size: int
    unpacked_size: int

    def record(self) -> bytes:
        """The record by which a player finds it."""
        place = struct.pack("<QQQQ", self.first_ns, self.last_ns, self.offset, self.length) + sized(self.offsets)
        sizes = (
            struct.pack("<Q", self.index_length)
            + text(self.compression)
            + struct.pack("<QQ", self.packed_size, self.unpacked_size)
        )
        return record(CHUNK_INDEX, place + sizes)


def record(kind: int, content: bytes) -> bytes:
    """One record."""
    return HEAD.pack(kind, len(content)) + content


def sized(content: bytes) -> bytes:
    """Bytes behind their length."""
    return struct.pack("<I", len(content)) + content


def text(content: str) -> bytes:
    """A text behind its length."""
    return sized(content.encode())


def message_indices(channel: Whole, log_ns: Whole, offset: Whole, data_offset: int) -> tuple[bytes, bytes]:
    """The message indices of a chunk at an offset of the file, and the offset by channel."""
    indices, offsets = b"", b""
    for number in np.unique(channel):
        rows = np.flatnonzero(channel == number)
        pairs = np.stack((log_ns[rows], offset[rows]), axis=1).astype("<u8").tobytes()
        offsets += struct.pack("<HQ", number, data_offset + len(indices))
        indices += record(MESSAGE_INDEX, struct.pack("<H", number) + sized(pairs))
    return indices, offsets


def ending(
    data_end: int, schemas: Sequence[bytes], channels: Sequence[bytes], chunks: Sequence[Chunk], counts: Mapping[int, int]
) -> bytes:
    """The summary at an offset of the file: topics, chunks, counts of messages by channel."""
    messages = sum(counts.values())
    first_ns = min((chunk.first_ns for chunk in chunks), default=0)
    last = max((chunk.last_ns for chunk in chunks), default=0)
    statistics = struct.pack("<QHIIIIQQ", messages, len(schemas), len(channels), 0, 0, len(chunks), first_ns, last)
    by_channel = sized(b"".join(struct.pack("<HQ", *count) for count in counts.items()))
    groups = {
        SCHEMA: b"".join(schemas),
        CHANNEL: b"".join(channels),
        CHUNK_INDEX: b"".join(chunk.record() for chunk in chunks),
        STATISTICS: record(STATISTICS, statistics + by_channel),
    }
    content = record(DATA_END, struct.pack("<I", 0))
    start, offsets = data_end + len(content), b""
    for kind, records in groups.items():
        if records:
            offsets += record(SUMMARY_OFFSET, struct.pack("<BQQ", kind, data_end + len(content), len(records)))
            content += records
    return content + offsets + record(FOOTER, struct.pack("<QQI", start, data_end + len(content), 0)) + MAGIC


def ending_without_summary() -> bytes:
    """The end of a file without an index, whose messages are found by reading all of it."""
    return record(DATA_END, struct.pack("<I", 0)) + record(FOOTER, struct.pack("<QQI", 0, 0, 0)) + MAGIC


FOOTER_BYTES = HEAD.size + 20 + len(MAGIC)
INDEX_ENTRY_BYTES = 16
"""A log time and an offset, for each message of a channel in a chunk; before them a head, the channel and their length."""
INDEX_HEAD_BYTES = HEAD.size + 6


class McapError(Exception):
    """It is no MCAP file, or its index is damaged."""


@dataclass(frozen=True, slots=True)
class IndexedChunk:
    """A chunk as the index describes it: number of messages by channel."""

    channel_count: dict[int, int]


@dataclass(frozen=True, slots=True)
class Statistics:
    """Number of messages by channel, as the file states it."""

    channel_message_counts: dict[int, int]


class McapIndex:
    """The index of a file; a file without one has no chunks here.

    `path`: a file with its end. Raises McapError if it cannot be read.
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
            if start:
                file.seek(start)
                try:
                    self._read(file.read(size - start - FOOTER_BYTES))
                except (struct.error, UnicodeDecodeError) as error:
                    raise McapError(f"a truncated index: {error}") from error

    def _read(self, data: bytes) -> None:
        offset = 0
        while offset < len(data):
            kind, length = HEAD.unpack_from(data, offset)
            content = data[offset + HEAD.size : offset + HEAD.size + length]
            offset += HEAD.size + length
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
    start, length, size = struct.unpack_from("<QQI", content, 16)
    channel_offsets = sorted(
        (offset, channel) for channel, offset in struct.iter_unpack("<HQ", content[36 : 36 + size // 10 * 10])
    )
    (index,) = struct.unpack_from("<Q", content, 36 + size)
    ends = [*(offset for offset, _ in channel_offsets[1:]), start + length + index]
    spans = zip(channel_offsets, ends, strict=False)
    counts = {channel: (end - offset - INDEX_HEAD_BYTES) // INDEX_ENTRY_BYTES for (offset, channel), end in spans}
    return IndexedChunk({channel: count for channel, count in counts.items() if count})


SUFFIX = ".part"
"""Of a file that is still being written, or never was finished."""
MESSAGE_HEAD = struct.Struct("<HIQQ")
LEAST = {HEADER: 8, SCHEMA: 2, CHANNEL: 4, MESSAGE: MESSAGE_HEAD.size, CHUNK: 40, MESSAGE_INDEX: 6, ATTACHMENT: 0, METADATA: 0}
"""Kinds of records before the end of the data, and the least length of each [bytes]."""


@cache
def zstd() -> ModuleType:
    """A library for zstd: that of Python 3.14, its backport, or the older one. Raises MissingExtraError without any."""
    for name in ("compression.zstd", "backports.zstd", "zstandard"):
        with suppress(ImportError):
            return import_module(name)
    raise MissingExtraError("unpacking zstd", "zstandard", "bags")


def unpack_zstd(data: bytes) -> bytes:
    """Unpack the frames of zstd in some bytes."""
    with zstd().open(io.BytesIO(data), "rb") as file:
        content: bytes = file.read()
    return content


def _unpack_lz4(data: bytes) -> bytes:
    try:
        from lz4.frame import decompress
    except ImportError:
        raise MissingExtraError("unpacking lz4", "lz4", "bags") from None
    content: bytes = decompress(data)
    return content


UNPACKERS: Mapping[str, Callable[[bytes], bytes]] = {"": bytes, "zstd": unpack_zstd, "lz4": _unpack_lz4}
"""Of the chunks of an MCAP file, by the name of their compression."""


@dataclass(slots=True)
class _Found:
    """Content up to the last complete chunk, or the last complete message of a file without chunks."""

    whole_bytes: int = 0
    schemas: dict[int, bytes] = field(default_factory=dict)
    channels: dict[int, bytes] = field(default_factory=dict)
    chunks: list[Chunk] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)
    first_ns: int = 2**63
    last_ns: int = 0
    is_complete: bool = False  # all messages are there
    indexed: bool = True  # all messages are in chunks that have an index
    loose_message: tuple[int, int] | None = None  # place and channel of the last message outside of a chunk
    last_chunk: list[tuple[int, int, int]] = field(default_factory=list)  # its messages: channel, log time, offset
    offsets: dict[int, int] = field(default_factory=dict)  # of its index, by channel

    def take(self, kind: int, content: bytes) -> int:
        """Process a schema, a channel or a message; return its number, or that of its channel."""
        number: int = struct.unpack_from("<H", content)[0]
        if kind == MESSAGE:
            log_ns = MESSAGE_HEAD.unpack_from(content)[2]
            self.counts[number] += 1
            self.first_ns, self.last_ns = min(self.first_ns, log_ns), max(self.last_ns, log_ns)
        else:
            (self.schemas if kind == SCHEMA else self.channels)[number] = record(kind, content)
        return number

    def leave_out_last_message(self) -> None:
        """Of messages outside of chunks: without a checksum they may contain arbitrary bytes after a power cut."""
        if self.loose_message is not None:
            self.whole_bytes, number = self.loose_message
            self.counts[number] -= 1

    def close_chunk(self) -> None:
        """The index of the last chunk is read, as another record follows."""
        if self.chunks:
            start = self.chunks[-1].offset + self.chunks[-1].length
            offsets = b"".join(struct.pack("<HQ", *place) for place in self.offsets.items())
            self.chunks[-1] = replace(self.chunks[-1], offsets=offsets, index_length=self.whole_bytes - start)
            self.indexed &= self.offsets.keys() == {channel for channel, _, _ in self.last_chunk}


@dataclass(frozen=True, slots=True)
class Recovered:
    """A repaired recording.

    Attributes
    ----------
    path
        Its file.
    messages, duration_s
        Number of messages, and time from the first to the last [s].
    lost_bytes
        Dropped bytes at the end of the unfinished file.
    """

    path: Path
    messages: int
    duration_s: float
    lost_bytes: int


class UnfinishedBag:
    """A file without its end, read as if it had one; to `rosbags` it is a path.

    `path`: an MCAP file for which `is_unfinished` is true. Raises InputError if there is no complete message in it.
    """

    suffix = ".mcap"

    def __init__(self, path: Path) -> None:
        self.path = path
        self._size = path.stat().st_size
        with path.open("rb") as file:
            scan = _scanned(file, self._size)
        if not scan.counts.total():
            raise InputError(
                str(path), f"an unfinished recording of {self._size} bytes", "one with at least one complete message"
            )
        self._whole_bytes, self._ending = _end_of(scan)
        self.messages = scan.counts.total()
        self.duration_s = (scan.last_ns - scan.first_ns) * 1e-9
        self.lost_bytes = 0 if scan.is_complete else self._size - scan.whole_bytes
        self.remark = (
            f"the recording is unfinished: its {self.messages} messages are read, its index is truncated"
            if scan.is_complete
            else f"the recording is unfinished: {self.messages} messages up to its last whole block are read, "
            f"the {self.lost_bytes} bytes behind it are incomplete; messages that were not written yet do not show"
        )

    def __str__(self) -> str:
        return str(self.path)

    def exists(self) -> bool:
        """As of a path."""
        return True

    def is_dir(self) -> bool:
        """As of a path."""
        return False

    def open(self, _mode: str = "rb") -> BinaryIO:
        """The file, with its ending, to be read."""
        return io.BufferedReader(_Joined(self.path.open("rb"), self._whole_bytes, self._ending))

    def write(self, path: Path) -> None:
        """Write it finished to another file, which is put in place when complete.

        Raises InputError if it cannot be written there.
        """
        part = path.with_name(f".{path.name}.{os.getpid()}{SUFFIX}")
        try:
            with self.open() as file, part.open("wb") as output:
                shutil.copyfileobj(file, output, 2**20)
            part.replace(path)
        except OSError as error:
            raise InputError(str(path), str(error.strerror), "a writable file") from error
        finally:
            part.unlink(missing_ok=True)


class _Joined(io.RawIOBase):
    """The first bytes of a file, and others behind them."""

    def __init__(self, file: BinaryIO, whole_bytes: int, tail: bytes) -> None:
        self._file, self._whole_bytes, self._tail, self._position = file, whole_bytes, tail, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, origin: int = io.SEEK_SET) -> int:
        start = {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: self._whole_bytes + len(self._tail)}[origin]
        if start + offset < 0:
            raise ValueError("a position before the beginning of the file")
        self._position = start + offset
        return self._position

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        count = len(buffer)
        if self._position < self._whole_bytes:
            self._file.seek(self._position)
            data = self._file.read(min(count, self._whole_bytes - self._position))
        else:
            data = self._tail[self._position - self._whole_bytes :][:count]
        buffer[: len(data)] = data
        self._position += len(data)
        return len(data)

    def close(self) -> None:
        self._file.close()
        super().close()


def is_unfinished(path: Path) -> bool:
    """Whether a file begins as MCAP does, and does not end so."""
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC or file.seek(0, io.SEEK_END) < 2 * len(MAGIC):
            return False
        file.seek(-len(MAGIC), io.SEEK_END)
        return file.read() != MAGIC


def _scanned(file: BinaryIO, size: int) -> _Found:
    """Read record by record as far as they are complete, with chunks whose checksum is correct."""
    scan, offset = _Found(), len(MAGIC)
    while offset + HEAD.size <= size:
        file.seek(offset)
        kind, length = HEAD.unpack(file.read(HEAD.size))
        end = offset + HEAD.size + length
        scan.is_complete = kind == DATA_END
        if kind not in LEAST or not LEAST[kind] <= length <= size - offset - HEAD.size:
            break
        if kind == CHUNK:
            scan.close_chunk()
            if not _take_chunk(scan, file.read(length), offset):
                break
            scan.whole_bytes = end
        elif kind == MESSAGE_INDEX and scan.chunks:
            scan.offsets[struct.unpack("<H", file.read(2))[0]] = offset
            scan.whole_bytes = end
        elif kind in (SCHEMA, CHANNEL, MESSAGE):
            number = scan.take(kind, file.read(length))
            if kind == MESSAGE:
                scan.indexed, scan.loose_message, scan.whole_bytes = False, (offset, number), end
        offset = end
    if not scan.is_complete:
        scan.leave_out_last_message()
    return scan


def _take_chunk(scan: _Found, content: bytes, chunk_offset: int) -> bool:
    """Process the messages of a chunk; return false, and process none, if it is damaged."""
    try:
        first_ns, last, size, crc, name = struct.unpack_from("<QQQII", content)
        compression = content[32 : 32 + name].decode()
        (packed_size,) = struct.unpack_from("<Q", content, 32 + name)
        if packed_size != len(content) - 40 - name:
            return False
        data = UNPACKERS[compression](content[40 + name :])
        if len(data) != size or (crc and crc != zlib.crc32(data)):
            return False
        records = list(_records(data))
    except MissingExtraError:
        raise
    except Exception:  # any exception of the library and its decompressors
        return False
    scan.last_chunk, scan.offsets = [], {}
    for kind, offset, record_content in records:
        scan.take(kind, record_content)
        if kind == MESSAGE:
            channel, _, log_ns, _ = MESSAGE_HEAD.unpack_from(record_content)
            scan.last_chunk.append((channel, log_ns, offset))
    scan.chunks.append(Chunk(first_ns, last, chunk_offset, HEAD.size + len(content), b"", 0, compression, packed_size, size))
    return True


def _records(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Kind, place and content of the records in a chunk. Raises ValueError, struct.error if they do not follow on one another."""
    offset = 0
    while offset < len(data):
        kind, length = HEAD.unpack_from(data, offset)
        content = data[offset + HEAD.size : offset + HEAD.size + length]
        if len(content) != length or length < LEAST.get(kind, 0):
            raise ValueError("a truncated record")
        if kind in (SCHEMA, CHANNEL, MESSAGE):
            yield kind, offset, content
        offset += HEAD.size + length


def _end_of(scan: _Found) -> tuple[int, bytes]:
    """Offset of the end of the usable content, and the bytes to append there.

    The index after the last chunk may be cut off, so it is made again.
    """
    if not scan.indexed or not scan.chunks:
        return scan.whole_bytes, ending_without_summary()
    chunk = scan.chunks[-1]
    start = chunk.offset + chunk.length
    channel, log_ns, offset = np.array(scan.last_chunk, dtype=np.uint64).reshape(-1, 3).T
    indices, offsets = message_indices(channel, log_ns, offset, start)
    chunks = [*scan.chunks[:-1], replace(chunk, offsets=offsets, index_length=len(indices))]
    schemas, channels = list(scan.schemas.values()), list(scan.channels.values())
    return start, indices + ending(start + len(indices), schemas, channels, chunks, scan.counts)
