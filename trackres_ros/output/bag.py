# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes results as topics of an MCAP file: those of the live node, except `estimate`, `parameters` and diagnostics."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimate import Steps
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.learning.columns import LearningColumns
from trackres_ros.output.mcap import BagTopic, BagWriter
from trackres_ros.output.topics import (
    BASE_FRAME,
    DEFAULT_NODE,
    PARAMETERS_TOPIC,
    OutputTopic,
    output_topics,
    status_of,
    values_of,
)

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

STATUS_PERIOD_NS = 1_000_000_000
FIELDS = {"wrench": ("wrench.torque.y",), "number": ("data",), "temperature": ("temperature", "variance")}


class OutputBag:
    """Writes blocks of results; the file is put in place when the `with` block ends well. See `BagWriter` for `part`."""

    def __init__(
        self, path: Path, estimator: Estimator, learned: LearningColumns | None = None, part: Path | None = None
    ) -> None:
        self.path, self.writer = path, BagWriter(path, part=part)
        self._estimator, self._learned = estimator, learned
        self._topics: list[tuple[OutputTopic, BagTopic]] = []
        self._last_reasons: int | None = None
        self._last_status_ns = self._last_learned_ns = 0

    def __enter__(self) -> Self:
        """Begin the file and announce the topics."""
        self.writer.__enter__()
        parameters = () if self._learned is None else (PARAMETERS_TOPIC,)
        for topic in (*output_topics(self._estimator.vehicle), *parameters):
            fields = FIELDS.get(topic.kind, tuple(f"effort[{i}]" for i in range(len(topic.names))))
            template = None if topic.kind == "status" else template_message(topic, self.writer.typestore, BASE_FRAME)
            name = f"/{DEFAULT_NODE}/{topic.name}"
            self._topics.append((topic, self.writer.topic(name, topic.type, template, fields if template is not None else ())))
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
            values = values_of(topic, steps.rows, self._estimator.column_index)
            known = np.isfinite(values).all(axis=1)
            self.writer.write_block(bag_topic, steps.stamp_ns[known], steps.arrival_ns[known], values[known])

    def _write_status(self, topic: BagTopic, steps: Steps) -> None:
        reasons = steps.rows[:, at.Results.reasons].astype(np.int64)
        before = np.concatenate([[-1 if self._last_reasons is None else self._last_reasons], reasons[:-1]])
        for i in self._due(steps.arrival_ns, reasons != before):
            level, text = status_of(at.Reason(int(reasons[i])))
            message = self._diagnostics([(level, "estimate", text, ())])
            self.writer.write(topic, message, int(steps.stamp_ns[i]), int(steps.arrival_ns[i]))
        if len(reasons):
            self._last_reasons = int(reasons[-1])

    def _write_learned(self, topic: BagTopic, steps: Steps) -> None:
        """Learned values, once a second."""
        assert self._learned is not None
        for i, second in enumerate((steps.arrival_ns // STATUS_PERIOD_NS).tolist()):
            if second != self._last_learned_ns:
                self._last_learned_ns = second
                found = [(0, name, message, known) for name, message, known in self._learned.lines(steps.rows[i].tolist())]
                self.writer.write(topic, self._diagnostics(found), int(steps.stamp_ns[i]), int(steps.arrival_ns[i]))

    def _due(self, arrival_ns: NDArray[np.int64], changed: NDArray[np.bool_]) -> list[int]:
        """Rows at which a status is due: at each change, and once a second."""
        if not len(arrival_ns):
            return []
        period = arrival_ns // STATUS_PERIOD_NS
        new_second = np.concatenate([[period[0] != self._last_status_ns], np.diff(period) != 0])
        self._last_status_ns = int(period[-1])
        return [int(i) for i in np.flatnonzero(changed | new_second)]

    def _diagnostics(self, statuses: Iterable[tuple[int, str, str, Iterable[tuple[str, str]]]]) -> Any:
        """A message of some statuses, each with level, name, text and values."""
        types, node, vehicle = self.writer.typestore.types, DEFAULT_NODE, self._estimator.vehicle.name
        status, pair = types["diagnostic_msgs/msg/DiagnosticStatus"], types["diagnostic_msgs/msg/KeyValue"]
        listed = [
            status(
                level=level,
                name=f"{node}: {name}",
                message=text,
                hardware_id=vehicle,
                values=[pair(key=k, value=v) for k, v in of],
            )
            for level, name, text, of in statuses
        ]
        return types["diagnostic_msgs/msg/DiagnosticArray"](header=_header(types, BASE_FRAME), status=listed)


def template_message(topic: OutputTopic, typestore: Typestore, frame_id: str) -> Any:
    """A message of a topic with all its strings, and zeros for its numbers and its stamp."""
    types = typestore.types
    header = _header(types, frame_id)
    if topic.kind == "joints":
        none = np.zeros(0)
        efforts = np.zeros(len(topic.names))
        return types[topic.type](header=header, name=list(topic.names), position=none, velocity=none, effort=efforts)
    if topic.kind == "wrench":
        vector = types["geometry_msgs/msg/Vector3"]
        wrench = types["geometry_msgs/msg/Wrench"](force=vector(x=0.0, y=0.0, z=0.0), torque=vector(x=0.0, y=0.0, z=0.0))
        return types[topic.type](header=header, wrench=wrench)
    if topic.kind == "temperature":
        return types[topic.type](header=header, temperature=0.0, variance=0.0)
    return types[topic.type](data=0.0)


def _header(types: Mapping[str, Any], frame_id: str) -> Any:
    return types["std_msgs/msg/Header"](stamp=types["builtin_interfaces/msg/Time"](sec=0, nanosec=0), frame_id=frame_id)
