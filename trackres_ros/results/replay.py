# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines the result of a replay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from trackres_ros.errors import InputError
from trackres_ros.estimator.estimator import Estimator, Session
from trackres_ros.estimator.records import Steps
from trackres_ros.files.output_files import not_an_input, output_file
from trackres_ros.learning.columns import column_names
from trackres_ros.learning.learner import Learner
from trackres_ros.learning.store import LearnedFile
from trackres_ros.offline.disturbance import DisturbanceColumns
from trackres_ros.offline.replay import Replayed, result_writer
from trackres_ros.offline.summary import summary, text
from trackres_ros.output.preview import picture_columns
from trackres_ros.recording.samples import Finding
from trackres_ros.results.series import Array, SeriesResult
from trackres_ros.text.html import listed, panel, paragraph
from trackres_ros.units import NANOSECOND
from trackres_ros.vehicle import AnyVehicle

MOST_UNFOLDED = 4
TIMES = ("time_s", "stamp_ns")


class ReplayResult(SeriesResult):
    """The estimate over a recording, one row for each accepted speed; see `trackres_ros.replay`.

    Attributes
    ----------
    name
        Of the recording.
    notes, findings
        Assumptions of the reader, and defects of the recording.
    messages, steps, duration_s
        Number of messages and of rows, and time of all steps [s]: without steps back, and without gaps too long to bridge.
    session
        The estimator's session at the end; its counters include those of a resumed state.
    output
        The file written during the replay; its rows are then not in memory.
    written
        All files that the replay wrote: `output`, the state, the vehicle file and the files copied for it.
    """

    def __init__(
        self,
        replayed: Replayed,
        kept: Sequence[Steps] | None,
        title: str,
        name: str,
        notes: Sequence[str],
        findings: Sequence[Finding],
        output: Path | None = None,
        inputs: Sequence[str | PathLike[str] | None] = (),
    ) -> None:
        self.title, self.name, self.notes, self.findings, self.output = title, name, tuple(notes), tuple(findings), output
        self.session: Session = replayed.session
        self.messages, self.steps, self.duration_s = replayed.messages, replayed.steps, replayed.totals.duration_s
        self.written: tuple[Path, ...] = ()
        self._replayed, self._kept, self._inputs = replayed, kept, inputs

    @property
    def estimator(self) -> Estimator:
        """The estimator of the replay."""
        return self.session.estimator

    @property
    def vehicle(self) -> AnyVehicle:
        """The vehicle of the replay."""
        return self.estimator.vehicle

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all columns, as in the table that `save` writes."""
        return (*TIMES, *self._of_rows, *DisturbanceColumns(self.vehicle).names)

    @property
    def learner(self) -> Learner | None:
        """The learner; None if learning was off."""
        return self._replayed.learner

    @property
    def learned_file(self) -> LearnedFile | None:
        """What the vehicle file of `save_vehicle` got, and why if nothing; None if none was asked for."""
        return self._replayed.learned_file

    @property
    def _of_rows(self) -> tuple[str, ...]:
        learned = () if self.learner is None else column_names(self.learner.learnables)
        return (*self.estimator.columns, *learned)

    @cached_property
    def _stamps(self) -> Array:
        return np.concatenate([steps.stamp_ns for steps in self._blocks()])

    @cached_property
    def _watched(self) -> dict[str, Array]:
        """Watched disturbance, by column."""
        watched = DisturbanceColumns(self.vehicle)
        blocks = [watched.of(steps) for steps in self._blocks()]
        return {name: np.concatenate([block[i] for block in blocks]) for i, name in enumerate(watched.names)}

    def __getitem__(self, name: str) -> Array:
        if name == "stamp_ns":
            return self._stamps.copy()
        if name == "time_s":
            return np.asarray((self._stamps - self._stamps[0]) * NANOSECOND)
        if name in DisturbanceColumns(self.vehicle).names:
            return self._watched[name].copy()
        if name not in self._of_rows:
            raise KeyError(name)
        column = self._of_rows.index(name)
        values = np.concatenate([steps.rows[:, column] for steps in self._blocks()])
        return values.astype(np.int64) if name == "reasons" else values

    def _blocks(self) -> Sequence[Steps]:
        if self._kept is None:
            allowed = "a replay without output, which holds its rows in memory"
            raise InputError("replay", f"output={str(self.output)!r}", allowed, "or read that file")
        return self._kept

    def _drawn(self) -> Mapping[str, Array]:
        picture = self._replayed.picture
        return {"time_s": picture[:, 0], **picture_columns(self._of_rows, picture)}

    def _coverage(self) -> Array | None:
        return None if self.learner is None else self.learner.buckets.seconds

    def _attributes(self) -> dict[str, str]:
        return {"vehicle": self.vehicle.name, "recording": self.name}

    def save(self, path: str | PathLike[str]) -> Path:
        """Write the rows to a file, with the same bytes as `trackres replay -o`.

        Parameters
        ----------
        path
            `.csv`, `.csv.gz`, `.parquet` or `.mf4` for a table; `.mcap` for topics of the live node. Only the table has the
            standard deviation of the resistance, and a disturbance.

        Returns
        -------
        Path
            Of the file.

        Raises
        ------
        InputError
            Another suffix, no such folder, an input of the replay, or rows that were not kept, as they went into an `output`.
        """
        file = output_file(path, where="path")
        not_an_input(file, self._inputs, "path")
        blocks = self._blocks()
        with result_writer(file, self.estimator, self.learner) as write:
            for steps in blocks:
                write(steps)
        return file

    def as_dict(self) -> dict[str, Any]:
        """The summary of reading and estimate, ready for JSON.

        Returns
        -------
        dict
            Input, defects, and the last estimate.
        """
        return summary(self._replayed, self.name, self.notes, self.findings)

    def __repr__(self) -> str:
        return text(self.as_dict())

    def _repr_html_(self) -> str:
        first, *others = repr(self).splitlines()
        about = [line.strip() for line in others if line.startswith("  ")]
        end = [line for line in others if not line.startswith("  ")]
        found = listed("Inputs and findings", about, folded=len(about) > MOST_UNFOLDED)
        return panel(self.title, paragraph(first), self._table(), *map(paragraph, end), found)
