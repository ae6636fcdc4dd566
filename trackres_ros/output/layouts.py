# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Layouts of PlotJuggler and Foxglove for the topics of a node or of a replay's bag, made from the table of topics."""

import json
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from trackres_ros.files.file_sets import file_set
from trackres_ros.files.output_files import output_folder
from trackres_ros.files.own_files import write
from trackres_ros.output.topics import DEFAULT_NODE, ESTIMATE_TOPIC, LEVEL, TOTALS, OutputTopic, output_topics
from trackres_ros.vehicle import AnyVehicle

COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#ff7f0e", "#9467bd", "#8c564b", "#17becf", "#bcbd22")
SHOWN_S = 600.0
DEFAULT_BASE = f"/{DEFAULT_NODE}"
"""Full name of the node; topics in the bag of a replay are below it too."""


@dataclass(frozen=True)
class LayoutCurve:
    """One curve: its label, and its place for both programs."""

    label: str
    plotjuggler: str
    foxglove: str


@dataclass(frozen=True)
class LayoutPlot:
    """One plot with its curves."""

    title: str
    curves: tuple[LayoutCurve, ...]


def write_layouts(vehicle: AnyVehicle, folder: Path, base: str = DEFAULT_BASE) -> list[Path]:
    """Write `plotjuggler.xml` and `foxglove.json` for a vehicle's topics below a node's full name.

    Raises InputError if the folder cannot be made or written to.
    """
    folder = output_folder(folder, "--output")
    texts = {folder / "plotjuggler.xml": plotjuggler(vehicle, base), folder / "foxglove.json": foxglove(vehicle, base)}
    with file_set():
        for path, text in texts.items():
            write(path, text.encode())
    return list(texts)


def _plots(vehicle: AnyVehicle, base: str) -> tuple[LayoutPlot, ...]:
    """Torque by part, feed-forward, belts, and measured against expected torque."""
    topics = {topic.name: topic for topic in output_topics(vehicle)}
    resistance, residual = topics["resistance_torque"], topics["torque_residual"]
    assemblies = [assembly.name for assembly in vehicle.assemblies]
    wrench = f"{base}/feedforward_torque"

    def joints(topic: OutputTopic, names: Sequence[str]) -> tuple[LayoutCurve, ...]:
        topic_path = f"{base}/{topic.name}"
        return tuple(
            LayoutCurve(name, f"{topic_path}/{name}/effort", f"{topic_path}.effort[{topic.names.index(name)}]") for name in names
        )

    def estimate(name: str) -> LayoutCurve:
        number, topic_path = ESTIMATE_TOPIC.names.index(name), f"{base}/{ESTIMATE_TOPIC.name}"
        plotjuggler, foxglove = (f"interface_values[0]{slash}values[{number}]" for slash in "/.")
        return LayoutCurve(name, f"{topic_path}/{plotjuggler}", f"{topic_path}.{foxglove}")

    temperatures = tuple(
        LayoutCurve(name, f"{topic}/temperature", f"{topic}.temperature")
        for name in assemblies
        for topic in (f"{base}/track_temperature/{name}",)
    )
    by_assembly = joints(resistance, [f"total/{name}" for name in assemblies])
    belts = (
        LayoutPlot("Belt temperature [degC]", temperatures),
        LayoutPlot("Torque about y that resists, by assembly [Nm]", by_assembly),
    )
    return (
        LayoutPlot("Torque about y that resists, by part [Nm]", joints(resistance, [name for name in TOTALS if name != "drive"])),
        LayoutPlot(
            "Feed-forward torque [Nm]", (LayoutCurve("feed-forward", f"{wrench}/wrench/torque/y", f"{wrench}.wrench.torque.y"),)
        ),
        *(belts if assemblies else ()),
        LayoutPlot("Measured and expected torque [Nm]", joints(residual, residual.names)),
        LayoutPlot("Standard deviation of the resistance [Nm]", (estimate("resistance_std_nm"),)),
        LayoutPlot("Level of the estimate: 0 is OK, 1 WARN, 2 ERROR, 3 STALE", (estimate(LEVEL),)),
    )


def plotjuggler(vehicle: AnyVehicle, base: str = DEFAULT_BASE) -> str:
    """A layout file of PlotJuggler 3: a tab for the torque, one for the assemblies."""
    root = ET.Element("root")
    widget = ET.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    all_plots = _plots(vehicle, base)
    tabs = (("torque and temperature", all_plots[:3]), ("assemblies, measured", all_plots[3:]))
    for title, plots in tabs if vehicle.assemblies else (("torque", all_plots),):
        tab = ET.SubElement(widget, "Tab", tab_name=title, containers="1")
        share = ";".join(f"{1 / len(plots):.6f}" for _ in plots)
        splitter = ET.SubElement(
            ET.SubElement(tab, "Container"), "DockSplitter", orientation="-", count=str(len(plots)), sizes=share
        )
        for plot in plots:
            area = ET.SubElement(splitter, "DockArea", name=plot.title)
            element = ET.SubElement(area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false")
            ET.SubElement(element, "range", left="0", right=f"{SHOWN_S:g}", bottom="0", top="1")
            ET.SubElement(element, "limitY")
            for curve, colour in zip(plot.curves, COLOURS * 4, strict=False):
                ET.SubElement(element, "curve", name=curve.plotjuggler, color=colour)
    ET.SubElement(widget, "currentTabIndex", index="0")
    ET.SubElement(root, "use_relative_time_offset", enabled="1")
    ET.indent(root, " ")
    return f"<?xml version='1.0' encoding='UTF-8'?>\n{ET.tostring(root, encoding='unicode')}\n"


def foxglove(vehicle: AnyVehicle, base: str = DEFAULT_BASE) -> str:
    """A layout file of Foxglove: the plots one below the other, the diagnostics at their side."""
    panels: dict[str, object] = {
        f"Plot!trackres{number}": {
            "title": plot.title,
            "paths": [
                {
                    "value": curve.foxglove,
                    "label": curve.label,
                    "enabled": True,
                    "timestampMethod": "headerStamp",
                    "color": colour,
                }
                for curve, colour in zip(plot.curves, COLOURS * 4, strict=False)
            ],
            "showXAxisLabels": True,
            "showYAxisLabels": True,
            "showLegend": True,
            "legendDisplay": "left",
            "isSynced": True,
            "xAxisVal": "timestamp",
            "followingViewWidth": SHOWN_S,
        }
        for number, plot in enumerate(_plots(vehicle, base))
    }
    column = _column(list(panels))
    panels["DiagnosticSummary!trackres"] = {
        "minLevel": 0,
        "pinnedIds": [],
        "hardwareIdFilter": "",
        "topicToRender": "/diagnostics",
        "sortByLevel": True,
    }
    layout = {"direction": "row", "first": column, "second": "DiagnosticSummary!trackres", "splitPercentage": 75}
    return json.dumps({"configById": panels, "globalVariables": {}, "userNodes": {}, "layout": layout}, indent=2) + "\n"


def _column(names: list[str]) -> object:
    """Panels of equal height, one below the other."""
    if len(names) == 1:
        return names[0]
    return {"direction": "column", "first": names[0], "second": _column(names[1:]), "splitPercentage": 100 / len(names)}
