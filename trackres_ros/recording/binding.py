# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines the source of a role: a field of a topic, a column of a table, or the sum of several."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Annotated, Literal, cast

import numpy as np
from numpy.typing import NDArray

from trackres_ros import checks
from trackres_ros.errors import InputError
from trackres_ros.files.dataclass_reader import FILLED, Limits
from trackres_ros.recording.directions import Ways
from trackres_ros.recording.roles import BRAKE_ON_PA

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

    def meant(self, numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert scaled numbers: of modes to 1 for those in `values`, else 0; of a direction to its way; nan stays."""
        if self.ways is not None:
            return self.ways.meant(numbers)
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
    found = STEP.findall(path)
    return tuple(
        FieldStep(name, int(part)) if part.isdecimal() else FieldStep(name, element=part or None) for name, part in found
    )
