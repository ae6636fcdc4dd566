# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads measurement data in the format MDF: channels, and the frames of buses that were logged."""

import copy
import functools
import heapq
import io
import logging
import math
import shutil
import tempfile
import weakref
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackres_ros.errors import InputError, MissingExtraError
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.can_signals import CanSignals, Frame, is_unavailable
from trackres_ros.recording.channel_file import MOST_TIME_S, Channel, ChannelFile, ChannelRows, rows_at
from trackres_ros.recording.opening import FileKind
from trackres_ros.recording.roles import is_quantity
from trackres_ros.recording.samples import Finding, FloatArray
from trackres_ros.recording.text_times import NO_ZONE

BLOCK_ROWS = 2**16
"""Records read at once: usually some megabytes, so that a packed block is unpacked a few times at most."""
UNFINISHED = b"UnFinMF"
IDENTIFICATION_BYTES = 64
FRAMES = "CAN_DataFrame"
OF_A_BUS = (FRAMES, "CAN_ErrorFrame", "CAN_RemoteFrame")
OF_A_FRAME = {"ID": 1, "DataBytes": 2, "DataLength": 1, "DLC": 1, "IDE": 1, "BusChannel": 1}
"""Parts of a frame to read, and the dimensions of their samples: ASAM MDF, bus logging."""
LENGTHS = np.array([*range(9), 12, 16, 20, 24, 32, 48, 64])
"""Bytes of a frame by its data length code: ISO 11898-1."""
VIRTUAL = (3, 6)
"""Types of a master and a channel without bytes in the record; their raw value is the index of the record: ASAM MDF 4."""
SAME, LINEAR, TABLES_OF_TEXTS, REST = 0, 1, (7, 8), "default_addr"
"""Types of conversions: ASAM MDF 4; and in asammdf the part of a table for all other values."""
REMOTE_MASTER, OTHER_MASTERS = 1 << 3, {2: "an angle", 3: "a distance", 4: "an index"}
"""Flag of a group whose master is in another one, and masters that are no time: ASAM MDF 4."""
LOCAL_TIME = 1 << 0
"""Flag of a start without a time zone: ASAM MDF 4."""
START_NOTE = f"time: since the start of the measurement, {NO_ZONE}"
EXTENDED, IDENTIFIER, STANDARD = 1 << 31, (1 << 29) - 1, 0x7FF


def _open_file(path: Path, name: str) -> tuple[Any, ExitStack]:
    """The file, and its closing function; given as a stream, as asammdf reads a channel of a named file at once."""
    from asammdf import MDF
    from asammdf.blocks.mdf_v4 import MDF4

    setattr(MDF4, "__del__", _close_quietly)  # noqa: B010 - a method, which fails for a file that could not be opened
    with ExitStack() as resources, _silence_log():
        file: Any = resources.enter_context(path.open("rb"))
        identification = file.read(IDENTIFICATION_BYTES)
        version = identification[8:16].decode("latin-1").strip("\0 ")
        if version < "4":
            raise InputError(name, f"MDF {version}", "MDF 4", "convert it: asammdf.MDF(FILE).convert('4.10').save(NEW)")
        file.seek(0)
        if identification.startswith(UNFINISHED):  # it is finished in a copy, as asammdf does with a named file
            packed_file, file = file, resources.enter_context(tempfile.TemporaryFile())
            shutil.copyfileobj(packed_file, file)
            file.seek(0)
        mdf = MDF(file, process_bus_logging=False)  # all identifiers would be read
        resources.callback(mdf.close)
        return mdf, resources.pop_all()


def _close_quietly(mdf: Any) -> None:
    with suppress(Exception):
        mdf.close()


@contextmanager
def _silence_log() -> Iterator[None]:
    """Suppress the output and log of asammdf, except for its exceptions."""
    logging.getLogger("asammdf").setLevel(logging.CRITICAL)
    with redirect_stdout(io.StringIO()):
        yield


class _Groups:
    """The groups of an MDF file."""

    def __init__(self, path: Path, name: str) -> None:
        self.name = name
        self.mdf, resources = _open_file(path, name)
        weakref.finalize(self, resources.close)
        self.start_ns = int(self.mdf.header.abs_time)  # without a time zone too: not that of this machine
        self.notes = [START_NOTE] if self.mdf.header.time_flags & LOCAL_TIME else []
        kinds = [{channel.name for channel in group.channels}.intersection(OF_A_BUS) for group in self.mdf.groups]
        self.of_a_bus = [number for number, kind in enumerate(kinds) if kind]
        self.buses = [number for number, kind in enumerate(kinds) if FRAMES in kind]

    def records(self, group: int) -> int:
        """How many records a group has."""
        return int(self.mdf.groups[group].channel_group.cycles_nr)

    def lacks_times(self, group: int) -> str:
        """Why the records of a group have no times; empty if they have."""
        channel_group = self.mdf.groups[group].channel_group
        group = channel_group.cg_master_index if channel_group.flags & REMOTE_MASTER else group
        if group not in self.mdf.masters_db:
            return "its group has no master"
        master = self.mdf.groups[group].channels[self.mdf.masters_db[group]]
        return f"the master of its group is {OTHER_MASTERS[master.sync_type]}" if master.sync_type in OTHER_MASTERS else ""

    def part(self, group: int, index: int, start: int) -> Any:
        """A part of a channel as a signal, including samples marked as invalid.

        Raises InputError if the channel or its times lie outside of the records: asammdf would read other data.
        """
        group_description = self.mdf.groups[group]
        sizes = group_description.channel_group
        for channel in (group_description.channels[index], group_description.channels[self.mdf.masters_db.get(group, index)]):
            bits = 8 * channel.byte_offset + channel.bit_offset + channel.bit_count
            if bits > 8 * sizes.samples_byte_nr or channel.pos_invalidation_bit > 8 * sizes.invalidation_bytes_nr:
                where = f"{self.name}: {channel.name}"
                raise InputError(where, f"{bits} bits", f"a channel within its record of {sizes.samples_byte_nr} bytes")
        rows = {"record_offset": start, "record_count": min(BLOCK_ROWS, self.records(group) - start)}
        with _silence_log():
            signal = self.mdf.get(group=group, index=index, raw=True, ignore_invalidation_bits=True, **rows)
        if group_description.channels[index].channel_type in VIRTUAL:  # asammdf counts from the beginning of a block
            signal.samples = np.arange(start, start + len(signal.timestamps))
        return signal


class MdfChannels(ChannelFile):
    """The channels of an MDF file that hold numbers."""

    def __init__(self, groups: _Groups, name: str) -> None:
        self.name, self._groups, self.notes = name, groups, groups.notes
        self._places: list[tuple[int, int]] = []
        self.channels: list[Channel] = []
        self.left_out: dict[Channel, str] = {}
        names = Counter(self._name_of(number) for number in range(len(groups.mdf.groups)))
        for number, group in enumerate(groups.mdf.groups):
            label = self._name_of(number)
            label = label if names[label] == 1 else f"{label} {number}"
            has_no_times = groups.lacks_times(number)
            for index, channel in enumerate(group.channels):
                if index != groups.mdf.masters_db.get(number) and number not in groups.of_a_bus and _is_numeric(group, index):
                    new_channel = Channel(channel.name, _unit(channel), label, _named_values(channel.conversion))
                    if has_no_times:
                        self.left_out[new_channel] = has_no_times
                        continue
                    self._places.append((number, index))
                    self.channels.append(new_channel)

    def _name_of(self, number: int) -> str:
        group = self._groups.mdf.groups[number].channel_group
        source = group.acq_source
        return group.acq_name or (source.name if source else "") or f"group {number}"

    def streams(self) -> Sequence[Iterator[ChannelRows]]:
        """The groups of the chosen channels; that of the last one, the speed, last."""
        numbers = [self._places[channel.place][0] for channel in self.wanted]
        self.findings = ()
        return [self._rows(number) for number in sorted(set(numbers), key=lambda number: (number == numbers[-1], number))]

    def _rows(self, number: int) -> Iterator[ChannelRows]:
        columns = [(column, self._places[wanted_channel.place]) for column, wanted_channel in enumerate(self.wanted)]
        group_columns = [(column, index) for column, (group, index) in columns if group == number]
        descriptions = [self._groups.mdf.groups[number].channels[index] for _, index in group_columns]
        conversions = [_without_texts(channel.conversion, _unit(channel)) for channel in descriptions]
        records, read, absent_values = self._groups.records(number), 0, 0
        if not records and self._groups.mdf.groups[number].data_group.data_block_addr:
            text = f"{self._name_of(number)} has no records by its header, but has data"
            self.findings = (*self.findings, Finding("", "structure", 1, float("nan"), text))
        for start in range(0, records, BLOCK_ROWS):
            signals = [self._groups.part(number, index, start) for _, index in group_columns]
            seconds = np.asarray(signals[0].timestamps, np.float64)
            cells = np.full((len(seconds), len(self.wanted)), np.nan)
            for (column, _), signal, conversion in zip(group_columns, signals, conversions, strict=True):
                cells[:, column] = _numbers(signal, conversion, len(seconds))
                absent_values += int(np.count_nonzero(np.isnan(cells[:, column])))
            read += len(seconds)
            yield rows_at(seconds, cells, self._groups.start_ns)
            if len(seconds) < min(BLOCK_ROWS, records - start):  # a damaged file may state any number of records
                break
        if absent_values:
            text = f"{absent_values} values are invalid or not numbers; they give no sample"
            self.findings = (*self.findings, Finding("", "absent", absent_values, float("nan"), text))
        if read < records:
            text = f"{records - read} records fewer than the file declares"
            self.findings = (*self.findings, Finding("", "missing", records - read, float("nan"), text))


def _unit(channel: Any) -> str:
    return (channel.conversion and channel.conversion.unit) or channel.unit or ""


def _named_values(conversion: Any) -> tuple[tuple[float, str], ...]:
    """Values that an enumeration names, and their names."""
    if conversion is None or conversion.conversion_type != TABLES_OF_TEXTS[0]:
        return ()
    texts = {key: part for key, part in conversion.referenced_blocks.items() if key != REST and isinstance(part, bytes)}
    return tuple(
        (float(getattr(conversion, key.replace("text", "val"))), part.decode("utf-8", "replace")) for key, part in texts.items()
    )


def _is_numeric(group: Any, index: int) -> bool:
    """Whether a channel has one number per record."""
    from asammdf.blocks.v4_constants import CHANNEL_TYPE_VALUE, CHANNEL_TYPE_VIRTUAL, DATA_TYPE_STRING_LATIN_1

    channel = group.channels[index]
    kinds = (CHANNEL_TYPE_VALUE, CHANNEL_TYPE_VIRTUAL)
    return (
        not group.channel_dependencies[index] and channel.data_type < DATA_TYPE_STRING_LATIN_1 and channel.channel_type in kinds
    )


def _without_texts(conversion: Any, unit: str) -> Any:
    """A conversion with nan for values that mean a text.

    In an enumeration all values mean texts, so their raw numbers stay, except where the text says that there is no value.
    """
    if conversion is None or conversion.conversion_type not in TABLES_OF_TEXTS:
        return conversion
    parts = dict(conversion.referenced_blocks)
    rest = parts.pop(REST)
    default_stays = rest == b"" or (not isinstance(rest, bytes) and _is_identity(rest))  # other values are their raw numbers
    has_scale = any(map(_gives_numbers, parts.values() if default_stays else (*parts.values(), rest)))
    new_conversion = _clear_texts(conversion, has_scale or (default_stays and is_quantity(unit)))
    if default_stays and not has_scale:
        new_conversion.referenced_blocks[REST] = rest
    return new_conversion


def _is_identity(conversion: Any) -> bool:
    kind = conversion.conversion_type
    return bool(kind == SAME or (kind == LINEAR and (conversion.a, conversion.b) == (1.0, 0.0)))


def _gives_numbers(part: Any) -> bool:
    """Whether a part of a table is a conversion to numbers: a text is none, nor is a table of texts."""
    if isinstance(part, bytes):
        return False
    return part.conversion_type not in TABLES_OF_TEXTS or any(map(_gives_numbers, part.referenced_blocks.values()))


def _clear_texts(part: Any, all_texts: bool) -> Any:
    """A part of a table, with a conversion to nan for its texts: for all, or for those that say that there is no value."""
    if isinstance(part, bytes):
        return _to_nan() if all_texts or is_unavailable(part.decode("utf-8", "replace")) else part
    if part.conversion_type in TABLES_OF_TEXTS:
        part = copy.copy(part)
        part.referenced_blocks = {key: _clear_texts(block, all_texts) for key, block in part.referenced_blocks.items()}
    return part


@functools.cache
def _to_nan() -> Any:
    """One conversion for all texts: asammdf compares those of equal keys."""
    from asammdf.blocks.v4_blocks import ChannelConversion

    return ChannelConversion(conversion_type=LINEAR, a=math.nan, b=0.0)


def _numbers(signal: Any, conversion: Any, count: int) -> FloatArray:
    """Physical values; nan where the record marks them as invalid, or where a value means a text."""
    samples = signal.samples
    if conversion is not None:
        samples = conversion.convert(samples, ignore_value2text_conversions=True)
    if samples.dtype.kind not in "biuf" or samples.ndim != 1 or len(samples) != count:
        return np.full(count, np.nan)
    numbers: FloatArray = samples.astype(np.float64)
    invalid_rows: NDArray[np.bool_] | None = signal.invalidation_bits
    if invalid_rows is not None:
        numbers[np.asarray(invalid_rows, np.bool_)] = np.nan
    return numbers


def _frames(groups: _Groups, event_counts: Counter[str]) -> Iterator[Frame]:
    """Frames of all buses by their times."""
    yield from heapq.merge(
        *(_frames_of(groups, number, event_counts) for number in groups.buses), key=lambda frame: frame.stamp_ns
    )


def _frames_of(groups: _Groups, number: int, event_counts: Counter[str]) -> Iterator[Frame]:
    """Frames of a group. Raises InputError if they do not follow the standard's description."""
    channels = groups.mdf.groups[number].channels
    places = {name: index for index, channel in enumerate(channels) for name in OF_A_FRAME if channel.name == f"{FRAMES}.{name}"}
    records = groups.records(number)
    for start in range(0, records, BLOCK_ROWS):
        parts = {name: groups.part(number, index, start) for name, index in places.items()}
        dimensions = {name: part.samples.ndim for name, part in parts.items() if part.samples.dtype.kind in "biu"}
        if dimensions != {name: OF_A_FRAME[name] for name in parts} or "ID" not in parts or "DataBytes" not in parts:
            raise InputError(groups.name, f"{FRAMES} of {', '.join(parts)}", f"numbers for {', '.join(OF_A_FRAME)}")
        payloads, seconds = parts.pop("DataBytes").samples, parts["ID"].timestamps
        numbers = {name: _numbers(part, channels[places[name]].conversion, len(seconds)) for name, part in parts.items()}
        rows = np.flatnonzero(np.isfinite(numbers["ID"])).tolist()
        ids = np.nan_to_num(numbers["ID"]).astype(np.int64)
        has_wide_id = (ids & EXTENDED != 0) | (ids > STANDARD) | (numbers.get("IDE", np.zeros(len(ids))) > 0.0)
        stamps = np.rint(np.where(np.abs(seconds) < MOST_TIME_S, seconds, 0.0) * 1e9).astype(np.int64) + groups.start_ns
        buses = [None if math.isnan(bus) else int(bus) for bus in numbers.get("BusChannel", np.full(len(ids), math.nan))]
        columns = [column.tolist() for column in (stamps, ids & IDENTIFIER, has_wide_id, _lengths(numbers, payloads))]
        for row in rows:
            stamp_ns, identifier, is_extended, length = (column[row] for column in columns)
            yield Frame(stamp_ns, identifier, is_extended, buses[row], payloads[row, :length].tobytes())
        event_counts["lost"] += len(ids) - len(rows)
        if len(ids) < min(BLOCK_ROWS, records - start):
            event_counts["lost"] += records - start - len(ids)
            return


def _lengths(numbers: Mapping[str, FloatArray], payloads: NDArray[Any]) -> NDArray[np.int64]:
    """Bytes of each frame: its length, else its data length code; without either all that the record has room for."""
    room = payloads.shape[1]
    codes = np.nan_to_num(numbers.get("DLC", np.full(len(payloads), math.nan)), nan=len(LENGTHS) - 1.0)
    by_code = LENGTHS[np.clip(codes, 0, len(LENGTHS) - 1).astype(np.int64)]
    lengths = numbers.get("DataLength", np.full(len(payloads), math.nan))
    return np.clip(np.where(np.isnan(lengths), by_code, lengths), 0, room).astype(np.int64)


def _read(path: Path, name: str, topics: Topics | None) -> list[ChannelFile]:
    """The channels, and the signals of a bus, if one was logged."""
    groups = _Groups(path, name)
    channels = MdfChannels(groups, name)
    if not groups.buses or (channels.channels and not (topics and topics.dbc)):
        return [channels]
    try:
        import cantools as _  # noqa: F401
    except ImportError:
        raise MissingExtraError("reading CAN frames", "cantools", "can") from None
    signals = CanSignals(name, lambda event_counts: _frames(groups, event_counts), topics)
    signals.notes = groups.notes
    return [channels, signals] if channels.channels else [signals]


KINDS = (FileKind("an MDF file", (".mf4", ".mdf"), _read, (("asammdf", "mdf"),), checked=True),)
