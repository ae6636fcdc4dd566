# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks the section `disturbance` of a vehicle file: an intermittent or drifting torque to watch for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trackres_ros.errors import InputError
from trackres_ros.vehicle import schema
from trackres_ros.vehicle.description import Disturbance, Drift, Spells
from trackres_ros.vehicle.reading import ValueReader

KINDS: Mapping[str, type[Spells | Drift]] = {kind.form: kind for kind in (Spells, Drift)}


def read_disturbance(reader: ValueReader, given: Any) -> Disturbance:
    """Check the section `disturbance` of a vehicle file.

    It has a reader of its own: what is only watched for is no quantity that the estimate, its uncertainty or a kept state
    depends on.

    Raises
    ------
    InputError
        If a value is not as `schema` says, or if spells have two levels that are one.
    """
    own = ValueReader(reader.path)
    if not isinstance(given, dict) or "form" not in given:
        raise InputError(own.where("disturbance"), given, f"a mapping with a form, one of {', '.join(KINDS)}")
    form = own.text(given["form"], "disturbance.form", tuple(KINDS))
    found = KINDS[form](**own.table(given, "disturbance", schema.DISTURBANCES[form], others=("form",)))
    if isinstance(found, Spells) and found.level == found.rest:
        raise InputError(own.where("disturbance.level"), found.level, "a torque different from that of the rest")
    return found
