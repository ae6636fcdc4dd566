# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads bags in blocks: rosbag2 and ROS 1 recordings."""

from __future__ import annotations

import itertools
import math
import re
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from trackres_ros.errors import InputError, nearest, one_line
from trackres_ros.recording.bag_files import READABLE, RosTopic, counts_of, is_ros1, messages, open_bag, remedy, unlisted_files
from trackres_ros.recording.bindings import NO_FIX, TopicBinding, Topics
from trackres_ros.recording.cdr import Encoding, FieldReader
from trackres_ros.recording.combining import Companions, PositionUnits, Signs, Sums, readings_of
from trackres_ros.recording.guess_values import faults_of_topics
from trackres_ros.recording.guessing import guess, torque_note, torque_topics
from trackres_ros.recording.mcap import SUFFIX as UNFINISHED
from trackres_ros.recording.message_types import (
    WIDE,
    Definitions,
    Field,
    check_field,
    definitions,
    installed_fields,
    message_fields,
    stamp_path,
    with_nested,
)
from trackres_ros.recording.opening import BagKind
from trackres_ros.recording.reading import read_in_steps, reading
from trackres_ros.recording.roles import likely_values, may_say_reverse
from trackres_ros.recording.samples import Finding, IntArray, SampleBlock, first_valid

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Typesdict

    from trackres_ros.recording.bag_files import Connection, Reader

SEPARATOR = "=" * 80 + "\n"
EMPTY = (Field("structure_needs_at_least_one_member", "uint8", "one", 1),)
"""Content of a message without fields on the wire."""
WIDE_FIELD = re.compile(rf"(?m)^[ \t]*{WIDE}<=\d+(?=[ \t\[])")
WIDE_CONSTANT = re.compile(rf"(?m)^[ \t]*{WIDE}(?:<=\d+)?(?=[ \t]+\w+[ \t]*=)")
"""Limits and constants of such texts, which rosbags does not read."""


def types_of_text(msgtype: str, text: str) -> Definitions:
    """Return the types in a bag's definition: its own, and after separators the nested ones.

    `msgtype`: ``package/msg/Name``; `text`: the definition. One of the interface definition language gives nothing: such types
    are the installed ones. Raises Exception from rosidl_adapter, for an invalid text.
    """
    from rosidl_adapter.parser import parse_message_string

    definitions_by_name: dict[str, tuple[Field, ...]] = {}
    if not text.strip() or text.startswith(f"{SEPARATOR}IDL: "):
        return definitions_by_name
    for place, part in enumerate(text.split(SEPARATOR)):
        name, body = msgtype, part
        if place:
            head, _, body = part.partition("\n")
            package, _, last = head.removeprefix("MSG: ").strip().partition("/")
            name = f"{package}/msg/{last.rpartition('/')[2]}"
        package, last = name.split("/")[0], name.rpartition("/")[2]
        definitions_by_name[name] = tuple(map(_of_field, parse_message_string(package, last, body).fields))
    return definitions_by_name


def with_installed(own: Definitions, msgtype: str) -> Definitions:
    """Return the fields of a message type and of all nested types, from installed packages where `own` lacks them.

    Raises KeyError if no package has a type.
    """
    return with_nested(msgtype, lambda name: (own[name] if name in own else installed_fields(name)) or EMPTY)


def _of_field(field: Any) -> Field:
    kind = field.type.type
    if not field.type.is_primitive_type():
        kind = f"{field.type.pkg_name}/msg/{kind}"
    multiplicity: Literal["one", "array", "sequence"] = "one"
    if field.type.is_array:
        multiplicity = "array" if field.type.array_size and not field.type.is_upper_bound else "sequence"
    return Field(field.name, kind, multiplicity, (field.type.array_size or 1) if multiplicity == "array" else 1)


@lru_cache
def _common(encoding: Encoding) -> Typesdict:
    """Return the definitions of the common types."""
    from rosbags.typesys import Stores, get_typestore

    return message_fields(get_typestore(Stores.ROS1_NOETIC if encoding is Encoding.ROS1 else Stores.LATEST))


@lru_cache
def _own_definitions(text: str, msgtype: str) -> Typesdict:
    """Return the definitions in a bag's text of a type."""
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    if not text.startswith(f"{SEPARATOR}IDL: "):
        return get_types_from_msg(WIDE_FIELD.sub(WIDE, WIDE_CONSTANT.sub("string", text)), msgtype) if text else {}
    own: Typesdict = {}
    for part in text.split(SEPARATOR)[1:]:
        own.update(get_types_from_idl(part.partition("\n")[2]))
    return own


def _finder(connection: Connection | RosTopic, encoding: Encoding) -> Callable[[], Definitions]:
    """Read the definition in the bag; return a function that adds missing ones, or raises KeyError."""
    if isinstance(connection, RosTopic):
        of_ros = types_of_text(connection.msgtype, connection.msgdef)
        return lambda: with_installed(of_ros, connection.msgtype)
    own = _own_definitions(
        connection.msgdef if isinstance(connection.msgdef, str) else connection.msgdef.data, connection.msgtype
    )

    def complete() -> Definitions:
        try:
            return definitions(own, connection.msgtype)
        except KeyError:  # the common types take a while to load
            return definitions({**_common(encoding), **own}, connection.msgtype)

    return complete


def types_of(connection: Connection | RosTopic, path: Path, encoding: Encoding) -> Definitions:
    """Return the definition of a connection's type: the bag's if present, else the common one."""
    where = f"{path}: {connection.topic}"
    try:
        with reading(Path(where), f"a readable definition of {connection.msgtype}"):
            find = _finder(connection, encoding)
        types = find()
    except KeyError as error:
        raise InputError(
            where,
            f"{connection.msgtype} with {error}",
            "a message type with its definition",
            "the bag does not define it: record as MCAP, which does",
        ) from None
    return types


NO_TYPE, SCHEMALESS = "no type", "__schemaless__"
"""The type of a topic without one: here, and in rosbags."""


def typed(connection: Connection, path: Path, topics_type: str, definition: Any) -> Connection:
    """A connection with the type of the topics file, where the bag has none or does not define it.

    `topics_type`: that type, or empty; `definition`: what a bag says of it, if anything.
    """
    is_known = connection.msgtype not in ("", SCHEMALESS)
    if is_known and topics_type not in ("", connection.msgtype):
        try:
            types_of(connection, path, Encoding.ROS1 if is_ros1(path) else Encoding.CDR)
        except InputError:
            is_known = False
    if is_known:
        return connection
    changes = {"msgtype": topics_type or NO_TYPE, "msgdef": definition}
    return replace(connection, **changes) if isinstance(connection, RosTopic) else connection._replace(**changes)


BATCH_ROWS, BATCH_BYTES = 2048, 32 * 2**20
"""Serialised messages held at once: few stay in the cache of the processor, and large ones do not fill the memory."""
MAX_LOG_NS = 2**62
"""Log times from 1970 to 2116 are accepted: differences of two of them fit in 64 bits [ns]."""
TOPICS_SHOWN = 50


@dataclass(frozen=True, slots=True)
class _Topic:
    """One topic to read: indices of the readings it feeds, their bindings, the source of each stamp, and the decoder."""

    name: str
    msgtype: str
    roles: tuple[int, ...]
    bindings: tuple[TopicBinding, ...]
    header: tuple[bool, ...]
    reader: FieldReader


TEXTS = {
    "malformed": "{count} messages cannot be decoded; each counts as a value that is not a number",
    "absent": "{count} messages do not have {field}: {lack}; they give no sample",
    "missing": "{count} messages fewer than the bag says it holds",
    "unusable": "{count} messages left out: they hold no bytes, or no log time between 1970 and 2116",
}
"""Events of the messages of a role, by kind."""
XCDR1 = "have their writer use XCDR1 (data representation XCDR_DATA_REPRESENTATION), as nodes of ROS 2 do, and record again"


@dataclass(slots=True)
class _Tally:
    """Events of one reading: count and first log time [ns] by kind and role index; the time is nan without a place."""

    begin_ns: int | None = None  # log time of the first valid speed, before it that of the first message
    has_speed: bool = False  # whether a speed was valid
    events: dict[str, dict[int, tuple[int, float]]] = field(default_factory=lambda: {kind: {} for kind in TEXTS})
    unknown_count: int = 0
    speeds: int = 0
    remarks: list[str] = field(default_factory=list)

    def add(self, kind: str, role: int, count: int, first_ns: float = math.nan) -> None:
        """Count events of a role; the first one met keeps its place."""
        if count > 0:
            previous_count, first_ns = self.events[kind].get(role, (0, first_ns))
            self.events[kind][role] = (previous_count + count, first_ns)


class BagSource:
    """Samples of one or several bags, one after another, each in log order.

    Reads rosbag2 directories (MCAP and sqlite3, compressed, split), single ``.mcap`` and ``.db3`` files, and ROS 1 bags. A
    message that cannot be decoded becomes a sample NaN at log time and a finding.

    `paths`: the bags; `topics`: topic of each role; by default guessed from the message types. Raises InputError for a file that
    is no bag, a missing topic or field, an unknown type, or no speed; MissingExtraError if rosbags is not installed.
    """

    zero_is_unset = True

    def __init__(self, paths: Sequence[Path], topics: Topics | None = None) -> None:
        self.name = one_line(", ".join(str(path) for path in paths))
        self._paths = tuple(paths)
        bags: list[tuple[Path, list[Connection]]] = []
        self._open_bags = {self._paths[0]: open_bag(self._paths[0])}
        weakref.finalize(self, _close, self._open_bags)
        for path in paths:
            reader = self._open_bags.get(path) or open_bag(path)
            bags.append((path, list(reader.connections)))
            if path not in self._open_bags:
                reader.close()
        topic_notes = topics.unused_notes(of_topics=True) if topics else []
        topics = self.topics = topics and topics.select(of_topics=True)
        bags, type_notes = _with_types(bags, topics)
        topic_notes += type_notes
        self.torque_candidates = tuple(
            torque_topics({item.topic: item.msgtype for _, connections in bags for item in connections})
        )
        if not (topics and topics.bindings):
            filled_topics = {item.topic: item.msgtype for _, connections in bags for item in connections if item.msgcount}
            topics, guesses = self._guess(filled_topics)
            topic_notes += guesses
        bindings = self.bindings = topics.bindings
        if "speed" not in bindings:
            raise InputError(f"{topics.origin}: speed", "no topic", "a topic for speed", "add a line for it")
        self.roles = tuple(sorted(bindings, key=lambda role: role == "speed"))
        self._readings = readings_of(self.roles, bindings)
        self._of_speed = np.array([item.role == "speed" and not item.is_valid for item in self._readings])
        read = {item.binding.topic for item in self._readings}
        kinds = {item.topic: item.msgtype for _, connections in bags for item in connections}
        self._may_say_reverse = {} if "direction" in bindings else {t: kinds[t] for t in may_say_reverse(kinds) if t not in read}
        self._origin = topics.origin
        self._topics = self._bind_topics(bags)
        self._position = PositionUnits(bindings)
        candidates = torque_note(self.torque_candidates, self.roles)
        sum_notes = (*Sums(self._readings, bindings).notes, *Companions(self._readings, bindings).notes)
        self._notes = tuple(map(one_line, (*topic_notes, *self._stamp_notes(), *sum_notes, *candidates)))
        self.findings: tuple[Finding, ...] = ()

    def _guess(self, filled_topics: Mapping[str, str]) -> tuple[Topics, list[str]]:
        """The guesses that their values allow, and notes."""
        refused: dict[tuple[str, str], str] = {}
        while True:
            topics, notes = guess(filled_topics, refused)
            faults = faults_of_topics(BagSource(self._paths, topics))
            if not faults:
                return topics, notes
            refused |= faults

    def _bind_topics(self, bags: Sequence[tuple[Path, list[Connection]]]) -> dict[tuple[Path, str], _Topic]:
        """Return the readings, by path and topic; those of one topic are decoded together."""
        present_topics = {
            connection.topic: connection.msgtype for _, connections_of_bag in bags for connection in connections_of_bag
        }
        by_topic: dict[str, list[int]] = {}
        for index, reading_ in enumerate(self._readings):
            topic_name = reading_.binding.topic
            name = topic_name if topic_name in present_topics or topic_name.startswith("/") else f"/{topic_name}"
            if name not in present_topics:
                topic_list = "; ".join(f"{topic} ({kind})" for topic, kind in sorted(present_topics.items())[:TOPICS_SHOWN])
                where = f"{self._origin}: {reading_.name}: topic"
                raise InputError(where, topic_name, f"a topic of {self.name}: {topic_list}", nearest(topic_name, present_topics))
            by_topic.setdefault(name, []).append(index)
        bound: dict[tuple[Path, str], _Topic] = {}
        readers: dict[tuple[str, str, str, Encoding], FieldReader] = {}
        for path, connections in bags:
            for connection in connections:
                indices = by_topic.get(connection.topic, [])
                if not indices:
                    continue
                if (path, connection.topic) in bound:
                    if connection.msgtype != bound[path, connection.topic].msgtype:
                        kinds = f"{connection.topic} as {bound[path, connection.topic].msgtype} and as {connection.msgtype}"
                        raise InputError(str(path), kinds, "one type on a topic that is read")
                    continue
                encoding = Encoding.ROS1 if is_ros1(path) else Encoding.CDR
                key = (connection.topic, connection.msgtype, str(connection.msgdef), encoding)
                types = readers[key].types if key in readers else types_of(connection, path, encoding)
                topic_bindings = tuple(self._readings[index].binding for index in indices)
                for index, binding in zip(indices, topic_bindings, strict=True):
                    _check_binding(binding, connection, types, f"{self._origin}: {self._readings[index].name}")
                if key not in readers:
                    fields = [*(binding.field for binding in topic_bindings), *filter(None, [topic_bindings[0].fix])]
                    readers[key] = FieldReader(types, connection.msgtype, fields, encoding)
                has_stamp = bool(stamp_path(types, connection.msgtype))
                bound[path, connection.topic] = _Topic(
                    connection.topic,
                    connection.msgtype,
                    tuple(indices),
                    topic_bindings,
                    tuple(has_stamp and binding.stamp != "log" for binding in topic_bindings),
                    readers[key],
                )
        return bound

    def _stamp_notes(self) -> Iterator[str]:
        noted_topics = set()
        for topic in self._topics.values():
            for role, binding, header in zip(topic.roles, topic.bindings, topic.header, strict=True):
                if role not in noted_topics:
                    noted_topics.add(role)
                    reason = "as the topics file says" if binding.stamp else f"{topic.msgtype} has no stamp"
                    stamps = "header stamps" if header else f"log time, {reason}"
                    yield f"{self._readings[role].name}: {topic.name} ({topic.msgtype}, {binding.field}), {stamps}"

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on guesses and unused lines, the stamps in use, and, after reading, the assumed unit of a position."""
        return (*self._notes, *self._position.notes)

    def blocks(self, max_rows: int = 65536) -> Iterator[SampleBlock]:
        """Read all bags; see `trackres_ros.recording.samples.Source.blocks`.

        Raises InputError for a bag that breaks off or is damaged.
        """
        tally, sums = _Tally(), Sums(self._readings, self.bindings)
        companions, signs = Companions(self._readings, self.bindings), Signs(self.roles)
        pending_blocks: list[SampleBlock] = []

        def finished(blocks: Sequence[SampleBlock]) -> SampleBlock:
            block = sums.add_totals(companions.keep_valid(_join_blocks(blocks)))
            return self._position.in_radians(signs.seen(companions.with_signs(block, self.roles)), self.roles)

        for path in self._paths:
            for block in read_in_steps(path, READABLE, self._batches(path, max_rows, tally), remedy(path)):
                if sum(map(len, pending_blocks)) + len(block) > max_rows:
                    yield finished(pending_blocks)
                    pending_blocks.clear()
                pending_blocks.append(block)
        if pending_blocks:
            yield finished(pending_blocks)
        lines = (
            f"direction: {{topic: {topic}, type: {kind}, field: data, values: {likely_values(topic)}}}"
            for topic, kind in self._may_say_reverse.items()
        )
        unsigned = signs.findings(list(self._may_say_reverse), lines)
        self.findings = (*self._tally_findings(tally), *sums.findings, *companions.findings, *unsigned)
        speed = len(self._readings) - 1
        if not tally.speeds and speed in tally.events["absent"]:
            where, given = f"{self._origin}: speed: field", f"{self._field(speed)}, {self._lack(speed)}"
            raise InputError(where, given, f"an element that the messages of {self.name} have")
        representation = self._representation(speed)
        if representation and tally.events["malformed"][speed][0] == tally.speeds:
            given = f"{tally.speeds} messages in the representation {representation}"
            raise InputError(f"{self.name}: speed", given, "messages in CDR (XCDR1)", XCDR1)

    def _field(self, role: int) -> str:
        return next(topic.bindings[topic.roles.index(role)].field for topic in self._topics.values() if role in topic.roles)

    def _representation(self, role: int) -> str:
        """The representation of messages for a role that are not in CDR; empty without any."""
        return next((topic.reader.representation for topic in self._topics.values() if role in topic.roles), "")

    def _lack(self, role: int) -> str:
        """Why messages have no element for a role."""
        readers = [(topic.reader, topic.roles.index(role)) for topic in self._topics.values() if role in topic.roles]
        return ", or ".join(dict.fromkeys(lack for reader, slot in readers for lack in reader.lacks.get(slot, ()) if lack))

    def _batches(self, path: Path, max_rows: int, tally: _Tally) -> Iterator[SampleBlock]:
        """Read one bag in the small batches that are decoded together."""
        with closing(self._open_bags.pop(path) if path in self._open_bags else open_bag(path)) as reader:
            counts = counts_of(reader, path)
            tally.unknown_count += counts.unknown_count
            tally.remarks += [*counts.remarks, *unlisted_files(reader, path, self._paths)]
            connections = [connection for connection in reader.connections if (path, connection.topic) in self._topics]
            if not connections:
                return
            topics = list({connection.topic: self._topics[path, connection.topic] for connection in connections}.values())
            index = {topic.name: number for number, topic in enumerate(topics)}
            lost_counts = np.array([counts.by_topic[topic.name] for topic in topics], np.int64)
            batches = messages(reader, connections)
            max_batch = min(BATCH_ROWS, max(1, max_rows // max(len(topic.roles) for topic in topics)))
            size = min(64, max_batch)
            while batch := list(itertools.islice(batches, size)):
                # A damaged index leads to messages of a connection that was not requested: those stay missing.
                topic_numbers = np.array([index.get(connection[0].topic, -1) for connection in batch], np.intp)
                if topic_numbers.min() < 0:
                    batch = list(itertools.compress(batch, (topic_numbers >= 0).tolist()))
                    topic_numbers = topic_numbers[topic_numbers >= 0]
                    if not batch:
                        continue
                stamps, raws = [connection[1] for connection in batch], [connection[2] for connection in batch]
                lost_counts -= np.bincount(topic_numbers, minlength=len(topics))
                times = _times(stamps)
                if times is None or set(map(type, raws)) != {bytes}:
                    is_good = np.array([_times([stamp]) is not None and type(raw) is bytes for _, stamp, raw in batch])
                    for number in topic_numbers[~is_good].tolist():
                        tally.add("unusable", topics[number].roles[0], 1)
                    topic_numbers, raws = topic_numbers[is_good], list(itertools.compress(raws, is_good.tolist()))
                    times = np.array(list(itertools.compress(stamps, is_good.tolist())), np.int64)
                if len(raws):
                    yield self._block(topics, topic_numbers, times, raws, tally)
                size = min(max_batch, 1 + BATCH_BYTES * len(raws) // max(1, sum(map(len, raws))))
            for topic, count in zip(topics, lost_counts.tolist(), strict=True):
                tally.add("missing", topic.roles[0], count)

    def _block(
        self,
        topics: Sequence[_Topic],
        topic_numbers: NDArray[np.intp],
        arrival_ns: IntArray,
        raws: Sequence[bytes],
        tally: _Tally,
    ) -> SampleBlock:
        """Decode a batch of messages; those of topic `topics[which]`."""
        if tally.begin_ns is None:
            tally.begin_ns = int(arrival_ns[0])
        rows_each = np.array([len(topic.roles) for topic in topics])[topic_numbers]
        start = np.cumsum(rows_each) - rows_each
        rows = int(rows_each.sum())
        block = SampleBlock(np.empty(rows, np.int16), np.empty(rows, np.int64), np.empty(rows, np.int64), np.empty(rows))
        keep = np.ones(rows, np.bool_)
        for number, topic in enumerate(topics):
            topic_rows = topic_numbers == number
            decoded_fields = topic.reader.decode(list(itertools.compress(raws, topic_rows.tolist())))
            if topic.bindings[0].fix:
                decoded_fields.value[decoded_fields.value[:, -1] == NO_FIX] = np.nan
            topic_arrival_ns = arrival_ns[topic_rows]
            for slot, (role, binding, header) in enumerate(zip(topic.roles, topic.bindings, topic.header, strict=True)):
                targets = start[topic_rows] + slot
                block.role[targets] = role
                block.arrival_ns[targets] = topic_arrival_ns
                stamps = (
                    np.where(decoded_fields.is_malformed, topic_arrival_ns, decoded_fields.stamp_ns)
                    if header
                    else topic_arrival_ns
                )
                if binding.delay_ns:  # 0 stays, as it means never set, and no other stamp becomes it
                    at_ns = stamps - binding.delay_ns
                    stamps = np.where(stamps == 0, 0, np.where(at_ns == 0, 1, at_ns))
                block.stamp_ns[targets] = stamps
                block.value[targets] = binding.directions(binding.scale * decoded_fields.value[:, slot] + binding.offset)
                keep[targets] = ~decoded_fields.is_absent[:, slot]
                for kind, rows_of in (("malformed", decoded_fields.is_malformed), ("absent", decoded_fields.is_absent[:, slot])):
                    if rows_of.any():
                        tally.add(kind, role, int(rows_of.sum()), int(topic_arrival_ns[rows_of][0]))
        tally.speeds += int(np.count_nonzero(keep & (block.role == len(self._readings) - 1)))
        if not tally.has_speed and (first_speed := first_valid(block, self._of_speed[block.role], self.zero_is_unset)):
            tally.begin_ns, tally.has_speed = first_speed[1], True
        if keep.all():
            return block
        return SampleBlock(block.role[keep], block.stamp_ns[keep], block.arrival_ns[keep], block.value[keep])

    def _tally_findings(self, tally: _Tally) -> Iterator[Finding]:
        for kind, text in TEXTS.items():
            for role, (count, first_ns) in tally.events[kind].items():
                shown_text = text.format(count=count, field=self._field(role), lack=self._lack(role))
                if kind == "malformed" and (representation := self._representation(role)):
                    shown_text += f"; some are in the representation {representation}: {XCDR1}"
                yield Finding(self._readings[role].role, kind, count, (first_ns - (tally.begin_ns or 0)) / 1e9, shown_text)
        if tally.unknown_count:
            text = f"{tally.unknown_count} messages of topics that the bag does not describe are left out"
            yield Finding("", "unknown_topic", tally.unknown_count, float("nan"), text)
        for remark in dict.fromkeys(tally.remarks):
            yield Finding("", "structure", 1, float("nan"), remark)


def _with_types(
    bags: Sequence[tuple[Path, list[Connection]]], topics: Topics | None
) -> tuple[list[tuple[Path, list[Connection]]], list[str]]:
    """Topics of bags with the types of the topics file where the bags lack them, and notes of these."""
    bindings = [reading_.binding for reading_ in readings_of(tuple(topics.bindings), topics.bindings)] if topics else []
    type_of = {name: binding.type for binding in bindings for name in (binding.topic, f"/{binding.topic}")}
    definition_of = {item.msgtype: item.msgdef for _, connections in bags for item in connections}
    typed_bags: list[tuple[Path, list[Connection]]] = []
    notes: dict[str, None] = {}
    for path, connections in bags:
        typed_connections: list[Connection] = []
        typed_bags.append((path, typed_connections))
        for item in connections:
            topics_type = type_of.get(item.topic, "")
            connection = typed(item, path, topics_type, definition_of.get(topics_type, ""))
            typed_connections.append(connection)
            if connection.msgtype not in (item.msgtype, NO_TYPE):
                lack = "names no type" if item.msgtype in ("", SCHEMALESS) else f"does not define {item.msgtype}"
                notes[f"{item.topic}: {topics_type}, as the topics file says; the bag {lack}"] = None
    return typed_bags, list(notes)


def _times(stamps: Sequence[object]) -> IntArray | None:
    """Log times if they are valid, which a database does not enforce; else None."""
    times = np.array(stamps)
    return times if times.dtype == np.int64 and times.min() >= 0 and times.max() < MAX_LOG_NS else None


def _close(readers: Mapping[Path, Reader]) -> None:
    for reader in readers.values():
        reader.close()


def _join_blocks(blocks: Sequence[SampleBlock]) -> SampleBlock:
    if len(blocks) == 1:
        return blocks[0]
    return SampleBlock(*(np.concatenate([getattr(block, item.name) for block in blocks]) for item in fields(SampleBlock)))


def _check_binding(binding: TopicBinding, connection: Connection, types: Definitions, where: str) -> None:
    """Refuse a type, field or stamp that the topic in the bag does not have."""
    if binding.type != connection.msgtype:
        raise InputError(f"{where}: type", binding.type, f"{connection.msgtype}, as {connection.topic} has in the bag")
    check_field(types, connection.msgtype, binding.field, f"{where}: field")
    if binding.stamp == "header" and not stamp_path(types, connection.msgtype):
        raise InputError(f"{where}: stamp", "header", f"log: {connection.msgtype} has no stamp")


KINDS = (BagKind((".mcap", ".db3", ".bag", UNFINISHED), BagSource),)
