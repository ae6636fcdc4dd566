# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres live`: the node, on ROS 2 if rclpy is installed, else on Cyclone DDS."""

from __future__ import annotations

import importlib
import os
from contextlib import suppress
from pathlib import Path

import click

from trackres_ros.errors import InputError, MissingExtraError
from trackres_ros.files.documents import parse_yaml
from trackres_ros.files.output_files import BAG_SUFFIX, output_file
from trackres_ros.node.application import Application
from trackres_ros.node.parameters import ParameterFile, make_parameters, read_with_overrides
from trackres_ros.node.process import REQUESTS
from trackres_ros.node.record import Recorder, RecordLimits
from trackres_ros.node.status import Overview
from trackres_ros.tasks import options
from trackres_ros.tasks.live_display import LiveDisplay, LiveJson, LiveTable
from trackres_ros.tasks.terminal import picture_beside, watch


@click.command("live")
@click.option("--vehicle", metavar="FILE|NAME", help="Vehicle file or shipped name; may stand in the parameter file instead.")
@click.option("--surroundings", metavar="S.yaml", help="Current effects of site, weather and ground.")
@options.topics("which topic feeds which role; default without.", with_dbc=False)
@click.option(
    "--params",
    "params_file",
    type=options.PATH,
    metavar="P.yaml",
    help="Parameter file, flat or in the format of ROS; without ROS, the node watches it for changes.",
)
@click.option("-p", "single", multiple=True, metavar="NAME:=VALUE", help="One parameter; may be given several times.")
@options.name_options
@click.option(
    "--transport",
    "--edge",  # its name before 1.0
    "transport",
    type=click.Choice(["auto", "ros", "dds"]),
    default="auto",
    help="Middleware: rclpy, or Cyclone DDS without ROS; auto takes rclpy if it is installed.",
)
@click.option(
    "--record",
    type=options.PATH,
    metavar="OUT.mcap",
    help="Record every message of the topics file and every estimate, for replay and diagnosis, and a picture at the end.",
)
@click.option("--record-split-mb", type=options.Number(1, 1e6), help="Begin the next file, OUT_0001.mcap, at this size [MB].")
@click.option(
    "--record-split-minutes", type=options.Number(0.01, 1e5), help="Begin the next file, OUT_0001.mcap, after this time [min]."
)
@click.option(
    "--record-limit-mb",
    type=options.Number(2, 1e8),
    help="Size limit of all files of the recording [MB], including earlier runs: the oldest are deleted.",
)
@click.option("--quiet", is_flag=True, help="No table in the terminal.")
@click.option("--json", "as_json", is_flag=True, help="Instead of the table, one line of JSON per second and one at the end.")
def live_command(
    params_file: Path | None,
    single: tuple[str, ...],
    name: str,
    namespace: str,
    transport: str,
    record: Path | None,
    record_split_mb: float | None,
    record_split_minutes: float | None,
    record_limit_mb: float | None,
    quiet: bool,
    as_json: bool,
    **values: str | None,
) -> int:
    """Run the live estimate until interrupted.

    \b
    trackres live --vehicle xgd24d --topics topics.yaml
    trackres live --vehicle xgd24d -p output_rate_hz:=100 -p use_sim_time:=true

    Signals: INT, TERM, HUP and QUIT end it and save the state, USR1 saves the state and USR2 starts cold.
    """
    options.check_names(name, namespace)
    limits = RecordLimits(record_split_mb or 0.0, record_split_minutes or 0.0, record_limit_mb or 0.0)
    if limits.splits and record is None:
        raise InputError("--record", "not given", "a file to record into, with --record-split-... and --record-limit-mb")
    recorder = Recorder(output_file(record, (BAG_SUFFIX,), "--record"), limits) if record else None
    watch(record)
    entries, of_qos = read_with_overrides(params_file, name, namespace)
    given_parameters = dict(_single(text) for text in single) | {key: value for key, value in values.items() if value is not None}
    parameters = make_parameters(entries | given_parameters)
    REQUESTS.listen()
    displays: list[LiveDisplay] = []
    applications: list[Application] = []  # one at a time: a lifecycle's cleanup and configure make the next

    def overview() -> Overview:
        return applications[0].overview()

    def on_start(application: Application) -> None:
        applications[:] = [application]
        for text in recorder.begin(application) if recorder else ():
            click.echo(f"trackres: {text}", err=True)
        if displays or (quiet and not as_json):
            return
        displays.append(
            LiveJson(overview) if as_json else LiveTable(lambda: f"{name}: {applications[0].vehicle.title}", overview)
        )
        displays[0].start()

    code = 1
    try:
        if transport == "ros" or (transport == "auto" and _rclpy_imports()):
            from trackres_ros.node.ros.estimator import run as run_on_ros

            code = run_on_ros(parameters, name, namespace, REQUESTS, on_start, of_qos)
            return code
        from trackres_ros.node.dds.node import run as run_on_dds

        if of_qos:
            allowed = "no override of a quality of service, which needs --transport ros"
            raise InputError(str(params_file), ", ".join(of_qos), allowed, "input_* and output_* set that of all topics")
        parameter_file = ParameterFile(params_file, name, namespace, parameters, given_parameters) if params_file else None
        code = run_on_dds(parameters, name, namespace, REQUESTS, on_start, parameter_file)
        return code
    finally:
        outcomes = [display.stop() for display in displays]
        if recorder:
            for text in (*recorder.end(), *recording_picture(recorder)):
                with suppress(OSError):  # the same disk may be that of the terminal's file
                    click.echo(text, err=as_json or not all(outcomes))
        if not all(outcomes):  # the output has no reader, and the end of the interpreter would wait for its buffer
            os._exit(code)


def recording_picture(recorder: Recorder) -> list[str]:
    """Draw the recorded estimates, now that the node has ended; return a text for the log, of a failure too."""
    path, series = picture_beside(recorder.path), recorder.series
    if not series:
        return []
    try:
        from trackres_ros.output.plots import estimate_figure

        estimate_figure(series.pop("time_s"), series, recorder.title, path=path)
    except MissingExtraError as error:
        return [f"no picture: {error}"]
    except Exception as error:  # a picture is not worth an exit code
        return [f"no picture {path}: {getattr(error, 'strerror', None) or error}"]
    return [f"{path}: torque and temperature over time"]


def _rclpy_imports() -> bool:
    try:
        importlib.import_module("rclpy")
    except ImportError:  # not there, or built for another Python
        return False
    return True


def _single(text: str) -> tuple[str, object]:
    name, mark, value = text.partition(":=")
    if not mark or not name:
        raise InputError("-p", text, "NAME:=VALUE", "for example: -p output_rate_hz:=100")
    return name, parse_yaml(value, f"-p {name}")
