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

    It has its own reader, as a watched disturbance affects neither the estimate, nor its uncertainty, nor the validity of a
    stored state.

    Raises
    ------
    InputError
        If a value does not satisfy `schema`, or if the two levels of spells are equal.
    """
    own = ValueReader(reader.path)
    if not isinstance(given, dict) or "form" not in given:
        raise InputError(own.where("disturbance"), given, f"a mapping with a form, one of {', '.join(KINDS)}")
    form = own.text(given["form"], "disturbance.form", tuple(KINDS))
    found = KINDS[form](**own.table(given, "disturbance", schema.DISTURBANCES[form], others=("form",)))
    if isinstance(found, Spells) and found.level == found.rest:
        raise InputError(own.where("disturbance.level"), found.level, "a torque different from that of the rest")
    return found
