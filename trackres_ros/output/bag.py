# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes results as topics of an MCAP file: those of the live node, except diagnostics."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from trackres_ros.arrays import Array
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.records import Estimate, Steps
from trackres_ros.learning.columns import lines
from trackres_ros.learning.learner import Learner
from trackres_ros.output.mcap import BagTopic, BagWriter
from trackres_ros.output.topics import (
    BASE_FRAME,
    DEFAULT_NODE,
    ESTIMATE_TOPIC,
    PARAMETERS_TOPIC,
    REASONS_GROUP,
    VEHICLE_GROUP,
    OutputTopic,
    output_topics,
    reasons_of,
    values_of,
)
from trackres_ros.recording.cdr import Template
from trackres_ros.units import SECOND_NS

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
FIELDS = {"wrench": ("wrench.torque.y",), "number": ("data",), "temperature": ("temperature", "variance")}
Values = Iterable[tuple[str, str]]
"""Keys and values of a status."""


class OutputBag:
    """Writes blocks of results; the file is put in place when the `with` block ends well. See `BagWriter` for `part`.

    Of a `live` node the estimates come from `write_published`, as they left; else each step makes one.
    """

    def __init__(
        self, path: Path, estimator: Estimator, learner: Learner | None = None, part: Path | None = None, live: bool = False
    ) -> None:
        self._live = live
        self.path, self.writer = path, BagWriter(path, part=part)
        self._estimator, self._learner = estimator, learner
        self._topics: list[tuple[OutputTopic, BagTopic]] = []
        self._templates: dict[tuple[tuple[str, int], ...], Template] = {}  # of estimates, by their reasons
        self._last_reasons: int | None = None
        self._last_status_ns = self._last_learned_ns = 0

    def __enter__(self) -> Self:
        """Begin the file and announce the topics."""
        self.writer.__enter__()
        parameters = () if self._learner is None else (PARAMETERS_TOPIC,)
        for topic in (*output_topics(self._estimator.vehicle), *parameters):
            template: tuple[Any, Sequence[str]] = (None, ())
            if topic.kind not in ("status", "estimate"):
                template = template_message(topic, self.writer.typestore, BASE_FRAME), number_fields(topic)
            self._topics.append((topic, self.writer.topic(f"/{DEFAULT_NODE}/{topic.name}", topic.type, *template)))
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Finish the file."""
        self.writer.__exit__(kind, error, trace)

    @property
    def estimates(self) -> int:
        """Rows of results in the file."""
        return self._topics[0][1].count

    def write(self, steps: Steps) -> None:
        """Write the results of a block of messages on all topics."""
        for topic, bag_topic in self._topics:
            if topic is PARAMETERS_TOPIC:
                self._write_learned(bag_topic, steps)
                continue
            if topic.kind == "status":
                self._write_status(bag_topic, steps)
                continue
            if topic.kind == "estimate":
                if not self._live:
                    self._write_steps(topic, bag_topic, steps)
                continue
            values = values_of(topic, steps.rows, self._estimator.column_index)
            is_finite = np.isfinite(values).all(axis=1)
            self.writer.write_block(bag_topic, steps.stamp_ns[is_finite], steps.arrival_ns[is_finite], values[is_finite])

    def write_published(self, estimates: Sequence[tuple[Sequence[float], Sequence[tuple[str, int]], int, int]]) -> None:
        """Write estimates as the node published them: numbers and reasons of each, its stamp, and when it left [ns]."""
        topic, bag_topic = next(pair for pair in self._topics if pair[0] is ESTIMATE_TOPIC)
        numbers, reasons, stamps, left_ns = zip(*estimates, strict=True)
        times = np.array(stamps, dtype=np.int64), np.array(left_ns, dtype=np.int64)
        for names in dict.fromkeys(reasons):
            rows = np.array([reason_names == names for reason_names in reasons])
            self._write_estimates(topic, bag_topic, names, times[0][rows], times[1][rows], np.array(numbers)[rows])

    def _write_steps(self, topic: OutputTopic, bag_topic: BagTopic, steps: Steps) -> None:
        """Estimates of steps under their own reasons."""
        values = values_of(topic, steps.rows, self._estimator.column_index)
        is_finite = np.isfinite(values).all(axis=1)
        reasons = steps.rows[:, at.Results.reasons].astype(np.int64)
        for bits in np.unique(reasons[is_finite]).tolist():
            rows = is_finite & (reasons == bits)
            self._write_estimates(topic, bag_topic, reasons_of(bits), steps.stamp_ns[rows], steps.arrival_ns[rows], values[rows])

    def _write_estimates(
        self,
        topic: OutputTopic,
        bag_topic: BagTopic,
        reasons: Sequence[tuple[str, int]],
        stamp_ns: NDArray[np.int64],
        log_ns: NDArray[np.int64],
        values: Array,
    ) -> None:
        """Estimates that have the same reasons."""
        key = tuple(reasons)
        if key not in self._templates:
            message = estimate_message(self.writer.typestore, BASE_FRAME, key)
            self._templates[key] = self.writer.template(bag_topic, message, number_fields(topic))
        self.writer.write_block(bag_topic, stamp_ns, log_ns, values, self._templates[key])

    def _write_status(self, topic: BagTopic, steps: Steps) -> None:
        reasons = steps.rows[:, at.Results.reasons].astype(np.int64)
        last = np.concatenate([[-1 if self._last_reasons is None else self._last_reasons], reasons[:-1]])
        for i in self._due_rows(steps.arrival_ns, reasons != last):
            estimate = Estimate(steps.rows[i], self._estimator.column_index)
            level, text = int(estimate.status == "warn"), "; ".join(estimate.reason_texts()) or "ok"
            message = self._diagnostics([(level, "estimate", text, ())])
            self.writer.write(topic, message, int(steps.stamp_ns[i]), int(steps.arrival_ns[i]))
        if len(reasons):
            self._last_reasons = int(reasons[-1])

    def _write_learned(self, topic: BagTopic, steps: Steps) -> None:
        """Learned values, once a second."""
        assert self._learner is not None
        for i, second in enumerate((steps.arrival_ns // SECOND_NS).tolist()):
            if second != self._last_learned_ns:
                self._last_learned_ns = second
                statuses = [(0, name, message, values) for name, message, values in lines(self._learner, steps.rows[i].tolist())]
                self.writer.write(topic, self._diagnostics(statuses), int(steps.stamp_ns[i]), int(steps.arrival_ns[i]))

    def _due_rows(self, arrival_ns: NDArray[np.int64], changes: NDArray[np.bool_]) -> list[int]:
        """Rows at which a status is due: at each change, and once a second."""
        if not len(arrival_ns):
            return []
        period = arrival_ns // SECOND_NS
        new_second = np.concatenate([[period[0] != self._last_status_ns], np.diff(period) != 0])
        self._last_status_ns = int(period[-1])
        return [int(i) for i in np.flatnonzero(changes | new_second)]

    def _diagnostics(self, statuses: Iterable[tuple[int, str, str, Values]]) -> Any:
        """A message of some statuses, each with level, name, text and values."""
        vehicle = self._estimator.vehicle.name
        rows = ((level, f"{DEFAULT_NODE}: {name}", text, vehicle, values) for level, name, text, values in statuses)
        return diagnostic_array(self.writer.typestore, rows, BASE_FRAME)


def number_fields(topic: OutputTopic) -> Sequence[str]:
    """Paths of the numbers of a topic in its message."""
    if topic.kind == "estimate":
        return tuple(f"interface_values[0].values[{i}]" for i in range(len(topic.names)))
    return FIELDS.get(topic.kind, tuple(f"effort[{i}]" for i in range(len(topic.names))))


def diagnostic_array(
    typestore: Typestore, statuses: Iterable[tuple[int, str, str, str, Values]], frame_id: str, stamp_ns: int = 0
) -> Any:
    """A DiagnosticArray of some statuses, each with level, name, text, hardware and values."""
    types = typestore.types
    status, pair = types["diagnostic_msgs/msg/DiagnosticStatus"], types["diagnostic_msgs/msg/KeyValue"]
    messages = [
        status(level=level, name=name, message=text, hardware_id=hardware, values=[pair(key=k, value=v) for k, v in values])
        for level, name, text, hardware, values in statuses
    ]
    return types[DIAGNOSTICS](header=header(typestore, frame_id, stamp_ns), status=messages)


def estimate_message(typestore: Typestore, frame_id: str, reasons: Sequence[tuple[str, int]]) -> Any:
    """A message of `topics.ESTIMATE_TOPIC` with the reasons and the level of each, and zeros for its numbers and its stamp."""
    types, names = typestore.types, list(ESTIMATE_TOPIC.names)
    group = types["control_msgs/msg/InterfaceValue"]
    reason_values = group(interface_names=[name for name, _ in reasons], values=np.array([float(level) for _, level in reasons]))
    return types[ESTIMATE_TOPIC.type](
        header=header(typestore, frame_id),
        interface_groups=[VEHICLE_GROUP, REASONS_GROUP],
        interface_values=[group(interface_names=names, values=np.zeros(len(names))), reason_values],
    )


def template_message(topic: OutputTopic, typestore: Typestore, frame_id: str) -> Any:
    """A message of a topic with all its strings, and zeros for its numbers and its stamp."""
    types, blank = typestore.types, header(typestore, frame_id)
    if topic.kind == "joints":
        no_values = np.zeros(0)
        efforts = np.zeros(len(topic.names))
        return types[topic.type](header=blank, name=list(topic.names), position=no_values, velocity=no_values, effort=efforts)
    if topic.kind == "wrench":
        vector = types["geometry_msgs/msg/Vector3"]
        wrench = types["geometry_msgs/msg/Wrench"](force=vector(x=0.0, y=0.0, z=0.0), torque=vector(x=0.0, y=0.0, z=0.0))
        return types[topic.type](header=blank, wrench=wrench)
    if topic.kind == "temperature":
        return types[topic.type](header=blank, temperature=0.0, variance=0.0)
    return types[topic.type](data=0.0)


def header(typestore: Typestore, frame_id: str, stamp_ns: int = 0) -> Any:
    """The header of a message."""
    types = typestore.types
    time = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, SECOND_NS))
    return types["std_msgs/msg/Header"](stamp=time, frame_id=frame_id)
