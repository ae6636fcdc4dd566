# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds the definition of a topic's message type: that of the bag, else the common or the installed one."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from trackres_ros.errors import InputError
from trackres_ros.recording.cdr import Encoding
from trackres_ros.recording.message_types import Definitions, check_size, definitions, message_fields
from trackres_ros.recording.reading import reading
from trackres_ros.recording.ros_bag import RosTopic
from trackres_ros.recording.ros_types import types_of_text, with_installed
from trackres_ros.recording.unpacking import MAX_MESSAGE_BYTES

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.interfaces.typing import Typesdict


@lru_cache
def _common(encoding: Encoding) -> Typesdict:
    """Return the definitions of the common types."""
    from rosbags.typesys import Stores, get_typestore

    return message_fields(get_typestore(Stores.ROS1_NOETIC if encoding is Encoding.ROS1 else Stores.LATEST))


@lru_cache
def _own_definitions(text: str, msgtype: str) -> Typesdict:
    """Return the definitions in a bag's text of a type."""
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    separator = "=" * 80 + "\n"
    if not text.startswith(f"{separator}IDL: "):
        return get_types_from_msg(text, msgtype) if text else {}
    own: Typesdict = {}
    for part in text.split(separator)[1:]:
        own.update(get_types_from_idl(part.partition("\n")[2]))
    return own


def _finder(one: Connection | RosTopic, encoding: Encoding) -> Callable[[], Definitions]:
    """Read the definition in the bag; return a function that adds missing ones, or raises KeyError."""
    if isinstance(one, RosTopic):
        of_ros = types_of_text(one.msgtype, one.msgdef)
        return lambda: with_installed(of_ros, one.msgtype)
    own = _own_definitions(one.msgdef if isinstance(one.msgdef, str) else one.msgdef.data, one.msgtype)
    return lambda: definitions({**_common(encoding), **own}, one.msgtype)


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
