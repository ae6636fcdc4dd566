"""Bags: rosbag2 and ROS 1 recordings read in blocks, and an MCAP file written in blocks."""

from __future__ import annotations

import itertools
import os
import struct
import weakref
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, BinaryIO, Literal, Self

import numpy as np
from numpy.typing import NDArray

from trackres_ros.cdr import Definitions, Encoding, FieldReader, Template, check_field, definitions, stamp_path
from trackres_ros.errors import InputError, MissingExtraError
from trackres_ros.recording import Block, Finding, FloatArray, IntArray
from trackres_ros.topics import TopicBinding, Topics, guess, nearest

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.interfaces.typing import Typesdict
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2
    from rosbags.typesys.store import Typestore

BATCH_ROWS, BATCH_BYTES = 2048, 32 * 2**20
"""Serialised messages held at once: few stay in the cache of the processor, and large ones do not fill the memory."""
CHUNK_BYTES = 2**20
"""Size of a chunk of the MCAP file [bytes]: what a player reads at once."""
REMEDIES = {".mcap": "a file that was cut off is repaired with: mcap recover", ".bag": "try: rosbag reindex"}


@dataclass(frozen=True, slots=True)
class _Topic:
    """One topic to read: indices of the roles it feeds, their bindings, whose stamp each takes, and the decoder."""

    name: str
    msgtype: str
    roles: tuple[int, ...]
    bindings: tuple[TopicBinding, ...]
    header: tuple[bool, ...]
    reader: FieldReader


@dataclass(slots=True)
class _Tally:
    """What one run of reading met, by role index."""

    first_ns: int | None = None
    malformed: dict[int, tuple[int, int]] = field(default_factory=dict)
    absent: dict[int, tuple[int, int]] = field(default_factory=dict)
    missing: dict[int, int] = field(default_factory=dict)

    def add(self, into: dict[int, tuple[int, int]], role: int, arrival_ns: IntArray) -> None:
        """Count samples of a role; the first one met keeps its place."""
        if arrival_ns.size:
            count, first = into.get(role, (0, int(arrival_ns[0])))
            into[role] = (count + int(arrival_ns.size), first)


class BagSource:
    """Samples of one or several bags, one after another, each in log order.

    Reads rosbag2 directories (MCAP and sqlite3, compressed, split), single ``.mcap`` and ``.db3`` files, and ROS 1
    bags. A message that cannot be decoded becomes a sample NaN at log time and a finding.

    Parameters
    ----------
    paths : sequence of Path
        The bags.
    topics : Topics, optional
        Which topic feeds which role; guessed from the message types without.

    Raises
    ------
    InputError
        A file that is no bag, a topic or field that is not there, a type that is not known, or no speed.
    MissingExtraError
        rosbags is not installed.
    """

    zero_is_unset = True

    def __init__(self, paths: Sequence[Path], topics: Topics | None = None) -> None:
        self.name = ", ".join(str(path) for path in paths)
        self._paths = tuple(paths)
        found: list[tuple[Path, list[Connection]]] = []
        self._kept = {self._paths[0]: _opened(self._paths[0])}
        weakref.finalize(self, _close, self._kept)
        for path in paths:
            reader = self._kept.get(path) or _opened(path)
            found.append((path, list(reader.connections)))
            if path not in self._kept:
                reader.close()
        said: list[str] = []
        if topics is None:
            filled = {one.topic: one.msgtype for _, ones in found for one in ones if one.msgcount}
            topics, said = guess(filled)
        bindings = {role: topics[role] for role in topics if topics[role].topic}
        if "speed" not in bindings:
            raise InputError(f"{topics.origin}: speed", "no topic", "a topic for speed", "add a line for it")
        self.roles = tuple(sorted(bindings, key=lambda role: role == "speed"))
        self._topics = self._bound(found, bindings, topics.origin)
        self.notes = (*said, *self._stamp_notes())
        self.findings: tuple[Finding, ...] = ()

    def _bound(self, found: Sequence[tuple[Path, list[Connection]]], bindings: Mapping[str, TopicBinding],
               origin: str) -> dict[tuple[Path, str], _Topic]:
        """Return what to read, by path and topic; roles of one topic are decoded together."""
        there = {one.topic: one.msgtype for _, ones in found for one in ones}
        by_topic: dict[str, list[str]] = {}
        for role in self.roles:
            named = bindings[role].topic
            name = named if named in there or named.startswith("/") else f"/{named}"
            if name not in there:
                listed = "; ".join(f"{topic} ({kind})" for topic, kind in sorted(there.items()))
                raise InputError(f"{origin}: {role}: topic", named, f"a topic of {self.name}: {listed}",
                                 nearest(named, there))
            by_topic.setdefault(name, []).append(role)
        bound: dict[tuple[Path, str], _Topic] = {}
        readers: dict[tuple[str, str, str, Encoding], FieldReader] = {}
        for path, connections in found:
            for one in connections:
                roles = by_topic.get(one.topic, [])
                if not roles or (path, one.topic) in bound:
                    continue
                encoding = Encoding.ROS1 if path.suffix == ".bag" else Encoding.CDR
                key = (one.topic, one.msgtype, str(one.msgdef), encoding)
                types = readers[key].types if key in readers else _types(one, path, encoding)
                chosen = tuple(bindings[role] for role in roles)
                for role, binding in zip(roles, chosen, strict=True):
                    _check_binding(binding, one, types, f"{origin}: {role}")
                if key not in readers:
                    readers[key] = FieldReader(types, one.msgtype, [binding.field for binding in chosen], encoding)
                stamped = bool(stamp_path(types, one.msgtype))
                bound[path, one.topic] = _Topic(
                    one.topic, one.msgtype, tuple(self.roles.index(role) for role in roles), chosen,
                    tuple(stamped and binding.stamp != "log" for binding in chosen), readers[key])
        return bound

    def _stamp_notes(self) -> Iterator[str]:
        said = set()
        for topic in self._topics.values():
            for role, binding, header in zip(topic.roles, topic.bindings, topic.header, strict=True):
                if role not in said:
                    said.add(role)
                    why = "as the topics file says" if binding.stamp else f"{topic.msgtype} has no stamp"
                    stamps = "header stamps" if header else f"log time, {why}"
                    yield f"{self.roles[role]}: {topic.name} ({topic.msgtype}, {binding.field}), {stamps}"

    def blocks(self, max_rows: int = 65536) -> Iterator[Block]:
        """Read all bags; see `trackres_ros.recording.Source.blocks`.

        Raises
        ------
        InputError
            A bag that breaks off or is damaged.
        """
        tally = _Tally()
        held: list[Block] = []
        for path in self._paths:
            for block in self._batches(path, max_rows, tally):
                if sum(map(len, held)) + len(block) > max_rows:
                    yield _joined(held)
                    held.clear()
                held.append(block)
        if held:
            yield _joined(held)
        self.findings = tuple(self._found(tally))

    def _batches(self, path: Path, max_rows: int, tally: _Tally) -> Iterator[Block]:
        """Read one bag in the small batches that are decoded together."""
        with closing(self._kept.pop(path) if path in self._kept else _opened(path)) as reader:
            wanted = [one for one in reader.connections if (path, one.topic) in self._topics]
            if not wanted:
                return
            topics = list({one.topic: self._topics[path, one.topic] for one in wanted}.values())
            index = {one.id: topics.index(self._topics[path, one.topic]) for one in wanted}
            lost = np.zeros(len(topics), np.int64)
            for one in wanted:
                lost[index[one.id]] += one.msgcount
            messages = reader.messages(wanted)
            most = min(BATCH_ROWS, max(1, max_rows // max(len(topic.roles) for topic in topics)))
            size = min(64, most)
            while batch := _batch(messages, size, path):
                connections, stamps, raws = zip(*batch, strict=True)
                which = np.fromiter(map(index.__getitem__, map(itemgetter(0), connections)), np.intp, len(batch))
                lost -= np.bincount(which, minlength=len(topics))
                yield self._block(topics, which, np.fromiter(stamps, np.int64, len(batch)), raws, tally)
                size = min(most, 1 + BATCH_BYTES * len(raws) // max(1, sum(map(len, raws))))
            for topic, count in zip(topics, lost.tolist(), strict=True):
                if count > 0:
                    tally.missing[topic.roles[0]] = tally.missing.get(topic.roles[0], 0) + count

    def _block(self, topics: Sequence[_Topic], which: NDArray[np.intp], arrival_ns: IntArray, raws: Sequence[bytes],
               tally: _Tally) -> Block:
        """Decode a batch of messages; those of topic `topics[which]`."""
        if tally.first_ns is None:
            tally.first_ns = int(arrival_ns[0])
        rows_each = np.array([len(topic.roles) for topic in topics])[which]
        start = np.cumsum(rows_each) - rows_each
        rows = int(rows_each.sum())
        block = Block(np.empty(rows, np.int16), np.empty(rows, np.int64), np.empty(rows, np.int64), np.empty(rows))
        keep = np.ones(rows, np.bool_)
        for number, topic in enumerate(topics):
            mine = which == number
            decoded = topic.reader.decode(list(itertools.compress(raws, mine.tolist())))
            arrived = arrival_ns[mine]
            for slot, (role, binding, header) in enumerate(zip(topic.roles, topic.bindings, topic.header, strict=True)):
                to = start[mine] + slot
                block.role[to] = role
                block.arrival_ns[to] = arrived
                block.stamp_ns[to] = np.where(decoded.malformed, arrived, decoded.stamp_ns) if header else arrived
                block.value[to] = binding.scale * decoded.value[:, slot] + binding.offset
                keep[to] = ~decoded.absent[:, slot]
                tally.add(tally.malformed, role, arrived[decoded.malformed])
                tally.add(tally.absent, role, arrived[decoded.absent[:, slot]])
        if keep.all():
            return block
        return Block(block.role[keep], block.stamp_ns[keep], block.arrival_ns[keep], block.value[keep])

    def _found(self, tally: _Tally) -> Iterator[Finding]:
        start = tally.first_ns or 0
        for role, (count, first) in tally.malformed.items():
            text = f"{count} messages cannot be decoded; each counts as a value that is not a number"
            yield Finding(self.roles[role], "malformed", count, (first - start) / 1e9, text)
        for role, (count, first) in tally.absent.items():
            yield Finding(self.roles[role], "absent", count, (first - start) / 1e9,
                          f"{count} messages do not have the element; they give no sample")
        for role, count in tally.missing.items():
            yield Finding(self.roles[role], "missing", count, float("nan"),
                          f"{count} messages fewer than the bag says it holds")


def _opened(path: Path) -> Reader1 | Reader2:
    """Open one bag for reading."""
    try:
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2
    except ImportError:
        raise MissingExtraError("reading bags", "rosbags", "bags") from None
    try:
        reader = Reader1(path) if path.suffix == ".bag" else Reader2(path)
        reader.open()
    except Exception as error:
        raise _unreadable(path, error) from error
    return reader


def _close(readers: Mapping[Path, Reader1 | Reader2]) -> None:
    for reader in readers.values():
        reader.close()


def _joined(blocks: Sequence[Block]) -> Block:
    if len(blocks) == 1:
        return blocks[0]
    return Block(np.concatenate([block.role for block in blocks]), np.concatenate([block.stamp_ns for block in blocks]),
                 np.concatenate([block.arrival_ns for block in blocks]),
                 np.concatenate([block.value for block in blocks]))


def _batch(messages: Iterator[tuple[Connection, int, bytes]], size: int,
           path: Path) -> list[tuple[Connection, int, bytes]]:
    """Return the next messages; whatever the library stumbles over is the bag's damage, said with its path."""
    try:
        return list(itertools.islice(messages, size))
    except Exception as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: Exception) -> InputError:
    remedy = REMEDIES.get(path.suffix, "try: ros2 bag reindex")
    if path.is_file() and "metadata.yaml" in str(error):
        remedy = "name its directory: this version of rosbags reads no single file; or pip install --upgrade rosbags"
    return InputError(str(path), f"{type(error).__name__}: {error}", "a bag that can be read to its end", remedy)


def _types(one: Connection, path: Path, encoding: Encoding) -> Definitions:
    """Return the definition of a connection's type: of the bag where it has one, else the common one."""
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    text = one.msgdef if isinstance(one.msgdef, str) else one.msgdef.data
    separator = "=" * 80 + "\n"
    fields = dict(_fielddefs(get_typestore(Stores.ROS1_NOETIC if encoding is Encoding.ROS1 else Stores.LATEST)))
    try:
        if text.startswith(f"{separator}IDL: "):
            for part in text.split(separator)[1:]:
                fields.update(get_types_from_idl(part.partition("\n")[2]))
        elif text:
            fields.update(get_types_from_msg(text, one.msgtype))
        return definitions(fields, one.msgtype)
    except KeyError as error:
        raise InputError(f"{path}: {one.topic}", f"{one.msgtype} with {error}", "a message type with its definition",
                         "the bag holds no definition of it: record as MCAP, which does") from None
    except Exception as error:
        raise InputError(f"{path}: {one.topic}", f"{type(error).__name__}: {error}",
                         f"a definition of {one.msgtype} that can be read") from error


def _fielddefs(store: Typestore) -> Typesdict:
    """Return the definitions of a typestore, under the name of this version of rosbags."""
    found: Typesdict = getattr(store, "fielddefs", None) or getattr(store, "FIELDDEFS")  # noqa: B009
    return found


def _check_binding(binding: TopicBinding, one: Connection, types: Definitions, where: str) -> None:
    """Refuse a type, field or stamp that the topic in the bag does not have."""
    if binding.type != one.msgtype:
        raise InputError(f"{where}: type", binding.type, f"{one.msgtype}, as {one.topic} has in the bag")
    check_field(types, one.msgtype, binding.field, f"{where}: field")
    if binding.stamp == "header" and not stamp_path(types, one.msgtype):
        raise InputError(f"{where}: stamp", "header", f"log: {one.msgtype} has no stamp")


@dataclass(slots=True)
class BagTopic:
    """A topic of a `BagWriter`, from `BagWriter.topic`."""

    number: int
    name: str
    msgtype: str
    types: Definitions
    template: Template | None
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

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
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
            types = definitions(_fielddefs(self.typestore), msgtype)
        except KeyError:
            raise InputError(f"{self.path}: {name}", msgtype, "a common message type") from None
        number = len(self._topics) + 1
        ready = None
        if template is not None:
            ready = Template(bytes(self.typestore.serialize_cdr(template, msgtype)), types, msgtype, fields)
        topic = BagTopic(number, name, msgtype, types, ready)
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

    def _write(self, topic: BagTopic, template: Template, stamp_ns: IntArray, log_ns: IntArray,
               values: FloatArray) -> None:
        if not len(log_ns):
            return
        if values.shape != (len(log_ns), template.reader.count) or stamp_ns.shape != log_ns.shape:
            raise InputError(f"{self.path}: {topic.name}", f"{stamp_ns.shape}, {log_ns.shape}, {values.shape}",
                             f"(n,), (n,) and (n, {template.reader.count})")
        if int(log_ns.min()) < 0:
            raise InputError(f"{self.path}: {topic.name}: log time", int(log_ns.min()), "0 ns or later")
        if topic.number in self._waiting and self._held > CHUNK_BYTES:
            self._flush()
        size = RECORD.size + len(template.raw)
        rows = np.empty((len(log_ns), size), np.uint8)
        rows[:, :RECORD.size] = np.frombuffer(RECORD.pack(0x05, size - 9, topic.number, 0, 0, 0), np.uint8)
        for at in (RECORD.size - 16, RECORD.size - 8):
            np.ndarray((len(rows),), "<u8", rows, at, rows.strides[:1])[:] = log_ns
        template.fill(rows, RECORD.size, stamp_ns, values)
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
        records = [data[at:at + size] for data, size in blocks for at in range(0, len(data), size)]
        ends = np.cumsum([len(records[row]) for row in order])
        start = 0
        while start < len(order):
            before = int(ends[start - 1]) if start else 0
            stop = max(start + 1, int(np.searchsorted(ends, before + CHUNK_BYTES, side="right")))
            rows = order[start:stop]
            offset = np.concatenate(([0], ends[start:stop - 1] - before))
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
        text, _ = self.typestore.generate_msgdef(topic.msgtype, ros_version=2)
        return _record(0x03, struct.pack("<H", topic.number) + _text(topic.msgtype) + _text("ros2msg") + _text(text))

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
        groups = {0x03: b"".join(map(self._schema, self._topics)), 0x04: b"".join(map(self._channel, self._topics)),
                  0x08: b"".join(self._chunks), 0x0B: _record(0x0B, statistics + counts)}
        start = self._file.tell()
        offsets = b""
        for code, records in groups.items():
            if records:
                offsets += _record(0x0E, struct.pack("<BQQ", code, self._file.tell(), len(records)))
                self._file.write(records)
        footer = struct.pack("<QQI", start, self._file.tell(), 0)
        self._file.write(offsets + _record(0x02, footer) + MAGIC)


MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQHIQQ")
"""Head of a message: code, length of the rest, channel, sequence, log time, publish time."""


def _record(code: int, content: bytes) -> bytes:
    return struct.pack("<BQ", code, len(content)) + content


def _sized(content: bytes) -> bytes:
    return struct.pack("<I", len(content)) + content


def _text(text: str) -> bytes:
    return _sized(text.encode())
