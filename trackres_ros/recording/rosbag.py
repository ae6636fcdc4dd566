# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads bags in blocks: rosbag2 and ROS 1 recordings."""

from __future__ import annotations

import itertools
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from numpy.typing import NDArray

from trackres_ros.errors import InputError, MissingExtraError, nearest, one_line
from trackres_ros.recording.bag_counts import counts_of, storages_of
from trackres_ros.recording.bag_types import types_of
from trackres_ros.recording.binding import NO_FIX, TopicBinding
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.cdr import Encoding, FieldReader
from trackres_ros.recording.guess import guess
from trackres_ros.recording.message_types import Definitions, check_field, stamp_path
from trackres_ros.recording.position_units import PositionUnits
from trackres_ros.recording.reading import check_file, check_there, reading
from trackres_ros.recording.ros_bag import RosBag, RosTopic
from trackres_ros.recording.samples import Finding, IntArray, SampleBlock
from trackres_ros.recording.sums import Sums, readings_of
from trackres_ros.recording.torque_candidates import note_of, of_topics
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

BATCH_ROWS, BATCH_BYTES = 2048, 32 * 2**20
"""Serialised messages held at once: few stay in the cache of the processor, and large ones do not fill the memory."""
READABLE = "a bag that is readable to its end"
REMEDIES = {".mcap": "try: mcap recover", ".bag": "try: rosbag reindex"}
MAX_LOG_NS = 2**62
"""Log times from 1970 to 2116 are accepted: differences of two of them fit in 64 bits [ns]."""
MAX_METADATA_BYTES, MAX_METADATA_DEPTH = 2**24, 50
"""Of the metadata.yaml of a bag; ten hours in files of a minute fill a hundredth of it, and the deepest value has 8 above it."""
SQLITE_LIMIT_LENGTH = 0
TOPICS_SHOWN = 50


@dataclass(frozen=True, slots=True)
class _Topic:
    """One topic to read: indices of the readings it feeds, their bindings, whose stamp each takes, and the decoder."""

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
    unusable: dict[int, int] = field(default_factory=dict)
    unknown: int = 0
    speeds: int = 0
    remarks: list[str] = field(default_factory=list)

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
        self.name = one_line(", ".join(str(path) for path in paths))
        self._paths = tuple(paths)
        found: list[tuple[Path, list[Connection]]] = []
        self._kept = {self._paths[0]: open_bag(self._paths[0])}
        weakref.finalize(self, _close, self._kept)
        for path in paths:
            reader = self._kept.get(path) or open_bag(path)
            found.append((path, list(reader.connections)))
            if path not in self._kept:
                reader.close()
        self.torque_candidates = tuple(of_topics({one.topic: one.msgtype for _, ones in found for one in ones}))
        guesses: list[str] = []
        if topics is None:
            filled = {one.topic: one.msgtype for _, ones in found for one in ones if one.msgcount}
            topics, guesses = guess(filled)
        bindings = self.bindings = {role: topics[role] for role in topics if topics[role].of_topics}
        if "speed" not in bindings:
            raise InputError(f"{topics.origin}: speed", "no topic", "a topic for speed", "add a line for it")
        self.roles = tuple(sorted(bindings, key=lambda role: role == "speed"))
        self._readings = readings_of(self.roles, bindings)
        self._origin = topics.origin
        self._topics = self._bound(found)
        self._position = PositionUnits(bindings)
        candidates = note_of(self.torque_candidates, self.roles)
        self._notes = tuple(map(one_line, (*guesses, *self._stamp_notes(), *Sums(self._readings, bindings).notes, *candidates)))
        self.findings: tuple[Finding, ...] = ()

    def _bound(self, found: Sequence[tuple[Path, list[Connection]]]) -> dict[tuple[Path, str], _Topic]:
        """Return what to read, by path and topic; readings of one topic are decoded together."""
        there = {one.topic: one.msgtype for _, ones in found for one in ones}
        by_topic: dict[str, list[int]] = {}
        for index, reading_ in enumerate(self._readings):
            named = reading_.binding.topic
            name = named if named in there or named.startswith("/") else f"/{named}"
            if name not in there:
                listed = "; ".join(f"{topic} ({kind})" for topic, kind in sorted(there.items())[:TOPICS_SHOWN])
                where = f"{self._origin}: {reading_.name}: topic"
                raise InputError(where, named, f"a topic of {self.name}: {listed}", nearest(named, there))
            by_topic.setdefault(name, []).append(index)
        bound: dict[tuple[Path, str], _Topic] = {}
        readers: dict[tuple[str, str, str, Encoding], FieldReader] = {}
        for path, connections in found:
            for one in connections:
                indices = by_topic.get(one.topic, [])
                if not indices:
                    continue
                if (path, one.topic) in bound:
                    if one.msgtype != bound[path, one.topic].msgtype:
                        kinds = f"{one.topic} as {bound[path, one.topic].msgtype} and as {one.msgtype}"
                        raise InputError(str(path), kinds, "one type on a topic that is read")
                    continue
                encoding = Encoding.ROS1 if is_ros1(path) else Encoding.CDR
                key = (one.topic, one.msgtype, str(one.msgdef), encoding)
                types = readers[key].types if key in readers else types_of(one, path, encoding)
                chosen = tuple(self._readings[index].binding for index in indices)
                for index, binding in zip(indices, chosen, strict=True):
                    _check_binding(binding, one, types, f"{self._origin}: {self._readings[index].name}")
                if key not in readers:
                    fields = [*(binding.field for binding in chosen), *filter(None, [chosen[0].fix])]
                    readers[key] = FieldReader(types, one.msgtype, fields, encoding)
                stamped = bool(stamp_path(types, one.msgtype))
                bound[path, one.topic] = _Topic(
                    one.topic,
                    one.msgtype,
                    tuple(indices),
                    chosen,
                    tuple(stamped and binding.stamp != "log" for binding in chosen),
                    readers[key],
                )
        return bound

    def _stamp_notes(self) -> Iterator[str]:
        noted = set()
        for topic in self._topics.values():
            for role, binding, header in zip(topic.roles, topic.bindings, topic.header, strict=True):
                if role not in noted:
                    noted.add(role)
                    why = "as the topics file says" if binding.stamp else f"{topic.msgtype} has no stamp"
                    stamps = "header stamps" if header else f"log time, {why}"
                    yield f"{self._readings[role].name}: {topic.name} ({topic.msgtype}, {binding.field}), {stamps}"

    @property
    def notes(self) -> tuple[str, ...]:
        """What was guessed, which stamps are used, and in which unit a position was taken to be once it was read."""
        return (*self._notes, *self._position.notes)

    def blocks(self, max_rows: int = 65536) -> Iterator[SampleBlock]:
        """Read all bags; see `trackres_ros.recording.samples.Source.blocks`.

        Raises
        ------
        InputError
            A bag that breaks off or is damaged.
        """
        tally, sums = _Tally(), Sums(self._readings, self.bindings)
        held: list[SampleBlock] = []
        for path in self._paths:
            for block in self._batches(path, max_rows, tally):
                if sum(map(len, held)) + len(block) > max_rows:
                    yield self._position.in_radians(sums.added(_joined(held)), self.roles)
                    held.clear()
                held.append(block)
        if held:
            yield self._position.in_radians(sums.added(_joined(held)), self.roles)
        self.findings = (*self._found(tally), *sums.findings)
        speed = len(self._readings) - 1
        if not tally.speeds and speed in tally.absent:
            where, given = f"{self._origin}: speed: field", f"{self._field(speed)}, {self._lack(speed)}"
            raise InputError(where, given, f"an element that the messages of {self.name} have")

    def _field(self, role: int) -> str:
        return next(topic.bindings[topic.roles.index(role)].field for topic in self._topics.values() if role in topic.roles)

    def _lack(self, role: int) -> str:
        """Why messages have no element for a role."""
        lacks = [topic.reader.lacks.get(topic.roles.index(role), "") for topic in self._topics.values() if role in topic.roles]
        return next(filter(None, lacks), "")

    def _batches(self, path: Path, max_rows: int, tally: _Tally) -> Iterator[SampleBlock]:
        """Read one bag in the small batches that are decoded together."""
        with (
            reading(path, READABLE, remedy(path)),
            closing(self._kept.pop(path) if path in self._kept else open_bag(path)) as reader,
        ):
            counts = counts_of(reader, path)
            tally.unknown += counts.unknown
            tally.remarks += counts.remarks
            wanted = [one for one in reader.connections if (path, one.topic) in self._topics]
            if not wanted:
                return
            topics = list({one.topic: self._topics[path, one.topic] for one in wanted}.values())
            index = {topic.name: number for number, topic in enumerate(topics)}
            lost = np.array([counts.by_topic[topic.name] for topic in topics], np.int64)
            batches = messages(reader, wanted)
            most = min(BATCH_ROWS, max(1, max_rows // max(len(topic.roles) for topic in topics)))
            size = min(64, most)
            while batch := list(itertools.islice(batches, size)):
                # A damaged index leads to messages that say they are of a connection not asked for: those stay missing.
                which = np.array([index.get(one[0].topic, -1) for one in batch], np.intp)
                if which.min() < 0:
                    batch = list(itertools.compress(batch, (which >= 0).tolist()))
                    which = which[which >= 0]
                    if not batch:
                        continue
                stamps, raws = [one[1] for one in batch], [one[2] for one in batch]
                lost -= np.bincount(which, minlength=len(topics))
                times = _times(stamps)
                if times is None or set(map(type, raws)) != {bytes}:
                    good = np.array([_times([stamp]) is not None and type(raw) is bytes for _, stamp, raw in batch])
                    for number in which[~good].tolist():
                        role = topics[number].roles[0]
                        tally.unusable[role] = tally.unusable.get(role, 0) + 1
                    which, raws = which[good], list(itertools.compress(raws, good.tolist()))
                    times = np.array(list(itertools.compress(stamps, good.tolist())), np.int64)
                if len(raws):
                    yield self._block(topics, which, times, raws, tally)
                size = min(most, 1 + BATCH_BYTES * len(raws) // max(1, sum(map(len, raws))))
            for topic, count in zip(topics, lost.tolist(), strict=True):
                if count > 0:
                    tally.missing[topic.roles[0]] = tally.missing.get(topic.roles[0], 0) + count

    def _block(
        self, topics: Sequence[_Topic], which: NDArray[np.intp], arrival_ns: IntArray, raws: Sequence[bytes], tally: _Tally
    ) -> SampleBlock:
        """Decode a batch of messages; those of topic `topics[which]`."""
        if tally.first_ns is None:
            tally.first_ns = int(arrival_ns[0])
        rows_each = np.array([len(topic.roles) for topic in topics])[which]
        start = np.cumsum(rows_each) - rows_each
        rows = int(rows_each.sum())
        block = SampleBlock(np.empty(rows, np.int16), np.empty(rows, np.int64), np.empty(rows, np.int64), np.empty(rows))
        keep = np.ones(rows, np.bool_)
        for number, topic in enumerate(topics):
            mine = which == number
            decoded = topic.reader.decode(list(itertools.compress(raws, mine.tolist())))
            if topic.bindings[0].fix:
                decoded.value[decoded.value[:, -1] == NO_FIX] = np.nan
            arrived = arrival_ns[mine]
            for slot, (role, binding, header) in enumerate(zip(topic.roles, topic.bindings, topic.header, strict=True)):
                to = start[mine] + slot
                block.role[to] = role
                block.arrival_ns[to] = arrived
                stamps = np.where(decoded.malformed, arrived, decoded.stamp_ns) if header else arrived
                block.stamp_ns[to] = np.where(stamps != 0, stamps - binding.delay_ns, 0) if binding.delay_ns else stamps
                block.value[to] = binding.meant(binding.scale * decoded.value[:, slot] + binding.offset)
                keep[to] = ~decoded.absent[:, slot]
                tally.add(tally.malformed, role, arrived[decoded.malformed])
                tally.add(tally.absent, role, arrived[decoded.absent[:, slot]])
        tally.speeds += int(np.count_nonzero(keep & (block.role == len(self._readings) - 1)))
        if keep.all():
            return block
        return SampleBlock(block.role[keep], block.stamp_ns[keep], block.arrival_ns[keep], block.value[keep])

    def _found(self, tally: _Tally) -> Iterator[Finding]:
        start = tally.first_ns or 0
        for role, (count, first) in tally.malformed.items():
            text = f"{count} messages cannot be decoded; each counts as a value that is not a number"
            yield Finding(self._readings[role].role, "malformed", count, (first - start) / 1e9, text)
        for role, (count, first) in tally.absent.items():
            yield Finding(
                self._readings[role].role,
                "absent",
                count,
                (first - start) / 1e9,
                f"{count} messages do not have {self._field(role)}: {self._lack(role)}; they give no sample",
            )
        for role, count in tally.missing.items():
            yield Finding(
                self._readings[role].role, "missing", count, float("nan"), f"{count} messages fewer than the bag says it holds"
            )
        for role, count in tally.unusable.items():
            text = f"{count} messages left out: they hold no bytes, or no log time between 1970 and 2116"
            yield Finding(self._readings[role].role, "unusable", count, float("nan"), text)
        if tally.unknown:
            text = f"{tally.unknown} messages of topics that the bag does not describe are left out"
            yield Finding("", "unknown_topic", tally.unknown, float("nan"), text)
        for remark in dict.fromkeys(tally.remarks):
            yield Finding("", "structure", 1, float("nan"), remark)


def is_ros1(path: Path) -> bool:
    """Whether a path is a bag of ROS 1: a file; a folder of such a name is a rosbag2."""
    return path.suffix == ".bag" and not path.is_dir()


def remedy(path: Path) -> str:
    """Remedy for an unreadable bag."""
    return "try: ros2 bag reindex" if path.is_dir() else REMEDIES.get(path.suffix, "try: ros2 bag reindex")


def open_bag(path: Path) -> Reader:
    """Open one bag for reading; it is the caller's to close.

    With the library rosbags where that is installed, else with those of ROS 2, which do not read bags of ROS 1.

    Raises
    ------
    InputError
        It is no bag, or asks for more memory or space than is there.
    MissingExtraError
        rosbags is not installed, and nothing else that reads the bag.
    """
    opened = _opener(path)
    check_there(path)
    if path.is_dir():
        _check_folder(path)
    else:
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
    """Return what opens a bag with the library that is there."""
    try:
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2
    except ImportError:
        if is_ros1(path) or not find_spec("rosbag2_py"):
            raise MissingExtraError("reading bags", "rosbags", "bags") from None
        return RosBag

    def opened(path: Path) -> Reader:
        set_ceilings()
        place: Any = UnfinishedBag(path) if path.is_file() and is_unfinished(path) else path
        reader: Reader1 | Reader2 = Reader1(path) if is_ros1(path) else Reader2(place)
        reader.open()
        return reader

    return opened


def _check_folder(path: Path) -> None:
    """Refuse a rosbag2 folder in which there is more, or something else, than recorders write."""
    for inside in sorted(path.iterdir()):
        check_there(inside)
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
            yield connection, stamp, b""  # what cannot be unpacked is malformed, and counted so


def _times(stamps: Sequence[object]) -> IntArray | None:
    """Log times that are such, as columns of a database need not be; else None."""
    times = np.array(stamps)
    return times if times.dtype == np.int64 and times.min() >= 0 and times.max() < MAX_LOG_NS else None


def _close(readers: Mapping[Path, Reader]) -> None:
    for reader in readers.values():
        reader.close()


def _joined(blocks: Sequence[SampleBlock]) -> SampleBlock:
    if len(blocks) == 1:
        return blocks[0]
    return SampleBlock(
        np.concatenate([block.role for block in blocks]),
        np.concatenate([block.stamp_ns for block in blocks]),
        np.concatenate([block.arrival_ns for block in blocks]),
        np.concatenate([block.value for block in blocks]),
    )


def _check_binding(binding: TopicBinding, one: Connection, types: Definitions, where: str) -> None:
    """Refuse a type, field or stamp that the topic in the bag does not have."""
    if binding.type != one.msgtype:
        raise InputError(f"{where}: type", binding.type, f"{one.msgtype}, as {one.topic} has in the bag")
    check_field(types, one.msgtype, binding.field, f"{where}: field")
    if binding.stamp == "header" and not stamp_path(types, one.msgtype):
        raise InputError(f"{where}: stamp", "header", f"log: {one.msgtype} has no stamp")
