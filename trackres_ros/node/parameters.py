# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every parameter of the live node: one table of default, unit, limits and meaning, from which the YAML file and the docs are
made; and what the node reads by them: vehicle, topics, settings, quality of service.

The settings of the estimator are part of the table, so the same file serves `trackres replay --params`. A node without parameter
services watches its file for changes.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
import shlex
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from trackres_ros import checks
from trackres_ros.errors import InputError
from trackres_ros.estimator.settings import FIELDS, Settings, settings_for, settings_of
from trackres_ros.files.dataclass_reader import Limits, fields_of, limits_of, words_of
from trackres_ros.files.documents import read_yaml
from trackres_ros.files.resources import find_vehicle
from trackres_ros.learning.learner import MODES
from trackres_ros.node.measured_torque import MismatchSettings
from trackres_ros.node.transport import Quality
from trackres_ros.output.topics import OutputTopic
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.roles import POSITION
from trackres_ros.vehicle import AnyVehicle, load_any, with_surroundings

Value = int | float | bool | str | tuple[str, ...]
Stamp = tuple[int, int, int]
"""Inode, size and time of change: a file of another stamp is another one."""

AT_START = "the node reads it once, when it is configured"
CONNECTED = "the node connects with it when it is configured"
RELIABILITIES = ("best_effort", "reliable")
ROS_KEY = "ros__parameters"
QOS_OVERRIDES = "qos_overrides"  # rclpy's section of a parameter file
WIRE_DEPTH = 5000  # enough for a few seconds' delay of this process at 1 kHz: a middleware drops messages silently
LOOK_EVERY_S = 1.0  # between two looks at a parameter file
TOPIC_NAME = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
SWITCH = MappingProxyType({True: "on", False: "off"})
"""YAML's values for the words on and off, and the words themselves."""


@dataclass(frozen=True)
class NodeParameter:
    """One parameter. All values have the type of the default."""

    name: str
    default: Value
    meaning: str
    unit: str = ""
    low: float = math.nan  # limits of a number, integers for an integer; nan for other kinds
    high: float = math.nan
    choices: tuple[str, ...] = ()  # allowed texts; of a list, allowed elements. Empty: any text
    fixed_because: str = ""  # why it cannot be changed while the node runs; empty if it can

    def __post_init__(self) -> None:
        if self.is_number:
            kind = int if isinstance(self.default, int) else float
            object.__setattr__(self, "low", kind(self.low))
            object.__setattr__(self, "high", kind(self.high))

    @property
    def is_number(self) -> bool:
        """Whether it is a number, integer or not."""
        return isinstance(self.default, int | float) and not isinstance(self.default, bool)

    def check(self, value: object) -> Value:
        """The value as this parameter's kind: 2 for a float is 2.0, 2.0 for a count is 2, and true is the word on.

        Raises InputError if it is of another kind or out of range; with the given and the allowed values.
        """
        place = f"parameter {self.name}"
        if isinstance(self.default, bool):
            if not isinstance(value, bool):
                raise InputError(place, value, "true or false")
            return value
        if isinstance(self.default, str):
            if self.choices:
                word = SWITCH.get(value) if isinstance(value, bool) else value
                return checks.one_of(word if word in self.choices else value, place, self.choices)
            if not isinstance(value, str):
                raise InputError(place, value, "a text")
            return value
        if isinstance(self.default, tuple):
            return checks.each_of(value, place, self.choices)
        unit = "" if self.unit == "1" else self.unit
        if isinstance(self.default, int):
            return checks.whole(value, place, int(self.low), int(self.high), unit)
        return checks.number(value, place, self.low, self.high, unit)


def _parameters_of(settings: type[Settings | MismatchSettings]) -> tuple[NodeParameter, ...]:
    """Parameters out of an annotated dataclass of settings."""
    limits, choices = limits_of(settings), {field.name: words_of(field.kind) for field in fields_of(settings)}
    return tuple(
        NodeParameter(
            item.name,
            item.default,  # type: ignore[arg-type]
            item.metadata["meaning"],
            *limits.get(item.name, Limits("", math.nan, math.nan, ""))[:3],
            choices[item.name],
        )
        for item in dataclasses.fields(settings)
    )


_read_once = partial(NodeParameter, fixed_because=AT_START)
_connecting = partial(NodeParameter, fixed_because=CONNECTED)
NODE_PARAMETERS = (
    _read_once("vehicle", "", "vehicle file, or the name of a shipped vehicle; required"),
    _read_once(
        "surroundings",
        "",
        "file with the current effects of site, weather and ground, as trackres diagnose writes it; empty: none",
    ),
    _read_once("topics", "", "topics file, or the name of a shipped one; empty: default"),
    _read_once(
        "state_file",
        "auto",
        "file that saves belt temperatures across restarts. auto: one per node and vehicle in "
        "~/.local/state/trackres, none in simulated time; none: start cold",
    ),
    NodeParameter(
        "learning",
        "watch",
        "learning from a measured torque: off; watch: learn and publish; on: also use the learned parameters",
        choices=MODES,
    ),
    NodeParameter("save_period_s", 30.0, "time between two saves of the state", "s", 1.0, 3600.0),
    NodeParameter(
        "output_rate_hz",
        50.0,
        "rate of the outputs; 0: one output per accepted speed, and ten a second while none comes",
        "Hz",
        0.0,
        1000.0,
    ),
    _read_once(
        "autostart", True, "configure and activate at the start; false: wait for a lifecycle manager; trackres live always starts"
    ),
    _read_once("use_sim_time", False, "take the time from /clock, for a simulation or a replay"),
    _read_once("frame_id", "base_link", "frame of the stamped outputs"),
    _connecting(
        "input_reliability",
        "best_effort",
        "reliability requested from publishers; best effort connects to both kinds",
        choices=RELIABILITIES,
    ),
    _connecting(
        "input_depth",
        100,
        "queue length of each topic; when it is full, the oldest messages are dropped and counted",
        "1",
        1,
        10000,
    ),
    _connecting(
        "input_deadline_s",
        0.0,
        "deadline requested from publishers; 0: none (a publisher without a deadline would never connect otherwise)",
        "s",
        0.0,
        3600.0,
    ),
    _connecting("output_reliability", "reliable", "reliability offered to subscribers", choices=RELIABILITIES),
    _connecting("output_depth", 10, "messages kept for a reliable subscriber that falls behind", "1", 1, 10000),
    _connecting(
        "output_deadline_s",
        0.2,
        "deadline offered to subscribers on the torque and temperature topics; 0: none",
        "s",
        0.0,
        3600.0,
    ),
)
PARAMETERS: Mapping[str, NodeParameter] = MappingProxyType(
    {p.name: p for p in (*NODE_PARAMETERS, *_parameters_of(Settings), *_parameters_of(MismatchSettings))}
)


@dataclass(frozen=True)
class Parameters:
    """Checked values of all parameters."""

    values: Mapping[str, Value]

    @property
    def sim_time(self) -> bool:
        """Whether time comes from /clock."""
        return bool(self.values["use_sim_time"])

    def number(self, name: str) -> float:
        """Value of a numeric parameter."""
        value = self.values[name]
        assert isinstance(value, float)
        return value

    def count(self, name: str) -> int:
        """Value of a whole-number parameter."""
        value = self.values[name]
        assert isinstance(value, int)
        return value

    def text(self, name: str) -> str:
        """Value of a text parameter."""
        value = self.values[name]
        assert isinstance(value, str)
        return value

    def diagnose_command(self) -> str:
        """Command that explains where and why measured and expected torque differ."""
        options = [
            f"--{name} {shlex.quote(self.text(name))}" for name in ("vehicle", "surroundings", "topics") if self.text(name)
        ]
        return f"trackres diagnose RECORDING {' '.join(options)} -o report"

    def settings(self) -> Settings:
        """The estimator's share."""
        return Settings(**{item.name: self.values[item.name] for item in dataclasses.fields(Settings)})  # type: ignore[arg-type]

    def mismatch(self) -> MismatchSettings:
        """The share of the comparison with a measured torque."""
        return MismatchSettings(**{item.name: self.number(item.name) for item in dataclasses.fields(MismatchSettings)})

    def input_quality(self) -> Quality:
        """Quality of service of every input; `input_depth` limits the queue in this process, which counts dropped messages."""
        depth = max(self.count("input_depth"), WIRE_DEPTH)
        return Quality(self.text("input_reliability") == "reliable", depth, self.number("input_deadline_s"))

    def latched_quality(self) -> Quality:
        """Quality of service of the second endpoint of an input, for what its publishers keep: these are reliable."""
        return Quality(True, self.input_quality().depth, 0.0, latched=True)

    def output_quality(self, topic: OutputTopic) -> Quality:
        """Quality of service of an output; a deadline only on those that come at a steady rate."""
        steady_ns = topic.kind != "status" and topic.name != "torque_residual"
        deadline_s = self.number("output_deadline_s") if steady_ns else 0.0
        return Quality(self.text("output_reliability") == "reliable", self.count("output_depth"), deadline_s)

    def with_changes(self, changes: Mapping[str, object]) -> Parameters:
        """These with some changed while the node runs.

        Raises InputError for an unknown one, a bad value, or one that cannot be changed while the node runs; then none
        is changed.
        """
        for name in changes:
            parameter = node_parameter(name)
            if parameter.fixed_because and parameter.check(changes[name]) != self.values[name]:
                raise InputError(
                    f"parameter {name}",
                    changes[name],
                    f"its initial value {self.values[name]}: {parameter.fixed_because}",
                    "set it in the parameter file and reconfigure the node",
                )
        return make_parameters({**self.values, **changes})


def node_parameter(name: str) -> NodeParameter:
    """The parameter of a name. Raises InputError for an unknown name; with the nearest name."""
    return PARAMETERS[checks.one_of(name, "parameter", PARAMETERS)]


def make_parameters(entries: Mapping[str, object]) -> Parameters:
    """Parameters from names and values, the rest by default. Raises InputError for an unknown name or a bad value."""
    checked_values = {name: node_parameter(name).check(value) for name, value in entries.items()}
    parameters = Parameters(MappingProxyType({name: checked_values.get(name, p.default) for name, p in PARAMETERS.items()}))
    rate, deadline = parameters.number("output_rate_hz"), parameters.number("output_deadline_s")
    if rate > 0.0 and 0.0 < deadline < 2.0 / rate:
        allowed = f"0, or at least {2.0 / rate:g} s, two outputs at an output_rate_hz of {rate:g} Hz"
        raise InputError("parameter output_deadline_s", deadline, allowed, "the node must be able to meet the offered deadline")
    return parameters


def read_parameters(path: Path | None, node: str = "trackres", namespace: str = "/") -> dict[str, object]:
    """Names and values out of a parameter file, see `read_with_overrides`."""
    return read_with_overrides(path, node, namespace)[0]


def read_with_overrides(path: Path | None, node: str, namespace: str) -> tuple[dict[str, object], dict[str, bool | int | str]]:
    """Names and values out of a parameter file, see `read_entries`, each of them checked; and rclpy's overrides of the quality
    of service, with full names.

    Raises InputError if the file cannot be read, an entry is unknown or bad, or no section fits the node.
    """
    entries = {} if path is None else read_entries(path, node, namespace)
    values = {name: value for name, value in entries.items() if str(name).split(".")[0] != QOS_OVERRIDES}
    try:
        make_parameters(values)
    except InputError as error:
        raise InputError(f"{path}: {error.where}", error.given, error.allowed, error.remedy) from None
    overrides = dict(_flat_entries({name: value for name, value in entries.items() if name not in values}, ""))
    for name, value in overrides.items():
        if not isinstance(value, bool | int | str):
            raise InputError(f"{path}: {name}", value, "a word, a whole number, true or false")
    return values, overrides


def _flat_entries(entries: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    """Nested entries by their dotted names."""
    for name, value in entries.items():
        if isinstance(value, Mapping):
            yield from _flat_entries(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def read_entries(path: Path, node: str, namespace: str) -> dict[str, object]:
    """Names and values of a parameter file: flat, or the sections that fit the node in the form that ROS reads.

    Raises InputError if the file cannot be read, or no section fits the node.
    """
    content = read_yaml(path)
    full_name = f"{namespace.rstrip('/')}/{node}"
    if not any(isinstance(value, Mapping) for value in content.values()):
        return dict(content)
    sections = _sections(content, "", str(path))
    fitting = [values for pattern, values in sections if fits_node(pattern, full_name)]
    if not fitting:
        names = ", ".join(pattern for pattern, _ in sections)
        raise InputError(str(path), f"parameters of {names}", f"a section for {full_name}", "use that name, or /** for any node")
    return {name: value for values in fitting for name, value in values.items()}


def fits_node(pattern: str, node: str) -> bool:
    """Whether a section is of a node with a full name, by the wildcards of ROS: /* is any one name, /** any number of them."""
    return re.fullmatch(re.escape(pattern).replace(r"/\*\*", r"(/\w+)*").replace(r"/\*", r"/\w+"), node) is not None


def section_names(path: Path) -> list[str]:
    """Node patterns of the sections of a parameter file of ROS.

    Raises InputError if the file cannot be read, or has anything else.
    """
    return [name for name, _ in _sections(read_yaml(path), "", str(path))]


def _sections(content: Mapping[Any, Any], prefix: str, origin: str) -> list[tuple[str, Mapping[str, object]]]:
    """Node patterns and their parameters in a ROS parameter file, namespaces nested or not; anything else is refused."""
    sections: list[tuple[str, Mapping[str, object]]] = []
    for key, value in content.items():
        name = f"{prefix}/{str(key).strip('/')}"
        if not isinstance(value, Mapping) or not value:
            remedy = f"did you mean {ROS_KEY}?" if difflib.get_close_matches(ROS_KEY, name.split("/")) else ""
            allowed = f"the name of a node or namespace with a mapping that ends in {ROS_KEY}"
            raise InputError(f"{origin}: {name.strip('/')}", value, allowed, remedy)
        sections_inside = {section_name: entry for section_name, entry in value.items() if section_name != ROS_KEY}
        if ROS_KEY in value:
            parameters = value[ROS_KEY]
            if not isinstance(parameters, Mapping | None):
                raise InputError(f"{origin}: {name.strip('/')}.{ROS_KEY}", parameters, "names and values of parameters")
            sections.append((name, parameters or {}))
        sections += _sections(sections_inside, name, origin)
    return sections


class Setup(NamedTuple):
    """Vehicle, topics and settings of a node."""

    vehicle: AnyVehicle  # with its surroundings
    topics: Topics  # every role has a topic, and speed is among them
    settings: Settings  # of the estimator, with the values of the topics file


def read_setup(parameters: Parameters) -> Setup:
    """Read the files that the parameters of a node name.

    Raises InputError if no vehicle is named, or vehicle, surroundings or topics file cannot be used.
    """
    if not parameters.text("vehicle"):
        raise InputError("parameter vehicle", "", "a vehicle file, or the name of a shipped one", "for example xgd24d")
    topics = Topics.load(parameters.text("topics") or "default")
    _check_live(topics)
    vehicle = with_surroundings(load_any(find_vehicle(parameters.text("vehicle"))), parameters.text("surroundings"))
    return Setup(vehicle, topics, settings_for(parameters.settings(), topics))


def changed_parameters(current: Parameters, values: Mapping[str, object], topics: Topics) -> Parameters:
    """The parameters after a change while running.

    Raises InputError for an unknown or bad value, one that cannot be changed while running, or one that the topics file
    decides.
    """
    parameters = current.with_changes(values)
    fixed_settings = settings_of(topics)
    for name in values:
        if name in fixed_settings and fixed_settings[name] != parameters.values[name]:
            raise InputError(
                f"parameter {name}",
                values[name],
                f"{fixed_settings[name]}, set by the topics file",
                f"change {FIELDS.get(name, 'max_age_s')} in {topics.origin} and reconfigure the node",
            )
    return parameters


def _check_live(topics: Topics) -> None:
    """Refuse topics that a live node cannot use: a column of a table, a name that ROS does not allow, or no speed among them."""
    for place, value, _ in topics.unused_lines(of_topics=True):
        raise InputError(place, value, "a topic with type and field", "use a topics file for each kind of source")
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


class ParameterFile:
    """A parameter file that is checked every `LOOK_EVERY_S`.

    It is read once it is unchanged between two checks, so that a file that an editor is still writing is not read. So it is after
    the start too: someone may have changed it since the node read it. A refused line leaves its parameter unchanged, and the
    other lines apply. Values of the command line keep priority. A deleted file changes nothing. `parameters` are those at the
    start of the node, and `overruled` the names set on the command line.
    """

    def __init__(self, path: Path, node: str, namespace: str, parameters: Parameters, overruled_names: Collection[str]) -> None:
        self.path, self._node, self._namespace = path, node, namespace
        self._overruled_names = frozenset(overruled_names)
        self._applied: dict[str, Value] = dict(parameters.values)
        self._read_stamp: Stamp | None = None
        self._last_stamp: Stamp | None = None

    def look(self, check: Callable[[Mapping[str, Value]], object]) -> tuple[Mapping[str, Value], list[InputError]]:
        """Names and values that differ from those applied last, and an error for each refused line; mostly neither.

        `check` raises InputError for a change that the node refuses.
        """
        stamp = _stamp(self.path)
        is_settled, self._last_stamp = stamp == self._last_stamp, stamp
        if stamp is None or stamp == self._read_stamp or not is_settled:
            return {}, []
        self._read_stamp = stamp
        try:
            entries = read_entries(self.path, self._node, self._namespace)
        except InputError as error:
            return {}, [error]
        file_values, bad_lines = {name: parameter.default for name, parameter in PARAMETERS.items()}, []
        for name, value in entries.items():
            try:
                file_values[name] = node_parameter(name).check(value)
            except InputError as error:
                file_values.pop(name, None)
                bad_lines.append(error)
        changes = {
            name: value
            for name, value in file_values.items()
            if name not in self._overruled_names and value != self._applied[name]
        }
        valid_changes, errors = _valid_changes(changes, check)
        return valid_changes, bad_lines + errors

    def note_changes(self, changes: Mapping[str, Value]) -> str:
        """Record a change; return it as text."""
        text = ", ".join(f"{name} {_text_of(self._applied[name])} -> {_text_of(value)}" for name, value in changes.items())
        self._applied.update(changes)
        return f"{self.path}: {text}"

    def refusal_text(self, error: InputError) -> str:
        """Refused changes with reasons, as text."""
        return f"{self.path}: refused, and left as it was: {error}"


def _valid_changes(
    changes: Mapping[str, Value], check: Callable[[Mapping[str, Value]], object]
) -> tuple[dict[str, Value], list[InputError]]:
    """All valid changes, and the errors of the others. Two that depend on each other pass in either order."""
    valid_changes: dict[str, Value] = {}
    errors: dict[str, InputError] = {}
    pending_changes = dict(changes)
    while pending_changes:
        errors = {}
        for name, value in pending_changes.items():
            try:
                check({**valid_changes, name: value})
            except InputError as error:
                errors[name] = error
            else:
                valid_changes[name] = value
        if len(errors) == len(pending_changes):
            break
        pending_changes = {name: pending_changes[name] for name in errors}
    return valid_changes, list(errors.values())


def _stamp(path: Path) -> Stamp | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_size, status.st_mtime_ns


def _text_of(value: Value) -> str:
    return f"[{', '.join(value)}]" if isinstance(value, tuple) else f"{value:g}" if isinstance(value, float) else str(value)
