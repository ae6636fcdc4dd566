"""From a row of results to messages: values as they stand on the wire, the fallback of the feed-forward, and their pace."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from trackres_ros.compiled import interpreted
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.kernel import fade
from trackres_ros.live.edge import Edge, Status
from trackres_ros.outputs import OutputTopic

FADE = interpreted(fade)  # one number at a time: nothing is gained by compiling it at the first start
FADING = ("feedforward_torque_nm",)
Row = list[float]
Values = Callable[[Row], list[float]]


class Outlet:
    """Publishes the last estimate through an edge.

    While the speed is old the last state goes on being published with its stamp, and the feed-forward fades to zero: who takes it
    without its stamp is safe too.
    """

    def __init__(self, outputs: Sequence[OutputTopic], estimator: Estimator, edge: Edge) -> None:
        self.estimator = estimator
        self.outputs = outputs
        self.row: Row = []
        self.stamp_ns: int | None = None
        self.published = 0
        self._edge = edge
        self._taken_ns = 0
        index = estimator.column_index
        self._values = [(i, _values(topic, index)) for i, topic in enumerate(outputs) if topic.kind != "status"]
        self._feedforward = [index[name] for name in FADING]

    def take(self, row: Row, stamp_ns: int, steady: int) -> None:
        """Keep a row of results and the time of its state."""
        self.row, self.stamp_ns, self._taken_ns = row, stamp_ns, steady

    def age_s(self, steady: int) -> float:
        """Time since the last estimate was made [s]; infinite before the first."""
        return math.inf if self.stamp_ns is None else (steady - self._taken_ns) * 1e-9

    def left(self, steady: int) -> float:
        """Share of the feed-forward that is left at the age of the speed."""
        settings = self.estimator.settings
        age_s = self.age_s(steady)
        return 0.0 if math.isinf(age_s) else FADE(age_s, settings.speed_max_age_s, settings.feedforward_fade_s)

    def publish(self, steady: int) -> None:
        """Publish the last estimate on all topics of numbers; nothing before the first one."""
        if self.stamp_ns is None:
            return
        row, left = self.row, self.left(steady)
        if left < 1.0:
            row = row.copy()
            for column in self._feedforward:
                row[column] *= left
        for output, values in self._values:
            numbers = values(row)
            if all(map(math.isfinite, numbers)):
                self._edge.publish(output, self.stamp_ns, numbers)
        self.published += 1

    def publish_statuses(self, statuses: Sequence[Status], now_ns: int, diagnostics: bool) -> None:
        """Publish the first status on the node's own topic, and all as diagnostics when asked."""
        for output, topic in enumerate(self.outputs):
            if topic.kind == "status" and (diagnostics or not topic.name.startswith("/")):
                self._edge.publish_status(output, now_ns, statuses if topic.name.startswith("/") else statuses[:1])


def _values(topic: OutputTopic, index: dict[str, int]) -> Values:
    """A function that picks a topic's numbers out of a row; see `outputs.values_of`."""
    columns, sign = [index[name] for name in topic.columns], topic.sign
    if topic.kind == "temperature":
        mean, std = columns
        return lambda row: [row[mean], row[std] ** 2]
    return lambda row: [row[column] * sign + 0.0 for column in columns]
