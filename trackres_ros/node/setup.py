# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads and checks the vehicle, topics and settings of a node's parameters, once at the start."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from trackres_ros.errors import InputError
from trackres_ros.estimator.settings import FIELDS, Settings, given_by, settings_for
from trackres_ros.files.resources import find_vehicle
from trackres_ros.node.parameters import Parameters
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.roles import POSITION
from trackres_ros.vehicle import AnyVehicle, load_any, with_surroundings

TOPIC_NAME = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)


@dataclass(frozen=True, eq=False)
class Setup:
    """Vehicle, topics and settings of a node."""

    vehicle_file: Path
    surroundings_file: str  # empty if there is none
    vehicle: AnyVehicle  # with its surroundings
    topics: Topics  # every role has a topic, and speed is among them
    settings: Settings  # of the estimator, with the values of the topics file


def read_setup(parameters: Parameters) -> Setup:
    """Read the files that the parameters of a node name.

    Raises InputError if no vehicle is named, or vehicle, surroundings or topics file cannot be used.
    """
    if not parameters.text("vehicle"):
        raise InputError("parameter vehicle", "", "a vehicle file, or the name of a shipped one", "for example xgd24d")
    topics_file = parameters.text("topics")
    topics = Topics.load(topics_file or "default")
    _check_live(topics)
    vehicle_file, surroundings_file = find_vehicle(parameters.text("vehicle")), parameters.text("surroundings")
    vehicle = with_surroundings(load_any(vehicle_file), surroundings_file)
    return Setup(vehicle_file, surroundings_file, vehicle, topics, settings_for(parameters.settings(), topics))


def changed_parameters(before: Parameters, given: Mapping[str, object], topics: Topics) -> Parameters:
    """The parameters after a change while running.

    Raises InputError for an unknown or bad value, one that cannot be changed while running, or one that the topics file
    decides.
    """
    parameters = before.changed(given)
    fixed = given_by(topics)
    for name in given:
        if name in fixed and fixed[name] != parameters.values[name]:
            raise InputError(
                f"parameter {name}",
                given[name],
                f"{fixed[name]}, set by the topics file",
                f"change {FIELDS.get(name, 'max_age_s')} in {topics.origin} and reconfigure the node",
            )
    return parameters


def _check_live(topics: Topics) -> None:
    """Refuse topics that a live node cannot use: a column of a table, a name that ROS does not allow, or no speed among them."""
    for where, given, _ in topics.unused(of_topics=True):
        raise InputError(where, given, "a topic with type and field", "use a topics file for each kind of source")
    for role in topics:
        for source in topics[role].sources:
            if not TOPIC_NAME.fullmatch(source.topic):
                allowed = "a path such as /left/speed: letters, digits and underscores, no part beginning with a digit"
                raise InputError(f"{topics.origin}: {role}: topic", source.topic, allowed)
        if role in POSITION and not topics[role].unit:
            remedy = "a live node has no values yet to infer the unit from"
            raise InputError(f"{topics.origin}: {role}: unit", "none", "deg or rad", remedy)
    if "speed" not in topics:
        raise InputError(topics.origin, f"roles {', '.join(topics)}", "roles including speed")
