# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes an MCAP file in blocks, as Foxglove, PlotJuggler and `ros2 bag play` open it."""

import os
import struct
import zlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from trackres_ros.errors import InputError
from trackres_ros.files.output_files import BEFORE_1970
from trackres_ros.files.own_files import put
from trackres_ros.recording.cdr import Template
from trackres_ros.recording.mcap import (
    CHANNEL,
    CHUNK,
    HEADER,
    MAGIC,
    MESSAGE,
    SCHEMA,
    Chunk,
    ending,
    message_indices,
    record,
    sized,
    text,
)
from trackres_ros.recording.message_types import Definitions, add_control_msgs, definitions, message_fields
from trackres_ros.recording.samples import FloatArray, IntArray

CHUNK_BYTES = 2**20
"""Size of a chunk of the MCAP file [bytes], which a player reads at once."""
BEGINNING = MAGIC + record(HEADER, text("ros2") + text("trackres_ros"))
"""First bytes of a file of ours."""
RECORD = struct.Struct("<BQHIQQ")
"""Head of a message: code, length of the rest, channel, sequence, log time, publish time."""


@dataclass(slots=True)
class BagTopic:
    """A topic of a `BagWriter`, from `BagWriter.topic`; `count` messages of it are in the file."""

    number: int
    name: str
    msgtype: str
    types: Definitions
    template: Template | None
    text: str
    count: int = 0


class BagWriter:
    """Writes one MCAP file, as Foxglove, PlotJuggler and ``ros2 bag play`` open it.

    The file is put in place only when the `with` block ends without an exception. Messages are sorted by log time within a batch,
    which ends when a topic is written again. A chunk is written completely or not at all, so the file can be read up to its last
    chunk at any time, whatever ends the program or fills the disk.

    Parameters
    ----------
    path : Path
        The file, see `output_file`; replaced if it exists.
    part : Path, optional
        File for writing until it is finished, which must be new. It stays if it cannot be finished; by default a hidden file in
        the same folder, which never stays.
    """

    def __init__(self, path: Path, part: Path | None = None) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.path = path
        self.typestore = add_control_msgs(get_typestore(Stores.LATEST))
        self.part = part or path.with_name(f".{path.name}.{os.getpid()}.part")
        self._is_kept = part is not None
        self._topics: list[BagTopic] = []
        self._new_records = b""
        self._pending: list[tuple[int, IntArray, NDArray[np.uint8]]] = []
        self._open_topics: set[int] = set()
        self._pending_bytes = 0
        self._chunks: list[Chunk] = []
        self._file_end = 0

    def __enter__(self) -> Self:
        """Begin a temporary file in the same folder."""
        self._file = self.part.open("xb" if self._is_kept else "wb", buffering=0)
        try:
            self._append(BEGINNING)
        except OSError:
            self._file.close()
            self.part.unlink()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Finish the file and put it in place, or remove the temporary one, unless it is to be kept."""
        try:
            if kind is None:
                self.flush()
                schemas, channels = [list(map(make, self._topics)) for make in (self._schema, self._channel)]
                counts = {topic.number: topic.count for topic in self._topics}
                self._append(ending(self._file_end, schemas, channels, self._chunks, counts))
                if self._is_kept:
                    os.fsync(self._file.fileno())
                self._file.close()
                put(self.part, self.path)
        except BaseException:
            self._drop()
            raise
        if kind is not None:
            self._drop()

    def _drop(self) -> None:
        self._file.close()
        if not self._is_kept:
            self.part.unlink(missing_ok=True)

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return self._file_end

    def topic(self, name: str, msgtype: str, template: object = None, fields: Sequence[str] = ()) -> BagTopic:
        """Announce a topic.

        `name`, `msgtype`: topic, and ``package/msg/Name``; `template`: for `write_block`: constant strings and sequences;
        `fields`: paths of the k numbers that `write_block` sets. Raises InputError for an unknown type, or a field path that does
        not lead to a number of the template.
        """
        try:
            types = definitions(message_fields(self.typestore), msgtype)
        except KeyError:
            raise InputError(f"{self.path}: {name}", msgtype, "a common message type") from None
        ready = None
        if template is not None:
            ready = Template(bytes(self.typestore.serialize_cdr(template, msgtype)), types, msgtype, fields)
        definition, _ = self.typestore.generate_msgdef(msgtype, ros_version=2)
        return self._announce(BagTopic(len(self._topics) + 1, name, msgtype, types, ready, definition))

    def raw_topic(self, name: str, msgtype: str, definition: str) -> BagTopic:
        """Announce a topic with serialised messages, for `write_raw`, with the definition of its type and all nested ones."""
        return self._announce(BagTopic(len(self._topics) + 1, name, msgtype, {}, None, definition))

    def _announce(self, topic: BagTopic) -> BagTopic:
        self._topics.append(topic)
        self._new_records += self._schema(topic) + self._channel(topic)
        return topic

    def template(self, topic: BagTopic, message: object, fields: Sequence[str]) -> Template:
        """A template for `write_block`, of a topic whose messages differ in more than numbers; see `topic`."""
        return Template(bytes(self.typestore.serialize_cdr(message, topic.msgtype)), topic.types, topic.msgtype, fields)

    def write_block(
        self, topic: BagTopic, stamp_ns: IntArray, log_ns: IntArray, values: FloatArray, template: Template | None = None
    ) -> None:
        """Write n messages that differ in stamp and numbers only.

        `topic`: announced with a template; `stamp_ns`, `log_ns`: header stamps, and log times, from 0 on [ns], shape (n,);
        `values`: the numbers of the fields of the topic, shape (n, k); `template`: instead of that of the topic.
        """
        template = template or topic.template
        if template is None:
            raise InputError(f"{self.path}: {topic.name}", "no template", "a topic with a template message")
        self._write(topic, template, stamp_ns, log_ns, values)

    def write(self, topic: BagTopic, message: object, stamp_ns: int, log_ns: int) -> None:
        """Write one message of its own form; its header, if any, gets the stamp [ns]."""
        raw = bytes(self.typestore.serialize_cdr(message, topic.msgtype))
        template = Template(raw, topic.types, topic.msgtype, ())
        self._write(topic, template, np.array([stamp_ns]), np.array([log_ns]), np.empty((1, 0)))

    def write_raw(self, topic: BagTopic, raw: bytes, log_ns: int) -> None:
        """Write one serialised message unchanged."""
        head = RECORD.pack(MESSAGE, RECORD.size + len(raw) - 9, topic.number, 0, log_ns, log_ns)
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
            raise InputError(f"{self.path}: {topic.name}: log time", int(log_ns.min()), "0 ns or later", BEFORE_1970)
        size = RECORD.size + len(template.raw)
        rows = np.empty((len(log_ns), size), np.uint8)
        rows[:, : RECORD.size] = np.frombuffer(RECORD.pack(MESSAGE, size - 9, topic.number, 0, 0, 0), np.uint8)
        for offset in (RECORD.size - 16, RECORD.size - 8):
            np.ndarray((len(rows),), "<u8", rows, offset, rows.strides[:1])[:] = log_ns
        template.fill(rows, RECORD.size, stamp_ns, values)
        self._hold(topic, log_ns, rows)

    def _hold(self, topic: BagTopic, log_ns: IntArray, rows: NDArray[np.uint8]) -> None:
        """Keep records of a topic until a chunk is full."""
        if topic.number in self._open_topics and self._pending_bytes > CHUNK_BYTES:
            self.flush()
        self._pending.append((topic.number, log_ns, rows))
        self._open_topics.add(topic.number)
        self._pending_bytes += rows.size

    def flush(self) -> None:
        """Write pending messages in the order of log time; a program that is killed afterwards does not lose them.

        After an OSError, pending messages are lost, and the file ends with its last complete chunk: writing can continue.
        """
        try:
            self._append(self._new_records)
            self._new_records = b""
            if self._pending:
                self._write_pending()
        finally:
            self._pending.clear()
            self._open_topics.clear()
            self._pending_bytes = 0

    def _write_pending(self) -> None:
        log_ns = np.concatenate([log for _, log, _ in self._pending])
        order = np.argsort(log_ns, kind="stable")
        channel = np.repeat([number for number, _, _ in self._pending], [len(log) for _, log, _ in self._pending])
        blocks = [(rows.tobytes(), rows.shape[1]) for _, _, rows in self._pending]
        records = [data[start_byte : start_byte + size] for data, size in blocks for start_byte in range(0, len(data), size)]
        ends = np.cumsum([len(records[row]) for row in order])
        start = 0
        while start < len(order):
            begin = int(ends[start - 1]) if start else 0
            stop = max(start + 1, int(np.searchsorted(ends, begin + CHUNK_BYTES, side="right")))
            rows = order[start:stop]
            offset = np.concatenate(([0], ends[start : stop - 1] - begin))
            self._chunk(b"".join([records[row] for row in rows]), channel[rows], log_ns[rows], offset)
            start = stop

    def _chunk(self, data: bytes, channel: NDArray[np.intp], log_ns: IntArray, offset: IntArray) -> None:
        """Write one chunk and its index of messages, and remember its place."""
        begin_ns, end_ns = int(log_ns[0]), int(log_ns[-1])
        head = struct.pack("<QQQI", begin_ns, end_ns, len(data), zlib.crc32(data))
        chunk = record(CHUNK, head + text("") + struct.pack("<Q", len(data)) + data)
        indices, offsets = message_indices(channel, log_ns, offset, self._file_end + len(chunk))
        place = self._append(chunk + indices)
        self._chunks.append(Chunk(begin_ns, end_ns, place, len(chunk), offsets, len(indices), "", len(data), len(data)))
        for number, count in zip(*np.unique(channel, return_counts=True), strict=True):
            self._topics[number - 1].count += int(count)

    def _append(self, data: bytes) -> int:
        """Append all of it to the file, or nothing; return its position."""
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError:
            self._file.seek(self._file_end)
            with suppress(OSError):
                self._file.truncate()
            raise
        place, self._file_end = self._file_end, self._file_end + len(data)
        return place

    def _schema(self, topic: BagTopic) -> bytes:
        return record(SCHEMA, struct.pack("<H", topic.number) + text(topic.msgtype) + text("ros2msg") + text(topic.text))

    def _channel(self, topic: BagTopic) -> bytes:
        numbers = struct.pack("<HH", topic.number, topic.number)
        metadata = sized(text("offered_qos_profiles") + text(""))
        return record(CHANNEL, numbers + text(topic.name) + text("cdr") + metadata)
