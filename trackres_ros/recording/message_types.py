# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Describes message types as this package uses them: fields by name, checked field paths."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, cast

from trackres_ros.errors import InputError, nearest
from trackres_ros.recording.bindings import FieldStep, field_steps

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Typesdict
    from rosbags.typesys.store import Typestore

NUMBERS = {
    "bool": "u1", "byte": "i1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4",
    "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
"""Numbers of the interface definition language, as numpy kind and size."""
BASIC = {"double": "float64", "float": "float32", "boolean": "bool", "octet": "byte"}
"""Numbers that the interface definition language calls otherwise than a .msg file."""
WIDE = "wstring"
"""A text of UTF-16, which libraries for messages lack, or take for a message of that name."""
CONTROL_MSGS = {
    "control_msgs/msg/InterfaceValue": "string[] interface_names\nfloat64[] values",
    "control_msgs/msg/DynamicInterfaceGroupValues": "std_msgs/Header header\nstring[] interface_groups\n"
    "InterfaceValue[] interface_values",
}
"""Fields of the messages of control_msgs, which rosbags does not bring."""
HEADER, TIME = "std_msgs/msg/Header", "builtin_interfaces/msg/Time"


def add_control_msgs(store: Typestore) -> Typestore:
    """A typestore with the ros2_control types of `CONTROL_MSGS` too."""
    from rosbags.typesys import get_types_from_msg

    for name, text in CONTROL_MSGS.items():
        if name not in store.types:
            store.register(get_types_from_msg(text, name))
    return store


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message: a number or string or message, alone, as fixed array, or as sequence."""

    # its name, and the type of an element: a key of `NUMBERS`, ``string``, ``wstring``, or a message type
    name: str
    type: str
    multiplicity: Literal["one", "array", "sequence"]  # ``one``, ``array`` or ``sequence``
    count: int  # length of a fixed array


Definitions = Mapping[str, tuple[Field, ...]]


def message_fields(store: Typestore) -> Typesdict:
    """Return the definitions of a typestore, under the name of this version of rosbags."""
    field_table: Typesdict = getattr(store, "fielddefs", None) or getattr(store, "FIELDDEFS")  # noqa: B009
    return field_table


def definitions(fielddefs: Mapping[str, tuple[object, object]], msgtype: str) -> Definitions:
    """Return the fields of a message type and of all nested types.

    `fielddefs`: `fielddefs` of a rosbags typestore; `msgtype`: ``package/msg/Name``. Raises KeyError if a type is not in the
    typestore.
    """

    def fields(name: str) -> Iterator[Field]:
        for field, desc in cast("list[tuple[str, tuple[int, tuple[tuple[int, object], int]]]]", fielddefs[name][1]):
            multiplicity: Literal["one", "array", "sequence"] = "one"
            element: tuple[int, object] = (desc[0], desc[1])
            count = 1
            if desc[0] > 2:
                multiplicity = "array" if desc[0] == 3 else "sequence"
                element, count = desc[1]
            kind = cast("str", element[1]) if element[0] == 2 else cast("tuple[str, int]", element[1])[0]
            yield Field(field, WIDE if kind.endswith(f"/{WIDE}") else kind, multiplicity, count)

    return with_nested(msgtype, lambda name: tuple(fields(name)))


def with_nested(msgtype: str, fields: Callable[[str], tuple[Field, ...]]) -> Definitions:
    """The fields of a message type and of all nested types, each as a function gives them."""
    definitions_by_name: dict[str, tuple[Field, ...]] = {}
    pending_types = [msgtype]
    while pending_types:
        name = pending_types.pop()
        if name not in definitions_by_name:
            definitions_by_name[name] = fields(name)
            pending_types += [field.type for field in definitions_by_name[name] if "/" in field.type]
    return definitions_by_name


def installed_fields(msgtype: str) -> tuple[Field, ...]:
    """Return the fields of a message type. Raises KeyError if no installed package has it."""
    from rosidl_runtime_py.utilities import get_message

    try:
        message = get_message(msgtype)
    except (ImportError, AttributeError, ValueError):
        raise KeyError(msgtype) from None
    kinds = zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True)
    return tuple(_of_slot(name, kind) for name, kind in kinds)


def _of_slot(name: str, kind: Any) -> Field:
    from rosidl_parser.definition import AbstractNestedType, AbstractString, Array, BasicType, NamespacedType

    multiplicity: Literal["one", "array", "sequence"] = "one"
    count = 1
    if isinstance(kind, AbstractNestedType):
        multiplicity = "array" if isinstance(kind, Array) else "sequence"
        count = kind.size if isinstance(kind, Array) else 1
        kind = kind.value_type
    if isinstance(kind, BasicType):
        return Field(name, BASIC.get(kind.typename, kind.typename), multiplicity, count)
    if isinstance(kind, NamespacedType):
        return Field(name, "/".join([*kind.namespaces, kind.name]), multiplicity, count)
    if isinstance(kind, AbstractString):
        return Field(name, "string", multiplicity, count)
    return Field(name, WIDE, multiplicity, count)


def stamp_path(types: Definitions, msgtype: str) -> tuple[FieldStep, ...]:
    """Return the path of the stamp of a message type, or an empty one: that of its header, or its own field ``stamp``."""
    for field in types[msgtype]:
        if field.multiplicity == "one" and (field.name, field.type) == ("header", HEADER):
            return field_steps("header.stamp")
        if field.multiplicity == "one" and (field.name, field.type) == ("stamp", TIME):
            return field_steps("stamp")
    return ()


def check_field(types: Definitions, msgtype: str, path: str, where: str) -> tuple[FieldStep, ...]:
    """Return the steps of a field path, after checking that it leads to one number.

    Raises InputError for no such field, no number, an array without index, an index outside of a fixed array.
    """
    steps = field_steps(path)
    message_name = msgtype
    for depth, step in enumerate(steps):
        fields = {field.name: field for field in types[message_name]}
        field_list = f"fields of {message_name}: {', '.join(fields)}"
        if step.name not in fields:
            raise InputError(where, path, field_list, nearest(step.name, fields))
        field = fields[step.name]
        has_index = step.index is not None or step.element is not None
        if has_index != (field.multiplicity != "one"):
            allowed = f"an index, as {step.name}[0]" if field.multiplicity != "one" else f"no index: {step.name} is no array"
            raise InputError(where, path, allowed)
        if field.multiplicity == "array" and step.index is not None and step.index >= field.count:
            raise InputError(where, path, f"an index below {field.count}")
        if step.element is not None:
            names = fields.get("name")
            if not names or (names.type, names.multiplicity) != ("string", "sequence") or field.type not in NUMBERS:
                raise InputError(where, path, f"an element by name only with a field string[] name; {field_list}")
        last = depth == len(steps) - 1
        if last and field.type not in NUMBERS:
            remedy = (
                f"it holds {', '.join(fields_within.name for fields_within in types[field.type])}" if field.type in types else ""
            )
            raise InputError(where, path, f"a number, not {field.type}", remedy)
        if not last and field.type not in types:
            raise InputError(where, path, f"nothing after {step.name}, which is {field.type}")
        message_name = field.type
    return steps
