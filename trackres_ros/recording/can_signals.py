# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Decodes the signals of CAN frames, as databases of the buses describe them; joins the packets of J1939."""

import copy
import itertools
import logging
import re
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from math import inf, nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trackres_ros.errors import InputError
from trackres_ros.recording.bindings import DBC, Topics
from trackres_ros.recording.channel_file import CHUNK_ROWS, Channel, ChannelFile, ChannelRows, ChosenChannel
from trackres_ros.recording.reading import check_there, reading
from trackres_ros.recording.samples import Finding
from trackres_ros.text import some_of

CONNECTION, PACKET = 0xEC, 0xEB
"""PDU formats of TP.CM, which announces a message, and of TP.DT, which carries it."""
REQUEST_TO_SEND, ACKNOWLEDGED, BROADCAST, ABORT = 16, 19, 32, 255
"""Control bytes of TP.CM that are read; the receiver's CTS (17) is not needed."""
SMALLEST, LARGEST = 9, 1785
"""Bytes of a message: one more than a frame holds, 255 packets."""
OF_A_PACKET = 7
LONGEST_PAUSE_NS = 1_250_000_000
"""T2 and T3 of the standard: time after which a receiver gives up."""
EVERYONE = 255
"""Receiver of a broadcast."""


class Frame(NamedTuple):
    """A data frame, or a joined message: stamp [ns], identifier, whether it has 29 bits, number of the bus, and bytes."""

    stamp_ns: int
    id: int
    is_extended: bool
    bus: int | None
    data: bytes


@dataclass(slots=True)
class _Transfer:
    """A message under way: its group, its content, the packets that are missing, and the stamp of the newest one."""

    group: int
    content: bytearray
    missing_parts: set[int]
    newest_ns: int


def is_transport(frame: Frame) -> bool:
    """Whether a frame belongs to the protocol."""
    return frame.is_extended and frame.id >> 16 & 0x3FF in (CONNECTION, PACKET)


def with_joined(frames: Iterator[Frame], event_counts: Counter[str]) -> Iterator[Frame]:
    """Yield all frames, and each joined message after its last packet, with the stamp of that packet.

    A sender has at most one broadcast in progress, and one transfer to each receiver. Packets may be repeated or reordered, as a
    receiver requests them again; nobody requests those of a broadcast that is complete.

    `frames`: in the order of the log; `event_counts`: counts losses: `incomplete` messages, and `stray` packets of messages that
    were not announced.
    """
    transfers: dict[tuple[int | None, int, int], _Transfer] = {}

    def end(key: tuple[int | None, int, int]) -> None:
        transfer = transfers.pop(key, None)
        event_counts["incomplete"] += bool(transfer and transfer.missing_parts)

    for frame in frames:
        yield frame
        if not is_transport(frame):
            continue
        sender, receiver = frame.id & 0xFF, frame.id >> 8 & 0xFF
        key = (frame.bus, sender, receiver)
        if frame.id >> 16 & 0xFF == CONNECTION:
            control = frame.data[0] if frame.data else None
            if control in (REQUEST_TO_SEND, BROADCAST):
                end(key)
                new_transfer = _read_announcement(frame)
                if new_transfer is None:
                    event_counts["incomplete"] += 1
                    continue
                transfers[key] = new_transfer
            elif control == ACKNOWLEDGED:  # by the receiver
                end((frame.bus, receiver, sender))
            elif control == ABORT:  # by the sender, or by the receiver
                end(key)
                end((frame.bus, receiver, sender))
            continue
        transfer = transfers.get(key)
        if transfer and frame.stamp_ns - transfer.newest_ns > LONGEST_PAUSE_NS:
            end(key)
            transfer = None
        if transfer is None or not _take(frame, transfer):
            event_counts["stray"] += 1
        elif not transfer.missing_parts and transfer.content:
            yield Frame(frame.stamp_ns, _identifier(frame.id, transfer.group), True, frame.bus, bytes(transfer.content))
            transfer.content.clear()
            if receiver == EVERYONE:
                end(key)  # others are kept, for packets that the receiver requests again
    for key in list(transfers):
        end(key)


def _read_announcement(frame: Frame) -> _Transfer | None:
    """The transfer that TP.CM begins; None if it is inconsistent."""
    size, packets = int.from_bytes(frame.data[1:3], "little"), frame.data[3] if len(frame.data) == 8 else 0
    if not SMALLEST <= size <= LARGEST or packets != -(-size // OF_A_PACKET):
        return None
    group = int.from_bytes(frame.data[5:8], "little") & 0x3FFFF
    return _Transfer(group, bytearray(size), set(range(1, packets + 1)), frame.stamp_ns)


def _take(frame: Frame, transfer: _Transfer) -> bool:
    """Store a packet; return whether it belongs to the transfer."""
    number = frame.data[0] if frame.data else 0
    transfer.newest_ns = frame.stamp_ns
    if not transfer.content:
        return True  # a repetition, in a complete message
    start = (number - 1) * OF_A_PACKET
    packet = frame.data[1 : 1 + min(OF_A_PACKET, len(transfer.content) - start)]
    if number == 0 or start >= len(transfer.content) or len(packet) < min(OF_A_PACKET, len(transfer.content) - start):
        return False
    transfer.content[start : start + len(packet)] = packet
    transfer.missing_parts.discard(number)
    return True


def _identifier(packet: int, group: int) -> int:
    """The identifier of the message: priority and sender of its packets and, if the group has one, their receiver."""
    with_receiver = group >> 8 & 0xFF < 240  # PDU1
    return packet & 0x1C0000FF | group << 8 | (packet & 0xFF00 if with_receiver else 0)


NOT_AVAILABLE = re.compile(
    r"(?<!\bno[ -])(?<!\bkein )\b(sna|snv|n[/.]?a|(not|nicht) ?(available|avail|valid|defined|verf(ü|ue)gbar|definiert)|"
    r"unavailable|(no|kein) ?(data|value|signal|wert)|invalid|ung(ü|ue)ltig|err(or)?|fehler|fault|fail(ed|ure)|defective|"
    r"init|undefined|unknown|unbekannt|reserved|missing|out of range|timeout)\b(?![ -]free\b)",
    re.IGNORECASE,
)
"""In the name of a value, of a database or of an MDF file: the signal is not available. "No error" is a value."""
NEW_WORD = re.compile(r"_|(?<=[a-z])(?=[A-Z])")
"""Where a word of such a name ends."""
ROUNDED = 1e-6
"""Share of a limit by which it may be rounded, of a number in floating point; of others it is half of a step."""
NAMES_SHOWN = 5
J1939_LAST_VALID = 0xFA
"""SAE J1939-71: a signal of 8 bits or more with a first byte above it is in error, not available, or a special code."""
J1939_ANY_SOURCE = (0xFE, 0xFF)
"""Source addresses of a database that name no control unit: null and global, SAE J1939-81."""
PDU2 = 240
"""SAE J1939-21: from this PDU format on, the second byte of the identifier belongs to the number of the group."""


@dataclass(slots=True)
class _Signal:
    """A signal to read: its column, its conversion to a physical value, and its raw values for not available."""

    column: int
    name: str
    scale: float
    offset: float
    missing_values: frozenset[int]
    named_values: frozenset[int]  # which its limits do not refuse
    last_valid: float
    limits: tuple[float, float]  # physical, with what they are rounded by
    outside: int = 0  # values outside of the limits
    outside_value: float = 0.0  # the first one


@dataclass(slots=True)
class _Message:
    """A message of a database, the number of its bus, and its group number for J1939."""

    message: Any
    bus: int | None
    group: str
    pgn: int | None
    file: Path
    plain_message: Any
    wanted_signals: list[_Signal] = field(default_factory=list)
    sender: tuple[int | None, int | None] | None = None  # bus, and control unit of J1939, whose frames are read: the first ones
    other_buses: Counter[int | None] = field(default_factory=Counter)  # frames of other buses, by bus
    short_frames: int = 0  # frames that end before a signal
    cut_signals: dict[str, None] = field(default_factory=dict)  # the names of these, in order

    @property
    def frames(self) -> tuple[object, ...]:
        """What its frames have in common; two messages with the same share them."""
        source = self.message.frame_id & 0xFF
        if self.pgn is None:
            return self.bus, self.message.is_extended_frame, self.message.frame_id
        return self.bus, self.pgn, None if source in J1939_ANY_SOURCE else source


class CanSignals(ChannelFile):
    """The signals of a log of frames.

    Messages are found by identifier. Those of J1939 are found by their group number, whatever the priority, and by the control
    unit in the database's identifier. Without one, the first sender of the group is read. Of a database without the number of a
    bus, a message is read from the first bus that sends it. Groups of more than 8 bytes are joined from the packets of the
    transport protocol.

    `name`: of the log, for messages; `frames`: reads the log from the beginning, and counts its faults, by the keys of `TEXTS`;
    `topics`: the topics file, which names the databases. Raises InputError for no database, or one that cannot be read.
    """

    uses = (DBC,)

    def __init__(self, name: str, frames: Callable[[Counter[str]], Iterator[Frame]], topics: Topics | None) -> None:
        self.name, self._frames = name, frames
        files = topics.dbc if topics else ()
        if not files:
            remedy = "give it: dbc: bus.dbc in the topics file, or --dbc bus.dbc"
            raise InputError(
                name, "a log of CAN frames without a database", "the database of the bus, such as a .dbc file", remedy
            )
        self._messages = [entry for bus, file in files for entry in _messages_of(bus, file)]
        _tell_apart(self._messages)
        signals = [(entry, signal) for entry in self._messages for signal in entry.message.signals]
        first = {(entry.group, signal.name): (entry, signal) for entry, signal in reversed(signals)}
        self._signals = [first[key] for key in reversed(first)]  # of one message in two databases the first
        self.channels = [
            Channel(signal.name, signal.unit or "", entry.group, _named_values(signal)) for entry, signal in self._signals
        ]

    def settle(self, time: ChosenChannel | None, channels: Sequence[ChosenChannel]) -> None:
        """Choose the signals to decode."""
        super().settle(time, channels)
        for entry in self._messages:
            entry.wanted_signals = []
        for column, channel in enumerate(channels):
            message, signal = self._signals[channel.place]
            message.wanted_signals.append(_signal(column, signal, message.pgn is not None))

    def streams(self) -> Sequence[Iterator[ChannelRows]]:
        """All frames in the order of the log."""
        return [self._rows()]

    def _rows(self) -> Iterator[ChannelRows]:
        event_counts: Counter[str] = Counter()
        for entry in self._messages:
            entry.sender = None
            entry.other_buses.clear()
            entry.short_frames = 0
            entry.cut_signals.clear()
            for signal in entry.wanted_signals:
                signal.outside = 0
        message_by_key: dict[tuple[int, bool, int | None], _Message | None] = {}
        rows = self._values(message_by_key, event_counts)
        while chunk := list(itertools.islice(rows, CHUNK_ROWS)):
            cells = np.full((len(chunk), len(self.wanted)), np.nan)
            for row, (_, values) in enumerate(chunk):
                for column, value in values:
                    cells[row, column] = value
            stamps = np.array([stamp_ns for stamp_ns, _ in chunk], np.int64)
            yield ChannelRows(stamps, np.ones(len(chunk), np.bool_), cells, ~np.isnan(cells))
        roles = [channel.role for channel in self.wanted]
        of_signals = itertools.chain.from_iterable(_of_signals(entry, roles) for entry in self._messages)
        self.findings = (*_findings_of(event_counts), *of_signals, *_of_buses(self._messages), *_of_rivals(self._messages))

    def _values(
        self, message_by_key: dict[tuple[int, bool, int | None], _Message | None], event_counts: Counter[str]
    ) -> Iterator[tuple[int, list[tuple[int, float]]]]:
        """Stamp of each frame that is read, with its columns and values."""
        frames = self._frames(event_counts)
        j1939 = any(entry.pgn is not None for entry in self._messages)
        for frame in with_joined(frames, event_counts) if j1939 else frames:
            stamp_ns, number, is_extended, bus, data = frame
            key = (number, is_extended, bus)
            if key not in message_by_key:
                message_by_key[key] = self._message(number, is_extended, bus)
            entry = message_by_key[key]
            if entry is None:
                event_counts["unknown"] += not (j1939 and is_transport(frame))
                continue
            sender = (bus, None if entry.pgn is None else number & 0xFF)
            entry.sender = entry.sender or sender
            if not entry.wanted_signals:
                continue
            if entry.sender[0] != bus:
                entry.other_buses[bus] += 1
                continue
            if entry.sender != sender:
                event_counts["other_source"] += 1
                continue
            raw_values = _raw(entry, data, event_counts)
            if raw_values is None:
                continue
            if len(data) < entry.message.length:
                _note_short(entry, raw_values)
            values = list(_values_of(entry, raw_values, event_counts))
            if values:
                yield stamp_ns, values

    def _message(self, number: int, is_extended: bool, bus: int | None) -> _Message | None:
        """The message of an identifier: an exact match, else that of its J1939 group."""
        similar_entry = None
        for entry in self._messages:
            if (entry.bus is not None and entry.bus != bus) or entry.message.is_extended_frame != is_extended:
                continue
            if entry.message.frame_id == number:
                return entry
            source = entry.message.frame_id & 0xFF
            if entry.pgn is not None and entry.pgn == _pgn(number) and source in (*J1939_ANY_SOURCE, number & 0xFF):
                similar_entry = similar_entry or entry
        return similar_entry


def _messages_of(bus: int | None, file: Path) -> list[_Message]:
    """The messages that a database describes."""
    from cantools.database import load_file

    logging.getLogger("cantools").setLevel(logging.ERROR)  # messages of one name are told apart
    check_there(file)
    with reading(file, "a database of a CAN bus, such as a .dbc file"), warnings.catch_warnings(action="ignore"):
        database: Any = load_file(file, strict=False)
        messages = database.messages
        attributes = getattr(database.dbc, "attributes", {}) or {}
        kind = attributes.get("ProtocolType")
        all_j1939 = kind is not None and "j1939" in str(kind.value).lower()
        suffix = "" if bus is None else f"@{bus}"
        return [
            _Message(
                message,
                bus,
                f"{message.name}{suffix}",
                _pgn(message.frame_id) if message.is_extended_frame and (all_j1939 or message.protocol == "j1939") else None,
                file,
                _drop_multiplexing(message),
            )
            for message in messages
        ]


def _tell_apart(messages: Sequence[_Message]) -> None:
    """Give messages of one name and bus their identifiers as names."""
    identifiers: dict[str, set[str]] = {}
    for entry in messages:
        identifiers.setdefault(entry.group, set()).add(_identifier_text(entry.message))
    for entry in messages:
        if len(identifiers[entry.group]) > 1:
            name = entry.message.name
            entry.group = entry.group.replace(name, f"{name}{_identifier_text(entry.message)}", 1)


def _identifier_text(message: Any) -> str:
    """The identifier of a message in the name of its group, of 29 bits with all digits."""
    return f"#0x{message.frame_id:0{8 if message.is_extended_frame else 1}X}"


def _note_short(entry: _Message, raw_values: Any) -> None:
    """Count a frame that ends before signals of every frame, and name them."""
    cut_signals = [
        signal.name for signal in entry.message.signals if not signal.multiplexer_ids and signal.name not in raw_values
    ]
    entry.short_frames += bool(cut_signals)
    entry.cut_signals.update(dict.fromkeys(cut_signals))


def _values_of(entry: _Message, raw_values: Any, event_counts: Counter[str]) -> Iterator[tuple[int, float]]:
    """Columns and physical values of the signals to read of a frame."""
    for signal in entry.wanted_signals:
        raw = raw_values.get(signal.name)
        if raw is None:
            continue
        value = signal.scale * raw + signal.offset
        if raw in signal.missing_values or raw > signal.last_valid or raw != raw:
            event_counts["absent"] += 1
        elif signal.limits[0] <= value <= signal.limits[1] or raw in signal.named_values:
            yield signal.column, value
        else:
            signal.outside_value = signal.outside_value if signal.outside else value
            signal.outside += 1


def _raw(entry: _Message, data: bytes, event_counts: Counter[str]) -> Any:
    """Raw values of a frame by signal, of an unlisted multiplexer value those of the other signals; None if it does not fit."""
    raw_values = _decode(entry.message, data)
    if raw_values is None and entry.plain_message is not None:
        raw_values = _decode(entry.plain_message, data)
        event_counts["unlisted"] += raw_values is not None
    event_counts["malformed"] += raw_values is None
    return raw_values


def _decode(message: Any, data: bytes) -> Any:
    from cantools.database.errors import Error

    try:
        return message.decode(data, decode_choices=False, scaling=False, allow_truncated=True)
    except (Error, ValueError, LookupError):
        return None


def _drop_multiplexing(message: Any) -> Any:
    """The message without its multiplexed signals; None if it has none."""
    from cantools.database import Message

    if not message.is_multiplexed():
        return None
    signals = [copy.copy(signal) for signal in message.signals if signal.multiplexer_ids is None]
    for signal in signals:
        signal.is_multiplexer = False  # else its named values would be the listed ones
    return Message(message.frame_id, message.name, message.length, signals, is_fd=message.is_fd, strict=False)


def _pgn(number: int) -> int:
    """The group number in an identifier of J1939."""
    group = number >> 8 & 0x3FFFF
    return group if group >> 8 & 0xFF >= PDU2 else group & 0x3FF00


def is_unavailable(name: str) -> bool:
    """Whether the name of a value says that there is none."""
    return bool(NOT_AVAILABLE.search(NEW_WORD.sub(" ", name)))


def _named_values(signal: Any) -> tuple[tuple[float, str], ...]:
    """Physical values that the database names, and their names."""
    choices = (signal.choices or {}).items()
    return tuple((float(signal.scale) * float(raw) + float(signal.offset), str(name)) for raw, name in choices)


def _signal(column: int, signal: Any, j1939: bool) -> _Signal:
    """How a signal is read."""
    choices = {raw: str(name) for raw, name in (signal.choices or {}).items()}
    missing = frozenset(raw for raw, name in choices.items() if is_unavailable(name))
    low, high = (end if limit is None else float(limit) for limit, end in ((signal.minimum, -inf), (signal.maximum, inf)))
    step = 0.0 if signal.is_float else 0.5 * abs(float(signal.scale))
    limits = (low - max(step, ROUNDED * abs(low)), high + max(step, ROUNDED * abs(high))) if low < high else (-inf, inf)
    last = inf
    if j1939 and not signal.is_signed and not signal.is_float:
        if signal.length >= 8:
            last = ((J1939_LAST_VALID + 1) << (signal.length - 8)) - 1
        elif signal.length > 1:
            last = (1 << signal.length) - 3  # the last two say error and not available
    named = frozenset(choices) - missing
    return _Signal(column, signal.name, float(signal.scale), float(signal.offset), missing, named, last, limits)


TEXTS = {
    "lost": ("unusable", "entries of the log are unreadable; they are skipped"),
    "cut": ("cut", "line at the end is incomplete: it is skipped"),
    "unknown": ("unknown_topic", "frames have identifiers that no database describes; they are skipped"),
    "other_source": ("other_source", "frames come from other control units that send the same group; they are skipped"),
    "unlisted": (
        "unlisted",
        "frames have a multiplexer value that the database does not list; only their other signals are read",
    ),
    "malformed": ("malformed", "frames do not match the database; they give no sample"),
    "incomplete": (
        "missing",
        "messages of the J1939 transport protocol are incomplete or aborted; they are skipped",
    ),
    "stray": ("malformed", "packets of the J1939 transport protocol belong to no announced message; they are skipped"),
    "absent": ("absent", "values are marked as unavailable or as an error; they give no sample"),
}


def _findings_of(event_counts: Counter[str]) -> Iterable[Finding]:
    for event, (kind, text) in TEXTS.items():
        if event_counts[event]:
            yield Finding("", kind, event_counts[event], nan, f"{event_counts[event]} {text}")


def _of_signals(entry: _Message, roles: Sequence[str]) -> Iterator[Finding]:
    """Frames that end before a signal, and values outside of its limits."""
    if entry.short_frames:
        names = some_of(list(entry.cut_signals), NAMES_SHOWN)
        text = f"{entry.short_frames} frames of {entry.group} are too short for {names}: only their other signals are read"
        yield Finding("", "short", entry.short_frames, nan, text)
    for signal in entry.wanted_signals:
        if signal.outside:
            described = entry.message.get_signal_by_name(signal.name)
            limits = f"[{described.minimum}|{described.maximum}] {described.unit or ''}".rstrip()
            text = (
                f"{signal.outside} values of {entry.group}/{signal.name} are outside of its limits {limits}, such as "
                f"{signal.outside_value:g}: they give no sample. If these are wrong, correct {entry.file.name}; [0|0] is none"
            )
            yield Finding(roles[signal.column], "out_of_range", signal.outside, nan, text)


def _of_buses(messages: Iterable[_Message]) -> Iterator[Finding]:
    """Frames of a message on other buses than the first that sends it."""
    for entry in messages:
        if entry.other_buses and entry.sender:
            count, bus = entry.other_buses.total(), next(iter(entry.other_buses))
            text = (
                f"{count} frames of other buses, such as {bus}, have the identifier of {entry.group}, which bus "
                f"{entry.sender[0]} sends first; they are skipped. To choose the bus, write in the topics file: "
                f"dbc: {{{bus}: {entry.file.name}}}"
            )
            yield Finding("", "other_bus", count, nan, text)


def _of_rivals(messages: Sequence[_Message]) -> Iterator[Finding]:
    """Signals of messages whose frames another message takes, as it comes first in the databases."""
    for place, entry in enumerate(messages):
        if not entry.wanted_signals or entry.sender:
            continue
        for rival in (message for message in messages[:place] if message.sender and message.frames == entry.frames):
            text = (
                f"{', '.join(signal.name for signal in entry.wanted_signals)} in {entry.file.name}: no sample, as frames of "
                f"{entry.group} are read as {rival.group} in {rival.file.name}, which has the same identifier. If their buses "
                f"differ, write in the topics file, by their numbers: dbc: {{1: {rival.file.name}, 2: {entry.file.name}}}"
            )
            yield Finding("", "empty", len(entry.wanted_signals), nan, text)
