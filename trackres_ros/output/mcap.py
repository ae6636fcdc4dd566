# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes an MCAP file in blocks, as Foxglove, PlotJuggler and `ros2 bag play` open it."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Literal, Self

import numpy as np
from numpy.typing import NDArray

from trackres_ros.errors import InputError, MissingExtraError
from trackres_ros.recording.cdr import Template
from trackres_ros.recording.message_types import Definitions, definitions, message_fields
from trackres_ros.recording.samples import FloatArray, IntArray

CHUNK_BYTES = 2**20
"""Size of a chunk of the MCAP file [bytes]: what a player reads at once."""
MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQHIQQ")
"""Head of a message: code, length of the rest, channel, sequence, log time, publish time."""


@dataclass(slots=True)
class BagTopic:
    """A topic of a `BagWriter`, from `BagWriter.topic`."""

    number: int
    name: str
    msgtype: str
    types: Definitions
    template: Template | None
    text: str
    count: int = 0


class BagWriter:
    """Writes one MCAP file, as Foxglove, PlotJuggler and ``ros2 bag play`` open it.

    The file takes its place only when the `with` block ends without an exception. Messages are put in the order of
    log time as far as they come together: all that is written until a topic is written again.

    Parameters
    ----------
    path : Path
        The file, replaced if it is there.
    storage : str
        Only ``mcap``.

    Raises
    ------
    MissingExtraError
        rosbags is not installed; it knows the message types.
    """

    def __init__(self, path: Path, storage: Literal["mcap"] = "mcap") -> None:
        try:
            from rosbags.typesys import Stores, get_typestore
        except ImportError:
            raise MissingExtraError("writing bags", "rosbags", "bags") from None
        if storage != "mcap":
            raise InputError(f"{path}: storage", storage, "mcap")
        if not path.parent.is_dir():
            raise InputError(str(path), f"no folder {path.parent}", "a file in a folder that is there")
        self.path = path
        self.typestore = get_typestore(Stores.LATEST)
        self._part = path.with_name(f".{path.name}.{os.getpid()}.part")
        self._topics: list[BagTopic] = []
        self._new = b""
        self._pending: list[tuple[int, IntArray, NDArray[np.uint8]]] = []
        self._waiting: set[int] = set()
        self._held = 0
        self._chunks: list[bytes] = []
        self._span = [2**64 - 1, 0]

    def __enter__(self) -> Self:
        """Begin the file beside its place."""
        self._file: BinaryIO = self._part.open("wb")
        self._file.write(MAGIC + _record(0x01, _text("ros2") + _text("trackres_ros")))
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Finish the file and put it in its place, or remove what was begun."""
        try:
            if kind is None:
                self._flush()
                self._summary()
                self._file.close()
                self._part.replace(self.path)
        finally:
            self._file.close()
            self._part.unlink(missing_ok=True)

    def topic(self, name: str, msgtype: str, template: object = None, fields: Sequence[str] = ()) -> BagTopic:
        """Announce a topic.

        Parameters
        ----------
        name, msgtype : str
            Topic, and ``package/msg/Name``.
        template : message object of `typestore`, optional
            For `write_block`: all strings and sequences as they stay.
        fields : sequence of str
            Paths of the k numbers that `write_block` sets.

        Raises
        ------
        InputError
            A type that is not known, or a field path that does not lead to a number of the template.
        """
        try:
            types = definitions(message_fields(self.typestore), msgtype)
        except KeyError:
            raise InputError(f"{self.path}: {name}", msgtype, "a common message type") from None
        ready = None
        if template is not None:
            ready = Template(bytes(self.typestore.serialize_cdr(template, msgtype)), types, msgtype, fields)
        text, _ = self.typestore.generate_msgdef(msgtype, ros_version=2)
        return self._announced(BagTopic(len(self._topics) + 1, name, msgtype, types, ready, text))

    def raw_topic(self, name: str, msgtype: str, text: str) -> BagTopic:
        """Announce a topic whose messages come serialised, for `write_raw`, with the text that defines its type and all in it."""
        return self._announced(BagTopic(len(self._topics) + 1, name, msgtype, {}, None, text))

    def _announced(self, topic: BagTopic) -> BagTopic:
        self._topics.append(topic)
        self._new += self._schema(topic) + self._channel(topic)
        return topic

    def write_block(self, topic: BagTopic, stamp_ns: IntArray, log_ns: IntArray, values: FloatArray) -> None:
        """Write n messages that differ in stamp and numbers only.

        Parameters
        ----------
        topic : BagTopic
            Announced with a template.
        stamp_ns, log_ns : ndarray of int64, shape (n,)
            Header stamps, and log times, from 0 on [ns].
        values : ndarray of float64, shape (n, k)
            The numbers of the fields of the topic.
        """
        if topic.template is None:
            raise InputError(f"{self.path}: {topic.name}", "no template", "a topic with a template message")
        self._write(topic, topic.template, stamp_ns, log_ns, values)

    def write(self, topic: BagTopic, message: object, stamp_ns: int, log_ns: int) -> None:
        """Write one message of its own form; its header, where it has one, gets the stamp [ns]."""
        raw = bytes(self.typestore.serialize_cdr(message, topic.msgtype))
        one = Template(raw, topic.types, topic.msgtype, ())
        self._write(topic, one, np.array([stamp_ns]), np.array([log_ns]), np.empty((1, 0)))

    def write_raw(self, topic: BagTopic, raw: bytes, log_ns: int) -> None:
        """Write one serialised message as it is."""
        head = RECORD.pack(0x05, RECORD.size + len(raw) - 9, topic.number, 0, log_ns, log_ns)
        self._hold(topic, np.array([log_ns]), np.frombuffer(head + raw, np.uint8)[np.newaxis])

    def _write(self, topic: BagTopic, template: Template, stamp_ns: IntArray, log_ns: IntArray, values: FloatArray) -> None:
        if not len(log_ns):
            return
        if values.shape != (len(log_ns), template.reader.count) or stamp_ns.shape != log_ns.shape:
            raise InputError(
                f"{self.path}: {topic.name}",
                f"{stamp_ns.shape}, {log_ns.shape}, {values.shape}",
                f"(n,), (n,) and (n, {template.reader.count})",
            )
        if int(log_ns.min()) < 0:
            raise InputError(f"{self.path}: {topic.name}: log time", int(log_ns.min()), "0 ns or later")
        size = RECORD.size + len(template.raw)
        rows = np.empty((len(log_ns), size), np.uint8)
        rows[:, : RECORD.size] = np.frombuffer(RECORD.pack(0x05, size - 9, topic.number, 0, 0, 0), np.uint8)
        for at in (RECORD.size - 16, RECORD.size - 8):
            np.ndarray((len(rows),), "<u8", rows, at, rows.strides[:1])[:] = log_ns
        template.fill(rows, RECORD.size, stamp_ns, values)
        self._hold(topic, log_ns, rows)

    def _hold(self, topic: BagTopic, log_ns: IntArray, rows: NDArray[np.uint8]) -> None:
        """Keep records of a topic until a chunk is full."""
        if topic.number in self._waiting and self._held > CHUNK_BYTES:
            self._flush()
        topic.count += len(rows)
        self._pending.append((topic.number, log_ns, rows))
        self._waiting.add(topic.number)
        self._held += rows.size

    def _flush(self) -> None:
        """Write what is pending, in the order of log time."""
        self._file.write(self._new)
        self._new = b""
        if not self._pending:
            return
        log_ns = np.concatenate([log for _, log, _ in self._pending])
        order = np.argsort(log_ns, kind="stable")
        channel = np.repeat([number for number, _, _ in self._pending], [len(log) for _, log, _ in self._pending])
        blocks = [(rows.tobytes(), rows.shape[1]) for _, _, rows in self._pending]
        records = [data[at : at + size] for data, size in blocks for at in range(0, len(data), size)]
        ends = np.cumsum([len(records[row]) for row in order])
        start = 0
        while start < len(order):
            before = int(ends[start - 1]) if start else 0
            stop = max(start + 1, int(np.searchsorted(ends, before + CHUNK_BYTES, side="right")))
            rows = order[start:stop]
            offset = np.concatenate(([0], ends[start : stop - 1] - before))
            self._chunk(b"".join([records[row] for row in rows]), channel[rows], log_ns[rows], offset)
            start = stop
        self._pending.clear()
        self._waiting.clear()
        self._held = 0

    def _chunk(self, data: bytes, channel: NDArray[np.intp], log_ns: IntArray, offset: IntArray) -> None:
        """Write one chunk and its index of messages, and remember its place."""
        first, last = int(log_ns[0]), int(log_ns[-1])
        self._span = [min(self._span[0], first), max(self._span[1], last)]
        place = self._file.tell()
        head = struct.pack("<QQQI", first, last, len(data), zlib.crc32(data))
        length = self._file.write(_record(0x06, head + _text("") + struct.pack("<Q", len(data)) + data))
        indices: list[bytes] = []
        offsets = b""
        for number in np.unique(channel):
            rows = np.flatnonzero(channel == number)
            pairs = np.stack((log_ns[rows], offset[rows]), axis=1).astype("<u8").tobytes()
            offsets += struct.pack("<HQ", number, place + length + sum(map(len, indices)))
            indices.append(_record(0x07, struct.pack("<H", number) + _sized(pairs)))
        self._file.write(b"".join(indices))
        where = struct.pack("<QQQQ", first, last, place, length) + _sized(offsets)
        sizes = struct.pack("<Q", sum(map(len, indices))) + _text("") + struct.pack("<QQ", len(data), len(data))
        self._chunks.append(_record(0x08, where + sizes))

    def _schema(self, topic: BagTopic) -> bytes:
        return _record(0x03, struct.pack("<H", topic.number) + _text(topic.msgtype) + _text("ros2msg") + _text(topic.text))

    def _channel(self, topic: BagTopic) -> bytes:
        numbers = struct.pack("<HH", topic.number, topic.number)
        offered = _sized(_text("offered_qos_profiles") + _text(""))
        return _record(0x04, numbers + _text(topic.name) + _text("cdr") + offered)

    def _summary(self) -> None:
        """Write what lets a player find its way: topics, chunks, counts."""
        self._file.write(_record(0x0F, struct.pack("<I", 0)))
        counts = _sized(b"".join(struct.pack("<HQ", topic.number, topic.count) for topic in self._topics))
        messages = sum(topic.count for topic in self._topics)
        span = self._span if messages else [0, 0]
        topics, chunks = len(self._topics), len(self._chunks)
        statistics = struct.pack("<QHIIIIQQ", messages, topics, topics, 0, 0, chunks, *span)
        groups = {
            0x03: b"".join(map(self._schema, self._topics)),
            0x04: b"".join(map(self._channel, self._topics)),
            0x08: b"".join(self._chunks),
            0x0B: _record(0x0B, statistics + counts),
        }
        start = self._file.tell()
        offsets = b""
        for code, records in groups.items():
            if records:
                offsets += _record(0x0E, struct.pack("<BQQ", code, self._file.tell(), len(records)))
                self._file.write(records)
        footer = struct.pack("<QQI", start, self._file.tell(), 0)
        self._file.write(offsets + _record(0x02, footer) + MAGIC)


def _record(code: int, content: bytes) -> bytes:
    return struct.pack("<BQ", code, len(content)) + content


def _sized(content: bytes) -> bytes:
    return struct.pack("<I", len(content)) + content


def _text(text: str) -> bytes:
    return _sized(text.encode())
