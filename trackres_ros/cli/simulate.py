"""`trackres simulate`: a drive that was never driven."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from trackres_ros.cli.common import emit, json_option, method_options, number, output_path, vehicle_option
from trackres_ros.errors import InputError
from trackres_ros.outputs import RESISTANCE_PARTS
from trackres_ros.recording import Recording
from trackres_ros.shown import decimals

KMH = 1 / 3.6
SUMMARY_TIMES_S = (50.0, 250.0, 600.0, 1000.0, 2500.0)


@click.command("simulate")
@vehicle_option
@click.option("--speed-kmh", type=number(-100, 100), help="Speed after the ramp [km/h].")
@click.option("--ramp-s", type=number(0, 1e5), default=50.0, show_default=True, help="Time from rest to that speed [s].")
@click.option("--duration-s", type=number(1e-3, 1e7), help="How long to simulate [s]; 2500 with --speed-kmh.")
@click.option(
    "--profile",
    type=click.Path(path_type=Path),
    metavar="P.csv",
    help="CSV or Parquet with time_s and speed_mps or speed_kmh instead; straight lines between its rows.",
)
@click.option("--ambient-degc", type=number(-60, 60), help="Ambient temperature [degC]; default the vehicle file's.")
@click.option("--initial-degc", type=number(-60, 150), help="Belt temperature at the start [degC]; default the ambient one.")
@click.option("--weight-kn", type=number(0.1, 1e5), help="Weight of the whole vehicle [kN]; default the vehicle file's.")
@method_options
@click.option("--dt", type=number(1e-4, 10), default=0.1, show_default=True, help="Time step [s].")
@click.option(
    "-o", "--output", "output", type=click.Path(path_type=Path), required=True, help="Result: .csv, .csv.gz, .parquet or .mcap."
)
@json_option
def simulate_command(
    vehicle: str,
    speed_kmh: float | None,
    ramp_s: float,
    duration_s: float | None,
    profile: Path | None,
    ambient_degc: float | None,
    initial_degc: float | None,
    weight_kn: float | None,
    method: str | None,
    thermal: str | None,
    dt: float,
    output: Path,
    as_json: bool,
) -> None:
    """Torque and belt temperature along a speed profile.

    \b
    trackres simulate --vehicle xgd24d --speed-kmh 50 -o out.csv
    trackres simulate --vehicle xgd24d --profile laps.csv --ambient-degc -15 -o out.mcap

    Columns: time_s, speed_mps, weight_n, ambient_degc, belt_degc (mean over the assemblies), resistance_torque_nm, which is the
    sum of hysteresis_nm, bearing_nm, wind_nm and effects_nm (of the vehicle file's effects), inertia_nm, drive_torque_nm
    (resistance and inertia); whole vehicle.
    """
    from trackres_ros.csvs import write_table
    from trackres_ros.estimator.estimator import Estimator, Steps
    from trackres_ros.model.track import with_methods
    from trackres_ros.output_bag import OutputBag
    from trackres_ros.simulate import ramp_and_hold, run_drive, series_of, through_points
    from trackres_ros.vehicle import load

    if (speed_kmh is None) == (profile is None):
        raise InputError("--speed-kmh, --profile", "both" if profile else "neither", "one of the two")
    if profile is not None and duration_s is not None:
        raise InputError("--duration-s", duration_s, "only with --speed-kmh: a profile says itself how long it is")
    path = output_path(output)
    description = with_methods(load(vehicle), method, thermal)
    if speed_kmh is not None:
        _check_speed(speed_kmh * KMH, description.chassis.max_speed)
        drive = ramp_and_hold(speed_kmh * KMH, ramp_s, 2500.0 if duration_s is None else duration_s, dt)
    else:
        assert profile is not None
        drive = through_points(*_read_profile(profile), dt)
        _check_speed(float(np.abs(drive.speed).max()), description.chassis.max_speed)
    estimator = Estimator(description)
    rows = run_drive(estimator, drive, None if weight_kn is None else weight_kn * 1e3, ambient_degc, initial_degc)
    series = series_of(estimator, drive, rows)
    if path.suffix.lower() == ".mcap":
        stamps = np.round((drive.time_s - drive.time_s[0]) * 1e9).astype(np.int64)
        with OutputBag(path, estimator) as bag:
            bag.write(Steps(stamps, stamps, rows))
    else:
        write_table(path, series)
    at_times = [t for t in SUMMARY_TIMES_S if t <= drive.time_s[-1]] or [float(drive.time_s[-1])]
    points = [
        {name: float(series[name][min(int(np.searchsorted(drive.time_s, t - 1e-9)), len(rows) - 1)]) for name in series}
        for t in at_times
    ]
    result = {
        "vehicle": description.name,
        "method": description.hysteresis,
        "thermal": description.thermal,
        "output": str(path),
        "rows": len(rows),
        "points": points,
    }
    emit(result, as_json, lambda: _text(result))


def _check_speed(speed: float, most: float) -> None:
    if abs(speed) > 1.2 * most:
        raise InputError(
            "speed", f"{abs(speed) * 3.6:g} km/h", f"up to 1.2 times the vehicle file's max_speed, {1.2 * most * 3.6:.0f} km/h"
        )


def _read_profile(path: Path) -> tuple[Any, Any]:
    from trackres_ros.csvs import TableSource
    from trackres_ros.sources import open_source

    source = open_source([path])
    if not isinstance(source, TableSource):
        raise InputError("--profile", str(path), "a CSV or Parquet table; trackres replay reads bags")
    recording = Recording.from_source(source)
    speed = recording.series["speed"]
    return recording.time_s("speed"), speed.value


def _text(result: dict[str, Any]) -> str:
    parts = {"resistance": "resistance_torque_nm", **RESISTANCE_PARTS}
    lines = [
        f"{'time':>8} {'speed':>7} " + " ".join(f"{part:>10}" for part in parts) + f" {'belt':>6}",
        f"{'s':>8} {'km/h':>7} " + " ".join(f"{'Nm':>10}" for _ in parts) + f" {'degC':>6}",
    ]
    lines += [
        f"{decimals(p['time_s']):>8} {decimals(p['speed_mps'] * 3.6, 1):>7} "
        + " ".join(f"{decimals(p[column]):>10}" for column in parts.values())
        + f" {decimals(p['belt_degc'], 1):>6}"
        for p in result["points"]
    ]
    return "\n".join([*lines, f"{result['rows']} rows in {result['output']}"])
