# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Binds topics and fields, or columns, to roles: the topics file of bags, tables and the live node."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from types import MappingProxyType
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from trackres_ros import checks
from trackres_ros.errors import InputError, nearest
from trackres_ros.files.yamls import read_yaml
from trackres_ros.recording.roles import ANGLES, BRAKE_ON_PA, PASSENGER_KG, POSITION, ROLES, base_role
from trackres_ros.units import DEGREE

KEYS = (
    "topic", "type", "field", "column", "scale", "offset", "stamp", "max_age_s", "sensor", "std_k", "delay_s",
    "unit", "kg_each", "threshold", "values",
)  # fmt: skip
ONLY_FOR = {
    "sensor": ("belt",),
    "std_k": ("belt",),
    "delay_s": ("torque",),
    "unit": ANGLES,
    "kg_each": ("passengers",),
    "threshold": ("brake",),
    "values": ("enable",),
}
"""Keys that have a meaning for some roles alone."""
TIME = "time"
"""The line that names the column of the time in a table; no role, as every sample has its time."""
BOTH = "position"
"""The line that stands for latitude and longitude of one message."""
OF_BOTH = ("topic", "type", "field", "stamp", "max_age_s", "unit")
"""Its keys: the field is that which holds the two."""
IN_DEGREES = "sensor_msgs/msg/NavSatFix"
"""The message type whose latitude and longitude are in degrees by its definition."""
FIX, NO_FIX = "status.status", -1
"""Where such a message says whether there is a fix, and that there is none."""
STEP = re.compile(r"([A-Za-z_]\w*)(?:\[([^\[\]]+)\])?")
MESSAGE_TYPE = re.compile(r"([A-Za-z]\w*)/(?:msg/)?([A-Za-z]\w*)")
PART = re.compile(r"[A-Za-z0-9_\-]+")
MOST_DELAY_S = 10.0
MOST_KG_EACH = 500.0  # with what somebody may carry
LARGEST = 1e300  # a whole number may be larger than any float
EXAMPLE = "speed: {topic: /vehicle/speed, type: geometry_msgs/msg/TwistStamped, field: twist.linear.x}"


@dataclass(frozen=True, slots=True)
class FieldStep:
    """One step of a field path: a field, and for an array the index or the name of the element.

    A name is looked up in the string array ``name`` beside the field, as in ``sensor_msgs/msg/JointState``.
    """

    name: str
    index: int | None = None
    element: str | None = None


@dataclass(frozen=True, slots=True)
class TopicBinding:
    """Where one role comes from: a field of a topic, or a column of a table.

    Attributes
    ----------
    topic, type, field : str
        Topic, message type as ``package/msg/Name``, and dotted field path; empty for a column.
    column : str
        Column of a table; empty for a topic.
    scale, offset : float
        The value in the unit of the role is ``scale * raw + offset``; of an angle given in degrees they turn it into rad.
    stamp : str
        ``header``, ``log``, or empty: the header's where the type has one, else log time.
    max_age_s : float or None
        Live: an older sample is not used [s].
    sensor : str
        Of a belt temperature: what is measured, ``surface`` or ``mean``.
    std_k : float
        Standard deviation of a belt temperature [K].
    delay_s : float
        By how much a torque comes late [s]: what is shown was so that long before its stamp.
    unit : str
        Of an angle: ``deg``, ``rad``, or empty; then a position is told by its values, and any other angle is in rad.
    kg_each : float
        Of passengers: mass of one [kg].
    threshold : float or None
        Of a brake: from which value on it brakes; None where nobody says.
    values : tuple of float
        Of an enable that comes as a mode: the modes in which the feed-forward is wanted; empty where it comes as 1 or 0.
    """

    topic: str = ""
    type: str = ""
    field: str = ""
    column: str = ""
    scale: float = 1.0
    offset: float = 0.0
    stamp: Literal["header", "log", ""] = ""
    max_age_s: float | None = None
    sensor: Literal["surface", "mean"] = "surface"
    std_k: float = 3.0
    delay_s: float = 0.0
    unit: Literal["deg", "rad", ""] = ""
    kg_each: float = PASSENGER_KG
    threshold: float | None = None
    values: tuple[float, ...] = ()

    def meant(self, numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        """What scaled numbers mean: 1 for the modes in `values`, 0 for others, nan for nan; the numbers themselves without."""
        if not self.values:
            return numbers
        return np.where(np.isnan(numbers), np.nan, np.isin(numbers, self.values).astype(float))

    def brakes_from(self, values: NDArray[np.float64]) -> float:
        """The value from which a brake is on: the threshold, else half of a switch's 0 and 1, else `BRAKE_ON_PA`."""
        if self.threshold is not None:
            return self.threshold
        return 0.5 if np.isin(values, (0.0, 1.0)).all() else BRAKE_ON_PA

    @property
    def delay_ns(self) -> int:
        """The delay [ns]."""
        return round(self.delay_s * 1e9)

    @property
    def steps(self) -> tuple[FieldStep, ...]:
        """The steps of the field path."""
        return field_steps(self.field)

    @property
    def fix(self) -> str:
        """The field path of what says whether the message holds a fix; empty where its type has none."""
        return FIX if self.type == IN_DEGREES else ""

    def read(self, message: object) -> float:
        """Return the value of this role in a decoded message, in the unit of the role; nan of a receiver without a fix.

        Raises
        ------
        LookupError
            The message has no such element (of a joint that is not in it, for one).
        AttributeError
            The type of the message has no such field.
        """
        if self.fix and attrgetter(self.fix)(message) == NO_FIX:
            return math.nan
        value = message
        for step in self.steps:
            parent, value = value, getattr(value, step.name)
            if step.element is not None:
                names = list(getattr(parent, "name"))  # noqa: B009 - of any message type
                if step.element not in names:
                    raise LookupError(step.element)
                value = cast("list[object]", value)[names.index(step.element)]
            elif step.index is not None:
                value = cast("list[object]", value)[step.index]
        return self.scale * float(cast("float", value)) + self.offset


@dataclass(frozen=True, slots=True)
class Topics:
    """A mapping of role to binding, and where it is from.

    Attributes
    ----------
    bindings : mapping of str to TopicBinding
        By role, qualified where the file says so (``load/front``).
    origin : str
        The file, for messages to the user.
    time : TopicBinding, optional
        The column of the time in a table, where it is not ``time_s``.
    """

    bindings: Mapping[str, TopicBinding]
    origin: str = "topics"
    time: TopicBinding | None = None

    def __getitem__(self, role: str) -> TopicBinding:
        return self.bindings[role]

    def __iter__(self) -> Iterator[str]:
        return iter(self.bindings)

    def __len__(self) -> int:
        return len(self.bindings)

    def __contains__(self, role: object) -> bool:
        return role in self.bindings

    @classmethod
    def load(cls, path: Path) -> Topics:
        """Read a topics file.

        Raises
        ------
        InputError
            The file is not there, no YAML, or says something that is not allowed: which role and key.
        """
        return cls.parse(read_yaml(path, "a mapping with one line a role", f"write for example: {EXAMPLE}"), str(path))

    @classmethod
    def parse(cls, content: object, origin: str = "topics") -> Topics:
        """Check the content of a topics file.

        Parameters
        ----------
        content : mapping of str to mapping
            What the YAML holds.
        origin : str
            Its file, for messages.

        Raises
        ------
        InputError
            Unknown role or key, missing or impossible value.
        """
        if not isinstance(content, Mapping) or not content:
            raise InputError(origin, content, "a mapping with one line a role", f"write for example: {EXAMPLE}")
        bindings: dict[str, TopicBinding] = {}
        for role, line in content.items():
            if role == BOTH:
                bindings |= _position(line, content, f"{origin}: {role}")
            elif role != TIME:
                _check_role(role, origin)
                bindings[role] = _binding(role, line, f"{origin}: {role}")
        time = _time(content[TIME], f"{origin}: {TIME}") if TIME in content else None
        return cls(MappingProxyType(bindings), origin, time)


def field_steps(path: str) -> tuple[FieldStep, ...]:
    """Split a field path into its steps: ``twist.linear.x``, ``effort[NAME]``, ``data[3]``.

    Raises
    ------
    ValueError
        It is no field path.
    """
    steps, rest = [], path
    while True:
        match = STEP.match(rest)
        if not match:
            raise ValueError(f"no field path: {path!r}")
        name, element = match.group(1), match.group(2)
        if element is None:
            steps.append(FieldStep(name))
        elif element.isdecimal():
            steps.append(FieldStep(name, index=int(element)))
        else:
            steps.append(FieldStep(name, element=element))
        rest = rest[match.end() :]
        if not rest:
            return tuple(steps)
        if rest[0] != ".":
            raise ValueError(f"no field path: {path!r}")
        rest = rest[1:]


def message_type(name: str) -> str:
    """Return a message type as ``package/msg/Name``, also from the ``package/Name`` of ROS 1.

    Raises
    ------
    ValueError
        It is no message type.
    """
    match = MESSAGE_TYPE.fullmatch(name)
    if not match:
        raise ValueError(f"no message type: {name!r}")
    return f"{match.group(1)}/msg/{match.group(2)}"


def _check_role(role: object, origin: str) -> None:
    allowed = ", ".join((*ROLES, BOTH, TIME))
    if not isinstance(role, str) or base_role(role) not in ROLES:
        raise InputError(f"{origin}: role", role, allowed, nearest(str(role).partition("/")[0], ROLES))
    base, slash, part = role.partition("/")
    if slash and not ROLES[base].parts:
        parts = ", ".join(name for name, about in ROLES.items() if about.parts)
        raise InputError(f"{origin}: role", role, f"an axle, assembly or wheel only for {parts}", f"write {base}")
    if slash and not PART.fullmatch(part):
        raise InputError(f"{origin}: role", role, f"{base}/NAME with the name of an axle, assembly or wheel")


def _binding(role: str, line: object, where: str) -> TopicBinding:
    if not isinstance(line, Mapping):
        raise InputError(where, line, "a mapping with topic, type and field, or with column", f"for example: {EXAMPLE}")
    for key in line:
        checks.one_of(key, f"{where}: key", KEYS)
        meant = ONLY_FOR.get(key)
        if meant and base_role(role) not in meant:
            raise InputError(f"{where}: key", key, f"{key} only for {', '.join(meant)}")
        if "column" in line and key in ("topic", "type", "field", "stamp", "max_age_s"):
            raise InputError(f"{where}: key", key, "either column, or topic with type and field")
    texts = {key: _text(line, key, where) for key in ("topic", "type", "field", "column")}
    if not texts["column"]:
        missing = [key for key in ("topic", "type", "field") if not texts[key]]
        if missing:
            raise InputError(where, f"no {missing[0]}", "topic, type and field, or column", f"for example: {EXAMPLE}")
        try:
            texts["type"] = message_type(texts["type"])
        except ValueError:
            raise InputError(f"{where}: type", texts["type"], "package/msg/Name") from None
        try:
            field_steps(texts["field"])
        except ValueError:
            allowed = "a path such as twist.linear.x, effort[NAME] or data[3]"
            raise InputError(f"{where}: field", texts["field"], allowed) from None
    max_age_s = _number(line, "max_age_s", 0.0, where) if "max_age_s" in line else None
    unit = _choice(line, "unit", ("deg", "rad"), "", where)
    if not unit and role in POSITION and texts["type"] == IN_DEGREES:
        unit = "deg"
    turned = DEGREE if unit == "deg" else 1.0
    binding = TopicBinding(
        **texts,
        scale=turned * _number(line, "scale", 1.0, where),
        offset=turned * _number(line, "offset", 0.0, where),
        stamp=cast("Literal['header', 'log', '']", _choice(line, "stamp", ("header", "log"), "", where)),
        max_age_s=max_age_s,
        sensor=cast("Literal['surface', 'mean']", _choice(line, "sensor", ("surface", "mean"), "surface", where)),
        std_k=_number(line, "std_k", 3.0, where),
        delay_s=checks.number(line.get("delay_s", 0.0), f"{where}: delay_s", 0.0, MOST_DELAY_S, "s"),
        unit=cast("Literal['deg', 'rad', '']", unit),
        kg_each=checks.number(line.get("kg_each", PASSENGER_KG), f"{where}: kg_each", 1.0, MOST_KG_EACH, "kg"),
        threshold=_number(line, "threshold", 0.0, where) if "threshold" in line else None,
        values=_values(line["values"], f"{where}: values") if "values" in line else (),
    )
    if binding.scale == 0.0:
        raise InputError(f"{where}: scale", 0.0, "a finite number that is not 0")
    for key, number in (("max_age_s", max_age_s), ("std_k", binding.std_k), ("threshold", binding.threshold)):
        if number is not None and number <= 0.0:
            raise InputError(f"{where}: {key}", number, "a positive number")
    return binding


def _position(line: object, content: Mapping[object, object], where: str) -> dict[str, TopicBinding]:
    """Latitude and longitude of one message: of a NavSatFix, where no type is named."""
    twice = [role for role in POSITION if role in content]
    if twice:
        raise InputError(where, f"{BOTH} and {twice[0]}", f"either {BOTH}, or {' and '.join(POSITION)}")
    if not isinstance(line, Mapping) or not set(line) <= set(OF_BOTH):
        other = [key for key in line if key not in OF_BOTH] if isinstance(line, Mapping) else [line]
        remedy = f"write for example: {BOTH}: {{topic: /fix, type: {IN_DEGREES}}}; of a table: {' and '.join(POSITION)}"
        raise InputError(where, other[0], f"a mapping with {', '.join(OF_BOTH)}", remedy)
    within = f"{_text(line, 'field', where)}." if "field" in line else ""
    return {role: _binding(role, {"type": IN_DEGREES, **line, "field": within + role}, where) for role in POSITION}


def _time(line: object, where: str) -> TopicBinding:
    """The column of the time; a bag has stamps instead."""
    if not isinstance(line, Mapping) or not set(line) <= {"column", "scale", "offset"} or "column" not in line:
        raise InputError(where, line, "column, scale and offset", "write for example: time: {column: seconds}")
    scale = _number(line, "scale", 1.0, where)
    if scale <= 0.0:
        raise InputError(f"{where}: scale", scale, "a positive number: seconds in a unit of the column")
    return TopicBinding(column=_text(line, "column", where), scale=scale, offset=_number(line, "offset", 0.0, where))


def _text(line: Mapping[object, object], key: str, where: str) -> str:
    text = line.get(key, "")
    if not isinstance(text, str) or (key in line and not text.strip()):
        raise InputError(f"{where}: {key}", text, "a text that is not empty")
    return text


def _number(line: Mapping[object, object], key: str, default: float, where: str) -> float:
    number = line.get(key, default)
    if isinstance(number, bool) or not isinstance(number, int | float) or not abs(number) < LARGEST:
        raise InputError(f"{where}: {key}", number, "a finite number")
    return float(number)


def _values(given: object, where: str) -> tuple[float, ...]:
    if not isinstance(given, list) or not given:
        raise InputError(where, given, "a list of numbers: the modes in which the feed-forward is wanted", "for example: [1, 2]")
    return tuple(_number({"value": number}, "value", 0.0, where) for number in given)


def _choice(line: Mapping[object, object], key: str, allowed: tuple[str, ...], default: str, where: str) -> str:
    return checks.one_of(line[key], f"{where}: {key}", allowed) if key in line else default
