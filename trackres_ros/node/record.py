# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes every message that the running node takes, and every estimate, into a bag, and a picture of them at the end."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trackres_ros.errors import MissingExtraError
from trackres_ros.estimator.estimate import Steps
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.learning.columns import LearnedTopic
from trackres_ros.node.endpoints import input_name
from trackres_ros.offline.summary import picture_columns
from trackres_ros.output.bag import OutputBag
from trackres_ros.output.mcap import BagTopic
from trackres_ros.output.plots import plot_estimate
from trackres_ros.output.preview import ResultPreview

if TYPE_CHECKING:
    from trackres_ros.node.application import Application

BLOCK_ROWS, BLOCK_MESSAGES = 256, 1024


class Recorder:
    """Takes messages and estimates one by one and writes them in blocks; the bag takes its place when it ends.

    Messages stand under the names that the topics file has for them, whatever the namespace: with it the bag is a recording like
    any other. A message that came before the simulated clock stands at the clock's first time, and no two of a topic at the same.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._rows: list[tuple[list[float], int, int]] = []
        self._estimator: Estimator | None = None
        self._bag: OutputBag | None = None
        self._seen: ResultPreview | None = None
        self._columns: tuple[str, ...] = ()
        self._topics: list[BagTopic] = []
        self._messages: list[tuple[int, bytes, int]] = []
        self._counts: list[int] = []
        self._last: list[int] = []

    def begin(self, application: Application) -> None:
        """Begin the bag, and take from now on what the application takes and makes.

        Where it learns, the columns of what is learned stand behind those of the estimate.
        """
        estimator, learner = application.estimator, application.learning.learner
        learned = None if learner is None else LearnedTopic(learner)
        self._columns = (*estimator.columns, *(() if learned is None else learned.names))
        self._estimator, self._seen = estimator, ResultPreview(len(self._columns))
        self._bag = OutputBag(self.path, estimator, learned)
        self._bag.__enter__()
        for given, text in application.record(self._keep):
            self._topics.append(self._bag.raw_topic(input_name(given.name, "/"), given.type, text))
        self._counts, self._last = [0] * len(self._topics), [0] * len(self._topics)
        application.on_estimate = self._take

    def end(self) -> list[str]:
        """Finish the bag and draw the picture; what was written, in words."""
        if self._bag is None or self._seen is None or self._estimator is None:
            return []
        self._write()
        self._bag.__exit__(None, None, None)
        inputs = ", ".join(f"{count} of {topic.name}" for topic, count in zip(self._topics, self._counts, strict=True))
        if not self._seen.steps:
            return [f"{self.path}: no estimate was made; messages: {inputs}"]
        picture = self.path.with_suffix(".png")
        lines = [f"{self.path}: {self._seen.steps} estimates as topics; messages: {inputs}"]
        try:
            columns = picture_columns(self._columns, self._seen.kept)
            plot_estimate(picture, self._seen.kept[:, 0], columns, f"Live: {self._estimator.vehicle.title}")
        except MissingExtraError as error:
            return [*lines, f"no picture: {error}"]
        return [*lines, f"{picture}: torque and temperature over time"]

    def _keep(self, index: int, raw: bytes, arrival_ns: int) -> None:
        self._counts[index] += 1
        self._messages.append((index, raw, arrival_ns))
        if len(self._messages) >= BLOCK_MESSAGES:
            self._write()

    def _take(self, row: list[float], stamp_ns: int, arrival_ns: int) -> None:
        self._rows.append((row, stamp_ns, arrival_ns))
        if len(self._rows) >= BLOCK_ROWS:
            self._write()

    def _write(self) -> None:
        if self._bag and any(arrival > 0 for _, _, arrival in self._messages):
            first = next(arrival for _, _, arrival in self._messages if arrival > 0)
            for index, raw, arrival in self._messages:
                # A simulated clock stands between its ticks; what has no stamp of its own would be twice the same sample.
                self._last[index] = max(arrival if arrival > 0 else first, self._last[index] + 1)
                self._bag.write_raw(self._topics[index], raw, self._last[index])
            self._messages.clear()
        if self._rows and self._bag and self._seen:
            rows, stamps, arrivals = zip(*self._rows, strict=True)
            steps = Steps(np.array(stamps, dtype=np.int64), np.array(arrivals, dtype=np.int64), np.array(rows))
            self._seen.take(steps, self._bag.write)
            self._rows.clear()
