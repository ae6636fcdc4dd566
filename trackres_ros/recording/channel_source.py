# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads files of channels in blocks: tables, measurement data, bus logs."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trackres_ros.errors import InputError, one_line
from trackres_ros.files.documents import in_a_line
from trackres_ros.recording.bindings import TopicBinding, Topics
from trackres_ros.recording.channel_file import MOST_TIME_S, ChannelFile, ChannelRows, ChosenChannel
from trackres_ros.recording.choosing import Choice, choose
from trackres_ros.recording.combining import Companions, PositionUnits, Signs, Sums, parts_without_samples, readings_of
from trackres_ros.recording.guessing import listed_names, torque_columns, torque_note
from trackres_ros.recording.reading import read_in_steps, reading
from trackres_ros.recording.roles import likely_values, may_say_reverse
from trackres_ros.recording.samples import Finding, FloatArray, IntArray, SampleBlock
from trackres_ros.recording.wrapping import WrappingClock


class ChannelSource:
    """Samples of a file of channels, row by row.

    An empty cell gives no sample. A sum of channels with the same times has a sample if all of them do; channels with other times
    are added as in `Sums`. Within a row speed comes last, so that a step at the speed has the rest of the row. Channels with
    their own times are sorted by these. Stamps of a table are the column ``time_s``, or the one that the topics file names. A
    role without a channel in the topics file is taken from the column known by name. Raises InputError for no header, no channel
    for time or speed, a missing or ambiguous channel, a unit that does not fit its role, ambiguous numbers or dates.

    `path`: the file; `topics`: channels of other names or units, by role; `read`: opens it, see `FileKind.read`; `kind`: kind of
    the file, for messages.
    """

    zero_is_unset = False

    def __init__(
        self,
        path: Path,
        topics: Topics | None,
        read: Callable[[Path, str, Topics | None], Sequence[ChannelFile]],
        kind: str,
    ) -> None:
        self.name = one_line(str(path))
        self._path, self._allowed_text = path, f"{kind} that is readable to its end"
        self.findings: tuple[Finding, ...] = ()
        topics_file = topics
        topics = self.topics = topics_file and topics_file.select(of_topics=False)
        with reading(path, self._allowed_text):
            files = read(path, self.name, topics)
            self._file, choice, other_files = _first_that_fits(files, topics)
        self._time, channels = choice.time, sorted(choice.channels, key=lambda channel: channel.role == "speed")
        self.roles = tuple(dict.fromkeys(channel.role for channel in channels))
        of_role = {
            role: [channel for channel in channels if channel.role == role and not channel.is_valid] for role in self.roles
        }
        self._validity = {channel.name: channel for channel in channels if channel.is_valid}
        self.bindings = {
            role: replace(topics[role], parts=tuple(channel.binding for channel in parts))
            if len(parts) > 1 and topics
            else parts[0].binding
            for role, parts in of_role.items()
        }
        self._bind_parts(of_role)
        used_places = {channel.place for channel in (*channels, *([self._time] if self._time else []))}
        ignored_channels = [
            (place, channel.name) for place, channel in enumerate(self._file.channels) if place not in used_places
        ]
        torque_names = torque_columns(name for _, name in ignored_channels)
        with reading(path, self._allowed_text):
            self._file.settle(self._time, list(itertools.chain(*self._columns)))
            self.torque_candidates = tuple(
                channel for place, channel in ignored_channels if channel in torque_names and self._file.is_number(place)
            )
        part_notes = [self._note_of(parts) for role, parts in of_role.items() if role not in choice.guessed_roles]
        unused_lines = (
            topics_file.unused_notes(False, {line for channel in files for line in channel.uses}) if topics_file else []
        )
        self._is_direction_required = "direction" in (topics or ())
        notes = [
            *unused_lines,
            *other_files,
            *self._file.notes,
            *choice.notes,
            *part_notes,
            *self._sums().notes,
            *self._companions().notes,
        ]
        self._may_say_reverse = {} if "direction" in self.roles else self._direction_lines(ignored_channels)
        if ignored_channels:
            notes.append(f"ignored columns: {listed_names([name for _, name in ignored_channels])}")
        notes += torque_note(self.torque_candidates, self.roles)
        self._notes = tuple(map(one_line, notes))
        self._position = PositionUnits(self.bindings)

    def _bind_parts(self, of_role: Mapping[str, Sequence[ChosenChannel]]) -> None:
        """Choose the readings: parts with the same times are added row by row, others are read singly and added as in `Sums`.

        A part of these has the group as its topic, as `Sums` treats parts with the same times as one message.
        """
        self._of_sums_apart: dict[str, TopicBinding] = {}
        for role, channels in of_role.items():
            parts = tuple(self._group_binding(channel) for channel in channels)
            are_apart = len({part.topic for part in parts}) > 1 or (len(parts) > 1 and any(part.valid for part in parts))
            total = parts[0] if len(parts) == 1 else replace(self.bindings[role], parts=parts if are_apart else ())
            self._of_sums_apart[role] = total
        self._readings = readings_of(self.roles, self._of_sums_apart)
        self._columns = [
            [self._validity[channel.binding.column]]
            if channel.is_valid
            else of_role[channel.role]
            if channel.part is None
            else [of_role[channel.role][channel.part]]
            for channel in self._readings
        ]

    def _group_binding(self, channel: ChosenChannel) -> TopicBinding:
        """The binding of a channel with its group as the topic, and so that of its validity."""
        validity = channel.binding.valid
        return replace(
            channel.binding,
            topic=self._file.channels[channel.place].group,
            valid=validity and replace(validity, topic=self._file.channels[self._validity[validity.column].place].group),
        )

    def _note_of(self, columns: Sequence[ChosenChannel]) -> str:
        """Which column feeds a role, or which are added."""
        role = columns[0].role
        if len(columns) == 1:
            return f"{role}: {'the change of ' if columns[0].binding.derivative else ''}column {columns[0].name}"
        in_rows = "" if self._of_sums_apart[role].parts else ", where a row has them all"
        return f"{role}: sum of the columns {', '.join(column.name for column in columns)}{in_rows}"

    def _direction_lines(self, channels: Sequence[tuple[int, str]]) -> dict[str, str]:
        """Lines of a topics file for those of some channels, by place and name, that may say the direction."""
        lines = {}
        for place, name in channels:
            if may_say_reverse([name]):
                values = likely_values(name, self._file.channels[place].value_names)
                numbers = "" if self._file.is_number(place) else ", and numbers instead of texts in that column"
                lines[name] = f"direction: {{channel: {in_a_line([name])[1:-1]}, values: {values}}}{numbers}"
        return lines

    @property
    def time(self) -> TopicBinding | None:
        """The column of the time of a table; None of a file whose channels have their own times."""
        return self._time.binding if self._time else None

    def _companions(self) -> Companions:
        return Companions(self._readings, self._of_sums_apart, self._is_direction_required)

    def _sums(self) -> Sums:
        return Sums(self._readings, self._of_sums_apart)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the reading, the channel of each role, ignored channels, and the assumed unit of a position."""
        return (*self._notes, *self._position.notes)

    def blocks(self, max_rows: int = 65536) -> Iterator[SampleBlock]:
        """Read the file; see `trackres_ros.recording.samples.Source.blocks`.

        Raises InputError, with the place, for no row at all, a cell that is no number, a row without time or of another length,
        or a damaged file.
        """
        sums, companions, signs = self._sums(), self._companions(), Signs(self.roles)
        blocks: Iterator[SampleBlock] = (sums.add_totals(companions.keep_valid(block)) for block in self._blocks(max_rows))
        for place, role in enumerate(self.roles):
            blocks = _differentiate(blocks, place) if self.bindings[role].derivative else blocks
        for block in read_in_steps(self._path, self._allowed_text, blocks):
            signed_block = signs.seen(companions.with_signs(block, self.roles))
            yield self._position.in_radians(signed_block, self.roles)
        unsigned = signs.findings(list(self._may_say_reverse), self._may_say_reverse.values())
        self.findings = (*self.findings, *sums.findings, *companions.findings, *unsigned)

    def _blocks(self, max_rows: int) -> Iterator[SampleBlock]:
        """Readings row by row, before parts with other times are added."""
        whole_bindings = [reading.binding if reading.is_valid or reading.part is None else None for reading in self._readings]
        delay_ns = np.array([binding.delay_ns if binding else 0 for binding in whole_bindings])
        modes = {place: binding for place, binding in enumerate(whole_bindings) if binding and binding.has_modes}
        at_once = max(1, max_rows // len(self._readings))
        self._lone_rows = [0] * len(self._readings)
        self._seen_parts: list[set[int]] = [set() for _ in self._readings]
        clock = WrappingClock(self._time.binding.scale if self._time else 1.0)
        row_count = 0
        streams = [self._stamp_rows(stream, clock) for stream in self._file.streams()]
        for stamp_ns, cells, has_value in streams[0] if len(streams) == 1 else _in_order(streams):
            row_count += len(stamp_ns)
            values, is_present = self._values(cells, has_value)
            for start in range(0, len(stamp_ns), at_once):
                rows, column = np.nonzero(is_present[start : start + at_once])
                if not rows.size:
                    continue
                rows += start
                stamps, samples = stamp_ns[rows], values[rows, column]
                for place, binding in modes.items():
                    samples[column == place] = binding.directions(samples[column == place])
                at_ns = stamps - delay_ns[column]
                at_ns[(at_ns == 0) & (stamps != 0)] = 1  # 0 would mean that it was never set
                yield SampleBlock(column.astype(np.int16), at_ns, stamps, samples)
        if not row_count:
            if self._file.has_times:
                reasons = "; ".join(finding.text for finding in self._file.findings)
                in_use = ", ".join(f"{channel.name} ({channel.role})" for channel in self._file.wanted)
                raise InputError(self._file.name, f"no sample of any channel in use: {in_use}", "at least one sample", reasons)
            raise InputError(self._file.name, "no row", "at least one row below the column names")
        self.findings = (*self._file.findings, *clock.findings(), *self._of_rows())

    def _stamp_rows(self, stream: Iterator[ChannelRows], clock: WrappingClock) -> Iterator[_Stamped]:
        """The rows of a stream with stamps [ns]. `clock`: of the column of the time; dates and own times need none."""
        row_count = 0
        for time, has_time, cells, has_value in stream:
            is_clock = self._time is not None and time.dtype == np.float64 and has_time.all()
            times = clock.continued(time.astype(np.float64)) if is_clock else time
            yield self._stamps(times, has_time, row_count), cells, has_value
            row_count += len(time)

    def _stamps(self, time: FloatArray | IntArray, has_time: NDArray[np.bool_], row_count: int) -> IntArray:
        """Stamps of some rows [ns], after `row_count` earlier ones."""
        scale, offset = (self._time.binding.scale, self._time.binding.offset) if self._time else (1.0, 0.0)
        dates = time.dtype == np.int64
        seconds = time * 1e-9 + offset if dates else scale * time + offset
        is_bad = ~has_time | ~(np.abs(seconds) < MOST_TIME_S)
        if is_bad.any():
            row = int(np.argmax(is_bad))
            where = f"{self._file.name}: {self._time.name if self._time else 'time'}, row {row_count + row + 1} below the header"
            raise InputError(where, float(seconds[row]) if has_time[row] else "", f"a time in seconds, within {MOST_TIME_S:g}")
        if dates:
            return np.asarray(time + round(offset * 1e9), np.int64)
        return np.rint(seconds * 1e9).astype(np.int64)

    def _values(self, cells: FloatArray, has_value: NDArray[np.bool_]) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Values by reading in the units of the roles, and whether there is one: a sum requires all of its parts."""
        shape = (len(cells), len(self._readings))
        values, is_present = np.empty(shape), np.empty(shape, np.bool_)
        place = 0
        for index, places in enumerate(self._columns):
            is_whole, total = np.ones(len(cells), np.bool_), np.zeros(len(cells))
            for part, column in enumerate(places):
                if has_value[:, place].any():
                    self._seen_parts[index].add(part)
                total = total + column.binding.scale * cells[:, place] + column.binding.offset
                is_whole &= has_value[:, place]
                place += 1
            if len(places) > 1:
                role = self.bindings[self._readings[index].role]
                total = role.scale * total + role.offset
                self._lone_rows[index] += int(np.count_nonzero(has_value[:, place - len(places) : place].any(axis=1) & ~is_whole))
            values[:, index], is_present[:, index] = total, is_whole
        return values, is_present

    def _of_rows(self) -> Iterator[Finding]:
        for series, count, seen_parts in zip(self._readings, self._lone_rows, self._seen_parts, strict=True):
            if count:
                lack = parts_without_samples(self.bindings[series.role].parts, seen_parts)
                text = f"{count} rows have only some parts of the sum and give no sample{lack}"
                yield Finding(series.role, "part", count, float("nan"), text)


_Stamped = tuple[IntArray, FloatArray, NDArray[np.bool_]]
"""Stamps [ns] of some rows, their cells, and whether these are given."""


def _in_order(streams: Sequence[Iterator[_Stamped]]) -> Iterator[_Stamped]:
    """Merge the rows of all streams by time; at equal times in a block the first stream comes first.

    Where the times of a stream run back, its rows stay in their order.
    """
    clocks = [np.iinfo(np.int64).min] * len(streams)
    pending_rows: dict[int, tuple[IntArray, _Stamped]] = {}

    def fill(number: int) -> None:
        for rows in streams[number]:
            if len(rows[0]):
                clock = np.maximum(np.maximum.accumulate(rows[0]), clocks[number])
                pending_rows[number] = clock, rows
                clocks[number] = int(clock[-1])
                return

    for number in range(len(streams)):
        fill(number)
    while pending_rows:
        end = min(int(clock[-1]) for clock, _ in pending_rows.values())
        parts: list[tuple[IntArray, _Stamped]] = []
        for number, (clock, rows) in sorted(pending_rows.items()):
            count = int(np.searchsorted(clock, end, side="right"))
            parts.append((clock[:count], (rows[0][:count], rows[1][:count], rows[2][:count])))
            if count == len(clock):
                del pending_rows[number]
                fill(number)
            else:
                pending_rows[number] = clock[count:], (rows[0][count:], rows[1][count:], rows[2][count:])
        order = np.argsort(np.concatenate([clock for clock, _ in parts]), kind="stable")
        stamps, cells, has_value = zip(*(rows for _, rows in parts), strict=True)
        yield np.concatenate(stamps)[order], np.concatenate(cells)[order], np.concatenate(has_value)[order]


def _first_that_fits(files: Sequence[ChannelFile], topics: Topics | None) -> tuple[ChannelFile, Choice, list[str]]:
    """The first table with a time and a speed, its channels, and a note on the others."""
    fitting: list[tuple[ChannelFile, Choice]] = []
    errors: list[InputError] = []
    for file in files:
        try:
            fitting.append((file, choose(file, topics)))
        except InputError as error:
            errors.append(error)
    if not fitting:
        raise errors[0]
    other_names = ", ".join(file.name for file, _ in fitting[1:])
    return (*fitting[0], [f"also possible: {other_names}"] if other_names else [])


def _differentiate(blocks: Iterator[SampleBlock], place: int) -> Iterator[SampleBlock]:
    """Replace the values of one role by their rate, from the sample before each to the one after it; nan where times do not rise.
    So both of these have to be read before.
    """
    read = list(blocks)
    role_rows = [block.role == place for block in read]
    stamps = (
        np.concatenate([block.stamp_ns[rows] for block, rows in zip(read, role_rows, strict=True)])
        if read
        else np.empty(0, np.int64)
    )
    value = np.concatenate([block.value[rows] for block, rows in zip(read, role_rows, strict=True)]) if read else np.empty(0)
    previous, last = np.maximum(np.arange(len(stamps)) - 1, 0), np.minimum(np.arange(len(stamps)) + 1, len(stamps) - 1)
    interval = (stamps[last] - stamps[previous]) * 1e-9
    is_rising = interval > 0.0
    rate = np.where(is_rising, (value[last] - value[previous]) / np.where(is_rising, interval, 1.0), np.nan)
    for block, rows, part in zip(
        read, role_rows, np.split(rate, np.cumsum([rows.sum() for rows in role_rows])[:-1]), strict=True
    ):
        new_value = block.value.copy()
        new_value[rows] = part
        yield replace(block, value=new_value)
