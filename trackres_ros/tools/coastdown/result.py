# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines the result of a coast-down."""

from __future__ import annotations

import math
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from trackres_ros.errors import InputError, one_line
from trackres_ros.files.output_files import not_an_input, output_file, picture_file
from trackres_ros.text import alike, figures
from trackres_ros.tools.coastdown.fitted import Coastdown, rollouts_of
from trackres_ros.units import KMH_PER_MPS


class CoastdownResult:
    """Resistance parameters from coast-downs; see `trackres_ros.coastdown`.

    Attributes
    ----------
    recordings
        Paths of the recordings.
    coastdown
        All intermediate results, step by step.
    """

    def __init__(self, coastdown: Coastdown, recordings: Sequence[Path], inputs: Sequence[Path] = ()) -> None:
        self.coastdown, self.recordings, self._inputs = coastdown, tuple(recordings), inputs

    @property
    def better(self) -> bool:
        """Whether the values improve the hold-out coast-downs significantly; only then they are written."""
        return self.coastdown.better

    @property
    def why_not(self) -> str:
        """Why the values are not better; empty if they are."""
        coastdown = self.coastdown
        if self.better:
            return ""
        unknown_slope = not all("grade" in session.given for session in coastdown.runs.sessions)
        remedy = "; an unrecorded slope may hide a gain: record the slope or the altitude" if unknown_slope else ""
        if not any(p.determined for p in coastdown.parameters):
            return f"the coast-downs add nothing to the vehicle file{remedy}"
        if coastdown.improvement is None:
            return "too few coast-downs for a hold-out set: record three or more, in both directions if the slope is unknown"
        if parameters_outside := [p for p in coastdown.parameters if p.is_outside]:
            texts = ", ".join(
                f"{p.name} {figures(p.value, 3)} (allowed: {p.by_file[0]:g} to {p.by_file[1]:g})" for p in parameters_outside
            )
            check = "check the unit of the speed, the mass, and that nothing drove or braked"
            return f"values outside their ranges in the vehicle file: {texts}; {check}; if they are right, widen the ranges"
        if coastdown.refusal:
            return f"no command would accept a vehicle file with the values: {coastdown.refusal}"
        error_before, error_after = figures(coastdown.improvement.before, 3), figures(coastdown.improvement.after, 3)
        error = f"the mean error is {error_after} Nm with them and {error_before} Nm with the vehicle file as it is"
        return f"on the hold-out coast-downs {error}{remedy}"

    def __repr__(self) -> str:
        runs, coastdown = self.coastdown.runs, self.coastdown
        seconds = sum((s.end - s.begin) * runs.sessions[s.session].step for s in runs.stretches)
        lines = [f"{runs.count} coast-downs, {seconds:.0f} s in all"]
        rows = [("parameter", "file", "+-", "found" if self.better else "not confirmed", "low", "high", "unit", "")]
        for p in coastdown.parameters:
            numbers = alike([p.file_value, p.value, p.interval.low, p.interval.high], p.interval.high - p.interval.low)
            std = "" if math.isinf(p.file_std) else figures(2.0 * p.file_std, 2)
            partners = f"only together with {', '.join(p.with_others)}" if p.with_others and p.determined else ""
            columns = (numbers[1], numbers[2], numbers[3]) if p.determined else ("not told", "", "")
            rows.append((p.name, numbers[0], std, *columns, "" if p.unit == "1" else p.unit, partners))
        widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
        align = ("<", ">", ">", ">", ">", ">", "<", "<")
        lines += [
            "  ".join(f"{c:{alignment}{w}}" for c, alignment, w in zip(row, align, widths, strict=True)).rstrip() for row in rows
        ]
        lines.append(
            f"The ranges include the uncertainty of the mass and rotating parts in the file, +-{200 * coastdown.mass_std:.0f} %"
        )
        if coastdown.improvement is not None and self.better:
            error_before, error_after = figures(coastdown.improvement.before, 3), figures(coastdown.improvement.after, 3)
            lines.append(f"On the hold-out coast-downs the mean error falls from {error_before} to {error_after} Nm")
        else:
            lines.append(f"The vehicle file stays as it is: {self.why_not}")
        lines += [f"  note: {note}" for note in runs.notes]
        lines += [f"  not used: {count} {reason}" for reason, count in runs.rejections.items()]
        return "\n".join(map(one_line, lines))

    def as_dict(self) -> dict[str, Any]:
        """All numbers, for JSON."""
        coastdown = self.coastdown
        improvement = coastdown.improvement
        return {
            "recordings": [str(path) for path in self.recordings],
            "vehicle": coastdown.base_file.title,
            "rollouts": [
                {
                    "recording": rollout.name, "begin_s": float(rollout.time[0]),
                    "seconds": float(rollout.time[-1] - rollout.time[0]),
                    "from_mps": float(rollout.speed[0]), "to_mps": float(rollout.speed[-1]),
                    "too_fast_at_the_end_mps": {
                        "file": float(rollout.by_file[-1] - rollout.speed[-1]),
                        "found": float(rollout.by_found[-1] - rollout.speed[-1]),
                    },
                }
                for rollout in rollouts_of(coastdown)
            ],
            "parameters": {
                p.name: {
                    "unit": p.unit, "file": p.file_value, "file_std": None if math.isinf(p.file_std) else p.file_std,
                    "value": p.value, "low": p.interval.low, "high": p.interval.high, "told": p.determined,
                    "only_with": list(p.with_others),
                }
                for p in coastdown.parameters
            },
            "mass_relative_std": coastdown.mass_std,
            "held_out_nm": None if improvement is None else {
                "file": improvement.before, "found": improvement.after, "better_low": improvement.low,
                "better_high": improvement.high,
            },
            "better": self.better,
            "why_not": self.why_not,
            "notes": list(coastdown.runs.notes),
            "left_out": dict(coastdown.runs.rejections),
        }  # fmt: skip

    def save_vehicle(self, path: str | PathLike[str]) -> list[Path]:
        """Write a vehicle file with the estimates and their ranges.

        Parameters
        ----------
        path
            ``.yaml``.

        Returns
        -------
        list of Path
            The files written.

        Raises
        ------
        InputError
            If they are not better than the file's on the hold-out coast-downs, or the path is an input.
        """
        file = output_file(path, (".yaml",), "save_vehicle")
        not_an_input(file, self._inputs, "save_vehicle")
        if not self.better:
            raise InputError("save_vehicle", str(path), "values that are better than the file's", self.why_not)
        names = ", ".join(one_line(recording.name) for recording in self.recordings)
        text = f"{self.coastdown.changes.text}.\nWritten by trackres coastdown from {names}."
        return self.coastdown.base_file.base.write(file, self.coastdown.changes, text)

    def plot(self, path: str | PathLike[str]) -> Path:
        """Draw the measured speed, and the speeds by the vehicle file and by the estimates.

        Parameters
        ----------
        path
            ``.png`` or ``.svg``.

        Returns
        -------
        Path
            The picture.

        Raises
        ------
        InputError
            Another suffix, or a folder of that name.
        MissingExtraError
            Matplotlib is not installed.
        """
        from trackres_ros.output.style import BLACK, BLUE, VERMILION, picture, shorten

        file = picture_file(path)
        styles: tuple[tuple[str, str, str], ...] = (
            ("measured", BLACK, "-"), ("by the vehicle file", VERMILION, "--"), ("as found", BLUE, "-"),
        )  # fmt: skip
        with picture(file, 9.0, 6.4) as figure:
            top, bottom = figure.subplots(2)
            for number, rollout in enumerate(rollouts_of(self.coastdown)):
                time = rollout.time - rollout.time[0]
                for (label, colour, line), speed in zip(styles, (rollout.speed, rollout.by_file, rollout.by_found), strict=True):
                    top.plot(time, KMH_PER_MPS * speed, line, color=colour, lw=1.2, label=label if number == 0 else None)
                for (label, colour, line), torque in zip(styles[1:], (rollout.over_file, rollout.over_found), strict=True):
                    kmh = KMH_PER_MPS * rollout.speed
                    bottom.plot(kmh, torque, line, color=colour, lw=1.0, label=label if number == 0 else None)
            title = shorten(self.coastdown.base_file.title, 90)
            top.set(xlabel="time since the coast-down began [s]", ylabel="speed [km/h]", title=title)
            bottom.axhline(0.0, color=BLACK, lw=0.8)
            bottom.set(xlabel="speed [km/h]", ylabel="residual torque [Nm]")
            top.legend()
            bottom.legend()
        return file
