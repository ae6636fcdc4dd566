# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres export`: the step of a vehicle as C99 or as an FMU, and the check of an export."""

from pathlib import Path
from typing import Any

import click

from trackres_ros.tasks import options
from trackres_ros.tasks.terminal import Command, Commands, emit, watch


def export_options(command: options.Decorated) -> options.Decorated:
    """Options of an export, in the order of the help."""
    text = "Start from the learned parameters of a state saved with learning on."
    for option in (
        click.option("--state", type=options.PATH, metavar="STATE", help=text),
        options.params,
        options.methods,
        options.surroundings,
    ):
        command = option(command)
    return command


@click.group("export", cls=Commands, invoke_without_command=True)
@click.option("--check", "folder", type=options.PATH, metavar="DIR", help="Check that the C in DIR belongs to its vehicle.")
@click.option("--vehicle", metavar="FILE|NAME", help="With --check: the vehicle file, if it was moved.")
@options.json
@click.pass_context
def export_group(context: click.Context, folder: Path | None, vehicle: str | None, as_json: bool) -> int:
    """Export the live step for a controller: C99 without heap, or an FMU.

    \b
    trackres export c my_vehicle.yaml -o out/
    trackres export --check out/
    """
    if context.invoked_subcommand is not None:
        return 0
    if folder is None:
        raise click.UsageError("Missing a command, c or fmu, or the option --check.", context)
    from trackres_ros.tools.export.exporting import check

    differences = check(folder, vehicle)
    text = "\n".join(
        [f"{folder} does not belong to its vehicle file and this version:", *(f"  - {difference}" for difference in differences)]
    )
    belongs = f"{folder} belongs to its vehicle file and this version"
    emit({"belongs": not differences, "differs": differences}, as_json, lambda: text if differences else belongs)
    return 1 if differences else 0


@export_group.command("c", cls=Command)
@click.argument("vehicle", metavar="FILE|NAME")
@options.folder("Folder for trackres.h, trackres.c, main.c and CMakeLists.txt.")
@export_options
@click.option("--single", is_flag=True, help="Numbers are float instead of double, but for sums: half the size, less precise.")
@options.json
def c_command(output: Path, as_json: bool, **request_values: Any) -> None:
    """Write the step of a vehicle as C99: one source and one header, a program that replays a CSV, and a CMake file.

    \b
    trackres export c xgd24d -o out/
    cmake -S out -B out/build && cmake --build out/build
    out/build/trackres_replay drive.csv > result.csv
    """
    from trackres_ros.tools.export.exporting import Request, export_c

    watch(output)
    folder_written = export_c(Request(**request_values), output)
    emit({"written": [str(path) for path in folder_written]}, as_json, lambda: f"Written: {', '.join(map(str, folder_written))}")


@export_group.command("fmu", cls=Command)
@click.argument("vehicle", metavar="FILE|NAME")
@click.option("-o", "--output", type=options.PATH, required=True, metavar="MODEL.fmu", help="The FMU.")
@export_options
@options.json
def fmu_command(output: Path, as_json: bool, **request_values: Any) -> None:
    """Write the step of a vehicle as an FMU: FMI 3.0 for co-simulation, with its sources and a library for Linux.

    \b
    trackres export fmu my_vehicle.yaml -o model.fmu
    """
    from trackres_ros.tools.export.exporting import Request
    from trackres_ros.tools.export.fmu import export_fmu

    watch(output)
    file_written = export_fmu(Request(**request_values), output)
    emit({"written": [str(file_written)]}, as_json, lambda: f"Written: {file_written}")
