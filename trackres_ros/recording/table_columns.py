# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Chooses the columns of a table to read: those that the topics file names, else those known by name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from trackres_ros.errors import InputError, nearest
from trackres_ros.recording.binding import TopicBinding
from trackres_ros.recording.bindings import TIME, Topics
from trackres_ros.recording.roles import ANGLES, ROLES, base_role
from trackres_ros.units import DEGREE

TIME_S = "time_s"
DATE_NAMES = ("time", "timestamp", "datetime")
"""Names of a column of dates with times, in any case; of numbers nobody would know the unit."""
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
        "specific_force_mps2": ("specific_force", 1.0),
        "distance_m": ("distance", 1.0),
        "stood_s": ("stood", 1.0),
        "latitude_deg": ("latitude", DEGREE),
        "latitude_rad": ("latitude", 1.0),
        "longitude_deg": ("longitude", DEGREE),
        "longitude_rad": ("longitude", 1.0),
        "altitude_m": ("altitude", 1.0),
        "steering_angle_rad": ("steering_angle", 1.0),
        "passengers": ("passengers", 1.0),
        "brake_pa": ("brake", 1.0),
        "brake_on": ("brake", 1.0),
        "wheel_speed_mps": ("wheel_speed", 1.0),
        "enable": ("enable", 1.0),
    }
)
"""Columns known by name: role, and scale to its unit. ``weight_n/front`` is the load of the axle or assembly front."""
NAMES_SHOWN = 20


@dataclass(frozen=True, slots=True)
class TableColumn:
    """A column to read: its place among all columns, its name, and the role it feeds, with the conversion in its binding.

    `dates_only`: a time whose name does not say the unit of a number.
    """

    place: int
    name: str
    role: str
    binding: TopicBinding
    dates_only: bool = False


def choose_columns(names: Sequence[str], topics: Topics | None, origin: str) -> tuple[TableColumn, list[TableColumn]]:
    """Return the column of the time, and the columns to read: as the topics file says, else those known by name."""
    places: dict[str, int] = {}
    for place, name in enumerate(names):
        places.setdefault(name, place)

    def named(role: str, binding: TopicBinding) -> TableColumn:
        if binding.column not in places:
            where = f"{topics.origin if topics else origin}: {role}: column"
            raise InputError(where, binding.column, listed_names(names), nearest(binding.column, names))
        return TableColumn(places[binding.column], binding.column, role, binding)

    listed = topics.bindings.items() if topics else ()
    of_file = [named(role, part) for role, binding in listed if not binding.of_topics for part in binding.sources]
    by_file = frozenset(column.role for column in of_file)
    columns: dict[str, TableColumn] = {}
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
            unit: Literal["deg", "rad", ""] = "" if COLUMNS[base][0] not in ANGLES else "rad" if scale == 1.0 else "deg"
            columns[role] = TableColumn(place, name, role, TopicBinding(column=name, scale=scale, unit=unit))
    if topics and topics.time:
        time = named(TIME, topics.time)
    elif TIME_S in places:
        time = TableColumn(places[TIME_S], TIME_S, TIME, TopicBinding(column=TIME_S))
    elif len(dated := [name for name in places if name.lower() in DATE_NAMES]) == 1:
        time = TableColumn(places[dated[0]], dated[0], TIME, TopicBinding(column=dated[0]), dates_only=True)
    else:
        near = nearest(TIME_S, names)
        name_it = "or name it in a topics file: time: {column: NAME, scale: 1.0}"
        allowed = f"a column {TIME_S}, in seconds, or timestamp, of dates with times"
        raise InputError(origin, f"columns {listed_names(names)}", allowed, near or name_it)
    chosen = [*of_file, *columns.values()]
    if not any(column.role == "speed" for column in chosen):
        raise InputError(
            origin,
            f"columns {listed_names(names)}",
            "a column speed_mps or speed_kmh",
            "or name it in a topics file: speed: {column: NAME, scale: 1.0}",
        )
    count = Counter(names)
    for name in (time.name, *(column.name for column in chosen)):
        if count[name] > 1:
            raise InputError(origin, f"{count[name]} columns {name}", "each column once")
    return time, chosen


def listed_names(names: Sequence[str]) -> str:
    """Names as far as anybody reads them."""
    more = f" and {len(names) - NAMES_SHOWN} more" if len(names) > NAMES_SHOWN else ""
    return ", ".join(names[:NAMES_SHOWN]) + more
