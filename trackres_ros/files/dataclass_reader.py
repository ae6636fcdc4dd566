# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads plain data, such as the content of a YAML file, into annotated dataclasses. All settings and descriptions come this way.

A dataclass is a mapping with its fields as keys; a field with a default may be missing. ``Annotated`` adds what the type does not
say: `Limits`, `FILLED`, or a check such as `checks.positive`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

from trackres_ros import checks
from trackres_ros.errors import InputError

ABSENT: Any = None
"""Default of a key that may be missing, but not empty."""
FILLED = "filled"
"""Note of a list or mapping with at least one entry."""


class Limits(NamedTuple):
    """Unit, absolute limits and meaning of a number."""

    unit: str
    low: float
    high: float
    meaning: str


class Field(NamedTuple):
    """A key of a mapping: its kind, and whether it is required."""

    name: str
    kind: Any
    is_required: bool


def _fields_of(part: Any) -> tuple[Field, ...]:
    """The keys from which a dataclass is read, in their order. Limits may be in the metadata of a field too."""
    kinds, keys = get_type_hints(part, include_extras=True), []
    for item in fields(part):
        limits, kind = item.metadata.get("limits"), kinds[item.name]
        is_required = item.default is MISSING and item.default_factory is MISSING
        keys.append(Field(item.name, Annotated[kind, limits] if limits else kind, is_required))
    return tuple(keys)


fields_of: Callable[[Any], tuple[Field, ...]] = cache(_fields_of)


def limits_of(part: Any) -> dict[str, Limits]:
    """The limits of the numbers of a dataclass, by name."""
    return {field.name: note for field in fields_of(part) for note in notes_of(field.kind) if isinstance(note, Limits)}


def notes_of(kind: Any) -> tuple[Any, ...]:
    """What ``Annotated`` adds to a type."""
    return get_args(kind)[1:] if get_origin(kind) is Annotated else ()


def words_of(kind: Any) -> tuple[str, ...]:
    """The words that a kind allows, or a list of it; empty if it is of another form."""
    element_kind = get_args(kind)[0] if get_origin(kind) is tuple else kind
    return get_args(element_kind) if get_origin(element_kind) is Literal else ()


def check_values(part: Any, origin: str) -> None:
    """Check the values of a dataclass as if it were read. Raises InputError."""
    for field in fields_of(type(part)):
        DataReader(f"{origin} {field.name}").read(field.kind, getattr(part, field.name))


class DataReader:
    """Reads annotated kinds. An error names the place: the origin, and the keys that lead there.

    `origin`: the file, for messages; `mark`: between two keys of a place. A part of a list is called by its name, once that is
    known. Every method raises InputError for a missing, unknown or bad value.
    """

    def __init__(self, origin: object, mark: str = ".") -> None:
        self.origin, self.mark = origin, mark

    def where(self, key: str) -> str:
        """Place of a key, for messages."""
        return f"{self.origin}: {key}" if key else str(self.origin)

    def subkey(self, key: str, name: object) -> str:
        """A key within that of a mapping."""
        return f"{key}{self.mark}{name}" if key else str(name)

    def read(self, kind: Any, value: Any, key: str = "", is_filled: bool = False) -> Any:
        """Read a value of any kind. `is_filled`: whether a list or mapping must have an entry."""
        notes = notes_of(kind)
        if notes:
            return self.read_noted(get_args(kind)[0], notes[0], value, key)
        form = get_origin(kind) or kind
        if is_dataclass(kind):
            return self.part(kind, value, key)
        if form is Literal:
            return self._choice(get_args(kind), value, key)
        if form in (Union, UnionType):
            return self._one_of_kinds(get_args(kind), value, key)
        if form is tuple:
            return self._list(get_args(kind)[0], value, key, is_filled)
        if form is Mapping:
            return self._mapping(get_args(kind)[1], value, key, is_filled)
        if kind in CHECKS:
            return CHECKS[kind](value, self.where(key))
        return value  # of any kind

    def read_noted(self, kind: Any, note: Any, value: Any, key: str) -> Any:
        """Read a value with a note: its limits, `FILLED`, or a function of the value and its place that checks it."""
        if note is FILLED:
            return self.read(kind, value, key, is_filled=True)
        if not isinstance(note, Limits):
            return note(value, self.where(key))
        unit = "" if note.unit == "1" else note.unit
        if kind is int:
            return checks.whole(value, self.where(key), int(note.low), int(note.high), unit)
        return checks.number(value, self.where(key), note.low, note.high, unit)

    def part(
        self, kind: Any, mapping: Any, key: str = "", selection: Iterable[str] = (), other_keys: Iterable[str] = (), **values: Any
    ) -> Any:
        """Read a dataclass.

        `selection`: its keys, if not all fields have one; `other_keys`: keys that the caller reads;
        `values`: fields that are no keys.
        """
        key_fields = [f for f in fields_of(kind) if f.name not in values and (not selection or f.name in selection)]
        required_keys = [f.name for f in key_fields if f.is_required]
        self.keys(mapping, key, required_keys, [*(f.name for f in key_fields if not f.is_required), *other_keys])
        for field in key_fields:
            if field.name in mapping:
                values[field.name] = self.read(field.kind, mapping[field.name], self.subkey(key, field.name))
                if field.name == "name" and key.endswith("]"):
                    key = self.subkey(key.rpartition("[")[0], values["name"])
        return kind(**values)

    def keys(self, mapping: Any, key: str, required_keys: Iterable[str], optional_keys: Iterable[str] = ()) -> None:
        """Refuse anything but a mapping with all required keys and no unknown ones."""
        allowed = [*required_keys, *optional_keys]
        if not isinstance(mapping, Mapping):
            raise InputError(self.where(key), mapping, f"a mapping with the keys {', '.join(allowed)}")
        for name in mapping:
            checks.one_of(name, self.where(self.subkey(key, name)), allowed)
        for name in required_keys:
            if name not in mapping:
                raise InputError(self.where(self.subkey(key, name)), "nothing", "this key is required")

    def _choice(self, allowed: tuple[Any, ...], value: Any, key: str) -> Any:
        words = [word for word in allowed if isinstance(word, str) and word]
        if words:
            return checks.one_of(value, self.where(key), words)
        if value not in allowed:
            raise InputError(self.where(key), value, ", ".join(map(str, allowed)))
        return value

    def _list(self, kind: Any, value: Any, key: str, is_filled: bool) -> tuple[Any, ...]:
        if not isinstance(value, list | tuple) or (is_filled and not value):
            raise InputError(self.where(key), value, "a list with at least one entry" if is_filled else "a list")
        return tuple(self.read(kind, entry, f"{key}[{i}]") for i, entry in enumerate(value))

    def _mapping(self, kind: Any, value: Any, key: str, is_filled: bool) -> dict[str, Any]:
        if not isinstance(value, Mapping) or (is_filled and not value):
            raise InputError(self.where(key), value, "a mapping with at least one entry" if is_filled else "a mapping")
        if is_dataclass(kind) and any(field.name == "name" for field in fields_of(kind)):
            return {str(name): self.part(kind, entry, self.subkey(key, name), name=str(name)) for name, entry in value.items()}
        return {str(name): self.read(kind, entry, self.subkey(key, name)) for name, entry in value.items()}

    def _one_of_kinds(self, kinds: tuple[Any, ...], value: Any, key: str) -> Any:
        """The first kind that a value has the form of; of several dataclasses the one that the key ``form`` names."""
        parts = {kind.form: kind for kind in kinds if is_dataclass(kind) and hasattr(kind, "form")}
        if parts:
            form = value.get("form") if isinstance(value, Mapping) else None
            if form is None:
                raise InputError(self.where(key), value, f"a mapping with a form, one of {', '.join(parts)}")
            form = checks.one_of(form, self.where(self.subkey(key, "form")), parts)
            return self.part(parts[form], value, key, other_keys=("form",))
        kind = next((kind for kind in kinds if _has_form(kind, value)), None)
        if kind is None:
            forms = [_form_of(kind)[1] for kind in kinds if kind is not NoneType]
            raise InputError(self.where(key), value, " or ".join(forms))
        return None if kind is NoneType else self.read(kind, value, key)


CHECKS = {str: checks.text, bool: checks.switch, float: checks.finite}
FORMS: Mapping[Any, tuple[Any, str]] = {
    str: (str, "a text"),
    Literal: (str, "a word"),
    bool: (bool, "true or false"),
    int: (int, "a whole number"),
    float: ((int, float), "a number"),
    tuple: ((list, tuple), "a list"),
    Mapping: (Mapping, "a mapping"),
    NoneType: (NoneType, ""),
}
"""Plain data of each kind, and its name in messages."""


def _form_of(kind: Any) -> tuple[Any, str]:
    base = get_args(kind)[0] if notes_of(kind) else kind
    if is_dataclass(base):
        return Mapping, f"a mapping with the keys {', '.join(field.name for field in fields_of(base))}"
    return FORMS[get_origin(base) or base]


def _has_form(kind: Any, value: Any) -> bool:
    plain_kind = _form_of(kind)[0]
    return isinstance(value, plain_kind) and (plain_kind is bool or not isinstance(value, bool))
