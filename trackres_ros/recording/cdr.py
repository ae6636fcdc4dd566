# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Decodes one field of many serialised messages at once, and encodes many messages from one template.

Messages of a type with equal length mostly have their numbers at the same offsets: only the lengths
of strings and sequences move them. The first message is decoded field by field. All others with the same lengths are then
read by strided views on the joined bytes. Rows that differ are decoded one by one, so the result is that of a full
decoding, message by message.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from trackres_ros.errors import InputError
from trackres_ros.recording.bindings import FieldStep, other_names, too_few
from trackres_ros.recording.message_types import HEADER, NUMBERS, TIME, WIDE, Definitions, check_field, stamp_path
from trackres_ros.recording.samples import FloatArray, IntArray
from trackres_ros.units import SECOND_NS

LACKS_SHOWN = 3
MAX_LAYOUTS = 16
"""Number of layouts of one length tried on all rows; rows that fit none are then decoded one by one."""
WIDE_BYTES: tuple[int, ...] = (2, 4, 1)
"""Bytes of a wide text for each unit of its length. Fast DDS counts units of two bytes; before Jazzy they had four, as those of
Cyclone's layer for ROS have (Fast-CDR 2.0 and 1.1, Cdr::serialize(const wchar_t*); rmw_cyclonedds 3.2, Serialization.cpp).
Cyclone itself counts bytes, as DDS-XTypes 1.3, 7.4.3.5.3, has it."""
COMPARED_MESSAGES = 64
"""Messages from which the bytes of wide texts are found."""
REPRESENTATIONS = {
    2: "PL_CDR", 6: "XCDR2 (PLAIN_CDR2)", 8: "XCDR2 (DELIMITED_CDR2)", 10: "XCDR2 (PL_CDR2)",
}  # fmt: skip
"""Encapsulations that are not read, by their even number (DDS-XTypes 1.3, 7.6.3.1.2); odd ones are little-endian."""


class Encoding(IntEnum):
    """Bytes before the first field: 4 in a ROS 2 message (CDR), none in one of ROS 1."""

    ROS1 = 0
    CDR = 4


class MalformedError(ValueError):
    """A message is too short, too long, or broken inside."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Offsets of the numbers in all messages with given bytes at given offsets."""

    length: int  # length of the messages [bytes]
    # offset and content of bytes that must be equal: lengths, ends of strings, names that were looked up
    constants: tuple[tuple[int, bytes], ...]
    # offset and numpy type of each wanted number; None if the message has no such element
    spots: tuple[tuple[int, str] | None, ...]
    lacks: Mapping[int, str]  # by index of the wanted number: why the message has no such element

    def column(self, data: bytes, spot: tuple[int, str]) -> NDArray[np.generic]:
        """Return a number of every message of `data`, which are joined; a view, shape (n,)."""
        offset, kind = spot
        return np.ndarray((len(data) // self.length,), kind, data, offset, (self.length,))

    def match_rows(self, data: bytes, rows: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Return which of the messages `rows` of `data` have this layout, shape of `rows`."""
        matches = np.ones(len(rows), np.bool_)
        for offset, content in self.constants:
            start = 0
            while start < len(content):
                size = max(size for size in (1, 2, 4, 8) if size <= len(content) - start)
                kind = f"<u{size}"
                matches &= self.column(data, (offset + start, kind))[rows] == np.frombuffer(content, kind, 1, start)[0]
                start += size
        return matches


class _Walk:
    """A walk through one message by the definition of its type; wide texts have `wide_bytes` for each unit of their length."""

    def __init__(self, raw: bytes, types: Definitions, encoding: Encoding, wide_bytes: int) -> None:
        self.raw, self.types, self.cdr, self.wide_bytes = raw, types, encoding is Encoding.CDR, wide_bytes
        self.pos = 0
        self.constants: list[tuple[int, int]] = []
        self.spots: dict[int, tuple[int, str] | None] = {}
        self.lacks: dict[int, str] = {}
        self.order: Literal["<", ">"] = "<"
        if self.cdr:
            start = self.take(4)
            if raw[start : start + 2] not in (b"\0\0", b"\0\1"):
                raise MalformedError("encapsulation")
            self.constants.append((0, 2))
            self.order = "<" if raw[1] else ">"

    def take(self, size: int, alignment: int = 1) -> int:
        """Step over some bytes and return where they begin."""
        if self.cdr:
            self.pos += (4 - self.pos) % alignment
        start = self.pos
        self.pos += size
        if self.pos > len(self.raw):
            raise MalformedError("too short")
        return start

    def length(self) -> int:
        start = self.take(4, 4)
        self.constants.append((start, start + 4))
        length = int.from_bytes(self.raw[start : start + 4], "little" if self.order == "<" else "big")
        if length > len(self.raw):
            raise MalformedError("length")
        return length

    def string(self, keep: bool) -> bytes:
        length = self.length()
        start = self.take(length)
        end = start + length
        if self.cdr:
            end -= 1
            if end < start or self.raw[end] != 0:
                raise MalformedError("string")
            self.constants.append((end, end + 1))
        if keep:
            self.constants.append((start, end))
        return self.raw[start:end]

    def wide_string(self) -> None:
        """Step over units of UTF-16; none of them is zero, and one in four bytes has no other than the lower two."""
        size = self.length() * self.wide_bytes
        start, unit_bytes = self.take(size), max(self.wide_bytes, 2)
        if size % unit_bytes:
            raise MalformedError("wide string")
        units = np.frombuffer(self.raw, f"{self.order}u{unit_bytes}", size // unit_bytes, start)
        if not ((units > 0) & (units <= 0xFFFF)).all():
            raise MalformedError("wide string")

    def message(self, msgtype: str, targets: Sequence[tuple[int, Sequence[FieldStep]]]) -> None:
        by_name = [(slot, steps[0]) for slot, steps in targets if steps[0].element is not None]
        names: list[bytes] = []
        arrays: dict[str, tuple[int, int, str]] = {}
        if not self.cdr and msgtype == HEADER and self.types[msgtype][0].name != "seq":
            self.take(4)
        for field in self.types[msgtype]:
            if field.name == "structure_needs_at_least_one_member":
                self.take(int(self.cdr))
                continue
            count = self.length() if field.multiplicity == "sequence" else field.count
            field_targets = [(slot, steps) for slot, steps in targets if steps[0].name == field.name]
            if field.type in NUMBERS:
                kind = NUMBERS[field.type]
                start = self.take(count * int(kind[1]), int(kind[1])) if count else self.pos
                arrays[field.name] = (start, count, kind)
                for slot, steps in field_targets:
                    if steps[0].element is None:
                        self._spot(slot, arrays[field.name], steps[0].index or 0)
                        if self.spots[slot] is None:
                            self.lacks[slot] = too_few(field.name, count)
            elif field.type == "string":
                keep = bool(by_name) and field.name == "name"
                elements = [self.string(keep) for _ in range(count)]
                names = elements if keep else names
            elif field.type == WIDE:
                for _ in range(count):
                    self.wide_string()
            elif field.type in self.types:
                for slot, steps in field_targets:
                    if (steps[0].index or 0) >= count:
                        self.lacks[slot] = too_few(steps[0].name, count)
                for index in range(count):
                    begin = self.pos
                    self.message(
                        field.type, [(slot, steps[1:]) for slot, steps in field_targets if (steps[0].index or 0) == index]
                    )
                    if self.pos == begin:  # elements of zero bytes, in any number
                        break
            else:
                raise MalformedError(f"no rule for {field.type}")
        for slot, step in by_name:
            element = cast("str", step.element).encode()
            self._spot(slot, arrays[step.name], names.index(element) if element in names else -1)
            if self.spots[slot] is None:
                lack = too_few(step.name, arrays[step.name][1])
                self.lacks[slot] = lack if element in names else other_names([name.decode(errors="replace") for name in names])

    def _spot(self, slot: int, array: tuple[int, int, str], index: int) -> None:
        start, count, kind = array
        self.spots[slot] = (start + index * int(kind[1]), self.order + kind) if 0 <= index < count else None


def layout_of(
    raw: bytes,
    types: Definitions,
    msgtype: str,
    paths: Sequence[Sequence[FieldStep]],
    encoding: Encoding = Encoding.CDR,
    wide_bytes: Sequence[int] = WIDE_BYTES,
) -> Layout:
    """Decode one message to its end and return the offsets of the wanted numbers.

    `wide_bytes`: the sizes of wide texts to try, see `WIDE_BYTES`. Raises MalformedError if the bytes are no message of the type.
    """
    first_size, *other_sizes = wide_bytes
    try:
        return _layout(_Walk(raw, types, encoding, first_size), msgtype, paths)
    except MalformedError:
        if not (other_sizes and has_wide(types)):
            raise
    return layout_of(raw, types, msgtype, paths, encoding, other_sizes)


def has_wide(types: Definitions) -> bool:
    """Whether a message type has a wide text."""
    return any(field.type == WIDE for fields in types.values() for field in fields)


def _layout(walk: _Walk, msgtype: str, paths: Sequence[Sequence[FieldStep]]) -> Layout:
    raw = walk.raw
    walk.message(msgtype, list(enumerate(paths)))
    padding = 3 if walk.cdr else 0
    if len(raw) > walk.pos + padding:
        raise MalformedError("too long")
    constants: list[tuple[int, int]] = []
    for start, end in sorted(walk.constants):
        if constants and start <= constants[-1][1]:
            constants[-1] = (constants[-1][0], max(end, constants[-1][1]))
        elif end > start:
            constants.append((start, end))
    return Layout(
        len(raw),
        tuple((start, raw[start:end]) for start, end in constants),
        tuple(walk.spots.get(slot) for slot in range(len(paths))),
        walk.lacks,
    )


@dataclass(frozen=True, slots=True)
class Decoded:
    """Content of n messages."""

    stamp_ns: IntArray  # stamps [ns]; 0 if the type has none or the message is malformed, shape (n,)
    value: FloatArray  # the wanted numbers; NaN where absent or malformed, shape (n, k)
    is_absent: NDArray[np.bool_]  # the message has no such element, shape (n, k)
    is_malformed: NDArray[np.bool_]  # the bytes are no message of the type, shape (n,)


class FieldReader:
    """Reads some numbers, and the stamp, of messages of one type.

    `types`: the type and all nested types; `msgtype`: ``package/msg/Name``; `fields`: field paths; `encoding`: CDR or ROS 1;
    `where`: for messages to the user. Raises InputError for a field path that does not lead to a number, see `check_field`.
    """

    def __init__(
        self, types: Definitions, msgtype: str, fields: Sequence[str], encoding: Encoding = Encoding.CDR, where: str = "field"
    ) -> None:
        self.types, self.msgtype, self.encoding = types, msgtype, encoding
        self.paths = [check_field(types, msgtype, field, where) for field in fields]
        self.count = len(fields)
        stamp = stamp_path(types, msgtype)
        if stamp:
            seconds, fraction = (field.name for field in types[TIME])
            self.paths += [(*stamp, FieldStep(seconds)), (*stamp, FieldStep(fraction))]
        self.lacks: dict[
            int, list[str]
        ] = {}  # by index of the field: the first `LACKS_SHOWN` reasons why messages do not have it
        self.representation = ""  # that of messages which are not in CDR, see `REPRESENTATIONS`
        self._wide_bytes, self._is_wide_open = WIDE_BYTES, has_wide(types)
        self._layouts: dict[int, list[Layout]] = {}

    def decode(self, raws: Sequence[bytes]) -> Decoded:
        """Decode n messages."""
        n = len(raws)
        if self._is_wide_open:
            self._compare_wide(raws[:COMPARED_MESSAGES])
        output = Decoded(
            np.zeros(n, np.int64), np.full((n, self.count), np.nan), np.zeros((n, self.count), np.bool_), np.zeros(n, np.bool_)
        )
        lengths = np.fromiter(map(len, raws), np.int64, n)
        if n and (lengths == lengths[0]).all():
            self._decode_equal(b"".join(raws), int(lengths[0]), np.arange(n), output)
            return output
        order = np.argsort(lengths, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(lengths[order])) + 1) if n else ():
            self._decode_equal(b"".join([raws[row] for row in rows]), int(lengths[rows[0]]), rows, output)
        return output

    def _compare_wide(self, raws: Sequence[bytes]) -> None:
        """Try first the size of wide texts that decodes most messages; short texts may be readable by several."""
        counts = {size: sum(self._has_layout(raw, size) for raw in raws) for size in self._wide_bytes}
        self._wide_bytes = tuple(sorted(self._wide_bytes, key=lambda size: -counts[size]))
        best, second, *_ = sorted(counts.values(), reverse=True)
        self._is_wide_open = best == second

    def _has_layout(self, raw: bytes, wide_bytes: int) -> bool:
        with suppress(MalformedError):
            return bool(layout_of(raw, self.types, self.msgtype, self.paths, self.encoding, (wide_bytes,)).length)
        return False

    def _decode_equal(self, data: bytes, length: int, rows: NDArray[np.intp], output: Decoded) -> None:
        """Decode messages of one length, joined; `rows` are their places in `output`."""
        layouts = self._layouts.setdefault(length, [])
        attempts = 0
        remaining_rows = np.arange(len(rows))
        while remaining_rows.size:
            if attempts < len(layouts):
                layout = layouts[attempts]
                attempts += 1
            else:
                row = int(remaining_rows[0])
                raw = data[row * length : (row + 1) * length]
                try:
                    layout = layout_of(raw, self.types, self.msgtype, self.paths, self.encoding, self._wide_bytes)
                except MalformedError:
                    if self.encoding is Encoding.CDR and not self.representation:
                        self.representation = REPRESENTATIONS.get(int.from_bytes(raw[:2]) & ~1, "")
                    output.is_malformed[rows[row]] = True
                    remaining_rows = remaining_rows[1:]
                    continue
                if len(layouts) == MAX_LAYOUTS:
                    self._fill(layout, raw, remaining_rows[:1] - row, rows[remaining_rows[:1]], output)
                    remaining_rows = remaining_rows[1:]
                    continue
                layouts.append(layout)
                attempts += 1
            matches = layout.match_rows(data, remaining_rows)
            self._fill(layout, data, remaining_rows[matches], rows[remaining_rows[matches]], output)
            remaining_rows = remaining_rows[~matches]

    def _fill(self, layout: Layout, data: bytes, take: NDArray[np.intp], rows: NDArray[np.intp], output: Decoded) -> None:
        """Copy the numbers of messages `take` of `data` to the rows of `output`."""
        columns = [layout.column(data, spot)[take] if spot else None for spot in layout.spots]
        for slot, column in enumerate(columns[: self.count]):
            if column is None:
                output.is_absent[rows, slot] = True
                reasons, lack = self.lacks.setdefault(slot, []), layout.lacks.get(slot, "")
                if lack not in reasons and len(reasons) < LACKS_SHOWN:
                    reasons.append(lack)
            else:
                output.value[rows, slot] = column
        if len(columns) > self.count:
            seconds, fraction = columns[self.count :]
            if seconds is not None and fraction is not None:
                output.stamp_ns[rows] = seconds.astype(np.int64) * SECOND_NS + fraction.astype(np.int64)


class Template:
    """One serialised message, the template of many copies with other stamps and numbers.

    `raw`: the message in CDR, whose strings and sequences stay; `types`: its type and all nested types; `msgtype`:
    ``package/msg/Name``; `fields`: paths of the k numbers that change. Raises InputError for a path that does not lead to a
    number of the message.
    """

    def __init__(self, raw: bytes, types: Definitions, msgtype: str, fields: Sequence[str]) -> None:
        self.raw = raw
        self.reader = FieldReader(types, msgtype, fields, where=f"{msgtype}: field")
        self.layout = layout_of(raw, types, msgtype, self.reader.paths)
        for field, spot in zip(fields, self.layout.spots, strict=False):
            if spot is None:
                raise InputError(f"{msgtype}: field", field, "an element that the template message has")

    def fill(self, output: NDArray[np.uint8], start: int, stamp_ns: IntArray, values: FloatArray) -> None:
        """Write n messages into the rows of a matrix of bytes.

        `output`: written from column `start`; C order, shape (n, start + length of the message); `start`: column of the messages'
        first byte; `stamp_ns`: stamps [ns]; unused if the type has none, shape (n,); `values`: the numbers, shape (n, k).
        """
        output[:, start:] = np.frombuffer(self.raw, np.uint8)
        seconds, fraction = np.divmod(stamp_ns, SECOND_NS)
        for spot, column in zip(self.layout.spots, (*values.T, seconds, fraction), strict=False):
            if spot:
                offset, kind = spot
                np.ndarray((len(output),), kind, output, start + offset, output.strides[:1])[:] = column
