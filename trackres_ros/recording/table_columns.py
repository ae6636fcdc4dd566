# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Chooses the columns of a table to read: those that the topics file names, else those known by name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from trackres_ros.errors import InputError, nearest
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.roles import ROLES, base_role

TIME = "time_s"
COLUMNS: Mapping[str, tuple[str, float]] = MappingProxyType(
    {
        "speed_mps": ("speed", 1.0),
        "speed_kmh": ("speed", 1.0 / 3.6),
        "weight_n": ("load", 1.0),
        "weight_kn": ("load", 1e3),
        "torque_nm": ("torque", 1.0),
        "belt_degc": ("belt", 1.0),
        "ambient_degc": ("ambient", 1.0),
        "grade": ("grade", 1.0),
        "yaw_rate_radps": ("yaw_rate", 1.0),
        "heading_rad": ("heading", 1.0),
        "accel_mps2": ("accel", 1.0),
        "distance_m": ("distance", 1.0),
    }
)
"""Columns known by name: role, and scale to its unit. ``weight_n/front`` is the load of the axle or assembly front."""
NAMES_SHOWN = 20


@dataclass(frozen=True, slots=True)
class Column:
    """A column to read: its place among all columns, its name, the role it feeds, and the conversion."""

    place: int
    name: str
    role: str
    scale: float = 1.0
    offset: float = 0.0
    delay_s: float = 0.0


def choose_columns(names: Sequence[str], topics: Topics | None, origin: str) -> tuple[int, list[Column]]:
    """Return the place of the time, and the columns to read: as the topics file says, else those known by name."""
    places: dict[str, int] = {}
    for place, name in enumerate(names):
        places.setdefault(name, place)
    columns: dict[str, Column] = {}
    for role, binding in topics.bindings.items() if topics else ():
        if binding.column:
            if binding.column not in places:
                where = f"{topics.origin if topics else origin}: {role}: column"
                raise InputError(where, binding.column, listed_names(names), nearest(binding.column, names))
            columns[role] = Column(places[binding.column], binding.column, role, binding.scale, binding.offset, binding.delay_s)
    by_file = frozenset(columns)
    for name, place in places.items():
        base, slash, part = name.partition("/")
        if base in COLUMNS:
            role, scale = COLUMNS[base][0] + slash + part, COLUMNS[base][1]
            if role in by_file or (slash and not (part and ROLES[base_role(role)].parts)):
                continue
            if role in columns:
                raise InputError(
                    origin,
                    f"columns {columns[role].name} and {name}",
                    f"one column for {role}",
                    "name the right one in a topics file",
                )
            columns[role] = Column(place, name, role, scale)
    if TIME not in places:
        raise InputError(origin, f"columns {listed_names(names)}", f"a column {TIME}, in seconds", nearest(TIME, names))
    if "speed" not in columns:
        raise InputError(
            origin,
            f"columns {listed_names(names)}",
            "a column speed_mps or speed_kmh",
            "or name it in a topics file: speed: {column: NAME, scale: 1.0}",
        )
    count = Counter(names)
    for name in (TIME, *(column.name for column in columns.values())):
        if count[name] > 1:
            raise InputError(origin, f"{count[name]} columns {name}", "each column once")
    return places[TIME], list(columns.values())


def listed_names(names: Sequence[str]) -> str:
    """Names as far as anybody reads them."""
    more = f" and {len(names) - NAMES_SHOWN} more" if len(names) > NAMES_SHOWN else ""
    return ", ".join(names[:NAMES_SHOWN]) + more
