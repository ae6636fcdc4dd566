"""Bags: rosbag2 and ROS 1 recordings read in blocks."""

from __future__ import annotations

import itertools
import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trackres_ros.cdr import Encoding, FieldReader
from trackres_ros.errors import InputError, MissingExtraError
from trackres_ros.message_types import Definitions, check_field, definitions, message_fields, stamp_path
from trackres_ros.recording import Block, Finding, IntArray
from trackres_ros.topics import TopicBinding, Topics, guess, nearest

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

BATCH_ROWS, BATCH_BYTES = 2048, 32 * 2**20
"""Serialised messages held at once: few stay in the cache of the processor, and large ones do not fill the memory."""
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
        self._kept = {self._paths[0]: open_bag(self._paths[0])}
        weakref.finalize(self, _close, self._kept)
        for path in paths:
            reader = self._kept.get(path) or open_bag(path)
            found.append((path, list(reader.connections)))
            if path not in self._kept:
                reader.close()
        said: list[str] = []
        if topics is None:
            filled = {one.topic: one.msgtype for _, ones in found for one in ones if one.msgcount}
            topics, said = guess(filled)
        bindings = self.bindings = {role: topics[role] for role in topics if topics[role].topic}
        if "speed" not in bindings:
            raise InputError(f"{topics.origin}: speed", "no topic", "a topic for speed", "add a line for it")
        self.roles = tuple(sorted(bindings, key=lambda role: role == "speed"))
        self._topics = self._bound(found, bindings, topics.origin)
        self.notes = (*said, *self._stamp_notes())
        self.findings: tuple[Finding, ...] = ()

    def _bound(
        self, found: Sequence[tuple[Path, list[Connection]]], bindings: Mapping[str, TopicBinding], origin: str
    ) -> dict[tuple[Path, str], _Topic]:
        """Return what to read, by path and topic; roles of one topic are decoded together."""
        there = {one.topic: one.msgtype for _, ones in found for one in ones}
        by_topic: dict[str, list[str]] = {}
        for role in self.roles:
            named = bindings[role].topic
            name = named if named in there or named.startswith("/") else f"/{named}"
            if name not in there:
                listed = "; ".join(f"{topic} ({kind})" for topic, kind in sorted(there.items()))
                raise InputError(f"{origin}: {role}: topic", named, f"a topic of {self.name}: {listed}", nearest(named, there))
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
                    one.topic,
                    one.msgtype,
                    tuple(self.roles.index(role) for role in roles),
                    chosen,
                    tuple(stamped and binding.stamp != "log" for binding in chosen),
                    readers[key],
                )
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
        with closing(self._kept.pop(path) if path in self._kept else open_bag(path)) as reader:
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

    def _block(
        self, topics: Sequence[_Topic], which: NDArray[np.intp], arrival_ns: IntArray, raws: Sequence[bytes], tally: _Tally
    ) -> Block:
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
                stamps = np.where(decoded.malformed, arrived, decoded.stamp_ns) if header else arrived
                block.stamp_ns[to] = np.where(stamps != 0, stamps - binding.delay_ns, 0) if binding.delay_ns else stamps
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
            yield Finding(
                self.roles[role],
                "absent",
                count,
                (first - start) / 1e9,
                f"{count} messages do not have the element; they give no sample",
            )
        for role, count in tally.missing.items():
            yield Finding(self.roles[role], "missing", count, float("nan"), f"{count} messages fewer than the bag says it holds")


def open_bag(path: Path) -> Reader1 | Reader2:
    """Open one bag for reading; it is the caller's to close.

    Raises
    ------
    InputError
        It is no bag.
    MissingExtraError
        rosbags is not installed.
    """
    try:
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2
    except ImportError:
        raise MissingExtraError("reading bags", "rosbags", "bags") from None
    try:
        reader = Reader1(path) if path.suffix == ".bag" else Reader2(path)
        reader.open()
    except Exception as error:
        raise unreadable(path, error) from error
    return reader


def _close(readers: Mapping[Path, Reader1 | Reader2]) -> None:
    for reader in readers.values():
        reader.close()


def _joined(blocks: Sequence[Block]) -> Block:
    if len(blocks) == 1:
        return blocks[0]
    return Block(
        np.concatenate([block.role for block in blocks]),
        np.concatenate([block.stamp_ns for block in blocks]),
        np.concatenate([block.arrival_ns for block in blocks]),
        np.concatenate([block.value for block in blocks]),
    )


def _batch(messages: Iterator[tuple[Connection, int, bytes]], size: int, path: Path) -> list[tuple[Connection, int, bytes]]:
    """Return the next messages; whatever the library stumbles over is the bag's damage, said with its path."""
    try:
        return list(itertools.islice(messages, size))
    except Exception as error:
        raise unreadable(path, error) from error


def unreadable(path: Path, error: Exception) -> InputError:
    """What to raise where the library stumbles over a bag."""
    remedy = REMEDIES.get(path.suffix, "try: ros2 bag reindex")
    if path.is_file() and "metadata.yaml" in str(error):
        remedy = "name its directory: this version of rosbags reads no single file; or pip install --upgrade rosbags"
    return InputError(str(path), f"{type(error).__name__}: {error}", "a bag that can be read to its end", remedy)


def _types(one: Connection, path: Path, encoding: Encoding) -> Definitions:
    """Return the definition of a connection's type: of the bag where it has one, else the common one."""
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    text = one.msgdef if isinstance(one.msgdef, str) else one.msgdef.data
    separator = "=" * 80 + "\n"
    fields = dict(message_fields(get_typestore(Stores.ROS1_NOETIC if encoding is Encoding.ROS1 else Stores.LATEST)))
    try:
        if text.startswith(f"{separator}IDL: "):
            for part in text.split(separator)[1:]:
                fields.update(get_types_from_idl(part.partition("\n")[2]))
        elif text:
            fields.update(get_types_from_msg(text, one.msgtype))
        return definitions(fields, one.msgtype)
    except KeyError as error:
        raise InputError(
            f"{path}: {one.topic}",
            f"{one.msgtype} with {error}",
            "a message type with its definition",
            "the bag holds no definition of it: record as MCAP, which does",
        ) from None
    except Exception as error:
        raise InputError(
            f"{path}: {one.topic}", f"{type(error).__name__}: {error}", f"a definition of {one.msgtype} that can be read"
        ) from error


def _check_binding(binding: TopicBinding, one: Connection, types: Definitions, where: str) -> None:
    """Refuse a type, field or stamp that the topic in the bag does not have."""
    if binding.type != one.msgtype:
        raise InputError(f"{where}: type", binding.type, f"{one.msgtype}, as {one.topic} has in the bag")
    check_field(types, one.msgtype, binding.field, f"{where}: field")
    if binding.stamp == "header" and not stamp_path(types, one.msgtype):
        raise InputError(f"{where}: stamp", "header", f"log: {one.msgtype} has no stamp")
