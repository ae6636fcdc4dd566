# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads a speed profile, and its conditions, for a simulation."""

from __future__ import annotations

from collections.abc import Collection
from os import PathLike
from pathlib import Path

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.errors import InputError
from trackres_ros.estimator.constants import LARGEST_LOAD_SHARE, LEAST_LOAD_SHARE, PLAUSIBLE
from trackres_ros.recording.channel_source import ChannelSource
from trackres_ros.recording.opening import open_source
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.roles import POSITION, ROLES
from trackres_ros.text import figures

ARGUMENT_OF = {"load": "weight_kn", "ambient": "ambient_degc", "grade": "", **dict.fromkeys(POSITION, "")}
"""Possible columns in addition to the speed, and the argument of the same meaning."""


def read_profile(profile: str | PathLike[str] | Recording, on_route: bool = False) -> Recording:
    """The profile of a table; a column without effect is refused, such as a position without a route.

    Raises InputError for no table, or a column that a simulation does not use.
    """
    if isinstance(profile, Recording):
        recording = profile
    else:
        source = open_source([Path(profile)])
        if not isinstance(source, ChannelSource):
            raise InputError("profile", str(profile), "a CSV or Parquet table; trackres replay reads bags")
        recording = Recording.from_source(source)
    taken = [role for role in ("speed", *ARGUMENT_OF) if on_route or role not in POSITION]
    unused = [role for role in recording.roles if role not in taken]
    if unused:
        allowed = ", ".join(taken)
        remedy = "remove the columns that a simulation does not use"
        if set(unused) <= set(POSITION):
            remedy = "a position needs a route in the surroundings: --surroundings FILE"
        raise InputError(f"{recording.name}: columns of", ", ".join(unused), allowed, remedy)
    return recording


def conditions(recording: Recording, time_s: Array, given: Collection[str], weight: float) -> dict[str, Array]:
    """Conditions of a profile at some times [s], see `along`, by role.

    Raises InputError for a role that is also in `given`, and for unknown or implausible values for a vehicle of a weight [N].
    """
    found = {}
    for role, argument in ARGUMENT_OF.items():
        if role not in recording.series or not len(recording.series[role]):
            continue
        if role in given:
            raise InputError(argument, f"{role} in {recording.name} too", "one of the two")
        value = recording.series[role].value
        if not np.isfinite(value).all():
            raise InputError(f"{recording.name}: {role}", float(value[~np.isfinite(value)][0]), "finite numbers")
        found[role] = along(recording, role, time_s, weight)
    return found


def along(recording: Recording, role: str, time_s: Array, weight: float, option: str = "") -> Array:
    """The known values of a role at some times [s], interpolated.

    Before its first and after its last value a position is nan, as in a replay; others keep that value. Raises InputError for
    values that are implausible for a vehicle of a weight [N]; `option`: the one that gave the recording.
    """
    low, high = {**PLAUSIBLE, "load": (LEAST_LOAD_SHARE * weight, LARGEST_LOAD_SHARE * weight)}[role]
    at, value = recording.time_s(role), recording.series[role].value
    order = np.argsort(at, kind="stable")
    order = order[np.isfinite(value[order])]
    bad = value[order][(value[order] < low) | (value[order] > high)]
    if bad.size:
        allowed = f"{low:g} to {high:g} {ROLES[role].unit}{f' for a vehicle of {figures(weight)} N' if role == 'load' else ''}"
        raise InputError(f"{option} {recording.name}: {role}".lstrip(), float(bad[0]), allowed)
    value = np.unwrap(value[order]) if role == "longitude" else value[order]  # it goes on over the date line
    outside = np.nan if role in POSITION else None
    return np.interp(time_s, at[order], value, left=outside, right=outside)
