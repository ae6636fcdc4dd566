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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from trackres_ros.diagnosis.pipeline import Diagnosis
from trackres_ros.diagnosis.report.charts import DARK, RIM, Area, Bars, Chart, Line, Panel, Rule, Span, Values, unit
from trackres_ros.diagnosis.report.pictures import first_charts
from trackres_ros.diagnosis.report.series import bins_of_steps
from trackres_ros.errors import MissingExtraError
from trackres_ros.output.style import BLACK, ORANGE

DOCUMENT = "diagnosis"
EDGE = 0.2  # beyond the first and last tick of bars
HIGHLIGHTED = f"{ORANGE}73", "highlighted", True


@dataclass(frozen=True, slots=True)
class Interactive:
    """Plots of a page: their places, and the browser's data, packed (gzip, base64)."""

    plots: Mapping[str, Sequence[tuple[str, str]]]  # of each picture: their elements and titles
    legends: Mapping[str, Sequence[tuple[str, str, bool]]]  # of each picture: colours and texts, and whether solid
    library: str  # source of Bokeh
    version: str  # of Bokeh
    data: str  # Bokeh's documents, and the bin of each step


def interactive(d: Diagnosis) -> Interactive:
    """Plots of a diagnosis.

    Raises
    ------
    MissingExtraError
        Without Bokeh.
    """
    package = find_spec("bokeh")
    if package is None or package.origin is None:
        raise MissingExtraError("zoom and hover on the page", "bokeh", "interactive")
    plots, legends, roots, names = {}, {}, list[Any](), dict[Model, str]()
    for part, chart in first_charts(d).items():
        roots += (encoded_plots := [encoded(plot, names) for plot in plots_of(chart)])
        plots[part] = [(f"plot-{root['id']}", panel.title) for root, panel in zip(encoded_plots, chart.panels, strict=True)]
        legends[part] = [*chart.legend(), *([HIGHLIGHTED] if any(panel.highlight for panel in chart.panels) else [])]
    ids = [root["id"] for root in roots]
    steps = [{"begin": float(s.time[0]), "step": s.step, **bins} for s, bins in zip(d.sessions, bins_of_steps(d), strict=True)]
    data = {
        "documents": {DOCUMENT: {"version": version("bokeh"), "title": DOCUMENT, "roots": roots}},
        "items": [{"docid": DOCUMENT, "roots": {root: f"plot-{root}" for root in ids}, "root_ids": ids}],
        "steps": dict(enumerate(steps)),
    }
    return Interactive(plots, legends, _library(Path(package.origin).parent), version("bokeh"), pack(json.dumps(data)))


@cache
def _library(folder: Path) -> str:
    """Bokeh's own script from the folder of its package, packed for the page."""
    return pack((folder / "server" / "static" / "js" / "bokeh.min.js").read_text(encoding="utf-8"))


def pack(text: str) -> str:
    """A text packed for the page; the same text gives the same result."""
    return base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode()


class Model:
    """A model of Bokeh's script, by its name there, and the attributes that differ from the script's own."""

    def __init__(self, name: str, /, **attributes: Any) -> None:
        self.name, self.attributes = name, attributes


class Column(str):
    """The name of a column of the data."""

    __slots__ = ()


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
    if isinstance(value, Column):
        return {"type": "field", "field": value}
    if isinstance(value, dict):
        return {"type": "map", "entries": [[key, encoded(x, names)] for key, x in value.items()]}
    if isinstance(value, list):
        return [encoded(x, names) for x in value]
    return {"type": "number", "value": "nan"} if isinstance(value, float) and math.isnan(value) else value


def plots_of(chart: Chart) -> list[Model]:
    """A plot for each panel of a chart; panels with a common label share its axis."""
    x_range = None
    if chart.x_label:
        left_ends, right_ends = zip(*(panel.x_range for panel in chart.panels), strict=True)
        x_range = Model("Range1d", start=min(left_ends), end=max(right_ends), bounds="auto")
    y_range = _range(chart.panels) if chart.y_label else None
    return [_plot(chart, panel, x_range, y_range or _range([panel])) for panel in chart.panels]


def _range(panels: Sequence[Panel]) -> Model:
    """The range of all lines, bars and rules across."""
    values: list[Values] = [np.zeros(0)]
    for element in (element for panel in panels for element in panel.elements):
        match element:
            case Rule(place, is_upright=False):
                values.append(np.array([place]))
            case Line():
                values += [y for _, y in element.pieces]
            case Bars():
                half_width = np.nan_to_num(element.half_width)
                values += [element.height - half_width, element.height + half_width]
    all_values = np.concatenate(values)
    all_values = all_values[np.isfinite(all_values)] if np.isfinite(all_values).any() else np.zeros(1)
    low, high = float(all_values.min()), float(all_values.max())
    rim = RIM * (high - low) + 1e-9
    return Model("Range1d", start=low - rim, end=high + rim)


def _plot(chart: Chart, panel: Panel, x_range: Model | None, y_range: Model) -> Model:
    look = {"axis_label_text_font_style": "normal", "axis_label_text_color": DARK, "major_label_text_color": DARK}
    x_axis = Model("LinearAxis", axis_label=chart.x_label if panel is chart.panels[-1] else "", **look)
    y_axis = Model("LinearAxis", axis_label=panel.y_label or chart.y_label, **look)
    y_axis.attributes["ticker"] = Model("BasicTicker", desired_num_ticks=4)
    if panel.ticks:
        places, labels = panel.ticks
        x_axis.attributes["ticker"] = Model("FixedTicker", ticks=list(places))
        x_axis.attributes["major_label_overrides"] = dict(zip(places, labels, strict=True))
        x_range = Model("Range1d", start=places[0] - EDGE, end=places[-1] + EDGE)
    renderers = [] if panel.highlight is None else [_strips(*panel.highlight)]
    center = [Model("Grid", axis=axis, dimension=i, grid_line_color="#E3E3E3") for i, axis in enumerate((x_axis, y_axis))]
    start, stop, tools, bars = y_range.attributes["start"], y_range.attributes["end"], list[Model](), list[Model]()
    for element in panel.elements:
        match element:
            case Span(_, begin, end, colour, top):
                box = {"left": begin, "right": end, "bottom": start, "top": start + top * (stop - start)}
                center.append(Model("BoxAnnotation", **box, fill_color=colour, fill_alpha=1.0, line_color=None))
            case Rule(place, is_upright, _, label, colour):
                way = {"dimension": "height", "line_dash": [6]} if is_upright else {"dimension": "width"}
                center.append(Model("Span", location=place, line_color=colour, **way))
                text = {"text": label, "text_font_size": "10px", "text_color": DARK, "text_baseline": "top"}
                center += [Model("Label", x=place, y=stop, x_offset=3, **text)] if label else []
            case Area(_, colour, x, low, high):
                columns = {"x": _round_values(x, 3), "y1": _round_values(low, 3), "y2": _round_values(high, 3)}
                renderers.append(_renderer(columns, "VArea", fill_color=colour))
            case Bars():
                bars.append(_bars(element))
                head, source = Model("TeeHead", size=5), bars[-1].attributes["data_source"]
                ends = {"base": Column("x"), "lower": Column("low"), "upper": Column("high"), "line_color": DARK}
                center.append(Model("Whisker", source=source, lower_head=head, upper_head=head, **ends))
                stars: dict[str, list[Any]] = {
                    "x": _round_values(element.x, 3),
                    "text": ["*" * star for star in element.has_star],
                }
                stars["text_baseline"] = ["top" if height > 0 else "bottom" for height in element.height]
                renderers.append(_renderer(stars, "Text", y=0.0, text_align="center", text_color=element.colour))
    if bars:
        tools = [Model("HoverTool", renderers=bars, tooltips="@details"), Model("TapTool", renderers=bars)]
    elif panel.lines:
        lines, tooltips = _lines(panel.lines, unit(chart.x_label), unit(panel.y_label or chart.y_label))
        renderers += lines
        zooming = Model("WheelZoomTool", dimensions="width", modifiers={"ctrl": True})
        tools = [Model("BoxZoomTool", dimensions="width"), Model("ResetTool"), zooming]
        tools.append(Model("HoverTool", renderers=lines[-1:], tooltips=tooltips, mode="vline"))
    return Model(
        "Figure", title=Model("Title", text=panel.title, text_font_size="12px"), height=panel.height, sizing_mode="stretch_width",
        x_range=x_range or Model("DataRange1d"), y_range=y_range, left=[y_axis], below=[x_axis], center=center,
        renderers=renderers + bars, toolbar=Model("Toolbar", logo=None, tools=tools), min_border_right=4,
        toolbar_location="right" if panel.lines else None, background_fill_color=None,
    )  # fmt: skip


def _renderer(columns: dict[str, list[Any]], glyph: str, **look: Any) -> Model:
    """Draws the rows of a source, whose columns have the names of the glyph's attributes."""
    shape = Model(glyph, **{name: Column(name) for name in columns}, **look)
    return Model("GlyphRenderer", data_source=Model("ColumnDataSource", data=columns), glyph=shape)


def _strips(session: int, unit_s: float) -> Model:
    """Strips for highlighting; the page's script writes their times."""
    strips = _renderer({"x0": [], "x1": []}, "VStrip", fill_color=HIGHLIGHTED[0], line_color=None)
    strips.attributes["data_source"].attributes |= {"name": "lit", "tags": [session, unit_s]}
    return strips


def _lines(lines: Sequence[Line], x_unit: str, y_unit: str) -> tuple[list[Model], list[list[str]]]:
    """Lines over the same `x`, and their texts at the pointer. A nan after each piece breaks a line before the next."""
    places = _places(np.concatenate([y for line in lines for _, y in line.pieces]))
    data = {"x": [v for x, _ in lines[0].pieces for v in (*_round_values(x, 3), math.nan)]}
    for i, line in enumerate(lines):
        data[f"y{i}"] = [v for _, y in line.pieces for v in (*_round_values(y, places + 1), math.nan)]
    source, glyphs = Model("ColumnDataSource", data=data), []
    for i, line in enumerate(lines):
        look = {"line_color": line.colour, "line_width": 1.4 * line.width, "line_dash": [6] if line.is_dashed else []}
        glyph = Model("Line", x=Column("x"), y=Column(f"y{i}"), **look)
        glyphs.append(Model("GlyphRenderer", data_source=source, glyph=glyph))
    return glyphs, [
        ["time", f"@x{{0.0[0]}} {x_unit}"],
        *([t.text, _number(f"y{i}", places, y_unit)] for i, t in enumerate(lines)),
    ]


def _bars(bars: Bars) -> Model:
    """Bars; a press highlights the times of one."""
    places = 1 + _places(bars.height)
    ends = {"low": bars.height - bars.half_width, "top": bars.height, "high": bars.height + bars.half_width}
    data = {"x": bars.x.tolist(), "details": bars.details, "key": bars.keys}
    source = Model("ColumnDataSource", data=data | {name: _round_values(values, places) for name, values in ends.items()})
    code = "const i = source.selected.indices[0]; window.trackresLight(i === undefined ? null : source.data.key[i])"
    callbacks = {"change:indices": [Model("CustomJS", args={"source": source}, code=code)]}
    source.attributes["selected"] = Model("Selection", js_property_callbacks=callbacks)
    look = {"x": Column("x"), "top": Column("top"), "width": bars.width, "fill_color": bars.colour}
    glyph, selected_glyph = Model("VBar", line_color=bars.colour, **look), Model("VBar", line_color=BLACK, line_width=2, **look)
    return Model("GlyphRenderer", data_source=source, glyph=glyph, selection_glyph=selected_glyph, nonselection_glyph=glyph)


def _round_values(values: Values, places: int) -> list[float]:
    return [float(v) for v in np.round(values, places)]


def _places(values: Values) -> int:
    """Decimals that show three figures of the largest value; none from 100 on."""
    largest_value = float(np.nanmax(np.abs(values), initial=0.0))
    return min(6, max(0, 2 - math.floor(math.log10(largest_value)))) if largest_value > 0.0 else 0


def _number(column: str, places: int, unit_of_it: str) -> str:
    return f"@{column}{{0{'.' + '0' * places if places else ''}}} {unit_of_it}"
