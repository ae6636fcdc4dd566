# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines the result of a simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.records import Steps
from trackres_ros.files.output_files import BAG_SUFFIX, not_an_input, output_file
from trackres_ros.model.coverage import beyond
from trackres_ros.model.resistance import resistance_parts
from trackres_ros.offline.energy import taken
from trackres_ros.offline.simulate import SimulatedDrive, by_column, series_of
from trackres_ros.output.bag import OutputBag
from trackres_ros.output.table import write_table
from trackres_ros.results.series import Array, SeriesResult
from trackres_ros.text.html import listed, panel
from trackres_ros.text.numbers import decimals, number_of
from trackres_ros.text.table import table
from trackres_ros.units import KMH_PER_MPS
from trackres_ros.vehicle import AnyVehicle

# The first is in the other remarks; the rest is of the feed-forward and of the length of a step.
UNSHOWN = at.Reason.OUTSIDE_TABLE | at.Reason.FEEDFORWARD_CLAMPED | at.HARMLESS
SUMMARY_TIMES_S = (50.0, 250.0, 600.0, 1000.0, 2500.0)


class SimulationResult(SeriesResult):
    """Torques [Nm] and belt temperature [degC] along a drive, one row per time step; see `trackres_ros.simulate`.

    Columns are ``time_s``, ``speed_mps``, ``weight_n``, ``ambient_degc``, ``belt_degc`` (mean over the assemblies) and
    ``resistance_torque_nm``, the sum of ``hysteresis_nm``, ``bearing_nm``, ``wind_nm`` and ``effects_nm``. Then follow
    ``inertia_nm``, ``drive_torque_nm`` (resistance and inertia), and ``grade_nm`` if the profile has a grade, which then is
    part of the drive torque. Without belts there are no ``belt_degc`` and ``hysteresis_nm``, and ``bearing_nm`` has all rolling
    resistance.

    Attributes
    ----------
    notes
        Unused columns of the profile.
    """

    def __init__(
        self,
        estimator: Estimator,
        drive: SimulatedDrive,
        rows: Array,
        with_grade: bool,
        notes: tuple[str, ...],
        inputs: Sequence[str | PathLike[str] | None] = (),
    ) -> None:
        self.estimator, self.notes = estimator, notes
        self.title = f"Simulated: {estimator.vehicle.title}"
        self._rows, self._drive, self._inputs = rows, drive, inputs
        self._series: dict[str, Array] = dict(series_of(estimator, drive, rows))
        if with_grade:
            self._series["grade_nm"] = rows[:, estimator.column_index["grade_nm"]]

    @property
    def vehicle(self) -> AnyVehicle:
        """The vehicle of the simulation."""
        return self.estimator.vehicle

    @property
    def remarks(self) -> list[str]:
        """Belt temperatures outside the rubber data, loads outside the table of losses, and other reasons of the estimator."""
        index = self.estimator.column_index
        reasons = self._rows[:, index["reasons"]].astype(np.int64)
        counts = {reason: int(np.count_nonzero(reasons & int(reason))) for reason in at.REASON_TEXT if not reason & UNSHOWN}
        texts = [f"{at.REASON_TEXT[reason]} ({number_of(count, 'step')})" for reason, count in counts.items() if count]
        return [*beyond(self.vehicle, by_column(self.estimator, self._rows)), *texts]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all columns, as in the table that `save` writes."""
        return tuple(self._series)

    def __getitem__(self, name: str) -> Array:
        return self._series[name].copy()

    def _drawn(self) -> Mapping[str, Array]:
        return self._series

    def _attributes(self) -> dict[str, str]:
        return {"vehicle": self.vehicle.name, "hysteresis": self.vehicle.hysteresis, "thermal": self.vehicle.thermal}

    def save(self, path: str | PathLike[str]) -> Path:
        """Write to a file, with the same bytes as `trackres simulate -o`.

        Parameters
        ----------
        path
            `.csv`, `.csv.gz`, `.parquet` or `.mf4` for a table of `columns`; `.mcap` for topics of the live node, without the
            standard deviation of the resistance.

        Returns
        -------
        Path
            Of the file.

        Raises
        ------
        InputError
            Another suffix, no such folder, or an input of the simulation.
        """
        file = output_file(path, where="path")
        not_an_input(file, self._inputs, "path")
        if file.suffix.lower() == BAG_SUFFIX:
            stamps = np.round((self._drive.time_s - self._drive.time_s[0]) * 1e9).astype(np.int64)
            with OutputBag(file, self.estimator) as bag:
                bag.write(Steps(stamps, stamps, self._rows))
        else:
            write_table(file, self._series, estimates=True)
        return file

    def points(self) -> list[dict[str, float]]:
        """All columns at a few times, for a summary.

        Returns
        -------
        list of dict of str to float
            One row for each time, by column.
        """
        time = self.time_s
        at_times = [t for t in SUMMARY_TIMES_S if t <= time[-1]] or [float(time[-1])]
        rows = [min(int(np.searchsorted(time, t - 1e-9)), len(time) - 1) for t in at_times]
        return [{name: float(values[row]) for name, values in self.items()} for row in rows]

    @property
    def drive(self) -> dict[str, float]:
        """Summary of the drive: distance, driving time, resistance [Nm], energy, kWh/km, belts."""
        return taken(self.vehicle, self.time_s, by_column(self.estimator, self._rows))

    def as_dict(self) -> dict[str, Any]:
        """The summary, ready for JSON.

        Returns
        -------
        dict
            Names of vehicle and methods, the number of rows, `points`, and `drive`.
        """
        return {
            "vehicle": self.vehicle.name,
            "method": self.vehicle.hysteresis,
            "thermal": self.vehicle.thermal,
            "rows": len(self.time_s),
            "points": self.points(),
            "remarks": self.remarks,
            "drive": self.drive,
        }

    def __repr__(self) -> str:
        belts = ["belt_degc"] if "belt_degc" in self else []
        parts = {"resistance": "resistance_torque_nm", **resistance_parts(bool(belts))}
        head = ["time\ns", "speed\nkm/h", *(f"{part}\nNm" for part in parts), *("belt\ndegC" for _ in belts)]
        rows = [
            [
                decimals(p["time_s"]),
                decimals(p["speed_mps"] * KMH_PER_MPS, 1),
                *(decimals(p[column]) for column in parts.values()),
                *(decimals(p[column], 1) for column in belts),
            ]
            for p in self.points()
        ]
        return "\n".join([table(rows, head), *(f"  ! {remark}" for remark in self.remarks)])

    def _repr_html_(self) -> str:
        return panel(f"{self.title}, {len(self.time_s)} rows", self._table(), listed("Remarks", self.remarks))
