# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds the definition of a topic's message type: that of the bag, else the common or the installed one."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from trackres_ros.errors import InputError
from trackres_ros.recording.cdr import Encoding
from trackres_ros.recording.message_types import (
    WIDE,
    Definitions,
    Field,
    check_size,
    definitions,
    installed_fields,
    message_fields,
    with_nested,
)
from trackres_ros.recording.reading import reading
from trackres_ros.recording.ros_bag import RosTopic
from trackres_ros.recording.unpacking import MAX_MESSAGE_BYTES

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.interfaces.typing import Typesdict

SEPARATOR = "=" * 80 + "\n"
EMPTY = (Field("structure_needs_at_least_one_member", "uint8", "one", 1),)
"""Content of a message without fields on the wire."""


def types_of_text(msgtype: str, text: str) -> Definitions:
    """Return the types in a bag's definition: its own, and after separators the nested ones.

    `msgtype`: ``package/msg/Name``; `text`: the definition. One of the interface definition language gives nothing: such types
    are the installed ones. Raises Exception from rosidl_adapter, for an invalid text.
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
        found[name] = tuple(map(_of_field, parse_message_string(package, last, body).fields))
    return found


def with_installed(own: Definitions, msgtype: str) -> Definitions:
    """Return the fields of a message type and of all nested types, from installed packages where `own` lacks them.

    Raises KeyError if no package has a type, or it has a text of wide characters.
    """

    def fields(name: str) -> tuple[Field, ...]:
        found = own[name] if name in own else installed_fields(name)
        if any(field.type == WIDE for field in found):
            raise KeyError(WIDE)
        return found or EMPTY

    return with_nested(msgtype, fields)


def _of_field(field: Any) -> Field:
    kind = field.type.type
    if not field.type.is_primitive_type():
        kind = f"{field.type.pkg_name}/msg/{kind}"
    many: Literal["one", "array", "sequence"] = "one"
    if field.type.is_array:
        many = "array" if field.type.array_size and not field.type.is_upper_bound else "sequence"
    return Field(field.name, kind, many, (field.type.array_size or 1) if many == "array" else 1)


@lru_cache
def _common(encoding: Encoding) -> Typesdict:
    """Return the definitions of the common types."""
    from rosbags.typesys import Stores, get_typestore

    return message_fields(get_typestore(Stores.ROS1_NOETIC if encoding is Encoding.ROS1 else Stores.LATEST))


@lru_cache
def _own_definitions(text: str, msgtype: str) -> Typesdict:
    """Return the definitions in a bag's text of a type."""
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    if not text.startswith(f"{SEPARATOR}IDL: "):
        return get_types_from_msg(text, msgtype) if text else {}
    own: Typesdict = {}
    for part in text.split(SEPARATOR)[1:]:
        own.update(get_types_from_idl(part.partition("\n")[2]))
    return own


def _finder(one: Connection | RosTopic, encoding: Encoding) -> Callable[[], Definitions]:
    """Read the definition in the bag; return a function that adds missing ones, or raises KeyError."""
    if isinstance(one, RosTopic):
        of_ros = types_of_text(one.msgtype, one.msgdef)
        return lambda: with_installed(of_ros, one.msgtype)
    own = _own_definitions(one.msgdef if isinstance(one.msgdef, str) else one.msgdef.data, one.msgtype)

    def complete() -> Definitions:
        try:
            return definitions(own, one.msgtype)
        except KeyError:  # the common types take a while to load
            return definitions({**_common(encoding), **own}, one.msgtype)

    return complete


def types_of(one: Connection | RosTopic, path: Path, encoding: Encoding) -> Definitions:
    """Return the definition of a connection's type: the bag's if present, else the common one."""
    where = f"{path}: {one.topic}"
    try:
        with reading(Path(where), f"a readable definition of {one.msgtype}"):
            find = _finder(one, encoding)
        types = find()
    except KeyError as error:
        raise InputError(
            where,
            f"{one.msgtype} with {error}",
            "a message type with its definition",
            "the bag does not define it: record as MCAP, which does",
        ) from None
    check_size(types, one.msgtype, where, MAX_MESSAGE_BYTES)
    return types
