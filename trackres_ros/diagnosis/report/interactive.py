# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The interactive plots of the page, with Bokeh; without it the page has only static pictures.

The page contains the library and the data compressed, and the browser decompresses them: one file, no network.
"""

from __future__ import annotations

import base64
import gzip
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from trackres_ros.diagnosis.findings.locate import SMOOTHED_S, rms_over_time, smoothed
from trackres_ros.diagnosis.pipeline import Diagnosis
from trackres_ros.diagnosis.prepare.session import Array, shown_names
from trackres_ros.diagnosis.report.series import (
    axis_label,
    bars,
    bins_of_steps,
    clock,
    lasting,
    most_off,
    shown_lap,
    stages,
)
from trackres_ros.diagnosis.report.timeline import (
    AVERAGED_S,
    MARK,
    Panel,
    begins,
    held_out_times,
    marked_times,
    minutes,
    names,
    panels,
)
from trackres_ros.errors import MissingExtraError
from trackres_ros.output.style import GREY, ORANGE, shortened
from trackres_ros.text.numbers import figures, from_to, rising

DOCUMENT = "diagnosis"
SHOWN_EACH_S = 4.0  # of means over `SMOOTHED_S`
LONGEST_LAP_S = 1200.0
TITLE_LETTERS = 60
BELIEVED_HEIGHT, RESIDUAL_HEIGHT, LAP_HEIGHT, BARS_HEIGHT = 220, 150, 170, 190  # pixels
INTERACTIVE_LETTERS = 90  # of a small font over the width of a page


@dataclass(frozen=True, slots=True)
class Interactive:
    """Plots of a page: their places, and the browser's data, packed (gzip, base64)."""

    plots: Mapping[str, Sequence[tuple[str, str]]]  # of each part of the page: their elements and titles
    library: str  # source of Bokeh
    version: str  # of Bokeh
    data: str  # Bokeh's documents, and the bin of each step
    over_all: Sequence[tuple[str, str, bool]]  # colours and texts of the lines over all drives, and whether solid


def interactive(d: Diagnosis) -> Interactive:
    """Plots of a diagnosis.

    Raises
    ------
    MissingExtraError
        Without Bokeh.
    """
    try:
        import bokeh
        from bokeh.document import Document
        from bokeh.embed.util import standalone_docs_json_and_render_items
    except ImportError:
        raise MissingExtraError("zoom and hover on the page", "bokeh", "interactive") from None
    document = Document()
    over_all = panels(d)
    parts = {"believed": _believed(d, over_all), "time": _over_time(d), "lap": _lap(d), "bars": _bars(d)}
    drawn = [figure for of in parts.values() for figure in of]
    with document.models.freeze():  # else each root checks all models again
        for figure in drawn:
            document.add_root(figure)
    (content,) = standalone_docs_json_and_render_items(drawn)[0].values()
    text, name = _named_in_order(json.dumps(content))
    roots = [name[figure.id] for figure in drawn]
    steps = [{"begin": float(s.time[0]), "step": s.step, **of} for s, of in zip(d.sessions, bins_of_steps(d), strict=True)]
    data = {
        "documents": {DOCUMENT: json.loads(text)},
        "items": [{"docid": DOCUMENT, "roots": {root: f"plot-{root}" for root in roots}, "root_ids": roots}],
        "steps": dict(enumerate(steps)),
    }
    plots = {part: [(f"plot-{name[figure.id]}", figure.title.text) for figure in of] for part, of in parts.items()}
    legend = [(line.colour, line.text, line.solid) for panel in over_all for line in panel.lines]
    where = marked_times(d)[0]
    legend += [("#D9D9D9", "hold-out laps", True), *([(MARK, where, True)] if where else [])]
    return Interactive(plots, _library(), bokeh.__version__, packed(json.dumps(data)), legend)


@cache
def _library() -> str:
    """Bokeh's own script, packed for the page."""
    from bokeh.resources import Resources

    return packed("\n".join(Resources(mode="inline", components=["bokeh"]).js_raw))


def packed(text: str) -> str:
    """A text packed for the page; the same text gives the same result."""
    return base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode()


def _named_in_order(text: str) -> tuple[str, dict[str, str]]:
    """A document with models numbered from one, independent of earlier plots, and the number of each."""
    names: dict[str, str] = {}

    def numbered(found: re.Match[str]) -> str:
        return f'"id": "{names.setdefault(found[1], f"p{len(names) + 1}")}"'

    return re.sub(r'"id": "(p\d+)"', numbered, text), names


def _figure(title: str, height: int, zoom: bool = True, **more: Any) -> Any:
    from bokeh.models import WheelZoomTool
    from bokeh.models.annotations import Title
    from bokeh.plotting import figure

    drawn: Any = figure(
        title=Title(text=title, text_font_size="12px"),
        height=height,
        sizing_mode="stretch_width",
        tools="xbox_zoom,reset" if zoom else "",
        toolbar_location="right" if zoom else None,
        **more,
    )
    if zoom:
        drawn.add_tools(WheelZoomTool(dimensions="width", modifiers={"ctrl": True}))
    drawn.toolbar.logo = None
    drawn.min_border_right = 4
    drawn.background_fill_color = None
    drawn.grid.grid_line_color = "#E3E3E3"
    for axis in drawn.axis:
        axis.axis_label_text_font_style = "normal"
        axis.major_label_text_color = axis.axis_label_text_color = "#333333"
    return drawn


def _strips(figure: Any, session: int, unit: float, counted: bool) -> None:
    """Strips for highlighting; the page's script writes their times, and sums up those that are counted."""
    from bokeh.models import ColumnDataSource

    source = ColumnDataSource({"x0": [], "x1": []}, name="lit", tags=[session, unit, counted])
    figure.vstrip("x0", "x1", source=source, fill_color=ORANGE, fill_alpha=0.45, line_color=None, level="underlay")


def _held_out_and_zero(figure: Any, times: Iterable[tuple[float, float]]) -> None:
    """The hold-out laps behind the lines, and a line at zero."""
    from bokeh.models.annotations import BoxAnnotation, Span

    for begin, end in times:
        figure.add_layout(BoxAnnotation(left=begin, right=end, fill_color=GREY, fill_alpha=0.15, line_color=None))
    figure.add_layout(Span(location=0.0, dimension="width", line_color=GREY, line_width=1))


def _numbers(values: Array, places: int) -> list[float]:
    return [float(v) for v in np.round(values, places)]


def _places(torques: Array) -> int:
    """Decimals of a torque [Nm] that show three figures of the largest; none from 100 Nm on."""
    largest = float(np.nanmax(np.abs(torques), initial=0.0))
    return min(6, max(0, 2 - math.floor(math.log10(largest)))) if largest > 0.0 else 0


def _nm(column: str, places: int) -> str:
    return f"@{column}{{0{'.' + '0' * places if places else ''}}} Nm"


def _believed(d: Diagnosis, over_all: Sequence[Panel]) -> list[Any]:
    """The residual over all drives in sequence, with each term over it, and the remaining residual."""
    from bokeh.models import ColumnDataSource, HoverTool, Range1d
    from bokeh.models.annotations import Label, Span

    ends, found = begins(d), []
    every = np.concatenate([values for panel in over_all for line in panel.lines for values in line.values])
    every, places = every[np.isfinite(every)], _places(every)
    low, high = (min(0.0, float(every.min())), max(0.0, float(every.max()))) if len(every) else (-1.0, 1.0)
    rim = 0.1 * (high - low) + 1e-9
    across = Range1d(start=0.0, end=ends[-1], bounds="auto")
    floor = low - rim
    up = Range1d(start=floor, end=high + 2.0 * rim)
    for number, panel in enumerate(over_all):
        figure = _figure(panel.title, BELIEVED_HEIGHT, x_range=across, y_range=up)
        _held_out_and_zero(figure, held_out_times(d))
        for begin in ends[1:-1]:
            figure.add_layout(Span(location=begin, dimension="height", line_color=GREY, line_dash="dotted"))
        if number == 0:
            times = marked_times(d)[1]
            of = {"x0": [x for x, _ in times], "x1": [x for _, x in times]}
            figure.quad("x0", "x1", floor + 0.5 * rim, floor, source=ColumnDataSource(of), color=MARK)
            for begin, name in zip(ends, names(d, INTERACTIVE_LETTERS), strict=False):
                figure.add_layout(
                    Label(x=begin, y=high + rim, text=name, text_font_size="10px", text_color="#555555", x_offset=3)
                )
        columns: dict[str, list[float]] = {"t": []}
        for i, session in enumerate(d.sessions):
            rows = slice(0, None, max(1, int(SHOWN_EACH_S * session.pace / session.step)))
            # A nan after each session breaks the line before the next.
            columns["t"] += [*_numbers(minutes(d, i)[rows], 3), float("nan")]
            for k, line in enumerate(panel.lines):
                columns.setdefault(f"y{k}", []).extend([*_numbers(line.values[i][rows], places + 1), float("nan")])
        source = ColumnDataSource(columns)
        lines = [
            figure.line("t", f"y{k}", source=source, color=line.colour, line_dash="solid" if line.solid else "dashed",
                        line_width=(3.4 if line.solid else 2.0) if line.wide else 1.1)
            for k, line in sorted(enumerate(panel.lines), key=lambda of: not of[1].wide)  # the measured lines on top
        ]  # fmt: skip
        texts = [("time", f"@t{{0.0}} {clock(d)[1]}"), *((line.text, _nm(f"y{k}", places)) for k, line in enumerate(panel.lines))]
        figure.add_tools(HoverTool(renderers=lines[-1:], tooltips=texts, mode="vline"))
        figure.yaxis.axis_label = "torque [Nm]"
        if number == len(over_all) - 1:
            figure.xaxis.axis_label = f"time over consecutive drives [{clock(d)[1]}]; means over {lasting(d, AVERAGED_S)}"
        found.append(figure)
    return found


def _over_time(d: Diagnosis) -> list[Any]:
    """The residual of each recording over its time; axes move together."""
    from bokeh.models import ColumnDataSource, HoverTool, Range1d
    from bokeh.models.annotations import Span

    unit, word = clock(d)
    every = {of.key: [smoothed(s, s.torque - of.torques[i]) for i, s in enumerate(d.sessions)] for of in stages(d)}
    values = np.concatenate([np.concatenate(of) for of in every.values()])
    values, places = values[np.isfinite(values)], _places(values)
    low, high = (float(q) for q in np.quantile(values, (0.001, 0.999))) if len(values) else (-1.0, 1.0)
    rim = 0.1 * (max(high, 0.0) - min(low, 0.0)) + 1e-9
    shown, called = most_off(rms_over_time(every["refitted"])[0]), shown_names(d.sessions)
    across = Range1d(start=0.0, end=max(d.sessions[i].time[-1] for i in shown) / unit, bounds="auto")
    up = Range1d(start=min(low, 0.0) - rim, end=max(high, 0.0) + rim)
    found = []
    for i in shown:
        session = d.sessions[i]
        rows = slice(0, None, max(1, int(SHOWN_EACH_S * session.pace / session.step)))
        columns = {key: _numbers(of[i][rows], places + 1) for key, of in every.items()}
        source = ColumnDataSource({"t": _numbers(session.time[rows] / unit, 3), **columns})
        figure = _figure(shortened(called[i], TITLE_LETTERS), RESIDUAL_HEIGHT, x_range=across, y_range=up)
        held_out = session.stretches(np.isin(session.block, d.split.held_out))
        _held_out_and_zero(figure, ((begin / unit, end / unit) for begin, end in held_out))
        _strips(figure, i, unit, True)
        lines = [
            figure.line("t", of.key, source=source, color=of.colour, line_width=1.0 if of.key == "nominal" else 1.6)
            for of in stages(d)
        ]
        for change in d.changes:
            if change.recording == session.name:
                figure.add_layout(Span(location=change.time / unit, dimension="height", line_color=GREY, line_dash="dashed"))
        texts = [("time", f"@t{{0.0}} {word}"), *((of.label, _nm(of.key, places)) for of in stages(d))]
        figure.add_tools(HoverTool(renderers=lines[1:2], tooltips=texts, mode="vline"))
        figure.yaxis.ticker.desired_num_ticks = 4
        figure.yaxis.axis_label = "residual [Nm]"
        if i == shown[-1]:
            figure.xaxis.axis_label = f"time [{word}]; means over {lasting(d, SMOOTHED_S)}"
        found.append(figure)
    return found


def _lap(d: Diagnosis) -> list[Any]:
    """Measured and simulated torque on a hold-out lap, and the speed, over the same time."""
    from bokeh.models import ColumnDataSource, HoverTool

    index, rows, drawn, *_ = shown_lap(d, LONGEST_LAP_S)
    session, name = d.sessions[index], shown_names(d.sessions)[index]
    columns = {"measured": np.where(session.used, session.torque, np.nan)[rows], "speed": session.speed[rows]}
    columns |= {of.key: of.torques[index][rows] for of in stages(d)}
    places = _places(columns["measured"])
    source = ColumnDataSource(
        {
            "t": _numbers(session.time[rows], 3),
            **{k: _numbers(v, 2 if k == "speed" else places + 1) for k, v in columns.items()},
        }
    )
    torque = _figure(f"{shortened(name, TITLE_LETTERS - 25)}, {drawn}", LAP_HEIGHT + 50)
    speed = _figure("speed", LAP_HEIGHT - 30, x_range=torque.x_range)
    for figure in (torque, speed):
        _strips(figure, index, 1.0, False)
    measured = torque.line("t", "measured", source=source, color="#555555", line_width=3, line_alpha=0.6)
    for of in stages(d)[1:]:
        torque.line("t", of.key, source=source, color=of.colour, line_width=1.4)
    line = speed.line("t", "speed", source=source, color="#555555")
    time = ("time", "@t{0} s" if session.step >= 1.0 else "@t{0.00} s")
    texts = [time, ("measured", _nm("measured", places)), *((of.label, _nm(of.key, places)) for of in stages(d))]
    torque.add_tools(HoverTool(renderers=[measured], tooltips=texts, mode="vline"))
    speed.add_tools(HoverTool(renderers=[line], tooltips=[time, ("speed", "@speed{0.00} m/s")], mode="vline"))
    torque.yaxis.axis_label, speed.yaxis.axis_label, speed.xaxis.axis_label = "torque [Nm]", "speed [m/s]", "time [s]"
    return [torque, speed]


def _bars(d: Diagnosis) -> list[Any]:
    """Mean residual by bins, with 95 % intervals; pressing a bar highlights its times."""
    from bokeh.models import ColumnDataSource, CustomJS, FixedTicker, HoverTool, Range1d, TapTool
    from bokeh.models.annotations import Whisker

    up, found, ends = Range1d(), [], [0.0]
    for name, edges, of_stages in bars(d):
        unit, ticks = of_stages[0].bins[0].unit, (np.arange(len(edges)) - 0.5).tolist()
        figure = _figure(axis_label(name, of_stages[0].stage.label), BARS_HEIGHT, False, y_range=up)
        drawn, places = [], 1 + _places(np.array([b.mean_residual for b in of_stages[0].bins]))
        for stage, bins, x, half in of_stages:
            mean = np.array([b.mean_residual for b in bins])
            ends += [*(mean + np.nan_to_num(half)), *(mean - np.nan_to_num(half))]
            ranges = [from_to(b.low, b.high) for b in bins]
            source = ColumnDataSource(
                {
                    "x": x.tolist(), "mean": _numbers(mean, places),
                    "low": _numbers(mean - half, places), "high": _numbers(mean + half, places),
                    "range": ranges, "seconds": [figures(b.samples * d.sessions[0].step, 4) for b in bins],
                    "p": [b.p for b in bins],
                    "key": [f"{name}:{n}" for n in range(len(bins))], "of": [stage.label] * len(bins),
                }
            )  # fmt: skip
            drawn.append(
                figure.vbar(
                    "x", 0.38 if d.modelled else 0.7, "mean", source=source, color=stage.colour,
                    nonselection_fill_alpha=1.0, nonselection_line_alpha=1.0,
                    selection_line_color="#000000", selection_line_width=2,
                )
            )  # fmt: skip
            whisker: Any = Whisker(base="x", lower="low", upper="high", source=source, line_color="#333333")
            whisker.upper_head.size = whisker.lower_head.size = 5
            figure.add_layout(whisker)
            code = "const i = source.selected.indices[0]; window.trackresLight(i === undefined ? null : source.data.key[i])"
            source.selected.js_on_change("indices", CustomJS(args={"source": source}, code=code))
        mean_text = ("mean", "@mean Nm (@low to @high)")
        texts = [("", "@of"), (name, f"@range {unit}"), mean_text, ("of", "@seconds s"), ("p", "@p{0.000}")]
        figure.add_tools(HoverTool(renderers=drawn, tooltips=texts), TapTool(renderers=drawn))
        figure.xaxis.ticker = FixedTicker(ticks=ticks)
        figure.xaxis.major_label_overrides = dict(zip(ticks, rising(edges), strict=True))
        figure.yaxis.ticker.desired_num_ticks = 4
        found.append(figure)
    rim = 0.05 * (max(ends) - min(ends)) + 1e-9
    up.start, up.end = float(min(ends) - rim), float(max(ends) + rim)
    return found
