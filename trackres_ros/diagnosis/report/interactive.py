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
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from trackres_ros.diagnosis.pipeline import Diagnosis
from trackres_ros.diagnosis.prepare.session import Array, shown_names
from trackres_ros.diagnosis.report.series import (
    AVERAGED_S,
    MARK,
    Panel,
    axis_label,
    bars,
    begins,
    bins_of_steps,
    clock,
    held_out_times,
    lasting,
    marked_times,
    minutes,
    most_off,
    names,
    panels,
    shown_lap,
    stages,
)
from trackres_ros.diagnosis.selection.locate import SMOOTHED_S, rms_over_time, smoothed
from trackres_ros.errors import MissingExtraError
from trackres_ros.output.style import GREY, ORANGE, shortened
from trackres_ros.text import figures, from_to, rising

DOCUMENT = "diagnosis"
SHOWN_EACH_S = 4.0  # of means over `SMOOTHED_S`
LONGEST_LAP_S = 1200.0
TITLE_LETTERS = 60
DARK = "#333333"
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
    found = find_spec("bokeh")
    if found is None or found.origin is None:
        raise MissingExtraError("zoom and hover on the page", "bokeh", "interactive")
    over_all = panels(d)
    parts = {"believed": _believed(d, over_all), "time": _over_time(d), "lap": _lap(d), "bars": _bars(d)}
    drawn, names = [plot.model for of in parts.values() for plot in of], dict[Model, str]()
    document = {"version": version("bokeh"), "title": DOCUMENT, "roots": [encoded(model, names) for model in drawn]}
    roots = [names[model] for model in drawn]
    steps = [{"begin": float(s.time[0]), "step": s.step, **of} for s, of in zip(d.sessions, bins_of_steps(d), strict=True)]
    data = {
        "documents": {DOCUMENT: document},
        "items": [{"docid": DOCUMENT, "roots": {root: f"plot-{root}" for root in roots}, "root_ids": roots}],
        "steps": dict(enumerate(steps)),
    }
    plots = {part: [(f"plot-{names[plot.model]}", plot.title) for plot in of] for part, of in parts.items()}
    legend = [(line.colour, line.text, line.solid) for panel in over_all for line in panel.lines]
    where = marked_times(d)[0]
    legend += [("#D9D9D9", "hold-out laps", True), *([(MARK, where, True)] if where else [])]
    return Interactive(plots, _library(Path(found.origin).parent), version("bokeh"), packed(json.dumps(data)), legend)


@cache
def _library(folder: Path) -> str:
    """Bokeh's own script from the folder of its package, packed for the page."""
    return packed((folder / "server" / "static" / "js" / "bokeh.min.js").read_text(encoding="utf-8"))


def packed(text: str) -> str:
    """A text packed for the page; the same text gives the same result."""
    return base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode()


class Model:
    """A model of Bokeh's script, by its name there, and the attributes that differ from the script's own."""

    def __init__(self, name: str, /, **attributes: Any) -> None:
        self.name, self.attributes = name, attributes


class Spec(NamedTuple):
    """A `field`, thus a column of the data, or the same `value` for all rows."""

    kind: Literal["field", "value"]
    of: Any


def encoded(value: Any, names: dict[Model, str]) -> Any:
    """A value as Bokeh's documents have it, ready for JSON. The first use of a model defines it, and adds its name to `names`.

    The plots are simple and many: with Bokeh's own classes they took much of the time of a report.
    """
    if isinstance(value, Model):
        if value in names:
            return {"id": names[value]}
        names[value] = f"p{len(names) + 1}"
        attributes = {key: encoded(x, names) for key, x in value.attributes.items()}
        return {"type": "object", "name": value.name, "id": names[value], "attributes": attributes}
    if isinstance(value, Spec):
        return {"type": value.kind, value.kind: value.of}
    if isinstance(value, dict):
        return {"type": "map", "entries": [[key, encoded(x, names)] for key, x in value.items()]}
    if isinstance(value, list):
        return [encoded(x, names) for x in value]
    return {"type": "number", "value": "nan"} if isinstance(value, float) and math.isnan(value) else value


class _Plot:
    """A plot, to which lines, areas and annotations are added."""

    def __init__(
        self, title: str, height: int, zoom: bool = True, x_range: Model | None = None, y_range: Model | None = None
    ) -> None:
        look = {"axis_label_text_font_style": "normal", "axis_label_text_color": DARK, "major_label_text_color": DARK}
        self.title, self.x_range = title, x_range or Model("DataRange1d")
        self.x_axis, self.y_axis = (Model("LinearAxis", **look) for _ in range(2))
        self.renderers: list[Model] = []
        self.layout = [
            Model("Grid", axis=axis, dimension=i, grid_line_color="#E3E3E3") for i, axis in enumerate((self.x_axis, self.y_axis))
        ]
        zooming = Model("WheelZoomTool", dimensions="width", modifiers={"ctrl": True})
        self.tools = [Model("BoxZoomTool", dimensions="width"), Model("ResetTool"), zooming] if zoom else []
        self.model = Model(
            "Figure", title=Model("Title", text=title, text_font_size="12px"), height=height, sizing_mode="stretch_width",
            x_range=self.x_range, y_range=y_range or Model("DataRange1d"), left=[self.y_axis], below=[self.x_axis],
            center=self.layout, renderers=self.renderers, toolbar=Model("Toolbar", logo=None, tools=self.tools),
            toolbar_location="right" if zoom else None, min_border_right=4, background_fill_color=None,
        )  # fmt: skip

    def add(self, source: Model, glyph: Model, **more: Any) -> Model:
        """Draw the rows of a source."""
        self.renderers.append(Model("GlyphRenderer", data_source=source, glyph=glyph, **more))
        return self.renderers[-1]

    def line(self, source: Model, x: str, y: str, colour: str, width: float = 1.0, **more: Any) -> Model:
        """A line through two columns of a source."""
        glyph = Model("Line", x=Spec("field", x), y=Spec("field", y), line_color=colour, line_width=width, **more)
        return self.add(source, glyph)

    def hover(self, renderers: Sequence[Model], texts: Sequence[tuple[str, str]], **more: Any) -> None:
        """Show texts about what is under the pointer."""
        self.tools.append(Model("HoverTool", renderers=list(renderers), tooltips=[list(text) for text in texts], **more))

    def across(self, at: float, dimension: str = "width", **more: Any) -> None:
        """A grey line over the whole plot."""
        self.layout.append(Model("Span", location=at, dimension=dimension, line_color=GREY, **more))

    def held_out_and_zero(self, times: Iterable[tuple[float, float]]) -> None:
        """The hold-out laps behind the lines, and a line at zero."""
        for begin, end in times:
            self.layout.append(Model("BoxAnnotation", left=begin, right=end, fill_color=GREY, fill_alpha=0.15, line_color=None))
        self.across(0.0)

    def strips(self, session: int, unit: float, counted: bool) -> None:
        """Strips for highlighting; the page's script writes their times, and sums up those that are counted."""
        source = Model("ColumnDataSource", data={"x0": [], "x1": []}, name="lit", tags=[session, unit, counted])
        area = {"fill_color": Spec("value", ORANGE), "fill_alpha": Spec("value", 0.45), "line_color": Spec("value", None)}
        self.add(source, Model("VStrip", x0=Spec("field", "x0"), x1=Spec("field", "x1"), **area), level="underlay")


def _numbers(values: Array, places: int) -> list[float]:
    return [float(v) for v in np.round(values, places)]


def _places(torques: Array) -> int:
    """Decimals of a torque [Nm] that show three figures of the largest; none from 100 Nm on."""
    largest = float(np.nanmax(np.abs(torques), initial=0.0))
    return min(6, max(0, 2 - math.floor(math.log10(largest)))) if largest > 0.0 else 0


def _nm(column: str, places: int) -> str:
    return f"@{column}{{0{'.' + '0' * places if places else ''}}} Nm"


def _believed(d: Diagnosis, over_all: Sequence[Panel]) -> list[_Plot]:
    """The residual over all drives in sequence, with each term over it, and the remaining residual."""
    ends, found = begins(d), []
    every = np.concatenate([values for panel in over_all for line in panel.lines for values in line.values])
    every, places = every[np.isfinite(every)], _places(every)
    low, high = (min(0.0, float(every.min())), max(0.0, float(every.max()))) if len(every) else (-1.0, 1.0)
    rim = 0.1 * (high - low) + 1e-9
    across = Model("Range1d", start=0.0, end=ends[-1], bounds="auto")
    floor = low - rim
    up = Model("Range1d", start=floor, end=high + 2.0 * rim)
    for number, panel in enumerate(over_all):
        plot = _Plot(panel.title, BELIEVED_HEIGHT, x_range=across, y_range=up)
        plot.held_out_and_zero(held_out_times(d))
        for begin in ends[1:-1]:
            plot.across(begin, "height", line_dash=[2, 4])
        if number == 0:
            times = marked_times(d)[1]
            of = {"x0": [x for x, _ in times], "x1": [x for _, x in times]}
            ends_of = {"left": Spec("field", "x0"), "right": Spec("field", "x1")}
            ends_of |= {"bottom": Spec("value", floor), "top": Spec("value", floor + 0.5 * rim)}
            colour = Spec("value", MARK)
            plot.add(Model("ColumnDataSource", data=of), Model("Quad", **ends_of, fill_color=colour, line_color=colour))
            look = {"text_font_size": "10px", "text_color": "#555555", "x_offset": 3}
            for begin, name in zip(ends, names(d, INTERACTIVE_LETTERS), strict=False):
                plot.layout.append(Model("Label", x=begin, y=high + rim, text=name, **look))
        columns: dict[str, list[float]] = {"t": []}
        for i, session in enumerate(d.sessions):
            rows = slice(0, None, max(1, int(SHOWN_EACH_S * session.pace / session.step)))
            # A nan after each session breaks the line before the next.
            columns["t"] += [*_numbers(minutes(d, i)[rows], 3), float("nan")]
            for k, line in enumerate(panel.lines):
                columns.setdefault(f"y{k}", []).extend([*_numbers(line.values[i][rows], places + 1), float("nan")])
        source = Model("ColumnDataSource", data=columns)
        lines = [
            plot.line(
                source, "t", f"y{k}", line.colour, (3.4 if line.solid else 2.0) if line.wide else 1.1,
                line_dash=[] if line.solid else [6],
            )
            for k, line in sorted(enumerate(panel.lines), key=lambda of: not of[1].wide)  # the measured lines on top
        ]  # fmt: skip
        texts = [("time", f"@t{{0.0}} {clock(d)[1]}"), *((line.text, _nm(f"y{k}", places)) for k, line in enumerate(panel.lines))]
        plot.hover(lines[-1:], texts, mode="vline")
        plot.y_axis.attributes["axis_label"] = "torque [Nm]"
        if number == len(over_all) - 1:
            label = f"time over consecutive drives [{clock(d)[1]}]; means over {lasting(d, AVERAGED_S)}"
            plot.x_axis.attributes["axis_label"] = label
        found.append(plot)
    return found


def _over_time(d: Diagnosis) -> list[_Plot]:
    """The residual of each recording over its time; axes move together."""
    unit, word = clock(d)
    every = {of.key: [smoothed(s, s.torque - of.torques[i]) for i, s in enumerate(d.sessions)] for of in stages(d)}
    values = np.concatenate([np.concatenate(of) for of in every.values()])
    values, places = values[np.isfinite(values)], _places(values)
    low, high = (float(q) for q in np.quantile(values, (0.001, 0.999))) if len(values) else (-1.0, 1.0)
    rim = 0.1 * (max(high, 0.0) - min(low, 0.0)) + 1e-9
    shown, called = most_off(rms_over_time(every["refitted"])[0]), shown_names(d.sessions)
    across = Model("Range1d", start=0.0, end=max(d.sessions[i].time[-1] for i in shown) / unit, bounds="auto")
    up = Model("Range1d", start=min(low, 0.0) - rim, end=max(high, 0.0) + rim)
    found = []
    for i in shown:
        session = d.sessions[i]
        rows = slice(0, None, max(1, int(SHOWN_EACH_S * session.pace / session.step)))
        columns = {key: _numbers(of[i][rows], places + 1) for key, of in every.items()}
        source = Model("ColumnDataSource", data={"t": _numbers(session.time[rows] / unit, 3), **columns})
        plot = _Plot(shortened(called[i], TITLE_LETTERS), RESIDUAL_HEIGHT, x_range=across, y_range=up)
        held_out = session.stretches(np.isin(session.block, d.split.held_out))
        plot.held_out_and_zero((begin / unit, end / unit) for begin, end in held_out)
        plot.strips(i, unit, True)
        lines = [plot.line(source, "t", of.key, of.colour, 1.0 if of.key == "nominal" else 1.6) for of in stages(d)]
        for change in d.changes:
            if change.recording == session.name:
                plot.across(change.time / unit, "height", line_dash=[6])
        texts = [("time", f"@t{{0.0}} {word}"), *((of.label, _nm(of.key, places)) for of in stages(d))]
        plot.hover(lines[1:2], texts, mode="vline")
        plot.y_axis.attributes |= {"ticker": Model("BasicTicker", desired_num_ticks=4), "axis_label": "residual [Nm]"}
        if i == shown[-1]:
            plot.x_axis.attributes["axis_label"] = f"time [{word}]; means over {lasting(d, SMOOTHED_S)}"
        found.append(plot)
    return found


def _lap(d: Diagnosis) -> list[_Plot]:
    """Measured and simulated torque on a hold-out lap, and the speed, over the same time."""
    index, rows, drawn, *_ = shown_lap(d, LONGEST_LAP_S)
    session, name = d.sessions[index], shown_names(d.sessions)[index]
    columns = {"measured": np.where(session.used, session.torque, np.nan)[rows], "speed": session.speed[rows]}
    columns |= {of.key: of.torques[index][rows] for of in stages(d)}
    places = _places(columns["measured"])
    shown = {k: _numbers(v, 2 if k == "speed" else places + 1) for k, v in columns.items()}
    source = Model("ColumnDataSource", data={"t": _numbers(session.time[rows], 3), **shown})
    torque = _Plot(f"{shortened(name, TITLE_LETTERS - 25)}, {drawn}", LAP_HEIGHT + 50)
    speed = _Plot("speed", LAP_HEIGHT - 30, x_range=torque.x_range)
    for plot in (torque, speed):
        plot.strips(index, 1.0, False)
    measured = torque.line(source, "t", "measured", "#555555", 3.0, line_alpha=0.6)
    for of in stages(d)[1:]:
        torque.line(source, "t", of.key, of.colour, 1.4)
    line = speed.line(source, "t", "speed", "#555555")
    time = ("time", "@t{0} s" if session.step >= 1.0 else "@t{0.00} s")
    texts = [time, ("measured", _nm("measured", places)), *((of.label, _nm(of.key, places)) for of in stages(d))]
    torque.hover([measured], texts, mode="vline")
    speed.hover([line], [time, ("speed", "@speed{0.00} m/s")], mode="vline")
    for axis, label in ((torque.y_axis, "torque [Nm]"), (speed.y_axis, "speed [m/s]"), (speed.x_axis, "time [s]")):
        axis.attributes["axis_label"] = label
    return [torque, speed]


def _bars(d: Diagnosis) -> list[_Plot]:
    """Mean residual by bins, with 95 % intervals; pressing a bar highlights its times."""
    up, found, ends = Model("Range1d"), [], [0.0]
    for name, edges, of_stages in bars(d):
        unit, ticks = of_stages[0].bins[0].unit, (np.arange(len(edges)) - 0.5).tolist()
        plot = _Plot(axis_label(name, of_stages[0].stage.label), BARS_HEIGHT, False, y_range=up)
        drawn, places = [], 1 + _places(np.array([b.mean_residual for b in of_stages[0].bins]))
        for stage, bins, x, half in of_stages:
            mean = np.array([b.mean_residual for b in bins])
            ends += [*(mean + np.nan_to_num(half)), *(mean - np.nan_to_num(half))]
            ranges = [from_to(b.low, b.high) for b in bins]
            source = Model(
                "ColumnDataSource",
                data={
                    "x": x.tolist(), "mean": _numbers(mean, places),
                    "low": _numbers(mean - half, places), "high": _numbers(mean + half, places),
                    "range": ranges, "seconds": [figures(b.samples * d.sessions[0].step, 4) for b in bins],
                    "p": [b.p for b in bins],
                    "key": [f"{name}:{n}" for n in range(len(bins))], "of": [stage.label] * len(bins),
                },
            )  # fmt: skip
            drawn.append(_add_bars(plot, source, 0.38 if d.modelled else 0.7, stage.colour))
        mean_text = ("mean", "@mean Nm (@low to @high)")
        plot.hover(drawn, [("", "@of"), (name, f"@range {unit}"), mean_text, ("of", "@seconds s"), ("p", "@p{0.000}")])
        plot.tools.append(Model("TapTool", renderers=drawn))
        labels = dict(zip(ticks, rising(edges), strict=True))
        plot.x_axis.attributes |= {"ticker": Model("FixedTicker", ticks=ticks), "major_label_overrides": labels}
        plot.y_axis.attributes["ticker"] = Model("BasicTicker", desired_num_ticks=4)
        found.append(plot)
    rim = 0.05 * (max(ends) - min(ends)) + 1e-9
    up.attributes |= {"start": float(min(ends) - rim), "end": float(max(ends) + rim)}
    return found


def _add_bars(plot: _Plot, source: Model, width: float, colour: str) -> Model:
    """Bars with their intervals; a press highlights the times of a bar."""
    code = "const i = source.selected.indices[0]; window.trackresLight(i === undefined ? null : source.data.key[i])"
    pressed = {"change:indices": [Model("CustomJS", args={"source": source}, code=code)]}
    source.attributes["selected"] = Model("Selection", js_property_callbacks=pressed)
    bar = {"x": Spec("field", "x"), "width": Spec("value", width), "top": Spec("field", "mean")}
    bar |= {"fill_color": Spec("value", colour), "line_color": Spec("value", colour)}
    chosen = bar | {"line_color": Spec("value", "#000000"), "line_width": Spec("value", 2)}
    plot.layout.append(
        Model(
            "Whisker", base=Spec("field", "x"), lower=Spec("field", "low"), upper=Spec("field", "high"), source=source,
            line_color=Spec("value", "#333333"), upper_head=Model("TeeHead", size=Spec("value", 5)),
            lower_head=Model("TeeHead", size=Spec("value", 5)),
        )
    )  # fmt: skip
    glyph = Model("VBar", **bar)
    return plot.add(source, glyph, selection_glyph=Model("VBar", **chosen), nonselection_glyph=glyph)
