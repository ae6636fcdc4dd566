# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads values from a vehicle file and checks each. Every value must be stated explicitly."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from trackres_ros import checks
from trackres_ros.arrays import Array
from trackres_ros.errors import InputError, nearest
from trackres_ros.vehicle import schema
from trackres_ros.vehicle.description import Disturbance, Drift, Quantity, QuantityLimits, Spells

QUANTITY_KEYS = ("value", "unit", "flag", "range", "reason")
FITTED = "F"
FLAGS = ("P", "L", "A", FITTED)
FORMS: Mapping[str, type[Spells | Drift]] = {kind.form: kind for kind in (Spells, Drift)}


@dataclass(frozen=True, slots=True)
class Known:
    """What several vehicles of one content have in common, once it is read and checked."""

    quantities: dict[str, tuple[Any, Quantity]] = field(default_factory=dict)  # by path, each with its entry in the content
    sweeps: dict[Path, tuple[Array, Array, Array]] = field(default_factory=dict)  # of rubber files


class ValueReader:
    """Reads values from one nested mapping, records each quantity by its path, and refuses invalid ones.

    `known`: shared by readers of one content, so that each checks only what an override changes.
    """

    def __init__(self, path: Path, overrides: Mapping[str, float] | None = None, known: Known | None = None) -> None:
        self.path = path
        self.known = Known() if known is None else known
        self.parameters: dict[str, Quantity] = {}
        self._overrides = dict(overrides or {})

    def where(self, key: str) -> str:
        """Place of a key, for messages."""
        return f"{self.path}: {key}"

    def keys(self, mapping: Any, key: str, required: tuple[str, ...], optional: tuple[str, ...] = ()) -> dict[str, Any]:
        """`mapping` itself, if it has all required keys and no unknown ones."""
        allowed = (*required, *optional)
        if not isinstance(mapping, dict):
            raise InputError(self.where(key), mapping, f"a mapping with the keys {', '.join(allowed)}")
        for name in required:
            if name not in mapping:
                raise InputError(self.where(f"{key}.{name}" if key else name), "nothing", "this key is required")
        for name in mapping:
            checks.one_of(name, self.where(f"{key}.{name}" if key else str(name)), allowed)
        return mapping

    def text(self, value: Any, key: str, allowed: tuple[str, ...] = ()) -> str:
        """A non-empty string, one of `allowed` if given."""
        if allowed:
            return checks.one_of(value, self.where(key), allowed)
        if not isinstance(value, str) or not value.strip():
            raise InputError(self.where(key), value, "a text")
        return value

    def name(self, value: Any, key: str, form: tuple[str, str]) -> str:
        """A name of a form: a regular expression, and the same in words."""
        pattern, allowed = form
        if not re.fullmatch(pattern, self.text(value, key)):
            raise InputError(self.where(key), value, allowed)
        return str(value)

    def items(self, value: Any, key: str) -> list[Any]:
        """A non-empty list."""
        if not isinstance(value, list) or not value:
            raise InputError(self.where(key), value, "a list with at least one entry")
        return value

    def table(
        self, mapping: Any, key: str, limits: Mapping[str, QuantityLimits], others: tuple[str, ...] = ()
    ) -> dict[str, float]:
        """All quantities of a section, by name; optional ones may be absent."""
        required = tuple(name for name, limit in limits.items() if not limit.optional)
        optional = tuple(name for name, limit in limits.items() if limit.optional)
        self.keys(mapping, key, (*required, *others), optional)
        return {name: self.quantity(mapping[name], f"{key}.{name}", limit) for name, limit in limits.items() if name in mapping}

    def quantity(self, given: Any, key: str, limits: QuantityLimits) -> float:
        """One checked scalar quantity."""
        value = self._quantity(given, key, limits).value
        if isinstance(value, tuple):
            raise InputError(self.where(f"{key}.value"), list(value), "one number")
        return value

    def quantities(self, given: Any, key: str, limits: QuantityLimits) -> tuple[float, ...]:
        """A checked list of quantities that share unit, range and reason."""
        value = self._quantity(given, key, limits).value
        return value if isinstance(value, tuple) else (value,)

    def _quantity(self, given: Any, key: str, limits: QuantityLimits) -> Quantity:
        entry, quantity = self.known.quantities.get(key, (None, None))
        if quantity is None or entry is not given or key in self._overrides:
            quantity = self._checked(given, key, limits)
            if key not in self._overrides:
                self.known.quantities[key] = given, quantity
        self.parameters[key] = quantity
        return quantity

    def _checked(self, given: Any, key: str, limits: QuantityLimits) -> Quantity:
        entry = self.keys(given, key, QUANTITY_KEYS)
        if entry["unit"] != limits.unit:
            raise InputError(self.where(f"{key}.unit"), entry["unit"], f"{limits.unit}", "convert the value to this unit")
        flag = self.text(entry["flag"], f"{key}.flag", FLAGS)
        reason = self.text(entry["reason"], f"{key}.reason")
        low, high = checks.span(entry["range"], self.where(f"{key}.range"), limits.low, limits.high, limits.unit)
        raw = entry["value"]
        value: float | tuple[float, ...]
        if isinstance(raw, list) and not raw:
            raise InputError(self.where(f"{key}.value"), raw, "at least one number")
        if isinstance(raw, list):
            value = tuple(self._number(item, f"{key}.value", low, high, limits.unit) for item in raw)
        else:
            raw = self._overrides.get(key, raw)
            if key in self._overrides:  # a fit may leave the file's range, never the absolute limits
                low, high = min(low, raw), max(high, raw)
                value = self._number(raw, key, limits.low, limits.high, limits.unit)
            else:
                value = self._number(raw, f"{key}.value", low, high, limits.unit)
        return Quantity(value, limits.unit, flag, low, high, reason)

    def _number(self, given: Any, key: str, low: float, high: float, unit: str) -> float:
        remedy = "correct the value, or widen its range if you trust the value"
        return checks.number(given, self.where(key), low, high, unit, if_outside=remedy)

    def check_overrides_used(self) -> None:
        """Refuse overrides whose path is not in the file."""
        for key in self._overrides:
            if key not in self.parameters or isinstance(self.parameters[key].value, tuple):
                allowed = "the path of a scalar quantity in this file"
                raise InputError(self.where(key), key, allowed, nearest(key, self.parameters))


def read_disturbance(path: Path, given: Any) -> Disturbance:
    """Check the section `disturbance` of a vehicle file.

    It has its own reader, as a watched disturbance affects neither the estimate, nor its uncertainty, nor the validity of a
    stored state.

    Raises
    ------
    InputError
        If a value does not satisfy `schema`, or if the two levels of spells are equal.
    """
    own = ValueReader(path)
    if not isinstance(given, dict) or "form" not in given:
        raise InputError(own.where("disturbance"), given, f"a mapping with a form, one of {', '.join(FORMS)}")
    form = own.text(given["form"], "disturbance.form", tuple(FORMS))
    found = FORMS[form](**own.table(given, "disturbance", schema.DISTURBANCES[form], others=("form",)))
    if isinstance(found, Spells) and found.level == found.rest:
        raise InputError(own.where("disturbance.level"), found.level, "a torque different from that of the rest")
    return found
