# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Chooses the channels or topics to read: those that the topics file names, those known by name, else those guessed."""

import itertools
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from trackres_ros.errors import InputError, nearest
from trackres_ros.files.documents import in_a_line
from trackres_ros.recording.bindings import TIME, TopicBinding, Topics, inside_unit
from trackres_ros.recording.channel_file import Channel, ChannelFile, ChosenChannel, TableFile
from trackres_ros.recording.guess_values import faults_of
from trackres_ros.recording.guessing import NOT_GUESSED, Guesses, guess_channels, listed_names, note_of_parts, topics_line
from trackres_ros.recording.name_units import bracketed_unit, is_same, unit_in
from trackres_ros.recording.roles import (
    ROLES,
    STANDARDS,
    UNITS,
    Ways,
    base_role,
    conversion,
    is_quantity,
    named_ways,
    names_a_part,
    standard_of,
)
from trackres_ros.recording.time_columns import DAYS, SeenTimes, is_named_as_time, seen_times

IDENTIFIER = re.compile(r"#0x[0-9A-F]+")
"""In the name of a group: the identifier of a message whose name others have too."""
TIME_S = "time_s"
DATE_NAMES = ("time", "timestamp", "datetime")
"""Names of a column of dates with times, in any case; for numbers the unit would be unknown."""
COLUMNS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {name: (role, unit) for role, about in ROLES.items() for name, unit in about.columns.items()}
)
"""Columns known by name: role, and unit. ``weight_n/front`` is the load of the axle or assembly front."""


@dataclass(frozen=True, slots=True)
class Choice:
    """Result of the choice: the time column of a table, the channels of the roles, and notes."""

    time: ChosenChannel | None
    channels: list[ChosenChannel]
    notes: list[str]
    guessed_roles: frozenset[str] = frozenset()


def choose(file: ChannelFile, topics: Topics | None) -> Choice:
    """Choose the channels of a file.

    `file`: the opened file; `topics`: the topics file. If it names no role, and no column is known as the speed, channels are
    guessed by name and unit. Raises InputError for a missing or ambiguous channel, no time, no speed, or a unit that does not
    fit its role.
    """
    names = _Names(file)
    file_lines = topics.bindings.items() if topics else ()
    origin = topics.origin if topics else file.name
    notes = _left_out(file)
    of_file = [
        _less_conversion(channel, binding, file)
        for role, binding in file_lines
        if not binding.of_topics
        for number, part in enumerate(binding.sources, 1)
        for channel in names.with_validity(
            role, part, f"{origin}: {role}{f': sum: part {number}' if binding.parts else ''}", notes
        )
    ]
    known_channels = _find_known_channels(file, frozenset(channel.role for channel in of_file), names, notes)
    time = None if file.has_times else _time(file, topics, names, notes)
    chosen_channels = [*of_file, *known_channels]
    present_roles, guessed_bindings = {base_role(channel.role) for channel in chosen_channels}, dict[str, TopicBinding]()
    refused: dict[tuple[str, str], str] = {}
    if not file_lines and "speed" not in present_roles:
        guesses, refused = _guess_by_values(file, time, names, present_roles)
        guessed_bindings = guesses.bindings
        for role, binding in guessed_bindings.items():
            chosen_channels.append(names.choose_channel(role, binding, origin, []))
            other_names = [alternative.column for alternative in guesses.alternatives[role]]
            alternatives = f"; also possible: {listed_names(other_names)}" if other_names else ""
            notes.append(f"{topics_line(role, chosen_channels[-1].binding)}  # guessed{alternatives}")
        for role, part_bindings in guesses.parts.items():
            notes.append(
                note_of_parts(role, [names.choose_channel(role, channel, origin, []).binding for channel in part_bindings])
            )
        notes += [f"{role}: {NOT_GUESSED} {name}: {reason}" for (role, name), reason in refused.items()]
    if not any(channel.role == "speed" for channel in chosen_channels):
        raise _no_speed(file, names, refused)
    for name in ((time.name,) if time else ()) + tuple(channel.name for channel in chosen_channels):
        names.check_single(name, file.name)
    return Choice(time, chosen_channels, notes, frozenset(guessed_bindings))


def _less_conversion(channel: ChosenChannel, line: TopicBinding, file: ChannelFile) -> ChosenChannel:
    """A part of a sum without the unit of its name, where the line of the sum converts from that unit: once is enough."""
    by_line, by_part = (line.scale, line.offset), (channel.binding.scale, channel.binding.offset)
    is_twice = bool(line.parts) and line.converts and by_line != (1.0, 0.0) and is_same(by_line, by_part)
    if not is_twice or file.channels[channel.place].unit or channel.binding.converts or channel.is_valid:
        return channel
    return replace(channel, binding=replace(channel.binding, scale=1.0, offset=0.0, unit=""))


def _left_out(file: ChannelFile) -> list[str]:
    """The channels that cannot be read, by reason."""
    return [
        f"not read, as {reason}: {listed_names([channel.name for channel in file.left_out if file.left_out[channel] == reason])}"
        for reason in dict.fromkeys(file.left_out.values())
    ]


class _Names:
    """The channels of a file by name, alone and with the group before it."""

    def __init__(self, file: ChannelFile) -> None:
        self._file = file
        self._places: dict[str, list[int]] = {}
        for place, channel in enumerate(file.channels):
            self._places.setdefault(channel.name, []).append(place)
        self.first_places = {name: places[0] for name, places in self._places.items()}  # channel of each name, without a group
        for place, channel in enumerate(file.channels):
            if channel.group:
                for group in dict.fromkeys((channel.group, IDENTIFIER.sub("", channel.group))):
                    self._places.setdefault(f"{group}/{channel.name}", []).append(place)

    @property
    def list_names(self) -> str:
        """The names, of several groups with the group before it."""
        return listed_names(list(dict.fromkeys(map(self.full_name, self._file.channels))))

    def full_name(self, channel: Channel) -> str:
        """The name of a channel, with its group if others have the name too."""
        return f"{channel.group}/{channel.name}" if channel.group and not self.is_single(channel.name) else channel.name

    def is_single(self, name: str) -> bool:
        return len(self._places[name]) == 1

    def check_single(self, name: str, where: str) -> None:
        """Refuse a name of several channels."""
        channels = [self._file.channels[place] for place in self._places[name]]
        if len(channels) > 1:
            full_names = [f"{channel.group}/{channel.name}" for channel in channels if channel.group]
            remedy = f"put the group name before it: {listed_names(full_names)}" if len(set(full_names)) == len(channels) else ""
            raise InputError(where, f"{len(channels)} columns {name}", "each column once", remedy)

    def with_validity(self, role: str, binding: TopicBinding, where: str, notes: list[str]) -> Iterator[ChosenChannel]:
        """The channel that says whether the one of a line counts, if the line names it, and that one."""
        if binding.valid:
            validity_channel = self.choose_channel("enable", binding.valid, f"{where}: valid", notes)
            yield replace(validity_channel, role=role, is_valid=True)
        yield self.choose_channel(role, binding, where, notes)

    def choose_channel(self, role: str, binding: TopicBinding, where: str, notes: list[str]) -> ChosenChannel:
        """A channel that a line names, in the unit of its role; `where`: the line, for messages."""
        if binding.column not in self._places:
            for channel, reason in self._file.left_out.items():
                if binding.column in (channel.name, f"{channel.group}/{channel.name}"):
                    raise InputError(f"{where}: column", binding.column, "a channel that can be read", reason)
            raise InputError(f"{where}: column", binding.column, self.list_names, nearest(binding.column, self._places))
        self.check_single(binding.column, f"{where}: column")
        place = self._places[binding.column][0]
        if role == "direction" and binding.ways is None:
            binding = replace(binding, ways=_ways_of(self._file.channels[place], where))
        return ChosenChannel(place, binding.column, role, _in_unit(self._file.channels[place], role, binding, where, notes))


def _guess_by_values(
    file: ChannelFile, time: ChosenChannel | None, names: _Names, present_roles: Collection[str]
) -> tuple[Guesses, dict[tuple[str, str], str]]:
    """The guesses that their values allow; roles and names of better ones that they do not, with the reason."""
    channels = [channel for channel in file.channels if names.is_single(channel.name)]
    guesses = guess_channels(channels, present_roles)
    candidates = {role: [binding, *guesses.alternatives[role]] for role, binding in guesses.bindings.items()}
    faults = faults_of(
        file,
        time,
        {
            role: [names.choose_channel(role, binding, file.name, []) for binding in of_role]
            for role, of_role in candidates.items()
        },
    )
    refused = dict[tuple[str, str], str]()
    for role, of_role in candidates.items():
        keys = itertools.takewhile(faults.__contains__, ((role, binding.column) for binding in of_role))
        refused |= {key: faults[key] for key in keys}
    return guess_channels(channels, present_roles, faults) if faults else guesses, refused


def _no_speed(file: ChannelFile, names: _Names, refused: Mapping[tuple[str, str], str]) -> InputError:
    """The error of a file without a speed: its columns, or the values of those that may be one."""
    of_speed = [f"{name}: {reason}" for (role, name), reason in refused.items() if role == "speed"]
    remedy_words = ", or a speed with a unit whose name a single group has" if file.has_times else ""
    allowed = f"a column speed_mps or speed_kmh{remedy_words}"
    if of_speed:
        allowed = "a speed with values that are available, possible and not all the same"
    reasons = [finding.text for finding in file.findings] if of_speed else []
    given = "; ".join([*of_speed, *reasons, f"columns {names.list_names or 'none'}", *_left_out(file)])
    return InputError(file.name, given, allowed, f"or give it in a topics file: {_speed_line(file, names, refused)}")


def _speed_line(file: ChannelFile, names: _Names, refused: Collection[tuple[str, str]]) -> str:
    """A line of a topics file for a channel named as a speed, in the unit of its name or km/h; else an example."""
    channels = [channel._replace(name=names.full_name(channel)) for channel in file.channels]
    in_kmh = [channel._replace(unit="km/h") for channel in channels if not channel.unit]
    for options in (channels, in_kmh):
        guess = guess_channels(options, ROLES.keys() - {"speed"}, refused).bindings.get("speed")
        if guess is not None and options is channels:
            return topics_line("speed", names.choose_channel("speed", guess, file.name, []).binding)
        if guess is not None:
            return topics_line("speed", guess).replace("unit: m/s", "unit: km/h")
    return "speed: {channel: NAME, unit: km/h}"


def _ways_of(channel: Channel, where: str) -> Ways:
    """What the values of a direction mean, by the names that the file gives them, else by its own name.

    Raises InputError if neither says it.
    """
    ways = named_ways(channel.value_names) or STANDARDS.get(standard_of(channel.name))
    if ways is None:
        remedy = f"for example: direction: {{channel: {channel.name}, values: {{forward: [1], reverse: [0]}}}}"
        raise InputError(where, f"no values for {channel.name}", "values that mean forward and reverse", remedy)
    return ways


def _in_unit(channel: Channel, role: str, binding: TopicBinding, where: str, notes: list[str]) -> TopicBinding:
    """The binding with the unit of the file, else of the name of the channel, if the line gives neither unit nor scale."""
    of_name = bracketed_unit(channel.name) or unit_in(role, channel.name, binding.derivative)
    text, source = (channel.unit, "the file") if channel.unit else (of_name, "its name")
    if not text or binding.has_modes:
        return binding
    si_unit = inside_unit(role, binding.derivative)
    of_file = conversion(text, si_unit)
    if of_file is None and role == TIME:  # dates have none
        return binding
    of_line = (binding.scale, binding.offset)
    by_offset = binding.offset != 0.0 and (of_file is None or is_same(of_file, of_line))  # an offset alone, for all there is: K
    if binding.converts or by_offset:
        if not (of_file and is_same(of_file, of_line)) and (channel.unit or of_file):
            read = "but the topics file uses another conversion"
            notes.append(f"{role}: {binding.column} is in {text} according to {source}, {read}")
        return binding
    if of_file is None:
        keys = {"channel": binding.column, "unit": next(iter(UNITS[si_unit]))} | (
            {"derivative": True} if binding.derivative else {}
        )
        remedy = f"give its unit in the topics file: {in_a_line([role])[1:-1]}: {in_a_line(keys)}"
        raise InputError(f"{where}: unit of {binding.column}", text, ", ".join(UNITS[si_unit]), remedy)
    unit = next(name for name, known_conversion in UNITS[si_unit].items() if known_conversion == of_file)
    if unit != si_unit:
        notes.append(f"{role}: {binding.column} is in {unit} according to {source}")
    return replace(binding, scale=of_file.scale, offset=of_file.scale * binding.offset + of_file.offset, unit=unit)


def _find_known_channels(file: ChannelFile, by_file: frozenset[str], names: _Names, notes: list[str]) -> list[ChosenChannel]:
    """The columns known by name, of roles that the topics file does not name."""
    columns: dict[str, ChosenChannel] = {}
    for name, place in names.first_places.items():
        base, slash, part = (name.rpartition(".")[2] if file.has_times else name).partition("/")
        if base not in COLUMNS:
            continue
        role, unit = COLUMNS[base][0] + slash + part, COLUMNS[base][1]
        entry = ROLES[base_role(role)]
        if role in by_file or (slash and not (names_a_part(part) and entry.parts)):
            continue
        if role == "direction" and not file.is_number(place):  # yes and no, R and D
            continue
        if role in columns:
            given = f"columns {columns[role].name} and {name}"
            raise InputError(file.name, given, f"one column for {role}", "give the right one in a topics file")
        columns[role] = ChosenChannel(place, name, role, _by_name(file.channels[place], role, unit, file.name, notes))
    return list(columns.values())


def _by_name(channel: Channel, role: str, unit: str, origin: str, notes: list[str]) -> TopicBinding:
    """The binding of a column known by name, in the unit of that name; without one (`grade`) in that of the file.

    Raises InputError if the file gives another unit; a text that is no known unit is only noted.
    """
    si_unit = inside_unit(role)
    by_name, of_file, share = (
        conversion(*unit_pair) for unit_pair in ((unit, si_unit), (channel.unit, si_unit), (channel.unit, "1"))
    )
    assert by_name is not None
    ways = _ways_of(channel, f"{origin}: {role}") if role == "direction" else None
    binding = TopicBinding(column=channel.name, scale=by_name.scale, unit=unit, ways=ways)
    if of_file == by_name or share == (1.0, 0.0):  # the same, or none
        return binding
    if of_file and unit == "1":
        return _in_unit(channel, role, TopicBinding(column=channel.name), f"{origin}: {role}", notes)
    if of_file or share or is_quantity(channel.unit):
        true_conversion = of_file or by_name
        line = topics_line(role, replace(binding, scale=true_conversion.scale, offset=true_conversion.offset))
        raise InputError(f"{origin}: unit of {channel.name}", channel.unit, unit, f"give it in a topics file: {line}")
    if role != TIME:  # dates have none
        notes.append(f"{role}: {channel.name} is in {channel.unit} according to the file: no known unit, so its name decides")
    return binding


def _time(file: ChannelFile, topics: Topics | None, names: _Names, notes: list[str]) -> ChosenChannel:
    """The column of the time in a table."""
    if topics and topics.time:
        channel = names.choose_channel(TIME, topics.time, f"{topics.origin}: {TIME}", notes)
        return _with_seen_times(file, channel, notes)
    if TIME_S in names.first_places:
        place = names.first_places[TIME_S]
        binding = _by_name(file.channels[place], TIME, "s", file.name, notes)
        return _with_seen_times(file, ChosenChannel(place, TIME_S, TIME, binding), notes)
    date_names = [name for name in names.first_places if name.lower() in DATE_NAMES]
    guesses = [] if len(date_names) == 1 else _guess_times(file, names)
    if guesses or len(date_names) == 1:
        name = guesses[0] if guesses else date_names[0]
        channel = names.choose_channel(TIME, TopicBinding(column=name), f"{file.name}: {TIME}", notes)
        has_unit = bool(channel.binding.unit) or bool(conversion(file.channels[channel.place].unit or "?", "s"))
        channel = _with_seen_times(file, replace(channel, dates_only=not has_unit), notes)
        if guesses:
            others = f"; also possible: {listed_names(guesses[1:])}" if guesses[1:] else ""
            notes.append(f"{time_line(channel.binding)}  # guessed{others}")
        return channel
    allowed = f"a column {TIME_S}, in seconds, or timestamp, of dates with times, or one named as a time with a unit"
    named = next((name for name in names.first_places if is_named_as_time(name)), "NAME")
    remedy = f"or give it in a topics file: {time_line(TopicBinding(column=named, unit=unit_in(TIME, named) or 's'))}"
    raise InputError(file.name, f"columns {listed_names(list(names.first_places))}", allowed, remedy)


def _seen_times(file: ChannelFile, place: int) -> SeenTimes:
    return seen_times(file.first_cells(place) if isinstance(file, TableFile) else ())


def _with_seen_times(file: ChannelFile, channel: ChosenChannel, notes: list[str]) -> ChosenChannel:
    """The column of the time in the unit that its numbers show, if neither line, file nor name has one; dates have none."""
    binding, seen = channel.binding, _seen_times(file, channel.place)
    if binding.converts:
        return channel
    if seen.is_text:
        offset = binding.offset if binding.scale == 1.0 else 0.0
        return replace(channel, binding=replace(binding, scale=1.0, offset=offset, unit=""))
    is_of_days = binding.unit == "d" and seen.unit in DAYS
    if not seen.unit or (binding.unit and not is_of_days):
        return channel
    binding = replace(binding, scale=1.0, offset=0.0) if is_of_days else binding
    factor = UNITS["s"][seen.unit]
    notes.append(f"time: column {channel.name}, in {seen.unit} according to its numbers")
    offset = factor.scale * binding.offset + factor.offset
    return replace(channel, dates_only=False, binding=replace(binding, scale=factor.scale, offset=offset, unit=seen.unit))


def _guess_times(file: ChannelFile, names: _Names) -> list[str]:
    """Columns that may be the time, the best one first: they rise, and are dates, clocks or numbers of a known unit."""
    ranks = dict[str, tuple[bool, bool, int]]()
    for name, place in names.first_places.items():
        is_named, unit = is_named_as_time(name), file.channels[place].unit
        has_unit = bool(conversion(unit, "s") if unit else unit_in(TIME, name))
        if not names.is_single(name) or not (is_named or has_unit):
            continue
        seen = _seen_times(file, place)
        if seen.rises and (seen.is_text or (is_named and (has_unit or seen.unit))):
            ranks[name] = (seen.changes < MOSTLY, not is_named, place)
    return sorted(ranks, key=ranks.__getitem__)


MOSTLY = 0.5
"""Share of the cells of a time that differ from the one before; a clock with a coarser step than the table is worse."""


def time_line(binding: TopicBinding) -> str:
    """The line of a topics file for the column of the time."""
    line = {key: getattr(binding, key) for key in ("unit", "order") if getattr(binding, key)}
    return f"{TIME}: {in_a_line({'channel': binding.column, **line})}"
