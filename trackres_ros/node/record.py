# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes every estimate of the running node into a bag, and a picture of them at the end."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from trackres_ros.errors import MissingExtraError
from trackres_ros.estimator.estimate import Steps
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.learning.columns import LearnedTopic
from trackres_ros.learning.learner import Learner
from trackres_ros.offline.summary import picture_columns
from trackres_ros.output.bag import OutputBag
from trackres_ros.output.plots import plot_estimate
from trackres_ros.output.preview import ResultPreview

BLOCK_ROWS = 256

TakeEstimate = Callable[[list[float], int, int], None]


class Recorder:
    """Takes estimates one by one and writes them in blocks; the bag takes its place when it ends."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._rows: list[tuple[list[float], int, int]] = []
        self._estimator: Estimator | None = None
        self._bag: OutputBag | None = None
        self._seen: ResultPreview | None = None
        self._columns: tuple[str, ...] = ()

    def begin(self, estimator: Estimator, learner: Learner | None = None) -> TakeEstimate:
        """Begin the bag; the function takes a row of results, its stamp and its arrival [ns].

        With a learner, its columns stand behind those of the estimate.
        """
        learned = None if learner is None else LearnedTopic(learner)
        self._columns = (*estimator.columns, *(() if learned is None else learned.names))
        self._estimator, self._seen = estimator, ResultPreview(len(self._columns))
        self._bag = OutputBag(self.path, estimator, learned)
        self._bag.__enter__()
        return self._take

    def end(self) -> list[str]:
        """Finish the bag and draw the picture; what was written, in words."""
        if self._bag is None or self._seen is None or self._estimator is None:
            return []
        self._write()
        self._bag.__exit__(None, None, None)
        if not self._seen.steps:
            return [f"{self.path}: no estimate was made, so it is empty"]
        picture = self.path.with_suffix(".png")
        lines = [f"{self.path}: {self._seen.steps} estimates as topics"]
        try:
            columns = picture_columns(self._columns, self._seen.kept)
            plot_estimate(picture, self._seen.kept[:, 0], columns, f"Live: {self._estimator.vehicle.title}")
        except MissingExtraError as error:
            return [*lines, f"no picture: {error}"]
        return [*lines, f"{picture}: torque and temperature over time"]

    def _take(self, row: list[float], stamp_ns: int, arrival_ns: int) -> None:
        self._rows.append((row, stamp_ns, arrival_ns))
        if len(self._rows) >= BLOCK_ROWS:
            self._write()

    def _write(self) -> None:
        if self._rows and self._bag and self._seen:
            rows, stamps, arrivals = zip(*self._rows, strict=True)
            steps = Steps(np.array(stamps, dtype=np.int64), np.array(arrivals, dtype=np.int64), np.array(rows))
            self._seen.take(steps, self._bag.write)
            self._rows.clear()
