# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The first picture of a page: the residual over time, each term over it, and the remaining residual."""

from __future__ import annotations

from pathlib import Path

from trackres_ros.diagnosis.pipeline import Diagnosis
from trackres_ros.diagnosis.report.believed import AVERAGED_S, MARK, begins, held_out_times, marked_times, minutes, names, panels
from trackres_ros.diagnosis.report.picture import WIDTH, Picture
from trackres_ros.diagnosis.report.series import clock, lasting
from trackres_ros.output.style import GREY, picture_with_legend, thinned

MOST_POINTS = 3000  # of a line over all sessions
LEGEND_LETTERS = 115
LETTERS = 105  # of a small font over the whole width


def draw_believed(d: Diagnosis, path: Path) -> Picture:
    """Draw the residual of the re-fitted base over all sessions with each term over it, and the remaining residual below."""
    drawn, ends = panels(d), begins(d)
    text, marked = marked_times(d)
    most = max(60, MOST_POINTS // len(d.sessions))
    entries = ["hold-out laps", *(line.text for line in drawn[0].lines), text]
    columns = max(1, LEGEND_LETTERS // (6 + max(map(len, entries))))
    with picture_with_legend(path, WIDTH, 1.9 * len(drawn) + 0.5, -(-len(entries) // columns)) as body:
        axes = body.subplots(len(drawn), 1, squeeze=False, sharex=True, sharey=True)[:, 0]
        for axis, panel in zip(axes, drawn, strict=True):
            for begin, end in held_out_times(d):
                axis.axvspan(begin, end, color=GREY, alpha=0.18, linewidth=0, label="hold-out laps")
            axis.axhline(0.0, color=GREY, linewidth=0.8)
            for begin in ends[1:-1]:
                axis.axvline(begin, color=GREY, linestyle=":", linewidth=1.0)
            for line in panel.lines:
                label = line.text if panel is drawn[0] else ""  # the title of the panel below names its line
                for i, values in enumerate(line.values):
                    axis.plot(
                        *thinned(minutes(d, i), values, most), color=line.colour, label=label,
                        linewidth=(2.4 if line.solid else 1.4) if line.wide else 0.8, zorder=2.0 if line.wide else 2.5,
                        linestyle="-" if line.solid else (0, (3, 1.5)),
                    )  # fmt: skip
            axis.set_title(panel.title, fontsize=8.5)
            axis.set_xlim(0.0, ends[-1])
            axis.set_ylabel("torque [Nm]")
        for begin, end in marked:
            axes[0].axvspan(begin, end, ymax=0.04, color=MARK, linewidth=0, label=text)
        for begin, name in zip(ends, names(d, LETTERS), strict=False):
            axes[0].annotate(
                name, (begin, 1.0), (2, -2), xycoords=("data", "axes fraction"), textcoords="offset points", va="top",
                fontsize=7, color="#555555",
            )  # fmt: skip
        axes[-1].set_xlabel(f"time over consecutive recordings [{clock(d)[1]}]")
    terms = [line.text for line in drawn[0].lines if line.wide]
    over = f" with {', '.join(terms)} over it; below it the residual" if terms else ""
    errors = ". ".join(panel.title for panel in drawn)
    return Picture(
        path,
        "What the model lacks, over time",
        f"Measured torque minus the re-fitted model{over}. {errors}. Means over {lasting(d, AVERAGED_S)}, all recordings "
        "in sequence.",
    )
