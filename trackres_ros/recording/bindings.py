# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Binds topics and fields, or columns, to roles: the topics file of bags, tables and the live node."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from trackres_ros import checks
from trackres_ros.errors import InputError, nearest
from trackres_ros.files.dataclass_reader import FILLED, DataReader, Limits
from trackres_ros.files.documents import read_yaml
from trackres_ros.files.resources import find_topics
from trackres_ros.recording.roles import (
    BRAKE_ON_PA,
    POSITION,
    ROLES,
    STANDARDS,
    UNITS,
    WAYS,
    Conversion,
    Ways,
    base_role,
    conversion,
    names_a_part,
    standard_of,
)

IN_DEGREES = "sensor_msgs/msg/NavSatFix"
"""The message type whose latitude and longitude are in degrees by its definition."""
FIX, NO_FIX = "status.status", -1
"""Field of such a message for the fix, and its value without one."""
STEP = re.compile(r"([A-Za-z_]\w*)(?:\[([^\[\]]+)\])?")
PATH = re.compile(rf"{STEP.pattern}(?:\.{STEP.pattern})*")
NAMES_SHOWN = 20
MESSAGE_TYPE = re.compile(r"([A-Za-z]\w*)/(?:msg/)?([A-Za-z]\w*)")


@dataclass(frozen=True, slots=True)
class FieldStep:
    """One step of a field path: a field, and for an array the index or the name of the element.

    A name is looked up in the string array ``name`` of the same message, as in ``sensor_msgs/msg/JointState``.
    """

    name: str
    index: int | None = None
    element: str | None = None


def message_type(given: object, where: str) -> str:
    """Return a message type as ``package/msg/Name``, also from the ``package/Name`` of ROS 1. Raises InputError."""
    match = MESSAGE_TYPE.fullmatch(checks.text(given, where))
    if not match:
        raise InputError(where, given, "package/msg/Name")
    return f"{match.group(1)}/msg/{match.group(2)}"


def field_path(given: object, where: str) -> str:
    """A path that `field_steps` takes. Raises InputError."""
    path = checks.text(given, where)
    if not PATH.fullmatch(path):
        raise InputError(where, given, "a path such as twist.linear.x, effort[NAME] or data[3]")
    return path


Positive = Annotated[float | None, checks.positive]
Numbers = Annotated[tuple[float, ...], FILLED]


@dataclass(frozen=True, slots=True)
class TopicBinding:
    """Source of one role: a field of a topic, or a column of a table."""

    # topic, message type as ``package/msg/Name``, and dotted field path; empty for a column
    topic: str = ""
    type: Annotated[str, message_type] = ""
    field: Annotated[str, field_path] = ""
    column: str = ""  # column of a table; empty for a topic
    # the value in the unit of the role is ``scale * raw + offset``; of an angle given in degrees they turn it into rad
    scale: float = 1.0
    offset: float = 0.0
    stamp: Literal["header", "log", ""] = ""  # ``header``, ``log``, or empty: the header's if the type has one, else log time
    max_age_s: Positive = None  # live: an older sample is not used [s]
    sensor: Literal["surface", "mean", ""] = ""  # of a belt temperature: ``surface``, ``mean``, or empty if not given
    std_k: Positive = None  # standard deviation of a belt temperature [K], if given
    # its value belongs to that much earlier than its stamp
    delay_s: Annotated[float, Limits("s", 0.0, 10.0, "delay of a torque")] = 0.0
    at: Literal["sprockets", "motor", ""] = ""  # of a torque: where it acts; empty if not given, then at the sprockets or wheels
    gear_ratio: float = 1.0  # of a torque at the motor that is converted: of the gears between
    unit: str = ""  # unit of the raw numbers, if given: it is in scale and offset. Without it, the values of a position decide
    converts: bool = False  # whether the line of a topics file gives a unit or a scale: then the unit of the file is not used
    kg_each: Annotated[float | None, Limits("kg", 1.0, 500.0, "mass of one passenger, with luggage")] = None
    threshold: Positive = None  # of a brake: value from which it brakes; None if not given
    # of an enable given as a mode: the modes with feed-forward; empty if it is 1 or 0
    values: Numbers = ()
    ways: Ways | None = None  # of a direction: what its values mean; None if neither the line nor a name says so
    valid: TopicBinding | None = None  # source of whether its values count: other than 0, or one of its `values`
    decimal: Literal[".", ",", ""] = ""  # of a column in text: its decimal mark; empty if its cells decide
    derivative: bool = False  # of a speed in a column: whether it is the distance travelled, whose rate is the speed
    # of dates with slashes or dashes: ``dmy`` or ``mdy``; empty if the whole column decides
    order: Literal["dmy", "mdy", ""] = ""
    # terms of a sum: columns, or fields of topics; `scale` and `offset` then apply to the sum
    parts: tuple[TopicBinding, ...] = ()

    @property
    def sources(self) -> tuple[TopicBinding, ...]:
        """The parts of a sum, else this one."""
        return self.parts or (self,)

    @property
    def of_topics(self) -> bool:
        """Whether it names topics; else it names columns."""
        return bool(self.sources[0].topic)

    def directions(self, numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert scaled numbers: of modes to 1 for those in `values`, else 0; of a direction to its way; nan stays."""
        if self.ways is not None:
            return self.ways.directions(numbers)
        if not self.values:
            return numbers
        return np.where(np.isnan(numbers), np.nan, np.isin(numbers, self.values).astype(float))

    @property
    def has_modes(self) -> bool:
        """Whether numbers are names of modes, or ways of a direction, and have no unit."""
        return bool(self.values) or self.ways is not None

    def brakes_from(self, values: NDArray[np.float64]) -> float:
        """Value from which a brake is on: the threshold, else half of a switch's 0 and 1, else `BRAKE_ON_PA`."""
        if self.threshold is not None:
            return self.threshold
        return 0.5 if np.isin(values, (0.0, 1.0)).all() else BRAKE_ON_PA

    @property
    def delay_ns(self) -> int:
        """The delay [ns]."""
        return round(self.delay_s * 1e9)

    def less_delay(self, stamp_ns: int) -> int:
        """A stamp less the delay [ns]. 0 stays, as it means never set, and no other stamp becomes it."""
        return stamp_ns and (stamp_ns - self.delay_ns or 1)

    @property
    def steps(self) -> tuple[FieldStep, ...]:
        """The steps of the field path."""
        return field_steps(self.field)

    @property
    def fix(self) -> str:
        """The field path of the message's fix status; empty if its type has none."""
        return FIX if self.type == IN_DEGREES else ""

    def read(self, message: object) -> float:
        """Return the value of this role in a decoded message, in the unit of the role; nan of a receiver without a fix.

        Raises LookupError, with the reason, if the message has no such element (of a joint that is not in it, for one);
        AttributeError if the type of the message has no such field.
        """
        if self.fix and attrgetter(self.fix)(message) == NO_FIX:
            return math.nan
        value = message
        for step in self.steps:
            parent, value = value, getattr(value, step.name)
            index = step.index
            if step.element is not None:
                names = list(getattr(parent, "name"))  # noqa: B009 - of any message type
                if step.element not in names:
                    raise LookupError(other_names(names))
                index = names.index(step.element)
            if index is not None:
                array = cast("list[object]", value)
                if index >= len(array):
                    raise LookupError(too_few(step.name, len(array)))
                value = array[index]
        return self.scale * float(cast("float", value)) + self.offset


def other_names(names: Sequence[str]) -> str:
    """Why a message has no element of a name: the names that it has."""
    return f"its names are {', '.join(names[:NAMES_SHOWN]) or 'none'}"


def too_few(name: str, count: int) -> str:
    """Why an array of a message has no such element."""
    return f"the array {name} has {f'only {count}' if count else 'no'} element{'s' * (count != 1)}"


def field_steps(path: str) -> tuple[FieldStep, ...]:
    """Split a field path into its steps: ``twist.linear.x``, ``effort[NAME]``, ``data[3]``.

    Raises ValueError if it is no field path.
    """
    if not PATH.fullmatch(path):
        raise ValueError(f"no field path: {path!r}")
    matches = STEP.findall(path)
    return tuple(
        FieldStep(name, int(part)) if part.isdecimal() else FieldStep(name, element=part or None) for name, part in matches
    )


OWN_KEYS = (
    "topic", "type", "field", "column", "scale", "offset", "stamp", "max_age_s", "sensor", "std_k", "delay_s", "unit", "kg_each",
    "threshold", "decimal", "derivative", "at",
)  # fmt: skip
"""Keys of a line that are fields of a binding."""
PARTS_OF_A_LINE = ("channel", "valid", "sum")
ONLY_FOR = {
    "sensor": ("belt",), "std_k": ("belt",), "delay_s": ("torque",), "kg_each": ("passengers",), "threshold": ("brake",),
    "at": ("torque",),
    "values": ("enable", "direction"), "derivative": ("speed",),
}  # fmt: skip
"""Keys that have a meaning for some roles alone."""
OF_A_PART = ("topic", "type", "field", "stamp", "column", "channel", "unit", "scale", "offset", "decimal", "valid")
"""Keys of a part of a sum."""
NOT_OF_A_SUM = ("topic", "type", "field", "stamp", "column", "channel", "unit", "decimal", "derivative", "values", "valid")
OF_VALIDITY = ("topic", "type", "field", "column", "channel", "values")
"""Keys of a validity; a field alone is of the same message."""
VALID_EXAMPLE = "speed: {channel: Speed, unit: km/h, valid: {channel: SpeedValid}}"
DIRECTION_EXAMPLE = "direction: {channel: Gear, values: {forward: [1, 2], reverse: [-1], neutral: [0]}}"
MOST_PARTS = 16
SUM_EXAMPLE = "torque: {sum: [{column: left_nm}, {column: right_knm, scale: 1000.0}]}"
OF_TIME = ("column", "unit", "scale", "offset", "decimal", "order")
TIME = "time"
"""The line for the time column of a table; no role, as every sample has its time."""
DBC = "dbc"
"""The line that names the database of a CAN bus, or several; no role either."""
BOTH = "position"
"""The line for latitude and longitude of one message."""
OF_BOTH = ("topic", "type", "field", "stamp", "max_age_s", "unit")
"""Its keys: the field is the parent of the two."""
EXAMPLE = "speed: {topic: /vehicle/speed, type: geometry_msgs/msg/TwistStamped, field: twist.linear.x}"


@dataclass(frozen=True, slots=True)
class Topics:
    """A mapping of role to binding, and its origin."""

    bindings: Mapping[str, TopicBinding]  # by role, qualified if the file does so (``load/front``)
    origin: str = "topics"  # the file, for messages to the user
    time: TopicBinding | None = None  # the time column of a table, if it is not ``time_s``
    dbc: tuple[tuple[int | None, Path], ...] = ()  # databases of CAN buses, each with the number of its bus if given

    def __getitem__(self, role: str) -> TopicBinding:
        return self.bindings[role]

    def __iter__(self) -> Iterator[str]:
        return iter(self.bindings)

    def with_databases(self, files: Iterable[Path]) -> Topics:
        """The same with other databases, of whatever bus."""
        return replace(self, dbc=tuple((None, file) for file in files))

    def select(self, of_topics: bool) -> Topics:
        """The same without the roles that a source does not use. `of_topics`: whether it has topics, else columns."""
        selection = {role: binding for role, binding in self.bindings.items() if binding.of_topics == of_topics}
        return replace(self, bindings=MappingProxyType(selection))

    def unused_lines(self, of_topics: bool, lines: Collection[str] = ()) -> Iterator[tuple[str, str, str]]:
        """Lines that a source does not use: their place, what they name, and what the source has instead.

        `of_topics`: whether it has topics, else columns; `lines`: which it uses of `TIME` and `DBC`.
        """
        remedy_words = ("a column of a table", "topics") if of_topics else ("a topic", "columns or channels")
        for role in self.select(not of_topics):
            yield f"{self.origin}: {role}", *remedy_words
        if self.time and TIME not in lines:
            yield f"{self.origin}: {TIME}", f"column {self.time.column}", "times of its own"
        if self.dbc and DBC not in lines:
            yield f"{self.origin}: {DBC}", ", ".join(str(file) for _, file in self.dbc), "no CAN frames"

    def unused_notes(self, of_topics: bool, lines: Collection[str] = ()) -> list[str]:
        """The same as notes: one topics file may serve recordings of several kinds."""
        lines_unused = self.unused_lines(of_topics, lines)
        return [f"{where}: {given} is not used, as this source has {alternative}" for where, given, alternative in lines_unused]

    @classmethod
    def load(cls, path_or_name: str | PathLike[str]) -> Topics:
        """Read a topics file, given by its path or by the name of a shipped one.

        Raises InputError if the file is missing or no YAML, or has an invalid entry: names role and key.
        """
        path = find_topics(path_or_name)
        content = read_yaml(path, "a mapping with one line per role", f"write for example: {EXAMPLE}")
        return cls.parse(content, str(path), path.parent)

    @classmethod
    def parse(cls, content: object, origin: str = "topics", folder: Path = Path()) -> Topics:
        """Check the content of a topics file.

        `content`: content of the YAML; `origin`: its file, for messages; `folder`: folder of relative paths in it. Raises
        InputError for unknown role or key, missing or impossible value.
        """
        if not isinstance(content, Mapping) or not content:
            raise InputError(origin, content, "a mapping with one line per role", f"write for example: {EXAMPLE}")
        bindings: dict[str, TopicBinding] = {}
        for role, line in content.items():
            if role == BOTH:
                bindings |= _position(line, content, f"{origin}: {role}")
            elif role not in (TIME, DBC):
                _check_role(role, origin)
                bindings[role] = _binding(role, line, f"{origin}: {role}")
        time = _time(content[TIME], f"{origin}: {TIME}") if TIME in content else None
        dbc = _databases(content[DBC], f"{origin}: {DBC}", folder) if DBC in content else ()
        return cls(MappingProxyType(bindings), origin, time, dbc)


def inside_unit(role: str, derivative: bool = False) -> str:
    """The unit inside the program of what a line reads: m where the rate of its values is the speed, s of the time."""
    if derivative:
        return "m"
    return "s" if role == TIME else ROLES[base_role(role)].unit


def _check_role(role: object, origin: str) -> None:
    allowed = ", ".join((*ROLES, BOTH, TIME, DBC))
    if not isinstance(role, str) or base_role(role) not in ROLES:
        raise InputError(f"{origin}: role", role, allowed, nearest(str(role).partition("/")[0], ROLES))
    base, slash, part = role.partition("/")
    if slash and not ROLES[base].parts:
        parts = ", ".join(name for name, entry in ROLES.items() if entry.parts)
        raise InputError(f"{origin}: role", role, f"a name of an axle, assembly or wheel only for {parts}", f"write {base}")
    if slash and not names_a_part(part):
        raise InputError(f"{origin}: role", role, f"{base}/NAME with the name of an axle, assembly or wheel")


def _binding(role: str, line: object, where: str) -> TopicBinding:
    if not isinstance(line, Mapping):
        raise InputError(
            where, line, "a mapping with topic, type and field, or with column, or with sum", f"for example: {EXAMPLE}"
        )
    line = _with_column(line, where)
    is_direction = role == "direction"
    own_keys, special_keys = (
        (OWN_KEYS, ("values", *PARTS_OF_A_LINE)) if is_direction else ((*OWN_KEYS, "values"), PARTS_OF_A_LINE)
    )
    base_binding: TopicBinding = _reader(where).part(TopicBinding, line, selection=own_keys, other_keys=special_keys)
    _check_keys(role, line, where)
    derivative, is_sum = base_binding.derivative, "sum" in line
    if not is_sum and not base_binding.column:
        missing_keys = [key for key in ("topic", "type", "field") if key not in line]
        if missing_keys:
            raise InputError(where, f"no {missing_keys[0]}", "topic, type and field, or column", f"for example: {EXAMPLE}")
    default = "deg" if role in POSITION and base_binding.type == IN_DEGREES else ""
    unit, by_unit = _unit(base_binding.unit or default, inside_unit(role, derivative), where)
    scale = by_unit.scale * base_binding.scale
    if scale == 0.0:
        raise InputError(f"{where}: scale", 0.0, "a finite number that is not 0")
    return replace(
        base_binding,
        scale=scale,
        offset=by_unit.scale * base_binding.offset + by_unit.offset,
        unit=unit,
        converts=_converts(line),
        ways=_ways(line.get("values"), base_binding, where) if is_direction else None,
        valid=_validity(line, where) if "valid" in line else None,
        parts=_parts(role, line["sum"], f"{where}: sum") if is_sum else (),
    )


def _reader(where: str) -> DataReader:
    return DataReader(where, ": ")


def _check_keys(role: str, line: Mapping[object, object], where: str) -> None:
    """Refuse keys that have no meaning for a role or beside the others."""
    for key in map(str, line):
        role_of_key = ONLY_FOR.get(key)
        if role_of_key and base_role(role) not in role_of_key:
            raise InputError(f"{where}: key", key, f"{key} only for {', '.join(role_of_key)}")
        if "column" in line and key in ("topic", "type", "field", "stamp", *(() if role == "direction" else ("max_age_s",))):
            raise InputError(f"{where}: key", key, "either column, or topic with type and field")
        if "column" not in line and key in ("decimal", "derivative"):
            raise InputError(f"{where}: key", key, f"{key} only beside column")
        if "sum" in line and key in NOT_OF_A_SUM:
            raise InputError(f"{where}: key", key, f"{key} in a part of the sum", f"write for example: {SUM_EXAMPLE}")


def _parts(role: str, given: object, where: str) -> tuple[TopicBinding, ...]:
    """The parts of a sum: all columns, or all fields of topics."""
    if ROLES[base_role(role)].unit == "rad":
        raise InputError(where, role, "a role that is not an angle")
    if not isinstance(given, list) or not 2 <= len(given) <= MOST_PARTS:
        raise InputError(where, given, f"a list of 2 to {MOST_PARTS} parts", f"write for example: {SUM_EXAMPLE}")
    for number, line in enumerate(given, 1):
        _reader(where).keys(line, f"part {number}", (), OF_A_PART)
    parts = tuple(_binding(role, line, f"{where}: part {number}") for number, line in enumerate(given, 1))
    if len({part.of_topics for part in parts}) > 1:
        raise InputError(where, "columns and topics", "parts that are all columns, or all fields of topics")
    if len({(part.topic, part.field, part.column) for part in parts}) < len(parts):
        raise InputError(where, "the same part twice", "each part once", "double it with scale: 2.0")
    if len({(part.topic, part.stamp) for part in parts}) > len({part.topic for part in parts}):
        raise InputError(where, "header and log for one topic", "one stamp for all parts of a topic")
    return parts


def _position(line: object, content: Mapping[object, object], where: str) -> dict[str, TopicBinding]:
    """Latitude and longitude of one message: a NavSatFix by default."""
    repeated_roles = [role for role in POSITION if role in content]
    if repeated_roles:
        raise InputError(where, f"{BOTH} and {repeated_roles[0]}", f"either {BOTH}, or {' and '.join(POSITION)}")
    if not isinstance(line, Mapping) or not set(line) <= set(OF_BOTH):
        other_keys = [key for key in line if key not in OF_BOTH] if isinstance(line, Mapping) else [line]
        remedy = f"write for example: {BOTH}: {{topic: /fix, type: {IN_DEGREES}}}; of a table: {' and '.join(POSITION)}"
        raise InputError(where, other_keys[0], f"a mapping with {', '.join(OF_BOTH)}", remedy)
    prefix = f"{checks.text(line['field'], f'{where}: field')}." if "field" in line else ""
    return {role: _binding(role, {"type": IN_DEGREES, **line, "field": prefix + role}, where) for role in POSITION}


def _time(line: object, where: str) -> TopicBinding:
    """The column of the time; a bag has stamps instead."""
    line = _with_column(line, where) if isinstance(line, Mapping) else line
    if not isinstance(line, Mapping) or not set(line) <= set(OF_TIME) or "column" not in line:
        raise InputError(
            where, line, f"column, and if need be {', '.join(OF_TIME[1:])}", "write for example: time: {column: seconds}"
        )
    base_binding: TopicBinding = _reader(where).part(TopicBinding, line, selection=OF_TIME)
    by_unit = _unit(base_binding.unit, "s", where)[1]
    scale, offset = by_unit.scale * base_binding.scale, by_unit.scale * base_binding.offset + by_unit.offset
    if scale <= 0.0:
        raise InputError(f"{where}: scale", scale, "a positive number: seconds in a unit of the column")
    return replace(base_binding, scale=scale, offset=offset, unit="", converts=_converts(line))


def _with_column(line: Mapping[object, object], where: str) -> Mapping[object, object]:
    """The line with its channel as a column, which is another word for the same."""
    if "channel" not in line:
        return line
    if "column" in line:
        raise InputError(where, "channel and column", "one of the two: they mean the same")
    return {"column" if key == "channel" else key: value for key, value in line.items()}


def _unit(given: str, si_unit: str, where: str) -> tuple[str, Conversion]:
    """A unit as named in the table of units, and its conversion to the internal unit; empty without one."""
    factor = conversion(given, si_unit) if given else Conversion(1.0)
    if factor is None:
        remedy = f"or give scale and offset: value [{si_unit}] = scale x raw + offset"
        raise InputError(f"{where}: unit", given, ", ".join(UNITS[si_unit]), remedy)
    return next((name for name, known_factor in UNITS[si_unit].items() if given and known_factor == factor), ""), factor


def _converts(line: Mapping[object, object]) -> bool:
    return "unit" in line or "scale" in line


def _databases(given: object, where: str, folder: Path) -> tuple[tuple[int | None, Path], ...]:
    """Files by bus: one, a list of them, or a mapping from the number of a bus."""
    files = given if isinstance(given, list) else [given]
    pairs: Iterable[tuple[Any, Any]] = given.items() if isinstance(given, Mapping) else [(None, file) for file in files]
    databases: list[tuple[int | None, Path]] = []
    for bus, file in pairs:
        is_valid = isinstance(file, str | PathLike) and str(file).strip() and (bus is None or type(bus) is int)
        if not is_valid:
            raise InputError(where, given, "a file, a list of files, or a mapping from the number of a bus to its file")
        databases.append((bus, folder / Path(file)))
    if not databases:
        raise InputError(where, given, "at least one file")
    return tuple(databases)


def _ways(given: Any, binding: TopicBinding, where: str) -> Ways | None:
    """What the values of a direction mean, by the line, or by the standard that a name is of; of a column the file may say it."""
    if given is None:
        standard = standard_of(binding.column or binding.field.rpartition(".")[2])
        if not standard and binding.topic:
            raise InputError(where, "no values", "values that mean forward and reverse", f"for example: {DIRECTION_EXAMPLE}")
        return STANDARDS[standard] if standard else None
    if isinstance(given, str):
        return STANDARDS[checks.one_of(given, f"{where}: values", tuple(STANDARDS))]
    if not isinstance(given, Mapping) or not {"forward", "reverse"} <= set(given) <= set(WAYS):
        allowed = f"a mapping with {', '.join(WAYS)}, the last if need be, or one of {', '.join(STANDARDS)}"
        raise InputError(f"{where}: values", given, allowed, f"for example: {DIRECTION_EXAMPLE}")
    numbers_by_way = {way: numbers if isinstance(numbers, list) else [numbers] for way, numbers in given.items()}
    ways = Ways(**{way: _reader(where).read(Numbers, numbers, f"values: {way}") for way, numbers in numbers_by_way.items()})
    all_numbers = [*ways.forward, *ways.reverse, *ways.neutral]
    if len(set(all_numbers)) < len(all_numbers):
        raise InputError(f"{where}: values", given, "each value once")
    return ways


def _validity(line: Mapping[object, object], where: str) -> TopicBinding:
    """The source of a validity; its topic and type are by default those of the line."""
    given = line["valid"]
    if not isinstance(given, Mapping) or not set(given) <= set(OF_VALIDITY):
        wrong_key = next((key for key in given if key not in OF_VALIDITY), given) if isinstance(given, Mapping) else given
        raise InputError(
            f"{where}: valid", wrong_key, f"a mapping with {', '.join(OF_VALIDITY)}", f"for example: {VALID_EXAMPLE}"
        )
    shared_keys = (
        {key: line[key] for key in ("topic", "type") if key in line} if "topic" not in given and "field" in given else {}
    )
    binding = _binding("enable", {**shared_keys, **given}, f"{where}: valid")
    if binding.of_topics != ("topic" in line):
        raise InputError(
            f"{where}: valid", given, "a channel of a channel, or a field of a topic", f"for example: {VALID_EXAMPLE}"
        )
    return binding
