# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Pages of docs/ with the tables that the program holds: the site has them, the repository a line in their place."""

import dataclasses
import math
from collections.abc import Iterable

import api_page
from marks import ROOT, page_with

from trackres_ros.effects import catalogue
from trackres_ros.estimator.columns import channels
from trackres_ros.estimator.settings import Settings
from trackres_ros.node.notices import KINDS
from trackres_ros.node.parameters import PARAMETERS, NodeParameter, make_parameters
from trackres_ros.node.status import COMPARISON_KEYS, DISTURBANCE_KEYS, ESTIMATE_KEYS, INPUT_KEYS, STATE_KEYS
from trackres_ros.node.transport import input_topics, live_topics
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.roles import ROLES, UNITS, base_role
from trackres_ros.vehicle import load


def markdown(head: tuple[str, ...], rows: Iterable[tuple[object, ...]]) -> str:
    """A Markdown table."""
    lines = [f"| {' | '.join(str(cell) for cell in cells)} |" for cells in (head, *rows)]
    return "\n".join([lines[0], f"|{'---|' * len(head)}", *lines[1:]])


def shown(value: object) -> str:
    """A value as a person writes it in YAML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(value)}]"
    return f"{value:g}" if isinstance(value, int | float) else f'"{value}"'


def limits(parameter: NodeParameter) -> str:
    """Range or choices of a parameter."""
    if parameter.choices:
        return ", ".join(parameter.choices)
    return "" if math.isnan(parameter.low) else f"{parameter.low:g} to {parameter.high:g}"


def node_page() -> str:
    """docs/node.md, for the reference vehicle."""
    vehicle = load("xgd24d")
    parameters = make_parameters({"vehicle": "xgd24d"})
    topics = Topics.load(ROOT / "config" / "topics" / "default.yaml")
    with_torque = Topics.parse({"torque": {"topic": "t", "type": "std_msgs/Float64", "field": "data"}})
    inputs = [
        (f"`{topic.name}`", topic.type, f"`{reading.binding.field}`", f"{reading.role} [{ROLES[reading.role].unit}]")
        for topic in input_topics(topics)
        for reading in topic.readings
    ]
    outputs = []
    for topic in live_topics(vehicle, with_torque):
        deadline_s = parameters.output_quality(topic).deadline_s
        name = topic.name if topic.name.startswith("/") else f"~/{topic.name}"
        outputs.append((f"`{name}`", topic.type, topic.meaning, f"{deadline_s:g} s" if deadline_s else "none"))
    of_parts = {base_role(name) for name in channels(vehicle) if "/" in name}
    roles = [
        (f"`{name}`", role.unit, "yes" if name in of_parts else "")
        for name, role in ROLES.items()
        if name in (*channels(vehicle), "direction")
    ]
    tables = {
        "estimate": ESTIMATE_KEYS,
        "input ROLE": INPUT_KEYS,
        "comparison": COMPARISON_KEYS,
        "disturbance": DISTURBANCE_KEYS,
        "state": STATE_KEYS,
    }
    keys = [(f"{title}: `{name}`", meaning) for title, table in tables.items() for name, meaning in table.items()]
    rows = {
        p.name: (f"`{p.name}`", shown(p.default), p.unit, limits(p), "no" if p.fixed_because else "yes", p.meaning)
        for p in PARAMETERS.values()
    }
    settings = [item.name for item in dataclasses.fields(Settings)]
    head = ("name", "default", "unit", "range", "runs", "meaning")
    return page_with(
        "docs/node.md",
        inputs=markdown(("topic", "type", "field", "role"), inputs),
        roles=markdown(("role", "unit", "also of one axle or assembly"), roles),
        outputs=markdown(("topic", "type", "content", "deadline offered"), outputs),
        parameters=markdown(head, [row for name, row in rows.items() if name not in settings]),
        settings=markdown(head, [rows[name] for name in settings]),
        diagnostics=markdown(("entry and key", "meaning"), keys),
    )


def statuses_page() -> str:
    """docs/robustness.md."""
    rows = [(f"`{name}`", kind.level.name.lower(), kind.meaning) for name, kind in KINDS.items()]
    return page_with("docs/robustness.md", statuses=markdown(("status", "level", "meaning"), rows))


def effects_page() -> str:
    """docs/effects.md."""
    effects = []
    for effect in catalogue().values():
        needs = ", ".join(effect.needs) + (f"; only of what {effect.only_of}" if effect.only_of else "")
        effects.append((f"`{effect.name}`", effect.belongs_to, effect.acts_on, effect.text, needs))
    parameters = [
        (f"`{effect.name}`", q.name, f"{q.low:g} to {q.high:g}", q.unit, q.text)
        for effect in catalogue().values()
        for q in effect.parameters
    ]
    return page_with(
        "docs/effects.md",
        effects=markdown(("effect", "belongs to", "acts on", "what it is", "needs"), effects),
        parameters=markdown(("effect", "parameter", "bounds of a fit", "unit", "meaning"), parameters),
    )


def recordings_page() -> str:
    """docs/recordings.md."""
    roles = []
    for name, role in ROLES.items():
        of_part = "/NAME" if role.parts else ""
        columns = ", ".join(f"`{column}`" for column in role.columns)
        roles.append((f"`{name}{of_part}`", ", ".join(UNITS[role.unit]), columns, role.text))
    head = ("role, with /NAME also of a part", "units; the first without a `unit`", "columns of a table", "meaning")
    return page_with("docs/recordings.md", roles=markdown(head, roles))


PAGES = {
    "docs/api.md": api_page.page,
    "docs/effects.md": effects_page,
    "docs/node.md": node_page,
    "docs/recordings.md": recordings_page,
    "docs/robustness.md": statuses_page,
}
