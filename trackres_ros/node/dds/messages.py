# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Messages in bytes: outputs prepared once and filled in place, inputs decoded."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from typing import Any

from trackres_ros.node.dds.participant import serialized
from trackres_ros.node.dds.wire import known_type, typestore
from trackres_ros.node.endpoints import InputTopic
from trackres_ros.node.transport import UNUSABLE, Reasons, Status, stamp_ns
from trackres_ros.output import bag
from trackres_ros.output.topics import ESTIMATE_TOPIC, OutputTopic
from trackres_ros.recording.bindings import FIX, NO_FIX
from trackres_ros.recording.cdr import FieldReader, MalformedError, Template, layout_of
from trackres_ros.recording.message_types import definitions, message_fields
from trackres_ros.units import SECOND_NS

CLOCK_BYTES = 12
CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "i8": "q", "u8": "Q", "f4": "f", "f8": "d"}
Fill = Callable[[int, Sequence[float], Reasons], bytes]
STRUCTS = {order + kind: struct.Struct(order + code) for order in "<>" for kind, code in CODES.items()}


class PreparedMessage:
    """A message of one output topic: only stamp and numbers are written into its bytes each time."""

    def __init__(self, topic: OutputTopic, message: object, numbers: Sequence[str]) -> None:
        types = definitions(message_fields(typestore()), topic.type)
        template = Template(serialized(message, topic.type), types, topic.type, numbers)
        self._bytes = bytearray(template.raw)
        places = [spot[0] for spot in template.layout.spots if spot]
        self._numbers, self._stamp = places[: len(numbers)], places[len(numbers) :]

    def filled(self, stamp: int, values: Sequence[float]) -> bytes:
        """The message with a stamp [ns] and its numbers."""
        if self._stamp:
            seconds, nanoseconds = divmod(stamp, SECOND_NS)
            struct.pack_into("<i", self._bytes, self._stamp[0], seconds)
            struct.pack_into("<I", self._bytes, self._stamp[1], nanoseconds)
        for offset, value in zip(self._numbers, values, strict=True):
            struct.pack_into("<d", self._bytes, offset, value)
        return bytes(self._bytes)


def prepared(topic: OutputTopic, frame_id: str) -> Fill:
    """A function that makes the message from a stamp [ns], the numbers of a topic and the reasons of an estimate."""
    if topic is ESTIMATE_TOPIC:
        return DdsEstimate(frame_id).filled
    message = PreparedMessage(topic, bag.template_message(topic, typestore(), frame_id), bag.number_fields(topic))
    return lambda stamp, values, _reasons: message.filled(stamp, values)


class DdsEstimate:
    """The message of `topics.ESTIMATE_TOPIC`, prepared again when the reasons change."""

    def __init__(self, frame_id: str) -> None:
        self._frame_id = frame_id
        self._reasons: Reasons | None = None

    def filled(self, stamp: int, values: Sequence[float], reasons: Reasons) -> bytes:
        """The message with a stamp [ns], its numbers and the present reasons."""
        if reasons != self._reasons:
            self._prepared, self._reasons = self._with(reasons), reasons
        return self._prepared.filled(stamp, values)

    def _with(self, reasons: Reasons) -> PreparedMessage:
        message = bag.estimate_message(typestore(), self._frame_id, reasons)
        return PreparedMessage(ESTIMATE_TOPIC, message, bag.number_fields(ESTIMATE_TOPIC))


def diagnostic_array(stamp: int, statuses: Sequence[Status], frame_id: str) -> bytes:
    """A DiagnosticArray."""
    listed = ((int(one.level), one.name, one.message, one.hardware_id, one.values) for one in statuses)
    return serialized(bag.diagnostic_array(typestore(), listed, frame_id, stamp), bag.DIAGNOSTICS)


class CdrInput:
    """Reads stamp and numbers of the messages of one input topic.

    Messages of a topic mostly have the same layout, so field positions are reused from message to message. Raises
    InputError for an unknown type, or a field path that does not lead to a number.
    """

    def __init__(self, given: InputTopic, origin: str) -> None:
        where = f"{origin}: {given.role_names}"
        self._type = known_type(given.type, where)
        self._scales = [(binding.scale, binding.offset) for binding in given.bindings]
        self._has_fix = bool(given.bindings[0].fix)
        fields = [*(binding.field for binding in given.bindings), *([FIX] if self._has_fix else [])]
        types = definitions(message_fields(typestore()), self._type)
        self._fields = FieldReader(types, self._type, fields, where=f"{where}: field")
        self._has_stamp = len(self._fields.paths) > len(fields)
        self._fixed: tuple[tuple[slice, bytes], ...] = ()
        self._length = -1
        self._places: list[tuple[int, struct.Struct] | str] = []

    def read(self, raw: bytes) -> tuple[int | None, list[float | str]]:
        """Stamp [ns], None where the type has none; and the scaled number of each binding, the reason where the message lacks
        it, nan of a receiver without a fix. Raises MalformedError if the bytes are no message of the type.
        """
        if len(raw) != self._length or any(raw[where] != content for where, content in self._fixed):
            self._learn(raw)
        numbers: list[Any] = [at if isinstance(at, str) else at[1].unpack_from(raw, at[0])[0] for at in self._places]
        stamp = None
        if self._has_stamp:
            nanoseconds, seconds = numbers.pop(), numbers.pop()
            stamp = stamp_ns(int(seconds), int(nanoseconds))
        if self._has_fix and numbers.pop() == NO_FIX:
            numbers = [math.nan] * len(numbers)
        return stamp, [
            number if isinstance(number, str) else scale * number + offset
            for number, (scale, offset) in zip(numbers, self._scales, strict=True)
        ]

    def _learn(self, raw: bytes) -> None:
        layout = layout_of(raw, self._fields.types, self._type, self._fields.paths)
        self._length = layout.length
        self._fixed = tuple((slice(start, start + len(content)), content) for start, content in layout.fixed)
        self._places = [
            (spot[0], STRUCTS[spot[1]]) if spot else layout.lacks.get(slot, "") for slot, spot in enumerate(layout.spots)
        ]


def clock_ns(raw: bytes) -> int:
    """Time [ns] in a rosgraph_msgs/msg/Clock. Raises MalformedError if the bytes are too few, or contain no valid time."""
    if len(raw) < CLOCK_BYTES:
        raise MalformedError("too short")
    seconds, nanoseconds = struct.unpack_from("<iI" if raw[1] else ">iI", raw, 4)
    stamp = stamp_ns(int(seconds), int(nanoseconds))
    if stamp == UNUSABLE:
        raise MalformedError("no time")
    return stamp
