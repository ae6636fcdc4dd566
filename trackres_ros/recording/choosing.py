# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Chooses the channels of a file to read: those that the topics file names, those known by name, else those guessed."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

from trackres_ros.errors import InputError, nearest
from trackres_ros.recording.binding import TopicBinding
from trackres_ros.recording.bindings import TIME, Topics, inside_unit
from trackres_ros.recording.channel_file import Channel, ChannelFile, ChosenChannel
from trackres_ros.recording.directions import STANDARDS, Ways, named_ways, standard_of
from trackres_ros.recording.guess import guess_channels, note_of_parts, topics_line
from trackres_ros.recording.role_units import UNITS, conversion, is_quantity
from trackres_ros.recording.roles import POSITION, ROLES, base_role, names_a_part
from trackres_ros.text import some_of, words

TIME_S = "time_s"
DATE_NAMES = ("time", "timestamp", "datetime")
"""Names of a column of dates with times, in any case; for numbers the unit would be unknown."""
COLUMNS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {name: (role, unit) for role, about in ROLES.items() for name, unit in about.columns.items()}
)
"""Columns known by name: role, and unit. ``weight_n/front`` is the load of the axle or assembly front."""
UNIT_IN_BRACKETS, UNIT_AT_THE_END = re.compile(r"[\[(]([^\[\]()]+)[\])]$"), re.compile(r"[_ ]([^_ ]{2,})$")
"""In the name of a column: ``Geschw [km/h]``, ``time_ms``; one letter at the end may be anything."""
NAMES_SHOWN = 20


@dataclass(frozen=True, slots=True)
class Choice:
    """Result of the choice: the time column of a table, the channels of the roles, and notes."""

    time: ChosenChannel | None
    channels: list[ChosenChannel]
    notes: list[str]
    guessed: frozenset[str] = frozenset()


def choose(file: ChannelFile, topics: Topics | None) -> Choice:
    """Choose the channels of a file.

    `file`: the opened file; `topics`: the topics file. If it names no role, channels of a file other than a table are guessed by
    name and unit. Raises InputError for a missing or ambiguous channel, no time, no speed, or a unit that does not fit its role.
    """
    names = _Names(file)
    listed = topics.bindings.items() if topics else ()
    origin = topics.origin if topics else file.name
    notes = _left_out(file)
    of_file = [
        one
        for role, binding in listed
        if not binding.of_topics
        for part in binding.sources
        for one in names.with_validity(role, part, origin, notes)
    ]
    known = _known(file, frozenset(one.role for one in of_file), names, notes)
    time = None if file.has_times else _time(file, topics, names, notes)
    if topics:
        notes += _units_in_names(file, topics, [*of_file, *([time] if time and topics.time else [])])
    chosen = [*of_file, *known]
    there, guessed = {base_role(one.role) for one in chosen}, dict[str, TopicBinding]()
    if file.has_times and not listed and "speed" not in there:
        guessed, others, parts = guess_channels([one for one in file.channels if names.is_single(one.name)], there)
        for role, binding in guessed.items():
            chosen.append(names.chosen(role, binding, origin, []))
            possible = f"; also possible: {listed_names(others[role])}" if others[role] else ""
            notes.append(f"{topics_line(role, chosen[-1].binding)}  # guessed{possible}")
        for role, some in parts.items():
            notes.append(note_of_parts(role, [names.chosen(role, one, origin, []).binding for one in some]))
    if not any(one.role == "speed" for one in chosen):
        own = ", or a speed with a unit whose name a single group has" if file.has_times else ""
        given = "; ".join([f"columns {names.listed or 'none'}", *_left_out(file)])
        remedy = f"or give it in a topics file: {_speed_line(file)}"
        raise InputError(file.name, given, f"a column speed_mps or speed_kmh{own}", remedy)
    for name in ((time.name,) if time else ()) + tuple(one.name for one in chosen):
        names.check_single(name)
    return Choice(time, chosen, notes, frozenset(guessed))


def _speed_line(file: ChannelFile) -> str:
    """A line of a topics file for a channel named as a speed in a unit, such as speed_mph; else an example."""
    bare = [one for one in file.channels if not one.unit]
    found = guess_channels(bare, ROLES.keys() - {"speed"}).bindings
    return topics_line("speed", found["speed"]) if found else "speed: {channel: NAME, unit: km/h}"


def _left_out(file: ChannelFile) -> list[str]:
    """The channels that cannot be read, by reason."""
    return [
        f"not read, as {why}: {listed_names([one.name for one in file.left_out if file.left_out[one] == why])}"
        for why in dict.fromkeys(file.left_out.values())
    ]


class _Names:
    """The channels of a file by name, alone and with the group before it."""

    def __init__(self, file: ChannelFile) -> None:
        self._file = file
        self._places: dict[str, list[int]] = {}
        for place, one in enumerate(file.channels):
            self._places.setdefault(one.name, []).append(place)
        self.first = {name: places[0] for name, places in self._places.items()}  # channel of each name, without a group
        for place, one in enumerate(file.channels):
            if one.group:
                self._places.setdefault(f"{one.group}/{one.name}", []).append(place)

    @property
    def listed(self) -> str:
        """The names, of several groups with the group before it."""
        channels = self._file.channels
        each = [f"{one.group}/{one.name}" if one.group and not self.is_single(one.name) else one.name for one in channels]
        return listed_names(list(dict.fromkeys(each)))

    def is_single(self, name: str) -> bool:
        return len(self._places[name]) == 1

    def check_single(self, name: str) -> None:
        """Refuse a name of several channels."""
        places = self._places[name]
        if len(places) > 1:
            groups = [self._file.channels[place].group for place in places]
            several = [f"{group}/{name}" for group in groups if group]
            remedy = f"put the group name before it: {listed_names(several)}" if len(set(groups)) == len(groups) else ""
            raise InputError(self._file.name, f"{len(places)} columns {name}", "each column once", remedy)

    def with_validity(self, role: str, binding: TopicBinding, origin: str, notes: list[str]) -> Iterator[ChosenChannel]:
        """The channel that says whether the one of a line counts, if the line names it, and that one."""
        if binding.valid:
            valid = self.chosen("enable", binding.valid, f"{origin}: {role}: valid", notes)
            yield replace(valid, role=role, is_valid=True)
        yield self.chosen(role, binding, origin, notes)

    def chosen(self, role: str, binding: TopicBinding, origin: str, notes: list[str]) -> ChosenChannel:
        """A channel that a line names, in the unit of its role."""
        if binding.column not in self._places:
            where = f"{origin}: {role}: column"
            for one, why in self._file.left_out.items():
                if binding.column in (one.name, f"{one.group}/{one.name}"):
                    raise InputError(where, binding.column, "a channel that can be read", why)
            raise InputError(where, binding.column, self.listed, nearest(binding.column, self._places))
        place = self._places[binding.column][0]
        if role == "direction" and binding.ways is None:
            binding = replace(binding, ways=_ways_of(self._file.channels[place], origin))
        return ChosenChannel(place, binding.column, role, _in_unit(self._file.channels[place], role, binding, origin, notes))


def _ways_of(channel: Channel, origin: str) -> Ways:
    """What the values of a direction mean, by the names that the file gives them, else by its own name.

    Raises InputError if neither says it.
    """
    found = named_ways(channel.named) or STANDARDS.get(standard_of(channel.name))
    if found is None:
        remedy = f"for example: direction: {{channel: {channel.name}, values: {{forward: [1], reverse: [0]}}}}"
        raise InputError(f"{origin}: direction", f"no values for {channel.name}", "values that mean forward and reverse", remedy)
    return found


def _in_unit(channel: Channel, role: str, binding: TopicBinding, origin: str, notes: list[str]) -> TopicBinding:
    """The binding with the unit of the file, if the line gives neither unit nor scale."""
    if not channel.unit or binding.has_modes:
        return binding
    inside = inside_unit(role, binding.derivative)
    of_file = conversion(channel.unit, inside)
    if role == TIME and of_file is None:  # dates have none
        return binding
    of_line = (binding.scale, binding.offset)
    by_offset = binding.offset != 0.0 and of_file in (None, of_line)  # an offset alone, which may convert all there is: K
    if binding.converts or by_offset:
        if of_file != of_line:
            read = "but the topics file uses another conversion"
            notes.append(f"{role}: {binding.column} is in {channel.unit} according to the file, {read}")
        return binding
    if of_file is None:
        keys = f"channel: {binding.column}, unit: {next(iter(UNITS[inside]))}{', derivative: true' * binding.derivative}"
        remedy = f"give its unit in the topics file: {role}: {{{keys}}}"
        raise InputError(f"{origin}: {role}: unit of {binding.column}", channel.unit, ", ".join(UNITS[inside]), remedy)
    unit = next(name for name, one in UNITS[inside].items() if one == of_file)
    if unit != inside:
        notes.append(f"{role}: {binding.column} is in {unit} according to the file")
    return replace(binding, scale=of_file.scale, offset=of_file.scale * binding.offset + of_file.offset, unit=unit)


def _units_in_names(file: ChannelFile, topics: Topics, chosen: Sequence[ChosenChannel]) -> Iterator[str]:
    """Note where the name of a column has a unit, but its line and the file have none and it is read in another one."""
    for one in chosen:
        line = topics.time if one.role == TIME and topics.time else topics[one.role]
        found = UNIT_IN_BRACKETS.search(one.name) or UNIT_AT_THE_END.search(one.name)
        given = file.channels[one.place].unit or line.converts or one.binding.converts or line.has_modes or one.is_valid
        if not found or given or one.role in POSITION:  # the values of a position decide
            continue
        inside = inside_unit(one.role, line.derivative)
        of_name = conversion(found[1], inside)
        foreign = of_name is None and found.re is UNIT_IN_BRACKETS and is_quantity(found[1])
        if foreign or of_name not in (None, (1.0, 0.0), (one.binding.scale, one.binding.offset)):
            read = f"but is read in {inside}, as its line has neither unit nor scale"
            yield f"{one.role}: {one.name} is in {found[1]} according to its name, {read}"


def _known(file: ChannelFile, by_file: frozenset[str], names: _Names, notes: list[str]) -> list[ChosenChannel]:
    """The columns known by name, of roles that the topics file does not name."""
    columns: dict[str, ChosenChannel] = {}
    for name, place in names.first.items():
        base, slash, part = (name.rpartition(".")[2] if file.has_times else name).partition("/")
        if base not in COLUMNS:
            continue
        role, unit = COLUMNS[base][0] + slash + part, COLUMNS[base][1]
        about = ROLES[base_role(role)]
        if role in by_file or (slash and not (names_a_part(part) and about.parts)):
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
    inside = inside_unit(role)
    by_name, of_file, share = (conversion(*one) for one in ((unit, inside), (channel.unit, inside), (channel.unit, "1")))
    assert by_name is not None
    ways = _ways_of(channel, origin) if role == "direction" else None
    binding = TopicBinding(column=channel.name, scale=by_name.scale, unit=unit, ways=ways)
    if of_file == by_name or share == (1.0, 0.0):  # the same, or none
        return binding
    if of_file and unit == "1":
        return _in_unit(channel, role, TopicBinding(column=channel.name), origin, notes)
    if of_file or share or is_quantity(channel.unit):
        right = of_file or by_name
        line = topics_line(role, replace(binding, scale=right.scale, offset=right.offset))
        raise InputError(f"{origin}: unit of {channel.name}", channel.unit, unit, f"give it in a topics file: {line}")
    if role != TIME:  # dates have none
        notes.append(f"{role}: {channel.name} is in {channel.unit} according to the file: no known unit, so its name decides")
    return binding


def _time(file: ChannelFile, topics: Topics | None, names: _Names, notes: list[str]) -> ChosenChannel:
    """The column of the time in a table."""
    if topics and topics.time:
        return names.chosen(TIME, topics.time, topics.origin, notes)
    if TIME_S in names.first:
        place = names.first[TIME_S]
        return ChosenChannel(place, TIME_S, TIME, _by_name(file.channels[place], TIME, "s", file.name, notes))
    dated = [name for name in names.first if name.lower() in DATE_NAMES]
    if len(dated) == 1:
        chosen = names.chosen(TIME, TopicBinding(column=dated[0]), file.name, notes)
        return replace(chosen, dates_only=not conversion(file.channels[chosen.place].unit or "?", "s"))
    allowed = f"a column {TIME_S}, in seconds, or timestamp, of dates with times"
    line = next(_time_lines(names.first), "time: {column: NAME, unit: ms}")
    raise InputError(file.name, f"columns {listed_names(list(names.first))}", allowed, f"or give it in a topics file: {line}")


def _time_lines(names: Iterable[str]) -> Iterator[str]:
    """Lines of a topics file for columns named as a time in a unit, such as time_ms."""
    for name in names:
        first, *rest = words(name).split() or [""]
        unit = conversion(rest[-1], "s") if rest and first in ("t", *DATE_NAMES) else None
        if unit:
            yield topics_line(TIME, TopicBinding(column=name, scale=unit.scale))


def listed_names(names: Sequence[str]) -> str:
    """Names as far as anybody reads them."""
    return some_of(names, NAMES_SHOWN)
