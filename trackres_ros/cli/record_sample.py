"""`trackres record-sample`: a recording to try things on."""

from __future__ import annotations

from pathlib import Path

import click

from trackres_ros.cli.common import emit, json_option, number, output_path


@click.command("record-sample")
@click.option("--vehicle", default="xgd24d", show_default=True, metavar="FILE|NAME", help="Vehicle whose weight is recorded.")
@click.option("--speed-kmh", type=number(1, 50), default=10.0, show_default=True, help="Speed on the lap [km/h].")
@click.option(
    "--laps",
    type=click.IntRange(1, 1000),
    default=3,
    show_default=True,
    help="Laps of a circle of 100 m radius, with a stop after each.",
)
@click.option("--ambient-degc", type=number(-60, 60), default=15.0, show_default=True, help="Air temperature [degC].")
@click.option("-o", "--output", type=click.Path(path_type=Path), required=True, help="File to write, .mcap.")
@json_option
def record_sample_command(vehicle: str, speed_kmh: float, laps: int, ambient_degc: float, output: Path, as_json: bool) -> None:
    """Make a recording as a vehicle's bus would log it: the paper's lap test, speed in steps of 1 km/h, load, air temperature.

    \b
    trackres record-sample -o lap.mcap
    """
    from trackres_ros.resources import config_dir
    from trackres_ros.sample import write_sample
    from trackres_ros.vehicle import load

    path = output_path(output, (".mcap",))
    drive = write_sample(path, load(vehicle), speed_kmh, laps, ambient_degc)
    topics = config_dir() / "topics" / "sample.yaml"
    result = {
        "written": str(path),
        "duration_s": float(drive.time_s[-1]),
        "distance_m": float((drive.speed[1:] * (drive.time_s[1] - drive.time_s[0])).sum()),
        "topics": str(topics),
    }
    emit(
        result,
        as_json,
        lambda: (
            f"{path}: {result['duration_s']:.0f} s, {result['distance_m']:.0f} m\n"
            f"Try: trackres replay {path} --vehicle {vehicle} --topics {topics} -o out.csv"
        ),
    )
