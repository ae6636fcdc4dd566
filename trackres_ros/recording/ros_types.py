# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Looks up message types with the libraries of ROS 2: in the bag's text, else in the installed packages."""

from __future__ import annotations

from typing import Any, Literal

from trackres_ros.recording.message_types import Definitions, Field

SEPARATOR = "=" * 80 + "\n"
BASIC = {"double": "float64", "float": "float32", "boolean": "bool", "octet": "byte"}
"""Numbers that the interface definition language calls otherwise than a .msg file."""
EMPTY = (Field("structure_needs_at_least_one_member", "uint8", "one", 1),)
"""Content of a message without fields on the wire."""
WIDE = "wstring"


def types_of_text(msgtype: str, text: str) -> Definitions:
    """Return the types in a bag's definition: its own, and after separators the nested ones.

    Raises Exception from rosidl_adapter, for an invalid text. `msgtype`: ``package/msg/Name``; `text`: the definition. One of the
    interface definition language gives nothing: such types are the installed ones.
    """
    from rosidl_adapter.parser import parse_message_string

    found: dict[str, tuple[Field, ...]] = {}
    if not text.strip() or text.startswith(f"{SEPARATOR}IDL: "):
        return found
    for place, part in enumerate(text.split(SEPARATOR)):
        name, body = msgtype, part
        if place:
            head, _, body = part.partition("\n")
            package, _, last = head.removeprefix("MSG: ").strip().partition("/")
            name = f"{package}/msg/{last.rpartition('/')[2]}"
        package, last = name.split("/")[0], name.rpartition("/")[2]
        found[name] = tuple(map(_of_field, parse_message_string(package, last, body).fields)) or EMPTY
    return found


def with_installed(own: Definitions, msgtype: str) -> Definitions:
    """Return the fields of a message type and of all nested types, from installed packages where `own` lacks them.

    Raises KeyError if no package has a type, or it has a text of wide characters.
    """
    found: dict[str, tuple[Field, ...]] = {}
    wanted = [msgtype]
    while wanted:
        name = wanted.pop()
        if name not in found:
            found[name] = own[name] if name in own else _installed(name)
            kinds = [field.type for field in found[name]]
            if WIDE in kinds:
                raise KeyError(WIDE)
            wanted += [kind for kind in kinds if "/" in kind]
    return found


def _of_field(field: Any) -> Field:
    kind = field.type.type
    if not field.type.is_primitive_type():
        kind = f"{field.type.pkg_name}/msg/{kind}"
    many: Literal["one", "array", "sequence"] = "one"
    if field.type.is_array:
        many = "array" if field.type.array_size and not field.type.is_upper_bound else "sequence"
    return Field(field.name, kind, many, (field.type.array_size or 1) if many == "array" else 1)


def _installed(msgtype: str) -> tuple[Field, ...]:
    """Return the fields of a type of an installed package."""
    from rosidl_runtime_py.utilities import get_message

    try:
        message = get_message(msgtype)
    except (ImportError, AttributeError, ValueError):
        raise KeyError(msgtype) from None
    kinds = zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True)
    return tuple(_of_slot(name, kind) for name, kind in kinds) or EMPTY


def _of_slot(name: str, kind: Any) -> Field:
    from rosidl_parser.definition import AbstractNestedType, AbstractString, Array, BasicType, NamespacedType

    many: Literal["one", "array", "sequence"] = "one"
    count = 1
    if isinstance(kind, AbstractNestedType):
        many = "array" if isinstance(kind, Array) else "sequence"
        count = kind.size if isinstance(kind, Array) else 1
        kind = kind.value_type
    if isinstance(kind, BasicType):
        return Field(name, BASIC.get(kind.typename, kind.typename), many, count)
    if isinstance(kind, NamespacedType):
        return Field(name, "/".join([*kind.namespaces, kind.name]), many, count)
    if isinstance(kind, AbstractString):
        return Field(name, "string", many, count)
    return Field(name, WIDE, many, count)
