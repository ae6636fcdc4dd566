"""`trackres replay`: a recording through the estimator."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from trackres_ros.cli.common import (
    emit,
    json_option,
    method_options,
    output_path,
    progress,
    surroundings_option,
    vehicle_option,
    without_suffix,
)
from trackres_ros.cli.written import watch
from trackres_ros.errors import InputError, MissingExtraError, one_line


@click.command("replay")
@click.argument("recording", nargs=-1, required=True, type=click.Path(path_type=Path))
@vehicle_option
@surroundings_option
@click.option(
    "--topics",
    "topics_file",
    type=click.Path(path_type=Path),
    metavar="T.yaml",
    help="Which topic, field or column feeds which role; guessed by message type without.",
)
@click.option(
    "--params",
    "params_file",
    type=click.Path(path_type=Path),
    metavar="P.yaml",
    help="Parameter file, flat or as the live node reads it; what concerns the estimator counts.",
)
@method_options
@click.option(
    "--resume", "resume_file", type=click.Path(path_type=Path), metavar="STATE", help="Go on from a state saved by --save-state."
)
@click.option("--save-state", "state_file", type=click.Path(path_type=Path), metavar="STATE", help="Save the state at the end.")
@click.option(
    "-o",
    "--output",
    "output",
    type=click.Path(path_type=Path),
    required=True,
    help="Result: .csv, .csv.gz or .parquet as a table, .mcap as topics. A picture .png goes beside it.",
)
@json_option
def replay_command(
    recording: tuple[Path, ...],
    vehicle: str,
    surroundings_file: Path | None,
    topics_file: Path | None,
    params_file: Path | None,
    method: str | None,
    thermal: str | None,
    resume_file: Path | None,
    state_file: Path | None,
    output: Path,
    as_json: bool,
) -> None:
    """Resistance torque and belt temperature over the time of a recording.

    RECORDING is a rosbag2 folder, .mcap, .db3, ROS 1 .bag (several are read one after the other), or one .csv, .csv.gz or
    .parquet with time_s and speed_mps (or speed_kmh).

    \b
    trackres replay lap.mcap --vehicle xgd24d --topics topics.yaml -o out.mcap
    trackres replay drive.csv --vehicle xgd24d -o out.csv

    Messages are taken in the order they were logged and by their own stamps: twice the same recording gives twice the same bits.
    """
    from trackres_ros.estimator import layout as at
    from trackres_ros.estimator.estimator import Estimator
    from trackres_ros.estimator.snapshot import resume, save
    from trackres_ros.model.track import with_methods
    from trackres_ros.parameters import make_parameters, read_parameters
    from trackres_ros.plots import plot_estimate
    from trackres_ros.replay import NANOSECOND, replay, result_writer
    from trackres_ros.replay_report import KeptSource, picture_columns, summary, text
    from trackres_ros.sources import open_source
    from trackres_ros.topic_settings import settings_for
    from trackres_ros.topics import Topics
    from trackres_ros.vehicle import load, with_surroundings

    path = output_path(output)
    if state_file:
        if not state_file.parent.is_dir() or (state_file.exists() and not state_file.is_file()):
            raise InputError("--save-state", str(state_file), "a file in a folder that exists")
        watch(state_file)
    if any(path.exists() and path.resolve() == given.resolve() for given in recording):
        raise InputError("-o", str(path), "another file than the recording, which it would replace")
    picture = without_suffix(path).with_name(without_suffix(path).name + ".png")
    watch(picture)
    topics = Topics.load(topics_file) if topics_file else None
    parameters = make_parameters(read_parameters(params_file))
    source = open_source(recording, topics)
    description = with_surroundings(with_methods(load(vehicle), method, thermal), surroundings_file)
    estimator = Estimator(description, settings_for(parameters.settings(), topics))
    session = resume(estimator, resume_file) if resume_file else None
    look = KeptSource(source, keep=path.suffix.lower() != ".mcap")
    with progress("replaying", None) as advance, result_writer(path, estimator) as write:
        result = replay(look, estimator, write, session, advance)
    if state_file:
        save(result.session, state_file, int(result.session.memory.times[at.SPEED, at.LAST_ARRIVAL]) * NANOSECOND)
    title = one_line(f"{', '.join(p.name for p in recording)}: {estimator.vehicle.title}")
    written = [str(path)]
    try:
        plot_estimate(picture, result.picture[:, 0], picture_columns(result.session.estimator.columns, result.picture), title)
        written.append(str(picture))
    except MissingExtraError as error:
        click.echo(f"trackres: no picture: {error}", err=True)
    report: dict[str, Any] = summary(result, look, written)
    emit(report, as_json, lambda: text(report))
