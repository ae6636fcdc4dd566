# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres layouts`: writes layouts of PlotJuggler and Foxglove for a vehicle's topics."""

from pathlib import Path

import click

from trackres_ros.output.layouts import write_layouts
from trackres_ros.tasks import options
from trackres_ros.tasks.arguments import load_vehicle
from trackres_ros.tasks.terminal import Command, emit


@click.command("layouts", cls=Command)
@options.vehicle
@options.name_options
@options.folder("Folder to write into.")
@options.json
def layouts_command(vehicle: str, name: str, namespace: str, output: Path, as_json: bool) -> None:
    """Write layouts of PlotJuggler and Foxglove for a vehicle: torque by part and assembly, feed-forward, belts, residual.

    They show the topics of a live node, and those in the bag of a replay (`-o out.mcap`) under /trackres.

    \b
    trackres layouts --vehicle my_vehicle.yaml -o layouts
    plotjuggler --layout layouts/plotjuggler.xml
    """
    options.check_names(name, namespace)
    paths = write_layouts(load_vehicle(vehicle), output, f"{namespace.rstrip('/')}/{name}")

    text = f"Written: {paths[0]}, {paths[1]}\nNext: plotjuggler --layout {paths[0]}; in Foxglove: Layouts, import from file, "
    emit({"written": [str(path) for path in paths]}, as_json, lambda: f"{text}{paths[1]}")
